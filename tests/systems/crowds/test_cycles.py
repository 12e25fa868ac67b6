"""When feet stand in a cycle."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from animtool.systems.crowds import cycles

LENGTH = 10


@pytest.mark.parametrize(
    ("spans", "stance"),
    [
        ([(10, 16)], (10, 16)),  # begins with the second cycle
        ([(19, 24)], (19, 24)),  # with its last frame
        ([(9, 16)], None),  # in the first one
        ([(20, 26)], None),  # in the third
        ([(0, 6), (12, 17), (22, 27)], (12, 17)),
        ([(11, 13), (15, 18)], None),  # twice
        ([(11, 20)], (11, 20)),
        ([(11, 21)], None),  # for all of a cycle
    ],
)
def test_a_foot_stands_once_in_the_second_cycle(
    monkeypatch: pytest.MonkeyPatch,
    spans: list[tuple[int, int]],
    stance: tuple[int, int] | None,
) -> None:
    mask = np.zeros(3 * LENGTH, np.bool_)
    for first, end in spans:
        mask[first:end] = True
    found = SimpleNamespace(any=mask, ankle=mask, toe=np.ones_like(mask))
    monkeypatch.setattr(cycles, "find_contacts", lambda *_: found)
    walker: Any = SimpleNamespace(legs=((0, 1, 2, -1),), leg_length=1.0)
    world: Any = SimpleNamespace(positions=np.zeros((3 * LENGTH, 3, 3)))
    made = cycles._find_stance(walker, world, 0, LENGTH, 24.0)
    assert (None if made is None else (made.begin, made.end)) == stance
    if made is not None:
        assert (made.is_flat == mask).all()
