"""Warnings about implausible markers: their rate and the size of the subject."""

from __future__ import annotations

from animtool.core.arguments import argument
from animtool.core.errors import Fault, warning
from animtool.core.quantities import length_text
from animtool.core.rates import rate_warning
from animtool.motion.marker_size import (
    is_plausible_size,
    rescaled_text,
    subject_size,
)
from animtool.motion.markers import Markers

# Warnings of readers about the unit of a file.
UNIT_CODES = frozenset({"MKR117", "MKR118"})


def plausibility_warnings(markers: Markers) -> list[Fault]:
    """Warn of a frame rate (TAKE009) or a subject size (MKR117) that is implausible."""
    notices = rate_warning(markers.clock.rate, "source.fps")
    if any(notice.code in UNIT_CODES for notice in markers.notices):
        return notices
    is_named = [not name.startswith("*") for name in markers.names]
    named_points = is_named if any(is_named) else slice(None)
    size = subject_size(markers.positions[:, named_points])
    if size is None or is_plausible_size(size):
        return notices
    message = f"the markers of a frame span {length_text(size)}{rescaled_text(size)}"
    hint = f"set the unit of the file with {argument('source.unit')}"
    return [*notices, warning("MKR117", message, hint)]
