"""A running integration: its state, its statistics, and its fixed steps."""

from __future__ import annotations

import math
from dataclasses import field
from typing import Protocol

import numpy as np

from animtool.core.array_types import FloatArray
from animtool.core.record import dataclass
from animtool.sim.equations import Equations
from animtool.sim.integrators.integrator import Integrator, Step
from animtool.sim.options import IntegrateOptions
from animtool.sim.system import Native
from animtool.sim.trajectory import Status

# Times within this fraction of a step count as a multiple of it.
ON_GRID = 1e-9
# Steps between two divergence checks.
LOOK_EVERY = 32


class Signs(Protocol):
    """Checks states for divergence."""

    def sign(self, t: float, state: FloatArray) -> str:
        """Return why a state has diverged; empty if it has not."""
        ...


@dataclass(slots=True)
class Run:
    """A running integration."""

    integrator: Integrator
    equations: Equations
    options: IntegrateOptions  # how to integrate
    watch: Signs  # checks for divergence
    end: float  # the last time [s]
    time: float  # current time [s]
    state: FloatArray
    memory: object = None  # the method's memory
    # The next trial step of adaptive methods [s].
    trial: float | None = None
    steps: int = 0  # accepted
    rejected: int = 0  # rejected
    smallest: float = math.inf  # step [s]
    largest: float = 0.0  # step [s]
    local_error: float = 0.0  # sum of the error estimates
    reason: str = ""  # why it stopped
    looked: int = field(default=0)  # accepted steps at the last divergence check

    def keep(self, step: Step, t: float, h: float) -> Status:
        """Accept a step that ends at time t; return whether to continue."""
        system = self.equations.system
        state, memory = step.state, step.memory
        if system.settles:
            state = system.settle(t, h, self.state, step.state)
            # The method's memory belongs to the state it produced.
            memory = memory if state is step.state else None
        self.state, self.memory = state, memory
        if step.error is not None:
            self.local_error += float(np.abs(step.error).max(initial=0.0))
        return self.count(t, h, 1)

    def count(self, t: float, h: float, steps: int) -> Status:
        """Count steps up to time t; return whether to continue."""
        self.time = t
        self.steps += steps
        self.smallest, self.largest = min(self.smallest, h), max(self.largest, h)
        if self.steps - self.looked >= LOOK_EVERY:
            return self.look()
        return self.within_budget()

    def look(self) -> Status:
        """Return whether the state has diverged."""
        self.looked = self.steps
        sign = self.watch.sign(self.time, self.state)
        if sign:
            return self.stop(Status.UNSTABLE, sign)
        return self.within_budget()

    def within_budget(self) -> Status:
        """Return whether evaluations remain."""
        if self.equations.evaluations < self.options.budget:
            return Status.OK
        took = f"it took {self.equations.evaluations} evaluations"
        return self.stop(Status.OUT_OF_BUDGET, took)

    def stop(self, status: Status, reason: str) -> Status:
        """Stop, and record the reason."""
        self.reason = reason
        return status


@dataclass(frozen=True, slots=True)
class Division:
    """Equal steps between two times."""

    start: float  # [s]
    end: float  # [s]
    count: int  # of steps
    h: float  # each step [s]
    # The start as a multiple of the step, if times are multiples; else None.
    first: int | None

    def time(self, i: int) -> float:
        """Return the start time of step i [s]; i may be the count."""
        if self.first is not None:
            return (self.first + i) * self.h
        return self.end if i == self.count else self.start + i * self.h


def divide(start: float, end: float, step: float) -> Division:
    """Split an interval into equal steps, none longer than a given one.

    Where both times are multiples of the step, it is taken as it is, and steps begin
    at multiples of it: so it is the same steps whichever values are asked for between,
    and wherever a motion is gone on from.

    >>> divide(0.5, 1.0, 0.2).h
    0.16666666666666666
    >>> divide(0.1 + 0.2, 0.6, 0.1)
    Division(start=0.30000000000000004, end=0.6, count=3, h=0.1, first=3)
    """
    first, last = start / step, end / step
    near, far = round(first), round(last)
    # Rounding of times that are multiples.
    slack = ON_GRID + 4 * math.ulp(max(abs(first), abs(last)))
    on_grid = max(abs(first - near), abs(last - far)) <= slack < 0.5
    if on_grid and far > near:
        return Division(start, end, far - near, step, near)
    count = max(1, math.ceil((end - start) / step * (1 - 1e-12)))
    return Division(start, end, count, (end - start) / count, None)


def advance_evenly(run: Run, target: float) -> Status:
    """Integrate up to a time, in equal steps."""
    assert run.options.step is not None
    division = divide(run.time, target, run.options.step)
    native = run.equations.system.native(run.integrator.name)
    go = _stepwise(run, division) if native is None else _blocks(run, division, native)
    # The last step ends at the requested time, but for rounding.
    run.time = target if go is Status.OK else run.time
    return go


def _stepwise(run: Run, division: Division) -> Status:
    take = run.integrator.step
    assert take is not None
    for i in range(division.count):
        t = division.time(i)
        step = take(run.equations, t, run.state, division.h, run.memory)
        if step is None:
            reason = "Newton's method did not converge"
            return run.stop(Status.NOT_SOLVED, reason)
        go = run.keep(step, division.time(i + 1), division.h)
        if go is not Status.OK:
            return go
    return Status.OK


def _blocks(run: Run, division: Division, native: Native) -> Status:
    """Take the steps in blocks, as long as no check is due."""
    each = run.integrator.evaluations or 1
    for i in range(0, division.count, LOOK_EVERY):
        count = min(LOOK_EVERY, division.count - i)
        run.state = native(division.time(i), run.state, division.h, count)
        run.equations.evaluations += each * count
        go = run.count(division.time(i + count), division.h, count)
        if go is not Status.OK:
            return go
    return Status.OK
