"""Dependencies between the systems of a scene."""

from __future__ import annotations

from collections.abc import Sequence
from graphlib import CycleError, TopologicalSorter
from typing import Any

from animtool.core.errors import listed
from animtool.core.names import nearest
from animtool.documents.document import Document, Location, location_of
from animtool.scene.file.entries import ScenePass, SceneSystem
from animtool.systems.framework.fields import SystemSurfaceModel
from animtool.systems.framework.kinds import SYSTEM_KINDS
from animtool.systems.framework.spec import Member


def in_order(systems: Sequence[SceneSystem]) -> list[list[int]]:
    """Return groups of system indices in simulation order.

    What others need comes before them; else they stand in the scene's order.
    """
    groups = joined_groups(systems)
    of = {i: k for k, group in enumerate(groups) for i in group}
    first = {system.name: i for i, system in reversed(list(enumerate(systems)))}
    sorter: TopologicalSorter[int] = TopologicalSorter()
    for k, group in enumerate(groups):
        needs = {
            of[first[name]]
            for i in group
            for name, _ in systems[i].setup.around.needs
            if name in first
        }
        sorter.add(k, *sorted(needs))
    return [groups[k] for k in sorter.static_order()]


def dependencies(systems: Sequence[SceneSystem], group: Sequence[int]) -> list[int]:
    """Return the systems that a joined group depends on.

    Those that they need, and what these need, each with what it is joined to.
    """
    groups = in_order(systems)
    names = {name for i in group for name, _ in systems[i].setup.around.needs}
    numbers: list[int] = []
    for other in reversed(groups[: groups.index(list(group))]):
        if any(systems[i].name in names for i in other):
            numbers += other
            names |= {name for i in other for name, _ in systems[i].setup.around.needs}
    return sorted(numbers)


def with_dependencies(
    systems: Sequence[SceneSystem], requested: Sequence[int]
) -> list[int]:
    """Return some systems with those they are joined to or depend on."""
    every, included = in_order(systems), {*requested}
    while True:
        groups = [group for group in every if not included.isdisjoint(group)]
        more = {i for group in groups for i in (*group, *dependencies(systems, group))}
        names = {systems[i].name for i in more}
        # Who pushes one of them moves it.
        more |= {
            i
            for i, system in enumerate(systems)
            if any(name in names for name, _ in system.setup.around.pushes)
        }
        if more == included:
            return sorted(included)
        included = more


def joined_groups(systems: Sequence[SceneSystem]) -> list[list[int]]:
    """Return groups of joined systems, ordered by their first member.

    Those that the same rigid bodies carry are joined by these.
    """
    group = list(range(len(systems)))
    tied_first: dict[str, int] = {}  # by rigid systems, the first that they carry
    for i, system in enumerate(systems):
        joined = {name for name, _ in system.setup.joined}
        others = [k for k, other in enumerate(systems) if other.name in joined]
        others += [
            tied_first.setdefault(name, i) for name in system.setup.around.carriers
        ]
        for k in others:
            old, new = max(group[i], group[k]), min(group[i], group[k])
            group = [new if of == old else of for of in group]
    return [
        [i for i, of in enumerate(group) if of == first] for first in sorted(set(group))
    ]


def check_links(
    document: Document, systems: Sequence[SceneSystem], names: Sequence[str]
) -> None:
    """Record unknown system names and invalid joins."""
    sound = len(systems) == len(names)
    for system in systems:
        setup = system.setup
        for name, at in setup.joined:
            sound &= _check_name(document, at, name, system, systems, names, "weldable")
        for name, at in setup.around.needs:
            sound &= _check_name(document, at, name, system, systems, names, "surface")
        for name, at in setup.around.pushes if sound else ():
            sound &= _check_name(document, at, name, system, systems, names, "rigid")
        for tie in system.setup.around.tied if sound else ():
            sound &= _check_body(document, system, systems, *tie)
    sound = sound and _check_circles(document, systems)
    for group in in_order(systems) if sound else ():
        if len(group) > 1:
            _check_joined(document, [systems[i] for i in group])


def check_colliders(
    document: Document,
    passes: Sequence[ScenePass],
    systems: Sequence[SceneSystem],
    names: Sequence[str],
) -> None:
    """Record unknown colliders that passes name (SIM183, SIM184, SCN063)."""
    for entry in passes:
        at = location_of(entry.location.where)
        for i, one in enumerate(getattr(entry.options, "characters", ())):
            if one.source:
                message = (
                    "what is attached to the character of this scene always collides "
                    "with it"
                )
                hint = "set how with `capsules` and `skin`, and remove the entry"
                document.add("SIM183", (*at, "characters", i, "source"), message, hint)
        for i, one in enumerate(getattr(entry.options, "systems", ())):
            if not isinstance(one, SystemSurfaceModel):
                continue
            at_key = (*at, "systems", i)
            _check_name(
                document,
                (*at_key, "system"),
                one.system,
                None,
                systems,
                names,
                "surface",
            )
            if one.two_way:
                message = "what a pass simulates does not push bodies of systems"
                hint = "remove two_way, or simulate it as a system"
                document.add("SIM184", (*at_key, "two_way"), message, hint)


def _check_body(
    document: Document,
    system: SceneSystem,
    systems: Sequence[SceneSystem],
    name: str,
    body: str,
    where: str,
) -> bool:
    """Record a body that a rigid system lacks (SIM162); stages are checked later."""
    specs: list[Any] = [each.setup.spec for each in systems if each.name == name]
    if not specs or specs[0].stages:
        return True
    known = [model.name for model in specs[0].bodies]
    if body in known or body.rpartition("[")[0] in known:
        return True
    message = f"unknown body {body!r} of {name!r}"
    hint = nearest(body, known) or f"it has {listed(known, 12)}"
    document.add("SIM162", (*system.setup.at, *location_of(where)), message, hint)
    return False


def member_of(system: SceneSystem) -> Member:
    """Return an entry in the form that a build takes."""
    setup = system.setup
    return Member(system.name, system.kind, setup.spec, setup.parts, setup.record)


def _check_joined(document: Document, systems: Sequence[SceneSystem]) -> None:
    """Record faults of systems that cannot be joined."""
    members = [member_of(system) for system in systems]
    for system in systems:
        record = system.setup.record
        for fault in [] if record is None else record.joined_faults(members):
            at_key = (*system.setup.at, *location_of(fault.where or ""))
            document.add(fault.code, at_key, fault.message, fault.hint)
    meets = any(system.setup.around.anything for system in systems)
    first: dict[str, tuple[str, Any]] = {}
    for system in systems:
        for key, value in system.setup.spec.shared(meets=meets).items():
            name, other = first.setdefault(key, (system.name, value))
            if value != other:
                message = f"{key} differs from that of {name}: they are "
                message += "joined, and simulated as one"
                hint = "write it once, or the same value twice"
                document.add("SIM054", (*system.setup.at, key), message, hint)


def _check_circles(document: Document, systems: Sequence[SceneSystem]) -> bool:
    """Record the first cycle of systems that collide with each other."""
    try:
        in_order(systems)
    except CycleError as error:
        groups = joined_groups(systems)
        members = {systems[i].name for k in error.args[1] for i in groups[k]}
        for system in systems:
            for name, at in system.setup.around.needs if system.name in members else ():
                if name in members:
                    message = f"{listed(sorted(members))} collide with each other in a "
                    message += "circle"
                    hint = "remove the collision that matters less"
                    document.add("SCN063", at, message, hint)
                    return False
    return True


def check_names(
    document: Document, at: Location, requested: Sequence[str], names: Sequence[str]
) -> None:
    """Record unknown system names of an output."""
    known = sorted({*names})
    for i, name in enumerate(requested):
        if name not in names:
            hint = nearest(name, known) or f"the scene has {listed(known)}"
            hint = hint if known else "the scene has no systems"
            message = f"unknown system {name!r}"
            document.add("SCN063", (*at, i), message, hint)


def _check_name(
    document: Document,
    at: Location,
    name: str,
    system: SceneSystem | None,
    systems: Sequence[SceneSystem],
    names: Sequence[str],
    having: str,
) -> bool:
    """Record a name that is not another suitable system."""
    self_name = None if system is None else system.name
    named = [other for other in systems if other.name == name]
    message, hint = "", None
    if name not in names:
        others = sorted({*names} - {self_name})
        message = f"unknown system {name!r}"
        hint = nearest(name, others) or f"the scene has {listed(others)}"
        none = "there is no other" if self_name else "the scene has no systems"
        hint = hint if others else none
    elif list(names).count(name) > 1:
        message = f"{list(names).count(name)} systems are named {name!r}"
        hint = "give each a unique name"
    elif name == self_name:
        message = f"{name!r} is the system itself"
    elif named and not getattr(SYSTEM_KINDS[named[0].kind], having):
        kinds = [kind for kind, it in SYSTEM_KINDS.items() if getattr(it, having)]
        message = f"{name!r} is of kind {named[0].kind}, not {' or '.join(kinds)}"
    if message:
        document.add("SCN063", at, message, hint)
    return not message
