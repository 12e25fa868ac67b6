"""Bringing the end of a cycle to its beginning, in pose and in speed.

Towards the end two corrections are added, quintics of the time s from 0 to 1:
one that brings the pose there and arrives without speed, and one that brings the
speed and arrives without offset. Both begin with neither, nor acceleration, so
that what comes before the blend stays as it is (the idea of D. Bollo,
Inertialization: high-performance animation transitions in Gears of War, 2018).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeAlias, TypeVar

import numpy as np
import numpy.typing as npt

from animtool._types import FloatArray
from animtool.maths import so3

_Value = TypeVar("_Value", bound=np.generic)
Onward: TypeAlias = Callable[[FloatArray], FloatArray]

# Where a cycle is the whole of its take, its ends tell speeds apart only roughly. A
# change of speed no larger than this share of the largest within is then taken for
# the motion's own: an even cycle stays as it is, whose fastest part takes nine
# frames or more (by Bernstein's inequality).
OWN_CHANGE = 0.25


@dataclass(frozen=True, slots=True)
class SeamBlend:
    """A cycle within some frames, and how much of each correction its frames take.

    Attributes:
        length: Frames of the cycle, L.
        before: Whether there is a frame before the cycle (1) or none (0).
        behind: Whether there is one behind the frame that shows the first pose again.
        pose: How much of the offset at the end [1] ``(L, 1, 1)``.
        speed: How much of the missing speed [frame] ``(L, 1, 1)``.
    """

    length: int
    before: int
    behind: int
    pose: FloatArray
    speed: FloatArray

    @staticmethod
    def over(length: int, frames: int, before: int, behind: int) -> SeamBlend:
        """Return the blend of the last frames of a cycle."""
        span = min(frames, length)
        s = np.clip((np.arange(length) - (length - span)) / max(span, 1), 0, 1)
        pose = s**3 * (10 - 15 * s + 6 * s**2)
        speed = span * s**3 * (-4 + 7 * s - 3 * s**2)
        pose, speed = pose[:, None, None], speed[:, None, None]
        return SeamBlend(length, before, behind, pose, speed)

    def cycle(self, values: npt.NDArray[_Value]) -> npt.NDArray[_Value]:
        """Return the frames of the cycle and the one behind it ``(L + 1, ...)``."""
        return values[self.before : self.before + self.length + 1]

    def ends(self, values: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the frames by which speed is known at the start and at the end.

        They are the frames on either side where both ends have them; else, if the
        cycle is all there is, the three frames that it has at each end.
        """
        around = self.before + self.behind
        if around:
            pair = np.array([0, around])
            return values[pair], values[pair + self.length]
        return values[:3], values[-3:]


def closed_lines(values: FloatArray, blend: SeamBlend, onward: Onward) -> FloatArray:
    """Return a cycle of vectors that runs into what comes after it ``(L, A, K)``.

    Args:
        values: The cycle, the frame behind it, and what the blend says is around.
        blend: Over which frames.
        onward: Takes values of this cycle to those of the next.
    """
    cycle = blend.cycle(values)
    start, end = blend.ends(values)
    missing = _missing_speed(
        np.diff(onward(start), axis=0),
        np.diff(end, axis=0),
        np.diff(cycle, axis=0),
        blend,
    )
    gap = onward(cycle[:1])[0] - cycle[-1]
    return np.asarray(cycle[:-1] + blend.pose * gap + blend.speed * missing)


def closed_turns(values: FloatArray, blend: SeamBlend, onward: Onward) -> FloatArray:
    """Return a cycle of rotations that runs into what comes after it ``(L, A, 4)``."""
    cycle = blend.cycle(values)
    start, end = blend.ends(values)
    gap = so3.multiply(so3.conjugate(cycle[-1]), onward(cycle[:1])[0])
    # Speeds are about the joint's own axes, which the gap turns.
    ending = so3.rotate(so3.conjugate(gap), _turning(end))
    missing = _missing_speed(_turning(onward(start)), ending, _turning(cycle), blend)
    part = so3.slerp(so3.IDENTITY, gap, blend.pose[..., 0])
    turned = so3.multiply(cycle[:-1], part)
    return so3.multiply(turned, so3.exp(blend.speed * missing))


def _turning(values: FloatArray) -> FloatArray:
    """Return the rotation vectors from frame to frame."""
    return so3.log(so3.multiply(so3.conjugate(values[:-1]), values[1:]))


def _missing_speed(
    starting: FloatArray, ending: FloatArray, steps: FloatArray, blend: SeamBlend
) -> FloatArray:
    """Return the speed ``(A, K)`` [a frame] that the end of a cycle lacks.

    Args:
        starting: Steps at the start of the next cycle.
        ending: Steps at the end of this one.
        steps: From frame to frame of the cycle ``(L, A, K)``.
        blend: Which frames the steps are between.
    """
    around = blend.before + blend.behind
    if around:
        return np.asarray((starting[0] - ending[0]) / around)
    if len(steps) < 2:
        return np.zeros(steps.shape[1:])
    mean_rate = (ending[1] - ending[0] + starting[1] - starting[0]) / 2
    missing = starting[0] - ending[1] - mean_rate
    size = np.linalg.norm(missing, axis=-1, keepdims=True)
    changes = np.linalg.norm(np.diff(steps, axis=0), axis=-1).max(axis=0)
    beyond = np.maximum(size - OWN_CHANGE * changes[:, None], 0)
    return np.asarray(missing * (beyond / np.where(size > 0, size, 1)))
