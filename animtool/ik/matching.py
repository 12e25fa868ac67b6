"""Matching: IK targets of a rig's chains that reproduce given poses.

A chain has targets for its tip's position and orientation, as its goal requires, and a
pole for the middle joint of its limb.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from animtool.core.array_types import BoolArray, FloatArray, IntArray
from animtool.core.loaded import check_loaded
from animtool.core.record import dataclass
from animtool.ik.goals import Goal, Targets
from animtool.ik.limbs import limb_joints
from animtool.ik.problem import find_moving_joints
from animtool.ik.sub_rig import with_ball_joints
from animtool.maths import so3
from animtool.rig.kinematics import WorldTransforms, rest_world
from animtool.rig.parts import IkChain
from animtool.rig.skeleton import JointType, Rig

# A middle joint nearer to the limb's line than this fraction of its length has no side:
# a wrong side causes an error below a hundred-thousandth of that length.
MIN_SIDE_DISTANCE = 5e-6


@dataclass(frozen=True, slots=True)
class Matched:
    """Goals and targets that reproduce poses.

    Attributes:
        goals: A goal for each of E chains; its pole has weight 0 if no joint between
            root and tip bends the chain, or it has no position to reach.
        targets: Targets of F frames.
    """

    goals: tuple[Goal, ...]
    targets: Targets


def match(rig: Rig, chains: Sequence[IkChain], world: WorldTransforms) -> Matched:
    """Return goals and targets of chains that reproduce world poses.

    The pole is half the limb's length off the line from root to tip, next to the middle
    joint and in the plane of the three. Where the limb is straight, the side of the
    previous bent frame is used, carried by the root joint; before that, of the next
    bent frame; if there is none, the chain's ``pole_dir``, for a hinge perpendicular to
    its axis.

    With the same parents of the chains, the targets reproduce the positions of tips and
    middle joints, and all rotations of bent limbs with seven degrees of freedom: a
    ball, a hinge, and a tip with three, one of which may be a twist of the forearm.

    Limits of the method: targets do not capture the twist of a straight limb about its
    line; twist that two joints share, such as a wrist and a forearm; the twist of a
    ball at the middle; which of two solutions three wrist hinges take; the bend of
    joints other than the root and the middle; and the tip's rotation for a chain
    without an orientation goal. A limb that bends through straight takes its pole with
    it.

    Args:
        rig: J joints.
        chains: E chains of the rig's joints.
        world: World of F frames.

    >>> from animtool.rig.skeleton import Joint
    >>> upper = Joint("upper", -1, JointType.BALL)
    >>> lower = Joint("lower", 0, JointType.PIN, translation=(1, 0, 0))
    >>> hand = Joint("hand", 1, JointType.BALL, translation=(0, 1, 0))
    >>> rig = Rig("arm", (upper, lower, hand))
    >>> found = match(rig, [IkChain("arm", "upper", "hand")], rest_world(rig))
    >>> np.round(found.targets.poles, 3).tolist()
    [[[1.207, -0.207, 0.0]]]
    """
    check_loaded(rig, Rig, "rig")
    rig = with_ball_joints(rig)
    rest_transforms = rest_world(rig)
    shape = (len(world.positions), len(chains))
    positions, poles = np.zeros((2, *shape, 3))
    rotations = np.zeros((*shape, 4))
    goals = []
    for goal_index, chain in enumerate(chains):
        tip = rig.index(chain.tip)
        positions[:, goal_index] = world.positions[:, tip]
        rotations[:, goal_index] = so3.align_signs(
            so3.split_scale(world.linear[:, tip])[0]
        )
        goal = Goal(
            chain.tip,
            position=float(chain.goal in {"position", "pose"}),
            orientation=float(chain.goal in {"orientation", "pose"}),
            root=chain.root,
            stretch=chain.stretch if chain.goal != "orientation" else 0.0,
        )
        limb = _bending_limb(rig, chain, goal, rest_transforms)
        if limb is not None:
            goal = replace(goal, pole=1.0)
            poles[:, goal_index] = _pole_positions(limb, world)
        goals.append(goal)
    return Matched(tuple(goals), Targets(positions, rotations, poles=poles))


@dataclass(frozen=True, slots=True)
class _BendingLimb:
    """A limb from root to tip with a middle joint that bends it.

    Attributes:
        root, middle, tip: Joints.
        length: Length of its bones at rest [m].
        default_side: Default side of the middle joint in the root joint's frame, used
            where no pose determines it ``(3,)``.
        hinge_axis: Axis of the middle joint in its frame ``(3,)``; 0 if no hinge.
    """

    root: int
    middle: int
    tip: int
    length: float
    default_side: FloatArray
    hinge_axis: FloatArray


def _bending_limb(
    rig: Rig, chain: IkChain, goal: Goal, rest: WorldTransforms
) -> _BendingLimb | None:
    """Return the limb that the solver bends for a chain; None if there is none."""
    if not goal.position:
        return None
    tip, origins = rig.index(chain.tip), rest.positions[0]
    moving_joints = find_moving_joints(rig, [goal])
    joints = limb_joints(rig, goal, moving_joints, origins, origins[tip])
    if joints is None:
        return None
    root, middle = joints
    limb_length, j = 0.0, tip
    while j != root:
        parent = rig.joints[j].parent
        limb_length += float(np.linalg.norm(origins[j] - origins[parent]))
        j = parent
    # The pole direction is in the frame of the parent of the chain's root.
    parent_index = rig.joints[rig.index(chain.root)].parent
    parent_rotation = np.eye(3) if parent_index < 0 else rest.linear[0, parent_index]
    pole_direction = np.array(chain.pole_dir or (0.0, 0.0, 0.0))
    default_side = rest.linear[0, root].T @ parent_rotation @ pole_direction
    is_hinge = rig.joints[middle].type is JointType.PIN
    hinge_axis = np.array(rig.joints[middle].axis) if is_hinge else np.zeros(3)
    return _BendingLimb(root, middle, tip, limb_length, default_side, hinge_axis)


def _pole_positions(limb: _BendingLimb, world: WorldTransforms) -> FloatArray:
    """Return poles that determine a limb's bend in each frame ``(F, 3)`` [m]."""
    root, middle, tip = (
        world.positions[:, j] for j in (limb.root, limb.middle, limb.tip)
    )
    min_distance = MIN_SIDE_DISTANCE * limb.length
    line_directions, has_direction = _normalize(tip - root, min_distance)
    line_directions[~has_direction] = 0.0
    middle_on_line = _component_along(line_directions, middle - root)
    sides, has_side = _normalize(middle - root - middle_on_line, min_distance)
    if not has_side.all():
        bend_sides = _transport_bend_sides(limb, world, sides, has_side)
        outward_sides = bend_sides - _component_along(line_directions, bend_sides)
        # If a transported side lies along the line, any side will do.
        transported_sides, is_transported = _normalize(
            outward_sides, np.sqrt(MIN_SIDE_DISTANCE)
        )
        any_sides = perpendicular_vectors(line_directions[~is_transported])
        transported_sides[~is_transported] = _normalize(any_sides, 0.0)[0]
        sides = np.where(has_side[:, None], sides, transported_sides)
    return np.asarray(root + middle_on_line + sides * limb.length / 2)


def _component_along(directions: FloatArray, vectors: FloatArray) -> FloatArray:
    """Return the parts of vectors along unit directions, each ``(F, 3)``."""
    products = np.sum(vectors * directions, axis=1, keepdims=True)
    return np.asarray(products * directions)


def _normalize(vectors: FloatArray, min_length: float) -> tuple[FloatArray, BoolArray]:
    """Normalize vectors ``(F, 3)``; mask those longer than ``min_length`` ``(F,)``."""
    lengths = np.linalg.norm(vectors, axis=1)
    is_longer = lengths > min_length
    return vectors / np.where(is_longer, lengths, 1.0)[:, None], is_longer


def _transport_bend_sides(
    limb: _BendingLimb, world: WorldTransforms, sides: FloatArray, has_side: BoolArray
) -> FloatArray:
    """Return the bend sides transported by the root joint to every frame ``(F, 3)``."""
    rotations = so3.split_scale(world.linear[:, limb.root])[0]
    if has_side.any():
        local_sides = so3.rotate(so3.conjugate(rotations), sides)
        return so3.rotate(rotations, local_sides[_nearest_known_frames(has_side)])
    hinge_axes = so3.rotate(
        so3.split_scale(world.linear[:, limb.middle])[0], limb.hinge_axis
    )
    default_side = so3.rotate(rotations, limb.default_side)
    return np.asarray(default_side - _component_along(hinge_axes, default_side))


def _nearest_known_frames(is_known: BoolArray) -> IntArray:
    """Return the last known frame up to each frame; before any, the first known.

    >>> _nearest_known_frames(np.array([False, True, False, True])).tolist()
    [1, 1, 1, 3]
    """
    last_known = np.maximum.accumulate(np.where(is_known, np.arange(len(is_known)), -1))
    return np.where(last_known < 0, int(np.argmax(is_known)), last_known)


def perpendicular_vectors(vectors: FloatArray) -> FloatArray:
    """Return a unit vector perpendicular to each of the vectors ``(..., 3)``."""
    smallest_axes = np.argmin(np.abs(vectors), axis=-1)
    normals = np.cross(vectors, np.eye(3)[smallest_axes])
    lengths = np.linalg.norm(normals, axis=-1, keepdims=True)
    return np.where(
        lengths > 0, normals / np.where(lengths > 0, lengths, 1.0), [1.0, 0.0, 0.0]
    )
