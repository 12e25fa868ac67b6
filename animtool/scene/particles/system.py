"""Particles of a scene, and how they are run."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, cast

from animtool._types import FloatArray
from animtool.documents.document import Location
from animtool.errors import Fault, Severity, counted
from animtool.frames import PointsFrame
from animtool.scene.entries import SceneSystem
from animtool.scene.systems.kinds import SystemFacts
from animtool.scene.systems.simulation import Opening
from animtool.scene.systems.surroundings import Surroundings
from animtool.systems.particles.run import ParticleRun
from animtool.systems.particles.trial import ParticleTrial

if TYPE_CHECKING:
    from animtool.sim.options import IntegrateOptions
    from animtool.systems.particles.setup import Particles


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
) -> list[RunningParticles]:
    """Return particles at their beginning; characters are read now."""
    setup, whole = _whole(members, opening)
    return [RunningParticles(ParticleRun(whole, -setup.preroll))]


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


class RunningParticles:
    """Particles under way.

    Attributes:
        run: What takes them through time.
    """

    def __init__(self, run: ParticleRun) -> None:
        self.run = run
        self._looks = self._seen = 0

    @property
    def notices(self) -> list[Fault]:
        """What is odd so far."""
        if self._seen or not self._looks:
            return self.run.notices
        message = "there is no particle at any frame"
        hint = "give emitters a rate or bursts, and a start and a lifetime by which "
        hint += "their particles are there in the range"
        nobody = Fault("SIM188", message, hint=hint, severity=Severity.WARNING)
        return [*self.run.notices, nobody]

    def report(self) -> dict[str, object]:
        """Return nothing: what is written says it all."""
        return {}

    def at(self, t: float) -> PointsFrame:
        """Return the particles at a time [s], not before the last one asked for."""
        frame = self.run.at(t)
        self._looks += 1
        self._seen += len(frame.ids)
        primvars = {"age": frame.ages}
        return PointsFrame(
            frame.ids, frame.points, frame.velocities, frame.radii, primvars
        )
