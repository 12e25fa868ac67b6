"""Atoms: species, initial positions and velocities."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from animtool.core.array_types import FloatArray
from animtool.core.errors import RefusalCollector, refuse
from animtool.core.record import dataclass
from animtool.systems.framework.matter import PointMasses, UnitFrame, normal_samples
from animtool.systems.molecules.spec import MoleculesModel
from animtool.systems.particles.emitter import uniform_samples

# Boltzmann's constant [kJ/(mol K)].
BOLTZMANN_CONSTANT = 0.00831446261815324
# Coulomb constant [kJ nm/(mol e²)].
COULOMB_CONSTANT = 138.935457644
# Largest total charge of a neutral system [e].
CHARGE_TOLERANCE = 1e-9
# Largest number of lattice sites per atom.
MAX_SITES_PER_ATOM = 64
# Offset of the seed for velocities.
_VELOCITY_SEED = 1000
_FCC_SITES = np.array([[0, 0, 0], [0, 0.5, 0.5], [0.5, 0, 0.5], [0.5, 0.5, 0]]) + 0.25


class PeriodicBox:
    """The periodic box, with local units of nm and ps in a scene of m and s."""

    def __init__(self, spec: MoleculesModel) -> None:
        self.size = np.array(spec.box)  # (3,) [nm]
        self._frame = UnitFrame.from_placement(spec, spec.scale, spec.pace)
        self.velocities_to_local = self._frame.velocities_to_local
        self.velocities_to_scene = self._frame.velocities_to_scene

    def to_local(self, points: FloatArray) -> FloatArray:
        """Transform scene points [m] to the box [nm]."""
        return self._frame.to_local(points) + self.size / 2

    def to_scene(self, x: FloatArray) -> FloatArray:
        """Transform box points [nm] to the scene [m], wrapped into the box."""
        x = x - self.size * np.floor(x / self.size)
        return self._frame.to_scene(x - self.size / 2)


@dataclass(frozen=True, slots=True)
class Atoms(PointMasses):
    """N atoms in the box, in units of nm, ps and u."""

    entry_indices: npt.NDArray[np.int32]  # (N,)
    charges: FloatArray  # (N,) [e]
    radii: FloatArray  # (N,) [m]

    @staticmethod
    def from_spec(
        spec: MoleculesModel,
        species_data: Sequence[Mapping[str, Any]],
        box: PeriodicBox,
    ) -> Atoms:
        """Return the atoms of a spec; raise SIM071 if they are invalid."""
        initial_motions, refusals = [], RefusalCollector()
        for model, atom_data in zip(spec.species, species_data, strict=True):
            with refusals.collect():
                initial_motions.append(_read_motion(model, atom_data, box))
        refusals.check()
        lattice_species = [
            k for k, (points, _) in enumerate(initial_motions) if points is None
        ]
        sites = _lattice_sites(spec, [spec.species[k].count for k in lattice_species])
        for k, site in zip(lattice_species, sites, strict=True):
            initial_motions[k] = site, initial_motions[k][1]
        points = [np.zeros((0, 3)) if p is None else p for p, _ in initial_motions]
        species_indices = np.repeat(
            np.arange(len(points)), [len(site) for site in points]
        )

        def atom_values(species_values: list[float]) -> FloatArray:
            return np.array(species_values, np.float64)[species_indices]

        radii = [atom.radius or atom.sigma / 2 * spec.scale for atom in spec.species]
        masses = atom_values([species.mass for species in spec.species])
        atoms = Atoms(
            np.concatenate(points),
            _initial_velocities(
                spec, masses, species_indices, [v for _, v in initial_motions]
            ),
            masses,
            species_indices.astype(np.int32),
            atom_values([species.charge for species in spec.species]),
            atom_values(radii),
        )
        total_charge = float(atoms.charges.sum())
        if abs(total_charge) > CHARGE_TOLERANCE:
            message = (
                f"charges have a sum of {total_charge:g} e, but a periodic box must be "
            )
            message += "neutral"
            signs = (
                ("positive", "negative")
                if total_charge > 0
                else ("negative", "positive")
            )
            hint = f"use less {signs[0]} or more {signs[1]} charge, until they cancel"
            refuse(spec.code, message, "species", hint)
        return atoms


def _read_motion(
    model: Any, arrays: Mapping[str, Any], box: PeriodicBox
) -> tuple[FloatArray | None, FloatArray | None]:
    """Return positions [nm] and velocities [nm/ps] from files, or None."""
    points, velocities = arrays.get("points"), arrays.get("velocities")
    if points is None:
        if velocities is not None:
            message = "velocities need points"
            refuse(MoleculesModel.code, message, "species")
        return None, None
    atom_label = f"{model.name!r}, atom"
    point_masses = PointMasses.read(
        arrays, model.mass, atom_label, MoleculesModel.code, "species"
    )
    x = box.to_local(points)
    tolerance = 1e-9 * box.size
    is_outside = ~((x >= -tolerance) & (x <= box.size + tolerance)).all(axis=1)
    if is_outside.any():
        i = int(np.argmax(is_outside))
        position_text = ", ".join(f"{value:g}" for value in points[i])
        message = (
            f"atom {i} of {model.name!r} is outside the box, at ({position_text}) m"
        )
        hint = "a nanometre is `scale` metres; `at` is the centre"
        refuse(MoleculesModel.code, message, "species", hint)
    if velocities is None:
        return x, None
    return x, box.velocities_to_local(point_masses.velocities)


def _lattice_sites(spec: MoleculesModel, counts: list[int]) -> list[FloatArray]:
    """Return the lattice sites of the atoms of each species ``(N, 3)`` [nm]."""
    atom_count = sum(counts)
    if not atom_count:
        return []
    lattice_size = np.array(spec.block or spec.box)
    cell_sites = _FCC_SITES if spec.lattice == "fcc" else np.full((1, 3), 0.5)
    spacing = (len(cell_sites) * lattice_size.prod() / atom_count) ** (1 / 3)
    shape = np.maximum(np.round(lattice_size / spacing), 1)
    max_sites = MAX_SITES_PER_ATOM * atom_count + MAX_SITES_PER_ATOM
    if not len(cell_sites) * shape.prod() <= max_sites:
        message = f"{atom_count} atoms do not fill a lattice in a box of "
        message += f"{lattice_size.tolist()} nm"
        refuse(spec.code, message, "box", "use more equal sides")
    cell_counts = shape.astype(np.int64)
    while len(cell_sites) * cell_counts.prod() < atom_count:
        cell_counts[np.argmax(lattice_size / cell_counts)] += 1
    cell_corners = np.indices(cell_counts).reshape(3, -1).T
    sites = (cell_corners[:, None] + cell_sites).reshape(-1, 3)
    # If there are more sites than atoms, atoms are spread over them evenly.
    site_indices = np.arange(atom_count) * len(sites) // atom_count
    order = np.arange(atom_count)
    if len(counts) > 1 and spec.lattice == "fcc":
        random_numbers = uniform_samples(spec.seed, np.arange(atom_count), 1)[:, 0]
        order = np.argsort(random_numbers, kind="stable")
    elif len(counts) > 1:
        cell_parities = cell_corners[site_indices].sum(axis=1) % 2
        order = np.argsort(cell_parities, kind="stable")
    points = (
        sites[site_indices][order] / cell_counts * lattice_size
        + (np.array(spec.box) - lattice_size) / 2
    )
    return np.split(points, np.cumsum(counts)[:-1])


def _initial_velocities(
    spec: MoleculesModel,
    masses: FloatArray,
    species_indices: npt.NDArray[np.int64],
    velocities_from_files: list[FloatArray | None],
) -> FloatArray:
    """Return velocities from files, or thermal ones without momentum ``(N, 3)``."""
    is_thermal = np.array([values is None for values in velocities_from_files])[
        species_indices
    ]
    velocities = np.zeros((len(masses), 3))
    for k, values in enumerate(velocities_from_files):
        if values is not None:
            velocities[species_indices == k] = values
    count = int(is_thermal.sum())
    if count < 2 or not spec.temperature:
        return velocities
    u = uniform_samples(spec.seed + _VELOCITY_SEED, np.flatnonzero(is_thermal), 3)
    m = masses[is_thermal][:, None]
    v = normal_samples(u) / np.sqrt(m)
    v -= (m * v).sum(axis=0) / m.sum()
    mean_square = float((m * v * v).sum()) / (3 * count - 3)
    velocities[is_thermal] = v * np.sqrt(
        BOLTZMANN_CONSTANT * spec.temperature / mean_square
    )
    return velocities


def pair_coefficients(spec: MoleculesModel) -> FloatArray:
    """Return c12 [kJ nm¹²/mol] and c6 [kJ nm⁶/mol] of each pair of species.

    Lorentz-Berthelot rules combine two species.
    """
    sigma = np.array([species.sigma for species in spec.species])
    epsilon = np.array([species.epsilon for species in spec.species])
    sigmas = (sigma[:, None] + sigma) / 2
    well_depths = 4 * np.sqrt(epsilon[:, None] * epsilon)
    repulsion, attraction = well_depths * sigmas**12, well_depths * sigmas**6
    return np.ascontiguousarray(np.stack([repulsion, attraction], axis=-1))
