"""Ranges and speeds in numbers: ends of a range, between two frames, pivots."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose
from support.faults import raises
from support.small_takes import small

from animtool.core.errors import OptionError
from animtool.edit.combine import sample_other_take
from animtool.edit.retiming import (
    TIME_SCALE,
    TimeScaleOptions,
    TrimOptions,
    _run_trim,
    time_scale,
    time_warp,
    trim,
)
from animtool.motion.motion import Channel
from animtool.motion.passes import PassContext
from animtool.motion.take import Take, TakeStream


def numbered(frames: int) -> Take:
    """Return a take from frame 1 on, whose root is at x = 0, 1, 2, ..."""
    take = small(frames)
    places = take.motion.translations.dense()
    places[:, 0, 0] = np.arange(frames)
    motion = replace(take.motion, translations=Channel.from_dense(places))
    return replace(take, motion=motion)


def shown(take: Take) -> list[float]:
    return take.motion.translations.dense()[:, 0, 0].round(9).tolist()


@pytest.mark.parametrize(
    ("first", "last", "alone", "in_shot"),
    [
        (3.0, 5.0, [2, 3, 4], [2, 3, 4]),
        (2.5, 4.5, [2, 3], [1, 2, 3, 4]),
        (2.9999999, 5.0000001, [2, 3, 4], [2, 3, 4]),
        (None, 1.0, [0], [0]),
        (8.0, None, [7], [7]),
    ],
)
def test_ends_between_two_frames_are_within_and_of_a_shot_without(
    first: float | None, last: float | None, alone: list[int], in_shot: list[int]
) -> None:
    """A shot shows what is between the frames on either side of its ends."""
    take, options = numbered(8), TrimOptions(first, last)
    found = trim(take, first, last)
    assert shown(found) == alone
    assert found.clock.start == alone[0] + 1
    context = PassContext(lambda _: take, Path(), in_shot=True)
    found = _run_trim(TakeStream.of(take), options, context).collect()
    assert shown(found) == in_shot
    assert found.clock.start == in_shot[0] + 1


@pytest.mark.parametrize(
    ("speed", "pivot", "start", "places"),
    [
        (2.0, None, 1, [0, 2, 4]),
        (2.0, 3.0, 2, [0, 2, 4]),
        (0.5, 3.0, -1, [0, 0.5, 1, 1.5, 2, 2.5, 3, 3.5, 4]),
        (-1.0, 3.0, 1, [4, 3, 2, 1, 0]),
        (-0.5, 1.0, -7, [4, 3.5, 3, 2.5, 2, 1.5, 1, 0.5, 0]),
        (1.5, 2.0, 2, [1, 2.5, 4]),
    ],
)
def test_a_speed_is_about_a_pivot(
    speed: float, pivot: float | None, start: int, places: list[float]
) -> None:
    """Time t shows pivot + (t - pivot) speed: of frames 1 to 5."""
    found = time_scale(numbered(5), speed, pivot)
    assert found.clock.start == start
    assert shown(found) == places


@pytest.mark.parametrize(
    ("keys", "refused"),
    [
        ([(1, 1 - 5e-7), (5, 5 + 5e-7)], False),
        ([(1, 1 - 2e-6), (5, 5)], True),
        ([(1, 1), (5, 5 + 2e-6)], True),
    ],
)
def test_a_curve_leaves_a_take_by_a_rounding_at_most(
    keys: list[tuple[float, float]], refused: bool
) -> None:
    """A millionth of a frame."""
    if refused:
        with raises(OptionError, "SCN013"):
            time_warp(numbered(5), keys)
        return
    found = shown(time_warp(numbered(5), keys))
    assert found == pytest.approx([0, 1, 2, 3, 4], abs=1e-6)


@pytest.mark.parametrize(
    ("first", "last", "hint"),
    [
        (0.2, 0.9, "write first=6 and last=22"),
        (None, 0.9, "write last=22"),
        (0.0, 0.5, "write first=1 and last=13"),
        (7.2, 7.9, "write first=174 and last=190"),
        (-3.0, -1.0, ""),
        (-0.9, -0.2, ""),
    ],
)
def test_a_trim_in_seconds_is_answered_with_frames(
    first: float | None, last: float | None, hint: str
) -> None:
    take = numbered(24)
    take = replace(take, clock=replace(take.clock, fps=Fraction(24)))
    with pytest.raises(OptionError) as caught:
        trim(take, first, last)
    (fault,) = caught.value.faults
    assert fault.code == "SCN013"
    assert (fault.hint or "").endswith(hint) if hint else fault.hint is None


@pytest.mark.parametrize(
    ("curve", "is_swapped"),
    [([(1, 1), (5, 9), (9, 40)], True), ([(1, 1), (40, 30)], False)],
)
def test_pairs_of_a_curve_that_are_swapped(
    curve: list[tuple[float, float]], is_swapped: bool
) -> None:
    with pytest.raises(OptionError) as caught:
        time_warp(numbered(24), curve)
    (fault,) = caught.value.faults
    assert fault.code == "SCN013"
    assert (fault.hint or "").endswith("swapped?") is is_swapped


def test_fractions_of_frames_that_the_take_has_are_frames() -> None:
    take = numbered(24)
    assert trim(take, 1.5, 3.5).clock.count == 2


@pytest.mark.parametrize(
    ("keys", "hint"),
    [
        ([(0, 0), (1, 0.5), (2, 1)], "1 s is frame 25"),
        ([(1, 0), (24, 24)], None),
        ([(1, -0.5), (24, 0.5)], None),
        ([(1, 1), (24, 24.5)], None),
    ],
)
def test_a_curve_in_seconds_is_answered_with_a_frame(
    keys: list[tuple[float, float]], hint: str | None
) -> None:
    take = numbered(24)
    take = replace(take, clock=replace(take.clock, fps=Fraction(24)))
    with pytest.raises(OptionError) as caught:
        time_warp(take, keys)
    (fault,) = caught.value.faults
    assert (fault.hint or "").endswith(hint) if hint else fault.hint is None


def test_another_take_runs_at_its_own_rate_and_begins_later() -> None:
    """At 30 a second, seen at 60 and at 20, and late by three frames of these."""
    take = numbered(5)
    for rate, delay, expected in (
        (60, 0, [0, 0.5, 1, 1.5, 2]),
        (20, 0, [0, 1.5, 3, 4, 4]),
        (60, 3, [0, 0, 0, 0, 0.5]),
        (20, -1, [1.5, 3, 4, 4, 4]),
    ):
        found = sample_other_take(take, Fraction(rate), 0, 5, Fraction(delay))
        assert_allclose(found.translations.dense()[:, 0, 0], expected)
    found = sample_other_take(take, Fraction(60), 2, 3)
    assert_allclose(found.translations.dense()[:, 0, 0], [1, 1.5, 2])


@pytest.mark.parametrize(
    ("speed", "found"), [(200, True), (50, True), (-100, True), (8, False), (0.02, 0)]
)
def test_a_speed_in_percent(speed: float, found: bool, tmp_path: Path) -> None:
    context = PassContext(lambda _: numbered(2), tmp_path)
    options = TimeScaleOptions(speed=speed)
    TIME_SCALE.run(numbered(240), options, context)
    codes = [notice.code for notice in context.notices]
    assert codes.count("SCN117") == found
    take_codes = [notice.code for notice in time_scale(numbered(240), speed).notices]
    assert take_codes.count("SCN117") == found


def test_a_range_in_seconds_that_leaves_one_frame_is_said() -> None:
    take = small(24)
    short = trim(take, 0.5, 1.5)
    assert [notice.code for notice in short.notices] == ["TAKE010"]
    assert short.clock.count == 1
    assert trim(take, 1, 1).notices == ()


def test_frames_are_not_counted_from_the_end() -> None:
    for last, is_swapped in ((-1, False), (2, True)):
        with pytest.raises(OptionError) as caught:
            trim(numbered(5), 3, last)
        (fault,) = caught.value.faults
        assert fault.code == "SCN013"
        assert ("first=" in (fault.hint or "")) is is_swapped
    with pytest.raises(TypeError, match=r"not '5'$"):
        trim(numbered(5), "5")  # type: ignore[arg-type]
