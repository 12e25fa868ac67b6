"""Markers of the left side that fit the rig on the right, and the reverse."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from animtool.capture.solve.model import MarkerProblem
from animtool.capture.solve.sampling import marker_residuals, sampled_poses
from animtool.core.array_types import FloatArray
from animtool.core.errors import Fault, Severity, listed
from animtool.core.quantities import length_text
from animtool.rig.sides import pair_sides

# Residual of swapped markers, and the fraction of it that is left without the swap.
MIN_RESIDUAL, MAX_FRACTION = 0.02, 0.4

Noise = Callable[[MarkerProblem, FloatArray, float], FloatArray]


def swapped_side_notices(
    model: MarkerProblem,
    sample: FloatArray,
    noise: FloatArray,
    min_noise: float,
    estimate_noise_of: Noise,
) -> list[Fault]:
    """Return a warning if all or several left and right markers are swapped (SOL109).

    Args:
        model: E markers.
        sample: Positions of markers in sampled frames ``(F, E, 3)`` [m].
        noise: Noise of the markers ``(E,)`` [m].
        min_noise: Lower bound of the noise [m].
        estimate_noise_of: Function that returns the noise of other positions.
    """
    names = model.template.names
    pairs = pair_sides(names)
    if not pairs.left or float(noise.max()) < MIN_RESIDUAL / 2:
        return []
    exchanged = sample[:, pairs.partners]
    median = float(np.median(noise))
    if median >= MIN_RESIDUAL / 2:
        exchanged_noise = float(
            np.median(estimate_noise_of(model, exchanged, min_noise))
        )
        if exchanged_noise < MAX_FRACTION * median:
            message = (
                "left and right look swapped: with all their markers exchanged, "
                f"they are {length_text(exchanged_noise)} off their positions "
                f"on the rig, not {length_text(median)}"
            )
            return [_warning(message)]
    coordinates = sampled_poses(model, sample, noise)
    misses, exchanged_misses = (
        _medians(marker_residuals(model, coordinates, positions))
        for positions in (sample, exchanged)
    )
    swapped_pairs = []
    for left in pairs.left:
        both_markers = [left, int(pairs.partners[left])]
        is_far = misses[both_markers].min() > MIN_RESIDUAL
        if (
            is_far
            and exchanged_misses[both_markers].max()
            < MAX_FRACTION * misses[both_markers].min()
        ):
            swapped_pairs.append(both_markers)
    if not swapped_pairs:
        return []
    pairs_text = listed([f"{names[a]} and {names[b]}" for a, b in swapped_pairs], 4)
    both_markers = swapped_pairs[0]
    message = (
        f"markers look swapped: {pairs_text}; exchanged, {names[both_markers[0]]} is "
        f"{length_text(float(exchanged_misses[both_markers[0]]))} off its position "
        "on the rig, not "
        f"{length_text(float(misses[both_markers[0]]))}"
    )
    return [_warning(message)]


def _medians(misses: FloatArray) -> FloatArray:
    """Return each column's median ``(E,)``, ignoring NaN; infinity if all are NaN."""
    columns = [column[np.isfinite(column)] for column in misses.T]
    return np.array([np.median(c) if len(c) else np.inf for c in columns])


def _warning(message: str) -> Fault:
    """Return a warning about swapped sides with a message (SOL109)."""
    hint = "exchange their names in the capture, or their entries in the template"
    return Fault("SOL109", message, hint=hint, severity=Severity.WARNING)
