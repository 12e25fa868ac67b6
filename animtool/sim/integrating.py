"""Integration of a system over sample times."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from animtool.core.array_types import ArrayLike, FloatArray
from animtool.sim import adaptive_steps, external
from animtool.sim.checks import (
    EnergyWatch,
    check_checkpoint,
    check_start,
    check_supported,
    check_times,
    step_warnings,
    stop_warning,
)
from animtool.sim.equations import Equations
from animtool.sim.integrators.integrator import StepControl, allowed_step
from animtool.sim.modes import modes_at
from animtool.sim.options import IntegrateOptions, checked_integrator, finer_options
from animtool.sim.run import IntegrationRun, advance_evenly
from animtool.sim.system import FirstOrder, SecondOrder
from animtool.sim.trajectory import Checkpoint, Stats, Status, Trajectory

_ADVANCE_FUNCTIONS = {
    StepControl.FIXED: advance_evenly,
    StepControl.ADAPTIVE: adaptive_steps.advance_adaptively,
    StepControl.SCIPY: external.advance_scipy,
}


def advance_run(run: IntegrationRun, target: float) -> Status:
    """Integrate up to a time [s], then check for divergence."""
    if not target > run.time:
        return Status.OK
    status = _ADVANCE_FUNCTIONS[run.integrator.control](run, target)
    return run.check_divergence() if status is Status.OK else status


def checkpoint_of(
    run: IntegrationRun, status: Status, time: float, state: FloatArray
) -> Checkpoint:
    """Return a checkpoint to resume the integration from.

    SciPy's solvers depend on their end time, so a new solver is created on resume.
    """
    if status is not Status.OK or run.integrator.control is StepControl.SCIPY:
        return Checkpoint(time, state)
    return Checkpoint(time, state, run.memory, run.trial)


def stats_of(
    run: IntegrationRun, status: Status, samples: Sequence[tuple[float, FloatArray]]
) -> Stats:
    """Return the statistics of a run, with the largest stable step at the samples."""
    integrator, stable_step = run.integrator, None
    if status is Status.UNSTABLE and integrator.limit is not None:
        stable_step = _stable_step(run, samples)
    return Stats(
        status,
        run.time,
        run.reason,
        run.step_count,
        None if integrator.control is StepControl.SCIPY else run.rejected_count,
        run.equations.evaluations,
        run.smallest_step if run.step_count else 0.0,
        run.largest_step,
        run.local_error if integrator.error_order else None,
        stable_step=stable_step,
    )


def _stable_step(
    run: IntegrationRun, samples: Sequence[tuple[float, FloatArray]]
) -> float | None:
    """Return the largest step that is stable at all sampled states [s]."""
    modes = [modes_at(run.equations, t, state) for t, state in samples]
    steps = [allowed_step(run.integrator, mode) for mode in modes if mode is not None]
    return min((step for step in steps if step is not None), default=None)


def integrate(
    system: FirstOrder | SecondOrder,
    times: ArrayLike,
    options: IntegrateOptions | None = None,
    checkpoint: Checkpoint | None = None,
) -> Trajectory:
    """Return the states of a system at sample times.

    Built-in methods end a step at each time; SciPy's solvers interpolate between their
    steps. Stopping early is not an error: the states reached so far are returned, with
    a status with the time and the reason of the stop.

    Args:
        system: The system, with its initial state.
        times: Ascending ``(F,)`` [s]; the first is the time of the initial state. Equal
            times return equal states, bit for bit.
        options: Method, step or tolerance, bounds.
        checkpoint: Checkpoint of an earlier trajectory to resume from, instead of the
            system's initial state; its time must be the first of ``times``. With fixed
            steps at multiples of the step, and with built-in adaptive methods, resumed
            integration equals uninterrupted integration, bit for bit.

    Raises:
        OptionError: The method is unknown (SIM001); times are empty, not finite or
            descend (SIM002); the start or its rate is not finite or has a wrong shape
            (SIM003); an option is out of range (SIM004), missing or ignored (SIM005);
            the method does not support the system (SIM006).

    >>> from animtool.sim.system import ForceSystem
    >>> fall = ForceSystem(lambda t, x, v: np.full_like(x, -9.81), [[0.0]])
    >>> options = IntegrateOptions("velocity_verlet", step=0.1)
    >>> integrate(fall, [0, 1, 2], options).positions[:, 0, 0].round(3).tolist()
    [0.0, -4.905, -19.62]
    """
    options = options or IntegrateOptions()
    integrator = checked_integrator(options)
    sample_times = check_times(times, checkpoint)
    equations = Equations(system)
    check_supported(equations, integrator)
    if checkpoint is not None:
        check_checkpoint(checkpoint, system.state)
    start = checkpoint or Checkpoint(float(sample_times[0]), system.state)
    with np.errstate(all="ignore"):
        check_start(equations, start.time, start.state)
        notices = [] if checkpoint else system.notices()
        notices += step_warnings(
            equations, integrator, options, sample_times, start.state
        )
        energy_watch = EnergyWatch(system, options)
        energy_watch.start(start.time, start.state)
        run = IntegrationRun(
            integrator,
            equations,
            options,
            energy_watch,
            float(sample_times[-1]),
            start.time,
            start.state,
            start.memory,
            start.trial,
        )
        states, status = _sample_states(run, sample_times)
        end_indices = sorted({0, len(states) - 1})
        samples = [(float(sample_times[i]), states[i]) for i in end_indices]
        stats = stats_of(run, status, samples)
        energies = _sample_energies(system, sample_times, states)
    if status is not Status.OK:
        notices.append(stop_warning(integrator, options, stats))
    elif options.estimate:
        fresh_start = replace(start, memory=None, trial=None)
        finer_trajectory = integrate(
            system, sample_times, finer_options(options), fresh_start
        )
        stats = replace(stats, error=_refinement_error(finer_trajectory, states))
    return Trajectory(
        sample_times[: len(states)],
        np.array(states),
        energies,
        stats,
        tuple(notices),
        checkpoint_of(run, status, float(sample_times[len(states) - 1]), states[-1]),
        equations.second_order is not None,
    )


def _sample_states(
    run: IntegrationRun, times: FloatArray
) -> tuple[list[FloatArray], Status]:
    """Return the states at the times that were reached, and the final status."""
    states, status = [run.state], Status.OK
    for t in times[1:].tolist():
        status = advance_run(run, t)
        if status is not Status.OK:
            break
        states.append(run.state)
    return states, status


def _sample_energies(
    system: FirstOrder | SecondOrder, times: FloatArray, states: list[FloatArray]
) -> FloatArray | None:
    """Return total energies at the times reached; None if any energy is undefined."""
    samples = zip(times.tolist(), states, strict=False)
    energies = [system.energy(t, state) for t, state in samples]
    totals = [energy.total for energy in energies if energy is not None]
    return np.array(totals) if len(totals) == len(energies) else None


def _refinement_error(
    finer_trajectory: Trajectory, states: list[FloatArray]
) -> float | None:
    """Return the largest difference from a finer run; None if it stopped early."""
    if finer_trajectory.stats.status is not Status.OK:
        return None
    return float(np.abs(finer_trajectory.states - np.array(states)).max(initial=0.0))
