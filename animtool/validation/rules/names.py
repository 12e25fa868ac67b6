"""Names that USD cannot tell apart."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

from animtool.errors import Fault, counted

if TYPE_CHECKING:
    # A rig is checked without what opens a take.
    from animtool.validation.subjects.capture import TakeSubject
    from animtool.validation.subjects.rig import RigSubject

# Lists of a rig file whose names are names in USD.
GROUPS = ("joints", "meshes", "shapes")
HINT = "the second gets a number there; rename one"


def in_rig(rig: RigSubject) -> Iterator[Fault]:
    """Yield names of a rig that become one (RIG219)."""
    for key in GROUPS:
        for name, message in _collisions(names_in(rig, key)):
            yield rig.fault("RIG219", rig.at(key, name), message, HINT)


def not_in_usd(rig: RigSubject) -> Iterator[Fault]:
    """Yield lists with names that are others in USD (RIG221)."""
    if "from" in rig.document.value:
        return
    for key in GROUPS:
        names = [name for name in names_in(rig, key) if legal(name) != name]
        if names:
            one = len(names) == 1
            message = (
                f"{counted(len(names), 'name')} of {key} {'is' if one else 'are'} "
                f"written otherwise in USD: {names[0]!r} as {legal(names[0])!r}"
            )
            hint = "letters, digits and underscores stay as they are"
            yield rig.fault("RIG221", rig.at(key, names[0]), message, hint)


def names_in(rig: RigSubject, key: str) -> list[str]:
    """Return the names of one of `GROUPS`."""
    return [entry.name for entry in getattr(rig.rig, key)]


def in_capture(subject: TakeSubject) -> Iterator[Fault]:
    """Yield names of joints in a capture that become one (BVH201)."""
    for name, message in _collisions(subject.take.rig.names):
        yield subject.fault("BVH201", name, message, HINT)


def _collisions(names: Sequence[str]) -> Iterator[tuple[str, str]]:
    """Yield each name that another before it becomes, and what to say of it."""
    first: dict[str, str] = {}
    for name in names:
        shown = legal(name)
        if shown in first:
            yield name, f"{name!r} and {first[shown]!r} both become {shown!r} in USD"
        first.setdefault(shown, name)


def legal(name: str) -> str:
    """Return a name with `_` for whatever cannot stand in the name of a prim."""
    plain = re.sub(r"\W", "_", name)
    return f"_{plain}" if plain[:1].isdigit() else plain
