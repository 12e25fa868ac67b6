"""The rigid motion between two sets of points."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from animtool.maths import so3
from animtool.maths.faces import rigid_motion


@given(seed=st.integers(0, 2**32 - 1), count=st.integers(3, 9))
def test_a_rigid_motion_is_found(seed: int, count: int) -> None:
    rng = np.random.default_rng(seed)
    points, shift = rng.normal(size=(count, 3)), 100 * rng.normal(size=3)
    turn = so3.normalize(rng.normal(size=4))
    found, moved = rigid_motion(points, so3.rotate(turn, points) + shift)
    np.testing.assert_allclose(
        so3.rotate(found, points) + moved, so3.rotate(turn, points) + shift, atol=1e-9
    )
    assert so3.angle_between(found, turn) < 1e-6


@given(seed=st.integers(0, 2**32 - 1), count=st.integers(2, 5))
def test_points_on_a_line_turn_as_little_as_they_can(seed: int, count: int) -> None:
    rng = np.random.default_rng(seed)
    along, to = (so3.normalize(np.append(rng.normal(size=3), 0))[:3] for _ in "ab")
    places = np.linspace(-1, 2, count)[:, None]
    turn, shift = rigid_motion(places * along, places * to + 1.0)
    np.testing.assert_allclose(
        so3.rotate(turn, places * along) + shift, places * to + 1.0, atol=1e-9
    )
    least = float(np.arccos(np.clip(along @ to, -1, 1)))
    assert so3.angle_between(turn, so3.IDENTITY) == pytest.approx(least, abs=1e-6)


def test_a_line_is_turned_round() -> None:
    line = np.array([[0.0, 0, 0], [1, 0, 0]])
    turn, shift = rigid_motion(line, -line)
    np.testing.assert_allclose(so3.rotate(turn, line) + shift, -line, atol=1e-15)


@pytest.mark.parametrize("points", [[[1e3, 2, 3]], [[1e3, 2, 3]] * 4])
def test_points_at_one_place_are_shifted(points: list[list[float]]) -> None:
    turn, shift = rigid_motion(points, np.add(points, [0.1, 0, 100]))
    assert turn.tolist() == [0, 0, 0, 1]
    np.testing.assert_allclose(shift, [0.1, 0, 100], atol=1e-10)


def test_no_motion_is_a_reflection() -> None:
    points = np.eye(3)
    turn, _ = rigid_motion(points, points * [1, 1, -1])
    assert np.linalg.det(so3.to_matrix(turn)) == pytest.approx(1)
