"""What springs come to over time, where they stand, and what went through them."""

from __future__ import annotations

import math
from dataclasses import field, replace

import numpy as np

from animtool.core.array_types import BoolArray, FloatArray, IntArray
from animtool.core.errors import Fault, counted, warning
from animtool.core.record import dataclass
from animtool.sim.colliders.bodies import Wrenches
from animtool.sim.trajectory import Trajectory
from animtool.systems.framework.simulation import growing, later
from animtool.systems.springs.body import Flags
from animtool.systems.springs.records import Solver

# Steps that a cell of time is divided into, at most.
MAX_SUBSTEPS = 4096


@dataclass(frozen=True, slots=True)
class Piercing:
    """What of a surface went through itself, at most at a time."""

    passed: int = 0  # particles through triangles that were not yet brought back
    cut: int = 0  # pairs of edges through each other
    # Steps a second in which what went too far in one would have been seen [1/s]; 0
    # where nothing did.
    rate: float = 0.0

    def with_more(self, more: Piercing) -> Piercing:
        """Return the most of both."""
        return Piercing(
            max(self.passed, more.passed),
            max(self.cut, more.cut),
            max(self.rate, more.rate),
        )


@dataclass(frozen=True, slots=True)
class SpringState:
    """Springs at the begin of a cell of time, so that they can be gone on with."""

    motion: FloatArray  # positions [m], then velocities [m/s] ``(2, N, 3)``
    torn: Flags
    substeps: int  # steps in a cell
    least: int  # steps in a cell of xpbd, at least
    calm: int = 0  # cells of xpbd without need of as many steps
    # State a step before, of bdf2.
    before: FloatArray | None = field(default=None, metadata=later(np.ndarray))
    # Where the surface is through itself ``(C, 3)``, as kernels have it.
    passages: IntArray = field(
        default_factory=lambda: np.zeros((0, 3), np.int64), metadata=growing()
    )
    # What pins that bodies carry were pulled by in the last step ``(H, 6)``.
    pulls: FloatArray | None = field(default=None, metadata=later(np.ndarray))
    # What the last cell found of how these change with velocities of the bodies.
    known: FloatArray | None = field(default=None, metadata=later(np.ndarray))


@dataclass(frozen=True, slots=True)
class TimeGrid:
    """Where a motion is on its grid of time, and what happened in the cells so far."""

    solver: Solver  # what takes it on
    origin: float  # time of the grid's first cell [s]
    cell: float  # length of each [s]
    index: int  # of the cell to cross next
    state: SpringState  # at its start
    # The largest of springs of xpbd that is not mostly their own give [1].
    stretch: float = 0.0
    steps: int = 0
    evaluations: int = 0  # of all springs
    lost: bool = False  # whether a cell could not be crossed
    touching: int = 0  # particles of xpbd that touched colliders at once, at most
    unresolved: int = 0  # particles left inside colliders, at most
    # What rigid colliders were pushed by in the last cells ``(C, 7)``: impulse, moment
    # about the origin, and the mass that touched each at once, at most.
    pushes: FloatArray = field(default_factory=lambda: np.zeros((0, 7)))
    # What rigid bodies that carry pins were pulled by in the last cell, by system.
    tied: tuple[Wrenches, ...] = ()
    # What went through the surface, at most.
    through: Piercing = field(default_factory=Piercing)

    @property
    def time(self) -> float:
        """Where it is [s]."""
        return self.origin + self.index * self.cell

    def crossed(
        self,
        cells: int,
        state: SpringState,
        steps: int,
        evaluations: int,
        inside: int,
        pushes: FloatArray,
    ) -> TimeGrid:
        """Return where it is after cells that took steps to a state."""
        return replace(
            self,
            index=self.index + cells,
            state=state,
            steps=self.steps + steps,
            evaluations=self.evaluations + evaluations,
            unresolved=max(self.unresolved, inside),
            pushes=pushes,
        )


@dataclass(frozen=True, slots=True)
class SpringMotion(Trajectory):
    """States of springs over time.

    Attributes:
        solver: What made it.
        reason: Why this solver, in words.
        step: The shortest step [s].
        stretch: Of xpbd, the most that springs were longer than at rest, where this
            was not mostly their own give, over their length at rest [1]; else 0.
        torn: Which springs are, at the end ``(S,)``, in the order of the body's.
        unresolved: Particles that colliders held from several sides, or that were on
            their way out of one, at most at a time.
        passed: Particles that had gone through the surface and were not yet brought
            back, at most at a time.
        cut: Pairs of edges that had gone through each other, at most at a time.
    """

    solver: Solver
    reason: str
    step: float
    stretch: float
    torn: BoolArray
    unresolved: int
    passed: int = 0
    cut: int = 0


def through_notices(through: Piercing, what: str = "the surface") -> list[Fault]:
    """Return warnings of what went through a surface (SIM144, SIM165, SIM167)."""
    notices = []
    thicker = "use a shorter step, or a larger thickness"
    if through.passed:
        message = f"{counted(through.passed, 'particle')} passed through {what}"
        notices.append(warning("SIM144", message, thicker))
    if through.cut:
        times = counted(through.cut, "pair")
        message = f"{times} of edges cut through each other in {what}"
        notices.append(warning("SIM167", message, thicker))
    if through.rate:
        message = f"parts of {what} moved past each other by many thicknesses in a step"
        hint = "use a shorter step"
        if math.isfinite(through.rate):
            hint = f"{math.ceil(through.rate)} steps per second resolve all contacts"
        notices.append(warning("SIM165", message, hint))
    return notices
