"""Fits sparse cubic keys to dense samples, within a tolerance at every sample."""

from __future__ import annotations

import numpy as np

from animtool import _kernels
from animtool.core.array_types import (
    ArrayLike,
    FloatArray,
    IntArray,
    as_floats,
)
from animtool.core.record import dataclass
from animtool.maths.curves import cubic_curves, evaluate


@dataclass(frozen=True, slots=True)
class FittedKeys:
    """K keys shared by D components, with cubic segments between them.

    The handles of a segment are at thirds of its time, so that time is linear in the
    curve's parameter: the Bézier curve is also a cubic over time.
    """

    frames: IntArray  # frames of the keys, ascending ``(K,)`` [frame]
    values: FloatArray  # samples at the keys ``(K, D)``
    # Handle before each key, as offset in value ``(K, D)``; 0 at the first.
    in_handles: FloatArray
    # Handle after each key, as offset in value ``(K, D)``; 0 at the last.
    out_handles: FloatArray


def fit_keys(
    values: ArrayLike,
    tolerance: ArrayLike,
    *,
    tolerance_scale: ArrayLike | None = None,
    anchors: ArrayLike = (),
    bounds: tuple[ArrayLike, ArrayLike] | None = None,
    straight_frames: ArrayLike = (),
) -> FittedKeys:
    """Fit sparse keys whose cubic segments stay within a tolerance of the samples.

    From each key, galloping and bisection find the longest segment that fits, in
    O(F log F) altogether. A segment begins and ends on samples; its two inner control
    values come from least squares, reweighted to minimise the largest error where the
    fit nearly succeeds. Then the two slopes at each key are merged where the tolerance
    allows.

    Limits: the search is greedy, so slightly fewer keys may be possible. The tolerance
    holds at the samples. A segment passes exactly through any two inner samples, so
    pure noise needs a key at every third sample, and between samples the curve may
    overshoot, but not beyond ``bounds``. A tolerance below 1e-13 of the values
    is less than their rounding.

    Args:
        values: Evenly spaced samples ``(F, D)``, F > 0, D > 0.
        tolerance: Largest error > 0, in the unit of the values: a number, for the
            Euclidean norm over D; or one for each component ``(D,)``, for the norm of
            the errors over their tolerances.
        tolerance_scale: Factor of the tolerance at each frame ``(F,)``, > 0; None is 1.
        anchors: Inner frames that always become keys, ascending [frame]. The keys
            between two anchors, except for slopes, do not depend on other frames.
        bounds: Lower and upper bound of each component ``(D,)``, which curves
            respect between samples within it; infinite or None for no bound.
        straight_frames: Frames whose segment to the next frame is straight [frame].

    Returns:
        The keys; a single one if all samples are within the tolerance of the first.

    References:
        C. L. Lawson, Contributions to the theory of linear least maximum
        approximation, 1961, for the weights.

    >>> t = np.arange(101.0)[:, None]
    >>> keys = fit_keys((t / 50 - 1) ** 3, 1e-6)
    >>> keys.frames.tolist(), keys.out_handles.round(6).tolist()
    ([0, 100], [[2.0], [0.0]])
    """
    samples = _check_samples(values)
    tolerance, scales = _check_tolerances(samples, tolerance, tolerance_scale)
    bound_pair = bounds or (-np.inf, np.inf)
    low, high = (
        np.ascontiguousarray(np.broadcast_to(bound, samples.shape[1:]) / tolerance)
        for bound in bound_pair
    )
    key_frames, in_handles, out_handles = _kernels.fit_cubics(
        samples / tolerance,
        scales,
        np.ascontiguousarray(anchors, np.int64),
        low,
        high,
        np.ascontiguousarray(straight_frames, np.int64),
    )
    in_handles, out_handles = in_handles * tolerance, out_handles * tolerance
    return FittedKeys(key_frames, samples[key_frames], in_handles, out_handles)


def _check_samples(values: ArrayLike) -> FloatArray:
    """Return samples as an array ``(F, D)``; raise if they are not finite."""
    samples = as_floats(values, ("F", "D"), "values")
    if not samples.size:
        raise ValueError("values must hold a sample")
    if not np.isfinite(samples).all():
        frame = int(np.argmin(np.isfinite(samples).all(axis=1)))
        raise ValueError(f"values are not finite at frame {frame}")
    return samples


def _check_tolerances(
    samples: FloatArray, tolerance: ArrayLike, scale: ArrayLike | None
) -> tuple[FloatArray, FloatArray]:
    """Return the checked tolerance, scalar or ``(D,)``, and its factor ``(F,)``."""
    tolerance, frame_count = np.asarray(tolerance, np.float64), len(samples)
    if tolerance.shape not in ((), samples.shape[1:]):
        shapes = f"{samples.shape[1:]}, not {tolerance.shape}"
        raise ValueError(f"tolerance must be a number or have shape {shapes}")
    scales = np.ones(frame_count)
    if scale is not None:
        scales = as_floats(scale, (frame_count,), "tolerance_scale")
    for name, array in (("tolerance", tolerance), ("tolerance_scale", scales)):
        if not ((array > 0) & np.isfinite(array)).all():
            raise ValueError(f"{name} must be above 0 and finite")
    return tolerance, scales


def evaluate_keys(keys: FittedKeys, frames: ArrayLike) -> FloatArray:
    """Return the values ``(F, D)`` of fitted keys at frames ``(F,)``.

    Before the first key and after the last, their values are held.

    >>> keys = fit_keys([[0.0], [1.0], [4.0], [9.0]], 0.01)
    >>> evaluate_keys(keys, [1.5]).round(9).tolist()
    [[2.25]]
    """
    times = keys.frames.astype(np.float64)
    curves = cubic_curves(times, keys.values, keys.in_handles, keys.out_handles)
    return np.ascontiguousarray(evaluate(curves, frames).T)
