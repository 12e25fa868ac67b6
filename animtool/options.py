"""Options of a record, each declared once: on its field."""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from typing import Any, Literal, TypeAlias

# What a value is, and so how files and the command line write it.
Kind: TypeAlias = Literal[
    "switch", "answer", "text", "file", "choice", "unit", "axis", "rate", "range",
    "frame", "rest", "offsets", "length", "lengths", "count", "name", "names", "angle",
    "amount", "seed",
]  # fmt: skip


@dataclass(frozen=True, slots=True)
class Key:
    """How a kind of file documents an option that it has a key for."""

    description: str
    example: Any
    choices: tuple[str, ...] = ()  # of a choice
    alias: str | None = None  # the key, where it is not the name of the field


@dataclass(frozen=True, slots=True)
class Option:
    """What an option is, and where it applies."""

    kind: Kind
    flag: str  # as refusals name it on the command line
    label: str  # as refusals name it in a scene
    not_for: frozenset[str]  # uses that refuse it
    scene: Key | None
    batch: Key | None
    help: str  # of the command line; empty where commands have another such option
    metavar: str | None  # what help calls the value; None is the usual word of the kind
    choices: tuple[str, ...]  # on the command line; of a switch, off and on
    least: int  # of a count
    reason: str  # why a source may not take it
    written: str | float | None  # the default, where the command line has another unit


def option(
    default: Any,
    kind: Kind,
    flag: str,
    *,
    label: str = "",
    not_for: tuple[str, ...] = (),
    scene: Key | None = None,
    batch: Key | None = None,
    both: Key | None = None,
    help: str = "",
    metavar: str | None = None,
    choices: tuple[str, ...] = (),
    least: int = 0,
    reason: str = "",
    written: str | float | None = None,
) -> Any:
    """Return the field of an option; ``both`` is the key of scenes and batches."""
    described = Option(
        kind,
        flag,
        label,
        frozenset(not_for),
        scene or both,
        batch or both,
        help,
        metavar,
        choices,
        least,
        reason,
        written,
    )
    return field(default=default, metadata={"option": described})


def options_of(record: Any) -> dict[str, Option]:
    """Return the options of a record or its class by name, in its order."""
    return {
        entry.name: entry.metadata["option"]
        for entry in fields(record)
        if "option" in entry.metadata
    }


def keys_of(record: Any, place: Literal["scene", "batch"]) -> dict[str, Key]:
    """Return the keys that a kind of file has for a record, by name of the option."""
    keys = {name: getattr(o, place) for name, o in options_of(record).items()}
    return {name: key for name, key in keys.items() if key is not None}


def refused_options(record: Any, use: str) -> list[Option]:
    """Return the options that are not for a use, of those that are not the defaults."""
    defaults = {entry.name: entry.default for entry in fields(record)}
    return [
        described
        for name, described in options_of(record).items()
        if use in described.not_for and getattr(record, name) != defaults[name]
    ]
