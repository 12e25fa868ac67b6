"""Smooths the poses of consecutive frames over all frames together."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from animtool import _kernels
from animtool.core.array_types import ArrayLike, FloatArray, IntArray
from animtool.core.errors import Fault, OptionError
from animtool.core.loaded import check_loaded
from animtool.core.record import dataclass
from animtool.ik.chain import REVOLUTION_EXCESS, joint_steps, unwrap_angles
from animtool.ik.goals import (
    GOAL_KINDS,
    TARGET_COLUMNS,
    WEIGHT_COLUMNS,
    Targets,
    by_unit,
)
from animtool.ik.jumps import Jump, find_jumps
from animtool.ik.limbs import SoftReach, extend_softly
from animtool.ik.options import IkOptions
from animtool.ik.problem import Problem
from animtool.ik.result import IkResult, IkStatus
from animtool.ik.rig_solver import WARM_DAMPING
from animtool.ik.solving import pack_for_chain, pose_rows
from animtool.ik.sub_rig import with_mimics
from animtool.maths import so3
from animtool.rig.joints import coordinate_slices, local_from_coordinates
from animtool.rig.limits import RangeLimit
from animtool.rig.skeleton import JointType, Rig

# Maximum number of Gauss-Newton iterations, each over all frames.
MAX_ITERATIONS = 30
# Lookahead of a smoothed block, in smoothing times; frames at its end have a weight of
# e^(-12 / sqrt 2), .0002.
LOOKAHEAD_FACTOR = 12
# Fewest frames of a block.
MIN_BLOCK_FRAMES = 256
# Weight of the original path when its speed is evened out.
ORIGINAL_PATH_WEIGHT = 1e-6


@dataclass(frozen=True)
class FramePath:
    """Kernel arguments of consecutive frames of one problem.

    Attributes:
        problem: Goals and joints.
        targets: Packed targets ``(F, E, W)``.
        soft_reach: Extension of soft and stretching limbs.
        preserved_steps: Motion between frames that smoothing preserves ``(F - 1, D)``.
        options: Tolerances.
    """

    problem: Problem
    targets: FloatArray
    soft_reach: SoftReach
    preserved_steps: FloatArray
    options: IkOptions

    def select_frames(self, frames: slice) -> FramePath:
        """Return the path restricted to consecutive frames."""
        steps = self.preserved_steps[frames.start : frames.stop - 1]
        frame_indices = np.arange(len(self.targets))[frames]
        targets, soft_reach = self.targets[frames], self.soft_reach[frame_indices]
        return replace(
            self, targets=targets, soft_reach=soft_reach, preserved_steps=steps
        )

    def steps(self, poses: FloatArray) -> FloatArray:
        """Return steps between poses ``(F, C)``, minus the preserved steps."""
        steps = joint_steps(self.problem.chain, poses[:-1], poses[1:])
        return steps - self.preserved_steps

    def smooth(
        self, poses: FloatArray, acceleration: float
    ) -> tuple[FloatArray, FloatArray]:
        """Return smoothed poses ``(F, C)`` and their misses ``(F, E, 4)``.

        Long paths are smoothed in blocks. Each continues the previous one and looks
        ahead as far as later frames matter.
        """
        term_weights = (1.0, 0.0, acceleration)
        lookahead_frames = math.ceil(LOOKAHEAD_FACTOR * acceleration**0.25)
        block_size = max(MIN_BLOCK_FRAMES, 4 * lookahead_frames)
        smooth_poses = np.zeros_like(poses)
        misses = []
        block_start = 0
        while block_start < len(poses):
            is_last = block_start + block_size + lookahead_frames >= len(poses)
            block_end = len(poses) if is_last else block_start + block_size
            window_start = max(block_start - 2, 0)
            window = slice(window_start, min(block_end + lookahead_frames, len(poses)))
            later_poses = poses[block_start : window.stop]
            start_poses = np.concatenate(
                [smooth_poses[window_start:block_start], later_poses]
            )
            moving_range = (block_start - window_start, len(start_poses))
            path, path_misses = self.select_frames(window)._run_kernel(
                start_poses, term_weights, moving_range, MAX_ITERATIONS
            )
            block = slice(block_start - window_start, block_end - window_start)
            smooth_poses[block_start:block_end] = path[block]
            misses.append(path_misses[block])
            block_start = block_end
        return smooth_poses, np.concatenate(misses)

    def with_even_speed(
        self, poses: FloatArray, *, is_start_free: bool = False
    ) -> tuple[FloatArray, FloatArray]:
        """Return poses that move from the first to the last pose at an even speed.

        The last pose is fixed, and so is the first unless ``is_start_free``.
        """
        moving_range = (0 if is_start_free else 1, len(poses) - 1)
        return self._run_kernel(
            poses, (ORIGINAL_PATH_WEIGHT, 1.0, 0.0), moving_range, MAX_ITERATIONS
        )

    def measure_misses(self, poses: FloatArray) -> FloatArray:
        """Return the misses of poses ``(F, E, 4)``."""
        return self._run_kernel(poses, (1.0, 0.0, 0.0), (0, 0), 0)[1]

    def tolerance_ratios(self, misses: FloatArray) -> FloatArray:
        """Return the miss of each goal, divided by its tolerance ``(F, E)``."""
        tolerances = by_unit(self.options.tolerance, self.options.angle_tolerance)
        return np.asarray((misses / tolerances).max(axis=2, initial=0.0))

    def max_tolerance_ratio(self, misses: FloatArray) -> FloatArray:
        """Return each frame's largest miss, divided by its tolerance ``(F,)``."""
        return np.asarray(self.tolerance_ratios(misses).max(axis=1, initial=0.0))

    def _run_kernel(
        self,
        poses: FloatArray,
        weights: tuple[float, float, float],
        moving_range: tuple[int, int],
        max_iterations: int,
    ) -> tuple[FloatArray, FloatArray]:
        """Return poses and misses from the kernel that smooths frames."""
        chain = self.problem.chain
        anchor, speed, acceleration = weights
        first, end = moving_range
        kernel_output = _kernels.smooth_ik(
            *chain.kernel_arrays,
            path=unwrap_angles(chain, poses),
            targets=self.targets,
            reachable=self.soft_reach.reachable_targets,
            stretches=self.soft_reach.bone_scales,
            drifts=self.preserved_steps,
            anchor=anchor,
            speed=speed,
            acceleration=acceleration,
            first=first,
            end=end,
            length_tolerance=self.options.tolerance,
            angle_tolerance=self.options.angle_tolerance,
            damping=WARM_DAMPING,
            rounds=max_iterations,
        )
        return kernel_output[0], kernel_output[1]


def build_frame_path(
    problem: Problem, targets: Targets, start: ArrayLike | None, options: IkOptions
) -> FramePath:
    """Build the frame path of a problem.

    A start with a pose per frame ``(F, Q)`` keeps its motion.
    """
    packed_targets = pack_for_chain(problem, targets)
    preserved_steps = np.zeros((max(len(packed_targets) - 1, 0), problem.degrees))
    if start is not None and np.ndim(start) == 2:
        chain = problem.chain
        start_rows = pose_rows(problem, start, len(packed_targets), "start")
        source_poses = chain.from_rig(start_rows)
        preserved_steps = joint_steps(chain, source_poses[:-1], source_poses[1:])
    soft_reach = extend_softly(problem.limbs, packed_targets)
    return FramePath(problem, packed_targets, soft_reach, preserved_steps, options)


def goal_steps(problem: Problem, targets: FloatArray) -> FloatArray:
    """Return the largest motion of the goals from frame to frame ``(F - 1,)``.

    It is in radians, or fractions of the problem's length, and covers the goals that
    are active in both frames. ``targets`` ``(F, E, W)``.
    """
    is_weighted = targets[:, :, WEIGHT_COLUMNS] > 0
    is_active = is_weighted[1:] & is_weighted[:-1]
    is_used = np.array([goal.weights for goal in problem.goals]) > 0
    steps_of_goals = np.zeros(is_active.shape)
    for i, kind in enumerate(GOAL_KINDS):
        values = targets[:, :, TARGET_COLUMNS[kind.name]]
        if kind.is_rotation:
            steps_of_goals[:, :, i] = so3.angle_between(values[1:], values[:-1])
        else:
            steps_of_goals[:, :, i] = np.linalg.norm(np.diff(values, axis=0), axis=2)
    steps_of_goals = np.where(is_active & is_used, steps_of_goals, 0.0)
    return np.asarray(steps_of_goals.max(axis=(1, 2), initial=0.0))


def find_clip_jumps(
    result: IkResult, targets: Targets, start: ArrayLike | None, fps: float
) -> tuple[Jump, ...]:
    """Return the jumps of a clip's poses, see `find_jumps`.

    ``start`` ``(F, Q)``: the source poses; None, or one pose, is static.
    """
    problem = result.problem
    source_poses = None
    if start is not None and np.ndim(start) == 2:
        source_poses = pose_rows(problem, start, len(result.coordinates), "start")
    goal_moves = goal_steps(problem, pack_for_chain(problem, targets))
    coordinates, translations = result.coordinates, result.local_translations()
    return _find_jumps(
        problem, coordinates, translations, source_poses, goal_moves, fps
    )


def find_jumping_frames(
    path: FramePath,
    poses: FloatArray,
    coordinates: FloatArray,
    source_poses: FloatArray | None,
    fps: float,
) -> IntArray:
    """Return the frames at which a joint jumps, ascending.

    Args:
        path: The path of F frames.
        poses: Chain coordinates ``(F, C)``.
        coordinates: Rig coordinates of the other joints ``(F, Q)``.
        source_poses: The source motion ``(F, Q)``; None if there is no source.
        fps: Frames a second.
    """
    problem = path.problem
    coordinates = with_mimics(
        problem.rig, problem.chain.into_rig(poses, coordinates), problem.joints
    )
    goal_moves = goal_steps(problem, path.targets)
    jumps = _find_jumps(problem, coordinates, None, source_poses, goal_moves, fps)
    return np.array(sorted({jump.frame for jump in jumps}), np.int64)


def _find_jumps(
    problem: Problem,
    coordinates: FloatArray,
    translations: FloatArray | None,
    source_poses: FloatArray | None,
    goal_moves: FloatArray,
    fps: float,
) -> tuple[Jump, ...]:
    """Find the jumps of coordinates ``(F, Q)``, including stretched bones."""
    local = local_from_coordinates(problem.rig, coordinates)
    if translations is not None:
        local = replace(local, translations=translations)
    return find_jumps(
        problem.rig.names,
        None
        if source_poses is None
        else local_from_coordinates(problem.rig, source_poses),
        local,
        goal_moves,
        fps=fps,
        length=problem.length,
        revolutions=full_revolutions(problem.rig, coordinates),
    )


def full_revolutions(rig: Rig, coordinates: FloatArray) -> FloatArray:
    """Return full revolutions of pins from frame to frame ``(F - 1, J)`` [rad].

    Only pins with limits wider than a revolution have any: their rotation does not
    show the revolution, but a cable would. ``coordinates`` ``(F, Q)``.
    """
    revolutions = np.zeros((max(len(coordinates) - 1, 0), len(rig.joints)))
    for j, columns in enumerate(coordinate_slices(rig)):
        limits = rig.joints[j].limits
        is_pin = rig.joints[j].type is JointType.PIN
        if not is_pin or not isinstance(limits, RangeLimit):
            continue
        if 2 * np.pi + REVOLUTION_EXCESS < limits.high - limits.low < np.inf:
            steps = np.diff(coordinates[:, columns.start]) / (2 * np.pi)
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
    check_loaded(result, IkResult, "result")
    check_loaded(targets, Targets, "targets")
    options = options or IkOptions()
    faults = smoothing_faults(seconds, fps)
    if faults:
        raise OptionError(faults)
    if seconds == 0 or len(result.coordinates) < 3:
        return result
    path = build_frame_path(result.problem, targets, start, options)
    poses = result.problem.chain.from_rig(result.coordinates)
    poses, misses = path.smooth(poses, (seconds * fps) ** 4)
    return with_poses(result, poses, misses, path)


def smoothing_faults(seconds: float, fps: float) -> list[Fault]:
    """Return the faults in a smoothing time and a frame rate."""
    faults = []
    if not (np.isfinite(seconds) and seconds >= 0):
        faults.append(Fault("IK014", f"smooth must be at least 0, not {seconds}"))
    if not (np.isfinite(fps) and fps > 0):
        faults.append(Fault("IK014", f"fps must be more than 0, not {fps}"))
    return faults


def with_poses(
    result: IkResult, poses: FloatArray, misses: FloatArray, path: FramePath
) -> IkResult:
    """Return a result with its chain poses ``(F, C)`` and misses replaced."""
    problem = result.problem
    coordinates = problem.chain.into_rig(poses, result.coordinates)
    is_reached = path.max_tolerance_ratio(misses) <= 1
    statuses = tuple(
        IkStatus.CONVERGED
        if is_frame_reached
        else IkStatus.NEAREST
        if status is IkStatus.CONVERGED
        else status
        for is_frame_reached, status in zip(is_reached, result.statuses, strict=True)
    )
    return replace(
        result,
        coordinates=with_mimics(problem.rig, coordinates, problem.joints),
        statuses=statuses,
        misses=misses * by_unit(problem.length, 1.0),
        reached=path.tolerance_ratios(misses) <= 1,
    )
