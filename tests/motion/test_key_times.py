"""Weight curves whose times look like seconds, or are beside the take."""

from __future__ import annotations

from fractions import Fraction

import pytest

from animtool.core.clock import Clock
from animtool.motion.key_times import weight_warnings


@pytest.mark.parametrize(
    ("weight", "first", "count", "found"),
    [
        ([[0, 0], [0.5, 1], [2, 0]], 1, 96, True),
        ([[0, 0], [1, 1], [3, 1], [4, 0]], 1, 96, True),
        ([[0, 0], [4, 1]], 1001, 120, True),  # frames from 0 in a take from 1001
        ([[300, 0], [310, 1]], 1, 96, True),  # never reached
        ([[1, 0], [5, 1], [9, 0]], 1, 96, False),  # a blink
        ([[0, 0], [8, 1]], 1, 96, False),
        ([[0, 0], [1, 1]], 1, 96, False),  # a switch
        ([[1, 0], [3, 1], [5, 0]], 1, 200, False),
        ([[0, 0], [12, 1], [84, 1], [96, 0]], 1, 96, False),
        ([[0, 1], [0.5, 1], [2, 1]], 1, 96, False),  # constant
        ([[-24, 0], [24, 1]], 1, 96, False),
        (0.5, 1, 96, False),
    ],
)
def test_weights(
    weight: float | list[list[float]], first: int, count: int, found: bool
) -> None:
    clock = Clock(Fraction(24), Fraction(first), Fraction(1), count)
    codes = [one.code for one in weight_warnings(weight, clock, in_shot=False)]
    assert codes == ["SCN116"] * found


def test_keys_beside_a_shot() -> None:
    clock = Clock(Fraction(24), Fraction(1), Fraction(1), 96)
    assert weight_warnings([[300, 0], [310, 1]], clock, in_shot=True) == []
