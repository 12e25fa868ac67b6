"""Hints that show how to write a value correctly."""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import field
from typing import Any, get_args, get_origin

from pydantic import BaseModel

from animtool.core.record import dataclass
from animtool.documents.document import Location
from animtool.documents.placeholders import (
    annotation_of,
    field_at,
    fields_at,
    fields_of,
    inner_annotation,
    models_of,
    value_at,
)
from animtool.documents.yaml_text import flow_text
from animtool.documents.yaml_values import plain_scalar

# Longer examples do not fit on one line.
MAX_EXAMPLE_LENGTH = 100
_NUMBER_PAIR = re.compile(r"(-?\d+(?:\.\d+)?)\s*(?:[-xX:,]|\.\.)\s*(-?\d+(?:\.\d+)?)")
_NUMBER_UNIT = re.compile(r"\d+([A-Za-z]+)")
_TIME_CODE = re.compile(r"\d+:\d\d:\d\d[:;]\d\d")
_RANGE_LENGTH, _VECTOR_LENGTH = 2, 3


@dataclass(frozen=True, slots=True)
class OptionExamplesAnnotation:
    """Annotation of a mapping of one name to its options: example options by name."""

    options: Mapping[str, Any] = field(hash=False)


@dataclass(frozen=True, slots=True)
class NamedOptionsAnnotation:
    """Annotation of a list of names with options below them, such as passes."""

    noun: str  # noun for one item in messages, such as "pass"
    find_names: Callable[[], Collection[str]]  # returns the known names


def syntax_hint(
    model: type[BaseModel], value: Any, location: Location, *, expects_list: bool
) -> str | None:
    """Return a hint that shows how to write a key; None if its example is too long.

    Args:
        model: Model of the document.
        value: Content of the document.
        location: Location of the faulty value.
        expects_list: Whether a list is expected.
    """
    field_match = field_at(model, value, location)
    if field_match is None:
        return None
    depth, field_info = field_match
    faulty_value = value_at(value, location)
    examples = field_info.examples or [None]
    example, inner_steps = examples[0], location[depth:]
    is_mapping = expects_list and isinstance(faulty_value, dict) and not inner_steps
    holds_mappings = not isinstance(example, list) or not _are_numbers(example)
    if is_mapping and holds_mappings and not _converted_value(faulty_value, example):
        entries = _list_entries(annotation_of(field_info), faulty_value)
        for example_entries in (entries, entries[:1]):
            text = flow_text(str(location[depth - 1]), example_entries)
            if example_entries and len(text) <= MAX_EXAMPLE_LENGTH:
                word = "write" if example_entries is entries else "for example"
                return f"{word} {text}"
        if entries:
            return f"write '- {next(iter(entries[0]))}:', with a dash for each entry"
    entry_examples = _entry_examples(annotation_of(field_info))
    options = {} if entry_examples is None else entry_examples.options
    name = inner_steps[0] if inner_steps else faulty_value
    if isinstance(name, str) and name in options:
        example = {name: options[name]}
    elif isinstance(faulty_value, str) and _takes_file(annotation_of(field_info)):
        # In a list, show the form of one entry.
        is_list = inner_steps or not models_of(annotation_of(field_info))
        example = [{"file": faulty_value}] if is_list else {"file": faulty_value}
    group = None
    if inner_steps and isinstance(faulty_value, str):
        group = _named_group(value_at(value, location[:depth]), example)
    if group == [] or not isinstance(example, list | tuple | dict):
        return None
    key = str(location[depth - 1])
    converted_value = group if inner_steps else _converted_value(faulty_value, example)
    if converted_value is not None:
        return f"write {_shortened_list_text(key, converted_value)}"
    text = flow_text(key, example)
    word = "write" if _example_contains(example, faulty_value) else "for example"
    return f"{word} {text}" if len(text) <= MAX_EXAMPLE_LENGTH else None


def named_options_hint(
    model: type[BaseModel], value: Any, location: Location
) -> str | None:
    """Return a hint that writes a mapping of options below the name they belong to.

    Names have `EntryExamples`, as the shapes of an emitter do. Keys of the mapping's
    parent move there. None if the mapping has no such form.
    """
    field_match = field_at(model, value, location)
    examples = _entry_examples(annotation_of(field_match[1])) if field_match else None
    if field_match is None or examples is None or field_match[0] != len(location):
        return None
    entry = value_at(value, location)
    parent_keys = fields_at(model, value, location[:-1])
    option_keys = {key for example in examples.options.values() for key in example}
    moved_keys = [k for k in entry if k in parent_keys and k not in option_keys]
    moved_options = {key: entry[key] for key in moved_keys}
    names = [key for key in entry if key in examples.options]
    options = {key: entry[key] for key in entry if key not in {*moved_options, *names}}
    if not names and options:
        option_examples = examples.options.items()
        names = [
            name
            for name, example in option_examples
            if example.keys() >= options.keys()
        ]
    if len(names) == 1 and (options or moved_options):
        stated_options = entry.get(names[0]) or {}
        if not isinstance(stated_options, dict):
            return None
        example = {names[0]: {**stated_options, **options}}
    elif not names and moved_options:
        example = (field_match[1].examples or [{}])[0]
    else:
        return None
    texts = [flow_text(str(location[-1]), example)]
    texts += [flow_text(key, item) for key, item in moved_options.items()]
    return f"write {', '.join(texts)}"


def key_named_by(
    model: type[BaseModel], value: Any, mapping: Location, option_name: str
) -> str | None:
    """Return the key that takes a name, such as ``shape`` for ``box``; else None."""
    for key in fields_at(model, value, mapping):
        field_match = field_at(model, value, (*mapping, key))
        examples = (
            _entry_examples(annotation_of(field_match[1])) if field_match else None
        )
        if examples is not None and option_name in examples.options:
            return key
    return None


def _shortened_list_text(key: str, entries: Sequence[Any]) -> str:
    """Return a key with its list on one line, shortened after the first entries."""
    for shown_count in range(len(entries), 0, -1):
        text = flow_text(key, list(entries[:shown_count]))
        if len(text) <= MAX_EXAMPLE_LENGTH or shown_count == 1:
            return text if shown_count == len(entries) else f"{text[:-1]}, …]"
    return flow_text(key, list(entries))


def missing_key_hint(
    model: type[BaseModel], value: Any, location: Location
) -> str | None:
    """Return a hint that adds a missing key with its example; None if that is long."""
    field_match = field_at(model, value, location)
    example = None if field_match is None else (field_match[1].examples or [None])[0]
    return None if example is None else _example_text(location[-1], example)


def _example_text(key: str | int, example: Any) -> str | None:
    """Return a hint with an example of a key; None if that is long."""
    text = flow_text(str(key), example)
    return f"for example {text}" if len(text) <= MAX_EXAMPLE_LENGTH else None


def vector_components(value: Any) -> list[Any] | None:
    """Return the components of a vector written as a mapping; None for other values.

    >>> vector_components({"x": 0, "y": 1, "z": 0}), vector_components({"t": 1, "v": 2})
    ([0, 1, 0], None)
    """
    if not isinstance(value, dict) or tuple(value) not in _COMPONENT_NAMES:
        return None
    numbers = list(value.values())
    return numbers if _are_numbers(numbers) else None


def example_hint(model: type[BaseModel], value: Any, location: Location) -> str | None:
    """Return a hint with the example of a key whose value is a scalar, else None."""
    field_match = field_at(model, value, location)
    if field_match is None or field_match[0] != len(location):
        return None
    example = (field_match[1].examples or [None])[0]
    parent = value_at(value, location[:-1])
    entry = parent.get(location[-1]) if isinstance(parent, dict) else None
    unit_match = _NUMBER_UNIT.fullmatch(example) if isinstance(example, str) else None
    if unit_match is not None and type(entry) in (int, float):
        return f"add a unit, such as {entry}{unit_match[1]}"
    if example is None or isinstance(example, bool | list | tuple | dict):
        return None
    hint = _example_text(location[-1], example)
    is_time_code = isinstance(entry, str) and _TIME_CODE.fullmatch(entry)
    return f"times are frame numbers, {hint}" if is_time_code else hint


def paired_entries(
    models: Sequence[type[BaseModel]], value: Mapping[str, Any]
) -> list[dict[str, Any]]:
    """Return the list entries meant by a mapping of name pairs; empty if unclear."""
    if not value or not all(isinstance(entry, str) for entry in value.values()):
        return []
    for fields in map(fields_of, models):
        required_keys = [key for key, info in fields.items() if info.is_required()]
        is_pair = len(required_keys) == 2 and "type" not in fields
        if is_pair and fields.keys().isdisjoint(value):
            return [dict(zip(required_keys, p, strict=True)) for p in value.items()]
    return []


def _list_entries(annotation: Any, value: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Return the list entries meant by a mapping; empty if unclear."""
    models = models_of(inner_annotation(annotation, None, 0))
    keys = {key for model in models for key in fields_of(model)}
    if not keys:  # entries that are named by their only key, such as passes
        return [{key: item} for key, item in value.items()]
    if value.keys() <= keys:
        return [dict(value)]
    if "name" in keys and all(isinstance(item, dict) for item in value.values()):
        return [{"name": name, **entry} for name, entry in value.items()]
    return paired_entries(models, value)


# Keys that other tools use for the ends of a range, the lower end first.
_COMPONENT_NAMES = (tuple("xyz"), tuple("wxyz"), ("dt", "dv"))
_RANGE_END_NAMES = (
    *("min", "low", "lower", "first", "start"),
    *("max", "high", "upper", "last", "end"),
)


def _converted_value(value: Any, example: Any) -> list[Any] | None:
    """Return a value in the form of an example; None if its meaning is unclear."""
    if not isinstance(example, list | tuple) or not example:
        return None
    if isinstance(value, str):
        return _parse_list(value.strip(), example)
    if isinstance(value, dict):
        range_ends = [value.get(key) for key in _RANGE_END_NAMES if key in value]
        is_range = len(range_ends) == _RANGE_LENGTH
        values = range_ends if is_range else vector_components(value) or []
        return values if len(values) == len(value) == len(example) else None
    if isinstance(value, int | float) and not isinstance(value, bool):
        # A magnitude along the only axis of the example: gravity of 9.81 points down.
        axes = [i for i, number in enumerate(example) if number]
        if len(example) == _VECTOR_LENGTH and len(axes) == 1:
            sign = -1 if example[axes[0]] < 0 < value else 1
            return [sign * value if i in axes else 0 for i in range(len(example))]
    if isinstance(value, list):
        return _nested_list(value, example)
    return None


def _named_group(names: Any, example: Any) -> list[Any] | None:
    """Return names in the form of an example's entry; None if it lists no names.

    The list is empty if not all of ``names`` are texts.
    """
    entry = example[0] if isinstance(example, list) and example else None
    if not isinstance(entry, dict) or len(entry) != 1 or not isinstance(names, list):
        return None
    [(key, example_names)] = entry.items()
    if not isinstance(example_names, list) or not isinstance(example_names[0], str):
        return None
    return [{key: names}] if all(isinstance(name, str) for name in names) else []


def _nested_list(value: list[Any], example: Sequence[Any]) -> list[Any] | None:
    """Return a list nested like an example, or as mappings with its keys; else None."""
    if isinstance(example[0], list):
        return [value] if len(value) == len(example[0]) else None
    keys = list(example[0]) if isinstance(example[0], dict) else []
    rows = [row for row in value if isinstance(row, list) and len(row) == len(keys)]
    if keys and rows and len(rows) == len(value):
        return [dict(zip(keys, row, strict=True)) for row in value]
    if len(keys) == 1 and all(isinstance(row, dict) for row in value):
        return [{key: row[key]} for row in value for key in row]
    is_range = len(value) == _RANGE_LENGTH + 1 and len(example) == _RANGE_LENGTH
    is_range = is_range and _are_numbers([*value, *example]) and example[0] >= 0
    return value[:_RANGE_LENGTH] if is_range and value[0] < value[1] else None


def _are_numbers(entries: Sequence[Any]) -> bool:
    return all(isinstance(value, int | float) for value in entries)


def _parse_list(text: str, example: Sequence[Any]) -> list[Any] | None:
    """Return the list meant by a text of numbers or a single name; None if unclear."""
    if all(isinstance(entry, str) for entry in example):
        return [text]
    pair_match = _NUMBER_PAIR.fullmatch(text)
    number_texts: Sequence[str] = re.split(r"[\s,;]+", text.strip("()[] "))
    if pair_match is not None:
        number_texts = pair_match.groups()
    numbers = [plain_scalar(part) for part in number_texts if part]
    are_numbers = all(isinstance(entry, int | float) for entry in numbers)
    return numbers if are_numbers and len(numbers) == len(example) else None


def _example_contains(example: Any, value: Any) -> bool:
    """Return whether a value occurs anywhere in an example."""
    if isinstance(example, dict):
        return any(_example_contains(i, value) for i in (*example, *example.values()))
    if isinstance(example, list | tuple):
        return any(_example_contains(item, value) for item in example)
    return bool(example == value)


def _entry_examples(annotation: Any) -> OptionExamplesAnnotation | None:
    """Return the `EntryExamples` that annotate a type or a member of a union."""
    for constraint in getattr(annotation, "__metadata__", ()):
        if isinstance(constraint, OptionExamplesAnnotation):
            return constraint
    members = map(_entry_examples, get_args(annotation))
    return next((examples for examples in members if examples is not None), None)


def _takes_file(annotation: Any) -> bool:
    """Return whether the mapping of a type has a `file` key."""
    models = models_of(annotation)
    if models:
        return any("file" in fields_of(model) for model in models)
    return get_origin(annotation) is list and _takes_file(get_args(annotation)[0])


def named_options_annotation(annotation: Any) -> NamedOptionsAnnotation | None:
    """Return the `EntryNames` of a type; None if it has none."""
    constraints = getattr(annotation, "__metadata__", ())
    return next((c for c in constraints if isinstance(c, NamedOptionsAnnotation)), None)
