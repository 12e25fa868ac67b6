"""When feet stand: walks whose steps are known, with noise_speed, at several rates."""

from __future__ import annotations

import numpy as np
import pytest

from animtool.core.array_types import BoolArray, FloatArray
from animtool.maths.runs import runs
from animtool.motion.contacts import (
    find_contacts,
    gaussian_smooth,
    noise_speed,
    remove_short_runs,
)

LEG, STRIDE, PERIOD, STANCE = 0.85, 1.3, 1.1, 0.62


def steps(fps: float, seconds: float = 6.0) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Return ankle and toe of a foot that steps, and when it stands."""
    t = np.arange(round(seconds * fps)) / fps
    whole, share = np.divmod(t / PERIOD, 1.0)
    swing = np.clip((share - STANCE) / (1 - STANCE), 0.0, 1.0)
    ease = swing**3 * (10 - 15 * swing + 6 * swing**2)
    lift = 64 * (swing * (1 - swing)) ** 3
    ankle = np.stack([0 * t, 1.07 + 0.14 * lift, STRIDE * (whole + ease)], axis=1)
    toe = ankle + np.array([0.0, -0.06, 0.13])
    return ankle, toe, share < STANCE


def f1(found: BoolArray, true: BoolArray) -> float:
    both = (found & true).sum()
    return float(2 * both / (found.sum() + true.sum()))


@pytest.mark.parametrize("fps", [24.0, 30.0, 60.0, 120.0, 240.0])
@pytest.mark.parametrize("noise", [0.0, 0.002])
def test_steps_are_found_at_any_rate(fps: float, noise: float) -> None:
    ankle, toe, true = steps(fps)
    rng = np.random.default_rng(3)
    ankle, toe = (each + noise * rng.normal(size=each.shape) for each in (ankle, toe))
    found = find_contacts(ankle, toe, fps, LEG)
    assert f1(found.any, true) >= 0.97
    # The ground is where the foot stands, wherever that is.
    assert abs(found.ground - 1.07) < 0.004


def test_a_foot_that_is_still_in_the_air_does_not_stand() -> None:
    ankle, toe, true = steps(60.0)
    last = np.flatnonzero(true)[-1]
    ankle[last - 20 :, 1] += 0.4
    toe[last - 20 :, 1] += 0.4
    found = find_contacts(ankle, toe, 60.0, LEG)
    assert not found.any[last - 10 : last].any()


@pytest.mark.parametrize("frames", [0, 1, 2, 3, 7])
def test_short_takes_have_an_answer(frames: int) -> None:
    still = np.zeros((frames, 3))
    found = find_contacts(still, None, 30.0, LEG)
    assert found.any.tolist() == [frames > 2] * frames


def test_jitter_is_that_of_the_noise() -> None:
    rng = np.random.default_rng(1)
    ankle, _, _ = steps(60.0)
    noisy = ankle + 0.003 * rng.normal(size=ankle.shape)
    assert noise_speed([noisy], 60.0) == pytest.approx(0.003 * 60 * 3**0.5, rel=0.15)
    assert noise_speed([ankle], 60.0) < 0.02


def test_smoothing_keeps_straight_ways_and_its_ends() -> None:
    way = np.outer(np.arange(40.0), [1.0, -2.0, 0.5]) + 3.0
    assert np.abs(gaussian_smooth(way, 3.0) - way).max() < 1e-12
    assert gaussian_smooth(way[:1], 3.0).tolist() == way[:1].tolist()


def test_what_the_ends_of_a_take_cut_off_is_not_too_short() -> None:
    """At 100 frames a second a contact lasts 6 frames, and so does a gap in one."""
    mask = np.array([1] * 2 + [0] * 9 + [1] * 5 + [0] * 9 + [1] * 6 + [0] * 9 + [1] * 2)
    kept = remove_short_runs(mask.astype(np.bool_), 100.0)
    assert runs(kept) == [(0, 2), (25, 31), (40, 42)]
    kept = remove_short_runs(mask == 0, 100.0)
    assert runs(kept) == [(2, 25), (31, 40)]
    kept = remove_short_runs(
        np.array([0] * 2 + [1] * 8 + [0] * 5 + [1] * 8 + [0] * 2) > 0, 100.0
    )
    assert runs(kept) == [(2, 23)]
