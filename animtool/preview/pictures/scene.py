"""Draws all 3D content of a page, in order."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, TypeAlias

import numpy as np

from animtool.core.array_types import FloatArray
from animtool.preview.pictures.bones import Color, DrawnBones
from animtool.preview.pictures.camera import Bounds, CameraView, EyeMatrices
from animtool.preview.pictures.data import StreamReader
from animtool.preview.pictures.device import Array, Device, Framebuffer
from animtool.preview.pictures.ground import ContactShadow, DrawnGround, DrawnTrails
from animtool.preview.pictures.lines import DrawnLines
from animtool.preview.pictures.pose import DrawnPose, compose_matrices
from animtool.preview.pictures.shapes import (
    DrawnInstances,
    DrawnMesh,
    DrawnPoints,
    DrawnStrands,
)
from animtool.preview.pictures.sources import theme_colors

# All layers, and the default ones.
LAYERS = (
    *("bones", "axes", "meshes", "trails", "contacts", "cameras", "grid", "shadows"),
)
DEFAULT_LAYERS = frozenset(LAYERS) - {"axes"}
# Maximum number of takes shown as single characters; more are a crowd.
MAX_SHADOW_CASTERS = 4
# A character is followed if its path is this many times longer than high; other motion,
# such as a bouncing ball, is framed completely.
MIN_PATH_RATIO = 2.0
# A stage this many times larger than its characters is not framed; they are.
MAX_STAGE_RATIO = 4
# Number of intervals of the motion at whose ends bounds are measured.
FRAMING_INTERVALS = 12
# Colours of takes if there are several.
TAKE_COLORS: tuple[Color, ...] = (
    *((56, 132, 196), (214, 126, 44), (60, 158, 116)),
    *((186, 92, 150), (138, 120, 206), (196, 84, 80)),
)

Solid: TypeAlias = DrawnMesh | DrawnInstances | DrawnPoints | DrawnStrands


class DrawnScene:
    """The contents of a page in an OpenGL context."""

    def __init__(
        self,
        device: Device,
        manifest: Mapping[str, Any],
        blocks: Sequence[str],
        shown: frozenset[str] = DEFAULT_LAYERS,
    ) -> None:
        self._device, self._shown = device, shown
        self._streams = streams = StreamReader(manifest["streams"], blocks)
        time = manifest["time"]
        self.codes = time["first"] + np.arange(time["count"]) * time["step"]
        self._poses = [
            DrawnPose(streams, take, i) for i, take in enumerate(manifest["takes"])
        ]
        geometries: dict[tuple[Any, ...], Any] = {}
        self._meshes = [
            DrawnMesh(device, streams, mesh, self._pose_of(mesh), geometries)
            for mesh in manifest["meshes"]
        ]
        self._instances = [
            DrawnInstances(device, streams, entry, self._meshes[entry["mesh"]])
            for entry in manifest["instances"]
        ]
        self._clouds = [
            DrawnPoints(device, streams, entry) for entry in manifest["points"]
        ]
        self._strands = [
            DrawnStrands(device, streams, entry, self._pose_of(entry))
            for entry in manifest["curves3d"]
        ]
        self.cameras: list[dict[str, Any]] = manifest["cameras"]
        self._bones = DrawnBones(device)
        self._trails = DrawnTrails(device, self.codes)
        self._frusta = DrawnLines(device)
        self._shadow = ContactShadow(device)
        self._ground = DrawnGround(device, 1.0)
        self._colors = theme_colors()
        self._crowd = len(self._poses) > MAX_SHADOW_CASTERS
        self._sample = -1

    def _pose_of(self, entry: Mapping[str, Any]) -> DrawnPose | None:
        take = entry.get("take")
        return None if take is None else self._poses[take]

    def frame_motion(self, view: CameraView, sample: int) -> None:
        """Frame everything from first to last sample; follow a travelling character."""
        self._update(sample)
        for pose in self._poses:
            box = Bounds()
            box.add(pose.positions)
            pose.extent = 1.0 if box.empty or box.radius <= 1e-3 else box.radius
        count = len(self.codes)
        sample_times = [
            int(i / FRAMING_INTERVALS * (count - 1) + 0.5)
            for i in range(FRAMING_INTERVALS + 1)
        ]
        samples = [*dict.fromkeys(sample_times), sample]
        roots = [self._root_at(i) for i in samples]
        offsets = np.array(roots) - roots[-1]
        travel = float(np.linalg.norm(offsets[:, [0, 2]], axis=1).max())
        main_pose = self._poses[0] if self._poses else None
        follow = (
            main_pose is not None
            and main_pose.count > 0
            and not self._crowd
            and travel
            > max(main_pose.extent, MIN_PATH_RATIO * float(np.ptp(offsets[:, 1])))
        )
        box, all_bounds, cast = Bounds(), Bounds(), Bounds()
        for i, root in zip(samples, roots, strict=True):
            self._update(i)
            shift = (roots[-1] - root) * [1.0, 0.0, 1.0] if follow else 0.0
            box = self._grow_bounds(all_bounds, cast, shift)
        view.frame(box)
        view.follow, view.followed_position = follow, None
        self._ground = DrawnGround(self._device, box.radius)

    def _root_at(self, sample: int) -> FloatArray:
        if not (self._poses and self._poses[0].count):
            return np.zeros(3)
        pose = self._poses[0]
        pose.update(sample)
        self._sample = -1
        position: FloatArray = pose.positions[pose.root].copy()
        return position

    def _grow_bounds(
        self, box: Bounds, cast: Bounds, shift: FloatArray | float
    ) -> Bounds:
        """Grow bounds of everything and of characters; return those to frame."""
        bounds, characters = Bounds(), Bounds()
        for pose in self._poses:
            if pose.visible:
                characters.add(pose.positions)
        for mesh in self._meshes:
            mesh.bound(characters if mesh.skinned else bounds)
        bounds.join(characters)
        drawn_objects: list[DrawnInstances | DrawnPoints | DrawnStrands]
        drawn_objects = [*self._instances, *self._clouds, *self._strands]
        for item in drawn_objects:
            item.bound(bounds)
        cast.join(characters, shift)
        box.join(bounds, shift)
        return (
            cast
            if not cast.empty and box.radius > MAX_STAGE_RATIO * cast.radius
            else box
        )

    def _update(self, sample: int) -> None:
        """Pose everything at a sample."""
        if sample == self._sample:
            return
        self._sample = sample
        for pose in self._poses:
            pose.update(sample)
        if "meshes" in self._shown:
            for solid in self._solids():
                solid.update(sample)

    def _solids(self) -> list[Solid]:
        return [*self._meshes, *self._instances, *self._clouds, *self._strands]

    def draw(
        self,
        view: CameraView,
        sample: int,
        picture: Framebuffer,
        shot: int | None = None,
    ) -> Array:
        """Return the pixels of a sample ``(H, W, 3)``.

        Args:
            view: The camera; it moves with the character it follows.
            sample: Sample of the page's timeline.
            picture: Framebuffer to draw into.
            shot: Index of a shot camera of the page to look through; None uses
                ``view``.
        """
        self._update(sample)
        visible = [pose for pose in self._poses if pose.visible]
        main_pose = self._poses[0] if self._poses else None
        root_position = (
            main_pose.positions[main_pose.root].copy()
            if main_pose and main_pose.count
            else None
        )
        view.track(root_position)
        accent = self._colors["accent"]
        several = len(self._poses) > 1
        self._trails.update(
            [] if self._crowd else visible,
            sample,
            self._color if several else lambda _: accent,
            self._colors["contact"],
            self._shown,
        )
        eye = None
        if shot is not None:
            eye = view.through(self.cameras[shot], self._streams, sample)
        eye = eye or view.eye()
        has_shadow = "shadows" in self._shown and self._shadow.cast(
            view, lambda below: self._draw_casting(below, visible, view.radius)
        )

        def draw(target: Any) -> None:
            self._draw_all(eye, view, visible, target, has_shadow=has_shadow, shot=shot)

        return picture.draw(self._colors["view"], draw)

    def _draw_casting(
        self, eye: EyeMatrices, visible: list[DrawnPose], radius: float
    ) -> None:
        shadow_casters = [
            solid
            for solid in self._solids()
            if not (isinstance(solid, DrawnMesh) and solid.surrounds(radius))
        ]
        self._draw_shapes(eye, shadow_casters)
        if not self._has_solid:
            self._draw_bones(eye, visible, axes=False)

    def _draw_all(
        self,
        eye: EyeMatrices,
        view: CameraView,
        visible: list[DrawnPose],
        target: Any,
        *,
        has_shadow: bool,
        shot: int | None,
    ) -> None:
        far_eye = eye.between(0.1, 1.0)
        self._draw_shapes(far_eye, self._solids())
        target.depth_mask = False
        with self._device.blending():
            if has_shadow:
                self._shadow.draw(far_eye)
            if "grid" in self._shown:
                colors = self._colors["grid"], self._colors["grid-strong"]
                self._ground.draw(far_eye, view.target, *colors)
            self._trails.draw(far_eye)
            if "cameras" in self._shown:
                self._draw_frusta(far_eye, view, shot)
        target.depth_mask = True
        axes = "axes" in self._shown
        if not self._has_solid:
            self._draw_bones(far_eye, visible, axes=axes)
            return
        # Drawn in front of the skin, which would hide them.
        with self._device.blending():
            self._draw_bones(eye.between(0.0, 0.1, 0.5), visible, axes=axes)

    @property
    def _has_solid(self) -> bool:
        return "meshes" in self._shown and any(
            mesh.pose is not None or mesh.record.get("cache") is not None
            for mesh in self._meshes
        )

    def _draw_shapes(self, eye: EyeMatrices, shapes: Sequence[Solid]) -> None:
        for shape in shapes if "meshes" in self._shown else []:
            if not (isinstance(shape, DrawnMesh) and shape.is_prototype):
                shape.draw(eye)

    def _draw_bones(
        self, eye: EyeMatrices, visible: list[DrawnPose], *, axes: bool
    ) -> None:
        bones = "bones" in self._shown
        self._bones.draw(eye, visible, self._color, bones=bones, axes=axes)

    def _color(self, take: int) -> Color:
        several = len(self._poses) > 1
        return TAKE_COLORS[take % len(TAKE_COLORS)] if several else self._colors["bone"]

    def _draw_frusta(
        self, eye: EyeMatrices, view: CameraView, shot: int | None
    ) -> None:
        segments: list[FloatArray] = []
        for i, camera in enumerate(self.cameras):
            if i == shot:
                continue
            t, r = (
                self._streams.at(camera[component], self._sample) for component in "tr"
            )
            if not (len(t) and len(r)):
                continue
            aperture_width, aperture_height = camera["aperture_mm"]
            size = view.radius * 0.16
            world = compose_matrices(t.astype(np.float64), r.astype(np.float64), None)
            gate = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1], [0, 1.5]])
            gate = gate * size * 0.5 * [1, aperture_height / aperture_width]
            corners = np.concatenate([gate, np.full((5, 1), -size)], axis=1)
            points = np.vstack([corners @ world[:3, :3].T + world[:3, 3], world[:3, 3]])
            edges = [(5, k) for k in range(4)] + [(k, (k + 1) % 4) for k in range(4)]
            segments.append(points[np.array([*edges, (3, 4), (2, 4)])])
        if segments:
            lines = np.concatenate(segments)
            color = np.array([*self._colors["soft"], 255.0])
            self._frusta.set(lines[:, 0], lines[:, 1], color)
            self._frusta.draw(eye, width=1.5)
