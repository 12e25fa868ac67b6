"""Plain values that another program wrote, read with a bound and checked by type."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NoReturn

from animtool.errors import FormatError, excerpt
from animtool.files import read_input

# Longer than the longest path that any system has.
MAX_TEXT = 40_000
# What sizes, times and inodes have room in.
MAX_WHOLE = 2**64


class RecordError(ValueError):
    """Plain values are not what they should be; the message says how."""


def _refused(name: str) -> NoReturn:
    raise RecordError(f"{name} is no number")


def _unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    found = dict(pairs)
    if len(found) < len(pairs):
        raise RecordError("a key is there twice")
    return found


_PLAIN = json.JSONDecoder(parse_constant=_refused)
_UNIQUE = json.JSONDecoder(parse_constant=_refused, object_pairs_hook=_unique)


def json_object(data: bytes, *, unique: bool = True) -> dict[str, Any]:
    """Return the JSON object that data holds.

    Args:
        data: UTF-8.
        unique: Whether to refuse a key that is there twice, which takes longer.

    Raises:
        RecordError: It is no JSON object, nests too deeply, or has NaN or infinity.
    """
    decoder = _UNIQUE if unique else _PLAIN
    try:
        return object_of(decoder.decode(data.decode("utf-8")))
    except RecordError:
        raise
    except ValueError as error:
        raise RecordError(f"is no JSON: {excerpt(str(error), 80)}") from error
    except RecursionError as error:
        raise RecordError("is nested too deeply") from error


def json_of_file(path: Path, most: int) -> dict[str, Any]:
    """Return the JSON object in a file of at most so many bytes.

    Raises:
        RecordError: It cannot be read, is too large, or as in `json_object`.
    """
    try:
        data = read_input(path, most, noted=False)
    except FormatError as error:
        raise RecordError(error.faults[0].message) from error
    return json_object(data)


def object_of(value: object) -> dict[str, Any]:
    """Return a value that is an object.

    Raises:
        RecordError: It is none.
    """
    if not isinstance(value, dict):
        raise RecordError("is no object")
    return value


def text_in(record: Mapping[str, Any], key: str, longest: int = MAX_TEXT) -> str:
    """Return the text of a key.

    Raises:
        RecordError: There is none, or it is too long or has a NUL.
    """
    return _text(record.get(key), key, longest)


def _text(value: object, key: str, longest: int = MAX_TEXT) -> str:
    if not isinstance(value, str):
        raise RecordError(f"{key!r} is no text")
    if len(value) > longest:
        raise RecordError(f"{key!r} is too long")
    if "\0" in value:
        raise RecordError(f"{key!r} has a NUL")
    return value


def texts_in(record: Mapping[str, Any], key: str) -> list[str]:
    """Return the texts of a key, checked as in `text_in`.

    Raises:
        RecordError: They are none.
    """
    return [_text(value, key) for value in list_in(record, key)]


def whole_in(
    record: Mapping[str, Any], key: str, low: int = 0, high: int = MAX_WHOLE
) -> int:
    """Return the whole number of a key.

    Raises:
        RecordError: There is none from ``low`` to ``high``.
    """
    value = record.get(key)
    # A truth value is an int to Python.
    if type(value) is not int or not low <= value <= high:
        raise RecordError(f"{key!r} is no whole number from {low} to {high}")
    return value


def number_in(record: Mapping[str, Any], key: str, low: float = 0.0) -> float:
    """Return the finite number of a key.

    Raises:
        RecordError: There is none that is at least ``low``.
    """
    value = record.get(key)
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise RecordError(f"{key!r} is no number")
    try:
        number = float(value)
    except OverflowError:
        number = math.inf
    if not (math.isfinite(number) and number >= low):
        raise RecordError(f"{key!r} is no number from {low:g}")
    return number


def list_in(record: Mapping[str, Any], key: str) -> Sequence[Any]:
    """Return the list of a key.

    Raises:
        RecordError: There is none.
    """
    value = record.get(key)
    if not isinstance(value, list):
        raise RecordError(f"{key!r} is no list")
    return value
