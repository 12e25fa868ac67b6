"""Markers that distances hardly tell apart: how their neighbours lie."""

from __future__ import annotations

from itertools import combinations
from typing import Any

import numpy as np
import pytest

from animtool.capture.markers import twins
from animtool.capture.markers.twins import _shape_error, _shape_evidence


def test_shapes_are_told_by_any_two_of_the_five_nearest(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Each by how much farther off it is by these names than by the others."""
    shape = np.stack([np.arange(9.0), np.zeros(9), np.zeros(9)], axis=1) / 10
    rest = np.linalg.norm(shape[:, None] - shape, axis=-1)
    now, then = np.arange(9), np.array([1, 0, *range(2, 9)])
    groups: list[tuple[int, ...]] = []

    def off(_: Any, group: list[int], own: Any) -> float:
        groups.append(tuple(group))
        return 0.004 if own[0, 0] == 0 else 0.001

    monkeypatch.setattr(twins, "_shape_error", off)
    known: dict[tuple[int, ...], float] = {}
    found = _shape_evidence(np.zeros((1, 9, 3)), shape, rest, [0, 1], now, then, known)
    assert found == pytest.approx(np.log(5 / 2))
    wanted = {(0, 1, *pair) for pair in combinations([2, 3, 4, 5, 6], 2)}
    assert set(groups) == wanted
    assert len(groups) == 20
    again = _shape_evidence(np.zeros((1, 9, 3)), shape, rest, [0, 1], now, then, known)
    assert (again, len(groups)) == (found, 20)


def test_a_shape_is_off_points_in_the_frames_that_fit_it_best() -> None:
    """A tenth of twenty frames are two; of seven nobody says anything."""
    shape = np.random.default_rng(3).uniform(-0.1, 0.1, (4, 3))
    points = np.stack([shape * (1 + 0.01 * k) for k in range(20)])
    alone = [_shape_error(points[[k] * 8], [0, 1, 2, 3], shape) for k in (0, 1)]
    assert _shape_error(points, [0, 1, 2, 3], shape) == pytest.approx(np.mean(alone))
    assert alone[0] == pytest.approx(0, abs=1e-9)
    assert _shape_error(points[:7], [0, 1, 2, 3], shape) == np.inf
    points[:13, 2] = np.nan
    assert _shape_error(points, [0, 1, 2, 3], shape) == np.inf
    assert np.isfinite(_shape_error(points, [0, 1, 3], shape[[0, 1, 3]]))
