"""Bringing the end of a cycle to its beginning, in pose and in speed.

Towards the end two corrections are added, quintics of the time s from 0 to 1:
one that brings the pose there and arrives without speed, and one that brings the
speed and arrives without offset. Both begin with neither, nor acceleration, so
that what comes before the blend stays as it is (the idea of D. Bollo,
Inertialization: high-performance animation transitions in Gears of War, 2018).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from animtool._types import FloatArray
from animtool.maths import so3

__all__ = ["SeamBlend", "closed_lines", "closed_turns"]

# A change of speed at the seam that is no more than this share of the largest
# within the cycle is taken for the motion's own: an even cycle stays as it is,
# whose fastest part takes nine frames or more (by Bernstein's inequality).
OWN_CHANGE = 0.25


@dataclass(frozen=True, slots=True)
class SeamBlend:
    """How much of each correction a frame takes ``(L, 1, 1)``.

    Attributes:
        pose: Of the offset at the end [1].
        speed: Of the missing speed [frame].
    """

    pose: FloatArray
    speed: FloatArray

    @staticmethod
    def over(length: int, frames: int) -> SeamBlend:
        """Return the blend of the last frames of a cycle of ``length``."""
        span = min(frames, length)
        s = np.clip((np.arange(length) - (length - span)) / max(span, 1), 0, 1)
        pose = s**3 * (10 - 15 * s + 6 * s**2)
        speed = span * s**3 * (-4 + 7 * s - 3 * s**2)
        return SeamBlend(pose[:, None, None], speed[:, None, None])


def closed_lines(values: FloatArray, after: FloatArray, blend: SeamBlend) -> FloatArray:
    """Return a cycle of vectors that runs into what comes after it ``(L, A, K)``.

    Args:
        values: The cycle and the frame behind it ``(L + 1, A, K)``.
        after: The first frames of the next cycle, three or all ``(N, A, K)``.
        blend: Over which frames.
    """
    steps = np.diff(values, axis=0)
    missing = _missing_speed(steps, steps[-2:], np.diff(after, axis=0))
    gap = after[0] - values[-1]
    return np.asarray(values[:-1] + blend.pose * gap + blend.speed * missing)


def closed_turns(values: FloatArray, after: FloatArray, blend: SeamBlend) -> FloatArray:
    """Return a cycle of rotations that runs into what comes after it ``(L, A, 4)``."""
    steps = _turning(values)
    gap = so3.multiply(so3.conjugate(values[-1]), after[0])
    # Speeds are about the joint's own axes, which the gap turns.
    ending = so3.rotate(so3.conjugate(gap), steps[-2:])
    missing = _missing_speed(steps, ending, _turning(after))
    part = so3.slerp(so3.IDENTITY, gap, blend.pose[..., 0])
    turned = so3.multiply(values[:-1], part)
    return so3.multiply(turned, so3.exp(blend.speed * missing))


def _turning(values: FloatArray) -> FloatArray:
    """Return the rotation vectors from frame to frame."""
    return so3.log(so3.multiply(so3.conjugate(values[:-1]), values[1:]))


def _missing_speed(
    steps: FloatArray, ending: FloatArray, starting: FloatArray
) -> FloatArray:
    """Return the speed ``(A, K)`` [a frame] that the end of a cycle lacks.

    Args:
        steps: From frame to frame of the cycle ``(L, A, K)``.
        ending: The last two of them, seen from the next cycle.
        starting: The first two of the next cycle.
    """
    if min(len(ending), len(starting)) < 2:
        return np.zeros(steps.shape[1:])
    beside = (ending[1] - ending[0] + starting[1] - starting[0]) / 2
    missing = starting[0] - ending[1] - beside
    size = np.linalg.norm(missing, axis=-1, keepdims=True)
    changes = np.linalg.norm(np.diff(steps, axis=0), axis=-1).max(axis=0)
    beyond = np.maximum(size - OWN_CHANGE * changes[:, None], 0)
    return np.asarray(missing * (beyond / np.where(size > 0, size, 1)))
