"""Detects markers whose left and right names are swapped."""

from __future__ import annotations

import numpy as np

from animtool.capture.solve.model import MarkerProblem
from animtool.capture.solve.sampling import (
    estimate_noise,
    marker_residuals,
    sampled_poses,
)
from animtool.core.array_types import FloatArray
from animtool.core.errors import Fault, listed, warning
from animtool.core.quantities import length_text
from animtool.rig.sides import pair_sides

# Residual of swapped markers, and the fraction of it that is left without the swap.
MIN_RESIDUAL, MAX_FRACTION = 0.02, 0.4


def swapped_side_notices(
    model: MarkerProblem, sample: FloatArray, noise: FloatArray, min_noise: float
) -> list[Fault]:
    """Return a warning if all or several left and right markers are swapped (SOL109).

    The sampled positions are ``(F, E, 3)`` [m]; noise ``(E,)`` and its lower bound in
    metres.
    """
    names = model.template.names
    pairs = pair_sides(names)
    if not pairs.left or float(noise.max()) < MIN_RESIDUAL / 2:
        return []
    exchanged = sample[:, pairs.partners]
    median = float(np.median(noise))
    if median >= MIN_RESIDUAL / 2:
        exchanged_noise = float(np.median(estimate_noise(model, exchanged, min_noise)))
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
        residual = misses[both_markers].min()
        exchanged_residual = exchanged_misses[both_markers].max()
        if residual > MIN_RESIDUAL and exchanged_residual < MAX_FRACTION * residual:
            swapped_pairs.append(both_markers)
    if not swapped_pairs:
        return []
    pairs_text = listed([f"{names[a]} and {names[b]}" for a, b in swapped_pairs], 4)
    first = swapped_pairs[0][0]
    message = (
        f"markers look swapped: {pairs_text}; exchanged, {names[first]} is "
        f"{length_text(float(exchanged_misses[first]))} off its position on the rig, "
        f"not {length_text(float(misses[first]))}"
    )
    return [_warning(message)]


def _medians(misses: FloatArray) -> FloatArray:
    """Return each column's median ``(E,)``, ignoring NaN; infinity if all are NaN."""
    columns = [column[np.isfinite(column)] for column in misses.T]
    return np.array([np.median(c) if len(c) else np.inf for c in columns])


def _warning(message: str) -> Fault:
    """Return a warning about swapped sides with a message (SOL109)."""
    hint = "exchange their names in the capture, or their entries in the template"
    return warning("SOL109", message, hint)
