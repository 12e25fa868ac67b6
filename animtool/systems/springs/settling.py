"""Rest state of xpbd, which differs from the static equilibrium."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from animtool.core.array_types import FloatArray
from animtool.core.errors import Fault, Severity, warning
from animtool.core.quantities import length_text
from animtool.core.record import dataclass
from animtool.systems.springs.motion import SpringState, TimeGrid
from animtool.systems.springs.records import Solver, SpringOptions
from animtool.systems.springs.solvers import MIN_AUTO_STEP, SolverChoice, advance
from animtool.systems.springs.system import SpringSystem

# Speed below which all particles count as at rest [m/s].
REST_SPEED = 1e-6
# Largest number of cells, and of springs times steps, about five seconds of work.
MAX_CELLS, MAX_WORK = 20_000, 500_000_000
# Steps are halved while that reduces the gap to less than this fraction [1].
GAP_REDUCTION = 0.7
# Largest unreported gap to the static equilibrium, relative to the system size [1].
MAX_RELATIVE_GAP = 1e-3


@dataclass(frozen=True, slots=True)
class XpbdRest:
    """Springs in the rest state of xpbd.

    Attributes:
        system: System that starts at rest.
        choice: Solver with the steps of the rest state.
        notices: Gap to the static equilibrium (SIM152, SIM179, SIM199).
    """

    system: SpringSystem
    choice: SolverChoice
    notices: tuple[Fault, ...]


def find_xpbd_rest(
    system: SpringSystem, options: SpringOptions, choice: SolverChoice, t: float
) -> XpbdRest:
    """Return springs that start in the rest state of xpbd, near static equilibrium.

    A step of xpbd visits each spring once, so that long chains hang lower than in
    equilibrium and would fall at the start. The fall is simulated here, with velocities
    reset whenever the kinetic energy peaks, until they rest. With `auto`, steps are
    halved as long as that reduces the gap.

    Args:
        system: Springs that start in equilibrium.
        options: Limits of the simulation.
        choice: Steps of xpbd.
        t: Time at which pins are sampled [s].
    """
    frozen = system.frozen_at(t, system.body)
    tolerance = MAX_RELATIVE_GAP * float(
        np.linalg.norm(np.ptp(system.state[0], axis=0))
    )
    substeps, work, is_auto = choice.substeps, 0, options.solver == Solver.AUTO
    previous: _Descent | None = None
    while True:
        descent = _descend(frozen, options, replace(choice, substeps=substeps), work)
        work = descent.work
        if not np.isfinite(descent.speed):
            return XpbdRest(system, choice, (_no_rest_notice(descent.speed),))
        is_improving = previous is None or descent.gap < GAP_REDUCTION * previous.gap
        if not is_improving and previous is not None:
            descent = previous
        can_halve = choice.cell / (2 * descent.substeps) >= MIN_AUTO_STEP
        if descent.gap <= tolerance or not (
            is_auto and is_improving and can_halve and work < MAX_WORK
        ):
            break
        previous, substeps = descent, 2 * descent.substeps
    notices = [] if descent.speed <= REST_SPEED else [_no_rest_notice(descent.speed)]
    if descent.gap > tolerance:
        notices.append(_gap_notice(descent.gap, is_auto=is_auto))
    rest_choice = replace(choice, substeps=descent.substeps)
    return XpbdRest(system.starting_at(descent.rest), rest_choice, tuple(notices))


@dataclass(frozen=True, slots=True)
class _Descent:
    """Result of a descent with kinetic damping: velocities are repeatedly set to 0."""

    rest: FloatArray  # final positions (N, 3) [m]
    speed: float  # speed of the fastest particle [m/s]
    substeps: int  # steps in a cell
    work: int  # number of springs times steps so far
    gap: float  # largest distance from the start [m]


def _descend(
    frozen: SpringSystem, options: SpringOptions, choice: SolverChoice, work: int
) -> _Descent:
    """Return the rest state of springs with frozen pins, by kinetic damping."""
    motion = np.ascontiguousarray(frozen.state)
    state = SpringState(motion, frozen.untorn_flags, choice.substeps, choice.substeps)
    grid = TimeGrid(choice.solver, 0.0, choice.cell, 0, state)
    masses, previous_energy, cells = frozen.free_masses, 0.0, 0
    speed, initial_work = np.inf, work
    while speed > REST_SPEED and cells < MAX_CELLS and work < MAX_WORK:
        cells += 1
        with np.errstate(all="ignore"):
            grid = advance(frozen, options, grid, 1)
        state, velocities = grid.state, grid.state.motion[1]
        speed = float(np.linalg.norm(velocities, axis=1).max(initial=0.0))
        work = initial_work + grid.steps * len(frozen.body.springs.rest)
        if not np.isfinite(speed):
            break
        # A later change to fewer steps would move it again.
        state = replace(state, least=state.substeps)
        energy = float(masses @ (velocities * velocities).sum(axis=1))
        if energy < previous_energy:
            state, energy = replace(state, motion=_with_zero_velocities(state)), 0.0
        previous_energy, grid = energy, replace(grid, state=state)
    rest = grid.state.motion[0]
    gap = float(np.linalg.norm(rest - frozen.state[0], axis=1).max(initial=0.0))
    return _Descent(rest, speed, grid.state.substeps, work, gap)


def _with_zero_velocities(state: SpringState) -> FloatArray:
    """Return the positions of a state, with all velocities set to 0 ``(2, N, 3)``."""
    motion = state.motion.copy()
    motion[1] = 0.0
    return motion


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
