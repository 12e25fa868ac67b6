"""What steps of solvers cost, and how many a motion is expected to take."""

from __future__ import annotations

import numpy as np

from animtool.sim.springs.loaded import LoadedBody
from animtool.sim.springs.options import Solver
from animtool.sim.springs.solvers import SHORTEST

# Time of a step, for each spring of a sheet of 20 by 20 [s], on one core of a server of
# 2024 (tests/bench/results/sim_springs.csv). Where there are few springs a step costs
# more of each, in all solvers about alike. Only how they compare decides.
COSTS = {
    # Springs of neighbours are pulled four at a time, from columns of particles.
    Solver.SYMPLECTIC_EULER: 2.8e-9,
    # Each spring reads what the one before it wrote, wherever it is.
    Solver.XPBD: 9.5e-9,
    # Newton's corrections, each of some ten products of a matrix.
    Solver.BDF2: 150e-9,
}
# Of a spring's stretch xpbd asks twice of what is not its own give.
TWICE = 2.0


def projected_rate(system: LoadedBody, stretch: float) -> float:
    """Return how many steps a second xpbd is expected to take, from what springs bear.

    A step of length h moves the ends of a spring that bears a force F by F w h² as
    those beside it are gone through, w being what its ends weigh, inverse and added
    up. At each pin or target hangs its part of the whole weight. Speeds are not
    counted: a motion may take twice as many, or half.

    Args:
        system: Of springs.
        stretch: Most that one may be longer, over its length at rest [1].
    """
    springs = system.body.springs
    firm = (springs.rest > 0) & (springs.stiffness > 0)
    free = ~system.fixed
    if not firm.any() or not free.any():
        return 0.0
    holders = np.count_nonzero(system.fixed) + len(system.drawn) or len(free)
    pull = float(np.linalg.norm(system.gravity))
    force = float(system.body.masses[free].sum()) * pull / holders
    ends = springs.ends[firm]
    moved = system.inverse_masses[ends].sum(axis=1) / springs.rest[firm]
    rate = np.sqrt(TWICE * force * float(np.median(moved)) / stretch)
    return min(float(rate), 1 / SHORTEST)
