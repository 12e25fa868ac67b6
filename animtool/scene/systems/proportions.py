"""Systems that do not fit their characters: far away, or out of scale."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from animtool.core.array_types import FloatArray
from animtool.core.errors import Fault, warning
from animtool.core.quantities import plain
from animtool.core.units import LengthUnit, UpAxis, unit_name, up_from_up
from animtool.maths import so3
from animtool.rig.kinematics import WorldTransforms, rest_world
from animtool.rig.skeleton import Rig
from animtool.rig.surfaces import surfaces_of
from animtool.scene.file.entries import SceneSystem
from animtool.scene.systems.carriers import OnJoint, OnVertex
from animtool.scene.systems.character_motion import CharacterMotion, CharacterMotions
from animtool.systems.framework.fields import AROUND, PlacedModel
from animtool.systems.framework.spec import PinnedPoints

# A system this many times as far from a character as that is large, or this many times
# as large, is hardly meant, where it would be near and no larger than this many times
# the character if it counted as the rig does.
FAR, LARGE, NEAR, FITTING = 10.0, 20.0, 2.0, 5.0
# What lengths of systems are called.
_COUNTED = {
    LengthUnit.M: "metres",
    LengthUnit.CM: "centimetres",
    LengthUnit.MM: "millimetres",
    LengthUnit.IN: "inches",
}


def misplaced(
    systems: Sequence[SceneSystem],
    characters: CharacterMotions,
    main_rig: Rig | None = None,
) -> list[Fault]:
    """Return warnings of systems that do not fit their characters.

    Pins that begin beyond the size of their character (SIM168), as far as the nearest
    of their particles is, at 0 s; else systems that are far off or large, and would fit
    if they counted in the unit of the rig (SIM169). ``main_rig`` is the rig of the
    scene's own character, whatever a system has to do with it.
    """
    first = CharacterMotions()
    faults = []
    for system in systems:
        counted = system.unit or LengthUnit.M
        warnings: list[Fault] = []
        for pinned in getattr(system.setup.record, "pinned", ()):
            if not isinstance(pinned.carrier, OnJoint | OnVertex):
                continue
            path = pinned.carrier.file
            if path not in first.by_path:
                first.by_path[path] = _first_frame(characters.of(path))
            warnings += _faults(pinned, first, counted)
        rigs = [characters.of(path).rig for path in _characters(system)]
        rigs = [main_rig, *rigs] if main_rig is not None else rigs
        scaled = (_out_of_scale(system, rig, counted) for rig in rigs)
        if not warnings:
            warnings += next(filter(None, map(list, scaled)), [])
        faults += [system.location.locate(fault) for fault in warnings]
    return faults


def _characters(system: SceneSystem) -> list[Path]:
    """Return the files of the characters that a system depends on."""
    files = [Path(str(one.file)) for one in system.setup.around.characters]
    pins = getattr(system.setup.record, "pinned", ())
    carriers = [pinned.carrier for pinned in pins]
    files += [one.file for one in carriers if isinstance(one, OnJoint | OnVertex)]
    return list(dict.fromkeys(files))


def _out_of_scale(
    system: SceneSystem, rig: Rig, counted: LengthUnit
) -> Iterator[Fault]:
    """Yield the warning of a system that fits a character only in the rig's unit."""
    points = _points(system)
    tall, size = _sizes(rig)
    scale = rig.meters_per_unit / counted.meters
    if not size or not len(points) or np.isclose(scale, 1.0):
        return
    around = rest_world(rig).positions[0]
    rotation = up_from_up(UpAxis.Y, rig.up)
    if rotation is not None:
        around = so3.rotate(rotation, around)
    away, length = _gap(points, around), float(np.ptp(points, axis=0).max())
    fits = _gap(points * scale, around) <= NEAR * size
    if not fits or length * scale > FITTING * size:
        return
    if away > FAR * size:
        what = f"starts {plain(away, 4)} m from the character"
    elif length > LARGE * size:
        what = f"is {plain(length, 4)} m large"
    else:
        return
    unit = unit_name(rig.meters_per_unit)
    counts = _COUNTED[counted]
    message = (
        f"{system.name} {what}, but the joints of {rig.name!r} span {plain(tall)} m; "
        f"systems use {counts}, this rig is in {unit}"
    )
    hint = _counting_as(unit) or f"write its lengths in {counts}"
    yield warning("SIM169", message, hint)


def _points(system: SceneSystem) -> FloatArray:
    """Return the stated positions of a system at 0 s ``(N, 3)`` [m]."""
    positions: FloatArray | None = getattr(system.setup.record, "positions", None)
    if positions is not None:
        return positions
    spec = system.setup.spec
    corners = [
        entry.at
        for key in type(spec).model_fields.keys() - {*AROUND}
        if isinstance(entries := getattr(spec, key), list)
        for entry in entries
        if isinstance(entry, PlacedModel) and "at" in entry.model_fields_set
    ]
    return np.array(corners, np.float64).reshape(-1, 3)


def _gap(points: FloatArray, others: FloatArray) -> float:
    """Return the distance between the bounds of two sets of points [m]."""
    gaps = np.maximum(
        points.min(axis=0) - others.max(axis=0), others.min(axis=0) - points.max(axis=0)
    )
    return float(np.linalg.norm(np.maximum(gaps, 0.0)))


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
    """Yield the warning of a pin that is far from its carrier.

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
        f"the pinned end is {plain(away, 4)} m from {what}, but the joints of "
        f"{rig.name!r} span {plain(tall)} m"
    )
    hint = "place it near its pin, or give the pin an offset"
    if unit != counted:
        counts = _COUNTED[counted]
        message += f"; systems use {counts}, this rig is in {unit}"
        hint = "; or ".join(filter(None, [_counting_as(unit), "place it near its pin"]))
    yield warning("SIM168", message, hint, pinned.where)


def _counting_as(unit: str) -> str:
    """Return how to state a unit in a scene; empty if it has no name."""
    if unit not in {one.value for one in LengthUnit}:
        return ""
    return f"units: {{length: {unit}}} in the scene uses the rig's unit"


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
