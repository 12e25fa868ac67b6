"""Ends of frames of what hangs on joints."""

from __future__ import annotations

import numpy as np
import pytest
from support.faults import raises

from animtool.core.errors import ToleranceError
from animtool.systems.attach.actor import cells_and_substeps, check_motion


@pytest.mark.parametrize("value", [2e30, -1e200, np.inf, np.nan])
def test_a_state_that_is_in_no_scene_is_refused(value: float) -> None:
    """SIM102 names the particle; what is far but finite goes on."""
    made = np.zeros((2, 3, 3))
    made[0, 1, 2] = 1e20
    check_motion(made)
    made[0, 2, 0] = value
    with raises(ToleranceError, "SIM102", match="particle 2"):
        check_motion(made)


@pytest.mark.parametrize(
    ("steps", "cells"),
    [(1, (1, 1)), (8, (8, 1)), (9, (5, 2)), (12, (6, 2)), (15, (5, 3)), (17, (6, 3)),
     (25, (5, 5)), (44, (5, 9))],
)  # fmt: skip
def test_a_frame_has_five_to_eight_cells_and_hardly_more_steps_than_asked(
    steps: int, cells: tuple[int, int]
) -> None:
    """The fewest steps in all; of as many the most cells."""
    assert cells_and_substeps(steps) == cells
