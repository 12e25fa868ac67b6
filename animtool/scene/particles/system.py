"""Particles of a scene, and how they are run."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Protocol, cast

from animtool._types import FloatArray
from animtool.documents.document import Location
from animtool.errors import Fault, Severity, counted
from animtool.frames import PointsFrame
from animtool.scene.entries import SceneSystem
from animtool.scene.systems.character_collider import (
    CharacterCollider,
    character_colliders,
)
from animtool.scene.systems.kinds import SystemFacts
from animtool.scene.systems.moving_mesh import MovingMesh
from animtool.scene.systems.simulation import Opening
from animtool.sim.colliders import Collider, Plane, Sheet, SheetMotion
from animtool.systems.particles.run import ParticleRun
from animtool.systems.particles.trial import ParticleTrial

if TYPE_CHECKING:
    from animtool.scene.springs.setup import SpringSetup
    from animtool.sim.options import IntegrateOptions
    from animtool.systems.particles.setup import Particles


@dataclass(frozen=True, slots=True)
class SurfaceCollider:
    """Cloth or a volume that particles run into.

    Attributes:
        system: Its name.
        restitution: Share of the speed into the surface that comes back [1].
        friction: Coulomb's coefficient [1].
        at: Place of the entry.
    """

    system: str
    restitution: float
    friction: float
    at: Location

    def problems(self) -> list[tuple[str, str]]:
        """Return what of it makes no sense: an option, and why."""
        like = Collider(Plane(), restitution=self.restitution, friction=self.friction)
        return like.problems()


class Watchable(Protocol):
    """A system whose surface can be met.

    Attributes:
        setup: What it is made of.
    """

    setup: SpringSetup

    def watched(self, begin: float, step: float) -> SheetMotion:
        """Return its surface from a time on, looked at in steps [s]."""


@dataclass(frozen=True, slots=True)
class ParticleSetup:
    """What particles are made of.

    Attributes:
        particles: What makes, moves, stops and removes them.
        preroll: Time before 0 s that they begin in [s].
        characters: Those that they run into.
        surfaces: Cloth and volumes of the scene that they run into.
        meshes: Meshes of USD files that they run into.
        followed: USD files that colliders and emitters go with.
    """

    particles: Particles
    preroll: float = 0.0
    characters: tuple[CharacterCollider, ...] = ()
    surfaces: tuple[SurfaceCollider, ...] = ()
    meshes: tuple[MovingMesh, ...] = ()
    followed: tuple[Path, ...] = ()

    @property
    def joined(self) -> tuple[tuple[str, Location], ...]:
        """Systems that they are one with: none."""
        return ()

    @property
    def needs(self) -> tuple[tuple[str, Location], ...]:
        """Systems that they meet, and that do not feel them."""
        return tuple((met.system, (*met.at, "system")) for met in self.surfaces)

    @property
    def files(self) -> tuple[Path, ...]:
        """What is read beside the scene."""
        return (*(met.file for met in self.characters), *self.followed)

    @property
    def reads(self) -> tuple[str, ...]:
        """What acts on them, in words."""
        given = self.particles
        reads = [counted(len(given.emitters), "emitter")]
        reads += [counted(len(given.forces), "force")] if given.forces else []
        reads += ["a velocity field"] if given.velocity else []
        reads += [counted(len(given.colliders), "collider")] if given.colliders else []
        reads += [met.system for met in self.surfaces]
        reads += [mesh.prim for mesh in self.meshes]
        return tuple(reads)

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
        many = len(given.colliders) + len(self.meshes)
        return SystemFacts(counts, given.options.method, given.options.step, many)


def open_particles(
    members: Sequence[SceneSystem], opening: Opening
) -> list[RunningParticles]:
    """Return particles at their beginning; characters are read now.

    Raises:
        FormatError: The file of a character is malformed.
        OptionError: A character has no colliders (SIM020), or something makes no
            sense.
    """
    setup, whole = _whole(members, opening)
    return [RunningParticles(ParticleRun(whole, -setup.preroll))]


def particle_trial(
    members: Sequence[SceneSystem], rebuild: Callable[[], Opening], times: FloatArray
) -> ParticleTrial:
    """Return particles that can be simulated in several ways.

    Raises:
        FormatError: The file of a character is malformed.
        OptionError: As `open_particles`.
    """
    (member,) = members
    setup = cast(ParticleSetup, member.setup)
    opened = rebuild()

    def made(options: IntegrateOptions | None) -> Particles:
        # Cloth that they run into begins again with them.
        return _whole(members, rebuild() if setup.surfaces else opened, options)[1]

    return ParticleTrial(made, -setup.preroll, times)


def _whole(
    members: Sequence[SceneSystem],
    opening: Opening,
    options: IntegrateOptions | None = None,
) -> tuple[ParticleSetup, Particles]:
    """Return particles with the characters and surfaces that they run into.

    Args:
        members: One system.
        opening: What it may ask for.
        options: How they are simulated; None is as the file says.
    """
    (member,) = members
    setup = cast(ParticleSetup, member.setup)
    given = setup.particles
    options = options or given.options
    capsules, skins = character_colliders(setup.characters, opening.characters)
    assert options.step is not None
    sheets = [_sheet(met, opening, setup, options.step) for met in setup.surfaces]
    sheets += [*(mesh.sheet() for mesh in setup.meshes), *skins]
    return setup, replace(
        given, colliders=[*given.colliders, *capsules], sheets=sheets, options=options
    )


def _sheet(
    met: SurfaceCollider, opening: Opening, setup: ParticleSetup, step: float
) -> Sheet:
    other = cast(Watchable, opening.opened[met.system])
    shape = other.setup.body.shape
    return Sheet(
        other.watched(-setup.preroll, step),
        other.setup.radius,
        getattr(shape, "closed", False),
        met.system,
        met.restitution,
        met.friction,
    )


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
