"""Faults of values that a model refuses: their locations, messages and hints."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
from typing import Any

from pydantic import BaseModel, ValidationError

from animtool.core.arguments import flag
from animtool.core.errors import Fault, excerpt, listed
from animtool.core.names import FILE_KINDS, most_similar, name_hint, sort_by_similarity
from animtool.core.record import dataclass
from animtool.documents.document import Document, Location, location_text
from animtool.documents.other_words import (
    AXES,
    COMMAND_KEYS,
    KEY_ALIASES,
    intended_options,
)
from animtool.documents.placeholders import (
    annotation_at,
    field_at,
    fields_at,
    fields_of,
    models_of,
    placeholder_of,
    set_value_at,
    value_at,
)
from animtool.documents.value_faults import (
    expected_structures,
    intended_choice,
    is_beyond_general_limit,
    is_euler_angles,
    is_type_fault,
    value_hint,
    values_message,
)
from animtool.documents.value_hints import (
    MAX_EXAMPLE_LENGTH,
    example_hint,
    key_named_by,
    missing_key_hint,
    named_options_annotation,
    named_options_hint,
    paired_entries,
    syntax_hint,
    vector_components,
)
from animtool.documents.versions import renamed_key
from animtool.documents.yaml_text import flow_text
from animtool.documents.yaml_values import flow_value

# Rows of a time and a value, by key.
TIMED_ROWS = {
    "moves": "[seconds, x, y, z]",
    "turns": "[seconds, w, x, y, z]",
    "gusts": "[seconds, x, y, z]",
}
# Maximum number of faulty values that are replaced by placeholders.
MAX_REPLACED_VALUES = 200
# Number of unknown keys from which an entry gets a single fault.
MIN_UNKNOWN_KEYS = 2
# Maximum number of mappings that a hint names as owners of an unknown key.
MAX_KEY_OWNERS = 2
# Maximum number of required keys that an example shows beside that key.
MAX_EXAMPLE_KEYS = 3

LocatedFaults = list[tuple[Location, Fault]]  # faults with their locations in a value


def _entry_example(models: list[type[BaseModel]], key: str, value: Any) -> str | None:
    """Return an example entry with a key and the required keys; None if ambiguous."""
    if len(models) > 1 or isinstance(value, dict | list):
        return None
    fields = fields_of(models[0])
    required = [n for n, info in fields.items() if info.is_required() and n != key]
    if not 0 < len(required) <= MAX_EXAMPLE_KEYS:
        return None
    return flow_value({**dict.fromkeys(required, "…"), key: value})


def faults_of_value(value: Any, error: ValidationError) -> LocatedFaults:
    """Return the faults of a value outside a document (SCN002), with locations."""
    faults_by_location = _group_by_location(value, error)
    ancestor_locations = _ancestor_locations(faults_by_location)
    located_faults: LocatedFaults = []
    lists_of_pairs: set[Location] = set()  # lists of numbers where pairs are needed
    for (location, _), faults in faults_by_location.items():
        if location in ancestor_locations or location[:-1] in lists_of_pairs:
            continue
        hint = value_hint(location[-1], faults) if location else None
        is_entry = len(location) > 1 and isinstance(location[-1], int)
        if is_entry and hint is None and expected_structures(faults) == {"a list"}:
            lists_of_pairs.add(location[:-1])
            hint = "write pairs, such as [[1, 0], [24, 1]]"
        fault = Fault("SCN002", values_message(faults), hint=hint)
        located_faults.append((location, fault))
    return located_faults


def intended_choices(value: Any, error: ValidationError) -> list[tuple[Location, str]]:
    """Return the corrected form of each value that is wrong only in its case."""
    faults_by_key = _group_by_location(value, error)
    choices = [
        (key[0], intended_choice(faults)) for key, faults in faults_by_key.items()
    ]
    return [(location, choice) for location, choice in choices if choice is not None]


def intended_key_hint(key: str, names: Collection[str]) -> tuple[str, str | None]:
    """Return a hint for an unknown key, and the key that was likely meant."""
    normalized_key = key.replace("_", "").lower()
    for equivalent_key in KEY_ALIASES.get(normalized_key, ()):
        if equivalent_key in names:
            return f"the key is {equivalent_key!r}", equivalent_key
    if normalized_key in KEY_ALIASES:  # a word of its own, not a misspelling
        return f"allowed: {', '.join(sort_by_similarity(key, names))}", None
    return name_hint(key, names), most_similar(key, names)


def warn_renamed_key(document: Document, location: Location, name: str) -> None:
    """Warn about a key under its old name (DOC102), and record that name."""
    *parent, key = location
    document.old_keys[*parent, name] = str(key)
    message = f"the key {key!r} is now called {name!r}"
    hint = f"animtool migrate FILE {flag('overwrite')} renames it"
    document.warn("DOC102", (*parent, name), message, hint)


@dataclass(slots=True)
class ModelFaults:
    """Records the faults of a document's values, and replaces these by placeholders."""

    document: Document  # where faults are recorded
    model: type[BaseModel]  # model of the value
    value: Any  # the document's value, with placeholders

    def replace_faulty(self, error: ValidationError) -> None:
        """Record the faults of a validation error, and replace the faulty values."""
        faults_by_location = _group_by_location(self.value, error)
        for location in self._record_misplaced_options(faults_by_location.values()):
            faults_by_location = {
                key: faults
                for key, faults in faults_by_location.items()
                if key[0][: len(location)] != location
            }
        ancestor_locations = _ancestor_locations(faults_by_location)
        faults_by_type: dict[str, list[tuple[Location, str]]] = {}
        for key, faults in faults_by_location.items():
            faults_by_type.setdefault(faults[0]["type"], []).append(key)
        known_placeholders = frozenset(self.document.placeholders)
        # In this order: a misspelt key is not missing too.
        unknown_keys = [key[0] for key in faults_by_type.pop("extra_forbidden", ())]
        entry_locations = {
            location[:-1] for location in unknown_keys if _is_list_entry(location[:-1])
        }
        unrecognised_entries = {
            location
            for location in sorted(entry_locations, key=str)
            if self._record_unrecognised_entry(location)
        }
        for location in unknown_keys:
            if location[:-1] not in unrecognised_entries:
                self._record_unknown_key(location)
        for location, missing_key in faults_by_type.pop("missing", ()):
            self._record_missing_key(location, missing_key)
        for key in [key for keys in faults_by_type.values() for key in keys]:
            # In a union, the author meant the member with the most deeply nested
            # faults.
            new_placeholders = self.document.placeholders - known_placeholders
            is_replaced = not new_placeholders.isdisjoint((key[0], key[0][:-1]))
            if key[0] not in ancestor_locations and not is_replaced:
                self._record_wrong_value(key[0], faults_by_location[key])
        if error.error_count() > MAX_REPLACED_VALUES:
            self.document.check()

    def _record_unknown_key(self, location: Location) -> None:
        *steps, key = location
        parent = tuple(steps)
        allowed_keys = fields_at(self.model, self.value, parent)
        mapping = value_at(self.value, parent)
        if self._record_vector_mapping(parent):
            return
        if key not in mapping or self._correct_name_pair(parent, mapping):
            return
        value = mapping.pop(key)
        kind = next((name for name in FILE_KINDS if name in self.value), "")
        new_name = renamed_key(kind, location, value)
        if new_name in allowed_keys and new_name not in mapping:
            mapping[new_name] = value
            warn_renamed_key(self.document, location, new_name)
            return
        if self._depends_on_unknown_kind(location):
            return
        if str(key).startswith("-"):
            self._record_bad_dash(location, mapping)
            return
        message = f"unknown key {excerpt(str(key))}"
        hint, meant_key = intended_key_hint(str(key), allowed_keys)
        owning_key = key_named_by(self.model, self.value, parent, str(key))
        if owning_key is not None and owning_key not in mapping:
            meant_key, value = owning_key, {key: value}
            hint = f"write {flow_text(owning_key, value)}"
        elif meant_key is not None:
            hint = self._with_entry_form(hint, (*parent, meant_key), key)
        if hint.startswith("allowed") and key in COMMAND_KEYS:
            hint = f"it is an option of commands: {flag(str(key).replace('_', '-'))}"
        elif hint.startswith("allowed"):
            hint = (
                self._key_elsewhere(parent, mapping, str(key))
                or self._key_of_another_branch(parent, str(key), value)
                or hint
            )
        self.document.add("DOC020", location, message, hint, is_at_key=True)
        if meant_key and meant_key not in mapping:
            # Its names may be referenced, but whether it was meant is unknown.
            mapping[meant_key] = value
            self.document.old_keys[*parent, meant_key] = str(key)
            self.document.guessed_keys.add((*parent, meant_key))

    def _with_entry_form(self, hint: str, location: Location, key: Any) -> str:
        """Return a hint with the list entry that an unknown key names, if any."""
        field_match = field_at(self.model, self.value, location)
        example = (field_match[1].examples or [None])[0] if field_match else None
        entries = example if isinstance(example, list) else []
        for entry in entries:
            if isinstance(entry, dict) and [*entry] == [key]:
                return f"{hint}: write {flow_text(str(location[-1]), [entry])}"
        return hint

    def _key_elsewhere(
        self, parent: Location, mapping: dict[str, Any], key: str
    ) -> str | None:
        """Return a hint that names a related mapping that accepts an unknown key."""
        for sibling, value in mapping.items():
            first_element = value[0] if isinstance(value, list) and value else value
            index_step = (0,) if first_element is not value else ()
            if isinstance(first_element, dict):
                location = (*parent, sibling, *index_step)
                if key in fields_at(self.model, self.value, location):
                    return f"it is a key of {sibling!r}: write it there"
                # An entry that is named by its only key, such as a system.
                if len(first_element) == 1:
                    location = (*location, next(iter(first_element)))
                    if key in fields_at(self.model, self.value, location):
                        label = location_text(location)
                        return f"it is a key of {label}: write it there"
        for absent_key in fields_at(self.model, self.value, parent):
            if absent_key in mapping:
                continue
            for steps in ((absent_key,), (absent_key, 0)):
                annotation = annotation_at(self.model, self.value, (*parent, *steps))
                if any(key in fields_of(kind) for kind in models_of(annotation)):
                    return f"it is a key of {absent_key!r}: write it there"
        for depth in reversed(range(len(parent))):
            if key in fields_at(self.model, self.value, parent[:depth]):
                if key in value_at(self.value, parent[:depth]):
                    return None  # it has one
                label = location_text(parent[:depth])
                owner_text = f"of {label}" if label else "at the top level of the file"
                return f"it is a key {owner_text}: write it there"
        return None

    def _key_of_another_branch(
        self, parent: Location, key: str, value: Any
    ) -> str | None:
        """Return a hint if one or two mappings near an ancestor accept an unknown key.

        With the key ``share`` in a joint of a map file, it is the list ``twists``.
        Every list may have names.
        """
        if key == "name":
            return None
        for depth in reversed(range(len(parent))):
            ancestor = parent[:depth]
            owners: dict[str, list[type[BaseModel]]] = {}
            for name in fields_at(self.model, self.value, ancestor):
                if name == parent[depth]:
                    continue
                for steps in ((name,), (name, 0)):
                    path = (*ancestor, *steps)
                    models = models_of(annotation_at(self.model, self.value, path))
                    matches = [model for model in models if key in fields_of(model)]
                    if matches:
                        owners.setdefault(location_text((*ancestor, name)), matches)
            if not owners:
                continue
            if len(owners) > MAX_KEY_OWNERS:
                return None
            hint = f"it is a key of {' and of '.join(map(repr, owners))}"
            (models, *others) = owners.values()
            example = "" if others else _entry_example(models, key, value)
            return f"{hint}: write {example or 'it'} there"
        return None

    def _limit_hint(self, location: Location, faults: list[Any]) -> str | None:
        """Return a hint for a number beyond the limit of all numbers."""
        if not is_beyond_general_limit(faults):
            return None
        depths = range(len(location))
        accepted_keys = {
            name
            for depth in depths
            for name in fields_at(self.model, self.value, location[:depth])
        }
        hint = "write it in a larger unit"
        if "gravity_constant" in accepted_keys:
            hint = "use larger units of mass, length and time throughout, and write "
            hint += "gravity_constant in these"
        return hint

    def _record_unrecognised_entry(self, parent: Location) -> bool:
        """Record a single fault if a list entry has no known key."""
        mapping = value_at(self.value, parent)
        allowed_keys = fields_at(self.model, self.value, parent)
        unknown_keys = [key for key in mapping if key not in allowed_keys]
        if len(unknown_keys) < len(mapping) or len(unknown_keys) < MIN_UNKNOWN_KEYS:
            return False
        models = models_of(annotation_at(self.model, self.value, parent), mapping)
        is_pair = bool(paired_entries(models, mapping))
        if is_pair or any(
            intended_key_hint(str(key), allowed_keys)[1] for key in unknown_keys
        ):
            return False
        names_text = listed([excerpt(str(key)) for key in unknown_keys])
        message = f"no known key in {names_text}"
        self.document.add(
            "DOC020", parent, message, f"allowed: {', '.join(allowed_keys)}"
        )
        self._insert_placeholder(parent)
        return True

    def _record_misplaced_options(self, groups: Iterable[list[Any]]) -> list[Location]:
        """Record a fault for each mapping whose options are not below a name.

        Returns the locations of these mappings, which get placeholders.
        """
        mappings: dict[Location, None] = {}
        for faults in groups:
            location = _fault_location(self.value, faults[0])
            if faults[0]["type"] == "dict_type":
                location = location[:-1]  # of an option, which is read as a name
            elif faults[0]["type"] != "too_long":
                continue
            if location and isinstance(value_at(self.value, location), dict):
                mappings[location] = None
        locations = list(filter(self._record_missing_dash, mappings))
        if not locations:
            locations = list(filter(self._record_unindented_options, mappings))
        if not locations:
            locations = list(filter(self._record_options_without_name, mappings))
        for location in locations:
            self._insert_placeholder(location)
        return locations

    def _record_unindented_options(self, location: Location) -> bool:
        """Record a fault if the options of an entry are not below its name."""
        entry = value_at(self.value, location)
        if not _is_list_entry(location) or len(entry) < 2:
            return False
        name, *options = entry
        if entry[name] is not None:
            return False
        names = listed([excerpt(str(key)) for key in options])
        text = flow_text(str(name), {key: entry[key] for key in options})
        message = f"options of {name!r} are not below it: {names}"
        hint = f"indent them further, or write {text}"
        key_location = (*location, options[0])
        self.document.add("DOC022", key_location, message, hint, is_at_key=True)
        return True

    def _record_missing_dash(self, location: Location) -> bool:
        """Record a fault if an item of a list holds several names of items."""
        annotation = named_options_annotation(
            annotation_at(self.model, self.value, location)
        )
        entry = value_at(self.value, location)
        if annotation is None or not _is_list_entry(location) or len(entry) < 2:
            return False
        known_names = annotation.find_names()
        if not all(
            name in known_names and (options is None or isinstance(options, dict))
            for name, options in entry.items()
        ):
            return False
        first, second, *_ = entry
        message = f"{second!r} is another {annotation.noun} in the item of {first!r}"
        hint = f"each {annotation.noun} needs its own dash: "
        items = [{name: options or {}} for name, options in entry.items()]
        text = flow_text(str(location[-2]), items)
        hint += (
            f"write {text}"
            if len(text) <= MAX_EXAMPLE_LENGTH
            else f"write '- {second}:'"
        )
        key_location = (*location, second)
        self.document.add("DOC022", key_location, message, hint, is_at_key=True)
        return True

    def _record_options_without_name(self, location: Location) -> bool:
        """Record a fault if a value has options that must be below a name."""
        hint = named_options_hint(self.model, self.value, location)
        if hint is None:
            return False
        keys = listed([excerpt(str(key)) for key in value_at(self.value, location)])
        message = f"one name with its options is needed, not {keys}"
        self.document.add("DOC022", location, message, hint)
        return True

    def _record_bad_dash(self, location: Location, mapping: dict[str, Any]) -> None:
        """Record a list entry that was read as a key, for lack of a space after "-"."""
        *parent_path, key = location
        hint = f"write '- {str(key)[1:].strip()}: …'"
        self.document.add(
            "DOC001", location, "no space after '-'", hint, is_at_key=True
        )
        for other_key, value in list(mapping.items()):
            if value is None:  # the list's key
                self._insert_placeholder((*parent_path, other_key))

    def _correct_name_pair(self, parent: Location, mapping: dict[str, Any]) -> bool:
        """Record and correct an entry that pairs two names, such as {Hips: hips}."""
        models = models_of(annotation_at(self.model, self.value, parent), mapping)
        entries = paired_entries(models, mapping) if len(parent) > 1 else []
        if not entries:
            return False
        key = next(iter(mapping))
        message = f"unknown key {excerpt(str(key))}"
        hint = f"write {', '.join(map(flow_value, entries))}"
        self.document.add("DOC020", (*parent, key), message, hint, is_at_key=True)
        mapping.clear()
        mapping.update(entries[0])
        for name in entries[0]:
            self.document.old_keys[*parent, name] = str(key)
        return True

    def _record_missing_key(self, parent: Location, key: str) -> None:
        location = (*parent, key)
        if location in self.document.old_keys:
            return
        if not self._depends_on_unknown_kind(location):
            hint = missing_key_hint(self.model, self.value, location)
            self.document.add("DOC021", parent, f"key {key!r} is missing", hint)
        self._insert_placeholder(location)

    def _record_wrong_entry(self, location: Location, faults: list[Any]) -> bool:
        """Record a single fault if the entries of a list have the wrong form."""
        parent = location[:-1]
        if not (parent and _is_list_entry(location) and expected_structures(faults)):
            return False
        hint = syntax_hint(self.model, self.value, parent, expects_list=True)
        if hint is None:
            return False
        entries, message = value_at(self.value, parent), values_message(faults)
        are_numbers = all(isinstance(entry, int | float) for entry in entries)
        if len(entries) == 3 and "rotat" in str(parent[-1]):
            hint = "write a quaternion [w, x, y, z]"
            location, message = parent, "3 numbers where 4 are needed"
        elif not (hint.startswith("write ") or are_numbers):
            return False
        self.document.add("DOC022", location, message, hint)
        self._insert_placeholder(parent)
        return True

    def _record_vector_mapping(self, parent: Location) -> bool:
        """Record a single fault if a vector is written as {x: …, y: …, z: …}."""
        if parent in self.document.placeholders:
            return True
        value = value_at(self.value, parent)
        numbers = vector_components(value)
        if numbers is None or not parent:
            return False
        hint = f"write {flow_text(str(parent[-1]), numbers)}"
        message = f"{excerpt(flow_value(value))[1:-1]} is not a list"
        self.document.add("DOC022", parent, message, hint)
        self._insert_placeholder(parent)
        return True

    def _record_wrong_value(self, location: Location, faults: list[Any]) -> None:
        if faults[0]["type"] == "union_tag_not_found":
            tag = faults[0]["ctx"]["discriminator"].strip("'")
            misspelt_key = most_similar(tag, map(str, faults[0]["input"]))
            if misspelt_key is not None:
                # A misspelt key is not missing too.
                self._record_unknown_key((*location, misspelt_key))
                return
        if faults[0]["type"].startswith("union_tag"):
            location = (*location, faults[0]["ctx"]["discriminator"].strip("'"))
        value = faults[0]["input"]
        choice = intended_choice(faults)
        if choice is not None:
            set_value_at(self.value, location, choice)
            return
        if self._record_wrong_entry(location, faults):
            return
        if isinstance(value, dict) and value and str(next(iter(value)))[:1] == "-":
            self._record_bad_dash((*location, next(iter(value))), {})
        elif not self._depends_on_unknown_kind(location):
            hint = _non_mapping_hint(location, faults[0]) or _row_hint(location, faults)
            hint = hint or value_hint(location[-1], faults)
            hint = hint or self._limit_hint(location, faults)
            hint = hint or self._syntax_hint(location, faults)
            self.document.add("DOC022", location, values_message(faults), hint)
        self._insert_placeholder(location)

    def _syntax_hint(self, location: Location, faults: list[Any]) -> str | None:
        """Return a hint that shows the correct form of a value; None if unknown."""
        value, structures = faults[0]["input"], expected_structures(faults)
        bounds = faults[0].get("ctx", {})
        count = bounds.get("min_length") or bounds.get("max_length") or 0
        comma_hint = self.document.decimal_comma_hint(location, count)
        if structures and comma_hint is not None:
            return comma_hint
        if is_euler_angles(faults):
            hint = "write a quaternion [w, x, y, z]"
            if location[-1] == "orientation":
                angles = {"euler": "XYZ", "keys": [{"t": 1, "v": value}]}
                hint += f", or for angles {flow_text('orientation', angles)}"
            return hint
        axis, needs_list = AXES.get(str(value).upper()), structures == {"a list"}
        if axis is not None and needs_list:
            numbers = flow_value([round(number) for number in axis])
            return f"write three numbers: {value} is {numbers}"
        if structures:
            model_location = self.model, self.value, location
            return syntax_hint(*model_location, expects_list=needs_list)
        if is_type_fault(faults):
            return example_hint(self.model, self.value, location)
        return None

    def _depends_on_unknown_kind(self, location: Location) -> bool:
        """Return whether a key belongs to some kinds only, and the kind is unknown."""
        for depth, key in enumerate(location):
            parent = location[:depth]
            unknown_locations = self.document.placeholders | self.document.guessed_keys
            if (*parent, "type") in unknown_locations and key != "type":
                models = models_of(annotation_at(self.model, self.value, parent))
                models_with_key = [kind for kind in models if key in fields_of(kind)]
                if models_with_key and len(models_with_key) < len(models):
                    return True
        return False

    def _insert_placeholder(self, location: Location) -> None:
        """Replace a value by a placeholder, or its parent if that failed before."""
        while location in self.document.placeholders:
            location = location[:-1]
        if not location:
            self.document.check()
        annotation = annotation_at(self.model, self.value, location)
        self.document.placeholders.add(location)
        set_value_at(self.value, location, placeholder_of(annotation))


def _group_by_location(
    value: Any, error: ValidationError
) -> dict[tuple[Location, str], list[Any]]:
    """Group the first faults of a failed validation by location and missing key."""
    faults_by_key: dict[tuple[Location, str], list[Any]] = {}
    for fault in error.errors(include_url=False)[:MAX_REPLACED_VALUES]:
        missing_key = str(fault["loc"][-1]) if fault["type"] == "missing" else ""
        key = _fault_location(value, fault), missing_key
        faults_by_key.setdefault(key, []).append(fault)
    return faults_by_key


def _is_list_entry(location: Location) -> bool:
    return bool(location) and isinstance(location[-1], int)


def _ancestor_locations(located_keys: Iterable[tuple[Location, str]]) -> set[Location]:
    """Return the locations of the mappings and lists around each faulty value."""
    return {
        location[:depth]
        for location, _ in located_keys
        for depth in range(len(location))
    }


def _fault_location(value: Any, fault: Any) -> Location:
    """Return the location of a validation error, without names of union members."""
    node, existing_steps = value, []
    for step in fault["loc"]:
        try:
            node = node[step]
        except (KeyError, IndexError, TypeError):
            continue
        existing_steps.append(step)
    return tuple(existing_steps)


def _row_hint(location: Location, faults: Sequence[Any]) -> str | None:
    """Return a hint with the form of a row of a time and a value; else None."""
    if not _is_list_entry(location) or not expected_structures(faults):
        return None
    row_form = TIMED_ROWS.get(str(location[-2]))
    return row_form and f"write rows {row_form}"


def _non_mapping_hint(location: Location, fault: Any) -> str | None:
    """Return a hint for options that were not written as a mapping; else None."""
    value = fault["input"]
    if fault["type"] != "dict_type":
        return None
    if len(location) > 1 and isinstance(location[-2], int):
        # Of an entry that is named by its only key, the value.
        name = str(location[-1])
        options = intended_options(name, value)
        text = flow_text(name, options) if options else f"{name}: {{OPTION: VALUE}}"
        return f"write {text}"
    is_name = isinstance(value, str) and value.isidentifier()
    return f"write '{value}: {{}}'" if _is_list_entry(location) and is_name else None
