"""Renders reports as text, from records and line templates.

A template is a line with fields of the record in braces. A colon separates a field from
its printer (`DEFAULT_PRINTERS`, otherwise a format spec)::

    "  joints    {joints:n joint} below {roots:list 4}[, {channels:n channel}]"

Text in brackets is omitted if one of its fields is None or empty, or prints nothing; so
is a line. In ``[a|b]`` the first alternative with all its fields is used. ``{?name}``
and ``{!name}`` print nothing: they only test that a field is present or missing. Dots
access fields of fields, and ``{self}`` is the record. A bar passes the result of a
printer to another, as in ``{limits:most | list 8}``.

A name that no record has is an error; `tests/report/test_templates.py` checks all.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import field
from functools import cache
from typing import Any, TypeAlias

from animtool.core.clock import frame_label, span_label
from animtool.core.errors import counted, listed, percent_text
from animtool.core.quantities import (
    angle_text,
    duration_text,
    length_text,
    plain_number,
    size_text,
)
from animtool.core.rates import rate_label
from animtool.core.record import dataclass
from animtool.core.values import value_at_path


@dataclass(frozen=True, slots=True)
class Each:
    """Lines for each entry of a field; entry fields shadow those of the record.

    Attributes:
        name: Name of the field, with a printer after a colon if it has no entries
            itself; entries of a mapping have ``key`` and ``value``.
        lines: Templates of one entry; ``{self}`` is the entry, ``{number}`` counts
            them.
        max_entries: Maximum number of entries to print; None prints all.
        omitted: Line for ``{left}`` more entries.
    """

    name: str
    lines: tuple[Line, ...]
    max_entries: int | None = None
    omitted: str = ""


@dataclass(frozen=True, slots=True)
class Table:
    """Rows in columns for the entries of a field.

    Attributes:
        name: Name of the field.
        columns: Template of a cell by column header. Blanks around a header are not
            printed.
        left: Headers of left-aligned columns.
        optional: Headers of columns that are omitted if all their cells are empty.
        indent: Start of each line.
    """

    name: str
    columns: Mapping[str, str]
    left: Collection[str] = ()
    optional: Collection[str] = ()
    indent: str = ""


Line: TypeAlias = str | Each | Table
Printers: TypeAlias = Mapping[str, Callable[..., Any]]


# Names per line, unless all are requested.
MAX_LISTED_NAMES = 8
# Durations of stages, printed with `--verbose`.
SECONDS = Each("seconds", ("{key}: {value:.3f} s",))


@dataclass(frozen=True, slots=True)
class Template:
    """Text template that renders the records of one class, line by line.

    Attributes:
        record: The class, as ``module:name``.
        lines: Line templates.
        printers: Printers in addition to `DEFAULT_PRINTERS`.
        details: Line templates for verbose output.
        is_result: Whether its lines are the result of the command itself.
    """

    record: str
    lines: tuple[Line, ...]
    printers: Printers = field(default_factory=dict)
    details: tuple[Line, ...] = ()
    is_result: bool = False

    def text(self, record: object, *, all_names: bool = False) -> list[str]:
        """Return the lines of a record; ``all_names`` prints lists of names in full."""
        names = _names_printer(None if all_names else MAX_LISTED_NAMES)
        return render(record, self.lines, {**self.printers, "names": names})

    def detail_lines(self, record: object) -> list[str]:
        """Return the lines of a record for verbose output."""
        return render(record, self.details, self.printers)


def _names_printer(max_count: int | None) -> Callable[..., str]:
    def print_names(value: Any, default: str = "") -> str:
        return listed(list(value), max_count or int(default or len(value)))

    return print_names


def render(
    record: object, lines: Sequence[Line], printers: Printers | None = None
) -> list[str]:
    """Return the lines of a record.

    Args:
        record: A dataclass or a mapping.
        lines: Line templates.
        printers: Printers in addition to `DEFAULT_PRINTERS`.

    >>> lines = ["{path}: {joints:n joint}", "  notes  [{notes:list}|none]"]
    >>> render({"path": "a.bvh", "joints": 1, "notes": []}, lines)
    ['a.bvh: 1 joint', '  notes  none']
    """
    return list(_renderer(printers).lines((record,), lines))


def table_cells(
    record: object, table: Table, printers: Printers | None = None
) -> tuple[list[list[str]], set[int]]:
    """Return the cells of a table, header first, and which columns align left.

    Arguments as in `render`.
    """
    return _renderer(printers).cells((record,), table)


def _renderer(printers: Printers | None) -> _Renderer:
    return _Renderer({**DEFAULT_PRINTERS, **(printers or {})})


_Scope: TypeAlias = tuple[Any, ...]  # records, the innermost first


@dataclass(frozen=True, slots=True)
class _Renderer:
    """Formats the values of a record by their field names."""

    printers: Printers

    def lines(self, scope: _Scope, lines: Sequence[Line]) -> Iterator[str]:
        """Yield the lines of templates filled with the records in a scope."""
        for line in lines:
            if isinstance(line, str):
                text = self.fill_template(scope, _parse_template(line))
                if text or not line:
                    yield text or ""
            elif isinstance(line, Each):
                yield from self._each_lines(scope, line)
            else:
                yield from self._table_lines(scope, line)

    def _each_lines(self, scope: _Scope, line: Each) -> Iterator[str]:
        entries = self._field_entries(scope, line.name)
        for entry_number, entry in enumerate(entries[: line.max_entries], 1):
            yield from self.lines((entry, {"number": entry_number}, *scope), line.lines)
        omitted_count = len(entries) - (line.max_entries or len(entries))
        if omitted_count > 0:
            yield from self.lines(({"left": omitted_count}, *scope), (line.omitted,))

    def _field_entries(self, scope: _Scope, name: str) -> list[Any]:
        name, _, printer_names = name.partition(":")
        value = _find_value(scope, name)
        for printer in filter(None, printer_names.split(" | ")):
            value = None if value is None else self.printers[printer](value)
        if isinstance(value, Mapping):
            return [{"key": key, "value": entry} for key, entry in value.items()]
        return list(value or ())

    def _table_lines(self, scope: _Scope, table: Table) -> Iterator[str]:
        for text in aligned_lines(*self.cells(scope, table)):
            yield table.indent + text

    def cells(self, scope: _Scope, table: Table) -> tuple[list[list[str]], set[int]]:
        """Return the rows of a table, header first, and which columns align left."""
        templates = [_parse_template(cell) for cell in table.columns.values()]
        cell_texts = [
            [self.fill_template((entry, *scope), cell) or "" for cell in templates]
            for entry in self._field_entries(scope, table.name)
        ]
        shown_columns = {
            header: i
            for i, header in enumerate(table.columns)
            if header not in table.optional or any(row[i] for row in cell_texts)
        }
        rows = [[header.strip() for header in shown_columns]]
        rows += [[row[i] for i in shown_columns.values()] for row in cell_texts]
        return rows, {i for i, name in enumerate(shown_columns) if name in table.left}

    def fill_template(self, scope: _Scope, nodes: tuple[_Node, ...]) -> str | None:
        """Return the text of template nodes; None if a required field is missing."""
        texts = []
        for node in nodes:
            if isinstance(node, _Alternatives):
                part_texts = (self.fill_template(scope, part) for part in node.parts)
                texts.append(
                    next((part for part in part_texts if part is not None), "")
                )
                continue
            text = node if isinstance(node, str) else self._field_text(scope, node)
            if text is None:
                return None
            texts.append(text)
        return "".join(texts)

    def _field_text(self, scope: _Scope, node: _Field) -> str | None:
        """Return a field as text; None if missing, empty if only tested."""
        value = _find_value(scope, node.name)
        if node.test:
            return "" if bool(value) is (node.test == "?") else None
        alignment_spec = ""
        for spec in node.spec.split(" | "):
            if value is None or (hasattr(value, "__len__") and not len(value)):
                return None
            printer_name, *arguments = spec.split(" ")
            if printer_name not in self.printers:
                return format(value, spec)
            alignment_spec = (
                arguments.pop() if arguments and arguments[-1][0] in "<>" else ""
            )
            value = self.printers[printer_name](value, *arguments)
        return format(value, alignment_spec) or None


def aligned_lines(
    rows: Sequence[Sequence[str]], left_columns: Collection[int]
) -> list[str]:
    """Align rows of cells as lines; columns in ``left_columns`` are left-aligned."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return [
        "  ".join(
            cell.ljust(width) if i in left_columns else cell.rjust(width)
            for i, (cell, width) in enumerate(zip(row, widths, strict=True))
        ).rstrip()
        for row in rows
    ]


@dataclass(frozen=True, slots=True)
class _Field:
    """A field of a template, in braces."""

    name: str
    spec: str = ""
    test: str = ""  # `?` tests that it is present, `!` that it is missing; else printed


@dataclass(frozen=True, slots=True)
class _Alternatives:
    """Alternatives in brackets; the first one whose fields all exist is used."""

    parts: tuple[tuple[_Node, ...], ...]


_Node: TypeAlias = str | _Field | _Alternatives
_TOKEN = re.compile(r"\{([?!]?)([\w.]+)(?::([^{}]*))?\}|([\[|\]])|([^{}\[|\]]+)")


@cache
def _parse_template(template: str) -> tuple[_Node, ...]:
    return _parse_alternatives(template, iter(_TOKEN.finditer(template)), is_top=True)[
        0
    ]


def _parse_alternatives(
    template: str, tokens: Iterator[re.Match[str]], *, is_top: bool = False
) -> tuple[tuple[_Node, ...], ...]:
    """Parse tokens up to a closing bracket into alternatives, separated by bars."""
    alternatives: list[list[_Node]] = [[]]
    for token in tokens:
        test, name, spec, bracket, text = token.groups()
        if name is not None:
            alternatives[-1].append(_Field(name, spec or "", test))
        elif text is not None:
            alternatives[-1].append(text)
        elif bracket == "[":
            alternatives[-1].append(
                _Alternatives(_parse_alternatives(template, tokens))
            )
        elif bracket == "|" and not is_top:
            alternatives.append([])
        elif bracket == "]" and not is_top:
            break
        else:
            alternatives[-1].append(bracket)
    return tuple(tuple(nodes) for nodes in alternatives)


def _find_value(scope: _Scope, name: str) -> Any:
    """Return the field value of the innermost record that has the field."""
    field_name, _, attributes_path = name.partition(".")
    for record in scope:
        if field_name == "self":
            return value_at_path(record, attributes_path)
        is_mapping = isinstance(record, Mapping)
        if field_name in record if is_mapping else hasattr(record, field_name):
            return value_at_path(record, name)
    types_text = ", ".join(type(record).__name__ for record in scope)
    raise AttributeError(f"{types_text}: no field {field_name!r}")


def _count_text(value: Any, *nouns: str) -> str:
    count = len(value) if hasattr(value, "__len__") else int(value)
    noun, _, plural = " ".join(nouns).partition("/")
    return counted(count, noun, plural)


def _with_digits(printer: Callable[..., str], scale: float = 1.0) -> Callable[..., str]:
    def print_value(value: float, *digits: str) -> str:
        return printer(float(value) * scale, *map(int, digits))

    return print_value


# Printers by name, the first word after the colon in a template; the other words are
# their arguments.
DEFAULT_PRINTERS: dict[str, Callable[..., Any]] = {
    "n": _count_text,
    "len": lambda value: str(len(value)),
    "total": lambda value: str(sum(value.values())),
    "counts": lambda value: ", ".join(counted(n, noun) for noun, n in value.items()),
    "spans": lambda value: listed([span_label(*span) for span in value]),
    "g": lambda value, digits="6": f"{float(value):.{digits}g}",
    "list": lambda value, max_count="5": listed(list(value), int(max_count)),
    "join": lambda value: ", ".join(map(str, value)),
    "kinds": lambda value: ", ".join(f"{n} {kind}" for kind, n in value.items()),
    "corners": lambda value, digits="4": " to ".join(
        f"({', '.join(plain_number(coordinate, int(digits)) for coordinate in corner)})"
        for corner in value
    ),
    "plain": _with_digits(plain_number),
    "percent": percent_text,
    "length": _with_digits(length_text),
    "mm": _with_digits(plain_number, 1e3),
    "kB": lambda value: f"{value / 1e3:.0f}",
    "angle": lambda value, *digits: angle_text(math.degrees(value), *map(int, digits)),
    "degrees": lambda value, *digits: plain_number(
        math.degrees(value), *map(int, digits)
    ),
    "hundredths": _with_digits(plain_number, 100.0),
    "duration": _with_digits(duration_text),
    "size": _with_digits(size_text),
    "rate": rate_label,
    "frame": frame_label,
    "repr": repr,
}
