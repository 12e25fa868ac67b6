"""Places in a take, at or between two frames, and what a take holds there."""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction

import numpy as np

from animtool._types import ArrayLike, FloatArray, IntArray
from animtool.maths import so3
from animtool.motion import Channel

# A place this near to a frame [frame] is meant to be the frame: what rounding
# leaves of a time code in the millions is less.
ON_FRAME = 1e-9


@dataclass(frozen=True, slots=True)
class Places:
    """Where samples lie: at or between two frames.

    Attributes:
        frames: Frame at or before each sample ``(N,)``.
        fractions: How far on to the next, in [0, 1) ``(N,)``.
    """

    frames: IntArray
    fractions: FloatArray

    def blend(self, channel: Channel) -> Channel:
        """Return the channel at the places.

        On a frame it is that frame exactly; between two, rotations (K = 4) go along
        the shortest arc, the rest in a straight line.
        """
        values = channel.values[self.frames]
        between = self.fractions > 0
        weight = self.fractions[between, None]
        if weight.size and values.size:
            low, high = values[between], channel.values[self.frames[between] + 1]
            if values.shape[-1] == 4:
                values[between] = so3.slerp(low, high, weight)
            else:
                values[between] = low + (high - low) * weight[..., None]
        return Channel(channel.rest, channel.animated, values)


def even_places(
    index: IntArray, offset: Fraction | int, ratio: Fraction, count: int
) -> Places:
    """Return the places ``(index + offset) · ratio`` of a take of ``count`` frames.

    They are exact, and held at the ends of the take.

    >>> even_places(np.arange(4), 0, Fraction(1, 2), 9).fractions.tolist()
    [0.0, 0.5, 0.0, 0.5]
    """
    shift = Fraction(offset)
    scale = ratio.denominator * shift.denominator
    step = ratio.numerator * shift.denominator
    ahead = ratio.numerator * shift.numerator
    most = max(abs(int(index[0])), abs(int(index[-1]))) + 1
    if max(scale, abs(step) * most + abs(ahead)) < 2**62:
        exact = index.astype(np.int64) * step + ahead
        frames, left = np.divmod(exact, scale)
        fractions = left / float(scale)
    else:
        pairs = [divmod((int(i) + shift) * ratio, 1) for i in index]
        frames = np.array([min(max(whole, -1), count) for whole, _ in pairs], np.int64)
        fractions = np.array([float(left) for _, left in pairs])
    return _held(frames, fractions, count)


def nearby_places(positions: ArrayLike, count: int) -> Places:
    """Return the places of positions ``(N,)`` [frame], 0 the first.

    What is within 1e-9 of a frame is on it; the ends of the take are held.

    >>> nearby_places([-3.0, 1.25, 1 + 1e-12], 4).frames.tolist()
    [0, 1, 1]
    """
    held = np.clip(np.asarray(positions, np.float64), 0, count - 1)
    nearest = np.round(held)
    held = np.where(np.abs(held - nearest) <= ON_FRAME, nearest, held)
    frames = np.floor(held).astype(np.int64)
    return _held(frames, held - frames, count)


def places_between(codes: FloatArray, at: ArrayLike) -> Places:
    """Return the places of times ``(N,)`` among the times of samples ``(F,)``.

    The ends are held.

    >>> places_between(np.array([1.0, 2.0, 4.0]), [1.0, 3.0, 9.0]).fractions.tolist()
    [0.0, 0.5, 0.0]
    """
    times = np.clip(np.asarray(at, np.float64), codes[0], codes[-1])
    frames = np.searchsorted(codes, times, side="right") - 1
    following = np.minimum(frames + 1, len(codes) - 1)
    spans = np.where(following > frames, codes[following] - codes[frames], 1.0)
    return _held(frames, (times - codes[frames]) / spans, len(codes))


def _held(frames: IntArray, fractions: FloatArray, count: int) -> Places:
    outside = (frames < 0) | (frames >= count - 1)
    return Places(np.clip(frames, 0, count - 1), np.where(outside, 0.0, fractions))
