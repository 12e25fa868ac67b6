"""Validates a document against a model and reports all faults with locations."""

from __future__ import annotations

import copy
from collections.abc import Collection, Mapping
from dataclasses import MISSING, Field, fields
from typing import TYPE_CHECKING, Any, TypeVar

import pydantic
from pydantic import BaseModel, ConfigDict, TypeAdapter, ValidationError

from animtool.core.errors import Fault
from animtool.core.options import Key
from animtool.documents.document import Document, Location
from animtool.documents.model_faults import (
    LocatedFaults,
    ModelFaults,
    faults_of_value,
    intended_choices,
    intended_key_hint,
    warn_renamed_key,
)
from animtool.documents.placeholders import set_value_at
from animtool.documents.versions import (
    MIGRATION_STEPS,
    kind_and_version,
    newest_version_of,
    renamed_key,
)

if TYPE_CHECKING:
    from pydantic._internal._model_construction import ModelMetaclass
else:
    ModelMetaclass = type(BaseModel)

Model = TypeVar("Model", bound=BaseModel)
Record = TypeVar("Record")


class _FileModelMeta(ModelMetaclass):
    """Metaclass of models whose fields are declared by `animtool.core.options.key`."""

    def __new__(
        cls, name: str, bases: tuple[type, ...], body: dict[str, Any], **options: Any
    ) -> Any:
        for attribute_name, value in body.items():
            if isinstance(value, Field):
                body[attribute_name] = model_field(value.metadata["key"], value.default)
        return super().__new__(cls, name, bases, body, **options)


def model_field(key: Key, default: Any = MISSING) -> Any:
    """Return a pydantic field with the description and example of a key."""
    options = {} if default is MISSING else {"default": default}
    description, examples = key.description, [key.example]
    return pydantic.Field(description=description, examples=examples, **options)


class FileModel(BaseModel, metaclass=_FileModelMeta):
    """Base model of a mapping: strict types, no unknown keys, finite numbers."""

    # Nested models are built with their parents, not separately.
    model_config = ConfigDict(
        extra="forbid", strict=True, allow_inf_nan=False, defer_build=True
    )


def check_version(document: Document, kind: str) -> None:
    """Raise `FormatError` unless a document has the kind and its newest version."""
    _, version = kind_and_version(document, MIGRATION_STEPS, kind)
    if version < newest_version_of(MIGRATION_STEPS[kind]):
        message = f"animtool/{version} is an older version"
        document.add("DOC013", (kind,), message, "animtool migrate rewrites it")
        document.check()


def validate_document(document: Document, model: type[Model]) -> Model:
    """Return a document as a model; record every fault of keys, types and values.

    Each faulty value is replaced by a placeholder that `Document.add` ignores, so that
    all other values are checked before `Document.check` raises all faults at once. A
    misspelt key counts as the key that was intended, but its value is not checked.
    """
    content: Any = document.value
    while True:
        try:
            return model.model_validate(content)
        except ValidationError as error:
            if content is document.value:
                content = copy.deepcopy(content)
            ModelFaults(document, model, content).replace_faulty(error)


def validate_file(document: Document, kind: str, model: type[Model]) -> Model:
    """Return a file of a kind as a model, as `validate_document` does."""
    check_version(document, kind)
    return validate_document(document, model)


def unknown_option_faults(
    options: Mapping[str, Any], names: Collection[str], owner: str
) -> LocatedFaults:
    """Return a fault for each unknown option, with a hint to the nearest name."""
    return [
        ((key,), Fault("SCN001", f"unknown option {key!r} of {owner}", hint=hint))
        for key in options
        if key not in names
        for hint, _ in [intended_key_hint(key, names)]
    ]


def record_from_options(
    record_type: type[Record], options: Mapping[str, Any], owner: str
) -> tuple[Record | None, LocatedFaults]:
    """Return options as a record (None if a value is invalid), and their faults."""
    option_names = [field.name for field in fields(record_type)]  # type: ignore[arg-type]
    faults = unknown_option_faults(options, option_names, owner)
    known_options = {
        key: value for key, value in options.items() if key in option_names
    }
    key_by_name = {name: name for name in known_options}
    for (key, *_), _fault in faults:
        # A misspelt key is not missing too.
        intended_key = intended_key_hint(str(key), option_names)[1]
        if intended_key is not None and intended_key not in known_options:
            known_options[intended_key] = options[str(key)]
            key_by_name[intended_key] = str(key)
    while True:
        try:
            return TypeAdapter(record_type).validate_python(known_options), faults
        except ValidationError as error:
            choices = intended_choices(known_options, error)
            if not choices:
                value_faults = faults_of_value(known_options, error)
                break
            known_options = copy.deepcopy(known_options)
            for location, choice in choices:
                set_value_at(known_options, location, choice)
    for location, fault in value_faults:
        written_keys = [key_by_name.get(str(step), step) for step in location[:1]]
        faults.append(((*written_keys, *location[1:]), fault))
    return None, faults


def rename_options(
    document: Document, location: Location, options: Mapping[str, Any], kind: str
) -> dict[str, Any]:
    """Return options with old names replaced by new names; warn about each old name.

    Args:
        document: The file that contains them.
        location: Their location in the file.
        options: Values by name.
        kind: Kind of the document.
    """
    renamed_options: dict[str, Any] = {}
    for key, value in options.items():
        name = renamed_key(kind, (*location, key), value)
        if name is None or name in options:
            renamed_options[key] = value
        else:
            renamed_options[name] = value
            warn_renamed_key(document, (*location, key), name)
    return renamed_options
