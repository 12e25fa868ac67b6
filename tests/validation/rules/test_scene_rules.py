"""Rules on scenes and what they solve, beyond the examples of their pages."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import numpy as np
import pytest
from support.props import write_props

from animtool import bake
from animtool.core.errors import FormatError, Severity
from animtool.scene.file.read import load_scene
from animtool.validation.run import validate

RIG = """\
rig: animtool/1
name: limb
joints:
- {name: base, type: TYPE, translate: [0, 1, 0]}
- {name: upper, parent: base, type: ball}
- {name: lower, parent: upper, type: pin, axis: [1, 0, 0], translate: [0, -0.4, 0]}
- {name: hand, parent: lower, type: HAND, translate: [0, -0.4, 0]}
ik: [{name: arm, root: upper, tip: hand, pole_dir: [0, 0, -1]}]
"""
CLIP = """\
clip: animtool/1
rig: limb.rig.yaml
fps: 24
channels: [{target: joint/lower.angle, keys: [{t: 1, v: 20}, {t: 12, v: 60}]}]
"""
SCENE = "scene: animtool/1\nsource: {file: limb.clip.yaml}\n"
SOLVED = f"{SCENE}passes: [{{ik: {{targets: page.targets.yaml}}}}]\n"
ROPE = """\
systems:
- rope:
    from: [0, 0.9, 0]
    to: [0.5, 0.9, 0]
    count: 6
    mass: 0.1
    springs: {structural: {stiffness: 1000, ratio: 0.1}}
    pins: [{particles: [start]}]
"""
TARGETS = "targets: animtool/1\nunits: {length: m}\nfps: 24\ngoals:\n"
FAR = "- {effector: arm, position: [0, 0.2, 0.6]}\n"
HIPS = "- {effector: base, position: [0, 0.9, 0.2]}\n"


@pytest.fixture
def shot(tmp_path: Path) -> Path:
    write_rig(tmp_path)
    (tmp_path / "limb.clip.yaml").write_text(CLIP, "utf-8")
    (tmp_path / "made").mkdir()
    return tmp_path / "shot.scene.yaml"


def write_rig(folder: Path, base: str = "fixed", hand: str = "fixed") -> None:
    text = RIG.replace("TYPE", base).replace("HAND", hand)
    (folder / "limb.rig.yaml").write_text(text, "utf-8")


def codes(path: Path) -> list[str]:
    return [fault.code for fault in validate(path)]


@pytest.mark.parametrize(("frame", "wanted"), [(1, []), (40, []), (2001, ["SCN213"])])
def test_props_have_frames_of_the_take(
    frame: int, wanted: list[str], shot: Path
) -> None:
    write_props(shot.parent / "props.usda")
    entry = f"{{from: props.usda, prim: /Set/box, frame: {frame}}}"
    shot.write_text(f"{SCENE}props: [{entry}]\n", "utf-8")
    assert codes(shot) == wanted


def test_a_pass_that_changes_the_time_of_props_does_something(shot: Path) -> None:
    write_props(shot.parent / "props.usda")
    still = "clip: animtool/1\nrig: limb.rig.yaml\nfps: 24\nrange: [1, 12]\n"
    (shot.parent / "limb.clip.yaml").write_text(still + "channels: []\n", "utf-8")
    warp = "passes: [{time_warp: {curve: [[1, 12], [12, 1]]}}]\n"
    shot.write_text(SCENE + warp, "utf-8")
    assert codes(shot) == ["SCN201"]
    entry = "{from: props.usda, prim: /Set/box}"
    shot.write_text(f"{SCENE}props: [{entry}]\n{warp}", "utf-8")
    assert codes(shot) == []


@pytest.mark.parametrize(
    ("base", "hand", "goals", "wanted"),
    [
        ("fixed", "fixed", FAR, ["TGT205"]),
        # The chain's root is its topmost joint; what is above moves for no goal.
        ("free", "fixed", FAR, ["TGT205"]),
        ("free", "fixed", FAR + HIPS, []),
        ("fixed", "prismatic, axis: [0, 1, 0], limits: [0, 0.4]", FAR, []),
        ("fixed", "prismatic, axis: [0, 1, 0], limits: [0, 0.1]", FAR, ["TGT205"]),
        ("fixed", "prismatic, axis: [0, 1, 0]", FAR, []),
        ("fixed", "fixed", FAR.replace("}", ", stretch: 0.5}"), []),
        ("fixed", "fixed", FAR.replace("}", ", offset: [0, -0.3, 0]}"), []),
        ("fixed", "fixed", FAR.replace("}", ", during: [[30, 40]]}"), ["TGT207"]),
    ],
)
def test_reach(base: str, hand: str, goals: str, wanted: list[str], shot: Path) -> None:
    write_rig(shot.parent, base, hand)
    shot.write_text(SOLVED, "utf-8")
    (shot.parent / "page.targets.yaml").write_text(TARGETS + goals, "utf-8")
    found = [c for c in codes(shot) if c.startswith("TGT2")]
    assert found == wanted


def test_a_goal_out_of_reach_is_said_of_its_line(shot: Path) -> None:
    shot.write_text(SOLVED, "utf-8")
    targets = shot.parent / "page.targets.yaml"
    targets.write_text(TARGETS + FAR, "utf-8")
    (fault,) = [fault for fault in validate(shot) if fault.code == "TGT205"]
    assert fault.path is not None
    assert Path(fault.path).name == targets.name
    assert fault.lines == (5,)
    assert "0.2 m out of reach" in fault.message
    assert "12 frames" in fault.message


@pytest.mark.parametrize(
    ("text", "wanted"),
    [
        ("output: {file: shot.usda, start: 1001}\nrange: [1001, 1012]\n", []),
        ("output: {file: shot.usda, start: 1001}\nrange: [1, 12]\n", ["SCN211"]),
        ("output: {file: shot.usda, start: 1001}\nrange: [1, 1001]\n", ["SCN202"]),
        ("range: [13, 20]\n", ["SCN211"]),
        ("range: [12, 20]\n", ["SCN202"]),
        ("output: {file: none/shot.usda}\n", ["SCN212"]),
        ("output: {file: limb.rig.yaml/shot.usda}\n", ["SCN212"]),
        ("output: [{file: a.usda}, {file: none/b.usda}]\n", ["SCN212"]),
        ("output: {file: made/shot.usda}\n", []),
        ("fps: 48\nrange: [1, 23]\n", []),
        ("fps: 48\nrange: [1, 24]\n", ["SCN202"]),
        ("passes: [{time_scale: {speed: 1}}]\n", ["SCN201"]),
        ("passes: [{time_scale: {speed: 2}}]\n", []),
        ("output: {file: o.usda, reduce: 1mm, reduce_at: {paw: 2mm}}\n", ["SCN207"]),
        ("output: {file: o.usda, reduce: 1mm, reduce_at: {hand: 2mm}}\n", []),
        ("output: {file: o.usda, reduce_at: {hand: 2mm}}\n", ["SCN207"]),
    ],
)
@pytest.mark.parametrize("systems", ["", ROPE])
def test_a_scene(text: str, wanted: list[str], systems: str, shot: Path) -> None:
    shot.write_text(SCENE + text + systems, "utf-8")
    assert codes(shot) == wanted


def test_what_is_odd_about_targets_is_said_of_their_scene(shot: Path) -> None:
    shot.write_text(SOLVED, "utf-8")
    targets = shot.parent / "page.targets.yaml"
    goal = "- {effector: arm, position: [0, 0.5, 0.4], weight: WEIGHT}\n"
    targets.write_text(TARGETS + goal.replace("WEIGHT", "{orientation: 2}"), "utf-8")
    (fault,) = [fault for fault in validate(shot) if fault.code == "TGT101"]
    assert (Path(fault.path or "").name, fault.lines) == (targets.name, (5,))
    # Of both files, it is said once.
    assert codes(shot.parent).count("TGT101") == 1
    targets.write_text(TARGETS + goal.replace("WEIGHT", "{position: 2}"), "utf-8")
    assert codes(shot) == []


def test_scenes_that_write_one_file_are_found_while_they_do(shot: Path) -> None:
    other = shot.with_name("other.scene.yaml")
    text = f"{SCENE}output: {{file: o.usda}}\n"
    shot.write_text(text, "utf-8")
    other.write_text(f"{SCENE}variables: {{o: o}}\noutput: {{file: '${{o}}.usda'}}\n")
    assert codes(shot.parent).count("SCN204") == 2
    other.write_text(f"{SCENE}output: {{file: another.usda}}\n", "utf-8")
    assert codes(shot.parent) == []
    other.write_text("scene: [", "utf-8")
    assert codes(shot) == []


def test_a_scene_that_writes_over_its_source_is_an_error(shot: Path) -> None:
    (shot.parent / "a.usda").write_text("#usda 1.0\n", "utf-8")
    text = f"{SCENE}output: {{file: a.usda, as: layer, rig_layer: a.usda}}\n"
    shot.write_text(text, "utf-8")
    (fault,) = validate(shot)
    assert (fault.code, fault.severity) == ("OUT003", Severity.ERROR)


def test_the_last_step_is_what_a_scene_opens_as(shot: Path) -> None:
    passes = "passes: [{mirror: {}}, {trim: {first: 3}}, {time_scale: {speed: 2}}]\n"
    shot.write_text(SCENE + passes, "utf-8")
    scene = load_scene(shot)
    steps = list(scene.steps())
    opened = scene.open().collect()
    assert len(steps) == 4
    assert steps[-1][0].clock == opened.clock
    assert (
        steps[-1][0].motion.rotations.dense() == opened.motion.rotations.dense()
    ).all()


@pytest.mark.parametrize(
    ("behind", "wanted"),
    [
        ("layer: {take: limb.clip.yaml, delay: 3}", ["SCN210"]),
        ("layer: {take: limb.clip.yaml, weight: 0}", ["SCN201"]),
        ("trim: {last: 8}", []),
        ("root_motion: {root: root}", []),
    ],
)
def test_passes_behind_ik(behind: str, wanted: list[str], shot: Path) -> None:
    write_rig(shot.parent, "free")
    near = "- {effector: arm, position: [0, 0.5, 0.4]}\n"
    (shot.parent / "page.targets.yaml").write_text(TARGETS + near, "utf-8")
    text = SOLVED.replace("]\n", f", {{{behind}}}]\n")
    shot.write_text(text, "utf-8")
    assert [code for code in codes(shot) if code.startswith("SCN2")] == wanted


@pytest.mark.parametrize(
    ("output", "wanted"),
    [
        ("[{file: a.usdc}, {file: limb.clip.yaml}]", ["OUT003"]),
        ("[{file: a.usdc}, {file: b.usda, bones: true, as: layer}]", ["SCN207"] * 2),
        ("[{file: a.usdc, keep_curves: true}, {file: b.bvh}]", ["SCN208"]),
        ("[{file: a.usdc}, {file: other.usdc}]", ["SCN204"]),
        ("[{file: a.usdc}, {file: b.clip.yaml, reduce: 1mm}]", []),
    ],
)
def test_each_of_several_outputs_is_looked_at(
    output: str, wanted: list[str], shot: Path
) -> None:
    other = shot.with_name("other.scene.yaml")
    other.write_text(f"{SCENE}output: [{{file: x.bvh}}, {{file: other.usdc}}]\n")
    shot.write_text(f"{SCENE}output: {output}\n", "utf-8")
    found = validate(shot)
    assert [fault.code for fault in found] == wanted
    assert all((fault.where or "").startswith("output[") for fault in found)


def test_handles_beyond_the_take(shot: Path) -> None:
    shot.write_text(f"{SCENE}shot: {{start: 1, cut: [1, 12], handles: 2}}\n", "utf-8")
    (fault,) = validate(shot)
    assert (fault.code, fault.where) == ("SCN202", "shot")


def test_a_variable_for_another(shot: Path) -> None:
    shot.write_text(
        'scene: animtool/1\nvariables: {a: limb, b: "${a}.clip", c: 1}\n'
        "source:\n  file: ${b}.yaml\n",
        "utf-8",
    )
    (fault,) = validate(shot)
    assert (fault.code, fault.where) == ("SCN209", "variables.c")


def test_a_scene_that_writes_over_what_its_targets_follow(shot: Path) -> None:
    (shot.parent / "prop.usda").write_text('#usda 1.0\ndef Xform "prop" {\n}\n')
    goal = "- {effector: arm, position: {prim: /prop, file: prop.usda}}\n"
    (shot.parent / "page.targets.yaml").write_text(TARGETS + goal, "utf-8")
    shot.write_text(f"{SOLVED}output: {{file: prop.usda}}\n", "utf-8")
    assert "OUT003" in codes(shot)


def test_a_unit_is_told_by_the_first_of_several_roots(shot: Path) -> None:
    """What the rig carries far off says nothing of the points of its targets."""
    rig = shot.with_name("limb.rig.yaml")
    prop = "- {name: prop, type: prismatic, axis: [1, 0, 0]}\nik:"
    rig.write_text(rig.read_text("utf-8").replace("ik:", prop), "utf-8")
    channel = "joint/prop.slide, keys: [{t: 1, v: 90}]}\n- {target: joint/lower"
    clip = CLIP.replace("channels: [", "channels:\n- ").replace("}]}]", "}]}")
    shot.with_name("limb.clip.yaml").write_text(
        clip.replace("joint/lower", channel), "utf-8"
    )
    shot.write_text(SOLVED, "utf-8")
    shot.with_name("page.targets.yaml").write_text(
        TARGETS + "- {effector: arm, position: [10, 60, 30]}\n", "utf-8"
    )
    (fault,) = (each for each in validate(shot) if each.code == "TGT206")
    assert fault.hint == "units: {length: cm} is more plausible"


BUILT = """\
scene: animtool/1
range: [1, 5]
systems:
- rigid:
    name: crates
    bodies: [{name: a, shape: {sphere: {radius: 0.1}}, turns: [[0, 1, 0, 0, 0]]}]
- flocks:
    name: birds
    species:
    - name: gull
      count: 3
      joins: [tern]
      flees: [{species: hawk, weight: 1, radius: 2}]
- crowds:
    name: people
    populations: [{name: one, count: 2, route: [door], then: repeat}]
- molecules:
    name: gas
    species: [{name: argon, count: 64}]
    box: [2, 2, 2]
    step: 0.5
- nbody:
    name: suns
    bodies: [{points: suns.npz, masses: suns.npz#short}]
- fluid:
    name: water
    spacing: 0.05
    fills:
    - {name: thin, shape: {box: {size: [1, 0.001, 1]}}, at: [0, -1, 0]}
    - {name: off, points: suns.npz#off}
    colliders: [{shape: {plane: null}}]
output: {file: made.usda}
"""


def test_what_building_systems_refuses_is_found_all_at_once(tmp_path: Path) -> None:
    points = np.array([[0.0, 0, 0], [1, 0, 0]])
    arrays = {"points": points, "short": np.ones(3), "off": points[:, :2]}
    np.savez(tmp_path / "suns.npz", **arrays)
    path = tmp_path / "page.scene.yaml"
    path.write_text(BUILT, "utf-8")
    found = [fault for fault in validate(path) if fault.severity is Severity.ERROR]
    counts = Counter(fault.code for fault in found)
    kinds = {"SIM061": 1, "SIM060": 2, "SIM145": 2, "SIM071": 1, "SIM064": 2}
    assert {code: counts[code] for code in kinds} == kinds
    assert sum(counts.values()) == 1 + sum(kinds.values())
    with pytest.raises(FormatError) as caught:
        bake(load_scene(path), None)
    refused = [f for f in caught.value.faults if f.severity is Severity.ERROR]
    assert Counter(fault.code for fault in refused) == counts


def test_what_building_refuses_is_found_with_faults_of_keys(tmp_path: Path) -> None:
    path = tmp_path / "page.scene.yaml"
    shape = "shape: {sphere: {radius: 0.1}}"
    one = f"- rigid: {{name: one, bodies: [{{name: a, {shape}, sped: 3}}]}}\n"
    two = f"- rigid: {{name: two, bodies: [{{name: a, {shape}, release: 1}}]}}\n"
    path.write_text(f"scene: animtool/1\nrange: [1, 9]\nsystems:\n{one}{two}", "utf-8")
    assert codes(path) == ["DOC020", "SIM061"]


def test_steps_that_a_bake_refuses_are_found(tmp_path: Path) -> None:
    path = tmp_path / "page.scene.yaml"
    text = "scene: animtool/1\nrange: [1, 10000]\n" + ROPE + "output: {file: a.usda}\n"
    path.write_text(text.replace("count: 6", "name: r\n    count: 6\n    step: 1e-6"))
    assert codes(path) == ["SCN091"]


def test_a_system_that_needs_a_wrong_one_is_no_fault_more(tmp_path: Path) -> None:
    path = tmp_path / "page.scene.yaml"
    bodies = "bodies: [{name: a, shape: {plane: null}}]"
    needs = ROPE.replace(
        "count: 6", "name: r\n    count: 6\n    systems: [{system: it}]"
    )
    text = f"scene: animtool/1\nrange: [1, 9]\n{needs}- rigid: {{name: it, {bodies}}}\n"
    path.write_text(text + "output: {file: a.usda}\n", "utf-8")
    assert codes(path) == ["SIM061"]


BATCH = """\
batch: animtool/1
scene: page.scene.yaml
variants: {speed: [0.5, 1], start: [1, 101]}
output: "made/{speed}_{start}.usdc"
"""


def test_a_batch_in_the_run_gives_a_scene_its_variables(shot: Path) -> None:
    scene, batch = shot.with_name("page.scene.yaml"), shot.with_name("a.batch.yaml")
    passes = "passes: [{time_scale: {speed: ${speed}}}]\n"
    output = "output: {file: made/x.usdc, start: ${start}}\n"
    scene.write_text(SCENE + passes + output, "utf-8")
    batch.write_text(BATCH, "utf-8")
    assert codes(scene) == ["SCN030", "SCN030"]
    assert validate([batch, scene]) == validate(shot.parent) == []
    scene.write_text(SCENE + passes + output + "range: [${first}, 9]\n", "utf-8")
    assert [fault.code for fault in validate([batch, scene])] == ["SCN030"]
    batch.write_text(BATCH.replace("0.5, 1", "fast, 1"), "utf-8")
    assert "SCN002" in [fault.code for fault in validate([batch, scene])]


def test_inputs_and_overrides_of_a_batch_count(shot: Path) -> None:
    scene, batch = shot.with_name("page.scene.yaml"), shot.with_name("a.batch.yaml")
    scene.write_text(SCENE.replace("limb.clip.yaml", "${input}") + "fps: ${rate}\n")
    over = "overrides: [{inputs: [limb.clip.yaml], variables: {rate: 25}}]\n"
    head = "batch: animtool/1\nscene: page.scene.yaml\ninputs: [limb.clip.yaml]\n"
    batch.write_text(head + "variables: {rate: none}\n" + over, "utf-8")
    assert validate([batch, scene]) == []
    batch.write_text(head + "variables: {rate: none}\n", "utf-8")
    assert [fault.code for fault in validate([batch, scene])] == ["SCN022"]
