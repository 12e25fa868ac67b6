"""Solves the frame spans of a take, and assembles the resulting take."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from animtool.core.array_types import BoolArray, FloatArray, IntArray
from animtool.core.errors import Fault
from animtool.core.record import dataclass
from animtool.core.values import plain_value
from animtool.ik.chain_frame import SolveSpan
from animtool.ik.goals import GOAL_PARTS, Goal, Targets, targets_of_frames
from animtool.ik.jumps import Jump, find_jumps
from animtool.ik.nearest import with_nearest_poses
from animtool.ik.options import IkMethod, IkOptions, TakeOptions
from animtool.ik.path import (
    find_clip_jumps,
    full_revolutions,
    goal_steps,
    smooth,
    smoothing_faults,
)
from animtool.ik.problem import Problem, build, rest_weight_faults
from animtool.ik.result import IkResult, IkStatus, frames_on_limits
from animtool.ik.solving import (
    option_faults,
    pack_for_chain,
    solve_in_frame,
    supported_methods,
)
from animtool.ik.sub_rig import find_mimics
from animtool.ik.tracks import GoalTrack, TargetTracks
from animtool.maths import so3
from animtool.motion.take import Take
from animtool.rig.joints import (
    LocalTransforms,
    coordinate_slices,
    local_from_coordinates,
)
from animtool.rig.kinematics import WorldTransforms
from animtool.rig.skeleton import Rig

# Coordinates that change by less keep their source value.
EQUAL_COORDINATE_TOLERANCE = 1e-12
# Methods that search a clip across branches; the others exist for comparison.
PATH_METHODS = frozenset({IkMethod.AUTO, IkMethod.DAMPED, IkMethod.TWO_BONE})
# Smoothing times tried where joints jump [s], and the factor by which a jump must
# shrink for the smoothing to be suggested.
TRIAL_SMOOTHING_TIMES, MIN_REDUCTION = (0.1, 0.3), 0.9
# Distance of a pole in chain lengths, so far that only its direction matters.
POLE_DISTANCE = 10.0


@dataclass(frozen=True)
class TakeIk:
    """A take solved for targets, and its misses.

    Attributes:
        take: The take with solved poses of the joints that move a goal.
        tracks: The targets.
        problem: Problem of the first frame.
        active: Mask of the active parts of goals ``(F, E, 4)``.
        misses: Misses of position [m], orientation, aim and pole [rad] ``(F, E, 4)``.
        statuses: Status of each frame ``(F,)``.
        iterations: Number of iterations ``(F,)``.
        descents: Number of starts tried ``(F,)``.
        seconds: Time of all frames [s], the only field that differs between runs.
        jumps: Jumps of joints that no path avoids.
        on_limits: Masks by joint of the frames in which it is on a limit ``(F,)``.
        moving_between: Joints between the solved ones that also move, or that move
            outside their types: each frame was then solved individually.
        target_distances: Smallest distance of each goal's position targets from its
            effector in the source take ``(E,)`` [m]; 0 if it has none.
        size: Largest extent of the rig's joints in the first frame [m].
        steadier: Smoothing that reduces the jumps in a trial; None if there is none.
        open_poles: Mask of the frames in which a pole lies on the line of its bent
            limb ``(F, E)``; None if there are no poles.
    """

    take: Take
    tracks: TargetTracks
    problem: Problem
    active: BoolArray
    misses: FloatArray
    statuses: tuple[IkStatus, ...]
    iterations: IntArray
    descents: IntArray
    seconds: float
    jumps: tuple[Jump, ...]
    on_limits: dict[str, BoolArray]
    moving_between: tuple[str, ...] = ()
    target_distances: tuple[float, ...] = ()
    size: float = 0.0
    steadier: Smoothing | None = None
    open_poles: BoolArray | None = None

    @property
    def frames(self) -> int:
        """Number of frames."""
        return len(self.statuses)

    @property
    def mean_iterations(self) -> float:
        """Mean number of iterations per frame."""
        return float(self.iterations.mean())

    @property
    def max_iterations(self) -> int:
        """Largest number of iterations of a frame."""
        return int(self.iterations.max())

    @property
    def restarts(self) -> int:
        """Number of restarts over all frames."""
        return int((self.descents - 1).clip(min=0).sum())

    @property
    def seconds_per_frame(self) -> float:
        """Mean solve time per frame [s]."""
        return self.seconds / self.frames

    @property
    def microseconds_per_frame(self) -> float:
        """Mean solve time per frame [µs]."""
        return 1e6 * self.seconds / self.frames

    @property
    def status_counts(self) -> dict[str, int]:
        """Number of frames by status."""
        count_by_status = Counter(self.statuses)
        return {
            str(status): count_by_status[status]
            for status in IkStatus
            if count_by_status[status]
        }

    @property
    def limit_counts(self) -> dict[str, int]:
        """Number of frames in which each joint is at a limit; zeros are left out."""
        count_by_joint = {
            name: int(is_on_limit.sum()) for name, is_on_limit in self.on_limits.items()
        }
        return {name: count for name, count in count_by_joint.items() if count}

    @property
    def jumps_at_codes(self) -> list[dict[str, object]]:
        """The jumps as plain values, with time codes as frames."""
        times = self.take.clock.times
        jumps = self.jumps
        return [{**plain_value(jump), "frame": times[jump.frame]} for jump in jumps]


@dataclass(frozen=True, slots=True)
class Smoothing:
    """Result of a trial smoothing.

    Attributes:
        seconds: Smoothing time, as in ``TakeOptions.smooth`` [s].
        max_jump: Largest remaining jump [rad]; 0 if no jump remains.
    """

    seconds: float
    max_jump: float


@dataclass(frozen=True, slots=True)
class SpanSolution:
    """Targets, solved poses and solve time of one span of frames.

    Attributes:
        span: The frame span.
        targets: Packed targets ``(F, E, W)``.
        result: Poses and misses.
        seconds: Solve time [s].
        steadier: Smoothing that reduces the jumps.
    """

    span: SolveSpan
    targets: FloatArray
    result: IkResult
    seconds: float
    steadier: Smoothing | None = None


def join_spans(
    take: Take,
    rig_indices: IntArray,
    local: LocalTransforms,
    tracks: TargetTracks,
    targets: Targets,
    solutions: Sequence[SpanSolution],
    rate: float,
) -> TakeIk:
    """Assemble a take from the solved poses of its frame spans."""
    span_results = [solution.result for solution in solutions]
    motion, problem = take.motion, span_results[0].problem
    rig = solutions[0].span.rig
    changed_names = {*problem.joints, *find_mimics(rig, problem.joints)}
    stretched_joints = {j for limb in problem.limbs for j in limb.joints}
    changed_joints = sorted(
        {rig.index(name) for name in changed_names} | stretched_joints
    )
    translations, rotations = (
        local.translations[:, changed_joints],
        local.rotations[:, changed_joints],
    )
    source_poses = LocalTransforms(translations.copy(), rotations.copy())
    for solution in solutions:
        span, frames = solution.span, solution.span.frames
        solved_rows, source_rows = solution.result.coordinates, span.coordinates
        solved_poses = local_from_coordinates(span.rig, solved_rows)
        local_translations = solution.result.local_translations()
        slices = coordinate_slices(span.rig)
        for i, j in enumerate(changed_joints):
            change = np.abs(solved_rows[:, slices[j]] - source_rows[:, slices[j]])
            is_changed = change.max(axis=1, initial=0.0) > EQUAL_COORDINATE_TOLERANCE
            is_stretched = local_translations[:, j] != solved_poses.translations[:, j]
            is_changed |= is_stretched.any(axis=1)
            translations[frames, i][is_changed] = local_translations[is_changed, j]
            rotations[frames, i][is_changed] = solved_poses.rotations[is_changed, j]
    indices, aligned_rotations = rig_indices[changed_joints], so3.align_signs(rotations)
    motion = replace(
        motion,
        translations=motion.translations.put(indices, translations).compact(),
        rotations=motion.rotations.put(indices, aligned_rotations).compact(),
    )
    packed_targets = np.concatenate([solution.targets for solution in solutions])
    coordinates = np.concatenate([result.coordinates for result in span_results])
    jumps = find_jumps(
        [rig.names[j] for j in changed_joints],
        source_poses,
        LocalTransforms(translations, rotations),
        goal_steps(problem, packed_targets),
        fps=rate,
        length=problem.length,
        revolutions=full_revolutions(rig, coordinates)[:, changed_joints],
    )
    goal_weights = [track.goal.weights for track in tracks.goals]
    active_weights = np.asarray(targets.weights) * goal_weights
    limit_masks = [frames_on_limits(r.problem, r.coordinates) for r in span_results]
    return TakeIk(
        replace(take, motion=motion),
        tracks,
        problem,
        active_weights > 0,
        np.concatenate([result.misses for result in span_results]),
        tuple(status for result in span_results for status in result.statuses),
        np.concatenate([result.iterations for result in span_results]),
        np.concatenate([result.descents for result in span_results]),
        sum(solution.seconds for solution in solutions),
        jumps,
        {
            name: np.concatenate([masks[name] for masks in limit_masks])
            for name in limit_masks[0]
        },
        steadier=solutions[0].steadier if jumps else None,
    )


def take_option_faults(options: TakeOptions) -> dict[str, list[Fault]]:
    """Return faults that do not depend on the take, by option.

    >>> faults = take_option_faults(TakeOptions(seed=-1, smooth=-0.1))
    >>> [name for name, found in faults.items() if found]
    ['seed', 'smooth']
    """
    solver_options = IkOptions(
        tolerance=options.tolerance,
        angle_tolerance=options.angle_tolerance,
        restarts=options.restarts,
        seed=options.seed,
        seconds=options.seconds,
    )
    return {
        **option_faults(solver_options),
        "rest_weight": rest_weight_faults(options.rest_weight),
        "smooth": smoothing_faults(options.smooth, 1.0),
    }


@dataclass(frozen=True, slots=True)
class TakeSolver:
    """Solves the IK of a take, one frame span at a time."""

    rig: Rig
    tracks: TargetTracks
    targets: Targets
    world: WorldTransforms
    options: TakeOptions
    joints: list[str] | None
    is_static: bool
    rate: float

    @property
    def goals(self) -> list[Goal]:
        """The goal of each track, in the order of the tracks."""
        return [track.goal for track in self.tracks.goals]

    def solve_span(self, span: SolveSpan) -> SpanSolution:
        """Return the solution of a frame span."""
        problem = self._build_problem(span, self.goals)
        targets = span.to_chain_frame(self.targets)
        packed_targets = pack_for_chain(problem, targets)
        if not self.is_static:
            start = span.coordinates
            result, seconds = self._timed_solve(
                problem, start, targets, is_warm_started=False
            )
            steadier = self._find_steadier_smoothing(result, targets, start)
            return SpanSolution(span, packed_targets, result, seconds, steadier)
        bent_start, bent_seconds = self._solve_bent_start(span, problem, targets)
        start, start_seconds = self._solve_start(span, problem, bent_start, targets)
        result, seconds = self._timed_solve(
            problem, start, targets, is_warm_started=True, prefer=span.coordinates[0]
        )
        seconds += bent_seconds + start_seconds
        steadier = self._find_steadier_smoothing(result, targets, None)
        return SpanSolution(span, packed_targets, result, seconds, steadier)

    def _find_steadier_smoothing(
        self, result: IkResult, targets: Targets, start: FloatArray | None
    ) -> Smoothing | None:
        """Return the trial smoothing with the smallest jumps; None if none helps."""
        angles = [jump.size for jump in result.jumps if not jump.slides]
        if not angles or self.options.smooth > 0:
            return None
        best_smoothing = Smoothing(0.0, MIN_REDUCTION * max(angles))
        for seconds in TRIAL_SMOOTHING_TIMES:
            options = self._solver_options(
                result.problem, is_warm_started=start is None
            )
            smoothed_result = smooth(
                result, targets, seconds, fps=self.rate, start=start, options=options
            )
            jumps = find_clip_jumps(smoothed_result, targets, start, self.rate)
            max_jump = max(
                (jump.size for jump in jumps if not jump.slides), default=0.0
            )
            if max_jump < MIN_REDUCTION * best_smoothing.max_jump:
                best_smoothing = Smoothing(seconds, max_jump)
        return best_smoothing if best_smoothing.seconds > 0 else None

    def _build_problem(self, span: SolveSpan, goals: Sequence[Goal]) -> Problem:
        """Return the problem of goals in a frame span."""
        return build(
            span.rig,
            goals,
            joints=self.joints,
            pose=span.coordinates[0],
            rest_weight=self.options.rest_weight,
        )

    def _solve_start(
        self, span: SolveSpan, problem: Problem, start: FloatArray, targets: Targets
    ) -> tuple[FloatArray, float]:
        """Return the start of the first frame ``(Q,)``, and the time it took [s].

        If it needs restarts, that is a solution near the source pose; otherwise the
        clip would keep the random pose of a restart.
        """
        targets, prefer = targets_of_frames(targets, slice(0, 1)), span.coordinates[0]
        start_result, seconds = self._timed_solve(
            problem, start, targets, is_warm_started=False, prefer=prefer
        )
        is_restarted = start_result.descents[0] > 1 and bool(start_result.converged[0])
        return start_result.coordinates[0] if is_restarted else start, seconds

    def _solve_bent_start(
        self, span: SolveSpan, problem: Problem, targets: Targets
    ) -> tuple[FloatArray, float]:
        """Return a start ``(Q,)`` with bent chains, and the time it took [s].

        They bend towards their poles as far as they can. The goals are solved from
        there, so that an unreachable pole does not compromise them; each frame starts
        from the previous one, which keeps the side.
        """
        poles = np.array(targets.poles)[:1]
        start_weights = np.array(targets.weights)[:1]
        goals = self.goals
        origins = self.world.positions[span.frames.start]
        for goal_index, track in enumerate(self.tracks.goals):
            if track.goal.pole or not _has_bend_direction(problem, track, origins):
                continue
            if not (start_weights[0, goal_index] * track.goal.weights).any():
                continue
            goals[goal_index] = replace(track.goal, pole=1.0)
            point = _distant_pole(self.rig, track, self.world, span.frames.start)
            (
                poles[:, goal_index],
                start_weights[:, goal_index, GOAL_PARTS.index("pole")],
            ) = point, 1.0
        if goals == self.goals:
            return span.coordinates[0], 0.0
        bent_problem = self._build_problem(span, goals)
        if self.options.method not in supported_methods(bent_problem):
            return span.coordinates[0], 0.0
        first_targets = targets_of_frames(targets, slice(0, 1))
        bent_targets = replace(first_targets, poles=poles, weights=start_weights)
        start = span.coordinates[0]
        bent_result, seconds = self._timed_solve(
            bent_problem, start, bent_targets, is_warm_started=True, restarts=0
        )
        return bent_result.coordinates[0], seconds

    def _timed_solve(
        self,
        problem: Problem,
        starts: FloatArray,
        targets: Targets,
        *,
        is_warm_started: bool,
        restarts: int | None = None,
        prefer: FloatArray | None = None,
    ) -> tuple[IkResult, float]:
        """Solve a problem; return the result and the elapsed time [s]."""
        options = self.options
        frame_options = self._solver_options(
            problem, is_warm_started=is_warm_started, restarts=restarts
        )
        start_time = time.perf_counter()
        if options.method in PATH_METHODS and len(np.asarray(targets.positions)) > 1:
            from animtool.ik.clip_path import FollowOptions
            from animtool.ik.clip_solver import follow_in_frame

            is_searched = restarts is None
            follow_options = FollowOptions(
                frame_options,
                self.rate,
                smooth=options.smooth if is_searched else 0.0,
                branches=FollowOptions().branches if is_searched else 0,
            )
            result = follow_in_frame(
                problem, starts, targets, follow_options, prefer=prefer
            )
        else:
            result = solve_in_frame(
                problem, starts, targets, frame_options, prefer=prefer
            )
            if options.method in PATH_METHODS and restarts is None:
                rows = result.coordinates if prefer is None else prefer
                preferred_rows = np.broadcast_to(rows, result.coordinates.shape)
                result = with_nearest_poses(
                    problem, result, targets, frame_options, preferred_rows
                )
        return result, time.perf_counter() - start_time

    def _solver_options(
        self, problem: Problem, *, is_warm_started: bool, restarts: int | None = None
    ) -> IkOptions:
        """Return the solver options of a problem's frames."""
        options = self.options
        return IkOptions(
            method=options.method,
            tolerance=options.tolerance / problem.length,
            angle_tolerance=options.angle_tolerance,
            restarts=options.restarts if restarts is None else restarts,
            seed=options.seed,
            seconds=options.seconds,
            warm=is_warm_started,
            near=not is_warm_started,
        )


def _has_bend_direction(
    problem: Problem, track: GoalTrack, origins: FloatArray
) -> bool:
    """Return whether a goal's chain has a pole direction and a middle joint.

    ``origins`` ``(J, 3)``.
    """
    chain, rig = track.chain, problem.rig
    if chain is None or chain.pole_dir is None or not track.goal.position:
        return False
    bone_count, j, root_index = 0, rig.index(chain.tip), rig.index(chain.root)
    point_below = origins[j]
    while j >= root_index:
        if rig.names[j] in problem.joints and (origins[j] != point_below).any():
            bone_count, point_below = bone_count + 1, origins[j]
        j = rig.joints[j].parent
    return bone_count > 1


def _distant_pole(
    rig: Rig, track: GoalTrack, world: WorldTransforms, frame: int
) -> FloatArray:
    """Return a point far along a chain's pole direction from its root ``(3,)`` [m]."""
    chain = track.chain
    assert chain is not None
    root = rig.index(chain.root)
    origin, tip = world.positions[frame, [root, rig.index(chain.tip)]]
    chain_length = np.linalg.norm(tip - origin)
    direction = np.array(chain.pole_dir, np.float64)
    parent = rig.joints[root].parent
    if parent >= 0:
        direction = world.linear[frame, parent] @ direction
    return np.asarray(origin + direction * POLE_DISTANCE * chain_length)
