"""MJCF: joints of every kind, ties, includes, and what is refused."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose
from support.faults import raises
from support.robots import rig_matrices, write

from animtool.core.errors import FormatError, OptionError
from animtool.core.readers import MJCF, is_timeline, reader_of
from animtool.formats.mjcf.read import read_mjcf, read_mjcf_rig
from animtool.rig.driver_plan import plan_of
from animtool.rig.driving import driven_coordinates
from animtool.rig.joints import coordinate_slices
from animtool.rig.limits import RangeLimit
from animtool.rig.skeleton import JointType, Mimic

mujoco = pytest.importorskip("mujoco")

MODEL = """\
<mujoco model="arm">
  <compiler angle="radian"/>
  <default><default class="thick"><geom size="0.1"/></default></default>
  <worldbody>
    <body name="a" pos="0.1 0.2 0.3" euler="0.3 0.1 0.2">
      <joint name="one" axis="1 2 0" pos="0.1 0 0"/>
      <joint name="two" axis="0 0 1" pos="0 0.1 0" ref="0.4"/>
      <joint name="push" type="slide" axis="0 1 1" ref="-0.2" range="-1 1"/>
      <geom class="thick"/>
      <body pos="0 0 1"><joint type="ball" pos="0 0 0.1"/><geom class="thick"/>
        <body name="c" pos="0 1 0"><joint name="c" axis="1 0 0"/><geom class="thick"/>
          <site name="tip" pos="0 0 0.5"/></body></body>
    </body>
    <body name="free" pos="1 0 0" euler="0 0 1"><freejoint name="float"/>
      <geom class="thick"/></body>
  </worldbody>
</mujoco>
"""


def with_equality(inner: str) -> str:
    return MODEL.replace("</mujoco>", f"<equality>{inner}</equality></mujoco>")


@pytest.mark.parametrize("seed", range(5))
def test_bodies_are_where_mujoco_has_them(tmp_path: Path, seed: int) -> None:
    rng = np.random.default_rng(seed)
    rig = read_mjcf_rig(write(tmp_path, MODEL, "arm.xml"))
    model = mujoco.MjModel.from_xml_string(MODEL)
    data = mujoco.MjData(model)
    values: dict[str, Any] = {}
    for joint in range(model.njnt):
        at = int(model.jnt_qposadr[joint])
        if model.jnt_type[joint] == 1:
            turn = rng.normal(size=4)
            data.qpos[at : at + 4] = turn = turn / np.linalg.norm(turn)
            (name,) = (one.name for one in rig.joints if one.type is JointType.BALL)
            values[name] = [*turn[1:], turn[0]]
        elif model.jnt_type[joint] > 1:
            data.qpos[at] = values[model.joint(joint).name] = float(rng.normal())
    mujoco.mj_kinematics(model, data)
    ours = rig_matrices(rig, values)
    for body in range(1, model.nbody):
        name = model.body(body).name or "body_1"
        assert_allclose(ours[name][:3, 3], data.xpos[body], atol=1e-12)
        assert_allclose(ours[name][:3, :3].ravel(), data.xmat[body], atol=1e-12)
    assert_allclose(ours["tip"][:3, 3], data.site_xpos[0], atol=1e-12)


def test_what_joints_are(tmp_path: Path) -> None:
    rig = read_mjcf_rig(write(tmp_path, MODEL, "arm.xml"))
    types = {joint.name: joint.type for joint in rig.joints}
    assert types["push"] is JointType.PRISMATIC
    assert types["float"] is JointType.FREE
    assert types["c"] is JointType.PIN
    assert rig.joints[rig.index("push")].limits == RangeLimit(-1.0, 1.0)
    assert rig.radians_per_unit == 1.0
    assert [notice.code for notice in rig.notices].count("MJC109") == 1
    assert read_mjcf(tmp_path / "arm.xml").collect().motion.frames == 1
    assert len(rig.masses) == len(rig.colliders) == 4


def test_linear_ties_are_mimics_and_others_drivers(tmp_path: Path) -> None:
    text = with_equality(
        '<joint joint1="two" joint2="push" polycoef="0.1 2 0 0 0"/>'
        '<joint joint1="c" joint2="one" polycoef="0.1 0 0.5 0 -0.25"/>'
    )
    rig = read_mjcf_rig(write(tmp_path, text, "arm.xml"))
    # q - 0.4 = 0.1 + 2 (p + 0.2)
    mimic = rig.joints[rig.index("two")].mimic
    assert mimic is not None
    assert (mimic.joint, mimic.gain) == ("push", 2.0)
    assert mimic.offset == pytest.approx(0.9)
    slices = coordinate_slices(rig)
    q = np.zeros((1, slices[-1].stop))
    q[0, slices[rig.index("one")]] = 0.7
    driven = driven_coordinates(plan_of(rig), q)[0, slices[rig.index("c")]]
    assert_allclose(driven, 0.1 + 0.5 * 0.7**2 - 0.25 * 0.7**4, rtol=1e-15)


def test_ties_of_ties_are_of_the_joint_that_moves(tmp_path: Path) -> None:
    text = with_equality(
        '<joint joint1="c" joint2="one" polycoef="1 2 0 0 0"/>'
        '<joint joint1="one" joint2="push" polycoef="0 3 0 0 0"/>'
    )
    rig = read_mjcf_rig(write(tmp_path, text, "arm.xml"))
    own, inner = (rig.joints[rig.index(name)].mimic for name in ("c", "one"))
    assert own is not None
    assert isinstance(inner, Mimic)
    assert (own.joint, own.gain) == ("push", 6.0)
    assert own.offset == pytest.approx(1 + 2 * 3 * 0.2)


@pytest.mark.parametrize(
    ("old", "new", "code", "words"),
    [
        ("</mujoco>", "", "MJC001", "ends inside"),
        ("<mujoco", "<!DOCTYPE mujoco []><mujoco", "MJC002", "DTD"),
        ("0 0 1", "0 0 nan", "MJC007", "joint 'two'.*not finite"),
        ('axis="0 0 1"', 'axis="0 0 0"', "MJC008", "joint 'two'.*axis too small"),
        ('<joint name="c" axis="1 0 0"', '<joint axis="0 0 0"', "MJC008",
         "joint of body 'c'.*axis too small"),
        ('pos="0 0 1"', 'pos="0 0 1e30"', "MJC007", "body_pos beyond"),
        ("-1 1", "1 -1", "MJC011", "'push'.*1 is above -1"),
        ('name="c" pos', 'name="a" pos', "MJC008", "body 'a'.*repeated"),
        ('type="ball" pos="0 0 0.1"', 'type="free" name="f"', "MJC008", "top level"),
        ("<site", "<sit", "MJC008", "unrecognized element"),
        ("<site", '<attach model="m" body="b" prefix="p"/><site', "MJC009", "attach"),
        ("<worldbody>", '<include file="none.xml"/><worldbody>', "MJC006", "none.xml"),
        ("<worldbody>", '<include file="../x.xml"/><worldbody>', "MJC006", "outside"),
        ("<worldbody>", '<include file="arm.xml"/><worldbody>', "MJC006", "itself"),
        ("</mujoco>", '<equality><joint joint1="c" joint2="one"/><joint joint1="one" '
         'joint2="c"/></equality></mujoco>', "MJC010", "ring: c → one → c"),
        ("</mujoco>", '<equality><joint joint1="c" joint2="one"/><joint joint1="c" '
         'joint2="two"/></equality></mujoco>', "MJC010", "'c' is tied to two"),
    ],
)  # fmt: skip
def test_what_is_broken_is_refused(
    tmp_path: Path, old: str, new: str, code: str, words: str
) -> None:
    folder = tmp_path / "inside"
    folder.mkdir()
    (tmp_path / "x.xml").write_text("<mujocoinclude/>")
    assert old in MODEL
    path = write(folder, MODEL.replace(old, new, 1), "arm.xml")
    with raises(FormatError, code, match=words):
        read_mjcf_rig(path)
    assert not (Path.cwd() / "MUJOCO_LOG.TXT").exists()


def test_faults_of_an_included_file_have_its_line(tmp_path: Path) -> None:
    (tmp_path / "parts").mkdir()
    write(
        tmp_path / "parts",
        '<mujocoinclude>\n<body name="d">\n<joint name="bad" axis="0 0 0"/>'
        '<geom size="1"/></body></mujocoinclude>',
        "d.xml",
    )
    text = MODEL.replace("<worldbody>", '<worldbody><include file="parts/d.xml"/>')
    with raises(FormatError, "MJC008", match="joint 'bad'") as caught:
        read_mjcf_rig(write(tmp_path, text, "arm.xml"))
    (fault,) = caught.value.faults
    assert (Path(fault.path or "").name, fault.lines) == ("d.xml", (3,))


def test_geoms_of_meshes_are_left_out_with_their_masses(tmp_path: Path) -> None:
    text = MODEL.replace(
        "<worldbody>", '<asset><mesh name="m" file="m.obj"/></asset><worldbody>'
    ).replace('<geom class="thick"/>', '<geom type="mesh" mesh="m"/>', 1)
    rig = read_mjcf_rig(write(tmp_path, text, "arm.xml"))
    assert len(rig.masses) == 3
    codes = [notice.code for notice in rig.notices]
    assert {"MJC101", "MJC103", "MJC107"} <= set(codes)


def test_assets_outside_the_project_are_noted_and_never_opened(tmp_path: Path) -> None:
    folder = tmp_path / "inside"
    folder.mkdir()
    (tmp_path / "x.obj").write_text("no mesh")
    assets = '<asset><mesh file="../x.obj"/><texture type="2d" file="/y.png"/></asset>'
    text = MODEL.replace("<worldbody>", f"{assets}<worldbody>")
    rig = read_mjcf_rig(write(folder, text, "arm.xml"))
    without_assets = read_mjcf_rig(write(folder, MODEL, "plain.xml"))
    assert rig.names == without_assets.names
    (notice,) = [notice for notice in rig.notices if notice.code == "MJC016"]
    assert "2 files" in notice.message


def test_an_include_outside_the_project_names_the_folder_that_allows_it(
    tmp_path: Path,
) -> None:
    for name in ("inside", "parts"):
        (tmp_path / name).mkdir()
    (tmp_path / "parts/x.xml").write_text("<mujocoinclude/>")
    text = MODEL.replace("<worldbody>", '<include file="../parts/x.xml"/><worldbody>')
    path = write(tmp_path / "inside", text, "arm.xml")
    with raises(FormatError, "MJC006") as caught:
        read_mjcf_rig(path)
    (fault,) = caught.value.faults
    assert str(tmp_path) in (fault.hint or "")
    (tmp_path / "animtool.toml").write_text("")
    assert read_mjcf_rig(path).names == read_mjcf_rig(write(tmp_path, MODEL)).names


def test_without_mujoco_it_says_what_to_install(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "mujoco", None)
    with raises(OptionError, "MJC005", match=r"animtool\[mjcf\]"):
        read_mjcf_rig(write(tmp_path, MODEL, "arm.xml"))


def test_a_timeline_in_xml_is_none_of_it(tmp_path: Path) -> None:
    model = write(tmp_path, MODEL, "arm.xml")
    cut = write(tmp_path, "<?xml version='1.0'?><!DOCTYPE xmeml><xmeml/>", "cut.xml")
    assert (reader_of(model), is_timeline(model)) == (MJCF, False)
    assert (reader_of(cut), is_timeline(cut)) == (None, True)


@pytest.mark.parametrize(
    ("angle", "ranges", "found"),
    [
        ("degree", ("-1.5708 1.5708", "0 2.6"), True),
        ("degree", ("-90 90", "0 150"), False),
        ("degree", ("-90 90", "-2 2"), False),  # a stiff joint
        ("radian", ("-90 90", "0 150"), True),
        ("radian", ("-1.5708 1.5708", "0 2.6"), False),
        ("radian", ("-6.28319 6.28319", "-12.56637 12.56637"), False),  # winds up
    ],
)
def test_ranges_in_another_unit(
    tmp_path: Path, angle: str, ranges: tuple[str, str], found: bool
) -> None:
    text = MODEL.replace('angle="radian"', f'angle="{angle}" autolimits="true"')
    for name, range_ in zip(("one", "two"), ranges, strict=True):
        text = text.replace(f'name="{name}"', f'name="{name}" range="{range_}"')
    path = write(tmp_path, text.replace(' ref="0.4"', ""), "arm.xml")
    codes = [notice.code for notice in read_mjcf_rig(path).notices]
    assert codes.count("MJC110") == found


def test_free_joints_count_from_the_frame_of_the_file(tmp_path: Path) -> None:
    text = MODEL.replace('<freejoint name="float"/>', '<freejoint align="true"/>')
    text = text.replace('euler="0 0 1">', 'euler="0 0 1"><geom size="1" pos="1 2 3"/>')
    ours = rig_matrices(read_mjcf_rig(write(tmp_path, text, "arm.xml")), {})["free"]
    half = np.array([np.cos(1), np.sin(1)])
    assert_allclose(ours[:2, 0], half, atol=1e-12)
    assert_allclose(ours[:3, 3], [1, 0, 0], atol=1e-12)


def test_equalities_are_inactive_by_default_class(tmp_path: Path) -> None:
    text = with_equality('<joint joint1="c" joint2="one"/>')
    text = text.replace("<default>", '<default><equality active="false"/>')
    rig = read_mjcf_rig(write(tmp_path, text, "arm.xml"))
    assert rig.joints[rig.index("c")].mimic is None


def test_constants_hold_in_a_take(tmp_path: Path) -> None:
    text = with_equality('<joint joint1="c" polycoef="0.3 0 0 0 0"/>')
    path = write(tmp_path, text, "arm.xml")
    take = read_mjcf(path).collect()
    turn = take.motion.rotations.dense()[0, take.rig.index("c")]
    assert_allclose(turn, [np.sin(0.15), 0, 0, np.cos(0.15)], atol=1e-12)


@pytest.mark.parametrize(
    ("equality", "found"),
    [
        ('<joint joint1="c" joint2="push" polycoef="0 2 0 0 0"/>', True),
        ('<joint joint1="c" joint2="push" polycoef="0 1 0 0 0"/>', False),
        ('<joint joint1="c" joint2="one" polycoef="0 9 0 0 0"/>', False),  # unlimited
        (
            '<joint joint1="c" joint2="one" polycoef="0 1 0 0 0"/><joint joint1="push" '
            'joint2="one" polycoef="3 1 0 0 0"/>',
            True,
        ),
        (
            '<joint joint1="c" joint2="one" polycoef="0 1 0 0 0"/><joint joint1="push" '
            'joint2="one" polycoef="2 1 0 0 0"/>',
            False,
        ),
        # Beyond at the ends of its leader's range, in its middle, and nowhere.
        ('<joint joint1="c" joint2="push" polycoef="0 0 9 0 0"/>', True),
        ('<joint joint1="c" joint2="push" polycoef="1.6 0 -1 0 0"/>', True),
        ('<joint joint1="c" joint2="push" polycoef="1.4 0 -1 0 0"/>', False),
        ('<joint joint1="c" joint2="one" polycoef="0 0 9 0 0"/>', False),  # unlimited
        ('<joint joint1="c" polycoef="2 0 0 0 0"/>', True),
        ('<joint joint1="c" polycoef="1 0 0 0 0"/>', False),
    ],
)
def test_equalities_beyond_limits(tmp_path: Path, equality: str, found: bool) -> None:
    text = with_equality(equality).replace(
        'name="c" axis', 'name="c" range="-1.5 1.5" axis'
    )
    rig = read_mjcf_rig(write(tmp_path, text, "arm.xml"))
    assert [notice.code for notice in rig.notices].count("MJC111") == found
