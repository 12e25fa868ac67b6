"""Targets written for another up axis."""

from __future__ import annotations

import numpy as np

from animtool.core.units import UpAxis, up_from_up
from animtool.ik.take_run import TakeIk
from animtool.ik.values import SampleFrames
from animtool.maths import so3
from animtool.rig.kinematics import rest_world

# Larger coordinates are mistakes of another kind [m].
MAX_DISTANCE = 1e6


def up_axis_hint(solved: TakeIk, goal_index: int, frame: float) -> str | None:
    """Return a hint if a missed target is in reach with the other up axis.

    Args:
        solved: The solved take.
        goal_index: A goal whose position is missed.
        frame: Time code of a miss.
    """
    track, rig = solved.tracks.goals[goal_index], solved.take.rig
    value, root = track.values.get("position"), track.goal.root
    if value is None or root is None:
        return None
    joint, start = rig.index(track.goal.joint), rig.index(root)
    chain = list(rig.upwards(joint))
    chain = chain[: chain.index(start) + 1]
    positions = rest_world(rig).positions[0]
    bones = positions[chain[:-1]] - positions[chain[1:]]
    reach = float(np.linalg.norm(bones, axis=1).sum())
    other = UpAxis.Y if rig.up is UpAxis.Z else UpAxis.Z
    fps = solved.take.clock.fps
    point = value.at(SampleFrames(np.array([frame]), fps))[0]
    if not abs(point).max() < MAX_DISTANCE:
        return None
    turned = so3.rotate(np.array(up_from_up(rig.up, other)), point)
    distances = np.linalg.norm(np.array([point, turned]) - positions[start], axis=1)
    if not distances[1] <= reach < distances[0]:
        return None
    axes = "[x, z, -y]" if rig.up is UpAxis.Y else "[x, -z, y]"
    return (
        f"the rig is {rig.up}-up: if the targets are {other}-up, write [x, y, z] as "
        f"{axes}"
    )
