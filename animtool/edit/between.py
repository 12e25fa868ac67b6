"""Sampling of a take between frames: curves evaluated, samples interpolated."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np

from animtool.core.array_types import BoolArray, FloatArray
from animtool.core.record import dataclass
from animtool.edit.travel import FramePositions, nearby_positions
from animtool.maths import so3
from animtool.motion.motion import Channel, Motion, MotionCurve
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

CURVE_CHANNELS = ("translations", "rotations", "scales", "weights", "controls")


@dataclass(frozen=True, slots=True)
class TakeSampler:
    """A take that can be sampled at any time.

    A row is a joint, a shape or a control of a channel. If the take has a curve and all
    samples of a row are on it, the row is evaluated between frames. Other rows, which
    have no curve or which a pass changed, are interpolated linearly, rotations along
    the shortest arc at constant speed. On a frame every row is its sample exactly.

    Attributes:
        take: A take of F frames.
        curved: Mask of the rows of each channel that are evaluated, by channel name;
            channels without such rows are omitted.
    """

    take: Take
    curved: Mapping[str, BoolArray]

    @staticmethod
    def of(take: Take) -> TakeSampler:
        """Return a take for sampling between frames; compares samples with its curve.

        >>> from fractions import Fraction
        >>> from animtool.clip.clip import Clip
        >>> from animtool.rig.skeleton import Joint, Rig
        >>> clip = Clip("still", Fraction(24), Fraction(1), Fraction(9), ())
        >>> take = clip.sample(Rig("one", (Joint("a", -1),)))
        >>> TakeSampler.of(take).curved["rotations"].tolist()
        [True]
        """
        if take.curve is None:
            return TakeSampler(take, {})
        times, curved = take.clock.times, dict[str, BoolArray]()
        for start in range(0, len(times), BLOCK_FRAMES):
            part = slice(start, start + BLOCK_FRAMES)
            curve_values, samples = take.curve(times[part]), take.motion.select(part)
            for name in CURVE_CHANNELS:
                is_equal = _equal_rows(
                    getattr(samples, name), getattr(curve_values, name)
                )
                if is_equal is not None:
                    curved[name] = curved.get(name, is_equal) & is_equal
        return TakeSampler(take, {k: rows for k, rows in curved.items() if rows.any()})

    def at(
        self, at: FramePositions, *, smooth: bool = False, shared: bool = False
    ) -> Motion:
        """Return the take at positions between its frames.

        smooth: rows of joints without curves follow splines of class C1; shared: all
        results have the same animated rows, as required for blocks of one motion.
        """
        motion = self.take.motion
        interpolated = motion.map(at.interpolate)
        if smooth:
            scales = motion.scales
            interpolated = replace(
                interpolated,
                translations=at.curve(motion.translations),
                rotations=at.curve(motion.rotations),
                scales=None if scales is None else at.curve(scales),
            )
        is_between = at.fractions > 0
        if not self.curved or not is_between.any():
            return interpolated
        times = self._times(at)[is_between]
        return self._evaluate(interpolated, is_between, times, shared=shared)

    def curve(self, shown: Callable[[FloatArray], FloatArray]) -> MotionCurve | None:
        """Return the curve of a take whose time t shows time ``shown(t)`` of this one.

        None if no row has a curve.
        """
        if not self.curved:
            return None
        clock = self.take.clock
        start, step = float(clock.start), float(clock.step)

        def sample(times: FloatArray) -> Motion:
            return self.at(nearby_positions((shown(times) - start) / step, clock.count))

        return sample

    def _times(self, at: FramePositions) -> FloatArray:
        """Return the time codes of positions ``(N,)``."""
        clock = self.take.clock
        frames = at.frames + at.fractions
        times = float(clock.start) + frames * float(clock.step)
        return np.asarray(np.round(times, TIME_DECIMALS))

    def _evaluate(
        self,
        interpolated: Motion,
        is_between: BoolArray,
        times: FloatArray,
        *,
        shared: bool,
    ) -> Motion:
        """Return a motion with the rows that have curves evaluated between frames."""
        assert self.take.curve is not None
        curve_motion = self.take.curve(times)
        new_channels: dict[str, Channel] = {}
        for name, rows in self.curved.items():
            linear: Channel = getattr(interpolated, name)
            channel: Channel = getattr(curve_motion, name)
            moves = (linear.rest != channel.rest).any(axis=-1)
            moves[channel.animated] = True
            moves &= not shared
            moves[linear.animated] = True
            moving = np.flatnonzero(moves & rows)
            values_of_rows, values = linear.gather(moving), channel.gather(moving)
            if name == "rotations":
                values = so3.align_to(values, values_of_rows[is_between])
            values_of_rows[is_between] = values
            new_channels[name] = linear.put(moving, values_of_rows)
        return replace(
            interpolated,
            translations=new_channels.get("translations", interpolated.translations),
            rotations=new_channels.get("rotations", interpolated.rotations),
            scales=new_channels.get("scales", interpolated.scales),
            weights=new_channels.get("weights", interpolated.weights),
            controls=new_channels.get("controls", interpolated.controls),
        )


def _equal_rows(a: Channel | None, b: Channel | None) -> BoolArray | None:
    """Return which rows of two channels have equal values in all frames ``(J,)``.

    None if there is nothing to compare.
    """
    if a is None or b is None or a.rest.shape != b.rest.shape:
        return None
    moving = np.union1d(a.animated, b.animated)
    is_equal: BoolArray = _is_equal(a.rest[None], b.rest[None])[0]
    is_equal[moving] = _is_equal(a.gather(moving), b.gather(moving)).all(axis=0)
    return is_equal


def _is_equal(a: FloatArray, b: FloatArray) -> BoolArray:
    """Return a mask of equal values ``(F, J, K)``: ``(F, J)``."""
    if a.shape[-1] == 4:
        b = so3.align_to(b, a)
    bound = CURVE_TOLERANCE * np.maximum(1.0, np.abs(a).max(axis=-1))
    return np.asarray(np.abs(a - b).max(axis=-1) <= bound)
