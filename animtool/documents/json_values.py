"""Parses JSON documents fast, without line numbers."""

from __future__ import annotations

import json
import re
from typing import Any, NoReturn

# Text that YAML refuses or interprets differently: surrogates, escapes of control
# characters, and numbers longer than Python converts.
_YAML_DIFFERENCES = re.compile(
    r"[\x00-\x08\x0b\x0c\x0e-\x1f\x7f-\x9f\u2028\u2029\ud800-\udfff\ue000-\uffff]"
    r"|\\[bfnrt]|\\u00(?:[01]|7[fF]|[89])|\\u202[89]|\\u[dDeEfF]|[0-9]{100}"
)


def plain_json(text: str, max_depth: int, max_key_length: int) -> Any:
    """Parse a JSON mapping; None if the YAML parser must be used.

    Args:
        text: Content of a file.
        max_depth: Maximum nesting of lists and mappings.
        max_key_length: Maximum length of a key [characters].

    >>> plain_json('{"t": 1.5, "v": [1, 2]}', 50, 1000)
    {'t': 1.5, 'v': [1, 2]}
    >>> plain_json('{"t": 1, "t": 2}', 50, 1000) is None
    True
    """
    if _YAML_DIFFERENCES.search(text):
        return None

    def checked_mapping(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
        mapping = dict(pairs)
        max_length = max(map(len, mapping), default=0)
        if len(mapping) != len(pairs) or max_length > max_key_length:
            raise ValueError
        return mapping

    try:
        value = json.loads(
            text, object_pairs_hook=checked_mapping, parse_constant=_refuse_constant
        )
    except (ValueError, RecursionError):
        return None
    if not isinstance(value, dict) or _nesting_depth(value) > max_depth:
        return None
    return value


def _refuse_constant(name: str) -> NoReturn:
    raise ValueError(name)


def _nesting_depth(value: Any) -> int:
    """Return how deep lists and mappings are nested; 1 for a flat mapping."""
    depth, nodes = 0, [value]
    while nodes:
        depth += 1
        nodes = [
            child
            for node in nodes
            for child in (node.values() if node.__class__ is dict else node)
            if child.__class__ is dict or child.__class__ is list
        ]
    return depth
