"""TOML of others, read within bounds of depth and time."""

from __future__ import annotations

import re
from collections.abc import Iterable
from typing import Any

# As deep as documents in YAML.
MAX_DEPTH = 50
# The parser takes time with the square of the parts of a key. A part begins where no
# part or escape is before it, so that the search takes time with the length alone.
_PART = r"""(?:[\w-]++|"(?:[^"\\\n]|\\.)*+"|'[^'\n]*+')"""
_LONG_KEY = re.compile(rf"(?<![\w\\-])(?:{_PART}[ \t]*+\.[ \t]*+){{{MAX_DEPTH}}}")


def parse_toml(text: str) -> dict[str, Any]:
    """Return the tables of a TOML text.

    Raises:
        ValueError: It is malformed, or nested deeper than 50.
    """
    import tomllib

    found = _LONG_KEY.search(text)
    if found is not None:
        raise _too_deep(f" (at line {text.count(chr(10), 0, found.start()) + 1})")
    try:
        tables = tomllib.loads(text)
    except RecursionError as error:
        raise _too_deep() from error
    level: list[Any] = [tables]
    for _ in range(MAX_DEPTH):
        level = [inner for value in level for inner in _inside(value)]
        if not level:
            return tables
    raise _too_deep()


def _too_deep(place: str = "") -> ValueError:
    return ValueError(f"it is nested deeper than {MAX_DEPTH}{place}")


def _inside(value: Any) -> Iterable[Any]:
    """Return the values in a table or a list."""
    if isinstance(value, dict):
        return value.values()
    return value if isinstance(value, list) else ()
