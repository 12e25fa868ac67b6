"""Limbs of goals: joints, reach, soft extension and stretch."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from animtool import _kernels
from animtool.core.array_types import BoolArray, FloatArray, IntArray
from animtool.core.errors import Fault
from animtool.core.record import dataclass
from animtool.ik.chain import SLIDE, Chain
from animtool.ik.goals import Goal
from animtool.rig.skeleton import Rig

# Joints nearer than this fraction of the rig's size share an origin.
MIN_BONE_FRACTION = 1e-9
# Lengths below this fraction of the problem's length count as zero.
ZERO_LENGTH = 1e-12
# A limb within this fraction of its full length is straight.
STRAIGHT_TOLERANCE = 1e-9


def limb_joints(
    rig: Rig,
    goal: Goal,
    moving_joints: set[int],
    origins: FloatArray,
    point: FloatArray,
) -> tuple[int, int] | None:
    """Return the root and middle joint of a goal's limb.

    They are the two nearest above its point; for a goal with a root, the root and the
    joint nearest to halfway along the bones, in any pose, so that a forearm twist joint
    is not chosen.

    The goal's ``point`` ``(3,)`` and ``origins`` ``(J, 3)`` are of any one pose.
    """
    min_bone = MIN_BONE_FRACTION * (np.ptp(origins, axis=0).max() + 1e-300)
    joints: list[int] = []
    bone_lengths: list[float] = []
    end_point, j = point, rig.index(goal.joint)
    while j >= 0 and (goal.root is not None or len(joints) < 2):
        bone = float(np.linalg.norm(origins[j] - end_point))
        if j in moving_joints and bone > min_bone:
            joints.append(j)
            bone_lengths.append(bone + (bone_lengths[-1] if bone_lengths else 0.0))
            end_point = origins[j]
        j = -1 if rig.joints[j].name == goal.root else rig.joints[j].parent
    if len(joints) < 2:
        return None
    distance_to_end = [
        min(length, bone_lengths[-1] - length) for length in bone_lengths[:-1]
    ]
    return joints[-1], joints[distance_to_end.index(max(distance_to_end))]


@dataclass(frozen=True, slots=True)
class GoalLimb:
    """A limb from a joint at a fixed position to a goal's point, for soft extension."""

    goal: int  # index of the goal in the problem
    joints: tuple[int, ...]  # joints whose translations are the limb's bones
    origin: FloatArray  # position of the root [fraction of problem length] ``(3,)``
    max_length: float  # its largest extension within limits [same unit]
    bone_length: float  # growth of the reach per relative growth of the bones [same]
    soft: float  # fraction of the reach over which its extension eases out
    stretch: float  # largest relative growth of its bones


def find_limbs(
    rig: Rig, goals: Sequence[Goal], moving_joints: set[int], chain: Chain
) -> tuple[tuple[GoalLimb, ...], list[Fault]]:
    """Return the limbs of goals that are soft or stretch, and their faults.

    A fault is a limb whose root moves, that slides, has no bones to stretch, or shares
    them with another that stretches (IK008).
    """
    limbs, faults = [], []
    stretched_joints: set[int] = set()
    for goal_index, goal in enumerate(goals):
        if not (goal.soft > 0 or goal.stretch > 0):
            continue
        limb = _goal_limb(rig, goal, goal_index, moving_joints, chain)
        message = _limb_fault(rig, goal, limb, moving_joints, chain)
        if goal.stretch > 0 and stretched_joints & set(limb.joints):
            message = "another goal already stretches its bones"
        if goal.stretch > 0:
            stretched_joints |= set(limb.joints)
        if message:
            faults.append(Fault("IK008", message, where=f"goals[{goal_index}]"))
        limbs.append(limb)
    return tuple(limbs), faults


def _goal_limb(
    rig: Rig, goal: Goal, goal_index: int, moving_joints: set[int], chain: Chain
) -> GoalLimb:
    """Return the limb of a goal, with its bones, reach and rest position."""
    path_nodes = _goal_nodes(chain, goal_index)
    joints_above = rig.upwards(rig.index(goal.joint))
    top_index = max(i for i, j in enumerate(joints_above) if j in moving_joints)
    bone_offset, tool_offset = (
        chain.goal_numbers[goal_index, :3],
        chain.goal_numbers[goal_index, 3:6],
    )
    length_between = float(
        np.linalg.norm(chain.node_numbers[path_nodes[1:], 9:12], axis=1).sum()
    )
    tip_offset = bone_offset + tool_offset
    tip_length = float(np.linalg.norm(tip_offset))
    alignment, extension = 0.0, 1.0
    if tip_length > ZERO_LENGTH:
        alignment = max(float(bone_offset @ tip_offset) / tip_length, 0.0)
    straight_length = length_between + tip_length
    if straight_length > 0:
        extension = min(
            _limb_reach(chain, path_nodes, tip_offset) / straight_length, 1.0
        )
    if extension > 1 - STRAIGHT_TOLERANCE:
        extension = 1.0
    return GoalLimb(
        goal_index,
        tuple(joints_above[:top_index]),
        chain.node_numbers[path_nodes[0], 9:12],
        extension * straight_length,
        extension * (length_between + alignment),
        goal.soft,
        goal.stretch,
    )


def _limb_reach(chain: Chain, path_nodes: list[int], end_offset: FloatArray) -> float:
    """Return the reach of a limb of two bones and a pin; infinity for others.

    ``end_offset`` ``(3,)``: the goal's point in the frame of the path's last node.
    """
    bending_nodes = [
        n
        for n in path_nodes[1:]
        if np.linalg.norm(chain.node_numbers[n, 9:12]) > ZERO_LENGTH
    ]
    last_node = path_nodes[-1]
    if (
        bending_nodes != [last_node]
        or len(path_nodes) != 2
        or chain.nodes[last_node, [0, 3]].any()
    ):
        return np.inf
    if chain.node_numbers[last_node, 12] != 1 or chain.node_numbers[last_node, 13] != 0:
        return np.inf
    offset = chain.node_numbers[last_node, 9:12]
    x, y, z = chain.node_numbers[last_node, :9].reshape(3, 3).T @ offset
    cosine_part = x * end_offset[0] + y * end_offset[1]
    sine_part = y * end_offset[0] - x * end_offset[1]
    # The squared reach is a constant plus a cosine about its farthest angle.
    low, high = chain.node_numbers[last_node, 14:16]
    farthest = float(np.arctan2(sine_part, cosine_part))
    if np.isfinite(low):
        farthest += 2 * np.pi * float(np.ceil((low - farthest) / (2 * np.pi)))
    angles = [farthest] if farthest <= high else [low, high]
    products = [cosine_part * np.cos(a) + sine_part * np.sin(a) for a in angles]
    largest_cosine = max(products)
    squared_reach = (
        offset @ offset
        + end_offset @ end_offset
        + 2 * (z * end_offset[2] + largest_cosine)
    )
    return float(np.sqrt(max(squared_reach, 0.0)))


def _limb_fault(
    rig: Rig, goal: Goal, limb: GoalLimb, moving_joints: set[int], chain: Chain
) -> str | None:
    """Return why a goal's limb can be neither soft nor stretch; None if it can."""
    description = "a limb with soft or stretch"
    if not goal.position > 0:
        return f"{description} needs a position goal"
    if (chain.nodes[_goal_nodes(chain, limb.goal), 0] == SLIDE).any():
        return f"{description} needs joints that rotate, and a root that stays in place"
    if goal.root is not None:
        above_root = rig.upwards(rig.index(goal.root))[1:]
        other_joints = [j for j in above_root if j in moving_joints]
        if other_joints:
            name = rig.joints[other_joints[0]].name
            return f"{description} needs a root that stays in place: {name!r} moves it"
    if goal.stretch > 0 and limb.bone_length <= ZERO_LENGTH:
        return "it has no bones to stretch"
    return None


def _goal_nodes(chain: Chain, goal_index: int) -> list[int]:
    """Return the nodes that move a goal, from the root."""
    path, node = [], int(chain.goal_nodes[goal_index, 0])
    while node >= 0:
        path.append(node)
        node = int(chain.nodes[node, 1])
    return path[::-1]


@dataclass(frozen=True, slots=True)
class SoftReach:
    """Targets of B problems in reach of soft and stretching limbs."""

    reachable_targets: FloatArray  # packed, within reach of the limbs ``(B, E, W)``
    bone_scales: FloatArray  # bone length scales ``(B, E)``
    # Where only soft extension keeps a limb from its target ``(B, E)``.
    is_softened: BoolArray

    def __getitem__(self, rows: IntArray) -> SoftReach:
        """Return the rows of the selected problems."""
        return SoftReach(
            self.reachable_targets[rows], self.bone_scales[rows], self.is_softened[rows]
        )


def extend_softly(limbs: Sequence[GoalLimb], targets: FloatArray) -> SoftReach:
    """Move targets within reach of their limbs; also return bone length scales.

    The bones grow by the distance that the softened extension lacks, up to their
    stretch; then the target is moved within reach.

    Up to ``(1 - soft) reach`` a limb extends as far as its target; beyond, it
    approaches its full reach with continuous speed, so that it never snaps straight.

    References:
        A. Nicholas, Soft IK, 2009 (the exponential ease).

    Limits of the method: the reach is that of the straight limb, or for two bones with
    a pin within the pin's limits; other limits are ignored.

    ``targets`` ``(B, E, W)``: packed, in fractions of the problem's length.
    """
    return SoftReach(*_kernels.extend_ik_limbs(*limb_arrays(limbs), targets))


def limb_arrays(limbs: Sequence[GoalLimb]) -> tuple[IntArray, FloatArray]:
    """Return kernel arrays of limbs: goals ``(L,)`` and numbers ``(L, 7)``."""
    rows = [
        [*limb.origin, limb.max_length, limb.bone_length, limb.soft, limb.stretch]
        for limb in limbs
    ]
    goals = np.array([limb.goal for limb in limbs], np.int64)
    return goals, np.array(rows, np.float64).reshape(-1, 7)


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
