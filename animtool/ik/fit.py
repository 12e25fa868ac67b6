"""Poses of a clip that come as near to weighted points as they can, smooth in time."""

from __future__ import annotations

import math

from animtool import _kernels
from animtool.core.array_types import BoolArray, FloatArray, IntArray
from animtool.core.record import dataclass
from animtool.ik.chain import unwound
from animtool.ik.goals import Targets
from animtool.ik.problem import Problem
from animtool.ik.solving import chain_targets, pose_rows
from animtool.ik.sub_rig import following

# Of the distance of a path from where its frames were found by themselves: nothing but
# what no goal holds heeds it.
ANCHOR = 1e-3
# Share of the way to its rest that a joint goes in a frame, where no goal holds it.
HOMING = 0.005
# Of the acceleration's weight, how strongly a frame by itself is drawn to where those
# before it lead.
DRAWN = 0.25
# Steps of a frame by itself, and of all frames at once.
ITERATIONS, ROUNDS = 30, 12


@dataclass(frozen=True, slots=True)
class FitOptions:
    """How to fit.

    Attributes:
        fps: Frames a second.
        acceleration: Of joints that is usual [rad/s²]; of what slides, in lengths of
            the problem. Less is smoother.
        robust: A miss, weighted, from which on a goal counts less and less; infinity
            is least squares.
        rounds: Most steps of all frames at once.
    """

    fps: float
    acceleration: float = 60.0
    robust: float = math.inf
    rounds: int = ROUNDS


@dataclass(frozen=True, slots=True)
class Fit:
    """What a fit found.

    Attributes:
        coordinates: Of the rig ``(F, Q)``.
        misses: Of the goals' positions ``(F, E)`` [m].
        searched: Frames that those before them did not lead to ``(F,)``.
        taken: Whose target each goal has ``(F, E)``: its own but where labels were
            mixed up; -1 where it has none.
        rounds: Steps of all frames at once.
        before: What is minimised, before them [1].
        after: And after.
    """

    coordinates: FloatArray
    misses: FloatArray
    searched: BoolArray
    taken: IntArray
    rounds: int
    before: float
    after: float


def fit(
    problem: Problem,
    targets: Targets,
    starts: FloatArray,
    options: FitOptions,
    *,
    path: FloatArray | None = None,
    first: int = 0,
) -> Fit:
    """Return poses of F frames that fit targets which no pose reaches exactly.

    The sum over the frames of ``r² / (1 + r² / robust²)`` of each goal's weighted miss
    r, and of the squared accelerations of the joints over what is usual, is least: by
    reweighted Gauss-Newton over all frames at once, within the limits. Before, frame
    after frame is looked for from where those before it lead, and from ``starts`` where
    most of it does not fit. Goals whose targets were mixed up exchange them.

    Args:
        problem: E goals over a rig of Q coordinates.
        targets: Of F frames; weights are one over how far a goal may be off, in lengths
            of the problem. Where a weight is 0, the goal is missing.
        starts: Where a frame is looked for that those before it do not lead to
            ``(F, Q)``.
        options: Rate, smoothness and robustness.
        path: Poses ``(F, Q)`` that are near; None looks for them. Those before
            ``first`` stay.
        first: The first frame that moves.

    Limits of the method: as of any local method, a frame whose start is far from what
    was captured may end elsewhere; its misses say so.

    References:
        S. Geman, D. McClure, Statistical methods for tomographic image reconstruction,
        1987. A. Blake, A. Zisserman, Visual reconstruction, 1987.
    """
    chain = problem.chain
    packed = chain_targets(problem, targets)
    count = len(packed)
    begins = pose_rows(problem, starts, count, "starts")
    own = begins if path is None else pose_rows(problem, path, count, "path")
    bend = (options.fps**2 / options.acceleration) ** 2
    found = _kernels.fit_ik(
        *chain.arrays,
        path=unwound(chain, chain.from_rig(own)),
        targets=packed,
        starts=chain.from_rig(begins),
        anchor=ANCHOR,
        speed=0.0,
        acceleration=bend,
        robust=options.robust,
        rest_weight=DRAWN * bend,
        homing=HOMING,
        first=first,
        end=count,
        iterations=ITERATIONS,
        rounds=options.rounds,
        tracked=path is None or first > 0,
    )
    coordinates, misses, searched, taken, rounds, before, after = found
    return Fit(
        following(problem.rig, chain.into_rig(coordinates, own), problem.joints),
        misses[:, :, 0] * chain.length,
        searched > 0,
        taken,
        rounds,
        before,
        after,
    )
