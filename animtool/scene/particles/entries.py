"""Reading the particles of a scene file: records of entries, all faults noted."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from animtool.documents.document import Document, Location
from animtool.errors import AnimtoolError, Fault, OptionError
from animtool.scene.particles.schema import EmitterModel, ParticlesModel
from animtool.scene.particles.system import ParticleSetup
from animtool.scene.systems.entries import PLACING, EntryReader
from animtool.scene.systems.surroundings import Surroundings, read_surfaces
from animtool.sim.colliders import Mesh
from animtool.sim.options import IntegrateOptions
from animtool.systems.fields import Named
from animtool.systems.particles import (
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

PLACES: dict[str, type[Any]] = {
    "box": BoxPlace,
    "disc": Disc,
    "mesh": Mesh,
    "point": Point,
    "sphere": SpherePlace,
}


def read_particles(
    document: Document, at: Location, model: ParticlesModel, roots: Sequence[Path]
) -> ParticleSetup | None:
    """Return the particles of an entry; None where what is noted leaves none."""
    reader = _Reader(document, roots)
    particles = reader.particles(at, model)
    characters = reader.characters((*at, "characters"), model.characters)
    if particles is None:
        return None
    surfaces = read_surfaces(reader, (*at, "systems"), model.systems)
    meshes = reader.meshes((*at, "meshes"), model.meshes)
    around = Surroundings(
        tuple(particles.colliders), characters, surfaces, meshes, tuple(reader.files)
    )
    return ParticleSetup(particles, around, model.preroll)


class _Reader(EntryReader):
    def particles(self, at: Location, model: ParticlesModel) -> Particles | None:
        emitters = [
            self.checked((*at, "emitters", i), self._emitter, entry)
            for i, entry in enumerate(model.emitters)
        ]
        forces = [
            self._force((*at, "forces", i), entry)
            for i, entry in enumerate(model.forces)
        ]
        colliders = self.colliders((*at, "colliders"), model.colliders)
        kills = self.colliders((*at, "kill"), model.kill)
        velocity = self._velocity((*at, "velocity"), model)
        if not self.sound:
            return None
        setup = Particles(
            [entry for entry in emitters if entry],
            [entry for entry in forces if entry],
            velocity,
            colliders,
            [KillRegion(entry) for entry in kills],
            IntegrateOptions(model.method, model.step, model.tolerance),
            model.max_particles,
            model.name,
        )
        try:
            setup.check()
        except OptionError as error:
            self._note_keys(at, model, error.faults)
        return setup

    def _note_keys(
        self, at: Location, model: ParticlesModel, faults: Sequence[Fault]
    ) -> None:
        """Note faults of the whole at the keys that they are of."""
        for fault in faults:
            key = "method" if fault.code in {"SIM001", "SIM006"} else fault.where
            known = key in model.model_fields_set
            self.note((*at, key) if known and key else at, fault)

    def _emitter(self, at: Location, model: EmitterModel) -> Emitter | None:
        place = self.named((*at, "place"), model.place, PLACES, "place", "SIM021")
        if place is None:
            return None
        poses = self.poses(at, model, "SIM021")
        if poses is None:
            return None
        given = model.model_dump(exclude={*PLACING, "place"})
        given["bursts"] = [(when, int(count)) for when, count in model.bursts]
        given["spread"] = math.radians(model.spread)
        given["start"] = -math.inf if model.start is None else model.start
        given["end"] = math.inf if model.end is None else model.end
        given["lifetime"] = math.inf if model.lifetime is None else model.lifetime
        if isinstance(place, Mesh):
            place = MeshSurface(place)
        return Emitter(place=place, poses=poses, **given)

    def _force(self, at: Location, entry: Named) -> Force | None:
        ((name, given),) = entry.items()
        try:
            kind = find_force(name)
        except AnimtoolError as error:
            self.note((*at, name), error.faults[0])
            return None
        made = self.record((*at, name), kind, given or {}, name)
        for option, why in [] if made is None else made.faults():
            place = (*at, name, *([option] if option in (given or {}) else []))
            self.note(place, Fault("SIM022", f"its {option} {why}"))
        return made

    def _velocity(self, at: Location, model: ParticlesModel) -> VelocityField | None:
        if model.velocity is None:
            return None
        made = VelocityField(model.velocity.x, model.velocity.y, model.velocity.z)
        for axis, why in made.faults():
            self.note((*at, axis), Fault("SIM022", f"its {axis} {why}"))
        return made
