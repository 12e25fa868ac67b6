"""Times outside a range, brought into it."""

from __future__ import annotations

import numpy as np
import pytest

from animtool.maths.curves import Extrapolation, fold_times

TIMES = np.array([-9.0, -8, -5, -4, -1, 0, 3, 4, 5, 8, 9, 12, 13])
INSIDE = {
    Extrapolation.HOLD: [0, 0, 0, 0, 0, 0, 3, 4, 4, 4, 4, 4, 4],
    Extrapolation.LINEAR: [0, 0, 0, 0, 0, 0, 3, 4, 4, 4, 4, 4, 4],
    Extrapolation.CYCLE: [3, 0, 3, 0, 3, 0, 3, 4, 1, 4, 1, 4, 1],
    Extrapolation.CYCLE_OFFSET: [3, 0, 3, 0, 3, 0, 3, 4, 1, 4, 1, 4, 1],
    Extrapolation.OSCILLATE: [1, 0, 3, 4, 1, 0, 3, 4, 3, 0, 1, 4, 3],
}


@pytest.mark.parametrize("mode", Extrapolation)
def test_times_within(mode: Extrapolation) -> None:
    assert fold_times(TIMES, 0.0, 4.0, mode, mode).times.tolist() == INSIDE[mode]


def test_linear_keeps_what_is_beyond() -> None:
    folded = fold_times(TIMES, 0.0, 4.0, Extrapolation.LINEAR, Extrapolation.LINEAR)
    assert (folded.times + folded.overshoot).tolist() == TIMES.tolist()
    assert not folded.cycles.any()


def test_offset_cycles_continue_a_line() -> None:
    mode = Extrapolation.CYCLE_OFFSET
    folded = fold_times(TIMES, 0.0, 4.0, mode, mode)
    assert (folded.times + 4.0 * folded.cycles).tolist() == TIMES.tolist()


@pytest.mark.parametrize("mode", Extrapolation)
def test_a_range_without_length_is_held(mode: Extrapolation) -> None:
    folded = fold_times(np.array([1.0, 2.0, 3.0]), 2.0, 2.0, mode, mode)
    assert folded.times.tolist() == [2.0, 2.0, 2.0]
