"""What came of a take that was brought to targets."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from animtool._types import BoolArray, FloatArray, IntArray
from animtool.ik.chain_frame import Part
from animtool.ik.goals import Targets
from animtool.ik.problem import Problem
from animtool.ik.result import IkResult, IkStatus, Jump
from animtool.ik.sub_rig import mimics
from animtool.ik.tangent import frames_on_limits
from animtool.ik.tracks import TargetTracks
from animtool.maths import so3
from animtool.rig.joints import (
    LocalTransforms,
    coordinate_slices,
    local_from_coordinates,
)
from animtool.take import Take

# Coordinates that a solve changes by less, it leaves as they were.
UNCHANGED = 1e-12


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


@dataclass(frozen=True, slots=True)
class SolvedPart:
    """The solution of a part, and how long it took [s]."""

    part: Part
    result: IkResult
    seconds: float


def gathered_take(
    take: Take,
    own: IntArray,
    local: LocalTransforms,
    tracks: TargetTracks,
    targets: Targets,
    found: Sequence[SolvedPart],
) -> TakeIk:
    """Return a take with the poses that its parts were brought to.

    Args:
        take: F frames.
        own: Which of its joints were solved for.
        local: Of those, before.
        tracks: What was asked, in words of the file.
        targets: And in numbers.
        found: Its parts in the order of time.
    """
    results = [one.result for one in found]
    motion = take.motion
    rig = found[0].part.rig
    names = {*results[0].problem.joints, *mimics(rig, results[0].problem.joints)}
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
        np.concatenate([one.misses for one in results]),
        tuple(status for one in results for status in one.statuses),
        np.concatenate([one.iterations for one in results]),
        np.concatenate([one.descents for one in results]),
        sum(one.seconds for one in found),
        tuple(jump for one in results for jump in one.jumps),
        {name: np.concatenate([one[name] for one in limits]) for name in limits[0]},
    )
