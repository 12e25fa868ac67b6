"""Draws all 3D content of a page, in order."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, TypeAlias

import numpy as np

from animtool.core.array_types import FloatArray
from animtool.preview.pictures.bones import Bones, Color
from animtool.preview.pictures.camera import Bounds, CameraView, Eye
from animtool.preview.pictures.data import Streams
from animtool.preview.pictures.device import Array, Device, Picture
from animtool.preview.pictures.ground import DrawnGround, Shadow, Trails
from animtool.preview.pictures.lines import DrawnLines
from animtool.preview.pictures.pose import DrawnPose, composed
from animtool.preview.pictures.shapes import (
    DrawnMesh,
    DrawnStrands,
    Instances,
    PointCloud,
)
from animtool.preview.pictures.sources import theme_colors

# All layers, and the default ones.
LAYERS = (
    *("bones", "axes", "meshes", "trails", "contacts", "cameras", "grid", "shadows"),
)
DEFAULT_LAYERS = frozenset(LAYERS) - {"axes"}
# Most takes that are looked at one by one: with more it is a crowd.
CAST = 4
# A stage this many times larger than its characters is not framed completely.
WIDE = 4
# Parts of the motion, at whose ends the camera looks where everything is.
LOOKS = 12
# Colours of takes, where there are several.
SERIES: tuple[Color, ...] = (
    *((56, 132, 196), (214, 126, 44), (60, 158, 116)),
    *((186, 92, 150), (138, 120, 206), (196, 84, 80)),
)

Solid: TypeAlias = DrawnMesh | Instances | PointCloud | DrawnStrands


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
        self._streams = streams = Streams(manifest["streams"], blocks)
        time = manifest["time"]
        self.codes = time["first"] + np.arange(time["count"]) * time["step"]
        self._poses = [
            DrawnPose(streams, take, i) for i, take in enumerate(manifest["takes"])
        ]
        known: dict[tuple[Any, ...], Any] = {}
        self._meshes = [
            DrawnMesh(device, streams, mesh, self._pose_of(mesh), known)
            for mesh in manifest["meshes"]
        ]
        self._instances = [
            Instances(device, streams, each, self._meshes[each["mesh"]])
            for each in manifest["instances"]
        ]
        self._clouds = [
            PointCloud(device, streams, each) for each in manifest["points"]
        ]
        self._strands = [
            DrawnStrands(device, streams, each, self._pose_of(each))
            for each in manifest["curves3d"]
        ]
        self.cameras: list[dict[str, Any]] = manifest["cameras"]
        self._bones = Bones(device)
        self._trails = Trails(device, self.codes)
        self._frusta = DrawnLines(device)
        self._shadow = Shadow(device)
        self._ground = DrawnGround(device, 1.0)
        self._colors = theme_colors()
        self._crowd = len(self._poses) > CAST
        self._sample = -1

    def _pose_of(self, entry: Mapping[str, Any]) -> DrawnPose | None:
        take = entry.get("take")
        return None if take is None else self._poses[take]

    def look(self, view: CameraView, sample: int) -> None:
        """Frame everything from first to last sample; follow a travelling character."""
        self._update(sample)
        for pose in self._poses:
            box = Bounds()
            box.add(pose.positions)
            pose.extent = 1.0 if box.empty or box.radius <= 1e-3 else box.radius
        count = len(self.codes)
        parts = [int(i / LOOKS * (count - 1) + 0.5) for i in range(LOOKS + 1)]
        looks = [*dict.fromkeys(parts), sample]
        roots = [self._root_at(i) for i in looks]
        level = (np.array(roots) - roots[-1])[:, [0, 2]]
        first = self._poses[0] if self._poses else None
        follow = (
            first is not None
            and first.count > 0
            and not self._crowd
            and bool((np.linalg.norm(level, axis=1) > first.extent).any())
        )
        box, around, cast = Bounds(), Bounds(), Bounds()
        for i, root in zip(looks, roots, strict=True):
            self._update(i)
            shift = (roots[-1] - root) * [1.0, 0.0, 1.0] if follow else 0.0
            box = self._grown(around, cast, shift)
        view.frame(box)
        view.follow, view.followed = follow, None
        self._ground = DrawnGround(self._device, box.radius)

    def _root_at(self, sample: int) -> FloatArray:
        if not (self._poses and self._poses[0].count):
            return np.zeros(3)
        pose = self._poses[0]
        pose.update(sample)
        self._sample = -1
        at: FloatArray = pose.positions[pose.root].copy()
        return at

    def _grown(self, box: Bounds, cast: Bounds, shift: FloatArray | float) -> Bounds:
        """Grow bounds of everything and of characters; return those to frame."""
        bounds, around = Bounds(), Bounds()
        for pose in self._poses:
            if pose.visible:
                around.add(pose.positions)
        for mesh in self._meshes:
            mesh.bound(around if mesh.skinned else bounds)
        bounds.join(around)
        others: list[Instances | PointCloud | DrawnStrands]
        others = [*self._instances, *self._clouds, *self._strands]
        for each in others:
            each.bound(bounds)
        cast.join(around, shift)
        box.join(bounds, shift)
        return cast if not cast.empty and box.radius > WIDE * cast.radius else box

    def _update(self, sample: int) -> None:
        """Pose everything at a sample."""
        if sample == self._sample:
            return
        self._sample = sample
        for pose in self._poses:
            pose.update(sample)
        if "meshes" in self._shown:
            for each in self._solids():
                each.update(sample)

    def _solids(self) -> list[Solid]:
        return [*self._meshes, *self._instances, *self._clouds, *self._strands]

    def draw(
        self, view: CameraView, sample: int, picture: Picture, shot: int | None = None
    ) -> Array:
        """Return the pixels of a sample ``(H, W, 3)``.

        Args:
            view: The camera; it goes along with what it follows.
            sample: Of the page's timeline.
            picture: What is drawn into.
            shot: Number of a camera of the page to look through.
        """
        self._update(sample)
        visible = [pose for pose in self._poses if pose.visible]
        first = self._poses[0] if self._poses else None
        at = first.positions[first.root].copy() if first and first.count else None
        view.track(at)
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
        shaded = "shadows" in self._shown and self._shadow.cast(
            view, lambda below: self._draw_casting(below, visible, view.radius)
        )

        def draw(target: Any) -> None:
            self._draw_all(eye, view, visible, target, shaded=shaded, shot=shot)

        return picture.draw(self._colors["view"], draw)

    def _draw_casting(self, eye: Eye, visible: list[DrawnPose], radius: float) -> None:
        casting = [
            each
            for each in self._solids()
            if not (isinstance(each, DrawnMesh) and each.surrounds(radius))
        ]
        self._draw_shapes(eye, casting)
        if not self._solid:
            self._draw_bones(eye, visible, axes=False)

    def _draw_all(
        self,
        eye: Eye,
        view: CameraView,
        visible: list[DrawnPose],
        target: Any,
        *,
        shaded: bool,
        shot: int | None,
    ) -> None:
        behind = eye.between(0.1, 1.0)
        self._draw_shapes(behind, self._solids())
        target.depth_mask = False
        with self._device.blending():
            if shaded:
                self._shadow.draw(behind)
            if "grid" in self._shown:
                colors = self._colors["grid"], self._colors["grid-strong"]
                self._ground.draw(behind, view.target, *colors)
            self._trails.draw(behind)
            if "cameras" in self._shown:
                self._draw_frusta(behind, view, shot)
        target.depth_mask = True
        axes = "axes" in self._shown
        if not self._solid:
            self._draw_bones(behind, visible, axes=axes)
            return
        # In front of the skin, which hides them else.
        with self._device.blending():
            self._draw_bones(eye.between(0.0, 0.1, 0.5), visible, axes=axes)

    @property
    def _solid(self) -> bool:
        return "meshes" in self._shown and any(
            mesh.pose is not None or mesh.record.get("cache") is not None
            for mesh in self._meshes
        )

    def _draw_shapes(self, eye: Eye, shapes: Sequence[Solid]) -> None:
        for each in shapes if "meshes" in self._shown else []:
            if not (isinstance(each, DrawnMesh) and each.copied):
                each.draw(eye)

    def _draw_bones(self, eye: Eye, visible: list[DrawnPose], *, axes: bool) -> None:
        bones = "bones" in self._shown
        self._bones.draw(eye, visible, self._color, bones=bones, axes=axes)

    def _color(self, take: int) -> Color:
        several = len(self._poses) > 1
        return SERIES[take % len(SERIES)] if several else self._colors["bone"]

    def _draw_frusta(self, eye: Eye, view: CameraView, shot: int | None) -> None:
        segments: list[FloatArray] = []
        for i, camera in enumerate(self.cameras):
            if i == shot:
                continue
            t, r = (self._streams.at(camera[part], self._sample) for part in "tr")
            if not (len(t) and len(r)):
                continue
            wide, high = camera["aperture_mm"]
            size = view.radius * 0.16
            world = composed(t.astype(np.float64), r.astype(np.float64), None)
            flat = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1], [0, 1.5]])
            flat = flat * size * 0.5 * [1, high / wide]
            corners = np.concatenate([flat, np.full((5, 1), -size)], axis=1)
            points = np.vstack([corners @ world[:3, :3].T + world[:3, 3], world[:3, 3]])
            pairs = [(5, k) for k in range(4)] + [(k, (k + 1) % 4) for k in range(4)]
            segments.append(points[np.array([*pairs, (3, 4), (2, 4)])])
        if segments:
            lines = np.concatenate(segments)
            color = np.array([*self._colors["soft"], 255.0])
            self._frusta.set(lines[:, 0], lines[:, 1], color)
            self._frusta.draw(eye, width=1.5)
