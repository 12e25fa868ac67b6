from __future__ import annotations

import copy
import math
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from support.cli import animtool
from support.faults import document_faults, raises, refused
from support.suite import examples

from animtool.core.errors import Fault, FormatError
from animtool.documents.document import Document, read_document
from animtool.documents.yaml_values import SourceMarks
from animtool.maths import so3
from animtool.rig.file import load_rig, parse_rig
from animtool.rig.joints import coordinate_slices, local_from_coordinates
from animtool.rig.kinematics import forward_kinematics
from animtool.rig.limits import BallLimit, RangeLimit
from animtool.rig.parts import Mesh, Shape
from animtool.rig.sides import reflect_rotation
from animtool.rig.skeleton import Joint, JointType, Mimic, Pose, Rig
from animtool.rig.write import rig_text

CRANE = """\
rig: animtool/1
name: crane
units: {length: cm, angle: deg}
up: Z
joints:
- {name: claw_l, parent: arm_l, type: pin, axis: [0, 0, 2], limits: [-10, 90], mirror: claw_r}
- {name: base, type: free, translate: [0, 0, 50]}
- {name: mast, parent: base, type: ball, rotate: [2, 0, 0, 0], limits: {swing: [30, 60], twist: locked, twist_axis: [0, 0, 1]}}
- {name: arm_l, parent: mast, type: prismatic, axis: [1, 0, 0], translate: [10, 0, 40], limits: [0, 25], mirror: arm_r}
- {name: pump, parent: base, type: prismatic, axis: [0, 0, 1], mimic: {joint: claw_l, gain: 2, offset: 3}}
- {name: hook, parent: claw_l, type: fixed, translate: [5, 0, 0]}
bind: {base: {translate: [0, 0, 60]}}
meshes:
- {name: hull, points: hull.npz, faces: hull.npz, normals: hull.npz, skin: {joints: [base, mast], indices: hull.npz, weights: hull.npz}}
shapes:
- {name: dent, mesh: hull, deltas: hull.npz#dent, inbetweens: [{at: 0.5, deltas: hull.npz#dent}]}
- {name: bulge, mesh: hull, deltas: hull.npz#dent}
- {name: both, mesh: hull, deltas: hull.npz#dent, combine: [dent, bulge]}
controls:
- {name: grip, range: [0, 1], drives: [{joint: claw_l.angle, curve: [[0, 0], [1, 80]]}, {control: wear, expr: "grip * 0.5"}]}
- {name: wear, default: 0.25, drives: [{shape: dent, expr: "clamp(wear, 0, 1)"}]}
ik: [{name: reach, root: mast, tip: hook, goal: position, pole_dir: [0, 3, 0]}]
attach: [{name: cable, kind: spring_chain, joints: [hook]}]
colliders: [{joint: base, capsule: {radius: 20, length: 100}}]
"""  # noqa: E501


@pytest.fixture(scope="module")
def yard(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with the arrays of the crane, and some that do not fit."""
    folder = tmp_path_factory.mktemp("yard")
    np.savez(
        folder / "hull.npz",
        points=np.zeros((4, 3)),
        normals=np.zeros((4, 3)),
        faces=np.array([[0, 1, 2, 3]]),
        faces_from_one=np.array([[1, 2, 3, 4], [1, 2, 3, -1]]),
        indices=np.zeros((4, 2), int),
        weights=np.full((4, 2), 0.5),
        dent=np.zeros((4, 3)),
        short=np.zeros((3, 3)),
        objects=np.array([{}], object),
        text=np.array(["a"]),
        halves=np.zeros((4, 2)),
        far=np.array([[0, 2]] * 4),
        from_one=np.array([[1, 2]] * 4),
        negative=np.array([[0, -1]] * 4),
        flags=np.zeros((4, 2), bool),
        three=np.zeros((4, 3), int),
        nan=np.full((4, 2), np.nan),
        below=np.array([[0.5, -0.5]] * 4),
        none=np.array([[1.0, 0.0]] * 3 + [[0.0, 0.0]]),
        corners=np.array([[0, 1, 2, 4]]),
        filled=np.array([[0, 1, 2, -1]]),
        hole=np.array([[0, 1, -1, -1]]),
        pairs=np.array([[0, 1]]),
        faceless=np.zeros((0, 3), int),
        infinite=np.full((4, 3), np.inf),
    )
    (folder / "animtool.toml").write_text("")
    return folder


def load(folder: Path, text: str) -> Rig:
    path = folder / "crane.rig.yaml"
    path.write_bytes(text.encode("utf-8", "surrogateescape"))
    return load_rig(path)


def faults(folder: Path, text: str) -> list[Fault]:
    with pytest.raises(FormatError) as caught:
        load(folder, text)
    return list(caught.value.faults)


def test_the_crane(yard: Path) -> None:
    rig = load(yard, CRANE)
    assert (rig.name, rig.meters_per_unit, str(rig.up)) == ("crane", 0.01, "Z")
    joints = {joint.name: joint for joint in rig.joints}
    assert set(joints) == {
        *("base", "mast", "arm_l", "arm_r", "claw_l", "claw_r", "pump", "hook")
    }
    assert joints["base"].translation == (0, 0, 0.5)
    assert joints["claw_l"].axis == (0, 0, 1)
    assert joints["claw_l"].limits == RangeLimit(math.radians(-10), math.radians(90))
    assert joints["arm_l"].limits == RangeLimit(0, 0.25)
    cone = joints["mast"].limits
    assert isinstance(cone, BallLimit)
    assert cone.twist == (0, 0)
    assert_allclose(cone.swing or (), np.radians([30, 60]))
    assert joints["mast"].rotation == (0, 0, 0, 1)
    assert joints["pump"].mimic == Mimic(
        "claw_l", pytest.approx(2 * 0.01 / math.radians(1)), pytest.approx(0.03)
    )
    assert rig.bind == {"base": Pose((0, 0, 0.6), (0, 0, 0, 1))}
    assert rig.meshes[0].skin is not None
    assert rig.meshes[0].skin.weights.path == yard / "hull.npz"
    assert [shape.combine for shape in rig.shapes] == [(), (), ("dent", "bulge")]
    assert rig.controls[0].drives[0].unit == math.radians(1)
    assert rig.controls[1].default == 0.25
    assert rig.chains[0].pole_dir == (0, 1, 0)
    assert rig.attach[0].joints == ("hook",)
    assert rig.colliders[0].capsule.radius == pytest.approx(0.2)


def test_mirrors_of_the_crane(yard: Path) -> None:
    joints = {joint.name: joint for joint in load(yard, CRANE).joints}
    names = load(yard, CRANE).names
    arm, claw = joints["arm_r"], joints["claw_r"]
    assert arm.translation == (-0.1, 0, 0.4)
    assert arm.axis == (-1, 0, 0)
    assert arm.limits == joints["arm_l"].limits
    assert names[claw.parent] == "arm_r"
    assert claw.axis == (0, 0, -1)
    assert claw.limits == joints["claw_l"].limits


@given(st.permutations(range(6)))
@settings(deadline=None, max_examples=examples(30))
def test_joints_in_any_order(yard: Path, order: list[int]) -> None:
    lines = CRANE.split("\n")
    shuffled = [*lines[:5], *(lines[5 + i] for i in order), *lines[11:]]
    rig, wanted = load(yard, "\n".join(shuffled)), load(yard, CRANE)
    parents = {j.name: j.parent < 0 or rig.joints[j.parent].name for j in rig.joints}
    assert parents == {
        j.name: j.parent < 0 or wanted.joints[j.parent].name for j in wanted.joints
    }
    one, other = (
        {j.name: replace(j, parent=-1) for j in r.joints} for r in (rig, wanted)
    )
    assert one == other


# Text to find, text to put there, code, line.
FAULTS = [
    *document_faults("rig", "up: Z", 4),
    ("up: Z", "up: \tZ\n\tb: 1", "DOC001", 5),
    ("up: Z", "<<: {up: Z}", "DOC020", 4),
    ("length: cm", "lenght: cm", "DOC020", 3),
    ("base: {translate", "base: {translat", "DOC020", 12),
    ("axis: [0, 0, 2], ", "axes: [0, 0, 2], ", "DOC020", 6),
    ("type: free", "type: free, limits: [0, 1]", "DOC020", 7),
    ("name: crane\n", "", "DOC021", 1),
    ("axis: [0, 0, 2], ", "", "DOC021", 6),
    ("type: free, ", "", "DOC022", 7),
    ("mesh: hull, deltas: hull.npz#dent, combine", "combine: 3, mesh", "DOC022", 18),
    ("length: cm", "length: km", "DOC022", 3),
    ("up: Z", "up: X", "DOC022", 4),
    ("type: free", "type: loose", "DOC022", 7),
    ("type: free", "type: [free]", "DOC022", 7),
    ("[0, 0, 50]", "[0, 0]", "DOC022", 7),
    ("[0, 0, 50]", "[0, 0, x]", "DOC022", 7),
    ("[0, 0, 50]", "[0, 0, true]", "DOC022", 7),
    ("[0, 0, 50]", "[0, 0, .nan]", "DOC022", 7),
    ("[0, 0, 50]", "[0, 0, 1e999]", "DOC022", 7),
    ("[0, 0, 50]", "[0, 0, " + "9" * 350 + "]", "DOC022", 7),
    ("[0, 0, 50]", "5", "DOC022", 7),
    ("limits: [0, 25]", "limits: [0]", "DOC022", 9),
    ("twist: locked", "twist: lockd", "DOC022", 8),
    ("radius: 20", "radius: 0", "DOC022", 24),
    ("radius: 20", "radius: wide", "DOC022", 24),
    ("joints: [hook]", "joints: []", "DOC022", 23),
    ("goal: position", "goal: place", "DOC022", 22),
    ("curve: [[0, 0], [1, 80]]", "curve: []", "DOC022", 20),
    ("name: hook", "name: pump", "RIG001", 11),
    ("parent: base, type: ball", "parent: bse, type: ball", "RIG002", 8),
    ("name: base, type", "name: base, parent: mast, type", "RIG003", 7),
    ("[0, 0, 2]", "[0, 0, 0]", "RIG005", 6),
    ("[0, 3, 0]", "[0, 0, 0]", "RIG005", 22),
    ("length: 100", "axis: [0, 0, 0]", "RIG005", 24),
    ("twist_axis: [0, 0, 1]", "twist_axis: [0, 0, 0]", "RIG005", 8),
    ("[2, 0, 0, 0]", "[0, 0, 0, 0]", "RIG006", 8),
    ("[0, 0, 2]", "[1.34e154, 0, 0]", "DOC022", 6),
    ("[2, 0, 0, 0]", "[2e200, 0, 0, 0]", "DOC022", 8),
    # Squares of these are below float64.
    ("[0, 0, 2]", "[1.34e-164, 0, 0]", "RIG005", 6),
    ("[2, 0, 0, 0]", "[2e-200, 0, 0, 0]", "RIG006", 8),
    ("[-10, 90]", "[90, -10]", "RIG007", 6),
    ("swing: [30, 60]", "swing: 200", "RIG007", 8),
    ("swing: [30, 60]", "swing: [-1, 60]", "RIG007", 8),
    ("twist: locked", "twist: [1, -1]", "RIG007", 8),
    ("bind: {base", "bind: {bose", "RIG008", 12),
    ("joint: claw_l, gain", "joint: clw_l, gain", "RIG008", 10),
    ("joints: [base, mast]", "joints: [base, most]", "RIG008", 14),
    ("root: mast", "root: most", "RIG008", 22),
    ("joints: [hook]", "joints: [hok]", "RIG008", 23),
    ("joint: base, capsule", "joint: bse, capsule", "RIG008", 24),
    ("joint: claw_l.angle", "joint: clw.angle", "RIG008", 20),
    ("joint: claw_l, gain", "joint: mast, gain", "RIG009", 10),
    ("joint: claw_l, gain", "joint: pump, gain", "RIG009", 10),
    ("mirror: claw_r", "mirror: hook", "RIG010", 6),
    ("type: ball", "type: ball, channels: [Zrotation, bla]", "DOC022", 8),
    ("type: ball", "type: ball, channels: [Zrotation, Zrotation]", "RIG028", 8),
    ("mirror: claw_r", "mirror: claw_l", "RIG010", 6),
    ("name: bulge", "name: dent", "RIG011", 17),
    ("name: wear", "name: grip", "RIG011", 21),
    ("mesh: hull, deltas: hull.npz#dent, in", "mesh: hul, in", "RIG012", 16),
    ("combine: [dent, bulge]", "combine: [dent, bulg]", "RIG012", 18),
    ("shape: dent, expr", "shape: dnt, expr", "RIG012", 21),
    ("control: wear", "control: wer", "RIG012", 20),
    ("grip * 0.5", "grp * 0.5", "RIG012", 20),
    ("grip * 0.5", "grip ** 2", "RIG013", 20),
    ("grip * 0.5", "=grip * 0.5", "RIG013", 20),
    ("grip * 0.5", "grip.real", "RIG013", 20),
    ("grip * 0.5", "grip + wear", "RIG014", 21),
    ("claw_l.angle", "claw_l", "RIG015", 20),
    ("claw_l.angle", "claw_l.slide", "RIG015", 20),
    ("{control: wear, ", "{control: wear, shape: dent, ", "RIG015", 20),
    ("{control: wear, expr", "{expr", "RIG015", 20),
    (', expr: "grip * 0.5"', "", "RIG015", 20),
    ("[[0, 0], [1, 80]]", "[[0, 0], [0, 80]]", "RIG016", 20),
    ("range: [0, 1]", "range: [1, 0]", "RIG017", 20),
    ("range: [0, 1]", "range: [1, 2]", "RIG017", 20),
    ("points: hull.npz", "points: hul.npz", "RIG018", 14),
    ("points: hull.npz", "points: hull.npz#pts", "RIG018", 14),
    ("points: hull.npz", "points: hull.npz#text", "RIG018", 14),
    ("normals: hull.npz", "normals: hull.npz#short", "RIG019", 14),
    ("faces: hull.npz", "faces: hull.npz#halves", "RIG019", 14),
    ("normals: hull.npz", "normals: hull.npz#objects", "RIG020", 14),
    ("normals: hull.npz", "normals: ../hull.npz", "DOC014", 14),
    ("normals: hull.npz", "normals: /etc/passwd", "DOC014", 14),
    ("tip: hook", "tip: base", "RIG022", 22),
    ("up: Z", "from: hero.usda", "RIG023", 4),
    ("up: Z", "from: ../../hero.usda", "DOC014", 4),
    ("at: 0.5", "at: 1", "RIG024", 16),
    ("combine: [dent, bulge]", "combine: [dent, both]", "RIG026", 18),
    ("indices: hull.npz", "indices: hull.npz#far", "RIG027", 14),
    ("indices: hull.npz", "indices: hull.npz#from_one", "RIG027", 14),
    ("indices: hull.npz", "indices: hull.npz#negative", "RIG027", 14),
    ("indices: hull.npz", "indices: hull.npz#halves", "RIG019", 14),
    ("indices: hull.npz", "indices: hull.npz#flags", "RIG019", 14),
    ("indices: hull.npz", "indices: hull.npz#three", "RIG019", 14),
    ("weights: hull.npz", "weights: hull.npz#nan", "RIG027", 14),
    ("weights: hull.npz", "weights: hull.npz#below", "RIG027", 14),
    ("weights: hull.npz", "weights: hull.npz#none", "RIG027", 14),
    ("weights: hull.npz", "weights: hull.npz#points", "RIG019", 14),
    ("faces: hull.npz", "faces: hull.npz#corners", "RIG027", 14),
    ("faces: hull.npz", "faces: hull.npz#faceless", "RIG019", 14),
    ("faces: hull.npz", "faces: hull.npz#hole", "RIG027", 14),
    ("faces: hull.npz", "faces: hull.npz#pairs", "RIG019", 14),
    ("points: hull.npz", "points: hull.npz#infinite", "RIG027", 14),
    ("deltas: hull.npz#dent", "deltas: hull.npz#infinite", "RIG027", 16),
    ("deltas: hull.npz#dent", "deltas: hull.npz#short", "RIG019", 16),
    ("name: wear", "name: we-ar", "RIG025", 21),
    ("name: wear", "name: lambda", "RIG025", 21),
    ("name: wear", "name: clamp", "RIG025", 21),
]


@pytest.mark.parametrize(("old", "new", "code", "line"), FAULTS)
def test_a_fault(yard: Path, old: str, new: str, code: str, line: int) -> None:
    assert old in CRANE
    found = faults(yard, CRANE.replace(old, new, 1))
    assert (code, line) in [(fault.code, fault.lines[0]) for fault in found]
    assert len(found) <= 3


@pytest.mark.parametrize(
    ("name", "reason"),
    [
        ("lambda", "it is a keyword of Python"),
        ("clamp", "it is a function of expressions"),
        ("pi", "it is a constant of expressions"),
        ("we-ar", "an expression would not read it as one name"),
    ],
)
def test_a_name_that_no_control_can_have(yard: Path, name: str, reason: str) -> None:
    found = faults(yard, CRANE.replace("name: wear", f"name: {name}", 1))
    (fault,) = [fault for fault in found if fault.code == "RIG025"]
    assert fault.message.endswith(reason)
    # What uses the name says nothing more of it.
    used = faults(yard, CRANE.replace("wear", name))
    assert {fault.code for fault in used} == {"RIG025"}


def test_a_value_of_an_array_is_named_with_its_place(yard: Path) -> None:
    [fault] = faults(yard, CRANE.replace("indices: hull.npz", "indices: hull.npz#far"))
    assert fault.message.startswith("'hull.npz#far' contains 2 at [0, 1], but ")
    assert "skin.joints has 2 joints" in fault.message
    assert "list 3 joints" in (fault.hint or "")


@pytest.mark.parametrize(
    "reference",
    ["indices: hull.npz#from_one", "faces: hull.npz#faces_from_one"],
)
def test_indices_that_count_from_1_are_recognised(yard: Path, reference: str) -> None:
    key = reference.partition("#")[0]
    [fault] = faults(yard, CRANE.replace(key, reference, 1))
    assert fault.code == "RIG027"
    assert (fault.hint or "").endswith("subtract 1")


def test_triangles_among_quadrangles(yard: Path) -> None:
    assert load(yard, CRANE.replace("faces: hull.npz", "faces: hull.npz#filled"))


def test_a_circle_of_shapes_is_printed(yard: Path) -> None:
    text = CRANE.replace(
        "{name: bulge, mesh: hull, deltas: hull.npz#dent}",
        "{name: bulge, mesh: hull, combine: [both]}",
    )
    [fault] = faults(yard, text)
    assert fault.code == "RIG026"
    assert "both → bulge → both" in fault.message or "bulge → both → bulge" in (
        fault.message
    )


BOUND = """\
rig: animtool/1
name: bound
joints:
- {name: hips, type: free, translate: [0, 1, 0]}
- {name: arm_l, parent: hips, type: ball, translate: [0.2, 0.5, 0], rotate: [1, 0.2, 0, 0], mirror: arm_r}
- {name: hand_l, parent: arm_l, type: ball, translate: [0.3, 0, 0.1], mirror: hand_r}
bind:
  arm_l: {translate: [0.25, 0.4, 0.1], rotate: [1, 0, 0.3, 0.5]}
"""  # noqa: E501


def test_a_bind_pose_is_mirrored(yard: Path) -> None:
    rig = load(yard, BOUND)
    left, right = rig.bind["arm_l"], rig.bind["arm_r"]
    assert_allclose(right.translation, [-0.25, 0.4, 0.1])
    assert_allclose(right.rotation, reflect_rotation(np.array(left.rotation)))
    again = load(yard, rig_text(rig))
    assert again.bind == rig.bind


def test_a_bind_pose_of_its_own_is_kept(yard: Path) -> None:
    own = BOUND + "  arm_r: {translate: [-0.2, 0.1, 0]}\n"
    assert load(yard, own).bind["arm_r"].translation == (-0.2, 0.1, 0)
    one_sided = replace(
        load(yard, BOUND), bind={"arm_l": load(yard, BOUND).bind["arm_l"]}
    )
    assert load(yard, rig_text(one_sided)).bind == one_sided.bind


def test_a_mirrored_bind_pose_below_a_parent_that_turns_only_at_bind(
    yard: Path,
) -> None:
    rig = load(yard, BOUND + "  hips: {rotate: [1, 0, 0, 0.4]}\n")
    posed = [rig.bind.get(j.name, Pose(j.translation, j.rotation)) for j in rig.joints]
    world = forward_kinematics(
        rig,
        np.array([[pose.translation for pose in posed]]),
        np.array([[pose.rotation for pose in posed]]),
    )
    flip = np.diag([-1.0, 1.0, 1.0])
    left, right = rig.index("arm_l"), rig.index("arm_r")
    assert_allclose(world.positions[:, right], world.positions[:, left] @ flip)
    assert_allclose(
        world.linear[:, right], flip @ world.linear[:, left] @ flip, atol=1e-12
    )


def test_a_collider_has_a_centre(yard: Path) -> None:
    text = CRANE.replace("length: 100", "length: 100, offset: [0, 50, 0]")
    rig = load(yard, text)
    assert rig.colliders[0].capsule.offset == (0, 0.5, 0)
    assert load(yard, CRANE).colliders[0].capsule.offset == (0, 0, 0)
    assert load(yard, rig_text(rig)).colliders == rig.colliders


def test_no_joints(yard: Path) -> None:
    found = faults(yard, "rig: animtool/1\nname: none\n")
    assert [fault.code for fault in found] == ["RIG004"]


def test_two_keys_missing_in_one_place(yard: Path) -> None:
    text = "rig: animtool/1\nname: x\njoints:\n- {type: pin}\n"
    assert [fault.code for fault in faults(yard, text)] == ["DOC021", "DOC021"]


def test_a_hint_for_keys_of_a_mapping(yard: Path) -> None:
    [fault] = faults(yard, CRANE.replace("base: {translate", "base: {translat"))
    assert fault.hint == "did you mean 'translate'?"


def test_ten_faults_at_once(yard: Path) -> None:
    chosen = ["RIG002", "RIG005", "RIG006", "RIG007", "RIG012", "RIG013", "RIG016"]
    chosen += ["RIG019", "RIG022", "RIG024"]
    text = CRANE
    for code in chosen:
        old, new = next((old, new) for old, new, c, _ in FAULTS if c == code)
        assert old in text
        text = text.replace(old, new, 1)
    found = faults(yard, text)
    lines = [fault.lines[0] for fault in found]
    assert lines == sorted(lines)
    assert set(chosen) <= {fault.code for fault in found}
    assert len(found) == 10


# Faults of keys, types and values among those of meaning; each is one cause.
MIXED = {
    "in every part": [
        ("up: Z", "upp: Z", "DOC020", 4),
        ("axis: [0, 0, 2], ", "", "DOC021", 6),
        ("[0, 0, 50]", "[0, 0, x]", "DOC022", 7),
        ("twist: locked", "twist: lockd", "DOC022", 8),
        ("limits: [0, 25]", "limits: [25, 0]", "RIG007", 9),
        ("bind: {base", "bind: {bose", "RIG008", 12),
        ("combine: [dent, bulge]", "combine: [dent, bulg]", "RIG012", 18),
        ("grip * 0.5", "grip ** 2", "RIG013", 20),
        ("tip: hook", "tip: base", "RIG022", 22),
        ("radius: 20", "radius: -1", "DOC022", 24),
    ],
    "in what others refer to": [
        ("type: pin, axis: [0, 0, 2]", "type: pni, axis: [0, 0, 2]", "DOC022", 6),
        ("[0, 0, 50]", "[0, 0]", "DOC022", 7),
        ("parent: base, type: ball", "parent: 5, type: ball", "DOC022", 8),
        ("parent: mast, type", "parent: most, type", "RIG002", 9),
        ("gain: 2", "gain: much", "DOC022", 10),
        ("points: hull.npz", "points: 5", "DOC022", 14),
        ("at: 0.5", "at: half", "DOC022", 16),
        ("range: [0, 1]", "range: [0]", "DOC022", 20),
        ("default: 0.25", "default: low", "DOC022", 21),
        ("joints: [hook]", "joints: [hok]", "RIG008", 23),
    ],
    "in names": [
        ("name: crane", "nmae: crane", "DOC020", 2),
        ("name: claw_l", "nam: claw_l", "DOC020", 6),
        ("translate: [0, 0, 50]", "translat: [0, 0]", "DOC020", 7),
        ("twist_axis: [0, 0, 1]", "twist_axis: [0, 0, 0]", "RIG005", 8),
        ("mirror: arm_r", "mirror: claw_l", "RIG010", 9),
        ("method: linear", "method: liner", "DOC022", 14),
        ("shape: dent, expr", "shape: dnt, expr", "RIG012", 21),
        ("root: mast", "root: most", "RIG008", 22),
        ("goal: position", "goal: place", "DOC022", 22),
        ("radius: 20", "radius: -1", "DOC022", 24),
    ],
    "of whole entries": [
        ("name: base, type", "type", "DOC021", 7),
        ("translate: [5, 0, 0]", "translate: [[5], 0, 0]", "DOC022", 11),
        ("bind: {base: {translate: [0, 0, 60]}}", "bind: {base: 5}", "DOC022", 12),
        ("skin: {joints", "skin: {method: [], joints", "DOC022", 14),
        ("[{at: 0.5, deltas: hull.npz#dent}]", "[7]", "DOC022", 16),
        ("combine: [dent, bulge]", "combine: [dent, 3]", "DOC022", 18),
        ("{control: wear, expr", "{expr", "RIG015", 20),
        ("drives: [{shape", "drives: [2, {shape", "DOC022", 21),
        ("pole_dir: [0, 3, 0]", "pole_dir: [0, 0, 0]", "RIG005", 22),
        ("attach: [{", "attach: [5, {", "DOC022", 23),
    ],
}


def mixed(name: str) -> tuple[str, list[tuple[str, int]]]:
    """Return the crane with ten faults, and what is to be said of them."""
    text = CRANE.replace("skin: {joints", "skin: {method: linear, joints")
    if name == "of whole entries":
        text = CRANE
    for old, new, _, _ in MIXED[name]:
        assert old in text or new in text, old
        text = text.replace(old, new, 1)
    return text, [(code, line) for *_, code, line in MIXED[name]]


@pytest.mark.parametrize("name", MIXED)
def test_ten_mixed_faults_in_one_go(yard: Path, name: str) -> None:
    text, expected = mixed(name)
    found = faults(yard, text)
    assert len(expected) == 10
    said = [(fault.code, fault.lines[0]) for fault in found]
    assert sorted(said, key=lambda f: f[1]) == said
    assert sorted(said) == sorted(expected), "\n".join(map(str, found))


def test_ten_mixed_faults_are_printed(yard: Path) -> None:
    text, expected = mixed("in every part")
    (yard / "crane.rig.yaml").write_text(text)
    clip = yard / "swing.clip.yaml"
    clip.write_text(
        "clip: animtool/1\nrig: crane.rig.yaml\nfps: 24\n"
        "channels: [{target: control/grip, keys: [{t: 0, v: 0}, {t: 0, v: x}]}]\n"
    )
    done = animtool("bake", clip, "-o", yard / "swing.usda")
    assert done.code == 3
    lines = done.fault_lines
    own = [line for line in lines if line.startswith(str(clip))]
    assert [line.split()[1] for line in own] == ["CLIP004", "DOC022"]
    rest = [line for line in lines if line not in own]
    assert [(line.split()[1], int(line.split(":")[1])) for line in rest] == expected
    assert not (yard / "swing.usda").exists()


NOISE: st.SearchStrategy[Any] = st.recursive(
    st.none()
    | st.booleans()
    | st.integers()
    | st.floats()
    | st.text(max_size=3)
    | st.sampled_from(["base", "hook", "pin", "hull.npz", "grip", "a\0b"]),
    lambda inner: (
        st.lists(inner, max_size=3)
        | st.dictionaries(st.sampled_from(["name", "type", "x"]), inner, max_size=2)
    ),
    max_leaves=4,
)


def edit(root: Any, data: st.DataObject) -> None:
    """Put something else in some place of a value, or under another key."""
    node = root
    while node:
        steps = list(node) if isinstance(node, dict) else list(range(len(node)))
        step = data.draw(st.sampled_from(steps))
        if (
            isinstance(node[step], dict | list)
            and node[step]
            and data.draw(st.integers(0, 4))
        ):
            node = node[step]
            continue
        if isinstance(node, dict) and data.draw(st.booleans()):
            node[step + data.draw(st.sampled_from("ab"))] = node.pop(step)
        else:
            node[step] = data.draw(NOISE)
        break


@pytest.mark.slow(0.5)
@given(st.data())
@settings(deadline=None, max_examples=examples(60))
@pytest.mark.parametrize("kind", ["whole", "sidecar"])
def test_any_edits_give_a_rig_or_faults(
    yard: Path, kind: str, data: st.DataObject
) -> None:
    path = yard / "edited.rig.yaml"
    path.write_text(CRANE if kind == "whole" else SIDECAR)
    document = read_document(path)
    root: Any = copy.deepcopy(document.value)
    for _ in range(data.draw(st.integers(1, 4))):
        edit(root, data)
    marks = document.marks()
    edited = Document(path, root, lambda: SourceMarks(marks.positions * 9, {}))
    joints: list[Any] = []
    faults: list[Any] = []
    try:
        with patch("animtool.usd.rigs.stored.read_rig", lambda _: BASE):
            joints = list(parse_rig(edited).joints)
    except FormatError as error:
        faults = list(error.faults)
    assert joints or faults
    assert all(fault.path == str(path) and fault.lines for fault in faults)


SIDES = """\
rig: animtool/1
name: sides
joints:
- {{name: root, type: free}}
- {{name: spine, parent: root, type: fixed, translate: [0, 1, 0.2], rotate: {0}}}
- {{name: a_l, parent: spine, type: ball, translate: [1, 0.5, 0], rotate: {1}, mirror: a_r, limits: {{swing: [20, 50], twist: [-10, 70], twist_axis: {5}}}}}
- {{name: b_l, parent: a_l, type: pin, axis: {4}, translate: [1, -0.5, 0.3], rotate: {2}, limits: [-20, 100], mirror: b_r}}
- {{name: c_l, parent: b_l, type: prismatic, axis: {5}, translate: [1, 2, 0], rotate: {3}, mirror: c_r, mimic: {{joint: b_l, gain: 0.5}}}}
- {{name: d_r, parent: c_r, type: free, translate: [-1, 0, 0], rotate: {4}0, mirror: d_l}}
"""  # noqa: E501


@given(st.integers(0, 10_000))
@settings(deadline=None, max_examples=examples(40))
def test_equal_coordinates_are_mirror_images(yard: Path, seed: int) -> None:
    rng = np.random.default_rng(seed)
    spine = [1.0, float(rng.normal()), 0.0, 0.0]
    turns = [rng.normal(size=4).round(3).tolist() for _ in range(3)]
    axes = [(rng.normal(size=3) + 0.001).round(4).tolist() for _ in range(2)]
    text = SIDES.format(spine, *turns, *axes).replace(
        f"{axes[0]}0, mirror: d_l", f"{rng.normal(size=4).tolist()}, mirror: d_l"
    )
    rig = load(yard, text)
    joints = {joint.name: joint for joint in rig.joints}
    places = dict(zip(rig.names, coordinate_slices(rig), strict=True))
    q = rng.normal(size=(3, coordinate_slices(rig)[-1].stop))
    q[:, places["root"]] = [0, 1, 2, 0, 0, 0, 1]
    for name, joint in joints.items():
        if not name.endswith("_l"):
            continue
        own, other = q[:, places[name]], q[:, places[joint.mirror]]
        other[:] = own
        if joint.type in {JointType.BALL, JointType.FREE}:
            other[:, -4:] = reflect_rotation(own[:, -4:])
        if joint.type is JointType.FREE:
            other[:, :3] = own[:, :3] * [-1, 1, 1]
    local = local_from_coordinates(rig, q)
    world = forward_kinematics(rig, local.translations, local.rotations)
    flip = np.diag([-1.0, 1.0, 1.0])
    for name, joint in joints.items():
        if joint.mirror:
            i, k = rig.index(name), rig.index(joint.mirror)
            positions, linear = world.positions, world.linear
            assert_allclose(positions[:, k], positions[:, i] @ flip, atol=1e-11)
            assert_allclose(linear[:, k], flip @ linear[:, i] @ flip, atol=1e-11)
    assert joints["b_r"].limits == joints["b_l"].limits
    assert joints["c_r"].mimic == replace(joints["c_l"].mimic or Mimic(""), joint="b_r")
    left, right = joints["a_l"].limits, joints["a_r"].limits
    assert isinstance(left, BallLimit)
    assert isinstance(right, BallLimit)
    turned = so3.normalize(rng.normal(size=(5, 4)))
    assert_allclose(
        so3.angle_between(
            right.clamped(reflect_rotation(turned)),
            reflect_rotation(left.clamped(turned)),
        ),
        0,
        atol=1e-7,
    )


BASE = Rig(
    "hero",
    (
        Joint("hip", -1, translation=(0, 1, 0)),
        Joint("knee_l", 0, source_name="knee.l"),
        Joint("knee_r", 0, source_name="knee.r"),
    ),
    0.01,
    bind={"knee_l": Pose((1, 2, 3), (0, 0, 0, 1))},
    shapes=(Shape("smile"),),
)
SIDECAR = """\
rig: animtool/1
name: hero
from: hero.usda
joints:
- {name: knee.l, type: pin, axis: [0, 0, 1], limits: [0, 90], mirror: knee.r}
- {name: knee_r, type: pin, axis: [0, 0, 1], mimic: {joint: knee.l}}
bind: {hip: {translate: [0, 2, 0]}}
controls: [{name: grin, drives: [{shape: smile, expr: grin}]}]
"""


@pytest.fixture
def base(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let every USD file be the base."""
    monkeypatch.setattr(
        "animtool.usd.rigs.stored.read_rig", lambda path: replace(BASE, name=path.name)
    )


def sidecar(folder: Path, text: str) -> Rig:
    path = folder / "hero.rig.yaml"
    path.write_bytes(text.encode("utf-8", "surrogateescape"))
    return load_rig(path)


@pytest.mark.usefixtures("base")
def test_a_sidecar_adds_to_a_base(yard: Path) -> None:
    rig = sidecar(yard, SIDECAR)
    hip, left, right = rig.joints
    assert hip == BASE.joints[0]
    assert (left.type, left.mirror) == (JointType.PIN, "knee_r")
    assert left.limits == RangeLimit(0, math.pi / 2)
    assert right.mimic == Mimic("knee_l")
    assert rig.meters_per_unit == 0.01
    assert rig.bind == {**BASE.bind, "hip": Pose((0, 2, 0), (0, 0, 0, 1))}
    assert rig.shapes == BASE.shapes
    assert not any(isinstance(mesh, Mesh) for mesh in rig.meshes)


def test_a_base_that_cannot_be_read_hides_no_other_fault(yard: Path) -> None:
    text = SIDECAR.replace("axis: [0, 0, 1], limits", "axis: [0, 0, 0], limits")
    text = text.replace("expr: grin}", "expr: grim}") + "ik: [{name: x, root: knee.l, "
    # The base may have a control that is called grim.
    with refused(("RIG023", 3), ("RIG005", 5)):
        sidecar(yard, text + "tip: foot}, {name: y, root: knee.l, tip: knee_r}]\n")


@pytest.mark.usefixtures("base")
def test_a_shape_of_a_sidecar_combines_those_of_the_base(yard: Path) -> None:
    more = "shapes: [{name: grimace, combine: [smile]}]\n"
    rig = sidecar(yard, SIDECAR + more)
    assert [shape.name for shape in rig.shapes] == ["smile", "grimace"]


@pytest.mark.usefixtures("base")
@pytest.mark.parametrize(
    ("old", "new", "code", "line"),
    [
        ("name: knee_r", "name: kne_r", "RIG008", 6),
        ("mirror: knee.r", "mirror: kne.r", "RIG008", 5),
        ("type: pin", "translate: [0, 0, 1], type: pin", "RIG023", 5),
        ("type: pin", "parent: hip, type: pin", "RIG023", 5),
    ],
)
def test_a_fault_of_a_sidecar(
    yard: Path, old: str, new: str, code: str, line: int
) -> None:
    with refused((code, line)):
        sidecar(yard, SIDECAR.replace(old, new, 1))


def test_a_base_that_cannot_be_read(yard: Path) -> None:
    (yard / "hero.usda").write_text("nothing")
    with raises(FormatError, "RIG023", match="USD001"):
        sidecar(yard, SIDECAR)


def chain(folder: Path, *names: str) -> Path:
    """Write sidecars, each of the next one."""
    for name, source in pairwise(names):
        text = f"rig: animtool/1\nname: hero\nfrom: {source}.rig.yaml\n"
        (folder / f"{name}.rig.yaml").write_text(text)
    return folder / f"{names[0]}.rig.yaml"


@pytest.mark.parametrize(
    ("names", "code"), [("aa", "RIG030"), ("aba", "RIG023"), ("abcb", "RIG023")]
)
def test_sidecars_in_a_circle(tmp_path: Path, names: str, code: str) -> None:
    path = chain(tmp_path, *names)
    with raises(FormatError, code, match="RIG030") as caught:
        Rig.load(path)
    (fault,) = caught.value.faults
    assert (fault.where, fault.lines) == ("from", (3,))


def test_a_sidecar_of_a_sidecar(tmp_path: Path) -> None:
    path = chain(tmp_path, *"abc")
    (tmp_path / "c.rig.yaml").write_text(
        "rig: animtool/1\nname: base\njoints: [{name: hips, type: free}]\n"
    )
    assert Rig.load(path).names == ["hips"]


WHOLE = """\
rig: animtool/1
name: base
joints:
- {name: hips, type: free}
- {name: knee, parent: hips, type: pin, axis: [1, 0, 0]}
- {name: foot, parent: knee, type: pin, axis: [1, 0, 0]}
shapes: [{name: smile}]
controls:
- {name: bend, drives: [{joint: knee.angle, expr: bend * 90}]}
- {name: grin, drives: [{shape: smile, expr: grin}]}
ik:
- {name: leg, root: hips, tip: foot}
- {name: shin, root: knee, tip: foot}
attach:
- {name: tail, kind: spring_chain, joints: [foot]}
- {name: ears, kind: spring_chain, joints: [hips]}
colliders:
- {joint: hips, capsule: {radius: 1}}
- {joint: hips, capsule: {radius: 2}}
- {joint: foot, capsule: {radius: 3}}
"""
ADDS = """\
rig: animtool/1
name: more
from: base.rig.yaml
controls:
- {name: both, drives: [{control: bend, expr: both}, {control: grin, expr: both}]}
- {name: grin, drives: [{shape: smile, expr: grin * bend}]}
ik: [{name: shin, root: hips, tip: knee}]
attach: [{name: ears, kind: spring_chain, joints: [knee]}]
colliders: [{joint: hips, capsule: {radius: 4}}]
"""


def more(folder: Path, text: str) -> Rig:
    (folder / "base.rig.yaml").write_text(WHOLE, "utf-8")
    (folder / "more.rig.yaml").write_text(text, "utf-8")
    return load_rig(folder / "more.rig.yaml")


def test_a_sidecar_keeps_what_it_does_not_replace(tmp_path: Path) -> None:
    rig = more(tmp_path, ADDS)
    base = load_rig(tmp_path / "base.rig.yaml")
    assert [control.name for control in rig.controls] == ["bend", "both", "grin"]
    assert rig.controls[0] == base.controls[0]
    assert rig.controls[2] != base.controls[1]
    assert [(chain.name, chain.tip) for chain in rig.chains] == [
        ("leg", "foot"),
        ("shin", "knee"),
    ]
    assert [(entry.name, entry.joints) for entry in rig.attach] == [
        ("tail", ("foot",)),
        ("ears", ("knee",)),
    ]
    found = [(one.joint, round(one.capsule.radius, 9)) for one in rig.colliders]
    assert found == [("foot", 3), ("hips", 4)]
    bare = more(tmp_path, ADDS[: ADDS.index("controls:")])
    for name in ("controls", "chains", "attach", "colliders"):
        assert getattr(bare, name) == getattr(base, name)


@pytest.mark.parametrize(
    ("old", "new", "code", "line"),
    [
        ("expr: grin * bend", "expr: grin * bent", "RIG012", 6),
        ("control: bend", "control: bent", "RIG012", 5),
        ("{control: grin, expr: both}", "{control: both, expr: bend}", "RIG014", 5),
        ("controls:", "joints: [{name: knee, type: ball}]\ncontrols:", "RIG023", 3),
    ],
)
def test_what_a_sidecar_does_to_the_controls_of_its_base(
    tmp_path: Path, old: str, new: str, code: str, line: int
) -> None:
    with refused((code, line)):
        more(tmp_path, ADDS.replace(old, new, 1))


def test_cloth_of_a_base_goes_with_its_mesh(tmp_path: Path) -> None:
    np.savez(tmp_path / "a.npz", points=np.eye(3), faces=np.array([[0, 1, 2]]))
    mesh = "meshes: [{name: cape, points: a.npz, faces: a.npz}]\n"
    cloth = "attach:\n- {name: cloak, kind: cloth, mesh: cape}\n"
    (tmp_path / "c.rig.yaml").write_text(WHOLE.replace("attach:\n", mesh + cloth))
    head = "rig: animtool/1\nname: more\nfrom: c.rig.yaml\n"
    for text, names in (("", ["cloak", "tail", "ears"]), (mesh, ["tail", "ears"])):
        (tmp_path / "more.rig.yaml").write_text(head + text)
        rig = load_rig(tmp_path / "more.rig.yaml")
        assert [entry.name for entry in rig.attach] == names


def test_too_many_sidecars(tmp_path: Path) -> None:
    path = chain(tmp_path, *"abcdefghijklmnopqrstuvwxyz")
    with raises(FormatError, "RIG023", match="RIG030"):
        Rig.load(path)
