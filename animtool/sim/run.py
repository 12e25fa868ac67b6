"""A motion under way: where it stands, what it took."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from animtool._types import FloatArray
from animtool.sim.checks import Signs
from animtool.sim.equations import Equations
from animtool.sim.integrators.integrator import Integrator, Step
from animtool.sim.options import IntegrateOptions
from animtool.sim.trajectory import Status

# Steps between two looks for signs of a blow-up.
LOOK_EVERY = 32


@dataclass(slots=True)
class Run:
    """A motion under way."""

    integrator: Integrator
    equations: Equations
    options: IntegrateOptions  # how to integrate
    watch: Signs  # looks for signs that it has blown up
    end: float  # the last time [s]
    time: float  # where it stands [s]
    state: FloatArray
    memory: object = None  # what the method takes along
    # The step to try next, of methods that choose theirs [s].
    trial: float | None = None
    steps: int = 0  # kept
    rejected: int = 0  # not kept
    smallest: float = math.inf  # step [s]
    largest: float = 0.0  # step [s]
    local_error: float = 0.0  # sum of the steps' own estimates
    reason: str = ""  # why it stopped
    looked: int = field(default=0)  # steps kept when signs were last looked for

    def keep(self, step: Step, t: float, h: float) -> Status:
        """Go on to where a step leads, at time t, and return whether to go further."""
        system = self.equations.system
        state, memory = step.state, step.memory
        if system.settles:
            state = system.settle(t, h, self.state, step.state)
            # What a method took along is of the state that it made itself.
            memory = memory if state is step.state else None
        self.state, self.memory = state, memory
        if step.error is not None:
            self.local_error += float(np.abs(step.error).max(initial=0.0))
        return self.count(t, h, 1)

    def count(self, t: float, h: float, steps: int) -> Status:
        """Count steps that led to time t, and return whether to go further."""
        self.time = t
        self.steps += steps
        self.smallest, self.largest = min(self.smallest, h), max(self.largest, h)
        if self.steps - self.looked >= LOOK_EVERY:
            return self.look()
        return self.within_budget()

    def look(self) -> Status:
        """Return whether the state shows a sign of a blow-up."""
        self.looked = self.steps
        sign = self.watch.sign(self.time, self.state)
        if sign:
            return self.stop(Status.UNSTABLE, sign)
        return self.within_budget()

    def within_budget(self) -> Status:
        """Return whether there are evaluations left."""
        if self.equations.evaluations < self.options.budget:
            return Status.OK
        took = f"it took {self.equations.evaluations} evaluations"
        return self.stop(Status.OUT_OF_BUDGET, took)

    def stop(self, status: Status, reason: str) -> Status:
        """Say why to go no further."""
        self.reason = reason
        return status
