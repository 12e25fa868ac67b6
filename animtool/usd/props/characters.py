"""Crowd characters: instances of rigs with separate or shared animations.

Samples that interpolation reproduces are omitted. The hips' motion is in the transform
of the character's prim, so that its animation has only rotations.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import field
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt
from pxr import Gf, Sdf, Vt

from animtool.core.array_types import BoolArray, Float32Array, FloatArray, IntArray
from animtool.core.record import dataclass
from animtool.maths import so3
from animtool.motion.frames import Cast, CharactersFrame
from animtool.rig.kinematics import rest_world
from animtool.rig.surfaces import surfaces_of
from animtool.usd.caches.writer import CharactersReport
from animtool.usd.layers.names import RigPaths, distinct_names, joint_names
from animtool.usd.layers.sdf import (
    apply_schemas,
    attribute_spec,
    author_relationship,
    author_xform_order,
    gf_quatf,
    prim_spec,
    write_samples,
)
from animtool.usd.props.sparse import (
    FOOT_TOLERANCE,
    JOINT_TOLERANCE,
    PoseSkeleton,
    find_rotating_joints,
    select_samples,
    slerp,
)
from animtool.usd.rigs.meshes import author_bones, author_meshes
from animtool.usd.rigs.skeleton import author_rig

_TYPES = Sdf.ValueTypeNames
PROTOTYPES_SCOPE, STANDING_SCOPE = "Prototypes", "Standing"
# Samples equal to both neighbors within these are omitted: position [m], heading [rad].
POSITION_TOLERANCE, HEADING_TOLERANCE = 1e-6, 1e-6
# Size of a skin's bounds, relative to those of its joints.
SKIN_EXTENT_FACTOR = 1.2


@dataclass
class CharactersWriter:
    """Collects the frames of crowd characters, and writes them at the end.

    Attributes:
        path: Path of their parent prim.
        unit: Unit of the layer [m].
        fps: Time codes per second.
    """

    path: str
    unit: float
    fps: float
    report: CharactersReport = field(default_factory=CharactersReport)
    codes: list[float] = field(default_factory=list)
    _first_frame: CharactersFrame | None = None
    _rows_by_name: dict[str, list[npt.NDArray[Any]]] = field(default_factory=dict)
    _rotations: list[list[Float32Array]] = field(default_factory=list)

    def author_prototypes(self, layer: Any, frame: CharactersFrame) -> None:
        """Write the parent prim, and the rigs as prototypes."""
        self._first_frame = frame
        prim_spec(layer, self.path, "Xform")
        for cast, paths in zip(frame.casts, self._rig_paths(frame), strict=True):
            _author_cast(layer, cast, paths, self.unit)
        scope = prim_spec(layer, f"{self.path}/{PROTOTYPES_SCOPE}", "Scope")
        scope.specifier = Sdf.SpecifierClass
        scope.ClearInfo("kind")

    def _rig_paths(self, frame: CharactersFrame) -> list[RigPaths]:
        """Return the prim paths of the prototype rigs."""
        names = [cast.rig.name for cast in frame.casts]
        legal_names = distinct_names(names, names, names).names
        return [
            RigPaths.from_model(f"{self.path}/{PROTOTYPES_SCOPE}/{name}")
            for name in legal_names
        ]

    def add(self, code: float, frame: CharactersFrame) -> None:
        """Collect the values of all characters at one frame."""
        self.codes.append(code)
        for name in ("points", "headings", "roots", "near_ground", "clocks", "visible"):
            self._rows_by_name.setdefault(name, []).append(getattr(frame, name))
        self._rotations.append(
            [rotations.astype(np.float32) for rotations in frame.joint_rotations]
        )

    def finish(self, layer: Any) -> None:
        """Write all collected characters."""
        frame = self._first_frame
        assert frame is not None
        rig_ends = np.cumsum(frame.counts).tolist()
        for c, (cast, paths) in enumerate(
            zip(frame.casts, self._rig_paths(frame), strict=True)
        ):
            members = slice(rig_ends[c] - int(frame.counts[c]), rig_ends[c])
            rig_values = {
                name: np.stack(
                    [frame_values[members] for frame_values in values_by_frame]
                )
                for name, values_by_frame in self._rows_by_name.items()
            }
            rotations = np.stack([frame_values[c] for frame_values in self._rotations])
            track = _CharacterTrack(
                np.array(self.codes),
                _align_signs(rotations),
                frame.scales[members],
                cast,
                **rig_values,
            )
            group = _CharacterGroup(self, layer, paths, frame.upright, track)
            group.author_bounds()
            group.write([f"agent_{i + 1:04d}" for i in frame.ids[members].tolist()])


def _author_cast(layer: Any, cast: Cast, paths: RigPaths, unit: float) -> None:
    """Write the rig of a cast as a prototype, with its meshes or bones."""
    rig = cast.rig
    names = joint_names(rig.joints, 0)
    author_rig(layer, rig, names, paths, unit)
    if rig.meshes:
        tokens = dict(zip(rig.names, rig.paths(names.names), strict=True))
        author_meshes(layer, surfaces_of(rig), paths, tokens, unit)
    else:
        author_bones(layer, rig, paths, unit)
    root = layer.GetPrimAtPath(paths.root)
    apply_schemas(root, ["SkelBindingAPI"])
    author_relationship(root, "skel:skeleton", paths.skeleton)


@dataclass(frozen=True)
class _CharacterTrack:
    """Motion of n characters of one rig over F frames."""

    codes: FloatArray  # time codes (F,)
    rotations: Float32Array  # of the animated joints (F, n, M, 4)
    scales: FloatArray  # (n,)
    cast: Cast
    points: FloatArray  # (F, n, 3) [m]
    headings: FloatArray  # (F, n) [rad]
    roots: FloatArray  # (F, n, 3) [m]
    near_ground: BoolArray  # whether each foot is on or near the ground (F, n, 2)
    clocks: FloatArray  # times in the standing animation (F, n) [s]
    visible: BoolArray  # (F, n)

    @cached_property
    def extent(self) -> float:
        """Largest extent of the joints at rest along an axis [m]."""
        return float(np.ptp(self.rest_positions, axis=0).max())

    @cached_property
    def rest_positions(self) -> FloatArray:
        """Rest positions of the joints ``(J, 3)`` [m]."""
        return np.asarray(rest_world(self.cast.rig).positions[0])

    @cached_property
    def subtree_radii(self) -> FloatArray:
        """Distance of each animated joint to its farthest descendant ``(M,)`` [m]."""
        parents = self.cast.rig.parents.tolist()
        radii = np.zeros(len(parents))
        for j in range(len(parents)):
            parent = parents[j]
            while parent >= 0:
                length = np.linalg.norm(
                    self.rest_positions[j] - self.rest_positions[parent]
                )
                radii[parent] = max(radii[parent], float(length))
                parent = parents[parent]
        return np.asarray(radii[self.cast.animated])

    @cached_property
    def pose_joints(self) -> IntArray:
        """Joints that define a pose: animated joints and feet."""
        cast = self.cast
        return np.union1d(cast.animated, np.array(cast.feet))

    @cached_property
    def pose_skeleton(self) -> PoseSkeleton:
        """The pose joints as a skeleton; static joints between them stay at rest."""
        rig, pose_joints = self.cast.rig, self.pose_joints.tolist()
        animated_index = {
            joint: m for m, joint in enumerate(self.cast.animated.tolist())
        }
        parents, positions, rotations = [], [], []
        for joint in pose_joints:
            position, rotation = rig.rest_translations[joint], so3.IDENTITY
            parent = int(rig.parents[joint])
            while parent >= 0 and parent not in pose_joints:
                rest_rotation = rig.rest_rotations[parent]
                position = rig.rest_translations[parent] + so3.rotate(
                    rest_rotation, position
                )
                rotation = so3.multiply(rest_rotation, rotation)
                parent = int(rig.parents[parent])
            parents.append(pose_joints.index(parent) if parent >= 0 else -1)
            positions.append(position)
            rotations.append(rotation)
        return PoseSkeleton(
            np.array(parents),
            np.array([animated_index.get(joint, -1) for joint in pose_joints]),
            np.array(positions),
            np.array(rotations),
            rig.rest_rotations[self.pose_joints],
            np.searchsorted(self.pose_joints, self.cast.feet),
            self.extent,
        )


@dataclass(frozen=True)
class _CharacterGroup:
    """Characters of one rig in a layer."""

    owner: CharactersWriter
    layer: Any
    paths: RigPaths
    up_rotation: FloatArray
    track: _CharacterTrack

    def write(self, names: Sequence[str]) -> None:
        """Write all characters, by name."""
        track, report = self.track, self.owner.report
        extent = track.extent * float(track.scales.max(initial=0.0))
        report.error = max(report.error, JOINT_TOLERANCE * extent)
        report.slide = max(report.slide, FOOT_TOLERANCE * extent)
        is_standing = self._find_standing()
        for i, name in enumerate(names):
            path = f"{self.owner.path}/{name}"
            if is_standing[i]:
                report.shared += 1
                self._author_root(path, i, None)
                self._reference_shared(path, i)
                continue
            rotations = track.rotations[:, i].copy()
            is_rotating = find_rotating_joints(
                rotations, track.subtree_radii, track.extent
            )
            rotations[:, ~is_rotating] = rotations[:1, ~is_rotating]
            is_written, corrections = select_samples(
                rotations, track.pose_skeleton, track.near_ground[:, i]
            )
            report.own += 1
            report.samples += int(is_written.sum())
            report.frames += len(track.codes)
            self._author_root(path, i, corrections)
            self._write_animation(path, rotations, is_rotating, is_written)

    def author_bounds(self) -> None:
        """Author bounds of the rig that contain every pose.

        Their radius is the largest distance of a rest joint from the hips, times a
        factor.
        """
        rest_positions = self.track.rest_positions
        distances = np.linalg.norm(rest_positions - rest_positions[0], axis=1)
        radius = float(distances.max()) * SKIN_EXTENT_FACTOR / self.owner.unit
        hips = rest_positions[0] / self.owner.unit
        corners = np.stack([hips - radius, hips + radius])
        root = self.layer.GetPrimAtPath(self.paths.root)
        extent = Vt.Vec3fArray.FromNumpy(corners.astype(np.float32))
        attribute_spec(root, "extent", _TYPES.Float3Array, extent)

    def _find_standing(self) -> BoolArray:
        """Return which characters stand still and can share an animation ``(n,)``."""
        track = self.track
        is_standing = np.isfinite(track.clocks).all(axis=0) & track.visible.all(axis=0)
        is_standing &= np.ptp(track.points, axis=0).max(axis=-1) <= POSITION_TOLERANCE
        is_standing &= np.ptp(track.headings, axis=0) <= HEADING_TOLERANCE
        # On uneven ground each leg has its own pose.
        cast = track.cast
        for i in np.flatnonzero(is_standing).tolist():
            (standing_rotations,) = _standing_values(
                cast, cast.rotations, track.clocks[:1, i]
            )
            is_standing_pose = (
                np.abs((standing_rotations * track.rotations[0, i]).sum(axis=-1))
                > 1 - 1e-6
            )
            is_standing[i] = bool(is_standing_pose.all())
        return np.asarray(is_standing & (is_standing.sum() > 1))

    def _author_root(
        self, path: str, character_index: int, foot_correction: FloatArray | None
    ) -> None:
        """Write the root transform of a character, and its rig reference.

        ``foot_correction`` offsets the hips; None if the animation moves the hips.
        """
        track, unit = self.track, self.owner.unit
        spec = prim_spec(self.layer, path, "Xform")
        spec.SetInfo("kind", "component")
        motion = np.zeros((len(track.codes), 3))
        if foot_correction is not None:
            rest = track.cast.rig.rest_translations[0]
            motion = track.roots[:, character_index] - rest + foot_correction
        half_angles = track.headings[:, character_index] / 2
        heading_rotations = np.zeros((len(half_angles), 4))
        heading_rotations[:, 1] = np.sin(half_angles)
        heading_rotations[:, 3] = np.cos(half_angles)
        hip_offset = so3.rotate(
            self.up_rotation,
            so3.rotate(heading_rotations, motion * track.scales[character_index]),
        )
        positions = ((track.points[:, character_index] + hip_offset) / unit).astype(
            np.float32
        )
        op_names = ["xformOp:translate"]
        translate = attribute_spec(spec, "xformOp:translate", _TYPES.Float3)
        changed_frames = _changing_frames(positions, POSITION_TOLERANCE / unit)
        write_samples(
            translate,
            track.codes,
            changed_frames,
            [Gf.Vec3f(*position) for position in positions[changed_frames].tolist()],
        )
        if (self.up_rotation != so3.IDENTITY).any():
            attribute_spec(
                spec, "xformOp:orient", _TYPES.Quatf, gf_quatf(self.up_rotation)
            )
            op_names.append("xformOp:orient")
        rotate = attribute_spec(spec, "xformOp:rotateY", _TYPES.Float)
        degrees = np.degrees(track.headings[:, character_index]).astype(np.float32)
        changed_frames = _changing_frames(
            degrees[:, None], np.degrees(HEADING_TOLERANCE)
        )
        write_samples(
            rotate, track.codes, changed_frames, degrees[changed_frames].tolist()
        )
        op_names.append("xformOp:rotateY")
        if track.scales[character_index] != 1:
            scale = Gf.Vec3f(*[float(track.scales[character_index])] * 3)
            attribute_spec(spec, "xformOp:scale", _TYPES.Float3, scale)
            op_names.append("xformOp:scale")
        author_xform_order(spec, *op_names)
        is_visible = track.visible[:, character_index]
        if not is_visible.all():
            visibility = attribute_spec(spec, "visibility", _TYPES.Token)
            changed_frames = np.flatnonzero(
                np.diff(is_visible, prepend=~is_visible[:1])
            )
            tokens = [
                "inherited" if visible else "invisible"
                for visible in is_visible[changed_frames].tolist()
            ]
            write_samples(visibility, track.codes, changed_frames, tokens)
        rig = prim_spec(self.layer, f"{path}/Rig", "SkelRoot")
        rig.SetInfo("instanceable", True)
        rig.referenceList.explicitItems = [Sdf.Reference("", self.paths.root)]
        apply_schemas(rig, ["SkelBindingAPI"])
        author_relationship(rig, "skel:animationSource", f"{path}/Anim")

    def _write_animation(
        self,
        path: str,
        poses: Float32Array,
        is_animated: BoolArray,
        is_written: BoolArray,
    ) -> None:
        """Write a separate animation of poses ``(F, M, 4)`` for a character.

        Static joints that are not at rest get a constant pose.
        """
        rest = self.track.cast.rig.rest_rotations[self.track.cast.animated]
        is_animated = is_animated | ((poses[0] * rest).sum(axis=-1) ** 2 < 1 - 1e-9)
        spec = self._author_animation(f"{path}/Anim", np.flatnonzero(is_animated))
        sample_frames = np.flatnonzero(is_written)
        rotations = spec.attributes["rotations"]
        arrays = _vt_arrays(Vt.QuatfArray, poses[sample_frames][:, is_animated])
        write_samples(rotations, self.track.codes, sample_frames, arrays)

    def _author_animation(self, path: str, animated_indices: IntArray) -> Any:
        """Author a SkelAnimation whose joints keep their rest translations."""
        cast, unit = self.track.cast, self.owner.unit
        joints = cast.animated[animated_indices]
        spec = prim_spec(self.layer, path, "SkelAnimation")
        spec.SetInfo("customData", {"animtool": {"thinned": True}})
        tokens = cast.rig.paths(joint_names(cast.rig.joints, 0).names)
        joint_tokens = Vt.TokenArray([tokens[j] for j in joints.tolist()])
        attribute_spec(spec, "joints", _TYPES.TokenArray, joint_tokens, is_uniform=True)
        rest = (cast.rig.rest_translations[joints] / unit).astype(np.float32)
        translations = Vt.Vec3fArray.FromNumpy(np.ascontiguousarray(rest))
        attribute_spec(spec, "translations", _TYPES.Float3Array, translations)
        attribute_spec(spec, "rotations", _TYPES.QuatfArray)
        unit_scales = Vt.Vec3hArray([Gf.Vec3h(1, 1, 1)] * len(joints))
        attribute_spec(spec, "scales", _TYPES.Half3Array, unit_scales)
        return spec

    def _reference_shared(self, path: str, character_index: int) -> None:
        """Bind a character to the shared standing animation, with a time offset."""
        track, fps = self.track, self.owner.fps
        shared_root = f"{self.paths.model}/{STANDING_SCOPE}"
        if self.layer.GetPrimAtPath(shared_root) is None:
            self._write_shared(shared_root)
        clock = float(track.clocks[0, character_index]) % max(track.cast.period, 1e-9)
        offset = float(track.codes[0]) - clock * fps
        spec = prim_spec(self.layer, f"{path}/Anim", "SkelAnimation")
        spec.referenceList.explicitItems = [
            Sdf.Reference("", shared_root, Sdf.LayerOffset(offset))
        ]

    def _write_shared(self, path: str) -> None:
        """Write the shared standing animation, from 0 s to its last use."""
        cast, fps, codes = self.track.cast, self.owner.fps, self.track.codes
        spec = self._author_animation(path, np.arange(len(cast.animated)))
        spec.SetInfo("customData", {"animtool": {"thinned": True, "shared": True}})
        # Standing characters start at most one period before the first frame.
        duration = (
            codes[-1] - codes[0] + cast.period * fps if len(cast.rotations) > 1 else 0.0
        )
        frames = np.arange(int(np.ceil(duration)) + 1)
        clocks = frames / fps
        rotations = _align_signs(
            _standing_values(cast, cast.rotations, clocks).astype(np.float32)
        )
        arrays = _vt_arrays(Vt.QuatfArray, rotations)
        codes = frames.astype(np.float64)
        write_samples(spec.attributes["rotations"], codes, frames, arrays)
        translations = np.repeat(
            cast.rig.rest_translations[None, cast.animated], len(frames), 0
        )
        translations[:, cast.animated == 0] = _standing_values(
            cast, cast.roots, clocks
        )[:, None]
        positions = (translations / self.owner.unit).astype(np.float32)
        arrays = _vt_arrays(Vt.Vec3fArray, positions)
        write_samples(spec.attributes["translations"], codes, frames, arrays)


def _vt_arrays(array_type: Any, values: Float32Array) -> list[Any]:
    """Return an array of a Vt type for each frame of values ``(F, N, K)``."""
    return [array_type.FromNumpy(np.ascontiguousarray(rows)) for rows in values]


def _standing_values(cast: Cast, samples: FloatArray, clocks: FloatArray) -> FloatArray:
    """Interpolate standing rotations or positions at clock times ``(K,)`` [s]."""
    count = len(samples)
    sample_position = clocks / (cast.period or 1.0) * count
    index = np.floor(sample_position).astype(np.int64)
    fraction = sample_position - index
    before, after = samples[index % count], samples[(index + 1) % count]
    if samples.ndim == 2:
        return np.asarray(before + fraction[:, None] * (after - before))
    after = np.where((before * after).sum(axis=-1, keepdims=True) < 0, -after, after)
    return slerp(before, after, fraction[:, None])


def _align_signs(rotations: Float32Array) -> Float32Array:
    """Return rotations ``(F, …, 4)`` with signs continuous over frames."""
    products = (rotations[1:] * rotations[:-1]).sum(axis=-1)
    signs = np.cumprod(np.where(products < 0, -1, 1), axis=0).astype(np.float32)
    aligned_rotations = rotations.copy()
    aligned_rotations[1:] *= signs[..., None]
    return aligned_rotations


def _changing_frames(values: Float32Array, tolerance: float) -> IntArray:
    """Return the frames before and after each change of values ``(F, K)``."""
    is_change = (np.abs(np.diff(values, axis=0)) > tolerance).any(axis=1)
    if not is_change.any():
        return np.zeros(1, np.int64)
    is_written = np.append(True, is_change) | np.append(is_change, True)
    return np.flatnonzero(is_written)
