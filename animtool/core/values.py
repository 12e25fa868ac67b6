"""Plain JSON values of records, by their fields or a template of keys.

A record whose report has other keys declares them in ``json_keys``, a template of names
of fields or properties, in the order of the report::

    json_keys: ClassVar[str] = "'ik' frames fps=clock.fps# goals{name joint} shot?"

``key=path.of.field`` uses another key; ``path{…}`` selects keys of the value, or of
each element of a list; ``.{…}`` selects more keys of the record. Suffixes of a path:
with ``?`` the key is omitted for None, with ``+`` also for empty values; ``#`` converts
to text, ``~`` rounds numbers to microseconds. ``*path`` inserts the keys of a value, or
none for None, and ``*`` all fields of the record. A name in quotes is that of the
report.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping
from dataclasses import fields, is_dataclass
from enum import Enum
from functools import cache
from os import PathLike
from typing import Any

from animtool.core.record import dataclass

VERSION = "animtool/1"


def plain_value(value: Any) -> Any:
    """Convert a value to JSON values: records to their fields, NaN to null.

    >>> from fractions import Fraction
    >>> plain_value({"fps": Fraction(24), "error": math.inf, "names": ("a",)})
    {'fps': 24.0, 'error': None, 'names': ['a']}
    """
    if isinstance(value, Enum | PathLike):
        return str(value)
    if value is None or isinstance(value, bool | int | str):
        return value
    if hasattr(value, "as_integer_ratio"):  # a float, a fraction
        return float(value) if math.isfinite(value) else None
    return _plain_container(value)


def _plain_container(value: Any) -> Any:
    """Convert a record, mapping, array or sequence and its elements to JSON values."""
    keys = getattr(value, "json_keys", None)
    if isinstance(keys, str):
        return template_values(value, keys)
    if is_dataclass(value):
        return _fields_of(value)
    if hasattr(value, "tolist"):  # an array, or an element of one
        return plain_value(value.tolist())
    if isinstance(value, Mapping):
        return {str(key): plain_value(element) for key, element in value.items()}
    return [plain_value(element) for element in value]


def _fields_of(record: Any) -> dict[str, Any]:
    return {
        entry.name: plain_value(getattr(record, entry.name)) for entry in fields(record)
    }


def template_values(record: Any, keys: str) -> dict[str, Any]:
    """Return the values of a record by the keys of a template.

    >>> from fractions import Fraction
    >>> template = "over=denominator numerator one=denominator{real}"
    >>> template_values(Fraction(1, 3), template)
    {'over': 3, 'numerator': 1, 'one': {'real': 3}}
    """
    return _values_of(record, parse_template(keys))


def value_at_path(value: Any, path: str) -> Any:
    """Return the value of a nested field or mapping key; None below None.

    >>> value_at_path({"a": 3.5}, "a.real")
    3.5
    """
    for name in filter(None, path.split(".")):
        if value is None:
            return None
        value = value.get(name) if isinstance(value, Mapping) else getattr(value, name)
    return value


@dataclass(frozen=True, slots=True)
class JsonKey:
    """A key of a report template: the field it reads, and how the value is shown."""

    key: str  # empty to insert the keys of a value
    path: str  # path of the field; empty for the record
    modifiers: str = ""  # `?`, `+`, `#`, `~`; `'` for the name of a report
    keys: tuple[JsonKey, ...] | None = None  # keys of the value


_TOKEN = re.compile(r"\s*(?:(\})|'([^']+)'|(\*)?(?:(\w+)=)?([\w.]*)([?+#~]*)(\{)?)\s*")


@cache
def parse_template(template: str) -> tuple[JsonKey, ...]:
    """Parse a template of report keys, such as ``fps=clock.fps# goals{name}``."""
    return tuple(_parse_keys(_template_tokens(template)))


def _template_tokens(template: str) -> Iterator[re.Match[str]]:
    offset = 0
    while offset < len(template):
        token = _TOKEN.match(template, offset)
        if token is None or token.end() == offset:
            raise ValueError(f"malformed template at {template[offset:]!r}")
        offset = token.end()
        yield token


def _parse_keys(tokens: Iterator[re.Match[str]]) -> Iterator[JsonKey]:
    for token in tokens:
        closing, report_name, asterisk, key, path, modifiers, opening = token.groups()
        if closing:
            return
        if report_name:
            yield JsonKey(report_name, "", "'")
            continue
        inner_keys = tuple(_parse_keys(tokens)) if opening else None
        name = "" if asterisk else key or path
        yield JsonKey(name, path.strip("."), modifiers, inner_keys)


def _values_of(record: Any, keys: tuple[JsonKey, ...]) -> dict[str, Any]:
    values: dict[str, Any] = {}
    for json_key in keys:
        value = value_at_path(record, json_key.path)
        if json_key.modifiers == "'":
            values[json_key.key] = VERSION
        elif not json_key.key:
            values |= _inserted_values(record, value, json_key)
        elif not _is_omitted(value, json_key.modifiers):
            values[json_key.key] = _value_of_key(value, json_key)
    return values


def _inserted_values(record: Any, value: Any, key: JsonKey) -> dict[str, Any]:
    """Return the keys of a value to insert in a record, or all fields of the record."""
    if value is None:
        return {}
    if key.keys is not None:
        return _values_of(value, key.keys)
    if value is record:
        return _fields_of(record)
    inserted_values: dict[str, Any] = plain_value(value)
    return inserted_values


def _is_omitted(value: Any, modifiers: str) -> bool:
    """Return whether the modifier ``?`` or ``+`` omits a None or empty value."""
    is_empty = value is None or (hasattr(value, "__len__") and not len(value))
    return ("?" in modifiers and value is None) or ("+" in modifiers and is_empty)


def _value_of_key(value: Any, key: JsonKey) -> Any:
    """Return a value as text, rounded or with nested keys, as its key says."""
    if value is None:
        return None
    if "#" in key.modifiers:
        return str(value)
    if "~" in key.modifiers:
        return _round_values(value)
    if key.keys is None:
        return plain_value(value)
    if isinstance(value, list | tuple):
        return [_values_of(element, key.keys) for element in value]
    return _values_of(value, key.keys)


def _round_values(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {name: _round_values(element) for name, element in value.items()}
    return round(value, 6)
