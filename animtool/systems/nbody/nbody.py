"""N-body simulation: steps, energy and momenta, close encounters."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import field
from functools import partial

import numpy as np

from animtool import _kernels
from animtool.core.array_types import FloatArray
from animtool.core.errors import Fault, RefusalCollector, refuse
from animtool.core.record import dataclass
from animtool.sim.integrators.integrator import StepControl
from animtool.sim.system import Energy
from animtool.systems.framework.colours import Quantities
from animtool.systems.framework.interacting import Interacting
from animtool.systems.framework.matter import PointMasses, check_distinct
from animtool.systems.framework.simulation import SimContext, StoppedError, saved_as
from animtool.systems.nbody.galaxies import build_galaxies
from animtool.systems.nbody.spec import AttractorModel, NbodyModel

# Number of bodies above which a tree is faster than direct sums, the accuracy at which
# that holds, and the power of the accuracy that the number grows with.
TREE_MIN_BODIES, CROSSOVER_ACCURACY, CROSSOVER_POWER = 1000, 2e-4, 0.4
# Tree forces are float32: no finer accuracy is possible.
MIN_TREE_ACCURACY = 1e-6
# Number of bodies that are sampled for the error of tree forces.
ERROR_SAMPLES = 16
# Largest orbital phase of a close pair in a step [rad], with softening, and without,
# where energies grow a hundredfold in an encounter.
MAX_STEP_PHASE, MAX_UNSOFTENED_STEP_PHASE = 0.15, 0.03
# Allowed growth of the orbital rate in a step, as it is checked at the start of it.
RATE_TOLERANCE = 1.5
# Recommended step relative to the free-fall time to the centre.
RECOMMENDED_STEP = 0.1


@dataclass(frozen=True, slots=True)
class MutualGravity:
    """Mutual accelerations of N bodies."""

    accelerations: FloatArray  # (N, 3) [m/s²]
    potentials: FloatArray  # (N,) [J/kg]
    # Largest squared orbital frequency with any other body ``(N,)`` [1/s²].
    rates: FloatArray


@dataclass(frozen=True, slots=True)
class NbodyState:
    """State of bodies, with their accelerations."""

    motion: FloatArray  # positions [m], then velocities [m/s] (2, N, 3)
    # Accelerations at these positions.
    gravity: MutualGravity = field(metadata=saved_as("pulls"))
    encounters: int  # number of steps with substeps so far
    divided: int  # largest number of substeps so far


class CloseEncounterError(Exception):
    """Two bodies are too close for a step; holds the time, positions and rates."""


def _check_closest_pair(
    max_squared_rate: float, t: float, x: FloatArray, gravity: MutualGravity
) -> None:
    """Raise `CloseEncounterError` if a pair's squared orbital rate is too large."""
    if len(x) and gravity.rates.max() > max_squared_rate:
        raise CloseEncounterError(t, x, gravity.rates)


@np.errstate(all="ignore")
def build(spec: NbodyModel, context: SimContext) -> Nbody:
    """Build the bodies of a spec, from files and of generated galaxies.

    Raises SIM001, SIM005, SIM006 or SIM070 if the spec is invalid.
    """
    body_sets, refusals = [], RefusalCollector()
    for body, data in zip(
        spec.bodies, context.entry_data.get("bodies", ()), strict=True
    ):
        with refusals.collect():
            body_sets.append(
                PointMasses.read(data, body.mass, "body", spec.code, "bodies")
            )
    refusals.check()
    nbody = Nbody(spec, context, [*body_sets, *build_galaxies(spec)])
    _check_start(spec, nbody.bodies)
    nbody.finish_setup()
    return nbody


def _check_start(spec: NbodyModel, bodies: PointMasses) -> None:
    """Raise SIM070 if bodies coincide, or numbers are not finite."""
    key, hint = "bodies", "move one of them"
    reasons = "their attraction is infinite", "they cannot be told apart"
    pair_names, reason = "bodies {} and {}".format, reasons[spec.softening > 0]
    check_distinct(bodies.points, pair_names, spec.code, key, hint, reason)
    if not np.isfinite([bodies.points, bodies.velocities]).all():
        message = "galaxies are so small, large or heavy that numbers overflow"
        refuse(spec.code, message, "bodies")


class Nbody(Interacting[NbodyState, MutualGravity]):
    """Simulates bodies that attract each other.

    Attributes:
        uses_tree: Whether a tree is used; it is then faster than a direct sum, and
            accurate enough.
    """

    def __init__(
        self, spec: NbodyModel, context: SimContext, body_sets: Sequence[PointMasses]
    ) -> None:
        """Start with the bodies of each entry; bodies of galaxies are last."""
        super().__init__(spec, context, "attractors")
        self._has_fixed_steps = self._integrator.control is StepControl.FIXED
        self._max_phase = (
            MAX_STEP_PHASE if spec.softening else MAX_UNSOFTENED_STEP_PHASE
        )
        self.bodies = PointMasses.concatenate(body_sets)
        counts = [len(entry.masses) for entry in body_sets]
        self.has_many_species = len(body_sets) > 1
        self.species = np.repeat(np.arange(len(body_sets)), counts)
        radii = [body.radius for body in spec.bodies]
        radii += [galaxy.radius for galaxy in spec.galaxies]
        self.radii = np.repeat(radii, counts)
        hidden_counts = [0] * len(spec.bodies)
        hidden_counts += [galaxy.hidden_count for galaxy in spec.galaxies]
        is_visible = [
            np.arange(count) < count - hidden_count
            for count, hidden_count in zip(counts, hidden_counts, strict=True)
        ]
        self.written_indices = np.flatnonzero(np.concatenate(is_visible))
        accuracy_factor = CROSSOVER_ACCURACY / max(spec.accuracy, MIN_TREE_ACCURACY)
        min_bodies = TREE_MIN_BODIES * accuracy_factor**CROSSOVER_POWER
        is_large = len(self.bodies.masses) > min_bodies
        self.uses_tree = spec.accuracy >= MIN_TREE_ACCURACY and is_large

    def _build_initial_state(self, motion: FloatArray) -> NbodyState:
        return NbodyState(motion, self.compute_sums(motion[0]), 0, 1)

    def _state_sums(self, state: NbodyState) -> MutualGravity:
        return state.gravity

    def compute_sums(
        self,
        x: FloatArray,
        last_sums: MutualGravity | None = None,  # noqa: ARG002
    ) -> MutualGravity:
        """Return mutual accelerations of bodies at points ``(N, 3)`` [m]."""
        spec, accuracy = self._spec, self._spec.accuracy if self.uses_tree else 0.0
        constants = spec.gravity_constant, spec.softening, accuracy
        return MutualGravity(*_kernels.gravity(x, self.bodies.masses, *constants))

    def _forces(self, sums: MutualGravity) -> FloatArray:
        return sums.accelerations

    def external_effect(
        self, attractor: AttractorModel, position: FloatArray, x: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Return accelerations ``(N, 3)`` [m/s²] and potentials ``(N,)`` [J/kg]."""
        offsets = position - x
        distances = np.sqrt((offsets * offsets).sum(axis=1) + attractor.softening**2)
        distances = np.maximum(distances, 1e-300)
        potentials = self._spec.gravity_constant * attractor.mass / distances
        return (potentials / distances**2)[:, None] * offsets, -potentials

    def suspected_cause(self, x: FloatArray, sums: MutualGravity) -> str:
        """Return the pair of bodies with the fastest orbit, as text for messages."""
        return self._fastest_pair(x, sums.rates)[1] if len(x) > 1 else ""

    def _fastest_pair(self, x: FloatArray, rates: FloatArray) -> tuple[float, str]:
        """Return the mass [kg] and a description of the pair with the fastest orbit."""
        masses, i = self.bodies.masses, int(np.argmax(rates))
        squared_distances = ((x - x[i]) ** 2).sum(axis=1)
        cubed_distances = (
            np.maximum(squared_distances + self._spec.softening**2, 1e-200) ** 1.5
        )
        pair_rates = (masses + masses[i]) / cubed_distances
        pair_rates[i] = -1.0
        j = int(np.argmax(pair_rates))
        names_text = f"bodies {min(i, j)} and {max(i, j)}"
        return masses[i] + masses[
            j
        ], f"{names_text} are {math.sqrt(squared_distances[j]):.3g} m apart"

    @np.errstate(all="ignore")
    def step(self, state: NbodyState, t: float, dt: float) -> NbodyState:
        """Return the state after a step [s].

        The step is split into substeps if two bodies come too close for one step.
        """
        substep_count = self._required_substeps(state.gravity.rates, dt)
        encounter = CloseEncounterError(t, state.motion[0], state.gravity.rates)
        while substep_count <= self._spec.substeps:
            max_squared_rate, step = math.inf, dt
            if self._has_fixed_steps:
                max_squared_rate = (
                    RATE_TOLERANCE * self._max_phase * substep_count / dt
                ) ** 2
                step = dt / substep_count
            system = self._system(state, partial(_check_closest_pair, max_squared_rate))
            try:
                motion = self._integrate(system, t, dt, step)
            except CloseEncounterError as error:
                substep_count, encounter = 2 * substep_count, error
                continue
            encounters = state.encounters + (substep_count > 1)
            max_substeps = max(state.divided, substep_count)
            next_state = NbodyState(
                motion, system.sums_at(motion[0]), encounters, max_substeps
            )
            self._check_energy(next_state, t + dt)
            return next_state
        raise self._encounter_error(dt, *encounter.args)

    def _required_substeps(self, rates: FloatArray, dt: float) -> int:
        """Return the substep count that resolves the closest pair, a power of two."""
        if not self._has_fixed_steps or not len(rates):
            return 1
        # A state from a file may hold any rates.
        phase_ratio = dt * math.sqrt(max(float(rates.max()), 0.0)) / self._max_phase
        if not phase_ratio < self._spec.substeps:
            return 2 * int(self._spec.substeps)
        return 1 << max(math.ceil(math.log2(phase_ratio)), 0) if phase_ratio > 1 else 1

    def _encounter_error(
        self, dt: float, t: float, x: FloatArray, rates: FloatArray
    ) -> StoppedError:
        """Return an error if the finest substeps do not resolve a pair."""
        mass, pair_text = self._fastest_pair(x, rates)
        max_substeps = self._spec.substeps
        message = f"{pair_text} at {t:.6g} s, too close for steps of "
        message += f"{dt / max_substeps:.3g} s"
        max_rate = (MAX_STEP_PHASE * max_substeps / dt) ** 2
        softening_length = (self._spec.gravity_constant * mass / max_rate) ** (1 / 3)
        hint = f"use softening: {1.05 * softening_length:.3g}, or more substeps"
        return StoppedError([Fault("SIM110", message, hint=hint)])

    def _exchanged_energy(self, state: NbodyState, energy: Energy) -> float:  # noqa: ARG002
        return energy.kinetic

    def _suggested_step(self, state: NbodyState, t: float) -> float:
        x, masses = state.motion[0], self.bodies.masses
        accelerations = (
            state.gravity.accelerations + self.external_accelerations(t, x)[0]
        )
        centre = masses @ x / masses.sum()
        distances = np.maximum(np.linalg.norm(x - centre, axis=1), self._spec.softening)
        magnitudes = np.maximum(np.linalg.norm(accelerations, axis=1), 1e-300)
        return RECOMMENDED_STEP * float(np.sqrt(distances / magnitudes).min())

    def _potential(self, state: NbodyState, t: float) -> float:
        masses, x = self.bodies.masses, state.motion[0]
        external = float(masses @ self.external_accelerations(t, x)[1])
        return 0.5 * float(masses @ state.gravity.potentials) + external

    def _momenta(self, state: NbodyState) -> FloatArray:
        """Return total linear and angular momentum ``(2, 3)``."""
        x, v = state.motion
        momenta = self.bodies.masses[:, None] * v
        return np.stack([momenta.sum(axis=0), np.cross(x, momenta).sum(axis=0)])

    def _quantities(self, state: NbodyState, t: float) -> Quantities:
        (x, v), gravity = state.motion, state.gravity
        external, potentials = self.external_accelerations(t, x)
        return {
            **super()._quantities(state, t),
            "energy": lambda: (v * v).sum(axis=1) / 2 + gravity.potentials + potentials,
            "acceleration": lambda: np.linalg.norm(
                gravity.accelerations + external, axis=1
            ),
        }

    def _report_values(self, state: NbodyState, t: float) -> Mapping[str, float]:
        """Return drifts of conserved quantities, substeps, and the force error."""
        x, v = state.motion
        values = {"bodies": float(len(x)), "encounters": float(state.encounters)}
        values["substeps"] = float(state.divided)
        if not self.external_forces:
            values["energy_drift"] = self._energy_drift(state, self._energy(state, t))
            momentum_magnitudes = self.bodies.masses * np.linalg.norm(v, axis=1)
            angular_scale = momentum_magnitudes @ np.linalg.norm(x, axis=1)
            scales = np.maximum([momentum_magnitudes.sum(), angular_scale], 1e-300)
            momentum_change = self._momenta(state) - self._momenta(self.initial_state())
            drifts = np.linalg.norm(momentum_change, axis=1) / scales
            values["momentum_drift"], values["angular_momentum_drift"] = drifts.tolist()
        if self.uses_tree:
            values["force_error"] = self._force_error(x, state.gravity)
        return values

    def _force_error(self, x: FloatArray, gravity: MutualGravity) -> float:
        """Return the relative force error of the tree, from sampled bodies [1]."""
        sampled_bodies = np.linspace(0, len(x) - 1, ERROR_SAMPLES).astype(int)
        exact_accelerations = np.array(
            [self._direct_sum(x, x[i]) for i in sampled_bodies]
        )
        errors = np.linalg.norm(
            gravity.accelerations[sampled_bodies] - exact_accelerations, axis=1
        )
        magnitudes = np.maximum(np.linalg.norm(exact_accelerations, axis=1), 1e-300)
        return float(np.sqrt(((errors / magnitudes) ** 2).mean()))

    def _direct_sum(self, x: FloatArray, position: FloatArray) -> FloatArray:
        """Return the acceleration at a position by direct summation ``(3,)``."""
        offsets = x - position
        squared_distances = (offsets * offsets).sum(axis=1)
        squared_distances = np.where(
            squared_distances > 0, squared_distances + self._spec.softening**2, np.inf
        )
        weights = self.bodies.masses / (squared_distances * np.sqrt(squared_distances))
        return np.asarray(self._spec.gravity_constant * weights @ offsets)
