"""Names that two markers swapped are put right, gaps at the ends or not."""

from __future__ import annotations

import numpy as np
import pytest
from capture.markers.test_fill import FRAMES, made, paths

from animtool.capture.markers.swaps import repair_swaps


def swapped(first: int, end: int, pair: tuple[int, int], gaps: list[tuple[int, slice]]):  # type: ignore[no-untyped-def]
    """Return a take with gaps in which two markers are swapped, and what is right."""
    right = paths()
    for marker, frames in gaps:
        right[frames, marker] = np.nan
    wrong = right.copy()
    wrong[first:end, list(pair)] = right[first:end, list(pair)[::-1]]
    return wrong, right


@pytest.mark.parametrize("pair", [(1, 2), (0, 7), (5, 9)])
@pytest.mark.parametrize(
    "gaps",
    [
        [],
        [(0, slice(90, 130))],
        [(1, slice(110, 112))],
        [(0, slice(140, 200)), (1, slice(60, 80))],
    ],
)
def test_a_swap_next_to_gaps(
    pair: tuple[int, int], gaps: list[tuple[int, slice]]
) -> None:
    gone = [(pair[which], frames) for which, frames in gaps]
    wrong, right = swapped(115, 160, pair, gone)
    whole, swaps = repair_swaps(made(wrong))
    np.testing.assert_array_equal(whole.positions, right)
    assert [swap.markers for swap in swaps] == [(f"M{pair[0]}", f"M{pair[1]}")]


@pytest.mark.parametrize(("first", "end"), [(0, 40), (250, FRAMES)])
def test_the_shorter_part_is_swapped(first: int, end: int) -> None:
    wrong, right = swapped(first, end, (2, 6), [])
    whole, swaps = repair_swaps(made(wrong))
    np.testing.assert_array_equal(whole.positions, right)
    assert [(s.first, s.last) for s in swaps] == [(first, end - 1)]


def test_one_marker_in_two_swaps() -> None:
    wrong, right = swapped(60, 100, (2, 6), [])
    wrong[150:190, [6, 8]] = wrong[150:190, [8, 6]]
    whole, swaps = repair_swaps(made(wrong))
    np.testing.assert_array_equal(whole.positions, right)
    assert len(swaps) == 2


def test_an_end_that_nobody_saw_is_in_the_middle_of_what_was_not_seen() -> None:
    unseen = [(2, slice(90, 131)), (6, slice(90, 131))]
    wrong, right = swapped(100, 180, (2, 6), unseen)
    whole, swaps = repair_swaps(made(wrong))
    np.testing.assert_array_equal(whole.positions, right)
    assert [(s.first, s.last) for s in swaps] == [(111, 179)]


def test_a_spike_is_no_swap() -> None:
    positions = paths()
    positions[100:103, 1] += 0.05
    positions[100:101, 4] -= 0.04
    assert repair_swaps(made(positions))[1] == []
