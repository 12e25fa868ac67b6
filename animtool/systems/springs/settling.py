"""Where springs come to rest under a solver that does not rest where forces cancel."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from animtool.core.array_types import FloatArray
from animtool.core.errors import Fault, Severity, warning
from animtool.core.quantities import length_text
from animtool.core.record import dataclass
from animtool.systems.springs.motion import SpringState, TimeGrid
from animtool.systems.springs.records import Solver, SpringOptions
from animtool.systems.springs.solvers import SHORTEST_OF_AUTO, Choice, advance
from animtool.systems.springs.system import SpringSystem

# Speed below which all particles are at rest [m/s]: they move on by micrometres.
RESTING = 1e-6
# Cells of time at most, and springs times steps: about five seconds of work.
MAX_CELLS, MAX_WORK = 20_000, 500_000_000
# Shorter steps go on as long as they leave this share of how far it is at most.
HELPS = 0.7
# Of the size of the springs, how far from where forces cancel they rest unreported.
NEAR = 1e-3


@dataclass(frozen=True, slots=True)
class XpbdRest:
    """Springs at rest under xpbd.

    Attributes:
        system: That begins there.
        choice: With as many steps as rest takes.
        notices: How far it is from where forces cancel out (SIM152, SIM179, SIM199).
    """

    system: SpringSystem
    choice: Choice
    notices: tuple[Fault, ...]


def rest_of_xpbd(
    system: SpringSystem, options: SpringOptions, choice: Choice, t: float
) -> XpbdRest:
    """Return springs that begin where xpbd leaves them at rest, near their true rest.

    A step of xpbd goes through each spring once, so that what hangs on long chains is
    lower than where the forces cancel out: from there it would fall. It falls here, and
    is stopped whenever its energy of motion is largest, until it moves no more. Steps
    that `auto` takes are halved as long as that brings it nearer.

    Args:
        system: Springs that begin where forces cancel out.
        options: What is allowed.
        choice: Steps of xpbd.
        t: When pins are looked at [s].
    """
    halted = system.halted(t, system.body)
    near = NEAR * float(np.linalg.norm(np.ptp(system.state[0], axis=0)))
    begun, work, auto = choice.substeps, 0, options.solver == Solver.AUTO
    best: _Fallen | None = None
    while True:
        fallen = _fallen(halted, options, replace(choice, substeps=begun), work)
        work = fallen.work
        if not np.isfinite(fallen.speed):
            return XpbdRest(system, choice, (_unsolved(fallen.speed),))
        nearer = best is None or fallen.gap < HELPS * best.gap
        if not nearer and best is not None:
            fallen = best
        shorter = choice.cell / (2 * fallen.substeps) >= SHORTEST_OF_AUTO
        if fallen.gap <= near or not (auto and nearer and shorter and work < MAX_WORK):
            break
        best, begun = fallen, 2 * fallen.substeps
    notices = [] if fallen.speed <= RESTING else [_unsolved(fallen.speed)]
    if fallen.gap > near:
        notices.append(_away(fallen.gap, auto=auto))
    steps = replace(choice, substeps=fallen.substeps)
    return XpbdRest(system.starting_at(fallen.rest), steps, tuple(notices))


@dataclass(frozen=True, slots=True)
class _Fallen:
    """Where springs that were stopped again and again are."""

    rest: FloatArray  # (N, 3) [m]
    speed: float  # of the fastest [m/s]
    substeps: int  # in a cell
    work: int  # springs times steps so far
    gap: float  # of the furthest from where it began [m]


def _fallen(
    halted: SpringSystem, options: SpringOptions, choice: Choice, work: int
) -> _Fallen:
    """Return where springs that stand still come to rest."""
    motion = np.ascontiguousarray(halted.state)
    state = SpringState(motion, halted.none_torn, choice.substeps, choice.substeps)
    grid = TimeGrid(choice.solver, 0.0, choice.cell, 0, state)
    masses, before, cells = halted.free_masses, 0.0, 0
    speed, first = np.inf, work
    while speed > RESTING and cells < MAX_CELLS and work < MAX_WORK:
        cells += 1
        with np.errstate(all="ignore"):
            grid = advance(halted, options, grid, 1)
        state, velocities = grid.state, grid.state.motion[1]
        speed = float(np.linalg.norm(velocities, axis=1).max(initial=0.0))
        work = first + grid.steps * len(halted.body.springs.rest)
        if not np.isfinite(speed):
            break
        # Fewer steps later on would move it again.
        state = replace(state, least=state.substeps)
        energy = float(masses @ (velocities * velocities).sum(axis=1))
        if energy < before:
            state, energy = replace(state, motion=_stopped(state)), 0.0
        before, grid = energy, replace(grid, state=state)
    rest = grid.state.motion[0]
    gap = float(np.linalg.norm(rest - halted.state[0], axis=1).max(initial=0.0))
    return _Fallen(rest, speed, grid.state.substeps, work, gap)


def _stopped(state: SpringState) -> FloatArray:
    """Return positions without velocities."""
    motion = state.motion.copy()
    motion[1] = 0.0
    return motion


def _away(gap: float, *, auto: bool) -> Fault:
    """Return how far from where forces cancel out it rests [m]."""
    message = f"xpbd comes to rest {length_text(gap)} from where the forces on "
    message += "particles cancel out"
    if not auto:
        return warning("SIM199", message, "use auto or bdf2", "settle")
    message += ", as close as shorter steps bring it"
    hint = "surfaces in contact keep it there, or its chains are long"
    return Fault("SIM179", message, where="settle", hint=hint, severity=Severity.NOTE)


def _unsolved(speed: float) -> Fault:
    message = f"xpbd found no rest state: particles still move at {speed:.2g} m/s"
    return warning("SIM152", message, "use auto or bdf2", "settle")
