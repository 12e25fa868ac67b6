"""Argument names in texts, worded for Python, the command line or a file.

A text of the library names an argument by `argument`; what prints it says what that is
called there: ``fps`` in Python, ``--fps`` on the command line, ``fps:`` in a file::

    Fault("MKR010", message, hint=f"{argument('source.fps')} gives the rate")

Names are those of records' fields; of what is read they begin with ``source.``, and of
what commands alone can be told with ``command.``.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import TypeAlias

from animtool.core.record import dataclass

# Noncharacters of Unicode, which no text that is exchanged has.
_BEGIN, _VALUE, _END, _OPEN, _CLOSE = "\ufdd0", "\ufdd1", "\ufdd2", "\ufdd3", "\ufdd4"
_MARK = re.compile(f"{_BEGIN}([a-z0-9_.]+)(?:{_VALUE}([^{_BEGIN}-{_END}]*))?{_END}")
_CLAUSE = re.compile(f"{_OPEN}([^{_OPEN}{_CLOSE}]*){_CLOSE}")


@dataclass(frozen=True, slots=True)
class Argument:
    """An argument that a text names."""

    name: str  # dotted name of the field, such as `source.fps`
    value: str | None = None  # as files write it, where the text states one

    @property
    def field(self) -> str:
        """Name of the field alone."""
        return self.name.rpartition(".")[2]

    @property
    def switch(self) -> bool | None:
        """Value that it states for a boolean, else None."""
        return {"true": True, "false": False}.get(self.value or "")


@dataclass(frozen=True, slots=True)
class Clause:
    """Part of a text that is omitted if its arguments have no names."""

    parts: tuple[Part, ...]


Part: TypeAlias = str | Argument | Clause
# What an interface calls an argument; None where it has none such.
Calling: TypeAlias = Callable[[Argument], str | None]


def in_python(argument: Argument) -> str | None:
    """Return the name of an argument in a Python call.

    >>> in_python(Argument("source.fps")), in_python(Argument("form", "layer"))
    ('fps', 'form="layer"')
    """
    if argument.name.startswith("command."):
        return None
    if argument.value is None:
        return argument.field
    if argument.switch is not None:
        return f"{argument.field}={argument.switch}"
    try:
        float(argument.value)
    except ValueError:
        return f'{argument.field}="{argument.value}"'
    return f"{argument.field}={argument.value}"


# Keys of files that are not called as the argument is.
KEYS = {
    "source.unit": "units",
    "source.prim_path": "prim",
    "form": "as",
    "frame_range": "range",
    "rest_frame": "rest",
    "set": "variables",
}


def in_file(argument: Argument) -> str:
    """Return the name of an argument in scene and batch files.

    >>> in_file(Argument("source.fps")), in_file(Argument("form", "layer"))
    ('fps:', 'as: layer')
    """
    key = KEYS.get(argument.name, argument.field)
    return f"{key}: {argument.value or ''}".rstrip()


class Text(str):
    """A text that names arguments: as Python names them, or by `worded`.

    Attributes:
        parts: What it is joined of.
    """

    __slots__ = ("parts",)
    parts: tuple[Part, ...]

    def __new__(cls, parts: tuple[Part, ...]) -> Text:
        """Join parts, with arguments as Python names them."""
        text = super().__new__(cls, _joined(parts, in_python))
        text.parts = parts
        return text

    def __reduce__(self) -> tuple[type[Text], tuple[tuple[Part, ...]]]:
        """Keep the parts when pickled."""
        return Text, (self.parts,)

    def __add__(self, other: str) -> Text:
        """Return both texts, with the arguments they name."""
        return Text((*self.parts, *_parts(other)))

    def __radd__(self, other: str) -> Text:
        """Return both texts, with the arguments they name."""
        return Text((*_parts(other), *self.parts))


def argument(name: str, value: object = None) -> str:
    """Return the marker of an argument in a text, for a `Text` to resolve.

    Args:
        name: Of the field; of what is read with ``source.`` before it.
        value: What the text states for it; None is nothing.
    """
    if value is None:
        return f"{_BEGIN}{name}{_END}"
    stated = str(value).lower() if isinstance(value, bool) else str(value)
    return f"{_BEGIN}{name}{_VALUE}{stated}{_END}"


def clause(text: str) -> str:
    """Return a part of a text that is omitted if an argument in it has no name.

    >>> marked("at night" + clause(f", not {argument('command.quiet')}"))
    'at night'
    """
    return f"{_OPEN}{text}{_CLOSE}"


def flag(name: str, value: str = "") -> str:
    """Return an option for a text that quotes a full command.

    >>> flag("shot", "NAME")
    '--shot NAME'
    """
    return f"--{name} {value}".rstrip()


def marked(text: str) -> str:
    """Return a text with `argument` markers as a `Text`.

    >>> marked(f"{argument('keep_samples', True)} keeps them")
    'keep_samples=True keeps them'
    """
    if isinstance(text, Text) or not (_BEGIN in text or _OPEN in text):
        return text
    return Text(_parts(text))


def worded(text: str, calling: Calling) -> str:
    """Return a text whose arguments are named as an interface names them.

    >>> worded(marked(f"{argument('up', 'Z')} says it"), in_file)
    'up: Z says it'
    """
    text = marked(text)
    return _joined(text.parts, calling) if isinstance(text, Text) else text


def _joined(parts: tuple[Part, ...], calling: Calling) -> str:
    return "".join(_worded(part, calling) for part in parts)


def _worded(part: Part, calling: Calling) -> str:
    if isinstance(part, Argument):
        return calling(part) or getattr(calling, "elsewhere", in_file)(part)
    if isinstance(part, Clause):
        named = [
            argument_part
            for argument_part in part.parts
            if isinstance(argument_part, Argument)
        ]
        return _joined(part.parts, calling) if all(map(calling, named)) else ""
    return part


def _parts(text: str) -> tuple[Part, ...]:
    if isinstance(text, Text):
        return text.parts
    parts: list[Part] = []
    end = 0
    for match in _CLAUSE.finditer(text):
        parts += [*_arguments(text[end : match.start()]), Clause(_arguments(match[1]))]
        end = match.end()
    return (*parts, *_arguments(text[end:]))


def _arguments(text: str) -> tuple[Part, ...]:
    """Return the parts of a text without clauses."""
    parts: list[Part] = []
    end = 0
    for match in _MARK.finditer(text):
        parts += [text[end : match.start()], Argument(match[1], match[2])]
        end = match.end()
    return tuple(part for part in (*parts, text[end:]) if part)
