"""Spans of poses that interpolation between two others finds."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from animtool import _kernels

FRAMES, WIDE = 12, 3


def arguments(**changes: Any) -> dict[str, Any]:
    """Return those of a joint that turns evenly, and of one below it."""
    angles = np.linspace(0, 1, FRAMES) / 2
    turns = np.zeros((FRAMES, 1, 4))
    turns[:, 0, 0], turns[:, 0, 3] = np.sin(angles), np.cos(angles)
    unit = np.tile([0.0, 0.0, 0.0, 1.0], (2, 1))
    return {
        "joint_rotations": turns,
        "parents": np.array([-1, 0]),
        "pose_indices": np.array([0, -1]),
        "positions": np.array([[0.0, 0, 0], [0, 1, 0]]),
        "pre_rotations": unit,
        "rest_rotations": unit,
        "feet": np.array([1, 1]),
        "foot_stands": np.zeros((FRAMES, 2), bool),
        "span_starts": np.arange(FRAMES - WIDE),
        "span_width": WIDE,
        "max_joint_error": 1e-3,
        "max_foot_error": 1e-3,
        "max_root_shift": 1.0,
        **changes,
    }


def test_even_turns_fit_and_move_nothing() -> None:
    fits, back = _kernels.fitting_spans(**arguments())
    assert fits.all()
    assert_array_equal(back, 0)


def test_spans_that_do_not_fit_move_nothing() -> None:
    given = arguments(max_joint_error=0.0)
    given["joint_rotations"][1::2] = [[1.0, 0, 0, 0]]
    for _ in range(50):
        # Memory that the result is likely to get.
        freed = np.full(3 * (FRAMES - WIDE) * (WIDE - 1) + 1, np.nan)
        del freed
        fits, back = _kernels.fitting_spans(**given)
        assert not fits.any()
        assert_array_equal(back, 0)


@pytest.mark.parametrize("name", ["positions", "pre_rotations", "rest_rotations"])
def test_a_chain_that_is_not_finite_is_refused(name: str) -> None:
    given = arguments()
    given[name] = given[name].copy()
    given[name][1, 1] = np.nan
    with pytest.raises(ValueError, match=name):
        _kernels.fitting_spans(**given)
