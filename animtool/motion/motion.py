"""Motion of a rig over frames; static values are stored once."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import field, replace
from typing import Any, TypeAlias

import numpy as np

from animtool import _kernels
from animtool.core.array_types import FloatArray, IntArray
from animtool.core.errors import refuse
from animtool.core.old_names import rename_attributes
from animtool.core.record import dataclass
from animtool.rig.kinematics import WorldTransforms
from animtool.rig.skeleton import Rig


@dataclass(frozen=True, slots=True)
class Channel:
    """One kind of value for every joint; static values are stored once.

    Attributes:
        rest: Value of each static joint ``(J, K)``.
        animated: Indices of the joints that move ``(A,)``, ascending.
        values: Values of the animated joints ``(F, A, K)``.
    """

    rest: FloatArray
    animated: IntArray
    values: FloatArray

    def __repr__(self) -> str:
        """Return the numbers of frames, moving joints and components.

        >>> Channel.from_dense(np.zeros((5, 2, 3)))
        <Channel: 5 frames, 0 of 2 move, 3 components>
        """
        frames, _, component_count = self.values.shape
        moving_text = f"{len(self.animated)} of {len(self.rest)} move"
        return (
            f"<Channel: {frames} frames, {moving_text}, {component_count} components>"
        )

    def dense(self) -> FloatArray:
        """Return the value of every joint in every frame ``(F, J, K)``.

        >>> Channel.from_dense(np.ones((2, 1, 3))).dense().tolist()
        [[[1.0, 1.0, 1.0]], [[1.0, 1.0, 1.0]]]
        """
        values = np.repeat(self.rest[None], len(self.values), axis=0)
        values[:, self.animated] = self.values
        return values

    def gather(self, joints: IntArray) -> FloatArray:
        """Return the values of selected joints ``(F, len(joints), K)``."""
        values = np.repeat(self.rest[joints][None], len(self.values), axis=0)
        columns = np.full(len(self.rest), -1)
        columns[self.animated] = np.arange(len(self.animated))
        is_moving = columns[joints] >= 0
        if is_moving.any():
            values[:, is_moving] = self.values[:, columns[joints[is_moving]]]
        return values

    def reorder(self, indices: IntArray, rest_values: FloatArray) -> Channel:
        """Return the channel with its joints reordered; -1 takes the rest value."""
        is_mapped = indices >= 0
        rest = np.array(rest_values, np.float64)
        rest[is_mapped] = self.rest[indices[is_mapped]]
        column_by_joint = np.full(len(self.rest), -1)
        column_by_joint[self.animated] = np.arange(len(self.animated))
        columns = np.full(len(indices), -1)
        columns[is_mapped] = column_by_joint[indices[is_mapped]]
        animated_joints = np.flatnonzero(columns >= 0)
        return Channel(rest, animated_joints, self.values[:, columns[animated_joints]])

    def put(self, joints: IntArray, values: FloatArray) -> Channel:
        """Return the channel with the values of selected joints replaced.

        Args:
            joints: Indices of the joints, ascending ``(A,)``.
            values: New values ``(F, A, K)``.
        """
        is_animated = np.zeros(len(self.rest), np.bool_)
        is_animated[self.animated] = is_animated[joints] = True
        animated_joints = np.flatnonzero(is_animated)
        merged_values = self.gather(animated_joints)
        merged_values[:, np.searchsorted(animated_joints, joints)] = values
        return Channel(self.rest, animated_joints, merged_values)

    def compact(self) -> Channel:
        """Return the channel; animated joints that never move become static."""
        if not len(self.values):
            return self
        is_animated = (self.values[-1] != self.values[0]).any(axis=-1)
        unsure_columns = np.flatnonzero(~is_animated)
        if len(unsure_columns):
            candidates = self.values[:, unsure_columns]
            is_animated[unsure_columns] = (candidates != candidates[:1]).any((0, 2))
        if is_animated.all():
            return self
        rest_values = self.rest.copy()
        rest_values[self.animated[~is_animated]] = self.values[0, ~is_animated]
        values = self.values[:, is_animated]
        return Channel(rest_values, self.animated[is_animated], values)

    def select(self, frames: slice | IntArray) -> Channel:
        """Return the channel at selected frames."""
        return replace(self, values=self.values[frames])

    @staticmethod
    def static(rest: FloatArray, frames: int = 1) -> Channel:
        """Return a channel of static joints at ``rest`` ``(J, K)``.

        >>> Channel.static(np.zeros((2, 3)), 5).dense().shape
        (5, 2, 3)
        """
        values = np.zeros((frames, 0, rest.shape[1]))
        return Channel(rest, np.zeros(0, np.int64), values)

    @staticmethod
    def from_dense(values: FloatArray) -> Channel:
        """Return a channel of values ``(F, J, K)``, with static joints stored once.

        Raises:
            OptionError: The values have another shape, or no frame (TAKE001).

        >>> Channel.from_dense(np.arange(12.0).reshape(2, 2, 3)).animated.tolist()
        [0, 1]
        """
        values = np.asarray(values)
        if values.ndim != 3 or not len(values):
            refuse("TAKE001", f"values must have shape (F, J, K), not {values.shape}")
        return Channel(values[0].copy(), np.arange(values.shape[1]), values).compact()

    @staticmethod
    def concatenate(channels: list[Channel]) -> Channel:
        """Concatenate blocks with equal rest values and animated joints in time."""
        if len(channels) == 1:
            return channels[0]
        values = np.concatenate([channel.values for channel in channels])
        return replace(channels[0], values=values)


rename_attributes(Channel, still="static")


def _kernel_arrays(channel: Channel) -> tuple[FloatArray, IntArray, FloatArray]:
    """Return the arguments that pass a channel to a kernel: rest, animated, values."""
    rest, values = (np.ascontiguousarray(a) for a in (channel.rest, channel.values))
    return rest, np.asarray(channel.animated, np.int64), values


# Names of the channels of a motion that a curve may provide.
CURVE_CHANNELS = ("translations", "rotations", "scales", "weights", "controls")
# Names of all channels of a motion.
CHANNELS = (*CURVE_CHANNELS, "track_times")


@dataclass(frozen=True, slots=True)
class Motion:
    """Motion of a rig over frames: joints, shapes and controls.

    Attributes:
        translations: In parent space, replacing those at rest [m], K = 3.
        rotations: Unit quaternions (x, y, z, w), signs continuous along time, K = 4.
        scales: Local scales [1], K = 3; None if nothing is scaled.
        weights: Weights of the rig's shapes, in its order [1], K = 1; None if the take
            has none.
        controls: Values of the rig's controls, in its order, K = 1; None if the take
            has none. Joints and shapes already have the values that controls drive.
        track_times: Local time of each of the take's tracks, K = 1; None if the take
            has no tracks.
        points: World points of simulated meshes and strands, which no longer follow
            joints, by name [m], K = 3.
    """

    translations: Channel
    rotations: Channel
    scales: Channel | None = None
    weights: Channel | None = None
    controls: Channel | None = None
    track_times: Channel | None = None
    points: Mapping[str, Channel] = field(default_factory=dict)

    @property
    def frames(self) -> int:
        """Number of frames."""
        return len(self.rotations.values)

    def __repr__(self) -> str:
        """Return the numbers of frames, joints, weights and controls."""
        count_texts = [f"{self.frames} frames", f"{len(self.rotations.rest)} joints"]
        for name in ("weights", "controls"):
            channel: Channel | None = getattr(self, name)
            if channel is not None:
                count_texts.append(f"{len(channel.rest)} {name}")
        return f"<Motion: {', '.join(count_texts)}>"

    def dense(self) -> tuple[FloatArray, FloatArray, FloatArray | None]:
        """Return translations, rotations and scales of every joint in every frame."""
        scales = None if self.scales is None else self.scales.dense()
        return self.translations.dense(), self.rotations.dense(), scales

    def world(self, rig: Rig) -> WorldTransforms:
        """Return the world transforms of every joint in every frame."""
        shape = (self.frames, len(rig.joints), 3)
        world = WorldTransforms(np.zeros(shape), np.zeros((*shape, 3)))
        _kernels.forward_motion(
            rig.parents,
            *_kernel_arrays(self.translations),
            *_kernel_arrays(self.rotations),
            None if self.scales is None else _kernel_arrays(self.scales),
            world.positions,
            world.linear,
        )
        return world

    def select(self, frames: slice | IntArray) -> Motion:
        """Return the motion at selected frames."""
        return self.map(lambda channel: channel.select(frames))

    def map(self, function: Callable[[Channel], Channel]) -> Motion:
        """Apply a function to each channel of the motion that is not None."""
        channel_by_field: dict[str, Any] = {
            name: function(channel)
            for name in CHANNELS
            if (channel := getattr(self, name)) is not None
        }
        points_by_name = {
            name: function(channel) for name, channel in self.points.items()
        }
        return Motion(**channel_by_field, points=points_by_name)

    @staticmethod
    def concatenate(blocks: list[Motion]) -> Motion:
        """Concatenate consecutive blocks to one motion."""
        channel_by_field: dict[str, Any] = {
            name: Channel.concatenate([getattr(block, name) for block in blocks])
            for name in CHANNELS
            if getattr(blocks[0], name) is not None
        }
        points_by_name = {
            name: Channel.concatenate([block.points[name] for block in blocks])
            for name in blocks[0].points
        }
        return Motion(**channel_by_field, points=points_by_name)


# Returns a take's motion at times ``(F,)`` [time codes], in any order.
MotionCurve: TypeAlias = Callable[[FloatArray], Motion]

# Time codes ``(F,)`` and motion of consecutive blocks.
TimedBlocks: TypeAlias = Iterator[tuple[FloatArray, Motion]]


def split_blocks(blocks: TimedBlocks, max_frames: int) -> TimedBlocks:
    """Yield blocks of at most a number of frames."""
    for codes, motion in blocks:
        for first in range(0, len(codes), max_frames):
            frames = slice(first, first + max_frames)
            yield codes[frames], motion.select(frames)
