"""Bodies that act on each other: what their simulations by integrators share."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from typing import Any, Generic, Protocol, TypeVar

import numpy as np
import numpy.typing as npt

from animtool.core.array_types import FloatArray, IntArray
from animtool.core.errors import Fault, Severity
from animtool.motion.frames import PointsFrame
from animtool.sim.checks import check_fit
from animtool.sim.colliders import Poses
from animtool.sim.equations import Equations
from animtool.sim.integrating import integrate
from animtool.sim.options import IntegrateOptions, check_options
from animtool.sim.system import Energy, SecondOrder
from animtool.sim.trajectory import Checkpoint, Status
from animtool.systems.framework.colours import Colouring, Quantities, log_density
from animtool.systems.framework.matter import PointMasses
from animtool.systems.framework.simulation import Diagnostics, SimContext, StoppedError

# Energy gained or lost, in what there was of either kind, from which on it blew up.
GROWTH = 0.5


class HasMotion(Protocol):
    """A state of bodies."""

    @property
    def motion(self) -> FloatArray:
        """Positions, then velocities ``(2, N, 3)``."""


Sums = TypeVar("Sums")
State = TypeVar("State", bound=HasMotion)


def integrated(
    system: SecondOrder, options: IntegrateOptions, begin: float, lasts: float
) -> FloatArray:
    """Return the state of a system after a time, from its own at a beginning [s].

    Raises:
        StoppedError: It blew up (SIM102), or the method could not go on (SIM103 to
            SIM105).
    """
    start = Checkpoint(begin, system.state)
    trajectory = integrate(system, (begin, begin + lasts), options, start)
    if trajectory.stats.status is not Status.OK:
        faults = [replace(one, severity=Severity.ERROR) for one in trajectory.notices]
        raise StoppedError(faults, trajectory.stats)
    return np.asarray(trajectory.states[-1])


class StepSystem(SecondOrder, Generic[Sums]):
    """Bodies for one step; what was summed last at their places is not summed again.

    Args:
        bodies: How they act on each other.
        motion: Where they are, and how fast ``(2, N, 3)``.
        known: What is summed there.
        check: Called with times, places and what is summed there.
    """

    velocity_dependent = False

    def __init__(
        self,
        bodies: Interacting[Any, Sums],
        motion: FloatArray,
        known: Sums,
        check: Callable[[float, FloatArray, Sums], None] = lambda *_: None,
    ) -> None:
        self._bodies, self._motion, self._check = bodies, motion, check
        self._known = motion[0], known

    @property
    def state(self) -> FloatArray:
        """Where they start."""
        return self._motion

    def at(self, x: FloatArray) -> Sums:
        """Return what there is at places ``(N, 3)``."""
        known, sums = self._known
        if x is not known and not np.array_equal(x, known):
            sums = self._bodies.summed(np.ascontiguousarray(x), sums)
        self._known = x, sums
        return sums

    def acceleration(self, t: float, x: FloatArray, v: FloatArray) -> FloatArray:  # noqa: ARG002
        """Return accelerations ``(N, 3)``; NaN where a place is not finite."""
        if not np.isfinite(x).all():
            return np.full_like(x, np.nan)
        sums = self.at(x)
        self._check(t, x, sums)
        return self._bodies.accelerated(t, x, sums)

    def suspect(self, t: float, state: FloatArray) -> str:  # noqa: ARG002
        """Return what makes a state hard to go on from."""
        if not np.isfinite(state).all():
            return ""
        return self._bodies.suspect(state[0], self.at(state[0]))


class Interacting(ABC, Generic[State, Sums]):
    """Bodies that act on each other, as a simulation.

    A kind checks its method as `__init__` does, sets what is not set here, calls
    `begin`, and says what a step is.

    Attributes:
        checked: Its steps see to it that numbers stay finite.
        unit: Of energies, for messages.
        placed: What else acts on them, from where it is put.
        bodies: Where they begin, how fast, and their masses.
        radii: Half the widths that they are drawn with ``(N,)`` [m].
        species: The number of the entry that each is of ``(N,)``.
        several: Whether there are more entries than one.
        shown: Which are written ``(M,)``.
        inertia: Accelerations are forces over this ``(N, 1)``; None is 1.
        box: Sides within which places repeat ``(3,)``; None where they do not.
    """

    checked = True
    unit = "J"
    bodies: PointMasses
    placed: Sequence[tuple[Any, Poses]]
    radii: FloatArray
    species: npt.NDArray[np.integer[Any]]
    several: bool
    shown: IntArray
    box: FloatArray | None = None
    inertia: FloatArray | None = None

    def __init__(
        self, spec: Any, context: SimContext, placed: str, pace: float = 1.0
    ) -> None:
        """``placed``: its key; ``pace``: time of the integrator in a second."""
        self._spec, self._begin, self._pace = spec, context.begin, pace
        poses = [parts["poses"] for parts in context.parts.get(placed, ())]
        self.placed = list(zip(getattr(spec, placed), poses, strict=True))
        tolerance = getattr(spec, "tolerance", None)
        self._options = IntegrateOptions(spec.method, spec.step * pace, tolerance)
        self._integrator = check_options(self._options)
        self._colouring: Colouring | None = None

    def begin(self) -> None:
        """Check that the method fits, and choose colours by the first state."""
        first = self.initial()
        check_fit(Equations(self._system(first)), self._integrator)
        if self._spec.colour is not None:
            quantities = self._quantities(first, self._begin)
            self._colouring = Colouring.of(self._spec.colour, quantities)

    @abstractmethod
    def _start(self, motion: FloatArray) -> State:
        """Return where all begin, from the motion of `bodies`."""

    @abstractmethod
    def _sums(self, state: State) -> Sums:
        """Return what is summed in a state."""

    @abstractmethod
    def summed(self, x: FloatArray, before: Sums) -> Sums:
        """Return what bodies at places ``(N, 3)`` do; ``before`` is what they did."""

    @abstractmethod
    def _forces(self, sums: Sums) -> FloatArray:
        """Return of what is summed the forces ``(N, 3)``, over `inertia`."""

    def accelerated(self, t: float, x: FloatArray, sums: Sums) -> FloatArray:
        """Return accelerations ``(N, 3)`` at a time of the integrator."""
        forces = self._forces(sums)
        if self.placed:
            forces = forces + self.outside(t / self._pace, x)[0]
        return np.asarray(forces if self.inertia is None else forces / self.inertia)

    @abstractmethod
    def from_placed(
        self, one: Any, at: FloatArray, x: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Return what one of `placed` at ``(3,)`` does to bodies: see `outside`."""

    def suspect(self, x: FloatArray, sums: Sums) -> str:  # noqa: ARG002
        """Return what makes places hard to go on from; may be empty."""
        return ""

    @abstractmethod
    def _potential(self, state: State, t: float) -> float:
        """Return their potential energy."""

    @abstractmethod
    def _values(self, state: State, t: float) -> Mapping[str, float]:
        """Return what is reported."""

    def _in_play(self, state: State, now: Energy) -> float:  # noqa: ARG002
        """Return the energy that may come and go, beside that of the beginning."""
        return abs(self._bath_energy(state))

    @abstractmethod
    def _advised(self, state: State, t: float) -> float:
        """Return a step that is short enough [s]."""

    def _bath_energy(self, state: State) -> float:  # noqa: ARG002
        """Return the energy that a bath gave so far."""
        return 0.0

    @cached_property
    def _first(self) -> State:
        return self._start(np.stack([self.bodies.points, self.bodies.velocities]))

    def _system(
        self,
        state: State,
        check: Callable[[float, FloatArray, Sums], None] = lambda *_: None,
    ) -> StepSystem[Sums]:
        """Return bodies for a step from a state."""
        return StepSystem(self, state.motion, self._sums(state), check)

    @cached_property
    def _moves(self) -> bool:
        """Whether anything placed moves, and so may bring energy in."""
        return any(one.moves or one.prim for one, _ in self.placed)

    def outside(self, t: float, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return what is placed does at a time ``(N, 3)``, and energies ``(N,)``."""
        accelerations, energies = np.zeros_like(x), np.zeros(len(x))
        for one, poses in self.placed:
            pull, energy = self.from_placed(one, poses.at(t)[:3], x)
            accelerations += pull
            energies += energy
        return accelerations, energies

    def initial(self) -> State:
        """Return where all begin."""
        return self._first

    def _integrated(
        self, system: StepSystem[Sums], t: float, dt: float, step: float
    ) -> FloatArray:
        """Return the motion after a time, in steps [s], as `integrated`."""
        options = replace(self._options, step=step * self._pace)
        return integrated(system, options, t * self._pace, dt * self._pace)

    def _watch(self, state: State, t: float) -> None:
        """Stop where energy appears from nowhere (SIM102)."""
        begin, now = self._begun, self._energy(state, t)
        scale = max(begin.kinetic, abs(begin.potential), self._in_play(state, now))
        supplied = self._moves or not scale
        if not supplied and not abs(self._gained(state, now)) <= GROWTH * scale:
            message = f"its energy changed to {now.total:.4g} {self.unit}, from "
            self._stop(state, t, f"{message}{begin.total:.4g} {self.unit}")

    def _stop(self, state: State, t: float, reason: str) -> None:
        message = f"{self._spec.name} blew up at {t:g} s: {reason}"
        step = min(self._advised(state, t), self._spec.step / 4)
        raise StoppedError([Fault("SIM102", message, hint=f"use step: {step:.2g}")])

    def _kinetic(self, motion: FloatArray) -> float:
        return 0.5 * float(self.bodies.masses @ (motion[1] ** 2).sum(axis=1))

    def _energy(self, state: State, t: float) -> Energy:
        return Energy(self._kinetic(state.motion), self._potential(state, t))

    @cached_property
    def _begun(self) -> Energy:
        return self._energy(self._first, self._begin)

    def _gained(self, state: State, now: Energy) -> float:
        """Return the energy that came from nowhere."""
        return now.total - self._bath_energy(state) - self._begun.total

    def _drift(self, state: State, now: Energy) -> float:
        """Return that over what there was at the beginning [1]."""
        scale = max(abs(self._begun.total), self._begun.kinetic, 1e-300)
        return self._gained(state, now) / scale

    def _placed(self, motion: FloatArray) -> FloatArray:
        """Return positions [m] and velocities [m/s] in the scene ``(2, N, 3)``."""
        return motion

    @np.errstate(all="ignore")
    def frame(self, state: State, t: float) -> PointsFrame:
        """Return the bodies that are shown."""
        shown = self.shown
        points, velocities = self._placed(state.motion)[:, shown]
        primvars: dict[str, Any] = {}
        if self.several:
            primvars["species"] = self.species[shown]
        if self._colouring is not None:
            colours = self._colouring.colours(self._quantities(state, t))
            primvars["displayColor"] = colours[shown]
        return PointsFrame(shown, points, velocities, self.radii[shown], primvars)

    def _quantities(self, state: State, t: float) -> Quantities:  # noqa: ARG002
        (x, v), box = state.motion, self.box
        if box is not None:
            x = x % box % box
        return {
            "speed": lambda: np.linalg.norm(v, axis=1),
            "density": lambda: log_density(x, self.bodies.masses, box),
            "species": lambda: self.species,
        }

    @np.errstate(all="ignore")
    def values(self, state: State, t: float) -> Mapping[str, float]:
        """Return what is reported, as far as it is finite."""
        values = self._values(state, t)
        return {key: one for key, one in values.items() if math.isfinite(one)}

    @np.errstate(all="ignore")
    def diagnostics(self, state: State, t: float) -> Diagnostics:
        """Return what is reported, and the energy that ought to stay."""
        now = self._energy(state, t)
        kept = replace(now, potential=now.potential - self._bath_energy(state))
        return Diagnostics(None if self._moves else kept, self.values(state, t))
