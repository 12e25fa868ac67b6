"""URDF: every kind of joint, what is refused, and what is noted."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose
from support.cli import animtool
from support.faults import raises
from support.robots import (
    ARM,
    link_matrices,
    random_robot,
    rig_matrices,
    rig_values,
    write,
)

from animtool.core.errors import FormatError, Severity
from animtool.core.units import UpAxis
from animtool.formats.urdf.read import read_urdf, read_urdf_rig
from animtool.rig.file import load_rig
from animtool.rig.limits import RangeLimit
from animtool.rig.skeleton import JointType, Mimic
from animtool.rig.write import rig_text

TOLERANCE = 1e-12


def codes(path: Path) -> list[str]:
    return [notice.code for notice in read_urdf_rig(path).notices]


@pytest.mark.parametrize("seed", range(25))
def test_links_of_any_tree_are_where_arithmetic_puts_them(
    tmp_path: Path, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    robot = random_robot(rng, int(rng.integers(1, 30)))
    rig = read_urdf_rig(write(tmp_path, robot.text))
    values = rig_values(rig, robot)
    ours, theirs = rig_matrices(rig, values), link_matrices(robot)
    size = 1 + max(np.abs(matrix[:3, 3]).max() for matrix in theirs.values())
    for name, matrix in theirs.items():
        assert np.abs(ours[name][:3, 3] - matrix[:3, 3]).max() <= TOLERANCE * size
        assert np.abs(ours[name][:3, :3] - matrix[:3, :3]).max() <= TOLERANCE
    for joint in rig.joints:
        if joint.mimic is not None:
            led = joint.mimic.gain * values[joint.mimic.joint] + joint.mimic.offset
            assert led == pytest.approx(values[joint.name], rel=1e-9, abs=1e-9)
    path = tmp_path / "again.rig.yaml"
    path.write_text(rig_text(rig), "utf-8")
    assert load_rig(path).joints == rig.joints


def test_a_robot_is_in_metres_and_radians_z_up(tmp_path: Path) -> None:
    rig = read_urdf_rig(write(tmp_path, ARM))
    assert (rig.name, rig.meters_per_unit, rig.radians_per_unit) == ("arm", 1.0, 1.0)
    assert rig.up is UpAxis.Z
    assert rig.names == ["base", "pan", "upper", "elbow", "lower", "tool"]
    elbow = rig.joints[rig.index("elbow")]
    assert (elbow.type, elbow.axis) == (JointType.PIN, (0.0, 1.0, 0.0))
    assert elbow.limits == RangeLimit(-2.0, 2.0)
    assert rig.joints[rig.index("pan")].limits is None
    # Chains of IK are those of moving joints.
    assert rig.joints[elbow.parent].name == "pan"
    (mass,) = rig.masses
    assert (mass.joint, mass.mass, mass.centre) == ("pan", 2.0, (0.0, 0.0, 0.2))
    assert mass.inertia == pytest.approx((0.01, 0.02, 0.03))
    (collider,) = rig.colliders
    assert collider.joint == "pan"
    assert collider.capsule.radius == 0.04
    assert_allclose(collider.capsule.length, 0.32)
    assert collider.capsule.offset == (0.0, 0.0, 0.2)


def test_a_take_of_it_stands_inside_its_limits(tmp_path: Path) -> None:
    text = ARM.replace('lower="-2"', 'lower="0.5"')
    path = write(tmp_path, text)
    take = read_urdf(path).collect()
    assert take.motion.frames == 1
    turn = take.motion.rotations.dense()[0, take.rig.index("elbow")]
    rest = take.rig.rest_rotations[take.rig.index("elbow")]
    assert 2 * np.arccos(abs(float(turn @ rest))) == pytest.approx(0.5)
    assert "URD109" in codes(path)


def test_mimics_of_mimics_are_of_the_joint_that_moves(tmp_path: Path) -> None:
    joint = (
        '<link name="{1}"/><joint name="{0}" type="prismatic"><parent link="{2}"/>'
        '<child link="{1}"/><limit lower="-9" upper="9"/>{3}</joint>'
    )
    more = joint.format("a", "la", "tool", '<mimic joint="b" multiplier="2"/>')
    more += joint.format(
        "b", "lb", "la", '<mimic joint="elbow" multiplier="-3" offset="0.5"/>'
    )
    text = ARM.replace("</robot>", f"{more}</robot>")
    rig = read_urdf_rig(write(tmp_path, text))
    assert rig.joints[rig.index("a")].mimic == Mimic("elbow", -6.0, 1.0)
    assert rig.joints[rig.index("b")].mimic == Mimic("elbow", -3.0, 0.5)


ELBOW = '<joint name="elbow" type="revolute">'
MIMIC = '<mimic joint="{}"/>'


@pytest.mark.parametrize(
    ("old", "new", "code", "words"),
    [
        ("</robot>", "", "URD001", "ends inside <robot>"),
        ("<robot", '<!DOCTYPE robot SYSTEM "a.dtd"><robot', "URD002", "DTD"),
        ("</robot>", "<x>" * 501 + "</x>" * 501 + "</robot>", "URD003", "500"),
        ('<robot name="arm">', '<robot name="${n}">', "URD005", "xacro"),
        ("<link name", "<xacro:if/><link name", "URD005", "<xacro:if>"),
        ('name="elbow" ', "", "URD006", "name of <joint> is missing"),
        ('<parent link="upper"/>', "", "URD006", "joint 'elbow': <parent> is missing"),
        ("0 2 0", "0 2 nan", "URD007", "joint 'elbow'.*not finite"),
        ("0 2 0", "0,5 2 0", "URD007", "not a number.*decimals with a point"),
        ("0 2 0", "0 2", "URD007", "2 values, not 3"),
        ("0 0 0.4", "0 0 1e30", "URD007", r"beyond 1e\+09"),
        ("revolute", "revolut", "URD008", "did you mean 'revolute'"),
        ("</robot>", '<link name="base"/></robot>', "URD009", "two links.*'base'"),
        ('name="pan"', 'name="hand"', "URD009", "two joints are named 'hand'"),
        ('child link="tool"', 'child link="tol"', "URD010", "'tol'.*mean 'tool'"),
        ('parent link="base"', 'parent link="tool"', "URD011", "form a loop"),
        ('child link="upper"', 'child link="tool"', "URD011", "'tool' has two parents"),
        ("</robot>", '<link name="b"/></robot>', "URD012", "'base', 'b'"),
        ("0 2 0", "0 0 0", "URD013", "'elbow'.*no length"),
        ('lower="-2"', 'lower="3"', "URD014", "'elbow'.*3 is above its upper limit 2"),
        (
            "<axis xyz",
            f"{MIMIC.format('el')}<axis xyz",
            "URD015",
            "'pan'.*'el'.*elbow",
        ),
        (ELBOW, ELBOW + MIMIC.format("elbow"), "URD015", "elbow → elbow"),
        (ELBOW, ELBOW + MIMIC.format("hand"), "URD015", "'hand', which is fixed"),
    ],
)
def test_what_is_broken_is_refused(
    tmp_path: Path, old: str, new: str, code: str, words: str
) -> None:
    assert old in ARM
    path = write(tmp_path, ARM.replace(old, new, 1))
    with raises(FormatError, code, match=words) as caught:
        read_urdf_rig(path)
    assert caught.value.faults[0].lines


@pytest.mark.parametrize(
    ("text", "hint"),
    [("<mujoco/>", ".xml"), ("<sdf/>", "SDF|sdf"), ("<a/>", "<robot>")],
)
def test_other_kinds_of_xml_are_named(tmp_path: Path, text: str, hint: str) -> None:
    with raises(FormatError, "URD004", match=hint):
        read_urdf_rig(write(tmp_path, text))


def test_every_fault_is_told_at_once(tmp_path: Path) -> None:
    text = ARM.replace("0 2 0", "0 0 0").replace('lower="-2"', 'lower="5"')
    with pytest.raises(FormatError) as caught:
        read_urdf_rig(write(tmp_path, text))
    assert [fault.code for fault in caught.value.faults] == ["URD013", "URD014"]


def with_mesh(name: str) -> str:
    mesh = f'<visual><geometry><mesh filename="{name}"/></geometry></visual>'
    return ARM.replace('<link name="lower"/>', f'<link name="lower">{mesh}</link>')


@pytest.mark.parametrize(
    "name",
    [
        "../secret.obj",
        "package://robot/../../secret.obj",
        "file:///etc/passwd",
        "/etc/passwd",
        "http://localhost/a.obj",
    ],
)
def test_a_mesh_outside_is_refused_and_not_looked_at(tmp_path: Path, name: str) -> None:
    inside = tmp_path / "inside"
    inside.mkdir()
    (tmp_path / "secret.obj").write_text("v 0 0 0\n")
    with raises(FormatError, "URD016", match="link 'lower'"):
        read_urdf_rig(write(inside, with_mesh(name)))


@pytest.mark.parametrize("folder", ["urdf", "URDF", "robots", "parts"])
def test_meshes_beside_a_folder_of_robots_are_read(tmp_path: Path, folder: str) -> None:
    for name in ("arm/meshes", f"arm/{folder}"):
        (tmp_path / name).mkdir(parents=True)
    (tmp_path / "arm/meshes/a.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    (tmp_path / "secret.obj").write_text("v 0 0 0\n")
    path = write(tmp_path / "arm" / folder, with_mesh("../meshes/a.obj"))
    if folder == "parts":
        with raises(FormatError, "URD016"):
            read_urdf_rig(path)
        return
    assert len(read_urdf_rig(path).meshes) == 1
    with raises(FormatError, "URD016"):
        read_urdf_rig(write(tmp_path / "arm" / folder, with_mesh("../../secret.obj")))


def test_meshes_of_the_package_are_found(tmp_path: Path) -> None:
    folder = tmp_path / "other_name/urdf"
    folder.mkdir(parents=True)
    path = write(folder, with_mesh("package://my_robot/meshes/a.obj"))
    assert "URD103" in codes(path)
    (tmp_path / "other_name/meshes").mkdir()
    (tmp_path / "other_name/meshes/a.obj").write_text("v 0 0 0\n")
    assert "URD113" in codes(path)
    write(tmp_path / "other_name", "<package><name>my_robot</name></package>",
          "package.xml")  # fmt: skip
    assert "URD103" not in codes(path)


@pytest.mark.parametrize(
    ("old", "new", "code"),
    [
        ("</robot>", "<gazebo/></robot>", "URD101"),
        ('name="hand"', 'name="upper"', ""),
        ('name="pan"', 'name="lower"', "URD102"),
        ('upper="2"', 'upper="-2"', "URD104"),
        ("</robot>", '<ros2_control><joint name="pan"/></ros2_control></robot>',
         "URD105"),
        ('mass value="2"', 'mass value="-2"', "URD107"),
        ('iyy="0.03"', 'iyy="0.3"', "URD107"),
        ("</robot>", "</robot>", "URD106"),
    ],
)  # fmt: skip
def test_what_is_odd_is_noted(tmp_path: Path, old: str, new: str, code: str) -> None:
    assert old in ARM
    found = codes(write(tmp_path, ARM.replace(old, new, 1)))
    assert code in found or not code
    assert len(found) == len(set(found))
    if code == "":
        assert "URD102" not in found


AXIS = '<axis xyz="0 2 0"/>'
LIMIT = '<limit lower="-2" upper="2" effort="1" velocity="1"/>'


@pytest.mark.parametrize(
    ("old", "new", "line", "words"),
    [
        (f"{AXIS}\n    {LIMIT}\n  </joint>", f"{LIMIT}</joint>\n {AXIS}", 18,
         "'elbow' .line 15. has none and turns about x; move it into <joint name="),
        (f'rpy="0.1 0 0"/>{AXIS}', f'rpy="0.1 0 0">{AXIS}</origin>', 17,
         "<axis> in <origin>.*'elbow'"),
        (f"{AXIS}\n", f"{AXIS.replace('axis', 'axs')}\n", 17, "mean <axis>"),
        (AXIS, AXIS.replace("xyz", "xzy"), 17, "xzy of <axis>.*mean xyz"),
        (AXIS, AXIS.replace("xyz", "value"), 17, "value of <axis>.*are xyz"),
        ('rpy="0.1 0 0"', 'rypy="0.1 0 0"', 17, "rypy of <origin>.*mean rpy"),
        ("<collision><origin", "<visuals/><collision><origin", 7, "mean <visual>"),
        ('<mass value="2"/>\n', '</inertial><mass value="2"/><inertial>\n', 5,
         "<mass> in <link>.*belongs in <inertial>"),
        ("<parent link=\"upper\"/>", "<joint name=\"x\"/><parent link=\"upper\"/>", 16,
         "<joint> in <joint>"),
    ],
)  # fmt: skip
def test_misplaced_and_misspelt_elements_are_named(
    tmp_path: Path, old: str, new: str, line: int, words: str
) -> None:
    assert old in ARM
    notices = read_urdf_rig(write(tmp_path, ARM.replace(old, new, 1))).notices
    (found,) = (notice for notice in notices if notice.code == "URD112")
    assert (found.severity, found.lines) == (Severity.WARNING, (line,))
    assert re.search(words, str(found))


def test_extensions_may_hold_any_element(tmp_path: Path) -> None:
    more = "<gazebo><axis/><joint/></gazebo><sensor><origin/><limit/></sensor>"
    text = ARM.replace("</robot>", f"{more}</robot>")
    text = text.replace("<geometry>", "<verbose/><contact><limit/></contact><geometry>")
    assert "URD112" not in codes(write(tmp_path, text))


def test_what_is_misplaced_is_named_where_it_is_missing(tmp_path: Path) -> None:
    moved = ARM.replace(LIMIT, "").replace("</robot>", f"{LIMIT}</robot>")
    for text in (moved, ARM.replace("<limit", "<limits")):
        with raises(FormatError, "URD014", "URD112", match="'elbow'.*no <limit>"):
            read_urdf_rig(write(tmp_path, text))


def test_a_mimic_beyond_its_limits_is_named(tmp_path: Path) -> None:
    more = (
        '<link name="f"/><joint name="f_j" type="prismatic"><parent link="tool"/>'
        '<child link="f"/><limit lower="0" upper="0.1"/><mimic joint="elbow"/></joint>'
    )
    text = ARM.replace("</robot>", f"{more}</robot>")
    rig = read_urdf_rig(write(tmp_path, text))
    (notice,) = (one for one in rig.notices if one.code == "URD108")
    assert (notice.joint, notice.severity) == ("f_j", Severity.WARNING)


def test_names_that_no_file_may_hold_are_changed(tmp_path: Path) -> None:
    text = ARM.replace('"tool"', '"to&#10;ol"')
    rig = read_urdf_rig(write(tmp_path, text))
    assert "to_ol" in rig.names
    assert "URD102" in [notice.code for notice in rig.notices]


@pytest.mark.slow
def test_commands_take_a_robot_as_a_rig(tmp_path: Path) -> None:
    path = write(tmp_path, ARM)
    targets = write(
        tmp_path,
        "targets: animtool/1\nrange: [1, 4]\nfps: 24\ngoals:\n- effector: tool\n"
        "  position: {keys: [{t: 1, v: [0.1, 0.1, 0.6]}]}\n",
        "a.targets.yaml",
    )
    for command in (
        ["info", path],
        ["validate", path],
        ["ik", path, "--targets", targets, "-o", tmp_path / "a.usda"],
        ["ik", path, "--targets", targets, "-o", tmp_path / "a.clip.yaml"],
        ["convert", path, tmp_path / "a.rig.yaml", "--overwrite"],
        ["convert", path, tmp_path / "rig.usda"],
        ["convert", path, tmp_path / "a.bvh"],
        ["bake", path, "-o", tmp_path / "still.usda"],
        ["preview", path, "-o", tmp_path / "a.html"],
        ["batch", tmp_path / "*.urdf", "-o", f"{tmp_path}/out/"],
    ):
        done = animtool(*command)
        assert done.code == 0, done.stderr
    refused = animtool("convert", path, tmp_path / "b.urdf")
    assert (refused.code, "OUT004" in refused.stderr) == (2, True)
    sidecar = write(
        tmp_path,
        "rig: animtool/1\nname: arm\nfrom: robot.urdf\n"
        "ik:\n- {name: reach, root: pan, tip: tool}\n",
        "side.rig.yaml",
    )
    assert load_rig(sidecar).chains[0].tip == "tool"


@pytest.mark.parametrize(("factor", "found"), [(1000, True), (100, True), (10, False)])
def test_a_robot_in_millimetres(tmp_path: Path, factor: int, found: bool) -> None:
    def scaled(match: re.Match[str]) -> str:
        numbers = (f"{factor * float(number):g}" for number in match[1].split())
        return f'<origin xyz="{" ".join(numbers)}"'

    text = re.sub('<origin xyz="([^"]*)"', scaled, ARM)
    path = write(tmp_path, text)
    assert ("RIG217" in codes(path)) is found
    hints = [n.hint or "" for n in read_urdf_rig(path).notices if n.code == "RIG217"]
    # Shapes keep their size.
    assert all("the xyz of joint origins" in hint for hint in hints)


def test_a_mesh_under_another_package_name_is_named(tmp_path: Path) -> None:
    """URD113: the file is there, in the package of the URDF or in its folder."""
    package = tmp_path / "arm_description"
    for name in ("urdf", "meshes"):
        (package / name).mkdir(parents=True)
    write(package, "<package><name>arm_description</name></package>", "package.xml")
    (package / "meshes/part_a.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    right = "package://arm_description/meshes/part_a.obj"
    for name in (
        "package://arm_desc/meshes/part_a.obj",
        "package://arm_description/meshes/Part-A.obj",
        "meshes/part_a.obj",
    ):
        path = write(package / "urdf", with_mesh(name))
        (notice,) = (n for n in read_urdf_rig(path).notices if n.code == "URD113")
        assert notice.severity is Severity.WARNING
        assert notice.lines
        assert str(notice.hint).endswith(f"write {right}")
        assert "URD103" not in codes(path)
    for name in ("../../meshes/part_a.obj", "/x/arm_description/meshes/part_a.obj"):
        with raises(FormatError, "URD016", match=f"write {right}"):
            read_urdf_rig(write(package / "urdf", with_mesh(name)))
    path = write(package / "urdf", with_mesh(right))
    assert {"URD103", "URD113"}.isdisjoint(codes(path))
    for name in ("package://arm_desc/meshes/part_b.obj", "part_b.obj"):
        path = write(package / "urdf", with_mesh(name))
        assert "URD103" in codes(path)
        assert "URD113" not in codes(path)
