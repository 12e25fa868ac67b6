"""Filters against what theory says of them."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.testing import assert_allclose

from animtool.maths import so3
from animtool.maths.filters import (
    fill_gaps,
    find_best_cutoff,
    lowpass,
    lowpass_rotations,
    noise_level,
    rotation_noise,
)

RATE = 120.0
TIMES = np.arange(1200) / RATE


@pytest.mark.parametrize("order", [2, 4])
@pytest.mark.parametrize("frequency", [1.0, 4.0, 6.0, 12.0])
def test_gain_and_lag_are_those_of_the_closed_form(
    frequency: float, order: int
) -> None:
    wave = np.exp(2j * np.pi * frequency * TIMES)
    parts = lowpass(np.stack([wave.real, wave.imag], axis=1), 6.0, RATE, order=order)
    middle = slice(300, 900)
    gain = (parts[:, 0] + 1j * parts[:, 1])[middle] / wave[middle]
    ratio = math.sin(math.pi * frequency / RATE) / math.sin(math.pi * 6 / RATE)
    np.testing.assert_allclose(gain, 1 / (1 + ratio ** (2 * order)), atol=1e-9)


def test_lines_stay_to_their_ends_and_gaps_are_crossed() -> None:
    line = np.outer(TIMES, [3.0, -1.0]) + np.array([1e3, 0.0])
    known = np.ones(len(TIMES), np.bool_)
    known[[0, 5, 6, 7, 900]] = False
    holed = np.where(known[:, None], line, 77.0)
    np.testing.assert_allclose(lowpass(holed, 5, RATE, is_valid=known), line, atol=1e-8)


def test_turns_turn_with_the_frame_that_they_are_seen_from() -> None:
    rng = np.random.default_rng(2)
    turns = so3.exp(0.1 * rng.standard_normal((80, 2, 3)))
    seen = so3.exp(np.array([0.3, 2.0, -1.0]))
    np.testing.assert_allclose(
        lowpass_rotations(so3.multiply(seen, turns), 5, 60),
        so3.multiply(seen, lowpass_rotations(turns, 5, 60)),
        atol=1e-12,
    )


@pytest.mark.parametrize("frequency", [0.7, 2.0, 5.0])
@pytest.mark.parametrize("noise", [0.003, 0.03])
def test_cutoff_of_a_sine_in_noise(frequency: float, noise: float) -> None:
    """The error is near the least that any cut-off of the filter has in theory."""
    rng = np.random.default_rng(5)
    clean = np.sin(2 * np.pi * frequency * TIMES[:, None] + [0.0, 1.0, 2.0])
    noisy = clean + noise * rng.standard_normal(clean.shape)
    assert noise_level(noisy) == pytest.approx(noise, rel=0.06)
    cutoff = find_best_cutoff(noisy, RATE)
    assert cutoff is not None
    shares = np.geomspace(0.002, 0.45, 400)
    waves = np.sin(np.pi * np.arange(1200) / 2400)
    gains = 1 / (1 + (waves / np.sin(np.pi * shares[:, None])) ** 4)
    ratio = np.sin(np.pi * frequency / RATE) / np.sin(np.pi * shares)
    lost = (1 - 1 / (1 + ratio**4)) ** 2 / 2
    expected = np.sqrt(lost + noise**2 * (gains**2).mean(axis=1))
    assert cutoff == pytest.approx(shares[expected.argmin()] * RATE, rel=0.35)
    # At the ends, where there are frames on one side only, theory says nothing.
    away = (lowpass(noisy, cutoff, RATE) - clean)[120:-120]
    error = math.sqrt(np.mean(away**2))
    assert error < 1.2 * expected.min()


@pytest.mark.parametrize("axes", [1, 2, 3])
@pytest.mark.parametrize("frame", [[0.0, 0.0, 0.0], [0.3, 2.0, -1.0]])
def test_noise_of_rotations_is_that_about_each_axis(
    axes: int, frame: list[float]
) -> None:
    """As of a hinge, in whichever frame; the four numbers shake together."""
    rng = np.random.default_rng(4)
    swing = so3.exp(np.sin(0.02 * np.arange(4000))[:, None] * [1.0, 0.0, 0.0])
    shake = np.zeros((4000, 3))
    shake[:, :axes] = 0.02 * rng.standard_normal((4000, axes))
    turns = so3.multiply(so3.exp(np.array(frame)), so3.multiply(swing, so3.exp(shake)))
    turns = so3.align_signs(turns)
    assert rotation_noise(turns) == pytest.approx(0.02, rel=0.05)
    # What is left of the noise at the best cut-off is that of so many axes.
    assert find_best_cutoff(turns, RATE, is_rotation=True) is not None
    assert rotation_noise(turns[:1]) == 0.0


def test_what_has_no_noise_is_left_alone() -> None:
    assert find_best_cutoff(np.sin(9 * TIMES)[:, None], RATE) is None
    assert find_best_cutoff(np.ones((50, 3)), RATE) is None


def test_missing_values_are_put_between_their_neighbours() -> None:
    nan = np.nan
    values = np.array([[nan, 1, nan], [2, nan, nan], [nan, nan, nan], [5, 4, nan]])
    found = fill_gaps(values, np.array([0.0, 1.0, 3.0, 4.0]))
    expected = [[2, 1, 0], [2, 1.75, 0], [4, 3.25, 0], [5, 4, 0]]
    assert_allclose(found, expected, rtol=1e-15)
    assert np.isnan(values).sum() == 8
