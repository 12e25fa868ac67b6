"""Matching: the controls of a rig's chains from poses, as targets that give them back.

A chain has its tip's position and orientation, as its goal asks, and a pole for the
joint in the middle of its limb.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from animtool.core.array_types import BoolArray, FloatArray, IntArray
from animtool.core.record import dataclass
from animtool.ik.goals import Goal, Targets
from animtool.ik.limbs import limb_joints
from animtool.ik.problem import moving_joints
from animtool.ik.sub_rig import with_types
from animtool.ik.two_bone import perpendicular
from animtool.maths import so3
from animtool.rig.kinematics import WorldTransforms, forward
from animtool.rig.parts import IkChain
from animtool.rig.skeleton import JointType, Rig

# A middle joint nearer to its limb's line than this share of the limb's length has no
# side: on a wrong one it is off by less than a hundred-thousandth of that length.
SIDE = 5e-6


@dataclass(frozen=True, slots=True)
class Matched:
    """What chains ask for so that poses come back.

    Attributes:
        goals: A goal of each of E chains; its pole has weight 0 where the chain has no
            joint between its root and its tip that bends it, or no position to reach.
        targets: Of F frames.
    """

    goals: tuple[Goal, ...]
    targets: Targets


def match(rig: Rig, chains: Sequence[IkChain], world: WorldTransforms) -> Matched:
    """Return goals and targets for chains, from where poses have their joints.

    The pole stands half the limb's length off the line from its root to its tip, beside
    the middle joint, in the plane of the three. Where the middle is on that line, as
    when the limb is straight, it is on the side where it was in the frame before, as
    the root joint carries it; in the first frames where it next is; without any such
    frame in the chain's ``pole_dir``, of a hinge at right angles to its axis.

    Solved with what carries the chains as it was, the targets give back the positions
    of tips and middle joints, and all rotations of limbs that bend and have seven
    degrees of freedom, as many as there are controls: a ball, a hinge, and a tip that
    turns three ways, be one of them a twist of the forearm.

    Limits of the method: not in the controls are the twist of a straight limb about its
    own line; twist that two joints share, as a wrist that twists behind a forearm that
    does; which way a ball at the middle is twisted; which of two ways three hinges of a
    wrist take to the same rotation; what joints other than the root and the middle
    bend; and of a chain that asks for no orientation the rotation of its tip. A limb
    that bends over straight to the other side takes its pole with it.

    Args:
        rig: J joints.
        chains: E of its chains, or others on its joints.
        world: Of F frames.

    >>> from animtool.rig.skeleton import Joint
    >>> upper = Joint("upper", -1, JointType.BALL)
    >>> lower = Joint("lower", 0, JointType.PIN, translation=(1, 0, 0))
    >>> hand = Joint("hand", 1, JointType.BALL, translation=(0, 1, 0))
    >>> rig = Rig("arm", (upper, lower, hand))
    >>> rest = forward(rig, rig.rest_translations[None], rig.rest_rotations[None])
    >>> found = match(rig, [IkChain("arm", "upper", "hand")], rest)
    >>> np.round(found.targets.poles, 3).tolist()
    [[[1.207, -0.207, 0.0]]]
    """
    rig = with_types(rig)
    rest = forward(rig, rig.rest_translations[None], rig.rest_rotations[None])
    shape = (len(world.positions), len(chains))
    positions, poles = np.zeros((2, *shape, 3))
    rotations = np.zeros((*shape, 4))
    goals = []
    for e, chain in enumerate(chains):
        tip = rig.index(chain.tip)
        positions[:, e] = world.positions[:, tip]
        rotations[:, e] = so3.align_signs(so3.split_scale(world.linear[:, tip])[0])
        goal = _goal(chain)
        limb = _limb(rig, chain, goal, rest)
        if limb is not None:
            goal = replace(goal, pole=1.0)
            poles[:, e] = _poles(limb, world)
        goals.append(goal)
    return Matched(tuple(goals), Targets(positions, rotations, poles=poles))


def _goal(chain: IkChain) -> Goal:
    """Return what a chain asks for, without its pole."""
    return Goal(
        chain.tip,
        position=1.0 if chain.goal in {"position", "pose"} else 0.0,
        orientation=1.0 if chain.goal in {"orientation", "pose"} else 0.0,
        root=chain.root,
        stretch=chain.stretch if chain.goal != "orientation" else 0.0,
    )


@dataclass(frozen=True, slots=True)
class _Limb:
    """A limb that bends.

    Attributes:
        root, middle, tip: Joints.
        length: Of its bones at rest [m].
        usual: Side of the middle in the root joint's frame where no pose tells
            ``(3,)``.
        hinge: Axis of the middle joint in its frame ``(3,)``; zero where it is none.
    """

    root: int
    middle: int
    tip: int
    length: float
    usual: FloatArray
    hinge: FloatArray


def _limb(rig: Rig, chain: IkChain, goal: Goal, rest: WorldTransforms) -> _Limb | None:
    """Return the limb of a chain, as the solver of its goal sees it."""
    if not goal.position:
        return None
    tip, origins = rig.index(chain.tip), rest.positions[0]
    joints = limb_joints(rig, goal, moving_joints(rig, [goal]), origins, origins[tip])
    if joints is None:
        return None
    root, middle = joints
    length, j = 0.0, tip
    while j != root:
        parent = rig.joints[j].parent
        length += float(np.linalg.norm(origins[j] - origins[parent]))
        j = parent
    # The pole direction stands in the frame of the parent of the chain's root.
    above = rig.joints[rig.index(chain.root)].parent
    turned = np.eye(3) if above < 0 else rest.linear[0, above]
    hinged = rig.joints[middle].type is JointType.PIN
    return _Limb(
        root,
        middle,
        tip,
        length,
        rest.linear[0, root].T @ turned @ np.array(chain.pole_dir or (0.0, 0.0, 0.0)),
        np.array(rig.joints[middle].axis) if hinged else np.zeros(3),
    )


def _poles(limb: _Limb, world: WorldTransforms) -> FloatArray:
    """Return where a limb's pole is ``(F, 3)`` [m]."""
    root, middle, tip = (
        world.positions[:, j] for j in (limb.root, limb.middle, limb.tip)
    )
    least = SIDE * limb.length
    line, apart = _directions(tip - root, least)
    line[~apart] = 0.0
    along = np.sum((middle - root) * line, axis=1, keepdims=True) * line
    sides, known = _directions(middle - root - along, least)
    if not known.all():
        bend = _bend(limb, world, sides, known)
        off = bend - np.sum(bend * line, axis=1, keepdims=True) * line
        # What is carried may come to lie along the line: any side will do then.
        others, kept = _directions(off, np.sqrt(SIDE))
        others[~kept] = _directions(perpendicular(line[~kept]), 0.0)[0]
        sides = np.where(known[:, None], sides, others)
    return np.asarray(root + along + sides * limb.length / 2)


def _directions(vectors: FloatArray, least: float) -> tuple[FloatArray, BoolArray]:
    """Return unit vectors ``(F, 3)``, and which are longer than the least ``(F,)``."""
    lengths = np.linalg.norm(vectors, axis=1)
    longer = lengths > least
    return vectors / np.where(longer, lengths, 1.0)[:, None], longer


def _bend(
    limb: _Limb, world: WorldTransforms, sides: FloatArray, known: BoolArray
) -> FloatArray:
    """Return the sides as the root joint carries them to every frame ``(F, 3)``."""
    turns = so3.split_scale(world.linear[:, limb.root])[0]
    if known.any():
        own = so3.rotate(so3.conjugate(turns), sides)
        return so3.rotate(turns, own[_nearest_before(known)])
    hinges = so3.rotate(so3.split_scale(world.linear[:, limb.middle])[0], limb.hinge)
    usual = so3.rotate(turns, limb.usual)
    return np.asarray(usual - np.sum(usual * hinges, axis=1, keepdims=True) * hinges)


def _nearest_before(known: BoolArray) -> IntArray:
    """Return the last known frame up to each one; the first known before that.

    >>> _nearest_before(np.array([False, True, False, True])).tolist()
    [1, 1, 1, 3]
    """
    last = np.maximum.accumulate(np.where(known, np.arange(len(known)), -1))
    return np.where(last < 0, int(np.argmax(known)), last)
