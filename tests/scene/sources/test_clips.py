from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from support.clips import hero, write_clip
from support.faults import raises

from animtool.clip.file import load_clip, open_clip
from animtool.clip.sample import sample_channels
from animtool.core.errors import AnimtoolError
from animtool.rig.skeleton import Rig
from animtool.scene.sources.clips import open_clip_source
from animtool.scene.sources.open import open_source
from animtool.validation.run import validate

CURL = """\
- {target: control/curl, keys: [{t: 1, v: 0}, {t: 9, v: 2}]}
"""


def test_blocks_and_curve_agree(tmp_path: Path) -> None:
    rig = hero(tmp_path)
    path = write_clip(tmp_path, CURL)
    stream = open_clip_source(path)
    assert (stream.start, stream.step, stream.count) == (1, 1, 9)
    (block,) = list(stream.blocks)
    assert stream.curve is not None
    times = np.arange(1.0, 10.0)
    clip = load_clip(open_clip(path), rig)
    for motion in (block, stream.curve(times)):
        expected = sample_channels(clip.channels, rig, times).motion.rotations
        np.testing.assert_array_equal(motion.rotations.values, expected.values)
    assert {note.path for note in stream.notices} == {str(path)}


def test_values_outside_limits_are_told_at_their_keys(tmp_path: Path) -> None:
    rig = tmp_path / "pin.rig.yaml"
    rig.write_text(
        "rig: animtool/1\nname: pin\njoints:\n- {name: a, type: free}\n"
        "- {name: b, parent: a, type: pin, axis: [0, 0, 1], limits: [0, 90]}\n"
        "- {name: c, parent: b, type: pin, axis: [0, 0, 1], limits: [0, 10]}\n"
        "controls:\n- {name: curl, range: [0, 1], "
        "drives: [{joint: c.angle, expr: curl * 9}]}\n",
        "utf-8",
    )
    path = tmp_path / "pin.clip.yaml"
    path.write_text(
        "clip: animtool/1\nrig: pin.rig.yaml\nfps: 24\nchannels:\n"
        "- target: control/curl\n  keys:\n"
        "  - {t: 1, v: 0}\n  - {t: 9, v: 2}\n"
        "- target: joint/b.angle\n  keys:\n"
        "  - {t: 1, v: 95}\n  - {t: 9, v: 0}\n",
        "utf-8",
    )
    stream = open_clip_source(path)
    list(stream.blocks)
    wanted = {("CLIP101", (8,), 5), ("CLIP102", (11,), 5), ("CLIP102", (8,), 5)}
    assert {(n.code, n.lines, n.column) for n in stream.notices} == wanted
    assert {(n.code, n.lines, n.column) for n in validate(path)} >= wanted


def test_a_clip_without_a_rig(tmp_path: Path) -> None:
    hero(tmp_path)
    path = write_clip(tmp_path, CURL)
    path.write_text(path.read_text().replace("rig: hero.rig.yaml\n", ""))
    with pytest.raises(AnimtoolError) as caught:
        open_clip_source(path)
    assert caught.value.code == "CLIP011"
    assert open_clip_source(path, rig=tmp_path / "hero.rig.yaml").count == 9


def test_a_range_of_days_is_refused_before_the_work(tmp_path: Path) -> None:
    hero(tmp_path)
    path = write_clip(tmp_path, CURL, "fps: 24\nrange: [0, 9.0e8]")
    with pytest.raises(AnimtoolError) as caught:
        open_clip_source(path)
    (fault,) = caught.value.faults
    assert (fault.code, fault.path, fault.lines) == ("CLIP006", str(path), (4,))


def test_keys_that_are_days_apart_have_their_place(tmp_path: Path) -> None:
    hero(tmp_path)
    path = write_clip(tmp_path, CURL.replace("t: 9,", "t: 9.0e8,"))
    with pytest.raises(AnimtoolError) as caught:
        open_clip_source(path)
    (fault,) = caught.value.faults
    assert (fault.code, fault.lines, fault.where) == ("CLIP006", (5,), "channels")


def test_an_expression_without_a_value_names_the_clip(tmp_path: Path) -> None:
    hero(tmp_path)
    rig = tmp_path / "hero.rig.yaml"
    rig.write_text(rig.read_text().replace("curl * 90", "90 / (curl - 1)"))
    path = write_clip(tmp_path, CURL.replace("keys", "interp: linear, keys"))
    with pytest.raises(AnimtoolError) as caught:
        list(open_clip_source(path).blocks)
    (fault,) = caught.value.faults
    assert (fault.code, fault.path) == ("CLIP015", str(path))
    assert "frame 5" in fault.message


@pytest.mark.parametrize(
    ("name", "code"),
    [
        ("none.rig.yaml", "IO001"),
        ("none", "IO001"),
        ("none.txt", "IO001"),
        ("folder.bvh", "IO001"),
        ("rig.txt", "IO002"),
        ("shot.clip.yaml", "DOC009"),
    ],
)
def test_what_is_no_rig(tmp_path: Path, name: str, code: str) -> None:
    write_clip(tmp_path, CURL)
    (tmp_path / "rig.txt").write_text("")
    (tmp_path / "folder.bvh").mkdir()
    with pytest.raises(AnimtoolError) as caught:
        Rig.load(tmp_path / name)
    assert caught.value.code == code


def test_a_missing_rig_has_its_place_in_the_clip(tmp_path: Path) -> None:
    path = tmp_path / "nod.clip.yaml"
    path.write_text(
        "clip: animtool/1\nrig: none.rig.yaml\nfps: 24\nchannels: []\nrange: [9, 1]\n",
        encoding="utf-8",
    )
    with pytest.raises(AnimtoolError) as caught:
        open_source(path)
    found = [(f.code, f.lines[0], f.column) for f in caught.value.faults]
    assert found == [("DOC015", 2, 6), ("CLIP006", 5, 8)]
    assert caught.value.faults[0].message == "'none.rig.yaml' does not exist"


def test_no_take_is_read_from_a_scene(tmp_path: Path) -> None:
    path = tmp_path / "shot.scene.yaml"
    path.write_text("scene: animtool/1\nsource: {file: walk.bvh}\n", encoding="utf-8")
    with raises(AnimtoolError, "IO002"):
        open_source(path)
