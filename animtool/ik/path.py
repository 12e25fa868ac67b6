"""Smooths the poses of consecutive frames over all frames together."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from animtool import _kernels
from animtool.core.array_types import ArrayLike, FloatArray, IntArray
from animtool.core.errors import Fault, OptionError
from animtool.core.record import dataclass
from animtool.ik.chain import REVOLUTION_EXCESS, difference, unwound
from animtool.ik.goals import COLUMNS, KINDS, WEIGHTS, Targets, TargetValue, by_unit
from animtool.ik.jumps import Jump, find_jumps
from animtool.ik.limbs import SoftReach, extend
from animtool.ik.options import IkOptions
from animtool.ik.problem import Problem
from animtool.ik.result import IkResult, IkStatus
from animtool.ik.rig_solver import WARM_DAMPING
from animtool.ik.solving import chain_targets, pose_rows
from animtool.ik.sub_rig import with_mimics
from animtool.maths import so3
from animtool.rig.joints import coordinate_slices, local_from_coordinates
from animtool.rig.limits import RangeLimit
from animtool.rig.skeleton import JointType, Rig

# Maximum number of Gauss-Newton iterations, each over all frames.
MAX_ITERATIONS = 30
# Frames that a smoothed path looks ahead, in smoothing times: what is that far off
# counts e^(-12 / sqrt 2), .0002.
LOOKAHEAD = 12
# Fewest frames of a block.
MIN_BLOCK = 256
# Weight of the original path when its speed is evened out.
PATH_WEIGHT = 1e-6


@dataclass(frozen=True)
class FramePath:
    """Kernel arguments of consecutive frames of one problem.

    Attributes:
        problem: Goals and joints.
        targets: Packed targets ``(F, E, W)``.
        limbs: Extension of soft and stretching limbs.
        drifts: Motion between frames that smoothing preserves ``(F - 1, D)``.
        options: Tolerances.
    """

    problem: Problem
    targets: FloatArray
    limbs: SoftReach
    drifts: FloatArray
    options: IkOptions

    def frames(self, rows: slice) -> FramePath:
        """Return some consecutive frames."""
        drifts = self.drifts[rows.start : rows.stop - 1]
        row_indices = np.arange(len(self.targets))[rows]
        targets, limbs = self.targets[rows], self.limbs[row_indices]
        return replace(self, targets=targets, limbs=limbs, drifts=drifts)

    def steps(self, poses: FloatArray) -> FloatArray:
        """Return steps of poses ``(F, C)`` from frame to frame, minus the drifts."""
        return difference(self.problem.chain, poses[:-1], poses[1:]) - self.drifts

    def smoothed(
        self, poses: FloatArray, acceleration: float
    ) -> tuple[FloatArray, FloatArray]:
        """Return smoothed poses ``(F, C)``, and misses ``(F, E, 4)``.

        Long paths are smoothed block by block: each goes on from the one before, and
        sees the frames after it as far as they count.
        """
        weights = (1.0, 0.0, acceleration)
        ahead = math.ceil(LOOKAHEAD * acceleration**0.25)
        size = max(MIN_BLOCK, 4 * ahead)
        smooth_poses = np.zeros_like(poses)
        misses = []
        begin = 0
        while begin < len(poses):
            last = begin + size + ahead >= len(poses)
            end = len(poses) if last else begin + size
            first = max(begin - 2, 0)
            window = slice(first, min(end + ahead, len(poses)))
            starts = np.concatenate(
                [smooth_poses[first:begin], poses[begin : window.stop]]
            )
            moving = (begin - first, len(starts))
            path, missed = self.frames(window)._run(
                starts, weights, moving, MAX_ITERATIONS
            )
            block = slice(begin - first, end - first)
            smooth_poses[begin:end] = path[block]
            misses.append(missed[block])
            begin = end
        return smooth_poses, np.concatenate(misses)

    def evened(
        self, poses: FloatArray, *, free_start: bool = False
    ) -> tuple[FloatArray, FloatArray]:
        """Return poses that move from the first to the last pose at an even speed.

        The last pose is fixed, and so is the first unless ``free_start``.
        """
        moving = (0 if free_start else 1, len(poses) - 1)
        return self._run(poses, (PATH_WEIGHT, 1.0, 0.0), moving, MAX_ITERATIONS)

    def measured(self, poses: FloatArray) -> FloatArray:
        """Return the misses of poses ``(F, E, 4)``."""
        return self._run(poses, (1.0, 0.0, 0.0), (0, 0), 0)[1]

    def excesses(self, misses: FloatArray) -> FloatArray:
        """Return the miss of each goal in tolerances ``(F, E)``."""
        tolerances = by_unit(self.options.tolerance, self.options.angle_tolerance)
        return np.asarray((misses / tolerances).max(axis=2, initial=0.0))

    def excess(self, misses: FloatArray) -> FloatArray:
        """Return the largest miss of each frame in tolerances ``(F,)``."""
        return np.asarray(self.excesses(misses).max(axis=1, initial=0.0))

    def _run(
        self,
        poses: FloatArray,
        weights: tuple[float, float, float],
        moving: tuple[int, int],
        rounds: int,
    ) -> tuple[FloatArray, FloatArray]:
        chain = self.problem.chain
        anchor, speed, acceleration = weights
        first, end = moving
        smoothed = _kernels.smooth_ik(
            *chain.arrays,
            path=unwound(chain, poses),
            targets=self.targets,
            reachable=self.limbs.reachable,
            stretches=self.limbs.scales,
            drifts=self.drifts,
            anchor=anchor,
            speed=speed,
            acceleration=acceleration,
            first=first,
            end=end,
            length_tolerance=self.options.tolerance,
            angle_tolerance=self.options.angle_tolerance,
            damping=WARM_DAMPING,
            rounds=rounds,
        )
        return smoothed[0], smoothed[1]


def path_of(
    problem: Problem, targets: Targets, start: ArrayLike | None, options: IkOptions
) -> FramePath:
    """Return the path of a problem; a start ``(F, Q)`` is motion to keep."""
    packed = chain_targets(problem, targets)
    drifts = np.zeros((max(len(packed) - 1, 0), problem.degrees))
    if start is not None and np.ndim(start) == 2:
        source = problem.chain.from_rig(pose_rows(problem, start, len(packed), "start"))
        drifts = difference(problem.chain, source[:-1], source[1:])
    return FramePath(problem, packed, extend(problem.limbs, packed), drifts, options)


def goal_moves(problem: Problem, targets: FloatArray) -> FloatArray:
    """Return the largest motion of the goals from frame to frame ``(F - 1,)``.

    In radians, or fractions of the problem's length, over the goals that are active in
    both frames. ``targets`` ``(F, E, W)``.
    """
    is_weighted = targets[:, :, WEIGHTS] > 0
    is_active = is_weighted[1:] & is_weighted[:-1]
    goals = np.array([goal.weights for goal in problem.goals]) > 0
    moves = np.stack(
        [_moves(kind.value, targets[:, :, COLUMNS[kind.name]]) for kind in KINDS],
        axis=2,
    )
    return np.asarray(
        np.where(is_active & goals, moves, 0.0).max(axis=(1, 2), initial=0.0)
    )


def _moves(value: TargetValue, targets: FloatArray) -> FloatArray:
    """Return the steps of targets ``(F, E, W)``, lengths or angles ``(F - 1, E)``."""
    if value is TargetValue.ROTATION:
        return so3.angle_between(targets[1:], targets[:-1])
    return np.asarray(np.linalg.norm(np.diff(targets, axis=0), axis=2))


def jumps_of(
    result: IkResult, targets: Targets, start: ArrayLike | None, fps: float
) -> tuple[Jump, ...]:
    """Return the jumps of a clip's poses, see `find_jumps`.

    ``start`` ``(F, Q)``: the source poses; None, or one pose, is static.
    """
    problem = result.problem
    source = None
    if start is not None and np.ndim(start) == 2:
        source = pose_rows(problem, start, len(result.coordinates), "start")
    moves = goal_moves(problem, chain_targets(problem, targets))
    longer = result.local_translations()
    return _jumps(problem, result.coordinates, longer, source, moves, fps)


def jumping_frames(
    path: FramePath,
    poses: FloatArray,
    rows: FloatArray,
    source: FloatArray | None,
    fps: float,
) -> IntArray:
    """Return the frames at which a joint jumps, ascending.

    Args:
        path: The path of F frames.
        poses: Chain coordinates ``(F, C)``.
        rows: Rig coordinates of the other joints ``(F, Q)``.
        source: The source motion ``(F, Q)``; None if there is no source.
        fps: Frames a second.
    """
    problem = path.problem
    rows = with_mimics(problem.rig, problem.chain.into_rig(poses, rows), problem.joints)
    moves = goal_moves(problem, path.targets)
    jumps = _jumps(problem, rows, None, source, moves, fps)
    return np.unique(np.array([jump.frame for jump in jumps], np.int64))


def _jumps(
    problem: Problem,
    rows: FloatArray,
    translations: FloatArray | None,
    source: FloatArray | None,
    moves: FloatArray,
    fps: float,
) -> tuple[Jump, ...]:
    """Return the jumps of coordinates ``(F, Q)``, with stretched bones if any."""
    local = local_from_coordinates(problem.rig, rows)
    if translations is not None:
        local = replace(local, translations=translations)
    return find_jumps(
        problem.rig.names,
        None if source is None else local_from_coordinates(problem.rig, source),
        local,
        moves,
        fps=fps,
        length=problem.length,
        windings=windings(problem.rig, rows),
    )


def windings(rig: Rig, rows: FloatArray) -> FloatArray:
    """Return full revolutions of pins from frame to frame ``(F - 1, J)`` [rad].

    For pins with limits wider than a revolution: their rotation does not show the
    revolution, but a cable would. ``rows`` ``(F, Q)``.
    """
    revolutions = np.zeros((max(len(rows) - 1, 0), len(rig.joints)))
    for j, columns in enumerate(coordinate_slices(rig)):
        limits = rig.joints[j].limits
        joint = rig.joints[j].type is JointType.PIN
        if not joint or not isinstance(limits, RangeLimit):
            continue
        if 2 * np.pi + REVOLUTION_EXCESS < limits.high - limits.low < np.inf:
            steps = np.diff(rows[:, columns.start]) / (2 * np.pi)
            revolutions[:, j] = 2 * np.pi * np.abs(np.round(steps))
    return revolutions


def smooth(
    result: IkResult,
    targets: Targets,
    seconds: float,
    *,
    fps: float,
    start: ArrayLike | None = None,
    options: IkOptions | None = None,
) -> IkResult:
    """Return the poses of a clip with smoothed joint motion.

    Over all frames together, the sum of ``|q - q0|^2 + seconds^4 |q''|^2`` is
    minimised, where q0 are the given poses: motion that the goals leave free and that
    is faster than ``seconds`` is removed, slower motion is kept (E. Whittaker, On a new
    method of graduation, 1923, with second derivatives). Reached goals stay within the
    tolerance; in frames that miss one, all goals keep their current points. Limits are
    kept.

    Args:
        result: F frames of one problem, in the order of time.
        targets: Targets of the solve.
        seconds: Smoothing time [s]; 0 changes nothing, .03 to .3 suit most clips.
        fps: Frames a second.
        start: Source poses ``(F, Q)`` whose acceleration is kept; only the change from
            them is smoothed.
        options: Tolerances.

    Raises:
        OptionError: ``seconds`` is less than 0 or ``fps`` not more than 0 (IK014);
            targets or start do not fit (IK010 to IK013).

    Limits of the method: the minimum is local; where a path has to switch branches, the
    switch stays. A goal that jumps makes joints jump. Long clips are smoothed in blocks
    of 48 smoothing times, at least 256 frames.
    """
    options = options or IkOptions()
    faults = rate_faults(seconds, fps)
    if faults:
        raise OptionError(faults)
    if seconds == 0 or len(result.coordinates) < 3:
        return result
    path = path_of(result.problem, targets, start, options)
    poses = result.problem.chain.from_rig(result.coordinates)
    poses, misses = path.smoothed(poses, (seconds * fps) ** 4)
    return at_poses(result, poses, misses, path)


def rate_faults(seconds: float, fps: float) -> list[Fault]:
    """Return the faults of a smoothing time and a frame rate."""
    faults = []
    if not (np.isfinite(seconds) and seconds >= 0):
        faults.append(Fault("IK014", f"smooth must be at least 0, not {seconds}"))
    if not (np.isfinite(fps) and fps > 0):
        faults.append(Fault("IK014", f"fps must be more than 0, not {fps}"))
    return faults


def at_poses(
    result: IkResult, poses: FloatArray, misses: FloatArray, path: FramePath
) -> IkResult:
    """Return a result with its chain poses ``(F, C)`` and misses replaced."""
    chain = result.problem.chain
    is_reached = path.excess(misses) <= 1
    statuses = tuple(
        IkStatus.CONVERGED
        if is_hit
        else IkStatus.NEAREST
        if status is IkStatus.CONVERGED
        else status
        for is_hit, status in zip(is_reached, result.statuses, strict=True)
    )
    return replace(
        result,
        coordinates=with_mimics(
            result.problem.rig,
            chain.into_rig(poses, result.coordinates),
            result.problem.joints,
        ),
        statuses=statuses,
        misses=misses * by_unit(chain.length, 1.0),
        reached=path.excesses(misses) <= 1,
    )
