"""Locate typing mistakes that make a text invalid YAML.

The YAML scanner reports what it could not read next, often a line later. These checks
read the lines up to there for what the author most likely mistyped.
"""

from __future__ import annotations

import re
from typing import NamedTuple

# Characters that are read within about half a second.
MAX_SCANNED_CHARACTERS = 1_000_000
_CLOSING_BRACKETS = {"[": "]", "{": "}"}
_KEY = r"[A-Za-z_][\w.]*"
_BLOCK_TEXT = re.compile(r"(?:: |- |^)[|>][-+0-9]*\s*(?:#.*)?$")
_ENTRY = re.compile(rf"- |{_KEY}:(?:\s|$)")
_FLOW_KEY = re.compile(rf'({_KEY}|"[^"]*"):(?:\s|$)')
_TIGHT_DASH = re.compile(r"-(?=[\[{\"'A-Za-z_])")
_TIGHT_KEY = re.compile(rf"(?:- )*({_KEY}):(?![\s/\\])(\S.*)")
# What may follow a value in brackets, and one that is text.
_AFTER_VALUE = re.compile(r"\s*(?:[,\]}:]|#|$)")
_FLOW_TEXT = re.compile(r"(?:[^,\[\]{}#:]|:(?=\S)|(?<=\S)#)*")
# An alias with a name is reported as such by the parser.
_RESERVED_CHARACTER = re.compile(r"[@`%]|\*(?![\w-]+\s*(?:[,\]}]|$))")


class YamlFault(NamedTuple):
    """A syntax fault: message, line, column and hint."""

    message: str
    hint: str | None
    line: int  # from 1 on
    column: int


def find_slip(text: str, stop: int) -> YamlFault | None:
    r"""Return the first mistake in invalid YAML; None if it is not recognised.

    Args:
        text: The text.
        stop: Line at which the scanner stopped, from 1.

    >>> find_slip("a: {stem}.usdc\n", 1)[:2]
    ('a value that starts with { is a mapping', 'put it in quotes: "{stem}.usdc"')
    """
    if len(text) > MAX_SCANNED_CHARACTERS:
        return None
    return _SlipFinder(text.splitlines(), stop).find()


class _SlipFinder:
    """Reads lines as the scanner does, with the brackets that are open."""

    def __init__(self, lines: list[str], stop: int) -> None:
        self.lines = lines
        self.stop = stop
        self.number = 0  # of the line, from 1
        self.line = ""
        self.open: list[tuple[str, int, int, int]] = []  # bracket, line, column, indent
        self.quote: tuple[str, int, int] | None = None  # character, line, column
        # Line, column and last character of a value within brackets that has ended.
        self.ended: tuple[int, int, str] | None = None

    def find(self) -> YamlFault | None:
        text_indent = None  # of the key whose value is a block of text
        for number, line in enumerate(self.lines[: self.stop], 1):
            self.number, self.line = number, line
            indent = len(line) - len(line.lstrip(" "))
            if text_indent is not None and (indent > text_indent or not line.strip()):
                continue
            text_indent = None
            slip = self._line_start(indent) or self._slip_after_indent(indent)
            if slip is not None:
                return slip
            if not self.open and not self.quote and _BLOCK_TEXT.search(line):
                text_indent = indent
        if self.quote:
            quote, opened, column = self.quote
            hint = f"close it with {quote} on the same line"
            return YamlFault("a quote is not closed", hint, opened, column)
        if self.open and self.stop >= len(self.lines):
            return self._unclosed_fault(len(self.lines))
        return None

    def _slip(self, message: str, hint: str, column: int) -> YamlFault:
        return YamlFault(message, hint, self.number, column + 1)

    def _line_start(self, indent: int) -> YamlFault | None:
        """Return the slip in how a line starts."""
        rest = self.line[indent:]
        if self.quote is None and rest.startswith("//"):
            return self._slip("'//' does not start a comment", "write '#'", indent)
        if self.quote or self.open:
            return None if self.quote else self._line_inside(rest, indent)
        if _TIGHT_DASH.match(rest):
            hint = f"write '- {rest[1:].split(' ')[0]}'"
            return self._slip("no space after '-'", hint, indent)
        key = _TIGHT_KEY.fullmatch(rest.split(" #")[0].rstrip())
        if key and self._is_last():
            return self._tight_fault(key[1], key[2], indent + key.start(1))
        return None

    def _line_inside(self, rest: str, indent: int) -> YamlFault | None:
        """Return the slip before a line that starts within brackets."""
        if indent <= self.open[0][3] and _ENTRY.match(rest):
            return self._unclosed_fault(self.number - 1)
        line_above = self.number - 1
        before = re.sub(r"\s#.*", "", self.lines[line_above - 1]).rstrip()
        is_key = self.open[-1][0] == "{" and _FLOW_KEY.match(rest)
        if not is_key or not before or before[-1] in ",{":
            return None
        message, hint = "no comma at the end of this line", f"write '{before[-1]},'"
        return YamlFault(message, hint, line_above, len(before) + 1)

    def _is_last(self) -> bool:
        """Return whether the scanner stopped at this line or the next with text."""
        between = self.lines[self.number : self.stop - 1]
        return not any(line.split("#")[0].strip() for line in between)

    def _tight_fault(self, key: str, value: str, column: int) -> YamlFault:
        short = value if len(value) <= 20 else value[:20] + "…"
        return self._slip(f"no space after '{key}:'", f"write '{key}: {short}'", column)

    def _unclosed_fault(self, line: int) -> YamlFault:
        """Return the fault of the innermost bracket that is open at a line's end."""
        bracket, start, column, _ = self.open[-1]
        while line > start and not self.lines[line - 1].split("#")[0].strip():
            line -= 1
        end = "this line" if line == start else f"line {line}"
        closers = "".join(_CLOSING_BRACKETS[each[0]] for each in reversed(self.open))
        hint = f"add '{closers}' at the end of {end}"
        return YamlFault(f"'{bracket}' is not closed", hint, start, column)

    def _slip_after_indent(self, indent: int) -> YamlFault | None:
        """Return the first mistake in a line; update the open brackets and quotes."""
        line = self.line
        column = self._quoted_end(0) if self.quote else 0
        fresh = True  # whether a value may start
        while column < len(line):
            letter = line[column]
            if letter == "#" and (column == 0 or line[column - 1] in " \t"):
                return None
            if letter in " \t":
                column += 1
                continue
            slip = self._missing_comma_fault(letter)
            if slip is not None:
                return slip
            if letter in "[{" and (fresh or self.open):
                self.open.append((letter, self.number, column + 1, indent))
                fresh, column = True, column + 1
            elif letter in "]}" and self.open:
                slip = self._close_bracket(letter, column)
                fresh, column = False, column + 1
                self.ended = (self.number, column, letter) if self.open else None
            elif letter in "\"'" and fresh:
                start, column = column, self._quoted_end(column)
                fresh, slip = False, self._after_quote_fault(start, column)
            elif fresh and _RESERVED_CHARACTER.match(line[column:]):
                slip = self._reserved_fault(column)
            else:
                slip = self._flow_key_slip(column) if fresh and self.open else None
                fresh = bool(self.open and letter == ",")
                fresh = fresh or line[column : column + 2] in {": ", "- ", ":"}
                column += 1
            if slip is not None:
                return slip
        return None

    def _missing_comma_fault(self, letter: str) -> YamlFault | None:
        """Return the fault of a value that starts right after another."""
        if self.ended is None:
            return None
        line, column, last = self.ended
        self.ended = None
        if letter in ",]}:":
            return None
        message, hint = f"no comma after '{last}'", f"write '{last},'"
        return YamlFault(message, hint, line, column)

    def _quoted_end(self, column: int) -> int:
        """Return the end of a quoted text; note one that does not end here."""
        if self.quote:
            quote, start = self.quote[0], column
        else:
            quote, start = self.line[column], column + 1
        pattern = r"(?:[^\"\\]|\\.)*\"" if quote == '"' else r"(?:[^']|'')*'"
        match = re.compile(pattern).match(self.line, start)
        if match is None:
            self.quote = self.quote or (quote, self.number, column + 1)
            return len(self.line)
        self.quote = None
        if self.open:
            self.ended = self.number, match.end(), quote
        return match.end()

    def _close_bracket(self, letter: str, end_column: int) -> YamlFault | None:
        bracket, line, column, _ = self.open[-1]
        if letter != _CLOSING_BRACKETS[bracket]:
            closer = _CLOSING_BRACKETS[bracket]
            place = "this line" if line == self.number else f"line {line}"
            message = f"'{bracket}' in column {column} of {place} is not closed"
            return self._slip(
                message, f"add '{closer}' before this '{letter}'", end_column
            )
        self.open.pop()
        rest = self.line[end_column + 1 :]
        if not self.open and re.match(r"\s*[\]}]", rest):
            extra = end_column + 1 + len(rest) - len(rest.lstrip())
            message = f"'{self.line[extra]}' closes nothing"
            return self._slip(message, "remove it", extra)
        if _AFTER_VALUE.match(rest) or (self.open and rest[:1] in " [{"):
            return None  # if it is another value, a comma is missing
        if (
            line != self.number
            or rest[:1] == " "
            or " " in self.line[column:end_column]
        ):
            message, hint = "text follows the closing bracket", "remove it"
            return self._slip(message, f"{hint}, or put all in quotes", end_column + 1)
        name = "mapping" if bracket == "{" else "list"
        message = f"a value that starts with {bracket} is a {name}"
        hint = f'put it in quotes: "{self._scalar_text(column - 1)}"'
        return self._slip(message, hint, column - 1)

    def _scalar_text(self, column: int) -> str:
        """Return the text from a column to the likely end of its value."""
        rest = re.sub(r"\s+#.*", "", self.line[column:]).rstrip()
        if not self.open:
            return rest
        depth = 0
        for i, letter in enumerate(rest):
            depth += (letter in "[{") - (letter in "]}")
            if depth < 0 or (depth == 0 and letter == ","):
                return rest[:i].rstrip()
        return rest

    def _after_quote_fault(self, start: int, column: int) -> YamlFault | None:
        """Return the fault of text that continues after a quote."""
        rest = self.line[column:]
        if self.quote or _AFTER_VALUE.match(rest) or rest.lstrip()[:1] in "\"'[{":
            return None
        value = self._scalar_text(start)
        hint = "put all of the value in quotes"
        if "'" not in value:
            hint = f"put all of it in single quotes: '{value}'"
        message = "text follows the closing quote"
        return self._slip(message, hint, column + len(rest) - len(rest.lstrip()))

    def _reserved_fault(self, column: int) -> YamlFault:
        message = f"a value cannot start with '{self.line[column]}'"
        hint = f'put it in quotes: "{self._scalar_text(column)}"'
        return self._slip(message, hint, column)

    def _flow_key_slip(self, column: int) -> YamlFault | None:
        """Return the slip in a key or a value within brackets."""
        rest = self.line[column:]
        tight = re.match(rf"({_KEY}):(?![\s/\\])([^,\]}}]+[\]}}]?)", rest)
        is_key = self.open[-1][0] == "{" and re.search(r"[{,]\s*$", self.line[:column])
        if tight and is_key:
            return self._tight_fault(tight[1], tight[2], column)
        text = _FLOW_TEXT.match(rest)
        lost = re.search(rf"\s({_KEY}):(?:\s|$)", rest)
        if text and lost and lost.start() < text.end():
            message = f"no comma before '{lost[1]}:'"
            before = rest[: lost.start()].split()[-1]
            hint = f"write '{before}, {lost[1]}:', or put a text in quotes"
            return self._slip(message, hint, column + lost.start(1))
        return None
