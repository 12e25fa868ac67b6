"""Values of keys of scenes and batches that are options."""

from __future__ import annotations

from collections.abc import Callable
from fractions import Fraction
from pathlib import Path
from typing import Any, TypeVar

from animtool.core.options import Kind, Place, keys_of, options_of
from animtool.core.rates import parse_rate
from animtool.core.record import dataclass
from animtool.core.shot import FrameRange
from animtool.core.units import LengthUnit, UpAxis, parse_length
from animtool.documents.check import FileModel
from animtool.documents.document import Document, Location
from animtool.documents.references import referred_input
from animtool.scene.file.option_text import parse_offsets

Value = TypeVar("Value")


@dataclass(frozen=True, slots=True)
class KeyReader:
    """Reads values of a file and records its faults."""

    document: Document
    roots: tuple[Path, ...]  # folders that files may be in
    code: str  # of a value that is none

    def parsed(
        self, at: Location, value: Any, parse: Callable[[Any], Value]
    ) -> Value | None:
        """Return a value, None of None; and a fault where it is none."""
        if value is None:
            return None
        try:
            return parse(value)
        except ValueError as error:
            self.document.add(getattr(error, "code", self.code), at, str(error))
            return None

    def read_file(self, at: Location, name: str) -> Path:
        """Return a file to read, which must be there."""
        path = referred_input(self.document, at, name, self.roots)
        return Path(name) if path is None else path


def option_keys(
    record: type[Any],
    model: FileModel,
    place: Place,
    at: Location,
    reader: KeyReader,
) -> dict[str, Any]:
    """Return the arguments of a record of options that the keys of a model give.

    Args:
        record: Of options.
        model: Of `with_fields`, of this place.
        place: The kind of file.
        at: Where the model is in its file.
        reader: Reads and records faults.
    """
    values, options = {}, options_of(record)
    for name, key in keys_of(record, place).items():
        given = getattr(model, key.alias or name)
        if given is not None:
            kind = options[name].kind
            value = _value(kind, given, (*at, key.alias or name), reader)
            if value is not None:
                values[name] = value
    return values


def _value(kind: Kind, value: Any, at: Location, reader: KeyReader) -> Any:
    """Return what a key means; None, and its fault recorded, where it means nothing."""
    if kind == "file":
        return reader.read_file(at, value)
    if kind == "lengths":
        lengths = {
            name: reader.parsed((*at, name), text, parse_length)
            for name, text in value.items()
        }
        return tuple((name, v) for name, v in lengths.items() if v is not None)
    parse = _PARSERS.get(kind)
    return value if parse is None else reader.parsed(at, value, parse)


def _offsets(numbers: list[float]) -> tuple[Fraction, ...]:
    return parse_offsets(",".join(map(repr, numbers))) if numbers else ()


def _range(ends: list[int]) -> FrameRange:
    first, last = ends
    if first > last:
        raise ValueError(f"the range from {first} to {last} is reversed")
    return FrameRange(first, last)


_PARSERS: dict[Kind, Callable[[Any], Any]] = {
    "unit": LengthUnit,
    "axis": UpAxis,
    "rate": parse_rate,
    "range": _range,
    "frame": Fraction,
    "offsets": _offsets,
    "length": parse_length,
}
