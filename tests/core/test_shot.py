"""The frames of a shot and the time of its media."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction

import pytest
from hypothesis import given
from hypothesis import strategies as st

from animtool.core.errors import OptionError
from animtool.core.rates import FractionLike
from animtool.core.shot import Shot, frame_spans, frames_within
from animtool.core.values import plain_value

RATES = st.sampled_from(
    [Fraction(n) for n in (24, 25, 30, 120)]
    + [Fraction(24000, 1001), Fraction(30000, 1001)]
)
SHOTS = st.builds(
    Shot,
    st.integers(-2000, 2000),
    st.integers(2001, 3000),
    st.integers(0, 50),
    st.integers(0, 50),
    fps=RATES,
    media_in=st.fractions(-100, 100, max_denominator=1001),
    speed=st.sampled_from([Fraction(1), Fraction(1, 2), Fraction(3)]),
)


@given(SHOTS, st.fractions(-100, 100))
def test_frames_and_seconds_are_inverse(shot: Shot, seconds: Fraction) -> None:
    assert shot.seconds_at(shot.frame_at(seconds)) == seconds
    assert shot.frame_at(shot.seconds_at(shot.cut_in)) == shot.cut_in
    assert shot.seconds_at(shot.cut_in) == shot.media_in
    step = shot.seconds_at(shot.start + 1) - shot.seconds_at(shot.start)
    assert step == shot.speed / shot.fps  # type: ignore[operator]


@given(SHOTS, st.integers(-50, 50), st.integers(0, 50), st.integers(0, 9))
def test_another_cut_shows_the_same_media(
    shot: Shot, moved: int, longer: int, handles: int
) -> None:
    other = shot.recut(
        shot.cut_in + moved, shot.cut_out + moved + longer, handles, handles + 1
    )
    for frame in (shot.start, shot.cut_out, other.end):
        assert other.seconds_at(frame) == shot.seconds_at(frame)
    assert (other.start, other.end) == (
        other.cut_in - handles,
        other.cut_out + handles + 1,
    )


@given(RATES, st.integers(1, 10_000), RATES)
def test_frames_within_a_time_begin_in_it(
    fps: Fraction, count: int, media: Fraction
) -> None:
    seconds = count / media
    frames = frames_within(seconds, fps)
    slack = Fraction(1, 10_000) / fps
    assert (frames - 1) / fps < seconds or frames == 1
    assert frames / fps >= seconds - slack


def test_times_of_floats_add_no_frame() -> None:
    fps = Fraction(24)
    assert frames_within(Fraction(72 + 9e-5) / fps, fps) == 72
    assert frames_within(Fraction(72 + 2e-4) / fps, fps) == 73


def test_frames_that_follow_each_other_are_a_span() -> None:
    assert frame_spans([1, 3, 5, 6, 8], step=2) == "1 to 5, 6 to 8"
    assert frame_spans([4]) == "4"


def test_names_and_reports_say_the_same() -> None:
    shot = Shot(1009, 1056, 8, 4, "sh010", Fraction(24000, 1001), Fraction(2))
    names, plain = shot.names(), plain_value(shot)
    for name, key in (
        ("first", "cut_in"),
        ("last", "cut_out"),
        ("begin", "start"),
        ("end", "end"),
        ("head", "head"),
        ("tail", "tail"),
        ("fps", "rate"),
    ):
        assert names[name] == str(plain[key])
    assert names["handles"] == "8"
    assert names["media_in"] == "2"
    # The cut shows 48 frames, the last of which begins 47 frames after the first.
    assert (plain["media_in"], plain["media_out"]) == (2, 2 + 47 * 1001 / 24000)
    assert names["media_out"] == f"{plain['media_out']:.12g}"
    assert plain["fps"] == 24000 / 1001


def test_a_shot_that_places_no_media_has_no_seconds() -> None:
    shot = Shot(1, 2, fps=Fraction(24))
    assert "media_in" not in {**shot.names(), **plain_value(shot)}
    for other in (shot, replace(shot, fps=None, media_in=Fraction(0))):
        with pytest.raises(ValueError, match="the shot has no media times"):
            other.seconds_at(1)


@pytest.mark.parametrize("fps", [24, 24.0, "24", Fraction(24)])
def test_a_shot_takes_its_rate_as_it_is_written(fps: FractionLike) -> None:
    found = Shot(1001, 1024, fps=fps).fps
    assert (found, type(found)) == (24, Fraction)


def test_a_shot_at_no_rate() -> None:
    with pytest.raises(OptionError) as caught:
        Shot(1001, 1024, fps="fast")
    assert caught.value.code == "SCN022"
