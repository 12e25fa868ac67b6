"""Turns USD's parser errors into messages about the file."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

from animtool.core.errors import Fault, excerpt
from animtool.core.names import most_similar
from animtool.core.source_lines import SourceLineCache

USDA_HEADER = "#usda 1.0"
# File, line, column, error, the text at that position, and the prim or attribute.
_LOCATED_ERROR = re.compile(r"(\S+):(\d+):(\d+): (.*?) at '(.*?)' in <(.*?)>")
_UNQUOTED_NAME = re.compile(r"(def|over|class)(\s+\w+)?\s+([A-Za-z_]\w*)\s*([({]|$)")
# A prim line; its first word may be a misspelled specifier.
_PRIM_LINE = re.compile(r'\s*([A-Za-z]+)\s+(?:[A-Z]\w*\s+)?"[A-Za-z_]\w*"\s*[({\s})]*$')
_SPECIFIERS = ("def", "over", "class")
_MAX_LENGTH = 300

# Build message and hint from the matched error of USD and the text at its position.
_FaultText = Callable[[re.Match[str], str], tuple[str, str | None]]
_FAULT_PATTERNS: dict[str, _FaultText] = {
    r"Unable to parse layer version|is not a valid usda layer": lambda _, __: (
        f"the first line is not {USDA_HEADER!r}",
        f"write {USDA_HEADER!r} in the first line",
    ),
    r"Cannot parse layer version '(.*?)'.*?version is '(.*?)'": lambda match, __: (
        f"is USD text of version {match[1]}; the installed USD reads {match[2]}",
        "save it with an older USD, or update usd-core",
    ),
    r"Cannot determine file format": lambda _, __: (
        "is not a USD file",
        "animtool convert writes rigs, clips and takes as USD",
    ),
    r"Expected (\S+)": lambda match, __: (
        f"{match[1]!r} is missing",
        f"add {match[1]!r} before this line",
    ),
    r"Tuple dimensions error for attribute of type (\w+)": lambda match, context: (
        f"{context or 'a value'} does not have the numbers of a {match[1]}",
        f"write as many numbers as a {match[1]} has",
    ),
    r"Error parsing (?:simple|shaped|tuple) value": lambda _, context: (
        f"{context} is not a value of its type",
        "texts need double quotes" if re.fullmatch(r"[A-Za-z_].*", context) else None,
    ),
    r"parse error|match": lambda _, context: (
        f"cannot be parsed from {excerpt(context)} on" if context else "ends too early",
        _quoting_hint(context),
    ),
    r"[Ff]ile too small|bootstrap|truncated": lambda _, __: (
        "is not a binary USD file, or not all of one",
        "write or copy it again",
    ),
}


def _quoting_hint(context: str) -> str | None:
    """Return a hint for a prim whose name has no quotes."""
    match = _UNQUOTED_NAME.match(context)
    if match is None:
        return None
    return f'put the name in quotes: {match[1]}{match[2] or ""} "{match[3]}"'


def _specifier_fault(line: str) -> tuple[str, str] | None:
    """Return message and hint for a prim line with an unknown specifier, else None.

    >>> _specifier_fault('clas Skeleton "Skel" (')
    ("'clas' does not begin a prim", "did you mean 'class'? a prim begins with def, \
over or class")
    """
    match = _PRIM_LINE.match(line)
    if match is None or match[1] in _SPECIFIERS:
        return None
    similar = most_similar(match[1], _SPECIFIERS, 0.5)
    hint = "a prim begins with def, over or class"
    hint = f"did you mean {similar!r}? {hint}" if similar else hint
    return f"{match[1]!r} does not begin a prim", hint


def layer_fault(text: str, path: Path) -> Fault:
    """Return a fault for a layer that USD cannot parse (USD001).

    Args:
        text: USD's error text, without its source locations.
        path: Path of the layer, as configured.

    >>> text = "/a.usda:1:1: Unable to parse layer version. at '#usda 1' in </>"
    >>> str(layer_fault(text, Path("a.usda"))).partition(";")[0]
    "a.usda:1:1: USD001 the first line is not '#usda 1.0'"
    """
    located_error = _LOCATED_ERROR.search(text)
    reason, context = (
        (text, "") if located_error is None else (located_error[4], located_error[5])
    )
    location: dict[str, Any] = {}
    if located_error is not None:
        location = {"lines": (int(located_error[2]),), "column": int(located_error[3])}
        if Path(located_error[1]).name != path.name:
            path = Path(located_error[1])  # a layer that it composes
        if located_error[6] not in {"", "/"}:
            location["where"] = located_error[6]
    for search_text in (text, reason):
        for pattern, describe in _FAULT_PATTERNS.items():
            match = re.search(pattern, search_text)
            if match is not None:
                message, hint = describe(match, context)
                if "first line" in message:
                    location = {"lines": (1,), "column": 1}
                else:
                    line = SourceLineCache().line(
                        str(path), *location.get("lines", (0,))
                    )
                    message, hint = _specifier_fault(line or "") or (message, hint)
                return Fault("USD001", message, str(path), hint=hint, **location)
    return Fault("USD001", text[:_MAX_LENGTH], str(path), **location)
