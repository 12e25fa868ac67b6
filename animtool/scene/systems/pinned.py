"""Pins that begin far from the joints that carry them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from animtool.errors import Fault, Severity
from animtool.quantities import plain
from animtool.rig.kinematics import WorldTransforms, rest_world
from animtool.rig.skeleton import Rig
from animtool.rig.surfaces import surfaces_of
from animtool.scene.entries import SceneSystem
from animtool.scene.systems.carriers import OnJoint, OnVertex
from animtool.scene.systems.character_motion import CharacterMotion, CharacterMotions
from animtool.systems.fields import PinnedPoints
from animtool.units import LengthUnit, unit_name


def far_pins(
    systems: Sequence[SceneSystem], characters: CharacterMotions
) -> list[Fault]:
    """Return warnings of pins that begin beyond the size of their character (SIM168).

    A pin is as far as the nearest of its particles is, at 0 s.
    """
    first = CharacterMotions()
    faults = []
    for system in systems:
        record = system.setup.record
        for pinned in getattr(record, "pinned", ()):
            if not isinstance(pinned.carrier, OnJoint | OnVertex):
                continue
            path = pinned.carrier.file
            if path not in first.by_path:
                first.by_path[path] = _first_frame(characters.of(path))
            faults += [
                system.place.put(fault)
                for fault in _faults(pinned, first, system.unit or LengthUnit.M)
            ]
    return faults


def _first_frame(character: CharacterMotion) -> CharacterMotion:
    world, head = character.world, slice(0, 1)
    return replace(
        character,
        motion=character.motion.select(head),
        world=WorldTransforms(world.positions[head], world.linear[head]),
        times=character.times[head],
    )


def _faults(
    pinned: PinnedPoints, characters: CharacterMotions, counted: LengthUnit
) -> Iterator[Fault]:
    """Yield the warning of what is pinned, if it is far from what carries it.

    counted: what lengths of the system count.
    """
    carrier: OnJoint | OnVertex = pinned.carrier
    rig = characters.of(carrier.file).rig
    tall, size = _sizes(rig)
    inside = pinned.inside(carrier.poses(characters))
    away = float(np.linalg.norm(inside, axis=-1).min(initial=np.inf))
    if not size or away <= size or not np.isfinite(away):
        return
    if isinstance(carrier, OnJoint):
        what = f"joint {carrier.joint!r}"
    else:
        what = f"vertex {carrier.vertex} of mesh {carrier.mesh!r}"
    unit = unit_name(rig.meters_per_unit)
    message = (
        f"the pinned end is {plain(away, 4)} m from {what}, and the joints of "
        f"{rig.name!r} span {plain(tall)} m"
    )
    hint = "begin it at what carries it, or give the pin an offset"
    if unit != counted:
        counts = "metres" if counted is LengthUnit.M else str(counted)
        message += f"; systems count {counts}, this rig is in {unit}"
        hint = f"units: {{length: {unit}}} of the scene counts as the rig does; or "
        hint += "begin it at what carries it"
    yield Fault(
        "SIM168", message, hint=hint, where=pinned.where, severity=Severity.WARNING
    )


def _sizes(rig: Rig) -> tuple[float, float]:
    """Return the longest side of the joints' bounds at rest, and of all bounds [m]."""
    points = rest_world(rig).positions[0]
    spans = [float(np.ptp(points, axis=0).max())]
    spans += [
        float(np.ptp(mesh.points, axis=0).max())
        for mesh in surfaces_of(rig)
        if len(mesh.points)
    ]
    return spans[0], max(spans)
