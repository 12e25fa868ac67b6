"""Shots of timelines."""

from __future__ import annotations

import json
import re
import sys
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.batch import take_files, whole_outputs
from support.cli import animtool

from animtool import open_source
from animtool.batch.cut_frames import SHOT_NAMES, CutOptions
from animtool.batch.cuts import read_cuts
from animtool.core.errors import FormatError, OptionError
from animtool.core.files.reading import MatchedFile
from animtool.core.rates import rate_from_float
from animtool.core.shot import Shot

otio = pytest.importorskip("opentimelineio", reason="no OpenTimelineIO (extra: otio)")

from support.faults import raises  # noqa: E402
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


def test_frames_are_those_of_the_shot(takes: Path) -> None:
    made = clip("sh010", "takes/take000.bvh", (86410, 12), (86400, 40))
    path = timeline(takes / "a.otio", made)
    (cut,) = read_cuts(path, options=CutOptions(handles=8)).shots
    assert set(cut.shot_values) == set(SHOT_NAMES)
    assert (cut.shot_values["first"], cut.shot_values["last"]) == ("1009", "1020")
    assert (cut.shot_values["begin"], cut.shot_values["end"]) == ("1001", "1028")
    assert (
        cut.shot_values["head"],
        cut.shot_values["tail"],
        cut.shot_values["handles"],
    ) == ("8",) * 3
    assert (cut.shot_values["shot"], cut.shot_values["fps"]) == ("sh010", "24")
    assert (cut.shot_values["track"], cut.shot_values["clip"]) == ("V1", "sh010")
    assert (cut.shot_values["media_first"], cut.shot_values["media_last"]) == (
        "11",
        "22",
    )
    assert cut.shot_values["media_fps"] == "24"
    assert cut.media.path == takes / "takes/take000.bvh"
    assert cut.shot is not None
    assert cut.shot.media_in == Fraction(10, 24)


def test_media_without_a_range_of_its_own(takes: Path) -> None:
    made = clip("sh010", "takes/take000.bvh", (4, 10), None)
    (cut,) = read_cuts(timeline(takes / "a.otio", made)).shots
    assert (cut.shot_values["media_first"], cut.shot_values["media_last"]) == (
        "5",
        "14",
    )
    assert (cut.shot_values["first"], cut.shot_values["last"]) == ("1001", "1010")


def shots_of(path: Path, **options: Any) -> list[Shot]:
    found = read_cuts(path, options=CutOptions(**options)).shots
    assert all(cut.shot is not None for cut in found)
    return [cut.shot for cut in found if cut.shot is not None]


@pytest.mark.parametrize("rate", [24, 30, 120, 24000 / 1001, 25])
@pytest.mark.parametrize("stated", [24, 24000 / 1001])
def test_seconds_are_those_of_the_edit(takes: Path, rate: float, stated: float) -> None:
    """The range of a clip is stored at the rate of its media."""
    shown, there = span(round(2 * rate), round(3 * rate), rate), span(0, 400, rate)
    made = clip("a", "takes/take000.bvh", shown, there)
    path = timeline(takes / "a.otio", made, rate=stated)
    (shot,) = shots_of(path, handles=8)
    fps, exact = rate_from_float(stated), rate_from_float(rate)
    assert shot.fps == fps
    assert shot.media_in == round(2 * rate) / exact
    assert shot.cut_in == 1009
    seconds = round(3 * rate) / exact
    assert shot.seconds_at(shot.cut_out) < shot.media_in + seconds
    assert shot.seconds_at(shot.cut_out + 1) >= shot.media_in + seconds - Fraction(
        1, 10**5
    )
    assert shot.seconds_at(shot.start) == shot.media_in - 8 / fps


def test_ranges_and_media_at_two_rates(takes: Path) -> None:
    media = span(108000, 300, 30)
    made = clip("a", "takes/take000.bvh", span(86448, 72, 24), media)
    (shot,) = shots_of(timeline(takes / "a.otio", made, rate=24))
    assert (shot.media_in, shot.cut_out - shot.cut_in + 1) == (2, 72)


def test_the_rate_is_that_of_most_clips_where_none_is_stated(takes: Path) -> None:
    url = "takes/take000.bvh"
    made = [clip(f"s{i}", url, span(0, 10, r)) for i, r in enumerate((30, 24, 24))]
    path = timeline(takes / "a.otio", *made)
    assert {shot.fps for shot in shots_of(path)} == {24}
    assert codes(path) == {"BAT049"}
    (said,) = read_cuts(path).notices
    assert (said.severity.value, "2 at 24 fps, 1 at 30 fps" in said.message) == (
        "warning",
        True,
    )
    assert {shot.fps for shot in shots_of(path, fps=Fraction(25))} == {25}
    with raises(OptionError, "BAT054"):
        shots_of(timeline(takes / "c.otio", *made[:2]))
    assert {s.fps for s in shots_of(takes / "c.otio", fps=Fraction(25))} == {25}
    (takes / "animtool.toml").write_text("[timeline]\nfps = 30\n")
    assert {s.fps for s in shots_of(takes / "c.otio")} == {30}
    (takes / "animtool.toml").unlink()
    stated = timeline(takes / "b.otio", *made[:0], clip("a", url, (0, 4)), rate=24)
    with raises(OptionError, "BAT051"):
        shots_of(stated, fps=Fraction(25))


@pytest.mark.parametrize(
    ("whole", "own", "given", "found"),
    [
        ({}, {}, {}, (1001, 0)),
        ({"start_frame": 101, "handles": 4}, {}, {}, (101, 4)),
        ({"start_frame": 101, "handles": 4}, {"handles": 6}, {}, (101, 6)),
        ({"handles": 4}, {"start_frame": 901}, {}, (901, 4)),
        (
            {"start_frame": 101},
            {"handles": 6},
            {"handles": 2, "start_frame": 11},
            (11, 2),
        ),
        ({}, {"start_frame": 901}, {"start_frame": 11}, (11, 0)),
        ({"start_frame": 101}, {"start_frame": 901}, {}, (901, 0)),
    ],
)
def test_start_and_handles(
    takes: Path,
    whole: dict[str, int],
    own: dict[str, int],
    given: dict[str, int],
    found: tuple[int, int],
) -> None:
    made = clip("a", "takes/take000.bvh", (10, 10))
    made.metadata["animtool"] = own
    path = timeline(takes / "a.otio", made, metadata=whole)
    (shot,) = shots_of(path, **given)
    assert (shot.start, shot.head, shot.tail) == (found[0], found[1], found[1])
    assert shot.cut_in == found[0] + found[1]


@pytest.mark.parametrize(
    ("whole", "own", "given", "found"),
    [
        ({"cut_start": 1001, "handles": 8}, {}, {}, (1001, 8)),
        ({"cut_start": 1001, "handles": 8}, {"start_frame": 1001}, {}, (1009, 8)),
        ({"handles": 4}, {"cut_start": 51}, {}, (51, 4)),
        ({"cut_start": 51}, {}, {"cut_start": 1, "handles": 2}, (1, 2)),
        ({"cut_start": 51}, {}, {"start_frame": 1, "handles": 2}, (3, 2)),
        ({"cut_start": 1009, "start_frame": 1001, "handles": 8}, {}, {}, (1009, 8)),
    ],
)
def test_where_cuts_start(
    takes: Path,
    whole: dict[str, int],
    own: dict[str, int],
    given: dict[str, int],
    found: tuple[int, int],
) -> None:
    made = clip("a", "takes/take000.bvh", (10, 10))
    made.metadata["animtool"] = own
    (shot,) = shots_of(timeline(takes / "a.otio", made, metadata=whole), **given)
    assert (shot.cut_in, shot.head) == found


def test_starts_that_contradict_each_other(takes: Path) -> None:
    made = clip("a", "takes/take000.bvh", (10, 10))
    made.metadata["animtool"] = {"cut_start": 1001, "start_frame": 1001, "handles": 8}
    with raises(FormatError, "BAT047"):
        shots_of(timeline(takes / "a.otio", made))


@pytest.mark.parametrize(
    ("own", "given", "project", "seconds"),
    [
        ({}, None, None, 3601),
        ({}, "01:00:00:00", None, 1),
        ({"first_timecode": "01:00:00:12"}, None, None, Fraction(1, 2)),
        ({}, None, "00:59:00:00", 61),
        ({}, "01:00:00:00", "00:59:00:00", 1),
    ],
)
def test_the_first_timecode_of_takes(
    takes: Path,
    own: dict[str, str],
    given: str | None,
    project: str | None,
    seconds: Fraction,
) -> None:
    made = clip("a", "takes/take000.bvh", (3601 * 24, 10), None)
    made.metadata["animtool"] = own
    path = timeline(takes / "a.otio", made)
    if project is not None:
        text = f'[timeline]\nfirst_timecode = "{project}"\n'
        (takes / "animtool.toml").write_text(text)
    (shot,) = shots_of(path, first_timecode=given)
    assert shot.media_in == seconds


def test_clips_shorter_than_a_frame_are_named(takes: Path) -> None:
    path = timeline(
        takes / "a.otio", clip("a", "takes/take000.bvh", span(10, 2, 120)), rate=24
    )
    (shot,) = shots_of(path)
    assert shot.cut_in == shot.cut_out
    assert codes(path) == {"BAT043"}


def test_the_start_of_a_project(takes: Path) -> None:
    (takes / "animtool.toml").write_text("start = 501\n")
    path = timeline(takes / "a.otio", clip("a", "takes/take000.bvh", (0, 4)))
    assert shots_of(path)[0].start == 501


@pytest.mark.parametrize(
    ("value", "said"),
    [
        ({"handels": 8}, "did you mean 'handles'?"),
        ({"handles": -1}, "below 0"),
        ({"start_frame": 1001.5}, "not a whole number"),
        ({"start_frame": True}, "not a whole number"),
        ({"start_frame": "1001"}, "not a whole number"),
        ({"fps": 24}, "no key 'fps'"),
        (8, "not a table"),
    ],
)
def test_metadata_that_cannot_be_used(takes: Path, value: object, said: str) -> None:
    made = clip("sh010", "takes/take000.bvh", (0, 4))
    made.metadata["animtool"] = value
    with pytest.raises(FormatError) as error:
        read_cuts(timeline(takes / "a.otio", made))
    (fault,) = error.value.faults
    assert fault.code == "BAT047"
    assert "clip 'sh010' of V1" in fault.message
    assert said in str(fault)


def test_names_are_legal_and_of_one_shot(takes: Path) -> None:
    url = "takes/take000.bvh"
    names = ["sh 010/a", "SH_010_A", "", "a", "a"]
    made = [clip(name, url, (0, 4)) for name in names]
    found = read_cuts(timeline(takes / "a.otio", *made))
    assert [shot.shot_values["shot"] for shot in found.shots] == [
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
    assert said == ["A1, of type Audio, is skipped", "skipped gaps: 1"]


def test_transitions_lengthen_what_is_taken(takes: Path) -> None:
    url = "takes/take000.bvh"
    time = otio.opentime.RationalTime
    fade = otio.schema.Transition(
        "x", "SMPTE_Dissolve", in_offset=time(3, 24), out_offset=time(5, 24)
    )
    made = clip("a", url, (10, 10)), fade, clip("b", url, (10, 10))
    path = timeline(takes / "a.otio", *made)
    spans = [(shot.cut_out - shot.cut_in + 1, shot.media_in) for shot in shots_of(path)]
    assert spans == [(15, Fraction(10, 24)), (13, Fraction(7, 24))]
    assert [n.code for n in read_cuts(path).notices] == ["BAT043", "BAT043"]


def test_speed_is_that_of_the_edit(takes: Path) -> None:
    made = clip("a", "takes/take000.bvh", (6, 10))
    made.effects.append(otio.schema.LinearTimeWarp("fast", time_scalar=2.0))
    path = timeline(takes / "a.otio", made)
    (shot,) = shots_of(path)
    assert (shot.cut_out - shot.cut_in + 1, shot.speed) == (10, 2)
    assert shot.seconds_at(shot.cut_out) == Fraction(6 + 18, 24)
    assert codes(path) == set()


def test_motion_that_does_not_go_forward_is_named(takes: Path) -> None:
    back = clip("a", "takes/take000.bvh", (6, 10))
    back.effects.append(otio.schema.LinearTimeWarp("back", time_scalar=-1.0))
    still = clip("b", "takes/take000.bvh", (6, 10))
    still.effects.append(otio.schema.FreezeFrame("still"))
    found = read_cuts(timeline(takes / "a.otio", back, still))
    assert [cut.shot.speed for cut in found.shots if cut.shot] == [-1, 0]
    assert [(n.code, n.severity.value) for n in found.notices] == [
        ("BAT044", "warning"),
        ("BAT044", "note"),
    ]


@pytest.mark.parametrize(
    ("shown", "said"),
    [
        (span(0, 0), "shows no frame"),
        (span(0, 1e9), "too many frames"),
        (span(0, float("nan")), "is invalid"),
        (span(0, 4, 0), "is invalid"),
    ],
)
def test_ranges_that_cannot_be_used(takes: Path, shown: Any, said: str) -> None:
    path = timeline(takes / "a.otio", clip("sh010", "takes/take000.bvh", shown))
    with raises(FormatError, "BAT041", match=said):
        read_cuts(path)


def test_outputs_that_are_no_usd_have_the_frames_of_the_shot(takes: Path) -> None:
    (takes / "shot.scene.yaml").write_text(
        'scene: animtool/1\nsource: {file: "${input}"}\n'
        "output:\n  - file: ${shot}.usda\n  - file: ${shot}.bvh\n"
    )
    made = clip("sh010", "takes/take000.bvh", span(12, 10), span(0, 40, 30))
    timeline(takes / "edit.otio", made, rate=24)
    words = ["--scene", "shot.scene.yaml", "--executor", "serial"]
    done = animtool("batch", "edit.otio", *words, cwd=takes)
    assert done.code == 0, done.stderr
    one, other = (open_source(takes / f"sh010.{kind}") for kind in ("usda", "bvh"))
    one, other = one.collect(), other.collect()
    assert one.clock.count == other.clock.count == 10
    assert one.clock.fps == other.clock.fps == 24
    apart = one.world().positions - other.world().positions
    assert np.abs(apart).max() < 1e-5


def test_nested_clips_are_shots(takes: Path) -> None:
    inner = otio.schema.Track("inner", kind="Video")
    inner.append(clip("a", "takes/take000.bvh", (0, 4)))
    stack = otio.schema.Stack("scene")
    stack.append(inner)
    found = read_cuts(timeline(takes / "a.otio", stack))
    assert [shot.shot_values["track"] for shot in found.shots] == ["V1/scene/inner"]


def test_missing_media_is_named_with_its_clips_at_once(takes: Path) -> None:
    made = clip("a", "x.bvh", (0, 4)), clip("b", "file:///none/y.bvh", (0, 4))
    path = timeline(takes / "a.otio", *made, clip("c", "takes/take000.bvh", (0, 4)))
    with pytest.raises(FormatError) as error:
        read_cuts(path)
    assert [fault.code for fault in error.value.faults] == ["BAT042", "BAT042"]
    assert "'b' of V1" in error.value.faults[1].message
    found = read_cuts(path, is_excluded=lambda path: path.suffix == ".bvh")
    assert (len(found.shots), len(found.notices)) == (0, 3)


def test_media_is_found_by_name(takes: Path) -> None:
    media = [MatchedFile(path, path.parent) for path in (takes / "takes").iterdir()]
    made = [clip("Take001", None, (0, 4))]
    made += [clip(n, "/elsewhere/take000.mov", (0, 4)) for n in ("b", "take001")]
    found = read_cuts(timeline(takes / "a.otio", *made), media)
    stems = [shot.media.path.stem for shot in found.shots]
    assert stems == ["take001", "take000", "take001"]
    unknown = timeline(takes / "b.otio", clip("c", None, (0, 4)))
    with raises(FormatError, "BAT042"):
        read_cuts(unknown, media)
    assert codes(unknown) == {"BAT043"}


def test_urls_are_read_as_such(takes: Path) -> None:
    spaced = takes / "takes/a take.bvh"
    (takes / "takes/take000.bvh").rename(spaced)
    urls = [spaced.as_uri(), "takes/a%20take.bvh", str(spaced), "takes/a take.bvh"]
    made = [clip(f"s{i}", url, (0, 4)) for i, url in enumerate(urls)]
    found = read_cuts(timeline(takes / "a.otio", *made))
    assert {shot.media.path.resolve() for shot in found.shots} == {spaced.resolve()}


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
    assert error.value.code == "IO005"


def test_an_edl(takes: Path) -> None:
    (takes / "a.edl").write_text(
        "TITLE: edit\nFCM: NON-DROP FRAME\n\n"
        "001  AX       V     C        00:00:00:00 00:00:00:08 01:00:00:00 01:00:00:08\n"
        "* FROM CLIP NAME: take001\n"
    )
    media = [MatchedFile(path, path.parent) for path in (takes / "takes").iterdir()]
    (shot,) = read_cuts(takes / "a.edl", media, CutOptions(fps=Fraction(24))).shots
    assert shot.media.path.stem == "take001"
    assert (shot.shot_values["media_first"], shot.shot_values["media_last"]) == (
        "1",
        "8",
    )


def test_a_scene_for_each_shot(takes: Path) -> None:
    (takes / "shot.scene.yaml").write_text(SCENE)
    url = "takes/take000.bvh"
    made = clip("a", url, (10, 4), (0, 40)), clip("b", url, (20, 6), (0, 40))
    timeline(takes / "edit.otio", *made, clip("c", "takes/take001.bvh", (0, 4)))
    words = ["edit.otio", "--scene", "shot.scene.yaml", "--handles", 2]
    words += ["--executor", "serial", "-o", "out/{shot}.usda"]
    done = animtool("batch", *words, "--format", "json", cwd=takes)
    assert done.code == 0, done.stderr
    items = json.loads(done.stdout)["items"]
    assert [item["samples"] for item in items] == [8, 10, 8]
    assert items[0]["shot"]["cut_in"] == 1003
    said = "shot c: the take does not have handle frames 1001 to 1002; the nearest "
    said += "pose is held"
    assert f"warning: SCN106 {said}" in done.stderr
    assert set(whole_outputs(takes / "out")) == {"a.usda", "b.usda", "c.usda"}
    again = animtool("batch", *words, cwd=takes)
    assert "3 of 3 are up to date" in again.stderr
    other = animtool("batch", *words, "--handles", 1, "-n", cwd=takes)
    assert "options changed" in other.stdout
    strict = animtool("batch", *words, "--strict", cwd=takes)
    assert (strict.code, "SCN106 shot c" in strict.stderr) == (1, True)
    assert set(whole_outputs(takes / "out")) == {"a.usda", "b.usda", "c.usda"}


def test_shots_of_scenes_take_cuts_and_handles(takes: Path) -> None:
    scene = (
        "scene: animtool/1\nvariables: {first: 1, last: 2, handles: 0, fps: 24}\n"
        'source: {file: "${input}"}\nfps: ${fps}\n'
        "shot:\n  cut:\n  - ${first}\n  - ${last}\n  handles: ${handles}\n"
    )
    (takes / "shot.scene.yaml").write_text(scene)
    made = clip("a", "takes/take000.bvh", (10, 4), (0, 40))
    timeline(takes / "edit.otio", made)
    words = ["--cut", "edit.otio", "--scene", "shot.scene.yaml", "--handles", 2]
    words += ["--executor", "serial", "-o", "{shot}.usda"]
    done = animtool("batch", *words, cwd=takes)
    assert done.code == 0, done.stderr
    text = (takes / "a.usda").read_text()
    assert "startTimeCode = 1001\n" in text
    assert "endTimeCode = 1008\n" in text
    (takes / "shot.scene.yaml").write_text(f"{scene}  start: 1\n")
    done = animtool("batch", *words, cwd=takes)
    assert (done.code, "SCN073" in done.stderr) == (2, True), done.stderr


def test_a_rate_that_a_scene_states_is_that_of_the_shots(takes: Path) -> None:
    """A timeline without a rate whose clip counts frames of its media at 30 fps."""
    scene = 'scene: animtool/1\nfps: 24\nsource: {file: "${input}"}\n'
    (takes / "shot.scene.yaml").write_text(scene)
    url = "takes/take000.bvh"
    timeline(takes / "edit.otio", clip("a", url, span(10, 10, 30), span(0, 40, 30)))
    words = ["--scene", "shot.scene.yaml", "--executor", "serial", "-o", "{shot}.usda"]
    done = animtool("batch", "edit.otio", *words, cwd=takes)
    assert done.code == 0, done.stderr
    assert "endTimeCode = 1008\n" in (takes / "a.usda").read_text()
    made = clip("a", url, span(10, 10, 30), span(0, 40, 30))
    timeline(takes / "edit.otio", made, rate=30)
    done = animtool("batch", "edit.otio", *words, cwd=takes)
    assert (done.code, "BAT051" in done.stderr) == (2, True), done.stderr


def test_outputs_without_a_pattern_are_props_the_list(takes: Path) -> None:
    made = clip("a", "takes/take000.bvh", (0, 4)), clip("b", "gone.bvh", (0, 4))
    timeline(takes / "edit.otio", *made)
    words = ["edit.otio", "--executor", "serial"]
    assert "BAT042" in animtool("batch", *words, cwd=takes).stderr
    done = animtool("batch", *words, "--exclude", "gone.bvh", cwd=takes)
    assert done.code == 0, done.stderr
    assert (takes / "a.usdc").exists()
    both = animtool("batch", "edit.otio", "--cut", "edit.otio", cwd=takes)
    assert (both.code, "BAT050" in both.stderr) == (2, True)
    assert animtool("batch", cwd=takes).code == 2


def test_one_shot_is_baked_by_its_name(takes: Path) -> None:
    made = clip("sh010", "takes/take000.bvh", (4, 8)), clip("sh020", "gone.bvh", (0, 4))
    timeline(takes / "edit.otio", *made, rate=24)
    done = animtool("bake", "edit.otio", "--shot", "sh010", "--handles", 2, cwd=takes)
    assert done.code == 0, done.stderr
    assert "shot sh010: cut 1003 to 1010, handles 2 and 2, 24 fps" in done.stderr
    told = animtool("info", "sh010.usdc", cwd=takes).stdout
    said = "  shot      sh010, frames 1001 to 1012, cut 1003 to 1010, handles 2 and 2"
    assert said in told.splitlines()
    for words, said in (
        (["--shot", "sh01"], "did you mean 'sh010'? the shots are sh010, sh020"),
        ([], "has 2 shots: name one with --shot; the shots are sh010, sh020"),
        (["--shot", "sh010", "--fps", 25, "--overwrite"], "BAT051"),
        (["--shot", "sh010", "--start", "1.5"], "whole frame"),
    ):
        done = animtool("bake", "edit.otio", *words, cwd=takes)
        assert (done.code, said in done.stderr) == (2, True), done.stderr
    done = animtool("bake", "takes/take000.bvh", "--shot", "sh010", cwd=takes)
    assert (done.code, "needs a timeline, such as edit.otio." in done.stderr) == (
        2,
        True,
    )


def test_a_shot_that_is_disabled_is_named_as_such(takes: Path) -> None:
    off = clip("off", "takes/take000.bvh", (4, 8))
    off.enabled = False
    path = timeline(takes / "a.otio", off, clip("on", "takes/take000.bvh", (4, 8)))
    done = animtool("bake", path, "--shot", "off", cwd=takes)
    assert (done.code, "is disabled" in done.stderr) == (2, True), done.stderr
    assert animtool("bake", path, cwd=takes).code == 0


def test_a_batch_file_states_where_cuts_and_takes_begin(takes: Path) -> None:
    timeline(takes / "a.otio", clip("a", "takes/take000.bvh", (3600 * 24, 8), None))
    text = "batch: animtool/1\ninputs: [a.otio]\ncut_start: 51\nhandles: 2\n"
    text += "output: '{shot}.usda'\nfirst_timecode: "
    job = takes / "a.batch.yaml"
    job.write_text(text + '"01:00:00:00"\n')
    done = animtool("batch", job, "--executor", "serial", cwd=takes)
    assert done.code == 0, done.stderr
    assert "startTimeCode = 49\n" in (takes / "a.usda").read_text()
    job.write_text(text + "an hour\n")
    done = animtool("batch", job, cwd=takes)
    assert (done.code, "BAT001" in done.stderr) == (3, True), done.stderr


def test_the_only_shot_needs_no_name(takes: Path) -> None:
    made = clip("only", "takes/take000.bvh", (4, 8))
    timeline(takes / "edit.otio", made, rate=24)
    words = ["edit.otio", "-o", "x.usda", "--start", 51]
    done = animtool("bake", *words, cwd=takes)
    assert done.code == 0, done.stderr
    assert "startTimeCode = 51\n" in (takes / "x.usda").read_text()


def test_media_that_is_a_folder_is_refused_with_its_clip(takes: Path) -> None:
    path = timeline(takes / "a.otio", clip("sh010", "takes", (0, 10), (0, 40)))
    with pytest.raises(FormatError) as error:
        read_cuts(path)
    assert error.value.code == "BAT042"
    assert "'sh010' of V1 is a folder" in error.value.faults[0].message


def test_an_address_of_media_is_named_as_it_is(takes: Path) -> None:
    url = "https://example.com/a.bvh"
    path = timeline(takes / "a.otio", clip("sh010", url, (0, 10), (0, 40)))
    with pytest.raises(FormatError) as error:
        read_cuts(path)
    assert url in error.value.faults[0].message


def test_a_shot_without_media_and_a_timeline_without_clips(takes: Path) -> None:
    alone = otio.schema.Clip("sh010", source_range=span(0, 10))
    path = timeline(takes / "a.otio", alone)
    done = animtool("bake", path, "--shot", "sh010", cwd=takes)
    assert (done.code, "BAT042" in done.stderr) == (3, True)
    done = animtool("batch", path, "-o", "out/{shot}.usdc", cwd=takes)
    assert (
        done.code,
        "a clip without media uses the INPUT with its name: pass takes too"
        in done.stderr,
    ) == (5, True)
    done = animtool("bake", timeline(takes / "b.otio"), cwd=takes)
    assert (done.code, "there is no shot to bake" in done.stderr) == (2, True)


def test_frames_of_time_of_day_are_printed_whole(takes: Path) -> None:
    late = clip("sh010", "takes/take000.bvh", (0, 10), (0, 40))
    late.metadata["animtool"] = {"start_frame": 2_073_600}
    done = animtool("bake", timeline(takes / "a.otio", late), cwd=takes)
    assert "frames 2073600 to 2073609" in done.stderr
    assert re.search(r"frame 20736\d\d\)", done.stderr), done.stderr


def test_two_shots_of_one_file_name_the_shots(takes: Path) -> None:
    shots = [clip(name, "takes/take000.bvh", (0, 10), (0, 40)) for name in "ab"]
    path = timeline(takes / "a.otio", *shots)
    done = animtool("batch", path, "-o", "out/x.usdc", cwd=takes)
    assert "take000.bvh (shot=a) and" in done.stderr
    assert "{shot} in the output" in done.stderr


def test_a_timeline_is_no_take_and_the_way_on_is_given(takes: Path) -> None:
    made = clip("sh010", "takes/take000.bvh", (4, 8))
    path = timeline(takes / "edit.otio", made)
    done = animtool("convert", path, "x.bvh", cwd=takes)
    assert (done.code, "animtool bake --shot NAME" in done.stderr) == (2, True)


def test_options_that_contradict_each_other_are_named_once(
    takes: Path, tmp_path: Path
) -> None:
    clips = [clip(name, "takes/take000.bvh", (10, 10)) for name in "ab"]
    path = timeline(takes / "a.otio", *clips)
    with pytest.raises(FormatError) as caught:
        shots_of(path, start_frame=1001, cut_start=1009, handles=4)
    (fault,) = caught.value.faults
    assert fault.code == "BAT047"
    arguments = [
        "--handles",
        "4",
        "--cut-start",
        "1009",
        "--start",
        "1001",
        "--shot",
        "a",
        "-o",
    ]
    done = animtool("bake", path, *arguments, tmp_path / "a.usdc")
    assert done.code != 0
    for text in ("--start 1001", "--handles 4", "1005", "--cut-start is 1009"):
        assert text in done.stderr


def test_json_of_a_timeline_is_repaired_at_its_line(tmp_path: Path) -> None:
    path = tmp_path / "a.otio"
    path.write_text('{"OTIO_SCHEMA": "Timeline.1",\n"name": "x",\n}')
    with pytest.raises(FormatError) as caught:
        read_cuts(path)
    (fault,) = caught.value.faults
    assert (fault.code, fault.lines, fault.column) == ("BAT041", (2,), 12)
    assert fault.hint == "remove the comma"
