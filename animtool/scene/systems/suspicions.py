"""Warnings about cloth and springs whose numbers look like another unit."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from animtool.core.quantities import length_text
from animtool.documents.document import Document, Location

# Greater thickness of cloth is implausible [m].
MAX_THICKNESS = 0.5
# Only rubber stretches to twice its length [1].
MAX_STRETCH = 1.0


def warn_of_sizes(document: Document, at: Location, values: Mapping[str, Any]) -> None:
    """Warn of a thickness in millimetres and a stretch in percent (SIM200)."""
    contact = values.get("self_contact")
    if isinstance(contact, Mapping):
        _warn_of_length(document, (*at, "self_contact"), "thickness", contact)
    _warn_of_length(document, at, "thickness", values)
    _warn_of_length(document, at, "radius", values)
    stretch = values.get("stretch")
    if isinstance(stretch, int | float) and stretch >= MAX_STRETCH:
        message = f"stretch {stretch:g} allows springs {1 + stretch:g} times as long"
        hint = f"for {stretch:g}% write {stretch / 100:g}"
        document.warn("SIM200", (*at, "stretch"), message, hint)


def _warn_of_length(
    document: Document, at: Location, key: str, values: Mapping[str, Any]
) -> None:
    for length in _metres(values.get(key)):
        message = f"{key} {length:g} makes the surface {length_text(2 * length)} thick"
        if key == "thickness":
            message = f"thickness {length:g} is {length_text(length)}, in metres"
        hint = f"for {length:g} mm write {length / 1000:g}"
        document.warn("SIM200", (*at, key), message, hint)


def _metres(value: object) -> Iterator[float]:
    """Yield a length without a unit, if it is implausible [m]."""
    if isinstance(value, int | float) and value >= MAX_THICKNESS:
        yield float(value)
