"""Placeholders for faulty values, which let validation continue."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin

from pydantic import BaseModel
from pydantic.fields import FieldInfo

from animtool.core.names import UNKNOWN
from animtool.documents.document import Location


def annotation_of(field: FieldInfo) -> Any:
    """Return the annotation of a field, as `Annotated` if it has constraints."""
    if not field.metadata:
        return field.annotation
    return Annotated[(field.annotation, *field.metadata)]


def value_at(value: Any, location: Iterable[str | int]) -> Any:
    """Return the value at a location, which must exist."""
    for step in location:
        value = value[step]
    return value


def _types_along(
    model: type[BaseModel], value: Any, location: Location
) -> Iterator[tuple[Any, Any]]:
    """Yield the expected type and the value from the root down to a location.

    Both are None where they are unknown or missing.
    """
    annotation: Any = model
    node = value
    yield annotation, node
    for step in location:
        annotation = inner_annotation(annotation, node, step)
        try:
            node = node[step]
        except (KeyError, IndexError, TypeError):
            node = None
        yield annotation, node


def annotation_at(model: type[BaseModel], value: Any, location: Location) -> Any:
    """Return the expected type at a location; None if it is unknown."""
    return list(_types_along(model, value, location))[-1][0]


def field_at(
    model: type[BaseModel], value: Any, location: Location
) -> tuple[int, FieldInfo] | None:
    """Return the innermost field that contains a location, and its depth."""
    innermost = None
    types = _types_along(model, value, location)
    steps = zip(location, types, strict=False)
    for depth, (step, (annotation, node)) in enumerate(steps, 1):
        for member in models_of(annotation, node):
            if str(step) in fields_of(member):
                innermost = depth, fields_of(member)[str(step)]
                break
    return innermost


def fields_at(model: type[BaseModel], value: Any, location: Location) -> list[str]:
    """Return the allowed keys of a mapping at a location."""
    node = value_at(value, location)
    models = models_of(annotation_at(model, value, location), node)
    return sorted({key for kind in models for key in fields_of(kind)})


def models_of(annotation: Any, node: Any = None) -> list[type[BaseModel]]:
    """Return the models of a type; of a tagged union, only the one a value names."""
    members = map(_without_constraints, _union_members(annotation))
    models = [k for k in members if isinstance(k, type) and issubclass(k, BaseModel)]
    return [member for member in models if _selects_model(member, node)] or models


def placeholder_of(annotation: Any) -> Any:
    """Return the simplest valid value of a type.

    >>> placeholder_of(float | None), placeholder_of(Literal["m", "cm"])
    (1.0, 'm')
    """
    min_length, number_value = 0, 1.0
    if get_origin(annotation) is Annotated:
        annotation, *constraints = get_args(annotation)
        min_length = max([getattr(c, "min_length", None) or 0 for c in constraints])
        bounds = [getattr(constraint, "le", None) for constraint in constraints]
        number_value = min([1.0, *(bound for bound in bounds if bound is not None)])
    models = models_of(annotation)
    if models:
        return _empty_values(min(models, key=lambda model: len(model.model_fields)))
    first_type = _union_members(annotation)[0]
    if get_origin(first_type) is Annotated:
        return placeholder_of(first_type)
    if get_origin(first_type) is Literal:
        return get_args(first_type)[0]
    if get_origin(first_type) is list:
        return [placeholder_of(get_args(first_type)[0])] * min_length
    if get_origin(first_type) is dict:
        return {UNKNOWN: placeholder_of(get_args(first_type)[1])} if min_length else {}
    return {str: UNKNOWN, float: number_value, int: 1, bool: False}.get(first_type)


def excludes_text(annotation: Any) -> bool:
    """Return whether a type allows only numbers and booleans.

    >>> excludes_text(float | None), excludes_text(float | str)
    (True, False)
    """
    members = map(_without_constraints, _union_members(annotation))
    return all(member in {float, int, bool} for member in members)


def set_value_at(value: Any, location: Location, new_value: Any) -> None:
    """Replace the value at a location, in the mapping or list that holds it."""
    *parent_location, last_step = location
    value_at(value, parent_location)[last_step] = new_value


def _empty_values(model: type[BaseModel]) -> dict[str, Any]:
    return {
        key: placeholder_of(annotation_of(field))
        for key, field in fields_of(model).items()
        if field.is_required()
    }


def fields_of(model: type[BaseModel]) -> dict[str, FieldInfo]:
    """Return the fields of a model by their keys in files."""
    return {info.alias or name: info for name, info in model.model_fields.items()}


def _selects_model(model: type[BaseModel], node: Any) -> bool:
    """Return whether the discriminator of a mapping names a model."""
    type_field = model.model_fields.get("type")
    if type_field is None or not isinstance(node, dict):
        return False
    return node.get("type") in get_args(type_field.annotation)


def inner_annotation(annotation: Any, node: Any, step: str | int) -> Any:
    """Return the type one step further inside: of a field, or of an element."""
    for model in models_of(annotation, node):
        field = fields_of(model).get(str(step))
        if field is not None:
            return annotation_of(field)
    for member in map(_without_constraints, _union_members(annotation)):
        if get_origin(member) is list and isinstance(step, int):
            return get_args(member)[0]
        if get_origin(member) is dict and isinstance(step, str):
            return get_args(member)[1]
    return None


def _without_constraints(annotation: Any) -> Any:
    is_constrained = get_origin(annotation) is Annotated
    return get_args(annotation)[0] if is_constrained else annotation


def _union_members(annotation: Any) -> list[Any]:
    """Return the members of a union without None, or the type itself."""
    inner_type = _without_constraints(annotation)
    if get_origin(inner_type) in {Union, UnionType}:
        members = [m for a in get_args(inner_type) for m in _union_members(a)]
        return [member for member in members if member is not NoneType]
    return [annotation]
