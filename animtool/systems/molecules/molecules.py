"""Atoms in a box as a simulation: steps, heat, temperature, pressure and energy."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from animtool._types import FloatArray
from animtool.errors import Fault, Severity
from animtool.frames import PointsFrame
from animtool.sim.checks import check_fit
from animtool.sim.equations import Equations
from animtool.sim.integrating import integrate
from animtool.sim.options import IntegrateOptions, check_options
from animtool.sim.system import Energy
from animtool.sim.trajectory import Checkpoint, Status
from animtool.systems.colours import Colouring, Quantities, log_density
from animtool.systems.matter import normals
from animtool.systems.molecules.atoms import BOLTZMANN, Atoms, Placing, refuse
from animtool.systems.molecules.forces import (
    Acting,
    Interactions,
    MoleculeSystem,
    Trap,
)
from animtool.systems.molecules.spec import MoleculesModel, ThermostatModel
from animtool.systems.particles.emitter import uniforms
from animtool.systems.simulation import Diagnostics, SimContext, StoppedError

# Pressure of 1 kJ/(mol nm³) [MPa].
MEGAPASCALS = 1.66053906717
# Energy over the depth of a pair from which on atoms overlap at the beginning.
OVERLAP = 1000.0
# Steps over 1/ω of the stiffest crystal, from which on they are refused, and advised.
LONGEST, ADVISED = 1.0, 0.1
# Seed of the numbers of a bath over that of the system.
_BATH = 2000
# Share of the box that an atom may go through in a step.
FARTHEST = 0.25
# Energy gained or lost, in what there was of either kind, from which on it blew up.
GROWTH = 0.5


@dataclass(frozen=True, slots=True)
class MoleculeState:
    """Where atoms are, and what they do to each other there."""

    motion: FloatArray  # positions [nm], then velocities [nm/ps] (2, N, 3)
    reference: FloatArray  # places of the list of neighbours (N, 3) [nm]
    acting: Acting
    heat: float  # that the bath gave so far [kJ/mol]
    steps: int


class Molecules:
    """Atoms in a periodic box, in steps.

    Attributes:
        checked: Its steps see to it that numbers stay finite.
        atoms: Which there are.

    Raises:
        OptionError: Something of the spec makes no sense (SIM001, SIM005, SIM006,
            SIM071).
    """

    checked = True

    @np.errstate(all="ignore")
    def __init__(self, spec: MoleculesModel, context: SimContext) -> None:
        self._spec, self._begin = spec, context.begin
        self._options = IntegrateOptions(spec.method, spec.step * spec.pace)
        integrator = check_options(self._options)
        self._placing = Placing.of(spec)
        self.atoms = Atoms.of(spec, context.parts["species"], self._placing)
        traps = [
            Trap(one.stiffness, one.radius, placed["poses"])
            for one, placed in zip(
                spec.traps, context.parts.get("traps", ()), strict=True
            )
        ]
        self._moving = any(one.moves or one.prim for one in spec.traps)
        self._interactions = Interactions(spec, self.atoms, self._placing, traps)
        self._freedom = max(3 * len(self.atoms.masses) - 3, 1)
        self._check_step()
        start = self.initial()
        motion = self._placing.velocities_out(start.motion[1])
        placed = [self._placing.outwards(start.motion[0]), motion]
        if not np.isfinite(placed).all():
            refuse(
                "atoms are so far or fast in the scene that numbers overflow", "scale"
            )
        self._check_apart(start)
        check_fit(Equations(self._system(start)), integrator)
        self._colouring: Colouring | None = None
        if spec.colour is not None:
            self._colouring = Colouring.of(spec.colour, self._quantities(start))

    def _stiffest(self) -> float:
        """Return the fastest vibration of a crystal of any of the kinds [rad/ps]."""
        rates = [57.15 * a.epsilon / a.sigma**2 / a.mass for a in self._spec.species]
        return math.sqrt(8 * max(rates))

    def _advised(self) -> float:
        """Return a step that is short enough [s]."""
        return ADVISED / max(self._stiffest() * self._spec.pace, 1e-300)

    def _check_step(self) -> None:
        """Refuse steps that no bond would survive (SIM071)."""
        step = self._spec.step * self._spec.pace
        if step * self._stiffest() > LONGEST:
            message = f"a step of {step:.3g} ps is too long: atoms vibrate in "
            message += f"{2 * math.pi / self._stiffest():.3g} ps"
            refuse(message, "step", f"give step: {self._advised():.2g}, or less pace")

    def _check_apart(self, start: MoleculeState) -> None:
        """Refuse atoms that begin in each other (SIM071)."""
        depth = max(*(one.epsilon for one in self._spec.species), 1e-3)
        energies = start.acting.energies
        if (energies < OVERLAP * depth).all():  # NaN is not
            return
        from scipy.spatial import cKDTree

        size = self._placing.size
        x = start.motion[0] % size
        distances, others = cKDTree(x % size, boxsize=size).query(x, 2)
        i = int(np.argmin(distances[:, 1]))
        one, other = sorted(others[i].tolist())
        message = f"atoms {one} and {other} begin {distances[i, 1]:.3g} nm apart"
        hint = "move one of them, or give a larger box"
        refuse(message, "species", hint)

    def initial(self) -> MoleculeState:
        """Return where all begin."""
        return self._first

    @cached_property
    def _first(self) -> MoleculeState:
        points = np.ascontiguousarray(self.atoms.points)
        motion = np.stack([points, self.atoms.velocities])
        acting = self._interactions.acting(points, points)
        return MoleculeState(motion, points, acting, 0.0, 0)

    def _system(self, state: MoleculeState) -> MoleculeSystem:
        return MoleculeSystem(
            self._interactions,
            self.atoms.masses,
            self._spec.pace,
            state.motion,
            state.acting,
            state.reference,
        )

    @np.errstate(all="ignore")
    def step(self, state: MoleculeState, t: float, dt: float) -> MoleculeState:
        """Return where atoms are a step [s] later, or a part of one.

        Raises:
            StoppedError: It blew up (SIM102).
        """
        pace, system = self._spec.pace, self._system(state)
        options = replace(self._options, step=dt * pace)
        span = (t * pace, t * pace + dt * pace)
        found = integrate(system, span, options, Checkpoint(span[0], state.motion))
        if found.stats.status is not Status.OK:
            hint = f"give step: {self._advised():.2g}"
            faults = [
                replace(one, severity=Severity.ERROR, hint=hint)
                for one in found.notices
            ]
            raise StoppedError(faults, found.stats)
        motion = found.states[-1]
        self._check_speeds(motion[1], t + dt, dt)
        acting = system.at(motion[0])
        heat = state.heat
        if self._spec.thermostat is not None:
            kinetic = self._kinetic(motion)
            factor = bath_factor(
                self._spec.thermostat,
                self._spec.seed,
                state.steps,
                t + dt,
                dt * pace,
                kinetic,
                self._freedom,
            )
            motion = np.stack([motion[0], factor * motion[1]])
            heat += (factor**2 - 1) * kinetic
        after = MoleculeState(motion, system.reference, acting, heat, state.steps + 1)
        self._watch(after, t + dt)
        return after

    def _check_speeds(self, v: FloatArray, t: float, dt: float) -> None:
        ways = np.sqrt((v * v).sum(axis=1)) * dt * self._spec.pace
        i = int(np.argmax(ways))
        if not ways[i] <= FARTHEST * self._placing.size.min():
            self._stop(t, f"atom {i} goes {ways[i]:.3g} nm in a step")

    def _watch(self, state: MoleculeState, t: float) -> None:
        """Stop where energy appears from nowhere (SIM102)."""
        begin, now = self._begun, self._energy(state, t)
        usual = max(begin.kinetic, abs(begin.potential), abs(state.heat))
        gained = now.total - state.heat - begin.total
        if not self._moving and usual and not abs(gained) <= GROWTH * usual:
            message = f"its energy is {now.total:.4g} kJ/mol, and was {begin.total:.4g}"
            self._stop(t, message)

    def _stop(self, t: float, reason: str) -> None:
        message = f"{self._spec.name} blew up at {t:g} s: {reason}"
        hint = f"give step: {min(self._advised(), self._spec.step / 4):.2g}"
        raise StoppedError([Fault("SIM102", message, hint=hint)])

    def _kinetic(self, motion: FloatArray) -> float:
        return 0.5 * float(self.atoms.masses @ (motion[1] ** 2).sum(axis=1))

    def _energy(self, state: MoleculeState, t: float) -> Energy:
        """Return energies [kJ/mol]."""
        potential = float(state.acting.energies.sum()) + self._interactions.own_energy()
        if self._interactions.traps:
            potential += float(self._interactions.trapped(t, state.motion[0])[1].sum())
        return Energy(self._kinetic(state.motion), potential)

    @cached_property
    def _begun(self) -> Energy:
        return self._energy(self._first, self._begin)

    @np.errstate(all="ignore")
    def frame(self, state: MoleculeState, t: float) -> PointsFrame:  # noqa: ARG002
        """Return atoms within the box."""
        x, v = state.motion
        primvars: dict[str, Any] = {}
        if len(self._spec.species) > 1:
            primvars["species"] = self.atoms.kinds
        if self._colouring is not None:
            primvars["displayColor"] = self._colouring.colours(self._quantities(state))
        return PointsFrame(
            np.arange(len(x)),
            self._placing.outwards(x),
            self._placing.velocities_out(v),
            self.atoms.radii,
            primvars,
        )

    def _quantities(self, state: MoleculeState) -> Quantities:
        (x, v), masses = state.motion, self.atoms.masses
        energies, size = state.acting.energies, self._placing.size
        squares = (v * v).sum(axis=1)
        return {
            "speed": lambda: np.sqrt(squares),
            "temperature": lambda: masses * squares / (3 * BOLTZMANN),
            "density": lambda: log_density(x % size % size, masses, size),
            "energy": lambda: 0.5 * masses * squares + energies,
            "species": lambda: self.atoms.kinds,
        }

    @np.errstate(all="ignore")
    def diagnostics(self, state: MoleculeState, t: float) -> Diagnostics:
        """Return temperature, pressure and energies, and how well energy was kept."""
        return Diagnostics(
            None if self._moving else self._balance(state, t), self.values(state, t)
        )

    def _balance(self, state: MoleculeState, t: float) -> Energy:
        """Return the energy without what the bath gave."""
        now = self._energy(state, t)
        return replace(now, potential=now.potential - state.heat)

    def values(self, state: MoleculeState, t: float) -> Mapping[str, float]:
        """Return what is reported: [K], [MPa] and [kJ/mol]."""
        now, begin = self._energy(state, t), self._begun
        volume = float(self._placing.size.prod())
        pressure = (2 * now.kinetic + state.acting.virial) / (3 * volume)
        values = {
            "atoms": float(len(self.atoms.masses)),
            "temperature": 2 * now.kinetic / (self._freedom * BOLTZMANN),
            "pressure": pressure * MEGAPASCALS,
            "kinetic_energy": now.kinetic,
            "potential_energy": now.potential,
        }
        if not self._moving:
            usual = max(abs(begin.total), begin.kinetic, 1e-300)
            gained = now.total - state.heat - begin.total
            values["energy_drift"] = gained / usual
        return {key: one for key, one in values.items() if math.isfinite(one)}


def bath_factor(
    model: ThermostatModel,
    seed: int,
    step: int,
    t: float,
    dt: float,
    kinetic: float,
    freedom: int,
) -> float:
    """Return by how much velocities change in a step, by a bath.

    Reference: G. Bussi, D. Donadio, M. Parrinello, Canonical sampling through velocity
    rescaling, Journal of Chemical Physics 126, 2007, equation A7.

    Args:
        model: The bath.
        seed: Of the system.
        step: Number of the step, which chooses what is random.
        t: Time at its end [s].
        dt: The step [ps].
        kinetic: Energy [kJ/mol].
        freedom: Degrees of freedom.
    """
    from scipy.special import gammaincinv

    if not kinetic > 0 or freedom < 1:
        return 1.0
    times, temperatures = np.array(model.temperatures).T
    usual = BOLTZMANN * float(np.interp(t, times, temperatures)) / 2
    (first, others) = np.clip(
        uniforms(seed + _BATH, np.array([step]), 2)[0], 2.0**-53, 1 - 2.0**-53
    )
    normal = float(normals(first))
    # The sum of the squares of all normal numbers but one.
    squares = 2 * float(gammaincinv((freedom - 1) / 2, others)) if freedom > 1 else 0.0
    kept = float(np.exp(-dt / model.relaxation))
    share = usual / kinetic * (1 - kept)
    square = kept + share * (normal**2 + squares) + 2 * normal * np.sqrt(kept * share)
    factor = float(np.sqrt(max(square, 0.0)))
    return -factor if normal * np.sqrt(share) + np.sqrt(kept) < 0 else factor
