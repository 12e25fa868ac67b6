"""What simulating springs comes to."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from animtool._types import FloatArray, IntArray
from animtool.sim.springs.options import Solver
from animtool.sim.springs.self_contact import Through
from animtool.sim.trajectory import Trajectory


@dataclass(frozen=True, slots=True)
class Grid:
    """Where a motion stands on its grid of time, so that it can be gone on with.

    Attributes:
        solver: What takes it on.
        origin: Time of the grid's first cell [s].
        cell: Length of each [s].
        index: Of the cell to cross next.
        substeps: Steps in a cell.
        state: At its start ``(2, N, 3)``.
        torn: Which springs are, in the order of kernels ``(S,)``.
        before: State a step before, of bdf2.
        calm: Cells of xpbd without need of as many steps.
        least: Steps in a cell of xpbd, at least.
        stretch: The largest so far of springs of xpbd that is not mostly their own
            give [1].
        steps: Taken so far.
        evaluations: Of all springs so far.
        lost: Whether a cell could not be crossed.
        unresolved: Particles left inside colliders, at most.
        passages: Where the surface is through itself ``(C, 3)``, as kernels have it.
        through: What went through the surface, at most.
    """

    solver: Solver
    origin: float
    cell: float
    index: int
    substeps: int
    state: FloatArray
    torn: npt.NDArray[np.uint8]
    before: FloatArray | None = None
    calm: int = 0
    least: int = 1
    stretch: float = 0.0
    steps: int = 0
    evaluations: int = 0
    lost: bool = False
    unresolved: int = 0
    passages: IntArray = field(default_factory=lambda: np.zeros((0, 3), np.int64))
    through: Through = field(default_factory=Through)

    @property
    def time(self) -> float:
        """Where it stands [s]."""
        return self.origin + self.index * self.cell


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
    torn: npt.NDArray[np.bool_]
    unresolved: int
    passed: int = 0
    cut: int = 0
