"""The closed form of a limb of two bones: a ball, then a pin or a ball.

The elbow opens until the tip is as far from the root as its target. Then the shoulder
rotates the tip there along the shortest arc, and about the line to the target until the
elbow points towards the pole.
"""

from __future__ import annotations

import numpy as np

from animtool.core.array_types import FloatArray
from animtool.ik.chain import BALL, PIN, Chain
from animtool.ik.problem import Problem

# Cosine below which a pin axis is perpendicular to a bone [1].
PERPENDICULAR_COSINE = 1e-12
# Lengths below this fraction of the limb's count as zero.
ZERO_LENGTH = 1e-12


def incompatibility(problem: Problem) -> str | None:
    """Return why the two-bone closed form does not apply; None if it does."""
    nodes, goal = problem.chain.nodes, problem.goals[0]
    if len(problem.goals) != 1:
        return "the problem has more than one goal"
    kinds = {kind.name for kind in goal.kinds}
    if "position" not in kinds or not kinds <= {"position", "pole"}:
        return "the goal is not a position, with or without a pole"
    if problem.rest_weight > 0:
        return "a pose is preferred"
    # A ball at the root, and an independent joint below it.
    if nodes[:, :2].tolist() != [[BALL, -1], [nodes[-1, 0], 0]] or nodes[1, 3]:
        return "the joints that move are not a ball joint and a child of it"
    return _joint_obstacle(problem.chain)


def _joint_obstacle(chain: Chain) -> str | None:
    """Return why the joints cannot bend and rotate the limb fully; None if they can."""
    if not _is_unlimited(chain.node_numbers[0]):
        return "its first joint has limits"
    upper_bone = chain.node_numbers[1, 9:12]
    lower_bone = chain.goal_numbers[0, :3] + chain.goal_numbers[0, 3:6]
    if min(np.linalg.norm(upper_bone), np.linalg.norm(lower_bone)) < ZERO_LENGTH:
        return "a bone has no length"
    if chain.nodes[1, 0] == BALL:
        is_limited = not _is_unlimited(chain.node_numbers[1])
        return "its second joint is a ball with limits" if is_limited else None
    axis = chain.node_numbers[1, :9].reshape(3, 3)[:, 2]
    bone_along_axis = chain.goal_numbers[0, 2]
    tool_along_axis = chain.goal_numbers[0, 5]
    cosines = abs(axis @ upper_bone), abs(bone_along_axis), abs(tool_along_axis)
    is_across = max(cosines) < PERPENDICULAR_COSINE
    is_unscaled = chain.node_numbers[1, 12] == 1 and chain.node_numbers[1, 13] == 0
    if chain.nodes[1, 0] == PIN and is_unscaled and is_across:
        return None
    return "its second joint does not rotate about an axis across both bones"


def _is_unlimited(node_numbers: FloatArray) -> bool:
    """Return whether the node numbers of a joint contain no limits."""
    no_limits = np.array([np.inf, np.inf, -np.inf, np.inf])
    return bool((node_numbers[14:18] == no_limits).all())


def bend_angle(
    upper_length: FloatArray, lower_length: FloatArray, distance: FloatArray
) -> FloatArray:
    """Return the angle between two bones' directions, 0 where straight.

    Args:
        upper_length: Length of the upper bone ``(B,)``.
        lower_length: Length of the lower bone ``(B,)``.
        distance: Distance from root to tip, clamped to the reach.

    >>> bend_angle(np.ones(2), np.ones(2), np.array([2.0, 0.0])).round(6).tolist()
    [0.0, 3.141593]
    """
    clamped_distance = np.clip(
        distance, np.abs(upper_length - lower_length), upper_length + lower_length
    )
    # The half-angle form stays accurate at both ends.
    squared_sine = (upper_length + lower_length - clamped_distance) * (
        upper_length + lower_length + clamped_distance
    )
    squared_cosine = (clamped_distance - (upper_length - lower_length)) * (
        clamped_distance + (upper_length - lower_length)
    )
    half_angle_parts = (
        np.sqrt(np.maximum(squared_sine, 0)),
        np.sqrt(np.maximum(squared_cosine, 0)),
    )
    return np.asarray(2 * np.arctan2(*half_angle_parts))


def perpendicular_vectors(vectors: FloatArray) -> FloatArray:
    """Return a unit vector perpendicular to each of the vectors ``(..., 3)``."""
    smallest_axes = np.argmin(np.abs(vectors), axis=-1)
    normals = np.cross(vectors, np.eye(3)[smallest_axes])
    lengths = np.linalg.norm(normals, axis=-1, keepdims=True)
    return np.where(
        lengths > 0, normals / np.where(lengths > 0, lengths, 1.0), [1.0, 0.0, 0.0]
    )
