"""Joints as UsdPhysics has them: valid, at the right places, and read back."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from pxr import Sdf, Usd, UsdGeom, UsdPhysics
from support.physics_joints import JointDescription, read_physics
from support.suite import examples
from support.usd import validation_errors

from animtool.maths import so3
from animtool.rig.limits import BallLimit, RangeLimit
from animtool.rig.skeleton import Joint, JointType, Rig
from animtool.usd.rigs.layer import author_physics

TURNED = (0.6, 0.0, 0.0, 0.8)
SLANTED = (0.48, 0.64, 0.6)
JOINTS = [
    Joint("pin", 0, JointType.PIN, (0.1, 0.2, 0), TURNED, axis=(0.0, 1.0, 0.0)),
    Joint("slant", 0, JointType.PIN, axis=SLANTED, limits=RangeLimit(-0.5, 2.0)),
    Joint("back", 0, JointType.PIN, axis=(0.0, 0.0, -1.0), limits=RangeLimit(0, 1)),
    Joint("slide", 0, JointType.PRISMATIC, axis=(1.0, 0.0, 0.0)),
    Joint("slip", 0, JointType.PRISMATIC, axis=SLANTED, limits=RangeLimit(0, 0.4)),
    Joint("fixed", 0, JointType.FIXED, (0, 1, 0), TURNED),
    Joint("ball", 0, JointType.BALL),
    Joint("cone", 0, JointType.BALL, limits=BallLimit((0.5, 0.9))),
    Joint("hinge", 0, JointType.BALL, limits=BallLimit((0.0, 0.9))),
    Joint("whole", 0, JointType.BALL, limits=BallLimit((0.5, 0.9), (-0.2, 0.7))),
    Joint("twist", 0, JointType.BALL, limits=BallLimit(None, (-1.0, 1.0), SLANTED)),
    Joint("locked", 0, JointType.BALL, limits=BallLimit((1.0, 1.0), (0.0, 0.0))),
]


def rig_of(*joints: Joint) -> Rig:
    root = Joint("root", -1, translation=(0.0, 1.0, 0.0), rotation=TURNED)
    return Rig("hero", (root, *joints))


def stage_of(rig: Rig, meters: float = 0.01) -> Any:
    layer = Sdf.Layer.CreateAnonymous(".usda")
    with Sdf.ChangeBlock():
        rig = replace(rig, meters_per_unit=meters)
        author_physics(layer, "/hero", rig, rig.names)
        layer.GetPrimAtPath("/hero").specifier = Sdf.SpecifierDef
        layer.GetPrimAtPath("/hero").typeName = "Xform"
        layer.defaultPrim = "hero"
        layer.pseudoRoot.SetInfo("metersPerUnit", meters)
        layer.pseudoRoot.SetInfo("upAxis", "Y")
        layer.pseudoRoot.SetInfo("kilogramsPerUnit", 1.0)
    return Usd.Stage.Open(layer)


def same(found: JointDescription, joint: Joint) -> None:
    """Assert that a joint is read as it was, within float32."""
    assert found.type is joint.type
    if joint.type in {JointType.PIN, JointType.PRISMATIC}:
        assert_allclose(found.axis, joint.axis, atol=1e-6)
    if joint.limits is None:
        assert found.limits is None
    elif isinstance(joint.limits, RangeLimit):
        assert_allclose(found.limits.low, joint.limits.low, rtol=1e-6, atol=1e-9)
        assert_allclose(found.limits.high, joint.limits.high, rtol=1e-6, atol=1e-9)
    else:
        assert_allclose(found.limits.twist_axis, joint.limits.twist_axis, atol=1e-6)
        for name in ("swing", "twist"):
            old, new = getattr(joint.limits, name), getattr(found.limits, name)
            assert (new is None) is (old is None)
            if old is not None:
                assert_allclose(new, old, rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize("joint", JOINTS, ids=lambda joint: joint.name)
def test_every_joint_is_valid_and_comes_back(joint: Joint) -> None:
    stage = stage_of(rig_of(joint))
    assert validation_errors(stage) == []
    found = read_physics(stage, 0.01)
    assert list(found) == [joint.name]
    same(found[joint.name], joint)
    made = stage.GetPrimAtPath(f"/hero/Physics/Joints/{joint.name}")
    assert made.GetAttribute("animtool:joint").Get() == str(joint.type)


def test_frames_of_a_joint_meet_at_rest() -> None:
    chain = [replace(joint, parent=i) for i, joint in enumerate(JOINTS)]
    stage = stage_of(rig_of(*chain))
    cache = UsdGeom.XformCache()
    for joint in chain:
        made = UsdPhysics.Joint(
            stage.GetPrimAtPath(f"/hero/Physics/Joints/{joint.name}")
        )
        places = []
        for i in (0, 1):
            (body,) = getattr(made, f"GetBody{i}Rel")().GetTargets()
            place = getattr(made, f"GetLocalPos{i}Attr")().Get()
            turn = getattr(made, f"GetLocalRot{i}Attr")().Get()
            local = np.eye(4)
            quaternion = np.array([*turn.imaginary, turn.real])
            local[:3, :3] = so3.to_matrix(quaternion).T
            local[3, :3] = place
            prim = stage.GetPrimAtPath(body)
            assert UsdPhysics.RigidBodyAPI(prim).GetKinematicEnabledAttr().Get()
            places.append(local @ np.array(cache.GetLocalToWorldTransform(prim)))
        assert_allclose(places[0], places[1], atol=2e-5)


def test_free_joints_have_no_joint_and_no_body() -> None:
    stage = stage_of(rig_of(Joint("free", 0), Joint("pin", 1, JointType.PIN)))
    bodies = stage.GetPrimAtPath("/hero/Physics/Bodies").GetChildren()
    assert [body.GetName() for body in bodies] == ["free", "pin"]
    assert list(read_physics(stage, 0.01)) == ["pin"]


def test_a_root_is_held_by_the_world() -> None:
    stage = stage_of(Rig("hero", (Joint("base", -1, JointType.FIXED),)))
    assert validation_errors(stage) == []
    made = UsdPhysics.Joint(stage.GetPrimAtPath("/hero/Physics/Joints/base"))
    assert not made.GetBody0Rel().GetTargets()


angles = st.floats(0.01, 3.0)


@given(
    axis=st.tuples(*[st.floats(-1, 1)] * 3).filter(lambda a: np.linalg.norm(a) > 0.1),
    swing=st.none() | st.tuples(angles, angles),
    twist=st.none() | st.tuples(angles.map(lambda a: -a), angles),
)
@settings(deadline=None, max_examples=examples(40))
def test_any_ball_comes_back(
    axis: tuple[float, float, float],
    swing: tuple[float, float] | None,
    twist: tuple[float, float] | None,
) -> None:
    x, y, z = (np.array(axis) / np.linalg.norm(axis)).tolist()
    limits = None if swing is twist is None else BallLimit(swing, twist, (x, y, z))
    joint = Joint("ball", 0, JointType.BALL, limits=limits)
    same(read_physics(stage_of(rig_of(joint)), 0.01)["ball"], joint)
