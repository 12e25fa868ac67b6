"""Types of keys, and models whose keys are fields of a record."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import MISSING, fields
from inspect import get_annotations
from typing import (
    Annotated,
    Any,
    Literal,
    TypeAlias,
    TypeVar,
    cast,
    get_args,
    get_origin,
    get_type_hints,
)

from annotated_types import Ge, Gt, Le, Len
from pydantic import Field, create_model
from pydantic_core import PydanticUndefined

from animtool.core.options import FileKind, Key, OptionKind, Range, keys_of, options_of
from animtool.documents.check import FileModel

# The largest number in a file, in its own unit. The square of one is held by float32,
# which USD has, in any unit; the product of sixteen by float64.
MAX_NUMBER = 1e18
# The smallest number above 0 where a key must be above 0. float32 rounds it to no zero;
# the product of eight is held by float64.
MIN_POSITIVE = 1e-36
# A year at 30 frames a second; time codes there are still apart by 1e-7.
MAX_FRAME = 1e9
# Whole numbers up to here are the same as floats.
MAX_WHOLE = 2**53
# Whole numbers among options, where a seed has 64 bits.
MAX_SEED = 2**64

Real = Annotated[float, Field(ge=-MAX_NUMBER, le=MAX_NUMBER)]
Whole = Annotated[int, Field(ge=-MAX_WHOLE, le=MAX_WHOLE)]
Frame = Annotated[float, Field(ge=-MAX_FRAME, le=MAX_FRAME)]
WholeFrame = Annotated[int, Field(ge=-int(MAX_FRAME), le=int(MAX_FRAME))]
Positive = Annotated[Real, Gt(0), Ge(MIN_POSITIVE)]
NotNegative = Annotated[Real, Ge(0)]
# Of bodies of a system.
Count = Annotated[Whole, Ge(1), Le(2 * 10**6)]
# On one line: control characters are in no text that is read. No path is longer.
Name = Annotated[str, Field(min_length=1, max_length=4096, pattern=r"^[^\n\t]*$")]
Pair = Annotated[list[Real], Len(2, 2)]
Vector = Annotated[list[Real], Len(3, 3)]
# w, x, y, z.
Quaternion = Annotated[list[Real], Len(4, 4)]


def key(text: str, example: Any, default: Any = PydanticUndefined) -> Any:
    """Return the field of a key: what it is, an example, and its value if not given.

    Without a default it must be given. `animtool.core.options.key` is that of a record.
    """
    return Field(default=default, description=text, examples=[example])


def check_numbers(value: Any) -> Any:
    """Return options as they are, where no number in them is beyond `MAX_NUMBER`.

    Raises:
        ValueError: One is, or is not finite.

    >>> check_numbers({"drag": [{"linear": 1e39}]})
    Traceback (most recent call last):
    ValueError: drag.linear is 1e+39, not a finite number up to 1e+18
    """
    for keys, number in _numbers(value, ()):
        most = MAX_NUMBER if isinstance(number, float) else MAX_SEED
        if not -most <= number <= most:
            name = ".".join(keys)
            shown = f"{number:g}" if isinstance(number, float) else _digits(number)
            allowed = f"a finite number up to {most:g}"
            raise ValueError(f"{name} is {shown}, not {allowed}")
    return value


def _digits(number: int) -> str:
    # The text of a very long number in decimals takes as long as the square of it.
    return f"{number:#x}"[:20] + "…"


def _numbers(
    value: Any, keys: tuple[str, ...]
) -> Iterator[tuple[tuple[str, ...], float]]:
    """Yield the numbers in mappings and lists, each with the keys that lead to it."""
    if isinstance(value, Mapping):
        for key, item in value.items():
            yield from _numbers(item, (*keys, str(key)))
    elif isinstance(value, list):
        for item in value:
            yield from _numbers(item, keys)
    elif isinstance(value, (int, float)) and not isinstance(value, bool):
        yield keys, value


class IgnoreModel(FileModel):
    """A finding of `animtool validate` that is known and stays."""

    code: str = Field(
        min_length=1, description="Code of the finding.", examples=["RIG201"]
    )
    where: str | None = Field(
        default=None,
        min_length=1,
        description="Location of the finding, or of something around it; list "
        "entries by number or name, `*` for any. Default: anywhere in "
        "the file.",
        examples=["joints[knee_l].limits"],
    )
    why: str = Field(
        min_length=1,
        description="Why it is accepted, for the next reader of the file.",
        examples=["this crouch is the rest pose"],
    )


Model = TypeVar("Model", bound=FileModel)
_TYPES: dict[Any, Any] = {
    float: Real,
    float | None: Real | None,
    int: Whole,
    Sequence[float] | None: Vector | None,
    Sequence[tuple[float, int]]: list[Pair],
}
# As a file writes a kind of option; what is not given is None, if nothing else is said.
_WRITTEN: dict[OptionKind, Any] = {
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
_DEFAULTS: dict[OptionKind, Any] = {"switch": False, "offsets": [], "lengths": {}}
Ranges: TypeAlias = Literal["record", "model", "schema"]


def with_fields(
    record: Any,
    *names: str,
    place: FileKind | None = None,
    order: Sequence[str] = (),
    before: str = "",
    ranges: Ranges = "record",
) -> Callable[[type[Model]], type[Model]]:
    """Give a model the fields of a record as keys, beside its own.

    What is infinite if it is not given is None in a file. Of what else a model has,
    class variables stay; methods are for a subclass.

    Args:
        record: A dataclass; the annotations of fields have a `Key`.
        names: Of the fields, in the order of the keys; none is each that has a `Key`
            and is none of the model yet.
        place: Kind of file, where the keys are those of the record's options.
        order: Of all keys; others come last. None is that of the record.
        before: Key that they come before; the last ones where none is named.
        ranges: Who checks the `Range` of a field: what reads the file on the record or
            on the model, or the model, which has it in its schema.
    """

    def decorate(model: type[Model]) -> type[Model]:
        own: dict[str, Any] = {
            name: (model.model_fields[name].annotation, model.model_fields[name])
            for name in get_annotations(model)
            if name in model.model_fields
        }
        at = list(own).index(before) if before else len(own)
        keys = keys_of(record, place)
        given = {}
        for name in names or keys:
            key = keys[name].alias or name
            if names or key not in model.model_fields:
                given[key] = _definition(record, name, keys[name], ranges)
        made = [*list(own.items())[:at], *given.items(), *list(own.items())[at:]]
        if order:
            made.sort(key=lambda e: order.index(e[0]) if e[0] in order else len(order))
        model_type: Any = create_model(
            model.__name__,
            __base__=model.__bases__,
            __module__=model.__module__,
            __doc__=model.__doc__,
            **dict(made),
        )
        for name in vars(model).keys() & model.__class_vars__:
            setattr(model_type, name, vars(model)[name])
        return model_type  # type: ignore[no-any-return]

    return decorate


Made = TypeVar("Made")


def record_of(record: type[Made], model: FileModel, **others: Any) -> Made:
    """Return a record of the fields that a model has too, and of others."""
    kind, given = cast(Any, record), others
    keys = keys_of(kind)
    for each in fields(kind):
        if each.name in others or each.name not in type(model).model_fields:
            continue
        value = getattr(model, each.name)
        if value is None and _endless(each.default):
            continue
        read = keys[each.name].read if each.name in keys else None
        given[each.name] = value if read is None else read(value)
    return record(**given)


def _endless(default: Any) -> bool:
    return isinstance(default, float) and math.isinf(default)


def _definition(record: Any, name: str, key: Key, ranges: Ranges) -> tuple[Any, Any]:
    """Return the type of a key, and what documents it."""
    type_, default = _typed(record, name, key, ranges)
    described: dict[str, Any] = {} if default is MISSING else {"default": default}
    return type_, Field(
        description=key.description, examples=[key.example], **described
    )


def _typed(record: Any, name: str, key: Key, ranges: Ranges) -> tuple[Any, Any]:
    """Return the type of a key, and its default."""
    option = options_of(record).get(name)
    if option is not None:
        kind = option.kind
        type_ = Literal[key.choices] | None if kind == "choice" else _WRITTEN[kind]
        return type_, _DEFAULTS.get(kind)
    hint = get_type_hints(record, include_extras=True)[name]
    type_, *notes = get_args(hint) if get_origin(hint) is Annotated else (hint,)
    type_ = Literal[key.choices] if key.choices else _TYPES.get(type_, type_)
    (default,) = (each.default for each in fields(record) if each.name == name)
    if _endless(default):
        type_, default = type_ | None, None
    elif default == ():
        default = []
    for note in notes:
        if isinstance(note, Range) and ranges == "schema":
            type_ = Annotated[type_, (Ge if note.reached else Gt)(note.least)]
        elif isinstance(note, Le) or (isinstance(note, Range) and ranges == "model"):
            type_ = Annotated[type_, note]
    return type_, default
