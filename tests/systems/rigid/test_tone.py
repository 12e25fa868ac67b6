"""Tone in the joints of a rig that falls, and fingers that collide."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.optimize import brentq

from animtool.core.clock import Clock
from animtool.maths import so3
from animtool.motion.motion import Channel, Motion
from animtool.motion.passes import PassContext
from animtool.motion.take import Take
from animtool.rig.kinematics import WorldTransforms, forward_kinematics
from animtool.rig.parts import Capsule, Collider
from animtool.rig.skeleton import Joint, JointType, Rig
from animtool.sim.colliders import Box, Poses
from animtool.sim.colliders import Collider as Obstacle
from animtool.sim.colliders.on_joints import JointCapsules
from animtool.systems.rigid.ragdoll import RagdollOptions
from animtool.systems.rigid.take_pass import apply_ragdoll
from animtool.systems.rigid.tone import (
    DAMPING_RATIO,
    GRAVITY,
    STIFFNESS_FRACTION,
    add_finger_capsules,
    passive_springs,
)

BONE = 0.04


def hand_rig(names: tuple[str, ...] = ("a", "b", "c")) -> Rig:
    """Return a forearm and a hand with capsules, and fingers without."""
    joints = [
        Joint("arm", -1, JointType.FREE),
        Joint("hand", 0, JointType.BALL, (0.3, 0, 0)),
    ]
    for k, name in enumerate(names):
        at = (0.1, 0.0, 0.03 * (k - 1))
        first = len(joints)
        joints.append(Joint(f"{name}_1", 1, JointType.BALL, at))
        joints += [
            Joint(f"{name}_{i + 2}", first + i, JointType.BALL, (BONE, 0, 0))
            for i in range(2)
        ]
    colliders = (
        Collider("arm", Capsule(0.04, 0.2, (1.0, 0, 0), (0.15, 0, 0))),
        Collider("hand", Capsule(0.03, 0.04, (1.0, 0, 0), (0.05, 0, 0))),
    )
    return Rig("hand", tuple(joints), colliders=colliders)


def rest(rig: Rig, frames: int = 1) -> tuple[np.ndarray, np.ndarray]:
    return tuple(  # type: ignore[return-value]
        np.repeat(array[None], frames, axis=0)
        for array in (rig.rest_translations, rig.rest_rotations)
    )


def world_of(rig: Rig) -> WorldTransforms:
    return forward_kinematics(rig, *rest(rig), np.ones((1, len(rig.joints), 3)))


def fallen(rig: Rig, frames: int, **options: object) -> Take:
    places, turns = rest(rig, frames)
    motion = Motion(Channel.from_dense(places), Channel.from_dense(turns))
    clock = Clock(Fraction(24), Fraction(1), Fraction(1), frames)
    take = Take(rig, clock, motion)
    context = PassContext(lambda _: take, Path())
    return apply_ragdoll(take, RagdollOptions(blend=0.0, **options), context)  # type: ignore[arg-type]


def test_fingers_get_capsules_along_their_bones() -> None:
    rig = hand_rig()
    capsules = JointCapsules.from_rig(rig)
    made = add_finger_capsules(rig, world_of(rig), capsules)
    assert len(made) == len(capsules) + 9
    assert (made.joints[2:] == 1).all()
    assert_allclose(made.radii[2:], 0.2 * BONE)
    # Two bones, and one more that no joint ends.
    assert_allclose(made.ends[2, 0], [0.1, 0, -0.03])
    assert_allclose(made.ends[4, 1], [0.1 + 2.8 * BONE, 0, -0.03])


@pytest.mark.parametrize(
    ("names", "count"), [(("a", "b"), 0), (("thumb", "mitten"), 3), ((), 0)]
)
def test_what_is_no_hand_gets_none(names: tuple[str, ...], count: int) -> None:
    rig = hand_rig(names)
    capsules = JointCapsules.from_rig(rig)
    assert (
        len(add_finger_capsules(rig, world_of(rig), capsules)) == len(capsules) + count
    )


@pytest.mark.parametrize("fingers", [True, False])
def test_fingers_stay_out_of_what_they_fall_onto(fingers: bool) -> None:
    # A table that only the fingers reach.
    table = Obstacle(Box((0.4, 0.2, 1.0)), Poses.fixed((0.62, -0.3, 0)))
    made = fallen(hand_rig(), 12, colliders=[table], fingers=fingers)
    assert made.motion is not None
    places, turns = (
        channel.dense() for channel in (made.motion.translations, made.motion.rotations)
    )
    world = forward_kinematics(made.rig, places, turns, np.ones_like(places))
    tips = world.positions[:, [4, 7, 10]]
    inside = (tips[..., 0] > 0.42) & (tips[..., 1] > -0.4)
    deep = np.where(inside, -0.2 - tips[..., 1], 0.0).max()
    assert deep < 0.002 if fingers else deep > 0.02


def test_tone_goes_with_the_weight_that_hangs_on_a_joint() -> None:
    above = np.array([-1, 0, 1])
    masses = np.array([10.0, 3.0, 1.0])
    centres = np.array([[0.0, 0, 0], [0.5, 0, 0], [1.5, 0, 0]])
    pivots = np.array([[0.0, 0, 0], [0.25, 0, 0], [1.0, 0, 0]])
    found = passive_springs(above, masses, centres, pivots)
    assert_allclose(found[2, 0], STIFFNESS_FRACTION * 1.0 * GRAVITY * 0.5)
    assert_allclose(found[1, 0], STIFFNESS_FRACTION * 4.0 * GRAVITY * (0.75 - 0.25))
    # Of a spring that turns 4 kg on an arm of half a metre, about a kg m².
    assert_allclose(found[1, 1], 2 * DAMPING_RATIO * np.sqrt(found[1, 0] * 4 * 0.5**2))


@pytest.mark.parametrize("tone", [3.0, 12.0])
def test_a_hand_sags_by_its_weight_over_its_tone(tone: float) -> None:
    rig = hand_rig(())
    colliders = (Collider("arm", Capsule(0.5, 0.0)), rig.colliders[1])
    heavy = Rig("hung", rig.joints, colliders=colliders)
    floor = Obstacle(Box((9.0, 1.0, 9.0)), Poses.fixed((0, -1.0, 0)))
    made = fallen(heavy, 96, tone=tone, damping=0.02, colliders=[floor])
    assert made.motion is not None
    turn = made.motion.rotations.dense()[-1, 1]
    sag = brentq(lambda a: tone * STIFFNESS_FRACTION * a - np.cos(a), 0, np.pi / 2)
    assert so3.angle_between(turn, so3.IDENTITY) == pytest.approx(sag, rel=0.03)
