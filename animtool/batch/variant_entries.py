"""Reading the variants of a batch file."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from typing import Any

from animtool.batch.schema import RangeModel
from animtool.batch.variants import (
    MAX_VARIANTS,
    TOO_MANY,
    Variants,
    columns_variants,
    name_problems,
    range_values,
    value_problem,
    values_of_text,
)
from animtool.documents.document import Document, Location

AT = ("variants",)


def rows_of_document(
    document: Document, given: Any, taken: Collection[str]
) -> Variants | None:
    """Return the table of values in a batch file; None, and its faults, without one.

    Args:
        document: The file.
        given: Values by name, or a list of rows.
        taken: Names that mean something else already.
    """
    reader = _Reader(document, taken)
    before = len(document.faults)
    if isinstance(given, list):
        table = reader.rows(given)
    else:
        columns = reader.columns(given)
        # Of faulty values not all are there.
        table = None if len(document.faults) > before else reader.combined(columns)
    return None if len(document.faults) > before or document.doubtful(AT) else table


class _Reader:
    def __init__(self, document: Document, taken: Collection[str]) -> None:
        self.document, self.taken = document, taken

    def columns(self, given: Mapping[str, Any]) -> dict[str, list[str]]:
        """Return the values of each column."""
        self._check_names(AT, list(given))
        return {
            name: list(self._values((*AT, name), entry))
            for name, entry in given.items()
        }

    def combined(self, columns: Mapping[str, list[str]]) -> Variants | None:
        """Return every combination of the values of columns."""
        try:
            return columns_variants(columns)
        except ValueError as error:
            self.document.add("BAT065", AT, str(error))
            return None

    def rows(self, given: list[Mapping[str, Any]]) -> Variants | None:
        """Return the rows of a list."""
        if len(given) > MAX_VARIANTS:
            self.document.add("BAT065", AT, f"{len(given)} variants: {TOO_MANY}")
            return None
        first = list(given[0])
        self._check_names((*AT, 0), first)
        if not first:
            self.document.add("BAT061", (*AT, 0), "a row has no values")
        rows = []
        for i, entry in enumerate(given):
            if set(entry) != set(first):
                odd = ", ".join(sorted(set(entry) ^ set(first)))
                message = f"the columns are not those of the first row: {odd}"
                hint = f"columns: {', '.join(first)}"
                self.document.add("BAT062", (*AT, i), message, hint)
                continue
            rows.append({name: self._value((*AT, i, name), entry) for name in first})
        return Variants(tuple(rows))

    def _check_names(self, at: Location, names: list[str]) -> None:
        for i, message in name_problems(names, self.taken):
            self.document.add("BAT063", (*at, names[i]), message)

    def _values(self, at: Location, given: Any) -> Iterator[str]:
        """Yield the values of a column."""
        if isinstance(given, list):
            for i in range(len(given)):
                yield self._value((*at, i), given)
            return
        try:
            if isinstance(given, RangeModel):
                ends = {"start": given.start, "stop": given.stop, "step": given.step}
                yield from range_values(
                    *(self._text((*at, key), value) for key, value in ends.items())
                )
            else:
                yield from values_of_text(given)
        except ValueError as error:
            self.document.add("BAT064", at, str(error))

    def _value(self, at: Location, around: Any) -> str:
        """Return a value in a list or a row."""
        text = self._text(at, around[at[-1]])
        problem = value_problem(text)
        if problem is not None:
            self.document.add("BAT064", at, problem)
        return text

    def _text(self, at: Location, value: Any) -> str:
        """Return a value as it is written."""
        if isinstance(value, str):
            return value
        written = self.document.written(at)
        return written or str(value).lower()
