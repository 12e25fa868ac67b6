"""Dataclasses of arrays with a row for each of what they describe."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from animtool.core.array_types import FloatArray, IntArray
from animtool.maths.rows import Rows


@dataclass(frozen=True, slots=True)
class Stones(Rows):
    ids: IntArray
    points: FloatArray


def test_rows_are_selected_and_joined_in_order() -> None:
    stones = Stones(np.arange(3), np.arange(9.0).reshape(3, 3))
    last, first = stones.select(np.array([2])), stones.select(stones.ids < 1)
    both = Stones.concatenate([last, first, stones])
    assert both.ids.tolist() == [2, 0, 0, 1, 2]
    assert both.points[:, 0].tolist() == [6, 0, 0, 3, 6]
    assert both.ids.dtype == np.int64
