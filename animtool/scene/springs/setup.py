"""What ropes, strands, cloth and volumes of a scene are made of."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from animtool._types import FloatArray
from animtool.documents.document import Location
from animtool.errors import counted
from animtool.scene.springs.bodies import SpringBody
from animtool.scene.springs.pins import Join, Pin
from animtool.scene.springs.shapes import Faces
from animtool.scene.systems.character_collider import CharacterCollider
from animtool.scene.systems.kinds import SystemFacts
from animtool.scene.systems.moving_mesh import MovingMesh
from animtool.sim.colliders import Collider
from animtool.sim.springs import Air, SelfContact, SpringOptions


@dataclass(frozen=True, slots=True, eq=False)
class Wind:
    """Air in motion.

    Attributes:
        velocity: ``(3,)`` [m/s].
        gusts: More of it over time: seconds and velocity ``(K, 4)``.
        faces: Density [kg/m³], and coefficients of drag and lift, of faces that bear
            it; None is taken along by drag.
    """

    velocity: FloatArray
    gusts: FloatArray
    faces: tuple[float, float, float] | None = None

    @property
    def air(self) -> Air:
        """As faces bear it."""
        density, drag, lift = self.faces or (0.0, 0.0, 0.0)
        if not len(self.gusts):
            return Air(self.velocity, drag, lift, density)
        winds = self.velocity + self.gusts[:, 1:]
        return Air(winds, drag, lift, density, self.gusts[:, 0])

    def same(self, other: Wind) -> bool:
        """Return whether it is as another."""
        return (
            np.array_equal(self.velocity, other.velocity)
            and np.array_equal(self.gusts, other.gusts)
            and self.faces == other.faces
        )


@dataclass(frozen=True, slots=True, eq=False)
class SpringSetup:
    """What particles and springs of an entry are made of.

    Attributes:
        body: Particles and springs.
        pins: What holds and draws them.
        joins: What makes them one with those of other systems.
        gravity: ``(3,)`` [m/s²].
        drag: What slows all motion, over mass and speed [1/s].
        radius: What is kept from colliders [m].
        speed_limit: Pins that go faster were put elsewhere [m/s].
        wind: The air; None is still, and faces bear none.
        self_contact: How it keeps apart from itself; None goes through.
        colliders: What they run into.
        characters: Those that they run into.
        options: Solver and steps.
        preroll: Time before 0 s that they begin in [s].
        settle: Whether they begin at rest.
        given: Names of the keys that the entry has.
        at: Place of the entry.
        meshes: Meshes of USD files that they run into.
        followed: USD files that colliders go with, and those of meshes.
    """

    body: SpringBody
    pins: tuple[Pin, ...]
    joins: tuple[Join, ...]
    gravity: FloatArray
    drag: float
    radius: float
    speed_limit: float
    wind: Wind | None
    self_contact: SelfContact | None
    colliders: tuple[Collider, ...]
    characters: tuple[CharacterCollider, ...]
    options: SpringOptions
    preroll: float
    settle: bool
    given: frozenset[str]
    at: Location
    meshes: tuple[MovingMesh, ...] = ()
    followed: tuple[Path, ...] = ()

    @property
    def joined(self) -> tuple[tuple[str, Location], ...]:
        """Systems that it is one with, and where it says so."""
        return tuple((join.system, join.at[0]) for join in self.joins)

    @property
    def needs(self) -> tuple[tuple[str, Location], ...]:
        """Systems that it meets, and that do not feel it."""
        return ()

    @property
    def files(self) -> tuple[Path, ...]:
        """What is read beside the scene."""
        carriers = [pin.carrier.file for pin in self.pins if pin.carrier is not None]
        return (*(met.file for met in self.characters), *carriers, *self.followed)

    @property
    def reads(self) -> tuple[str, ...]:
        """What acts on them, in words."""
        reads = [counted(len(self.pins), "pin")] if self.pins else []
        reads += [f"{join.system}, joined" for join in self.joins]
        reads += ["the wind"] if self.wind is not None else []
        reads += ["itself"] if self.self_contact is not None else []
        many = len(self.colliders)
        reads += [counted(many, "collider")] if many else []
        reads += [met.file.name for met in self.characters]
        reads += [mesh.prim for mesh in self.meshes]
        return tuple(reads)

    @property
    def makes(self) -> str:
        """What becomes of them, in words."""
        body = self.body.body
        particles = counted(len(body.positions), "particle")
        springs = counted(len(body.springs.rest), "spring")
        solver, step = self.options.solver, self.options.step
        how = f"by {solver}" if step is None else f"by {solver} in steps of {step:g} s"
        return f"{particles} with {springs}, {how}"

    @property
    def facts(self) -> SystemFacts:
        """What they are made of, in numbers."""
        body, shape = self.body.body, self.body.shape
        drawn = "faces" if isinstance(shape, Faces) else "curves"
        counts = {
            "particles": len(body.positions),
            "springs": len(body.springs.rest),
            drawn: len(shape.counts),
        }
        options, many = self.options, len(self.colliders) + len(self.meshes)
        return SystemFacts(counts, str(options.solver), options.step, many)
