"""Holding a target still over spans of frames, eased in and out."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from animtool._types import FloatArray
from animtool.maths import so3

Span = tuple[float, float]


def smoothstep(share: FloatArray) -> FloatArray:
    """Return an ease from 0 to 1 whose speed and acceleration are 0 at both ends.

    Args:
        share: How far it is; held outside 0 to 1.

    >>> smoothstep(np.array([-1.0, 0.5, 2.0])).tolist()
    [0.0, 0.5, 1.0]
    """
    u = np.clip(share, 0.0, 1.0)
    # Rounding may lead past 1.
    return np.minimum(u * u * u * (u * (6.0 * u - 15.0) + 10.0), 1.0)


def hold_shares(times: FloatArray, spans: Sequence[Span], ease: float) -> FloatArray:
    """Return how much each of H spans holds at times ``(H, F)``, 0 to 1.

    It is 1 inside the span. Where two spans are nearer than both eases, each has half
    of the gap, so that at no time more than one holds.

    Args:
        times: [frame] ``(F,)``.
        spans: First and last frame, ascending, without overlap.
        ease: [frame] before and behind each span; 0 is none.

    >>> hold_shares(np.array([0.0, 2.0, 4.0, 9.0]), [(4.0, 6.0)], 4.0).tolist()
    [[0.0, 0.5, 1.0, 0.103515625]]
    """
    shares = np.zeros((len(spans), len(times)))
    for i, (first, last) in enumerate(spans):
        before = ease if i == 0 else min(ease, (first - spans[i - 1][1]) / 2)
        behind = (
            ease if i + 1 == len(spans) else min(ease, (spans[i + 1][0] - last) / 2)
        )
        inside = (times >= first) & (times <= last)
        shares[i, inside] = 1.0
        for length, way in ((before, first - times), (behind, times - last)):
            near = (way > 0) & (way < length)
            shares[i, near] = smoothstep(1.0 - way[near] / length)
    return shares


def held(values: FloatArray, shares: FloatArray, stills: FloatArray) -> FloatArray:
    """Return a motion with spans held.

    Args:
        values: The free motion ``(F, 3)``, or rotations ``(F, 4)``, which go to the
            held one by the shortest way.
        shares: From `hold_shares` ``(H, F)``.
        stills: What each span holds ``(H, 3)`` or ``(H, 4)``.

    >>> held(np.zeros((2, 3)), np.array([[0.5, 1.0]]), np.ones((1, 3)))[:, 0].tolist()
    [0.5, 1.0]
    """
    out = values.copy()
    for share, still in zip(shares, stills, strict=True):
        part = (share > 0) & (share < 1)
        if values.shape[1] == 4:
            ends = np.broadcast_to(still, out[part].shape)
            out[part] = so3.slerp(out[part], ends, share[part])
        else:
            out[part] += share[part, None] * (still - out[part])
        out[share >= 1] = still
    return so3.align_signs(out) if values.shape[1] == 4 else out
