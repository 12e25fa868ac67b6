"""Rotation key curves: step, slerp, squad or a C1 spline between keys.

Quaternions are unit ``(x, y, z, w)``. Segments are equivariant: multiplying all keys by
a rotation from the left or the right multiplies the curve.
"""

from __future__ import annotations

from enum import IntEnum

import numpy as np

from animtool import _kernels
from animtool.core.array_types import ArrayLike, FloatArray, as_floats
from animtool.maths.curves import Extrapolation, fold_times


class RotationKind(IntEnum):
    """Interpolation of rotations from a key to the next.

    STEP holds the key, SLERP rotates at constant speed along the shortest arc. SQUAD
    and SPLINE are C1 at keys shared with each other or a SLERP.
    """

    STEP = 0
    SLERP = 1
    SQUAD = 2
    SPLINE = 3


def evaluate_rotations(
    times: ArrayLike,
    keys: ArrayLike,
    kinds: ArrayLike,
    sample_times: ArrayLike,
    pre: Extrapolation = Extrapolation.HOLD,
    post: Extrapolation = Extrapolation.HOLD,
) -> FloatArray:
    """Return rotations at times, interpolated from rotation keys.

    SQUAD and SPLINE segments have one angular velocity at each key: that of the
    quadratic through the key and its neighbours, for any spacing of times. Next to a
    SLERP it is the slerp's; at an end, or next to a STEP, that of the slerp on the
    other side. It is limited to a full revolution over the longer of the key's
    segments, which only matters where a short, fast segment joins a long one. A key
    therefore affects only the two segments before and after it, while a C2 interpolant
    would propagate every change to all segments.

    LINEAR extrapolation continues with the curve's velocity at its end, constant in
    body and world frame; after a STEP it holds. CYCLE_OFFSET multiplies each cycle from
    the left by the shortest rotation from the first key to the last: q(t + T) =
    last·first⁻¹·q(t).

    Limits: between neighbours more than 180 degrees apart the curve follows the short
    arc; at exactly 180 degrees, the arc of the keys' signs. Angular acceleration jumps
    at keys; so does velocity between SLERP segments, at a STEP, and where the limit
    above clips the velocity of a SLERP.

    Args:
        times: Times of the keys, strictly ascending ``(K,)``, K ≥ 1.
        keys: Quaternions of any length but zero ``(K, 4)``, or ``(K, C, 4)`` for C
            curves with keys at the same times.
        kinds: `RotationKind` of the segment after each key ``(K,)``, or one for all;
            ignored for the last key.
        sample_times: Times to evaluate, in any order ``(F,)``.
        pre: Extrapolation before the first key.
        post: Extrapolation after the last key.

    Returns:
        Unit quaternions ``(F, 4)`` or ``(F, C, 4)``, of continuous sign in the order
        of ``sample_times``. At its time a key is returned exactly, normalised.

    References:
        M.-J. Kim, M.-S. Kim, S. Y. Shin, A general construction scheme for unit
        quaternion curves with simple high order derivatives, SIGGRAPH 1995, section 4,
        for SPLINE. K. Shoemake, Quaternion calculus and fast animation, SIGGRAPH course
        notes, 1987, for SQUAD.

    >>> keys = [[0, 0, 0, 1], [0, 0, 1, 0]]
    >>> half = evaluate_rotations([0, 2], keys, RotationKind.SLERP, [1.0])
    >>> np.allclose(half, [[0, 0, 0.5**0.5, 0.5**0.5]])
    True
    """
    times = _check_finite(times, ("K",), "times")
    if not len(times):
        raise ValueError("a curve has at least one key")
    if (np.diff(times) <= 0).any():
        key_index = int((np.diff(times) <= 0).argmax()) + 1
        raise ValueError(
            f"times must ascend; that of key {key_index} is {times[key_index]}"
        )
    is_batched = np.ndim(keys) == 3
    shape = (len(times), "C", 4) if is_batched else (len(times), 4)
    key_rotations = as_floats(keys, shape, "keys")
    kinds = np.asarray(kinds)
    if kinds.shape not in {(), times.shape}:
        raise ValueError(f"kinds must have shape {times.shape}, not {kinds.shape}")
    if not np.isin(kinds, list(RotationKind)).all():
        raise ValueError(f"kinds must be of {[int(kind) for kind in RotationKind]}")
    sample_times = _check_finite(sample_times, ("F",), "sample_times")
    folded_times = fold_times(sample_times, times[0], times[-1], pre, post)
    rotations = _kernels.evaluate_rotations(
        times,
        key_rotations if is_batched else key_rotations[:, None],
        np.broadcast_to(kinds, times.shape).astype(np.int64),
        folded_times.times,
        folded_times.overshoot,
        folded_times.cycles,
    )
    return rotations if is_batched else rotations[:, 0]


def _check_finite(
    values: ArrayLike, shape: tuple[int | str, ...], name: str
) -> FloatArray:
    """Return values as an array; raise if the shape differs or one is not finite."""
    array = as_floats(values, shape, name)
    if not np.isfinite(array).all():
        raise ValueError(f"{name} must be finite")
    return array
