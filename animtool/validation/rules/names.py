"""Names that USD cannot tell apart."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

from animtool.errors import Fault

if TYPE_CHECKING:
    # A rig is checked without what opens a take.
    from animtool.validation.subjects.capture import TakeSubject
    from animtool.validation.subjects.rig import RigSubject

__all__ = ["in_capture", "in_rig"]

HINT = "the second gets a number there; rename one"


def in_rig(rig: RigSubject) -> Iterator[Fault]:
    """Yield names of a rig that become one (RIG219)."""
    groups: dict[str, Sequence[str]] = {
        "joints": rig.rig.names,
        "meshes": [mesh.name for mesh in rig.rig.meshes],
        "shapes": [shape.name for shape in rig.rig.shapes],
    }
    for key, names in groups.items():
        for name, message in _collisions(names):
            yield rig.fault("RIG219", rig.at(key, name), message, HINT)


def in_capture(subject: TakeSubject) -> Iterator[Fault]:
    """Yield names of joints in a capture that become one (BVH201)."""
    for name, message in _collisions(subject.take.rig.names):
        yield subject.fault("BVH201", name, message, HINT)


def _collisions(names: Sequence[str]) -> Iterator[tuple[str, str]]:
    """Yield each name that another before it becomes, and what to say of it."""
    first: dict[str, str] = {}
    for name in names:
        legal = _legal(name)
        if legal in first:
            yield name, f"{name!r} and {first[legal]!r} both become {legal!r} in USD"
        first.setdefault(legal, name)


def _legal(name: str) -> str:
    """Return a name with `_` for whatever cannot stand in the name of a prim."""
    legal = re.sub(r"\W", "_", name)
    return f"_{legal}" if legal[:1].isdigit() else legal
