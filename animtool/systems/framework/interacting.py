"""Base of simulations of interacting bodies by integrators."""

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
from animtool.sim.checks import check_supported
from animtool.sim.colliders import Poses
from animtool.sim.equations import Equations
from animtool.sim.integrating import integrate
from animtool.sim.options import IntegrateOptions, check_options
from animtool.sim.system import Energy, SecondOrder
from animtool.sim.trajectory import Checkpoint, Status
from animtool.systems.framework.colours import Colouring, Quantities, log_density
from animtool.systems.framework.matter import PointMasses
from animtool.systems.framework.simulation import Diagnostics, SimContext, StoppedError

# Relative energy change that counts as blow-up.
GROWTH = 0.5


class HasMotion(Protocol):
    """A state with positions and velocities."""

    @property
    def motion(self) -> FloatArray:
        """Positions, then velocities ``(2, N, 3)``."""


Sums = TypeVar("Sums")
State = TypeVar("State", bound=HasMotion)


def integrated(
    system: SecondOrder, options: IntegrateOptions, begin: float, lasts: float
) -> FloatArray:
    """Integrate a system over a duration [s] and return its final state.

    Raises:
        StoppedError: It blew up (SIM102), or the method failed (SIM103 to SIM105).
    """
    start = Checkpoint(begin, system.state)
    trajectory = integrate(system, (begin, begin + lasts), options, start)
    if trajectory.stats.status is not Status.OK:
        faults = [replace(one, severity=Severity.ERROR) for one in trajectory.notices]
        raise StoppedError(faults, trajectory.stats)
    return np.asarray(trajectory.states[-1])


class StepSystem(SecondOrder, Generic[Sums]):
    """Bodies for one step, with cached sums at the last positions.

    Args:
        bodies: The interaction.
        motion: Positions and velocities ``(2, N, 3)``.
        known: Sums at these positions.
        check: Called with time, positions and sums.
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
        """Initial state."""
        return self._motion

    def at(self, x: FloatArray) -> Sums:
        """Return the sums at positions ``(N, 3)``, cached."""
        known, sums = self._known
        if x is not known and not np.array_equal(x, known):
            sums = self._bodies.summed(np.ascontiguousarray(x), sums)
        self._known = x, sums
        return sums

    def acceleration(self, t: float, x: FloatArray, v: FloatArray) -> FloatArray:  # noqa: ARG002
        """Return accelerations ``(N, 3)``; NaN if a position is not finite."""
        if not np.isfinite(x).all():
            return np.full_like(x, np.nan)
        sums = self.at(x)
        self._check(t, x, sums)
        return self._bodies.accelerated(t, x, sums)

    def suspect(self, t: float, state: FloatArray) -> str:  # noqa: ARG002
        """Return what makes a state hard to integrate."""
        if not np.isfinite(state).all():
            return ""
        return self._bodies.suspect(state[0], self.at(state[0]))


class Interacting(ABC, Generic[State, Sums]):
    """Base class of simulations of interacting bodies.

    A subclass calls `__init__`, sets the remaining attributes, calls `begin`, and
    defines a step.

    Attributes:
        checked: Steps check that numbers stay finite.
        unit: Unit of energies in messages.
        placed: External forces with their poses.
        bodies: Initial positions, velocities and masses.
        radii: Drawn radii ``(N,)`` [m].
        species: Entry index of each body ``(N,)``.
        several: Whether there are several entries.
        shown: Written bodies ``(M,)``.
        inertia: Accelerations are forces over this ``(N, 1)``; None is 1.
        box: Size of the periodic box ``(3,)``; None without.
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
        """``placed``: key of external forces; ``pace``: integrator time per second."""
        self._spec, self._begin, self._pace = spec, context.begin, pace
        poses = [parts["poses"] for parts in context.parts.get(placed, ())]
        self.placed = list(zip(getattr(spec, placed), poses, strict=True))
        tolerance = getattr(spec, "tolerance", None)
        self._options = IntegrateOptions(spec.method, spec.step * pace, tolerance)
        self._integrator = check_options(self._options)
        self._colouring: Colouring | None = None

    def begin(self) -> None:
        """Check the method, and set colour ranges from the first state."""
        first = self.initial()
        check_supported(Equations(self._system(first)), self._integrator)
        if self._spec.colour is not None:
            quantities = self._quantities(first, self._begin)
            self._colouring = Colouring.of(self._spec.colour, quantities)

    @abstractmethod
    def _start(self, motion: FloatArray) -> State:
        """Return the initial state, from the motion of `bodies`."""

    @abstractmethod
    def _sums(self, state: State) -> Sums:
        """Return the sums of a state."""

    @abstractmethod
    def summed(self, x: FloatArray, before: Sums) -> Sums:
        """Return interaction sums at positions ``(N, 3)``; ``before`` are the last."""

    @abstractmethod
    def _forces(self, sums: Sums) -> FloatArray:
        """Return forces from sums ``(N, 3)``, to be divided by `inertia`."""

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
        """Return acceleration and energy from one of `placed` at ``(3,)``."""

    def suspect(self, x: FloatArray, sums: Sums) -> str:  # noqa: ARG002
        """Return what makes positions hard to integrate; may be empty."""
        return ""

    @abstractmethod
    def _potential(self, state: State, t: float) -> float:
        """Return their potential energy."""

    @abstractmethod
    def _values(self, state: State, t: float) -> Mapping[str, float]:
        """Return reported values."""

    def _in_play(self, state: State, now: Energy) -> float:  # noqa: ARG002
        """Return energy exchanged in addition to the initial energy."""
        return abs(self._bath_energy(state))

    @abstractmethod
    def _advised(self, state: State, t: float) -> float:
        """Return an advised step [s]."""

    def _bath_energy(self, state: State) -> float:  # noqa: ARG002
        """Return the energy added by a heat bath so far."""
        return 0.0

    @cached_property
    def _first(self) -> State:
        return self._start(np.stack([self.bodies.points, self.bodies.velocities]))

    def _system(
        self,
        state: State,
        check: Callable[[float, FloatArray, Sums], None] = lambda *_: None,
    ) -> StepSystem[Sums]:
        """Return the system of one step from a state."""
        return StepSystem(self, state.motion, self._sums(state), check)

    @cached_property
    def _moves(self) -> bool:
        """Whether an external force moves, and so may supply energy."""
        return any(one.moves or one.prim for one, _ in self.placed)

    def outside(self, t: float, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return external accelerations ``(N, 3)`` and energies ``(N,)`` at a time."""
        accelerations, energies = np.zeros_like(x), np.zeros(len(x))
        for one, poses in self.placed:
            pull, energy = self.from_placed(one, poses.at(t)[:3], x)
            accelerations += pull
            energies += energy
        return accelerations, energies

    def initial(self) -> State:
        """Return the initial state."""
        return self._first

    def _integrated(
        self, system: StepSystem[Sums], t: float, dt: float, step: float
    ) -> FloatArray:
        """Return the motion after a duration, in steps [s], as `integrated`."""
        options = replace(self._options, step=step * self._pace)
        return integrated(system, options, t * self._pace, dt * self._pace)

    def _watch(self, state: State, t: float) -> None:
        """Stop if energy is not conserved (SIM102)."""
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
        """Return the unexplained energy gain."""
        return now.total - self._bath_energy(state) - self._begun.total

    def _drift(self, state: State, now: Energy) -> float:
        """Return the unexplained gain relative to the initial energy [1]."""
        scale = max(abs(self._begun.total), self._begun.kinetic, 1e-300)
        return self._gained(state, now) / scale

    def _placed(self, motion: FloatArray) -> FloatArray:
        """Return positions [m] and velocities [m/s] in the scene ``(2, N, 3)``."""
        return motion

    @np.errstate(all="ignore")
    def frame(self, state: State, t: float) -> PointsFrame:
        """Return the frame of the shown bodies."""
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
        """Return reported values that are finite."""
        values = self._values(state, t)
        return {key: one for key, one in values.items() if math.isfinite(one)}

    @np.errstate(all="ignore")
    def diagnostics(self, state: State, t: float) -> Diagnostics:
        """Return reported values, and the conserved energy."""
        now = self._energy(state, t)
        kept = replace(now, potential=now.potential - self._bath_energy(state))
        return Diagnostics(None if self._moves else kept, self.values(state, t))
