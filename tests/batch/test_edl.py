"""Edit decision lists: rates, drop-frame, speeds, transitions and what is wrong."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from support.batch import take_files
from support.cli import animtool
from support.faults import raises
from support.timelines import span

from animtool.batch.cut_frames import CutOptions
from animtool.batch.cuts import CutList, read_cuts
from animtool.core.errors import AnimtoolError
from animtool.core.files.reading import MatchedFile
from animtool.core.timecode import timecode_label

pytest.importorskip("opentimelineio", reason="no OpenTimelineIO (extra: otio)")

NTSC = Fraction(30000, 1001)
RATES = [Fraction(24), Fraction(25), Fraction(30), NTSC, Fraction(24000, 1001)]
HEAD = "TITLE: EDIT\nFCM: NON-DROP FRAME\n\n"
NAME = "* FROM CLIP NAME: walk\n"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for name in ("walk", "run"):
        (tmp_path / f"{name}.bvh").touch()
    return tmp_path


def read(folder: Path, text: str, fps: Fraction | None = Fraction(24)) -> CutList:
    path = folder / "edit.edl"
    path.write_text(text, "utf-8")
    media = [MatchedFile(folder / f"{name}.bvh", folder) for name in ("walk", "run")]
    return read_cuts(path, media, CutOptions(fps=fps))


def shown(cuts: CutList) -> list[tuple[str, Fraction, int, Fraction]]:
    """Return each shot's media, first frame of it, frames and speed."""
    found = []
    for cut in cuts.shots:
        shot = cut.shot
        assert shot is not None
        assert shot.fps is not None
        first = shot.seconds_at(shot.cut_in) * shot.fps
        count = shot.cut_out - shot.cut_in + 1
        found.append((cut.media.path.stem, first, count, shot.speed))
    return found


def event(
    number: int, source: str, record: str = "", edit: str = "C", reel: str = "AX"
) -> str:
    return f"{number:03d}  {reel}  V  {edit}  {source} {record or source}\n"


@pytest.mark.parametrize("reel", ["BL", "BLACK", "bars"])
def test_black_is_a_gap_and_not_a_shot(folder: Path, reel: str) -> None:
    first, second = "00:00:00:00 00:00:01:00", "00:00:01:00 00:00:02:00"
    text = HEAD + event(1, first) + NAME + event(2, first, second, reel=reel)
    assert [name for name, *_ in shown(read(folder, text))] == ["walk"]


@pytest.mark.parametrize(
    ("rate", "drop"), [*((rate, False) for rate in RATES), (NTSC, True)]
)
def test_labels_count_frames_of_the_rate(
    folder: Path, rate: Fraction, drop: bool
) -> None:
    frames = (17, 1950)
    labels = " ".join(
        timecode_label(frame, rate, is_drop_frame=drop) for frame in frames
    )
    cuts = read(folder, HEAD + event(1, labels) + NAME, rate)
    assert shown(cuts) == [("walk", 17, 1933, 1)]
    assert [cut.shot.fps for cut in cuts.shots if cut.shot] == [rate]


def test_drop_frame_with_colons_is_that_of_its_header(folder: Path) -> None:
    text = event(1, "00:00:59:28 00:01:00:02") + NAME
    head = "TITLE: X\nFCM: DROP FRAME\n"
    assert shown(read(folder, head + text, NTSC)) == [("walk", 1798, 2, 1)]
    assert shown(read(folder, HEAD + text, NTSC)) == [("walk", 1798, 4, 1)]
    both = head + text + "FCM: NON-DROP FRAME\n" + text.replace("001 ", "002 ")
    assert [count for *_, count, _ in shown(read(folder, both, NTSC))] == [2, 4]


def test_no_rate_is_asked_for(folder: Path) -> None:
    text = HEAD + event(1, "00:00:01:24 00:00:02:00") + NAME
    with raises(AnimtoolError, "BAT054", match="24") as error:
        read(folder, text, None)
    (folder / "animtool.toml").write_text("[timeline]\nfps = 25\n")
    assert shown(read(folder, text, None)) == [("walk", 49, 1, 1)]
    (folder / "animtool.toml").unlink()
    stated = f"{HEAD}* FPS: 25\n{text.removeprefix(HEAD)}"
    assert shown(read(folder, stated, None)) == [("walk", 49, 1, 1)]
    with pytest.raises(AnimtoolError) as error:
        read(folder, stated, Fraction(30))
    assert error.value.code == "BAT051"


@pytest.mark.parametrize(
    ("labels", "fps"),
    [
        ("00:00:01:24 00:00:02:00", Fraction(24)),
        ("00:00:01;10 00:00:02;00", Fraction(30)),
        ("00:01:00;00 00:01:02;00", NTSC),
        ("00:00:01:00 soon", Fraction(24)),
    ],
)
def test_labels_that_the_rate_has_not(folder: Path, labels: str, fps: Fraction) -> None:
    with pytest.raises(AnimtoolError) as error:
        read(folder, HEAD + event(1, labels) + NAME, fps)
    assert {(f.code, f.lines) for f in error.value.faults} == {("BAT041", (4,))}


@pytest.mark.parametrize(
    ("source", "record", "speed", "found"),
    [
        ("00:00:01:00 00:00:03:00", "01:00:00:00 01:00:01:00", "048.0", (24, 24, 2)),
        ("00:00:01:00 00:00:03:00", "01:00:00:00 01:00:01:00", "047.9", (24, 24, 2)),
        ("00:00:01:00 00:00:01:12", "01:00:00:00 01:00:01:00", "012.0", (24, 24, 0.5)),
        ("00:00:01:00 00:00:02:00", "01:00:00:00 01:00:01:00", "-024.0", (47, 24, -1)),
        ("00:00:02:00 00:00:01:00", "01:00:00:00 01:00:01:00", "-024.0", (47, 24, -1)),
        ("00:00:01:00 00:00:01:01", "01:00:00:00 01:00:02:00", "000.0", (24, 48, 0)),
        ("00:00:01:00 00:00:02:00", "01:00:00:00 01:00:01:00", "024.0", (24, 24, 1)),
    ],
)
def test_speeds(
    folder: Path, source: str, record: str, speed: str, found: tuple[float, int, float]
) -> None:
    motion = f"M2   AX       {speed}                00:00:01:00\n"
    cuts = read(folder, HEAD + event(1, source, record) + NAME + motion)
    assert shown(cuts) == [("walk", *found)]


def test_a_freeze_frame_of_a_comment(folder: Path) -> None:
    made = event(1, "00:00:01:00 00:00:01:01", "01:00:00:00 01:00:02:00")
    cuts = read(folder, f"{HEAD}{made}{NAME}* * FREEZE FRAME\n")
    assert shown(cuts) == [("walk", 24, 48, 0)]


def test_durations_that_differ_without_a_speed_are_named(folder: Path) -> None:
    made = event(1, "00:00:01:00 00:00:03:00", "01:00:00:00 01:00:01:00")
    other = event(2, "00:00:01:00 00:00:02:00", "01:00:01:00 01:00:02:00")
    cuts = read(folder, HEAD + made + NAME + other + NAME)
    assert shown(cuts) == [("walk", 24, 48, 1), ("walk", 24, 24, 1)]
    (said,) = [n for n in cuts.notices if n.severity.value == "warning"]
    assert (said.code, said.lines) == ("BAT056", (4,))


def test_a_dissolve_shows_both_clips(folder: Path) -> None:
    text = HEAD + event(1, "00:00:01:00 00:00:03:00", "01:00:00:00 01:00:02:00") + NAME
    text += event(2, "00:00:03:00 00:00:03:00", "01:00:02:00 01:00:02:00")
    text += event(2, "00:00:00:00 00:00:02:00", "01:00:02:00 01:00:04:00", "D 012")
    text += f"{NAME}* TO CLIP NAME: run\n"
    assert shown(read(folder, text)) == [("walk", 24, 60, 1), ("run", 0, 48, 1)]


def test_black_sound_and_names_of_files(folder: Path) -> None:
    text = "001  BL  V  C  00:00:00:00 00:00:01:00 01:00:00:00 01:00:01:00\n"
    text += "002  run  V  C  00:00:00:00 00:00:01:00 01:00:01:00 01:00:02:00\n"
    text += "003  AX  A  C  00:00:00:00 00:00:01:00 01:00:01:00 01:00:02:00\n" + NAME
    text += "004  AX  V  C  00:00:00:00 00:00:01:00 01:00:03:00 01:00:04:00\n"
    text += "* FROM CLIP NAME: walk.mov\n* FROM CLIP IS A STILL\n"
    cuts = read(folder, HEAD + text)
    assert [stem for stem, *_ in shown(cuts)] == ["run", "walk"]
    assert {n.code for n in cuts.notices} <= {"BAT043", "BAT046"}


def test_options_of_timelines_are_refused_without_one(folder: Path) -> None:
    for words in (["--cut-start", 1], ["--first-timecode", "01:00:00:00"]):
        done = animtool("batch", "walk.bvh", *words, "-n", cwd=folder)
        assert (done.code, "for a timeline" in done.stderr) == (2, True)
    done = animtool("batch", "walk.bvh", "--first-timecode", "an hour", cwd=folder)
    assert (done.code, "01:00:00:00" in done.stderr) == (2, True)


def test_a_scene_and_the_command_line_have_one_rate(folder: Path) -> None:
    (folder / "a.edl").write_text(HEAD + event(1, "00:00:01:00 00:00:02:00") + NAME)
    scene = 'scene: animtool/1\nfps: 25\nsource: {file: "${input}"}\n'
    (folder / "a.scene.yaml").write_text(scene)
    words = ["a.edl", "walk.bvh", "--scene", "a.scene.yaml", "-o", "{shot}.usda", "-n"]
    done = animtool("batch", *words, "--fps", 24, cwd=folder)
    assert (done.code, "BAT051" in done.stderr) == (2, True)
    for more in ([], ["--fps", 25]):
        assert animtool("batch", *words, *more, cwd=folder).code == 0


def test_the_rate_of_the_command_line_is_that_of_takes(tmp_path: Path) -> None:
    take_files(tmp_path / "takes", 1, frames=31)
    words = ["takes", "-o", "{stem}.usda", "--executor", "serial", "--fps", 60]
    done = animtool("batch", *words, cwd=tmp_path)
    assert done.code == 0, done.stderr
    assert "timeCodesPerSecond = 60" in (tmp_path / "take000.usda").read_text()


@pytest.mark.parametrize("seed", range(24))
def test_events_are_those_of_the_adapter(folder: Path, seed: int) -> None:
    """EDLs that the adapter of OpenTimelineIO writes, read by both."""
    pytest.importorskip("otio_cmx3600_adapter", reason="no adapter for EDL")
    import opentimelineio as otio

    rng = np.random.default_rng(seed)
    rate = float(rng.choice([24, 25, 30]))
    track = otio.schema.Track("V", kind="Video")
    for _ in range(rng.integers(1, 7)):
        first, count = int(rng.integers(0, 9000)), 12 * int(rng.integers(1, 12))
        made = otio.schema.Clip("walk", None, span(first, count, rate))
        if rng.random() < 0.3:
            speed = float(rng.choice([0.5, 2.0, 1.5]))
            made.effects.append(otio.schema.LinearTimeWarp(time_scalar=speed))
        track.append(made)
        if rng.random() < 0.3:
            track.append(otio.schema.Gap(source_range=span(0, 24, rate)))
    made = otio.schema.Timeline("edit")
    made.tracks.append(track)
    text = otio.adapters.write_to_string(made, "cmx_3600", rate=rate)
    theirs = otio.adapters.read_from_string(text, "cmx_3600", rate=rate)
    expected = []
    for item in theirs.find_clips():
        shown = item.source_range
        speed = Fraction(item.effects[0].time_scalar) if item.effects else Fraction(1)
        speed = speed.limit_denominator(1000)
        expected.append(("walk", shown.start_time.value, shown.duration.value, speed))
    found = shown_near(read(folder, text, Fraction(rate)))
    assert found == expected


def shown_near(cuts: CutList) -> list[tuple[str, float, float, Fraction]]:
    return [
        (stem, float(first), float(count), speed.limit_denominator(1000))
        for stem, first, count, speed in shown(cuts)
    ]
