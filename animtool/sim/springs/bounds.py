"""How fast springs can make particles move, whatever their shape."""

from __future__ import annotations

import numpy as np

from animtool._types import FloatArray
from animtool.sim.springs.loaded import LoadedBody


def fastest(system: LoadedBody) -> FloatArray | None:
    """Return bounds of the fastest motions (ω, ζ) ``(2, 2)``, None without springs.

    The stiffness over √(m m') has no eigenvalue above the largest sum of sizes in a row
    (Gershgorin), each spring as if along all others of its particle; the same of the
    damping. The first motion bears all of that, the second only the drag.
    """
    springs = system.body.springs
    stiffest = _largest(system, springs.stiffness, system.draws[:, 0])
    if stiffest == 0:
        return None
    slowed = _largest(system, springs.damping, system.draws[:, 1])
    slowed += float(system.drags.max(initial=0.0))
    omega = float(np.sqrt(stiffest))
    least = float(system.drags.min(initial=0.0))
    return np.array([[omega, slowed / (2 * omega)], [omega, least / (2 * omega)]])


def _largest(system: LoadedBody, pull: FloatArray, draws: FloatArray) -> float:
    weights = system.inverse_masses
    first, second = system.body.springs.ends.T
    between = np.sqrt(weights[first] * weights[second])
    rows = np.zeros(len(weights))
    np.add.at(rows, first, pull * (weights[first] + between))
    np.add.at(rows, second, pull * (weights[second] + between))
    np.add.at(rows, system.drawn, draws * weights[system.drawn])
    return float(rows.max(initial=0.0))
