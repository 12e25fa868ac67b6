"""The one way from a record to plain values of a JSON report."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from enum import Enum
from fractions import Fraction
from operator import attrgetter
from pathlib import PurePath
from typing import Any


def plain_value(value: Any) -> Any:
    """Return a value as JSON has it: records as their fields, null for no number.

    >>> plain_value({"fps": Fraction(24), "error": math.inf, "names": ("a",)})
    {'fps': 24.0, 'error': None, 'names': ['a']}
    """
    if isinstance(value, float | Fraction):
        return float(value) if math.isfinite(value) else None
    if isinstance(value, Enum | PurePath):
        return str(value)
    if value is None or isinstance(value, bool | int | str):
        return value
    return _plain_parts(value)


def _plain_parts(value: Any) -> Any:
    """Return what holds others as plain values."""
    if hasattr(value, "as_dict"):
        return value.as_dict()
    if hasattr(value, "tolist"):  # an array, or a number of one
        return plain_value(value.tolist())
    if is_dataclass(value):
        value = {own.name: getattr(value, own.name) for own in fields(value)}
    if isinstance(value, Mapping):
        return {str(key): plain_value(own) for key, own in value.items()}
    return [plain_value(own) for own in value]


def picked(record: Any, names: str) -> dict[str, Any]:
    """Return fields of a record as plain values.

    Args:
        record: The record.
        names: Of the fields, in order, ``key=path.of.field`` where the key is another.

    >>> picked(Fraction(1, 3), "over=denominator numerator")
    {'over': 3, 'numerator': 1}
    """
    values = {}
    for name in names.split():
        key, _, path = name.partition("=")
        values[key] = plain_value(attrgetter(path or key)(record))
    return values
