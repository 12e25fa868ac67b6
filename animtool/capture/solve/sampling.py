"""Sampled frames of a capture: poses, marker noise, and left and right swapped."""

from __future__ import annotations

import math

import numpy as np

from animtool.capture.solve.model import MIN_MARKERS, MarkerProblem, visibility_mask
from animtool.core.array_types import FloatArray, IntArray
from animtool.core.errors import Fault, listed, warning
from animtool.core.quantities import length_text
from animtool.ik.fit import FitOptions, fit
from animtool.rig.sides import pair_sides, reflect_vector

# Median length of a 3D vector whose components have standard deviation 1.
MEDIAN_LENGTH = 1.538
# Residuals beyond this many deviations are downweighted.
ROBUST_DEVIATIONS = 8.0
# A marker visible in fewer frames gets the noise of the others.
MIN_VISIBLE_FRAMES = 5
# Initial noise, maximum rounds of its estimate, and the ratio at which it has
# converged.
INITIAL_NOISE, NOISE_ROUNDS, CONVERGED_RATIO = 0.02, 4, 0.7
# Residual of swapped markers, and the fraction of it that is left without the swap.
MIN_SWAP_RESIDUAL, MAX_SWAP_RATIO = 0.02, 0.4


def fullest_frames(positions: FloatArray, count: int) -> IntArray:
    """Return the frame with the most markers from each of ``count`` equal intervals."""
    marker_counts = visibility_mask(positions).sum(axis=1)
    intervals = np.array_split(np.arange(len(positions)), min(count, len(positions)))
    best_frames = [
        interval[int(np.argmax(marker_counts[interval]))]
        for interval in intervals
        if len(interval)
    ]
    return np.array(
        [frame for frame in best_frames if marker_counts[frame] >= MIN_MARKERS],
        np.int64,
    )


def independent_poses(
    model: MarkerProblem, positions: FloatArray, noise: FloatArray
) -> FloatArray:
    """Fit a pose to each frame on its own by robust least squares ``(F, Q)``."""
    starts = model.start_poses(positions)
    targets = model.targets(positions, noise)
    points, weights = np.asarray(targets.positions), np.asarray(targets.weights)
    options = FitOptions(1.0, math.inf, robust=ROBUST_DEVIATIONS)
    poses = np.zeros_like(starts)
    for f in range(len(positions)):
        frame = slice(f, f + 1)
        target = type(targets)(points[frame], weights=weights[frame])
        poses[f] = fit(model.problem, target, starts[frame], options).coordinates[0]
    return poses


def residual_noise(residuals: FloatArray, min_noise: float) -> FloatArray:
    """Return the standard deviation per axis of each marker ``(E,)`` [m].

    Residuals ``(F, E)`` [m] are NaN where a marker is missing. A marker with tiny ones,
    such as the only marker on its joints, is assumed to be half as noisy as the others.
    """
    is_known = np.isfinite(residuals)
    median_noise = min_noise
    if is_known.any():
        median_noise = float(np.median(residuals[is_known])) / MEDIAN_LENGTH
    noise = np.full(residuals.shape[1], median_noise)
    is_measured = is_known.sum(axis=0) >= MIN_VISIBLE_FRAMES
    noise[is_measured] = np.nanmedian(residuals[:, is_measured], axis=0) / MEDIAN_LENGTH
    return np.asarray(np.maximum(noise, max(min_noise, median_noise / 2)))


def estimate_noise(
    model: MarkerProblem, sample: FloatArray, min_noise: float
) -> FloatArray:
    """Estimate each marker's noise per axis ``(E,)`` [m] from sampled frames.

    The estimate starts from a large value, so that another subject's rig and wrong
    labels can be distinguished.
    """
    noise = np.full(len(model.joints), INITIAL_NOISE)
    for _ in range(NOISE_ROUNDS):
        residuals = marker_residuals(
            model, independent_poses(model, sample, noise), sample
        )
        new_noise = residual_noise(residuals, min_noise)
        has_converged = bool((new_noise > CONVERGED_RATIO * noise).all())
        noise = new_noise
        if has_converged:
            break
    return noise


def marker_residuals(
    model: MarkerProblem, coordinates: FloatArray, positions: FloatArray
) -> FloatArray:
    """Return the residuals of markers in poses ``(F, E)`` [m], NaN where missing."""
    return np.asarray(
        np.linalg.norm(model.points(coordinates) - positions, axis=2), np.float64
    )


def swapped_side_notices(
    model: MarkerProblem, sample: FloatArray, noise: FloatArray, min_noise: float
) -> list[Fault]:
    """Return a warning if left and right marker names look swapped (SOL109).

    The sampled positions are ``(F, E, 3)`` [m]; noise ``(E,)`` and its lower bound in
    metres.
    """
    names = model.template.names
    pairs = pair_sides(names)
    if not pairs.left or float(noise.max()) < MIN_SWAP_RESIDUAL / 2:
        return []
    swapped_sample = sample[:, pairs.partners]
    median_noise = float(np.median(noise))
    if median_noise >= MIN_SWAP_RESIDUAL / 2:
        swapped_noise = float(
            np.median(estimate_noise(model, swapped_sample, min_noise))
        )
        if swapped_noise < MAX_SWAP_RATIO * median_noise:
            message = (
                "left and right look swapped: with all their markers exchanged, "
                f"they are {length_text(swapped_noise)} off their positions "
                f"on the rig, not {length_text(median_noise)}"
            )
            return [_swapped_warning(message)]
    coordinates = independent_poses(model, sample, noise)
    residuals, swapped_residuals = (
        _column_medians(marker_residuals(model, coordinates, positions))
        for positions in (sample, swapped_sample)
    )
    swapped_pairs = []
    for left in pairs.left:
        both_markers = [left, int(pairs.partners[left])]
        residual = residuals[both_markers].min()
        swap_residual = swapped_residuals[both_markers].max()
        if residual > MIN_SWAP_RESIDUAL and swap_residual < MAX_SWAP_RATIO * residual:
            swapped_pairs.append(both_markers)
    if not swapped_pairs:
        return []
    pairs_text = listed([f"{names[a]} and {names[b]}" for a, b in swapped_pairs], 4)
    first = swapped_pairs[0][0]
    message = (
        f"markers look swapped: {pairs_text}; exchanged, {names[first]} is "
        f"{length_text(float(swapped_residuals[first]))} off its position on the "
        f"rig, not {length_text(float(residuals[first]))}"
    )
    return [_swapped_warning(message)]


def mirrored_offsets_notices(
    model: MarkerProblem, sample: FloatArray, noise: FloatArray, min_noise: float
) -> list[Fault]:
    """Return a warning if markers fit offsets with x negated far better (SOL107).

    The sampled positions are ``(F, E, 3)`` [m]; noise ``(E,)`` and its lower bound in
    metres.
    """
    median_noise = float(np.median(noise))
    if median_noise < MIN_SWAP_RESIDUAL / 2:
        return []
    mirrored_model = model.with_bones(model.rig, reflect_vector(model.offsets))
    mirrored_noise = float(np.median(estimate_noise(mirrored_model, sample, min_noise)))
    if mirrored_noise >= MAX_SWAP_RATIO * median_noise:
        return []
    message = f"markers are {length_text(median_noise)} off their positions on the "
    message += f"rig, and {length_text(mirrored_noise)} with x of all offsets negated: "
    message += "the offsets look mirrored"
    return [warning("SOL107", message, "negate x of all offsets in the template")]


def _column_medians(residuals: FloatArray) -> FloatArray:
    """Return each marker's median residual ``(E,)`` [m]; infinite if never visible."""
    columns = [column[np.isfinite(column)] for column in residuals.T]
    return np.array([np.median(c) if len(c) else np.inf for c in columns])


def _swapped_warning(message: str) -> Fault:
    """Return warning SOL109 with a hint to swap the names."""
    hint = "exchange their names in the capture, or their entries in the template; if "
    hint += "one axis was negated or two exchanged, the capture is mirrored: export it "
    hint += "again"
    return warning("SOL109", message, hint)
