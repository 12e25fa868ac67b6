"""States of files that rigid bodies cannot be resumed from."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from animtool.systems.rigid.simulation import RigidSimulation


@pytest.mark.parametrize(
    ("attitude", "fits"),
    [([0, 0, 0, 1], True), ([0.6, 0, 0.8, 0], True), ([0, 0, 0, 0], False),
     ([1e-300, 0, 0, 0], False)],
)  # fmt: skip
def test_an_attitude_is_a_rotation(attitude: list[float], fits: bool) -> None:
    motion = np.zeros((2, 14))
    motion[:, 3:7] = [0, 0, 0, 1], attitude
    assert (incompatibility(motion=motion) == "") is fits


def incompatibility(**changes: Any) -> str:
    """Return why a state of two bodies with a joint does not fit."""
    motion = np.zeros((2, 14))
    motion[:, 6] = 1.0
    whole = {
        "motion": motion,
        "fastest_drive_joint": -1,
        "deepest_pairs": np.full((2, 2), -1),
    }
    bodies = SimpleNamespace(names=["a", "b"], joints=["hinge"])
    bodies._shape_names = lambda: bodies.names
    state = cast(Any, SimpleNamespace(**whole | changes))
    return RigidSimulation.incompatibility(cast(Any, bodies), state, 0.0)


@pytest.mark.parametrize(
    ("changes", "fits"),
    [({"fastest_drive_joint": 0}, True), ({"fastest_drive_joint": 1}, False),
     ({"deepest_pairs": np.array([[0, 1], [-1, -1]])}, True),
     ({"deepest_pairs": np.array([[0, 2], [-1, -1]])}, False),
     ({"deepest_pairs": np.array([[0, -2], [-1, -1]])}, False)],
)  # fmt: skip
def test_what_a_state_names_is_there(changes: dict[str, Any], fits: bool) -> None:
    assert (incompatibility(**changes) == "") is fits
