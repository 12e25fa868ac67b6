"""What atoms do to each other, by lists of neighbours, as integrators see it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from animtool import _kernels
from animtool._types import FloatArray
from animtool.errors import Fault, ToleranceError
from animtool.systems.interacting import Law
from animtool.systems.molecules.atoms import COULOMB, Atoms, Box, mixed
from animtool.systems.molecules.spec import MoleculesModel, TrapModel

# Neighbours of an atom that are listed, on average: atoms are as dense in no matter.
MOST_EACH = 5000


@dataclass(frozen=True, slots=True)
class Acting:
    """What N atoms do to each other."""

    forces: FloatArray  # (N, 3) [kJ/(mol nm)]
    energies: FloatArray  # half of each pair's (N,) [kJ/mol]
    virial: float  # sum of forces times distances [kJ/mol]


class Interactions(Law[tuple[Acting, FloatArray]]):
    """How atoms act on each other; the list that was made last is kept.

    Time is in ps. What is summed goes with the places of the list ``(N, 3)`` [nm].
    """

    def __init__(
        self,
        spec: MoleculesModel,
        atoms: Atoms,
        box: Box,
        traps: Sequence[Mapping[str, Any]],
    ) -> None:
        super().__init__(spec.traps, traps)
        self._atoms, self._box, self._pace = atoms, box, spec.pace
        self._laws = mixed(spec)
        self._cutoff = min(spec.reach, box.size.min() / 2)
        self._from = min(
            0.9 * self._cutoff if spec.switch is None else spec.switch, self._cutoff
        )
        self._skin = max(min(spec.skin, box.size.min() / 2 - self._cutoff), 0.0)
        charged = bool(atoms.charges.any())
        self._charges = atoms.charges * np.sqrt(COULOMB) if charged else None
        self._damping = spec.damping
        self._listed: tuple[FloatArray, Any] | None = None

    def own_energy(self) -> float:
        """Return what charges have by themselves and their images [kJ/mol]."""
        from scipy.special import erfc

        if self._charges is None:
            return 0.0
        screened = erfc(self._damping * self._cutoff) / (2 * self._cutoff)
        share = screened + self._damping / np.sqrt(np.pi)
        return -float(share * (self._charges**2).sum())

    def summed(
        self, x: FloatArray, before: tuple[Acting, FloatArray]
    ) -> tuple[Acting, FloatArray]:
        """Return what atoms at points do, by the list from before as long as it holds."""
        squares = ((x - before[1]) ** 2).sum(axis=1)
        near = squares.max(initial=0.0) <= (self._skin / 2) ** 2
        reference = before[1] if near else x
        return self.acting(x, reference), reference

    def accelerated(
        self, t: float, x: FloatArray, sums: tuple[Acting, FloatArray]
    ) -> FloatArray:
        """Return accelerations ``(N, 3)`` [nm/ps²]."""
        forces = sums[0].forces
        if self.placed:
            forces = forces + self.outside(t / self._pace, x)[0]
        return np.asarray(forces / self._atoms.masses[:, None])

    def acting(self, x: FloatArray, reference: FloatArray) -> Acting:
        """Return what atoms at points ``(N, 3)`` [nm] do, by the list of other places.

        Raises:
            ToleranceError: They are so dense that lists would fill the memory (SIM102).
        """
        if self._listed is None or self._listed[0] is not reference:
            most = MOST_EACH * len(x)
            try:
                pairs = _kernels.molecule_pairs(
                    reference, self._box.size, self._cutoff + self._skin, most
                )
            except ValueError as error:
                message = f"atoms fell together: {error}"
                raise ToleranceError(Fault("SIM102", message)) from error
            self._listed = reference, pairs
        order, starts, partners = self._listed[1]
        found = _kernels.molecule_forces(
            x, order, starts, partners, self._box.size, self._atoms.kinds,
            self._laws, self._charges, self._cutoff, self._from, self._damping,
        )  # fmt: skip
        return Acting(*found)

    def from_placed(
        self, one: TrapModel, at: FloatArray, x: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Return forces ``(N, 3)`` [kJ/(mol nm)] and energies ``(N,)`` [kJ/mol]."""
        size = self._box.size
        off = self._box.inwards(at) - x
        off -= size * np.round(off / size)
        near = np.maximum(1 - (off * off).sum(axis=1) / one.radius**2, 0.0)
        force = (one.stiffness * near**2)[:, None] * off
        return force, -(one.stiffness * one.radius**2 / 6 * near**3)
