"""Rest states of springs: static equilibrium by Newton's method, and rest of xpbd."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from animtool.core.array_types import FloatArray
from animtool.core.errors import Fault, Severity, warning
from animtool.core.quantities import length_text
from animtool.core.record import dataclass
from animtool.systems.springs.choosing import (
    STEP_SAFETY_FACTOR,
    SolverChoice,
    explicit_limit,
)
from animtool.systems.springs.motion import at_rest
from animtool.systems.springs.records import Solver, SpringOptions
from animtool.systems.springs.solvers import MIN_AUTO_STEP, SpringPlan
from animtool.systems.springs.system import SpringSystem

# Largest residual force of an equilibrium, relative to the weight of a particle [1].
RESIDUAL_TOLERANCE = 1e-9
# Relative rounding error of an energy, summed over ten thousand springs [1].
ENERGY_ROUNDING = 1e-12
MAX_STEPS = 400
# Damped descent: duration as the phase of a pendulum as long as the body [rad], spring
# damping relative to critical [1], and largest springs times steps, about 1 s of work.
DESCENT_PHASE, DESCENT_DAMPING, MAX_DESCENT_WORK = 8.0, 0.1, 500_000_000
MAX_DESCENT_STEPS = 2_000_000
# Factors that raise and lower the regularization of the stiffness matrix.
REGULARIZATION_INCREASE, REGULARIZATION_DECREASE = 4.0, 16.0
# Speed below which all particles count as at rest [m/s].
REST_SPEED = 1e-6
# Largest number of cells, and of springs times steps, about five seconds of work.
MAX_REST_CELLS, MAX_REST_WORK = 20_000, 500_000_000
# Steps are halved while that reduces the gap to less than this fraction [1].
GAP_REDUCTION = 0.7
# Largest unreported gap to the static equilibrium, relative to the system size [1].
MAX_RELATIVE_GAP = 1e-3
# For matrices that are symmetric and nearly always positive definite.
LU_OPTIONS: dict[str, Any] = {
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
    """Return the static equilibrium for pins fixed at their positions at a time [s].

    Minimizes the energy by Newton's method, regularized to decrease at each step. If
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
    frozen_system = system.frozen_at(t, replace(system.body, positions=start))
    current, has_descended = _Configuration(frozen_system, start), False
    regularization, steps = current.typical_stiffness, 0
    while not current.is_solved and steps < MAX_STEPS:
        steps += 1
        candidate = current.newton_step(regularization)
        if (
            candidate is not None
            and candidate.energy <= current.energy + current.rounding
        ):
            current = candidate
            regularization /= REGULARIZATION_DECREASE
        elif has_descended:
            regularization *= REGULARIZATION_INCREASE
        else:
            current, has_descended = _damped_descent(frozen_system, current), True
        if progress is not None:
            progress(current.progress)
    return Rest(current.x, current.residual, steps, current.is_solved)


def _damped_descent(system: SpringSystem, start: _Configuration) -> _Configuration:
    """Return the state after damped motion; the start if it needs too many steps.

    Sheets fold during the descent, where Newton's method needs many short steps.
    """
    springs = system.body.springs
    size = float(np.linalg.norm(np.ptp(start.x, axis=0)))
    gravity = float(np.linalg.norm(system.gravity))
    if not size * gravity > 0 or not len(springs.rest):
        return start
    pendulum_rate = float(np.sqrt(gravity / size))
    masses = system.body.masses[springs.ends].mean(axis=1)
    damping = 2 * DESCENT_DAMPING * np.sqrt(springs.stiffness * masses)
    damped_springs = replace(springs, damping=damping)
    body = replace(system.body, positions=start.x, springs=damped_springs)
    damped_system = system.frozen_at(0.0, body, 2 * pendulum_rate)
    step = STEP_SAFETY_FACTOR * explicit_limit(damped_system, 0.0, damped_system.state)
    step_count = DESCENT_PHASE / (pendulum_rate * step) if step > 0 else np.inf
    if not step_count <= MAX_DESCENT_STEPS:
        return start
    if np.ceil(step_count) * len(springs.rest) > MAX_DESCENT_WORK:
        return start
    steps = int(np.ceil(step_count))
    native_steps = damped_system.native("symplectic_euler")
    assert native_steps is not None
    x = native_steps(0.0, damped_system.state, step, steps)[0]
    end = _Configuration(system, x) if np.isfinite(x).all() else start
    return end if end.energy < start.energy else start


class _Configuration:
    """Positions of particles, with their forces and energy."""

    def __init__(self, system: SpringSystem, x: FloatArray) -> None:
        self._system, self.x = system, x
        self._free_particles = np.flatnonzero(~system.is_pinned)
        self._masses = system.free_masses
        motion = at_rest(x)
        self.energy = system.energy(0.0, motion).potential
        accelerations = system.acceleration(0.0, *motion)
        self._forces = accelerations * self._masses[:, None]
        self.residual = float(np.abs(self._forces).max(initial=0.0))
        weights = self._masses * np.linalg.norm(system.gravity)
        max_weight = float(weights.max(initial=0.0))
        self.is_solved = self.residual <= RESIDUAL_TOLERANCE * max_weight
        decades = np.log10(max(self.residual, 1e-300) / max(max_weight, 1e-300))
        # Progress from the weight of a particle down to rounding level [1].
        self.progress = float(np.clip(decades / np.log10(RESIDUAL_TOLERANCE), 0.0, 1.0))
        self.rounding = ENERGY_ROUNDING * max(abs(self.energy), 1e-300)
        families = system.body.springs, system.target_springs
        stiffnesses = np.concatenate([springs.stiffness for springs in families])
        self.typical_stiffness = float(stiffnesses.max(initial=1.0))

    def newton_step(self, regularization: float) -> _Configuration | None:
        """Take one Newton step; return None if it is not a descent direction."""
        from scipy.sparse import diags_array
        from scipy.sparse.linalg import splu

        rows = (3 * self._free_particles[:, None] + np.arange(3)).ravel()
        matrix: Any = self._system.stiffness(0.0, self.x)[rows][:, rows]
        matrix = matrix + diags_array(np.full(len(rows), regularization))
        forces = self._forces.ravel()[rows]
        try:
            step = splu(matrix.tocsc(), **LU_OPTIONS).solve(forces)
        except RuntimeError:
            return None
        descent = step @ forces
        # Reject steps that raise the energy or are not finite.
        if not np.isfinite(step).all() or not 0 < descent < np.inf:
            return None
        x = self.x.copy()
        x.reshape(-1)[rows] += step
        return _Configuration(self._system, x)


def find_xpbd_rest(
    system: SpringSystem, options: SpringOptions, choice: SolverChoice, t: float
) -> SpringPlan:
    """Return springs that start in the rest state of xpbd, near static equilibrium.

    The plan has the steps of that state, and warnings about the gap to the static
    equilibrium (SIM152, SIM179, SIM199).

    A step of xpbd visits each spring once, so that long chains hang lower than in
    equilibrium and would fall at the start. The fall is simulated here, with velocities
    reset whenever the kinetic energy peaks, until they rest. With `auto`, steps are
    halved as long as that reduces the gap. The system starts in equilibrium, with pins
    sampled at a time [s].
    """
    frozen_system = system.frozen_at(t, system.body)
    size = float(np.linalg.norm(np.ptp(system.state[0], axis=0)))
    tolerance = MAX_RELATIVE_GAP * size
    substeps, work, is_auto = choice.substeps, 0, options.solver == Solver.AUTO
    previous: _Descent | None = None
    while True:
        trial_choice = replace(choice, substeps=substeps)
        descent = _descend(frozen_system, options, trial_choice, work)
        work = descent.work
        if not np.isfinite(descent.speed):
            notices = [_no_rest_notice(descent.speed)]
            return SpringPlan(system, options, choice, planning_notices=notices)
        is_improving = previous is None or descent.gap < GAP_REDUCTION * previous.gap
        if not is_improving and previous is not None:
            descent = previous
        can_halve = choice.cell / (2 * descent.substeps) >= MIN_AUTO_STEP
        if descent.gap <= tolerance or not (
            is_auto and is_improving and can_halve and work < MAX_REST_WORK
        ):
            break
        previous, substeps = descent, 2 * descent.substeps
    notices = [] if descent.speed <= REST_SPEED else [_no_rest_notice(descent.speed)]
    if descent.gap > tolerance:
        notices.append(_gap_notice(descent.gap, is_auto=is_auto))
    rest_choice = replace(choice, substeps=descent.substeps)
    system = system.starting_at(descent.rest)
    return SpringPlan(system, options, rest_choice, planning_notices=notices)


class _Descent(NamedTuple):
    """Result of a descent with kinetic damping: velocities are repeatedly set to 0."""

    rest: FloatArray  # final positions (N, 3) [m]
    speed: float  # speed of the fastest particle [m/s]
    substeps: int  # steps in a cell
    work: int  # number of springs times steps so far
    gap: float  # largest distance from the start [m]


def _descend(
    frozen_system: SpringSystem, options: SpringOptions, choice: SolverChoice, work: int
) -> _Descent:
    """Return the rest state of springs with frozen pins, by kinetic damping."""
    plan = SpringPlan(frozen_system, options, choice)
    grid = plan.start(0.0)
    masses, previous_energy, cells = frozen_system.free_masses, 0.0, 0
    max_speed, initial_work = np.inf, work
    while max_speed > REST_SPEED and cells < MAX_REST_CELLS and work < MAX_REST_WORK:
        cells += 1
        with np.errstate(all="ignore"):
            grid = plan.advance(grid, 1)
        state, velocities = grid.state, grid.state.motion[1]
        max_speed = float(np.linalg.norm(velocities, axis=1).max(initial=0.0))
        work = initial_work + grid.step_count * len(frozen_system.body.springs.rest)
        if not np.isfinite(max_speed):
            break
        # A later change to fewer steps would move it again.
        state = replace(state, least=state.substeps)
        energy = float(masses @ (velocities * velocities).sum(axis=1))
        if energy < previous_energy:
            state, energy = replace(state, motion=at_rest(state.motion[0])), 0.0
        previous_energy, grid = energy, replace(grid, state=state)
    rest = grid.state.motion[0]
    max_gap = float(
        np.linalg.norm(rest - frozen_system.state[0], axis=1).max(initial=0.0)
    )
    return _Descent(rest, max_speed, grid.state.substeps, work, max_gap)


def _gap_notice(gap: float, *, is_auto: bool) -> Fault:
    """Return a notice of the gap to the static equilibrium [m]."""
    message = f"xpbd comes to rest {length_text(gap)} from where the forces on "
    message += "particles cancel out"
    if not is_auto:
        return warning("SIM199", message, "use auto or bdf2", "settle")
    message += ", as close as shorter steps bring it"
    hint = "surfaces in contact keep it there, or its chains are long"
    return Fault("SIM179", message, where="settle", hint=hint, severity=Severity.NOTE)


def _no_rest_notice(speed: float) -> Fault:
    """Return a warning that particles still move [m/s] (SIM152)."""
    message = f"xpbd found no rest state: particles still move at {speed:.2g} m/s"
    return warning("SIM152", message, "use auto or bdf2", "settle")
