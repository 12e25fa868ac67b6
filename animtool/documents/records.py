"""Models of files whose keys are fields of a record, each declared once: there."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import MISSING, fields
from inspect import get_annotations
from typing import Annotated, Any, Literal, TypeVar, get_args, get_type_hints

from annotated_types import Ge, Gt
from pydantic import Field, create_model

from animtool.documents.check import FileModel
from animtool.documents.fields import Real
from animtool.options import Key
from animtool.ranges import Range

Model = TypeVar("Model", bound=FileModel)
_TYPES: dict[Any, Any] = {float: Real, float | None: Real | None}


def with_fields(
    record: type[Any], *names: str, before: str = "", bounds: bool = False
) -> Callable[[type[Model]], type[Model]]:
    """Give a model the fields of a record as keys, beside its own.

    Args:
        record: A dataclass; the annotation of each field has a `Key`.
        names: Of the fields, in the order of the keys.
        before: Key that they come before; the last ones where none is named.
        bounds: Whether the model refuses what is out of a field's `Range`; else what
            reads the file checks the record.
    """

    def decorate(model: type[Model]) -> type[Model]:
        own: dict[str, Any] = {
            name: (model.model_fields[name].annotation, model.model_fields[name])
            for name in get_annotations(model)
        }
        at = list(own).index(before) if before else len(own)
        given = {name: _definition(record, name, bounds=bounds) for name in names}
        ahead, behind = list(own.items())[:at], list(own.items())[at:]
        made: Any = create_model(
            model.__name__,
            __base__=model.__base__,
            __module__=model.__module__,
            __doc__=model.__doc__,
            **dict([*ahead, *given.items(), *behind]),
        )
        return made  # type: ignore[no-any-return]

    return decorate


def _definition(record: type[Any], name: str, *, bounds: bool) -> tuple[Any, Any]:
    """Return the type of a key, and what documents it."""
    type_, *notes = get_args(get_type_hints(record, include_extras=True)[name])
    key = next(note for note in notes if isinstance(note, Key))
    type_ = Literal[key.choices] if key.choices else _TYPES[type_]
    for allowed in (note for note in notes if bounds and isinstance(note, Range)):
        limit = Ge(allowed.least) if allowed.reached else Gt(allowed.least)
        type_ = Annotated[type_, limit]
    (default,) = (each.default for each in fields(record) if each.name == name)
    described: dict[str, Any] = {} if default is MISSING else {"default": default}
    return type_, Field(
        description=key.description, examples=[key.example], **described
    )
