"""Attachments as particles: where chains end, and what carries cloth."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

from animtool.rig.skeleton import Joint, Rig
from animtool.systems.attach.bodies import MassSpringNetwork, _bone_end, _main_joint

JOINTS = (
    Joint("head", -1, translation=(0.0, 1.6, 0.0)),
    Joint("tail_1", 0, translation=(0.0, 0.1, -0.1)),
    Joint("tail_2", 1, translation=(0.0, -0.2, -0.05)),
)


def test_a_chain_ends_at_its_tip_or_child_or_goes_on_as_its_last_bone() -> None:
    assert_allclose(_bone_end(Rig("tail", JOINTS), [1, 2]), [0.0, -0.2, -0.05])
    end = Joint("end", 2, translation=(0.0, -0.1, 0.3))
    assert_allclose(_bone_end(Rig("tail", (*JOINTS, end)), [1, 2]), [0.0, -0.1, 0.3])
    tipped = replace(JOINTS[2], tips=((0.5, 0.0, 0.0), (9.0, 0.0, 0.0)))
    rig = Rig("tail", (*JOINTS[:2], tipped, end))
    assert_allclose(_bone_end(rig, [1, 2]), [0.5, 0.0, 0.0])


@pytest.mark.parametrize(
    ("held", "carrier"),
    [([0], 0), ([1], 1), ([0, 1], 1), ([2, 3], 2), ([], 2), ([0, 1, 2], 1)],
)
def test_what_is_held_goes_with_the_joint_of_most_of_its_weight(
    held: list[int], carrier: int
) -> None:
    """Of two influences a point; of cloth that nothing holds by all of its points."""
    skin = SimpleNamespace(
        joints=("tail_2", "head", "tail_1"),
        indices=np.array([[1, 2], [2, 1], [0, 2], [0, 2]]),
        weights=np.array([[0.6, 0.4], [0.7, 0.3], [0.9, 0.1], [1.0, 0.0]]),
    )
    surface: Any = SimpleNamespace(skin=skin)
    points = np.eye(4, 3)
    network = MassSpringNetwork(points, np.array(held, np.int64), np.array([[0, 1]]))
    assert _main_joint(Rig("tail", JOINTS), surface, network) == carrier
    assert _main_joint(Rig("tail", JOINTS), SimpleNamespace(skin=None), network) == 0
