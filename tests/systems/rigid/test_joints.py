"""Numbers of joints: units of limits and speeds, loads, and joints turned round."""

from __future__ import annotations

from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose
from support.rigid import Rigid, box

from animtool.maths import so3
from animtool.motion.physics import relative_pose
from animtool.sim.colliders import Poses
from animtool.systems.rigid.joints import (
    JOINT_KINDS,
    BodyJoint,
    Joints,
    _drive_parameters,
    _limit_parameters,
    joint_forces_and_torques,
    swap_bodies,
    to_parent_frame,
)
from animtool.systems.rigid.spec import RigidJointModel


def model(kind: str, **keys: Any) -> RigidJointModel:
    given = {"type": kind, "body": "a", "at": [0, 0, 0], **keys}
    return RigidJointModel.model_validate(given)


def test_pins_and_balls_are_in_degrees_and_slides_in_metres() -> None:
    def limits(kind: str, **keys: Any) -> list[float]:
        return _limit_parameters(model(kind, **keys), "it", "joints[0]")

    assert limits("pin", limits=[-90, 180])[:2] == pytest.approx([-np.pi / 2, np.pi])
    assert limits("prismatic", limits=[-90, 180])[:2] == [-90, 180]
    found = limits("ball", twist=[-30, 60], swing=[45, 30])
    assert found == pytest.approx([-np.pi / 6, np.pi / 3, np.pi / 4, np.pi / 6])
    assert limits("ball", swing=45)[2:] == pytest.approx([np.pi / 4] * 2)
    assert limits("pin") == [1.0, 0.0, -1.0, -1.0]


def test_motors_turn_in_degrees_and_slide_in_metres() -> None:
    for kind, factor in (("pin", np.pi / 180), ("prismatic", 1.0)):
        own = _drive_parameters(
            model(kind, drive={"speed": 90, "most": 7}), "joints[0]"
        )
        assert own[-1] == pytest.approx(90 * factor)
        assert own[-2] == 7
        drive = {"target": 30, "stiffness": 5, "damping": 2}
        own = _drive_parameters(model(kind, drive=drive), "joints[0]")
        assert own[0] == pytest.approx(30 * factor)
        assert own[5:] == [5, 2, -1, 0]


def test_what_is_turned_round_moves_the_other_way() -> None:
    drive = so3.from_axis_angle(np.array([0.0, 1.0, 0.0]), 0.7)
    rest = np.array([-0.2, 0.5, 0.3, 0.4, 0.25, *drive, 5.0, 2.0, 7.0, 1.5])
    found = swap_bodies(rest)
    assert_allclose(found[:5], [-0.5, 0.2, 0.3, 0.4, -0.25])
    assert_allclose(found[5:9], so3.conjugate(drive))
    assert_allclose(found[9:], [5.0, 2.0, 7.0, -1.5])
    assert_allclose(swap_bodies(found), rest)
    # Without limits the least is above the most, and stays so.
    rest[:2] = 1.0, 0.0
    assert_allclose(swap_bodies(rest)[:2], [1.0, 0.0])


def test_loads_are_forces_and_torques_by_what_the_joint_leaves_free() -> None:
    """What limits hold is along x: a force of a slide, else a torque."""
    names = ["prismatic", "pin"]
    joints = Joints(
        [
            BodyJoint(name, JOINT_KINDS[name], (-1, 0), [], Poses(), -1, (-1, -1))
            for name in names
        ]
    )
    held = np.zeros((2, 12))
    held[:, :9] = [1.0, 4.0, 0.0, 0.0, 6.0, 0.0, 5.0, 3.0, 8.0]
    found = joint_forces_and_torques(joints, held)
    assert_allclose(found[0], [5.0, 10.0])  # (1 + 5 - 3, 4), and 6 beside 8
    assert_allclose(found[1], [np.sqrt(17), np.sqrt(4 + 36 + 64)])


def test_frames_are_seen_and_placed_back() -> None:
    turn = so3.from_axis_angle(np.array([0.0, 0.0, 1.0]), np.pi / 2)
    pose = np.array([1.0, 2.0, 3.0, *turn])
    frame = np.array([1.0, 5.0, 3.0, *so3.IDENTITY])
    seen = relative_pose(pose, frame)
    assert_allclose(seen, [3, 0, 0, *so3.conjugate(turn)], atol=1e-12)
    assert_allclose(to_parent_frame(pose, seen), frame, atol=1e-12)


def test_what_is_fixed_to_a_turned_frame_of_the_world_stays(tmp_path: Path) -> None:
    """About axes of all signs, by 100 and 170 degrees: frames of all quaternions."""
    bodies, joints = [], []
    for k, signs in enumerate(product((1, -1), repeat=3)):
        axis = np.array([1.0, 2.0, 3.0]) * signs / np.sqrt(14)
        turn = so3.from_axis_angle(axis, np.radians(100 + 70 * (k % 2)))
        at = [3.0 * k, 0.0, 0.0]
        bodies.append({**box((0.2, 0.3, 0.4)), "name": f"b{k}", "at": at})
        rotate = turn[[3, 0, 1, 2]].tolist()
        joint = {"type": "fixed", "body": f"b{k}", "at": [3.0 * k, 0.5, 0]}
        joints.append({**joint, "rotate": rotate})
    found = Rigid(tmp_path, *bodies, joints=joints, forces=[], sleep={"speed": 0})
    found.to(0.1)
    assert_allclose(found.velocities(), 0, atol=1e-9)
    assert_allclose(found.spins(), 0, atol=1e-9)
    assert_allclose(np.abs(found.state.motion[:, 6]), 1, atol=1e-9)
