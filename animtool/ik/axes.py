"""Detects targets that use another up axis, unit, space or side."""

from __future__ import annotations

import numpy as np

from animtool.core.array_types import FloatArray
from animtool.core.quantities import length_text
from animtool.core.record import dataclass
from animtool.core.units import LengthUnit, UpAxis, unit_name, up_from_up
from animtool.ik.goals import GOAL_PARTS, path_to_root
from animtool.ik.take_run import TakeIk
from animtool.ik.values import SampleFrames
from animtool.maths import so3
from animtool.rig.kinematics import rest_world
from animtool.rig.sides import pair_sides
from animtool.rig.skeleton import Rig

# Larger coordinates are mistakes of another kind [m].
MAX_DISTANCE = 1e6
# A target in the unit that is meant may still be missed by a little, in limb lengths.
MAX_REACH_RATIO = 1.5
# If targets of left and right are swapped, limbs cross by this part of the distance
# of their roots, and a joint is on its limit in this fraction of frames [1].
MIN_CROSSING_FRACTION, MIN_LIMIT_FRACTION = 0.5, 0.5


@dataclass(frozen=True, slots=True)
class LimbTarget:
    """A missed position target, and the limb that should reach it, at rest."""

    point: FloatArray  # the target ``(3,)`` [m]
    root: int  # topmost joint that the goal moves
    origin: FloatArray  # position of that joint at rest ``(3,)`` [m]
    length: float  # length of the limb [m]


def limb_target(
    solved_take: TakeIk, goal_index: int, frame: float
) -> LimbTarget | None:
    """Return a goal's position target and limb at a time code; None if it has none."""
    track, rig = solved_take.tracks.goals[goal_index], solved_take.take.rig
    position_value = track.values.get("position")
    if position_value is None:
        return None
    joints_to_root = path_to_root(rig, track.goal.joint, track.goal.root)
    rest_positions = rest_world(rig).positions[0]
    bones = rest_positions[joints_to_root[:-1]] - rest_positions[joints_to_root[1:]]
    length = float(np.linalg.norm(bones, axis=1).sum())
    fps = solved_take.take.clock.fps
    point = position_value.sample(SampleFrames(np.array([frame]), fps))[0]
    if not abs(point).max() < MAX_DISTANCE:
        return None
    return LimbTarget(
        point, joints_to_root[-1], rest_positions[joints_to_root[-1]], length
    )


def up_axis_hint(rig: Rig, target: LimbTarget | None) -> str | None:
    """Return a hint if a target would be in reach with the other up axis."""
    if target is None:
        return None
    other_up = UpAxis.Y if rig.up is UpAxis.Z else UpAxis.Z
    rotated_point = so3.rotate(np.array(up_from_up(rig.up, other_up)), target.point)
    offsets = np.array([target.point, rotated_point]) - target.origin
    distances = np.linalg.norm(offsets, axis=1)
    if not distances[1] <= target.length < distances[0]:
        return None
    axes = "[x, z, -y]" if rig.up is UpAxis.Y else "[x, -z, y]"
    text = f"the rig is {rig.up}-up: if the targets are {other_up}-up, write [x, y, z]"
    return f"{text} as {axes}"


def unit_hint(rig: Rig, target: LimbTarget | None) -> str | None:
    """Return a hint if a target would be in reach with a smaller unit."""
    if target is None:
        return None
    for unit in (LengthUnit.CM, LengthUnit.MM):
        unit_factor = unit.meters / rig.meters_per_unit
        distance = float(np.linalg.norm(unit_factor * target.point - target.origin))
        if unit_factor < 1 and distance <= MAX_REACH_RATIO * target.length:
            return (
                f"the rig is in {unit_name(rig.meters_per_unit)}; with "
                f"'units: {{length: {unit}}}' the target is "
                f"{length_text(distance)} from {rig.names[target.root]!r}"
            )
    return None


def space_hint(rig: Rig, target: LimbTarget | None) -> str | None:
    """Return a hint if a target would be in reach relative to a joint.

    The joints are the root of the rig and that of the limb, at rest.
    """
    if target is None or not _is_out_of_reach(target):
        return None
    rest_positions = rest_world(rig).positions[0]
    for joint in (rig.upwards(target.root)[-1], target.root):
        offset = rest_positions[joint] + target.point - target.origin
        if float(np.linalg.norm(offset)) <= target.length:
            return (
                "positions are in world space: if this one is relative to "
                f"{rig.names[joint]!r}, add its position at rest, "
                f"{_point_text(rest_positions[joint])}"
            )
    return None


def _is_out_of_reach(target: LimbTarget) -> bool:
    """Return whether a target is farther from the limb's root than its length."""
    return float(np.linalg.norm(target.point - target.origin)) > target.length


def pole_hint(
    solved_take: TakeIk, goal_index: int, frame: float, target: LimbTarget | None
) -> str | None:
    """Return a hint if a missed target is in reach, so that its pole is in the way.

    Args:
        solved_take: The solved take.
        goal_index: A goal whose position is missed.
        frame: Time code of a miss.
        target: The target of that position.
    """
    row = int(np.abs(solved_take.take.clock.times - frame).argmin())
    is_active = solved_take.active[row, goal_index, GOAL_PARTS.index("pole")]
    if not is_active or (target is not None and _is_out_of_reach(target)):
        return None
    name = solved_take.tracks.goals[goal_index].name
    return (
        f"the target is in reach of {name!r}, but not with its pole: move the "
        "pole to the side on which the limb bends, or write weight: {pole: 0}"
    )


def crossed_goals(solved_take: TakeIk) -> list[tuple[int, int]]:
    """Return pairs of a left and a right goal whose targets seem to be swapped.

    In all frames of both, the limbs cross by `MIN_CROSSING_FRACTION` or more, and in
    most of them a joint of theirs is on its limit.
    """
    rig, tracks = solved_take.take.rig, solved_take.tracks.goals
    pairs = pair_sides(rig.names, rig.parents)
    goal_of_joint = {
        rig.index(track.goal.joint): e
        for e, track in enumerate(tracks)
        if track.values.get("position") is not None
    }
    crossed_pairs: list[tuple[int, int]] = []
    world_positions: FloatArray | None = None
    for left in pairs.left:
        right = int(pairs.partners[left])
        if left not in goal_of_joint or right not in goal_of_joint:
            continue
        goal_pair = goal_of_joint[left], goal_of_joint[right]
        paired_joints = [j for j in rig.upwards(left) if pairs.partners[j] != j]
        roots = paired_joints[-1], int(pairs.partners[paired_joints[-1]])
        is_active = solved_take.active[:, goal_pair, 0].all(axis=1)
        if world_positions is None:
            world_positions = solved_take.take.world().positions
        positions = world_positions[is_active]
        root_offsets = positions[:, roots[0]] - positions[:, roots[1]]
        tip_offsets = positions[:, left] - positions[:, right]
        crossings = -(tip_offsets * root_offsets).sum(axis=1)
        if (
            not len(crossings)
            or (
                crossings <= MIN_CROSSING_FRACTION * (root_offsets**2).sum(axis=1)
            ).any()
        ):
            continue
        limb_joint_names = {
            rig.names[joint] for tip in (left, right) for joint in rig.upwards(tip)
        }
        limit_fractions = [
            float(is_on_limit[is_active].mean())
            for name, is_on_limit in solved_take.on_limits.items()
            if name in limb_joint_names
        ]
        if max(limit_fractions, default=0.0) >= MIN_LIMIT_FRACTION:
            crossed_pairs.append(goal_pair)
    return crossed_pairs


def _point_text(point: FloatArray) -> str:
    return f"[{', '.join(f'{round(float(number), 3) + 0.0:g}' for number in point)}]"
