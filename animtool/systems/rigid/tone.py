"""Ragdoll extras: passive muscle tone, and capsules for fingers."""

from __future__ import annotations

import re
from itertools import pairwise

import numpy as np

from animtool.core.array_types import FloatArray, IntArray
from animtool.rig.kinematics import WorldTransforms
from animtool.rig.skeleton import Rig
from animtool.sim.colliders.on_joints import Capsules

# Passive stiffness per radian, as a fraction of the gravity torque of a level limb, and
# the damping ratio of that spring.
STIFFNESS_FRACTION, DAMPING_RATIO = 0.15, 0.35
GRAVITY = 9.81  # [m/s²]
# Radius of a finger over its mean bone length, and length of its last bone over the
# previous one if no joint ends it.
THICKNESS, TIP = 0.2, 0.8
# A joint with this many chains of two or more joints is a hand, whatever its name.
DIGITS = 3
_NAMES = re.compile(r"thumb|finger|index|middle|ring|pinky|little|digit", re.IGNORECASE)


def with_digits(rig: Rig, world: WorldTransforms, capsules: Capsules) -> Capsules:
    """Return capsules, with added ones for fingers, attached to their hand.

    A hand is a joint with capsules, and none below it, from which fingers go out.

    Args:
        rig: The rig.
        world: Of its joints in one pose.
        capsules: Of the rig.
    """
    below: dict[int, list[int]] = {}
    for j, joint in enumerate(rig.joints):
        below.setdefault(joint.parent, []).append(j)
    owned = set(capsules.joints.tolist())
    inner = {k for j in owned for k in rig.upwards(j)[1:]}
    joints, ends, radii = [], [], []
    for hand in sorted(owned - inner):
        chains = [_chain(below, child) for child in below.get(hand, ())]
        long = [chain for chain in chains if len(chain) > 1]
        named = [c for c in long if _NAMES.search(rig.joints[c[0]].name)]
        for chain in long if len(long) >= DIGITS else named:
            points = world.positions[0, chain]
            bones = np.diff(points, axis=0)
            lengths = np.linalg.norm(bones, axis=1)
            if not lengths.all():
                continue
            ended = rig.joints[chain[-1]].name.lower().endswith(("end", "tip", "nub"))
            if not ended:
                points = np.concatenate([points, points[-1:] + TIP * bones[-1:]])
            back = np.linalg.inv(world.linear[0, hand])
            local = (points - world.positions[0, hand]) @ back.T
            size = np.cbrt(np.abs(np.linalg.det(back)))
            for a, b in pairwise(local):
                joints.append(hand)
                ends.append(np.stack([a, b]))
                radii.append(THICKNESS * lengths.mean() * size)
    if not joints:
        return capsules
    return Capsules(
        np.concatenate([capsules.joints, joints]),
        np.concatenate([capsules.ends, np.array(ends)]),
        np.concatenate([capsules.radii, np.array(radii)]),
    )


def _chain(below: dict[int, list[int]], joint: int) -> list[int]:
    """Return a joint and its descendants, up to the first branch."""
    chain = [joint]
    while len(below.get(chain[-1], ())) == 1:
        chain.append(below[chain[-1]][0])
    return chain


def passive(
    above: IntArray, masses: FloatArray, centres: FloatArray, pivots: FloatArray
) -> FloatArray:
    """Return the stiffness [N m/rad] and damping [N m s/rad] of joints ``(N, 2)``.

    Each goes with the weight of what hangs on it, and how far from the joint that is.

    Args:
        above: Of each body the one that it hangs on, -1 for none ``(N,)``; bodies come
            behind what they hang on.
        masses: ``(N,)`` [kg].
        centres: Of mass, in the world ``(N, 3)`` [m].
        pivots: Where each is joined to the one above ``(N, 3)`` [m].
    """
    weights, firsts = masses.copy(), masses[:, None] * centres
    for i in range(len(above) - 1, -1, -1):
        if above[i] >= 0:
            weights[above[i]] += weights[i]
            firsts[above[i]] += firsts[i]
    arms = np.linalg.norm(firsts / weights[:, None] - pivots, axis=1)
    stiffness = STIFFNESS_FRACTION * weights * GRAVITY * arms
    damping = 2 * DAMPING_RATIO * np.sqrt(stiffness * weights) * arms
    return np.stack([stiffness, damping], axis=1)
