"""Options of a bake, read from text."""

from __future__ import annotations

from fractions import Fraction

import pytest

from animtool.core.shot import FrameRange
from animtool.scene.file.option_text import (
    parse_frame,
    parse_frame_range,
    parse_offsets,
    parse_rest,
)


@pytest.mark.parametrize(
    ("text", "found"),
    [
        ("12", FrameRange(12, 12)),
        ("-10--1", FrameRange(-10, -1)),
        (" 1-9x3 ", FrameRange(1, 9, 3)),
        ("1-240x240", FrameRange(1, 240, 240)),
        ("1-240x0", None),
        *((text, None) for text in ("", "a-b", "1-", "2-1", "1-2x", "1-2-3", "1e3")),
    ],
)
def test_ranges(text: str, found: FrameRange | None) -> None:
    if found is None:
        with pytest.raises(ValueError, match=r"range|no frame|reversed"):
            parse_frame_range(text)
        return
    assert parse_frame_range(text) == found


@pytest.mark.parametrize(
    ("text", "frame"),
    [
        ("1000000000", 10**9),
        ("-1000000000", -(10**9)),
        ("1000000000.5", None),
        ("-1000000001", None),
        ("soon", None),
    ],
)
def test_first_frames(text: str, frame: int | None) -> None:
    if frame is None:
        with pytest.raises(ValueError, match="frame"):
            parse_frame(text)
        return
    assert parse_frame(text) == frame


@pytest.mark.parametrize(
    ("text", "offsets"),
    [
        ("1/4,-.25,0", (Fraction(-1, 4), Fraction(0), Fraction(1, 4))),
        ("-.5,.499", (Fraction(-1, 2), Fraction(499, 1000))),
        # The second is the first of the next frame.
        ("-.5,.5", None),
        ("0,0", None),
        ("1", None),
        ("-1", None),
        ("a", None),
        ("", None),
    ],
)
def test_offsets_around_a_frame(
    text: str, offsets: tuple[Fraction, ...] | None
) -> None:
    if offsets is None:
        with pytest.raises(ValueError, match="offset"):
            parse_offsets(text)
        return
    assert parse_offsets(text) == offsets


def test_where_the_rest_pose_comes_from() -> None:
    assert (parse_rest("offsets"), parse_rest("frame:-3")) == (None, -3)
    with pytest.raises(ValueError, match="neither"):
        parse_rest("frame:")


@pytest.mark.parametrize(
    ("text", "hint"),
    [
        ("-90,0,90", "for degrees of a shutter write -0.25,0,0.25"),
        ("-25,0,25", "for percent write -0.25,0,0.25"),
        ("0,1.5", ""),
        ("-900,900", ""),
    ],
)
def test_offsets_in_other_units(text: str, hint: str) -> None:
    with pytest.raises(ValueError, match="not between -1 and 1") as error:
        parse_offsets(text)
    assert str(error.value).endswith(hint or "offsets are in frames")
