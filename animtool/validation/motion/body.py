"""Detects body joints of a rig: feet, and the joints that carry the body."""

from __future__ import annotations

import numpy as np

from animtool.core.array_types import BoolArray, IntArray
from animtool.rig.body_size import find_feet
from animtool.validation.motion.subject import MotionSubject

# Fraction of the joints below the one that carries the body; targets and props next to
# it have fewer [1].
MIN_BODY_FRACTION = 0.6
# Fraction of these that are below a joint of the trunk [1].
TRUNK_FRACTION = 0.4


def body_carriers(subject: MotionSubject) -> tuple[int, ...]:
    """Return the joints that move the complete body, from the first root to the hips.

    Below a static root, or a root that only follows the path of a walk, another joint
    carries the body. Other children of these joints are targets and props.
    """
    rig = subject.take.rig
    if not rig.roots:
        return ()
    is_foot = np.isin(np.arange(len(rig.joints)), find_feet(rig.names))
    feet_below = _subtree_counts(rig.parents, is_foot)
    joints_below = _subtree_counts(rig.parents, np.ones(len(is_foot), bool))
    joint_path, carrier_count = [int(rig.roots[0])], 1
    moving_joints = set(subject.translating_joints.tolist())
    while True:
        children = np.flatnonzero(rig.parents == joint_path[-1]).tolist()
        body_children = [
            child
            for child in children
            if joints_below[child] >= MIN_BODY_FRACTION * joints_below[joint_path[0]]
            and 2 * feet_below[child] > np.count_nonzero(is_foot)
        ]
        if not body_children:
            return tuple(joint_path[:carrier_count])
        joint_path.append(body_children[0])
        if body_children[0] in moving_joints:
            carrier_count = len(joint_path)


def hips_of(subject: MotionSubject) -> int:
    """Return the lowest joint that moves the complete body, usually the hips; or 0."""
    return (body_carriers(subject) or (0,))[-1]


def _subtree_counts(parents: IntArray, is_counted: BoolArray) -> IntArray:
    """Return how many joints of a mask are at or below each joint ``(J,)``.

    >>> values = np.array([True, False, True, True])
    >>> _subtree_counts(np.array([-1, 0, 1, 0]), values).tolist()
    [3, 1, 1, 1]
    """
    counts = is_counted.astype(np.int64)
    for joint in range(len(parents) - 1, 0, -1):
        if parents[joint] >= 0:
            counts[parents[joint]] += counts[joint]
    return counts


def limb_roots(parents: IntArray) -> IntArray:
    """Return the topmost joint of each joint's limb ``(J,)``; -1 in the trunk.

    >>> limb_roots(np.array([-1, 0, 1, 0, 3])).tolist()
    [-1, 1, 1, 3, 3]
    """
    counts = _subtree_counts(parents, np.ones(len(parents), bool))
    limbs = np.full(len(parents), -1)
    for joint in range(len(parents)):
        if counts[joint] <= TRUNK_FRACTION * len(parents):
            parent = int(parents[joint])
            parent_limb = -1 if parent < 0 else int(limbs[parent])
            limbs[joint] = joint if parent_limb < 0 else parent_limb
    return limbs


def positioned_joints(subject: MotionSubject) -> BoolArray:
    """Return a mask of joints whose translation is a position, not a bone ``(J,)``.

    These are roots, joints that carry the body, and the children of these.
    """
    parents = subject.take.rig.parents
    carrier_joints = body_carriers(subject)
    is_positioned = parents < 0
    is_positioned[list(carrier_joints)] = True
    return np.asarray(is_positioned | np.isin(parents, carrier_joints[:-1]), bool)


def body_joints(subject: MotionSubject) -> BoolArray:
    """Return a mask of the hips and all joints below them ``(J,)``."""
    parents = subject.take.rig.parents
    is_body = np.zeros(len(parents), bool)
    is_body[hips_of(subject) : hips_of(subject) + 1] = True
    for joint in range(1, len(parents)):
        is_body[joint] |= parents[joint] >= 0 and is_body[parents[joint]]
    return is_body
