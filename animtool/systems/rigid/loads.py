"""Mean forces on bodies over a step, and the number of substeps."""

from __future__ import annotations

import math

import numpy as np

from animtool.core.array_types import BoolArray, FloatArray
from animtool.core.errors import Fault, ToleranceError, excerpt
from animtool.core.quantities import floor_to_two_digits, plain_number
from animtool.core.record import dataclass
from animtool.systems.rigid.bodies import RigidBodies
from animtool.systems.rigid.flight import Flight, free_flight
from animtool.systems.rigid.surroundings import BodyForces

# Largest rotation or oscillation phase in a substep [rad].
MAX_SUBSTEP_ANGLE = 0.5
MAX_SUBSTEPS = 256
# Constrained bodies with a larger mass factor from drag take shorter substeps, so that
# they bounce correctly and keep their mass ratio.
MAX_SUBSTEP_MASS_FACTOR, MAX_CONSTRAINED_SUBSTEPS = 2.0, 64
# Constrained bodies with larger mass factors, in the most substeps, would drift from
# contacts.
MAX_MASS_FACTOR = 64.0
# Smaller relative changes of mass are ignored.
MIN_FACTOR_CHANGE = 1e-3
# Bodies with a larger factor collide at the velocity of their free flight.
UNEXPECTED_CONTACT_FACTOR = 1.25
# Relative velocity difference to the free flight below which a body had no contact [1].
FREE_FLIGHT_TOLERANCE = 1e-6


@dataclass(frozen=True, slots=True)
class StepForces:
    """Mean forces on bodies over a step, and their free flight."""

    forces: FloatArray  # forces [N] and torques [N m] (N, 6)
    # Velocities to start the step with (N, 3) [m/s]; None keeps those of the bodies.
    velocities: FloatArray | None = None
    mass_factors: FloatArray | None = None  # factors on the masses (N,); None is 1
    # Free flight of bodies without contacts; None if forces are constant.
    flight: Flight | None = None

    def unexpected_contacts(
        self, velocities: FloatArray, is_constrained: BoolArray
    ) -> BoolArray:
        """Return a mask of the bodies with unexpected contacts ``(N,)``.

        Only bodies with a large mass factor are considered.
        """
        flight = self.flight
        if flight is None:
            return np.zeros(len(is_constrained), np.bool_)
        differences = np.linalg.norm(velocities - flight.velocities, axis=1)
        start_velocities = velocities if self.velocities is None else self.velocities
        magnitudes = np.linalg.norm(flight.velocities, axis=1)
        magnitudes += np.linalg.norm(start_velocities, axis=1)
        is_heavier = flight.mass_factors >= UNEXPECTED_CONTACT_FACTOR
        is_touched = differences > FREE_FLIGHT_TOLERANCE * magnitudes
        return np.asarray(~is_constrained & is_heavier & is_touched)


def substeps_for_mass_factors(min_count: int, mass_factors: FloatArray) -> int:
    """Return the substep count that the mass factors need, at least ``min_count``."""
    max_factor = float(mass_factors.max(initial=1.0))
    if not max_factor > MAX_SUBSTEP_MASS_FACTOR:
        return min_count
    count = min(
        min_count * max_factor / MAX_SUBSTEP_MASS_FACTOR, MAX_CONSTRAINED_SUBSTEPS
    )
    return max(min_count, math.ceil(count))


class StepForceSolver:
    """Computes the forces and substeps of the bodies of a system."""

    def __init__(self, name: str, bodies: RigidBodies, forces: BodyForces) -> None:
        self._name, self._bodies, self._forces = name, bodies, forces

    def free_flight(
        self, t: float, dt: float, body_states: FloatArray
    ) -> Flight | None:
        """Return the free flight of all bodies; None if forces are constant."""
        if not self._forces.is_variable:
            return None
        push_accelerations = self._forces.push_wrenches(t, dt, body_states)[:, :3]
        push_accelerations /= self._bodies.masses[:, None]

        def acceleration_at(time: float, x: FloatArray, v: FloatArray) -> FloatArray:
            return self._forces.accelerations(time, x, v) + push_accelerations

        x, v = body_states[:, :3], body_states[:, 7:10]
        with np.errstate(all="ignore"):
            return free_flight(acceleration_at, self._forces.jacobians, t, dt, x, v)

    def step_forces(
        self,
        t: float,
        dt: float,
        body_states: FloatArray,
        is_constrained: BoolArray,
        flight: Flight | None,
    ) -> StepForces:
        """Return the forces, start velocities and mass factors for a step.

        ``is_constrained`` is the mask of bodies with contacts or joints ``(N,)``. They
        get the force at the start of the step; a mass factor represents the drag that
        grows as they accelerate. Other bodies get the mean force of their free flight.
        """
        if flight is None:
            with np.errstate(all="ignore"):
                step_forces = StepForces(self._forces.step_wrenches(t, dt, body_states))
        else:
            step_forces = self._flight_forces(
                t, dt, body_states, is_constrained, flight
            )
        self._check_forces(step_forces, t)
        return step_forces

    def _flight_forces(
        self,
        t: float,
        dt: float,
        body_states: FloatArray,
        is_constrained: BoolArray,
        flight: Flight,
    ) -> StepForces:
        """Return the mean forces of a step that reproduce the free flight."""
        x, v = body_states[:, :3], body_states[:, 7:10]
        is_heavier = is_constrained & (flight.mass_factors > 1 + MIN_FACTOR_CHANGE)
        mass_factors = np.where(is_heavier, flight.mass_factors, 1.0)
        forces = self._forces.push_wrenches(t, dt, body_states)
        with np.errstate(all="ignore"):
            # The kernel moves bodies by the mean of both velocities.
            start_velocities = 2 * (flight.points - x) / dt - flight.velocities
            start_velocities = np.where(is_constrained[:, None], v, start_velocities)
            masses = (self._bodies.masses * mass_factors)[:, None]
            forces[:, :3] = masses * (flight.velocities - start_velocities) / dt
        return StepForces(
            forces,
            start_velocities,
            mass_factors if is_heavier.any() else None,
            flight,
        )

    def _check_forces(self, step_forces: StepForces, t: float) -> None:
        """Raise SIM102 if forces are not finite, or not resolved."""
        is_finite = np.isfinite(step_forces.forces).all(axis=1)
        if step_forces.velocities is not None:
            is_finite &= np.isfinite(step_forces.velocities).all(axis=1)
        if not is_finite.all():
            body_index = int(np.argmin(is_finite))
            message = f"the force on {self._body_label(body_index)} is not finite"
            self._stop(t, message, "weaker forces")
        if step_forces.flight is not None and step_forces.flight.is_unresolved.any():
            body_index = int(np.argmax(step_forces.flight.is_unresolved))
            label = self._body_label(body_index)
            message = f"the force on {label} changes too fast to be resolved"
            self._stop(t, message, "use a weaker or smoother force")

    def required_substep_count(
        self, t: float, dt: float, body_states: FloatArray
    ) -> int:
        """Return the substep count that resolves oscillating and spinning bodies."""
        oscillation_rates, spin_rates = self._oscillation_and_spin_rates(
            t, dt, body_states
        )
        max_rate = float(oscillation_rates.max(initial=0.0))
        oscillation_steps = max_rate * dt / MAX_SUBSTEP_ANGLE
        if not oscillation_steps <= MAX_SUBSTEPS:
            body = int(np.argmax(oscillation_rates))
            message = f"the forces on {self._body_label(body)} make it oscillate at "
            message += f"{oscillation_rates[body]:.3g} rad/s, which needs more than "
            message += f"{MAX_SUBSTEPS} substeps in a step of {plain_number(dt)} s"
            hint = "use weaker forces, or more mass"
            if math.isfinite(oscillation_steps):
                step = floor_to_two_digits(dt * MAX_SUBSTEPS / oscillation_steps)
                hint = f"use step: {plain_number(step)}, or {hint}"
            self._stop(t, message, hint)
        rotation_steps = float(spin_rates.max(initial=0.0)) * dt / MAX_SUBSTEP_ANGLE
        rotation_substeps = min(math.ceil(rotation_steps), MAX_SUBSTEPS)
        return max(1, math.ceil(oscillation_steps), rotation_substeps)

    def constrained_substep_count(
        self,
        t: float,
        dt: float,
        substep_count: int,
        body_states: FloatArray,
        is_constrained: BoolArray,
    ) -> int:
        """Return the substep count for bodies constrained by contacts or joints."""
        if not is_constrained.any():
            return substep_count
        substep = dt / substep_count
        flight = self.free_flight(t, substep, body_states)
        assert flight is not None
        mass_factors = np.where(is_constrained, flight.mass_factors, 1.0)
        max_factor = float(mass_factors.max()) * substep_count
        if max_factor > MAX_MASS_FACTOR * MAX_CONSTRAINED_SUBSTEPS:
            body = int(np.argmax(mass_factors))
            message = f"drag on {self._body_label(body)}, which is in "
            message += f"contact, is too strong for a step of {plain_number(dt)} s"
            factor = MAX_MASS_FACTOR * MAX_CONSTRAINED_SUBSTEPS
            step = plain_number(floor_to_two_digits(dt * factor / max_factor))
            self._stop(t, message, f"use step: {step}, or less drag, or more mass")
        return substeps_for_mass_factors(substep_count, mass_factors)

    def _oscillation_and_spin_rates(
        self, t: float, dt: float, body_states: FloatArray
    ) -> FloatArray:
        """Return rates of oscillation, and of spin under pushes ``(2, N)`` [rad/s]."""
        with np.errstate(all="ignore"):
            rates = self._forces.oscillation_rates(t, dt, body_states)
            if self._forces.is_variable:
                x, v = body_states[:, :3], body_states[:, 7:10]
                jacobians = self._forces.jacobians(t, x, v)
                rates[0] = np.maximum(rates[0], _oscillation_rates(*jacobians, dt))
        return rates

    def _body_label(self, body: int) -> str:
        """Return the name of a dynamic body, for messages."""
        return excerpt(self._bodies.names[self._bodies.dynamic_indices[body]])

    def _stop(self, t: float, reason: str, hint: str) -> None:
        """Raise SIM102 with a reason."""
        message = f"{self._name} blew up at {t:g} s: {reason}"
        raise ToleranceError(Fault("SIM102", message, hint=hint))


def _oscillation_rates(
    by_position: FloatArray, by_velocity: FloatArray, dt: float
) -> FloatArray:
    """Return angular frequencies of force Jacobians ``(N,)`` [rad/s]."""
    # An upper bound, so that few need eigenvalues.
    upper_bounds = np.sqrt(np.linalg.norm(by_position, axis=(1, 2)))
    antisymmetric = by_velocity - by_velocity.swapaxes(1, 2)
    upper_bounds += np.linalg.norm(antisymmetric, axis=(1, 2)) / 2
    frequencies = np.zeros(len(by_position))
    is_relevant = upper_bounds * dt > MAX_SUBSTEP_ANGLE
    if is_relevant.any():
        matrices = np.zeros((int(is_relevant.sum()), 6, 6))
        matrices[:, :3, 3:] = np.eye(3)
        matrices[:, 3:, :3] = by_position[is_relevant]
        matrices[:, 3:, 3:] = by_velocity[is_relevant]
        is_finite = np.isfinite(matrices).all(axis=(1, 2))
        angular_frequencies = np.full(len(matrices), np.inf)
        eigenvalues = np.linalg.eigvals(matrices[is_finite])
        angular_frequencies[is_finite] = np.abs(eigenvalues.imag).max(axis=1)
        frequencies[is_relevant] = angular_frequencies
    return frequencies
