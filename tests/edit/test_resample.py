from __future__ import annotations

from dataclasses import replace
from fractions import Fraction
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal
from support.faults import raises

from animtool.core.clock import Clock
from animtool.core.errors import OptionError
from animtool.core.shot import FrameRange
from animtool.edit.resample import (
    BLOCK_FRAMES,
    SampleTimes,
    plan_samples,
    resampled,
    sample_blocks,
)
from animtool.maths import so3
from animtool.motion.motion import Channel, Motion
from animtool.motion.take import Take
from animtool.rig.skeleton import Joint, Rig

NTSC = Fraction(24000, 1001)


def clock(count: int, fps: Fraction = Fraction(120)) -> Clock:
    return Clock(fps, Fraction(1), Fraction(1), count)


def spin(count: int, fps: Fraction) -> Take:
    """Return a joint that turns at one radian a second and slides as fast."""
    seconds = np.arange(count) / float(fps)
    turns = so3.from_axis_angle(np.array([0.0, 0.6, 0.8]), seconds)[:, None]
    slides = np.zeros((count, 1, 3))
    slides[:, 0, 0] = seconds
    rig = Rig("spin", (Joint("a", -1),))
    motion = Motion(
        Channel.from_dense(slides), Channel.from_dense(so3.align_signs(turns))
    )
    return Take(rig, clock(count, fps), motion)


@given(st.sampled_from([24, 25, 30, 60, 90, 100, 119, 120, 240]).map(Fraction))
def test_constant_speed_is_kept_exactly(fps: Fraction) -> None:
    take = spin(241, Fraction(120))
    times = plan_samples(take.clock, fps, Fraction(1))
    blocks = [motion for _, motion in sample_blocks(take, times)]
    whole = Motion.concatenate(blocks)
    seconds = (times.codes - 1) / float(fps)
    truth = so3.from_axis_angle(np.array([0.0, 0.6, 0.8]), seconds)
    found = whole.rotations.values[:, 0]
    assert so3.angle_between(found, truth).max() < 1e-14
    assert (np.sum(found[1:] * found[:-1], axis=-1) > 0).all()
    assert_allclose(whole.translations.values[:, 0, 0], seconds, atol=1e-14)


def test_samples_that_coincide_are_the_source_exactly() -> None:
    take = spin(1201, Fraction(120))
    times = plan_samples(take.clock, Fraction(24), Fraction(1001))
    assert len(times.codes) == 241
    assert not times.fractions.any()
    found = Motion.concatenate([motion for _, motion in sample_blocks(take, times)])
    assert_array_equal(found.rotations.values, take.motion.rotations.values[::5])
    assert (times.first, times.last) == (1001, 1241)


def test_kept_samples_have_exact_time_codes() -> None:
    times = plan_samples(clock(11), Fraction(24), Fraction(1001), keep_samples=True)
    assert times.codes.tolist() == [
        float(Fraction(1001) + Fraction(i, 5)) for i in range(11)
    ]
    assert times.last == 1003
    ntsc = plan_samples(clock(4), NTSC, Fraction(1), keep_samples=True)
    step = NTSC / 120
    assert ntsc.codes.tolist() == [float(1 + i * step) for i in range(4)]


def test_a_long_take_at_a_broken_rate_does_not_drift() -> None:
    times = plan_samples(clock(10**6, Fraction(30)), Fraction(30000, 1001), Fraction(1))
    ratio = Fraction(30) / Fraction(30000, 1001)
    for i in (1, 999, 10**5 + 1, len(times.codes) - 1):
        whole, left = divmod(i * ratio, 1)
        assert (times.frames[i], times.fractions[i]) == (whole, float(left))


@pytest.mark.parametrize(
    ("frames", "codes"),
    [
        (FrameRange(1, 11, 1), range(1, 12)),
        (FrameRange(3, 9, 2), (3, 5, 7, 9)),
        (FrameRange(-5, 100, 4), (3, 7, 11)),
        (FrameRange(11, 11), (11,)),
    ],
)
def test_ranges(frames: FrameRange, codes: object) -> None:
    times = plan_samples(clock(11), Fraction(120), Fraction(1), frame_range=frames)
    assert times.codes.tolist() == list(codes)  # type: ignore[call-overload]
    assert (times.first, times.last) == (times.codes[0], times.codes[-1])


@pytest.mark.parametrize("frames", [FrameRange(12, 20), FrameRange(-9, 0)])
@pytest.mark.parametrize("keep", [False, True])
def test_a_range_without_a_frame(frames: FrameRange, keep: bool) -> None:
    with raises(OptionError, "CLI005"):
        plan_samples(
            clock(11), Fraction(120), Fraction(1), frame_range=frames, keep_samples=keep
        )


def test_kept_samples_within_a_range() -> None:
    times = plan_samples(
        clock(21),
        Fraction(24),
        Fraction(1),
        frame_range=FrameRange(2, 3),
        keep_samples=True,
    )
    assert_allclose(times.codes, np.arange(2, 3.1, 0.2))
    with raises(OptionError, "CLI005"):
        plan_samples(
            clock(21), Fraction(24), Fraction(1),
            frame_range=FrameRange(1, 3, 2), keep_samples=True,
        )  # fmt: skip


@pytest.mark.parametrize(
    ("wanted", "first", "last"),
    [
        (FrameRange(2, 3), 5, 9),
        (FrameRange(-9, 2), 0, 4),
        (FrameRange(3, 99), 10, 19),
        (FrameRange(6, 6), None, None),
    ],
)
def test_kept_samples_off_the_grid_stay_within_the_range(
    wanted: FrameRange, first: int | None, last: int
) -> None:
    """At 120 samples a second no frame of 25 but each fifth has a sample."""
    step = Fraction(25, 120)

    def times() -> SampleTimes:
        return plan_samples(
            clock(20), Fraction(25), Fraction(1), frame_range=wanted, keep_samples=True
        )

    if first is None:
        with raises(OptionError, "CLI005", match=r"1.*4\.95833"):
            times()
        return
    found = times()
    assert found.frames.tolist() == list(range(first, last + 1))
    assert found.codes.tolist() == [float(1 + i * step) for i in found.frames]
    assert (found.first, found.last) == (1 + first * step, 1 + last * step)


def test_sub_frame_samples_are_ascending_and_held_at_the_ends() -> None:
    offsets = (Fraction(-1, 4), Fraction(0), Fraction(1, 4))
    take = spin(3, Fraction(24))
    times = plan_samples(take.clock, Fraction(24), Fraction(10), offsets=offsets)
    assert times.codes.tolist() == [9.75, 10, 10.25, 10.75, 11, 11.25, 11.75, 12, 12.25]
    assert (times.first, times.last) == (10, 12)
    found = Motion.concatenate([motion for _, motion in sample_blocks(take, times)])
    slide = found.translations.values[:, 0, 0] * 24
    assert_allclose(slide, [0, 0, 0.25, 0.75, 1, 1.25, 1.75, 2, 2], atol=1e-14)


def test_one_frame() -> None:
    times = plan_samples(clock(1), Fraction(24), Fraction(1))
    assert (times.codes.tolist(), times.first, times.last) == ([1.0], 1, 1)


@pytest.mark.parametrize("frames", [None, FrameRange(1, 10**9)])
def test_far_too_many_samples(frames: FrameRange | None) -> None:
    slow = clock(100, Fraction(1, 100))
    with raises(OptionError, "CLI005"):
        plan_samples(slow, Fraction(100_000), Fraction(1), frame_range=frames)


def test_what_lasts_beyond_the_last_whole_frame_is_noted() -> None:
    dropped = resampled(spin(30, Fraction(30)), 24).notices
    assert [notice.code for notice in dropped] == ["TAKE006"]
    assert "0.2 frames" in dropped[0].message
    assert resampled(spin(31, Fraction(30)), 24).notices == ()


@pytest.mark.parametrize("fps", [0, Fraction(0), -24, "none", float("nan"), True, [24]])
def test_a_rate_that_is_none_is_refused(fps: Any) -> None:
    with raises(OptionError, "SCN022"):
        resampled(spin(3, Fraction(30)), fps)


@pytest.mark.parametrize("fps", [23.976, "23.976", "24000/1001"])
def test_rates_are_taken_as_they_are_written(fps: float | str) -> None:
    assert resampled(spin(3, Fraction(30)), fps).clock.fps == Fraction(24000, 1001)


@given(
    st.fractions(-20, 20, max_denominator=1001),
    st.sampled_from([Fraction(24), Fraction(30), NTSC]),
    st.integers(-30, 30),
    st.integers(0, 60),
    st.integers(1, 5),
)
def test_a_range_of_a_take_that_begins_within_a_frame(
    start: Fraction, fps: Fraction, first: int, more: int, step: int
) -> None:
    """Whole frames are sampled at their own time; what is missing is held."""
    take = spin(121, Fraction(30))
    wanted = FrameRange(first, first + more, step)
    times = plan_samples(take.clock, fps, start, frame_range=wanted, extend=True)
    assert times.codes.tolist() == list(range(first, first + more + 1, step))
    motion = Motion.concatenate([motion for _, motion in sample_blocks(take, times)])
    seconds = np.clip((times.codes - float(start)) / float(fps), 0, 120 / 30)
    assert_allclose(motion.translations.dense()[:, 0, 0], seconds, atol=1e-12)
    inside = [n for n in times.codes if start <= n <= start + 120 * fps / 30]
    if not inside:
        with raises(OptionError, "CLI005"):
            plan_samples(take.clock, fps, start, frame_range=wanted)
        return
    own = plan_samples(take.clock, fps, start, frame_range=wanted)
    assert own.codes.tolist() == inside


def test_samples_between_the_frames_of_a_range_are_counted() -> None:
    wanted = FrameRange(1, 9)
    for start, between in (
        (Fraction(0), 32),
        (Fraction(-1, 5), 32),
        (Fraction(1, 7), 40),
    ):
        times = plan_samples(clock(400), Fraction(24), start, frame_range=wanted)
        assert times.dropped_sample_count == between


def shaking(frequency: float, count: int = 961) -> Take:
    """Return a joint that slides to and fro at 240 frames a second."""
    take = spin(count, Fraction(240))
    slides = np.zeros((count, 1, 3))
    slides[:, 0, 0] = np.sin(2 * np.pi * frequency * np.arange(count) / 240)
    motion = replace(take.motion, translations=Channel.from_dense(slides))
    return replace(take, motion=motion)


@pytest.mark.parametrize(
    ("frequency", "least", "most"), [(2, 0.99, 1.01), (18, 0, 3e-3), (47, 0, 1e-5)]
)
def test_lowpass_keeps_what_is_slow_and_shows_nothing_else(
    frequency: float, least: float, most: float
) -> None:
    """What is too fast for 24 frames a second shows in full without a filter."""
    take = shaking(frequency)
    middle = slice(24, -24)
    plain = resampled(take, 24).motion.translations.dense()[middle, 0, 0]
    assert np.abs(plain).max() > 0.9
    slow = resampled(take, 24, lowpass=True).motion.translations.dense()[middle, 0, 0]
    assert least <= np.abs(slow).max() / np.abs(plain).max() <= most


def test_lowpass_shows_the_same_at_common_times() -> None:
    """A slow motion is within a thousandth of itself at 24 and 60 frames a second."""
    take = shaking(1.0)
    few, many = (resampled(take, fps, lowpass=True).motion for fps in (24, 60))
    assert_allclose(
        few.translations.dense()[::2], many.translations.dense()[::5], atol=1e-3
    )


def test_lowpass_leaves_a_take_that_gets_more_frames() -> None:
    take = spin(31, Fraction(30))
    plain, slow = (resampled(take, 60, lowpass=on).motion for on in (False, True))
    assert_array_equal(plain.rotations.dense(), slow.rotations.dense())


def test_smooth_samples_are_of_third_order() -> None:
    """Of a joint that goes along a sine, and turns about a turning axis."""
    errors = []
    for rate in (30, 60):
        t = np.arange(2 * rate + 1) / rate
        take = along(t, rate)
        fine = resampled(take, 4 * rate, smooth=True)
        truth = along(np.arange(8 * rate + 1) / (4 * rate), 4 * rate)
        places = fine.motion.translations.dense() - truth.motion.translations.dense()
        turns = so3.angle_between(
            fine.motion.rotations.dense(), truth.motion.rotations.dense()
        )
        errors.append((np.abs(places).max(), turns.max()))
        assert_allclose(
            fine.motion.rotations.dense()[::4], take.motion.rotations.dense()
        )
    orders = np.log2(np.divide(*errors))
    assert orders.min() > 2.7
    straight = resampled(along(np.arange(61) / 30, 30), 120).motion
    off = (
        straight.translations.dense()
        - along(np.arange(241) / 120, 120).motion.translations.dense()
    )
    assert np.abs(off).max() > 10 * errors[0][0]


def along(times: np.ndarray, rate: int) -> Take:
    """Return a joint at some times [s]."""
    zero = np.zeros_like(times)
    places = np.stack([np.sin(5 * times), np.cos(4 * times), zero], axis=1)
    axis = np.stack([np.cos(times), np.sin(times), zero], axis=1)
    turns = so3.exp(axis * (1.5 * np.sin(3 * times))[:, None])
    rig = Rig("joint", (Joint("joint", -1),))
    motion = Motion(
        Channel.from_dense(places[:, None]),
        Channel.from_dense(so3.align_signs(turns)[:, None]),
    )
    clock = Clock(Fraction(rate), Fraction(1), Fraction(1), len(times))
    return Take(rig, clock, motion)


def test_smooth_samples_have_continuous_signs_from_block_to_block() -> None:
    turned = resampled(spin(1500, Fraction(120)), 60, smooth=True)
    assert len(turned) > BLOCK_FRAMES
    values = turned.motion.rotations.values[:, 0]
    assert (values[1:] * values[:-1]).sum(axis=1).min() > 0.99


def test_as_many_frames_as_there_may_be_are_made(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Of 5 frames at 24 a second 9 at 48 and at 53, and 10 at 54."""
    monkeypatch.setattr("animtool.edit.frames.MAX_FRAME_COUNT", 9)
    take = spin(5, Fraction(24))
    assert resampled(take, 48).motion.frames == 9
    assert resampled(take, 53).motion.frames == 9
    with raises(OptionError, "SCN021"):
        resampled(take, 54)


def test_frames_of_the_take_are_left_to_the_sign_of_their_quaternions() -> None:
    take = spin(5, Fraction(24))
    turns = take.motion.rotations.dense().copy()
    turns[[1, 2, 4]] *= -1
    take = replace(
        take, motion=replace(take.motion, rotations=Channel.from_dense(turns))
    )
    times = plan_samples(take.clock, Fraction(24), take.clock.start)
    ((_, found),) = sample_blocks(take, times)
    assert_array_equal(found.rotations.dense(), turns)
    ((_, found),) = sample_blocks(take, times, is_smooth=True)
    assert (np.sum(np.diff(found.rotations.dense(), axis=0) ** 2, axis=2) < 1).all()
