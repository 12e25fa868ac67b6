"""Fits poses of a clip to weighted points, smooth in time."""

from __future__ import annotations

import math

from animtool import _kernels
from animtool.core.array_types import BoolArray, FloatArray, IntArray
from animtool.core.record import dataclass
from animtool.ik.chain import unwrap_angles
from animtool.ik.goals import Targets
from animtool.ik.problem import Problem
from animtool.ik.solving import pack_for_chain, pose_rows
from animtool.ik.sub_rig import with_mimics

# Weight that pulls a path to its per-frame solutions: only motion that no goal
# determines responds to it.
ANCHOR_WEIGHT = 1e-3
# Fraction by which a joint returns to rest in each frame if no goal determines it.
REST_RETURN = 0.005
# Weight of the extrapolated pose in a single-frame solve, relative to acceleration.
EXTRAPOLATION_WEIGHT = 0.25
# Iterations of a single frame, and of all frames together.
FRAME_ITERATIONS, MAX_ROUNDS = 30, 12


@dataclass(frozen=True, slots=True)
class FitOptions:
    """Options of a fit.

    Attributes:
        fps: Frames a second.
        acceleration: Typical joint acceleration [rad/s²], of slides in lengths of the
            problem. Less is smoother.
        robust: Weighted miss above which a goal's influence falls; infinity is plain
            least squares.
        rounds: Maximum number of Gauss-Newton iterations over all frames together.
    """

    fps: float
    acceleration: float = 60.0
    robust: float = math.inf
    rounds: int = MAX_ROUNDS


@dataclass(frozen=True, slots=True)
class FitResult:
    """Result of a fit.

    Attributes:
        coordinates: Rig coordinates ``(F, Q)``.
        misses: Position miss of each goal ``(F, E)`` [m].
        is_restarted: Mask of the frames solved from a start instead of the previous
            frames ``(F,)``.
        target_indices: Index of the target assigned to each goal ``(F, E)``: its own
            unless labels were swapped; -1 if it has no target.
        rounds: Number of Gauss-Newton iterations over all frames together.
        cost_before: Objective before these iterations [1].
        cost_after: Objective after these iterations [1].
    """

    coordinates: FloatArray
    misses: FloatArray
    is_restarted: BoolArray
    target_indices: IntArray
    rounds: int
    cost_before: float
    cost_after: float


def fit(
    problem: Problem,
    targets: Targets,
    starts: FloatArray,
    options: FitOptions,
    *,
    path: FloatArray | None = None,
    first: int = 0,
) -> FitResult:
    """Fit poses of F frames to noisy targets by robust least squares over all frames.

    Minimises the sum over the frames of ``r² / (1 + r² / robust²)`` of each goal's
    weighted miss r, plus squared joint accelerations over the typical one, by
    reweighted Gauss-Newton over all frames together, within the limits. First each
    frame is solved from the extrapolated previous ones, and from ``starts`` where most
    goals do not fit. Goals with swapped targets exchange them.

    Args:
        problem: E goals over a rig of Q coordinates.
        targets: Targets of F frames; weights are inverse standard deviations [1 /
            length of the problem]. Where a weight is 0, the goal is missing.
        starts: Start poses of frames that the previous ones do not predict ``(F, Q)``.
        options: Rate, smoothness and robustness.
        path: Initial poses ``(F, Q)``; None solves each frame first. Poses before
            ``first`` are fixed.
        first: The first frame that moves.

    Limits of the method: it is local, so a frame whose start is far from the captured
    pose may end in another minimum; its misses show that.

    References:
        S. Geman, D. McClure, Statistical methods for tomographic image reconstruction,
        1987. A. Blake, A. Zisserman, Visual reconstruction, 1987.
    """
    chain = problem.chain
    packed_targets = pack_for_chain(problem, targets)
    frame_count = len(packed_targets)
    start_rows = pose_rows(problem, starts, frame_count, "starts")
    start_path = (
        start_rows if path is None else pose_rows(problem, path, frame_count, "path")
    )
    acceleration_weight = (options.fps**2 / options.acceleration) ** 2
    kernel_output = _kernels.fit_ik(
        *chain.kernel_arrays,
        path=unwrap_angles(chain, chain.from_rig(start_path)),
        targets=packed_targets,
        starts=chain.from_rig(start_rows),
        anchor=ANCHOR_WEIGHT,
        speed=0.0,
        acceleration=acceleration_weight,
        robust=options.robust,
        rest_weight=EXTRAPOLATION_WEIGHT * acceleration_weight,
        homing=REST_RETURN,
        first=first,
        end=frame_count,
        iterations=FRAME_ITERATIONS,
        rounds=options.rounds,
        tracked=path is None or first > 0,
    )
    (
        coordinates,
        misses,
        start_counts,
        target_indices,
        rounds,
        cost_before,
        cost_after,
    ) = kernel_output
    return FitResult(
        with_mimics(
            problem.rig, chain.into_rig(coordinates, start_path), problem.joints
        ),
        misses[:, :, 0] * chain.length,
        start_counts > 0,
        target_indices,
        rounds,
        cost_before,
        cost_after,
    )
