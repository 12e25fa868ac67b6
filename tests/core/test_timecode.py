"""SMPTE time codes: laws, and the counts that everybody publishes."""

from __future__ import annotations

from fractions import Fraction

import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.timecodes import timecode_label

from animtool.core.timecode import (
    frames_per_day,
    nominal_rate,
    parse_timecode,
    seconds_between,
)
from animtool.core.timecode import (
    timecode_label as written,
)

NTSC, FAST = Fraction(30000, 1001), Fraction(60000, 1001)
WHOLE = st.sampled_from([24, 25, 30, 48, 50, 60, 100, 120, 240]).map(Fraction)
BROADCAST = st.sampled_from([24, 30, 60, 120]).map(lambda n: Fraction(n * 1000, 1001))
RATES = st.one_of(WHOLE, BROADCAST)
DROPS = st.sampled_from([NTSC, FAST])
PARTS = st.integers(0, 999_999).map(lambda n: Fraction(n, 1_000_000))


@given(st.integers(0, 10**7), RATES)
def test_labels_are_those_of_another_count(frame: int, rate: Fraction) -> None:
    assert written(frame, rate) == timecode_label(Fraction(frame), rate)
    if rate in {NTSC, FAST}:
        label = written(frame, rate, is_drop_frame=True)
        assert label == timecode_label(Fraction(frame), rate, is_drop_frame=True)


@given(RATES, st.integers(0, 10**9), PARTS)
def test_labels_come_back_as_frames(rate: Fraction, frame: int, part: Fraction) -> None:
    frames = frame % frames_per_day(rate) + part
    assert parse_timecode(timecode_label(frames, rate), rate) == frames


@given(DROPS, st.integers(0, 10**9), PARTS)
def test_dropped_labels_come_back(rate: Fraction, frame: int, part: Fraction) -> None:
    frames = frame % frames_per_day(rate, is_drop_frame=True) + part
    label = timecode_label(frames, rate, is_drop_frame=True)
    assert parse_timecode(label, rate) == frames


@pytest.mark.slow
@pytest.mark.parametrize(("rate", "left_out"), [(NTSC, 2), (FAST, 4)])
def test_drop_frame_counts_every_label_that_is(rate: Fraction, left_out: int) -> None:
    labels = [
        f"{hour:02d}:{minute:02d}:{second:02d};{frame:02d}"
        for hour in (0, 1)
        for minute in range(60)
        for second in (0, 59)
        for frame in (0, 1, 2, 3, 4, nominal_rate(rate) - 1)
        if not (minute % 10 and second == 0 and frame < left_out)
    ]
    counted, number = {}, 0
    for hour in (0, 1):
        for minute in range(60):
            for second in range(60):
                for frame in range(nominal_rate(rate)):
                    if minute % 10 and second == 0 and frame < left_out:
                        continue
                    counted[f"{hour:02d}:{minute:02d}:{second:02d};{frame:02d}"] = (
                        number
                    )
                    number += 1
    for label in labels:
        assert parse_timecode(label, rate) == counted[label]
        assert (
            timecode_label(Fraction(counted[label]), rate, is_drop_frame=True) == label
        )


@pytest.mark.parametrize(
    ("label", "rate", "frames"),
    [
        ("00:00:00:00", Fraction(24), 0),
        ("01:00:00:00", Fraction(24), 86400),
        ("01:00:00:00", Fraction(24000, 1001), 86400),
        ("00:00:59;29", NTSC, 1799),
        ("00:01:00;02", NTSC, 1800),
        ("00:10:00;00", NTSC, 17982),
        ("01:00:00;00", NTSC, 107892),
        ("01:00:00;00", FAST, 215784),
        ("23:59:59;29", NTSC, 2589407),
        ("00:00:00:119", Fraction(120), 119),
        ("00:00:01:02.25", Fraction(25), Fraction(109, 4)),
    ],
)
def test_published_counts(label: str, rate: Fraction, frames: Fraction) -> None:
    assert parse_timecode(label, rate) == frames


@pytest.mark.parametrize(
    ("label", "rate", "word"),
    [
        ("1:00:00:00", Fraction(24), "not a time code"),
        ("01:00:00", Fraction(24), "not a time code"),
        ("01:00:00:00.", Fraction(24), "not a time code"),
        ("24:00:00:00", Fraction(24), "hour 24"),
        ("00:60:00:00", Fraction(24), "minute 60"),
        ("00:00:60:00", Fraction(24), "second 60"),
        ("00:00:00:24", Fraction(24), "the largest is 23"),
        ("00:01:00;00", NTSC, "starts at 00:01:00;02"),
        ("00:01:00;01.5", NTSC, "starts at 00:01:00;02"),
        ("10:59:00;03", FAST, "starts at 10:59:00;04"),
        ("00:00:00;00", Fraction(30), "not apply to 30 frames"),
        ("00:00:00;00", Fraction(24000, 1001), "30000/1001 and 60000/1001"),
        ("00:00:00:00", Fraction(47, 2), "23.5 frames"),
    ],
)
def test_what_is_no_time_code(label: str, rate: Fraction, word: str) -> None:
    with pytest.raises(ValueError, match=word):
        parse_timecode(label, rate)


@given(RATES, st.integers(0, 10**9), st.integers(0, 10**9))
def test_the_shorter_way_around_the_clock(rate: Fraction, a: int, b: int) -> None:
    first, other = (timecode_label(Fraction(n), rate) for n in (a, b))
    apart = seconds_between(first, rate, other, rate)
    assert -frames_per_day(rate) <= 2 * apart * rate < frames_per_day(rate)
    assert (a + apart * rate - b) % frames_per_day(rate) == 0


@pytest.mark.parametrize(
    ("first", "other", "rate", "frames"),
    [
        ("23:59:59;29", "00:00:00;00", NTSC, 1),
        ("00:00:00;00", "23:59:59;29", NTSC, -1),
        ("23:59:00;02", "00:01:00;02", NTSC, 1798 + 1800),
        ("23:59:59;59", "00:00:00;00", FAST, 1),
        ("00:00:00;00", "23:59:59;59", FAST, -1),
        ("23:59:00;04", "00:01:00;04", FAST, 3596 + 3600),
    ],
)
def test_drop_frame_counts_on_over_midnight(
    first: str, other: str, rate: Fraction, frames: int
) -> None:
    assert seconds_between(first, rate, other, rate) * rate == frames


@given(DROPS, st.integers(0, 10**9), st.integers(-3000, 3000))
def test_what_is_counted_over_midnight_is_counted_back(
    rate: Fraction, frame: int, apart: int
) -> None:
    day = frames_per_day(rate, is_drop_frame=True)
    first, other = (
        timecode_label(Fraction(n % day), rate, is_drop_frame=True)
        for n in (frame, frame + apart)
    )
    assert seconds_between(first, rate, other, rate) * rate == apart
    assert seconds_between(other, rate, first, rate) * rate == -apart


def test_rates_that_differ_are_compared_in_seconds() -> None:
    apart = seconds_between("01:00:00:00", Fraction(24), "01:00:00:30", Fraction(120))
    assert apart == Fraction(1, 4)
    apart = seconds_between("01:00:00:12", Fraction(24000, 1001), "01:00:01:00", NTSC)
    assert apart == Fraction(1001, 2000)
