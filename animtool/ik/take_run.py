"""Solving the parts of a take, and the take that comes of it."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from animtool.core.array_types import BoolArray, FloatArray, IntArray
from animtool.core.errors import Fault, OptionError
from animtool.core.record import dataclass
from animtool.core.values import plain_value
from animtool.ik.chain_frame import Part
from animtool.ik.goals import PARTS, Goal, Targets, rows_of
from animtool.ik.jumps import Jump, find_jumps
from animtool.ik.nearest import settled
from animtool.ik.options import IkMethod, IkOptions, TakeOptions
from animtool.ik.path import goal_moves, jumps_of, rate_faults, smooth, windings
from animtool.ik.problem import Problem, build, rest_faults
from animtool.ik.result import IkResult, IkStatus, frames_on_limits
from animtool.ik.solving import chain_targets, option_faults, serving, solve
from animtool.ik.sub_rig import mimics
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

# Coordinates that a solve changes by less, it leaves as they were.
UNCHANGED = 1e-12
# Those that follow a clip over other branches; the others are there for comparison.
FOLLOWED = frozenset({IkMethod.AUTO, IkMethod.DAMPED, IkMethod.TWO_BONE})
# Times over which motion is smoothed on trial, where joints jump [s]; what makes jumps
# no smaller than this share is no cure.
TRIED_SMOOTHING, SMALLER = (0.1, 0.3), 0.9
# A pole stands this many lengths of its chain away, so that only its side counts.
FAR = 10.0


@dataclass(frozen=True)
class TakeIk:
    """A take that was brought to targets, and what it misses.

    Attributes:
        take: With other poses of the joints that move a goal.
        tracks: What was asked.
        problem: Of the first frame.
        asked: Which parts each goal asked for in each frame ``(F, E, 4)``.
        misses: Of position [m], orientation, aim and pole [rad] ``(F, E, 4)``.
        statuses: ``(F,)``.
        iterations: ``(F,)``.
        descents: Starts tried ``(F,)``.
        seconds: Time of all frames [s], the one part that differs between runs.
        jumps: Where joints jump and no steadier path was found.
        on_limits: By joint, in which frames it stands on a limit ``(F,)``.
        between: Joints between those that were solved which move by themselves, or in
            ways that their types have not: each frame was then solved on its own.
        away: How far the positions that each goal asks for are from its effector in
            the take, in the frame where they are nearest ``(E,)`` [m]; 0 of none.
        size: Of the rig, the largest extent of its joints in the first frame [m].
        steadier: Smoothing that a trial found to leave smaller jumps; None where there
            are none, or none was found.
    """

    take: Take
    tracks: TargetTracks
    problem: Problem
    asked: BoolArray
    misses: FloatArray
    statuses: tuple[IkStatus, ...]
    iterations: IntArray
    descents: IntArray
    seconds: float
    jumps: tuple[Jump, ...]
    on_limits: dict[str, BoolArray]
    between: tuple[str, ...] = ()
    away: tuple[float, ...] = ()
    size: float = 0.0
    steadier: Smoothing | None = None

    @property
    def frames(self) -> int:
        """Number of frames."""
        return len(self.statuses)

    @property
    def mean_iterations(self) -> float:
        """Iterations of a frame in the mean."""
        return float(self.iterations.mean())

    @property
    def max_iterations(self) -> int:
        """Iterations of a frame at most."""
        return int(self.iterations.max())

    @property
    def restarts(self) -> int:
        """How often frames were begun again."""
        return int((self.descents - 1).clip(min=0).sum())

    @property
    def seconds_per_frame(self) -> float:
        """How long a frame took [s]."""
        return self.seconds / self.frames

    @property
    def microseconds_per_frame(self) -> float:
        """How long a frame took [µs]."""
        return 1e6 * self.seconds / self.frames

    @property
    def status_counts(self) -> dict[str, int]:
        """How many frames ended how."""
        counts = Counter(self.statuses)
        return {str(status): counts[status] for status in IkStatus if counts[status]}

    @property
    def limit_counts(self) -> dict[str, int]:
        """In how many frames joints stand on a limit, those that ever do."""
        counts = {name: int(on.sum()) for name, on in self.on_limits.items()}
        return {name: count for name, count in counts.items() if count}

    @property
    def jumps_at_codes(self) -> list[dict[str, object]]:
        """The jumps as plain values, their frames as time codes."""
        times = self.take.clock.times
        return [{**plain_value(one), "frame": times[one.frame]} for one in self.jumps]


@dataclass(frozen=True, slots=True)
class Smoothing:
    """What evening out motion over some time would leave.

    Attributes:
        seconds: The time, as of ``TakeOptions.smooth`` [s].
        angle: The largest turn of a joint that would still be a jump [rad]; 0 of none.
    """

    seconds: float
    angle: float


@dataclass(frozen=True, slots=True)
class SolvedPart:
    """The solution of a part.

    Attributes:
        part: Which frames, and what the chain hangs from in them.
        targets: As the chain takes them ``(F, E, W)``.
        result: Poses and misses.
        seconds: How long it took [s].
        steadier: Smoothing that leaves smaller jumps.
    """

    part: Part
    targets: FloatArray
    result: IkResult
    seconds: float
    steadier: Smoothing | None = None


def gathered_take(
    take: Take,
    own: IntArray,
    local: LocalTransforms,
    tracks: TargetTracks,
    targets: Targets,
    parts: Sequence[SolvedPart],
    rate: float,
) -> TakeIk:
    """Return a take with the poses that its parts were brought to."""
    results = [one.result for one in parts]
    motion = take.motion
    rig = parts[0].part.rig
    names = {*results[0].problem.joints, *mimics(rig, results[0].problem.joints)}
    stretched = {j for limb in results[0].problem.limbs for j in limb.joints}
    joints = sorted({rig.index(name) for name in names} | stretched)
    places, turns = local.translations[:, joints], local.rotations[:, joints]
    source = LocalTransforms(places.copy(), turns.copy())
    for one in parts:
        span = one.part.frames
        rows, before = one.result.coordinates, one.part.coordinates
        locals_of_part = local_from_coordinates(one.part.rig, rows)
        longer = one.result.local_translations()
        slices = coordinate_slices(one.part.rig)
        for i, j in enumerate(joints):
            change = np.abs(rows[:, slices[j]] - before[:, slices[j]])
            grown = (longer[:, j] != locals_of_part.translations[:, j]).any(axis=1)
            moved = (change.max(axis=1, initial=0.0) > UNCHANGED) | grown
            places[span, i][moved] = longer[moved, j]
            turns[span, i][moved] = locals_of_part.rotations[moved, j]
    index = own[joints]
    motion = replace(
        motion,
        translations=motion.translations.put(index, places).compact(),
        rotations=motion.rotations.put(index, so3.align_signs(turns)).compact(),
    )
    problem = results[0].problem
    jumps = find_jumps(
        [rig.names[j] for j in joints],
        source,
        LocalTransforms(places, turns),
        goal_moves(problem, np.concatenate([one.targets for one in parts])),
        fps=rate,
        length=problem.length,
        windings=windings(rig, np.concatenate([one.coordinates for one in results]))[
            :, joints
        ],
    )
    asked = np.asarray(targets.weights) * [goal.goal.weights for goal in tracks.goals]
    limits = [frames_on_limits(one.problem, one.coordinates) for one in results]
    return TakeIk(
        replace(take, motion=motion),
        tracks,
        problem,
        asked > 0,
        np.concatenate([one.misses for one in results]),
        tuple(status for one in results for status in one.statuses),
        np.concatenate([one.iterations for one in results]),
        np.concatenate([one.descents for one in results]),
        sum(one.seconds for one in parts),
        jumps,
        {name: np.concatenate([one[name] for one in limits]) for name in limits[0]},
        steadier=parts[0].steadier if jumps else None,
    )


def take_option_faults(options: TakeOptions) -> dict[str, list[Fault]]:
    """Return what makes no sense for any take, by option.

    >>> faults = take_option_faults(TakeOptions(seed=-1, smooth=-0.1))
    >>> [name for name, found in faults.items() if found]
    ['seed', 'smooth']
    """
    solving = IkOptions(
        tolerance=options.tolerance,
        angle_tolerance=options.angle_tolerance,
        restarts=options.restarts,
        seed=options.seed,
        seconds=options.seconds,
    )
    return {
        **option_faults(solving),
        "rest_weight": rest_faults(options.rest_weight),
        "smooth": rate_faults(options.smooth, 1.0),
    }


def check_options(options: TakeOptions) -> None:
    """Refuse options that make no sense."""
    faults = [
        fault for found in take_option_faults(options).values() for fault in found
    ]
    if faults:
        raise OptionError(faults)


@dataclass(frozen=True, slots=True)
class TakeRun:
    """How the parts of a take are solved."""

    rig: Rig
    tracks: TargetTracks
    targets: Targets
    world: WorldTransforms
    options: TakeOptions
    joints: list[str] | None
    still: bool
    rate: float

    @property
    def goals(self) -> list[Goal]:
        """The goals of the tracks."""
        return [track.goal for track in self.tracks.goals]

    def solved(self, part: Part) -> SolvedPart:
        """Return the solution of a part."""
        problem = self._problem(part, self.goals)
        targets = part.to_chain_frame(self.targets)
        packed = chain_targets(problem, targets)
        if not self.still:
            start = part.coordinates
            done = self._timed(problem, start, targets, warm=False)
            return SolvedPart(
                part, packed, *done, self._steadier(done[0], targets, start)
            )
        bent, seconds = self._bent(part, problem, targets)
        start, more = self._begun(part, problem, bent, targets)
        kept = part.coordinates[0]
        done = self._timed(problem, start, targets, warm=True, prefer=kept)
        seconds += more + done[1]
        steadier = self._steadier(done[0], targets, None)
        return SolvedPart(part, packed, done[0], seconds, steadier)

    def _steadier(
        self, result: IkResult, targets: Targets, start: FloatArray | None
    ) -> Smoothing | None:
        """Return the smoothing that leaves the smallest jumps, if any helps."""
        turns = [jump.size for jump in result.jumps if not jump.slides]
        if not turns or self.options.smooth > 0:
            return None
        best = Smoothing(0.0, SMALLER * max(turns))
        for seconds in TRIED_SMOOTHING:
            options = self._chosen(result.problem, warm=start is None)
            trial = smooth(
                result, targets, seconds, fps=self.rate, start=start, options=options
            )
            jumps = jumps_of(trial, targets, start, self.rate)
            angle = max((jump.size for jump in jumps if not jump.slides), default=0.0)
            if angle < SMALLER * best.angle:
                best = Smoothing(seconds, angle)
        return best if best.seconds > 0 else None

    def _problem(self, part: Part, goals: Sequence[Goal]) -> Problem:
        return build(
            part.rig,
            goals,
            joints=self.joints,
            pose=part.coordinates[0],
            rest_weight=self.options.rest_weight,
        )

    def _begun(
        self, part: Part, problem: Problem, start: FloatArray, targets: Targets
    ) -> tuple[FloatArray, float]:
        """Return where the first frame starts ``(Q,)``, and the time it took [s].

        If it needs new starts, that is a solution near the pose of the part; what is
        followed from any other would stay as random as these are.
        """
        first = rows_of(targets, slice(0, 1))
        kept = part.coordinates[0]
        poses, seconds = self._timed(problem, start, first, warm=False, prefer=kept)
        new = poses.descents[0] > 1 and bool(poses.converged[0])
        return poses.coordinates[0] if new else start, seconds

    def _bent(
        self, part: Part, problem: Problem, targets: Targets
    ) -> tuple[FloatArray, float]:
        """Return a first pose ``(Q,)`` with bent chains, and the time it took [s].

        They bend towards their poles as far as they can. The goals are solved from
        there, so that a pole that cannot be had takes nothing from them, and every
        frame from the one before, which keeps the side.
        """
        poles = np.array(targets.poles)[:1]
        weights = np.array(targets.weights)[:1]
        goals = self.goals
        origins = self.world.positions[part.frames.start]
        for e, track in enumerate(self.tracks.goals):
            if track.goal.pole or not _bends(problem, track, origins):
                continue
            if not (weights[0, e] * track.goal.weights).any():
                continue
            goals[e] = replace(track.goal, pole=1.0)
            point = _pole(self.rig, track, self.world, part.frames.start)
            poles[:, e], weights[:, e, PARTS.index("pole")] = point, 1.0
        if goals == self.goals:
            return part.coordinates[0], 0.0
        leaning = self._problem(part, goals)
        if self.options.method not in serving(leaning):
            return part.coordinates[0], 0.0
        first = rows_of(targets, slice(0, 1))
        given = replace(first, poles=poles, weights=weights)
        start = part.coordinates[0]
        poses, seconds = self._timed(leaning, start, given, warm=True, restarts=0)
        return poses.coordinates[0], seconds

    def _timed(
        self,
        problem: Problem,
        starts: FloatArray,
        targets: Targets,
        *,
        warm: bool,
        restarts: int | None = None,
        prefer: FloatArray | None = None,
    ) -> tuple[IkResult, float]:
        """Return a solution, and how long it took [s]."""
        options = self.options
        chosen = self._chosen(problem, warm=warm, restarts=restarts)
        began = time.perf_counter()
        if options.method in FOLLOWED and len(np.asarray(targets.positions)) > 1:
            from animtool.ik.clip_path import FollowOptions
            from animtool.ik.clip_solver import follow

            searched = restarts is None
            way = FollowOptions(
                chosen,
                self.rate,
                smooth=options.smooth if searched else 0.0,
                branches=FollowOptions().branches if searched else 0,
            )
            result = follow(problem, starts, targets, way, prefer=prefer)
        else:
            result = solve(problem, starts, targets, chosen, prefer=prefer)
            if options.method in FOLLOWED and restarts is None:
                rows = result.coordinates if prefer is None else prefer
                wished = np.broadcast_to(rows, result.coordinates.shape)
                result = settled(problem, result, targets, chosen, wished)
        return result, time.perf_counter() - began

    def _chosen(
        self, problem: Problem, *, warm: bool, restarts: int | None = None
    ) -> IkOptions:
        """Return how a problem's frames are solved."""
        options = self.options
        return IkOptions(
            method=options.method,
            tolerance=options.tolerance / problem.length,
            angle_tolerance=options.angle_tolerance,
            restarts=options.restarts if restarts is None else restarts,
            seed=options.seed,
            seconds=options.seconds,
            warm=warm,
            near=not warm,
        )


def _bends(problem: Problem, track: GoalTrack, origins: FloatArray) -> bool:
    """Return whether a goal's chain says where its middle points, and has one.

    ``origins`` ``(J, 3)``.
    """
    chain, rig = track.chain, problem.rig
    if chain is None or chain.pole_dir is None or not track.goal.position:
        return False
    bones, j, end = 0, rig.index(chain.tip), rig.index(chain.root)
    below = origins[j]
    while j >= end:
        if rig.names[j] in problem.joints and (origins[j] != below).any():
            bones, below = bones + 1, origins[j]
        j = rig.joints[j].parent
    return bones > 1


def _pole(rig: Rig, track: GoalTrack, world: WorldTransforms, frame: int) -> FloatArray:
    """Return a point far along the pole direction of a chain ``(3,)`` [m]."""
    chain = track.chain
    assert chain is not None
    root = rig.index(chain.root)
    origin = world.positions[frame, root]
    far = np.linalg.norm(world.positions[frame, rig.index(chain.tip)] - origin)
    direction = np.array(chain.pole_dir, np.float64)
    parent = rig.joints[root].parent
    if parent >= 0:
        direction = world.linear[frame, parent] @ direction
    return np.asarray(origin + direction * FAR * far)
