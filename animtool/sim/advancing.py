"""A motion brought from one time to another, and what it took."""

from __future__ import annotations

from collections.abc import Sequence

from animtool._types import FloatArray
from animtool.sim import adaptive, external, fixed
from animtool.sim.integrators.integrator import Control
from animtool.sim.modes import allowed_step, modes_at
from animtool.sim.run import Run
from animtool.sim.trajectory import Checkpoint, Stats, Status

_ADVANCE = {
    Control.FIXED: fixed.advance,
    Control.ADAPTIVE: adaptive.advance,
    Control.SCIPY: external.advance,
}


def advance(run: Run, target: float) -> Status:
    """Bring a motion to a time [s], and look for signs of a blow-up there."""
    if not target > run.time:
        return Status.OK
    status = _ADVANCE[run.integrator.control](run, target)
    return run.look() if status is Status.OK else status


def checkpoint_of(
    run: Run, status: Status, time: float, state: FloatArray
) -> Checkpoint:
    """Return where a motion can be gone on from.

    scipy's solvers are bound to the end that they were begun with, and begin anew.
    """
    if status is not Status.OK or run.integrator.control is Control.SCIPY:
        return Checkpoint(time, state)
    return Checkpoint(time, state, run.memory, run.trial)


def stats_of(
    run: Run, status: Status, places: Sequence[tuple[float, FloatArray]]
) -> Stats:
    """Return what a motion took.

    Args:
        run: The motion.
        status: How it ended.
        places: Times and states that tell which steps are stable.
    """
    integrator, stable = run.integrator, None
    if status is Status.UNSTABLE and integrator.limit is not None:
        stable = _stable_step(run, places)
    return Stats(
        status,
        run.time,
        run.reason,
        run.steps,
        None if integrator.control is Control.SCIPY else run.rejected,
        run.equations.evaluations,
        run.smallest if run.steps else 0.0,
        run.largest,
        run.local_error if integrator.error_order else None,
        stable_step=stable,
    )


def _stable_step(run: Run, places: Sequence[tuple[float, FloatArray]]) -> float | None:
    """Return the largest step that is stable at each of some states."""
    modes = (modes_at(run.equations, t, state) for t, state in places)
    steps = [
        allowed_step(run.integrator, found) for found in modes if found is not None
    ]
    return min((step for step in steps if step is not None), default=None)
