"""Options of a record, each declared once: on its field, with the range of its numbers.

A record says once what its numbers may be, and `range_faults` checks all of them::

    step: Annotated[float | None, above(0, "SIM004", finite=True)] = None

Records are dataclasses, or the models of files; pydantic does not look at a `Range`.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping
from dataclasses import MISSING, field, fields, make_dataclass
from functools import cache
from typing import (
    Any,
    ClassVar,
    Literal,
    TypeAlias,
    TypeVar,
    cast,
    get_args,
    get_type_hints,
)

from animtool.core.arguments import argument, marked
from animtool.core.errors import Fault
from animtool.core.record import dataclass

# What a value is, and so how files and the command line write it.
OptionKind: TypeAlias = Literal[
    "switch", "answer", "text", "file", "output", "choice", "unit", "axis", "rate",
    "range", "frame", "rest", "source_rest", "offsets", "length", "lengths", "count",
    "name", "names", "angle", "amount", "seed", "codes", "severities", "processes",
    "frames", "texts",
]  # fmt: skip


@dataclass(frozen=True, slots=True)
class Key:
    """How a kind of file documents the key of an option."""

    description: str
    example: Any
    choices: tuple[str, ...] = ()  # of a choice
    alias: str | None = None  # the key, where it is not the name of the field
    read: Callable[[Any], Any] | None = None  # makes the field's value of the key's


def key(text: str, example: Any, default: Any = MISSING, **said: Any) -> Any:
    """Return the dataclass field of a key.

    Args:
        text: What it is.
        example: A value of it.
        default: Its value if it is not given; without one it must be given.
        said: What else `Key` has.
    """
    return field(default=default, metadata={"key": Key(text, example, **said)})


class _DocOfKeys:
    """A docstring with the keyed fields, built on access."""

    def __init__(self, docstring: str) -> None:
        self.docstring = docstring

    def __get__(self, instance: object, owner: type[Any]) -> str:
        head, _, listed = self.docstring.partition("    Attributes:\n")
        _, blank, rest = listed.partition("\n\n")
        texts_by_name = {
            name: text
            for base in reversed(owner.__mro__)
            for text, name in re.findall(_ATTRIBUTE, _plain_docstring(base), re.M)
        }
        about = {name: each.about for name, each in options_of(owner).items()}
        about |= {name: key.description for name, key in keys_of(owner).items()}
        for name, text in about.items():
            if text:
                texts_by_name.setdefault(name, f"        {name}: {text}\n")
        if not texts_by_name:
            return self.docstring
        names = [each.name for each in fields(owner)]
        texts = [texts_by_name[name] for name in names if name in texts_by_name]
        listed = f"    Attributes:\n{''.join(texts)}{blank[1:]}"
        return f"{head.rstrip()}\n\n{listed}{rest or '    '}"


# An attribute of a docstring, with its continuation lines.
_ATTRIBUTE = r"^( {8}(\w+): .*\n(?: {12}.*\n)*)"


def _plain_docstring(owner: type[Any]) -> str:
    text = vars(owner).get("__doc__") or ""
    return text.docstring if isinstance(text, _DocOfKeys) else text


Described = TypeVar("Described")


def inherits_docs(record: type[Described]) -> type[Described]:
    """Return a dataclass whose docstring lists its keys and inherited fields."""
    record.__doc__ = cast(str, _DocOfKeys(record.__doc__ or ""))
    return record


@dataclass(frozen=True, slots=True)
class Option:
    """Declaration of an option and where it applies."""

    kind: OptionKind
    flag: str = ""  # word of the command line, where it is not the name of the field
    label: str = ""  # as refusals name it in a scene
    not_for: tuple[str, ...] = ()  # uses that refuse it
    over_layer: str = ""  # why an animation layer refuses it; empty where it does not
    # Options that it excludes, with the refusal's message if not the default.
    excludes: Mapping[str, str] = field(default_factory=dict)
    goes_with: str = ""  # another option that it needs, or none
    lacking: str = ""  # the refusal's message where that is missing, if not the default
    scene: Key | None = None
    batch: Key | None = None
    help: str = ""  # of the command line; empty where commands have another such option
    metavar: str | None = (
        None  # placeholder of the value in help; None is that of its kind
    )
    choices: tuple[str, ...] = ()  # on the command line; of a switch, off and on
    least: int = 0  # of a count
    reason: str = ""  # why a source may not take it
    # The default, where the command line has another unit.
    written: str | float | None = None
    short: str = ""  # the flag of one letter

    @property
    def about(self) -> str:
        """Its documentation in Python: that of files, else the help.

        Nothing, where its words on the command line are no values in Python.
        """
        key = self.scene or self.batch
        if key is None and self.kind in {"switch", "answer"} and self.choices:
            return ""
        text = key.description if key else marked(self.help)
        return f"{text} {_UNITS.get(self.kind, '')}".rstrip()


# Of numbers that files and the command line write with a unit.
_UNITS: dict[OptionKind, str] = {"length": "[m]", "lengths": "[m]", "angle": "[rad]"}


def option(
    default: Any,
    kind: OptionKind,
    *,
    default_factory: Any = MISSING,
    both: Key | None = None,
    **said: Any,
) -> Any:
    """Return the dataclass field of an option.

    Args:
        default: As `dataclasses.field` takes it, or ``MISSING``.
        kind: What the value is.
        default_factory: Likewise.
        both: The key of scenes and batches.
        said: What else `Option` has.
    """
    inherits_docs = Option(kind, **{"scene": both, "batch": both, **said})
    return field(
        default=default,
        default_factory=default_factory,
        metadata={"option": inherits_docs},
    )


def options_of(record: Any) -> dict[str, Option]:
    """Return the options of a record or its class by name, in order."""
    return {
        entry.name: entry.metadata["option"]
        for entry in fields(record)
        if "option" in entry.metadata
    }


FileKind: TypeAlias = Literal["scene", "batch"]


def keys_of(record: Any, file_kind: FileKind | None = None) -> Mapping[str, Key]:
    """Return the keys of a record in a kind of file, by field.

    Without a kind those of `key` and of annotations, which any file may have.
    """
    if file_kind is None:
        return _keys(record)
    keys = {name: getattr(o, file_kind) for name, o in options_of(record).items()}
    return {name: key for name, key in keys.items() if key is not None}


@cache
def _keys(record: Any) -> Mapping[str, Key]:
    hints = get_type_hints(record, include_extras=True)
    notes = {
        each.name: (*get_args(hints[each.name]), each.metadata.get("key"))
        for each in fields(record)
    }
    return {n: note for n in notes for note in notes[n] if isinstance(note, Key)}


Record = TypeVar("Record")
# What files write for a value of some kinds: a length as text, an angle in degrees.
_WRITTEN: dict[OptionKind, type] = {"length": str, "angle": float}


def with_text_values(
    record: type[Any], *first: str
) -> Callable[[type[Record]], type[Record]]:
    """Give a frozen dataclass the options of a record with text values.

    first: Names of options that come before the others.
    """

    def add(record_type: type[Record]) -> type[Record]:
        hints, options = get_type_hints(record), options_of(record)
        more = []
        for name in dict.fromkeys((*first, *options)):
            written = _WRITTEN.get(options[name].kind)
            default_value = record.__dataclass_fields__[name].default
            default = default_value if written is None else options[name].written
            more.append((name, written or hints[name], default))
        inherits_docs = {
            "__module__": record_type.__module__,
            "__doc__": record_type.__doc__,
        }
        written_record: type[Record] = make_dataclass(
            record_type.__name__,
            more,
            bases=(record_type,),
            namespace=inherits_docs,
            frozen=True,
        )
        return written_record

    return add


def chosen_options(record: Any) -> dict[str, Option]:
    """Return the options that differ from their defaults."""
    defaults = {entry.name: entry.default for entry in fields(record)}
    return {
        name: inherits_docs
        for name, inherits_docs in options_of(record).items()
        if (value := getattr(record, name)) != defaults[name]
        and not (inherits_docs.kind == "answer" and value)
    }


def option_marker(name: str, inherits_docs: Option) -> str:
    """Return the marker of an option in a text."""
    return argument(name, {"switch": True, "answer": False}.get(inherits_docs.kind))


def refused_options(record: Any, use: str) -> dict[str, Option]:
    """Return the chosen options that a use refuses, by their markers.

    By the marker of each in a text.
    """
    chosen = chosen_options(record).items()
    return {
        option_marker(name, option): option
        for name, option in chosen
        if use in option.not_for
    }


def clashes(record: Any) -> list[str]:
    """Return messages of chosen options that exclude or lack one another."""
    options, chosen = options_of(record), chosen_options(record)
    names = {name: option_marker(name, option) for name, option in options.items()}
    messages = []
    for name, one in chosen.items():
        for other, message in one.excludes.items():
            if other in chosen:
                default_message = f"{names[name]} and {names[other]} exclude each other"
                messages.append(message or default_message)
        if one.goes_with and one.goes_with not in chosen:
            default_message = f"{names[name]} needs {names[one.goes_with]}"
            messages.append(one.lacking or default_message)
    return messages


# What a message says of a number of an entry in a file.
OF_ENTRY = "its {name} must be {bound}, not {value:g}"
# What options may be at most, where nothing else limits them.
LARGEST = 1e9
# What a message says of an argument.
OF_ARGUMENT = "{name} must be {bound}, not {value:g}"


@dataclass(frozen=True, slots=True)
class Range:
    """Allowed values of a number or a vector's components; NaN is never allowed."""

    bound: str  # in words, as in "must be above 0"
    code: str
    least: float
    most: float = math.inf
    reached: bool = True  # whether the least is in range itself
    finite: bool = False  # whether infinity is out of range
    count: int = 0  # numbers of a vector; 0 is a number

    def holds(self, value: Any) -> bool:
        """Return whether a number, or a vector, is in range."""
        if value is None:
            return True
        values = value if self.count else (value,)
        return len(values) == (self.count or 1) and all(map(self._holds, values))

    def _holds(self, value: float) -> bool:
        inside = self.least <= value <= self.most
        if self.finite and not math.isfinite(value):
            return False
        return inside and (self.reached or value > self.least)


def above(least: float, code: str, *, finite: bool = False) -> Range:
    """Return a range that does not hold its least number.

    >>> above(0, "SIM004", finite=True).bound
    'finite and above 0'
    """
    bound = _bound(f"above {least:g}", finite=finite)
    return Range(bound, code, least, reached=False, finite=finite)


def or_more(least: float, code: str, *, finite: bool = False) -> Range:
    """Return a range with a lower bound, worded "0 or more"."""
    return Range(
        _bound(f"{least:g} or more", finite=finite), code, least, finite=finite
    )


def at_least(least: float, code: str, *, finite: bool = False) -> Range:
    """Return a range with a lower bound, worded "at least 1e-06"."""
    bound = _bound(f"at least {least:g}", finite=finite)
    return Range(bound, code, least, finite=finite)


def within(
    least: float, code: str, most: float = LARGEST, *, reached: bool = True
) -> Range:
    """Return a range between two finite numbers.

    >>> within(0, "SIM062", 1.0, reached=False).bound
    'more than 0 and at most 1'
    """
    bound = f"{least:g} or more" if reached else f"more than {least:g}"
    bound += f" and at most {most:g}"
    return Range(bound, code, least, most, reached, finite=True)


def _bound(text: str, *, finite: bool) -> str:
    return f"finite and {text}" if finite else text


@cache
def ranges_of(record: type[Any]) -> Mapping[str, Range]:
    """Return the declared ranges of a record, by field.

    >>> from animtool.systems.springs import SpringOptions
    >>> ranges_of(SpringOptions)["longest"].bound
    'above 1'
    """
    if hasattr(record, "model_fields"):
        declared = {name: each.metadata for name, each in record.model_fields.items()}
    else:
        hints = get_type_hints(record, include_extras=True)
        declared = {name: getattr(hints[name], "__metadata__", ()) for name in hints}
    return {
        name: each
        for name, metadata in declared.items()
        for each in metadata
        if isinstance(each, Range)
    }


def range_faults(record: Any, message: str = OF_ARGUMENT) -> list[Fault]:
    """Return a fault for each number of a record out of its range.

    >>> from animtool.systems.springs import SpringOptions
    >>> [str(fault) for fault in range_faults(SpringOptions(step=0.0, longest=1.0))]
    ['SIM004 step: step must be finite and above 0, not 0', 'SIM004 longest: longest \
must be above 1, not 1']
    """
    kind: Any = type(record)
    faults = []
    for name, allowed in ranges_of(kind).items():
        value = getattr(record, name)
        if not allowed.holds(value):
            words = message.partition(", not ")[0] if allowed.count else message
            text = words.format(name=name, bound=allowed.bound, value=value)
            faults.append(Fault(allowed.code, text, where=name))
    return faults


class Checked:
    """A record of an entry that reports its invalid values."""

    __slots__ = ()
    code: ClassVar[str]

    def problems(self) -> list[tuple[str, str]]:
        """Return the invalid options, each with the reason."""
        faults = range_faults(self, OF_ENTRY)
        return [(str(fault.where), fault.message) for fault in faults]

    def faults(self, where: str) -> list[Fault]:
        """Return the invalid options as faults of one code."""
        return [Fault(self.code, why, where=where) for _, why in self.problems()]
