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
    state = cast(Any, SimpleNamespace(motion=motion))
    why = RigidSimulation.misfit(cast(Any, None), state, 0.0)
    assert (why == "") is fits
