"""Poses of a take: joint transforms at a sample, and trails around it."""

from __future__ import annotations

import re
from typing import Any

import numpy as np

from animtool.core.array_types import BoolArray, FloatArray, IntArray
from animtool.preview.pictures.data import StreamReader

_FOOT_NAME_PATTERN = re.compile("foot|toe|ankle|paw|hoof|ball", re.I)


def compose_matrices(
    translations: FloatArray, rotations: FloatArray, scales: FloatArray | None
) -> FloatArray:
    """Return matrices T·R·S ``(..., 4, 4)``; rotations need not be normalized."""
    norm = np.linalg.norm(rotations, axis=-1, keepdims=True)
    x, y, z, w = np.moveaxis(rotations / np.where(norm > 0, norm, 1.0), -1, 0)
    matrices = np.zeros((*x.shape, 4, 4))
    matrices[..., 0, 0] = 1 - 2 * (y * y + z * z)
    matrices[..., 1, 0], matrices[..., 2, 0] = 2 * (x * y + z * w), 2 * (x * z - y * w)
    matrices[..., 0, 1], matrices[..., 2, 1] = 2 * (x * y - z * w), 2 * (y * z + x * w)
    matrices[..., 1, 1] = 1 - 2 * (x * x + z * z)
    matrices[..., 0, 2], matrices[..., 1, 2] = 2 * (x * z + y * w), 2 * (y * z - x * w)
    matrices[..., 2, 2] = 1 - 2 * (x * x + y * y)
    if scales is not None:
        matrices[..., :3, :3] *= scales[..., None, :]
    matrices[..., :3, 3] = translations
    matrices[..., 3, 3] = 1
    return matrices


class PosedTake:
    """A take of a page in the pose of one sample.

    Attributes:
        world_matrices: World matrices of its joints ``(J, 4, 4)``.
        is_visible: Whether it is drawn at the sample.
        bounds_radius: Radius of its bounds [m].
        root: The first joint with animated translation, else the first joint.
        trail_joints: Joints with trails.
    """

    def __init__(
        self, streams: StreamReader, manifest_entry: dict[str, Any], index: int
    ) -> None:
        self._streams, self.manifest_entry, self.index = streams, manifest_entry, index
        skeleton = manifest_entry["skeleton"]
        self.joint_names: list[str] = skeleton["names"]
        self.parents = np.array(skeleton["parents"], np.int64)
        self.joint_count = len(self.joint_names)
        self.joints_by_depth = _joints_by_depth(self.parents)
        static_by_component = manifest_entry.get("still") or skeleton["rest"]
        self._values_by_component = {
            "t": np.reshape(static_by_component["t"], (-1, 3)).astype(np.float64),
            "r": np.reshape(static_by_component["r"], (-1, 4)).astype(np.float64),
            "s": np.ones((self.joint_count, 3)),
        }
        if static_by_component.get("s") is not None:
            self._values_by_component["s"] = np.array(
                static_by_component["s"], np.float64
            )
        self._animated_components = [
            (
                component,
                manifest_entry[component],
                np.array(manifest_entry["moving"][component], np.int64),
            )
            for component in "trs"
            if manifest_entry.get(component) is not None
            and manifest_entry["moving"].get(component)
        ]
        self.first_sample: int = (manifest_entry.get("span") or [0])[0]
        self.shift = np.array(manifest_entry.get("offset") or [0.0] * 3)
        self.tips = [
            (int(j), np.array(position)) for j, *position in skeleton.get("tips") or []
        ]
        self.world_matrices = np.zeros((self.joint_count, 4, 4))
        self.is_visible, self.bounds_radius = True, 1.0
        self.root = self._find_root()
        self.trail_joints = self._trail_joints()
        self._positions_by_sample: dict[int, FloatArray] = {}

    def _find_root(self) -> int:
        """Return the first joint with animated translation, else the first joint."""
        translated_joints = {
            int(j)
            for component, _, joints in self._animated_components
            if component == "t"
            for j in joints
        }
        joint_order = [int(j) for level in self.joints_by_depth for j in level]
        return next(
            (j for j in joint_order if j in translated_joints),
            joint_order[0] if joint_order else 0,
        )

    def _trail_joints(self) -> list[int]:
        """Return the joints with trails: the root and the feet."""
        if not self.joint_count:
            return []
        feet = [
            contact["joint"] for contact in self.manifest_entry.get("contacts") or []
        ]
        if not feet:
            parent_names = [self.joint_names[p] if p >= 0 else "" for p in self.parents]
            feet = [
                int(j)
                for level in self.joints_by_depth
                for j in level
                if _FOOT_NAME_PATTERN.search(self.joint_names[j])
                and not _FOOT_NAME_PATTERN.search(parent_names[j])
            ][:8]
        return list(dict.fromkeys([self.root, *feet]))

    def sample_values(self, stream: int | None, sample: int) -> FloatArray | None:
        """Return a stream's values at a page sample; None if there is no stream."""
        if stream is None:
            return None
        return self._streams.sample_values(stream, sample - self.first_sample)

    def update(self, sample: int) -> None:
        """Set the visibility and the world matrices of the take at a sample."""
        visibility = self.sample_values(self.manifest_entry.get("visible"), sample)
        self.is_visible = visibility is None or visibility[0] != 0
        self.world_matrices = self._posed_matrices(sample)

    def _posed_matrices(self, sample: int) -> FloatArray:
        """Return the world matrices of the joints at a sample ``(J, 4, 4)``."""
        values_by_component = self._values_by_component
        for component, stream, joints in self._animated_components:
            stored_values = self._streams.sample_values(
                stream, sample - self.first_sample
            )
            values_by_component[component][joints] = stored_values.reshape(
                len(joints), -1
            )
        world = compose_matrices(
            values_by_component["t"], values_by_component["r"], values_by_component["s"]
        )
        for level in self.joints_by_depth[1:]:
            world[level] = world[self.parents[level]] @ world[level]
        world[:, :3, 3] += self.shift
        return world

    @property
    def positions(self) -> FloatArray:
        """World positions of the joints ``(J, 3)`` [m]."""
        return self.world_matrices[:, :3, 3]

    @property
    def root_position(self) -> FloatArray:
        """World position of the root joint ``(3,)`` [m]."""
        position: FloatArray = self.positions[self.root].copy()
        return position

    def tip_ends(self) -> tuple[list[int], FloatArray]:
        """Return the joints that have a tip, and the tip positions ``(N, 3)``."""
        joints = [j for j, _ in self.tips]
        ends = [
            self.world_matrices[j, :3, :3] @ tip_position
            + self.world_matrices[j, :3, 3]
            for j, tip_position in self.tips
        ]
        return joints, np.reshape(ends, (-1, 3))

    def trail_positions(self, first_sample: int, last_sample: int) -> FloatArray:
        """Return positions of the trail joints in a range of samples ``(F, T, 3)``."""
        previous_positions = self._positions_by_sample
        # Positions that the next picture of a film needs are kept.
        self._positions_by_sample = {
            i: previous_positions[i]
            for i in range(first_sample, last_sample + 1)
            if i in previous_positions
        }
        for sample in range(first_sample, last_sample + 1):
            if sample not in self._positions_by_sample:
                world = self._posed_matrices(sample)
                self._positions_by_sample[sample] = world[self.trail_joints, :3, 3]
        return np.stack(
            [self._positions_by_sample[i] for i in range(first_sample, last_sample + 1)]
        )

    def contacts_at(self, codes: FloatArray) -> BoolArray:
        """Return whether trail joints touch the ground at time codes ``(F, T)``."""
        is_in_contact = np.zeros((len(codes), len(self.trail_joints)), bool)
        for contact in self.manifest_entry.get("contacts") or []:
            for column, joint in enumerate(self.trail_joints):
                if joint == contact["joint"]:
                    is_in_contact[:, column] |= is_in_spans(codes, contact["spans"])
        return is_in_contact


def is_in_spans(codes: FloatArray, spans: list[list[float]]) -> BoolArray:
    """Return whether each time code is inside any of the spans ``(F,)``."""
    is_inside = np.zeros(len(codes), bool)
    for first, last in spans:
        is_inside |= (codes >= first - 1e-6) & (codes <= last + 1e-6)
    return is_inside


def _joints_by_depth(parents: IntArray) -> list[IntArray]:
    """Return joints grouped by depth, parents first."""
    depths = np.full(len(parents), -1)
    joints = np.flatnonzero(parents < 0)
    joints_by_depth: list[IntArray] = []
    while len(joints):
        depths[joints] = len(joints_by_depth)
        joints_by_depth.append(joints.astype(np.int64))
        joints = np.flatnonzero((depths < 0) & np.isin(parents, joints))
    return joints_by_depth
