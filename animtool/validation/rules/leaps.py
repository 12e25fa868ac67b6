"""What is far more in one frame than before and behind it."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from animtool._types import BoolArray, FloatArray
from animtool.rig.kinematics import rest_size
from animtool.take import Take
from animtool.validation.subjects.steps import Steps

__all__ = ["Leap", "leaps"]

# Less is seen as motion [rad]; of the rig's size [1].
LEAST_TURN, LEAST_SHIFT = math.radians(40.0), 0.2
# A leap is as much more than what is done before and behind it.
STANDS_OUT = 8.0


@dataclass(frozen=True, slots=True)
class Leap:
    """A joint that leaps from one frame to the next.

    Attributes:
        joint: Which.
        frame: Index of the frame before the first leap.
        angle: How far it turns [rad]; 0 where it is moved.
        length: How far it is moved [m]; 0 where it turns.
        count: How often it does so.
    """

    joint: int
    frame: int
    angle: float
    length: float
    count: int

    @property
    def much(self) -> str:
        """How far, with its unit."""
        if self.angle:
            return f"{math.degrees(self.angle):.0f}\N{DEGREE SIGN}"
        return f"{self.length:.3g} m"

    def message(self, take: Take) -> str:
        """Return what is to be said of it in a take."""
        times = take.clock.times
        more = f", and {self.count - 1} times more" if self.count > 1 else ""
        return (
            f"{take.rig.joints[self.joint].name!r} jumps by {self.much} from frame "
            f"{times[self.frame]:g} to {times[self.frame + 1]:g}{more}"
        )


def leaps(steps: Steps, meant: BoolArray | None = None) -> Iterator[Leap]:
    """Yield joints that leap in one frame, each once.

    Args:
        steps: Of a take of F frames.
        meant: Frames from which to the next a leap is meant ``(F - 1,)``.
    """
    take = steps.take
    if take.motion.frames < 3:
        return
    size = max(rest_size(take.rig), 1e-6)
    for amounts, least, turn in (
        (steps.turns, LEAST_TURN, 1.0),
        (steps.shifts, LEAST_SHIFT * size, 0.0),
    ):
        apart = _apart(amounts, least)
        if meant is not None:
            apart &= ~meant[:, None]
        for j in np.flatnonzero(apart.any(axis=0)).tolist():
            frame = int(apart[:, j].argmax())
            much = float(amounts[frame, j])
            count = int(apart[:, j].sum())
            yield Leap(j, frame, turn * much, (1.0 - turn) * much, count)


def _apart(amounts: FloatArray, least: float) -> BoolArray:
    """Return where amounts ``(F, J)`` are far more than those beside them.

    Of a leap there and back in the next frame, the one there.
    """
    rows = np.pad(amounts, ((1, 2), (0, 0)))
    before, now, behind, after = rows[:-3], rows[1:-2], rows[2:-1], rows[3:]
    once = now > STANDS_OUT * np.maximum(before, behind)
    twice = np.minimum(now, behind) > STANDS_OUT * np.maximum(before, after)
    return np.asarray((now > least) & (once | (twice & (behind > least))))
