"""Markers of a capture found by name."""

from __future__ import annotations

import pytest

from animtool.capture.templates import MarkerTemplate, TemplateMarker, match_markers
from animtool.core.errors import OptionError

TEMPLATE = MarkerTemplate(
    (
        TemplateMarker("LFHD", "head", aliases=("LeftFrontHead", "HEAD1")),
        TemplateMarker("RFHD", "head"),
        TemplateMarker("C7", "chest"),
    )
)


def test_prefixes_aliases_and_case_do_not_matter() -> None:
    match = match_markers(TEMPLATE, ["*0", "Ann:c7", "Ann: HEAD1", "Ann:RFHD", "X"])
    assert match.columns.tolist() == [2, 3, 1]
    assert (match.missing, match.unused, match.subject) == ((), ("X",), "Ann")


def test_a_capture_may_lack_markers() -> None:
    match = match_markers(TEMPLATE, ["C7", "*1"])
    assert match.columns.tolist() == [-1, -1, 0]
    assert match.missing == ("LFHD", "RFHD")


def test_a_column_is_one_marker_only() -> None:
    template = MarkerTemplate((TemplateMarker("a", "x"), TemplateMarker("A", "x")))
    assert match_markers(template, ["A"]).columns.tolist() == [-1, 0]


@pytest.mark.parametrize(
    ("names", "subject", "code", "hint"),
    [
        (["LFHDD", "RFH"], None, "SOL001", "'LFHD' is near 'LFHDD'"),
        (["*0", "*1"], None, "SOL001", "mocap label"),
        ([], None, "SOL001", "mocap label"),
        (["Ann:C7", "Bob:C7"], None, "SOL002", "subject"),
        (["Ann:C7"], "Bob", "SOL001", "Ann"),
        (["Ann:x", "Bob:C7"], "Ann", "SOL001", "add them to aliases"),
    ],
)
def test_what_does_not_fit_is_named(
    names: list[str], subject: str | None, code: str, hint: str
) -> None:
    with pytest.raises(OptionError) as caught:
        match_markers(TEMPLATE, names, subject)
    assert caught.value.code == code
    assert hint in (caught.value.faults[0].hint or "")


def test_six_of_many_names_are_shown() -> None:
    """Of those that a capture has, or of those that are near to the template's."""
    names = [f"xyz{k}w" for k in range(9)]
    with pytest.raises(OptionError) as caught:
        match_markers(TEMPLATE, names)
    hint = caught.value.faults[0].hint or ""
    assert [name in hint for name in names] == [True] * 6 + [False] * 3
    known = [f"Marker{letter}" for letter in "abcdefgh"]
    template = MarkerTemplate(tuple(TemplateMarker(name, "x") for name in known))
    with pytest.raises(OptionError) as caught:
        match_markers(template, [f"{name}__" for name in known])
    assert (caught.value.faults[0].hint or "").count("is near") == 6


def test_one_of_several_subjects_is_chosen() -> None:
    names = ["Ann:C7", "Bob:C7", "Bob:RFHD"]
    assert match_markers(TEMPLATE, names, "Bob").columns.tolist() == [-1, 2, 1]
