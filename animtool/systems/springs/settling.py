"""Where springs come to rest under a solver that does not rest where forces cancel."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from animtool.core.array_types import FloatArray
from animtool.core.errors import Fault
from animtool.core.quantities import length_text
from animtool.systems.springs.motion import Grid, SpringState, warning
from animtool.systems.springs.records import SpringOptions
from animtool.systems.springs.solvers import Choice, advance
from animtool.systems.springs.system import SpringSystem

# Speed below which all particles are at rest [m/s]: they move on by micrometres.
RESTING = 1e-6
# Cells of time at most, and springs times steps: about five seconds of work.
MAX_CELLS, MAX_WORK = 20_000, 500_000_000
# Of the size of the springs, how far from where forces cancel they rest unreported.
NEAR = 1e-3


@dataclass(frozen=True, slots=True)
class XpbdRest:
    """Springs at rest under xpbd.

    Attributes:
        system: That begins there.
        choice: With as many steps as rest takes.
        notices: How far it is from where forces cancel out (SIM152, SIM199).
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
    is stopped whenever its energy of motion is largest, until it moves no more.

    Args:
        system: Springs that begin where forces cancel out.
        options: What is allowed.
        choice: Steps of xpbd.
        t: When pins are looked at [s].
    """
    still = system.halted(t, system.body)
    motion = np.ascontiguousarray(still.state)
    state = SpringState(motion, still.whole, choice.substeps, choice.substeps)
    grid = Grid(choice.solver, 0.0, choice.cell, 0, state)
    masses, before, cells = still.free_masses, 0.0, 0
    speed, work = np.inf, 0
    while speed > RESTING and cells < MAX_CELLS and work < MAX_WORK:
        cells += 1
        with np.errstate(all="ignore"):
            grid = advance(still, options, grid, 1)
        state, velocities = grid.state, grid.state.motion[1]
        speed = float(np.linalg.norm(velocities, axis=1).max(initial=0.0))
        work = grid.steps * len(still.body.springs.rest)
        if not np.isfinite(speed):
            return XpbdRest(system, choice, (_unsolved(speed),))
        # Fewer steps later on would move it again.
        state = replace(state, least=state.substeps)
        energy = float(masses @ (velocities * velocities).sum(axis=1))
        if energy < before:
            state, energy = replace(state, motion=_stopped(state)), 0.0
        before, grid = energy, replace(grid, state=state)
    rest = grid.state.motion[0]
    notices = [] if speed <= RESTING else [_unsolved(speed)]
    gap = float(np.linalg.norm(rest - system.state[0], axis=1).max(initial=0.0))
    if gap > NEAR * float(np.linalg.norm(np.ptp(rest, axis=0))):
        message = f"xpbd comes to rest {length_text(gap)} from where the forces on "
        message += "particles cancel out"
        notices.append(warning("SIM199", message, "take auto or bdf2", "settle"))
    steps = replace(choice, substeps=grid.state.substeps)
    return XpbdRest(system.starting_at(rest), steps, tuple(notices))


def _stopped(state: SpringState) -> FloatArray:
    """Return positions without velocities."""
    motion = state.motion.copy()
    motion[1] = 0.0
    return motion


def _unsolved(speed: float) -> Fault:
    message = f"no rest of xpbd was found: particles still move at {speed:.2g} m/s"
    return warning("SIM152", message, "take auto or bdf2", "settle")
