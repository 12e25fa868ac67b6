"""Passive muscle tone of ragdolls, and capsules for their fingers."""

from __future__ import annotations

import re
from itertools import pairwise

import numpy as np

from animtool.core.array_types import FloatArray, IntArray
from animtool.rig.kinematics import WorldTransforms
from animtool.rig.skeleton import Rig
from animtool.sim.colliders.on_joints import JointCapsules

# Passive stiffness per radian, as a fraction of the gravity torque of a level limb, and
# the damping ratio of that spring.
STIFFNESS_FRACTION, DAMPING_RATIO = 0.15, 0.35
GRAVITY = 9.81  # [m/s²]
# Radius of a finger relative to its mean bone length, and length of its last bone
# relative to the bone before it, if it has no end joint.
FINGER_RADIUS_RATIO, LAST_BONE_RATIO = 0.2, 0.8
# A joint with this many child chains of two or more joints is a hand, regardless of the
# names of the joints.
MIN_HAND_CHAINS = 3
_FINGER_NAMES = re.compile(
    r"thumb|finger|index|middle|ring|pinky|little|digit", re.IGNORECASE
)


def add_finger_capsules(
    rig: Rig, world: WorldTransforms, capsules: JointCapsules
) -> JointCapsules:
    """Return the capsules of a rig, with finger capsules added to the hands.

    A hand is a joint that has capsules, has no descendants with capsules, and from
    which fingers branch off. ``world`` has the joints in one pose ``(1, J, …)``.
    """
    children_by_joint: dict[int, list[int]] = {}
    for j, joint in enumerate(rig.joints):
        children_by_joint.setdefault(joint.parent, []).append(j)
    joints_with_capsules = set(capsules.joints.tolist())
    ancestors = {k for j in joints_with_capsules for k in rig.upwards(j)[1:]}
    joints, ends, radii = [], [], []
    for hand in sorted(joints_with_capsules - ancestors):
        chains = [
            _joint_chain(children_by_joint, child)
            for child in children_by_joint.get(hand, ())
        ]
        chains = [chain for chain in chains if len(chain) > 1]
        if len(chains) < MIN_HAND_CHAINS:
            chains = [c for c in chains if _FINGER_NAMES.search(rig.joints[c[0]].name)]
        for chain in chains:
            points = world.positions[0, chain]
            bone_vectors = np.diff(points, axis=0)
            bone_lengths = np.linalg.norm(bone_vectors, axis=1)
            if not bone_lengths.all():
                continue
            last_name = rig.joints[chain[-1]].name.lower()
            if not last_name.endswith(("end", "tip", "nub")):
                end_point = points[-1] + LAST_BONE_RATIO * bone_vectors[-1]
                points = np.vstack([points, end_point])
            inverse_linear = np.linalg.inv(world.linear[0, hand])
            local_points = (points - world.positions[0, hand]) @ inverse_linear.T
            scale = np.cbrt(np.abs(np.linalg.det(inverse_linear)))
            for a, b in pairwise(local_points):
                joints.append(hand)
                ends.append(np.stack([a, b]))
                radii.append(FINGER_RADIUS_RATIO * bone_lengths.mean() * scale)
    if not joints:
        return capsules
    finger_capsules = JointCapsules(np.array(joints), np.array(ends), np.array(radii))
    return JointCapsules.concatenate([capsules, finger_capsules])


def _joint_chain(children: dict[int, list[int]], joint: int) -> list[int]:
    """Return a joint and its descendants up to the first branching joint."""
    chain = [joint]
    while len(children.get(chain[-1], ())) == 1:
        chain.append(children[chain[-1]][0])
    return chain


def passive_springs(
    parent_bodies: IntArray, masses: FloatArray, centres: FloatArray, pivots: FloatArray
) -> FloatArray:
    """Return stiffness [N m/rad] and damping [N m s/rad] of joints ``(N, 2)``.

    Both increase with the weight below the joint, and with its lever arm. Parent bodies
    ``(N,)``, -1 for none, come first. Centres of mass ``(N, 3)`` [m] are in the world,
    and so are the pivots of the joints to the parent bodies; masses are ``(N,)`` [kg].
    """
    supported_masses, weighted_centres = masses.copy(), masses[:, None] * centres
    for i in range(len(parent_bodies) - 1, -1, -1):
        if parent_bodies[i] >= 0:
            supported_masses[parent_bodies[i]] += supported_masses[i]
            weighted_centres[parent_bodies[i]] += weighted_centres[i]
    lever_arms = np.linalg.norm(
        weighted_centres / supported_masses[:, None] - pivots, axis=1
    )
    stiffness = STIFFNESS_FRACTION * supported_masses * GRAVITY * lever_arms
    damping = 2 * DAMPING_RATIO * np.sqrt(stiffness * supported_masses) * lever_arms
    return np.stack([stiffness, damping], axis=1)
