"""Finds typing mistakes that make a text invalid YAML.

The YAML scanner reports what it could not read next, often a line later. These checks
read the lines up to there for what the author most likely mistyped.
"""

from __future__ import annotations

import re
from typing import NamedTuple

# Characters that are read within about half a second.
MAX_SCANNED_CHARACTERS = 1_000_000
_CLOSING_BRACKETS = {"[": "]", "{": "}"}
_KEY_PATTERN = r"[A-Za-z_][\w.]*"
_BLOCK_TEXT = re.compile(r"(?:: |- |^)[|>][-+0-9]*\s*(?:#.*)?$")
_ENTRY_START = re.compile(rf"- |{_KEY_PATTERN}:(?:\s|$)")
_FLOW_KEY = re.compile(rf'({_KEY_PATTERN}|"[^"]*"):(?:\s|$)')
_UNSPACED_DASH = re.compile(r"-(?=[\[{\"'A-Za-z_])")
_UNSPACED_KEY = re.compile(rf"(?:- )*({_KEY_PATTERN}):(?![\s/\\])(\S.*)")
_UNSPACED_FLOW_KEY = re.compile(rf"({_KEY_PATTERN}):(?![\s/\\])([^,\]}}]+[\]}}]?)")
# What may follow a value in brackets, and one that is text.
_AFTER_VALUE = re.compile(r"\s*(?:[,\]}:]|#|$)")
_FLOW_TEXT = re.compile(r"(?:[^,\[\]{}#:]|:(?=\S)|(?<=\S)#)*")
# An alias with a name is reported as such by the parser.
_RESERVED_CHARACTER = re.compile(r"[@`%]|\*(?![\w-]+\s*(?:[,\]}]|$))")


class YamlFault(NamedTuple):
    """A fault of YAML syntax: message, line, column and hint."""

    message: str
    hint: str | None
    line: int  # from 1 on
    column: int


def find_typing_mistake(text: str, stop_line: int) -> YamlFault | None:
    r"""Return the first mistake in invalid YAML; None if it is not recognised.

    Args:
        text: The text.
        stop_line: Line at which the scanner stopped, from 1.

    >>> find_typing_mistake("a: {stem}.usdc\n", 1)[:2]
    ('a value that starts with { is a mapping', 'put it in quotes: "{stem}.usdc"')
    """
    if len(text) > MAX_SCANNED_CHARACTERS:
        return None
    is_cut = not text.endswith(("\n", "\r"))
    return _MistakeFinder(text.splitlines(), stop_line, is_cut=is_cut).find_fault()


def truncation_fault(lines: list[str], inside: str, remedy: str) -> YamlFault:
    """Return the fault of a text that ends inside a value, without a line end.

    >>> truncation_fault(["a: {b"], "'{'", "close it with '}'").message
    "the file ends here, inside '{'"
    """
    hint = f"if it is truncated, copy or export it again, otherwise {remedy}"
    message = f"the file ends here, inside {inside}"
    return YamlFault(message, hint, len(lines), len(lines[-1]) + 1)


class _MistakeFinder:
    """Reads lines as the YAML scanner does, and tracks open brackets and quotes."""

    def __init__(self, lines: list[str], stop_line: int, *, is_cut: bool) -> None:
        self.lines = lines
        self.is_cut = is_cut  # whether the last line has no line end
        self.stop_line = stop_line
        self.line_number = 0  # of the line, from 1
        self.line = ""
        # Bracket, line, column, indent.
        self.open_brackets: list[tuple[str, int, int, int]] = []
        self.open_quote: tuple[str, int, int] | None = None  # character, line, column
        # Line, column and last character of a value within brackets that has ended.
        self.ended_value: tuple[int, int, str] | None = None

    def find_fault(self) -> YamlFault | None:
        text_indent = None  # of the key whose value is a block of text
        for number, line in enumerate(self.lines[: self.stop_line], 1):
            self.line_number, self.line = number, line
            indent = len(line) - len(line.lstrip(" "))
            if text_indent is not None and (indent > text_indent or not line.strip()):
                continue
            text_indent = None
            fault = self._line_start_fault(indent) or self._fault_after_indent(indent)
            if fault is not None:
                return fault
            is_open = self.open_brackets or self.open_quote
            if not is_open and _BLOCK_TEXT.search(line):
                text_indent = indent
        if self.open_quote:
            quote, open_line, column = self.open_quote
            if self.is_cut and open_line == len(self.lines):
                closers = quote + self._closers()
                return truncation_fault(
                    self.lines, "a quote", f"close it with {closers}"
                )
            hint = f"close it with {quote} on the same line"
            return YamlFault("a quote is not closed", hint, open_line, column)
        if self.open_brackets and self.stop_line >= len(self.lines):
            if not self.is_cut:
                return self._unclosed_fault(len(self.lines))
            bracket, open_line, *_ = self.open_brackets[-1]
            line_text = "" if open_line == len(self.lines) else f" of line {open_line}"
            remedy = f"close it with '{self._closers()}'"
            return truncation_fault(self.lines, f"'{bracket}'{line_text}", remedy)
        return None

    def _closers(self) -> str:
        """Return the brackets that close all open ones, the innermost first."""
        open_brackets = [open_bracket for open_bracket, *_ in self.open_brackets]
        return "".join(_CLOSING_BRACKETS[b] for b in reversed(open_brackets))

    def _fault_here(self, message: str, hint: str, column: int) -> YamlFault:
        return YamlFault(message, hint, self.line_number, column + 1)

    def _line_start_fault(self, indent: int) -> YamlFault | None:
        """Return the typing mistake at the start of a line, if any."""
        line_text = self.line[indent:]
        if self.open_quote:
            return None
        if line_text.startswith("//"):
            message = "'//' does not start a comment"
            return self._fault_here(message, "write '#'", indent)
        if self.open_brackets:
            return self._line_in_brackets_fault(line_text, indent)
        if _UNSPACED_DASH.match(line_text):
            hint = f"write '- {line_text[1:].split(' ')[0]}'"
            return self._fault_here("no space after '-'", hint, indent)
        key = _UNSPACED_KEY.fullmatch(line_text.split(" #")[0].rstrip())
        if key and self._is_stop_line():
            return self._missing_space_fault(key[1], key[2], indent + key.start(1))
        return None

    def _line_in_brackets_fault(self, line_text: str, indent: int) -> YamlFault | None:
        """Return the mistake before a line that starts inside brackets, if any."""
        if indent <= self.open_brackets[0][3] and _ENTRY_START.match(line_text):
            return self._unclosed_fault(self.line_number - 1)
        line_above = self.line_number - 1
        text_above = re.sub(r"\s#.*", "", self.lines[line_above - 1]).rstrip()
        is_key = self.open_brackets[-1][0] == "{" and _FLOW_KEY.match(line_text)
        if not is_key or not text_above or text_above[-1] in ",{":
            return None
        message, hint = "no comma at the end of this line", f"write '{text_above[-1]},'"
        return YamlFault(message, hint, line_above, len(text_above) + 1)

    def _is_stop_line(self) -> bool:
        """Return whether the scanner stopped at this line or the next nonblank line."""
        lines_between = self.lines[self.line_number : self.stop_line - 1]
        return not any(line.split("#")[0].strip() for line in lines_between)

    def _missing_space_fault(self, key: str, value: str, column: int) -> YamlFault:
        short_value = value if len(value) <= 20 else value[:20] + "…"
        hint = f"write '{key}: {short_value}'"
        return self._fault_here(f"no space after '{key}:'", hint, column)

    def _unclosed_fault(self, line: int) -> YamlFault:
        """Return a fault for the innermost bracket that a line leaves open."""
        bracket, open_line, column, _ = self.open_brackets[-1]
        while line > open_line and not self.lines[line - 1].split("#")[0].strip():
            line -= 1
        end_text = "this line" if line == open_line else f"line {line}"
        hint = f"add '{self._closers()}' at the end of {end_text}"
        return YamlFault(f"'{bracket}' is not closed", hint, open_line, column)

    def _fault_after_indent(self, indent: int) -> YamlFault | None:
        """Return the first mistake in a line, and track its brackets and quotes."""
        line = self.line
        column = self._quoted_end(0) if self.open_quote else 0
        may_start_value = True  # whether a value may start
        while column < len(line):
            letter = line[column]
            if letter == "#" and (column == 0 or line[column - 1] in " \t"):
                return None
            if letter in " \t":
                column += 1
                continue
            fault = self._missing_comma_fault(letter)
            if fault is not None:
                return fault
            if letter in "[{" and (may_start_value or self.open_brackets):
                column_number = column + 1
                bracket = letter, self.line_number, column_number, indent
                self.open_brackets.append(bracket)
                may_start_value, column = True, column + 1
            elif letter in "]}" and self.open_brackets:
                fault = self._close_bracket(letter, column)
                may_start_value, column = False, column + 1
                ended_value = self.line_number, column, letter
                self.ended_value = ended_value if self.open_brackets else None
            elif letter in "\"'" and may_start_value:
                start, column = column, self._quoted_end(column)
                may_start_value, fault = False, self._after_quote_fault(start, column)
            elif may_start_value and _RESERVED_CHARACTER.match(line[column:]):
                fault = self._reserved_fault(column)
            else:
                if may_start_value and self.open_brackets:
                    fault = self._flow_key_fault(column)
                is_separator = bool(self.open_brackets) and letter == ","
                is_indicator = line[column : column + 2] in {": ", "- ", ":"}
                may_start_value = is_separator or is_indicator
                column += 1
            if fault is not None:
                return fault
        return None

    def _missing_comma_fault(self, letter: str) -> YamlFault | None:
        """Return a fault for a value that follows another one without a comma."""
        if self.ended_value is None:
            return None
        line, column, last_character = self.ended_value
        self.ended_value = None
        if letter in ",]}:":
            return None
        message = f"no comma after '{last_character}'"
        hint = f"write '{last_character},'"
        return YamlFault(message, hint, line, column)

    def _quoted_end(self, column: int) -> int:
        """Return the column after a quoted text; record a quote that stays open."""
        if self.open_quote:
            quote, start = self.open_quote[0], column
        else:
            quote, start = self.line[column], column + 1
        pattern = r"(?:[^\"\\]|\\.)*\"" if quote == '"' else r"(?:[^']|'')*'"
        match = re.compile(pattern).match(self.line, start)
        if match is None:
            self.open_quote = self.open_quote or (quote, self.line_number, column + 1)
            return len(self.line)
        self.open_quote = None
        if self.open_brackets:
            self.ended_value = self.line_number, match.end(), quote
        return match.end()

    def _close_bracket(self, letter: str, end_column: int) -> YamlFault | None:
        bracket, line, column, _ = self.open_brackets[-1]
        if letter != _CLOSING_BRACKETS[bracket]:
            closer = _CLOSING_BRACKETS[bracket]
            line_text = "this line" if line == self.line_number else f"line {line}"
            message = f"'{bracket}' in column {column} of {line_text} is not closed"
            hint = f"add '{closer}' before this '{letter}'"
            return self._fault_here(message, hint, end_column)
        self.open_brackets.pop()
        text_after = self.line[end_column + 1 :]
        if not self.open_brackets and re.match(r"\s*[\]}]", text_after):
            extra_column = end_column + 1 + len(text_after) - len(text_after.lstrip())
            message = f"'{self.line[extra_column]}' closes nothing"
            return self._fault_here(message, "remove it", extra_column)
        # If another value follows, a comma is missing.
        starts_value = self.open_brackets and text_after[:1] in " [{"
        if _AFTER_VALUE.match(text_after) or starts_value:
            return None
        has_space = text_after[:1] == " " or " " in self.line[column:end_column]
        if has_space or line != self.line_number:
            message = "text follows the closing bracket"
            hint = "remove it, or put all in quotes"
            return self._fault_here(message, hint, end_column + 1)
        name = "mapping" if bracket == "{" else "list"
        message = f"a value that starts with {bracket} is a {name}"
        hint = f'put it in quotes: "{self._scalar_text(column - 1)}"'
        return self._fault_here(message, hint, column - 1)

    def _scalar_text(self, column: int) -> str:
        """Return the text from a column to the likely end of its value."""
        value_text = re.sub(r"\s+#.*", "", self.line[column:]).rstrip()
        if not self.open_brackets:
            return value_text
        depth = 0
        for i, letter in enumerate(value_text):
            depth += (letter in "[{") - (letter in "]}")
            if depth < 0 or (depth == 0 and letter == ","):
                return value_text[:i].rstrip()
        return value_text

    def _after_quote_fault(self, start: int, column: int) -> YamlFault | None:
        """Return a fault if a text continues after its closing quote, else None."""
        text_after = self.line[column:]
        next_text = text_after.lstrip()
        starts_value = next_text[:1] in "\"'[{"
        if self.open_quote or starts_value or _AFTER_VALUE.match(text_after):
            return None
        value = self._scalar_text(start)
        hint = "put all of the value in quotes"
        if "'" not in value:
            hint = f"put all of it in single quotes: '{value}'"
        message = "text follows the closing quote"
        return self._fault_here(message, hint, len(self.line) - len(next_text))

    def _reserved_fault(self, column: int) -> YamlFault:
        message = f"a value cannot start with '{self.line[column]}'"
        hint = f'put it in quotes: "{self._scalar_text(column)}"'
        return self._fault_here(message, hint, column)

    def _flow_key_fault(self, column: int) -> YamlFault | None:
        """Return the mistake in a key or a value inside brackets, if any."""
        text_after = self.line[column:]
        match = _UNSPACED_FLOW_KEY.match(text_after)
        is_in_mapping = self.open_brackets[-1][0] == "{"
        if match and is_in_mapping and re.search(r"[{,]\s*$", self.line[:column]):
            return self._missing_space_fault(match[1], match[2], column)
        text = _FLOW_TEXT.match(text_after)
        key_match = re.search(rf"\s({_KEY_PATTERN}):(?:\s|$)", text_after)
        if text and key_match and key_match.start() < text.end():
            message = f"no comma before '{key_match[1]}:'"
            word_before = text_after[: key_match.start()].split()[-1]
            hint = f"write '{word_before}, {key_match[1]}:', or put a text in quotes"
            return self._fault_here(message, hint, column + key_match.start(1))
        return None
