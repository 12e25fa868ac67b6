"""A bath that keeps a temperature.

Reference:
    G. Bussi, D. Donadio, M. Parrinello, Canonical sampling through velocity rescaling,
    Journal of Chemical Physics 126, 2007, equation A7.
"""

from __future__ import annotations

import numpy as np

from animtool.systems.matter import normals
from animtool.systems.molecules.atoms import BOLTZMANN
from animtool.systems.molecules.spec import ThermostatModel
from animtool.systems.particles.emitter import uniforms

# Seed of its numbers over that of the system.
_BATH = 2000


def bath_factor(
    model: ThermostatModel,
    seed: int,
    step: int,
    t: float,
    dt: float,
    kinetic: float,
    freedom: int,
) -> float:
    """Return by how much velocities change in a step.

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
