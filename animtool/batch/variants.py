"""Variants of a batch: a table of values, one item per row."""

from __future__ import annotations

import csv
import io
import itertools
import math
import re
from collections.abc import Collection, Iterator, Mapping, Sequence
from decimal import Decimal, InvalidOperation
from pathlib import Path

from animtool.core.arguments import argument
from animtool.core.errors import (
    Fault,
    FormatError,
    OptionError,
    counted,
    excerpt,
    first_faults,
)
from animtool.core.names import is_variable_name
from animtool.core.record import dataclass
from animtool.documents.document import read_text

# Maximum number of variants; a wrong step requests millions.
MAX_VARIANTS = 10_000
# Limits of a table; a file without line ends has one line of millions of characters.
MAX_COLUMNS = 1000
MAX_LINE_LENGTH = 1_000_000
# Number of reported faults of a table.
MAX_FAULTS = 100
TOO_MANY_TEXT = f"a batch has at most {MAX_VARIANTS} variants"
_RANGE_PATTERN = re.compile(
    r"(?P<first>[-+]?\d+(?:\.\d+)?)\.\.(?P<last>[^/.][^/]*)(?:/(?P<step>.+))?"
)
# A range of other tools: FIRST:LAST:STEP, FIRST:STEP:LAST or FIRST..LAST..STEP; and one
# of integers with a hyphen, which may also be a text.
_NUMBER = r"(-?(?:0|[1-9]\d*)(?:\.\d+)?)"
_OTHER_RANGE = re.compile(rf"{_NUMBER}(?::|\.\.){_NUMBER}(?::|\.\.){_NUMBER}")
_HYPHEN_RANGE = re.compile(r"(\d+)\s*[-:]\s*(\d+)")
_UNSAFE_CHARACTERS = re.compile(r"[^A-Za-z0-9_.+-]+")


@dataclass(frozen=True, slots=True)
class Variants:
    """A table of variables: one variant per row, with the value of each name."""

    # Values of every name for each variant, as text.
    rows: tuple[Mapping[str, str], ...]
    path: Path | None = None  # the source file; None if there is none

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the columns."""
        return tuple(self.rows[0])


def variants_of_columns(columns: Mapping[str, Sequence[str]]) -> Variants:
    """Return all combinations of column values; the last column changes fastest.

    >>> variants = variants_of_columns({"k": "12", "s": "ab"})
    >>> [row["k"] + row["s"] for row in variants.rows]
    ['1a', '1b', '2a', '2b']
    """
    variant_count = math.prod(map(len, columns.values())) if columns else 0
    if variant_count == 0:
        raise ValueError("a value is missing")
    if variant_count > MAX_VARIANTS:
        raise ValueError(f"{counted(variant_count, 'variant')}: {TOO_MANY_TEXT}")
    combinations = itertools.product(*columns.values())
    return Variants(tuple(dict(zip(columns, row, strict=True)) for row in combinations))


def variants_of_texts(texts: Sequence[str]) -> Variants:
    """Return all combinations of the values in texts such as ``k=1,2,5``.

    >>> variants_of_texts(["k=1..2", "s=a"]).rows
    ({'k': '1', 's': 'a'}, {'k': '2', 's': 'a'})
    """
    columns: dict[str, list[str]] = {}
    faults: list[Fault] = []
    names = [text.partition("=")[0].strip() for text in texts]
    problem_by_index = dict(name_problems(names))
    for i, (name, text) in enumerate(zip(names, texts, strict=True)):
        option_text = argument("vary", text)
        suggested_range = _translate_separated_range(text.partition("=")[2])
        hint = "write NAME=1,2,5 or NAME=1..20"
        hint = f"write {name}={suggested_range}" if suggested_range else hint
        if "=" not in text:
            message = f"{option_text}: the sign = is missing"
            faults.append(Fault("BAT064", message, hint=_assignment_hint(text)))
        elif i in problem_by_index:
            faults.append(
                Fault("BAT063", f"{option_text}: {problem_by_index[i]}", hint=hint)
            )
        else:
            try:
                columns[name] = values_of_text(text.partition("=")[2])
            except BackwardRangeError as error:
                message, hint = f"{option_text}: {error}", error.hint
                faults.append(Fault("BAT064", message, hint=hint))
            except ValueError as error:
                faults.append(Fault("BAT064", f"{option_text}: {error}", hint=hint))
    if not faults:
        try:
            return variants_of_columns(columns)
        except ValueError as error:
            faults.append(Fault("BAT065", f"{argument('vary')}: {error}"))
    raise OptionError(faults)


def _assignment_hint(text: str) -> str:
    """Return a hint for a text without ``=``.

    >>> _assignment_hint("wind 1 2"), _assignment_hint("wind")
    ('write wind=1,2', 'write wind=1,2,5 or wind=1..20')
    """
    if suggested_range := _translate_separated_range(text.strip()):
        return f"write NAME={suggested_range}"
    name, *values = re.split(r"[\s:,]+", text.strip())
    if not is_variable_name(name):
        name = "NAME"
    if values:
        return f"write {name}={','.join(values)}"
    return f"write {name}=1,2,5 or {name}=1..20"


def _translate_separated_range(text: str) -> str | None:
    """Convert a range with colons or dots to animtool's; None if it is not one.

    >>> texts = ("50:200:50", "50:50:200", "01:00:00")
    >>> tuple(map(_translate_separated_range, texts))
    ('50..200/50', '50..200/50', None)
    """
    match = _OTHER_RANGE.fullmatch(text)
    if match is None:
        return None
    first, middle, last = match.groups()
    if float(last) > float(middle) or float(middle) == 0:
        middle, last = last, middle
    return f"{first}..{middle}/{last}"


def translate_range(text: str) -> str | None:
    """Convert a range that may have a hyphen, too; None if it is not a range.

    >>> tuple(map(translate_range, ("1-4", "50:200:50", "2 - 12", "4-1", "walk-2")))
    ('1..4', '50..200/50', '2..12', None, None)
    """
    match = _HYPHEN_RANGE.fullmatch(text.strip())
    if match is None:
        return _translate_separated_range(text.strip())
    first, last = match.groups()
    return f"{first}..{last}" if int(first) < int(last) else None


def values_of_text(text: str) -> list[str]:
    """Return the values of a comma-separated list, with ranges expanded.

    >>> values_of_text("1..3,10"), values_of_text("0..1/0.25")
    (['1', '2', '3', '10'], ['0', '0.25', '0.5', '0.75', '1'])
    """
    values: list[str] = []
    for entry in (entry.strip() for entry in text.split(",")):
        match = _RANGE_PATTERN.fullmatch(entry)
        if match is None:
            problem = value_problem(entry)
            if problem is None and _translate_separated_range(entry) is not None:
                problem = f"{excerpt(entry)} is neither a value nor a range"
            if problem is not None:
                raise ValueError(problem)
            values.append(entry)
        else:
            values += range_values(match["first"], match["last"], match["step"] or "1")
        if len(values) > MAX_VARIANTS:
            raise ValueError(f"more values: {TOO_MANY_TEXT}")
    return values


class BackwardRangeError(ValueError):
    """A range whose step leads away from its last number.

    Attributes:
        hint: Ranges that could be meant, as text.
        key_hint: The same with the keys of files.

    >>> BackwardRangeError("4", "1", "1").hint
    'write 1..4, or 4..1/-1 to count down'
    """

    def __init__(self, first: str, last: str, step: str) -> None:
        """Compare the numbers of a range, given as text."""
        first, last, step = (text.strip() for text in (first, last, step))
        is_descending = Decimal(last) < Decimal(first)
        direction = "down" if is_descending else "up"
        super().__init__(f"{first}..{last} counts {direction}, but its step is {step}")
        low, high = (last, first) if is_descending else (first, last)
        step_size = step.lstrip("+-")
        ascending_range = f"{low}..{high}" + (
            "" if Decimal(step_size) == 1 else f"/{step_size}"
        )
        self.hint = (
            f"write {ascending_range}, or {high}..{low}/-{step_size} to count down"
        )
        self.key_hint = (
            f"write step: {'-' * is_descending}{step_size}, or exchange start and stop"
        )


def range_values(first: str, last: str, step: str = "1") -> list[str]:
    """Return the numbers of a range; the last is included if the steps reach it.

    >>> range_values("0", "0.3", "0.1"), range_values("3", "1", "-1")
    (['0', '0.1', '0.2', '0.3'], ['3', '2', '1'])
    """
    first_value, last_value, step_value = map(_parse_decimal, (first, last, step))
    if step_value == 0:
        raise ValueError(f"the step from {first} to {last} is 0")
    if (last_value - first_value) / step_value < 0:
        raise BackwardRangeError(first, last, step)
    value_count = int((last_value - first_value) / step_value) + 1
    if value_count > MAX_VARIANTS:
        raise ValueError(f"a range of {counted(value_count, 'value')}: {TOO_MANY_TEXT}")
    return [_decimal_text(first_value + i * step_value) for i in range(value_count)]


def _parse_decimal(text: str) -> Decimal:
    try:
        value = Decimal(text.strip())
    except InvalidOperation:
        value = Decimal("nan")
    # Other numbers have more digits than a float, or than memory.
    if "_" in text or not value.is_finite() or abs(value.adjusted()) > 300:
        raise ValueError(f"{excerpt(text)} is not a finite number")
    return value


def _decimal_text(value: Decimal) -> str:
    text = format(value, "f")
    return text.rstrip("0").rstrip(".") if "." in text else text


def value_problem(text: str) -> str | None:
    """Return why a value is invalid; None if it is valid.

    >>> value_problem("1e-3"), value_problem("nan")
    (None, "'nan' is not a finite number")
    """
    if not text.strip():
        return "a value is missing"
    try:
        number = float(text.strip().removeprefix("."))
    except ValueError:
        return None
    return None if math.isfinite(number) else f"{excerpt(text)} is not a finite number"


def name_problems(
    names: Sequence[str], reserved_names: Collection[str] = ()
) -> Iterator[tuple[int, str]]:
    """Yield the index of each invalid column name with the reason."""
    previous_names: set[str] = set()
    for i, name in enumerate(names):
        is_duplicate = name in previous_names
        previous_names.add(name)
        if not name:
            yield i, "a name is missing"
        elif not is_variable_name(name):
            yield i, f"{excerpt(name)} is not a name of letters, digits and _"
        elif name in reserved_names:
            yield i, f"{name!r} is reserved here"
        elif is_duplicate:
            yield i, f"there are two columns {name!r}"


def variant_pattern(variants: Variants | None) -> str:
    """Return the suffix of an output pattern that makes variants distinct.

    >>> variant_pattern(Variants(({"k": "1", "s": "2"},)))
    '_{k}_{s}'
    """
    return (
        "" if variants is None else "".join(f"_{{{name}}}" for name in variants.names)
    )


def file_name_part(value: str) -> str:
    """Return a value converted to a part of a file name.

    >>> file_name_part("a/b c"), file_name_part("../x"), file_name_part("-0.5")
    ('a_b_c', '_x', '-0.5')
    """
    return _UNSAFE_CHARACTERS.sub("_", value).lstrip(".") or "_"


def read_variants(path: Path) -> Variants:
    """Return the table of a CSV file: names in the first line, then a variant per line.

    Columns are separated by commas, in ``.tsv`` files by tabs. Blank lines are skipped.
    All faults of the file are raised at once, each with line and column.
    """
    separator = "\t" if path.suffix.lower() == ".tsv" else ","
    # One line more than allowed is enough to detect the excess.
    max_lines = MAX_VARIANTS + 2
    parsed_lines = _parse_lines(read_text(path), separator, path)
    lines = list(itertools.islice(parsed_lines, max_lines))
    if len(lines) < 2:
        message = "has no rows" if lines else "is empty"
        hint = "the first line names the columns; every other line is a variant"
        raise FormatError(Fault("BAT061", message, str(path), (1,), hint))
    (_, names, name_columns), *rows = lines
    separator_hint = None
    if len(names) == 1 and (";" in names[0] or "\t" in names[0]):
        separator_hint = "separate columns by commas, or by tabs in a .tsv file"
    header_location = (str(path), (lines[0][0],), separator_hint)
    faults = [
        Fault("BAT063", message, *header_location, column=name_columns[i])
        for i, message in name_problems(names)
    ]
    if len(rows) > MAX_VARIANTS:
        message = f"more rows: {TOO_MANY_TEXT}"
        faults.append(Fault("BAT065", message, str(path), (rows[MAX_VARIANTS][0],)))
        raise FormatError(faults)
    for line, values, value_columns in rows:
        if len(values) != len(names):
            message = f"{counted(len(values), 'value')} for {len(names)} columns"
            column = value_columns[min(len(values) - 1, len(names))]
            hint = f"columns: {', '.join(names)}"
            fault = Fault("BAT062", message, str(path), (line,), hint, column=column)
            faults.append(fault)
            continue
        for name, value, column in zip(names, values, value_columns, strict=True):
            problem = value_problem(value)
            if problem is not None:
                text = f"column {name!r}: {problem}"
                faults.append(Fault("BAT064", text, str(path), (line,), column=column))
    if faults:
        raise FormatError(first_faults(faults, MAX_FAULTS, str(path)))
    table = (dict(zip(names, values, strict=True)) for _, values, _ in rows)
    return Variants(tuple(table), path)


def _parse_lines(
    text: str, separator: str, path: Path
) -> Iterator[tuple[int, list[str], list[int]]]:
    """Yield the nonblank lines of a table: line number, values, and value columns."""
    for line_number, raw_line in enumerate(io.StringIO(text), 1):
        line = raw_line.removesuffix("\n").removesuffix("\r")
        if not line.strip(f" {separator}"):
            continue
        try:
            values = _parse_line(line, separator)
        except (csv.Error, ValueError) as error:
            message = f"cannot be read as a table: {error}"
            hint = "inside quotes, double a quote; values cannot contain line ends"
            fault = Fault("BAT061", message, str(path), (line_number,), hint, column=1)
            raise FormatError(fault) from error
        columns = _value_columns(line, separator)
        # Readers disagree on quotes inside a value.
        columns += columns[-1:] * (len(values) - len(columns))
        yield line_number, [value.strip() for value in values], columns


def _parse_line(line: str, separator: str) -> list[str]:
    """Split a line into its values; refuse lines and tables that are too wide."""
    if len(line) > MAX_LINE_LENGTH:
        raise ValueError(f"a line can have up to {MAX_LINE_LENGTH} characters")
    (values,) = csv.reader(io.StringIO(line), delimiter=separator, strict=True)
    if len(values) > MAX_COLUMNS:
        message = f"the table has {len(values)} columns; the limit is {MAX_COLUMNS}"
        raise ValueError(message)
    return values


def _value_columns(line: str, separator: str) -> list[int]:
    """Return the 1-based columns where the values of a line begin."""
    columns, is_quoted = [1], False
    for column, character in enumerate(line, 2):
        is_quoted ^= character == '"'
        if character == separator and not is_quoted:
            columns.append(column)
    return columns
