"""Results of an integration."""

from __future__ import annotations

from enum import StrEnum

from animtool.core.array_types import FloatArray
from animtool.core.errors import Fault
from animtool.core.record import dataclass


class Status(StrEnum):
    """How an integration ended.

    Attributes:
        OK: All times were reached.
        UNSTABLE: It blew up: energy or springs grew beyond bounds, or numbers did.
        STEP_TOO_SMALL: The step that the tolerance asks for is below the floor.
        OUT_OF_BUDGET: It took more evaluations than it may.
        NOT_SOLVED: The equations of an implicit step were not solved.
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
        time: [s]
        state: At that time.
        memory: What the method takes along beside it.
        trial: The step to try next, of methods that choose theirs [s].
    """

    time: float
    state: FloatArray
    memory: object = None
    trial: float | None = None


@dataclass(frozen=True, slots=True)
class Stats:
    """Statistics of an integration, and how it ended.

    Attributes:
        status: How it ended.
        time: When [s]: the last time, or where it stopped.
        reason: Why it stopped, empty where it did not.
        steps: Taken and kept.
        rejected: Taken and not kept; None of solvers of scipy's, which do not say.
        evaluations: Of rates or accelerations.
        smallest: Step [s]; 0 where there was none.
        largest: Step [s].
        local_error: Sum of the largest errors that steps made by their own estimate;
            None of methods that have none.
        error: Largest difference to a motion in finer steps, in the state's units, as
            an estimate of its error; None where it was not asked for.
        stable_step: Of a motion that blew up with a fixed step, the largest that is
            stable [s]: 0 where none is, None where it is not known.
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
        times: Those reached ``(F,)`` [s]; all that were asked for where the status
            is ok.
        states: At these times ``(F, …)``; of particles ``(F, 2, N, d)``.
        energies: Kinetic and potential together ``(F,)`` [J], None where the system
            says none.
        stats: What it took, and how it ended.
        notices: Warnings: of a step too long to be stable, of how it ended.
        checkpoint: Where it can be gone on from, at the last of the times.
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
