"""Bodies under gravity as a simulation: steps, energy and momenta, encounters."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from animtool._types import FloatArray
from animtool.errors import Fault, OptionError, Severity
from animtool.frames import PointsFrame
from animtool.sim.checks import check_fit
from animtool.sim.equations import Equations
from animtool.sim.integrating import integrate
from animtool.sim.integrators.integrator import Control
from animtool.sim.options import IntegrateOptions, check_options
from animtool.sim.system import Energy
from animtool.sim.trajectory import Checkpoint, Status
from animtool.systems.colours import Colouring, Quantities, log_density
from animtool.systems.matter import at_one_place, check_rows, unit_quaternion
from animtool.systems.nbody.attraction import (
    Attractor,
    Gravity,
    GravitySystem,
    Pulls,
    TooCloseError,
)
from animtool.systems.nbody.galaxies import (
    Bodies,
    build_galaxy,
    on_orbit,
)
from animtool.systems.nbody.spec import BodiesModel, NbodyModel
from animtool.systems.simulation import Diagnostics, SimContext, StoppedError

# Most of the phase of a close pair that a step goes through [rad]: softened, whose pull
# ends at a distance, and without, where energies at a meeting are a hundredfold.
PHASE, BARE_PHASE = 0.15, 0.03
# It is looked at before steps; within them it may become this many times as much.
LATITUDE = 1.5
# Energy gained or lost, in what there was of either kind, from which on it blew up.
GROWTH = 0.5
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


class Nbody:
    """Bodies that attract each other, in steps.

    Attributes:
        checked: Its steps see to it that numbers stay finite.
        gravity: How they attract each other.

    Raises:
        OptionError: Something of the spec makes no sense (SIM001, SIM005, SIM006,
            SIM070).
    """

    checked = True

    @np.errstate(all="ignore")
    def __init__(self, spec: NbodyModel, context: SimContext) -> None:
        self._spec = spec
        self._options = IntegrateOptions(spec.method, spec.step, spec.tolerance)
        self._fixed = check_options(self._options).control is Control.FIXED
        parts, self._radii, self._species = _parts(spec, context.parts)
        self._bodies = Bodies.joined(parts)
        names = [f"bodies {k}" for k in range(len(spec.bodies))]
        self._names = names + [galaxy.name for galaxy in spec.galaxies]
        _check_apart(self._bodies.points, spec.softening)
        attractors = [
            Attractor(one.mass, one.softening, placed["poses"])
            for one, placed in zip(
                spec.attractors, context.parts.get("attractors", ()), strict=True
            )
        ]
        self._moving = any(one.moves or one.prim for one in spec.attractors)
        self.gravity = Gravity(
            self._bodies.masses,
            spec.gravity_constant,
            spec.softening,
            spec.accuracy,
            attractors,
        )
        if not np.isfinite([self._bodies.points, self._bodies.velocities]).all():
            refuse("galaxies are so small, large or heavy that numbers overflow")
        self._begin = context.begin
        self._phase = PHASE if spec.softening else BARE_PHASE
        start = self.initial()
        system = GravitySystem(self.gravity, start.motion, start.pulls, math.inf)
        check_fit(Equations(system), check_options(self._options))
        self._colouring: Colouring | None = None
        if spec.colour is not None:
            first = self._quantities(start, context.begin)
            self._colouring = Colouring.of(spec.colour, first)
        shown = [np.full(len(one.masses), True) for one in parts]
        for k, galaxy in enumerate(spec.galaxies, len(spec.bodies)):
            if galaxy.halo is not None and not galaxy.shows_halo:
                shown[k][-galaxy.halo.count :] = False
        self._shown = np.flatnonzero(np.concatenate(shown))

    def initial(self) -> NbodyState:
        """Return where all begin."""
        return self._first

    @cached_property
    def _first(self) -> NbodyState:
        points = self._bodies.points
        motion = np.stack([points, self._bodies.velocities])
        return NbodyState(motion, self.gravity.pulls(points), 0, 1)

    @np.errstate(all="ignore")
    def step(self, state: NbodyState, t: float, dt: float) -> NbodyState:
        """Return where bodies are a step [s] later.

        A step is divided where two bodies come so close that it would not follow them.

        Raises:
            StoppedError: It blew up (SIM102), the method could not go on (SIM103 to
                SIM105), or two bodies come too close for the most parts (SIM110).
        """
        parts = self._parts(state.pulls.rates, dt)
        while True:
            if parts > self._spec.substeps:
                raise self._encounter(t, state.motion[0], state.pulls.rates, dt)
            limit = (
                (LATITUDE * self._phase * parts / dt) ** 2 if self._fixed else math.inf
            )
            system = GravitySystem(self.gravity, state.motion, state.pulls, limit)
            options = replace(self._options, step=dt / parts if self._fixed else dt)
            begin = Checkpoint(t, state.motion)
            try:
                found = integrate(system, (t, t + dt), options, begin)
            except TooCloseError as close:
                parts *= 2
                if parts > self._spec.substeps:
                    raise self._encounter(
                        close.t, close.points, close.rates, dt
                    ) from None
                continue
            break
        if found.stats.status is not Status.OK:
            faults = [replace(one, severity=Severity.ERROR) for one in found.notices]
            raise StoppedError(faults, found.stats)
        motion = found.states[-1]
        after = NbodyState(
            motion,
            system.at(motion[0]),
            state.encounters + (parts > 1),
            max(state.divided, parts),
        )
        self._watch(after, t + dt, dt)
        return after

    def _parts(self, rates: FloatArray, dt: float) -> int:
        """Return how many parts of a step follow the closest pair, a power of two."""
        if not self._fixed or not len(rates):
            return 1
        phase = dt * math.sqrt(float(rates.max())) / self._phase
        if not phase < self._spec.substeps:
            return 2 * self._spec.substeps
        return 2 ** max(math.ceil(math.log2(phase)), 0) if phase > 1 else 1

    def _encounter(
        self, t: float, x: FloatArray, rates: FloatArray, dt: float
    ) -> StoppedError:
        i, j, distance = self.gravity.closest(x, rates)
        most = self._spec.substeps
        message = (
            f"bodies {i} and {j} are {distance:.3g} m apart at {t:.6g} s, too close "
        )
        message += f"for steps of {dt / most:.3g} s"
        masses = self.gravity.masses[i] + self.gravity.masses[j]
        widest = (PHASE * most / dt) ** 2
        enough = (self.gravity.constant * masses / widest) ** (1 / 3)
        hint = f"give softening: {1.05 * enough:.3g}, or more substeps"
        return StoppedError([Fault("SIM110", message, hint=hint)])

    def _watch(self, state: NbodyState, t: float, dt: float) -> None:
        """Stop where energy appears from nowhere (SIM102)."""
        begin, now = self._begun[0], self._energy(state, t)
        usual = max(begin.kinetic, abs(begin.potential), now.kinetic)
        supplied = self._moving or not usual
        if supplied or abs(now.total - begin.total) <= GROWTH * usual:
            return
        made = state.pulls.accelerations + self.gravity.outside(t, state.motion[0])[0]
        off = np.linalg.norm(state.motion[0] - self._centre(state)[0], axis=1)
        reach = np.maximum(off, self.gravity.softening)
        sizes = np.maximum(np.linalg.norm(made, axis=1), 1e-300)
        advised = ADVISED * float(np.sqrt(reach / sizes).min())
        message = (
            f"{self._spec.name} blew up at {t:g} s: its energy is {now.total:.4g} J, "
        )
        message += f"and was {begin.total:.4g} J"
        hint = f"give step: {min(advised, dt / 4):.2g}"
        raise StoppedError([Fault("SIM102", message, hint=hint)])

    def _energy(self, state: NbodyState, t: float) -> Energy:
        masses = self.gravity.masses
        kinetic = 0.5 * float(masses @ (state.motion[1] ** 2).sum(axis=1))
        potential = 0.5 * float(masses @ state.pulls.potentials)
        if self.gravity.attractors:
            potential += float(masses @ self.gravity.outside(t, state.motion[0])[1])
        return Energy(kinetic, potential)

    def _centre(self, state: NbodyState) -> FloatArray:
        """Return the centre of mass [m] and its velocity [m/s] ``(2, 3)``."""
        masses = self.gravity.masses
        whole = max(float(masses.sum()), 1e-300)
        return np.stack([masses @ each / whole for each in state.motion])

    def _momenta(self, state: NbodyState) -> FloatArray:
        """Return the momentum and the angular momentum ``(2, 3)``."""
        x, v = state.motion
        momenta = self.gravity.masses[:, None] * v
        return np.stack([momenta.sum(axis=0), np.cross(x, momenta).sum(axis=0)])

    @cached_property
    def _begun(self) -> tuple[Energy, FloatArray]:
        """Return the energy and the momenta of the beginning."""
        return self._energy(self._first, self._begin), self._momenta(self._first)

    @np.errstate(all="ignore")
    def frame(self, state: NbodyState, t: float) -> PointsFrame:
        """Return the bodies that are shown."""
        shown = self._shown
        points, velocities = state.motion[:, shown]
        primvars: dict[str, Any] = {}
        if len(self._names) > 1:
            primvars["species"] = self._species[shown]
        if self._colouring is not None:
            colours = self._colouring.colours(self._quantities(state, t))
            primvars["displayColor"] = colours[shown]
        return PointsFrame(shown, points, velocities, self._radii[shown], primvars)

    def _quantities(self, state: NbodyState, t: float) -> Quantities:
        x, v = state.motion
        masses = self.gravity.masses
        outside = self.gravity.outside(t, x) if self.gravity.attractors else (0.0, 0.0)
        pulls = state.pulls
        return {
            "speed": lambda: np.linalg.norm(v, axis=1),
            "density": lambda: log_density(x, masses),
            "energy": lambda: (v * v).sum(axis=1) / 2 + pulls.potentials + outside[1],
            "acceleration": lambda: np.linalg.norm(
                pulls.accelerations + outside[0], axis=1
            ),
            "species": lambda: self._species,
        }

    @np.errstate(all="ignore")
    def diagnostics(self, state: NbodyState, t: float) -> Diagnostics:
        """Return how well what stays was kept, and how close bodies came."""
        energy, (momentum, spin) = self._energy(state, t), self._momenta(state)
        begin, (momentum0, spin0) = self._begun
        masses, (x, v) = self.gravity.masses, state.motion
        sizes = masses * np.linalg.norm(v, axis=1)
        values = {"bodies": float(len(masses))}
        values["encounters"], values["substeps"] = (
            float(state.encounters),
            float(state.divided),
        )
        if not self.gravity.attractors:
            usual = np.array(
                [
                    max(abs(begin.total), begin.kinetic),
                    sizes.sum(),
                    sizes @ np.linalg.norm(x, axis=1),
                ]
            )
            gained = [
                energy.total - begin.total,
                *np.linalg.norm([momentum - momentum0, spin - spin0], axis=1),
            ]
            drifts = (np.array(gained) / np.maximum(usual, 1e-300)).tolist()
            names = ("energy_drift", "momentum_drift", "angular_momentum_drift")
            values |= dict(zip(names, drifts, strict=True))
        if self.gravity.tree:
            values["force_error"] = self._force_error(state)
        finite = {key: one for key, one in values.items() if math.isfinite(one)}
        return Diagnostics(None if self._moving else energy, finite)

    def _force_error(self, state: NbodyState) -> float:
        """Return the error of the tree, measured on some bodies [1]."""
        count = len(self.gravity.masses)
        rows = np.linspace(0, count - 1, SAMPLES).astype(int).tolist()
        exact = self.gravity.direct(state.motion[0], rows)
        off = np.linalg.norm(state.pulls.accelerations[rows] - exact, axis=1)
        sizes = np.maximum(np.linalg.norm(exact, axis=1), 1e-300)
        return float(np.sqrt(((off / sizes) ** 2).mean()))


def _parts(
    spec: NbodyModel, parts: Mapping[str, Any]
) -> tuple[list[Bodies], FloatArray, Any]:
    """Return bodies of each entry, half their widths [m], and whose each is."""
    read: Sequence[Mapping[str, Any]] = parts.get("bodies", ())
    made = [_read(*each) for each in zip(spec.bodies, read, strict=True)]
    radii = [one.radius for one in spec.bodies]
    constant, softening = spec.gravity_constant, spec.softening
    built = [build_galaxy(one, constant, softening) for one in spec.galaxies]
    places = [(np.array(one.at), np.array(one.velocity)) for one in spec.galaxies]
    if spec.encounter is not None:
        places = list(on_orbit(spec.encounter, built[0], built[1], constant))
    for galaxy, own, (at, velocity) in zip(spec.galaxies, built, places, strict=True):
        made.append(own.placed(unit_quaternion(galaxy.rotate), at, velocity))
        radii.append(galaxy.radius)
    counts = [len(one.masses) for one in made]
    return made, np.repeat(radii, counts), np.repeat(np.arange(len(made)), counts)


def _read(model: BodiesModel, parts: Mapping[str, Any]) -> Bodies:
    """Return bodies of a file, refused where arrays do not fit (SIM070)."""
    points, velocities = parts["points"], parts.get("velocities")
    masses = parts.get("masses")
    given = {"points": points, "velocities": velocities, "masses": masses}
    check_rows(given, "body", "SIM070", "bodies")
    velocities = np.zeros(points.shape) if velocities is None else velocities
    masses = np.full(len(points), model.mass) if masses is None else masses
    if (masses <= 0).any():
        i = int(np.argmax(masses <= 0))
        refuse(f"the mass of body {i} is {masses[i]:g} kg, not above 0")
    return Bodies(points, velocities, masses)


def _check_apart(points: FloatArray, softening: float) -> None:
    """Refuse two bodies at one place (SIM070)."""
    pair = at_one_place(points)
    if pair is not None:
        why = (
            "nothing tells them apart" if softening else "their attraction is infinite"
        )
        message = f"bodies {pair[0]} and {pair[1]} begin at one place: {why}"
        refuse(message, "move one of them")


def refuse(message: str, hint: str | None = None) -> None:
    """Raise what of bodies makes no sense (SIM070)."""
    raise OptionError(Fault("SIM070", message, hint=hint, where="bodies"))
