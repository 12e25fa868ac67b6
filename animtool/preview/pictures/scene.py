"""Draws the layers of a page at a sample: ground, meshes, bones, trails, cameras."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, TypeAlias

import numpy as np

from animtool.core.array_types import FloatArray
from animtool.preview.pictures.bones import BoneRenderer, Color
from animtool.preview.pictures.camera import (
    Bounds,
    CameraView,
    EyeMatrices,
    shot_camera_matrix,
)
from animtool.preview.pictures.data import StreamReader
from animtool.preview.pictures.device import Array, Device, Framebuffer
from animtool.preview.pictures.ground import (
    ContactShadow,
    GroundRenderer,
    TrailRenderer,
)
from animtool.preview.pictures.lines import LineRenderer
from animtool.preview.pictures.pose import PosedTake
from animtool.preview.pictures.shapes import (
    InstanceRenderer,
    MeshRenderer,
    PointRenderer,
    StrandRenderer,
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

Drawable: TypeAlias = MeshRenderer | InstanceRenderer | PointRenderer | StrandRenderer


class SceneRenderer:
    """Draws the contents of a page at any sample, in an OpenGL context."""

    def __init__(
        self,
        device: Device,
        manifest: Mapping[str, Any],
        blocks: Sequence[str],
        shown_layers: frozenset[str] = DEFAULT_LAYERS,
    ) -> None:
        self._device, self._shown_layers = device, shown_layers
        self._streams = streams = StreamReader(manifest["streams"], blocks)
        time_entry = manifest["time"]
        self.codes = (
            time_entry["first"] + np.arange(time_entry["count"]) * time_entry["step"]
        )
        self._poses = [
            PosedTake(streams, take, i) for i, take in enumerate(manifest["takes"])
        ]
        # The take that the camera follows; None if none has joints.
        has_joints = bool(self._poses) and self._poses[0].joint_count > 0
        self._main_pose = self._poses[0] if has_joints else None
        geometry_by_streams: dict[tuple[Any, ...], Any] = {}
        self._meshes = [
            MeshRenderer(
                device, streams, mesh, self._pose_of_entry(mesh), geometry_by_streams
            )
            for mesh in manifest["meshes"]
        ]
        self._instances = [
            InstanceRenderer(device, streams, entry, self._meshes[entry["mesh"]])
            for entry in manifest["instances"]
        ]
        self._points = [
            PointRenderer(device, streams, entry) for entry in manifest["points"]
        ]
        self._strands = [
            StrandRenderer(device, streams, entry, self._pose_of_entry(entry))
            for entry in manifest["curves3d"]
        ]
        self.cameras: list[dict[str, Any]] = manifest["cameras"]
        self._bones = BoneRenderer(device)
        self._trails = TrailRenderer(device, self.codes)
        self._frusta = LineRenderer(device)
        self._shadow = ContactShadow(device)
        self._ground = GroundRenderer(device, 1.0)
        self._colors = theme_colors()
        self._is_crowd = len(self._poses) > MAX_SHADOW_CASTERS
        self._sample = -1

    def _pose_of_entry(self, entry: Mapping[str, Any]) -> PosedTake | None:
        """Return the posed take of a manifest entry; None if it has no take."""
        take = entry.get("take")
        return None if take is None else self._poses[take]

    def frame_motion(self, view: CameraView, sample: int) -> None:
        """Frame the bounds of the complete motion; follow a travelling character."""
        self._update(sample)
        for pose in self._poses:
            pose_bounds = Bounds()
            pose_bounds.add(pose.positions)
            radius = pose_bounds.radius
            pose.bounds_radius = radius if radius > 1e-3 else 1.0
        sample_count = len(self.codes)
        spread_samples = [
            int(i / FRAMING_INTERVALS * (sample_count - 1) + 0.5)
            for i in range(FRAMING_INTERVALS + 1)
        ]
        samples = [*dict.fromkeys(spread_samples), sample]
        root_positions = [self._root_position(i) for i in samples]
        offsets = np.array(root_positions) - root_positions[-1]
        travel = float(np.linalg.norm(offsets[:, [0, 2]], axis=1).max())
        min_travel = MIN_PATH_RATIO * float(np.ptp(offsets[:, 1]))
        is_following = (
            self._main_pose is not None
            and not self._is_crowd
            and travel > max(self._main_pose.bounds_radius, min_travel)
        )
        framed_bounds, all_bounds, character_bounds = Bounds(), Bounds(), Bounds()
        for i, root_position in zip(samples, root_positions, strict=True):
            self._update(i)
            shift = (
                (root_positions[-1] - root_position) * [1.0, 0.0, 1.0]
                if is_following
                else 0.0
            )
            framed_bounds = self._grow_bounds(all_bounds, character_bounds, shift)
        view.frame_bounds(framed_bounds)
        view.is_following, view.followed_position = is_following, None
        self._ground = GroundRenderer(self._device, framed_bounds.radius)

    def _root_position(self, sample: int) -> FloatArray:
        """Return the root position of the first take at a sample [m]."""
        if self._main_pose is None:
            return np.zeros(3)
        self._main_pose.update(sample)
        self._sample = -1
        return self._main_pose.root_position

    def _grow_bounds(
        self, framed_bounds: Bounds, character_bounds: Bounds, shift: FloatArray | float
    ) -> Bounds:
        """Grow the bounds of everything and of characters; return those to frame."""
        sample_bounds, sample_character_bounds = Bounds(), Bounds()
        for pose in self._poses:
            if pose.is_visible:
                sample_character_bounds.add(pose.positions)
        for mesh in self._meshes:
            mesh.grow_bounds(
                sample_character_bounds if mesh.is_skinned else sample_bounds
            )
        sample_bounds.union_with(sample_character_bounds)
        drawn_objects: list[InstanceRenderer | PointRenderer | StrandRenderer]
        drawn_objects = [*self._instances, *self._points, *self._strands]
        for drawable in drawn_objects:
            drawable.grow_bounds(sample_bounds)
        character_bounds.union_with(sample_character_bounds, shift)
        framed_bounds.union_with(sample_bounds, shift)
        if (
            not character_bounds.is_empty
            and framed_bounds.radius > MAX_STAGE_RATIO * character_bounds.radius
        ):
            return character_bounds
        return framed_bounds

    def _update(self, sample: int) -> None:
        """Pose takes and deform objects for a sample, unless they already are."""
        if sample == self._sample:
            return
        self._sample = sample
        for pose in self._poses:
            pose.update(sample)
        if "meshes" in self._shown_layers:
            for drawable in self._drawables():
                drawable.update(sample)

    def _drawables(self) -> list[Drawable]:
        """Return the meshes, instances, points and strands to draw."""
        return [*self._meshes, *self._instances, *self._points, *self._strands]

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
        poses = [pose for pose in self._poses if pose.is_visible]
        if self._main_pose is not None:
            view.follow_position(self._main_pose.root_position)
        accent = self._colors["accent"]
        has_several_takes = len(self._poses) > 1
        self._trails.update(
            [] if self._is_crowd else poses,
            sample,
            self._take_color if has_several_takes else lambda _: accent,
            self._colors["contact"],
            self._shown_layers,
        )
        eye = None
        if shot is not None:
            eye = view.view_through(self.cameras[shot], self._streams, sample)
        eye = eye or view.eye_matrices()
        has_shadow = "shadows" in self._shown_layers and self._shadow.cast(
            view,
            lambda eye_from_below: self._draw_shadow_casters(
                eye_from_below, poses, view.radius
            ),
        )

        def draw(target: Any) -> None:
            """Draw all layers into a framebuffer."""
            self._draw_all(eye, view, poses, target, has_shadow=has_shadow, shot=shot)

        return picture.draw(self._colors["view"], draw)

    def _draw_shadow_casters(
        self, eye: EyeMatrices, poses: list[PosedTake], radius: float
    ) -> None:
        """Draw the objects that cast a contact shadow."""
        shadow_casters = [
            drawable
            for drawable in self._drawables()
            if not (
                isinstance(drawable, MeshRenderer)
                and drawable.is_ground_or_room(radius)
            )
        ]
        self._draw_objects(eye, shadow_casters)
        if not self._has_surfaces:
            self._draw_bones(eye, poses, shows_axes=False)

    def _draw_all(
        self,
        eye: EyeMatrices,
        view: CameraView,
        poses: list[PosedTake],
        framebuffer: Any,
        *,
        has_shadow: bool,
        shot: int | None,
    ) -> None:
        """Draw all layers, starting with the ground."""
        far_eye = eye.with_depth_range(0.1, 1.0)
        self._draw_objects(far_eye, self._drawables())
        framebuffer.depth_mask = False
        with self._device.blending():
            if has_shadow:
                self._shadow.draw(far_eye)
            if "grid" in self._shown_layers:
                colors = self._colors["grid"], self._colors["grid-strong"]
                self._ground.draw(far_eye, view.target, *colors)
            self._trails.draw(far_eye)
            if "cameras" in self._shown_layers:
                self._draw_frusta(far_eye, view, shot)
        framebuffer.depth_mask = True
        shows_axes = "axes" in self._shown_layers
        if not self._has_surfaces:
            self._draw_bones(far_eye, poses, shows_axes=shows_axes)
            return
        # Drawn in front of the skin, which would hide them.
        with self._device.blending():
            self._draw_bones(
                eye.with_depth_range(0.0, 0.1, 0.5), poses, shows_axes=shows_axes
            )

    @property
    def _has_surfaces(self) -> bool:
        """Whether any mesh or instance is shown, not just bones."""
        return "meshes" in self._shown_layers and any(
            mesh.pose is not None or mesh.manifest_entry.get("cache") is not None
            for mesh in self._meshes
        )

    def _draw_objects(self, eye: EyeMatrices, drawables: Sequence[Drawable]) -> None:
        """Draw objects except prototypes; nothing if meshes are hidden."""
        for drawable in drawables if "meshes" in self._shown_layers else []:
            if not (isinstance(drawable, MeshRenderer) and drawable.is_prototype):
                drawable.draw(eye)

    def _draw_bones(
        self, eye: EyeMatrices, poses: list[PosedTake], *, shows_axes: bool
    ) -> None:
        """Draw bones and joint axes of posed takes, if their layers are shown."""
        shows_bones = "bones" in self._shown_layers
        self._bones.draw(
            eye, poses, self._take_color, shows_bones=shows_bones, shows_axes=shows_axes
        )

    def _take_color(self, take: int) -> Color:
        """Return the color of a take; that of bones if it is the only one."""
        if len(self._poses) > 1:
            return TAKE_COLORS[take % len(TAKE_COLORS)]
        return self._colors["bone"]

    def _draw_frusta(
        self, eye: EyeMatrices, view: CameraView, shot: int | None
    ) -> None:
        """Draw the frusta of shot cameras except the one looked through."""
        segments: list[FloatArray] = []
        for i, camera in enumerate(self.cameras):
            if i == shot:
                continue
            world_from_camera = shot_camera_matrix(camera, self._streams, self._sample)
            if world_from_camera is None:
                continue
            aperture_width, aperture_height = camera["aperture_mm"]
            frustum_size = view.radius * 0.16
            film_gate = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1], [0, 1.5]])
            film_gate = (
                film_gate * frustum_size * 0.5 * [1, aperture_height / aperture_width]
            )
            corners = np.concatenate(
                [film_gate, np.full((5, 1), -frustum_size)], axis=1
            )
            points = np.vstack(
                [
                    corners @ world_from_camera[:3, :3].T + world_from_camera[:3, 3],
                    world_from_camera[:3, 3],
                ]
            )
            edges = [(5, k) for k in range(4)] + [(k, (k + 1) % 4) for k in range(4)]
            segments.append(points[np.array([*edges, (3, 4), (2, 4)])])
        if segments:
            edge_ends = np.concatenate(segments)
            color = np.array([*self._colors["soft"], 255.0])
            self._frusta.set_segments(edge_ends[:, 0], edge_ends[:, 1], color)
            self._frusta.draw(eye, width=1.5)
