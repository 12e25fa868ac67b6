"""The right form of a value that was written in another one."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import field
from typing import Any, get_args, get_origin

from pydantic import BaseModel

from animtool.core.record import dataclass
from animtool.documents.document import Location
from animtool.documents.placeholders import (
    annotation_of,
    field_at,
    fields_of,
    models_of,
)
from animtool.documents.yaml_text import flow_text

# A longer example is no help on one line.
MAX_FORM = 100


@dataclass(frozen=True, slots=True)
class Forms:
    """Examples of the options of each name that a mapping of one entry may have."""

    options: Mapping[str, Any] = field(hash=False)


def form_hint(
    model: type[BaseModel], value: Any, location: Location, *, listed: bool
) -> str | None:
    """Return how the key around a value is written; None where no example is short.

    Args:
        model: What the document should be.
        value: The document.
        location: Of the value.
        listed: Whether a list is wanted.
    """
    found = field_at(model, value, location)
    if found is None:
        return None
    depth, info = found
    given = value
    for step in location:
        given = given[step]
    examples = info.examples or [None]
    example, rest = examples[0], location[depth:]
    if listed and isinstance(given, dict) and not rest:
        example = [given]
    forms = _forms(annotation_of(info))
    name = rest[0] if rest else given
    if forms is not None and isinstance(name, str) and name in forms.options:
        example = {name: forms.options[name]}
    elif isinstance(given, str) and _takes_file(annotation_of(info)):
        # Of a list, the entry.
        several = rest or not models_of(annotation_of(info))
        example = [{"file": given}] if several else {"file": given}
    if not isinstance(example, list | tuple | dict):
        return None
    text = flow_text(str(location[depth - 1]), example)
    return f"write {text}" if len(text) <= MAX_FORM else None


def _forms(annotation: Any) -> Forms | None:
    """Return the forms that a type, or one that it may be, is marked with."""
    for note in getattr(annotation, "__metadata__", ()):
        if isinstance(note, Forms):
            return note
    inner = (_forms(one) for one in get_args(annotation))
    return next((one for one in inner if one is not None), None)


def _takes_file(annotation: Any) -> bool:
    """Return whether a mapping of a type has the name of a file."""
    models = models_of(annotation)
    if models:
        return any("file" in fields_of(one) for one in models)
    return get_origin(annotation) is list and _takes_file(get_args(annotation)[0])
