"""``animtool retarget``: from files to files, with its report and its exit codes."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import pytest
from numpy.testing import assert_array_equal
from support.cli import animtool
from support.suite import some_quick
from support.usd import joint_positions, open_stage, validation_errors

from animtool import open_source

BIPED, WALK = "rigs/biped/biped.rig.yaml", "samples/walk/walk.bvh"


def run(root: Path, *arguments: object, source: str | Path = WALK) -> Any:
    return animtool("retarget", root / source, "--to", root / BIPED, *arguments)


def test_a_report_alone_writes_nothing(root: Path, tmp_path: Path) -> None:
    done = animtool("retarget", root / WALK, "--to", root / BIPED, cwd=tmp_path)
    assert done.code == 0, done.stderr
    assert "scaled); soles within" in done.stderr
    assert "not mapped, of the rig: jaw" in done.stderr
    assert not list(tmp_path.iterdir())


def test_a_report_begins_with_a_verdict(root: Path, tmp_path: Path) -> None:
    assert run(root).stderr.startswith("good\n")
    found = json.loads(run(root, "--format", "json").stdout)
    assert next(iter(found.items())) == ("verdict", "good")
    lamp = tmp_path / "lamp.rig.yaml"
    lamp.write_text(LAMP, "utf-8")
    job = ("retarget", root / WALK, "--to", lamp, "--force-fit", "--format", "json")
    forced = json.loads(animtool(*job).stdout)
    assert forced["verdict"] == "not usable"
    assert len(forced["look_at"]) == 1


@pytest.mark.slow
@pytest.mark.parametrize("suffix", ["usda", "bvh", "clip.yaml"])
def test_frames_are_those_that_bake_writes_of_the_whole(
    root: Path, tmp_path: Path, suffix: str
) -> None:
    options = ("--fps", 24, "--start", 1001, "--range", "1005-1030")
    whole, part, other = (tmp_path / f"{n}.usda" for n in ("whole", "part", "other"))
    assert run(root, "-o", whole).code == 0
    assert animtool("bake", whole, "-o", part, *options).code == 0
    output = other if suffix == "usda" else tmp_path / f"other.{suffix}"
    rig = tmp_path / "rig.usda"
    assert animtool("convert", root / BIPED, rig).code == 0
    done = animtool("retarget", root / WALK, "--to", rig, "-o", output, *options)
    assert done.code == 0, done.stderr
    if suffix != "usda":
        units = ["--units", "m"] if suffix == "bvh" else []
        made = animtool("bake", output, "-o", other, *units, "--fps", 24)
        assert made.code == 0, made.stderr
    wanted, found = (open_source(path).collect() for path in (part, other))
    assert (found.clock.count, found.clock.fps) == (26, 24)
    assert suffix != "usda" or found.clock.start == wanted.clock.start == 1005
    order = [found.rig.index(name) for name in wanted.rig.names]
    off = found.world().positions[:, order] - wanted.world().positions
    assert abs(off).max() < (2e-3 if suffix == "clip.yaml" else 1e-5)


def test_a_range_outside_of_the_take_is_refused(root: Path, tmp_path: Path) -> None:
    done = run(root, "-o", tmp_path / "a.bvh", "--range", "2000-2001")
    assert done.code == 2
    assert not list(tmp_path.iterdir())


def test_the_report_in_json(root: Path) -> None:
    found = json.loads(run(root, "--format", "json").stdout)
    assert (found["retarget"], found["frames"]) == ("animtool/1", 64)
    assert found["drift_max"] < 1e-3
    hand = next(pair for pair in found["joints"] if pair["target"] == "wrist_l")
    assert hand["source"] == "LeftHand"
    assert hand["role"] == "hand_l"


@pytest.mark.slow
@pytest.mark.parametrize("suffix", some_quick(["usda", "usdc", "bvh", "clip.yaml"], 2))
def test_takes_are_written(root: Path, tmp_path: Path, suffix: str) -> None:
    outputs = [tmp_path / name / f"out.{suffix}" for name in "ab"]
    for output in outputs:
        output.parent.mkdir()
        done = run(root, "-o", output)
        assert done.code == 0, done.stderr
    assert outputs[0].read_bytes() == outputs[1].read_bytes()
    if suffix == "usda":
        stage = open_stage(outputs[0])
        assert not validation_errors(stage)
        assert stage.GetEndTimeCode() - stage.GetStartTimeCode() == 63


def test_a_map_that_was_written_gives_the_same_take(root: Path, tmp_path: Path) -> None:
    first, again = tmp_path / "a.bvh", tmp_path / "b.bvh"
    map_file = tmp_path / "walk.map.yaml"
    assert run(root, "-o", first, "--write-map", map_file).code == 0
    assert map_file.read_text("utf-8").splitlines()[1] == "map: animtool/1"
    done = run(root, "-o", again, "--map", map_file)
    assert done.code == 0, done.stderr
    assert first.read_bytes() == again.read_bytes()


@pytest.mark.parametrize(
    ("arguments", "code", "text"),
    [
        (["--rest", "frame:65"], 2, "MAP006"),
        (["--preset", "mixamoo"], 2, "MAP003 --preset: "),
        (["--target-preset", "mixamoo"], 2, "MAP003 --target-preset: "),
        (["--by", "looks"], 2, "auto"),
        (["--write-map", "out.yaml"], 2, "OUT004"),
        (["-o", "out.fbx"], 2, "OUT004"),
    ],
)
def test_what_makes_no_sense_is_refused(
    root: Path, tmp_path: Path, arguments: list[str], code: int, text: str
) -> None:
    done = animtool(
        "retarget", root / WALK, "--to", root / BIPED, *arguments, cwd=tmp_path
    )
    assert done.code == code, done.stderr
    assert text in done.stderr
    assert not list(tmp_path.iterdir())


def test_a_skeleton_that_is_no_person_is_named(root: Path, tmp_path: Path) -> None:
    odd = tmp_path / "box.bvh"
    odd.write_text(
        "HIERARCHY\nROOT box\n{\nOFFSET 0 0 0\nCHANNELS 3 Xposition Yposition "
        "Zposition\nEnd Site\n{\nOFFSET 0 1 0\n}\n}\nMOTION\nFrames: 1\n"
        "Frame Time: 0.04\n0 0 0\n",
        "utf-8",
    )
    done = run(root, "-o", tmp_path / "out.usdc", source=odd)
    assert done.code == 2
    assert "MAP004" in done.stderr
    assert not (tmp_path / "out.usdc").exists()


def test_the_pass_gives_what_the_command_does(root: Path, tmp_path: Path) -> None:
    scene = tmp_path / "walk.scene.yaml"
    shutil.copytree(root / "rigs/biped", tmp_path / "biped")
    shutil.copy(root / WALK, tmp_path)
    scene.write_text(
        "scene: animtool/1\nsource: {file: walk.bvh}\npasses:\n"
        "- retarget: {rig: biped/biped.rig.yaml}\n",
        "utf-8",
    )
    made, wanted = tmp_path / "made.usdc", tmp_path / "wanted.usdc"
    done = animtool("bake", scene, "-o", made)
    assert done.code == 0, done.stderr
    assert run(root, "-o", wanted).code == 0
    places = [
        joint_positions(open_stage(path), range(1, 65)) for path in (made, wanted)
    ]
    assert_array_equal(*places)


LAMP = """\
rig: animtool/1
name: lamp
joints:
- {name: base, type: fixed}
- {name: swivel, type: pin, parent: base, translate: [0, .04, 0], axis: [0, 1, 0]}
- {name: elbow, type: pin, parent: swivel, translate: [0, .3, 0], axis: [0, 0, 1]}
- {name: head, type: pin, parent: elbow, translate: [0, .25, 0], axis: [0, 0, 1]}
"""


def test_a_person_does_not_go_onto_a_lamp(root: Path, tmp_path: Path) -> None:
    lamp, output = tmp_path / "lamp.rig.yaml", tmp_path / "out.bvh"
    lamp.write_text(LAMP, "utf-8")
    done = animtool("retarget", root / WALK, "--to", lamp, "-o", output)
    assert (done.code, "MAP010" in done.stderr) == (3, True)
    assert not output.exists()
    forced = animtool(
        *("retarget", root / WALK, "--to", lamp, "-o", output),
        *("--force-fit", "--format", "json"),
    )
    assert forced.code == 0, forced.stderr
    found = json.loads(forced.stdout)
    assert found["bone_angle_mean"] is None
    assert found["reach_error"] is None
    assert output.exists()


def test_what_is_driven_is_not_named_as_lacking(root: Path, tmp_path: Path) -> None:
    patch = "- {name: patch, type: pin, parent: head, axis: [0, 1, 0]%s}\nmeshes:\n"
    shutil.copytree(root / "rigs/biped", tmp_path / "biped")
    rig = tmp_path / "biped/biped.rig.yaml"
    text, missing = rig.read_text("utf-8"), []
    for driven in ("", ", driven: {expr: elbow_l.angle / 10}"):
        rig.write_text(text.replace("meshes:\n", patch % driven, 1), "utf-8")
        done = animtool("retarget", root / WALK, "--to", rig, "--format", "json")
        missing.append("patch" in json.loads(done.stdout)["unmapped_target"])
    assert missing == [True, False]


def test_a_scene_says_where_too_little_is_paired_and_what_helps(
    root: Path, tmp_path: Path
) -> None:
    shutil.copy(root / WALK, tmp_path / "walk.bvh")
    (tmp_path / "lamp.rig.yaml").write_text(LAMP, "utf-8")
    scene = tmp_path / "s.scene.yaml"
    text = (
        "scene: animtool/1\nsource: {file: walk.bvh}\npasses:\n"
        "- retarget: {rig: lamp.rig.yaml}\noutput: {file: s.usda}\n"
    )
    scene.write_text(text, "utf-8")
    done = animtool("bake", scene, "--log-format", "json")
    assert done.code == 3
    (said,) = [json.loads(line) for line in done.stderr.splitlines()]
    assert (said["code"], said["lines"]) == ("MAP010", [4])
    assert "force_fit: true" in said["hint"]
    scene.write_text(text.replace("yaml}", "yaml, force_fit: true}"), "utf-8")
    assert animtool("bake", scene).code == 0


def test_of_a_rig_that_shares_no_joint_a_person_is_refused_too(
    root: Path, tmp_path: Path
) -> None:
    ball = root / "rigs/ball/ball.rig.yaml"
    for more in ([], ["--force-fit"]):
        done = animtool("retarget", root / WALK, "--to", ball, *more, cwd=tmp_path)
        assert (done.code, "MAP010" in done.stderr) == (3, True)


def test_a_map_file_says_enough_of_what_follows_what(
    root: Path, tmp_path: Path
) -> None:
    lamp, mapped = tmp_path / "lamp.rig.yaml", tmp_path / "a.map.yaml"
    lamp.write_text(LAMP, "utf-8")
    text = "map: animtool/1\njoints:\n- {source: Head, target: head}\n"
    # Without `others`, it is not said that all other joints are to stay at rest.
    for others, code in (("", 1), ("others: none\n", 0)):
        mapped.write_text(text + others, "utf-8")
        command = "retarget", root / WALK, "--to", lamp, "--map", mapped
        done = animtool(*command)
        assert done.code == 0, done.stderr
        assert done.stderr.count("MAP010") == code
        assert animtool(*command, "--strict").code == code


def test_a_file_that_cannot_be_read_is_named_by_its_option(walk: Path) -> None:
    done = animtool("retarget", walk, "--to", walk, "--map", "W")
    assert (done.code, done.stderr) == (
        3,
        "W: IO001 --map: does not exist; it takes a file\n",
    )


def test_a_rig_without_its_folder_and_suffix_is_found(
    root: Path, tmp_path: Path
) -> None:
    walk, rigs = tmp_path / "walk.bvh", tmp_path / "rigs"
    shutil.copyfile(root / WALK, walk)
    rigs.mkdir()
    shutil.copyfile(root / "rigs/ball/ball.rig.yaml", rigs / "ball.rig.yaml")
    done = animtool("retarget", walk, "--to", "ball")
    assert done.code == 3
    assert f"IO001 --to: does not exist; write --to {rigs / 'ball.rig.yaml'}" in (
        done.stderr
    )
