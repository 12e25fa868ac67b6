"""Dependencies between the systems of a scene."""

from __future__ import annotations

from collections.abc import Sequence
from graphlib import CycleError, TopologicalSorter
from typing import Any

from animtool.core.errors import listed
from animtool.core.names import name_hint
from animtool.documents.document import Document, Location, parse_location
from animtool.scene.file.entries import ScenePass, SceneSystem
from animtool.systems.framework.fields import SystemSurfaceModel
from animtool.systems.framework.kinds import SYSTEM_KINDS
from animtool.systems.framework.spec import JoinedEntry


def simulation_order(systems: Sequence[SceneSystem]) -> list[list[int]]:
    """Return groups of system indices in simulation order.

    A system comes after the systems it depends on; apart from that, the order is that
    of the scene.
    """
    groups = joined_groups(systems)
    group_ids = {i: k for k, group in enumerate(groups) for i in group}
    index_by_name = {system.name: i for i, system in reversed(list(enumerate(systems)))}
    sorter: TopologicalSorter[int] = TopologicalSorter()
    for k, group in enumerate(groups):
        needed_groups = {
            group_ids[index_by_name[name]]
            for i in group
            for name, _ in systems[i].setup.surroundings.needed_systems
            if name in index_by_name
        }
        sorter.add(k, *sorted(needed_groups))
    return [groups[k] for k in sorter.static_order()]


def dependencies(systems: Sequence[SceneSystem], group: Sequence[int]) -> list[int]:
    """Return the indices of the systems that a joined group depends on.

    This includes indirect dependencies and the systems that they are joined to.
    """
    groups = simulation_order(systems)
    needed_names = {
        name for i in group for name, _ in systems[i].setup.surroundings.needed_systems
    }
    system_indices: list[int] = []
    for earlier_group in reversed(groups[: groups.index(list(group))]):
        if any(systems[i].name in needed_names for i in earlier_group):
            system_indices += earlier_group
            for i in earlier_group:
                needed_names |= {
                    name for name, _ in systems[i].setup.surroundings.needed_systems
                }
    return sorted(system_indices)


def with_dependencies(
    systems: Sequence[SceneSystem], requested_indices: Sequence[int]
) -> list[int]:
    """Return the requested systems with all systems that they are joined to or need."""
    ordered_groups, included_indices = simulation_order(systems), {*requested_indices}
    while True:
        needed_indices: set[int] = set()
        for group in ordered_groups:
            if not included_indices.isdisjoint(group):
                needed_indices |= {*group, *dependencies(systems, group)}
        names = {systems[i].name for i in needed_indices}
        # A system that pushes another one moves it.
        needed_indices |= {
            i
            for i, system in enumerate(systems)
            if any(
                name in names for name, _ in system.setup.surroundings.pushed_systems
            )
        }
        if needed_indices == included_indices:
            return sorted(included_indices)
        included_indices = needed_indices


def joined_groups(systems: Sequence[SceneSystem]) -> list[list[int]]:
    """Return the index groups of joined systems, ordered by their first member.

    Systems attached to the same rigid bodies are joined too.
    """
    group_ids = list(range(len(systems)))
    first_by_carrier: dict[str, int] = {}  # rigid systems, by the first that they carry
    for i, system in enumerate(systems):
        joined_names = {name for name, _ in system.setup.joined_systems}
        joined_indices = [
            other_index
            for other_index, other in enumerate(systems)
            if other.name in joined_names
        ]
        carriers = system.setup.surroundings.carriers
        joined_indices += [first_by_carrier.setdefault(name, i) for name in carriers]
        for other_index in joined_indices:
            new_group, old_group = sorted((group_ids[i], group_ids[other_index]))
            group_ids = [new_group if g == old_group else g for g in group_ids]
    return [
        [i for i, group in enumerate(group_ids) if group == group_number]
        for group_number in sorted(set(group_ids))
    ]


def check_links(
    document: Document, systems: Sequence[SceneSystem], names: Sequence[str]
) -> None:
    """Record faults in the names of systems and bodies, in joins, and cycles."""
    is_valid = len(systems) == len(names)
    for system in systems:
        setup, scene = system.setup, (document, system, systems, names)
        for name, location in setup.joined_systems:
            is_valid &= _check_name(*scene, name, location, "weldable")
        for name, location in setup.surroundings.needed_systems:
            is_valid &= _check_name(*scene, name, location, "surface")
        for name, location in setup.surroundings.pushed_systems if is_valid else ():
            is_valid &= _check_name(*scene, name, location, "rigid")
        for tie in setup.surroundings.carrier_ties if is_valid else ():
            is_valid &= _check_body(document, system, systems, *tie)
    is_valid = is_valid and _check_cycles(document, systems)
    for group in simulation_order(systems) if is_valid else ():
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
                key = (*location, "characters", i, "source")
                message = "what is attached to the character of this scene always "
                message += "collides with it"
                hint = "set how with `capsules` and `skin`, and remove the entry"
                document.add("SIM183", key, message, hint)
        for i, surface in enumerate(getattr(entry.options, "systems", ())):
            if not isinstance(surface, SystemSurfaceModel):
                continue
            key_location = (*location, "systems", i)
            link = (surface.system, (*key_location, "system"), "surface")
            _check_name(document, None, systems, names, *link)
            if surface.two_way:
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
    specs: list[Any] = [other.setup.spec for other in systems if other.name == name]
    if not specs or specs[0].stages:
        return True
    body_names = [model.name for model in specs[0].bodies]
    if body in body_names or body.rpartition("[")[0] in body_names:
        return True
    location = (*system.setup.location, *parse_location(key_text))
    message = f"unknown body {body!r} of {name!r}"
    hint = name_hint(body, body_names) or f"it has {listed(body_names, 12)}"
    document.add("SIM162", location, message, hint)
    return False


def to_joined_entry(system: SceneSystem) -> JoinedEntry:
    """Return the scene entry of a system, for simulation together with others."""
    setup = system.setup
    return JoinedEntry(
        system.name, system.kind, setup.spec, setup.entries, setup.record
    )


def _check_joined(document: Document, systems: Sequence[SceneSystem]) -> None:
    """Record faults in joined systems, such as keys that differ (SIM054)."""
    members = [to_joined_entry(system) for system in systems]
    for system in systems:
        record = system.setup.record
        for fault in [] if record is None else record.joined_faults(members):
            key_location = (*system.setup.location, *parse_location(fault.where or ""))
            document.add(fault.code, key_location, fault.message, fault.hint)
    has_colliders = any(system.setup.surroundings.has_colliders for system in systems)
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
        needed_systems = [
            s.setup.surroundings.needed_systems for s in systems if s.name in members
        ]
        locations = (
            loc for links in needed_systems for name, loc in links if name in members
        )
        message = f"{listed(sorted(members))} collide with each other in a circle"
        hint = "remove the collision that matters less"
        for location in locations:
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
            hint = "the scene has no systems"
            if known_names:
                hint = name_hint(name, known_names)
                hint = hint or f"the scene has {listed(known_names)}"
            document.add("SCN063", (*location, i), f"unknown system {name!r}", hint)


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
    system_name = None if system is None else system.name
    kind = next((other.kind for other in systems if other.name == name), None)
    suitable_kinds = [
        k for k, entry in SYSTEM_KINDS.items() if getattr(entry, capability)
    ]
    message, hint = "", None
    if name not in names:
        other_names = sorted({*names} - {system_name})
        message = f"unknown system {name!r}"
        hint = "there is no other" if system_name else "the scene has no systems"
        if other_names:
            hint = (
                name_hint(name, other_names) or f"the scene has {listed(other_names)}"
            )
    elif (count := list(names).count(name)) > 1:
        message = f"{count} systems are named {name!r}"
        hint = "give each a unique name"
    elif name == system_name:
        message = f"{name!r} is the system itself"
    elif kind is not None and kind not in suitable_kinds:
        message = f"{name!r} is of kind {kind}, not {' or '.join(suitable_kinds)}"
    if message:
        document.add("SCN063", location, message, hint)
    return not message
