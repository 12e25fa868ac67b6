"""Validation of a document against a model: all faults at once, with locations."""

from __future__ import annotations

import copy
import re
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import MISSING, Field, fields
from typing import TYPE_CHECKING, Any, TypeVar

import pydantic
from pydantic import BaseModel, ConfigDict, TypeAdapter, ValidationError

from animtool.core.arguments import flag
from animtool.core.errors import Fault, counted, excerpt
from animtool.core.names import KINDS, nearest, similar
from animtool.core.options import Key
from animtool.core.record import dataclass
from animtool.documents.document import Document, Location
from animtool.documents.forms import form_hint, paired_entries
from animtool.documents.other_words import AXES, OTHER_KEYS, OTHER_VALUES
from animtool.documents.placeholders import (
    annotation_at,
    fields_at,
    fields_of,
    models_of,
    placeholder_of,
    replaced,
)
from animtool.documents.versions import STEPS, new_key, newest, version_of
from animtool.documents.yaml_values import flow_value

if TYPE_CHECKING:
    from pydantic._internal._model_construction import ModelMetaclass
else:
    ModelMetaclass = type(BaseModel)

# Faulty values to replace by placeholders before validation stops.
MAX_REPLACED = 200

Model = TypeVar("Model", bound=BaseModel)
Record = TypeVar("Record")
LocatedFaults = list[tuple[Location, Fault]]  # faults with their locations in a value


class _KeyedModels(ModelMetaclass):
    """Metaclass of models whose fields are declared by `animtool.core.options.key`."""

    def __new__(
        cls, name: str, bases: tuple[type, ...], body: dict[str, Any], **options: Any
    ) -> Any:
        for at, value in body.items():
            if isinstance(value, Field):
                body[at] = model_field(value.metadata["key"], value.default)
        return super().__new__(cls, name, bases, body, **options)


def model_field(key: Key, default: Any = MISSING) -> Any:
    """Return the field of a key in a model of a file."""
    field_options = {} if default is MISSING else {"default": default}
    return pydantic.Field(
        description=key.description, examples=[key.example], **field_options
    )


class FileModel(BaseModel, metaclass=_KeyedModels):
    """Base model of a mapping: strict types, no unknown keys, finite numbers."""

    # Nested models are built with their parents, not again alone.
    model_config = ConfigDict(
        extra="forbid", strict=True, allow_inf_nan=False, defer_build=True
    )


def check_version(document: Document, kind: str) -> None:
    """Raise `FormatError` unless a document has the kind and its newest version."""
    _, version = version_of(document, STEPS, kind)
    if version < newest(STEPS[kind]):
        message = f"animtool/{version} is an older version"
        document.add("DOC013", (kind,), message, "animtool migrate rewrites it")
        document.check()


def validated(document: Document, model: type[Model]) -> Model:
    """Return a document as a model; record faults of keys, types and values.

    Each faulty value is replaced by a placeholder that `Document.add` ignores,
    so that the rest can be checked before `Document.check` raises all at once. A key
    that is nearly right counts as given, and its value is not checked.

    Raises:
        FormatError: No placeholder fits.
    """
    value: Any = document.value
    while True:
        try:
            return model.model_validate(value)
        except ValidationError as error:
            if value is document.value:
                value = copy.deepcopy(value)
            _Faults(document, model, value).replace_faulty(error)


def wrong_values(value: Any, error: ValidationError) -> list[tuple[Location, str]]:
    """Return location and message of each fault in a value outside of a model."""
    by_location = _by_location(value, error.errors(include_url=False)[:MAX_REPLACED])
    ancestors = {
        location[:depth]
        for location, _ in by_location
        for depth in range(len(location))
    }
    return [
        (location, "; or ".join(dict.fromkeys(map(_fault_message, faults))))
        for (location, _), faults in by_location.items()
        if location not in ancestors
    ]


def unknown_options(
    options: Mapping[str, Any], names: Collection[str], owner: str
) -> LocatedFaults:
    """Return a fault for each option that its owner does not have."""
    return [
        ((key,), Fault("SCN001", f"unknown option {key!r} of {owner}", hint=hint))
        for key in options
        if key not in names
        for hint in [nearest(key, names)]
    ]


def record_of_options(
    kind: type[Record], options: Mapping[str, Any], owner: str
) -> tuple[Record | None, LocatedFaults]:
    """Return options as a record, with their faults; None where a value is wrong."""
    names = [field.name for field in fields(kind)]  # type: ignore[arg-type]
    faults = unknown_options(options, names, owner)
    known_options = {key: value for key, value in options.items() if key in names}
    try:
        return TypeAdapter(kind).validate_python(known_options), faults
    except ValidationError as error:
        wrong = wrong_values(known_options, error)
    return None, faults + [(at, Fault("SCN002", message)) for at, message in wrong]


def renamed_options(
    document: Document, at: Location, options: Mapping[str, Any], kind: str
) -> dict[str, Any]:
    """Return options with old names replaced by new ones; warn of each.

    Args:
        document: The file that contains them.
        at: Their location in the file.
        options: Values by name.
        kind: Kind of the document.
    """
    result: dict[str, Any] = {}
    for key, value in options.items():
        name = new_key(kind, (*at, key), value)
        if name is None or name in options:
            result[key] = value
            continue
        result[name] = value
        _note_renamed(document, (*at, key), name)
    return result


def _note_renamed(document: Document, location: Location, name: str) -> None:
    """Warn of a renamed key (DOC102)."""
    *parent, key = location
    document.spellings[*parent, name] = str(key)
    message = f"the key {key!r} is now called {name!r}"
    hint = f"animtool migrate FILE {flag('overwrite')} renames it"
    document.warn("DOC102", (*parent, name), message, hint)


@dataclass(slots=True)
class _Faults:
    """Faults of a value, recorded and replaced by placeholders in the value."""

    document: Document  # where faults are recorded
    model: type[BaseModel]  # model of the value
    value: Any  # the document's value, with placeholders

    def replace_faulty(self, error: ValidationError) -> None:
        """Record the faults of a validation attempt and replace the faulty values."""
        errors = error.errors(include_url=False)
        by_location = _by_location(self.value, errors[:MAX_REPLACED])
        ancestors = {
            location[:depth]
            for location, _ in by_location
            for depth in range(len(location))
        }
        by_kind: dict[str, list[tuple[Location, str]]] = {}
        for key, faults in by_location.items():
            by_kind.setdefault(faults[0]["type"], []).append(key)
        # In this order: a misspelt key is not missing too.
        for location, _ in by_kind.pop("extra_forbidden", ()):
            self._unknown_key(location)
        for location, missing in by_kind.pop("missing", ()):
            self._missing_key(location, missing)
        for key in [key for keys in by_kind.values() for key in keys]:
            # In a union, the author meant the member with the most deeply nested
            # faults.
            if key[0] not in ancestors:
                self._wrong_value(key[0], by_location[key])
        if len(errors) > MAX_REPLACED:
            self.document.check()

    def _unknown_key(self, location: Location) -> None:
        *steps, key = location
        mapping = tuple(steps)
        names = fields_at(self.model, self.value, mapping)
        node = self.value
        for step in mapping:
            node = node[step]
        if key not in node or self._paired_key(mapping, node):
            return
        value = node.pop(key)
        kind = next((name for name in KINDS if name in self.value), "")
        renamed = new_key(kind, location, value)
        if renamed in names and renamed not in node:
            node[renamed] = value
            _note_renamed(self.document, location, renamed)
            return
        if self._depends_on_kind(location):
            return
        message = f"unknown key {excerpt(str(key))}"
        normalized = str(key).replace("_", "").lower()
        intended = next((k for k in OTHER_KEYS.get(normalized, ()) if k in names), None)
        hint = f"the key is {intended!r}" if intended else nearest(str(key), names)
        self.document.add("DOC020", location, message, hint, at_key=True)
        intended = intended or similar(str(key), names)
        if intended and intended not in node:
            # Its names may be referenced, but whether it was meant is unknown.
            node[intended] = value
            self.document.spellings[*mapping, intended] = str(key)
            self.document.guesses.add((*mapping, intended))

    def _paired_key(self, mapping: Location, node: dict[str, Any]) -> bool:
        """Record an entry that pairs two names, such as {Hips: hips}, and mend it."""
        models = models_of(annotation_at(self.model, self.value, mapping), node)
        entries = paired_entries(models, node) if len(mapping) > 1 else []
        if not entries:
            return False
        key = next(iter(node))
        message = f"unknown key {excerpt(str(key))}"
        hint = f"write {', '.join(map(flow_value, entries))}"
        self.document.add("DOC020", (*mapping, key), message, hint, at_key=True)
        node.clear()
        node.update(entries[0])
        for name in entries[0]:
            self.document.spellings[*mapping, name] = str(key)
        return True

    def _missing_key(self, mapping: Location, key: str) -> None:
        location = (*mapping, key)
        if location in self.document.spellings:
            return
        if not self._depends_on_kind(location):
            self.document.add("DOC021", mapping, f"key {key!r} is missing")
        self._put_placeholder(location)

    def _wrong_value(self, location: Location, faults: list[Any]) -> None:
        sizes = [fault for fault in faults if fault["type"] in _SIZES]
        texts = dict.fromkeys(_fault_message(fault) for fault in sizes or faults)
        if faults[0]["type"] == "union_tag_not_found":
            tag = faults[0]["ctx"]["discriminator"].strip("'")
            misspelt = similar(tag, map(str, faults[0]["input"]))
            if misspelt is not None:
                # A misspelt key is not missing too.
                self._unknown_key((*location, misspelt))
                return
        if faults[0]["type"].startswith("union_tag"):
            location = (*location, faults[0]["ctx"]["discriminator"].strip("'"))
        if not self._depends_on_kind(location):
            hint = (
                _entry_hint(location, faults[0])
                or _choice_hint(faults)
                or self._form_hint(location, faults)
            )
            self.document.add("DOC022", location, _join_messages(texts), hint)
        self._put_placeholder(location)

    def _form_hint(self, location: Location, faults: list[Any]) -> str | None:
        """Return a hint with the right form where a mapping or list is expected."""
        expected = {_KINDS.get(fault["type"]) for fault in faults}
        if not expected & _STRUCTURES:
            return None
        axis = AXES.get(str(faults[0]["input"]).upper())
        if axis is not None and expected == {_KINDS["list_type"]}:
            numbers = flow_value([round(number) for number in axis])
            return f"write three numbers: {faults[0]['input']} is {numbers}"
        expects_list = expected & _STRUCTURES == {_KINDS["list_type"]}
        return form_hint(self.model, self.value, location, expects_list=expects_list)

    def _depends_on_kind(self, location: Location) -> bool:
        """Return whether a key exists in only some kinds, and the kind is faulty."""
        for depth, key in enumerate(location):
            mapping = location[:depth]
            unknown = self.document.doubts | self.document.guesses
            if (*mapping, "type") in unknown and key != "type":
                kinds = models_of(annotation_at(self.model, self.value, mapping))
                kinds_with_key = [kind for kind in kinds if key in fields_of(kind)]
                if kinds_with_key and len(kinds_with_key) < len(kinds):
                    return True
        return False

    def _put_placeholder(self, location: Location) -> None:
        """Replace a value by a placeholder; if that failed before, its parent."""
        while location in self.document.doubts:
            location = location[:-1]
        if not location:
            self.document.check()
        annotation = annotation_at(self.model, self.value, location)
        self.document.doubts.add(location)
        replaced(self.value, location, placeholder_of(annotation))


def _by_location(
    value: Any, errors: Sequence[Any]
) -> dict[tuple[Location, str], list[Any]]:
    """Group faults by location and missing key."""
    groups: dict[tuple[Location, str], list[Any]] = {}
    for fault in errors:
        missing_key = str(fault["loc"][-1]) if fault["type"] == "missing" else ""
        groups.setdefault((_within(value, fault), missing_key), []).append(fault)
    return groups


def _within(value: Any, fault: Any) -> Location:
    """Return the location of a fault, without names of union members."""
    node, steps = value, []
    for step in fault["loc"]:
        try:
            node = node[step]
        except (KeyError, IndexError, TypeError):
            continue
        steps.append(step)
    return tuple(steps)


def _missing_message(last: int | str, value: Any) -> str:
    """Return a message for a missing key or list item."""
    if isinstance(last, str):
        return f"key {last!r} is missing"
    return f"{counted(len(value), 'item')} where {_count_is(last + 1)} needed"


def _join_messages(texts: Iterable[str]) -> str:
    """Join the messages of a union's members into one."""
    first, *more = texts
    start, negation, _ = first.partition(" is not ")
    if more and negation and all(text.startswith(start + negation) for text in more):
        kinds = [text.removeprefix(start + negation) for text in (first, *more)]
        return f"{start} is neither {' nor '.join(kinds)}"
    return "; or ".join((first, *more))


# Faults of values outside an enumeration.
_CHOICES = {"literal_error", "enum", "union_tag_invalid"}


def _fault_message(fault: Any) -> str:
    """Return the message of a fault, with the value."""
    value, context, kind = fault["input"], fault.get("ctx", {}), fault["type"]
    shown = excerpt(value) if isinstance(value, str) else _shown(value)
    if kind in {"too_short", "too_long", "string_too_long"}:
        length = context.get("min_length", context.get("max_length"))
        noun = "letter" if isinstance(value, str) else "item"
        return f"{counted(len(value), noun)} where {_count_is(length)} needed"
    if kind == "missing":
        return _missing_message(fault["loc"][-1], value)
    if kind == "union_tag_not_found":
        return f"key {context['discriminator']} is missing"
    if kind in _CHOICES:
        allowed = context.get("expected", context.get("expected_tags"))
        tag = excerpt(str(context["tag"])) if "tag" in context else shown
        return f"{tag} is not one of {allowed}"
    if kind in _KINDS:
        return f"{shown} is not {_KINDS[kind]}"
    return _value_fault(shown, fault)


def _value_fault(shown: str, fault: Any) -> str:
    """Return the message for a value of the right type but out of range."""
    context, kind = fault.get("ctx", {}), fault["type"]
    if kind == "extra_forbidden":
        return f"unknown key {excerpt(str(fault['loc'][-1]))}"
    bound = context.get(_BOUNDS.get(kind))
    if bound is not None and abs(bound) >= LARGE:
        return f"{shown} is beyond {bound:g}"
    if bound is not None and 0 < bound <= SMALL:
        above = fault["input"] > 0
        return f"{shown} is below {bound:g}" if above else f"{shown} is not above 0"
    if kind == "value_error":
        return str(context["error"])
    return f"{shown}: {fault['msg'][0].lower()}{fault['msg'][1:]}"


def _choice_hint(faults: list[Any]) -> str | None:
    """Return a hint with the nearest allowed value."""
    for fault in faults:
        context = fault.get("ctx", {})
        value = context.get("tag", fault["input"])
        allowed = context.get("expected", context.get("expected_tags"))
        if fault["type"] in _CHOICES and isinstance(value, str):
            names = re.findall(r"'([^']*)'", str(allowed))
            our_name = OTHER_VALUES.get(value.lower())
            if our_name in names:
                return f"{value!r} is called {our_name!r} here"
            similar_name = similar(value, names)
            if similar_name is not None:
                return f"did you mean {similar_name!r}?"
    return None


def _entry_hint(location: Location, fault: Any) -> str | None:
    """Return a hint on how to write an entry that is only a name, such as a pass."""
    value, expected = fault["input"], _KINDS.get(fault["type"])
    if expected != _KINDS["dict_type"] or not isinstance(location[-1], int):
        return None
    if not isinstance(value, str) or not value.isidentifier():
        return None
    return f"write '{value}: {{}}'"


def _count_is(count: int) -> str:
    return f"{count} is" if count == 1 else f"{count} are"


# Larger bounds are general limits, not the key's.
LARGE = 1e9
# A bound at most this small is how "above 0" is checked.
SMALL = 1e-30
_BOUNDS = {"less_than_equal": "le", "greater_than_equal": "ge"}
_KINDS = {
    "float_type": "a number",
    "float_parsing": "a number",
    "finite_number": "a finite number",
    "int_type": "a whole number",
    "int_parsing": "a whole number",
    "int_from_float": "a whole number",
    "string_type": "text",
    "string_pattern_mismatch": "a name on one line, without tabs",
    "bool_type": "true or false",
    "bool_parsing": "true or false",
    "path_type": "the name of a file",
    "list_type": "a list",
    "tuple_type": "a list",
    "dict_type": "a mapping of keys",
    "model_type": "a mapping of keys",
    "model_attributes_type": "a mapping of keys",
}


# Length faults of lists of the right type; the other members of a union were not meant.
_SIZES = {"too_short", "too_long"}
# Types of containers.
_STRUCTURES = {"a list", "a mapping of keys"}


def _shown(value: Any) -> str:
    if value is None:
        return "nothing"
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, dict | list | tuple):
        return excerpt(flow_value(value))[1:-1]
    return excerpt(str(value)).strip("'")
