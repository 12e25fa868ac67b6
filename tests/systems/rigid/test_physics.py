"""Bodies and joints as UsdPhysics has them: written, and read again."""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose
from pxr import Sdf, Usd, UsdGeom, UsdPhysics
from support.faults import raises
from support.rigid import FLOOR, Rigid, ball, box
from support.simulated import Simulator

from animtool import BakeOptions, validate
from animtool.core.errors import FormatError, ToleranceError
from animtool.core.units import LengthUnit, UpAxis
from animtool.maths import so3

FORMS: list[tuple[dict[str, Any], float]] = [
    ({}, 1.0),
    ({"to_up": UpAxis.Z, "to_units": LengthUnit("cm")}, 0.01),
]
HAMMER = {
    "name": "hammer",
    "shapes": [
        {"shape": {"capsule": {"radius": 0.02, "length": 0.4}}, "density": 700},
        {
            "shape": {"box": {"size": [0.2, 0.08, 0.06]}},
            "at": [0.01, 0.2, 0],
            "rotate": [0.9, 0.1, 0, 0.4],
            "density": 7800,
        },
    ],
    "at": [0, 2, 0],
    "spin": [10, 200, -30],
    "velocity": [0.5, 0, 0.1],
    "friction": 0.3,
    "restitution": 0.2,
}
BODIES = [
    HAMMER,
    ball(0.1, at=[1, 1, 0], mass=0.7) | {"name": "bob"},
    box([0.1, 0.5, 0.1], at=[1, 1.6, 0.2]) | {"name": "arm"},
    box([0.3, 0.1, 0.3], at=[3, 1, 0]) | {"name": "tray"},
    box([0.4, 0.1, 0.4], at=[4, 0.3, 0])
    | {"name": "lift", "kinematic": True, "moves": [[0, 0, 0, 0], [1, 0, 0.3, 0]]},
    box([0.1, 0.1, 0.1], at=[4, 0.9, 0], spin=[0, 90, 0]) | {"name": "cargo"},
]
JOINTS = [
    {"name": "elbow", "type": "pin", "body": "bob", "to": "arm", "at": [1, 1.3, 0.1],
     "axis": [0, 1, 1], "limits": [-40, 70],
     "drive": {"stiffness": 3, "damping": 0.2, "target": 20, "most": 5}},
    {"name": "shoulder", "type": "ball", "body": "arm", "at": [1, 1.9, 0.2],
     "axis": [0, -1, 0], "swing": [50, 30], "twist": [-20, 35],
     "drive": {"stiffness": 2, "damping": 0.1}},
    {"name": "rail", "type": "prismatic", "body": "tray", "at": [3, 1, 0],
     "axis": [1, 0, 1], "limits": [-0.2, 0.3],
     "drive": {"stiffness": 30, "damping": 1, "target": 0.1}},
]  # fmt: skip
YARD: dict[str, Any] = {
    "name": "it",
    "step": 0.005,
    "bodies": BODIES,
    "joints": JOINTS,
    "colliders": [
        {**FLOOR, "friction": 0.8},
        {"shape": {"box": {"size": [1, 0.2, 1]}}, "at": [6, 0.1, 0]},
    ],
    "sleep": {"speed": 0},
}
WRITTEN = {"prims": "xforms", "physics": True}


def written(folder: Path, entry: dict[str, Any] = YARD, **keys: Any) -> Usd.Stage:
    stage, _ = Simulator(folder).baked(
        [{"rigid": {**entry, **WRITTEN}}], BakeOptions(**keys)
    )
    return stage


def file_of(stage: Usd.Stage) -> str:
    return str(stage.GetRootLayer().realPath)


@pytest.mark.parametrize(("keys", "unit"), FORMS)
def test_what_is_written_is_what_the_kernel_steps(
    tmp_path: Path, keys: dict[str, Any], unit: float
) -> None:
    own = Rigid(tmp_path, *BODIES, joints=JOINTS).simulation.bodies
    stage = written(tmp_path, **keys)
    assert UsdPhysics.GetStageKilogramsPerUnit(stage) == 1.0
    scene = UsdPhysics.Scene(stage.GetPrimAtPath("/shot/it/Physics/Scene"))
    assert_allclose(scene.GetGravityMagnitudeAttr().Get(), 9.81 / unit, rtol=1e-6)
    down = [0, -1, 0] if unit == 1.0 else [0, 0, -1]
    assert_allclose(scene.GetGravityDirectionAttr().Get(), down, atol=1e-6)
    for i, model in enumerate(BODIES):
        prim = stage.GetPrimAtPath(f"/shot/it/{model['name']}")
        assert prim.HasAPI(UsdPhysics.RigidBodyAPI)
        rigid, mass = UsdPhysics.RigidBodyAPI(prim), UsdPhysics.MassAPI(prim)
        kind = own.kinds[i]
        assert rigid.GetKinematicEnabledAttr().Get() is (model["name"] == "lift")
        assert_allclose(mass.GetMassAttr().Get(), kind.mass, rtol=1e-6)
        centre = np.array(mass.GetCenterOfMassAttr().Get()) * unit
        assert_allclose(centre, kind.centre, atol=1e-7)
        moments = np.array(mass.GetDiagonalInertiaAttr().Get()) * unit**2
        assert_allclose(moments, kind.moments, rtol=1e-6)
        axes = mass.GetPrincipalAxesAttr().Get()
        assert_allclose([*axes.imaginary, axes.real], kind.axes, atol=1e-6)
        if model["name"] != "lift":
            velocity = np.array(rigid.GetVelocityAttr().Get()) * unit
            assert_allclose(velocity, model.get("velocity", [0, 0, 0]), atol=1e-6)
            spin = rigid.GetAngularVelocityAttr().Get()
            assert_allclose(spin, model.get("spin", [0, 0, 0]), atol=1e-4)
    elbow = UsdPhysics.RevoluteJoint.Get(stage, "/shot/it/Physics/Joints/elbow")
    assert elbow.GetBody0Rel().GetTargets() == [Sdf.Path("/shot/it/arm")]
    assert elbow.GetBody1Rel().GetTargets() == [Sdf.Path("/shot/it/bob")]
    assert_allclose(elbow.GetLowerLimitAttr().Get(), -40, rtol=1e-6)
    assert_allclose(elbow.GetUpperLimitAttr().Get(), 70, rtol=1e-6)
    drive = UsdPhysics.DriveAPI(elbow.GetPrim(), "angular")
    assert_allclose(drive.GetTargetPositionAttr().Get(), 20, rtol=1e-6)
    stiffness = 3 / unit**2 * math.pi / 180
    assert_allclose(drive.GetStiffnessAttr().Get(), stiffness, rtol=1e-6)
    assert_allclose(drive.GetMaxForceAttr().Get(), 5 / unit**2, rtol=1e-6)


def test_nobody_finds_fault_with_it(tmp_path: Path) -> None:
    stage = written(tmp_path)
    from pxr import UsdValidation

    registry = UsdValidation.ValidationRegistry()
    context = UsdValidation.ValidationContext(registry.GetOrLoadAllValidators())
    errors = [error.GetMessage() for error in context.Validate(stage)]
    assert not [text for text in errors if "hysics" in text or "rigid" in text]
    assert not validate([file_of(stage)])


@pytest.mark.parametrize(("keys", "unit"), FORMS)
def test_both_sides_of_joints_meet(
    tmp_path: Path, keys: dict[str, Any], unit: float
) -> None:
    stage = written(tmp_path, **keys)
    cache = UsdGeom.XformCache(1.0)
    for name, at in (("elbow", [1, 1.3, 0.1]), ("shoulder", [1, 1.9, 0.2])):
        joint = UsdPhysics.Joint(stage.GetPrimAtPath(f"/shot/it/Physics/Joints/{name}"))
        worlds = []
        for side in (0, 1):
            body = getattr(joint, f"GetBody{side}Rel")().GetTargets()[0]
            place = getattr(joint, f"GetLocalPos{side}Attr")().Get()
            matrix = cache.GetLocalToWorldTransform(stage.GetPrimAtPath(body))
            worlds.append(np.array(matrix.Transform(place)) * unit)
        x, y, z = at
        wanted = [x, y, z] if unit == 1.0 else [x, -z, y]
        assert_allclose(worlds, [wanted] * 2, atol=2e-6)


@pytest.mark.slow
@pytest.mark.parametrize("keys", [keys for keys, _ in FORMS])
def test_what_is_read_again_moves_alike(tmp_path: Path, keys: dict[str, Any]) -> None:
    """All numbers went through float32 once."""
    file = file_of(written(tmp_path, **keys))
    first = Rigid(tmp_path, *BODIES, **{k: YARD[k] for k in ("joints", "colliders",
                  "step", "sleep")})  # fmt: skip
    again = Rigid(tmp_path, stages=[{"file": file}], step=0.005, sleep=YARD["sleep"])
    assert not again.codes()
    one, other = first.simulation, again.simulation
    assert other.bodies.names == one.bodies.names
    assert_allclose(other.bodies.masses, one.bodies.masses, rtol=1e-6)
    assert_allclose(
        other.joints.parameters[:, 14:], one.joints.parameters[:, 14:], atol=2e-6
    )
    for t in (0.1, 0.3):
        assert_allclose(again.to(t), first.to(t), atol=1e-5)
    spins = [run.run.at(0.4).rotations for run in (first, again)]
    assert so3.angle_between(*spins).max() < 1e-4


def test_joints_that_break_are_read_again(tmp_path: Path) -> None:
    """Forces and torques of each; the last never does."""
    breaks = [{"force": 300, "torque": 20}, {"torque": 7}]
    joints = [j | {"breaks": b} for j, b in zip(JOINTS, breaks, strict=False)]
    file = file_of(written(tmp_path, {**YARD, "joints": [*joints, JOINTS[2]]}))
    again = Rigid(tmp_path, stages=[{"file": file}], step=0.005)
    found = again.simulation.joints
    assert [one.name for one in found.members] == ["elbow", "shoulder", "rail"]
    assert_allclose(found.break_limits, [[300, 20], [math.inf, 7], [math.inf] * 2])


def stage_of(folder: Path, text: str, head: str = "") -> str:
    file = folder / "yard.usda"
    file.write_text(f"#usda 1.0\n({head or 'metersPerUnit = 1'})\n{text}", "utf-8")
    return str(file)


CRATE = """
def Xform "Yard" {
  def Cube "crate" (prepend apiSchemas = ["PhysicsRigidBodyAPI", "PhysicsCollisionAPI"])
  {
    double size = 2
    float3 xformOp:scale = (0.5, 0.25, 0.5)
    double3 xformOp:translate = (0, 3, 0)
    uniform token[] xformOpOrder = ["xformOp:translate", "xformOp:scale"]
  }
  def Cylinder "drum" (
    prepend apiSchemas = ["PhysicsRigidBodyAPI", "PhysicsCollisionAPI"]
  )
  {
  }
  def Plane "ground" (prepend apiSchemas = ["PhysicsCollisionAPI"])
  {
    uniform token axis = "Y"
  }
}
"""


def test_a_stage_of_another_tool_falls_to_its_ground(tmp_path: Path) -> None:
    file = stage_of(tmp_path, CRATE, 'metersPerUnit = 1\n upAxis = "Y"')
    found = Rigid(tmp_path, stages=[{"file": file, "prim": "/Yard"}])
    assert found.simulation.bodies.names == ["crate"]
    assert_allclose(found.simulation.bodies.masses, [1000 * 1 * 0.5 * 1], rtol=1e-6)
    assert found.codes() == ["SIM136", "SIM136"]
    assert_allclose(found.to(3.0)[0], [0, 0.25, 0], atol=1e-3)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('def Xform "Yard" {}', "contains no rigid body"),
        (CRATE.replace("(0, 3, 0)", "(0, nan, 0)"), "has nan"),
        ('def Xform "Field" {}', "has no prim"),
    ],
)
def test_stages_that_make_no_sense_are_refused(
    tmp_path: Path, text: str, message: str
) -> None:
    file = stage_of(tmp_path, text)
    with raises(FormatError, "SIM051", match=rf"stages\[0\].*{message}"):
        Rigid(tmp_path, stages=[{"file": file, "prim": "/Yard"}])


FLAT = """
  def Mesh "leaf" (prepend apiSchemas = ["PhysicsRigidBodyAPI", "PhysicsCollisionAPI"])
  {
    int[] faceVertexCounts = [3]
    int[] faceVertexIndices = [0, 1, 2]
    point3f[] points = [(0, 0, 0), (1, 0, 0), (0, 1, 0)]
  }
}
"""
HEAVY = """
  def Sphere "leaf" (prepend apiSchemas = [
    "PhysicsRigidBodyAPI", "PhysicsCollisionAPI", "PhysicsMassAPI"])
  {
    float physics:density = 1e12
  }
}
"""


@pytest.mark.parametrize(
    ("text", "code", "said"),
    [(FLAT, "SIM061", "coplanar"), (HEAVY, "SIM051", r"1e\+30")],
)
def test_what_keys_cannot_hold_is_refused_by_its_prim(
    tmp_path: Path, text: str, code: str, said: str
) -> None:
    whole = CRATE.rstrip().removesuffix("}") + text
    file = stage_of(tmp_path, whole, "metersPerUnit = 1e-6")
    message = rf"stages\[0\].*yard.usda: /Yard/leaf: .*{said}"
    with raises(FormatError, code, match=message):
        Rigid(tmp_path, stages=[{"file": file, "prim": "/Yard"}])


@pytest.mark.parametrize("column", [0, 7, 10])
def test_a_state_that_no_body_can_be_in_is_refused(tmp_path: Path, column: int) -> None:
    found = Rigid(tmp_path, ball(0.1), box([1, 1, 1], at=[0, 9, 0]))
    motion = found.state.motion.copy()
    motion[1, column] = 1e110
    state = dataclasses.replace(found.state, motion=motion)
    with raises(ToleranceError, "SIM102", match=r"0\.01"):
        found.simulation.step(state, 0.0, 0.01)


@pytest.mark.parametrize(
    ("keys", "message"),
    [({"physics": True}, "copies of an instancer"), ({"bodies": []}, "no bodies")],
)
def test_keys_that_make_no_sense_together(
    tmp_path: Path, keys: dict[str, Any], message: str
) -> None:
    entry = {"name": "it", "bodies": BODIES[:1], **keys}
    with raises(FormatError, "SIM061", match=message):
        Simulator(tmp_path).scene([{"rigid": entry}])
