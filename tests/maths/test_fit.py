from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from animtool.core.array_types import FloatArray
from animtool.maths.fit import FittedKeys, evaluate_keys, fit_keys

# A rounding of the values beside the tolerance.
ROOM = 1 + 1e-6


@st.composite
def samples(draw: st.DrawFn) -> FloatArray:
    """Samples of one to three components, smooth or rough."""
    shape = (draw(st.integers(1, 60)), draw(st.integers(1, 3)))
    rough = draw(hnp.arrays(np.float64, shape, elements=st.floats(-10, 10)))
    return np.cumsum(rough, axis=0) if draw(st.booleans()) else rough


def errors(keys: FittedKeys, values: FloatArray) -> FloatArray:
    """Return the error at every sample."""
    found = evaluate_keys(keys, np.arange(len(values)))
    return np.linalg.norm(found - values, axis=1)


def wave(frames: int = 400) -> FloatArray:
    """Three smooth components."""
    t = np.arange(frames)[:, None] / 30
    return np.sin(t * [1.0, 2.3, 3.1]) * [10.0, 3.0, 1.0]


@given(samples(), st.floats(1e-3, 10))
def test_every_sample_is_within_the_tolerance(values, tolerance) -> None:
    keys = fit_keys(values, tolerance)
    assert errors(keys, values).max() <= tolerance * ROOM


@given(samples(), st.floats(1e-3, 10))
def test_keys_lie_on_samples_in_order(values, tolerance) -> None:
    keys = fit_keys(values, tolerance)
    assert (np.diff(keys.frames) > 0).all()
    assert keys.frames[0] == 0
    assert len(keys.frames) == 1 or keys.frames[-1] == len(values) - 1
    np.testing.assert_array_equal(keys.values, values[keys.frames])
    np.testing.assert_array_equal(evaluate_keys(keys, keys.frames), keys.values)
    assert not keys.in_handles[0].any()
    assert not keys.out_handles[-1].any()


@given(samples(), st.sampled_from([2.0**-20, 0.5, 4.0, 2.0**30]))
def test_scaling_values_and_tolerance_changes_nothing(values, factor) -> None:
    # Above the subnormal numbers, where scaling by a power of two is exact.
    values = np.round(values, 6)
    one, other = fit_keys(values, 0.25), fit_keys(values * factor, 0.25 * factor)
    np.testing.assert_array_equal(one.frames, other.frames)
    np.testing.assert_allclose(one.out_handles * factor, other.out_handles, rtol=1e-12)


@given(samples())
def test_the_same_samples_give_the_same_bytes(values) -> None:
    one, other = fit_keys(values, 0.1), fit_keys(values.copy(), 0.1)
    for name in ("frames", "values", "in_handles", "out_handles"):
        assert getattr(one, name).tobytes() == getattr(other, name).tobytes()


@given(hnp.arrays(np.float64, (4, 2), elements=st.floats(-5, 5)), st.integers(2, 500))
def test_a_cubic_needs_two_keys(coefficients, frames) -> None:
    t = np.arange(frames)[:, None] / max(1, frames - 1)
    values = sum(c * t**power for power, c in enumerate(coefficients))
    assert len(fit_keys(values, 1e-8).frames) <= 2


@pytest.mark.parametrize("frames", [1, 2, 1000])
def test_a_constant_needs_one_key(frames: int) -> None:
    keys = fit_keys(np.full((frames, 3), 7.25), 1e-12)
    assert keys.frames.tolist() == [0]
    np.testing.assert_array_equal(evaluate_keys(keys, [-3.0, 0.5, 1e6]), 7.25)


def test_one_frame_and_two() -> None:
    assert fit_keys([[3.0]], 0.1).frames.tolist() == [0]
    two = fit_keys([[0.0], [3.0]], 0.1)
    assert two.frames.tolist() == [0, 1]
    np.testing.assert_allclose(evaluate_keys(two, [0.25, 0.5]), [[0.75], [1.5]])


def test_noise_keeps_a_third_of_its_samples() -> None:
    """Two control values pass through any two samples, and no cubic through more."""
    values = np.random.default_rng(1).normal(size=(3001, 1))
    keys = fit_keys(values, 1e-6)
    assert len(keys.frames) == 1001
    assert errors(keys, values).max() <= 1e-6


def test_a_smaller_tolerance_needs_more_keys() -> None:
    counts = [len(fit_keys(wave(), t).frames) for t in (1.0, 0.1, 0.01, 0.001)]
    assert counts == sorted(counts)
    assert len(set(counts)) == len(counts)


def test_smooth_motion_needs_few_keys() -> None:
    assert 400 / len(fit_keys(wave(), 0.05).frames) > 15


def test_components_have_tolerances_of_their_own() -> None:
    values = wave()
    limits = np.array([1.0, 0.1, 0.01])
    keys = fit_keys(values, limits)
    off = evaluate_keys(keys, np.arange(len(values))) - values
    assert np.linalg.norm(off / limits, axis=1).max() <= ROOM


def test_a_share_holds_at_its_frames() -> None:
    values, share = wave(), np.ones(400)
    share[100:120] = 0.01
    off = errors(fit_keys(values, 0.5, tolerance_scale=share), values)
    assert (off <= 0.5 * share * ROOM).all()


def test_anchors_are_keys_and_keep_what_is_between_them() -> None:
    values, share = wave(), np.ones(400)
    plain = fit_keys(values, 0.1, anchors=[150, 250])
    share[160:200] = 0.1
    tight = fit_keys(values, 0.1, tolerance_scale=share, anchors=[150, 250])
    for keys in (plain, tight):
        assert {150, 250} <= set(keys.frames.tolist())
    assert len(tight.frames) > len(plain.frames)
    for outside in (lambda f: f[f <= 150], lambda f: f[f >= 250]):
        np.testing.assert_array_equal(outside(plain.frames), outside(tight.frames))


def test_fitting_again_with_keys_as_anchors_gives_these_keys() -> None:
    keys = fit_keys(wave(), 0.1)
    again = fit_keys(wave(), 0.1, anchors=keys.frames[1:-1])
    np.testing.assert_array_equal(keys.frames, again.frames)


def test_a_key_is_smooth_where_both_slopes_are_one() -> None:
    t = np.arange(101.0)[:, None]
    keys = fit_keys((t / 50 - 1) ** 3, 1e-6, anchors=[30, 71])
    lengths = np.diff(keys.frames)[:, None]
    before, after = keys.in_handles[1:] / -lengths, keys.out_handles[:-1] / lengths
    np.testing.assert_allclose(before[:-1], after[1:], rtol=1e-9)
    corner = fit_keys(np.abs(t - 50), 1e-3)
    assert corner.frames.tolist() == [0, 50, 100]
    assert corner.out_handles[1] > 0 < corner.in_handles[1]


@pytest.mark.parametrize("offset", [0.0, 1e6])
def test_a_large_offset_costs_no_keys(offset: float) -> None:
    keys = fit_keys(wave() + offset, 0.01)
    assert abs(len(keys.frames) - len(fit_keys(wave(), 0.01).frames)) <= 1


@pytest.mark.parametrize(
    ("values", "tolerance", "options"),
    [
        ([[np.nan]], 1.0, {}),
        ([[0.0], [np.inf]], 1.0, {}),
        ([[0.0], [1.0]], 0.0, {}),
        ([[0.0], [1.0]], np.nan, {}),
        ([[0.0], [1.0]], [1.0, 1.0], {}),
        ([0.0, 1.0], 1.0, {}),
        (np.zeros((0, 1)), 1.0, {}),
        ([[0.0], [1.0]], 1.0, {"tolerance_scale": [1.0, 0.0]}),
        ([[0.0], [1.0]], 1.0, {"tolerance_scale": [1.0]}),
        ([[0.0], [1.0], [2.0]], 1.0, {"anchors": [2]}),
        ([[0.0], [1.0], [2.0]], 1.0, {"anchors": [0]}),
        ([[0.0]] * 5, 1.0, {"anchors": [2, 2]}),
    ],
)
def test_what_cannot_be_fitted_is_refused(values, tolerance, options) -> None:
    with pytest.raises(ValueError, match=r"finite|above 0|shape|hold|anchors"):
        fit_keys(values, tolerance, **options)
