"""Mean forces on bodies in a step, and the number of substeps."""

from __future__ import annotations

import math

import numpy as np

from animtool.core.array_types import BoolArray, FloatArray
from animtool.core.errors import Fault, ToleranceError, excerpt
from animtool.core.quantities import floor_to_two_digits, plain_number
from animtool.core.record import dataclass
from animtool.systems.rigid.bodies import RigidBodies
from animtool.systems.rigid.flight import Flight, fly
from animtool.systems.rigid.surroundings import BodyForces

# Largest rotation or phase of a swing in a substep [rad].
MAX_SUBSTEP_ANGLE = 0.5
MAX_SUBSTEPS = 256
# Constrained bodies with a larger inertia factor from drag take shorter substeps, so
# that they bounce right and keep their inertia ratio.
MAX_INERTIA_RATIO, MAX_CONSTRAINED_SUBSTEPS = 2.0, 64
# Constrained bodies with larger factors at the most substeps would drift from contacts.
MAX_INERTIA_FACTOR = 64.0
# Smaller relative changes of mass are ignored.
MIN_FACTOR_CHANGE = 1e-3
# Bodies with a larger factor collide at the velocity of their free flight.
UNEXPECTED_CONTACT_FACTOR = 1.25
# Relative velocity difference below which a body had no contact.
FREE_FLIGHT_TOLERANCE = 1e-6


@dataclass(frozen=True, slots=True)
class StepForces:
    """Mean forces on bodies over a step, and their free flight.

    Attributes:
        forces: Forces [N] and torques [N m] ``(N, 6)``.
        velocities: Velocities that bodies start with ``(N, 3)`` [m/s]; None keeps
            theirs.
        inertias: Factors on their masses ``(N,)``; None is 1.
        flight: Free flight of bodies without contacts; None if forces are constant.
    """

    forces: FloatArray
    velocities: FloatArray | None = None
    inertias: FloatArray | None = None
    flight: Flight | None = None

    def unexpected_contacts(
        self, velocities: FloatArray, constrained: BoolArray
    ) -> BoolArray:
        """Return bodies with contacts that were not expected ``(N,)``.

        Only bodies whose mass factor is large are considered.
        """
        flight = self.flight
        if flight is None:
            return np.zeros(len(constrained), np.bool_)
        differences = np.linalg.norm(velocities - flight.velocities, axis=1)
        initial = velocities if self.velocities is None else self.velocities
        magnitudes = np.linalg.norm(flight.velocities, axis=1) + np.linalg.norm(
            initial, axis=1
        )
        return np.asarray(
            ~constrained
            & (flight.inertias >= UNEXPECTED_CONTACT_FACTOR)
            & (differences > FREE_FLIGHT_TOLERANCE * magnitudes)
        )

    def parts(self, parts: int, constrained: BoolArray) -> int:
        """Return the substeps needed to repeat a step."""
        assert self.flight is not None
        return substeps_for_inertias(parts, self.flight.inertias[constrained])


def substeps_for_inertias(parts: int, inertias: FloatArray) -> int:
    """Return the number of substeps for inertia factors, at least ``parts``."""
    max_factor = float(inertias.max(initial=1.0))
    if not max_factor > MAX_INERTIA_RATIO:
        return parts
    return max(
        parts,
        math.ceil(
            min(parts * max_factor / MAX_INERTIA_RATIO, MAX_CONSTRAINED_SUBSTEPS)
        ),
    )


class BodyLoads:
    """Computes step forces for the bodies of a system."""

    def __init__(self, name: str, bodies: RigidBodies, forces: BodyForces) -> None:
        self._name, self._bodies, self._forces = name, bodies, forces

    def fly(self, t: float, dt: float, motion: FloatArray) -> Flight | None:
        """Return the free flight of bodies; None under constant forces."""
        if not self._forces.vary:
            return None
        constant = self._forces.push_wrenches(t, dt, motion)[:, :3]
        constant /= self._bodies.masses[:, None]

        def rate(time: float, x: FloatArray, v: FloatArray) -> FloatArray:
            return self._forces.accelerations(time, x, v) + constant

        x, v = motion[:, :3], motion[:, 7:10]
        with np.errstate(all="ignore"):
            return fly(rate, self._forces.slopes, t, dt, x, v)

    def over(
        self,
        t: float,
        dt: float,
        motion: FloatArray,
        constrained: BoolArray,
        flight: Flight | None,
    ) -> StepForces:
        """Return the forces of a step.

        Bodies ``constrained`` ``(N,)`` by contacts or joints get the initial force and
        a larger mass, as the force would decrease with their velocity. Others get the
        mean force of their free flight.
        """
        if flight is None:
            with np.errstate(all="ignore"):
                loads = StepForces(self._forces.over(t, dt, motion))
        else:
            loads = self._flight_forces(t, dt, motion, constrained, flight)
        self._check(loads, t)
        return loads

    def _flight_forces(
        self,
        t: float,
        dt: float,
        motion: FloatArray,
        constrained: BoolArray,
        flight: Flight,
    ) -> StepForces:
        x, v = motion[:, :3], motion[:, 7:10]
        is_heavier = constrained & (flight.inertias > 1 + MIN_FACTOR_CHANGE)
        inertias = np.where(is_heavier, flight.inertias, 1.0)
        forces = self._forces.push_wrenches(t, dt, motion)
        with np.errstate(all="ignore"):
            # The kernel moves bodies by the mean of both velocities.
            start_velocities = 2 * (flight.points - x) / dt - flight.velocities
            start_velocities = np.where(constrained[:, None], v, start_velocities)
            masses = (self._bodies.masses * inertias)[:, None]
            forces[:, :3] = masses * (flight.velocities - start_velocities) / dt
        return StepForces(
            forces, start_velocities, inertias if is_heavier.any() else None, flight
        )

    def _check(self, loads: StepForces, t: float) -> None:
        finite = np.isfinite(loads.forces).all(axis=1)
        if loads.velocities is not None:
            finite &= np.isfinite(loads.velocities).all(axis=1)
        if not finite.all():
            number = int(np.argmin(finite))
            message = f"the force on {self._body(number)} is not finite"
            self._stop(t, message, "weaker forces")
        if loads.flight is not None and loads.flight.coarse.any():
            number = int(np.argmax(loads.flight.coarse))
            message = f"the force on {self._body(number)} changes too fast to be "
            message += "resolved"
            self._stop(t, message, "use a weaker or smoother force")

    def parts(self, t: float, dt: float, motion: FloatArray) -> int:
        """Return the substeps that resolve swinging bodies."""
        swings, spins = self._rates(t, dt, motion)
        oscillation_steps = float(swings.max(initial=0.0)) * dt / MAX_SUBSTEP_ANGLE
        if not oscillation_steps <= MAX_SUBSTEPS:
            number = int(np.argmax(swings))
            message = f"the forces on {self._body(number)} make it oscillate at "
            message += f"{swings[number]:.3g} rad/s, which needs more than "
            message += f"{MAX_SUBSTEPS} substeps in a step of {plain_number(dt)} s"
            hint = "use weaker forces, or more mass"
            if math.isfinite(oscillation_steps):
                step = floor_to_two_digits(dt * MAX_SUBSTEPS / oscillation_steps)
                hint = f"use step: {plain_number(step)}, or {hint}"
            self._stop(t, message, hint)
        rotation_steps = float(spins.max(initial=0.0)) * dt / MAX_SUBSTEP_ANGLE
        return max(
            1,
            math.ceil(oscillation_steps),
            min(math.ceil(rotation_steps), MAX_SUBSTEPS),
        )

    def constrained_substeps(
        self,
        t: float,
        dt: float,
        parts: int,
        motion: FloatArray,
        constrained: BoolArray,
    ) -> int:
        """Return the substeps for constrained bodies ``(N,)``."""
        if not constrained.any():
            return parts
        substep = dt / parts
        flight = self.fly(t, substep, motion)
        assert flight is not None
        inertias = np.where(constrained, flight.inertias, 1.0)
        max_factor = float(inertias.max()) * parts
        if max_factor > MAX_INERTIA_FACTOR * MAX_CONSTRAINED_SUBSTEPS:
            message = f"drag on {self._body(int(np.argmax(inertias)))}, which is in "
            message += f"contact, is too strong for a step of {plain_number(dt)} s"
            step = floor_to_two_digits(
                dt * MAX_INERTIA_FACTOR * MAX_CONSTRAINED_SUBSTEPS / max_factor
            )
            self._stop(
                t,
                message,
                f"use step: {plain_number(step)}, or less drag, or more mass",
            )
        return substeps_for_inertias(parts, inertias)

    def _rates(self, t: float, dt: float, motion: FloatArray) -> FloatArray:
        """Return rates of oscillation, and of spin under pushes ``(2, N)`` [rad/s]."""
        with np.errstate(all="ignore"):
            rates = self._forces.oscillation_rates(t, dt, motion)
            if self._forces.vary:
                x, v = motion[:, :3], motion[:, 7:10]
                swings = _oscillation_rates(*self._forces.slopes(t, x, v), dt)
                rates[0] = np.maximum(rates[0], swings)
        return rates

    def _body(self, number: int) -> str:
        return excerpt(self._bodies.names[self._bodies.dynamic[number]])

    def _stop(self, t: float, reason: str, hint: str) -> None:
        message = f"{self._name} blew up at {t:g} s: {reason}"
        raise ToleranceError(Fault("SIM102", message, hint=hint))


def _oscillation_rates(
    by_position: FloatArray, by_speed: FloatArray, dt: float
) -> FloatArray:
    """Return angular frequencies ``(N,)`` [rad/s] of force gradients ``(N, 3, 3)``."""
    # An upper bound, so that few need eigenvalues.
    bound = np.sqrt(np.linalg.norm(by_position, axis=(1, 2)))
    bound += np.linalg.norm(by_speed - by_speed.swapaxes(1, 2), axis=(1, 2)) / 2
    frequencies = np.zeros(len(by_position))
    is_relevant = bound * dt > MAX_SUBSTEP_ANGLE
    if is_relevant.any():
        matrices = np.zeros((int(is_relevant.sum()), 6, 6))
        matrices[:, :3, 3:] = np.eye(3)
        matrices[:, 3:, :3], matrices[:, 3:, 3:] = (
            by_position[is_relevant],
            by_speed[is_relevant],
        )
        finite = np.isfinite(matrices).all(axis=(1, 2))
        rates = np.full(len(matrices), np.inf)
        rates[finite] = np.abs(np.linalg.eigvals(matrices[finite]).imag).max(axis=1)
        frequencies[is_relevant] = rates
    return frequencies
