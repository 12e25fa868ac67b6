"""Laws of the slopes at keys."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal
from support.curves import hermite_curve

from animtool.core.array_types import FloatArray
from animtool.maths import tangents
from animtool.maths.curves import evaluate

SEEDS = st.integers(0, 10_000)


def random_keys(seed: int, flat: float = 0.2) -> tuple[FloatArray, FloatArray]:
    """Return keys ``(K,)`` and ``(K, 1)``, some of them level with the one before."""
    rng = np.random.default_rng(seed)
    count = rng.integers(2, 9)
    steps = rng.normal(size=count) * 10.0 ** rng.integers(-3, 3, count)
    steps[rng.random(count) < flat] = 0.0
    times = np.cumsum(rng.uniform(0.01, 5, count))
    return times, np.cumsum(steps)[:, None]


@given(SEEDS)
def test_auto_clamped_never_overshoots(seed: int) -> None:
    times, values = random_keys(seed)
    slopes = tangents.auto_clamped(times, values)[:, 0]
    curve = hermite_curve(times, values[:, 0], slopes, slopes)
    slack = 1e-14 * np.abs(values).max()
    for k in range(len(times) - 1):
        found = evaluate(curve, np.linspace(times[k], times[k + 1], 60))[0]
        low, high = sorted(values[k : k + 2, 0])
        assert low - slack <= found.min()
        assert found.max() <= high + slack
        rising = np.diff(found) * np.sign(values[k + 1, 0] - values[k, 0])
        assert (rising >= -slack).all()


@given(SEEDS)
def test_auto_clamped_is_flat_at_extremes(seed: int) -> None:
    times, values = random_keys(seed)
    steps = np.diff(values[:, 0])
    turns = np.flatnonzero(steps[:-1] * steps[1:] <= 0) + 1
    assert not tangents.auto_clamped(times, values)[turns].any()


@given(SEEDS)
def test_nonuniform_is_exact_for_parabolas(seed: int) -> None:
    times, _ = random_keys(seed)
    found = tangents.parabola_slopes(times, (times**2 - 3 * times)[:, None])[1:-1, 0]
    assert_allclose(found, (2 * times - 3)[1:-1], rtol=1e-9, atol=1e-9)


@given(SEEDS)
def test_tcb_of_zeros(seed: int) -> None:
    times, values = random_keys(seed)
    ins, outs = tangents.tcb(times, values, np.zeros((len(times), 3)))
    assert_array_equal(ins, outs)
    plain = tangents.parabola_slopes(times, values)
    assert_allclose(ins, plain, rtol=1e-12, atol=1e-12)


def test_full_tension_is_flat() -> None:
    times, values = np.arange(4.0), np.arange(4.0)[:, None] ** 3
    for side in tangents.tcb(times, values, [[1, 0, 0]] * 4):
        assert side[1:3].ravel().tolist() == [0.0, 0.0]


def test_a_single_key_is_flat() -> None:
    for rule in (
        tangents.secant_slopes,
        tangents.parabola_slopes,
        tangents.auto_clamped,
    ):
        assert rule([1.0], [[2.0, 3.0]]).tolist() == [[0.0, 0.0]]


@pytest.mark.parametrize("alpha", [0.0, 0.5, 1.0])
def test_coincident_points_are_finite(alpha: float) -> None:
    points = np.array([[0, 0], [1, 1], [1, 1], [1, 1], [2, 0], [2, 0]], float)
    ins, outs = tangents.catmull_rom_controls(points, alpha)
    assert np.isfinite([ins, outs]).all()
    if alpha:
        assert_array_equal(outs[1:3], np.zeros((2, 2)))
        assert_array_equal(ins[2:4], np.zeros((2, 2)))


@given(SEEDS, st.sampled_from([0.0, 0.5, 1.0]))
def test_the_path_is_smooth_in_its_knots(seed: int, alpha: float) -> None:
    points = np.random.default_rng(seed).normal(size=(5, 3))
    ins, outs = tangents.catmull_rom_controls(points, alpha)
    knots = np.linalg.norm(np.diff(points, axis=0), axis=1)[:, None] ** alpha
    before, behind = -ins[1:-1] / knots[:-1], outs[1:-1] / knots[1:]
    assert_allclose(before, behind, rtol=1e-10, atol=1e-12)


def test_faults() -> None:
    with pytest.raises(ValueError, match="ascend"):
        tangents.secant_slopes([0.0, 0.0], [[1.0], [2.0]])
    with pytest.raises(ValueError, match="values"):
        tangents.secant_slopes([0.0, 1.0], [[1.0]])
