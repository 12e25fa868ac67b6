"""Motors of joints that keep a speed."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose
from support.rigid import GRAVITY, Rigid, box

from animtool.core.errors import AnimtoolError


def pin(**drive: Any) -> dict[str, Any]:
    return {"type": "pin", "body": "box", "axis": [0, 0, 1], "drive": drive}


@pytest.mark.parametrize("speed", [0.5, -90, 720])
def test_a_motor_keeps_its_speed_against_gravity(tmp_path: Path, speed: float) -> None:
    arm = box((0.6, 0.1, 0.1), at=[0.3, 0, 0], mass=2)
    found = Rigid(tmp_path, arm, joints=[pin(speed=speed)], residual=1e-8)
    for t in (0.5, 1.0, 4.0):
        x, y, _ = found.to(t)[0]
        assert_allclose(found.spins()[0], [0, 0, math.radians(speed)], atol=1e-3)
        angle = math.radians(speed) * t
        off = math.remainder(math.atan2(y, x) - angle, math.tau)
        # The last step may be as much as half a degree of a fast one behind.
        assert abs(off) < 2e-3 + abs(math.radians(speed)) * 0.01


def test_a_weak_motor_speeds_up_as_its_torque_says(tmp_path: Path) -> None:
    arm = box((0.6, 0.1, 0.1), mass=2)
    found = Rigid(tmp_path, arm, joints=[pin(speed=360, most=0.1)], forces=[])
    moment = 2 * (0.6**2 + 0.1**2) / 12
    found.to(1.0)
    assert found.spins()[0, 2] == pytest.approx(0.1 / moment, rel=1e-3)
    found.to(6.0)
    assert found.spins()[0, 2] == pytest.approx(math.tau, rel=1e-3)


def test_a_motor_with_damping_falls_behind_its_load(tmp_path: Path) -> None:
    lift = {"type": "prismatic", "body": "box", "axis": [0, 1, 0]}
    lift["drive"] = {"speed": 2, "damping": 50}
    found = Rigid(tmp_path, box((0.2, 0.2, 0.2), mass=3), joints=[lift])
    found.to(2.0)
    assert found.velocities()[0, 1] == pytest.approx(2 - 3 * GRAVITY / 50, abs=1e-3)


def test_a_slide_with_a_motor_goes_on_at_its_speed(tmp_path: Path) -> None:
    slide = {"type": "prismatic", "body": "box", "axis": [1, 0, 0]}
    slide["drive"] = {"speed": 0.3}
    found = Rigid(tmp_path, box((0.2, 0.2, 0.2), mass=3), joints=[slide])
    path = found.path(np.arange(1, 11) / 2)[:, 0, 0]
    assert_allclose(path, 0.3 * np.arange(1, 11) / 2, atol=5e-3)


@pytest.mark.parametrize(
    "joint",
    [
        {**pin(speed=90), "type": "ball"},
        pin(speed=90, stiffness=3),
        pin(speed=90, target=10),
        pin(speed=90, damping=0),
    ],
)
def test_what_a_motor_cannot_be_is_refused(
    tmp_path: Path, joint: dict[str, Any]
) -> None:
    with pytest.raises(AnimtoolError) as error:
        Rigid(tmp_path, box((0.2, 0.2, 0.2)), joints=[joint])
    assert error.value.code == "SIM061"
