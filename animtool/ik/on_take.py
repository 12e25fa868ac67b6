"""Bringing a take to targets: each frame a problem, near the pose that it has."""

from __future__ import annotations

import re
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, fields, replace
from fnmatch import fnmatchcase
from pathlib import Path

import numpy as np

from animtool._types import BoolArray, FloatArray, IntArray
from animtool.documents.check import nearest
from animtool.errors import Fault, OptionError
from animtool.ik.carried import Part, parts_of
from animtool.ik.followers import followers
from animtool.ik.free import FreeEffector
from animtool.ik.goals import Goal, Targets, rows_of
from animtool.ik.methods import IkMethod, serving
from animtool.ik.on_limits import frames_on_limits
from animtool.ik.problem import Problem, build
from animtool.ik.result import IkResult, IkStatus, Jump
from animtool.ik.solving import IkOptions, solve
from animtool.ik.sub_rig import sub_rig, with_types
from animtool.ik.take_options import TakeOptions, check_options
from animtool.ik.tracks import GoalTrack, TargetTracks
from animtool.ik.without import rounds, takes_without
from animtool.maths import so3
from animtool.rig.joints import (
    LocalTransforms,
    coordinate_slices,
    local_from_coordinates,
)
from animtool.rig.kinematics import WorldTransforms, forward
from animtool.rig.skeleton import Rig
from animtool.take import Take

__all__ = ["TakeIk", "refuse_scales", "solve_take"]

# Coordinates that a solve changes by less, it leaves as they were.
UNCHANGED = 1e-12
# Those that follow a clip over other branches; the others are there for comparison.
FOLLOWED = frozenset({IkMethod.AUTO, IkMethod.DAMPED, IkMethod.TWO_BONE})
# A pole stands this many lengths of its chain away, so that only its side counts.
FAR = 10.0
# How faults name the goal that they are of.
_GOAL = re.compile(r"goals\[(\d+)\]")


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
        jumps: Where joints jump and no other way was found.
        on_limits: By joint, in which frames it stands on a limit ``(F,)``.
        between: Joints between those that were solved which move by themselves, or in
            ways that their types have not: each frame was then solved on its own.
        away: How far the positions that each goal asks for are from its effector in
            the take, in the frame where they are nearest ``(E,)`` [m]; 0 of none.
        size: Of the rig, the largest extent of its joints in the first frame [m].
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


def solve_take(
    take: Take,
    tracks: TargetTracks,
    options: TakeOptions | None = None,
    *,
    still: bool = False,
    only: int | None = None,
    progress: Callable[[float], None] | None = None,
) -> TakeIk:
    """Return a take brought to targets.

    Each frame starts at the pose that it has. Joints that move no goal keep it, and so
    do all in frames that ask nothing, but for limits: joints that move a goal are
    brought inside theirs.

    Args:
        take: F frames.
        tracks: Its targets.
        options: Tolerances, budget, which joints.
        still: The take is one pose, which need not be kept: each frame starts where
            the one before it ended, and chains bend towards their ``pole_dir``.
        only: Index of the one frame to solve; None is all.
        progress: Called with the share done, 0 to 1.

    Raises:
        OptionError: The targets are of another rate or length (TGT014, TGT015), a joint
            that a goal hangs from is scaled (TGT016), or a goal or option makes no
            sense (IK codes).
        FormatError: A prim's transform is not finite.
    """
    options = options or TakeOptions()
    check_options(options)
    tracks = tracks.placed(take.clock)
    effectors = [(track.name, track.goal.joint) for track in tracks.goals]
    refuse_scales(take, effectors, tracks.path)
    count, done = rounds(tracks), 0
    spent = 0.0

    def bring(wanted: TargetTracks, free: tuple[Take, ...]) -> TakeIk:
        def told(share: float) -> None:
            if progress is not None:
                progress((done + share) / count)

        return _brought(take, wanted, free, options, still, only, told)

    def bring_take(wanted: TargetTracks, free: tuple[Take, ...]) -> Take:
        nonlocal done, spent
        found = bring(wanted, free)
        done, spent = done + 1, spent + found.seconds
        return found.take

    free = takes_without(take, tracks, bring_take)
    found = bring(tracks, free)
    return replace(found, seconds=spent + found.seconds)


def _brought(
    take: Take,
    tracks: TargetTracks,
    free: tuple[Take, ...],
    options: TakeOptions,
    still: bool,
    only: int | None,
    progress: Callable[[float], None],
) -> TakeIk:
    """Return a take at its targets.

    Args:
        take: F frames.
        tracks: Its targets.
        free: By goal, the take without it; of F frames, or the one that is solved.
        options: Tolerances, budget, which joints.
        still: As of `solve_take`.
        only: Likewise.
        progress: Called with the share done.
    """
    goals = [track.goal for track in tracks.goals]
    typed = with_types(take.rig)
    rig, own = sub_rig(typed, (goal.joint for goal in goals))
    joints = _chosen(take.rig, rig, options)
    local = LocalTransforms(
        take.motion.translations.gather(own), take.motion.rotations.gather(own)
    )
    world = forward(rig, local.translations, local.rotations)
    found: list[_Found] = []
    with _placed(tracks):
        loose = tuple(_world(rig, own, one, world) for one in free)
        targets = tracks.sample(rig, take.clock, world, loose)
        if only is not None:
            take, local, world, targets = _selected(take, local, world, targets, only)
        rate = float(take.clock.rate)
        run = _Run(rig, tracks, targets, world, options, joints, still, rate)
        parts = parts_of(rig, local, world, goals, joints)
        for part in parts.all:
            found.append(run.solved(part))
            progress(found[-1].part.frames.stop / take.clock.count)
    gathered = _gathered(take, own, local, tracks, targets, found)
    extent = float(np.ptp(world.positions[0], axis=0).max())
    return replace(
        gathered,
        between=parts.between,
        away=_away(goals, rig, world, targets),
        size=max(extent, gathered.problem.length),
    )


def _away(
    goals: Sequence[Goal], rig: Rig, world: WorldTransforms, targets: Targets
) -> tuple[float, ...]:
    """Return how far each goal's positions are from its effector, where nearest [m]."""
    found = []
    for e, goal in enumerate(goals):
        asked = np.asarray(targets.weights)[:, e, 0] * goal.position > 0
        places = FreeEffector(rig, goal, world).place()[asked]
        ways = np.asarray(targets.positions)[asked, e] - places
        # The longest part of a way needs no square, which huge numbers lack.
        found.append(float(np.abs(ways).max(axis=1).min(initial=np.inf)))
    return tuple(0.0 if away == np.inf else away for away in found)


def _world(
    rig: Rig, own: IntArray, take: Take, like: WorldTransforms
) -> WorldTransforms:
    """Return where joints of a take are, one frame repeated over as many as another."""
    motion = take.motion
    found = forward(rig, motion.translations.gather(own), motion.rotations.gather(own))
    return WorldTransforms(
        np.broadcast_to(found.positions, like.positions.shape),
        np.broadcast_to(found.linear, like.linear.shape),
    )


@contextmanager
def _placed(tracks: TargetTracks) -> Iterator[None]:
    """Give faults of goals that have no file their place in that of the targets."""
    try:
        yield
    except OptionError as error:
        faults = [_at_goal(fault, tracks) for fault in error.faults]
        raise OptionError(faults) from error


def _at_goal(fault: Fault, tracks: TargetTracks) -> Fault:
    goal = _GOAL.match(fault.where or "")
    if fault.path is not None or goal is None:
        return replace(fault, path=fault.path or str(tracks.path))
    line, column = tracks.goals[int(goal[1])].place
    return replace(fault, path=str(tracks.path), lines=(line,), column=column)


def _selected(
    take: Take,
    local: LocalTransforms,
    world: WorldTransforms,
    targets: Targets,
    frame: int,
) -> tuple[Take, LocalTransforms, WorldTransforms, Targets]:
    """Return one frame of everything."""
    rows = slice(frame, frame + 1)
    clock = take.clock
    start = clock.start + frame * clock.step
    arrays = [getattr(targets, field.name)[rows] for field in fields(Targets)]
    return (
        replace(
            take,
            clock=replace(clock, start=start, count=1),
            motion=take.motion.select(rows),
        ),
        LocalTransforms(local.translations[rows], local.rotations[rows]),
        WorldTransforms(world.positions[rows], world.linear[rows]),
        Targets(*arrays),
    )


def _chosen(whole: Rig, rig: Rig, options: TakeOptions) -> list[str] | None:
    """Return the joints that may move; None is every one that moves a goal."""
    if not options.joints:
        return None
    found: set[str] = set()
    faults = []
    for pattern in options.joints:
        matches = {name for name in whole.names if fnmatchcase(name, pattern)}
        if not matches:
            message = f"no joint of {whole.name!r} is {pattern!r}"
            hint = nearest(pattern, whole.names)
            faults.append(Fault("IK001", message, hint=hint))
        found |= matches
    if faults:
        raise OptionError(faults)
    return [name for name in rig.names if name in found]


def refuse_scales(
    take: Take, effectors: Iterable[tuple[str, str]], path: Path | None = None
) -> None:
    """Refuse scales of what an effector hangs from: a chain has lengths that stay.

    Args:
        take: Of a rig.
        effectors: Their names, and their joints.
        path: The targets file that asks for them, if there is one.

    Raises:
        OptionError: A joint is scaled, with a fault for each (TGT016).
    """
    channel = take.motion.scales
    if channel is None:
        return
    scaled = (channel.rest != 1.0).any(axis=1)
    scaled[channel.animated] |= (channel.values != 1.0).any(axis=(0, 2))
    faults = {}
    place = None if path is None else str(path)
    for effector, joint in effectors:
        j = take.rig.index(joint)
        while j >= 0:
            if scaled[j]:
                name = take.rig.names[j]
                message = f"{effector!r} hangs from {name!r}, which is scaled"
                hint = "inverse kinematics is for joints without scale"
                faults[name] = Fault("TGT016", message, place, (), hint)
            j = take.rig.joints[j].parent
    if faults:
        raise OptionError(list(faults.values()))


@dataclass(frozen=True, slots=True)
class _Found:
    """The solution of a part, and how long it took [s]."""

    part: Part
    result: IkResult
    seconds: float


@dataclass(frozen=True, slots=True)
class _Run:
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

    def solved(self, part: Part) -> _Found:
        """Return the solution of a part."""
        problem = self._problem(part, self.goals)
        targets = part.brought(self.targets)
        if not self.still:
            done = self._timed(problem, part.coordinates, targets, warm=False)
            return _Found(part, *done)
        bent, seconds = self._bent(part, problem, targets)
        start, more = self._begun(part, problem, bent, targets)
        kept = part.coordinates[0]
        done = self._timed(problem, start, targets, warm=True, prefer=kept)
        return _Found(part, done[0], seconds + more + done[1])

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
        found, seconds = self._timed(problem, start, first, warm=False, prefer=kept)
        new = found.descents[0] > 1 and bool(found.converged[0])
        return found.coordinates[0] if new else start, seconds

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
            poles[:, e], weights[:, e, 3] = point, 1.0
        if goals == self.goals:
            return part.coordinates[0], 0.0
        leaning = self._problem(part, goals)
        if self.options.method not in serving(leaning):
            return part.coordinates[0], 0.0
        first = rows_of(targets, slice(0, 1))
        given = replace(first, poles=poles, weights=weights)
        start = part.coordinates[0]
        found, seconds = self._timed(leaning, start, given, warm=True, restarts=0)
        return found.coordinates[0], seconds

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
        chosen = IkOptions(
            method=options.method,
            tolerance=options.tolerance / problem.length,
            angle_tolerance=options.angle_tolerance,
            restarts=options.restarts if restarts is None else restarts,
            seed=options.seed,
            seconds=options.seconds,
            warm=warm,
            near=not warm,
        )
        began = time.perf_counter()
        if options.method in FOLLOWED and len(np.asarray(targets.positions)) > 1:
            from animtool.ik.following import FollowOptions, follow

            searched = restarts is None
            way = FollowOptions(
                chosen,
                self.rate,
                smooth=options.smooth if searched else 0.0,
                branches=FollowOptions().branches if searched else 0,
            )
            found = follow(problem, starts, targets, way, prefer=prefer)
        else:
            found = solve(problem, starts, targets, chosen, prefer=prefer)
        return found, time.perf_counter() - began


def _bends(problem: Problem, track: GoalTrack, origins: FloatArray) -> bool:
    """Return whether a goal's chain says where its middle points, and has one.

    Args:
        problem: In which joints of the chain move, or not.
        track: Of the goal.
        origins: Of the joints ``(J, 3)``.
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


def _gathered(
    take: Take,
    own: IntArray,
    local: LocalTransforms,
    tracks: TargetTracks,
    targets: Targets,
    found: Sequence[_Found],
) -> TakeIk:
    results = [one.result for one in found]
    motion = take.motion
    rig = found[0].part.rig
    names = {*results[0].problem.joints, *followers(rig, results[0].problem.joints)}
    stretched = {j for limb in results[0].problem.limbs for j in limb.joints}
    joints = sorted({rig.index(name) for name in names} | stretched)
    places, turns = local.translations[:, joints], local.rotations[:, joints]
    for one in found:
        span = one.part.frames
        rows, before = one.result.coordinates, one.part.coordinates
        made = local_from_coordinates(one.part.rig, rows)
        longer = one.result.local_translations()
        slices = coordinate_slices(one.part.rig)
        for i, j in enumerate(joints):
            change = np.abs(rows[:, slices[j]] - before[:, slices[j]])
            grown = (longer[:, j] != made.translations[:, j]).any(axis=1)
            moved = (change.max(axis=1, initial=0.0) > UNCHANGED) | grown
            places[span, i][moved] = longer[moved, j]
            turns[span, i][moved] = made.rotations[moved, j]
    index = own[joints]
    motion = replace(
        motion,
        translations=motion.translations.put(index, places).compact(),
        rotations=motion.rotations.put(index, so3.align_signs(turns)).compact(),
    )
    asked = np.asarray(targets.weights) * [goal.goal.weights for goal in tracks.goals]
    limits = [frames_on_limits(one.problem, one.coordinates) for one in results]
    return TakeIk(
        replace(take, motion=motion),
        tracks,
        results[0].problem,
        asked > 0,
        np.concatenate([_misses(one) for one in results]),
        tuple(status for one in results for status in one.statuses),
        np.concatenate([one.iterations for one in results]),
        np.concatenate([one.descents for one in results]),
        sum(one.seconds for one in found),
        tuple(jump for one in results for jump in one.jumps),
        {name: np.concatenate([one[name] for one in limits]) for name in limits[0]},
    )


def _misses(result: IkResult) -> FloatArray:
    parts = (result.positions, result.orientations, result.aims, result.poles)
    return np.stack(parts, axis=-1)
