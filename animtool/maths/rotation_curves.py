"""Rotation key curves: step, slerp, squad or a C1 spline between keys.

Quaternions are unit ``(x, y, z, w)``; angular velocities are in the body frame,
q' = q·ω/2. The formulas work on the double cover of the rotations, where q and -q
differ: an arc connects signed quaternions, over at most 360 degrees. Sign-aligned keys
give the short arc. Segments are equivariant: multiplying all keys by a rotation from
the left or the right multiplies the curve.
"""

from __future__ import annotations

from enum import IntEnum

import numpy as np

from animtool import _kernels
from animtool.core.array_types import ArrayLike, FloatArray, as_floats
from animtool.maths import so3
from animtool.maths.curves import Extrapolation, fold_times


def align_keys(keys: ArrayLike, count: int | str = "K") -> FloatArray:
    """Return normalised keys with signs that give the short arcs.

    The first keeps its sign. Neighbours exactly 180 degrees apart keep their relative
    signs.

    ``keys``: quaternions of any length but zero ``(K, 4)``, or ``(K, C, 4)`` of C
    curves.

    >>> align_keys([[0, 0, 0, 2], [0, 0, 0, -1]]).tolist()
    [[0.0, 0.0, 0.0, 1.0], [-0.0, -0.0, -0.0, 1.0]]
    """
    is_batched = np.ndim(keys) == 3
    q = as_floats(keys, (count, "C", 4) if is_batched else (count, 4), "keys")
    for fault_text, rows in (
        ("is not finite", ~np.isfinite(q).all(axis=-1)),
        ("is zero, not a rotation", ~q.any(axis=-1)),
    ):
        if rows.any():
            raise ValueError(f"key {int(np.argwhere(rows)[0, 0])} {fault_text}")
    q = so3.normalize(q)
    return so3.align_signs(q, q[0]) if len(q) else q


def log_of_cover(q: ArrayLike) -> FloatArray:
    """Return the rotation vector ``(..., 3)`` [rad] whose `so3.exp` is q, not -q.

    Its length is at most 2π; q = (0, 0, 0, -1), which has no axis, returns 0.

    >>> np.allclose(log_of_cover([0, 0, -1, 0]), [0, 0, -np.pi])
    True
    """
    # q + 1, normalised, is half the rotation.
    return 2.0 * so3.log(so3.normalize(np.asarray(q, np.float64) + so3.IDENTITY))


def rotation_between(a: ArrayLike, b: ArrayLike) -> FloatArray:
    """Return the rotation vector ``(..., 3)`` [rad] in body space from a to b.

    ``b == a·exp(rotation_between(a, b))``, sign included.

    >>> rotation_between([0, 0, 1, 0], [0, 0, 1, 0]).tolist()
    [0.0, 0.0, 0.0]
    """
    return log_of_cover(so3.multiply(so3.conjugate(a), b))


def squad(q: ArrayLike, u: ArrayLike) -> FloatArray:
    """Return the squad curve between the middle two of four evenly timed keys.

    Args:
        q: The keys, sign-aligned here ``(4, 4)``.
        u: From the second key, 0, to the third, 1 ``(U,)`` [1].

    Returns:
        Unit quaternions ``(U, 4)``.

    References:
        K. Shoemake, Quaternion calculus and fast animation, SIGGRAPH course notes,
        1987: s = q·exp(-(log(q⁻¹·next) + log(q⁻¹·previous))/4).

    >>> keys = so3.from_axis_angle([0, 0, 1], [0.0, 0.5, 1.0, 1.5])
    >>> np.allclose(squad(keys, [0.5]), so3.from_axis_angle([0, 0, 1], [0.75]))
    True
    """
    keys = align_keys(q, 4)
    steps = rotation_between(keys[:-1], keys[1:])
    # Segments of length 1: Shoemake's points are those of the central differences.
    velocities = (steps[:-1] + steps[1:]) / 2
    return squad_by_velocities(keys[1:3], velocities, as_floats(u, ("U",), "u"))


def squad_by_velocities(
    ends: ArrayLike, velocities: ArrayLike, u: ArrayLike
) -> FloatArray:
    """Return squad segments with given angular velocities at the ends.

    The derivative at an end is that of the arc between the ends plus twice the rotation
    towards the inner point; each inner point is placed to give the required velocity.
    Segments of different lengths then join smoothly. At even times and with central
    differences these are Shoemake's points.

    ``ends`` ``(2, ..., 4)``, ``velocities`` ``(2, ..., 3)`` [rad], ``u`` ``(...)`` [1].

    >>> ends = so3.from_axis_angle([0, 0, 1], [0.0, 1.0])
    >>> np.allclose(squad_by_velocities(ends, [[0, 0, 1], [0, 0, 1]], 1), ends[1])
    True
    """
    start, end = np.asarray(ends, np.float64)
    out_velocities, in_velocities = np.asarray(velocities, np.float64)
    step = rotation_between(start, end)
    outer = so3.multiply(start, so3.exp((out_velocities - step) / 2))
    inner = so3.multiply(end, so3.exp((step - in_velocities) / 2))
    u = np.asarray(u, np.float64)
    direct_arc = so3.multiply(start, so3.exp(u[..., None] * step))
    inner_arc = _arc(outer, inner, u)
    return so3.normalize(_arc(direct_arc, inner_arc, 2 * u * (1 - u)))


def hermite(ends: ArrayLike, velocities: ArrayLike, u: ArrayLike) -> FloatArray:
    """Return cubic segments from the rotations and angular velocities at their ends.

    The cumulative cubic Bézier form: q₀·exp(β₁ω₁)·exp(β₂ω₂)·exp(β₃ω₃). The order of the
    factors matters: swapping the ends does not quite reverse the curve, unless all
    rotations share an axis.

    Args:
        ends: Unit quaternions at u = 0 and 1 ``(2, ..., 4)``.
        velocities: In the body frames there, times the segment's length
            ``(2, ..., 3)`` [rad].
        u: ``(...)`` [1].

    References:
        M.-J. Kim, M.-S. Kim, S. Y. Shin, A general construction scheme for unit
        quaternion curves with simple high order derivatives, SIGGRAPH 1995, section 4.

    >>> ends = so3.from_axis_angle([0, 0, 1], [0.0, 1.0])
    >>> middle = hermite(ends, [[0, 0, 1], [0, 0, 1]], 0.5)
    >>> np.allclose(middle, so3.from_axis_angle([0, 0, 1], 0.5))
    True
    """
    start, end = np.asarray(ends, np.float64)
    first, last = np.asarray(velocities, np.float64) / 3
    inner_start = so3.multiply(start, so3.exp(first))
    inner_end = so3.multiply(end, so3.exp(-last))
    middle = rotation_between(inner_start, inner_end)
    u = np.asarray(u, np.float64)[..., None]
    weights = (1 - (1 - u) ** 3, u**2 * (3 - 2 * u), u**3)
    return _compose_weighted(start, weights, (first, middle, last))


def cumulative_bspline(q: ArrayLike, u: ArrayLike) -> FloatArray:
    """Return the uniform cubic B-spline segment of four evenly timed keys.

    It is C2 where segments join and stays near the keys, but does not pass through
    them.

    Args:
        q: The keys, sign-aligned here ``(4, 4)``.
        u: Along the segment, 0 near the second key, 1 near the third ``(U,)`` [1].

    Returns:
        Unit quaternions ``(U, 4)``.

    References:
        M.-J. Kim, M.-S. Kim, S. Y. Shin, A general construction scheme for unit
        quaternion curves with simple high order derivatives, SIGGRAPH 1995, section 5.

    >>> keys = so3.from_axis_angle([0, 0, 1], [0.0, 0.5, 1.0, 1.5])
    >>> middle = cumulative_bspline(keys, [0.5])
    >>> np.allclose(middle, so3.from_axis_angle([0, 0, 1], [0.75]))
    True
    """
    keys = align_keys(q, 4)
    u = as_floats(u, ("U",), "u")[:, None]
    weights = (1 - (1 - u) ** 3 / 6, (1 + u * (3 + u * (3 - 2 * u))) / 6, u**3 / 6)
    steps = tuple(rotation_between(keys[:-1], keys[1:]))
    return _compose_weighted(keys[0], weights, steps)


def _arc(a: FloatArray, b: FloatArray, u: FloatArray) -> FloatArray:
    """Interpolate from a to b along the arc of the signed quaternions."""
    return so3.multiply(a, so3.exp(u[..., None] * rotation_between(a, b)))


def _compose_weighted(
    start: FloatArray,
    weights: tuple[FloatArray, ...],
    rotations: tuple[FloatArray, ...],
) -> FloatArray:
    """Return start·exp(w₁ω₁)·exp(w₂ω₂)…, normalized."""
    q = start
    for weight, rotation in zip(weights, rotations, strict=True):
        q = so3.multiply(q, so3.exp(weight * rotation))
    return so3.normalize(q)


class RotationKind(IntEnum):
    """Interpolation of rotations from a key to the next.

    STEP holds the key, SLERP rotates at constant speed along the shortest arc. SQUAD
    and SPLINE are C1 at keys shared with each other or a SLERP.
    """

    STEP = 0
    SLERP = 1
    SQUAD = 2
    SPLINE = 3


def spline(
    times: ArrayLike, keys: ArrayLike, evaluation_times: ArrayLike
) -> FloatArray:
    """Evaluate the C1 spline through rotation keys, constant outside the key times.

    Arguments, errors and limits are those of `evaluate_rotations`.

    >>> keys = so3.from_axis_angle([0, 0, 1], [0.0, 0.5, 2.0])
    >>> np.allclose(spline([0, 1, 4], keys, [3])[0], so3.exp([0, 0, 1.5]))
    True
    """
    return evaluate_rotations(times, keys, RotationKind.SPLINE, evaluation_times)


def evaluate_rotations(
    times: ArrayLike,
    keys: ArrayLike,
    kinds: ArrayLike,
    at: ArrayLike,
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
        at: Times to evaluate, in any order ``(F,)``.
        pre: Extrapolation before the first key.
        post: Extrapolation after the last key.

    Returns:
        Unit quaternions ``(F, 4)`` or ``(F, C, 4)``, of continuous sign in the order
        of ``at``. At its time a key is returned exactly, normalised.

    References:
        M.-J. Kim, M.-S. Kim, S. Y. Shin, A general construction scheme for unit
        quaternion curves with simple high order derivatives, SIGGRAPH 1995.

    >>> keys = [[0, 0, 0, 1], [0, 0, 1, 0]]
    >>> half = evaluate_rotations([0, 2], keys, RotationKind.SLERP, [1.0])
    >>> np.allclose(half, [[0, 0, 0.5**0.5, 0.5**0.5]])
    True
    """
    times = _check_finite(times, ("K",), "times")
    if not len(times):
        raise ValueError("a curve has at least one key")
    if (np.diff(times) <= 0).any():
        key = int((np.diff(times) <= 0).argmax()) + 1
        raise ValueError(f"times must ascend; that of key {key} is {times[key]}")
    is_batched = np.ndim(keys) == 3
    shape = (len(times), "C", 4) if is_batched else (len(times), 4)
    rows = as_floats(keys, shape, "keys")
    kinds = np.asarray(kinds)
    if kinds.shape not in {(), times.shape}:
        raise ValueError(f"kinds must have shape {times.shape}, not {kinds.shape}")
    if not np.isin(kinds, list(RotationKind)).all():
        raise ValueError(f"kinds must be of {[int(kind) for kind in RotationKind]}")
    at = _check_finite(at, ("F",), "at")
    folded_times = fold_times(at, times[0], times[-1], pre, post)
    rotations = _kernels.evaluate_rotations(
        times,
        rows if is_batched else rows[:, None],
        np.broadcast_to(kinds, times.shape).astype(np.int64),
        folded_times.times,
        folded_times.overshoot,
        folded_times.cycles,
    )
    return rotations if is_batched else rotations[:, 0]


def _check_finite(
    values: ArrayLike, shape: tuple[int | str, ...], name: str
) -> FloatArray:
    """Return values as an array; raise unless shaped as given and finite."""
    array = as_floats(values, shape, name)
    if not np.isfinite(array).all():
        raise ValueError(f"{name} must be finite")
    return array
