"""The element tree of an FBX file, binary or text, and its numbers."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import field
from typing import Any

import numpy as np

from animtool.core.array_types import FloatArray, IntArray
from animtool.core.errors import value_excerpt
from animtool.core.record import dataclass
from animtool.formats import FLOAT32_MAX
from animtool.formats.file_diagnostics import FileDiagnostics

# Maximum nesting depth; keys of an object are four levels deep.
MAX_NESTING = 48
MAX_ELEMENTS = 3_000_000
# Limit of all arrays of a file, inflated [byte].
MAX_ARRAY_BYTES = 1_000_000_000


@dataclass(slots=True, eq=False)
class Element:
    """An element of an FBX file: a name, values and child elements."""

    name: str
    values: list[Any]  # int, float, str, bytes, or an array
    location: str  # byte offset or line
    children: list[Element] = field(default_factory=list)

    def find(self, name: str) -> Element | None:
        """Return the first child element with a given name; None if there is none."""
        return next((child for child in self.children if child.name == name), None)

    def find_all(self, name: str) -> Iterator[Element]:
        """Yield the child elements with a given name."""
        return (child for child in self.children if child.name == name)

    def text(self, index: int) -> str:
        """Return the value at an index if it is text, else an empty string."""
        value = self.values[index] if index < len(self.values) else ""
        return value if isinstance(value, str) else ""


def read_number(element: Element, index: int, diagnostics: FileDiagnostics) -> float:
    """Return the finite number at an index of an element's values (FBX005)."""
    value = element.values[index] if index < len(element.values) else None
    if isinstance(value, np.ndarray) and value.size:
        value = value.reshape(-1)[0].item()
    if not isinstance(value, int | float) or not abs(value) <= FLOAT32_MAX:
        message = f"{element.name} must be a number, not {value_excerpt(value)}"
        diagnostics.fail("FBX005", element.location, message)
    return float(value)


def read_floats(
    parent: Element, name: str, diagnostics: FileDiagnostics, count: int | None = None
) -> FloatArray | None:
    """Return the finite numbers of a child element; None if missing."""
    element = parent.find(name)
    if element is None:
        return None
    values = np.asarray(_numeric_array(element, diagnostics), np.float64)
    if not (np.abs(values) <= FLOAT32_MAX).all():
        diagnostics.fail(
            "FBX005", element.location, f"{name} contains a value that is not finite"
        )
    if count is not None and len(values) != count:
        message = f"{name} has {len(values)} numbers instead of {count}"
        diagnostics.fail("FBX005", element.location, message)
    return values


def read_integers(
    parent: Element, name: str, diagnostics: FileDiagnostics
) -> IntArray | None:
    """Return the integers of a child element; None if missing."""
    element = parent.find(name)
    if element is None:
        return None
    values = _numeric_array(element, diagnostics)
    if values.dtype.kind == "f":
        is_in_range = (np.abs(values) < 2.0**63).all()
        if not is_in_range or (values != np.round(values)).any():
            diagnostics.fail("FBX005", element.location, f"{name} must hold integers")
    return np.asarray(values, np.int64)


def _numeric_array(element: Element, diagnostics: FileDiagnostics) -> Any:
    """Return the numbers of an element as an array; raise for other values."""
    values = element.values
    if len(values) == 1 and isinstance(values[0], np.ndarray):
        return values[0]
    if all(isinstance(value, int) and abs(value) < 2**63 for value in values):
        return np.array(values, np.int64)
    if all(isinstance(value, int | float) for value in values):
        try:
            return np.array(values, np.float64)
        except OverflowError:
            pass
    return diagnostics.fail(
        "FBX005", element.location, f"{element.name} must hold numbers"
    )
