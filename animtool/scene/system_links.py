"""How systems of a scene depend on each other."""

from __future__ import annotations

from collections.abc import Sequence
from graphlib import CycleError, TopologicalSorter

from animtool.documents.document import Document, Location
from animtool.documents.names import nearest
from animtool.errors import listed
from animtool.plugins import load_object
from animtool.scene.entries import SceneSystem
from animtool.scene.system_kinds import SYSTEM_KINDS

__all__ = ["check_links", "in_order"]


def in_order(systems: Sequence[SceneSystem]) -> list[list[int]]:
    """Return systems by number, those that are simulated as one together.

    What others need comes before them; else they stand in the scene's order.
    """
    groups = _groups(systems)
    of = {i: k for k, group in enumerate(groups) for i in group}
    first = {system.name: i for i, system in reversed(list(enumerate(systems)))}
    sorter: TopologicalSorter[int] = TopologicalSorter()
    for k, group in enumerate(groups):
        needs = {
            of[first[name]]
            for i in group
            for name, _ in systems[i].setup.needs
            if name in first
        }
        sorter.add(k, *sorted(needs))
    return [groups[k] for k in sorter.static_order()]


def _groups(systems: Sequence[SceneSystem]) -> list[list[int]]:
    """Return systems that are joined together, each group as its first stands."""
    group = list(range(len(systems)))
    for i, system in enumerate(systems):
        for name, _ in system.setup.joined:
            for k, other in enumerate(systems):
                if other.name == name:
                    old, new = max(group[i], group[k]), min(group[i], group[k])
                    group = [new if of == old else of for of in group]
    return [
        [i for i, of in enumerate(group) if of == first] for first in sorted(set(group))
    ]


def check_links(document: Document, systems: Sequence[SceneSystem]) -> None:
    """Note names of systems that there are none of, circles, and joints that cannot be.

    Args:
        document: Where faults are noted.
        systems: Those of the scene.
    """
    known = {system.name for system in systems}
    sound = True
    for system in systems:
        setup = system.setup
        for name, at in (*setup.joined, *setup.needs):
            sound &= _check_name(document, at, name, system, systems)
    if not sound or not known:
        return
    try:
        groups = in_order(systems)
    except CycleError as error:
        _note_circle(document, systems, error.args[1])
        return
    for group in groups:
        place = SYSTEM_KINDS[systems[group[0]].kind].joiner
        if len(group) > 1 and place:
            check = load_object(place)
            check(document, [systems[i] for i in group])  # type: ignore[operator]


def _check_name(
    document: Document,
    at: Location,
    name: str,
    system: SceneSystem,
    systems: Sequence[SceneSystem],
) -> bool:
    """Note a name that is none of another system that can serve."""
    named = [other for other in systems if other.name == name]
    message, hint = "", None
    if not named:
        names = sorted({other.name for other in systems} - {system.name})
        message = f"no system is named {name!r}"
        hint = nearest(name, names) or f"there are {listed(names)}"
        hint = hint if names else "each has a name of its own"
    elif len(named) > 1:
        message = f"{len(named)} systems are named {name!r}"
        hint = "give each a name of its own"
    elif named[0] is system:
        message = f"{name!r} is the system itself"
    elif not SYSTEM_KINDS[named[0].kind].joiner:
        kinds = [kind for kind, about in SYSTEM_KINDS.items() if about.joiner]
        message = f"{name!r} is of kind {named[0].kind}, which comes and goes"
        hint = f"name one of kind {', '.join(kinds)}"
    if message:
        document.add("SCN063", at, message, hint)
    return not message


def _note_circle(
    document: Document, systems: Sequence[SceneSystem], circle: Sequence[int]
) -> None:
    groups = _groups(systems)
    members = {i for k in circle for i in groups[k]}
    names = [systems[groups[k][0]].name for k in circle]
    for i in sorted(members):
        for name, at in systems[i].setup.needs:
            if any(systems[k].name == name for k in members):
                message = f"systems wait for each other: {' for '.join(names)}"
                hint = "what is run into is there first: leave one of them out"
                document.add("SCN064", at, message, hint)
                return
