"""Static equilibrium of springs by Newton's method."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from animtool.core.array_types import FloatArray
from animtool.core.record import dataclass
from animtool.systems.springs.body import Body
from animtool.systems.springs.solvers import SAFE, explicit_limit
from animtool.systems.springs.system import SpringSystem

# Residual force relative to the weight of a particle.
SOLVED = 1e-9
# Relative rounding error of an energy summed over some ten thousand springs.
ROUNDED = 1e-12
MAX_STEPS = 400
# Duration of the damped descent, as phase of a pendulum as long as the body [rad];
# spring damping, relative to critical; largest springs times steps: about 1 s.
SINKING, SWINGING, MAX_SINKING = 8.0, 0.1, 500_000_000
MAX_SINKING_STEPS = 2_000_000
# Factors that raise and lower the regularization of the stiffness.
FIRMER, SOFTER = 4.0, 16.0
# The matrices are symmetric and nearly always positive definite.
SYMMETRIC: dict[str, Any] = {
    "permc_spec": "MMD_AT_PLUS_A",
    "diag_pivot_thresh": 0.0,
    "options": {"SymmetricMode": True},
}


@dataclass(frozen=True, slots=True)
class Rest:
    """A static equilibrium of springs.

    Attributes:
        positions: ``(N, 3)`` [m].
        residual: Largest remaining force on a free particle [N].
        steps: Newton steps taken.
        solved: Whether the residual is at rounding level.
    """

    positions: FloatArray
    residual: float
    steps: int
    solved: bool


@np.errstate(all="ignore")
def find_rest(
    system: SpringSystem,
    t: float = 0.0,
    *,
    progress: Callable[[float], None] | None = None,
) -> Rest:
    """Return the static equilibrium with pins as they are at a time.

    Minimizes the energy by Newton's method, regularized so that each step lowers it. If
    the first step raises it, particles descend with strong damping for a while, if that
    is cheap. Air is ignored.

    Limits of the method: compressed springs buckle to one of several sides, which
    rounding decides. The result is a local minimum of the energy.

    Args:
        system: The springs, in their built state.
        t: Time at which pins are sampled [s].
        progress: Called with the fraction done, 0 to 1, by the orders of magnitude that
            the forces have fallen.

    >>> from animtool.systems.springs import Family, Pins, rope
    >>> line = rope([0, 0, 0], [0, 0, -1], 2, Family(98.1), mass=1.0)
    >>> rest = find_rest(SpringSystem(line, pins=Pins([0])))
    >>> rest.positions[1, 2].round(6).tolist()
    -1.1
    """
    start = system.settle(t, 1.0, system.state, system.state)[0]
    frozen = system.halted(t, replace(system.body, positions=start))
    current, has_descended = _Configuration(frozen, start), False
    regularization, steps = current.typical, 0
    while not current.solved and steps < MAX_STEPS:
        steps += 1
        candidate = current.moved(regularization)
        if (
            candidate is not None
            and candidate.energy <= current.energy + current.rounding
        ):
            current, regularization = candidate, regularization / SOFTER
        elif has_descended:
            regularization *= FIRMER
        else:
            current, has_descended = _descended(frozen, current), True
        if progress is not None:
            progress(current.settled)
    return Rest(current.x, current.residual, steps, current.solved)


def _descended(system: SpringSystem, start: _Configuration) -> _Configuration:
    """Return the state after damped descent; the start if that takes too many steps.

    Sheets fold during the descent, where Newton's method needs many short steps.
    """
    body = replace(system.body, positions=start.x)
    size = float(np.linalg.norm(np.ptp(body.positions, axis=0)))
    pull = float(np.linalg.norm(system.gravity))
    if not size * pull > 0 or not len(body.springs.rest):
        return start
    swing_rate = float(np.sqrt(pull / size))
    damped = system.halted(0.0, _with_damping(body), 2 * swing_rate)
    step = SAFE * explicit_limit(damped, 0.0, damped.state)
    step_count = SINKING / (swing_rate * step) if step > 0 else np.inf
    if not step_count <= MAX_SINKING_STEPS:
        return start
    if np.ceil(step_count) * len(body.springs.rest) > MAX_SINKING:
        return start
    steps = int(np.ceil(step_count))
    steps_at_once = damped.native("symplectic_euler")
    assert steps_at_once is not None
    x = steps_at_once(0.0, damped.state, step, steps)[0]
    end = _Configuration(system, x) if np.isfinite(x).all() else start
    return end if end.energy < start.energy else start


def _with_damping(body: Body) -> Body:
    """Return the body with strongly damped springs."""
    springs = body.springs
    masses = body.masses[springs.ends].mean(axis=1)
    damping = 2 * SWINGING * np.sqrt(springs.stiffness * masses)
    return replace(body, springs=replace(springs, damping=damping))


class _Configuration:
    """Positions with their forces and energy."""

    def __init__(self, system: SpringSystem, x: FloatArray) -> None:
        self._system, self.x = system, x
        self._at_rest = np.zeros_like(x)
        self._free = np.flatnonzero(~system.fixed)
        self._masses = system.free_masses
        self.energy = system.energy(0.0, np.array((x, self._at_rest))).potential
        self._forces = (
            system.acceleration(0.0, x, self._at_rest) * self._masses[:, None]
        )
        self.residual = float(np.abs(self._forces).max(initial=0.0))
        weights = self._masses * np.linalg.norm(system.gravity)
        pull = float(weights.max(initial=0.0))
        self.solved = self.residual <= SOLVED * pull
        orders = np.log10(max(self.residual, 1e-300) / max(pull, 1e-300))
        # Progress from the weight of a particle down to rounding level [1].
        self.settled = float(np.clip(orders / np.log10(SOLVED), 0.0, 1.0))
        self.rounding = ROUNDED * max(abs(self.energy), 1e-300)
        stiffest = np.append(
            system.body.springs.stiffness, system.target_springs.stiffness
        )
        self.typical = float(stiffest.max(initial=1.0))

    def moved(self, regularization: float) -> _Configuration | None:
        """Return the result of one Newton step; None if it does not descend."""
        from scipy.sparse import diags_array
        from scipy.sparse.linalg import splu

        rows = (3 * self._free[:, None] + np.arange(3)).ravel()
        matrix: Any = self._system.stiffness(0.0, self.x)[rows][:, rows]
        regularized = (matrix + diags_array(np.full(len(rows), regularization))).tocsc()
        try:
            step = splu(regularized, **SYMMETRIC).solve(self._forces.ravel()[rows])
        except RuntimeError:
            return None
        descent = step @ self._forces.ravel()[rows]
        # Reject steps that raise the energy or are not finite.
        if not np.isfinite(step).all() or not 0 < descent < np.inf:
            return None
        x = self.x.copy()
        x.reshape(-1)[rows] += step
        return _Configuration(self._system, x)
