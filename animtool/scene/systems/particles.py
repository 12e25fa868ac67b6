"""Particles of a scene: read from the keys of their entry, and run."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import cast

from animtool._types import FloatArray
from animtool.documents.document import Document, Location
from animtool.errors import Fault, OptionError, counted
from animtool.scene.entries import SceneSystem
from animtool.scene.systems.entries import PLACING, EntryReader
from animtool.scene.systems.setups import SystemFacts
from animtool.scene.systems.simulation import Opening
from animtool.scene.systems.surroundings import Surroundings
from animtool.sim.options import IntegrateOptions
from animtool.systems.particles import (
    Emitter,
    KillRegion,
    Particles,
    VelocityField,
)
from animtool.systems.particles.run import ParticleSimulation
from animtool.systems.particles.spec import EmitterModel, ParticlesModel
from animtool.systems.particles.trial import ParticleTrial
from animtool.systems.simulation import SimulationRun


@dataclass(frozen=True, slots=True)
class ParticleSetup:
    """What particles are made of: what moves them, and what they run into."""

    particles: Particles  # without what they run into
    around: Surroundings
    preroll: float = 0.0  # time before 0 s that they begin in [s]

    @property
    def joined(self) -> tuple[tuple[str, Location], ...]:
        """Systems that they are one with: none."""
        return ()

    @property
    def needs(self) -> tuple[tuple[str, Location], ...]:
        """Systems that they run into, and that do not feel them."""
        return self.around.needs

    @property
    def files(self) -> tuple[Path, ...]:
        """Files that are read along with the scene."""
        return self.around.files

    @property
    def reads(self) -> tuple[str, ...]:
        """What acts on them, in words."""
        given = self.particles
        reads = [counted(len(given.emitters), "emitter")]
        reads += [counted(len(given.forces), "force")] if given.forces else []
        reads += ["a velocity field"] if given.velocity else []
        return (*reads, *self.around.reads)

    @property
    def makes(self) -> str:
        """What becomes of them, in words."""
        options = self.particles.options
        return f"particles, by {options.method} in steps of {options.step:g} s"

    @property
    def facts(self) -> SystemFacts:
        """What they are made of, in numbers."""
        given = self.particles
        counts = {
            "emitters": len(given.emitters),
            "forces": len(given.forces),
            "max_particles": given.max_particles,
        }
        options, count = given.options, self.around.count
        return SystemFacts(counts, options.method, options.step, count)


def open_particles(
    members: Sequence[SceneSystem], opening: Opening
) -> list[SimulationRun]:
    """Return particles at their beginning; characters are read now."""
    setup, whole = _whole(members, opening)
    begin, step = -setup.preroll, whole.options.step
    assert step is not None
    simulation = ParticleSimulation(whole, begin)
    return [SimulationRun(whole.name, simulation, begin, step)]


def particle_trial(
    members: Sequence[SceneSystem], rebuild: Callable[[], Opening], times: FloatArray
) -> ParticleTrial:
    """Return particles that can be simulated in several ways."""
    (member,) = members
    setup = cast(ParticleSetup, member.setup)
    opened = rebuild()

    def made(options: IntegrateOptions | None) -> Particles:
        # Cloth that they run into begins again with them.
        return _whole(members, rebuild() if setup.around.surfaces else opened, options)[
            1
        ]

    return ParticleTrial(made, -setup.preroll, times)


def _whole(
    members: Sequence[SceneSystem],
    opening: Opening,
    options: IntegrateOptions | None = None,
) -> tuple[ParticleSetup, Particles]:
    """Return particles with the characters and surfaces that they run into."""
    (member,) = members
    setup = cast(ParticleSetup, member.setup)
    given = setup.particles
    options = options or given.options
    assert options.step is not None
    colliders, sheets = setup.around.built(opening, -setup.preroll, options.step)
    return setup, replace(given, colliders=colliders, sheets=sheets, options=options)


def read_particles(
    document: Document, at: Location, model: ParticlesModel, roots: Sequence[Path]
) -> ParticleSetup | None:
    """Return the particles of an entry; None where what is noted leaves none."""
    reader = _Reader(document, roots)
    particles = reader.particles(at, model)
    characters = reader.characters((*at, "characters"), model.characters)
    if particles is None:
        return None
    surfaces = reader.surfaces((*at, "systems"), model.systems)
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
            self.force((*at, "forces", i), entry)
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
        place = self.emitter_place((*at, "place"), model.place)
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
        return Emitter(place=place, poses=poses, **given)

    def _velocity(self, at: Location, model: ParticlesModel) -> VelocityField | None:
        if model.velocity is None:
            return None
        made = VelocityField(model.velocity.x, model.velocity.y, model.velocity.z)
        for axis, why in made.faults():
            self.note((*at, axis), Fault("SIM022", f"its {axis} {why}"))
        return made
