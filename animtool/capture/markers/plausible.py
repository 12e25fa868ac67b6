"""Warnings about implausible markers: their rate and the size of the subject."""

from __future__ import annotations

import numpy as np

from animtool.core.arguments import argument
from animtool.core.errors import Fault, warning
from animtool.core.quantities import length_text
from animtool.core.rates import rate_warning
from animtool.motion.markers import Markers

# Sizes of captured subjects, from a hand to a group of people [m].
MIN_SUBJECT_SIZE, MAX_SUBJECT_SIZE = 0.05, 60.0
# Size of a child, and of a person with raised arms [m].
PERSON_SIZE = (0.5, 3.0)
# Ratios of units: m, cm, mm and in.
UNIT_FACTORS = (10.0, 100.0, 1000.0, 39.37)
# Frames sampled, and markers that a frame needs.
SAMPLED_FRAME_COUNT, MIN_MARKERS = 100, 4


def plausibility_warnings(markers: Markers) -> list[Fault]:
    """Warn of a frame rate (TAKE009) or a subject size (MKR117) that is implausible."""
    notices = rate_warning(markers.clock.rate, "source.fps")
    is_named = [not name.startswith("*") for name in markers.names]
    frame_indices = np.linspace(
        0, max(len(markers) - 1, 0), SAMPLED_FRAME_COUNT
    ).astype(int)
    points = markers.positions[np.unique(frame_indices)][
        :, is_named if any(is_named) else slice(None)
    ]
    sizes = []
    for frame in points:
        visible_points = frame[np.isfinite(frame).all(axis=1)]
        if len(visible_points) >= MIN_MARKERS:
            sizes.append(float(np.linalg.norm(np.ptp(visible_points, axis=0))))
    # Median diagonal of a frame's markers [m].
    size = float(np.median(sizes)) if sizes else None
    if size is None or MIN_SUBJECT_SIZE <= size <= MAX_SUBJECT_SIZE:
        return notices
    message = f"the markers of a frame span {length_text(size)}"
    unit_factors = (*UNIT_FACTORS, *(1 / factor for factor in UNIT_FACTORS))
    plausible_factors = [
        f for f in unit_factors if PERSON_SIZE[0] <= size * f <= PERSON_SIZE[1]
    ]
    if plausible_factors:
        factor = plausible_factors[0]
        factor_text = f"{factor:g} times" if factor > 1 else f"1/{1 / factor:g} of"
        message += f"; {factor_text} that would be {length_text(size * factor)}"
    hint = f"set the unit of the file with {argument('source.unit')}"
    return [*notices, warning("MKR117", message, hint)]
