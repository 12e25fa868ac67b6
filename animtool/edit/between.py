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

# A sample this near to its curve, relative to the larger of 1 and its size, is on it:
# rounding of times in the millions is less, and it is a tenth of a curve's tolerance
# [m], [rad], [1].
SAME = 1e-10
# Frames per block of the comparison.
BLOCK_FRAMES = 512
# Times are rounded to these decimals [frame], which restores decimals that users wrote,
# so that a step stays on its side of its key.
TIME_DECIMALS = 11

CURVED = ("translations", "rotations", "scales", "weights", "controls")


@dataclass(frozen=True, slots=True)
class Between:
    """A take that can be sampled at any time.

    A row is a joint, a shape or a control of a channel. If the take has a curve and all
    samples of a row are on it, the row is evaluated between frames. Other rows, which
    have no curve or which a pass changed, are interpolated linearly, rotations along
    the shortest arc at constant speed. On a frame every row is its sample exactly.

    Attributes:
        take: F frames.
        curved: Which rows of each channel are evaluated, by the channel's name; a
            channel without such rows is left out.
    """

    take: Take
    curved: Mapping[str, BoolArray]

    @staticmethod
    def of(take: Take) -> Between:
        """Return a take for sampling between frames; compares samples with its curve.

        >>> from fractions import Fraction
        >>> from animtool.clip.clip import Clip
        >>> from animtool.rig.skeleton import Joint, Rig
        >>> clip = Clip("still", Fraction(24), Fraction(1), Fraction(9), ())
        >>> take = clip.sample(Rig("one", (Joint("a", -1),)))
        >>> Between.of(take).curved["rotations"].tolist()
        [True]
        """
        if take.curve is None:
            return Between(take, {})
        times, curved = take.clock.times, dict[str, BoolArray]()
        for begin in range(0, len(times), BLOCK_FRAMES):
            part = slice(begin, begin + BLOCK_FRAMES)
            evaluated, sampled = take.curve(times[part]), take.motion.select(part)
            for name in CURVED:
                same = _same_rows(getattr(sampled, name), getattr(evaluated, name))
                if same is not None:
                    curved[name] = curved.get(name, same) & same
        return Between(take, {k: rows for k, rows in curved.items() if rows.any()})

    def at(
        self, at: FramePositions, *, smooth: bool = False, shared: bool = False
    ) -> Motion:
        """Return the take at positions between its frames.

        smooth: rows of joints without curves follow splines of class C1; shared: the
        animated rows are those of the take, as blocks of one motion have to share them.
        """
        motion = self.take.motion
        blended = motion.map(at.blend)
        if smooth:
            scales = motion.scales
            blended = replace(
                blended,
                translations=at.curve(motion.translations),
                rotations=at.curve(motion.rotations),
                scales=None if scales is None else at.curve(scales),
            )
        between = at.fractions > 0
        if not self.curved or not between.any():
            return blended
        times = self._times(at)[between]
        return self._evaluated(blended, between, times, shared=shared)

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

    def _evaluated(
        self, blended: Motion, between: BoolArray, times: FloatArray, *, shared: bool
    ) -> Motion:
        """Return a motion with the rows that have curves evaluated between frames."""
        assert self.take.curve is not None
        evaluated = self.take.curve(times)
        changed: dict[str, Channel] = {}
        for name, rows in self.curved.items():
            linear: Channel = getattr(blended, name)
            channel: Channel = getattr(evaluated, name)
            moves = (linear.rest != channel.rest).any(axis=-1)
            moves[channel.animated] = True
            moves &= not shared
            moves[linear.animated] = True
            moving = np.flatnonzero(moves & rows)
            values_of_rows, values = linear.gather(moving), channel.gather(moving)
            if name == "rotations":
                values = so3.align_to(values, values_of_rows[between])
            values_of_rows[between] = values
            changed[name] = linear.put(moving, values_of_rows)
        return replace(
            blended,
            translations=changed.get("translations", blended.translations),
            rotations=changed.get("rotations", blended.rotations),
            scales=changed.get("scales", blended.scales),
            weights=changed.get("weights", blended.weights),
            controls=changed.get("controls", blended.controls),
        )


def _same_rows(a: Channel | None, b: Channel | None) -> BoolArray | None:
    """Return which rows of two channels have equal values in all frames ``(J,)``.

    None if there is nothing to compare.
    """
    if a is None or b is None or a.rest.shape != b.rest.shape:
        return None
    moving = np.union1d(a.animated, b.animated)
    same: BoolArray = _near(a.rest[None], b.rest[None])[0]
    same[moving] = _near(a.gather(moving), b.gather(moving)).all(axis=0)
    return same


def _near(a: FloatArray, b: FloatArray) -> BoolArray:
    """Return which values ``(F, J, K)`` are the same ``(F, J)``."""
    if a.shape[-1] == 4:
        b = so3.align_to(b, a)
    bound = SAME * np.maximum(1.0, np.abs(a).max(axis=-1))
    return np.asarray(np.abs(a - b).max(axis=-1) <= bound)
