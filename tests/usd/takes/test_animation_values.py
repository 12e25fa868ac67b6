"""Which frames the sample times of an animation stand for."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pxr import Sdf, Vt
from support.drifting import author_samples
from support.suite import examples

from animtool.core.clock import time_codes
from animtool.core.rates import rate_from_float
from animtool.usd.takes.animation_values import SampleGrid, _find_grid, _TakeSpan
from animtool.usd.takes.read import read_usd

STATED = _TakeSpan(Fraction(1), None)


def grid(times: list[float]) -> SampleGrid:
    return _find_grid(times, STATED, "a.usda")


def test_a_long_take_of_drifting_samples_has_as_many_frames(tmp_path: Path) -> None:
    times = (1 + 1.0000000521 * np.arange(3000)).tolist()
    stream = read_usd(author_samples(tmp_path / "drift.usda", times))
    clock = stream.collect().clock
    assert (clock.start, clock.step, clock.count) == (1, 1, 3000)
    (notice,) = stream.notices
    assert notice.code == "USD121"
    assert "0.00016" in notice.message
    assert "3000 frames" in notice.message


@given(
    st.sampled_from([Fraction(1), Fraction(5, 4), Fraction(1, 5), Fraction(4, 5)]),
    st.integers(-20, 1001),
    st.integers(4, 400),
    st.floats(-1e-6, 1e-6),
    st.integers(0, 2**31),
)
@settings(max_examples=examples(40), deadline=None)
def test_drift_and_jitter_far_below_a_frame_keep_the_count(
    step: Fraction, start: int, count: int, drift: float, seed: int
) -> None:
    jitter = np.random.default_rng(seed).uniform(-1e-3, 1e-3, count) * float(step)
    times = start + np.arange(count) * float(step) * (1 + drift) + jitter
    found = grid(times.tolist())
    assert (found.start, found.step, found.count) == (start, step, count)
    assert found.max_time_offset < 0.02 * float(step)


def test_a_step_of_a_slightly_other_rate_is_kept() -> None:
    found = grid((1 + 1.00003 * np.arange(3000)).tolist())
    assert (found.start, found.count, found.is_regular) == (1, 3000, True)
    assert float(found.step) == pytest.approx(1.00003, abs=1e-9)


def test_a_missing_sample_of_a_drifting_take_leaves_its_frame() -> None:
    times = (1 + 1.0000002 * np.arange(900)).tolist()
    del times[450]
    found = grid(times)
    assert (found.count, found.step, found.is_regular) == (900, 1, False)


def test_attributes_that_drift_apart_share_frames() -> None:
    whole = np.arange(1.0, 301.0)
    found = grid(sorted({*whole, *(1 + 1.0000031 * np.arange(300))}))
    assert (found.count, found.step, found.is_regular) == (300, 1, True)


def test_samples_between_frames_are_counted(tmp_path: Path) -> None:
    times = [1.0, 2.137, 3.6123, 7.0]
    stream = read_usd(author_samples(tmp_path / "keys.usda", times))
    assert stream.collect().clock.count == 7
    assert [notice.code for notice in stream.notices] == ["USD105", "USD122"]
    assert "2 of 4 samples" in stream.notices[1].message


@pytest.mark.parametrize("step", ["200/1001", "1001/5000", "24/1001", "1001/1200"])
@pytest.mark.parametrize("start", [1, 1001, -7])
def test_sub_frame_steps_of_broadcast_rates_are_exact(step: str, start: int) -> None:
    """Such as 120 samples a second on the time codes of 23.976 frames."""
    codes = time_codes(Fraction(start), Fraction(step), 60).tolist()
    found = grid(codes)
    assert (found.start, found.step, found.count) == (start, Fraction(step), 60)
    assert (found.is_regular, found.max_time_offset) == (True, 0.0)
    # One is missing, and samples are where they were.
    assert grid(codes[:7] + codes[8:]).step == Fraction(step)


def test_samples_on_even_parts_of_frames_are_no_drift() -> None:
    found = grid([1 + i / 5 for i in range(41)])
    assert (found.step, found.count, found.max_time_offset) == (Fraction(1, 5), 41, 0.0)


def test_a_few_samples_astray_are_those_of_their_frames() -> None:
    found = grid([1.0, 2.04, 3.0, 3.96, 5.0, 6.0])
    assert (found.start, found.step, found.count) == (1, 1, 6)
    assert found.max_time_offset == pytest.approx(0.04)
    # Two of one frame, and one that is meant where it is.
    assert grid([1.0, 1.97, 2.04, 3.0, 4.0]).between_count == 2
    assert grid([1.0, 2.06, 3.0, 4.0, 5.0]).between_count == 1


@pytest.mark.parametrize("times", [[1.01, 2.0, 3.02, 4.0], [1.0, 2.04, 3.0, 4.0]])
def test_the_samples_themselves_are_read(times: list[float], tmp_path: Path) -> None:
    path = author_samples(tmp_path / "off.usda", times)
    stream = read_usd(path)
    assert [notice.code for notice in stream.notices] == ["USD121"]
    translations, _, _ = stream.collect().motion.dense()
    # Not what USD interpolates on the frames.
    exact = np.float32(np.sin(np.array(times) / 10))
    np.testing.assert_array_equal(translations[:, 0, 0], exact)


def lengthened(path: Path, factors: dict[float, float]) -> Path:
    """Multiply the first joint's quaternions at some time codes."""
    layer = Sdf.Layer.FindOrOpen(str(path))
    for time, factor in factors.items():
        rows = np.array(layer.QueryTimeSample("/hero/Rig/Anim.rotations", time))
        rows[0] *= factor
        value = Vt.QuatfArray.FromNumpy(rows)
        layer.SetTimeSample("/hero/Rig/Anim.rotations", time, value)
    layer.Save()
    return path


def test_rotations_that_are_normalised_are_reported_once(tmp_path: Path) -> None:
    times = [1.0, 2.0, 3.0, 4.0]
    plain = read_usd(author_samples(tmp_path / "plain.usda", times)).collect()
    path = author_samples(tmp_path / "long.usda", times)
    stream = read_usd(lengthened(path, {2.0: 1.01, 3.0: 0.7, 4.0: 1.2}))
    (notice,) = stream.notices
    assert (notice.code, notice.severity) == ("USD123", "warning")
    assert notice.where == "/hero/Rig/Anim"
    for text in ("3 of 8", "hips", "frame 3", "0.7"):
        assert text in notice.message
    _, rotations, _ = stream.collect().motion.dense()
    np.testing.assert_allclose(rotations, plain.motion.dense()[1], atol=1e-7)


def test_rounding_of_text_is_no_other_length(tmp_path: Path) -> None:
    path = author_samples(tmp_path / "text.usda", [1.0, 2.0, 3.0])
    assert read_usd(lengthened(path, {2.0: 1.0004})).notices == []


@pytest.mark.parametrize("own", [23.976, 29.97, 59.94])
@pytest.mark.parametrize("rate", [24.0, 25.0])
def test_rates_of_few_digits_are_the_usual_ones(
    own: float, rate: float, tmp_path: Path
) -> None:
    times = [(1001 + i) * rate / own for i in range(48)]
    clock = (
        read_usd(author_samples(tmp_path / "take.usda", times, rate)).collect().clock
    )
    assert clock.rate == rate_from_float(own)
    assert (clock.fps, clock.count) == (rate, 48)
