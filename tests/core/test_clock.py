"""Clocks."""

from __future__ import annotations

from fractions import Fraction
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from animtool.core.clock import Clock, time_codes
from animtool.core.errors import AnimtoolError, OptionError


@given(
    st.fractions(-(10**6), 10**6, max_denominator=1001),
    st.fractions(Fraction(1, 1001), 100, max_denominator=1001),
    st.integers(0, 50),
)
def test_time_codes_are_rounded_once(
    start: Fraction, step: Fraction, count: int
) -> None:
    found = time_codes(start, step, count).tolist()
    assert found == [float(start + i * step) for i in range(count)]


def test_time_codes_beyond_exact_integers() -> None:
    start = Fraction(2**60 + 1, 3)
    assert time_codes(start, Fraction(1, 7), 2).tolist() == [
        float(start),
        float(start + Fraction(1, 7)),
    ]


def test_clock() -> None:
    clock = Clock(Fraction(24), Fraction(1001), Fraction(1, 5), 11)
    assert clock.rate == 120
    assert clock.duration == Fraction(1, 12)
    assert clock.times[-1] == 1003.0


@pytest.mark.parametrize(
    ("fps", "step", "faults"),
    [(29.97, 1, 1), (0, 1, 1), (24, -1, 1), (24.0, 0, 2)],
)
def test_a_clock_that_is_none(fps: Any, step: Any, faults: int) -> None:
    with pytest.raises(AnimtoolError) as caught:
        Clock(fps, Fraction(1), step, 5)
    assert [fault.code for fault in caught.value.faults] == ["TAKE003"] * faults


def test_whole_numbers_are_exact() -> None:
    clock = Clock(30000, 1, 1001, 5)  # type: ignore[arg-type]
    assert clock.rate == Fraction(30000, 1001)


def test_a_rate_that_is_a_float_names_the_fraction() -> None:
    for fps in (23.976, Fraction(23.976)):
        with pytest.raises(AnimtoolError) as caught:
            Clock(fps, Fraction(1), Fraction(1), 5)  # type: ignore[arg-type]
        (fault,) = caught.value.faults
        assert (fault.code, fault.hint) == ("TAKE003", "write Fraction(24000, 1001)")


def test_starts_and_steps_may_be_those_of_floats() -> None:
    clock = Clock(Fraction(24), Fraction(0.1), Fraction(0.4), 2)
    assert [clock.start, clock.step] == [Fraction(0.1), Fraction(0.4)]


def test_a_rate_that_is_text_is_no_number() -> None:
    text: Any = "24fps"
    with pytest.raises(OptionError) as caught:
        Clock(text, 1, 1, 2)
    (fault,) = caught.value.faults
    assert fault.code == "TAKE003"
    assert "not a number" in fault.message
