"""Where the ground is that a rig stands on."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from animtool.maths import so3
from animtool.rig.skeleton import Joint, Rig
from animtool.systems.crowds.gaits import _rest_ground_height


def test_the_ground_is_below_the_lowest_joint_or_the_end_of_a_bone() -> None:
    """The second joint is turned about z by 90 degrees: its bone along x goes up."""
    joints = (Joint("a", -1), Joint("b", 0), Joint("c", 1))
    positions = np.array([[-5.0, 1.0, -7.0], [-6.0, 0.5, 0.0], [-8.0, 0.75, -9.0]])
    turns = np.tile(so3.IDENTITY, (3, 1))
    turns[1] = so3.exp(np.array([0.0, 0.0, np.pi / 2]))
    person = SimpleNamespace(rig=Rig("r", joints), positions=positions, rotations=turns)
    assert _rest_ground_height(person) == 0.5  # type: ignore[arg-type]
    for tip, height in (((-0.3, 0.0, 0.0), 0.2), ((0.3, 0.0, 0.0), 0.5)):
        tipped = (joints[0], Joint("b", 0, tips=(tip,)), joints[2])
        person.rig = Rig("r", tipped)
        assert _rest_ground_height(person) == pytest.approx(height)  # type: ignore[arg-type]
