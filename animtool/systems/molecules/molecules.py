"""Molecular dynamics: steps, thermostat, temperature, pressure and energy."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any, TypeAlias

import numpy as np

from animtool import _kernels
from animtool.core.array_types import FloatArray
from animtool.core.errors import Fault, RefusalCollector, ToleranceError, refuse
from animtool.core.record import dataclass
from animtool.systems.framework.colours import Quantities
from animtool.systems.framework.interacting import Interacting
from animtool.systems.framework.matter import normal_samples
from animtool.systems.framework.simulation import SimContext, StoppedError
from animtool.systems.molecules.atoms import (
    BOLTZMANN_CONSTANT,
    COULOMB_CONSTANT,
    Atoms,
    PeriodicBox,
    pair_coefficients,
)
from animtool.systems.molecules.spec import MoleculesModel, ThermostatModel, TrapModel
from animtool.systems.particles.emitter import uniform_samples

# Pressure of 1 kJ/(mol nm³) [MPa].
MEGAPASCALS_PER_UNIT = 1.66053906717
# Pair energy, relative to the well depth, above which atoms overlap at the start.
OVERLAP_ENERGY = 1000.0
# Largest and recommended step, relative to 1/ω of the stiffest crystal.
MAX_STEP, RECOMMENDED_STEP = 1.0, 0.1
# Offset of the seed for the thermostat.
_THERMOSTAT_SEED = 2000
# Largest motion of an atom in a step, relative to the box.
MAX_STEP_TRAVEL = 0.25
# Largest mean number of neighbours; no real matter is denser.
MAX_NEIGHBOURS = 5000


@dataclass(frozen=True, slots=True)
class AtomForces:
    """Forces, energies and virial of N atoms."""

    forces: FloatArray  # (N, 3) [kJ/(mol nm)]
    energies: FloatArray  # half the energy of each atom's pairs (N,) [kJ/mol]
    virial: float  # sum of forces times distances [kJ/mol]


class Interactions:
    """Computes pair forces of atoms, with a cached neighbour list."""

    def __init__(self, spec: MoleculesModel, atoms: Atoms, box: PeriodicBox) -> None:
        self._atoms, self._box = atoms, box
        self._pair_coefficients = pair_coefficients(spec)
        self._cutoff = min(spec.cutoff_distance, box.size.min() / 2)
        switch_distance = 0.9 * self._cutoff if spec.switch is None else spec.switch
        self._switch_distance = min(switch_distance, self._cutoff)
        self._skin = max(min(spec.skin, box.size.min() / 2 - self._cutoff), 0.0)
        has_charges = bool(atoms.charges.any())
        self._charges = (
            atoms.charges * np.sqrt(COULOMB_CONSTANT) if has_charges else None
        )
        self._damping = spec.damping
        self._neighbour_list: tuple[FloatArray, Any] | None = None

    def self_energy(self) -> float:
        """Return the Ewald self energy of the charges [kJ/mol]."""
        from scipy.special import erfc

        if self._charges is None:
            return 0.0
        screened_potential = erfc(self._damping * self._cutoff) / (2 * self._cutoff)
        energy_per_charge = screened_potential + self._damping / np.sqrt(np.pi)
        return -float(energy_per_charge * (self._charges**2).sum())

    def valid_reference(self, x: FloatArray, reference: FloatArray) -> FloatArray:
        """Return ``reference`` if its neighbour list is valid at ``x``, else ``x``."""
        squared_distances = ((x - reference) ** 2).sum(axis=1)
        return (
            reference
            if squared_distances.max(initial=0.0) <= (self._skin / 2) ** 2
            else x
        )

    def forces_at(self, x: FloatArray, reference: FloatArray) -> AtomForces:
        """Return the forces on atoms, with the neighbour list of ``reference``.

        Both positions are ``(N, 3)`` [nm].
        """
        if self._neighbour_list is None or self._neighbour_list[0] is not reference:
            max_pairs = MAX_NEIGHBOURS * len(x)
            try:
                pairs = _kernels.molecule_pairs(
                    reference, self._box.size, self._cutoff + self._skin, max_pairs
                )
            except ValueError as error:
                message = f"atoms overlap: {error}"
                raise ToleranceError(Fault("SIM102", message)) from error
            self._neighbour_list = reference, pairs
        order, partner_starts, partners = self._neighbour_list[1]
        sums = _kernels.molecule_forces(
            x, order, partner_starts, partners, self._box.size,
            self._atoms.entry_indices, self._pair_coefficients, self._charges,
            self._cutoff, self._switch_distance, self._damping,
        )  # fmt: skip
        return AtomForces(*sums)


@dataclass(frozen=True, slots=True)
class MoleculeState:
    """State of atoms, with the forces on them."""

    motion: FloatArray  # positions [nm], then velocities [nm/ps] (2, N, 3)
    reference: FloatArray  # positions at which the neighbour list was built (N, 3) [nm]
    acting: AtomForces  # forces at these positions
    heat: float  # energy from the thermostat so far [kJ/mol]
    steps: int  # number of steps so far


# Forces, and the positions at which the neighbour list was built.
ListedForces: TypeAlias = tuple[AtomForces, FloatArray]


@np.errstate(all="ignore")
def build(spec: MoleculesModel, context: SimContext) -> Molecules:
    """Build the atoms of a spec; raise SIM001, SIM005, SIM006, SIM071 if invalid."""
    box = PeriodicBox(spec)
    atoms = Atoms.from_spec(spec, context.entry_data["species"], box)
    molecules = Molecules(spec, context, box, atoms)
    molecules.finish_setup()
    return molecules


class Molecules(Interacting[MoleculeState, ListedForces]):
    """Simulates atoms in a periodic box.

    Attributes:
        atoms: Atoms of all species.
    """

    unit = "kJ/mol"

    def __init__(
        self,
        spec: MoleculesModel,
        context: SimContext,
        periodic_box: PeriodicBox,
        atoms: Atoms,
    ) -> None:
        super().__init__(spec, context, "traps", spec.pace)
        self.bodies = self.atoms = atoms
        self.radii, self.species = self.atoms.radii, self.atoms.entry_indices
        self.has_many_species = len(spec.species) > 1
        self.inertia = self.atoms.masses[:, None]
        self.written_indices = np.arange(len(self.species))
        self._periodic_box, self.box = periodic_box, periodic_box.size
        self._interactions = Interactions(spec, self.atoms, periodic_box)
        self._degrees_of_freedom = max(3 * len(self.bodies.masses) - 3, 1)
        squared_frequencies = [
            57.15 * a.epsilon / a.sigma**2 / a.mass for a in spec.species
        ]
        # The fastest crystal vibration of all species [rad/ps].
        self._max_frequency = math.sqrt(8 * max(squared_frequencies))

    def finish_setup(self) -> None:
        """Check the initial state, and set colour ranges from that state."""
        initial_state, refusals = self.initial_state(), RefusalCollector()
        with refusals.collect():
            self._check_numbers(initial_state)
        with refusals.collect():
            self._check_distinct(initial_state)
        refusals.check()
        super().finish_setup()

    def _check_numbers(self, initial_state: MoleculeState) -> None:
        """Raise SIM071 if the step is too long, or numbers overflow in the scene."""
        spec, step = self._spec, self._spec.step * self._spec.pace
        if step * self._max_frequency > MAX_STEP:
            message = f"a step of {step:.3g} ps is too long: the fastest vibration "
            message += f"has a period of {2 * math.pi / self._max_frequency:.3g} ps"
            suggested_step = self._suggested_step(initial_state)
            hint = f"use 'step: {suggested_step:.2g}', or a lower pace"
            refuse(spec.code, message, "step", hint)
        if not np.isfinite(self._to_scene(initial_state.motion)).all():
            message = "atoms are so far away or fast in the scene that numbers overflow"
            refuse(spec.code, message, "scale")

    def _check_distinct(self, initial_state: MoleculeState) -> None:
        """Raise SIM071 if atoms overlap at the start."""
        well_depth = max(*(species.epsilon for species in self._spec.species), 1e-3)
        energies = initial_state.acting.energies
        if (energies < OVERLAP_ENERGY * well_depth).all():  # NaN is not
            return
        from scipy.spatial import cKDTree

        size = self._periodic_box.size
        x = initial_state.motion[0] % size
        distances, neighbours = cKDTree(x % size, boxsize=size).query(x, 2)
        i = int(np.argmin(distances[:, 1]))
        first_atom, second_atom = sorted(neighbours[i].tolist())
        message = (
            f"atoms {first_atom} and {second_atom} start {distances[i, 1]:.3g} nm apart"
        )
        hint = "move one of them, or use a larger box"
        refuse(self._spec.code, message, "species", hint)

    def _build_initial_state(self, motion: FloatArray) -> MoleculeState:
        points = motion[0]
        forces = self._interactions.forces_at(points, points)
        return MoleculeState(motion, points, forces, 0.0, 0)

    def _state_sums(self, state: MoleculeState) -> ListedForces:
        return state.acting, state.reference

    def compute_sums(self, x: FloatArray, last_sums: ListedForces) -> ListedForces:
        """Return the forces on atoms, and their neighbour list's reference positions.

        All positions are ``(N, 3)`` [nm].
        """
        reference = self._interactions.valid_reference(x, last_sums[1])
        return self._interactions.forces_at(x, reference), reference

    def _forces(self, sums: ListedForces) -> FloatArray:
        return sums[0].forces

    def external_effect(
        self, trap: TrapModel, position: FloatArray, x: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Return forces ``(N, 3)`` [kJ/(mol nm)] and energies ``(N,)`` of a trap."""
        size = self._periodic_box.size
        offsets = self._periodic_box.to_local(position) - x
        offsets -= size * np.round(offsets / size)
        squared_distances = (offsets * offsets).sum(axis=1)
        proximity = np.maximum(1 - squared_distances / trap.radius**2, 0.0)
        force = (trap.stiffness * proximity**2)[:, None] * offsets
        return force, -(trap.stiffness * trap.radius**2 / 6 * proximity**3)

    @np.errstate(all="ignore")
    def step(self, state: MoleculeState, t: float, dt: float) -> MoleculeState:
        """Return the state after a full or partial step [s]."""
        spec, system = self._spec, self._system(state)
        try:
            motion = self._integrate(system, t, dt, dt)
        except StoppedError as error:
            hint = f"use step: {self._suggested_step(state):.2g}"
            faults = [replace(fault, hint=hint) for fault in error.faults]
            raise StoppedError(faults, error.stats) from None
        distances = np.sqrt((motion[1] * motion[1]).sum(axis=1)) * dt * spec.pace
        fastest_atom = int(np.argmax(distances))
        if (
            not distances[fastest_atom]
            <= MAX_STEP_TRAVEL * self._periodic_box.size.min()
        ):
            reason = (
                f"atom {fastest_atom} moves {distances[fastest_atom]:.3g} nm in a step"
            )
            self._stop(state, t + dt, reason)
        (forces, reference), heat = system.sums_at(motion[0]), state.heat
        if spec.thermostat is not None:
            kinetic = self._kinetic_energy(motion)
            factor = thermostat_factor(
                spec.thermostat,
                spec.seed,
                state.steps,
                t + dt,
                dt * spec.pace,
                kinetic,
                self._degrees_of_freedom,
            )
            motion = np.stack([motion[0], factor * motion[1]])
            heat += (factor**2 - 1) * kinetic
        next_state = MoleculeState(motion, reference, forces, heat, state.steps + 1)
        self._check_energy(next_state, t + dt)
        return next_state

    def _bath_energy(self, state: MoleculeState) -> float:
        return state.heat

    def _suggested_step(self, state: MoleculeState, t: float = 0.0) -> float:  # noqa: ARG002
        return RECOMMENDED_STEP / max(self._max_frequency * self._time_scale, 1e-300)

    def _potential(self, state: MoleculeState, t: float) -> float:
        interaction_energy = (
            float(state.acting.energies.sum()) + self._interactions.self_energy()
        )
        external_energies = self.external_accelerations(t, state.motion[0])[1]
        return interaction_energy + float(external_energies.sum())

    def _to_scene(self, motion: FloatArray) -> FloatArray:
        x, v = motion
        periodic_box = self._periodic_box
        return np.stack([periodic_box.to_scene(x), periodic_box.velocities_to_scene(v)])

    def _quantities(self, state: MoleculeState, t: float) -> Quantities:
        energies = state.acting.energies
        squared_speeds = (state.motion[1] ** 2).sum(axis=1)
        return {
            **super()._quantities(state, t),
            "temperature": lambda: (
                self.bodies.masses * squared_speeds / (3 * BOLTZMANN_CONSTANT)
            ),
            "energy": lambda: 0.5 * self.bodies.masses * squared_speeds + energies,
        }

    def _report_values(self, state: MoleculeState, t: float) -> Mapping[str, float]:
        """Return temperature [K], pressure [MPa] and energies [kJ/mol]."""
        energy, volume = self._energy(state, t), float(self._periodic_box.size.prod())
        pressure = (2 * energy.kinetic + state.acting.virial) / (3 * volume)
        values = {
            "atoms": float(len(self.bodies.masses)),
            "temperature": 2
            * energy.kinetic
            / (self._degrees_of_freedom * BOLTZMANN_CONSTANT),
            "pressure": pressure * MEGAPASCALS_PER_UNIT,
            "kinetic_energy": energy.kinetic,
            "potential_energy": energy.potential,
        }
        if not self._is_driven:
            values["energy_drift"] = self._energy_drift(state, energy)
        return values


def thermostat_factor(
    model: ThermostatModel,
    seed: int,
    step: int,
    t: float,
    dt: float,
    kinetic_energy: float,
    degrees_of_freedom: int,
) -> float:
    """Return the velocity scale factor of one thermostat step.

    Reference: G. Bussi, D. Donadio, M. Parrinello, Canonical sampling through velocity
    rescaling, Journal of Chemical Physics 126, 2007, equation A7.

    Random numbers depend on the seed and on the index of the step, which ends at ``t``
    [s] and takes ``dt`` [ps]. ``kinetic_energy`` is the kinetic energy [kJ/mol].
    """
    from scipy.special import gammaincinv

    if not kinetic_energy > 0 or degrees_of_freedom < 1:
        return 1.0
    times, temperatures = np.array(model.temperatures).T
    target_energy = BOLTZMANN_CONSTANT * float(np.interp(t, times, temperatures)) / 2
    random_numbers = uniform_samples(seed + _THERMOSTAT_SEED, np.array([step]), 2)[0]
    random, second_random = np.clip(random_numbers, 2.0**-53, 1 - 2.0**-53)
    normal = float(normal_samples(random))
    # Sum of squares of the other normal samples.
    other_squares = 0.0
    if degrees_of_freedom > 1:
        other_squares = 2 * float(
            gammaincinv((degrees_of_freedom - 1) / 2, second_random)
        )
    decay = float(np.exp(-dt / model.relaxation))
    exchanged_fraction = target_energy / kinetic_energy * (1 - decay)
    squared_factor = decay + exchanged_fraction * (normal**2 + other_squares)
    squared_factor += 2 * normal * np.sqrt(decay * exchanged_fraction)
    factor = float(np.sqrt(max(squared_factor, 0.0)))
    is_reversed = normal * np.sqrt(exchanged_fraction) + np.sqrt(decay) < 0
    return -factor if is_reversed else factor
