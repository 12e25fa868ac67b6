"""The motion of a clip at any time, which knows the clip that it is of."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from animtool.core.array_types import FloatArray
from animtool.core.record import dataclass
from animtool.motion.motion import Channel, Motion
from animtool.motion.take import Take

# Values of a take and of its curve that differ by less are the same [m], [1].
SAME = 1e-9


@dataclass(frozen=True, slots=True, eq=False)
class KeyedCurve:
    """A `animtool.motion.motion.MotionCurve` of keys.

    Attributes:
        sample: From times ``(F,)`` [time codes] to the motion there.
        clip: Makes the `animtool.clip.clip.Clip` of the keys, over the same time codes;
            None where no clip holds them.
        foreign: Whether they are of a file that is no clip.
        native: The keys as that file has them, for a writer of its format.
    """

    sample: Callable[[FloatArray], Motion]
    clip: Callable[[], Any]
    foreign: bool = False
    native: object = None

    def __call__(self, times: FloatArray) -> Motion:
        """Return the motion at times."""
        return self.sample(times)


def clip_of(take: Take) -> Any:
    """Return the `animtool.clip.clip.Clip` that a take is still of; None without one.

    A pass may have changed the samples: they are compared with the curve.
    """
    curve = take.curve
    if not isinstance(curve, KeyedCurve) or not is_of_curve(take):
        return None
    return curve.clip()


def is_of_curve(take: Take) -> bool:
    """Return whether a take is what its keyed curve gives at its frames."""
    curve = take.curve
    if not isinstance(curve, KeyedCurve):
        return False
    motion = curve(take.clock.times)
    for name in ("translations", "rotations", "scales", "weights"):
        mine: Channel | None = getattr(take.motion, name)
        channel: Channel | None = getattr(motion, name)
        if (mine is None) != (channel is None):
            return False
        if (
            mine is not None
            and channel is not None
            and not _equal_channels(mine, channel)
        ):
            return False
    return True


def _equal_channels(one: Channel, other: Channel) -> bool:
    if one.rest.shape != other.rest.shape or len(one.values) != len(other.values):
        return False
    a, b = one.dense(), other.dense()
    same = np.abs(a - b)
    if a.shape[-1] == 4:
        same = np.minimum(same, np.abs(a + b))
    return float(same.max(initial=0.0)) <= SAME * max(1.0, float(np.abs(a).max()))
