"""Faults of USD layers, in words about the file: USD's own name its parser's rules."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

from animtool.core.errors import Fault, excerpt
from animtool.core.names import most_similar
from animtool.core.source_lines import SourceLineCache

FIRST_LINE = "#usda 1.0"
# File, line, column, what is wrong, the text there, and the prim or attribute.
_LOCATED_FAULT = re.compile(r"(\S+):(\d+):(\d+): (.*?) at '(.*?)' in <(.*?)>")
_UNQUOTED_NAME = re.compile(r"(def|over|class)(\s+\w+)?\s+([A-Za-z_]\w*)\s*([({]|$)")
# A prim that begins with another word than USD's.
_PRIM_LINE = re.compile(r'\s*([A-Za-z]+)\s+(?:[A-Z]\w*\s+)?"[A-Za-z_]\w*"\s*[({\s})]*$')
_SPECIFIERS = ("def", "over", "class")
_MAX_TEXT = 300

# Message and hint, by what USD says; both are given its words and the text there.
_FaultText = Callable[[re.Match[str], str], tuple[str, str | None]]
_FAULT_PATTERNS: dict[str, _FaultText] = {
    r"Unable to parse layer version|is not a valid usda layer": lambda _, __: (
        f"the first line is not {FIRST_LINE!r}",
        f"write {FIRST_LINE!r} in the first line",
    ),
    r"Cannot parse layer version '(.*?)'.*?version is '(.*?)'": lambda words, __: (
        f"is USD text of version {words[1]}; the installed USD reads {words[2]}",
        "save it with an older USD, or update usd-core",
    ),
    r"Expected (\S+)": lambda words, __: (
        f"{words[1]!r} is missing",
        f"add {words[1]!r} before this line",
    ),
    r"Tuple dimensions error for attribute of type (\w+)": lambda words, there: (
        f"{there or 'a value'} does not have the numbers of a {words[1]}",
        f"write as many numbers as a {words[1]} has",
    ),
    r"Error parsing (?:simple|shaped|tuple) value": lambda _, there: (
        f"{there} is not a value of its type",
        "texts need double quotes" if re.fullmatch(r"[A-Za-z_].*", there) else None,
    ),
    r"parse error|match": lambda _, there: (
        f"cannot be parsed from {excerpt(there)} on" if there else "ends too early",
        _quoting_hint(there),
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
    """Return message and hint for a prim with an unknown specifier; None for others.

    >>> _specifier_fault('clas Skeleton "Skel" (')
    ("'clas' does not begin a prim", "did you mean 'class'? a prim begins with def, \
over or class")
    """
    match = _PRIM_LINE.match(line)
    if match is None or match[1] in _SPECIFIERS:
        return None
    meant = most_similar(match[1], _SPECIFIERS, 0.5)
    hint = "a prim begins with def, over or class"
    hint = f"did you mean {meant!r}? {hint}" if meant else hint
    return f"{match[1]!r} does not begin a prim", hint


def layer_fault(text: str, path: Path) -> Fault:
    """Return the fault of a layer that USD refused (USD001).

    Args:
        text: What USD says, without its source locations.
        path: The layer, as the user named it.

    >>> text = "/a.usda:1:1: Unable to parse layer version. at '#usda 1' in </>"
    >>> str(layer_fault(text, Path("a.usda"))).partition(";")[0]
    "a.usda:1:1: USD001 the first line is not '#usda 1.0'"
    """
    located_fault = _LOCATED_FAULT.search(text)
    message_text, context = (
        (text, "") if located_fault is None else (located_fault[4], located_fault[5])
    )
    location: dict[str, Any] = {}
    if located_fault is not None:
        location = {"lines": (int(located_fault[2]),), "column": int(located_fault[3])}
        if Path(located_fault[1]).name != path.name:
            path = Path(located_fault[1])  # a layer that it brings in
        if located_fault[6] not in {"", "/"}:
            location["where"] = located_fault[6]
    for text_part in (text, message_text):
        for pattern, describe in _FAULT_PATTERNS.items():
            match = re.search(pattern, text_part)
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
    return Fault("USD001", text[:_MAX_TEXT], str(path), **location)
