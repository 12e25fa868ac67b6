"""Messages for faults of YAML syntax."""

from __future__ import annotations

import re

from animtool.documents.yaml_mistakes import (
    YamlFault,
    find_typing_mistake,
    truncation_fault,
)

# An entry whose keys are on its line: `- trim: first: 5, last: 60`.
_ENTRY_ON_A_LINE = re.compile(r"\s*-\s+(\w+):\s+(\w+:\s[^#{}\[\]]*[^\s#{}\[\]])\s*")
# A condition as C has it: `x > 0.5 ? 90 : 0`.
_CONDITION = re.compile(r"\S\s*\?[^?{}\[\]]*\s:\s?$|\S\s*\?[^?{}\[\]]*\s:\s")
# Messages of libyaml's scanner, each with a message and a hint; the first match counts.
_SCANNER_FAULTS = {
    "expected ',' or ']'": ("a list in [ ] is not closed", "add a comma or ]"),
    "expected ',' or '}'": ("keys in { } are not closed", "add a comma or }"),
    "expected hexdecimal number": (
        "an escape in double quotes without its digits",
        "write a path with /, or in single quotes",
    ),
    "scanning a quoted scalar": ("a quote is not closed", "close it on the same line"),
    "unknown escape character": (
        "unknown escape in double quotes",
        "write / in paths, and \\\\ for a backslash",
    ),
    "cannot start any token": (
        "a value cannot start with this character",
        "put the value in quotes",
    ),
    "could not find expected ':'": ("a key has no colon", "write key: value"),
    "sequence entries are not allowed": (
        "a list cannot start on this line",
        "start the list on the next line, or write [a, b]",
    ),
    "control characters are not allowed": (
        "the file contains a control character",
        "remove it; is it a text file?",
    ),
    "document start": (
        "this line belongs to no key above it",
        "align it with the first line",
    ),
}


def yaml_fault(text: str, problem: str, line: int, column: int) -> YamlFault:
    r"""Return the message, hint and position for a text that is invalid YAML.

    Args:
        text: Content of the file.
        problem: Message of the YAML scanner.
        line: 1-based line of the fault.
        column: 1-based column of the fault.

    >>> yaml_fault("a: 1\n  b: 2\n", "mapping values are not allowed", 2, 4)[:2]
    ('line 2 is indented further than line 1', 'start it in column 1')
    """
    lines = text.splitlines() or [""]
    return (
        _tab_fault(lines, line)
        or find_typing_mistake(text, line)
        or _last_key_fault(text, lines, problem)
        or _missing_colon_fault(lines, problem, line)
        or _scanner_fault(lines, problem, line, column)
    )


def _tab_fault(lines: list[str], line: int) -> YamlFault | None:
    """Return a fault for a tab on the scanner's line or the line above, or None."""
    for line_number in (line, line - 1):
        source_line = lines[line_number - 1] if 1 <= line_number <= len(lines) else ""
        indent = source_line[: len(source_line) - len(source_line.lstrip())]
        if "\t" in indent:
            tab_column = indent.index("\t") + 1
            return YamlFault(
                "a tab indents this line", "use spaces", line_number, tab_column
            )
    return None


def _last_key_fault(text: str, lines: list[str], problem: str) -> YamlFault | None:
    """Return a fault for a key without a colon in the last line, or None."""
    last_line = _line_above(lines, len(lines) + 1)
    name = _bare_key(lines[last_line - 1]) if last_line else None
    if name is None or "could not find expected ':'" not in problem:
        return None
    hint = f"write '{name}: value'"
    if last_line == len(lines) and not text.endswith(("\n", "\r")):
        return truncation_fault(lines, f"the key '{name}'", hint)
    column = lines[last_line - 1].index(name) + 1
    return YamlFault("a key has no colon", hint, last_line, column)


def _missing_colon_fault(lines: list[str], problem: str, line: int) -> YamlFault | None:
    """Return a fault for a key without a colon above the scanner's position."""
    line_text = lines[min(line, len(lines)) - 1]
    line_above = _line_above(lines, line)
    text_above = lines[line_above - 1] if line_above else ""
    bare_key = _bare_key(text_above)
    is_indented = _indent_width(line_text) >= _indent_width(text_above)
    is_colon_missing = "could not find expected ':'" in problem
    is_colon_missing |= "mapping values" in problem and is_indented
    if bare_key is None or not is_colon_missing:
        return None
    name, _, remaining_text = bare_key.partition(" ")
    hint = f"write '{name}: {remaining_text.strip(' =') or 'value'}'"
    column = text_above.index(bare_key) + 1
    return YamlFault("a key has no colon", hint, line_above, column)


def _scanner_fault(lines: list[str], problem: str, line: int, column: int) -> YamlFault:
    """Return the fault that the scanner's own message describes."""
    if "mapping values are not allowed" in problem:
        line_text = lines[min(line, len(lines)) - 1]
        line_above = _line_above(lines, line)
        indent_above = _indent_width(lines[line_above - 1])
        if line_above and _indent_width(line_text) > indent_above:
            message = f"line {line} is indented further than line {line_above}"
            hint = f"start it in column {indent_above + 1}"
            return YamlFault(message, hint, line, column)
        entry = _ENTRY_ON_A_LINE.fullmatch(line_text)
        hint = "put the value in quotes"
        if entry is not None:
            hint = f"put its keys in braces: - {entry[1]}: {{{entry[2]}}}"
        return YamlFault("a value contains ': '", hint, line, column)
    if "expected key" in problem or "expected '-' indicator" in problem:
        return _indentation_fault(lines, line, column)
    line_text = lines[min(line, len(lines)) - 1]
    if "expected ',' or" in problem and _CONDITION.search(line_text[:column]):
        hint = "put the expression in quotes; smoothstep(low, high, x) stands for a "
        hint += "condition"
        message = "': ' in 'a ? b : c' separates a key from its value"
        return YamlFault(message, hint, line, column)
    known_fault = next((f for w, f in _SCANNER_FAULTS.items() if w in problem), None)
    message, hint_ = known_fault or (f"invalid YAML: {problem}", None)
    return YamlFault(message, hint_, line, column)


def _indentation_fault(lines: list[str], line: int, column: int) -> YamlFault:
    """Return a fault for a line whose indentation matches no line above it."""
    line_text = lines[min(line, len(lines)) - 1]
    indent, is_entry = _indent_width(line_text), line_text.lstrip().startswith("-")
    indents = [
        _indent_width(text)
        for text in lines[: line - 1]
        if text.strip() and text.lstrip().startswith("-") == is_entry
    ]
    nearest_indent = min(indents, key=lambda i: abs(i - indent), default=None)
    if nearest_indent is None or nearest_indent == indent:
        message = "this line does not belong to the block above it"
        return YamlFault(message, "align it with the lines of its block", line, column)
    column_text = f"in column {nearest_indent + 1}"
    message = f"this line starts in column {indent + 1}; the keys above it start "
    if is_entry:
        message = f"the '-' on this line is in column {indent + 1}; the others of this "
        message += "list are "
    return YamlFault(message + column_text, f"start it {column_text}", line, indent + 1)


def _bare_key(line: str) -> str | None:
    """Return the text of a line whose first word may lack a colon; else None."""
    match = re.fullmatch(r"[ -]*([A-Za-z_][^:#]*?)\s*(#.*)?", line)
    return match[1] if match else None


def _line_above(lines: list[str], line: int) -> int:
    """Return the number of the nearest nonblank line above; 0 if there is none."""
    for line_number in range(min(line, len(lines) + 1) - 1, 0, -1):
        if re.match(r"\s*[^\s#]", lines[line_number - 1]):
            return line_number
    return 0


def _indent_width(line: str) -> int:
    return len(line) - len(line.lstrip(" "))
