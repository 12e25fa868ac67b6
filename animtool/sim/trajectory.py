"""Sampled states of an integration, its statistics, and checkpoints."""

from __future__ import annotations

from enum import StrEnum

from animtool.core.array_types import FloatArray
from animtool.core.errors import Fault
from animtool.core.record import dataclass


class Status(StrEnum):
    """How an integration ended.

    Attributes:
        OK: All times were reached.
        UNSTABLE: The run diverged: energy, strain or state exceeded their bounds.
        STEP_TOO_SMALL: The tolerance requires a step below the floor.
        OUT_OF_BUDGET: The run reached its limit of evaluations.
        NOT_SOLVED: An implicit step did not converge.
    """

    OK = "ok"
    UNSTABLE = "unstable"
    STEP_TOO_SMALL = "step too small"
    OUT_OF_BUDGET = "out of budget"
    NOT_SOLVED = "not solved"


@dataclass(frozen=True, slots=True)
class Checkpoint:
    """A state to resume the integration from.

    Attributes:
        time: Time of the state [s].
        state: State at that time.
        memory: Data that the method keeps between steps.
        trial: Next step that an adaptive method tries [s].
    """

    time: float
    state: FloatArray
    memory: object = None
    trial: float | None = None


@dataclass(frozen=True, slots=True)
class Stats:
    """Statistics of an integration, and how it ended.

    Attributes:
        status: How the integration ended.
        time: The last sample time, or the time of an early stop [s].
        reason: Why the integration stopped; empty on success.
        steps: Number of accepted steps.
        rejected: Number of rejected steps; None for SciPy's solvers, which hide it.
        evaluations: Number of evaluations of rates or accelerations.
        smallest: Smallest step [s]; 0 if there are no steps.
        largest: Largest step [s].
        local_error: Sum over steps of the largest estimated error; None for methods
            without an estimate.
        error: Largest difference from a run with finer steps, in the state's units, as
            an estimate of the error; None if not requested.
        stable_step: Largest stable step of a run that diverged with a fixed step [s]:
            0 if none is stable, None if unknown.
    """

    status: Status
    time: float
    reason: str
    steps: int
    rejected: int | None
    evaluations: int
    smallest: float
    largest: float
    local_error: float | None
    error: float | None = None
    stable_step: float | None = None


@dataclass(frozen=True, slots=True)
class Trajectory:
    """States of a system over time.

    Attributes:
        times: Times reached ``(F,)`` [s]; all requested ones if the status is ok.
        states: States at these times ``(F, …)``; of particles ``(F, 2, N, d)``.
        energies: Total energies ``(F,)`` [J]; None if the system has none.
        stats: Statistics, and how it ended.
        notices: Warnings about unstable steps and early stops.
        checkpoint: Checkpoint at the last time, to resume from.
        second_order: Whether states are positions and velocities.
    """

    times: FloatArray
    states: FloatArray
    energies: FloatArray | None
    stats: Stats
    notices: tuple[Fault, ...]
    checkpoint: Checkpoint
    second_order: bool

    @property
    def positions(self) -> FloatArray:
        """Positions ``(F, N, d)`` [m], or the states of a first-order system."""
        return self.states[:, 0] if self.second_order else self.states

    @property
    def velocities(self) -> FloatArray:
        """Velocities ``(F, N, d)`` [m/s].

        Raises:
            AttributeError: The system is of first order.
        """
        if not self.second_order:
            raise AttributeError("states of a system of rates have no velocities")
        return self.states[:, 1]
