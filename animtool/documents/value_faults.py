"""Messages and hints for values that are invalid for their key."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from typing import Any

from animtool.core.errors import counted, excerpt
from animtool.core.names import most_similar
from animtool.documents.other_words import FALLBACK_VALUE_ALIASES, VALUE_ALIASES
from animtool.documents.yaml_values import (
    flow_value,
    plain_scalar,
    timed_list_hint,
    timed_rows,
)

# Larger bounds are general limits, not the key's.
MIN_GENERAL_LIMIT = 1e9
# Larger bounds are those of numbers with a unit, not of counts.
MIN_UNIT_LIMIT = 1e15
# Bounds up to this size mean "above 0".
MAX_ZERO_BOUND = 1e-30
# Faults of numbers out of range: the key of the bound, and the comparison as text.
_BOUND_FAULTS = {
    "less_than_equal": ("le", "above the maximum of {}"),
    "greater_than_equal": ("ge", "below the minimum of {}"),
    "less_than": ("lt", "not below {}"),
    "greater_than": ("gt", "not above {}"),
}
_EXPECTED_NOUNS = {
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


# Faults of values of the right type; the author did not mean another union member.
_LENGTH_FAULTS = {"too_short", "too_long"}
_RIGHT_TYPE_FAULTS = (_LENGTH_FAULTS, _BOUND_FAULTS.keys())
# Types of containers.
_CONTAINER_NOUNS = {"a list", "a mapping of keys"}
_MAX_NUMBER_LENGTH = 40
_NUMBER_WITH_UNIT = re.compile(r"([-+]?(?:\d+\.?\d*|\.\d+))\s*([A-Za-z%°]+)")
_SECONDS_PER_UNIT = {"s": 1, "sec": 1, "m": 60, "min": 60, "h": 3600}
_BOOLEAN_WORDS = {
    **dict.fromkeys(("yes", "on", "y", "1", "true"), "true"),
    **dict.fromkeys(("no", "off", "n", "0", "false"), "false"),
}


def likely_faults(faults: Sequence[Any]) -> list[Any]:
    """Return the faults from the union member that was most likely intended."""
    for fault_types in _RIGHT_TYPE_FAULTS:
        matching_faults = [fault for fault in faults if fault["type"] in fault_types]
        if matching_faults:
            return matching_faults
    return list(faults)


def expected_structures(faults: Sequence[Any]) -> set[str]:
    """Return which containers the faults expect: a list, a mapping, or both."""
    intended_faults = likely_faults(faults)
    nouns = {_EXPECTED_NOUNS.get(fault["type"], "") for fault in intended_faults}
    if any(fault["type"] in _LENGTH_FAULTS for fault in intended_faults):
        nouns.add("a list")
    return nouns & _CONTAINER_NOUNS


def is_euler_angles(faults: Sequence[Any]) -> bool:
    """Return whether a value is three numbers where a quaternion is expected."""
    value = faults[0]["input"]
    min_lengths = {f.get("ctx", {}).get("min_length") for f in likely_faults(faults)}
    return isinstance(value, list) and len(value) == 3 and min_lengths == {4}


def is_type_fault(faults: Iterable[Any]) -> bool:
    """Return whether any fault of a value is a wrong type."""
    return any(fault["type"] in _EXPECTED_NOUNS for fault in faults)


def is_beyond_general_limit(faults: Iterable[Any]) -> bool:
    """Return whether a number is beyond the limit of all numbers."""
    bounds = [
        fault.get("ctx", {}).get(_BOUND_FAULTS[fault["type"]][0])
        for fault in faults
        if fault["type"] in _BOUND_FAULTS
    ]
    return any(bound and abs(bound) >= MIN_UNIT_LIMIT for bound in bounds)


def values_message(faults: Sequence[Any]) -> str:
    """Return one message for all faults of a value, joined by "or"."""
    if faults[0]["input"] is None:
        return "the value is missing"
    return _join_messages(dict.fromkeys(map(_value_message, likely_faults(faults))))


def value_hint(key: str | int, faults: Sequence[Any]) -> str | None:
    """Return a hint that shows the value that was likely meant."""
    value = faults[0]["input"]
    nouns = {_EXPECTED_NOUNS.get(fault["type"]) for fault in faults}
    expected_classes = {fault.get("ctx", {}).get("class") for fault in faults}
    if (
        key == "size"
        and "Sequence" in expected_classes
        and isinstance(value, int | float)
    ):
        return f"write {flow_value([value] * 3)}"
    if "a list" in nouns and isinstance(value, dict):
        return _timed_rows_hint(key, value)
    if nouns & {"a number", "a whole number"}:
        return number_hint(key, value)
    if "true or false" in nouns:
        boolean_text = _BOOLEAN_WORDS.get(str(value).lower())
        return boolean_text and f"write {boolean_text}"
    return _choice_hint(faults)


def _timed_rows_hint(key: str | int, value: dict[Any, Any]) -> str | None:
    """Return a hint that writes a mapping of times to values as a list of rows."""
    times = [plain_scalar(str(time)) for time in value]
    if not times or not all(type(time) in (int, float) for time in times):
        return None
    return timed_list_hint(key, timed_rows(zip(times, value.values(), strict=True)))


def number_hint(key: str | int, value: Any) -> str | None:
    """Return a hint with the number that a text or a list likely means."""
    if isinstance(value, list) and len(value) == 1:
        return f"write {flow_value(value[0])}"
    if isinstance(value, list | tuple) and len(value) == 3 and key == "gravity":
        return _magnitude_hint(value)
    text = value.strip() if isinstance(value, str) else ""
    if not text or len(text) > _MAX_NUMBER_LENGTH:
        return None
    if not isinstance(plain_scalar(text), str):
        return f"remove the quotes: {text}"
    if re.fullmatch(r"[-+]?\d*[,-]\d+", text):
        decimal_hint = f"write {text.replace(',', '.')}, with a decimal point"
        range_hint = "write one number; variants of a batch are written 1..4"
        return decimal_hint if "," in text else range_hint
    match = _NUMBER_WITH_UNIT.fullmatch(text)
    return match and _unit_hint(key, float(match[1]), match[2].lower())


def _magnitude_hint(value: Sequence[Any]) -> str | None:
    """Return a hint for a vector where gravity is a downward magnitude."""
    components = [number for number in value if number]
    if len(components) != 1 or not isinstance(components[0], int | float):
        return "write its size, such as 9.81; it pulls down along the up axis"
    return f"write gravity: {abs(components[0]):g}, which pulls down along the up axis"


def _unit_hint(key: str | int, number: float, unit: str) -> str:
    """Return a hint for a number written with a unit."""
    if unit == "%":
        return f"write {number / 100:g}"
    if key == "t":
        return "times of keys are frames, without a unit"
    if key == "seconds" and unit in _SECONDS_PER_UNIT:
        return f"write {number * _SECONDS_PER_UNIT[unit]:g}, in seconds"
    return f"write {number:g}, without a unit"


def _missing_message(missing_step: int | str, value: Any) -> str:
    """Return the message for a missing key, or for a list that is too short."""
    if isinstance(missing_step, str):
        return f"key {missing_step!r} is missing"
    count_text = counted(len(value), "item")
    return f"{count_text} where {_count_phrase(missing_step + 1)} needed"


def _join_messages(texts: Iterable[str]) -> str:
    """Join the messages for the members of a union to one message."""
    first, *other_texts = texts
    subject, negation, kind = first.partition(" is not ")
    prefix = subject + negation
    if negation and other_texts and all(t.startswith(prefix) for t in other_texts):
        kinds = [kind, *(text.removeprefix(prefix) for text in other_texts)]
        return f"{subject} is neither {' nor '.join(kinds)}"
    return "; or ".join((first, *other_texts))


# Faults of values outside an enumeration.
_CHOICE_FAULTS = {"literal_error", "enum", "union_tag_invalid"}


def _value_message(fault: Any) -> str:
    """Return the message of a fault, including the value."""
    value, context, kind = fault["input"], fault.get("ctx", {}), fault["type"]
    value_text = excerpt(value) if isinstance(value, str) else _value_text(value)
    if kind in {"too_short", "too_long", "string_too_long"}:
        length = context.get("min_length", context.get("max_length"))
        noun = "letter" if isinstance(value, str) else "item"
        return f"{counted(len(value), noun)} where {_count_phrase(length)} needed"
    if kind == "missing":
        return _missing_message(fault["loc"][-1], value)
    if kind == "union_tag_not_found":
        return f"key {context['discriminator']} is missing"
    if kind in _CHOICE_FAULTS:
        tag = excerpt(str(context["tag"])) if "tag" in context else value_text
        return f"{tag} is not one of {_allowed_text(context)}"
    expected_noun = _expected_noun(fault)
    if expected_noun is not None:
        return f"{value_text} is not {expected_noun}"
    return _range_message(value_text, fault)


def _expected_noun(pydantic_error: Any) -> str | None:
    """Return what a value of the right type is called; None for other faults."""
    if pydantic_error["type"] == "is_instance_of":
        return "a list" if pydantic_error["ctx"]["class"] == "Sequence" else None
    return _EXPECTED_NOUNS.get(pydantic_error["type"])


def _range_message(value_text: str, pydantic_error: Any) -> str:
    """Return the message for a value of the right type but out of range."""
    context, kind = pydantic_error.get("ctx", {}), pydantic_error["type"]
    if kind == "extra_forbidden":
        return f"unknown key {excerpt(str(pydantic_error['loc'][-1]))}"
    key, comparison = _BOUND_FAULTS.get(kind, ("", ""))
    bound = context.get(key)
    if bound is not None and abs(bound) >= MIN_GENERAL_LIMIT:
        return f"{value_text} is beyond {bound:g}"
    if bound is not None and 0 < bound <= MAX_ZERO_BOUND:
        is_positive = pydantic_error["input"] > 0
        return f"{value_text} is {f'below {bound:g}' if is_positive else 'not above 0'}"
    if bound is not None:
        return f"{value_text} is {comparison.format(f'{bound:g}')}"
    if kind == "value_error":
        return str(context["error"])
    message = pydantic_error["msg"]
    return f"{value_text}: {message[0].lower()}{message[1:]}"


def _choice_hint(faults: Sequence[Any]) -> str | None:
    """Return a hint with the nearest allowed value."""
    for pydantic_error in faults:
        value = pydantic_error.get("ctx", {}).get("tag", pydantic_error["input"])
        if pydantic_error["type"] in _CHOICE_FAULTS and isinstance(value, str):
            names = _allowed_values(pydantic_error)
            if _repeats_axis(value, names):
                return "name each axis once"
            matching_name = _name_ignoring_case(value, names)
            if matching_name is not None:
                return f"write {matching_name}"
            word = value.lower().replace("_", "")
            for replacement in (
                VALUE_ALIASES.get(word),
                FALLBACK_VALUE_ALIASES.get(word),
            ):
                if replacement in names:
                    return f"{value!r} is called {replacement!r} here"
            similar_name = most_similar(value, names)
            if similar_name is not None:
                return f"did you mean {similar_name!r}?"
    return None


def intended_choice(faults: Sequence[Any]) -> str | None:
    """Return the allowed value that differs from the given one in case only.

    Euler orders are excluded, since some tools write extrinsic ones in lower case.
    """
    fault, *other_faults = faults
    value = fault["input"]
    is_choice = fault["type"] in _CHOICE_FAULTS and isinstance(value, str)
    if other_faults or not is_choice or "expected" not in fault["ctx"]:
        return None
    names = _allowed_values(fault)
    return None if "XYZ" in names else _name_ignoring_case(value, names)


def _allowed_values(fault: Any) -> list[str]:
    """Return the values of the enumeration that a value is outside of."""
    return re.findall(r"'([^']*)'", str(_allowed_text(fault.get("ctx", {}))))


def _allowed_text(context: dict[str, Any]) -> Any:
    return context.get("expected", context.get("expected_tags"))


def _name_ignoring_case(value: str, names: Sequence[str]) -> str | None:
    """Return the name that equals a value apart from case."""
    return next((name for name in names if name.lower() == value.lower()), None)


def _repeats_axis(value: str, names: Sequence[str]) -> bool:
    """Return whether a value is an axis order that repeats an axis."""
    is_order = re.fullmatch("[XYZ]{3}", value.upper()) is not None
    return is_order and "XYZ" in names and len(set(value.upper())) < len(value)


def _count_phrase(count: int) -> str:
    return f"{count} is" if count == 1 else f"{count} are"


def _value_text(value: Any) -> str:
    """Return a value as YAML, shortened for a message."""
    if value is None:
        return "nothing"
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, dict | list | tuple):
        return excerpt(flow_value(value))[1:-1]
    return excerpt(str(value)).strip("'")
