"""Warnings about systems that are far from their characters or out of scale."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from animtool.core.array_types import FloatArray
from animtool.core.errors import Fault, warning
from animtool.core.quantities import plain_number
from animtool.core.units import LengthUnit, UpAxis, unit_name, up_from_up
from animtool.maths import so3
from animtool.rig.kinematics import WorldTransforms, rest_world
from animtool.rig.skeleton import Rig
from animtool.rig.surfaces import surfaces_of
from animtool.scene.file.entries import SceneSystem
from animtool.scene.systems.carriers import JointCarrier, VertexCarrier
from animtool.scene.systems.character_motion import CharacterMotion, CharacterMotions
from animtool.systems.framework.fields import COLLISION_KEYS, PlacedModel
from animtool.systems.framework.spec import PinnedPoints

# A system is probably in a wrong unit if its distance from a character is FAR_RATIO
# times the character's size, or its own size LARGE_RATIO times it, but in the rig's
# unit they would be within NEAR_RATIO and FITTING_RATIO times it.
FAR_RATIO, LARGE_RATIO, NEAR_RATIO, FITTING_RATIO = 10.0, 20.0, 2.0, 5.0
# Names of units in messages.
_UNIT_NAMES = {
    LengthUnit.M: "metres",
    LengthUnit.CM: "centimetres",
    LengthUnit.MM: "millimetres",
    LengthUnit.IN: "inches",
}


def placement_warnings(
    systems: Sequence[SceneSystem],
    characters: CharacterMotions,
    main_rig: Rig | None = None,
) -> list[Fault]:
    """Return warnings about systems that do not fit their characters.

    SIM168 reports a system with pins that are farther from their nearest particle at
    0 s than the size of their character. SIM169 reports any other system that is far
    away or large, but would fit in the unit of the rig. ``main_rig`` is the rig of the
    scene's own character; every system is compared with it.
    """
    first_frames = CharacterMotions()
    faults = []
    for system in systems:
        length_unit = system.unit or LengthUnit.M
        warnings: list[Fault] = []
        for pin in _character_pins(system):
            path = pin.carrier.file
            if path not in first_frames.by_path:
                first_frames.by_path[path] = _first_frame(characters.for_file(path))
            warnings += _pin_warnings(pin, first_frames, length_unit)
        rigs = [characters.for_file(path).rig for path in _characters(system)]
        rigs = [main_rig, *rigs] if main_rig is not None else rigs
        scale_warnings = (_scale_warnings(system, rig, length_unit) for rig in rigs)
        if not warnings:
            warnings += next(filter(None, map(list, scale_warnings)), [])
        faults += [system.location.locate(fault) for fault in warnings]
    return faults


def _characters(system: SceneSystem) -> list[Path]:
    """Return the files of the characters that a system depends on."""
    files = [
        Path(str(character.file)) for character in system.setup.surroundings.characters
    ]
    files += [pin.carrier.file for pin in _character_pins(system)]
    return list(dict.fromkeys(files))


def _character_pins(system: SceneSystem) -> list[PinnedPoints]:
    """Return the pinned points of a system that a character carries."""
    pins = getattr(system.setup.record, "pinned_points", ())
    return [
        pin for pin in pins if isinstance(pin.carrier, JointCarrier | VertexCarrier)
    ]


def _scale_warnings(
    system: SceneSystem, rig: Rig, length_unit: LengthUnit
) -> Iterator[Fault]:
    """Yield a warning if a system fits its character only in the rig's length unit."""
    points = _start_positions(system)
    joint_size, bounds_size = _rig_sizes(rig)
    scale = rig.meters_per_unit / length_unit.meters
    if not bounds_size or not len(points) or np.isclose(scale, 1.0):
        return
    joint_positions = rest_world(rig).positions[0]
    rotation = up_from_up(UpAxis.Y, rig.up)
    if rotation is not None:
        joint_positions = so3.rotate(rotation, joint_positions)
    distance = _bounds_distance(points, joint_positions)
    extent = float(np.ptp(points, axis=0).max())
    scaled_distance = _bounds_distance(points * scale, joint_positions)
    is_near = scaled_distance <= NEAR_RATIO * bounds_size
    if not is_near or extent * scale > FITTING_RATIO * bounds_size:
        return
    if distance > FAR_RATIO * bounds_size:
        description = f"starts {plain_number(distance, 4)} m from the character"
    elif extent > LARGE_RATIO * bounds_size:
        description = f"is {plain_number(extent, 4)} m large"
    else:
        return
    unit, system_unit = unit_name(rig.meters_per_unit), _UNIT_NAMES[length_unit]
    message = f"{system.name} {description}, but the joints of {rig.name!r} span "
    message += (
        f"{plain_number(joint_size)} m; systems use {system_unit}, but the rig is "
    )
    message += f"in {unit}"
    hint = _unit_hint(unit) or f"write its lengths in {system_unit}"
    yield warning("SIM169", message, hint)


def _start_positions(system: SceneSystem) -> FloatArray:
    """Return the positions that a system states for 0 s ``(N, 3)`` [m]."""
    positions: FloatArray | None = getattr(system.setup.record, "positions", None)
    if positions is not None:
        return positions
    spec = system.setup.spec
    entry_positions = [
        entry.at
        for key in type(spec).model_fields.keys() - {*COLLISION_KEYS}
        if isinstance(entries := getattr(spec, key), list)
        for entry in entries
        if isinstance(entry, PlacedModel) and "at" in entry.model_fields_set
    ]
    return np.array(entry_positions, np.float64).reshape(-1, 3)


def _bounds_distance(points: FloatArray, other_points: FloatArray) -> float:
    """Return the distance between the bounds of two sets of points [m]."""
    gaps = np.maximum(
        points.min(axis=0) - other_points.max(axis=0),
        other_points.min(axis=0) - points.max(axis=0),
    )
    return float(np.linalg.norm(np.maximum(gaps, 0.0)))


def _first_frame(character: CharacterMotion) -> CharacterMotion:
    """Return the first frame of a character in motion."""
    world = character.world
    return replace(
        character,
        motion=character.motion.select(slice(0, 1)),
        world=WorldTransforms(world.positions[:1], world.linear[:1]),
        times=character.times[:1],
    )


def _pin_warnings(
    pinned_points: PinnedPoints, characters: CharacterMotions, length_unit: LengthUnit
) -> Iterator[Fault]:
    """Yield a warning if a pin is far from its carrier.

    ``length_unit`` is that of the system's lengths.
    """
    carrier: JointCarrier | VertexCarrier = pinned_points.carrier
    rig = characters.for_file(carrier.file).rig
    joint_size, bounds_size = _rig_sizes(rig)
    local_positions = pinned_points.local_positions(carrier.poses(characters))
    min_distance = float(np.linalg.norm(local_positions, axis=-1).min(initial=np.inf))
    if not bounds_size or min_distance <= bounds_size or not np.isfinite(min_distance):
        return
    if isinstance(carrier, JointCarrier):
        description = f"joint {carrier.joint!r}"
    else:
        description = f"vertex {carrier.vertex} of mesh {carrier.mesh!r}"
    unit = unit_name(rig.meters_per_unit)
    message = f"the pinned end is {plain_number(min_distance, 4)} m from {description}"
    message += f", but the joints of {rig.name!r} span {plain_number(joint_size)} m"
    hint = "move the pinned end to its pin, or give the pin an offset"
    if unit != length_unit:
        message += f"; systems use {_UNIT_NAMES[length_unit]}, but the rig is in {unit}"
        remedies = [_unit_hint(unit), "move the pinned end to its pin"]
        hint = ", or ".join(filter(None, remedies))
    yield warning("SIM168", message, hint, pinned_points.where)


def _unit_hint(unit: str) -> str:
    """Return a hint to set a unit in the scene; empty if the unit has no name."""
    if unit not in {candidate.value for candidate in LengthUnit}:
        return ""
    return f"write units: {{length: {unit}}} in the scene"


def _rig_sizes(rig: Rig) -> tuple[float, float]:
    """Return the longest extent of the resting joints, without and with meshes [m]."""
    point_sets = [rest_world(rig).positions[0]]
    point_sets += [mesh.points for mesh in surfaces_of(rig) if len(mesh.points)]
    extents = [float(np.ptp(points, axis=0).max()) for points in point_sets]
    return extents[0], max(extents)
