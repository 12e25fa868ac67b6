"""Argument names in texts, replaced by the names of Python, command line or files.

Texts of the library name arguments with `argument`; the interface that prints a text
replaces them by its own names: ``fps`` in Python, ``--fps`` on the command line,
``fps:`` in a file::

    Fault("MKR010", message, hint=f"{argument('source.fps')} gives the rate")

Names are field names of records. Those of inputs begin with ``source.``, and those that
only commands have with ``command.``.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import TypeAlias

from animtool.core.record import dataclass

# Unicode noncharacters, which do not occur in exchanged text.
_ARGUMENT_BEGIN = "\ufdd0"
_ARGUMENT_VALUE = "\ufdd1"
_ARGUMENT_END = "\ufdd2"
_CLAUSE_BEGIN = "\ufdd3"
_CLAUSE_END = "\ufdd4"
_ARGUMENT_PATTERN = re.compile(
    f"{_ARGUMENT_BEGIN}([a-z0-9_.]+)"
    f"(?:{_ARGUMENT_VALUE}([^{_ARGUMENT_BEGIN}-{_ARGUMENT_END}]*))?{_ARGUMENT_END}"
)
_CLAUSE = re.compile(f"{_CLAUSE_BEGIN}([^{_CLAUSE_BEGIN}{_CLAUSE_END}]*){_CLAUSE_END}")


@dataclass(frozen=True, slots=True)
class Argument:
    """An argument that a text mentions, and the value that the text gives it."""

    name: str  # dotted name of the field, such as `source.fps`
    value: str | None = None  # value as files write it, if the text states one

    @property
    def field(self) -> str:
        """Name of the field without a prefix."""
        return self.name.rpartition(".")[2]

    @property
    def boolean_value(self) -> bool | None:
        """The stated value as a boolean; None if no boolean is stated."""
        return {"true": True, "false": False}.get(self.value or "")


@dataclass(frozen=True, slots=True)
class Clause:
    """Part of a text, omitted if the interface has no name for its arguments."""

    parts: tuple[TextPart, ...]


TextPart: TypeAlias = str | Argument | Clause
# Maps an argument to its name in an interface; None if it has none there.
ArgumentNamer: TypeAlias = Callable[[Argument], str | None]


def python_name(argument: Argument) -> str | None:
    """Return the name of an argument in a Python call.

    >>> python_name(Argument("source.fps")), python_name(Argument("form", "layer"))
    ('fps', 'form="layer"')
    """
    if argument.name.startswith("command."):
        return None
    if argument.value is None:
        return argument.field
    if argument.boolean_value is not None:
        return f"{argument.field}={argument.boolean_value}"
    try:
        float(argument.value)
    except ValueError:
        return f'{argument.field}="{argument.value}"'
    return f"{argument.field}={argument.value}"


# Keys of files that differ from the argument's name.
FILE_KEYS = {
    "source.unit": "units",
    "source.prim_path": "prim",
    "form": "as",
    "frame_range": "range",
    "rest_frame": "rest",
    "set": "variables",
}


def file_key(argument: Argument) -> str:
    """Return the name of an argument in scene and batch files.

    >>> file_key(Argument("source.fps")), file_key(Argument("form", "layer"))
    ('fps:', 'as: layer')
    """
    key = FILE_KEYS.get(argument.name, argument.field)
    return f"{key}: {argument.value or ''}".rstrip()


class TextWithArguments(str):
    """A text that names arguments as in Python; `name_arguments` names them for others.

    Attributes:
        parts: The joined parts.
    """

    __slots__ = ("parts",)
    parts: tuple[TextPart, ...]

    def __new__(cls, parts: tuple[TextPart, ...]) -> TextWithArguments:
        """Join parts, with arguments named as in Python."""
        text = super().__new__(cls, _join_parts(parts, python_name))
        text.parts = parts
        return text

    def __reduce__(self) -> tuple[type[TextWithArguments], tuple[tuple[TextPart, ...]]]:
        """Keep the parts when pickled."""
        return TextWithArguments, (self.parts,)

    def __add__(self, other: str) -> TextWithArguments:
        """Return the concatenation of both texts, with their arguments."""
        return TextWithArguments((*self.parts, *_split_clauses(other)))

    def __radd__(self, other: str) -> TextWithArguments:
        """Return the concatenation of both texts, with their arguments."""
        return TextWithArguments((*_split_clauses(other), *self.parts))


def argument(name: str, value: object = None) -> str:
    """Return a marker that names an argument in a text; `as_text` resolves it.

    Args:
        name: Field name, with ``source.`` for inputs.
        value: Value stated by the text; None for no value.
    """
    if value is None:
        return f"{_ARGUMENT_BEGIN}{name}{_ARGUMENT_END}"
    value_text = str(value).lower() if isinstance(value, bool) else str(value)
    return f"{_ARGUMENT_BEGIN}{name}{_ARGUMENT_VALUE}{value_text}{_ARGUMENT_END}"


def clause(text: str) -> str:
    """Mark a part of a text to be left out if an argument in it has no name.

    >>> as_text("at night" + clause(f", not {argument('command.quiet')}"))
    'at night'
    """
    return f"{_CLAUSE_BEGIN}{text}{_CLAUSE_END}"


def flag(name: str, value: str = "") -> str:
    """Return a command-line flag and its value, for a hint that quotes a command.

    >>> flag("shot", "NAME")
    '--shot NAME'
    """
    return f"--{name} {value}".rstrip()


def as_text(text: str) -> str:
    """Return a text with `argument` markers as a `TextWithArguments`.

    >>> as_text(f"{argument('keep_samples', True)} keeps them")
    'keep_samples=True keeps them'
    """
    if isinstance(text, TextWithArguments) or not (
        _ARGUMENT_BEGIN in text or _CLAUSE_BEGIN in text
    ):
        return text
    return TextWithArguments(_split_clauses(text))


def name_arguments(text: str, namer: ArgumentNamer) -> str:
    """Return a text with its arguments named as an interface names them.

    >>> name_arguments(as_text(f"{argument('up', 'Z')} says it"), file_key)
    'up: Z says it'
    """
    text = as_text(text)
    if isinstance(text, TextWithArguments):
        return _join_parts(text.parts, namer)
    return text


def _join_parts(parts: tuple[TextPart, ...], namer: ArgumentNamer) -> str:
    return "".join(_part_text(part, namer) for part in parts)


def _part_text(part: TextPart, namer: ArgumentNamer) -> str:
    if isinstance(part, Argument):
        return namer(part) or getattr(namer, "name_elsewhere", file_key)(part)
    if isinstance(part, Clause):
        arguments = [inner for inner in part.parts if isinstance(inner, Argument)]
        return _join_parts(part.parts, namer) if all(map(namer, arguments)) else ""
    return part


def _split_clauses(text: str) -> tuple[TextPart, ...]:
    if isinstance(text, TextWithArguments):
        return text.parts
    parts: list[TextPart] = []
    position = 0
    for match in _CLAUSE.finditer(text):
        parts += [
            *_split_arguments(text[position : match.start()]),
            Clause(_split_arguments(match[1])),
        ]
        position = match.end()
    return (*parts, *_split_arguments(text[position:]))


def _split_arguments(text: str) -> tuple[TextPart, ...]:
    """Split a text without clauses into plain texts and arguments."""
    parts: list[TextPart] = []
    position = 0
    for match in _ARGUMENT_PATTERN.finditer(text):
        parts += [text[position : match.start()], Argument(match[1], match[2])]
        position = match.end()
    return tuple(part for part in (*parts, text[position:]) if part)
