"""Keys of scenes and batches that are options, read off their records."""

from __future__ import annotations

from collections.abc import Callable
from fractions import Fraction
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

from annotated_types import Ge, Len
from pydantic import Field, create_model

from animtool.core.options import Key, Kind, keys_of, options_of
from animtool.core.rates import parse_rate
from animtool.core.record import dataclass
from animtool.core.shot import FrameRange
from animtool.core.units import LengthUnit, UpAxis, parse_length
from animtool.documents.check import FileModel
from animtool.documents.document import Document, Location
from animtool.documents.fields import Frame, Name, Real, Whole, WholeFrame
from animtool.documents.references import referred_input
from animtool.scene.file.option_text import parse_offsets

Model = TypeVar("Model", bound=FileModel)
Value = TypeVar("Value")
FileKind = Literal["scene", "batch"]

# As a file writes a kind of option; what is not given is None, if nothing else is said.
_TYPES: dict[Kind, Any] = {
    "switch": bool,
    "answer": bool | None,
    "text": str | None,
    "file": Name | None,
    "unit": Literal["m", "cm", "mm", "in"] | None,
    "axis": Literal["Y", "Z"] | None,
    "rate": Real | str | None,
    "range": Annotated[list[WholeFrame], Len(2, 2)] | None,
    "frame": Frame | None,
    "offsets": list[Frame],
    "length": str | None,
    "lengths": dict[str, str],
    "count": Annotated[Whole, Ge(1)] | None,
}
_DEFAULTS: dict[Kind, Any] = {"switch": False, "offsets": [], "lengths": {}}


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


def with_keys(
    record: type[Any], place: FileKind, *order: str
) -> Callable[[type[Model]], type[Model]]:
    """Give a model the keys of a record of options, beside its own.

    Args:
        record: Of options, each with the `Key` of the place.
        place: The kind of file.
        order: Of all keys; others come last.
    """

    def decorate(model: type[Model]) -> type[Model]:
        definitions: dict[str, Any] = {
            name: (info.annotation, info) for name, info in model.model_fields.items()
        }
        for name, key in keys_of(record, place).items():
            kind = options_of(record)[name].kind
            definitions[key.alias or name] = _definition(kind, key)
        names = sorted(
            definitions, key=lambda n: order.index(n) if n in order else len(order)
        )
        model_type: Any = create_model(
            model.__name__,
            __base__=FileModel,
            __module__=model.__module__,
            __doc__=model.__doc__,
            **{name: definitions[name] for name in names},
        )
        return model_type  # type: ignore[no-any-return]

    return decorate


def _definition(kind: Kind, key: Key) -> tuple[Any, Any]:
    """Return the type of a key, and what documents it."""
    type_ = Literal[key.choices] | None if kind == "choice" else _TYPES[kind]
    described = Field(
        default=_DEFAULTS.get(kind),
        description=key.description,
        examples=[key.example],
    )
    return type_, described


def option_keys(
    record: type[Any],
    model: FileModel,
    place: FileKind,
    at: Location,
    reader: KeyReader,
) -> dict[str, Any]:
    """Return the arguments of a record of options that the keys of a model give.

    Args:
        record: Of options.
        model: Of `with_keys`.
        place: The kind of file.
        at: Where the model is in its file.
        reader: Reads and records faults.
    """
    values = {}
    for name, key in keys_of(record, place).items():
        given = getattr(model, key.alias or name)
        if given is not None:
            kind = options_of(record)[name].kind
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
