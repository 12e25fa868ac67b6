"""Integration of a system over sample times."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from animtool.core.array_types import ArrayLike, FloatArray
from animtool.sim import adaptive_steps, external
from animtool.sim.checks import (
    Watch,
    check_fit,
    check_start,
    check_times,
    ending,
    step_notices,
)
from animtool.sim.equations import Equations
from animtool.sim.integrators.integrator import Integrator, StepControl
from animtool.sim.modes import allowed_step, modes_at
from animtool.sim.options import IntegrateOptions, check_options, finer
from animtool.sim.run import Run, advance_evenly
from animtool.sim.system import FirstOrder, SecondOrder
from animtool.sim.trajectory import Checkpoint, Stats, Status, Trajectory

_ADVANCE = {
    StepControl.FIXED: advance_evenly,
    StepControl.ADAPTIVE: adaptive_steps.advance,
    StepControl.SCIPY: external.advance,
}


def advance(run: Run, target: float) -> Status:
    """Integrate up to a time [s], then check for divergence."""
    if not target > run.time:
        return Status.OK
    status = _ADVANCE[run.integrator.control](run, target)
    return run.look() if status is Status.OK else status


def checkpoint_of(
    run: Run, status: Status, time: float, state: FloatArray
) -> Checkpoint:
    """Return a checkpoint to resume the integration from.

    SciPy's solvers are bound to their end time, and are built again.
    """
    if status is not Status.OK or run.integrator.control is StepControl.SCIPY:
        return Checkpoint(time, state)
    return Checkpoint(time, state, run.memory, run.trial)


def stats_of(
    run: Run, status: Status, samples: Sequence[tuple[float, FloatArray]]
) -> Stats:
    """Return statistics of a run; the samples give its stable step."""
    integrator, stable = run.integrator, None
    if status is Status.UNSTABLE and integrator.limit is not None:
        stable = _stable_step(run, samples)
    return Stats(
        status,
        run.time,
        run.reason,
        run.steps,
        None if integrator.control is StepControl.SCIPY else run.rejected,
        run.equations.evaluations,
        run.smallest if run.steps else 0.0,
        run.largest,
        run.local_error if integrator.error_order else None,
        stable_step=stable,
    )


def _stable_step(run: Run, samples: Sequence[tuple[float, FloatArray]]) -> float | None:
    """Return the largest step that is stable at all of the samples."""
    modes = (modes_at(run.equations, t, state) for t, state in samples)
    steps = [
        allowed_step(run.integrator, rates) for rates in modes if rates is not None
    ]
    return min((step for step in steps if step is not None), default=None)


def integrate(
    system: FirstOrder | SecondOrder,
    times: ArrayLike,
    options: IntegrateOptions | None = None,
    checkpoint: Checkpoint | None = None,
) -> Trajectory:
    """Return the states of a system at sample times.

    Methods of animtool's own end a step at each time; solvers of scipy's take their
    own curve between two steps. A motion that cannot be gone on with is no error: what
    was reached is returned, with a status that says where it stopped and why.

    Args:
        system: Where it starts, and how it changes.
        times: Ascending ``(F,)`` [s]; the first is that of the start. Duplicate
            times return equal states, bit for bit.
        options: Method, step or tolerance, bounds.
        checkpoint: Where to begin in place of the system's start: what an earlier
            trajectory carried; its time is the first one then. With fixed steps at
            multiples of the step, and with methods that choose theirs but scipy's, a
            motion in parts is the motion as a whole, bit for bit.

    Raises:
        OptionError: There is no such method (SIM001); times descend, are not finite or
            none (SIM002); the start or its rate is not finite or of another shape
            (SIM003); an option is out of its range (SIM004), missing or not heeded
            (SIM005); the method is not for such a system (SIM006).

    >>> from animtool.sim.system import ForceSystem
    >>> fall = ForceSystem(lambda t, x, v: np.full_like(x, -9.81), [[0.0]])
    >>> options = IntegrateOptions("velocity_verlet", step=0.1)
    >>> integrate(fall, [0, 1, 2], options).positions[:, 0, 0].round(3).tolist()
    [0.0, -4.905, -19.62]
    """
    options = options or IntegrateOptions()
    integrator = check_options(options)
    checked = check_times(times, checkpoint)
    equations = Equations(system)
    check_fit(equations, integrator)
    begin = checkpoint or Checkpoint(float(checked[0]), system.state)
    with np.errstate(all="ignore"):
        check_start(equations, begin.time, begin.state)
        notices = [] if checkpoint else system.notices()
        notices += step_notices(equations, integrator, options, checked, begin.state)
        run = _begun(equations, integrator, options, checked, begin)
        states, status = _states(run, checked)
        ends = sorted({0, len(states) - 1})
        stats = stats_of(run, status, [(float(checked[i]), states[i]) for i in ends])
        energies = _energies(system, checked, states)
    if status is not Status.OK:
        notices.append(ending(integrator, options, stats))
    elif options.estimate:
        refined = integrate(
            system, checked, finer(options), replace(begin, memory=None, trial=None)
        )
        stats = replace(stats, error=_difference(refined, states))
    return Trajectory(
        checked[: len(states)],
        np.array(states),
        energies,
        stats,
        tuple(notices),
        checkpoint_of(run, status, float(checked[len(states) - 1]), states[-1]),
        equations.second is not None,
    )


def _begun(
    equations: Equations,
    integrator: Integrator,
    options: IntegrateOptions,
    times: FloatArray,
    begin: Checkpoint,
) -> Run:
    watch = Watch(equations.system, options)
    watch.start(begin.time, begin.state)
    return Run(
        integrator,
        equations,
        options,
        watch,
        float(times[-1]),
        begin.time,
        begin.state,
        begin.memory,
        begin.trial,
    )


def _states(run: Run, times: FloatArray) -> tuple[list[FloatArray], Status]:
    """Return the states at the times that were reached, and the final status."""
    states, status = [run.state], Status.OK
    for target in times[1:].tolist():
        status = advance(run, target)
        if status is not Status.OK:
            break
        states.append(run.state)
    return states, status


def _energies(
    system: FirstOrder | SecondOrder, times: FloatArray, states: list[FloatArray]
) -> FloatArray | None:
    energies = [
        system.energy(t, state)
        for t, state in zip(times.tolist(), states, strict=False)
    ]
    totals = [energy.total for energy in energies if energy is not None]
    return np.array(totals) if len(totals) == len(energies) else None


def _difference(refined: Trajectory, states: list[FloatArray]) -> float | None:
    """Return the distance to a finer run; None if that stops early."""
    if refined.stats.status is not Status.OK:
        return None
    return float(np.abs(refined.states - np.array(states)).max(initial=0.0))
