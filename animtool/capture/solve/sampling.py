"""Independent frames of a capture: fitted poses and marker residuals."""

from __future__ import annotations

import math

import numpy as np

from animtool.capture.solve.model import MIN_MARKERS, MarkerProblem, visible_markers
from animtool.core.array_types import FloatArray, IntArray
from animtool.ik.fit import FitOptions, fit

# Median length of a 3D vector whose components have standard deviation 1.
MEDIAN_LENGTH = 1.538
# Residuals beyond this many deviations are downweighted.
ROBUST_DEVIATIONS = 8.0
# A marker visible in fewer frames gets the noise of the others.
MIN_VISIBLE_FRAMES = 5
# Initial noise, maximum rounds of its estimate, and the ratio at which it has
# converged.
INITIAL_NOISE, NOISE_ROUNDS, CONVERGED_RATIO = 0.02, 4, 0.7


def sampled_frames(positions: FloatArray, count: int) -> IntArray:
    """Return the frame with the most markers from each of ``count`` equal intervals."""
    counts = visible_markers(positions).sum(axis=1)
    chunks = np.array_split(np.arange(len(positions)), min(count, len(positions)))
    best_frames = [
        chunk[int(np.argmax(counts[chunk]))] for chunk in chunks if len(chunk)
    ]
    return np.array([f for f in best_frames if counts[f] >= MIN_MARKERS], np.int64)


def sampled_poses(
    model: MarkerProblem, positions: FloatArray, noise: FloatArray
) -> FloatArray:
    """Solve each frame independently by robust least squares; return ``(F, Q)``."""
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


def typical_noise(misses: FloatArray, min_noise: float) -> FloatArray:
    """Return the standard deviation per axis of each marker ``(E,)`` [m].

    Residuals ``(F, E)`` [m] are NaN where a marker is missing. A marker with tiny ones,
    such as the only marker on its joints, is assumed to be half as noisy as the others.
    """
    is_known = np.isfinite(misses)
    median = min_noise
    if is_known.any():
        median = float(np.median(misses[is_known])) / MEDIAN_LENGTH
    noise = np.full(misses.shape[1], median)
    has_enough = is_known.sum(axis=0) >= MIN_VISIBLE_FRAMES
    noise[has_enough] = np.nanmedian(misses[:, has_enough], axis=0) / MEDIAN_LENGTH
    return np.asarray(np.maximum(noise, max(min_noise, median / 2)))


def estimate_noise(
    model: MarkerProblem, sample: FloatArray, min_noise: float
) -> FloatArray:
    """Return the noise of markers ``(F, E, 3)``, per axis ``(E,)`` [m].

    The estimate starts from a large value, so that another subject's rig and wrong
    labels can be distinguished.
    """
    noise = np.full(len(model.joints), INITIAL_NOISE)
    for _ in range(NOISE_ROUNDS):
        misses = marker_residuals(model, sampled_poses(model, sample, noise), sample)
        estimate = typical_noise(misses, min_noise)
        has_converged = bool((estimate > CONVERGED_RATIO * noise).all())
        noise = estimate
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
