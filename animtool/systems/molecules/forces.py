"""What atoms do to each other, by lists of neighbours, as integrators see it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from animtool import _kernels
from animtool._types import FloatArray
from animtool.errors import Fault, ToleranceError
from animtool.systems.molecules.atoms import COULOMB, Atoms, Box, mixed
from animtool.systems.molecules.spec import MoleculesModel

# Neighbours of an atom that are listed, on average: atoms are as dense in no matter.
MOST_EACH = 5000


@dataclass(frozen=True, slots=True)
class Acting:
    """What N atoms do to each other."""

    forces: FloatArray  # (N, 3) [kJ/(mol nm)]
    energies: FloatArray  # half of each pair's (N,) [kJ/mol]
    virial: float  # sum of forces times distances [kJ/mol]


class Interactions:
    """How atoms act on each other; the list that was made last is kept."""

    def __init__(self, spec: MoleculesModel, atoms: Atoms, box: Box) -> None:
        self._atoms, self._box = atoms, box
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

    def reference(self, x: FloatArray, before: FloatArray) -> FloatArray:
        """Return the places whose list holds at points: those before, or these."""
        squares = ((x - before) ** 2).sum(axis=1)
        return before if squares.max(initial=0.0) <= (self._skin / 2) ** 2 else x

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
