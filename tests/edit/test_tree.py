"""A joint on the end of a rope: where it is, and how it is turned."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose
from pxr import Usd, UsdGeom, UsdSkel
from support.faults import raises

from animtool import bake
from animtool.core.clock import Clock
from animtool.core.errors import FormatError, OptionError
from animtool.core.shot import Shot
from animtool.core.units import UpAxis
from animtool.edit.tree import hang
from animtool.maths import so3
from animtool.motion.motion import Channel, Motion
from animtool.motion.take import Take
from animtool.rig.skeleton import Joint, JointType, Rig
from animtool.scene.file.read import load_scene
from animtool.scene.scene import Scene

FRAMES = 5
RIG = Rig(
    "crane",
    (
        Joint("arm", -1, JointType.BALL, (0, 2, 0)),
        Joint("lamp", 0, JointType.FREE, (1, 0, 0), (0, 0, 0.6, 0.8)),
        Joint("flame", 1, JointType.FIXED, (0, -0.1, 0)),
    ),
)
SCENE = """\
scene: animtool/1
source: {{file: crane.clip.yaml}}
passes:
- hang: {options}
systems:
- rope:
    name: rope
    from: [0.5, 2, 0]
    to: [0.5, 1.5, 0]
    count: 6
    mass: 0.1
    springs: {{structural: {{axial_stiffness: 500, ratio: 0.1}}}}
    pins: [{{particles: [start], joint: {{source: true, joint: arm}}}}]
- cloth:
    name: flag
    resolution: [3, 3]
    mass: 0.1
    springs: {{structural: {{stiffness: 100}}}}
"""
RIG_FILE = """\
rig: animtool/1
name: crane
up: {up}
joints:
- {{name: arm, type: ball}}
- {{name: lamp, type: free, parent: arm, translate: [.5, 0, 0]}}
- {{name: flame, type: fixed, parent: lamp, tips: [[0, 0, .1]]}}
"""
CLIP = """\
clip: animtool/1
rig: crane.rig.yaml
fps: 24
range: [1, 8]
channels:
- {target: joint/arm.rotation, euler: XYZ, interp: linear,
   keys: [{t: 1, v: [0, 0, 0]}, {t: 8, v: [40, 30, -50]}]}
"""


def moving() -> Take:
    """An arm that turns, and carries the lamp."""
    vectors = 0.3 * np.sin(np.arange(FRAMES)[:, None] + [0.0, 1.0, 2.0])
    rotations = np.tile(RIG.rest_rotations, (FRAMES, 1, 1))
    rotations[:, 0] = so3.exp(vectors)
    translations = np.tile(RIG.rest_translations, (FRAMES, 1, 1))
    motion = Motion(Channel.from_dense(translations), Channel.from_dense(rotations))
    return Take(RIG, Clock(Fraction(24), Fraction(1), Fraction(1), FRAMES), motion)


def ends(seed: int = 3) -> np.ndarray:
    return np.random.default_rng(seed).normal(size=(FRAMES, 2, 3))


@pytest.mark.parametrize("axis", [None, (0.0, 0.0, 2.0)])
def test_the_joint_is_on_the_end_with_its_axis_along_the_segment(axis) -> None:
    segments = ends()
    take = moving()
    world = hang(take, "lamp", segments, axis).world()
    assert_allclose(world.positions[:, 1], segments[:, 1], atol=1e-12)
    own = axis
    if axis is None:
        # What points down at rest.
        own = so3.rotate(so3.conjugate(RIG.rest_rotations[1]), [0, -1, 0])
    along = world.linear[:, 1] @ np.array(own)
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    way = segments[:, 1] - segments[:, 0]
    way /= np.linalg.norm(way, axis=1, keepdims=True)
    assert_allclose(along, way, atol=1e-12)
    offset = world.positions[:, 2] - world.positions[:, 1]
    assert_allclose(np.linalg.norm(offset, axis=1), 0.1)
    # The arm stays as it is.
    assert_allclose(world.positions[:, 0], take.world().positions[:, 0])


def test_no_axis_keeps_the_rotation_in_the_world() -> None:
    take = moving()
    found = hang(take, "lamp", ends(), (0, 0, 0)).world()
    apart = so3.angle_between(found.rotations[:, 1], take.world().rotations[:, 1])
    assert apart.max() < 1e-9


def test_opposite_and_empty_segments_stay_finite() -> None:
    segments = np.zeros((FRAMES, 2, 3))
    segments[0, 1] = (0, 1, 0)
    still = Take(RIG, moving().clock, moving().motion)
    made = hang(still, "lamp", segments, (0, 1, 0)).motion
    assert np.isfinite(made.rotations.dense()).all()


@pytest.mark.parametrize(
    ("joint", "axis", "where"),
    [("lmp", None, "joint"), ("arm", None, "joint"), ("lamp", (1, 2), "axis")],
)
def test_what_cannot_hang(joint, axis, where) -> None:
    with pytest.raises(OptionError) as caught:
        hang(moving(), joint, ends(), axis)
    (fault,) = caught.value.faults
    assert (fault.code, fault.where) == ("SIM192", where)


def written(folder: Path, options: str, up: str = "Y") -> Path:
    (folder / "crane.rig.yaml").write_text(RIG_FILE.format(up=up))
    (folder / "crane.clip.yaml").write_text(CLIP)
    (folder / "s.scene.yaml").write_text(SCENE.format(options=options))
    return folder / "s.scene.yaml"


def check_on_rope(scene: Scene, folder: Path, since: float = 1.0) -> np.ndarray:
    """Bake a scene; check the joint against the rope, return its places."""
    bake(scene, folder / "s.usda")
    stage = Usd.Stage.Open(str(folder / "s.usda"))
    (rope,) = [prim for prim in stage.Traverse() if prim.GetName() == "rope"]
    (skeleton,) = [p for p in stage.Traverse() if p.IsA(UsdSkel.Skeleton)]
    points = UsdGeom.BasisCurves(rope).GetPointsAttr()
    joints = list(UsdSkel.Skeleton(skeleton).GetJointsAttr().Get())
    query = UsdSkel.Cache().GetSkelQuery(UsdSkel.Skeleton(skeleton))
    found = []
    for code in (t for t in points.GetTimeSamples() if t >= since):
        place = UsdGeom.Xformable(rope).ComputeLocalToWorldTransform(code)
        last = place.Transform(tuple(map(float, points.Get(code)[-1])))
        frames = query.ComputeJointWorldTransforms(UsdGeom.XformCache(code))
        lamp = frames[joints.index("arm/lamp")].ExtractTranslation()
        assert_allclose(lamp, last, atol=1e-6)
        found.append(last)
    return np.array(found)


@pytest.mark.parametrize("up", ["Y", "Z"])
def test_a_joint_hangs_on_the_rope_that_is_written(tmp_path: Path, up: str) -> None:
    scene = load_scene(written(tmp_path, "{joint: lamp, system: rope}", up))
    assert scene.open().collect().rig.up is UpAxis(up)
    found = check_on_rope(scene, tmp_path)
    assert len(found) == 8
    assert np.ptp(found, axis=0).max() > 0.01


def test_a_shot_that_begins_before_its_take(tmp_path: Path) -> None:
    scene = load_scene(written(tmp_path, "{joint: lamp, system: rope}"))
    shot = Shot(1001, 1008, fps=Fraction(24), media_in=Fraction(-3, 24))
    # Frames before the take hold its first pose.
    assert len(check_on_rope(scene.with_shot(shot), tmp_path, 1004.0)) == 5


@pytest.mark.parametrize(
    ("options", "named"),
    [
        ("{joint: lamp, system: rop}", "'rop'"),
        ("{joint: lamp, system: flag}", "'flag'"),
        ("{joint: lamp, system: rope, particle: tip}", "'tip'"),
        ("{joint: lamp, system: rope, particle: '9'}", "'9'"),
        ("{joint: arm, system: rope}", "'arm'"),
        ("{system: rope}", "joint"),
    ],
)
def test_faults_are_at_their_key(tmp_path: Path, options: str, named: str) -> None:
    with pytest.raises(FormatError) as caught:
        load_scene(written(tmp_path, options)).open()
    (fault,) = caught.value.faults
    assert fault.code == "SIM192"
    assert str(fault.where).startswith("passes[0].hang")
    assert fault.lines == (4,)
    assert named in fault.message


def test_a_joint_below_one_that_is_scaled_to_zero_is_refused() -> None:
    count = len(RIG.joints)
    scales = np.ones((FRAMES, count, 3))
    scales[2, 0] = 0.0
    moves = np.repeat(RIG.rest_translations[None], FRAMES, axis=0)
    turns = np.repeat(RIG.rest_rotations[None], FRAMES, axis=0)
    motion = Motion(*map(Channel.from_dense, (moves, turns, scales)))
    clock = Clock(Fraction(24), Fraction(1), Fraction(1), FRAMES)
    ends = np.tile([[0.0, 1.0, 0.0], [0.0, 0.5, 0.0]], (FRAMES, 1, 1))
    with raises(OptionError, "SIM192", match="frame 3"):
        hang(Take(RIG, clock, motion), "lamp", ends)
