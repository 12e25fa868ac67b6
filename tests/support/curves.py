"""Curves made for tests."""

from __future__ import annotations

import numpy as np

from animtool.core.array_types import ArrayLike
from animtool.maths.curves import Curves, Extrapolation, SegmentKind


def one_curve(
    times: ArrayLike,
    values: ArrayLike,
    kinds: ArrayLike = SegmentKind.LINEAR,
    in_handles: ArrayLike = (0.0, 0.0),
    out_handles: ArrayLike = (0.0, 0.0),
    pre: Extrapolation = Extrapolation.HOLD,
    post: Extrapolation = Extrapolation.HOLD,
) -> Curves:
    """Return a single curve; kinds and handles may be the same for all keys."""
    times = np.array(times, np.float64)
    count = len(times)
    return Curves(
        first_keys=np.array([0, count]),
        times=times,
        values=np.array(values, np.float64),
        kinds=np.broadcast_to(np.array(kinds, np.int64), count).copy(),
        in_handles=np.broadcast_to(np.array(in_handles, np.float64), (count, 2)).copy(),
        out_handles=np.broadcast_to(
            np.array(out_handles, np.float64), (count, 2)
        ).copy(),
        pre=(pre,),
        post=(post,),
    )


def hermite_curve(
    times: ArrayLike, values: ArrayLike, ins: ArrayLike, outs: ArrayLike
) -> Curves:
    """Return a single CUBIC curve with slopes ``(K,)`` before and behind its keys."""
    times = np.array(times, np.float64)
    thirds = np.diff(times) / 3
    before, behind = np.zeros((len(times), 2)), np.zeros((len(times), 2))
    before[1:, 0], behind[:-1, 0] = -thirds, thirds
    before[:, 1] = before[:, 0] * np.asarray(ins)
    behind[:, 1] = behind[:, 0] * np.asarray(outs)
    return one_curve(times, values, SegmentKind.CUBIC, before, behind)
