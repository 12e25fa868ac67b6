"""Where springs come to rest."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from animtool._types import FloatArray
from animtool.sim.springs.system import SpringSystem

__all__ = ["Rest", "find_rest"]

# Of the weight, or pull, of a particle, what is left of the forces on it.
SOLVED = 1e-9
MOST_STEPS = 400
# What is added to the stiffness in every direction goes up and down by this.
FIRMER = 4.0
# The matrices are symmetric, and nearly always positive.
SYMMETRIC: dict[str, Any] = {
    "permc_spec": "MMD_AT_PLUS_A",
    "diag_pivot_thresh": 0.0,
    "options": {"SymmetricMode": True},
}


@dataclass(frozen=True, slots=True)
class Rest:
    """Where springs come to rest.

    Attributes:
        positions: ``(N, 3)`` [m].
        residual: Largest force left on a particle that is not held [N].
        steps: Taken.
        solved: Whether the residual is rounding.
    """

    positions: FloatArray
    residual: float
    steps: int
    solved: bool


def find_rest(system: SpringSystem, t: float = 0.0) -> Rest:
    """Return where the forces on particles cancel out, with pins as they are at a time.

    Newton's method for the least energy, with as much added to the stiffness as it
    takes for the energy to fall. Air is left out.

    Limits of the method: springs that are pressed give way to one of many sides; which
    one, rounding decides. The energy is then a least one among those near by.

    >>> from animtool.sim.springs import Family, Pins, rope
    >>> line = rope([0, 0, 0], [0, 0, -1], 2, Family(98.1), mass=1.0)
    >>> rest = find_rest(SpringSystem(line, pins=Pins([0])))
    >>> rest.positions[1, 2].round(6).tolist()
    -1.1
    """
    calm = system.without_air()
    place = _Place(calm, t, calm.settle(t, 1.0, calm.state, calm.state)[0])
    firm, steps = place.typical, 0
    while not place.solved and steps < MOST_STEPS:
        steps += 1
        moved = place.moved(firm)
        if moved is not None and moved.energy <= place.energy + place.rounding:
            place, firm = moved, firm / FIRMER
        else:
            firm *= FIRMER
    return Rest(place.x, place.residual, steps, place.solved)


class _Place:
    """Positions, and the forces and energy there."""

    def __init__(self, system: SpringSystem, t: float, x: FloatArray) -> None:
        self._system, self._t, self.x = system, t, x
        self._still = np.zeros_like(x)
        self._free = np.flatnonzero(~system.fixed)
        self._masses = np.where(system.fixed, 0.0, system.body.masses)
        self.energy = system.energy(t, np.array((x, self._still))).potential
        self._forces = system.acceleration(t, x, self._still) * self._masses[:, None]
        self.residual = float(np.abs(self._forces).max(initial=0.0))
        weights = self._masses * np.linalg.norm(system.gravity)
        pull = float(weights.max(initial=0.0))
        self.solved = self.residual <= SOLVED * pull
        self.rounding = 1e-14 * max(abs(self.energy), 1e-300)
        stiffest = np.append(system.body.springs.stiffness, system.draws[:, 0])
        self.typical = float(stiffest.max(initial=1.0))

    def moved(self, firm: float) -> _Place | None:
        """Return where one step of Newton's leads, None where it leads nowhere."""
        from scipy.sparse import diags_array
        from scipy.sparse.linalg import splu

        rows = (3 * self._free[:, None] + np.arange(3)).ravel()
        matrix: Any = self._system.stiffness(self._t, self.x)[rows][:, rows]
        whole = (matrix + diags_array(np.full(len(rows), firm))).tocsc()
        try:
            step = splu(whole, **SYMMETRIC).solve(self._forces.ravel()[rows])
        except RuntimeError:
            return None
        # Up the energy's slope is no way to rest.
        if not np.isfinite(step).all() or step @ self._forces.ravel()[rows] <= 0:
            return None
        x = self.x.copy()
        x.reshape(-1)[rows] += step
        return _Place(self._system, self._t, x)
