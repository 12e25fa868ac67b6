"""Frames of one problem through time, evened out or measured as a whole."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from animtool import _kernels
from animtool._types import ArrayLike, FloatArray
from animtool.ik.goals import Targets
from animtool.ik.limbs import Extension, extend
from animtool.ik.problem import Problem
from animtool.ik.solving import WARM_DAMPING, IkOptions, chain_targets, pose_rows
from animtool.ik.tangent import difference, unwound

# Rounds of Gauss-Newton at most, each over all frames.
ROUNDS = 30
# Of the preference for where a path was when its speed is evened out.
HARDLY = 1e-6


@dataclass(frozen=True)
class Path:
    """Frames of one problem, as the solver takes them.

    Attributes:
        problem: What was asked.
        targets: ``(F, E, 17)``.
        limbs: How far the limbs of eased and stretching goals go.
        drifts: Motion from frame to frame that is not to be evened out ``(F - 1, D)``.
        options: Tolerances.
    """

    problem: Problem
    targets: FloatArray
    limbs: Extension
    drifts: FloatArray
    options: IkOptions

    def frames(self, rows: slice) -> Path:
        """Return a stretch of it."""
        drifts = self.drifts[rows.start : rows.stop - 1]
        picked = np.arange(len(self.targets))[rows]
        targets, limbs = self.targets[rows], self.limbs[picked]
        return replace(self, targets=targets, limbs=limbs, drifts=drifts)

    def steps(self, poses: FloatArray) -> FloatArray:
        """Return how poses ``(F, C)`` move from frame to frame, less the drifts."""
        return difference(self.problem.chain, poses[:-1], poses[1:]) - self.drifts

    def smoothed(
        self, poses: FloatArray, acceleration: float
    ) -> tuple[FloatArray, FloatArray]:
        """Return poses ``(F, C)`` of less acceleration, and misses ``(F, E, 4)``."""
        weights = (1.0, 0.0, acceleration)
        return self._run(poses, weights, (0, len(poses)), ROUNDS)

    def evened(
        self, poses: FloatArray, *, opened: bool = False
    ) -> tuple[FloatArray, FloatArray]:
        """Return poses that go from the first to the last at an even speed.

        The last stays, and so does the first unless it is ``opened``.
        """
        moving = (0 if opened else 1, len(poses) - 1)
        return self._run(poses, (HARDLY, 1.0, 0.0), moving, ROUNDS)

    def measured(self, poses: FloatArray) -> FloatArray:
        """Return what poses miss ``(F, E, 4)``."""
        return self._run(poses, (1.0, 0.0, 0.0), (0, 0), 0)[1]

    def excesses(self, misses: FloatArray) -> FloatArray:
        """Return by how many tolerances each goal is missed ``(F, E)``."""
        angle = self.options.angle_tolerance
        tolerances = np.array([self.options.tolerance, angle, angle, angle])
        return np.asarray((misses / tolerances).max(axis=2, initial=0.0))

    def excess(self, misses: FloatArray) -> FloatArray:
        """Return by how many tolerances each frame misses its goals ``(F,)``."""
        return np.asarray(self.excesses(misses).max(axis=1, initial=0.0))

    def _run(
        self,
        poses: FloatArray,
        weights: tuple[float, float, float],
        moving: tuple[int, int],
        rounds: int,
    ) -> tuple[FloatArray, FloatArray]:
        chain = self.problem.chain
        found = _kernels.smooth_ik(
            chain.nodes,
            chain.numbers,
            chain.goals,
            chain.goal_numbers,
            unwound(chain, poses),
            self.targets,
            self.limbs.sought,
            self.limbs.scales,
            self.drifts,
            *weights,
            *moving,
            self.options.tolerance,
            self.options.angle_tolerance,
            WARM_DAMPING,
            rounds,
        )
        return found[0], found[1]


def path_of(
    problem: Problem, targets: Targets, start: ArrayLike | None, options: IkOptions
) -> Path:
    """Return the frames of a problem; ``start`` ``(F, Q)`` is the motion they keep."""
    packed = chain_targets(problem, targets)
    drifts = np.zeros((max(len(packed) - 1, 0), problem.degrees))
    if start is not None and np.ndim(start) == 2:
        own = problem.chain.from_rig(pose_rows(problem, start, len(packed), "start"))
        drifts = difference(problem.chain, own[:-1], own[1:])
    return Path(problem, packed, extend(problem.limbs, packed), drifts, options)
