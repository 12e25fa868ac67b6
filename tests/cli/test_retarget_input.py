"""Takes and rigs that lack something: each is named, with what is done instead."""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Callable
from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import pytest
from support.cli import animtool
from support.full_rigs import FULL_RIGS, full_rig
from support.usd import joint_positions, open_stage

from animtool import open_source
from animtool.core.clock import Clock
from animtool.formats.bvh.write import write_bvh
from animtool.motion.motion import Channel, Motion
from animtool.motion.take import Take

SAMPLE = Path(__file__).parents[2] / "samples/retarget"
WALK = (SAMPLE / "takes/walk.bvh").read_text("utf-8")
RIG = (SAMPLE / "rigs/child.rig.yaml").read_text("utf-8")
HEAD, _, FRAMES = WALK.partition("MOTION\n")
COUNT, TIME, *ROWS = FRAMES.splitlines()


def without_offsets() -> str:
    """Return the walk with all joints in one place."""
    return re.sub("OFFSET .*", "OFFSET 0 0 0", WALK)


def twice() -> str:
    """Return the walk of two people in one file."""
    other = HEAD.removeprefix("HIERARCHY\n")
    rows = [f"{row} {row}" for row in ROWS]
    return "\n".join([f"{HEAD}{other}MOTION", COUNT, TIME, *rows, ""])


def with_positions(zero: str = "") -> str:
    """Return the walk with position channels of 0 on joints whose names match."""
    lines, columns, name = [], [], ""
    for text in HEAD.splitlines():
        line, words = text, text.split()
        if words[:1] in (["JOINT"], ["ROOT"]):
            name = words[1]
        if words[:1] == ["CHANNELS"] and int(words[1]) == 3 and re.search(zero, name):
            line = line.replace("3 ", "6 Xposition Yposition Zposition ", 1)
            columns += [False] * 3
        if words[:1] == ["CHANNELS"]:
            columns += [True] * int(words[1])
        lines.append(line)
    rows = []
    for row in ROWS:
        values = iter(row.split())
        rows.append(" ".join(next(values) if own else "0" for own in columns))
    return "\n".join([*lines, "MOTION", COUNT, TIME, *rows, ""])


def of_two_frames() -> str:
    """Return the first two frames of the walk."""
    return "\n".join([f"{HEAD}MOTION", "Frames: 2", TIME, *ROWS[:2], ""])


def without_legs() -> str:
    """Return the walk of a skeleton that ends at its hips."""
    begin = HEAD.index("  JOINT LeftUpLeg")
    head = f"{HEAD[:begin]}}}\n"
    width = sum(map(int, re.findall(r"CHANNELS (\d)", head)))
    rows = [" ".join(row.split()[:width]) for row in ROWS]
    return "\n".join([f"{head}MOTION", COUNT, TIME, *rows, ""])


def without_fingers() -> str:
    """Return the rig with hands that end at the wrist."""
    kept = [
        re.sub(r", tips: \[\[.*?\]\]", "", line) if "name: wrist_" in line else line
        for line in RIG.splitlines()
        if not re.search("name: (thumb|index|middle|ring|pinky)_", line)
    ]
    return "\n".join(kept)


TAKES = {
    "offsets": (without_offsets, "MAP102", "joints are mapped by name only"),
    "two": (twice, "MAP103", "'Hips_2' are skipped"),
    "short": (of_two_frames, "MAP007", "no foot is held"),
    "legs": (
        without_legs,
        "MAP101",
        "root motion is scaled like the rest of the body, and no feet are held",
    ),
}


@pytest.mark.parametrize(("take", "code", "text"), TAKES.values(), ids=TAKES)
def test_a_take_that_lacks_something_is_named(
    take: Callable[[], str], code: str, text: str, tmp_path: Path
) -> None:
    path, output = tmp_path / "take.bvh", tmp_path / "out.usdc"
    path.write_text(take(), "utf-8")
    rig = SAMPLE / "rigs/child.rig.yaml"
    done = animtool("retarget", path, "--to", rig, "-o", output, "--format", "json")
    assert done.code == 0, done.stderr
    found = json.loads(done.stdout)
    (notice,) = [one for one in found["notices"] if one["code"] == code]
    assert notice["path"] == str(path)
    assert text in f"{notice['message']}, {notice['hint']}"
    frames = open_source(path).collect().clock.count
    assert len(joint_positions(open_stage(output), range(1, frames + 1))) == frames
    refused = tmp_path / "refused.usdc"
    strict = animtool("retarget", path, "--to", rig, "-o", refused, "--strict")
    assert strict.code == (0 if code == "MAP007" else 1), strict.stderr
    assert refused.exists() == (code == "MAP007")


def test_a_rig_whose_hands_have_no_ends_is_named(tmp_path: Path) -> None:
    rig = tmp_path / "child.rig.yaml"
    rig.write_text(without_fingers(), "utf-8")
    done = animtool("retarget", SAMPLE / "takes/walk.bvh", "--to", rig)
    assert done.code == 0, done.stderr
    (line,) = [line for line in done.stderr.splitlines() if "MAP104" in line]
    assert line.startswith(str(rig))
    assert (
        "'wrist_l', 'wrist_r' end; the hand is assumed to continue the forearm" in line
    )


def test_a_take_in_another_unit_is_named() -> None:
    source, rig = SAMPLE / "takes/walk.bvh", SAMPLE / "rigs/child.rig.yaml"
    done = animtool("retarget", source, "--to", rig, "--units", "m")
    assert "MAP106 the rig is 0.00544 times the size" in done.stderr
    assert "check: size 0.00544 times that of the take" in done.stderr
    assert "MAP106" not in animtool("retarget", source, "--to", rig).stderr


@pytest.mark.parametrize(
    ("written", "stated", "found"), [("cm", "1", True), ("cm", "0.01", False)]
)
def test_a_usd_take_whose_unit_is_wrong_is_named_by_its_key(
    tmp_path: Path, written: str, stated: str, found: bool
) -> None:
    """In a bake, a retarget and `validate`, as one warning each."""
    take, rig = tmp_path / "walk.usda", SAMPLE / "rigs/child.rig.yaml"
    source = SAMPLE / "takes/walk.bvh"
    done = animtool("bake", source, "-o", take, "--units", written)
    assert done.code == 0, done.stderr
    text = take.read_text("utf-8")
    assert "metersPerUnit = 0.01" in text
    changed = text.replace("metersPerUnit = 0.01", f"metersPerUnit = {stated}")
    take.write_text(changed, "utf-8")
    for command in (
        ("bake", take, "-o", tmp_path / "b.usdc"),
        ("retarget", take, "--to", rig, "-o", tmp_path / "r.usdc"),
        ("validate", take),
    ):
        done = animtool(*command)
        text = done.stdout + done.stderr
        assert text.count("MOT213") == found, text
        assert "MAP106" not in text
        assert ("set metersPerUnit = 0.01 in the file" in text) is found


def test_root_motion_without_legs_is_scaled_by_the_body(tmp_path: Path) -> None:
    """A body of twice the size goes twice as far."""
    for name, size in (("one", 1), ("two", 2)):
        text = re.sub(
            "OFFSET (.*)",
            lambda found, size=size: (
                "OFFSET " + " ".join(str(size * float(n)) for n in found[1].split())
            ),
            without_legs(),
        )
        (tmp_path / f"{name}.bvh").write_text(text, "utf-8")
    output = tmp_path / "out.bvh"
    done = animtool(
        *("retarget", tmp_path / "one.bvh", "--to", tmp_path / "two.bvh"),
        *("-o", output),
    )
    assert done.code == 0, done.stderr
    made, source = (
        open_source(path).collect().motion for path in (output, tmp_path / "one.bvh")
    )

    def travel(motion: Motion) -> list[float]:
        hips = motion.translations.dense()[:, 0]
        return list(hips[-1] - hips[0])

    assert travel(made) == pytest.approx([2 * x for x in travel(source)], abs=1e-6)


def test_a_mixamo_take_goes_onto_a_rig_of_unreal_without_a_map(tmp_path: Path) -> None:
    """Every joint follows the one of its role; those without a role are listed."""
    mixamo = {"Chest": "Spine1"}
    take, target = tmp_path / "take.bvh", tmp_path / "manny.bvh"
    take.write_text(
        re.sub(
            r"(ROOT|JOINT) (\w+)",
            lambda found: f"{found[1]} mixamorig:{mixamo.get(found[2], found[2])}",
            WALK,
        ),
        "utf-8",
    )
    rig, roles = full_rig(*FULL_RIGS["ue5_manny"])
    rig = replace(rig, meters_per_unit=0.01)
    rest = rig.rest_translations[None], rig.rest_rotations[None]
    still = Motion(*map(Channel.from_dense, rest))
    clock = Clock(Fraction(30), Fraction(1), Fraction(1), 1)
    write_bvh(Take(rig, clock, still), target)
    done = animtool("retarget", take, "--to", target, "--format", "json")
    assert done.code == 0, done.stderr
    found = json.loads(done.stdout)
    known = dict(zip(rig.names, roles, strict=True))
    pairs = {pair["target"]: pair["role"] for pair in found["joints"]}
    assert pairs == {name: known[name] for name in pairs}
    assert len(pairs) == 25
    assert found["unmapped_source"] == []
    twisted = {name for name in rig.names if "twist" in name}
    assert {*found["unmapped_target"]} == {*rig.names} - pairs.keys() - twisted
    text = animtool("retarget", take, "--to", target, "-v").stderr
    assert ", ".join(found["unmapped_target"]) in text
    outputs, map_file = [tmp_path / f"{i}.bvh" for i in "ab"], tmp_path / "m.map.yaml"
    for output, own in zip(outputs, ("--write-map", "--map"), strict=True):
        done = animtool("retarget", take, "--to", target, "-o", output, own, map_file)
        assert done.code == 0, done.stderr
    assert outputs[0].read_bytes() == outputs[1].read_bytes()
    _, _, ignored = map_file.read_text("utf-8").partition("ignored:")
    assert max(map(len, ignored.splitlines())) <= 88


@pytest.mark.slow
def test_a_take_that_fits_worse_than_asked_for_fails_under_strict(
    tmp_path: Path,
) -> None:
    """The march bends the knees further than those of the rig go."""
    for path in SAMPLE.glob("takes/[jm]*.bvh"):
        shutil.copy(path, tmp_path)
    giant = (SAMPLE / "rigs/giant.rig.yaml").read_text("utf-8")
    stiff = re.sub(r"(name: knee_l.*limits: )\[.*?\]", r"\1[0, 80]", giant)
    assert stiff != giant
    (tmp_path / "giant.rig.yaml").write_text(stiff, "utf-8")
    scene = tmp_path / "onto.scene.yaml"
    scene.write_text(
        "scene: animtool/1\nsource: {file: ${input}}\npasses:\n"
        "- retarget: {rig: giant.rig.yaml, warn_above: ${times}}\n",
        "utf-8",
    )
    command = ("batch", tmp_path, "--scene", scene, "--format", "json", "--strict")
    done = animtool(*command, "-o", f"{tmp_path}/{{stem}}.usdc", "--set", "times=2")
    assert done.code == 1
    jump, march = json.loads(done.stdout)["items"]
    assert [fault["code"] for fault in march["faults"]] == ["MAP107"]
    assert jump["status"] == "done"
    assert not (tmp_path / "march.usdc").exists()
    drift = jump["scores"][0]["scores"][0]
    assert drift["value"] <= 2 * drift["usual"]
    odd = animtool(*command, "-o", f"{tmp_path}/{{stem}}.usdc", "--set", "times=-1")
    assert "CAP001 --set: warn_above must be" in odd.stderr
    assert "passes[0].retarget.warn_above of " in odd.stderr


@pytest.mark.slow
def test_a_batch_of_them_says_of_each_what_was_done(tmp_path: Path) -> None:
    (tmp_path / "takes").mkdir()
    for name, (take, _, _) in TAKES.items():
        (tmp_path / f"takes/{name}.bvh").write_text(take(), "utf-8")
    (tmp_path / "child.rig.yaml").write_text(RIG, "utf-8")
    (tmp_path / "odd.map.yaml").write_text(
        "map: animtool/1\njoints:\n- {source: LeftArm, target: shulder_l}\n", "utf-8"
    )
    (tmp_path / "onto.scene.yaml").write_text(
        "scene: animtool/1\nsource: {file: ${input}}\npasses:\n"
        "- retarget: {rig: child.rig.yaml, map: ${map}, rest: ${rest}}\n",
        "utf-8",
    )
    batch = tmp_path / "onto.batch.yaml"
    batch.write_text(
        "batch: animtool/1\ninputs: [takes]\nscene: onto.scene.yaml\n"
        "variables: {map: '', rest: 3}\noverrides:\n"
        "- {inputs: [takes/two.bvh], variables: {map: odd.map.yaml}}\n"
        "- {inputs: [takes/offsets.bvh], variables: {rest: ''}}\n"
        "output: 'out/{stem}.usdc'\n",
        "utf-8",
    )
    done = animtool("batch", batch, "--format", "json", "-j", "2")
    assert done.code == 1
    items = {
        Path(item["input"]).stem: item for item in json.loads(done.stdout)["items"]
    }
    for name in ("offsets", "legs"):
        codes = [notice["code"] for notice in items[name]["notices"]]
        assert TAKES[name][1] in codes
        assert items[name]["scores"]
    faults = {name: items[name].get("faults", []) for name in TAKES}
    assert [fault["code"] for fault in faults["short"]] == ["MAP006"]
    assert [(f["code"], f["lines"]) for f in faults["two"]] == [("MAP001", [3])]
    assert f"  of {items['legs']['input']}" in done.stderr


@pytest.mark.parametrize("zero", ["", "Leg|Foot", "RightForeArm"])
def test_bones_without_length_are_refused_and_said(zero: str, tmp_path: Path) -> None:
    source, output = tmp_path / "zero.bvh", tmp_path / "out.bvh"
    source.write_text(with_positions(zero), "utf-8")
    rig = tmp_path / "walk.bvh"
    rig.write_text(WALK, "utf-8")
    for command in ("info", "validate", "bake"):
        where = ["-o", str(tmp_path / "a.usda")] if command == "bake" else []
        done = animtool(command, str(source), *where)
        assert (done.stdout + done.stderr).count("BVH111") == 1, command
    job = ("retarget", source, "--to", rig, "-o", output)
    done = animtool(*job)
    assert (done.code, "MAP011" in done.stderr) == (3, True)
    assert not output.exists()
    held = animtool(*job, "--positions", "offsets")
    assert held.code == 0, held.stderr
    assert "BVH111" not in held.stderr
    found = open_source(output).collect().world().positions
    expected = open_source(rig).collect().world().positions
    assert abs(found - expected).max() < 1e-4


def test_position_channels_that_say_where_joints_are_are_taken(tmp_path: Path) -> None:
    """And those of bones that are no limb's may vanish, with the warning."""
    source = tmp_path / "zero.bvh"
    source.write_text(with_positions("Toe"), "utf-8")
    rig = tmp_path / "walk.bvh"
    rig.write_text(WALK, "utf-8")
    done = animtool("retarget", source, "--to", rig)
    assert (done.code, done.stderr.count("BVH111")) == (0, 1)
    take = open_source(rig).collect()
    moving = Channel.from_dense(take.motion.translations.dense())
    free = replace(take, motion=replace(take.motion, translations=moving))
    written = tmp_path / "free.bvh"
    write_bvh(free, written)
    assert "BVH111" not in animtool("info", written).stderr


@pytest.mark.slow
def test_meshes_of_the_source_are_not_missed_in_another_rig(tmp_path: Path) -> None:
    stride = SAMPLE.parent / "stride/stride.clip.yaml"
    source = tmp_path / "stride.usdc"
    assert animtool("bake", stride, "-o", source).code == 0
    assert "USD127" in animtool("bake", source, "-o", tmp_path / "a.usdc").stderr
    rig = SAMPLE / "rigs/child.rig.yaml"
    done = animtool("retarget", source, "--to", rig, "-o", tmp_path / "b.usdc")
    assert done.code == 0, done.stderr
    assert "USD127" not in done.stderr
    (tmp_path / "animtool.toml").write_text(f'roots = ["{rig.parent}"]\n')
    scene = tmp_path / "child.scene.yaml"
    scene.write_text(
        "scene: animtool/1\nsource: stride.usdc\n"
        f"passes: [{{retarget: {{rig: {rig}}}}}]\n"
    )
    done = animtool("bake", scene, "-o", tmp_path / "c.usdc")
    assert done.code == 0, done.stderr
    assert "USD127" not in done.stderr
