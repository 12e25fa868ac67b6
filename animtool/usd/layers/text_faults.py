"""Turns USD's parser errors into messages about the file."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from animtool.core.errors import Fault, excerpt
from animtool.core.names import most_similar
from animtool.core.record import dataclass
from animtool.core.source_lines import SourceLineCache

USDA_HEADER = "#usda 1.0"
# File, line, column, error, the text at that position, and the prim or attribute; the
# end is missing if a long line was cut.
_LOCATED_ERROR = re.compile(
    r"(\S+):(\d+):(\d+): (.*?) at '(.*?)(?:' in <(.*?)>|$)", re.DOTALL
)
_UNQUOTED_NAME = re.compile(r"(def|over|class)(\s+\w+)?\s+([A-Za-z_]\w*)\s*([({]|$)")
# A prim line; its first word may be a misspelled specifier.
_PRIM_LINE = re.compile(r'\s*([A-Za-z]+)\s+(?:[A-Z]\w*\s+)?"[A-Za-z_]\w*"\s*[({\s})]*$')
_SPECIFIERS = ("def", "over", "class")
_MAX_TEXT_LENGTH = 300


@dataclass(frozen=True, slots=True)
class _ParserError:
    """An error of USD's parser, and the text around it."""

    match: re.Match[str]  # match of the error's pattern in USD's text
    context: str  # the rest of its line from the error's position
    lines: Sequence[str]  # known lines of the file
    line: int  # 1-based line, 0 if unknown

    @property
    def source_line(self) -> str:
        """The line of the error; empty if unknown."""
        return self.lines[self.line - 1] if 0 < self.line <= len(self.lines) else ""

    @property
    def previous_line(self) -> int:
        """The last line above the error that is not blank; 0 if unknown."""
        above = range(min(self.line, len(self.lines)) - 1, 0, -1)
        return next((i for i in above if self.lines[i - 1].strip()), 0)


class _FaultText(NamedTuple):
    """The text of a fault, and its line if USD states another."""

    message: str
    hint: str | None
    line: int = 0


def _unclosed_fault(error: _ParserError, bracket: str) -> _FaultText:
    """Return the fault of a list or tuple that is not closed or lacks a comma."""
    context = error.context
    noun = {"]": "list", ")": "tuple"}[bracket]
    if not context:
        message = f"the file ends within a {noun}"
        return _FaultText(message, f"add {bracket!r}, or copy or export the file again")
    if context[0] == ",":
        return _FaultText("a value is missing before this comma", "remove the comma")
    if re.match(r"[-+.\d\"'(\[@<)\]]", context):
        message = f"',' or {bracket!r} is missing before {excerpt(context)}"
        return _FaultText(message, f"write {bracket!r} or a comma there")
    line = error.previous_line
    location = "this line" if line else "the line above"
    message = f"the {noun} in {location} is not closed"
    return _FaultText(message, f"add {bracket!r} at the end of {location}", line)


def _missing_fault(error: _ParserError) -> _FaultText:
    """Return the fault of a missing bracket, or of a line that USD cannot parse."""
    bracket, context = error.match[1], error.context
    if not context:
        hint = f"add {bracket!r} at its end, or copy or export the file again"
        return _FaultText(f"the file ends before a {bracket!r}", hint)
    if bracket != "}" or context[0] in "})]":
        hint = f"add {bracket!r} before this line"
        return _FaultText(f"{bracket!r} is missing", hint)
    unquoted_hint = _quoting_hint(context)
    if unquoted_hint or context.split()[0] in _SPECIFIERS:
        hint = unquoted_hint or "add '{' after it"
        return _FaultText(f"{excerpt(context)} does not begin a prim", hint)
    if not any(line.strip() for line in error.lines[error.line :]):
        message = f"the file ends within {excerpt(context)}"
        return _FaultText(message, "copy or export the file again")
    hint = "a property is a type, a name, = and a value, such as double size = 1.5"
    for pattern, remedy in _PROPERTY_REMEDIES.items():
        match = re.search(pattern, context)
        if match is not None:
            hint = match.expand(remedy)
            break
    return _FaultText(f"{excerpt(context)} cannot be parsed", hint)


# Remedies of properties that cannot be parsed.
_PROPERTY_REMEDIES = {
    r"=\s*(-?\d+),(\d+)$": r"write \1.\2 with a point",
    r"=\s*$": "write its value after =",
    r"=\s*(/[^<>]*)>?$": r"write the path as <\1>",
    r"^(\w[\w:]*)\s*=": r"write its type first, such as double \1 = 1.5",
    r"^(\w+(?:\[\])?\s+[\w:]+)\s+([^=\s]+)$": r"write \1 = \2",
}
_SAMPLE = re.compile(r"\s*[-+.\deE]+\s*:\s*\S")


def _samples_fault(error: _ParserError) -> _FaultText:
    """Return the fault of invalid time samples, located at the first invalid line."""
    message, hint = "the time samples cannot be parsed", "write each as time: value,"
    for number in range(error.line + 1, len(error.lines) + 1):
        text = error.lines[number - 1].strip()
        following = "".join(line.strip() for line in error.lines[number : number + 1])
        if text.startswith("}"):
            break
        if text and not _SAMPLE.match(text):
            if re.match(r"[-+.\d(]", text):
                message = f"{excerpt(text)} is not a time sample"
                return _FaultText(message, hint, number)
            message = "the time samples above are not closed: '}' is missing"
            return _FaultText(message, "add '}' before this line", number)
        if text and text[-1] != "," and _SAMPLE.match(following):
            message = f"',' is missing after {excerpt(text)}"
            return _FaultText(message, "add it at the end of the line", number)
    return _FaultText(message, hint)


def _value_fault(error: _ParserError) -> _FaultText:
    """Return the fault of a value that does not match its declared type."""
    message = f"{excerpt(error.context)} is not a value of its type"
    declaration = re.search(r"(\w+)(\[\])?\s+[\w:.]+\s*=", error.source_line)
    type_name = declaration[1] if declaration else "string"
    if type_name in {"string", "token"}:
        is_word = re.match(r"[A-Za-z_]", error.context)
        return _FaultText(message, "texts need double quotes" if is_word else None)
    message = f"{excerpt(error.context)} is not a value of the type {type_name}"
    return _FaultText(message, _VALUE_HINTS.get(type_name))


_VALUE_HINTS = {
    "asset": "write the path between two @",
    "bool": "write true or false",
    **dict.fromkeys(("float", "double", "half"), "write a number such as 1.5"),
    **dict.fromkeys(("int", "uint", "int64"), "write a whole number"),
}


def _constant_fault(
    message: str, hint: str | None
) -> Callable[[_ParserError], _FaultText]:
    """Return a function that returns the same fault for every error."""
    return lambda _: _FaultText(message, hint)


def _unclosed_text(mark: str) -> Callable[[_ParserError], _FaultText]:
    """Return a function that reports a text or path without its closing mark."""
    return _constant_fault(
        f"{mark} is missing after this", f"close the value with {mark}"
    )


_FAULT_PATTERNS: dict[str, Callable[[_ParserError], _FaultText]] = {
    r"Unable to parse layer version|is not a valid usda layer": _constant_fault(
        f"the first line is not {USDA_HEADER!r}",
        f"write {USDA_HEADER!r} in the first line",
    ),
    r"Cannot parse layer version '(.*?)'.*?version is '(.*?)'": lambda error: (
        _FaultText(
            f"is USD text of version {error.match[1]}; the installed USD reads "
            f"{error.match[2]}",
            "save it with an older USD, or update usd-core",
        )
    ),
    r"Cannot determine file format": _constant_fault(
        "is not a USD file", "animtool convert writes rigs, clips and takes as USD"
    ),
    r"Expected (\S+)": _missing_fault,
    r"Tuple dimensions error for attribute of type (\w+)": lambda error: _FaultText(
        f"{excerpt(error.context) if error.context else 'a value'} does not have the "
        f"numbers of a {error.match[1]}",
        f"write as many numbers as a {error.match[1]} has",
    ),
    r"Type name has \[\] for non-shaped value": lambda error: _FaultText(
        f"{excerpt(error.context)} is not a list, but its type ends in []",
        "write the values between [ and ]",
    ),
    r"Error parsing (?:simple|shaped|tuple) value": _value_fault,
    r"matching ListValueClose": lambda error: _unclosed_fault(error, "]"),
    r"matching TupleValueClose": lambda error: _unclosed_fault(error, ")"),
    r"matching seq<Assignment, TimeSampleMap": _samples_fault,
    r"matching until<ascii::one<'\\?\"": _unclosed_text("a double quote"),
    r"matching until<ascii::one<'\\?'": _unclosed_text("a single quote"),
    r"matching until<At": _unclosed_text("@"),
    r"matching sor<RightAngleBracket": _unclosed_text("'>'"),
    r"matching internal::eof": lambda error: _FaultText(
        f"cannot be parsed from {excerpt(error.context)} on",
        "remove this '}', or add a '{' above"
        if error.context[:1] == "}"
        else _quoting_hint(error.context) or "is a '{' missing below?",
    ),
    r"parse error|match": lambda error: _FaultText(
        f"cannot be parsed from {excerpt(error.context)} on"
        if error.context
        else "cannot be parsed to its end",
        _quoting_hint(error.context) or "correct the text, or export the layer again",
    ),
    r"[Ff]ile too small|bootstrap|truncated": _constant_fault(
        "is not a binary USD file, or not all of one", "write or copy it again"
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
        if located_error[6] not in {None, "", "/"}:
            location["where"] = located_error[6]
    for search_text in (text, reason):
        for pattern, describe in _FAULT_PATTERNS.items():
            match = re.search(pattern, search_text)
            if match is not None:
                sources = SourceLineCache()
                (line,) = location.get("lines", (0,))
                specifier_fault = _specifier_fault(sources.line(str(path), line) or "")
                error = _ParserError(match, context, sources.lines, line)
                message, hint, stated_line = describe(error)
                if "first line" in message:
                    location = {"lines": (1,), "column": 1}
                elif specifier_fault is not None:
                    message, hint = specifier_fault
                elif stated_line:
                    end = len(sources.lines[stated_line - 1].rstrip())
                    column = end if stated_line < line else 1
                    location |= {"lines": (stated_line,), "column": column}
                return Fault("USD001", message, str(path), hint=hint, **location)
    return Fault("USD001", text[:_MAX_TEXT_LENGTH], str(path), **location)
