"""A running integration: its state, its statistics, and its fixed steps."""

from __future__ import annotations

import math
from typing import Protocol

import numpy as np

from animtool.core.array_types import FloatArray
from animtool.core.record import dataclass
from animtool.sim.equations import Equations
from animtool.sim.integrators.integrator import Integrator, StepResult
from animtool.sim.options import IntegrateOptions
from animtool.sim.system import NativeAdvance
from animtool.sim.trajectory import Status

# Times within this fraction of a step count as a multiple of it.
GRID_TOLERANCE = 1e-9
# Steps between two divergence checks.
CHECK_INTERVAL = 32


class DivergenceWatch(Protocol):
    """Interface of an object that checks states for divergence."""

    def divergence_reason(self, t: float, state: FloatArray) -> str:
        """Return why a state has diverged; empty if it has not."""
        ...


@dataclass(slots=True)
class IntegrationRun:
    """A running integration."""

    integrator: Integrator
    equations: Equations
    options: IntegrateOptions  # options of the integration
    divergence_watch: DivergenceWatch  # divergence check
    end: float  # final time of the integration [s]
    time: float  # current time [s]
    state: FloatArray
    memory: object = None  # data that the method keeps between steps
    # The next trial step of adaptive methods [s].
    trial: float | None = None
    step_count: int = 0  # accepted steps
    rejected_count: int = 0  # rejected steps
    smallest_step: float = math.inf  # smallest accepted step [s]
    largest_step: float = 0.0  # largest accepted step [s]
    local_error: float = 0.0  # sum of the error estimates
    reason: str = ""  # why the run stopped; empty if it did not
    checked_step_count: int = 0  # accepted steps at the last divergence check

    def accept(self, step: StepResult, t: float, h: float) -> Status:
        """Accept a step that ends at time t; return OK, or why the run stops."""
        system = self.equations.system
        state, memory = step.state, step.memory
        if system.settles:
            state = system.settle(t, h, self.state, step.state)
            # The method's memory belongs to the state it produced.
            memory = memory if state is step.state else None
        self.state, self.memory = state, memory
        if step.error is not None:
            self.local_error += float(np.abs(step.error).max(initial=0.0))
        return self.record_steps(t, h, 1)

    def record_steps(self, t: float, h: float, count: int) -> Status:
        """Count steps up to time t; return OK, or why the run stops."""
        self.time = t
        self.step_count += count
        self.smallest_step = min(self.smallest_step, h)
        self.largest_step = max(self.largest_step, h)
        if self.step_count - self.checked_step_count >= CHECK_INTERVAL:
            return self.check_divergence()
        return self.budget_status()

    def check_divergence(self) -> Status:
        """Check the state for divergence; return OK, or why the run stops."""
        self.checked_step_count = self.step_count
        reason = self.divergence_watch.divergence_reason(self.time, self.state)
        if reason:
            return self.stop(Status.UNSTABLE, reason)
        return self.budget_status()

    def budget_status(self) -> Status:
        """Return OK while evaluations remain, else OUT_OF_BUDGET."""
        if self.equations.evaluations < self.options.budget:
            return Status.OK
        reason = f"it took {self.equations.evaluations} evaluations"
        return self.stop(Status.OUT_OF_BUDGET, reason)

    def stop(self, status: Status, reason: str) -> Status:
        """Stop the run, and record the reason; for too small a step, with the cause."""
        cause = ""
        if status is Status.STEP_TOO_SMALL:
            cause = self.equations.system.suspected_cause(self.time, self.state)
        self.reason = f"{reason}; {cause}" if cause else reason
        return status


@dataclass(frozen=True, slots=True)
class StepGrid:
    """Equal steps between two times, aligned to multiples of the step if possible."""

    start: float  # [s]
    end: float  # [s]
    count: int  # number of steps
    h: float  # size of each step [s]
    # Index of the first step on the grid of multiples; None off the grid.
    first_index: int | None

    def time(self, i: int) -> float:
        """Return the start time of step i [s]; i = count gives the end time."""
        if self.first_index is not None:
            return (self.first_index + i) * self.h
        return self.end if i == self.count else self.start + i * self.h


def step_grid(start: float, end: float, step: float) -> StepGrid:
    """Split an interval into equal steps no longer than ``step``.

    If both times are multiples of the step, it is used unchanged and steps begin at its
    multiples. The steps are then the same for any sample times between, and for any
    time from which integration is resumed.

    >>> step_grid(0.5, 1.0, 0.2).h
    0.16666666666666666
    >>> step_grid(0.1 + 0.2, 0.6, 0.1)
    StepGrid(start=0.30000000000000004, end=0.6, count=3, h=0.1, first_index=3)
    """
    first_multiple, last_multiple = start / step, end / step
    first_index, last_index = round(first_multiple), round(last_multiple)
    # Rounding error of times that are multiples of the step.
    rounding = math.ulp(max(abs(first_multiple), abs(last_multiple)))
    tolerance = GRID_TOLERANCE + 4 * rounding
    largest_offset = max(
        abs(first_multiple - first_index), abs(last_multiple - last_index)
    )
    is_on_grid = largest_offset <= tolerance < 0.5
    if is_on_grid and last_index > first_index:
        return StepGrid(start, end, last_index - first_index, step, first_index)
    count = max(1, math.ceil((end - start) / step * (1 - 1e-12)))
    return StepGrid(start, end, count, (end - start) / count, None)


def advance_evenly(run: IntegrationRun, target: float) -> Status:
    """Integrate to ``target`` [s] in equal steps."""
    assert run.options.step is not None
    grid = step_grid(run.time, target, run.options.step)
    native_advance = run.equations.system.native(run.integrator.name)
    if native_advance is None:
        status = _advance_by_steps(run, grid)
    else:
        status = _advance_by_blocks(run, grid, native_advance)
    # Up to rounding, the last step ends at the requested time.
    run.time = target if status is Status.OK else run.time
    return status


def _advance_by_steps(run: IntegrationRun, grid: StepGrid) -> Status:
    """Take the steps of a grid one by one, in Python."""
    step_function = run.integrator.step
    assert step_function is not None
    for i in range(grid.count):
        t = grid.time(i)
        step = step_function(run.equations, t, run.state, grid.h, run.memory)
        if step is None:
            reason = "Newton's method did not converge"
            return run.stop(Status.NOT_SOLVED, reason)
        status = run.accept(step, grid.time(i + 1), grid.h)
        if status is not Status.OK:
            return status
    return Status.OK


def _advance_by_blocks(
    run: IntegrationRun, grid: StepGrid, native_advance: NativeAdvance
) -> Status:
    """Take the steps of a grid in compiled blocks, with a check after each block."""
    evaluations = run.integrator.evaluations or 1
    for i in range(0, grid.count, CHECK_INTERVAL):
        count = min(CHECK_INTERVAL, grid.count - i)
        run.state = native_advance(grid.time(i), run.state, grid.h, count)
        run.equations.evaluations += evaluations * count
        status = run.record_steps(grid.time(i + count), grid.h, count)
        if status is not Status.OK:
            return status
    return Status.OK
