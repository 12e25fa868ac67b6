"""Plausibility of captured markers: their rate and the size of what they are on."""

from __future__ import annotations

import numpy as np

from animtool.core.arguments import argument
from animtool.core.errors import Fault, Severity
from animtool.core.quantities import length_text
from animtool.core.rates import rate_warning
from animtool.motion.markers import Markers

# Sizes of captured subjects, from a hand to a group of people [m].
MIN_SUBJECT, MAX_SUBJECT = 0.05, 60.0
# A person with raised arms, at most, and a child [m].
PERSON = (0.5, 3.0)
# Ratios of units: m, cm, mm and in.
FACTORS = (10.0, 100.0, 1000.0, 39.37)
# Frames sampled, and markers that a frame needs.
SAMPLES, MIN_MARKERS = 100, 4


def implausible(markers: Markers) -> list[Fault]:
    """Return warnings about the rate (TAKE009) and the size (MKR117) of a capture."""
    notices = rate_warning(markers.clock.rate, "source.fps")
    size = _size(markers)
    if size is None or MIN_SUBJECT <= size <= MAX_SUBJECT:
        return notices
    message = f"the markers of a frame span {length_text(size)}"
    factors = (*FACTORS, *(1 / factor for factor in FACTORS))
    fitting = [f for f in factors if PERSON[0] <= size * f <= PERSON[1]]
    if fitting:
        factor = fitting[0]
        shown = f"{factor:g} times" if factor > 1 else f"1/{1 / factor:g} of"
        message += f"; {shown} that would be {length_text(size * factor)}"
    hint = f"set the unit of the file with {argument('source.unit')}"
    return [*notices, Fault("MKR117", message, hint=hint, severity=Severity.WARNING)]


def _size(markers: Markers) -> float | None:
    """Return the median diagonal of a frame's markers [m]; None for too few."""
    named = [not name.startswith("*") for name in markers.names]
    rows = np.unique(np.linspace(0, max(len(markers) - 1, 0), SAMPLES).astype(int))
    points = markers.positions[rows][:, named if any(named) else slice(None)]
    sizes = []
    for frame in points:
        known = frame[np.isfinite(frame).all(axis=1)]
        if len(known) >= MIN_MARKERS:
            sizes.append(float(np.linalg.norm(np.ptp(known, axis=0))))
    return float(np.median(sizes)) if sizes else None
