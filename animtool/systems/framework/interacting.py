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
from animtool.sim.options import IntegrateOptions, checked_integrator
from animtool.sim.system import Energy, SecondOrder
from animtool.sim.trajectory import Checkpoint, Status
from animtool.systems.framework.colours import Colouring, Quantities, log_density
from animtool.systems.framework.matter import PointMasses
from animtool.systems.framework.simulation import Diagnostics, SimContext, StoppedError

# Relative energy change that counts as divergence [1].
MAX_ENERGY_GROWTH = 0.5


class HasMotion(Protocol):
    """A state with positions and velocities."""

    @property
    def motion(self) -> FloatArray:
        """Positions, then velocities ``(2, N, 3)``."""


InteractionSums = TypeVar("InteractionSums")
State = TypeVar("State", bound=HasMotion)


def integrate_step(
    system: SecondOrder, options: IntegrateOptions, begin: float, duration: float
) -> FloatArray:
    """Integrate a system over a duration [s], and return the final state."""
    start = Checkpoint(begin, system.state)
    trajectory = integrate(system, (begin, begin + duration), options, start)
    if trajectory.stats.status is not Status.OK:
        notices = trajectory.notices
        faults = [replace(fault, severity=Severity.ERROR) for fault in notices]
        raise StoppedError(faults, trajectory.stats)
    return np.asarray(trajectory.states[-1])


class StepSystem(SecondOrder, Generic[InteractionSums]):
    """Interacting bodies during one step as a second-order system, with cached sums.

    Args:
        bodies: The interaction.
        motion: Positions and velocities ``(2, N, 3)``.
        initial_sums: Sums at these positions.
        check: Called with time, positions and sums.
    """

    velocity_dependent = False

    def __init__(
        self,
        bodies: Interacting[Any, InteractionSums],
        motion: FloatArray,
        initial_sums: InteractionSums,
        check: Callable[[float, FloatArray, InteractionSums], None] = lambda *_: None,
    ) -> None:
        self._bodies, self._motion, self._check = bodies, motion, check
        self._cached_sums = motion[0], initial_sums

    @property
    def state(self) -> FloatArray:
        """Initial positions and velocities ``(2, N, 3)``."""
        return self._motion

    def sums_at(self, x: FloatArray) -> InteractionSums:
        """Return the interaction sums at positions ``(N, 3)``, cached."""
        cached_positions, sums = self._cached_sums
        if x is not cached_positions and not np.array_equal(x, cached_positions):
            sums = self._bodies.compute_sums(np.ascontiguousarray(x), sums)
        self._cached_sums = x, sums
        return sums

    def acceleration(self, t: float, x: FloatArray, v: FloatArray) -> FloatArray:  # noqa: ARG002
        """Return accelerations ``(N, 3)``; NaN if a position is not finite."""
        if not np.isfinite(x).all():
            return np.full_like(x, np.nan)
        sums = self.sums_at(x)
        self._check(t, x, sums)
        return self._bodies.accelerations_from(t, x, sums)

    def suspected_cause(self, t: float, state: FloatArray) -> str:  # noqa: ARG002
        """Return why a state is hard to integrate, for messages; may be empty."""
        if not np.isfinite(state).all():
            return ""
        return self._bodies.suspected_cause(state[0], self.sums_at(state[0]))


class Interacting(ABC, Generic[State, InteractionSums]):
    """Base class of simulations of interacting bodies.

    A subclass calls `__init__`, sets the remaining attributes, calls `finish_setup`,
    and defines a step.

    Attributes:
        checked: Whether steps raise if a number is not finite.
        unit: Unit of energies in messages.
        external_forces: External forces with their poses.
        bodies: Initial positions, velocities and masses.
        radii: Displayed radii ``(N,)`` [m].
        species: Entry index of each body ``(N,)``.
        has_many_species: Whether there is more than one entry.
        written_indices: Indices of the bodies in frames ``(M,)``.
        inertia: Divisor from forces to accelerations ``(N, 1)``; None is 1.
        box: Size of the periodic box ``(3,)``; None if space is not periodic.
    """

    checked = True
    unit = "J"
    bodies: PointMasses
    external_forces: Sequence[tuple[Any, Poses]]
    radii: FloatArray
    species: npt.NDArray[np.integer[Any]]
    has_many_species: bool
    written_indices: IntArray
    box: FloatArray | None = None
    inertia: FloatArray | None = None

    def __init__(
        self, spec: Any, context: SimContext, forces_key: str, time_scale: float = 1.0
    ) -> None:
        """Read options; ``time_scale`` is the integrator's time per second.

        ``forces_key`` is the key of external forces in the spec.
        """
        self._spec, self._begin, self._time_scale = spec, context.begin, time_scale
        poses = [
            force_data["poses"] for force_data in context.entry_data.get(forces_key, ())
        ]
        self.external_forces = list(zip(getattr(spec, forces_key), poses, strict=True))
        tolerance = getattr(spec, "tolerance", None)
        self._options = IntegrateOptions(spec.method, spec.step * time_scale, tolerance)
        self._integrator = checked_integrator(self._options)
        self._colouring: Colouring | None = None

    def finish_setup(self) -> None:
        """Check that the method fits; set colour ranges from the first state."""
        state = self.initial_state()
        check_supported(Equations(self._system(state)), self._integrator)
        if self._spec.colour is not None:
            quantities = self._quantities(state, self._begin)
            self._colouring = Colouring.from_model(self._spec.colour, quantities)

    @abstractmethod
    def _build_initial_state(self, motion: FloatArray) -> State:
        """Build the initial state from positions and velocities ``(2, N, 3)``."""

    @abstractmethod
    def _state_sums(self, state: State) -> InteractionSums:
        """Return the interaction sums stored in a state."""

    @abstractmethod
    def compute_sums(
        self, x: FloatArray, last_sums: InteractionSums
    ) -> InteractionSums:
        """Return interaction sums at positions ``(N, 3)``, given the previous sums."""

    @abstractmethod
    def _forces(self, sums: InteractionSums) -> FloatArray:
        """Return forces from sums ``(N, 3)``, to be divided by `inertia`."""

    def accelerations_from(
        self, t: float, x: FloatArray, sums: InteractionSums
    ) -> FloatArray:
        """Return total accelerations ``(N, 3)`` at a time in integrator units."""
        forces = self._forces(sums)
        if self.external_forces:
            forces = forces + self.external_accelerations(t / self._time_scale, x)[0]
        return np.asarray(forces if self.inertia is None else forces / self.inertia)

    @abstractmethod
    def external_effect(
        self, force: Any, position: FloatArray, x: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Return accelerations ``(N, 3)`` and energies ``(N,)`` by an external force.

        The position of the force is ``(3,)``; positions of bodies are ``x`` ``(N, 3)``.
        """

    def suspected_cause(self, x: FloatArray, sums: InteractionSums) -> str:  # noqa: ARG002
        """Return why positions are hard to integrate, as text; may be empty."""
        return ""

    @abstractmethod
    def _potential(self, state: State, t: float) -> float:
        """Return the potential energy of a state."""

    @abstractmethod
    def _report_values(self, state: State, t: float) -> Mapping[str, float]:
        """Return the values of a state for the report, by name."""

    def _exchanged_energy(self, state: State, energy: Energy) -> float:  # noqa: ARG002
        """Return the magnitude of energy exchanged with heat baths."""
        return abs(self._bath_energy(state))

    @abstractmethod
    def _suggested_step(self, state: State, t: float) -> float:
        """Return the shorter step that an error message suggests [s]."""

    def _bath_energy(self, state: State) -> float:  # noqa: ARG002
        """Return the total energy added by a heat bath up to a state."""
        return 0.0

    @cached_property
    def _initial_state(self) -> State:
        return self._build_initial_state(
            np.stack([self.bodies.points, self.bodies.velocities])
        )

    def _system(
        self,
        state: State,
        check: Callable[[float, FloatArray, InteractionSums], None] = lambda *_: None,
    ) -> StepSystem[InteractionSums]:
        """Return the second-order system that integrates one step from a state."""
        return StepSystem(self, state.motion, self._state_sums(state), check)

    @cached_property
    def _is_driven(self) -> bool:
        """Whether an external force moves, and may supply energy."""
        return any(force.moves or force.prim for force, _ in self.external_forces)

    def external_accelerations(
        self, t: float, x: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Return external accelerations ``(N, 3)`` and energies ``(N,)`` at a time."""
        accelerations, energies = np.zeros_like(x), np.zeros(len(x))
        for force, poses in self.external_forces:
            acceleration, energy = self.external_effect(force, poses.at(t)[:3], x)
            accelerations += acceleration
            energies += energy
        return accelerations, energies

    def initial_state(self) -> State:
        """Return the bodies at the start, with the sums at their positions."""
        return self._initial_state

    def _integrate(
        self, system: StepSystem[InteractionSums], t: float, dt: float, step: float
    ) -> FloatArray:
        """Return the motion after a duration [s], in steps [s] of the integrator."""
        time_scale = self._time_scale
        options = replace(self._options, step=step * time_scale)
        return integrate_step(system, options, t * time_scale, dt * time_scale)

    def _check_energy(self, state: State, t: float) -> None:
        """Raise SIM102 if energy is not conserved."""
        initial, energy = self._initial_energy, self._energy(state, t)
        exchanged_energy = self._exchanged_energy(state, energy)
        energy_scale = max(initial.kinetic, abs(initial.potential), exchanged_energy)
        has_supply = self._is_driven or not energy_scale
        gain = abs(self._energy_gain(state, energy))
        if not has_supply and not gain <= MAX_ENERGY_GROWTH * energy_scale:
            message = f"its energy changed to {energy.total:.4g} {self.unit}, from "
            self._stop(state, t, f"{message}{initial.total:.4g} {self.unit}")

    def _stop(self, state: State, t: float, reason: str) -> None:
        """Raise SIM102 with a reason and a suggested step."""
        message = f"{self._spec.name} blew up at {t:g} s: {reason}"
        step = min(self._suggested_step(state, t), self._spec.step / 4)
        raise StoppedError([Fault("SIM102", message, hint=f"use step: {step:.2g}")])

    def _kinetic_energy(self, motion: FloatArray) -> float:
        return 0.5 * float(self.bodies.masses @ (motion[1] ** 2).sum(axis=1))

    def _energy(self, state: State, t: float) -> Energy:
        return Energy(self._kinetic_energy(state.motion), self._potential(state, t))

    @cached_property
    def _initial_energy(self) -> Energy:
        return self._energy(self._initial_state, self._begin)

    def _energy_gain(self, state: State, energy: Energy) -> float:
        """Return the energy gain since the start, excluding energy from heat baths."""
        return energy.total - self._bath_energy(state) - self._initial_energy.total

    def _energy_drift(self, state: State, energy: Energy) -> float:
        """Return the energy gain relative to the initial energy [1]."""
        initial = self._initial_energy
        energy_scale = max(abs(initial.total), initial.kinetic, 1e-300)
        return self._energy_gain(state, energy) / energy_scale

    def _to_scene(self, motion: FloatArray) -> FloatArray:
        """Return positions [m] and velocities [m/s] in the scene ``(2, N, 3)``."""
        return motion

    @np.errstate(all="ignore")
    def frame(self, state: State, t: float) -> PointsFrame:
        """Return the frame of the written bodies."""
        written_indices = self.written_indices
        points, velocities = self._to_scene(state.motion)[:, written_indices]
        primvars: dict[str, Any] = {}
        if self.has_many_species:
            primvars["species"] = self.species[written_indices]
        if self._colouring is not None:
            colours = self._colouring.colours(self._quantities(state, t))
            primvars["displayColor"] = colours[written_indices]
        return PointsFrame(
            written_indices, points, velocities, self.radii[written_indices], primvars
        )

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
        """Return the finite report values of a state, by name."""
        values = self._report_values(state, t)
        return {key: value for key, value in values.items() if math.isfinite(value)}

    @np.errstate(all="ignore")
    def diagnostics(self, state: State, t: float) -> Diagnostics:
        """Return report values, and the energy if it is conserved."""
        energy = self._energy(state, t)
        potential = energy.potential - self._bath_energy(state)
        conserved_energy = None
        if not self._is_driven:
            conserved_energy = replace(energy, potential=potential)
        return Diagnostics(conserved_energy, self.values(state, t))
