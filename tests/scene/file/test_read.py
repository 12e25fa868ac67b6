"""Scene files: a source, passes in order, an output."""

from __future__ import annotations

import json
import shutil
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest
from support.cli import animtool
from support.faults import raises, refused

from animtool import bake, open_source
from animtool.core.errors import FormatError
from animtool.edit.mirroring import mirror
from animtool.edit.retiming import trim
from animtool.scene.file.read import load_scene
from animtool.scene.scene import Scene

GOOD = """scene: animtool/1
source: {file: walk.bvh, units: cm}
passes:
- mirror:
- trim: {first: 5, last: 20}
output: {file: shot.usda, start: 1001}
"""


@pytest.fixture
def shot(walk: Path, tmp_path: Path) -> Path:
    shutil.copy(walk, tmp_path / "walk.bvh")
    path = tmp_path / "shot.scene.yaml"
    path.write_text(GOOD, "utf-8")
    return path


def test_passes_run_in_order(shot: Path) -> None:
    take = load_scene(shot).open().collect()
    source = open_source(shot.parent / "walk.bvh").collect()
    expected = trim(mirror(source), 5, 20)
    assert take.clock == expected.clock
    for ours, theirs in zip(take.motion.dense(), expected.motion.dense(), strict=True):
        if ours is not None:
            np.testing.assert_array_equal(ours, theirs)


def test_a_scene_bakes_to_the_file_it_names(shot: Path) -> None:
    done = animtool("bake", shot)
    assert done.code == 0, done.stderr
    text = (shot.parent / "shot.usda").read_text("utf-8")
    assert "startTimeCode = 1001\n" in text
    assert "endTimeCode = 1016\n" in text


@pytest.mark.parametrize(
    ("entry", "key", "word"),
    [
        ("- mirror:\n  trim: {first: 5}", "trim", "{mirror: {}}, {trim: {first: 5}}"),
        ("- mirror: {}\n  trim:", "trim", "{mirror: {}}, {trim: {}}"),
        ("- {mirror: , loop: , trim: }", "loop", "{mirror: {}}, {loop: {}}, {trim"),
        # A key that is an option of the pass too.
        ("- loop:\n  blend: 12", "blend", "loop: {blend: 12}"),
    ],
)
def test_passes_without_their_dash(shot: Path, entry: str, key: str, word: str) -> None:
    text = GOOD.replace("- mirror:\n- trim: {first: 5, last: 20}", entry)
    shot.write_text(text, "utf-8")
    with pytest.raises(FormatError) as caught:
        load_scene(shot)
    [fault] = caught.value.faults
    assert (fault.code, fault.where) == ("DOC022", f"passes[0].{key}")
    assert word in (fault.hint or "")


@pytest.mark.parametrize("weight", ["{1: 0, 12: 1}", '{"1": 0, "12": 1}'])
def test_a_weight_over_time_is_told_as_pairs(shot: Path, weight: str) -> None:
    layer = f"- layer: {{take: walk.bvh, weight: {weight}}}"
    shot.write_text(GOOD.replace("- mirror:", layer), "utf-8")
    with pytest.raises(FormatError) as caught:
        load_scene(shot)
    [fault] = caught.value.faults
    assert fault.hint == "write weight: [[1, 0], [12, 1]]"


def test_a_bake_reads_its_scene_once(
    shot: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    read: list[Path] = []

    def counted(path: Path | str, variables: Mapping[str, str]) -> Scene:
        read.append(Path(path))
        return load_scene(path, variables)

    monkeypatch.setattr("animtool.scene.file.read.load_scene", counted)
    assert animtool("bake", shot, "--skip-existing").code == 0
    assert read == [shot]


def test_a_scene_that_is_loaded_is_baked(shot: Path) -> None:
    scene = load_scene(shot)
    report = bake(scene, shot.parent / "one.usda")
    assert report.takes[0].source == shot
    assert animtool("bake", shot).code == 0
    one, other = (shot.parent / name for name in ("one.usda", "shot.usda"))
    assert one.read_bytes() == other.read_bytes()


def test_the_command_line_comes_first(shot: Path, tmp_path: Path) -> None:
    done = animtool("bake", shot, "-o", tmp_path / "mine.usda", "--start", "1")
    assert done.code == 0, done.stderr
    assert "startTimeCode = 1\n" in (tmp_path / "mine.usda").read_text("utf-8")


FAULTS = {
    "SCN010": ("mirror:", "miror:", 4),
    "SCN001": ("first: 5", "frist: 5", 5),
    "SCN002": ("last: 20", "last: [x]", 5),
    "DOC014": ("file: walk.bvh", "file: ../../walk.bvh", 2),
    "DOC015": ("file: walk.bvh", "file: none.bvh", 2),
    "DOC004": ("output:", "passes:", 6),
    "DOC009": ("scene:", "rig:", 1),
    "DOC020": ("output:", "outptu:", 6),
    "DOC021": ("source:", "# source:", 1),
    "DOC022": ("units: cm", "units: miles", 2),
    "DOC012": ("animtool/1", "animtool/2", 1),
}


@pytest.mark.parametrize("code", FAULTS)
def test_each_fault_has_its_line(shot: Path, code: str) -> None:
    old, new, line = FAULTS[code]
    shot.write_text(GOOD.replace(old, new, 1), "utf-8")
    with refused((code, line)):
        load_scene(shot)


@pytest.mark.parametrize(
    ("line", "code"),
    [("range: [9, 1]", "SCN003"), ("fps: fast", "SCN022")],
)
def test_time_that_makes_no_sense(shot: Path, line: str, code: str) -> None:
    shot.write_text(GOOD + line + "\n", "utf-8")
    with pytest.raises(FormatError) as caught:
        load_scene(shot)
    assert caught.value.code == code


def test_every_file_to_read_must_be_there(shot: Path) -> None:
    text = (
        "scene: animtool/1\nrig: none.rig.yaml\nsource: {file: nod.clip.yaml}\n"
        "output: {file: new.usda, rig_layer: none.usda}\n"
    )
    shot.write_text(text, "utf-8")
    with pytest.raises(FormatError) as caught:
        load_scene(shot)
    said = [(f.code, f.lines[0], f.where) for f in caught.value.faults]
    assert said == [
        ("DOC015", 2, "rig"),
        ("DOC015", 3, "source.file"),
        ("DOC015", 4, "output.rig_layer"),
    ]


def test_two_faults_are_said_at_once(shot: Path) -> None:
    text = GOOD.replace("mirror:", "miror:").replace("first: 5", "frist: 5")
    shot.write_text(text, "utf-8")
    done = animtool("bake", shot)
    assert done.code == 3
    assert done.stderr.count("shot.scene.yaml:") == 2
    assert not (shot.parent / "shot.usda").exists()


def test_what_a_pass_says_is_reported(shot: Path) -> None:
    shot.write_text(GOOD.replace("mirror:", "loop: {find: true}"), "utf-8")
    done = animtool("bake", shot)
    assert done.code == 0
    assert ":4:9: note: SCN102 passes[0].loop: the best cycle: frames" in done.stderr
    poor = GOOD.replace("mirror:", "loop: {first: 1, last: 17, repeats: 2}")
    shot.write_text(poor, "utf-8")
    done = animtool("bake", shot, "--strict", "--overwrite")
    assert done.code == 1
    assert "SCN101" in done.stderr


MIXED = """\
scene: animtool/1
rigg: hero.rig.yaml
fps: fast
range: [9, 1]
source: {file: ../../walk.bvh, units: miles}
passes:
- miror:
- trim: {frist: 5, last: [x]}
- loop: 7
output: {file: shot.usda, start: now}
"""
MIXED_FAULTS = [
    ("DOC020", 2),
    ("SCN022", 3),
    ("SCN003", 4),
    ("DOC014", 5),
    ("DOC022", 5),
    ("SCN010", 7),
    ("SCN001", 8),
    ("SCN002", 8),
    ("DOC022", 9),
    ("DOC022", 10),
]


def test_ten_mixed_faults_in_one_go(shot: Path) -> None:
    shot.write_text(MIXED, "utf-8")
    done = animtool("bake", shot)
    assert done.code == 3
    said = [line.removeprefix(f"{shot}:").split() for line in done.fault_lines]
    assert [(c, int(at.split(":")[0])) for at, c, *_ in said] == MIXED_FAULTS
    assert sorted(p.name for p in shot.parent.iterdir()) == [
        "shot.scene.yaml",
        "walk.bvh",
    ]


def test_a_source_that_is_missing_hides_nothing(shot: Path) -> None:
    text = GOOD.replace("source:", "#").replace("mirror:", "miror:")
    shot.write_text(text, "utf-8")
    with refused(("DOC021", 1), ("SCN010", 4)):
        load_scene(shot)


MANY = """scene: animtool/1
source: {file: walk.bvh, units: cm}
passes:
- trim: {first: 50, last: 5}
- time_scale: {speed: 0}
- loop: {repeats: -1}
- layer: {take: nope.bvh, weight: 3}
- blend: {weight: [[1, 0], [1]]}
- resample: {fps: 0}
- root_motion: {axes: q}
- time_warp: {curve: [[2, 1], [1, 1]]}
"""


def test_options_are_checked_before_there_is_a_take(shot: Path) -> None:
    shot.write_text(MANY, "utf-8")
    done = animtool("bake", shot, "-o", shot.parent / "o.usda")
    assert done.code == 3
    said = [line.removeprefix(f"{shot}:").split() for line in done.fault_lines]
    assert [(c, int(at.split(":")[0])) for at, c, *_ in said] == [
        ("SCN013", 4),
        ("SCN016", 5),
        ("SCN018", 6),
        ("DOC015", 7),
        ("SCN014", 7),
        ("SCN002", 8),
        ("SCN022", 9),
        ("SCN020", 10),
        ("SCN015", 11),
    ]
    assert "tuple" not in done.stderr


@pytest.mark.parametrize(
    ("entry", "code"),
    [
        ("trim: {first: 100, last: 200}", "SCN013"),
        ("loop: {first: 100}", "SCN013"),
        ("mirror: {pairs: [[LeftLeg, RightArm]]}", "SCN019"),
        ("layer: {take: walk.bvh, joints: [Nose]}", "SCN012"),
    ],
)
def test_what_a_pass_finds_in_a_take_has_the_place_of_the_pass(
    shot: Path, entry: str, code: str
) -> None:
    # Two others behind it read its blocks, and are not to blame.
    text = GOOD.replace("trim: {first: 5, last: 20}", f"{entry}\n- mirror:\n- loop:")
    shot.write_text(text, "utf-8")
    with pytest.raises(FormatError) as caught:
        load_scene(shot).open().collect()
    [fault] = caught.value.faults
    name = entry.partition(":")[0]
    assert (fault.code, fault.path) == (code, str(shot))
    assert (fault.lines, fault.where) == ((5,), f"passes[1].{name}")


TEMPLATE = """scene: animtool/1
variables: {capture: walk, rate: 24}
fps: ${rate}
source:
  file: ${capture}.bvh
passes:
- trim:
    first: ${first}
    last: 20
output: {file: "${capture}_${rate}.usda"}
"""


def test_variables_of_the_command_line(shot: Path) -> None:
    shot.write_text(TEMPLATE, "utf-8")
    done = animtool("bake", shot, "--set", "first=5", "--set", "rate=30")
    assert done.code == 0, done.stderr
    assert "timeCodesPerSecond = 30\n" in (shot.parent / "walk_30.usda").read_text()
    assert load_scene(shot, {"first": "6"}).variables == {"capture", "rate", "first"}


def test_the_last_value_that_the_command_line_gives_a_variable_counts(
    shot: Path,
) -> None:
    shot.write_text(TEMPLATE, "utf-8")
    twice = ("--set", "rate=30", "--set", "first=5", "--set", "rate=48")
    done = animtool("bake", shot, *twice)
    assert done.code == 0, done.stderr
    assert [path.name for path in shot.parent.glob("*.usda")] == ["walk_48.usda"]
    (found,) = json.loads(animtool("info", shot, *twice, "--format", "json").stdout)[
        "files"
    ]
    assert found["fps"] == 48


def test_variables_that_are_missing_or_spare(shot: Path) -> None:
    shot.write_text(TEMPLATE, "utf-8")
    done = animtool("bake", shot)
    assert done.code == 3
    assert f"{shot}:8:12: SCN030 passes[0].trim.first" in done.stderr
    done = animtool("bake", shot, "--set", "first=5", "--set", "frist=6")
    assert done.code == 2
    assert "SCN031" in done.stderr
    assert "did you mean 'first'?" in done.stderr
    walk = shot.with_name("walk.bvh")
    assert animtool("bake", walk, "--set", "first=5").code == 2
    assert animtool("bake", walk, "--set", "first").code == 2
    assert animtool("bake", walk, "--set", "a b=1").code == 2


def test_a_file_that_a_variable_names_may_be_anywhere(
    shot: Path, tmp_path_factory: pytest.TempPathFactory
) -> None:
    away = tmp_path_factory.mktemp("away") / "far.bvh"
    shutil.copy(shot.with_name("walk.bvh"), away)
    shot.write_text(GOOD.replace("walk.bvh", '"${input}"'), "utf-8")
    assert load_scene(shot, {"input": str(away)}).sources[0].path == away.resolve()
    outside = {"input": "../" + away.parent.name + "/far.bvh"}
    with raises(FormatError, "DOC014"):
        load_scene(shot, outside)


def test_a_pass_over_a_clip_is_not_lost_at_another_rate(tmp_path: Path) -> None:
    (tmp_path / "one.rig.yaml").write_text(
        "rig: animtool/1\nname: one\njoints: [{name: hips, type: free}]\n", "utf-8"
    )
    (tmp_path / "slide.clip.yaml").write_text(
        "clip: animtool/1\nrig: one.rig.yaml\nfps: 24\nchannels:\n"
        "- {target: joint/hips.translation,\n"
        "   keys: [{t: 1, v: [0, 0, 0]}, {t: 25, v: [0, 0, 24]}]}\n",
        "utf-8",
    )
    scene = tmp_path / "shot.scene.yaml"
    scene.write_text(
        "scene: animtool/1\nfps: 48\nsource: {file: slide.clip.yaml}\n"
        "passes: [{trim: {first: 5, last: 9}}]\n",
        "utf-8",
    )
    bake(scene, tmp_path / "shot.usda")
    take = open_source(tmp_path / "shot.usda").collect()
    moved = take.motion.translations.dense()[:, 0, 2]
    np.testing.assert_allclose(moved, np.arange(4, 8.5, 0.5), atol=1e-6)


def test_a_pass_that_is_only_a_name_is_told_how_it_is_written(tmp_path: Path) -> None:
    text = "scene: animtool/1\nsource: {file: a.bvh}\npasses:\n- mirror\n"
    (tmp_path / "a.scene.yaml").write_text(text)
    with pytest.raises(FormatError) as caught:
        load_scene(tmp_path / "a.scene.yaml")
    hints = [fault.hint for fault in caught.value.faults if fault.code == "DOC022"]
    assert hints == ["write 'mirror: {}'"]


def test_options_that_are_not_below_their_pass(tmp_path: Path) -> None:
    (tmp_path / "a.scene.yaml").write_text(
        "scene: animtool/1\nsource: {file: a.bvh}\npasses:\n- loop:\n  find: true\n"
        "  repeats: 3\n- trim:\n  options: {}\n- mirror:\n"
    )
    with pytest.raises(FormatError) as caught:
        load_scene(tmp_path / "a.scene.yaml")
    faults = [fault for fault in caught.value.faults if fault.code == "DOC022"]
    assert [(fault.where, fault.lines) for fault in faults] == [
        ("passes[0].find", (5,)),
        ("passes[1].options", (8,)),
    ]
    assert "loop: {find: true, repeats: 3}" in str(faults[0].hint)


def test_short_forms_are_those_in_full(tmp_path: Path) -> None:
    walk = Path("samples/walk/walk.bvh").resolve()
    (tmp_path / "walk.bvh").write_bytes(walk.read_bytes())
    short = tmp_path / "short.scene.yaml"
    short.write_text(
        "scene: animtool/1\nsource: walk.bvh\nrange: 3-9\noutput: a.usda\n", "utf-8"
    )
    full = tmp_path / "full.scene.yaml"
    full.write_text(
        "scene: animtool/1\nsource: {file: walk.bvh}\nrange: [3, 9]\n"
        "output: {file: a.usda}\n",
        "utf-8",
    )
    one, other = load_scene(short), load_scene(full)
    assert one.outputs[0].path == other.outputs[0].path
    assert one.bake.frame_range == other.bake.frame_range
    assert one.bake.frame_range is not None


def test_short_forms_in_json_and_with_variables(tmp_path: Path) -> None:
    walk = Path("samples/walk/walk.bvh").resolve()
    (tmp_path / "walk.bvh").write_bytes(walk.read_bytes())
    path = tmp_path / "short.scene.json"
    path.write_text(
        '{"scene": "animtool/1", "source": "${take}.bvh", "output": "${take}.usda"}',
        "utf-8",
    )
    scene = load_scene(path, {"take": "walk"})
    assert scene.outputs[0].path == tmp_path / "walk.usda"
    path.write_text('{"scene": "animtool/1",\n"source": "gone.bvh"}', "utf-8")
    with raises(FormatError, "DOC015") as caught:
        load_scene(path)
    assert caught.value.faults[0].lines == (2,)


def test_a_value_of_the_command_line_is_named(shot: Path) -> None:
    text = shot.read_text()
    assert "last: 20" in text
    shot.write_text(text.replace("last: 20", "last: ${end}"))
    with pytest.raises(FormatError) as caught:
        load_scene(shot, {"end": "late"})
    (fault,) = caught.value.faults
    assert (fault.code, fault.path) == ("SCN002", str(shot))
    assert "variables" in (fault.hint or "")
    assert "'late'" in (fault.hint or "")
