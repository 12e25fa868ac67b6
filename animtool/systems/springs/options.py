"""How to simulate springs, and what comes of it."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from animtool._types import FloatArray, IntArray
from animtool.errors import Fault, OptionError
from animtool.ranges import range_faults
from animtool.sim.trajectory import Trajectory
from animtool.systems.springs.records import Solver, SpringOptions
from animtool.systems.springs.self_contact import Through

# Steps that a cell of time is divided into, at most.
MAX_SUBSTEPS = 4096


def check_options(options: SpringOptions) -> Solver:
    """Return the solver that options name, and raise where they make no sense.

    Raises:
        OptionError: There is no such solver (SIM001), or a number is out of its range
            (SIM004).
    """
    faults = []
    names = [str(solver) for solver in Solver]
    if options.solver not in names:
        message = f"there is no solver {options.solver!r}"
        hint = f"they are {', '.join(names)}"
        faults.append(Fault("SIM001", message, where="solver", hint=hint))
    faults += range_faults(options)
    if faults:
        raise OptionError(faults)
    return Solver(options.solver)


def check_substeps(solver: Solver, rate: float, most: float) -> None:
    """Raise where a solver needs more steps a second than it may take.

    Raises:
        OptionError: It does (SIM004).
    """
    if rate <= most:
        return
    message = f"{solver} needs {rate:.3g} steps a second, and takes {most:.3g} at most"
    hint = "take xpbd or auto, less stiffness or damping, or more mass"
    raise OptionError(Fault("SIM004", message, where="solver", hint=hint))


def check_keeping_apart(wanted: Solver) -> None:
    """Raise where a solver does not keep a surface apart from itself.

    Raises:
        OptionError: It does not (SIM046).
    """
    if wanted in {Solver.AUTO, Solver.XPBD}:
        return
    message = f"{wanted} does not keep a surface apart from itself"
    hint = "take xpbd or auto"
    raise OptionError(Fault("SIM046", message, where="solver", hint=hint))


@dataclass(frozen=True, slots=True)
class Grid:
    """Where a motion stands on its grid of time, so that it can be gone on with."""

    solver: Solver  # what takes it on
    origin: float  # time of the grid's first cell [s]
    cell: float  # length of each [s]
    index: int  # of the cell to cross next
    substeps: int  # steps in a cell
    state: FloatArray  # at its start ``(2, N, 3)``
    torn: npt.NDArray[np.uint8]  # which springs are, in the order of kernels ``(S,)``
    before: FloatArray | None = None  # state a step before, of bdf2
    calm: int = 0  # cells of xpbd without need of as many steps
    least: int = 1  # steps in a cell of xpbd, at least
    # The largest so far of springs of xpbd that is not mostly their own give [1].
    stretch: float = 0.0
    steps: int = 0  # taken so far
    evaluations: int = 0  # of all springs so far
    lost: bool = False  # whether a cell could not be crossed
    unresolved: int = 0  # particles left inside colliders, at most
    # Where the surface is through itself ``(C, 3)``, as kernels have it.
    passages: IntArray = field(default_factory=lambda: np.zeros((0, 3), np.int64))
    # What went through the surface, at most.
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
