"""Mistakes with a cause elsewhere than where they show: the fault names the cause."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from support.cli import animtool

WALK, BIPED = "samples/walk/walk.bvh", "rigs/biped/biped.rig.yaml"
FAULT = re.compile(r"(?:[^ ]+?:(\d+):[\d:]* |[^ ]+: )?(?:warning: )?([A-Z]{3,4}\d{3}) ")
ROPE = """scene: animtool/1
fps: 24
range: [1, 3]
systems:
- rope:
    name: rope
    from: [0, 1, 0]
    to: [0, 0, 0]
    count: 5
    mass: 0.3
    springs: {{structural: {{stiffness: 3e5, ratio: 0.1}}}}
    pins: [{{particles: [start]}}]
    {more}
output: {{file: rope.usda}}
"""
TARGETS = "targets: animtool/1\nunits: {length: m, angle: deg}\nfps: 24\n"


def faults(place: Path, *command: object, code: int) -> list[tuple[str, int]]:
    """Return the codes and lines of errors and warnings of a command."""
    done = animtool(*map(str, command), cwd=place)
    assert done.code == code, done.stderr
    said = f"{done.stdout}\n{done.stderr}".splitlines()
    lines = [line for line in said if "note:" not in line]
    found = map(FAULT.match, lines)
    return [(match[2], int(match[1] or 0)) for match in found if match]


def test_a_map_of_the_other_direction_is_one_fault(workplace: Path) -> None:
    (workplace / "swapped.map.yaml").write_text(
        "map: animtool/1\njoints:\n- {source: hips, target: Hips}\n"
        "- {source: elbow_l, target: LeftForeArm}\n"
    )
    command = ("retarget", WALK, "--to", BIPED, "--map", "swapped.map.yaml")
    assert faults(workplace, *command, "-o", "o.usda", code=3) == [("MAP001", 3)]


def test_a_pass_before_the_retarget_that_it_needs(workplace: Path) -> None:
    (workplace / "a.targets.yaml").write_text(
        f"{TARGETS}goals:\n- {{effector: leg_l, hold: [[4, 10]]}}\n"
    )
    (workplace / "a.scene.yaml").write_text(
        f"scene: animtool/1\nsource: {{file: {WALK}}}\npasses:\n"
        f"- ik: {{targets: a.targets.yaml}}\n- retarget: {{rig: {BIPED}}}\n"
    )
    done = animtool("bake", "a.scene.yaml", cwd=workplace)
    assert "5:14: TGT001" in done.stderr
    assert "move ik below retarget" in done.stderr


def test_a_wind_above_the_speed_limit(workplace: Path) -> None:
    more = "wind: {velocity: [6000, 0, 0]}"
    (workplace / "a.scene.yaml").write_text(ROPE.format(more=more))
    found = faults(workplace, "bake", "a.scene.yaml", code=3)
    assert found == [("SIM050", 13)]


def test_known_warnings_come_before_a_simulation_and_once(workplace: Path) -> None:
    more = "radius: 12\n    solver: symplectic_euler\n    step: 0.04"
    (workplace / "a.scene.yaml").write_text(ROPE.format(more=more))
    codes = [code for code, _ in faults(workplace, "bake", "a.scene.yaml", code=4)]
    assert codes[0] == "SIM200"
    assert codes[-1] == "SIM102"
    assert codes.count("SIM200") == 1


@pytest.mark.parametrize(
    ("goal", "expected"),
    [
        ("{effector: arm_l, hold: [4, 10]}", [("DOC022", 5)]),
        ("{effector: arm_l, position: {x: 0, y: 1, z: 0}}", [("DOC022", 5)]),
        ("{effector: arm_l, pole: [0.5, 1.4, -1]}", [("TGT002", 5)]),
    ],
)
def test_a_goal_in_another_form_is_not_empty_too(
    workplace: Path, goal: str, expected: list[tuple[str, int]]
) -> None:
    (workplace / "a.targets.yaml").write_text(f"{TARGETS}goals:\n- {goal}\n")
    command = ("ik", BIPED, "--targets", "a.targets.yaml")
    assert faults(workplace, *command, code=3) == expected


@pytest.mark.parametrize(("post", "expected"), [("linear", []), ("hold", ["TGT107"])])
def test_a_pose_after_the_targets(
    workplace: Path, post: str, expected: list[str]
) -> None:
    (workplace / "a.targets.yaml").write_text(
        f"{TARGETS}goals:\n- effector: arm_l\n"
        f"  position: {{interp: linear, post: {post}, "
        "keys: [{t: 1, v: [0.4, 1, 0.1]}, {t: 9, v: [0.4, 1, 0.101]}]}\n"
    )
    command = ("ik", BIPED, "--targets", "a.targets.yaml", "--pose", "12")
    assert [code for code, _ in faults(workplace, *command, code=0)] == expected


@pytest.mark.parametrize(
    ("point", "hinted"), [("[-0.4, 0.3, 1.2]", True), ("[-4, 1.2, 0.3]", False)]
)
def test_targets_of_the_other_up_axis(
    workplace: Path, point: str, hinted: bool
) -> None:
    (workplace / "a.targets.yaml").write_text(
        f"{TARGETS}range: [1, 1]\ngoals:\n- {{effector: arm_r, position: {point}}}\n"
    )
    done = animtool("ik", BIPED, "--targets", "a.targets.yaml", cwd=workplace)
    assert "IK101" in done.stderr
    assert ("[x, z, -y]" in done.stderr) is hinted


@pytest.mark.parametrize(
    ("point", "joint"),
    [
        ("[-0.25, 0.35, 0.1]", "hips"),
        ("[-0.2, -0.4, 0.1]", "shoulder"),
        ("[-4, 9, 2]", ""),
    ],
)
def test_targets_relative_to_a_joint(workplace: Path, point: str, joint: str) -> None:
    (workplace / "a.targets.yaml").write_text(
        f"{TARGETS}range: [1, 1]\ngoals:\n- {{effector: arm_r, position: {point}}}\n"
    )
    done = animtool("ik", BIPED, "--targets", "a.targets.yaml", cwd=workplace)
    (line,) = [line for line in done.stderr.splitlines() if "IK101" in line]
    meant = re.search(r"relative to '(\w+)', add its position at rest, \[.*\]$", line)
    assert (meant[1] if meant else "").startswith(joint)
    assert (meant is None) == (joint == "")


@pytest.mark.parametrize(
    ("left", "right", "crossed"),
    [
        ("[-0.4, 1.1, 0.2]", "[0.4, 1.1, 0.2]", True),
        ("[0.4, 1.1, 0.2]", "[-0.4, 1.1, 0.2]", False),
        ("[0, 1.1, 0.3]", "[0, 1.15, 0.3]", False),
    ],
)
def test_targets_of_left_and_right(
    workplace: Path, left: str, right: str, crossed: bool
) -> None:
    (workplace / "a.targets.yaml").write_text(
        f"{TARGETS}range: [1, 2]\ngoals:\n- {{effector: arm_l, position: {left}}}\n"
        f"- {{effector: arm_r, position: {right}}}\n"
    )
    done = animtool("ik", BIPED, "--targets", "a.targets.yaml", cwd=workplace)
    assert done.code == 0, done.stderr
    assert ("TGT111 goals[0]" in done.stderr) is crossed


@pytest.mark.parametrize(
    "text", ["k=50:200:50", "k=50:50:200", "50:200:50", "k=50..200..50"]
)
def test_a_range_of_another_notation(workplace: Path, text: str) -> None:
    (workplace / "a.scene.yaml").write_text(
        f"scene: animtool/1\nsource: {{file: {WALK}}}\n"
        "passes: [{time_scale: {speed: '${k}'}}]\n"
    )
    command = ("batch", "--scene", "a.scene.yaml", "-o", "o/{k}.usda", "-n", "--vary")
    done = animtool(*command, text, cwd=workplace)
    assert done.code == 2
    assert "BAT064" in done.stderr
    assert "50..200/50" in done.stderr


def test_a_tolerance_in_metres(workplace: Path) -> None:
    for command in (("bake", WALK, "-o", "a.usda"), ("convert", WALK, "a.clip.yaml")):
        for tolerance, expected in (("5m", [("CLIP120", 0)]), ("5mm", [])):
            options = ("--reduce", tolerance, "--overwrite")
            assert faults(workplace, *command, *options, code=0) == expected


def test_frames_that_a_take_lacks_have_a_line(workplace: Path) -> None:
    head = f"scene: animtool/1\nfps: 24\nsource: {{file: {WALK}}}\noutput: a.usda\n"
    scene = workplace / "a.scene.yaml"
    scene.write_text(f"{head}shot: {{start: 1, cut: [9, 99], handles: 4}}\n")
    found = faults(workplace, "bake", scene, code=0)
    assert found == [("SCN074", 5), ("SCN106", 5)]
    scene.write_text(f"{head}shot: {{start: 1, cut: [900, 990]}}\n")
    assert faults(workplace, "bake", scene, "--overwrite", code=2) == [("SCN042", 5)]


@pytest.mark.parametrize(
    ("passes", "hint"),
    [
        (f"retarget: {BIPED}", f"retarget: {{rig: {BIPED}}}"),
        ("trim: [5, 60]", "trim: {first: 5, last: 60}"),
        ("simulate: {what: [a], gravity: [0, -9.8, 0]}", "gravity: 9.8"),
        ("layer: {take: a.bvh, weight: [0, 1]}", "[[1, 0], [24, 1]]"),
    ],
)
def test_the_form_of_a_pass(workplace: Path, passes: str, hint: str) -> None:
    (workplace / "a.bvh").write_text((workplace / WALK).read_text())
    (workplace / "a.scene.yaml").write_text(
        f"scene: animtool/1\nsource: {{file: {WALK}}}\npasses:\n- {passes}\n"
    )
    done = animtool("bake", "a.scene.yaml", cwd=workplace)
    assert done.code == 3
    assert ":4:" in done.stderr
    assert hint in done.stderr


def test_numbers_apart_from_their_option(workplace: Path) -> None:
    for option in (("--samples", "-.25", ".25"), ("--range", "1", "24")):
        done = animtool("bake", WALK, "-o", "a.usda", *option, cwd=workplace)
        assert done.code == 3
        assert f"IO001 does not exist; a value of {option[0]}" in done.stderr


def test_letters_for_digits(workplace: Path) -> None:
    for command in (("explain", "MOT2O8"), ("validate", WALK, "--ignore", "MOT2O8")):
        done = animtool(*command, cwd=workplace)
        assert done.code == 2
        assert "'MOT208'" in done.stderr


def test_a_prim_that_does_not_begin_as_one(workplace: Path) -> None:
    (workplace / "a.usda").write_text('#usda 1.0\ndef "a"\n{\n    on Xform "b" {}\n}\n')
    done = animtool("bake", "a.usda", "-o", "b.usda", cwd=workplace)
    assert "a.usda:4:" in done.stderr
    assert "def, over or class" in done.stderr


def test_a_driver_in_radians(workplace: Path) -> None:
    (workplace / "a.rig.yaml").write_text(
        "rig: animtool/1\nname: a\njoints:\n- {name: a, type: pin, axis: X}\n"
        "- {name: b, type: pin, parent: a, axis: X, driven: {expr: curl * 1.5708}}\n"
        "controls:\n- {name: curl, range: [0, 1]}\n"
    )
    assert faults(workplace, "validate", "a.rig.yaml", code=0) == [("RIG112", 5)]


@pytest.mark.parametrize(
    ("command", "hint"),
    [
        (("retarget", WALK, BIPED, "-o", "o.usda"), f"write --to {BIPED}"),
        (("convert", WALK, "--to", "usda"), "OUTPUT is an argument"),
        (("plugins", "list"), "options only"),
        (("batch", WALK, "--scene", "a.batch.yaml", "-o", "o.usda"), "run it"),
        (("job", "a.batch.yaml", "--task-seconds", "00:10:00"), "above 0"),
        (("job", "a.scene.yaml", "-o", "jobs"), "scene: a.scene.yaml"),
    ],
)
def test_an_argument_in_another_place(
    workplace: Path, command: tuple[str, ...], hint: str
) -> None:
    for name in ("a.batch.yaml", "a.scene.yaml"):
        (workplace / name).touch()
    done = animtool(*command, cwd=workplace)
    assert done.code == 2
    assert hint in done.stderr


def test_a_missing_file_that_would_be_replaced_is_missing(workplace: Path) -> None:
    done = animtool("bake", "gone.usdc", cwd=workplace)
    assert done.code == 3
    assert "IO001" in done.stderr
    assert "OUT003" not in done.stderr


def test_a_stage_of_a_frame_a_second_is_said(workplace: Path) -> None:
    assert animtool("bake", WALK, "-o", "a.usda", cwd=workplace).code == 0
    layer = workplace / "a.usda"
    text = layer.read_text("utf-8")
    layer.write_text(text.replace("timeCodesPerSecond = 30", "timeCodesPerSecond = 1"))
    command = ("bake", layer, "-o", "b.usda")
    assert faults(workplace, *command, code=0) == [("TAKE009", 0)]


def test_a_key_of_another_list_is_named(root: Path, tmp_path: Path) -> None:
    """Of a map file: a joint has no share, an entry of twists has."""
    path = tmp_path / "a.map.yaml"
    path.write_text(
        "map: animtool/1\njoints:\n"
        "- {source: LeftArm, target: shoulder_l, share: 0.5}\n"
    )
    arguments = ["--to", root / BIPED, "--map", path, "-o", tmp_path / "a.usdc"]
    done = animtool("retarget", root / WALK, *arguments)
    assert "a.map.yaml:3:41: DOC020" in done.stderr
    assert "'twists'" in done.stderr
    assert "{joint: …, bone: …, share: 0.5}" in done.stderr
    text = path.read_text()
    path.write_text(text.replace("share: 0.5", "name: 0.5"))
    done = animtool("retarget", root / WALK, *arguments)
    assert "DOC020" in done.stderr
    assert "write it there" not in done.stderr


def test_a_range_with_a_space_is_joined(workplace: Path) -> None:
    done = animtool("bake", WALK, "-o", "o.usda", "--range", 11, 48, cwd=workplace)
    assert done.code == 3
    assert "write --range 11-48" in done.stderr


def test_joints_that_mimic_each_other_are_one_fault(workplace: Path) -> None:
    left = "{name: a, parent: base, type: pin, axis: [0, 0, 1], mimic: {joint: b}}"
    right = left.replace("name: a", "name: b").replace("joint: b", "joint: a")
    (workplace / "grip.rig.yaml").write_text(
        "rig: animtool/1\nname: grip\njoints:\n- {name: base, type: fixed}\n"
        f"- {left}\n- {right}\n"
    )
    assert faults(workplace, "validate", "grip.rig.yaml", code=1) == [("RIG009", 5)]
