"""Which joints are the root and the middle of the limb that ends in a goal."""

from __future__ import annotations

import numpy as np

from animtool._types import FloatArray
from animtool.ik.goals import Goal
from animtool.rig.skeleton import Rig

# Joints nearer than this share of the rig's size have one origin.
APART = 1e-9


def limb_joints(
    rig: Rig, goal: Goal, moving: set[int], origins: FloatArray, point: FloatArray
) -> tuple[int, int] | None:
    """Return the joints at the root and in the middle of a goal's limb.

    They are the two next above its point; of a goal with a root that, and between the
    joint nearest to halfway along the bones, whatever the pose, so that one which
    twists a forearm is none.

    Args:
        rig: J joints.
        goal: Whose limb it is.
        moving: The joints that may move.
        origins: Of the joints ``(J, 3)``, in any pose.
        point: Of the goal ``(3,)``, in that pose.
    """
    near = APART * (np.ptp(origins, axis=0).max() + 1e-300)
    found: list[int] = []
    ways: list[float] = []
    below, j = point, rig.index(goal.joint)
    while j >= 0 and (goal.root is not None or len(found) < 2):
        bone = float(np.linalg.norm(origins[j] - below))
        if j in moving and bone > near:
            found.append(j)
            ways.append(bone + (ways[-1] if ways else 0.0))
            below = origins[j]
        j = -1 if rig.joints[j].name == goal.root else rig.joints[j].parent
    if len(found) < 2:
        return None
    halves = [min(way, ways[-1] - way) for way in ways[:-1]]
    return found[-1], found[halves.index(max(halves))]
