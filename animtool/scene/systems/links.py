"""Dependencies between the systems of a scene."""

from __future__ import annotations

from collections.abc import Sequence
from graphlib import CycleError, TopologicalSorter
from typing import Any

from animtool.core.errors import listed
from animtool.core.names import nearest
from animtool.documents.document import Document, Location, parse_location
from animtool.scene.file.entries import ScenePass, SceneSystem
from animtool.systems.framework.fields import SystemSurfaceModel
from animtool.systems.framework.kinds import SYSTEM_KINDS
from animtool.systems.framework.spec import Member


def simulation_order(systems: Sequence[SceneSystem]) -> list[list[int]]:
    """Return groups of system indices in simulation order.

    A system comes after the systems it depends on; apart from that, the order is that
    of the scene.
    """
    groups = joined_groups(systems)
    group_of = {i: k for k, group in enumerate(groups) for i in group}
    index_by_name = {system.name: i for i, system in reversed(list(enumerate(systems)))}
    sorter: TopologicalSorter[int] = TopologicalSorter()
    for k, group in enumerate(groups):
        needed_groups = {
            group_of[index_by_name[name]]
            for i in group
            for name, _ in systems[i].setup.around.needs
            if name in index_by_name
        }
        sorter.add(k, *sorted(needed_groups))
    return [groups[k] for k in sorter.static_order()]


def dependencies(systems: Sequence[SceneSystem], group: Sequence[int]) -> list[int]:
    """Return the indices of the systems that a joined group depends on.

    This includes indirect dependencies and the systems that they are joined to.
    """
    groups = simulation_order(systems)
    needed_names = {name for i in group for name, _ in systems[i].setup.around.needs}
    system_indices: list[int] = []
    for earlier_group in reversed(groups[: groups.index(list(group))]):
        if any(systems[i].name in needed_names for i in earlier_group):
            system_indices += earlier_group
            needed_names |= {
                name for i in earlier_group for name, _ in systems[i].setup.around.needs
            }
    return sorted(system_indices)


def with_dependencies(
    systems: Sequence[SceneSystem], requested: Sequence[int]
) -> list[int]:
    """Return the requested systems with all systems that they are joined to or need."""
    ordered_groups, included_indices = simulation_order(systems), {*requested}
    while True:
        groups = [
            group for group in ordered_groups if not included_indices.isdisjoint(group)
        ]
        needed_indices = {
            i for group in groups for i in (*group, *dependencies(systems, group))
        }
        names = {systems[i].name for i in needed_indices}
        # A system that pushes another one moves it.
        needed_indices |= {
            i
            for i, system in enumerate(systems)
            if any(name in names for name, _ in system.setup.around.pushes)
        }
        if needed_indices == included_indices:
            return sorted(included_indices)
        included_indices = needed_indices


def joined_groups(systems: Sequence[SceneSystem]) -> list[list[int]]:
    """Return the index groups of joined systems, ordered by their first member.

    Systems attached to the same rigid bodies are joined too.
    """
    group_of = list(range(len(systems)))
    tied_first: dict[str, int] = {}  # rigid systems, by the first that they carry
    for i, system in enumerate(systems):
        joined_names = {name for name, _ in system.setup.joined}
        joined_indices = [
            other_index
            for other_index, other_system in enumerate(systems)
            if other_system.name in joined_names
        ]
        joined_indices += [
            tied_first.setdefault(name, i) for name in system.setup.around.carriers
        ]
        for other_index in joined_indices:
            old_group = max(group_of[i], group_of[other_index])
            new_group = min(group_of[i], group_of[other_index])
            group_of = [
                new_group if member == old_group else member for member in group_of
            ]
    return [
        [i for i, member in enumerate(group_of) if member == smallest_member]
        for smallest_member in sorted(set(group_of))
    ]


def check_links(
    document: Document, systems: Sequence[SceneSystem], names: Sequence[str]
) -> None:
    """Record unknown system names and invalid joins."""
    valid_systems = len(systems) == len(names)
    for system in systems:
        setup = system.setup
        for name, location in setup.joined:
            valid_systems &= _check_name(
                document, system, systems, names, name, location, "weldable"
            )
        for name, location in setup.around.needs:
            valid_systems &= _check_name(
                document, system, systems, names, name, location, "surface"
            )
        for name, location in setup.around.pushes if valid_systems else ():
            valid_systems &= _check_name(
                document, system, systems, names, name, location, "rigid"
            )
        for tie in setup.around.tied if valid_systems else ():
            valid_systems &= _check_body(document, system, systems, *tie)
    valid_systems = valid_systems and _check_cycles(document, systems)
    for group in simulation_order(systems) if valid_systems else ():
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
        location = parse_location(entry.location.where)
        for i, character in enumerate(getattr(entry.options, "characters", ())):
            if character.source:
                message = (
                    "what is attached to the character of this scene always collides "
                    "with it"
                )
                hint = "set how with `capsules` and `skin`, and remove the entry"
                document.add(
                    "SIM183", (*location, "characters", i, "source"), message, hint
                )
        for i, character in enumerate(getattr(entry.options, "systems", ())):
            if not isinstance(character, SystemSurfaceModel):
                continue
            key_location = (*location, "systems", i)
            name, name_location = character.system, (*key_location, "system")
            _check_name(document, None, systems, names, name, name_location, "surface")
            if character.two_way:
                message = "what a pass simulates does not push bodies of systems"
                hint = "remove two_way, or simulate it as a system"
                document.add("SIM184", (*key_location, "two_way"), message, hint)


def _check_body(
    document: Document,
    system: SceneSystem,
    systems: Sequence[SceneSystem],
    name: str,
    body: str,
    key_text: str,
) -> bool:
    """Record a fault if a rigid system lacks a body (SIM162)."""
    specs: list[Any] = [
        candidate.setup.spec for candidate in systems if candidate.name == name
    ]
    if not specs or specs[0].stages:
        return True
    body_names = [model.name for model in specs[0].bodies]
    if body in body_names or body.rpartition("[")[0] in body_names:
        return True
    message = f"unknown body {body!r} of {name!r}"
    hint = nearest(body, body_names) or f"it has {listed(body_names, 12)}"
    document.add(
        "SIM162", (*system.setup.location, *parse_location(key_text)), message, hint
    )
    return False


def member_of(system: SceneSystem) -> Member:
    """Return a system as the member that build functions take."""
    setup = system.setup
    return Member(system.name, system.kind, setup.spec, setup.parts, setup.record)


def _check_joined(document: Document, systems: Sequence[SceneSystem]) -> None:
    """Record faults of systems that cannot be joined."""
    members = [member_of(system) for system in systems]
    for system in systems:
        record = system.setup.record
        for fault in [] if record is None else record.joined_faults(members):
            key_location = (*system.setup.location, *parse_location(fault.where or ""))
            document.add(fault.code, key_location, fault.message, fault.hint)
    has_colliders = any(system.setup.around.has_colliders for system in systems)
    first_values: dict[str, tuple[str, Any]] = {}
    for system in systems:
        for key, value in system.setup.spec.shared(has_colliders=has_colliders).items():
            name, first_value = first_values.setdefault(key, (system.name, value))
            if value != first_value:
                message = f"{key} differs from that of {name}: they are "
                message += "joined, and simulated as one"
                hint = "write it once, or the same value twice"
                document.add("SIM054", (*system.setup.location, key), message, hint)


def _check_cycles(document: Document, systems: Sequence[SceneSystem]) -> bool:
    """Record the first cycle of systems that collide with each other."""
    try:
        simulation_order(systems)
    except CycleError as error:
        groups = joined_groups(systems)
        members = {systems[i].name for k in error.args[1] for i in groups[k]}
        for system in systems:
            for name, location in (
                system.setup.around.needs if system.name in members else ()
            ):
                if name in members:
                    message = f"{listed(sorted(members))} collide with each other in a "
                    message += "circle"
                    hint = "remove the collision that matters less"
                    document.add("SCN063", location, message, hint)
                    return False
    return True


def check_names(
    document: Document,
    location: Location,
    requested_names: Sequence[str],
    names: Sequence[str],
) -> None:
    """Record a fault for each system name that an output requests but no system has."""
    known_names = sorted({*names})
    for i, name in enumerate(requested_names):
        if name not in names:
            hint = nearest(name, known_names) or f"the scene has {listed(known_names)}"
            hint = hint if known_names else "the scene has no systems"
            message = f"unknown system {name!r}"
            document.add("SCN063", (*location, i), message, hint)


def _check_name(
    document: Document,
    system: SceneSystem | None,
    systems: Sequence[SceneSystem],
    names: Sequence[str],
    name: str,
    location: Location,
    capability: str,
) -> bool:
    """Record a fault unless a name is that of a suitable other system."""
    self_name = None if system is None else system.name
    matching_systems = [
        other_system for other_system in systems if other_system.name == name
    ]
    message, hint = "", None
    if name not in names:
        selectable_names = sorted({*names} - {self_name})
        message = f"unknown system {name!r}"
        hint = (
            nearest(name, selectable_names)
            or f"the scene has {listed(selectable_names)}"
        )
        no_system_hint = (
            "there is no other" if self_name else "the scene has no systems"
        )
        hint = hint if selectable_names else no_system_hint
    elif list(names).count(name) > 1:
        message = f"{list(names).count(name)} systems are named {name!r}"
        hint = "give each a unique name"
    elif name == self_name:
        message = f"{name!r} is the system itself"
    elif matching_systems and not getattr(
        SYSTEM_KINDS[matching_systems[0].kind], capability
    ):
        suitable_kinds = [
            kind
            for kind, system_kind in SYSTEM_KINDS.items()
            if getattr(system_kind, capability)
        ]
        message = (
            f"{name!r} is of kind {matching_systems[0].kind}, "
            f"not {' or '.join(suitable_kinds)}"
        )
    if message:
        document.add("SCN063", location, message, hint)
    return not message
