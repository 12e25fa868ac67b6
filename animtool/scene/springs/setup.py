"""What springs of a scene are made of: joined, shared and checked."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, cast

import numpy as np

from animtool._types import FloatArray, IntArray
from animtool.documents.document import Document, Location
from animtool.errors import Fault, OptionError, counted
from animtool.scene.entries import SceneSystem
from animtool.scene.springs.bodies import SpringBody
from animtool.scene.springs.pins import Join, Pin, numbered
from animtool.scene.springs.shapes import Faces
from animtool.scene.systems.character_collider import CharacterCollider
from animtool.scene.systems.kinds import SystemFacts
from animtool.scene.systems.moving_mesh import MovingMesh
from animtool.sim.colliders import Collider
from animtool.systems.springs import Air, SelfContact, Solver, SpringOptions
from animtool.systems.springs.options import check_keeping_apart


@dataclass(frozen=True, slots=True, eq=False)
class Wind:
    """Air in motion."""

    velocity: FloatArray  # ``(3,)`` [m/s]
    gusts: FloatArray  # more of it over time: seconds and velocity ``(K, 4)``
    # Density [kg/m³], and coefficients of drag and lift, of faces that bear it; None is
    # taken along by drag.
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
    """What particles and springs of an entry are made of."""

    body: SpringBody  # particles and springs
    pins: tuple[Pin, ...]  # what holds and draws them
    joins: tuple[Join, ...]  # what makes them one with those of other systems
    gravity: FloatArray  # ``(3,)`` [m/s²]
    drag: float  # what slows all motion, over mass and speed [1/s]
    radius: float  # what is kept from colliders [m]
    speed_limit: float  # pins that go faster were put elsewhere [m/s]
    wind: Wind | None  # the air; None is still, and faces bear none
    # How it keeps apart from itself; None goes through.
    self_contact: SelfContact | None
    colliders: tuple[Collider, ...]  # what they run into
    characters: tuple[CharacterCollider, ...]  # those that they run into
    options: SpringOptions  # solver and steps
    preroll: float  # time before 0 s that they begin in [s]
    settle: bool  # whether they begin at rest
    given: frozenset[str]  # names of the keys that the entry has
    at: Location  # place of the entry
    meshes: tuple[MovingMesh, ...] = ()  # meshes of USD files that they run into
    # USD files that colliders go with, and those of meshes.
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


_OPTIONS = ("solver", "step", "error", "stretch")
_OWN = ("gravity", "radius", "speed_limit", "self_contact", "preroll", "settle")


@dataclass(frozen=True, slots=True, eq=False)
class Shared:
    """How a system of bodies is simulated."""

    options: SpringOptions  # solver and steps
    gravity: FloatArray  # ``(3,)`` [m/s²]
    radius: float  # what is kept from colliders [m]
    speed_limit: float  # pins that go faster were put elsewhere [m/s]
    # How they keep apart from themselves and each other.
    self_contact: SelfContact | None
    preroll: float  # time before 0 s that they begin in [s]
    settle: bool  # whether they begin at rest
    wind: Wind | None  # the air that faces bear; None is none


def shared(setups: Sequence[SpringSetup]) -> Shared:
    """Return what bodies have in common: what any of them states."""
    first = setups[0]
    found = {name: _value(first, name) for name in (*_OPTIONS, *_OWN)}
    for setup in setups:
        found |= {name: _value(setup, name) for name in found if name in setup.given}
    options = {name: found.pop(name) for name in _OPTIONS}
    return Shared(replace(first.options, **options), wind=_faced(setups), **found)


def conflicts(setups: Sequence[SpringSetup]) -> Iterator[tuple[int, str, int]]:
    """Yield what bodies that are joined state differently.

    Yields:
        The body, the key, and the body that states it before.
    """
    meets = any(setup.colliders or setup.characters or setup.meshes for setup in setups)
    for name in (*_OPTIONS, *_OWN, "wind"):
        if name == "radius" and not meets:
            continue
        stating = [i for i, setup in enumerate(setups) if _states(setup, name)]
        for i in stating[1:]:
            one, other = (_value(setups[k], name) for k in (stating[0], i))
            if not _same(one, other):
                yield i, name, stating[0]


def _states(setup: SpringSetup, name: str) -> bool:
    if name == "wind":
        return setup.wind is not None and setup.wind.faces is not None
    return name in setup.given


def _value(setup: SpringSetup, name: str) -> Any:
    return getattr(setup.options if name in _OPTIONS else setup, name)


def _same(one: Any, other: Any) -> bool:
    if isinstance(one, Wind):
        return one.same(other)
    return bool(np.array_equal(one, other))


def _faced(setups: Sequence[SpringSetup]) -> Wind | None:
    winds = [setup.wind for setup in setups if _states(setup, "wind")]
    return winds[0] if winds else None


def check_joins(document: Document, members: Sequence[SceneSystem]) -> None:
    """Note what keeps systems from being one.

    Args:
        document: Where faults are noted.
        members: Those that are joined.
    """
    setups = [cast(SpringSetup, member.setup) for member in members]
    bodies = {
        member.name: setup.body for member, setup in zip(members, setups, strict=True)
    }
    for setup in setups:
        for join in setup.joins:
            for at, fault in _faults(join, bodies[join.system]):
                document.add(fault.code, at, fault.message, fault.hint)
    for i, key, before in conflicts(setups):
        message = f"{key} is another than that of {members[before].name}: they are "
        message += "joined, and simulated as one"
        at = (*setups[i].at, key)
        document.add("SIM054", at, message, "state it once, or twice the same")
    _check_solver(document, setups)


def _check_solver(document: Document, setups: Sequence[SpringSetup]) -> None:
    """Note a solver that does not keep apart what another system wants apart."""
    if not any(setup.self_contact for setup in setups):
        return
    for setup in setups:
        # One that wants it itself has been told.
        if setup.self_contact is None and "solver" in setup.given:
            try:
                check_keeping_apart(Solver(setup.options.solver))
            except OptionError as error:
                fault, at = error.faults[0], (*setup.at, "solver")
                document.add(fault.code, at, fault.message, fault.hint)


def _faults(join: Join, other: SpringBody) -> list[tuple[Location, Fault]]:
    numbers, faults = numbered(join.others, other)
    found = [((*join.at[1], i), fault) for i, fault in faults]
    if not faults and len(numbers) not in {1, len(join.particles)}:
        message = f"{len(join.particles)} particles are joined to {len(numbers)}"
        hint = "name as many, or one for all"
        found.append((join.at[1], Fault("SIM054", message, hint=hint)))
    return found


def join_pairs(
    names: Sequence[str], setups: Sequence[SpringSetup], starts: IntArray
) -> IntArray:
    """Return particles that become one with others, and these ``(J, 2)``.

    Args:
        names: Of the systems that are joined.
        setups: What they are made of.
        starts: Number of the first particle of each among all.
    """
    pairs = [np.zeros((0, 2), np.int64)]
    for setup, start in zip(setups, starts, strict=False):
        for join in setup.joins:
            k = list(names).index(join.system)
            others = np.array(numbered(join.others, setups[k].body)[0])
            two = np.broadcast_arrays(join.particles + start, others + starts[k])
            pairs.append(np.stack(two, axis=1))
    return np.concatenate(pairs)
