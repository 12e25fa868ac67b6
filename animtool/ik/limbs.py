"""How far limbs extend: their joints, their reach, and what their bones stretch by."""

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

# Joints nearer than this share of the rig's size have one origin.
APART = 1e-9


def limb_joints(
    rig: Rig, goal: Goal, moving: set[int], origins: FloatArray, point: FloatArray
) -> tuple[int, int] | None:
    """Return the joints at the root and in the middle of a goal's limb.

    They are the two next above its point; of a goal with a root that, and between the
    joint nearest to halfway along the bones, whatever the pose, so that one which
    twists a forearm is none.

    The goal's ``point`` ``(3,)`` and ``origins`` ``(J, 3)`` are of one pose, any.
    """
    near = APART * (np.ptp(origins, axis=0).max() + 1e-300)
    joints: list[int] = []
    ways: list[float] = []
    below, j = point, rig.index(goal.joint)
    while j >= 0 and (goal.root is not None or len(joints) < 2):
        bone = float(np.linalg.norm(origins[j] - below))
        if j in moving and bone > near:
            joints.append(j)
            ways.append(bone + (ways[-1] if ways else 0.0))
            below = origins[j]
        j = -1 if rig.joints[j].name == goal.root else rig.joints[j].parent
    if len(joints) < 2:
        return None
    halves = [min(way, ways[-1] - way) for way in ways[:-1]]
    return joints[-1], joints[halves.index(max(halves))]


# Lengths below this share of the problem's are none.
NO_LENGTH = 1e-12
# A limb that lacks less than this share of its reach is straight.
STRAIGHT = 1e-9


@dataclass(frozen=True, slots=True)
class Limb:
    """The way from a joint that stays in its place to a goal's point."""

    goal: int  # which of the problem's goals
    joints: tuple[int, ...]  # those whose translations are its bones
    origin: FloatArray  # of its root, in shares of the problem's length ``(3,)``
    reach: float  # its length when as straight as it can be, in such shares
    bones: float  # by how much that grows while the bones grow by 1 of their length
    soft: float  # share of the reach over which its extension eases out
    stretch: float  # most that its bones grow by


def find_limbs(
    rig: Rig, goals: Sequence[Goal], moving: set[int], chain: Chain
) -> tuple[tuple[Limb, ...], list[Fault]]:
    """Return the limbs of goals that are soft or stretch, and what is wrong with them.

    A fault is a limb whose root is moved, that slides, has no bones to stretch, or
    shares them with another that stretches (IK008).
    """
    limbs, faults = [], []
    stretched: set[int] = set()
    for e, goal in enumerate(goals):
        if not (goal.soft > 0 or goal.stretch > 0):
            continue
        limb = _limb(rig, goal, e, moving, chain)
        message = _fault(rig, goal, limb, moving, chain)
        if goal.stretch > 0 and stretched & set(limb.joints):
            message = "bones that it stretches are another goal's to stretch too"
        if goal.stretch > 0:
            stretched |= set(limb.joints)
        if message:
            faults.append(Fault("IK008", message, where=f"goals[{e}]"))
        limbs.append(limb)
    return tuple(limbs), faults


def _limb(rig: Rig, goal: Goal, e: int, moving: set[int], chain: Chain) -> Limb:
    path = _path(chain, e)
    above = rig.upwards(rig.index(goal.joint))
    top = max(i for i, j in enumerate(above) if j in moving)
    bone, tool = chain.goal_numbers[e, :3], chain.goal_numbers[e, 3:6]
    between = float(np.linalg.norm(chain.numbers[path[1:], 9:12], axis=1).sum())
    end = bone + tool
    length = float(np.linalg.norm(end))
    along = max(float(bone @ end) / length, 0.0) if length > NO_LENGTH else 0.0
    straight = between + length
    share = min(_reach(chain, path, end) / straight, 1.0) if straight > 0 else 1.0
    if share > 1 - STRAIGHT:
        share = 1.0
    return Limb(
        e,
        tuple(above[:top]),
        chain.numbers[path[0], 9:12],
        share * straight,
        share * (between + along),
        goal.soft,
        goal.stretch,
    )


def _reach(chain: Chain, path: list[int], end: FloatArray) -> float:
    """Return how far a limb of two bones and a pin comes; infinite of others.

    ``end`` ``(3,)`` reaches, in the frame of the path's last node.
    """
    bent = [n for n in path[1:] if np.linalg.norm(chain.numbers[n, 9:12]) > NO_LENGTH]
    last = path[-1]
    if bent != [last] or len(path) != 2 or chain.nodes[last, [0, 3]].any():
        return np.inf
    if chain.numbers[last, 12] != 1 or chain.numbers[last, 13] != 0:
        return np.inf
    offset = chain.numbers[last, 9:12]
    x, y, z = chain.numbers[last, :9].reshape(3, 3).T @ offset
    even, odd = x * end[0] + y * end[1], y * end[0] - x * end[1]
    # The square of the reach is a constant and a cosine about its farthest angle.
    low, high = chain.numbers[last, 14:16]
    farthest = float(np.arctan2(odd, even))
    if np.isfinite(low):
        farthest += 2 * np.pi * float(np.ceil((low - farthest) / (2 * np.pi)))
    angles = [farthest] if farthest <= high else [low, high]
    most = max(even * np.cos(a) + odd * np.sin(a) for a in angles)
    square = offset @ offset + end @ end + 2 * (z * end[2] + most)
    return float(np.sqrt(max(square, 0.0)))


def _fault(
    rig: Rig, goal: Goal, limb: Limb, moving: set[int], chain: Chain
) -> str | None:
    what = "a limb that eases out or stretches"
    if not goal.position > 0:
        return f"{what} must have a position to reach"
    if (chain.nodes[_path(chain, limb.goal), 0] == SLIDE).any():
        return f"{what} must have joints that turn, and a root that stays in its place"
    above = rig.upwards(rig.index(goal.joint))
    if goal.root is not None:
        own = above[: above.index(rig.index(goal.root)) + 1]
        others = [j for j in above if j in moving and j not in own]
        if others:
            name = rig.joints[others[0]].name
            return f"{what} must have a root that stays in its place: {name!r} moves it"
    if goal.stretch > 0 and limb.bones <= NO_LENGTH:
        return "it has no bones to stretch"
    return None


def _path(chain: Chain, e: int) -> list[int]:
    """Return the nodes that move a goal, from the root."""
    path, node = [], int(chain.goals[e, 0])
    while node >= 0:
        path.append(node)
        node = int(chain.nodes[node, 1])
    return path[::-1]


@dataclass(frozen=True, slots=True)
class Extension:
    """How far the limbs of B problems go."""

    sought: FloatArray  # targets ``(B, E, W)``, packed, as far as the limbs extend
    scales: FloatArray  # what their bones are multiplied by ``(B, E)``
    eased: BoolArray  # where ease alone keeps one from its target ``(B, E)``

    def __getitem__(self, rows: IntArray) -> Extension:
        """Return those of some of the problems."""
        return Extension(self.sought[rows], self.scales[rows], self.eased[rows])


def extend(limbs: Sequence[Limb], targets: FloatArray) -> Extension:
    """Return the targets that limbs can seek, and what their bones are multiplied by.

    The bones grow by what the eased extension lacks of the distance, and no more than
    they may; the target sought is as far as the limb then extends.

    Up to ``(1 - soft) reach`` a limb extends as far as its target, and beyond ever
    closer to its full reach without a kink in speed, so that it never snaps straight.

    References:
        A. Nicholas, Soft IK, 2009 (the exponential ease).

    Limits of the method: the reach is that of the straight limb, or where a pin joins
    two bones of as straight a one as its limits let be; whatever other limits keep it
    from that.

    ``targets`` ``(B, E, W)`` are packed, in shares of the problem's length.
    """
    return Extension(*_kernels.extend_ik_limbs(*limb_arrays(limbs), targets))


def limb_arrays(limbs: Sequence[Limb]) -> tuple[IntArray, FloatArray]:
    """Return goals of limbs ``(L,)`` and their numbers ``(L, 7)`` for kernels."""
    rows = [
        [*limb.origin, limb.reach, limb.bones, limb.soft, limb.stretch]
        for limb in limbs
    ]
    goals = np.array([limb.goal for limb in limbs], np.int64)
    return goals, np.array(rows, np.float64).reshape(-1, 7)
