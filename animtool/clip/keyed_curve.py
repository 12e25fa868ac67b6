"""Keyed motion that can be evaluated at arbitrary times, with its source clip."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from animtool.core.array_types import FloatArray
from animtool.core.record import dataclass
from animtool.motion.motion import Channel, Motion
from animtool.motion.take import Take

# Values of a take and of its curve that differ by less are equal [m], [1].
EQUAL_VALUE_TOLERANCE = 1e-9


@dataclass(frozen=True, slots=True, eq=False)
class KeyedCurve:
    """An `animtool.motion.motion.MotionCurve` that evaluates keys."""

    # Returns the motion at times ``(F,)`` [time code].
    sample: Callable[[FloatArray], Motion]
    # Returns the `animtool.clip.clip.Clip` of the keys, at the same time codes; None if
    # there is none.
    get_clip: Callable[[], Any]
    is_foreign: bool = False  # whether the keys are from a file of another format
    native_keys: object = None  # the keys in that format, for its writer
    # Yields the motion at times block by block; None samples all times in one call.
    sample_blocks: Callable[[FloatArray], Iterator[Motion]] | None = None

    def __call__(self, times: FloatArray) -> Motion:
        """Evaluate the keys at times ``(F,)`` [time code]."""
        return self.sample(times)

    def blocks(self, times: FloatArray) -> Iterator[Motion]:
        """Yield the motion at times, in blocks with the same animated joints."""
        if self.sample_blocks is None:
            yield self.sample(times)
        else:
            yield from self.sample_blocks(times)


def clip_of(take: Take) -> Any:
    """Return a take's `animtool.clip.clip.Clip`; None if it no longer matches.

    Samples are compared with the curve, as a pass may have changed them.
    """
    curve = take.curve
    if not isinstance(curve, KeyedCurve) or not matches_curve(take):
        return None
    return curve.get_clip()


def matches_curve(take: Take) -> bool:
    """Return whether a take's samples equal its keyed curve."""
    curve = take.curve
    if not isinstance(curve, KeyedCurve):
        return False
    motion = curve(take.clock.times)
    for name in ("translations", "rotations", "scales", "weights"):
        if not _are_equal(getattr(take.motion, name), getattr(motion, name)):
            return False
    return True


def _are_equal(first: Channel | None, second: Channel | None) -> bool:
    """Return whether two channels differ by no more than rounding."""
    if first is None or second is None:
        return first is second
    if first.rest.shape != second.rest.shape or len(first.values) != len(second.values):
        return False
    a, b = first.dense(), second.dense()
    differences = np.abs(a - b)
    if a.shape[-1] == 4:
        differences = np.minimum(differences, np.abs(a + b))
    tolerance = EQUAL_VALUE_TOLERANCE * max(1.0, float(np.abs(a).max()))
    return float(differences.max(initial=0.0)) <= tolerance
