"""Reading the particles of a scene file: records of entries, all faults noted."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from pydantic import TypeAdapter, ValidationError

from animtool.documents.arrays import Archives
from animtool.documents.check import wrong_values
from animtool.documents.document import Document, Location
from animtool.documents.names import nearest
from animtool.documents.references import (
    referred,
    referred_input,
    split_reference,
)
from animtool.errors import AnimtoolError, Fault, OptionError
from animtool.scene.particle_system import ParticleSetup
from animtool.scene.system_schema import (
    CharacterModel,
    EmitterModel,
    Named,
    ParticlesModel,
    SystemColliderModel,
)
from animtool.sim.colliders import Box, Capsule, Collider, Mesh, Plane, Poses, Sphere
from animtool.sim.options import IntegrateOptions
from animtool.sim.particles import (
    BoxPlace,
    Disc,
    Emitter,
    Force,
    KillRegion,
    MeshSurface,
    Particles,
    Point,
    SpherePlace,
    VelocityField,
    find_force,
)

__all__ = ["read_particles"]

SHAPES: dict[str, type[Any]] = {
    "box": Box,
    "capsule": Capsule,
    "mesh": Mesh,
    "plane": Plane,
    "sphere": Sphere,
}
PLACES: dict[str, type[Any]] = {
    "box": BoxPlace,
    "disc": Disc,
    "mesh": Mesh,
    "point": Point,
    "sphere": SpherePlace,
}
Record = TypeVar("Record")


def read_particles(
    document: Document, at: Location, model: ParticlesModel, roots: Sequence[Path]
) -> ParticleSetup | None:
    """Return the particles of an entry; None where what is noted leaves none.

    Args:
        document: Where faults are noted.
        at: Place of the entry.
        model: What it says.
        roots: Folders that files may be in.
    """
    reader = _Reader(document, roots)
    particles = reader.particles(at, model)
    characters = reader.characters((*at, "characters"), model.characters)
    if particles is None:
        return None
    return ParticleSetup(particles, model.preroll, characters)


class _Reader:
    def __init__(self, document: Document, roots: Sequence[Path]) -> None:
        self.document, self.roots = document, tuple(roots)
        self.archives = Archives()
        self.sound = True

    def particles(self, at: Location, model: ParticlesModel) -> Particles | None:
        emitters = [
            self._checked((*at, "emitters", i), self._emitter, entry)
            for i, entry in enumerate(model.emitters)
        ]
        forces = [
            self._force((*at, "forces", i), entry)
            for i, entry in enumerate(model.forces)
        ]
        colliders = [
            self._checked((*at, "colliders", i), self._collider, entry)
            for i, entry in enumerate(model.colliders)
        ]
        kills = [
            self._checked((*at, "kill", i), self._collider, entry)
            for i, entry in enumerate(model.kill)
        ]
        velocity = self._velocity((*at, "velocity"), model)
        if not self.sound:
            return None
        setup = Particles(
            [entry for entry in emitters if entry],
            [entry for entry in forces if entry],
            velocity,
            [entry for entry in colliders if entry],
            [KillRegion(entry) for entry in kills if entry],
            IntegrateOptions(model.method, model.step, model.tolerance),
            model.most,
            model.name,
        )
        try:
            setup.check()
        except OptionError as error:
            self._note_keys(at, model, error.faults)
        return setup

    def characters(
        self, at: Location, models: Sequence[CharacterModel]
    ) -> tuple[tuple[Path, tuple[float, float, float]], ...]:
        """Return files of characters, and what touching one does."""
        found = []
        for i, model in enumerate(models):
            codes, place = ("SCN004", "SCN005"), (*at, i, "file")
            path = referred_input(self.document, place, model.file, self.roots, codes)
            if path is not None:
                found.append((path, (model.restitution, model.friction, model.margin)))
        return tuple(found)

    def _note_keys(
        self, at: Location, model: ParticlesModel, faults: Sequence[Fault]
    ) -> None:
        """Note faults of the whole at the keys that they are of."""
        for fault in faults:
            key = "method" if fault.code in {"SIM001", "SIM006"} else fault.where
            known = key in model.model_fields_set
            place = (*at, key) if known and key else at
            self.document.add(fault.code, place, fault.message, fault.hint)

    def _checked(
        self, at: Location, make: Callable[[Location, Any], Record | None], model: Any
    ) -> Record | None:
        made: Any = make(at, model)
        if made is None:
            self.sound = False
            return None
        for fault in made.faults(""):
            self.sound = False
            self.document.add(fault.code, at, fault.message, fault.hint)
        return made  # type: ignore[no-any-return]

    def _emitter(self, at: Location, model: EmitterModel) -> Emitter | None:
        place = self._named((*at, "place"), model.place, PLACES, "place", "SIM021")
        if place is None:
            return None
        given = model.model_dump(exclude={"at", "rotate", "moves", "place"})
        given["bursts"] = [(when, int(count)) for when, count in model.bursts]
        given["spread"] = math.radians(model.spread)
        given["start"] = -math.inf if model.start is None else model.start
        given["end"] = math.inf if model.end is None else model.end
        given["lifetime"] = math.inf if model.lifetime is None else model.lifetime
        if isinstance(place, Mesh):
            place = MeshSurface(place)
        return Emitter(place=place, poses=_poses(model), **given)

    def _collider(self, at: Location, model: SystemColliderModel) -> Collider | None:
        shape = self._named((*at, "shape"), model.shape, SHAPES, "shape", "SIM020")
        if shape is None:
            return None
        given = model.model_dump(exclude={"at", "rotate", "moves", "shape"})
        return Collider(shape, _poses(model), **given)

    def _force(self, at: Location, entry: Named) -> Force | None:
        ((name, given),) = entry.items()
        try:
            kind = find_force(name)
        except AnimtoolError as error:
            self._note((*at, name), error.faults[0])
            return None
        made = self._record((*at, name), kind, given or {}, name)
        for option, why in [] if made is None else made.faults():
            self.sound = False
            place = (*at, name, *([option] if option in (given or {}) else []))
            self.document.add("SIM022", place, f"its {option} {why}")
        return made

    def _velocity(self, at: Location, model: ParticlesModel) -> VelocityField | None:
        if model.velocity is None:
            return None
        made = VelocityField(model.velocity.x, model.velocity.y, model.velocity.z)
        for axis, why in made.faults():
            self.sound = False
            self.document.add("SIM022", (*at, axis), f"its {axis} {why}")
        return made

    def _named(
        self,
        at: Location,
        entry: Named,
        table: Mapping[str, type[Any]],
        what: str,
        code: str,
    ) -> Any:
        """Return the record of an entry that names one of a table."""
        ((name, given),) = entry.items()
        if name not in table:
            hint = nearest(name, list(table))
            self._note((*at, name), Fault(code, f"no {what} is {name!r}", hint=hint))
            return None
        if table[name] is Mesh:
            return self._mesh((*at, name), given or {})
        return self._record((*at, name), table[name], given or {}, name)

    def _record(
        self, at: Location, kind: type[Record], given: dict[str, Any], name: str
    ) -> Record | None:
        """Return a record of options, all of which are checked."""
        names = [field.name for field in fields(kind)]  # type: ignore[arg-type]
        unknown = [key for key in given if key not in names]
        for key in unknown:
            message = f"unknown option {key!r} of {name}"
            self._note((*at, key), Fault("SCN001", message, hint=nearest(key, names)))
        known = {key: value for key, value in given.items() if key in names}
        try:
            made = TypeAdapter(kind).validate_python(known)
        except ValidationError as error:
            for place, message in wrong_values(known, error):
                self._note((*at, *place), Fault("SCN002", message))
            return None
        return None if unknown else made

    def _mesh(self, at: Location, given: dict[str, Any]) -> Mesh | None:
        """Return the mesh whose arrays a file has."""
        arrays = []
        for key in ("points", "triangles"):
            text = given.get(key)
            if not isinstance(text, str):
                message = f"a mesh has {key}, such as stairs.npz#{key}"
                self._note((*at, key) if key in given else at, Fault("SCN002", message))
                continue
            name, array = split_reference(text, key)
            path = referred(self.document, (*at, key), name, self.roots, "SCN004")
            if path is None:
                self.sound = False
                continue
            try:
                arrays.append(self.archives.load(path, array))
            except ValueError as error:
                self._note((*at, key), Fault("SCN005", str(error)))
        if len(arrays) < 2:
            return None
        return Mesh(arrays[0], np.asarray(arrays[1], np.int64))

    def _note(self, at: Location, fault: Fault) -> None:
        self.sound = False
        self.document.add(fault.code, at, fault.message, fault.hint)


def _poses(model: EmitterModel | SystemColliderModel) -> Poses:
    w, x, y, z = model.rotate
    if not model.moves:
        return Poses.fixed(model.at, (x, y, z, w))
    rows = np.array(model.moves)
    turns = np.tile([x, y, z, w], (len(rows), 1))
    return Poses(rows[:, 0], rows[:, 1:] + model.at, turns)
