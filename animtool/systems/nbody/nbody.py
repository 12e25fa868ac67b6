"""Bodies under gravity as a simulation: steps, energy and momenta, encounters."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from animtool._types import FloatArray
from animtool.errors import Fault, refuse
from animtool.sim.integrators.integrator import Control
from animtool.sim.system import Energy
from animtool.systems.colours import Quantities
from animtool.systems.interacting import Interacting
from animtool.systems.matter import (
    Bodies,
    Placement,
    at_one_place,
    check_rows,
    unit_quaternion,
)
from animtool.systems.nbody.attraction import Gravity, Pulls, TooCloseError, check_close
from animtool.systems.nbody.galaxies import build_galaxy, on_orbit
from animtool.systems.nbody.spec import BodiesModel, NbodyModel
from animtool.systems.simulation import SimContext, StoppedError

# Most of the phase of a close pair that a step goes through [rad]: softened, whose pull
# ends at a distance, and without, where energies at a meeting are a hundredfold.
PHASE, BARE_PHASE = 0.15, 0.03
# It is looked at before steps; within them it may become this many times as much.
LATITUDE = 1.5
# Bodies whose accelerations by the tree are compared with direct sums.
SAMPLES = 16
# Share of the time in which accelerations would bring bodies to the centre that a step
# is advised to be.
ADVISED = 0.1


@dataclass(frozen=True, slots=True)
class NbodyState:
    """Where bodies are, and how they attract each other there."""

    motion: FloatArray  # positions [m], then velocities [m/s] (2, N, 3)
    pulls: Pulls
    encounters: int  # steps so far that were divided, as two came close
    divided: int  # the most parts that one was


class Nbody(Interacting[NbodyState, Pulls]):
    """Bodies that attract each other, in steps.

    Attributes:
        gravity: How they attract each other.

    Raises:
        OptionError: Something of the spec makes no sense (SIM001, SIM005, SIM006,
            SIM070).
    """

    @np.errstate(all="ignore")
    def __init__(self, spec: NbodyModel, context: SimContext) -> None:
        super().__init__(spec, context)
        self._fixed = self._integrator.control is Control.FIXED
        self._phase = PHASE if spec.softening else BARE_PHASE
        parts = _parts(spec, context.parts)
        self.bodies, self.several = Bodies.joined(parts), len(parts) > 1
        counts = [len(one.masses) for one in parts]
        self.species = np.repeat(np.arange(len(parts)), counts)
        entries = [*spec.bodies, *spec.galaxies]
        self.radii = np.repeat([one.radius for one in entries], counts)
        pair = at_one_place(self.bodies.points)
        if pair is not None:
            why = "nothing tells them apart"
            why = why if spec.softening else "their attraction is infinite"
            message = f"bodies {pair[0]} and {pair[1]} begin at one place: {why}"
            refuse(spec.code, message, "bodies", "move one of them")
        attractors = context.parts.get("attractors", ())
        self.law = self.gravity = Gravity(spec, self.bodies.masses, attractors)
        if not np.isfinite([self.bodies.points, self.bodies.velocities]).all():
            message = "galaxies are so small, large or heavy that numbers overflow"
            refuse(spec.code, message, "bodies")
        dark = [0] * len(spec.bodies) + [
            0 if one.halo is None or one.shows_halo else one.halo.count
            for one in spec.galaxies
        ]
        numbers = [np.arange(n) < n - k for n, k in zip(counts, dark, strict=True)]
        self.shown = np.flatnonzero(np.concatenate(numbers))
        self.begin()

    def _start(self, motion: FloatArray) -> NbodyState:
        return NbodyState(motion, self.gravity.pulls(motion[0]), 0, 1)

    def _sums(self, state: NbodyState) -> Pulls:
        return state.pulls

    @np.errstate(all="ignore")
    def step(self, state: NbodyState, t: float, dt: float) -> NbodyState:
        """Return where bodies are a step [s] later.

        A step is divided where two bodies come so close that it would not follow them.

        Raises:
            StoppedError: It blew up (SIM102), the method could not go on (SIM103 to
                SIM105), or two bodies come too close for the most parts (SIM110).
        """
        parts = self._parts(state.pulls.rates, dt)
        close = TooCloseError(t, state.motion[0], state.pulls)
        while parts <= self._spec.substeps:
            limit, step = math.inf, dt
            if self._fixed:
                limit, step = (LATITUDE * self._phase * parts / dt) ** 2, dt / parts
            system = self._system(state, partial(check_close, limit))
            try:
                motion = self._integrated(system, t, dt, step)
            except TooCloseError as error:
                parts, close = 2 * parts, error
                continue
            encounters, divided = (
                state.encounters + (parts > 1),
                max(state.divided, parts),
            )
            after = NbodyState(motion, system.at(motion[0]), encounters, divided)
            self._watch(after, t + dt)
            return after
        raise self._encounter(close, dt)

    def _parts(self, rates: FloatArray, dt: float) -> int:
        """Return how many parts of a step follow the closest pair, a power of two."""
        if not self._fixed or not len(rates):
            return 1
        phase = dt * math.sqrt(float(rates.max())) / self._phase
        if not phase < self._spec.substeps:
            return 2 * self._spec.substeps
        return 2 ** max(math.ceil(math.log2(phase)), 0) if phase > 1 else 1

    def _encounter(self, close: TooCloseError, dt: float) -> StoppedError:
        i, j, distance = self.gravity.closest(close.points, close.rates)
        most = self._spec.substeps
        message = f"bodies {i} and {j} are {distance:.3g} m apart at {close.t:.6g} s, "
        message += f"too close for steps of {dt / most:.3g} s"
        widest = (PHASE * most / dt) ** 2
        pull = self._spec.gravity_constant * (
            self.bodies.masses[i] + self.bodies.masses[j]
        )
        enough = (pull / widest) ** (1 / 3)
        hint = f"give softening: {1.05 * enough:.3g}, or more substeps"
        return StoppedError([Fault("SIM110", message, hint=hint)])

    def _in_play(self, state: NbodyState, now: Energy) -> float:  # noqa: ARG002
        return now.kinetic

    def _advised(self, state: NbodyState, t: float) -> float:
        x, masses = state.motion[0], self.bodies.masses
        made = state.pulls.accelerations + self.law.outside(t, x)[0]
        centre = masses @ x / masses.sum()
        reach = np.maximum(np.linalg.norm(x - centre, axis=1), self._spec.softening)
        sizes = np.maximum(np.linalg.norm(made, axis=1), 1e-300)
        return ADVISED * float(np.sqrt(reach / sizes).min())

    def _potential(self, state: NbodyState, t: float) -> float:
        masses, x = self.bodies.masses, state.motion[0]
        outside = float(masses @ self.law.outside(t, x)[1]) if self.law.placed else 0.0
        return 0.5 * float(masses @ state.pulls.potentials) + outside

    def _momenta(self, state: NbodyState) -> FloatArray:
        """Return the momentum and the angular momentum ``(2, 3)``."""
        x, v = state.motion
        momenta = self.bodies.masses[:, None] * v
        return np.stack([momenta.sum(axis=0), np.cross(x, momenta).sum(axis=0)])

    def _quantities(self, state: NbodyState, t: float) -> Quantities:
        (x, v), pulls = state.motion, state.pulls
        placed = self.law.placed
        made, potentials = self.law.outside(t, x) if placed else (0.0, 0.0)
        return {
            **super()._quantities(state, t),
            "energy": lambda: (v * v).sum(axis=1) / 2 + pulls.potentials + potentials,
            "acceleration": lambda: np.linalg.norm(pulls.accelerations + made, axis=1),
        }

    def _values(self, state: NbodyState, t: float) -> Mapping[str, float]:
        """Return how well what stays was kept, and how close bodies came."""
        x, v = state.motion
        values = {
            "bodies": float(len(x)),
            "encounters": float(state.encounters),
            "substeps": float(state.divided),
        }
        if not self.law.placed:
            values["energy_drift"] = self._drift(state, self._energy(state, t))
            sizes = self.bodies.masses * np.linalg.norm(v, axis=1)
            usual = np.array([sizes.sum(), sizes @ np.linalg.norm(x, axis=1)])
            gained = self._momenta(state) - self._momenta(self.initial())
            drifts = np.linalg.norm(gained, axis=1) / np.maximum(usual, 1e-300)
            names = ("momentum_drift", "angular_momentum_drift")
            values |= dict(zip(names, drifts.tolist(), strict=True))
        if self.gravity.tree:
            values["force_error"] = self._force_error(state)
        return values

    def _force_error(self, state: NbodyState) -> float:
        """Return the error of the tree, measured on some bodies [1]."""
        rows = np.linspace(0, len(state.motion[0]) - 1, SAMPLES).astype(int).tolist()
        exact = self.gravity.direct(state.motion[0], rows)
        off = np.linalg.norm(state.pulls.accelerations[rows] - exact, axis=1)
        sizes = np.maximum(np.linalg.norm(exact, axis=1), 1e-300)
        return float(np.sqrt(((off / sizes) ** 2).mean()))


def _parts(spec: NbodyModel, parts: Mapping[str, Any]) -> list[Bodies]:
    """Return the bodies of each entry."""
    read = zip(spec.bodies, parts.get("bodies", ()), strict=True)
    made = [_read(spec.code, *each) for each in read]
    constant, softening = spec.gravity_constant, spec.softening
    built = [build_galaxy(one, constant, softening) for one in spec.galaxies]
    places = [(np.array(one.at), np.array(one.velocity)) for one in spec.galaxies]
    if spec.encounter is not None:
        places = list(on_orbit(spec.encounter, built[0], built[1], constant))
    for galaxy, own, (at, v) in zip(spec.galaxies, built, places, strict=True):
        placing = Placement(at, unit_quaternion(galaxy.rotate))
        points, velocities = own.points, placing.velocities_out(own.velocities) + v
        made.append(Bodies(placing.outwards(points), velocities, own.masses))
    return made


def _read(code: str, model: BodiesModel, parts: Mapping[str, Any]) -> Bodies:
    """Return bodies of a file, refused where arrays do not fit."""
    check_rows(parts, "body", code, "bodies")
    points, velocities = parts["points"], parts.get("velocities")
    velocities = np.zeros(points.shape) if velocities is None else velocities
    masses = parts.get("masses")
    masses = np.full(len(points), model.mass) if masses is None else masses
    if (masses <= 0).any():
        i = int(np.argmax(masses <= 0))
        message = f"the mass of body {i} is {masses[i]:g} kg, not above 0"
        refuse(code, message, "bodies")
    return Bodies(points, velocities, masses)
