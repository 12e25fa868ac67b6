"""Explains why a JSON text does not parse, and how to repair it."""

from __future__ import annotations

import json
import re

from animtool.core.errors import excerpt
from animtool.core.names import most_similar
from animtool.core.record import dataclass

# A string, or a bracket outside of strings.
_TOKEN = re.compile(r'"(?:[^"\\]|\\.)*"|[\[\]{}]', re.DOTALL)
_CLOSING = {"{": "}", "[": "]"}
# Words of other languages, and those of JSON that are meant.
_OTHER_WORDS = {"True": "true", "False": "false", "None": "null"}
_WORD = re.compile(r"[A-Za-z_]\w*|'[^'\n]*'")
_COMMENTS = ("//", "/*", "#")
# Messages and repairs of errors in strings, by the beginning of Python's text.
_STRING_PROBLEMS = {
    "Unterminated string": ("a quote is not closed", 'write " at its end'),
    "Invalid control character": (
        "a line break or tab is within quotes",
        'write " before it, or \\n or \\t',
    ),
    "Invalid \\": ("a backslash in quotes begins no escape", "write two, or /"),
}
# Those of other errors, before the text that is found instead.
_PROBLEMS = {
    "Extra data": ("after the end of the JSON is", "remove it, or a bracket before it"),
    "Expecting ',' delimiter": ("a comma is missing before", "write a comma here"),
    "Expecting ':' delimiter": ("a colon is missing before", "write a colon here"),
}
MAX_EXCERPT_LENGTH = 20


@dataclass(frozen=True, slots=True)
class JsonProblem:
    """A syntax error of a JSON text.

    Attributes:
        line: Its line, from 1.
        column: Its column, from 1.
        message: What is wrong.
        repair: How to repair it; None if it is not known.
    """

    line: int
    column: int
    message: str
    repair: str | None = None


def json_problem(error: json.JSONDecodeError) -> JsonProblem:
    """Return the place, the cause and the repair of a JSON syntax error.

    >>> def problem(text):
    ...     try:
    ...         json.loads(text)
    ...     except json.JSONDecodeError as error:
    ...         found = json_problem(error)
    ...         return found.line, found.column, found.message, found.repair
    >>> problem('{"a": 1,}')
    (1, 8, "a comma is before '}'", 'remove the comma')
    >>> problem('{"a": [1, 2}')
    (1, 12, "'[' of line 1 is not closed before '}'", "write ']' before '}'")
    """
    text, position = error.doc, error.pos
    for beginning, (message, repair) in _STRING_PROBLEMS.items():
        if error.msg.startswith(beginning):
            return _problem(text, position, message, repair)
    if text[position : position + 1] == ",":  # a trailing comma, since Python 3.13
        position += 1
    rest = text[position:].lstrip()
    position = len(text) - len(rest)
    if not rest:
        return _end_problem(text)
    if error.msg in _PROBLEMS:
        message, repair = _PROBLEMS[error.msg]
        is_bracket = rest[0] in "}]"
        if not is_bracket and not rest.startswith(_COMMENTS):
            at_gap = error.msg.startswith("Expecting")
            place = len(text[:position].rstrip()) if at_gap else position
            return _problem(text, place, f"{message} {_beginning(rest)}", repair)
    if rest[0] in "}]":
        return _bracket_problem(text, position)
    return _word_problem(text, position)


def _bracket_problem(text: str, position: int) -> JsonProblem:
    """Return the problem of a closing bracket that is unexpected."""
    before, bracket = text[:position].rstrip(), text[position]
    if before.endswith(","):
        message = f"a comma is before {bracket!r}"
        return _problem(text, len(before) - 1, message, "remove the comma")
    open_brackets = _open_brackets(text, position)
    if not open_brackets:
        return _problem(text, position, f"{bracket!r} closes nothing", "remove it")
    opening = text[open_brackets[-1]]
    if _CLOSING[opening] != bracket:
        line = _line_and_column(text, open_brackets[-1])[0]
        message = f"{opening!r} of line {line} is not closed before {bracket!r}"
        outer_brackets = [_CLOSING[text[i]] for i in open_brackets]
        relation = "before" if bracket in outer_brackets else "in place of"
        repair = f"write {_CLOSING[opening]!r} {relation} {bracket!r}"
        return _problem(text, position, message, repair)
    return _problem(text, position, f"a value is missing before {bracket!r}")


def _word_problem(text: str, position: int) -> JsonProblem:
    """Return the problem of a word that is not JSON."""
    rest = text[position:]
    if rest.startswith(_COMMENTS):
        return _problem(text, position, "JSON has no comments", "remove the comment")
    word = _WORD.match(rest)
    if word is None:
        return _problem(text, position, f"{_beginning(rest)} is unexpected")
    plain = word[0].strip("'")
    meant_word = _OTHER_WORDS.get(plain) or most_similar(plain, _OTHER_WORDS.values())
    repair = f"write {meant_word or json.dumps(plain, ensure_ascii=False)}"
    message = f"{excerpt(word[0], MAX_EXCERPT_LENGTH)} is not JSON"
    return _problem(text, position, message, repair)


def _problem(
    text: str, position: int, message: str, repair: str | None = None
) -> JsonProblem:
    return JsonProblem(*_line_and_column(text, position), message, repair)


def _end_problem(text: str) -> JsonProblem:
    """Return the problem of a text that ends before its last bracket."""
    open_brackets = _open_brackets(text, len(text))
    if not open_brackets:
        return _problem(text, len(text.rstrip()), "the JSON has no value")
    bracket = text[open_brackets[-1]]
    line = _line_and_column(text, open_brackets[-1])[0]
    message = f"the JSON ends too early: {bracket!r} of line {line} is not closed"
    return _problem(text, len(text.rstrip()), message)


def _line_and_column(text: str, position: int) -> tuple[int, int]:
    """Return line and column of a position, from 1."""
    line_start = text.rfind("\n", 0, position) + 1
    return text.count("\n", 0, position) + 1, position - line_start + 1


def _open_brackets(text: str, end: int) -> list[int]:
    """Return the positions of the brackets that are open at a position."""
    positions: list[int] = []
    for match in _TOKEN.finditer(text, 0, end):
        if match[0] in _CLOSING:
            positions.append(match.start())
        elif match[0] in "]}" and positions:
            positions.pop()
    return positions


def _beginning(rest: str) -> str:
    """Return the beginning of a text, for a message."""
    return excerpt(rest.partition("\n")[0].rstrip(), MAX_EXCERPT_LENGTH)
