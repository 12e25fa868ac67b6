"""Kinematic bodies that are released, and joints that break."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose
from support.rigid import FLOOR, GRAVITY, Rigid, ball, box

from animtool.core.errors import AnimtoolError

AWAKE = {"sleep": {"speed": 0}}
HELD = {"kinematic": True, "release": 1.0}


def test_a_released_body_goes_on_with_its_velocity(tmp_path: Path) -> None:
    turns = [[k / 4, math.cos(k / 2), 0, math.sin(k / 2), 0] for k in range(5)]
    crate = box(
        (0.4, 0.2, 0.3), at=[0, 5, 0], moves=[[0, 0, 0, 0], [1, 3, 1, 0]],
        turns=turns, **HELD,
    )  # fmt: skip
    found = Rigid(tmp_path, crate)
    assert_allclose(found.to(0.5)[0], [1.5, 5.5, 0], atol=1e-9)
    found.to(1.0)
    assert_allclose(found.velocities()[0], [3, 1, 0], atol=1e-6)
    # An angle of half a radian of the quaternion in a quarter of a second.
    assert_allclose(found.spins()[0], [0, 4, 0], atol=1e-6)
    assert_allclose(found.to(1.6)[0], [4.8, 6.6 - GRAVITY * 0.18, 0], atol=1e-3)
    assert_allclose(found.spins()[0], [0, 4, 0], atol=1e-6)


def test_a_thrower_lets_go_of_what_others_ran_into(tmp_path: Path) -> None:
    """Before it is released nothing pushes it, and it pushes what is in its way."""
    plate = box((1, 0.1, 1), name="plate", at=[0, 1, 0], mass=2, **HELD)
    load = ball(0.1, name="load", at=[0, 1.15, 0], mass=50)
    found = Rigid(tmp_path, plate, load, colliders=[FLOOR], **AWAKE)
    assert_allclose(found.to(0.99)[:, 1], [1, 1.15], atol=2e-3)
    both = found.to(1.3)
    assert_allclose(both[0, 1], 1 - GRAVITY * 0.3**2 / 2, atol=0.01)
    assert both[1, 1] == pytest.approx(1.15 - GRAVITY * 0.3**2 / 2, abs=0.01)
    assert found.to(3.0)[0, 1] == pytest.approx(0.05, abs=0.01)


@pytest.mark.parametrize("order", [("bob", "hand"), ("hand", "bob")])
def test_joints_go_on_where_a_body_is_released(
    tmp_path: Path, order: tuple[str, str]
) -> None:
    hand = ball(0.05, name="hand", at=[0, 2, 0], mass=1e-3 + 1, **HELD)
    bob = ball(0.05, name="bob", at=[0.5, 2, 0], mass=1)
    pin = {"type": "pin", "body": order[0], "to": order[1], "axis": [0, 0, 1]}
    found = Rigid(tmp_path, hand, bob, joints=[{**pin, "at": [0, 2, 0]}], **AWAKE)
    for t in np.linspace(0.1, 2.0, 20):
        hand_at, bob_at = found.to(t)
        assert_allclose(np.linalg.norm(bob_at - hand_at), 0.5, atol=1e-3)
        if t < 0.99:
            assert_allclose(hand_at, [0, 2, 0], atol=1e-9)
    assert hand_at[1] < -1


@pytest.mark.parametrize("order", [("bob", "hand"), ("hand", "bob")])
def test_drag_does_not_move_the_joint_of_a_body_that_is_not_released(
    tmp_path: Path, order: tuple[str, str]
) -> None:
    """Bodies with drag are heavier in a step, at the same joint frames."""
    hand = ball(0.05, name="hand", at=[0, 2, 0], centre=[0, 0.3, 0], mass=1, **HELD)
    bob = ball(0.05, name="bob", at=[0.5, 2, 0], mass=1)
    pin = {"type": "pin", "body": order[0], "to": order[1], "axis": [0, 0, 1]}
    forces = [{"gravity": None}, {"drag": {"linear": 5.0}}]
    joints = [{**pin, "at": [0, 2, 0]}]
    found = Rigid(tmp_path, hand, bob, joints=joints, forces=forces, **AWAKE)
    for t in np.linspace(0.1, 0.9, 5):
        hand_at, bob_at = found.to(t)
        assert_allclose(np.linalg.norm(bob_at - hand_at), 0.5, atol=2e-3)


def test_a_release_is_the_same_after_a_resume_and_in_any_step_asked(
    tmp_path: Path,
) -> None:
    crate = box((0.4, 0.2, 0.3), at=[0, 2, 0], **HELD)
    pin = {"type": "pin", "body": "bob", "to": "box", "axis": [0, 0, 1]}
    bob = ball(0.05, name="bob", at=[0.5, 2, 0], mass=1)
    joints = [{**pin, "at": [0.2, 2, 0], "breaks": {"force": 20}}]
    ends = []
    for looks in ([2.0], [0.3, 0.98, 1.02, 1.5, 2.0]):
        found = Rigid(tmp_path, crate, bob, joints=joints, colliders=[FLOOR])
        for t in looks:
            ends.append(found.to(t))
    assert (ends[0] == ends[-1]).all()


@pytest.mark.parametrize("share", [0.9, 1.1])
def test_a_joint_holds_its_weight_and_no_more(tmp_path: Path, share: float) -> None:
    weight = 2 * GRAVITY
    for kind in ("pin", "ball", "fixed", "prismatic"):
        hook = {"type": kind, "body": "ball", "breaks": {"force": share * weight}}
        found = Rigid(tmp_path, ball(0.1, mass=2), joints=[hook], **AWAKE)
        fell = found.to(1.0)[0, 1] < -1
        assert fell == (share < 1)
        assert ("SIM197" in found.codes()) == fell


@pytest.mark.slow
def test_a_pendulum_breaks_at_the_angle_of_its_tension(tmp_path: Path) -> None:
    """From level, it pulls by three times its weight over the sine of its angle."""
    hook = {"type": "pin", "body": "ball", "axis": [0, 0, 1], "name": "hook"}
    hook["breaks"] = {"force": 2 * 3 * 0.6 * GRAVITY}
    bob = ball(0.01, at=[1, 0, 0], mass=2)
    found = Rigid(tmp_path, bob, joints=[hook], step=0.002, **AWAKE)
    found.to(2.0)
    (notice,) = [one for one in found.run.notices if one.code == "SIM197"]
    t = found.state.broken[0, 0]
    assert "hook" in notice.message
    again = Rigid(tmp_path, bob, joints=[{**hook, "breaks": {"force": 1e9}}],
                  step=0.002, **AWAKE)  # fmt: skip
    assert -again.to(t)[0, 1] == pytest.approx(0.6, abs=0.01)
    # It flies from there.
    speed = math.sqrt(2 * GRAVITY * 0.6)
    way = np.array([-0.6, -0.8]) * speed
    at = again.to(t)[0, :2]
    left = 2.0 - t
    assert_allclose(
        found.to(2.0)[0, :2],
        at + way * left - [0, GRAVITY * left**2 / 2],
        atol=0.05,
    )


def test_a_beam_breaks_by_its_torque(tmp_path: Path) -> None:
    moment = 2 * GRAVITY * 0.5
    for share in (0.9, 1.1):
        beam = box((1, 0.1, 0.1), at=[0.5, 0, 0], mass=2)
        weld = {"type": "fixed", "body": "box", "breaks": {"torque": share * moment}}
        found = Rigid(tmp_path, beam, joints=[weld], **AWAKE)
        assert (found.to(1.0)[0, 1] < -1) == (share < 1)


def test_bodies_of_a_broken_joint_collide(tmp_path: Path) -> None:
    post = box((0.5, 0.5, 0.5), name="post", kinematic=True)
    ring = ball(0.1, name="ring", at=[0, 0.6, 0], mass=1)
    weld = {"type": "fixed", "body": "ring", "to": "post", "breaks": {"force": 5}}
    found = Rigid(tmp_path, post, ring, joints=[weld], **AWAKE)
    assert found.to(1.0)[1, 1] == pytest.approx(0.35, abs=2e-3)


def test_only_what_is_held_is_released(tmp_path: Path) -> None:
    loose: dict[str, Any] = ball(0.1, release=1.0)
    with pytest.raises(AnimtoolError) as error:
        Rigid(tmp_path, loose)
    assert error.value.code == "SIM061"
