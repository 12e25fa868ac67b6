"""Solving the parts of a take, from poses of their own or from one to the next."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from animtool._types import FloatArray
from animtool.errors import Fault, OptionError
from animtool.ik.chain_frame import Part
from animtool.ik.goals import PARTS, Goal, Targets, rows_of
from animtool.ik.methods import serving
from animtool.ik.options import IkMethod, TakeOptions
from animtool.ik.problem import Problem, build, rest_faults
from animtool.ik.result import IkResult
from animtool.ik.smoothing import rate_faults
from animtool.ik.solving import IkOptions, option_faults, solve
from animtool.ik.take_ik import SolvedPart
from animtool.ik.tracks import GoalTrack, TargetTracks
from animtool.rig.kinematics import WorldTransforms
from animtool.rig.skeleton import Rig


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
    """Refuse options that make no sense.

    Raises:
        OptionError: With every fault (IK002, IK014).
    """
    faults = [
        fault for found in take_option_faults(options).values() for fault in found
    ]
    if faults:
        raise OptionError(faults)


# Those that follow a clip over other branches; the others are there for comparison.
FOLLOWED = frozenset({IkMethod.AUTO, IkMethod.DAMPED, IkMethod.TWO_BONE})
# A pole stands this many lengths of its chain away, so that only its side counts.
FAR = 10.0


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
        if not self.still:
            done = self._timed(problem, part.coordinates, targets, warm=False)
            return SolvedPart(part, *done)
        bent, seconds = self._bent(part, problem, targets)
        start, more = self._begun(part, problem, bent, targets)
        kept = part.coordinates[0]
        done = self._timed(problem, start, targets, warm=True, prefer=kept)
        return SolvedPart(part, done[0], seconds + more + done[1])

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
            poles[:, e], weights[:, e, PARTS.index("pole")] = point, 1.0
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
            from animtool.ik.clip_solver import FollowOptions, follow

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
