"""Plausibility of calibrated cameras: how far apart they are."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from animtool.capture.cameras.camera import Camera
from animtool.core.arguments import argument
from animtool.core.quantities import length_text
from animtool.core.units import LengthUnit
from animtool.documents.document import Document, Location

# Farthest distance of two cameras, from a pair of lenses to a stadium [m].
MIN_SPREAD, MAX_SPREAD = 0.01, 300.0
# That of the cameras of a typical capture [m].
TYPICAL_SPREAD = 6.0


def warn_of_spread(
    document: Document,
    location: Location,
    cameras: Sequence[Camera],
    unit: LengthUnit,
    *,
    stated: bool,
) -> None:
    """Warn of cameras that are too far apart, or too close (CAM113).

    Args:
        document: Camera file.
        location: Where it states the unit, or else the first translation.
        cameras: The cameras.
        unit: The unit that translations are read in.
        stated: Whether the file states it.
    """
    positions = np.array([camera.position for camera in cameras]).reshape(-1, 3)
    offsets = positions[:, None] - positions
    spread = float(np.linalg.norm(offsets, axis=-1).max(initial=0.0))
    if len(cameras) < 2 or spread == 0 or MIN_SPREAD <= spread <= MAX_SPREAD:
        return

    def spread_in(other: LengthUnit) -> float:
        return spread * other.meters / unit.meters

    likely = min(
        LengthUnit, key=lambda other: abs(math.log(spread_in(other) / TYPICAL_SPREAD))
    )
    message = f"the cameras are up to {length_text(spread)} apart"
    hint = f"are the translations in {unit}?"
    if MIN_SPREAD <= spread_in(likely) <= MAX_SPREAD:
        message += f"; in {likely} it would be {length_text(spread_in(likely))}"
        hint = f"write units: {{length: {likely}}} in the file"
        if not stated:
            hint += f", or set {argument('source.unit', likely)}"
    document.warn("CAM113", location, message, hint)
