"""States of springs on a time grid, and their piercing counts."""

from __future__ import annotations

import math
from dataclasses import field, replace
from typing import NamedTuple

import numpy as np

from animtool.core.array_types import BoolArray, FloatArray, IntArray
from animtool.core.errors import Fault, Severity, counted, warning
from animtool.core.record import dataclass
from animtool.maths import so3
from animtool.sim.colliders.bodies import Wrenches
from animtool.sim.trajectory import Trajectory
from animtool.systems.framework.simulation import field_set_later, growing_field
from animtool.systems.springs.body import TornFlags
from animtool.systems.springs.records import Solver

# Most steps in a cell of time.
MAX_SUBSTEPS_PER_CELL = 4096
# Higher step rates are not suggested: lengths probably have another unit [1/s].
MAX_SUGGESTED_STEP_RATE = 1e6


class Piercing(NamedTuple):
    """Largest counts of self-intersections of a surface over time."""

    passed: int = 0  # number of particles through triangles, not yet resolved
    cut: int = 0  # number of edge pairs that passed through each other
    # Step rate needed to detect all fast contacts [1/s]; 0 if the current one suffices.
    rate: float = 0.0

    def maximum(self, more: tuple[int, int, float]) -> Piercing:
        """Return the element-wise maximum of these counts and others."""
        passed, cut = max(self.passed, more[0]), max(self.cut, more[1])
        return Piercing(passed, cut, max(self.rate, more[2]))


@dataclass(frozen=True, slots=True)
class SpringState:
    """State of springs at the start of a time cell, sufficient to resume."""

    motion: FloatArray  # positions [m], then velocities [m/s] ``(2, N, 3)``
    torn: TornFlags
    substeps: int  # steps in a cell
    least: int  # lower limit of the steps in a cell of xpbd
    calm: int = 0  # consecutive cells of xpbd for which fewer steps sufficed
    # Motion one step earlier, for bdf2.
    before: FloatArray | None = field(
        default=None, metadata=field_set_later(np.ndarray)
    )
    # Particles that pierced the surface ``(C, 3)``: particle, triangle, side.
    passages: IntArray = field(
        default_factory=lambda: np.zeros((0, 3), np.int64), metadata=growing_field()
    )
    # Impulse and moment on each pin in the last step, for pins on bodies ``(H, 6)``.
    pulls: FloatArray | None = field(default=None, metadata=field_set_later(np.ndarray))
    # Warm start of the coupling to bodies, as `CoupledCell.solve` takes it.
    known: FloatArray | None = field(default=None, metadata=field_set_later(np.ndarray))


@dataclass(frozen=True, slots=True)
class TimeGrid:
    """A spring motion at one point of its time grid, with counts over earlier cells."""

    solver: Solver  # active solver
    origin: float  # start time of cell 0 [s]
    cell: float  # length of a cell [s]
    index: int  # index of the next cell
    state: SpringState  # state at the start of the current cell
    # Largest strain of xpbd springs beyond their compliance [1].
    max_strain: float = 0.0
    step_count: int = 0
    evaluation_count: int = 0  # evaluations of all spring forces
    is_unsolved: bool = False  # whether the last cell could not be solved
    max_contact_count: int = 0  # most xpbd particles in contact at one time
    unresolved_count: int = 0  # maximum number of particles left inside colliders
    # Impulse on rigid colliders in the last cells ``(C, 7)``: impulse, moment about the
    # origin, and the largest mass in contact at one time.
    pushes: FloatArray = field(default_factory=lambda: np.zeros((0, 7)))
    # Impulses on rigid bodies that carry pins in the last cell, by system.
    body_wrenches: tuple[Wrenches, ...] = ()
    # Maximum counts of self-piercing over time.
    piercing: Piercing = field(default_factory=Piercing)

    @property
    def time(self) -> float:
        """Current time [s]."""
        return self.origin + self.index * self.cell

    def after_cells(
        self,
        cell_count: int,
        state: SpringState,
        steps: int,
        evaluations: int,
        inside: int,
        pushes: FloatArray,
    ) -> TimeGrid:
        """Return the time grid ``cell_count`` cells later, with a new state."""
        return replace(
            self,
            index=self.index + cell_count,
            state=state,
            step_count=self.step_count + steps,
            evaluation_count=self.evaluation_count + evaluations,
            unresolved_count=max(self.unresolved_count, inside),
            pushes=pushes,
        )


def at_rest(positions: FloatArray) -> FloatArray:
    """Return a state ``(2, N, 3)`` with particles at rest in positions [m]."""
    return np.stack([positions, np.zeros_like(positions)])


def move_rigidly(
    motion: FloatArray, shift: FloatArray, rotation: FloatArray
) -> FloatArray:
    """Return a state ``(2, N, 3)`` rotated about the origin and then shifted."""
    result = so3.rotate(rotation, motion)
    result[0] += shift
    return result


@dataclass(frozen=True, slots=True)
class SpringMotion(Trajectory):
    """States of springs over time.

    Attributes:
        solver: Solver that was used.
        reason: Why this solver, in words.
        step: The shortest step [s].
        stretch: Largest strain of xpbd springs beyond their compliance [1]; 0 for other
            solvers.
        torn: Torn springs at the end ``(S,)``, in body order.
        unresolved: Most particles at a time that were held by colliders from several
            sides, or were still inside one.
        passed: Most particles at a time that had passed through the surface and were
            not yet resolved.
        cut: Most pairs of edges at a time that had passed through each other.
    """

    solver: Solver
    reason: str
    step: float
    stretch: float
    torn: BoolArray
    unresolved: int
    passed: int = 0
    cut: int = 0


def piercing_notices(
    piercing: Piercing, subject: str = "the surface", *, is_intact: bool = False
) -> list[Fault]:
    """Return warnings about self-intersections of a surface (SIM144, SIM165, SIM167).

    Args:
        piercing: Counts over time.
        subject: Name of the surface.
        is_intact: Whether nothing intersected in any frame: then fast parts are a note.
    """
    notices = []
    thickness_hint = "use a shorter step, or a larger thickness"
    if piercing.passed:
        particles = counted(piercing.passed, "particle")
        message = f"{subject} passed through itself at {particles}"
        notices.append(warning("SIM144", message, thickness_hint))
    if piercing.cut:
        pairs = counted(piercing.cut, "pair")
        message = f"{pairs} of edges of {subject} crossed each other"
        notices.append(warning("SIM167", message, thickness_hint))
    if piercing.rate:
        message = f"parts of {subject} moved past each other by more than four times "
        message += "its thickness in one step"
        hint = "use a shorter step"
        if MAX_SUGGESTED_STEP_RATE < piercing.rate < math.inf:
            hint = "no step resolves it: check speeds, lengths and their units"
        elif math.isfinite(piercing.rate):
            hint = f"use {math.ceil(piercing.rate)} steps per second to resolve all "
            hint += "contacts, or a larger thickness"
        notice = warning("SIM165", message, hint)
        if is_intact and not notices:
            message += ", but nothing intersects in any frame"
            notice = replace(notice, message=message, severity=Severity.NOTE)
        notices.append(notice)
    return notices
