"""Types of keys in files, and models built from the fields of records."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import fields
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
from pydantic import BeforeValidator, Field, create_model

from animtool.core.options import FileKind, Key, OptionKind, Range, keys_of, options_of
from animtool.documents.check import FileModel, model_field
from animtool.documents.other_words import AXES

# Largest magnitude of a number in a file, in its own unit. Its square fits into
# float32, which USD uses, in any unit; a product of sixteen fits into float64.
MAX_NUMBER = 1e18
# Smallest positive number in a file where a key must be above 0. float32 does not round
# it to zero; a product of eight fits into float64.
MIN_POSITIVE = 1e-36
# A year at 30 frames a second; float64 time codes there still differ by 1e-7.
MAX_FRAME = 1e9
# Integers up to here are exact in float64.
MAX_INTEGER = 2**53
# Largest integer option; seeds have 64 bits.
MAX_SEED = 2**64

Real = Annotated[float, Field(ge=-MAX_NUMBER, le=MAX_NUMBER)]
Integer = Annotated[int, Field(ge=-MAX_INTEGER, le=MAX_INTEGER)]
Frame = Annotated[float, Field(ge=-MAX_FRAME, le=MAX_FRAME)]
IntegerFrame = Annotated[int, Field(ge=-int(MAX_FRAME), le=int(MAX_FRAME))]
Positive = Annotated[Real, Gt(0), Ge(MIN_POSITIVE)]
NonNegative = Annotated[Real, Ge(0)]
# A number of bodies.
Count = Annotated[Integer, Ge(1), Le(2 * 10**6)]
# A single line; no control characters, and no longer than the longest path.
Name = Annotated[str, Field(min_length=1, max_length=4096, pattern=r"^[^\n\t]*$")]
NumberPair = Annotated[list[Real], Len(2, 2)]
Vector = Annotated[list[Real], Len(3, 3)]


def _axis_to_vector(value: Any) -> Any:
    """Convert the name of an axis to its vector; return other values unchanged."""
    return AXES.get(value.upper(), value) if isinstance(value, str) else value


# A vector, or the name of an axis such as Z or -X.
_AxisName = Literal["X", "Y", "Z", "-X", "-Y", "-Z"]
Direction = Annotated[
    Vector, BeforeValidator(_axis_to_vector, json_schema_input_type=Vector | _AxisName)
]
# w, x, y, z.
Quaternion = Annotated[list[Real], Len(4, 4)]


def shared_key(text: str, example: Any) -> Any:
    """Return a field with the description and example of a key that models share."""
    return model_field(Key(text, example))


def check_numbers(value: Any) -> Any:
    """Return options unchanged; raise an error for numbers beyond `MAX_NUMBER`.

    >>> check_numbers({"drag": [{"linear": 1e39}]})
    Traceback (most recent call last):
    ValueError: drag.linear is 1e+39, not a finite number up to 1e+18
    """
    for keys, number in _numbers(value, ()):
        limit = MAX_NUMBER if isinstance(number, float) else MAX_SEED
        if not -limit <= number <= limit:
            name = ".".join(keys)
            # Formatting a very long integer as decimal takes quadratic time.
            is_float = isinstance(number, float)
            number_text = f"{number:g}" if is_float else f"{number:#x}"[:20] + "…"
            message = f"{name} is {number_text}, not a finite number up to {limit:g}"
            raise ValueError(message)
    return value


def _numbers(
    value: Any, keys: tuple[str, ...]
) -> Iterator[tuple[tuple[str, ...], float]]:
    """Yield every number in nested mappings and lists, with the keys above it."""
    if isinstance(value, Mapping):
        for key, nested_value in value.items():
            yield from _numbers(nested_value, (*keys, str(key)))
    elif isinstance(value, list):
        for nested_value in value:
            yield from _numbers(nested_value, keys)
    elif isinstance(value, (int, float)) and not isinstance(value, bool):
        yield keys, value


class IgnoreModel(FileModel):
    """An accepted finding of `animtool validate`."""

    code: str = Field(
        min_length=1, description="Code of the finding.", examples=["RIG201"]
    )
    where: str | None = Field(
        default=None,
        min_length=1,
        description="Location of the finding, or of something around it; list "
        "entries by number or name, `*` for any. Default: anywhere in the file.",
        examples=["joints[knee_l].limits"],
    )
    why: str = Field(
        min_length=1,
        description="Why it is accepted, for the next reader of the file.",
        examples=["this crouch is the rest pose"],
    )


Model = TypeVar("Model", bound=FileModel)
_KEY_TYPES: dict[Any, Any] = {
    float: Real,
    float | None: Real | None,
    int: Integer,
    Sequence[float] | None: Vector | None,
    Sequence[tuple[float, int]]: list[NumberPair],
}
# Type of a key by kind of option; None is the default of optional ones.
_FILE_TYPES: dict[OptionKind, Any] = {
    "switch": bool,
    "answer": bool | None,
    "text": str | None,
    "file": Name | None,
    "unit": Literal["m", "cm", "mm", "in"] | None,
    "axis": Literal["Y", "Z"] | None,
    "rate": Real | str | None,
    "range": Annotated[list[IntegerFrame], Len(2, 2)] | None,
    "frame": Frame | None,
    "offsets": list[Frame],
    "length": str | None,
    "lengths": dict[str, str],
    "count": Annotated[Integer, Ge(1)] | None,
}
_DEFAULT_BY_KIND: dict[OptionKind, Any] = {
    "switch": False,
    "offsets": [],
    "lengths": {},
}
RangeCheck: TypeAlias = Literal["record", "model", "schema"]


def with_fields(
    record: Any,
    *names: str,
    file_kind: FileKind | None = None,
    order: Sequence[str] = (),
    before_key: str = "",
    range_check: RangeCheck = "record",
) -> Callable[[type[Model]], type[Model]]:
    """Return a decorator that adds the fields of a record to a model as keys.

    Infinite defaults are None in files. Class variables of the model stay;
    methods belong in a subclass.

    Args:
        record: A dataclass whose fields are declared by `key` or `option`.
        names: Fields, in the order of the keys; empty for every field with a key
            that the model lacks.
        file_kind: Kind of file whose names of the record's options are used.
        order: Order of keys; others come last. Empty keeps the record's order.
        before_key: Key to insert them before; empty appends them.
        range_check: Where the `Range` of a field is checked: by the reader of the
            file on the record or on the model, or by the model's schema.
    """

    def decorate(model: type[Model]) -> type[Model]:
        declared_keys: dict[str, Any] = {
            name: (model.model_fields[name].annotation, model.model_fields[name])
            for name in get_annotations(model)
            if name in model.model_fields
        }
        entries = list(declared_keys.items())
        index = list(declared_keys).index(before_key) if before_key else len(entries)
        keys = keys_of(record, file_kind)
        new_fields: dict[str, Any] = {}
        for name in names or keys:
            key = keys[name].alias or name
            if names or key not in model.model_fields:
                type_, default = _type_and_default(
                    record, name, keys[name], range_check
                )
                new_fields[key] = type_, model_field(keys[name], default)
        field_definitions = [*entries[:index], *new_fields.items(), *entries[index:]]
        ranks = {key: rank for rank, key in enumerate(order)}
        field_definitions.sort(key=lambda entry: ranks.get(entry[0], len(order)))
        model_type: Any = create_model(
            model.__name__,
            __base__=model.__bases__,
            __module__=model.__module__,
            __doc__=model.__doc__,
            **dict(field_definitions),
        )
        for name in vars(model).keys() & model.__class_vars__:
            setattr(model_type, name, vars(model)[name])
        return model_type  # type: ignore[no-any-return]

    return decorate


RecordT = TypeVar("RecordT")


def record_from_model(
    record: type[RecordT], model: FileModel, **extra_arguments: Any
) -> RecordT:
    """Return a record built from a model's equally named fields and extra arguments."""
    record_type, arguments = cast(Any, record), extra_arguments
    keys = keys_of(record_type)
    for record_field in fields(record_type):
        name = record_field.name
        if name in extra_arguments or name not in type(model).model_fields:
            continue
        value = getattr(model, name)
        if value is None and _is_infinite(record_field.default):
            continue
        convert = keys[name].read if name in keys else None
        arguments[name] = value if convert is None else convert(value)
    return record(**arguments)


def _is_infinite(default: Any) -> bool:
    return isinstance(default, float) and math.isinf(default)


def _type_and_default(
    record: Any, name: str, key: Key, range_check: RangeCheck
) -> tuple[Any, Any]:
    """Return the type and default of the file key for a record's field."""
    option = options_of(record).get(name)
    if option is not None:
        kind = option.kind
        type_ = Literal[key.choices] | None if kind == "choice" else _FILE_TYPES[kind]
        return type_, _DEFAULT_BY_KIND.get(kind)
    annotation = get_type_hints(record, include_extras=True)[name]
    type_, *constraints = (
        get_args(annotation) if get_origin(annotation) is Annotated else (annotation,)
    )
    type_ = Literal[key.choices] if key.choices else _KEY_TYPES.get(type_, type_)
    (default,) = (r.default for r in fields(record) if r.name == name)
    if _is_infinite(default):
        type_, default = type_ | None, None
    elif default == ():
        default = []
    for constraint in constraints:
        is_range = isinstance(constraint, Range)
        if is_range and range_check == "schema":
            minimum_type = Ge if constraint.includes_minimum else Gt
            type_ = Annotated[type_, minimum_type(constraint.minimum)]
        elif isinstance(constraint, Le) or (is_range and range_check == "model"):
            type_ = Annotated[type_, constraint]
    return type_, default
