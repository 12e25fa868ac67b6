"""Sampling of a take between frames: curves evaluated, samples interpolated."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from animtool.core.array_types import BoolArray, FloatArray
from animtool.core.record import dataclass
from animtool.edit.travel import FramePositions, frame_positions
from animtool.maths import so3
from animtool.motion.motion import CURVE_CHANNELS, Channel, Motion, MotionCurve
from animtool.motion.take import Take

# A sample within this distance of its curve, relative to the larger of 1 and its size,
# is on the curve: more than the rounding of times in the millions, and a tenth of a
# curve's tolerance [m], [rad], [1].
CURVE_TOLERANCE = 1e-10
# Frames per block of the comparison.
BLOCK_FRAMES = 512
# Decimals to which times are rounded [frame]; this restores the decimals that users
# wrote, so that a step stays on its side of its key.
TIME_DECIMALS = 11


@dataclass(frozen=True, slots=True)
class TakeSampler:
    """A take that can be sampled at arbitrary times.

    A row is a joint, a shape or a control of a channel. If the take has a curve and all
    samples of a row are on it, the row is evaluated between frames. Other rows, which
    have no curve or which a pass changed, are interpolated linearly, rotations along
    the shortest arc at constant speed. On a frame every row is its sample exactly.
    """

    take: Take  # a take of F frames
    # Mask of the rows of each channel that are evaluated, by channel name; channels
    # without such rows are omitted.
    rows_on_curve: Mapping[str, BoolArray]

    @staticmethod
    def from_take(take: Take) -> TakeSampler:
        """Return a sampler of a take, whose samples are compared with its curve.

        >>> from fractions import Fraction
        >>> from animtool.clip.clip import Clip
        >>> from animtool.rig.skeleton import Joint, Rig
        >>> clip = Clip("still", Fraction(24), Fraction(1), Fraction(9), ())
        >>> take = clip.sample(Rig("one", (Joint("a", -1),)))
        >>> TakeSampler.from_take(take).rows_on_curve["rotations"].tolist()
        [True]
        """
        if take.curve is None:
            return TakeSampler(take, {})
        times, rows_on_curve = take.clock.times, dict[str, BoolArray]()
        for start in range(0, len(times), BLOCK_FRAMES):
            block_frames = slice(start, start + BLOCK_FRAMES)
            curve_values = take.curve(times[block_frames])
            samples = take.motion.select(block_frames)
            for name in CURVE_CHANNELS:
                channels = (getattr(motion, name) for motion in (samples, curve_values))
                is_equal = _equal_rows(*channels)
                if is_equal is not None:
                    rows_on_curve[name] = rows_on_curve.get(name, is_equal) & is_equal
        used_rows = {name: rows for name, rows in rows_on_curve.items() if rows.any()}
        return TakeSampler(take, used_rows)

    def sample(
        self,
        positions: FramePositions,
        *,
        is_smooth: bool = False,
        has_fixed_rows: bool = False,
    ) -> Motion:
        """Return the take at positions between its frames.

        ``is_smooth``: rows of joints without curves follow splines of class C1;
        ``has_fixed_rows``: all results have the same animated rows, as required for
        blocks of one motion.
        """
        motion = self.take.motion
        interpolated_motion = motion.map(positions.interpolate)
        if is_smooth:
            scales = motion.scales
            interpolated_motion = replace(
                interpolated_motion,
                translations=positions.interpolate_spline(motion.translations),
                rotations=positions.interpolate_spline(motion.rotations),
                scales=None if scales is None else positions.interpolate_spline(scales),
            )
        is_between = positions.fractions > 0
        if not self.rows_on_curve or not is_between.any():
            return interpolated_motion
        times = self._times(positions)[is_between]
        return self._evaluate_rows_on_curve(
            interpolated_motion, is_between, times, has_fixed_rows=has_fixed_rows
        )

    def retimed_curve(
        self, source_times: Callable[[FloatArray], FloatArray]
    ) -> MotionCurve | None:
        """Return the motion curve whose value at t is the take at ``source_times(t)``.

        Return None if no row has a curve.
        """
        if not self.rows_on_curve:
            return None
        clock = self.take.clock
        start, step = float(clock.start), float(clock.step)

        def sample(times: FloatArray) -> Motion:
            """Return the motion of the take at the mapped times."""
            frames = (source_times(times) - start) / step
            return self.sample(frame_positions(frames, clock.count))

        return sample

    def _times(self, positions: FramePositions) -> FloatArray:
        """Return the time codes of positions ``(N,)``."""
        clock = self.take.clock
        frames = positions.frames + positions.fractions
        times = float(clock.start) + frames * float(clock.step)
        return np.asarray(np.round(times, TIME_DECIMALS))

    def _evaluate_rows_on_curve(
        self,
        interpolated_motion: Motion,
        is_between: BoolArray,
        times: FloatArray,
        *,
        has_fixed_rows: bool,
    ) -> Motion:
        """Return a motion with the rows that have curves evaluated between frames."""
        assert self.take.curve is not None
        curve_motion = self.take.curve(times)
        new_channels: dict[str, Any] = {}
        for name, is_on_curve in self.rows_on_curve.items():
            interpolated_channel: Channel = getattr(interpolated_motion, name)
            curve_channel: Channel = getattr(curve_motion, name)
            is_moving = (interpolated_channel.rest != curve_channel.rest).any(axis=-1)
            is_moving[curve_channel.animated] = True
            is_moving &= not has_fixed_rows
            is_moving[interpolated_channel.animated] = True
            moving_rows = np.flatnonzero(is_moving & is_on_curve)
            values_of_rows = interpolated_channel.gather(moving_rows)
            curve_values = curve_channel.gather(moving_rows)
            if name == "rotations":
                curve_values = so3.align_to(curve_values, values_of_rows[is_between])
            values_of_rows[is_between] = curve_values
            new_channels[name] = interpolated_channel.put(moving_rows, values_of_rows)
        return replace(interpolated_motion, **new_channels)


def _equal_rows(a: Channel | None, b: Channel | None) -> BoolArray | None:
    """Return a mask ``(J,)`` of the rows with equal values in all frames.

    Return None if a channel is missing or has other rows.
    """
    if a is None or b is None or a.rest.shape != b.rest.shape:
        return None
    rows = np.union1d(a.animated, b.animated)
    is_equal: BoolArray = _is_equal(a.rest[None], b.rest[None])[0]
    is_equal[rows] = _is_equal(a.gather(rows), b.gather(rows)).all(axis=0)
    return is_equal


def _is_equal(a: FloatArray, b: FloatArray) -> BoolArray:
    """Return a mask ``(F, J)``, true where all K components of two arrays are equal.

    Both arrays are ``(F, J, K)``. With K = 4 they are quaternions, whose sign is
    ignored.
    """
    if a.shape[-1] == 4:
        b = so3.align_to(b, a)
    tolerance = CURVE_TOLERANCE * np.maximum(1.0, np.abs(a).max(axis=-1))
    return np.asarray(np.abs(a - b).max(axis=-1) <= tolerance)
