"""A cut list of takes at several rates, whole: what each frame of a shot shows."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from support.cli import animtool

from animtool import BakeOptions, SourceOptions, bake, open_source
from animtool.core.rates import rate_from_float
from animtool.core.shot import Shot
from animtool.usd.layers.sdf import open_layer

otio = pytest.importorskip("opentimelineio", reason="no OpenTimelineIO (extra: otio)")

from support.timelines import clip, span, timeline  # noqa: E402

# Name, rate of the take, its frames, first second shown, seconds shown. The last has
# 4 of 8 handle frames at its end.
SHOTS = [
    ("sh010", 24, 96, 1.0, 1.0),
    ("sh020", 30, 150, 2.0, 1.5),
    ("sh030", 120, 310, 1.25, 1.1666666666666667),
]
HANDLES = 8
CAPTURE = """HIERARCHY
ROOT hips
{{
  OFFSET 0 0 0
  CHANNELS 6 Xposition Yposition Zposition Zrotation Xrotation Yrotation
  End Site
  {{
    OFFSET 0 1 0
  }}
}}
MOTION
Frames: {count}
Frame Time: {time:.10f}
{rows}
"""
TRIM = """scene: animtool/1
source: {file: "${input}"}
passes:
- trim:
    first: ${begin}
    last: ${end}
"""
CUT = """scene: animtool/1
variables: {first: 1, last: 2, handles: 0, fps: 24}
fps: ${fps}
source: {file: "${input}"}
shot:
  cut:
  - ${first}
  - ${last}
  handles: ${handles}
"""


def capture(path: Path, rate: int, count: int) -> None:
    """Write a take whose root is 1 m further in each second."""
    rows = "\n".join(f"{100 * i / rate:.9f} 0 0 0 0 0" for i in range(count))
    path.write_text(CAPTURE.format(count=count, time=1 / rate, rows=rows), "utf-8")


def edit(folder: Path, fps: float, *, own: bool) -> Path:
    """Write takes and their cut list; ranges are at the takes' rates, or the edit's."""
    clips = []
    for name, rate, count, first, seconds in SHOTS:
        capture(folder / f"{name}_take.bvh", rate, count)
        counted = rate if own else fps
        shown = span(round(first * counted), round(seconds * counted), counted)
        media = span(0, count, rate)
        clips.append(clip(name, f"{name}_take.bvh", shown, media))
    return timeline(folder / "cut.otio", *clips, rate=fps, metadata={"handles": 8})


def expected(name: str, fps: float, *, own: bool) -> tuple[Fraction, int, Fraction]:
    """Return a cut's first second, its frames, and the last second of its media."""
    _, rate, count, first, seconds = next(shot for shot in SHOTS if shot[0] == name)
    exact, counted = (
        rate_from_float(fps),
        Fraction(rate) if own else rate_from_float(fps),
    )
    within = round(seconds * float(counted)) / counted
    frames = -(-within * exact // 1)
    begin = round(first * float(counted)) / counted
    return begin, int(frames), Fraction(count - 1, rate)


@pytest.mark.parametrize(
    ("fps", "own", "scene"),
    [
        (24, True, None),
        (24, False, None),
        (24000 / 1001, True, None),
        (24, True, TRIM),
        (24000 / 1001, True, TRIM),
        (24, True, CUT),
    ],
)
def test_shots_show_the_seconds_of_the_edit(
    tmp_path: Path, fps: float, own: bool, scene: str | None
) -> None:
    edit(tmp_path, fps, own=own)
    words = ["cut.otio", "-o", "out/{shot}.usdc", "--executor", "serial"]
    if scene is not None:
        (tmp_path / "shot.scene.yaml").write_text(scene, "utf-8")
        words += ["--scene", "shot.scene.yaml"]
    done = animtool("batch", *words, cwd=tmp_path)
    assert done.code == 0, done.stderr
    warned = [line for line in done.stderr.splitlines() if "warning: " in line]
    assert len(warned) == 1
    assert "SCN106 shot sh030: the take does not have handle frames" in warned[0]
    exact = rate_from_float(fps)
    for name, *_ in SHOTS:
        begin, frames, last = expected(name, fps, own=own)
        take = open_source(tmp_path / f"out/{name}.usdc").collect()
        assert (take.clock.start, take.clock.step, take.clock.fps) == (1001, 1, exact)
        assert take.clock.count == frames + 2 * HANDLES
        shown = [
            min(begin + (i - HANDLES) / exact, last) for i in range(take.clock.count)
        ]
        found = take.world().positions[:, 0, 0]
        np.testing.assert_allclose(found, np.array(shown, float), atol=1e-6)
        layer = open_layer(tmp_path / f"out/{name}.usdc")
        shot = layer.customLayerData["animtool"]["shot"]
        assert (layer.startTimeCode, layer.endTimeCode) == (shot["start"], shot["end"])
        assert (shot["name"], shot["start"], shot["cutIn"]) == (name, 1001, 1009)
        assert shot["cutOut"] == 1009 + frames - 1
        assert (shot["head"], shot["tail"], shot["rate"]) == (8, 8, str(exact))
        assert shot["mediaIn"] == float(begin)


def test_a_shot_baked_alone_is_that_of_the_batch(tmp_path: Path) -> None:
    edit(tmp_path, 24, own=True)
    words = ["cut.otio", "-o", "out/{shot}.usdc", "--executor", "serial"]
    assert animtool("batch", *words, cwd=tmp_path).code == 0
    done = animtool("bake", "cut.otio", "--shot", "sh020", "-o", "a.usdc", cwd=tmp_path)
    assert done.code == 0, done.stderr
    made = (tmp_path / "a.usdc").read_bytes()
    assert made == (tmp_path / "out/sh020.usdc").read_bytes()


def test_shots_become_layers_over_a_rig(tmp_path: Path) -> None:
    edit(tmp_path, 24, own=True)
    one = ["bake", "sh010_take.bvh", "-o", "rig.usda", "--split", "--start", 1]
    assert animtool(*one, cwd=tmp_path).code == 0
    words = ["--shot", "sh020", "--rig-layer", "rig.rig.usda", "-o", "a.usdc"]
    done = animtool("bake", "cut.otio", *words, cwd=tmp_path)
    assert done.code == 0, done.stderr
    layer = open_layer(tmp_path / "a.usdc")
    assert (layer.startTimeCode, layer.endTimeCode) == (1001, 1052)
    (tmp_path / "job.batch.yaml").write_text(
        "batch: animtool/1\ninputs: [cut.otio]\noptions: {rig_layer: rig.rig.usda}\n"
        "output: out/{shot}.usdc\n"
    )
    done = animtool("batch", "job.batch.yaml", "--executor", "serial", cwd=tmp_path)
    assert done.code == 0, done.stderr
    made = (tmp_path / "out/sh020.usdc").read_bytes()
    assert made == (tmp_path / "a.usdc").read_bytes()


def test_a_shot_is_moved_to_targets(tmp_path: Path) -> None:
    edit(tmp_path, 24, own=True)
    (tmp_path / "level.targets.yaml").write_text(
        "targets: animtool/1\nunits: {length: cm, angle: deg}\nfps: 24\n"
        "goals: [{effector: hips, orientation: [1, 0, 0, 0]}]\n"
    )
    words = ["sh010_take.bvh", "-t", "level.targets.yaml", "--clip", "cut.otio"]
    done = animtool("ik", *words, "--shot", "sh030", "-o", "a.usdc", cwd=tmp_path)
    assert done.code == 0, done.stderr
    assert "does not have handle frames" in done.stderr
    begin, frames, last = expected("sh030", 24, own=True)
    take = open_source(tmp_path / "a.usdc").collect()
    assert (take.clock.start, take.clock.count) == (1001, frames + 2 * HANDLES)
    shown = [min(begin + Fraction(i - HANDLES, 24), last) for i in range(frames + 16)]
    found = take.world().positions[:, 0, 0]
    np.testing.assert_allclose(found, np.array(shown, float), atol=1e-6)
    shot = open_layer(tmp_path / "a.usdc").customLayerData["animtool"]["shot"]
    assert (shot["cutIn"], shot["mediaIn"]) == (1009, float(begin))
    refused = animtool("ik", *words, "--shot", "sh3", cwd=tmp_path)
    assert (refused.code, "did you mean 'sh030'" in refused.stderr) == (2, True)


def test_media_too_short_is_an_error_under_strict(tmp_path: Path) -> None:
    edit(tmp_path, 24, own=True)
    words = ["cut.otio", "-o", "out/{shot}.usdc", "--executor", "serial", "--strict"]
    done = animtool("batch", *words, cwd=tmp_path)
    assert done.code == 1
    assert "SCN106 shot sh030" in done.stderr
    names = sorted(path.name for path in (tmp_path / "out").glob("*.usdc"))
    assert names == ["sh010.usdc", "sh020.usdc"]


def test_a_source_in_a_shot_has_its_frames(tmp_path: Path) -> None:
    capture(tmp_path / "take.bvh", 30, 31)
    shot = Shot(1001, 1012, fps=Fraction(24), media_in=Fraction(1, 2))
    options = BakeOptions(source=SourceOptions(shot=shot), fps=24)
    bake(tmp_path / "take.bvh", tmp_path / "a.usdc", options)
    take = open_source(tmp_path / "a.usdc").collect()
    # The take begins half a second before the shot, and no range was asked for.
    assert (take.clock.start, take.clock.count) == (1001 - 12, 25)
    found = take.world().positions[:, 0, 0]
    np.testing.assert_allclose(found, np.arange(25) / 24, atol=1e-6)


KEYED = """clip: animtool/1
name: slide
rig: hips.rig.yaml
fps: 24
range: [1, 97]
channels:
- target: joint/hips.translation
  keys: [{t: 1, v: [0, 0, 0], interp: linear}, {t: 97, v: [4, 0, 0]}]
"""
# Name, first frame at 24 fps, frames, speed, and the seconds of the first and the last.
PLAYED = [
    ("back", 24, 48, -1.0, (71 / 24, 24 / 24)),
    ("fast", 12, 24, -2.0, (58 / 24, 12 / 24)),
    ("held", 30, 24, 0.0, (30 / 24, 30 / 24)),
    ("slow", 24, 24, 0.5, (24 / 24, 35.5 / 24)),
]


@pytest.mark.parametrize("kind", ["24 fps", "30 fps", "keys", "scene"])
def test_shots_that_play_otherwise_show_their_seconds(
    tmp_path: Path, kind: str
) -> None:
    take = "take.bvh"
    if kind == "keys":
        take = "take.clip.yaml"
        (tmp_path / "hips.rig.yaml").write_text(
            "rig: animtool/1\nname: hips\nunits: {length: m, angle: deg}\n"
            "joints:\n- {name: hips, type: free}\n"
        )
        (tmp_path / take).write_text(KEYED)
    else:
        rate = 30 if kind == "30 fps" else 24
        capture(tmp_path / take, rate, 4 * rate + 1)
    clips = []
    for name, first, count, speed, _ in PLAYED:
        made = clip(name, take, (first, count), None)
        made.effects.append(otio.schema.LinearTimeWarp(time_scalar=speed))
        clips.append(made)
    timeline(tmp_path / "cut.otio", *clips, rate=24, metadata={"handles": 4})
    words = ["cut.otio", "-o", "out/{shot}.usdc", "--executor", "serial"]
    if kind == "scene":
        (tmp_path / "shot.scene.yaml").write_text(TRIM, "utf-8")
        words += ["--scene", "shot.scene.yaml"]
    done = animtool("batch", *words, cwd=tmp_path)
    assert done.code == 0, done.stderr
    assert "SCN074" not in done.stderr
    assert "SCN106" not in done.stderr
    for name, _, count, speed, (begin, end) in PLAYED:
        found = open_source(tmp_path / f"out/{name}.usdc").collect()
        assert (found.clock.start, found.clock.count) == (1001, count + 8)
        x = found.world().positions[:, 0, 0]
        shown = begin + speed * np.arange(-4, count + 4) / 24
        assert shown[4 + count - 1] == pytest.approx(end)
        np.testing.assert_allclose(x, shown, atol=1e-6)


EDL = """TITLE: HOUR
FCM: NON-DROP FRAME

001  AX       V     C        {0} 01:00:00:00 01:00:02:00
* FROM CLIP NAME: take
"""


def test_an_edl_asks_for_its_rate_and_says_how_far_a_range_is_away(
    tmp_path: Path,
) -> None:
    capture(tmp_path / "take.bvh", 25, 251)
    (tmp_path / "a.edl").write_text(EDL.format("10:00:01:00 10:00:03:00"))
    words = ["a.edl", "take.bvh", "-o", "{shot}.usda", "--executor", "serial"]
    done = animtool("batch", *words, cwd=tmp_path)
    assert (done.code, "BAT054" in done.stderr) == (2, True)
    done = animtool("batch", *words, "--fps", 25, cwd=tmp_path)
    assert done.code == 1
    for part in ("SCN042", "10:00:01:00 to 10:00:02:24", "00:00:00:00 to 00:00:10:00"):
        assert part in done.stderr
    assert "10 hours (36001 s)" in done.stderr
    assert "--first-timecode 10:00:00:00" in done.stderr
    words += ["--first-timecode", "10:00:00:00", "--cut-start", 1001, "--handles", 2]
    done = animtool("batch", *words, "--fps", 25, "--overwrite", cwd=tmp_path)
    assert done.code == 0, done.stderr
    found = open_source(tmp_path / "take.usda").collect()
    assert (found.clock.start, found.clock.fps) == (999, 25)
    x = found.world().positions[:, 0, 0]
    np.testing.assert_allclose(x, 1 + np.arange(-2, 52) / 25, atol=1e-6)
    far = ["--fps", 25, "--first-timecode", "09:00:00:00", "--name", "far"]
    done = animtool("batch", *words[:6], *far, "--overwrite", cwd=tmp_path)
    assert "an hour (3601 s) after" in done.stderr


def test_a_frame_that_is_held_is_one_of_the_take(tmp_path: Path) -> None:
    capture(tmp_path / "take.bvh", 24, 48)
    still = clip("a", "take.bvh", (3600 * 24, 12), None)
    still.effects.append(otio.schema.FreezeFrame())
    timeline(tmp_path / "cut.otio", still, rate=24)
    done = animtool("bake", "cut.otio", "-o", "a.usda", cwd=tmp_path)
    assert (done.code, "SCN042 shot a" in done.stderr) == (2, True), done.stderr
    assert "an hour (3600 s) after" in done.stderr
