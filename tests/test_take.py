from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_array_equal

from animtool.take import Channel, Clock, time_codes


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


def test_compact_keeps_the_values() -> None:
    rng = np.random.default_rng(0)
    values = rng.normal(size=(5, 4, 3))
    values[:, [1, 3]] = values[:1, [1, 3]]
    channel = Channel.from_dense(values)
    assert channel.animated.tolist() == [0, 2]
    assert channel.values.shape == (5, 2, 3)
    assert_array_equal(channel.dense(), values)
    assert_array_equal(channel.select(slice(1, 3)).dense(), values[1:3])


@pytest.mark.parametrize("frames", [1, 3])
def test_what_never_moves_has_no_values(frames: int) -> None:
    channel = Channel.from_dense(np.ones((frames, 2, 3)))
    assert channel.values.shape == (frames, 0, 3)
    assert_array_equal(channel.dense(), np.ones((frames, 2, 3)))


def test_concatenate_undoes_select() -> None:
    values = np.random.default_rng(0).normal(size=(6, 2, 4))
    channel = Channel.from_dense(values)
    parts = [channel.select(slice(0, 2)), channel.select(slice(2, 6))]
    assert_array_equal(Channel.concatenate(parts).dense(), values)
