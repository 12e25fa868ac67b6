"""Options of a record, each declared once: on its field, with its valid range.

A record states the ranges of its numbers once, and `range_faults` checks all of them::

    step: Annotated[float | None, above(0, "SIM004", finite=True)] = None

Records are dataclasses, or the models of files; pydantic does not look at a `Range`.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import MISSING, field, fields, make_dataclass
from enum import StrEnum
from fractions import Fraction
from functools import cache
from typing import Any, ClassVar, Literal, TypeAlias, TypeVar, cast, get_type_hints

from animtool.core.arguments import argument, as_text
from animtool.core.errors import Fault, OptionError, excerpt
from animtool.core.names import most_similar
from animtool.core.record import dataclass
from animtool.core.units import LengthUnit, UpAxis, parse_length

# Kind of a value, which determines its spelling in files and on the command line.
OptionKind: TypeAlias = Literal[
    "switch", "answer", "text", "file", "output", "choice", "unit", "axis", "rate",
    "range", "frame", "rest", "source_rest", "offsets", "length", "lengths", "count",
    "name", "names", "angle", "amount", "seed", "codes", "severities", "processes",
    "frames", "texts",
]  # fmt: skip


@dataclass(frozen=True, slots=True)
class Key:
    """Documentation of an option as a key in one kind of file."""

    description: str
    example: Any
    choices: tuple[str, ...] = ()  # of a choice
    alias: str | None = None  # the key, if it differs from the field's name
    read: Callable[[Any], Any] | None = None  # converts the key's value to the field's


def key(text: str, example: Any, default: Any = MISSING, **settings: Any) -> Any:
    """Return a dataclass field that is documented as a key of a file.

    Without a default the key is required; ``settings`` are other arguments of `Key`.
    """
    return field(default=default, metadata={"key": Key(text, example, **settings)})


class _KeyDocstring:
    """Descriptor of a class docstring that lists the keyed fields when accessed."""

    def __init__(self, docstring: str) -> None:
        self.docstring = docstring

    def __get__(self, instance: object, owner: type[Any]) -> str:
        head, _, attribute_lines = self.docstring.partition("    Attributes:\n")
        _, separator, text_after_list = attribute_lines.partition("\n\n")
        texts_by_name = {
            name: text
            for base in reversed(owner.__mro__)
            for text, name in re.findall(_ATTRIBUTE_LINE, _plain_docstring(base), re.M)
        }
        description = {name: option.about for name, option in options_of(owner).items()}
        description |= {name: key.description for name, key in keys_of(owner).items()}
        for name, text in description.items():
            if text:
                texts_by_name.setdefault(name, f"        {name}: {text}\n")
        if not texts_by_name:
            return self.docstring
        names = [option.name for option in fields(owner)]
        texts = [texts_by_name[name] for name in names if name in texts_by_name]
        attribute_lines = f"    Attributes:\n{''.join(texts)}{separator[1:]}"
        return f"{head.rstrip()}\n\n{attribute_lines}{text_after_list or '    '}"


# An attribute in a docstring, with its continuation lines.
_ATTRIBUTE_LINE = r"^( {8}(\w+): .*\n(?: {12}.*\n)*)"


def _plain_docstring(owner: type[Any]) -> str:
    text = vars(owner).get("__doc__") or ""
    return text.docstring if isinstance(text, _KeyDocstring) else text


DocumentedT = TypeVar("DocumentedT")


def inherits_docs(record: type[DocumentedT]) -> type[DocumentedT]:
    """Return a dataclass whose docstring lists its keys and inherited fields."""
    record.__doc__ = cast(str, _KeyDocstring(record.__doc__ or ""))
    return record


@dataclass(frozen=True, slots=True)
class Option:
    """Declaration of an option: its scope, type and texts."""

    kind: OptionKind
    flag: str = ""  # command-line name, if it differs from the field's
    not_for: tuple[str, ...] = ()  # uses that refuse it
    layer_refusal: str = ""  # why an animation layer refuses it; empty if it does not
    # Options that it excludes, with the message if it is not the default.
    excludes: Mapping[str, str] = field(default_factory=dict)
    required_option: str = ""  # another option that it requires, if any
    # Message if that option is missing, if it is not the default.
    missing_message: str = ""
    scene: Key | None = None
    batch: Key | None = None
    help: str = ""  # help on the command line; empty if commands declare their own
    # Placeholder of the value in help; None uses that of its kind.
    metavar: str | None = None
    choices: tuple[str, ...] = ()  # on the command line; for a switch, off and on
    min_count: int = 0  # minimum of a count
    reason: str = ""  # why a source may not have it
    # Default in the command line's unit, if that differs.
    text_default: str | float | None = None
    short_flag: str = ""  # one-letter flag

    @property
    def about(self) -> str:
        """Description for Python: the one used in files, else the help text.

        Empty if its command-line values are not values in Python.
        """
        key = self.scene or self.batch
        if key is None and self.kind in {"switch", "answer"} and self.choices:
            return ""
        text = key.description if key else as_text(self.help)
        return f"{text} {_UNITS.get(self.kind, '')}".rstrip()


# Units of numbers that files and the command line write with a unit.
_UNITS: dict[OptionKind, str] = {"length": "[m]", "lengths": "[m]", "angle": "[rad]"}


def option(
    default: Any,
    kind: OptionKind,
    *,
    default_factory: Any = MISSING,
    common_key: Key | None = None,
    **settings: Any,
) -> Any:
    """Return a dataclass field that is an option.

    The defaults are those of `dataclasses.field`. ``common_key`` is the key of both
    scenes and batches, and ``settings`` are other arguments of `Option`.
    """
    declaration = Option(kind, **{"scene": common_key, "batch": common_key, **settings})
    return field(
        default=default,
        default_factory=default_factory,
        metadata={"option": declaration},
    )


def options_of(record: Any) -> dict[str, Option]:
    """Return the options of a record or its class by name, in order."""
    return _metadata_of(record, "option")


def _metadata_of(record: Any, name: str) -> dict[str, Any]:
    """Return an entry of the fields' metadata, by field name."""
    return {e.name: e.metadata[name] for e in fields(record) if name in e.metadata}


FileKind: TypeAlias = Literal["scene", "batch"]


def keys_of(record: Any, file_kind: FileKind | None = None) -> Mapping[str, Key]:
    """Return the keys of a record in one kind of file, by field name.

    Without a kind, the keys of `key`, which any file may have.
    """
    if file_kind is None:
        return _metadata_of(record, "key")
    keys = {
        name: getattr(option, file_kind) for name, option in options_of(record).items()
    }
    return {name: key for name, key in keys.items() if key is not None}


Record = TypeVar("Record")
MemberT = TypeVar("MemberT", bound=StrEnum)
_INHERITED_ATTRIBUTES = ("__module__", "__doc__")
# Types of text values: lengths are text, angles are in degrees.
_TEXT_VALUE_TYPES: dict[OptionKind, type] = {"length": str, "angle": float}


def convert_option_values(record: Any) -> None:
    """Convert text values of a frozen record's options to their types.

    Units, up axes, lengths such as ``1mm`` and offsets of samples may be text or plain
    numbers; other values, and unknown words of a choice, are refused (SCN025).
    """
    for name, declaration in options_of(record).items():
        value = getattr(record, name)
        convert = _VALUE_CONVERTERS.get(declaration.kind)
        if value is None or convert is None:
            continue
        try:
            converted_value = convert(value, declaration)
        except (TypeError, ValueError) as error:
            message = f"{name} is {excerpt(str(value))}: {error}"
            raise OptionError(Fault("SCN025", message)) from error
        if converted_value is not value:
            object.__setattr__(record, name, converted_value)


def _unit(value: Any, _: Option) -> LengthUnit:
    return value if isinstance(value, LengthUnit) else _member(LengthUnit, value)


def _axis(value: Any, _: Option) -> UpAxis:
    if isinstance(value, UpAxis):
        return value
    return _member(UpAxis, str(value).upper())


def _member(choices: type[MemberT], word: Any) -> MemberT:
    _check_word(str(word), [str(choice) for choice in choices])
    return choices(str(word))


def _choice(value: Any, declaration: Option) -> Any:
    keys = (declaration.scene, declaration.batch)
    words = dict.fromkeys(declaration.choices)
    words |= dict.fromkeys(word for each in keys if each for word in each.choices)
    if words:
        _check_word(str(value), list(words))
    return value


def _check_word(word: str, words: Sequence[str]) -> None:
    """Raise `ValueError` for a word that is not among the allowed ones."""
    if word not in words:
        suggestion = most_similar(word, words)
        hint = f"; did you mean {suggestion!r}?" if suggestion else ""
        raise ValueError(f"it is one of {', '.join(words)}{hint}")


def _length(value: Any, _: Option) -> float:
    return parse_length(value) if isinstance(value, str) else value


def _codes(value: Any, _: Option) -> Any:
    return (value,) if isinstance(value, str) else value


def _processes(value: Any, _: Option) -> Any:
    if not isinstance(value, int) or value < 1:
        raise ValueError("it is a whole number from 1 up, or None")
    return value


def _offsets(value: Any, _: Option) -> tuple[Fraction, ...]:
    if isinstance(value, tuple) and all(isinstance(each, Fraction) for each in value):
        return value
    return tuple(Fraction(str(each)) for each in value)


_VALUE_CONVERTERS: dict[OptionKind, Callable[[Any, Option], Any]] = {
    "unit": _unit,
    "axis": _axis,
    "choice": _choice,
    "length": _length,
    "offsets": _offsets,
    "codes": _codes,
    "processes": _processes,
}


def with_text_values(
    record: type[Any], *first_names: str
) -> Callable[[type[Record]], type[Record]]:
    """Return a decorator that adds a record's options, as text, to a frozen dataclass.

    first_names: Names of options that precede the others.
    """

    def add_options(record_type: type[Record]) -> type[Record]:
        type_hints, options = get_type_hints(record), options_of(record)
        new_fields = []
        for name in dict.fromkeys((*first_names, *options)):
            text_type = _TEXT_VALUE_TYPES.get(options[name].kind)
            default_value = record.__dataclass_fields__[name].default
            default = default_value if text_type is None else options[name].text_default
            new_fields.append((name, text_type or type_hints[name], default))
        namespace = {name: getattr(record_type, name) for name in _INHERITED_ATTRIBUTES}
        name, bases = record_type.__name__, (record_type,)
        text_record: type[Record] = make_dataclass(
            name, new_fields, bases=bases, namespace=namespace, frozen=True
        )
        return text_record

    return add_options


def changed_options(record: Any) -> dict[str, Option]:
    """Return the options of a record whose values differ from their defaults."""
    defaults = {each.name: each.default for each in fields(record)}
    return {
        name: option
        for name, option in options_of(record).items()
        if (value := getattr(record, name)) != defaults[name]
        and not (option.kind == "answer" and value)
    }


def option_marker(name: str, declaration: Option) -> str:
    """Return the marker by which a text names an option."""
    return argument(name, {"switch": True, "answer": False}.get(declaration.kind))


def refused_options(record: Any, use: str) -> dict[str, Option]:
    """Return the changed options of a record that cannot be used in a given way.

    The result maps the marker of each to its reason.
    """
    changes = changed_options(record).items()
    refused_changes = [change for change in changes if use in change[1].not_for]
    return {option_marker(name, option): option for name, option in refused_changes}


def clash_messages(record: Any) -> list[str]:
    """Return messages about changed options that exclude or require other options."""
    options, changes = options_of(record), changed_options(record)
    markers = {name: option_marker(name, option) for name, option in options.items()}
    messages = []
    for name, changed_option in changes.items():
        for excluded_name, message in changed_option.excludes.items():
            if excluded_name in changes:
                pair_text = f"{markers[name]} and {markers[excluded_name]}"
                default_text = f"{pair_text} exclude each other: use one of them"
                messages.append(message or default_text)
        required_name = changed_option.required_option
        if required_name and required_name not in changes:
            message = f"{markers[name]} needs {markers[required_name]}"
            messages.append(changed_option.missing_message or message)
    return messages


# Message template for a number of an entry in a file.
ENTRY_RANGE_MESSAGE = "its {name} must be {bound}, not {value:g}"
# Upper limit of options without another limit.
MAX_OPTION_VALUE = 1e9
# Message template for an argument.
ARGUMENT_RANGE_MESSAGE = "{name} must be {bound}, not {value:g}"


@dataclass(frozen=True, slots=True)
class Range:
    """Allowed values of a number or of a vector's components; NaN is never allowed."""

    bound: str  # description, as in "must be above 0"
    code: str
    minimum: float
    maximum: float = math.inf
    includes_minimum: bool = True  # whether the minimum itself is valid
    finite: bool = False  # whether infinity is invalid
    count: int = 0  # number of components; 0 for a scalar

    def holds(self, value: Any) -> bool:
        """Return whether a number, or a vector, is in range."""
        if value is None:
            return True
        values = value if self.count else (value,)
        return len(values) == (self.count or 1) and all(
            map(self._holds_component, values)
        )

    def _holds_component(self, value: float) -> bool:
        in_range = self.minimum <= value <= self.maximum
        if self.finite and not math.isfinite(value):
            return False
        return in_range and (self.includes_minimum or value > self.minimum)


def above(minimum: float, code: str, *, finite: bool = False) -> Range:
    """Return a range whose minimum is excluded.

    >>> above(0, "SIM004", finite=True).bound
    'finite and above 0'
    """
    bound = _bound_text(f"above {minimum:g}", finite=finite)
    return Range(bound, code, minimum, includes_minimum=False, finite=finite)


def or_more(minimum: float, code: str, *, finite: bool = False) -> Range:
    """Return a range with an included minimum, described as "0 or more"."""
    return Range(
        _bound_text(f"{minimum:g} or more", finite=finite), code, minimum, finite=finite
    )


def at_least(minimum: float, code: str, *, finite: bool = False) -> Range:
    """Return a range with an included minimum, described as "at least 1e-06"."""
    bound = _bound_text(f"at least {minimum:g}", finite=finite)
    return Range(bound, code, minimum, finite=finite)


def between(
    minimum: float,
    code: str,
    maximum: float = MAX_OPTION_VALUE,
    *,
    includes_minimum: bool = True,
) -> Range:
    """Return a range between two finite numbers.

    >>> between(0, "SIM062", 1.0, includes_minimum=False).bound
    'more than 0 and at most 1'
    """
    bound = f"{minimum:g} or more" if includes_minimum else f"more than {minimum:g}"
    bound += f" and at most {maximum:g}"
    return Range(bound, code, minimum, maximum, includes_minimum, finite=True)


def _bound_text(text: str, *, finite: bool) -> str:
    return f"finite and {text}" if finite else text


@cache
def ranges_of(record: type[Any]) -> Mapping[str, Range]:
    """Return the valid ranges that a record declares in its annotations, by field.

    >>> from animtool.systems.springs import SpringOptions
    >>> ranges_of(SpringOptions)["longest"].bound
    'above 1'
    """
    if hasattr(record, "model_fields"):
        constraints = {name: e.metadata for name, e in record.model_fields.items()}
    else:
        type_hints = get_type_hints(record, include_extras=True).items()
        constraints = {name: getattr(h, "__metadata__", ()) for name, h in type_hints}
    return {
        name: constraint
        for name, field_constraints in constraints.items()
        for constraint in field_constraints
        if isinstance(constraint, Range)
    }


def range_faults(record: Any, message: str = ARGUMENT_RANGE_MESSAGE) -> list[Fault]:
    """Return a fault for each number of a record that is out of range.

    >>> from animtool.systems.springs import SpringOptions
    >>> [str(fault) for fault in range_faults(SpringOptions(step=0.0, longest=1.0))]
    ['SIM004 step: step must be finite and above 0, not 0', 'SIM004 longest: longest \
must be above 1, not 1']
    """
    kind: Any = type(record)
    faults = []
    for name, valid_range in ranges_of(kind).items():
        value = getattr(record, name)
        if not valid_range.holds(value):
            template = message.partition(", not ")[0] if valid_range.count else message
            text = template.format(name=name, bound=valid_range.bound, value=value)
            faults.append(Fault(valid_range.code, text, where=name))
    return faults


class CheckedRecord:
    """Base of records that report their own invalid values."""

    __slots__ = ()
    code: ClassVar[str]

    def problems(self) -> list[tuple[str, str]]:
        """Return the name of each invalid option with the reason."""
        faults = range_faults(self, ENTRY_RANGE_MESSAGE)
        return [(str(fault.where), fault.message) for fault in faults]

    def faults(self, where: str) -> list[Fault]:
        """Return a fault for each invalid option, all with the record's code."""
        return [Fault(self.code, reason, where=where) for _, reason in self.problems()]
