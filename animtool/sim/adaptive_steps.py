"""Adaptive time steps, chosen by a method's error estimate.

References:
    E. Hairer, S. P. Nørsett, G. Wanner, Solving Ordinary Differential Equations I,
    1993, II.4.
"""

from __future__ import annotations

import math

import numpy as np

from animtool.core.array_types import FloatArray
from animtool.core.quantities import plain
from animtool.sim.integrators.integrator import Step
from animtool.sim.options import IntegrateOptions
from animtool.sim.run import Run
from animtool.sim.trajectory import Status

# Safety factor on the step, and bounds of the step change.
SAFETY, SHRINK, GROW = 0.9, 0.2, 5.0
# Step factor after a stage that did not converge, or a state that is not finite.
FAILED = 0.25


def advance(run: Run, target: float) -> Status:
    """Integrate up to a time, and end a step there."""
    while run.time < target:
        go = _next(run, target)
        if go is not Status.OK:
            return go
    return Status.OK


def _next(run: Run, target: float) -> Status:
    """Try a step; accept it if its error is within tolerance."""
    take = run.integrator.step
    assert take is not None
    run.equations.anchor(run.time, run.state)
    trial = _first_trial(run) if run.trial is None else run.trial
    if run.options.step is not None:
        trial = min(trial, run.options.step)
    if _too_small(trial, run, target):
        return _stopped(run, trial)
    h, t = _fitted(trial, run.time, target)
    step = take(run.equations, run.time, run.state, h, run.memory)
    ratio = math.nan if step is None else _ratio(step, run.state, run.options)
    if step is None or not ratio <= 1:
        run.rejected += 1
        run.trial = h * (FAILED if math.isnan(ratio) else _factor(ratio, run))
        return run.within_budget()
    # A truncated step says little about the next one.
    grown = h * _factor(ratio, run)
    run.trial = grown if h == trial else max(grown, trial)
    return run.keep(step, t, h)


def _fitted(trial: float, now: float, target: float) -> tuple[float, float]:
    """Return a step size and its end time, so that no sliver remains before a stop."""
    left = target - now
    if trial >= left:
        return left, target
    h = left / 2 if trial > left / 2 else trial
    return h, now + h


def _too_small(trial: float, run: Run, target: float) -> bool:
    if trial >= target - run.time:
        return False
    return trial < run.options.floor or run.time + trial == run.time


def _stopped(run: Run, trial: float) -> Status:
    reason = f"the tolerance needs a step of {plain(trial)} s"
    suspect = run.equations.system.suspect(run.time, run.state)
    reason += f"; {suspect}" if suspect else ""
    return run.stop(Status.STEP_TOO_SMALL, reason)


def _factor(ratio: float, run: Run) -> float:
    """Return the factor of the next step size, from the error over the tolerance."""
    if ratio == 0:
        return GROW
    factor = SAFETY * math.pow(ratio, -1 / run.integrator.error_order)
    return min(GROW, max(SHRINK, factor))


def _ratio(step: Step, before: FloatArray, options: IntegrateOptions) -> float:
    """Return the largest error over its tolerance; NaN if the state is not finite."""
    assert step.error is not None
    size = np.maximum(np.abs(before), np.abs(step.state))
    allowed = options.least + options.relative * size
    # With neither tolerance nor scale, an error of 0 passes.
    shares = np.abs(step.error) / np.maximum(allowed, 1e-300)
    return float(shares.max(initial=0.0)) if np.isfinite(shares).all() else math.nan


def _first_trial(run: Run) -> float:
    """Return an initial step size, from the rate and its rate of change."""
    options, equations, y = run.options, run.equations, run.state
    allowed = np.maximum(options.least + options.relative * np.abs(y), 1e-300)

    def size(values: FloatArray) -> float:
        return float(np.sqrt(np.mean((values / allowed) ** 2))) if values.size else 0.0

    rate = equations.rate(run.time, y)
    scale, speed = size(y), size(rate)
    small = 0.01 * scale / speed if scale > 1e-5 and speed > 1e-5 else 1e-6
    next_rate = equations.rate(run.time + small, y + small * rate)
    most = max(speed, size(next_rate - rate) / small)
    power = 1 / run.integrator.error_order
    best = max(1e-6, small * 1e-3) if most <= 1e-15 else (0.01 / most) ** power
    step = min(100 * small, best)
    return step if math.isfinite(step) and step > 0 else small
