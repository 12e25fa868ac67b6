"""Atoms: species, initial positions and velocities."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from animtool.core.array_types import FloatArray
from animtool.core.errors import Refusals, refuse
from animtool.core.record import dataclass
from animtool.systems.framework.matter import PointMasses, UnitFrame, normal_samples
from animtool.systems.molecules.spec import MoleculesModel
from animtool.systems.particles.emitter import uniforms

# Boltzmann's constant [kJ/(mol K)].
BOLTZMANN = 0.00831446261815324
# Coulomb constant [kJ nm/(mol e²)].
COULOMB = 138.935457644
# Smaller total charges count as neutral [e].
CHARGE_TOLERANCE = 1e-9
# Largest number of lattice sites per atom.
MAX_SITES_PER_ATOM = 64
# Seed offset of velocities.
_VELOCITY_SEED = 1000
_FCC_SITES = np.array([[0, 0, 0], [0, 0.5, 0.5], [0.5, 0, 0.5], [0.5, 0.5, 0]]) + 0.25


class PeriodicBox:
    """The periodic box: local units are nm and ps, scene units m and s."""

    def __init__(self, spec: MoleculesModel) -> None:
        self.size = np.array(spec.box)  # (3,) [nm]
        self._frame = UnitFrame.of(spec, spec.scale, spec.pace)
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
    """N atoms in the box, in nm, ps and u."""

    kinds: npt.NDArray[np.int32]  # (N,)
    charges: FloatArray  # (N,) [e]
    radii: FloatArray  # (N,) [m]

    @staticmethod
    def of(
        spec: MoleculesModel, parts: Sequence[Mapping[str, Any]], box: PeriodicBox
    ) -> Atoms:
        """Return the atoms of a spec; invalid ones are refused (SIM071)."""
        motions, refusals = [], Refusals()
        for model, part in zip(spec.species, parts, strict=True):
            with refusals.collect():
                motions.append(_read(model, part, box))
        refusals.check()
        on_lattice = [k for k, (points, _) in enumerate(motions) if points is None]
        sites = _lattice_sites(spec, [spec.species[k].count for k in on_lattice])
        for k, site in zip(on_lattice, sites, strict=True):
            motions[k] = site, motions[k][1]
        points = [np.zeros((0, 3)) if p is None else p for p, _ in motions]
        kinds = np.repeat(np.arange(len(points)), [len(site) for site in points])

        def by_atom(values: list[float]) -> FloatArray:
            return np.array(values, np.float64)[kinds]

        masses = by_atom([species.mass for species in spec.species])
        atoms = Atoms(
            np.concatenate(points),
            _initial_velocities(spec, masses, kinds, [v for _, v in motions]),
            masses,
            kinds.astype(np.int32),
            by_atom([species.charge for species in spec.species]),
            by_atom(
                [
                    species.radius or species.sigma / 2 * spec.scale
                    for species in spec.species
                ]
            ),
        )
        total = float(atoms.charges.sum())
        if abs(total) > CHARGE_TOLERANCE:
            message = f"charges have a sum of {total:g} e, but a periodic box must be "
            message += "neutral"
            refuse(spec.code, message, "species", "use as many of either sign")
        return atoms


def _read(
    model: Any, parts: Mapping[str, Any], box: PeriodicBox
) -> tuple[FloatArray | None, FloatArray | None]:
    """Return positions [nm] and velocities [nm/ps] of files; None if absent."""
    points, velocities = parts.get("points"), parts.get("velocities")
    if points is None:
        if velocities is not None:
            message = "velocities need points"
            refuse(MoleculesModel.code, message, "species")
        return None, None
    kind = f"{model.name!r}, atom"
    bodies = PointMasses.read(parts, model.mass, kind, MoleculesModel.code, "species")
    x = box.to_local(points)
    tolerance = 1e-9 * box.size
    outside = ~((x >= -tolerance) & (x <= box.size + tolerance)).all(axis=1)
    if outside.any():
        i = int(np.argmax(outside))
        where = ", ".join(f"{value:g}" for value in points[i])
        message = f"atom {i} of {model.name!r} is outside the box, at ({where}) m"
        hint = "a nanometre is `scale` metres; `at` is the centre"
        refuse(MoleculesModel.code, message, "species", hint)
    return x, None if velocities is None else box.velocities_to_local(bodies.velocities)


def _lattice_sites(spec: MoleculesModel, counts: list[int]) -> list[FloatArray]:
    """Return lattice sites for each species ``(N, 3)`` [nm]."""
    total = sum(counts)
    if not total:
        return []
    size = np.array(spec.block or spec.box)
    basis = _FCC_SITES if spec.lattice == "fcc" else np.full((1, 3), 0.5)
    spacing = (len(basis) * size.prod() / total) ** (1 / 3)
    shape = np.maximum(np.round(size / spacing), 1)
    if not len(basis) * shape.prod() <= MAX_SITES_PER_ATOM * total + MAX_SITES_PER_ATOM:
        message = f"{total} atoms do not fill a lattice in a box of {size.tolist()} nm"
        refuse(spec.code, message, "box", "use more equal sides")
    cells = shape.astype(np.int64)
    while len(basis) * cells.prod() < total:
        cells[np.argmax(size / cells)] += 1
    corners = np.stack(
        np.meshgrid(*[np.arange(n) for n in cells], indexing="ij"), axis=-1
    ).reshape(-1, 3)
    sites = (corners[:, None] + basis).reshape(-1, 3)
    # If there are more sites than atoms, atoms are spread over them evenly.
    indices = np.arange(total) * len(sites) // total
    order = np.arange(total)
    if len(counts) > 1 and spec.lattice == "fcc":
        order = np.argsort(
            uniforms(spec.seed, np.arange(total), 1)[:, 0], kind="stable"
        )
    elif len(counts) > 1:
        parity = corners[indices].sum(axis=1) % 2
        order = np.argsort(parity, kind="stable")
    points = sites[indices][order] / cells * size + (np.array(spec.box) - size) / 2
    return np.split(points, np.cumsum(counts)[:-1])


def _initial_velocities(
    spec: MoleculesModel,
    masses: FloatArray,
    kinds: npt.NDArray[np.int64],
    from_files: list[FloatArray | None],
) -> FloatArray:
    """Return velocities from files or thermal ones, without net momentum ``(N, 3)``."""
    is_thermal = np.array([file_velocities is None for file_velocities in from_files])[
        kinds
    ]
    velocities = np.zeros((len(masses), 3))
    for k, values in enumerate(from_files):
        if values is not None:
            velocities[kinds == k] = values
    count = int(is_thermal.sum())
    if count < 2 or not spec.temperature:
        return velocities
    u = uniforms(spec.seed + _VELOCITY_SEED, np.flatnonzero(is_thermal), 3)
    m = masses[is_thermal][:, None]
    v = normal_samples(u) / np.sqrt(m)
    v -= (m * v).sum(axis=0) / m.sum()
    square = float((m * v * v).sum()) / (3 * count - 3)
    velocities[is_thermal] = v * np.sqrt(BOLTZMANN * spec.temperature / square)
    return velocities


def pair_coefficients(spec: MoleculesModel) -> FloatArray:
    """Return c12 [kJ nm¹²/mol] and c6 of two species (Lorentz-Berthelot rules)."""
    sigma = np.array([species.sigma for species in spec.species])
    epsilon = np.array([species.epsilon for species in spec.species])
    sigmas = (sigma[:, None] + sigma) / 2
    depth = 4 * np.sqrt(epsilon[:, None] * epsilon)
    return np.ascontiguousarray(
        np.stack([depth * sigmas**12, depth * sigmas**6], axis=-1)
    )
