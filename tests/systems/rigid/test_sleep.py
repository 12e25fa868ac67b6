"""Who sleeps: what friction holds; not what drifts, is pushed, swings or slides."""

from __future__ import annotations

import math
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose
from support.rigid import FLOOR, GRAVITY, Rigid, ball, box

from animtool.systems.rigid.simulation import RigidSimulation

CUBE = (0.2, 0.2, 0.2)
SLOW = 0.015


def test_a_slow_body_in_space_goes_on(tmp_path: Path) -> None:
    found = Rigid(tmp_path, box(CUBE, velocity=[SLOW, 0, 0], spin=[0, 3, 0]), forces=[])
    assert_allclose(found.to(5.0)[0], [5 * SLOW, 0, 0], atol=1e-9)
    assert_allclose(found.spins()[0], [0, math.radians(3), 0], atol=1e-9)


def test_a_small_constant_push_speeds_up(tmp_path: Path) -> None:
    body = box(CUBE, mass=10, pushes=[{"force": [0.05, 0, 0]}])
    found = Rigid(tmp_path, body, forces=[])
    assert found.to(5.0)[0, 0] == pytest.approx(0.05 / 10 * 25 / 2, rel=1e-3)


def test_a_pendulum_that_swings_little_goes_on(tmp_path: Path) -> None:
    reach, offset = 1.0, 2e-3
    bob = ball(0.05, at=[offset, -reach, 0])
    joint = {"type": "pin", "body": "ball", "at": [0, 0, 0], "axis": [0, 0, 1]}
    found = Rigid(tmp_path, bob, joints=[joint])
    rate = math.sqrt(GRAVITY * reach / (reach**2 + 0.4 * 0.05**2))
    for t in (3.0, 4.3, 6.1):
        assert found.to(t)[0, 0] == pytest.approx(
            offset * math.cos(rate * t), abs=offset / 50
        )


def test_a_door_on_its_hinge_turns_on(tmp_path: Path) -> None:
    door = box(
        [1, 2, 0.04], at=[0.5, 0, 0], spin=[0, 0.5, 0], velocity=[0, 0, -0.00436]
    )
    joint = {"type": "pin", "body": "box", "at": [0, 0, 0], "axis": [0, 1, 0]}
    found = Rigid(tmp_path, door, joints=[joint])
    begin = found.to(0.5)[0]
    at = found.to(8.0)[0]
    turned = math.degrees(math.atan2(-at[2], at[0]) - math.atan2(-begin[2], begin[0]))
    assert turned == pytest.approx(0.5 * 7.5, rel=0.02)


@pytest.mark.parametrize(("friction", "goes"), [(0.0, 5 * SLOW), (1e-4, 0.0627)])
def test_a_stone_on_ice_slides_on(tmp_path: Path, friction: float, goes: float) -> None:
    """v t - mu g t² / 2."""
    stone = box(CUBE, at=[0, 0.1, 0], velocity=[SLOW, 0, 0], friction=friction)
    floor = {**FLOOR, "friction": friction}
    found = Rigid(tmp_path, stone, colliders=[floor])
    assert found.to(5.0)[0, 0] == pytest.approx(goes, rel=0.02)


def test_a_slow_ball_rolls_on(tmp_path: Path) -> None:
    body = ball(0.1, at=[0, 0.1, 0], velocity=[SLOW, 0, 0], friction=0.5)
    body |= {"spin": [0, 0, -math.degrees(SLOW / 0.1)]}
    found = Rigid(tmp_path, body, colliders=[FLOOR])
    assert found.to(5.0)[0, 0] == pytest.approx(5 * SLOW, rel=0.01)


def test_what_stands_sleeps(tmp_path: Path) -> None:
    boxes = [{**box(CUBE, at=[0, 0.1 + 0.2 * k, 0]), "name": f"b{k}"} for k in range(4)]
    found = Rigid(tmp_path, *boxes, colliders=[FLOOR])
    found.to(2.0)
    assert found.state.awake == 0
    assert np.abs(found.velocities()).max() == 0


def test_those_whose_forces_change_wake_and_the_others_sleep() -> None:
    """Of four the first is awake; of three who sleep one is pulled otherwise."""
    motion = np.zeros((4, 14))
    motion[:, 13] = [0.1, 0.5, 0.7, 0.9]
    changed = np.array([True, False, True, False])
    asked: list[Any] = []
    forces = SimpleNamespace(
        is_variable=True,
        step_wrenches=lambda *given: asked.append(given) or "varied",
        has_changed=lambda own, *_: (asked.append(own), changed)[1],
    )
    spec = SimpleNamespace(sleep=SimpleNamespace(time=0.5))
    own: Any = SimpleNamespace(_spec=spec, _forces=forces)
    loads: Any = SimpleNamespace(forces="kept")
    found = RigidSimulation._wake_sleepers(own, motion, loads, 1.0, 0.1)
    assert found[:, 13].tolist() == [0.1, 0.5, 0.0, 0.9]
    assert motion[2, 13] == 0.7
    assert asked[-1] == "varied"
    forces.is_variable = False
    assert RigidSimulation._wake_sleepers(own, motion, loads, 1.0, 0.1)[2, 13] == 0
    assert asked[-1] == "kept"
    changed[2] = False
    assert RigidSimulation._wake_sleepers(own, motion, loads, 1.0, 0.1) is motion
    motion[:, 13] = 0.1
    count = len(asked)
    assert RigidSimulation._wake_sleepers(own, motion, loads, 1.0, 0.1) is motion
    assert len(asked) == count
