"""Colliders that joints carry."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from animtool.rig.kinematics import forward_kinematics
from animtool.rig.parts import Capsule as RigCapsule
from animtool.rig.parts import Collider as RigCollider
from animtool.rig.skeleton import Joint, Rig
from animtool.sim.colliders import (
    Capsule,
    Collider,
    Colliders,
    Sphere,
    rig_colliders,
)


def test_capsules_go_with_their_joints() -> None:
    bone = RigCapsule(0.1, 0.4, (1, 0, 0), (0.2, 0, 0))
    rig = Rig(
        "arm",
        (Joint("root", -1), Joint("arm", 0, translation=(0, 1, 0))),
        colliders=(RigCollider("arm", bone),),
    )
    turn = [0, 0, 0.5**0.5, 0.5**0.5]
    still = [0, 0, 0, 1]
    world = forward_kinematics(
        rig, [rig.rest_translations] * 2, [[still, still], [still, turn]]
    )
    like = Collider(Sphere(1), friction=0.5)
    (arm,) = rig_colliders(rig, world, [0, 1], like)
    assert (arm.name, arm.friction) == ("arm", 0.5)
    shape = Capsule(0.1, 0.4, (1, 0, 0), (0.2, 0, 0))
    assert_allclose(arm.shape.sizes(), shape.sizes(), atol=1e-15)
    ready = Colliders([arm])
    tips = [[0.5, 1, 0], [0, 1.5, 0]]
    assert_allclose(ready.sample(tips, 0.0).distances[0, 0], 0, atol=1e-12)
    assert_allclose(ready.sample(tips, 1.0).distances[0, 1], 0, atol=1e-12)
    speed = ready.sample([[0.5, 1, 0]], 0.0, 1.0).velocities[0, 0]
    assert_allclose(speed, [0, np.pi / 4, 0], atol=1e-12)


@pytest.mark.parametrize("length", [0.0, 0.4])
def test_capsules_are_as_large_as_the_first_frame_has_them(length: float) -> None:
    bone = RigCapsule(0.1, length, (0, 0, 1), (0, 0.3, 0))
    rig = Rig("arm", (Joint("arm", -1),), colliders=(RigCollider("arm", bone),))
    turn = [0, 0, 0.5**0.5, 0.5**0.5]
    scales = [[[2, 2, 2]], [[5, 5, 5]]]
    world = forward_kinematics(rig, [[[0, 0, 0]]] * 2, [[turn], [turn]], scales)
    (arm,) = rig_colliders(rig, world, [0, 1])
    shape = Capsule(0.2, 2 * length, (0, 0, 1), (0, 0.6, 0))
    assert_allclose(arm.shape.sizes(), shape.sizes(), atol=1e-15)
    assert not arm.faults("")


def test_a_rig_without_colliders_has_none() -> None:
    rig = Rig("dot", (Joint("root", -1),))
    world = forward_kinematics(rig, [rig.rest_translations], [[[0, 0, 0, 1]]])
    assert rig_colliders(rig, world, [0]) == []
