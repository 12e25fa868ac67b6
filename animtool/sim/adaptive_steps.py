"""Adaptive time steps from the error estimates of a method.

References:
    E. Hairer, S. P. Nørsett, G. Wanner, Solving Ordinary Differential Equations I,
    1993, II.4.
"""

from __future__ import annotations

import math

import numpy as np

from animtool.core.array_types import FloatArray
from animtool.core.quantities import plain_number
from animtool.sim.integrators.integrator import StepResult
from animtool.sim.options import IntegrateOptions
from animtool.sim.run import IntegrationRun
from animtool.sim.trajectory import Status

# Safety factor on the step, and bounds of the step change.
SAFETY_FACTOR, MIN_STEP_FACTOR, MAX_STEP_FACTOR = 0.9, 0.2, 5.0
# Step factor after a stage that did not converge, or a state that is not finite.
FAILED_STEP_FACTOR = 0.25


def advance_adaptively(run: IntegrationRun, target: float) -> Status:
    """Integrate with adaptive steps; the last step ends exactly at ``target`` [s]."""
    while run.time < target:
        status = _try_step(run, target)
        if status is not Status.OK:
            return status
    return Status.OK


def _try_step(run: IntegrationRun, target: float) -> Status:
    """Try a step; accept it if its error estimate is within the tolerance."""
    step_function = run.integrator.step
    assert step_function is not None
    run.equations.set_anchor(run.time, run.state)
    trial_step = _initial_step(run) if run.trial is None else run.trial
    if run.options.step is not None:
        trial_step = min(trial_step, run.options.step)
    if _is_too_small(trial_step, run, target):
        reason = f"the tolerance needs a step of {plain_number(trial_step)} s"
        return run.stop(Status.STEP_TOO_SMALL, reason)
    h, t = _fit_to_target(trial_step, run.time, target)
    step_result = step_function(run.equations, run.time, run.state, h, run.memory)
    error_ratio = (
        math.nan
        if step_result is None
        else _error_ratio(step_result, run.state, run.options)
    )
    if step_result is None or not error_ratio <= 1:
        run.rejected_count += 1
        factor = (
            FAILED_STEP_FACTOR
            if math.isnan(error_ratio)
            else _step_factor(error_ratio, run)
        )
        run.trial = h * factor
        return run.budget_status()
    # A step shortened to end at the target says little about the next one.
    next_step = h * _step_factor(error_ratio, run)
    run.trial = next_step if h == trial_step else max(next_step, trial_step)
    return run.accept(step_result, t, h)


def _fit_to_target(
    trial_step: float, time: float, target: float
) -> tuple[float, float]:
    """Return the size and end time of a step, sized to avoid a tiny last step."""
    remaining_time = target - time
    if trial_step >= remaining_time:
        return remaining_time, target
    h = remaining_time / 2 if trial_step > remaining_time / 2 else trial_step
    return h, time + h


def _is_too_small(trial_step: float, run: IntegrationRun, target: float) -> bool:
    """Return whether a trial step that ends before the target is below the floor."""
    if trial_step >= target - run.time:
        return False
    return trial_step < run.options.floor or run.time + trial_step == run.time


def _step_factor(error_ratio: float, run: IntegrationRun) -> float:
    """Return the factor for the next step size from the error-to-tolerance ratio."""
    if error_ratio == 0:
        return MAX_STEP_FACTOR
    factor = SAFETY_FACTOR * math.pow(error_ratio, -1 / run.integrator.error_order)
    return min(MAX_STEP_FACTOR, max(MIN_STEP_FACTOR, factor))


def _error_ratio(
    step_result: StepResult, start_state: FloatArray, options: IntegrateOptions
) -> float:
    """Return the largest error-to-tolerance ratio; NaN if the state is not finite."""
    assert step_result.error is not None
    magnitude = np.maximum(np.abs(start_state), np.abs(step_result.state))
    tolerances = options.atol + options.rtol * magnitude
    # If tolerance and state are 0, an error of 0 is accepted.
    ratios = np.abs(step_result.error) / np.maximum(tolerances, 1e-300)
    return float(ratios.max(initial=0.0)) if np.isfinite(ratios).all() else math.nan


def _initial_step(run: IntegrationRun) -> float:
    """Return an initial step size [s], estimated from the rate and its change."""
    options, equations, y = run.options, run.equations, run.state
    tolerances = np.maximum(options.atol + options.rtol * np.abs(y), 1e-300)

    def norm(values: FloatArray) -> float:
        squares = (values / tolerances) ** 2
        return float(np.sqrt(np.mean(squares))) if values.size else 0.0

    rate = equations.rate(run.time, y)
    state_norm, rate_norm = norm(y), norm(rate)
    small_step = 1e-6
    if state_norm > 1e-5 and rate_norm > 1e-5:
        small_step = 0.01 * state_norm / rate_norm
    next_rate = equations.rate(run.time + small_step, y + small_step * rate)
    largest_rate = max(rate_norm, norm(next_rate - rate) / small_step)
    exponent = 1 / run.integrator.error_order
    if largest_rate <= 1e-15:
        estimated_step = max(1e-6, small_step * 1e-3)
    else:
        estimated_step = (0.01 / largest_rate) ** exponent
    step = min(100 * small_step, estimated_step)
    return step if math.isfinite(step) and step > 0 else small_step
