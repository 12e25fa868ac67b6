from __future__ import annotations

import math
from fractions import Fraction

import pytest
from hypothesis import given
from hypothesis import strategies as st

from animtool.sim.run import step_grid


@given(st.integers(1, 10**7), st.integers(1, 500), st.sampled_from([24, 25, 30, 60]))
def test_multiples_of_a_step_are_met_from_wherever(
    first: int, count: int, rate: int
) -> None:
    # As times of frames come: divided by the rate, each rounded by itself.
    step = 1 / (rate * 10)
    whole = step_grid(0.0, (first + count) / rate, step)
    part = step_grid(first / rate, (first + count) / rate, step)
    assert part.h == whole.h == step
    assert part.count == 10 * count
    assert [part.time(i) for i in range(5)] == [
        whole.time(10 * first + i) for i in range(5)
    ]


@given(st.floats(-1e3, 1e3), st.floats(1e-6, 10.0), st.floats(1e-3, 1.0))
def test_steps_are_even_and_none_is_too_long(
    start: float, gap: float, step: float
) -> None:
    end = start + gap
    if end == start:
        return
    found = step_grid(start, end, step)
    assert found.h <= step * (1 + 1e-9)
    assert found.time(0) == pytest.approx(start, abs=1e-9 * step + math.ulp(start) * 4)
    assert found.time(found.count) == pytest.approx(end, abs=1e-8 * step + 1e-12)
    assert found.count * found.h == pytest.approx(gap, rel=1e-6, abs=1e-9)


def test_rates_of_video_are_met() -> None:
    rate = Fraction(30000, 1001)
    found = step_grid(float(7 / rate), float(8 / rate), float(1 / (rate * 4)))
    assert (found.count, found.first_index) == (4, 28)
