"""Shots of timelines."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest
from support.batch import take_files, whole_outputs
from support.cli import animtool

from animtool.batch.cuts import SHOT_NAMES, read_cuts
from animtool.errors import FormatError, OptionError
from animtool.files import FoundFile

otio = pytest.importorskip("opentimelineio", reason="no OpenTimelineIO (extra: otio)")

from support.timelines import clip, span, timeline  # noqa: E402

SCENE = """
scene: animtool/1
variables: {begin: 1, end: 4, shot: none}
source: {file: "${input}"}
passes:
- trim:
    first: ${begin}
    last: ${end}
"""


@pytest.fixture
def takes(tmp_path: Path) -> Path:
    take_files(tmp_path / "takes", 2, frames=40)
    return tmp_path


def codes(path: Path, **given: object) -> set[str]:
    return {n.code for n in read_cuts(path, **given).notices}  # type: ignore[arg-type]


def test_ranges_count_from_the_first_frame_of_the_media(takes: Path) -> None:
    made = clip("sh010", "takes/take000.bvh", (86410, 12), (86400, 40))
    (shot,) = read_cuts(timeline(takes / "a.otio", made), handles=8).shots
    assert set(shot.names) == set(SHOT_NAMES)
    assert (shot.names["first"], shot.names["last"]) == ("11", "22")
    assert (shot.names["begin"], shot.names["end"]) == ("3", "30")
    assert (shot.names["shot"], shot.names["fps"]) == ("sh010", "24")
    assert (shot.names["track"], shot.names["clip"]) == ("V1", "sh010")
    assert shot.found.path == takes / "takes/take000.bvh"


def test_media_without_a_range_of_its_own(takes: Path) -> None:
    made = clip("sh010", "takes/take000.bvh", (4, 10), None)
    (shot,) = read_cuts(timeline(takes / "a.otio", made), handles=8).shots
    assert (shot.names["first"], shot.names["last"]) == ("5", "14")
    assert (shot.names["begin"], shot.names["end"]) == ("-3", "22")


def test_handles_that_are_not_there_are_named(takes: Path) -> None:
    made = clip("sh010", "takes/take000.bvh", (2, 30), (0, 40))
    found = read_cuts(timeline(takes / "a.otio", made), handles=8)
    assert [(n.code, str(n.severity)) for n in found.notices] == [("BAT045", "warning")]
    assert "2 and 8 frames" in found.notices[0].message
    names = found.shots[0].names
    assert (names["begin"], names["end"], names["handles"]) == ("1", "40", "8")


def test_a_cut_beyond_its_media_is_named(takes: Path) -> None:
    made = clip("sh010", "takes/take000.bvh", (30, 20), (0, 40))
    assert codes(timeline(takes / "a.otio", made)) == {"BAT045"}


def test_names_are_legal_and_of_one_shot(takes: Path) -> None:
    url = "takes/take000.bvh"
    names = ["sh 010/a", "SH_010_A", "", "a", "a"]
    made = [clip(name, url, (0, 4)) for name in names]
    found = read_cuts(timeline(takes / "a.otio", *made))
    assert [shot.names["shot"] for shot in found.shots] == [
        "sh_010_a",
        "SH_010_A_2",
        "take000",
        "a",
        "a_2",
    ]
    assert [n.code for n in found.notices] == ["BAT046"] * 3


def test_gaps_and_other_tracks_are_said(takes: Path) -> None:
    sound = otio.schema.Track("A1", kind="Audio")
    sound.append(clip("music", "music.wav", (0, 4)))
    gap = otio.schema.Gap(source_range=span(0, 10))
    made = clip("a", "takes/take000.bvh", (0, 4))
    found = read_cuts(timeline(takes / "a.otio", gap, made, more=(sound,)))
    assert len(found.shots) == 1
    said = [n.message for n in found.notices]
    assert said == ["A1, of Audio, is left out", "left out gaps: 1"]


def test_transitions_lengthen_what_is_taken(takes: Path) -> None:
    url = "takes/take000.bvh"
    time = otio.opentime.RationalTime
    fade = otio.schema.Transition(
        "x", "SMPTE_Dissolve", in_offset=time(3, 24), out_offset=time(5, 24)
    )
    made = clip("a", url, (10, 10)), fade, clip("b", url, (10, 10))
    found = read_cuts(timeline(takes / "a.otio", *made))
    spans = [(shot.names["first"], shot.names["last"]) for shot in found.shots]
    assert spans == [("11", "25"), ("8", "20")]
    assert [n.code for n in found.notices] == ["BAT043", "BAT043"]


def test_speed_is_said_and_counted(takes: Path) -> None:
    made = clip("a", "takes/take000.bvh", (0, 10))
    made.effects.append(otio.schema.LinearTimeWarp("fast", time_scalar=2.0))
    found = read_cuts(timeline(takes / "a.otio", made))
    assert found.shots[0].names["last"] == "20"
    assert found.shots[0].names["speed"] == "2"
    assert [n.code for n in found.notices] == ["BAT044"]


def test_nested_clips_are_shots(takes: Path) -> None:
    inner = otio.schema.Track("inner", kind="Video")
    inner.append(clip("a", "takes/take000.bvh", (0, 4)))
    stack = otio.schema.Stack("scene")
    stack.append(inner)
    found = read_cuts(timeline(takes / "a.otio", stack))
    assert [shot.names["track"] for shot in found.shots] == ["V1/scene/inner"]


def test_missing_media_is_named_with_its_clips_at_once(takes: Path) -> None:
    made = clip("a", "x.bvh", (0, 4)), clip("b", "file:///none/y.bvh", (0, 4))
    path = timeline(takes / "a.otio", *made, clip("c", "takes/take000.bvh", (0, 4)))
    with pytest.raises(FormatError) as error:
        read_cuts(path)
    assert [fault.code for fault in error.value.faults] == ["BAT042", "BAT042"]
    assert "'b' of V1" in error.value.faults[1].message
    found = read_cuts(path, left_out=lambda path: path.suffix == ".bvh")
    assert (len(found.shots), len(found.notices)) == (0, 3)


def test_media_is_found_by_name(takes: Path) -> None:
    media = [FoundFile(path, path.parent) for path in (takes / "takes").iterdir()]
    made = clip("Take001", None, (0, 4)), clip("b", "/elsewhere/take000.mov", (0, 4))
    found = read_cuts(timeline(takes / "a.otio", *made), media)
    assert [shot.found.path.stem for shot in found.shots] == ["take001", "take000"]
    unknown = timeline(takes / "b.otio", clip("c", None, (0, 4)))
    with pytest.raises(FormatError, match="BAT042"):
        read_cuts(unknown, media)
    assert codes(unknown) == {"BAT043"}


def test_urls_are_read_as_such(takes: Path) -> None:
    spaced = takes / "takes/a take.bvh"
    (takes / "takes/take000.bvh").rename(spaced)
    urls = [spaced.as_uri(), "takes/a%20take.bvh", str(spaced), "takes/a take.bvh"]
    made = [clip(f"s{i}", url, (0, 4)) for i, url in enumerate(urls)]
    found = read_cuts(timeline(takes / "a.otio", *made))
    assert {shot.found.path.resolve() for shot in found.shots} == {spaced.resolve()}


@pytest.mark.parametrize(
    ("name", "text"),
    [("a.otio", "{"), ("a.otio", "{}"), ("a.none", ""), ("b.otio", "")],
)
def test_what_is_no_timeline(tmp_path: Path, name: str, text: str) -> None:
    if text or name != "b.otio":
        (tmp_path / name).write_text(text)
    with pytest.raises(FormatError) as error:
        read_cuts(tmp_path / name)
    assert error.value.code == "BAT041"


def test_without_the_library(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "opentimelineio", None)
    with pytest.raises(OptionError) as error:
        read_cuts(tmp_path / "a.otio")
    assert error.value.code == "BAT040"


def test_an_edl(takes: Path) -> None:
    pytest.importorskip("otio_cmx3600_adapter", reason="no adapter for EDL")
    (takes / "a.edl").write_text(
        "TITLE: edit\nFCM: NON-DROP FRAME\n\n"
        "001  AX       V     C        00:00:00:00 00:00:00:08 01:00:00:00 01:00:00:08\n"
        "* FROM CLIP NAME: take001\n"
    )
    media = [FoundFile(path, path.parent) for path in (takes / "takes").iterdir()]
    (shot,) = read_cuts(takes / "a.edl", media).shots
    assert shot.found.path.stem == "take001"
    assert (shot.names["first"], shot.names["last"]) == ("1", "8")


def test_a_scene_for_each_shot(takes: Path) -> None:
    (takes / "shot.scene.yaml").write_text(SCENE)
    url = "takes/take000.bvh"
    made = clip("a", url, (10, 4), (0, 40)), clip("b", url, (20, 6), (0, 40))
    timeline(takes / "edit.otio", *made, clip("c", "takes/take001.bvh", (0, 4)))
    words = ["--cut", "edit.otio", "--scene", "shot.scene.yaml", "--handles", 2]
    words += ["--executor", "serial", "-o", "out/{shot}.usda"]
    done = animtool("batch", *words, "--format", "json", cwd=takes)
    assert done.code == 0, done.stderr
    assert '"samples": 8' in done.stdout
    assert '"samples": 10' in done.stdout
    assert "BAT045" in done.stderr
    assert set(whole_outputs(takes / "out")) == {"a.usda", "b.usda", "c.usda"}
    again = animtool("batch", *words, cwd=takes)
    assert "3 of 3 are up to date" in again.stderr
    other = animtool("batch", *words, "--handles", 1, "-n", cwd=takes)
    assert "options changed" in other.stdout


def test_shots_of_scenes_take_cuts_and_handles(takes: Path) -> None:
    (takes / "shot.scene.yaml").write_text(
        "scene: animtool/1\nvariables: {first: 1, last: 2, handles: 0}\n"
        'source: {file: "${input}"}\n'
        "shot:\n  start: 1\n  cut:\n  - ${first}\n  - ${last}\n"
        "  handles: ${handles}\n"
    )
    made = clip("a", "takes/take000.bvh", (10, 4), (0, 40))
    timeline(takes / "edit.otio", made)
    words = ["--cut", "edit.otio", "--scene", "shot.scene.yaml", "--handles", 2]
    words += ["--executor", "serial", "-o", "{shot}.usda"]
    done = animtool("batch", *words, cwd=takes)
    assert done.code == 0, done.stderr
    text = (takes / "a.usda").read_text()
    assert "startTimeCode = 9\n" in text
    assert "endTimeCode = 16\n" in text


def test_outputs_without_a_pattern_are_beside_the_list(takes: Path) -> None:
    (takes / "shot.scene.yaml").write_text(SCENE)
    made = clip("a", "takes/take000.bvh", (0, 4)), clip("b", "gone.bvh", (0, 4))
    timeline(takes / "edit.otio", *made)
    words = ["--cut", "edit.otio", "--scene", "shot.scene.yaml"]
    words += ["--executor", "serial"]
    assert "BAT042" in animtool("batch", *words, cwd=takes).stderr
    done = animtool("batch", *words, "--exclude", "gone.bvh", cwd=takes)
    assert done.code == 0, done.stderr
    assert (takes / "a.usdc").exists()
    bare = animtool("batch", "--cut", "edit.otio", cwd=takes)
    assert (bare.code, "needs a scene" in bare.stderr) == (2, True)
    assert animtool("batch", cwd=takes).code == 2
