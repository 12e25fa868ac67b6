"""Draws skeletons: bones as octahedra, joints as balls, and joint axes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from animtool.core.array_types import FloatArray
from animtool.preview.pictures.camera import EyeMatrices
from animtool.preview.pictures.device import Device, TextureTable
from animtool.preview.pictures.lines import LineRenderer, SpriteRenderer, VertexBuffer
from animtool.preview.pictures.pose import PosedTake

# Maximum number of joints drawn with thick bones; crowds have thin lines.
MAX_THICK_JOINTS = 1500
AXIS_COLORS = ((222, 82, 82), (92, 176, 88), (76, 130, 224))
Color = tuple[int, int, int]
# Returns the color of a take by its index.
ColorOfTake = Callable[[int], Color]


class BoneRenderer:
    """Draws the bones and joint axes of posed takes in few draw calls."""

    def __init__(self, device: Device) -> None:
        self._device = device
        self._bone_program = device.program("bones.js")
        self._line_program = device.program("bones.js", "THIN_VERTEX", "THIN_FRAGMENT")
        self._bone_table = TextureTable(device)
        self._balls = SpriteRenderer(device)
        self._axes = LineRenderer(device)
        self._line_buffer = VertexBuffer(device)
        self._line_array: Any = None

    def draw(
        self,
        eye: EyeMatrices,
        poses: Sequence[PosedTake],
        color_of_take: ColorOfTake,
        *,
        shows_bones: bool,
        shows_axes: bool,
    ) -> None:
        """Draw the bones and joint axes of posed takes; crowds as thin lines."""
        poses = [pose for pose in poses if pose.joint_count]
        if not poses:
            return
        if shows_bones and sum(pose.joint_count for pose in poses) > MAX_THICK_JOINTS:
            self._draw_lines(eye, poses, color_of_take)
            return
        if shows_bones:
            self._draw_octahedra(eye, poses, color_of_take)
        if shows_axes:
            self._draw_axes(eye, poses)

    def _draw_octahedra(
        self, eye: EyeMatrices, poses: Sequence[PosedTake], color_of_take: ColorOfTake
    ) -> None:
        """Draw bones as octahedra and joints as balls."""
        max_radius = max(pose.bounds_radius for pose in poses)
        octahedra, balls, ball_colors = [], [], []
        for pose in poses:
            child_indices = np.flatnonzero(pose.parents >= 0)
            tip_joints, tips = pose.tip_ends()
            positions = pose.positions
            heads = np.concatenate(
                [positions[pose.parents[child_indices]], positions[tip_joints]]
            )
            tails = np.concatenate([positions[child_indices], tips])
            has_length = (
                np.linalg.norm(tails - heads, axis=1) > pose.bounds_radius * 1e-4
            )
            bones = np.zeros((int(has_length.sum()), 3, 4))
            bones[:, 0, :3], bones[:, 1, :3] = (heads[has_length], tails[has_length])
            bones[:, 2, :3] = np.array(color_of_take(pose.index)) / 255
            octahedra.append(bones)
            balls.append(positions)
            ball_colors.append(
                np.tile(
                    np.array(color_of_take(pose.index), np.uint8), (len(positions), 1)
                )
            )
        texels = np.concatenate(octahedra)
        if len(texels):
            self._bone_table.upload(texels.reshape(-1, 4))
            max_width = max_radius * 0.03
            self._device.set_uniforms(
                self._bone_program, eye, bones=self._bone_table, thickest=max_width
            )
            self._device.draw_generated(self._bone_program, len(texels) * 24)
        self._balls.set_points(np.concatenate(balls), np.concatenate(ball_colors))
        self._balls.draw(eye, max_radius * 0.008, 2.5)

    def _draw_lines(
        self, eye: EyeMatrices, poses: Sequence[PosedTake], color_of_take: ColorOfTake
    ) -> None:
        """Draw skeletons as thin lines, in one draw call."""
        vertex_blocks = []
        for pose in poses:
            child_indices = np.flatnonzero(pose.parents >= 0)
            end_indices = np.stack(
                [child_indices, pose.parents[child_indices]], axis=1
            ).ravel()
            vertices = np.empty((len(end_indices), 6), "<f4")
            vertices[:, :3] = pose.positions[end_indices]
            vertices[:, 3:] = np.array(color_of_take(pose.index)) / 255
            vertex_blocks.append(vertices)
        all_vertices = np.concatenate(vertex_blocks)
        if self._line_buffer.write(all_vertices):
            buffer_layout = self._line_buffer.buffer, "3f 3f", "point", "color"
            self._line_array = self._device.gl.vertex_array(
                self._line_program, [buffer_layout]
            )
        self._device.set_uniforms(self._line_program, eye)
        self._line_array.render(self._device.moderngl.LINES, vertices=len(all_vertices))

    def _draw_axes(self, eye: EyeMatrices, poses: Sequence[PosedTake]) -> None:
        """Draw the x, y and z axes of each joint in red, green and blue."""
        begins: list[FloatArray] = []
        ends: list[FloatArray] = []
        colors: list[FloatArray] = []
        for pose in poses:
            axes = pose.world_matrices[:, :3, :3]
            lengths = np.linalg.norm(axes, axis=1, keepdims=True)
            axes = (
                axes / np.where(lengths > 0, lengths, 1.0) * pose.bounds_radius * 0.06
            )
            for k in range(3):
                begins.append(pose.positions)
                ends.append(pose.positions + axes[:, :, k])
                colors.append(np.tile([*AXIS_COLORS[k], 255.0], (pose.joint_count, 1)))
        self._axes.set_segments(*map(np.concatenate, (begins, ends, colors)))
        self._axes.draw(eye, width=1.5)
