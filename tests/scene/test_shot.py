"""A scene in a shot: its cut, handles, pre-roll and samples for motion blur."""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterator
from dataclasses import dataclass, replace
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from support.cli import animtool
from support.faults import refused

from animtool import open_source
from animtool.motion.motion import Motion
from animtool.motion.passes import PASSES, FrameScope, Pass, PassContext
from animtool.motion.take import Take, TakeStream
from animtool.scene.file.read import load_scene
from animtool.scene.sources.retime import Preroll, drop_first_frames, with_preroll
from animtool.usd.layers.sdf import open_layer

SCENE = """scene: animtool/1
source: {file: walk.bvh, units: cm}
shot: {start: 1001, cut: [1009, 1050], handles: 8, preroll: 20}
output: {file: shot.usda}
"""


@pytest.fixture
def shot(walk: Path, tmp_path: Path) -> Path:
    shutil.copy(walk, tmp_path / "walk.bvh")
    path = tmp_path / "shot.scene.yaml"
    path.write_text(SCENE, "utf-8")
    return path


def test_the_cut_is_written_with_its_handles(shot: Path) -> None:
    done = animtool("bake", shot, "--strict")
    assert done.code == 0, done.stderr
    text = (shot.parent / "shot.usda").read_text("utf-8")
    assert "startTimeCode = 1001\n" in text
    assert "endTimeCode = 1058\n" in text
    ours = open_source(shot.parent / "shot.usda").collect()
    source = open_source(shot.parent / "walk.bvh").collect()
    apart = ours.world().positions - source.world().positions[:58]
    assert np.abs(apart).max() < 1e-5


@pytest.mark.parametrize(
    ("cut", "named"),
    [
        ("[1004, 1050]", "996 to 1000"),
        ("[1009, 1060]", "1065 to 1068"),
        ("[1001, 1064]", "993 to 1000, 1065 to 1072"),
    ],
)
def test_handles_that_are_missing_are_named(shot: Path, cut: str, named: str) -> None:
    shot.write_text(SCENE.replace("[1009, 1050]", cut), "utf-8")
    done = animtool("bake", shot)
    assert done.code == 0, done.stderr
    said = f"SCN106 shot.handles: the take does not have handle frames {named}; the"
    assert said in done.stderr
    first, last = (int(frame) for frame in cut.strip("[]").split(", "))
    text = (shot.parent / "shot.usda").read_text("utf-8")
    assert f"startTimeCode = {first - 8}\n" in text
    assert f"endTimeCode = {last + 8}\n" in text
    done = animtool("bake", shot, "--strict", "--overwrite")
    assert done.code == 1


@pytest.mark.parametrize(
    ("cut", "named"),
    [
        ("[1000, 1050]", "1000"),
        ("[1009, 1065]", "1065"),
        ("[1030, 1070]", "1065 to 1070"),
    ],
)
def test_frames_of_the_cut_that_are_missing_hold_the_nearest_pose(
    shot: Path, cut: str, named: str
) -> None:
    shot.write_text(SCENE.replace("[1009, 1050]", cut), "utf-8")
    done = animtool("bake", shot, "--strict")
    assert done.code == 1
    assert not (shot.parent / "shot.usda").exists()
    done = animtool("bake", shot)
    assert done.code == 0, done.stderr
    said = f"SCN074 shot.cut: the take does not have frames of the cut {named}; the"
    assert said in done.stderr
    take = open_source(shot.parent / "shot.usda").collect()
    positions = take.world().positions
    begin, near = int(take.clock.start), 1001 if named == "1000" else 1064
    held = positions[int(named[-4:]) - begin]
    np.testing.assert_array_equal(held, positions[near - begin])


def test_a_take_without_any_frame_of_the_shot_is_refused(shot: Path) -> None:
    shot.write_text(SCENE.replace("[1009, 1050]", "[1080, 1090]"), "utf-8")
    done = animtool("bake", shot)
    assert done.code == 2
    assert "SCN042 shot.cut" in done.stderr
    assert not (shot.parent / "shot.usda").exists()


def test_a_layer_says_which_shot_it_is_of(shot: Path) -> None:
    done = animtool("bake", shot, "--format", "json")
    report = json.loads(done.stdout)["shot"]
    assert (report["start"], report["cut_in"], report["cut_out"]) == (1001, 1009, 1050)
    layer = open_layer(shot.parent / "shot.usda")
    assert layer.customLayerData["animtool"]["shot"] == {
        "name": "",
        "start": 1001,
        "end": 1058,
        "cutIn": 1009,
        "cutOut": 1050,
        "head": 8,
        "tail": 8,
        "fps": 30.0,
        "rate": "30",
    }


def test_the_command_line_writes_other_frames(shot: Path) -> None:
    done = animtool("bake", shot, "--range", "1010-1012", "--strict")
    assert done.code == 0, done.stderr
    text = (shot.parent / "shot.usda").read_text("utf-8")
    assert "startTimeCode = 1010\n" in text


def test_samples_for_motion_blur(shot: Path) -> None:
    text = SCENE.replace("shot.usda", "shot.usda, samples: [-0.25, 0, 0.25]")
    shot.write_text(text, "utf-8")
    done = animtool("bake", shot)
    assert done.code == 0, done.stderr
    assert "174 samples" in done.stderr
    assert "1008.75: " in (shot.parent / "shot.usda").read_text("utf-8")


@pytest.mark.parametrize(
    ("old", "new", "code", "line"),
    [
        ("[1009, 1050]", "[1050, 1009]", "SCN003", 3),
        ("[1009, 1050]", "[1009]", "DOC022", 3),
        ("cut: [1009, 1050], ", "", "DOC021", 3),
        ("handles: 8", "handles: -1", "DOC022", 3),
        ("shot.usda", "shot.usda, samples: [0.5, -0.5]", "SCN003", 4),
        ("shot.usda", "shot.usda, samples: [2]", "SCN003", 4),
        ("output", "range: [1, 9]\noutput", "SCN041", 4),
    ],
)
def test_each_fault_has_its_line(
    shot: Path, old: str, new: str, code: str, line: int
) -> None:
    shot.write_text(SCENE.replace(old, new), "utf-8")
    with refused((code, line)):
        load_scene(shot)


@dataclass(frozen=True, slots=True)
class FallOptions:
    """Nothing to say."""


SEEN: list[tuple[float, int]] = []


def fall(stream: TakeStream, _: FallOptions, __: PassContext) -> TakeStream:
    """Let the roots rise by a centimetre a frame from the first frame on."""

    def blocks() -> Iterator[Motion]:
        done = 0
        for block in stream.blocks:
            values = block.translations.values.copy()
            values[:, 0, 1] += 0.01 * (done + np.arange(block.frames))
            channel = replace(block.translations, values=values)
            done += block.frames
            yield replace(block, translations=channel)
        SEEN.append((float(stream.start or 1), done))

    return replace(stream, blocks=blocks())


SETTLING = Pass("fall", "Fall", FallOptions, FrameScope.FRAME, fall, needs_preroll=True)


def fallen(take: Take, _: FallOptions, context: PassContext) -> Take:
    return fall(TakeStream.of(take), FallOptions(), context).collect()


WHOLE = Pass("fall", "Fall", FallOptions, FrameScope.CLIP, fallen, needs_preroll=True)


@pytest.mark.parametrize("name", ["SETTLING", "WHOLE"])
def test_passes_with_a_state_begin_in_the_preroll(
    shot: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    monkeypatch.setitem(PASSES, "fall", f"{__name__}:{name}")
    text = SCENE.replace("output", "passes: [{trim: {first: 3}}, {fall: }]\noutput")
    shot.write_text(text, "utf-8")
    SEEN.clear()
    take = load_scene(shot).open().collect()
    # The take begins at 1001, and handles and pre-roll at 981.
    assert SEEN == [(3 - 20, 62 + 20)]
    assert (take.clock.start, take.clock.count) == (3, 62)
    source = open_source(shot.parent / "walk.bvh").collect().motion.translations
    risen = take.motion.translations.dense()[:, 0, 1] - source.dense()[2:, 0, 1]
    np.testing.assert_allclose(risen, 0.01 * (20 + np.arange(62)), atol=1e-9)


def test_no_preroll_where_the_take_has_its_frames(
    shot: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(PASSES, "fall", f"{__name__}:SETTLING")
    text = SCENE.replace("[1009, 1050]", "[1040, 1050]")
    shot.write_text(text.replace("output", "passes: [{fall: }]\noutput"), "utf-8")
    SEEN.clear()
    load_scene(shot).open().collect()
    assert SEEN == [(1, 64)]


def test_preroll_at_another_rate(walk: Path) -> None:
    stream = open_source(walk)
    assert stream.fps == 30
    wanted = Preroll(Fraction(1001), 996, Fraction(24))
    assert wanted.missing_frame_count(stream) == 7  # 5 frames of 24 a second
    early = with_preroll(open_source(walk), 7)
    assert early.start == -6
    again = drop_first_frames(early, 7, None).collect()
    whole = open_source(walk).collect()
    np.testing.assert_array_equal(
        again.motion.rotations.dense(), whole.motion.rotations.dense()
    )


@pytest.mark.parametrize(
    ("requested", "suggested"),
    [
        ("1-24", "1001-1024"),
        ("1-24x2", "1001-1024x2"),
        ("1-500", "1001-1058"),
        ("1070-1080", "1001-1011"),
        ("0-9", "1001-1010"),
    ],
)
def test_a_range_outside_of_the_shot_names_the_frames_of_the_shot(
    shot: Path, requested: str, suggested: str
) -> None:
    done = animtool("bake", shot, "--range", requested)
    assert done.code == 2
    assert "SCN042" in done.stderr
    assert f"--range {requested} " in done.stderr
    assert "1001 to 1058" in done.stderr
    assert f"write --range {suggested}\n" in done.stderr
    assert animtool("bake", shot, "--range", suggested).code == 0
