"""Mean forces on bodies in a step, and the number of substeps."""

from __future__ import annotations

import math

import numpy as np

from animtool.core.array_types import BoolArray, FloatArray
from animtool.core.errors import Fault, ToleranceError, excerpt
from animtool.core.quantities import floored, plain
from animtool.core.record import dataclass
from animtool.systems.rigid.bodies import RigidBodies
from animtool.systems.rigid.flight import Flight, fly
from animtool.systems.rigid.surroundings import BodyForces

# Largest rotation or phase of a swing in a substep [rad].
ANGLE = 0.5
MAX_PARTS = 256
# Constrained bodies with a larger inertia factor from drag take shorter substeps, so
# that they bounce right and keep their inertia ratio.
MAX_INERTIA_RATIO, MAX_CONSTRAINED_PARTS = 2.0, 64
# Constrained bodies with larger factors at the most substeps would drift from contacts.
HEAVIEST = 64.0
# Smaller relative changes of mass are ignored.
LIGHT = 1e-3
# Bodies with a larger factor collide at the velocity of their free flight.
HEAVY = 1.25
# Velocity difference, relative, below which a body flew freely.
OFF = 1e-6


@dataclass(frozen=True, slots=True)
class StepForces:
    """Mean forces on bodies over a step, and their free flight.

    Attributes:
        forces: Forces [N] and torques [N m] ``(N, 6)``.
        velocities: What bodies begin with ``(N, 3)`` [m/s]; None is what they have.
        inertias: Factors on their masses ``(N,)``; None is 1.
        flight: Where they come that nothing touches; None where all is constant.
    """

    forces: FloatArray
    velocities: FloatArray | None = None
    inertias: FloatArray | None = None
    flight: Flight | None = None

    def missed(self, velocities: FloatArray, constrained: BoolArray) -> BoolArray:
        """Return bodies with contacts that were not expected ``(N,)``.

        Only bodies that drag makes much heavier count.
        """
        flight = self.flight
        if flight is None:
            return np.zeros(len(constrained), np.bool_)
        off = np.linalg.norm(velocities - flight.velocities, axis=1)
        begun = velocities if self.velocities is None else self.velocities
        size = np.linalg.norm(flight.velocities, axis=1) + np.linalg.norm(begun, axis=1)
        return np.asarray(
            ~constrained & (flight.inertias >= HEAVY) & (off > OFF * size)
        )

    def parts(self, parts: int, constrained: BoolArray) -> int:
        """Return the substeps needed to repeat a step."""
        assert self.flight is not None
        return divided(parts, self.flight.inertias[constrained])


def divided(parts: int, inertias: FloatArray) -> int:
    """Return the number of substeps for inertia factors of some parts."""
    heaviest = float(inertias.max(initial=1.0))
    if not heaviest > MAX_INERTIA_RATIO:
        return parts
    return max(
        parts,
        math.ceil(min(parts * heaviest / MAX_INERTIA_RATIO, MAX_CONSTRAINED_PARTS)),
    )


class BodyLoads:
    """Computes step forces for the bodies of a system."""

    def __init__(self, name: str, bodies: RigidBodies, forces: BodyForces) -> None:
        self._name, self._bodies, self._forces = name, bodies, forces

    def fly(self, t: float, dt: float, motion: FloatArray) -> Flight | None:
        """Return the free flight of bodies; None under constant forces."""
        if not self._forces.vary:
            return None
        steady = self._forces.pushes_over(t, dt, motion)[:, :3]
        steady /= self._bodies.masses[:, None]

        def rate(now: float, x: FloatArray, v: FloatArray) -> FloatArray:
            return self._forces.accelerations(now, x, v) + steady

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

        ``constrained`` bodies ``(N,)``, by contacts or joints, feel the force that
        there is, and yield to all others as much less as it would have gone down with
        their velocity. The others come where they fly.

        Raises:
            ToleranceError: A force is not finite (SIM102).
        """
        if flight is None:
            with np.errstate(all="ignore"):
                loads = StepForces(self._forces.over(t, dt, motion))
        else:
            loads = self._flown(t, dt, motion, constrained, flight)
        self._check(loads, t)
        return loads

    def _flown(
        self,
        t: float,
        dt: float,
        motion: FloatArray,
        constrained: BoolArray,
        flight: Flight,
    ) -> StepForces:
        x, v = motion[:, :3], motion[:, 7:10]
        heavy = constrained & (flight.inertias > 1 + LIGHT)
        inertias = np.where(heavy, flight.inertias, 1.0)
        forces = self._forces.pushes_over(t, dt, motion)
        with np.errstate(all="ignore"):
            # The kernel moves bodies by the mean of both velocities.
            begin = 2 * (flight.points - x) / dt - flight.velocities
            begin = np.where(constrained[:, None], v, begin)
            masses = (self._bodies.masses * inertias)[:, None]
            forces[:, :3] = masses * (flight.velocities - begin) / dt
        return StepForces(forces, begin, inertias if heavy.any() else None, flight)

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
            message = (
                f"the force on {self._body(number)} changes too fast to be resolved"
            )
            self._stop(t, message, "use a weaker or smoother force")

    def parts(self, t: float, dt: float, motion: FloatArray) -> int:
        """Return the substeps that resolve swinging bodies.

        Raises:
            ToleranceError: They are too many (SIM102).
        """
        swings, spins = self._rates(t, dt, motion)
        fastest = float(swings.max(initial=0.0)) * dt / ANGLE
        if not fastest <= MAX_PARTS:
            number = int(np.argmax(swings))
            message = f"the forces on {self._body(number)} make it oscillate at "
            message += f"{swings[number]:.3g} rad/s, which needs more than "
            message += f"{MAX_PARTS} substeps in a step of {plain(dt)} s"
            hint = "use weaker forces, or more mass"
            if math.isfinite(fastest):
                step = floored(dt * MAX_PARTS / fastest)
                hint = f"use step: {plain(step)}, or {hint}"
            self._stop(t, message, hint)
        turned = float(spins.max(initial=0.0)) * dt / ANGLE
        return max(1, math.ceil(fastest), min(math.ceil(turned), MAX_PARTS))

    def parts_of_constrained(
        self,
        t: float,
        dt: float,
        parts: int,
        motion: FloatArray,
        constrained: BoolArray,
    ) -> int:
        """Return the substeps for constrained bodies ``(N,)``.

        Raises:
            ToleranceError: They are too many (SIM102).
        """
        if not constrained.any():
            return parts
        each = dt / parts
        flight = self.fly(t, each, motion)
        assert flight is not None
        inertias = np.where(constrained, flight.inertias, 1.0)
        heaviest = float(inertias.max()) * parts
        if heaviest > HEAVIEST * MAX_CONSTRAINED_PARTS:
            message = f"drag on {self._body(int(np.argmax(inertias)))}, which is in "
            message += f"contact, is too strong for a step of {plain(dt)} s"
            step = floored(dt * HEAVIEST * MAX_CONSTRAINED_PARTS / heaviest)
            self._stop(
                t, message, f"use step: {plain(step)}, or less drag, or more mass"
            )
        return divided(parts, inertias)

    def _rates(self, t: float, dt: float, motion: FloatArray) -> FloatArray:
        """Return how fast bodies swing, and spin under pushes ``(2, N)``."""
        with np.errstate(all="ignore"):
            rates = self._forces.turning(t, dt, motion)
            if self._forces.vary:
                x, v = motion[:, :3], motion[:, 7:10]
                swings = _swings(*self._forces.slopes(t, x, v), dt)
                rates[0] = np.maximum(rates[0], swings)
        return rates

    def _body(self, number: int) -> str:
        return excerpt(self._bodies.names[self._bodies.dynamic[number]])

    def _stop(self, t: float, why: str, hint: str) -> None:
        message = f"{self._name} blew up at {t:g} s: {why}"
        raise ToleranceError(Fault("SIM102", message, hint=hint))


def _swings(by_position: FloatArray, by_speed: FloatArray, dt: float) -> FloatArray:
    """Return angular frequencies ``(N,)`` [rad/s] of force gradients ``(N, 3, 3)``."""
    # An upper bound, so that few need eigenvalues.
    bound = np.sqrt(np.linalg.norm(by_position, axis=(1, 2)))
    bound += np.linalg.norm(by_speed - by_speed.swapaxes(1, 2), axis=(1, 2)) / 2
    swings = np.zeros(len(by_position))
    look = bound * dt > ANGLE
    if look.any():
        matrices = np.zeros((int(look.sum()), 6, 6))
        matrices[:, :3, 3:] = np.eye(3)
        matrices[:, 3:, :3], matrices[:, 3:, 3:] = by_position[look], by_speed[look]
        finite = np.isfinite(matrices).all(axis=(1, 2))
        rates = np.full(len(matrices), np.inf)
        rates[finite] = np.abs(np.linalg.eigvals(matrices[finite]).imag).max(axis=1)
        swings[look] = rates
    return swings
