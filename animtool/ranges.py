"""Ranges of numbers, declared in the annotation of the field that they bound.

A record says once what its numbers may be, and `range_faults` checks all of them::

    step: Annotated[float | None, above(0, "SIM004", finite=True)] = None

Records are dataclasses, or the models of files; pydantic does not look at a `Range`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any, get_type_hints

from animtool.errors import Fault

# What a message says of a number of an entry in a file.
OF_ENTRY = "its {name} must be {bound}, not {value:g}"
# What a message says of an argument.
OF_ARGUMENT = "{name} must be {bound}, not {value:g}"


@dataclass(frozen=True, slots=True)
class Range:
    """What a number may be. None is always in range; NaN never is."""

    bound: str  # in words, as in "must be above 0"
    code: str
    least: float
    most: float = math.inf
    reached: bool = True  # whether the least is in range itself
    finite: bool = False  # whether infinity is out of range

    def holds(self, value: float | None) -> bool:
        """Return whether a number is in range."""
        if value is None:
            return True
        inside = self.least <= value <= self.most
        if self.finite and not math.isfinite(value):
            return False
        return inside and (self.reached or value > self.least)


def above(least: float, code: str, *, finite: bool = False) -> Range:
    """Return a range that does not hold its least number.

    >>> above(0, "SIM004", finite=True).bound
    'finite and above 0'
    """
    bound = _bound(f"above {least:g}", finite=finite)
    return Range(bound, code, least, reached=False, finite=finite)


def or_more(least: float, code: str, *, finite: bool = False) -> Range:
    """Return a range from a number on, as in "0 or more"."""
    return Range(
        _bound(f"{least:g} or more", finite=finite), code, least, finite=finite
    )


def at_least(least: float, code: str, *, finite: bool = False) -> Range:
    """Return a range from a number on, as in "at least 1e-06"."""
    bound = _bound(f"at least {least:g}", finite=finite)
    return Range(bound, code, least, finite=finite)


def _bound(text: str, *, finite: bool) -> str:
    return f"finite and {text}" if finite else text


@cache
def ranges_of(record: type[Any]) -> Mapping[str, Range]:
    """Return the ranges that a record declares, by the name of the field.

    >>> from animtool.systems.springs import SpringOptions
    >>> ranges_of(SpringOptions)["longest"].bound
    'above 1'
    """
    if hasattr(record, "model_fields"):
        declared = {name: each.metadata for name, each in record.model_fields.items()}
    else:
        hints = get_type_hints(record, include_extras=True)
        declared = {name: getattr(hints[name], "__metadata__", ()) for name in hints}
    return {
        name: each
        for name, metadata in declared.items()
        for each in metadata
        if isinstance(each, Range)
    }


def range_faults(record: Any, message: str = OF_ARGUMENT) -> list[Fault]:
    """Return a fault of each number of a record that is out of its range.

    >>> from animtool.systems.springs import SpringOptions
    >>> [str(fault) for fault in range_faults(SpringOptions(step=0.0, longest=1.0))]
    ['SIM004 step: step must be finite and above 0, not 0', 'SIM004 longest: longest \
must be above 1, not 1']
    """
    kind: Any = type(record)
    faults = []
    for name, allowed in ranges_of(kind).items():
        value = getattr(record, name)
        if not allowed.holds(value):
            text = message.format(name=name, bound=allowed.bound, value=value)
            faults.append(Fault(allowed.code, text, where=name))
    return faults
