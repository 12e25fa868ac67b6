"""Laws of fitted cubics: units, and what is a cubic already."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from animtool import _kernels

NONE = np.zeros(0, np.int64)


def fit(
    values: np.ndarray,
    bounds: np.ndarray,
    anchors: np.ndarray,
    low: float = -np.inf,
    high: float = np.inf,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return frames and handles of keys, the same limits for all components."""
    width = values.shape[1]
    return _kernels.fit_cubics(
        values, bounds, anchors, np.full(width, low), np.full(width, high), NONE
    )


def motion(frames: int = 60) -> np.ndarray:
    t = np.linspace(0, 1, frames)
    return np.stack([np.sin(9 * t), np.cos(4 * t) * t, 2 * t], axis=1)


def slopes(values: np.ndarray, bounds: np.ndarray, anchors: list[int]) -> np.ndarray:
    """Return the slopes before and after each anchor ``(2, A, W)``, a frame."""
    at, ins, outs = fit(values, bounds, np.array(anchors))
    assert_array_equal(at[1:-1], anchors)
    lengths = np.diff(at)[:, None] / 3
    return np.stack([-ins[1:-1] / lengths[:-1], outs[1:-1] / lengths[1:]])


def test_keys_are_smooth_where_their_bounds_leave_room() -> None:
    before, after = slopes(motion(), np.full(60, 0.05), [13, 22, 40])
    assert_allclose(before, after, rtol=1e-9)


def test_the_side_with_tighter_bounds_keeps_its_slope() -> None:
    """A corner between lines of slopes 1 and 2: either side gives way to the other."""
    values = np.concatenate([np.arange(10.0), 9 + 2 * np.arange(11.0)])[:, None]
    values = np.delete(values, 10, axis=0).copy()
    tight, loose = np.full(10, 1e-3), np.full(10, 100.0)
    left, _ = slopes(values, np.concatenate([tight, loose]), [9])
    right, _ = slopes(values, np.concatenate([loose, tight]), [9])
    assert_allclose([left.item(), right.item()], [1, 2], atol=1e-3)


# From values of 1e-9 to 1e9, by powers of two: nothing is rounded.
@pytest.mark.parametrize("power", [-30, 30])
@pytest.mark.parametrize(("bound", "anchors"), [(1e-3, []), (0.05, [13, 22, 40])])
def test_units_make_no_difference(power: int, bound: float, anchors: list[int]) -> None:
    unit, own = 2.0**power, np.array(anchors, np.int64)
    bounds = np.full(60, bound)
    bounds[15:30] *= 0.3
    at, ins, outs = fit(motion(), bounds, own)
    assert len(at) > 3
    scaled = fit(unit * motion(), unit * bounds, own)
    assert_array_equal(scaled[0], at)
    assert_array_equal(scaled[1], unit * ins)
    assert_array_equal(scaled[2], unit * outs)


def test_a_cubic_is_one_segment_and_gives_its_handles_back() -> None:
    """Handles are a third of the slopes at the ends."""
    frames = 31
    u = np.linspace(0, 1, frames)
    values = np.stack([u**3 - u, 3 * u * u], axis=1)
    at, ins, outs = fit(values, np.full(frames, 1e-9), NONE)
    assert_array_equal(at, [0, frames - 1])
    assert_allclose(outs, [[-1 / 3, 0], [0, 0]], atol=1e-8)
    assert_allclose(ins, [[0, 0], [-2 / 3, -2]], atol=1e-8)


def test_what_stays_within_its_bounds_is_one_key() -> None:
    rests = np.full((9, 2), 5.0)
    rests[4, 1] += 0.9e-3
    at, ins, outs = fit(rests, np.full(9, 1e-3), NONE)
    assert_array_equal(at, [0])
    assert not ins.any()
    assert not outs.any()
    rests[4, 1] += 0.2e-3
    assert len(fit(rests, np.full(9, 1e-3), NONE)[0]) > 1


def test_anchors_are_keys() -> None:
    straight = np.linspace(0, 1, 12)[:, None].copy()
    anchors = np.array([4, 5])
    at, ins, outs = fit(straight, np.full(12, 1e-3), anchors)
    assert_array_equal(at, [0, 4, 5, 11])
    steps = np.diff(straight[at, 0]) / 3
    assert_allclose(outs[:-1, 0], steps, atol=1e-3)
    assert_allclose(ins[1:, 0], -steps, atol=1e-3)


def test_every_frame_is_within_its_bound() -> None:
    values, bounds = motion(), np.geomspace(1e-4, 1e-2, 60)
    at, ins, outs = fit(values, bounds, NONE)
    for k, (a, b) in enumerate(pairwise(at)):
        u = np.linspace(0, 1, b - a + 1)[:, None]
        v = 1 - u
        from_, to = values[a], values[b]
        curve = (
            v**3 * from_
            + 3 * u * v * v * (from_ + outs[k])
            + 3 * u * u * v * (to + ins[k + 1])
            + u**3 * to
        )
        off = np.linalg.norm(curve - values[a : b + 1], axis=1)
        assert (off <= bounds[a : b + 1] * (1 + 1e-9)).all()


@pytest.mark.parametrize("tolerance", [1e-6, 1e-2, 0.5])
def test_curves_stay_within_limits_between_samples(tolerance: float) -> None:
    """Samples that stop dead at a limit, where a free fit swings out."""
    t = np.linspace(0, 40, 200)
    values = np.clip(np.stack([np.sin(t), np.cos(1.7 * t)], axis=1), -0.6, 0.6)
    reached = []
    for limit in (np.inf, 0.6):
        at, ins, outs = fit(values, np.full(200, tolerance), NONE, -limit, limit)
        u = np.linspace(0, 1, 33)[:, None, None]
        start, end = values[at[:-1]], values[at[1:]]
        first, second = start + outs[:-1], end + ins[1:]
        curve = (1 - u) ** 3 * start + 3 * u * (1 - u) ** 2 * first
        curve = curve + 3 * u**2 * (1 - u) * second + u**3 * end
        reached.append(float(np.abs(curve).max()))
    assert reached[0] > 0.6 + 1e-3
    assert reached[1] <= 0.6 + 1e-12


def test_samples_beyond_limits_are_kept() -> None:
    values = np.sin(np.linspace(0, 6, 50))[:, None]
    at, ins, outs = fit(values, np.full(50, 1e-6), NONE, -0.5, 0.5)
    free = fit(values, np.full(50, 1e-6), NONE)
    assert len(at) >= len(free[0])
    assert np.isfinite(ins).all()
    assert np.isfinite(outs).all()


def test_reversed_limits_are_refused() -> None:
    with pytest.raises(ValueError, match=r"^low: "):
        fit(motion(), np.ones(60), NONE, 1.0, -1.0)
