"""UsdPhysics that no body can be is refused by prim and value, or left out and said."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose
from support.faults import raises

from animtool.core.errors import FormatError
from animtool.motion.physics import Physics
from animtool.usd.physics.read import read_bodies

YARD = """
def Xform "Yard" {
  def PhysicsScene "scene" {
    vector3f physics:gravityDirection = (0, -1, 0)
    float physics:gravityMagnitude = 1.62
  }
  def Cube "crate" (prepend apiSchemas = ["PhysicsRigidBodyAPI", "PhysicsCollisionAPI",
    "PhysicsMassAPI", "MaterialBindingAPI"]) {
    double size = 2
    double3 xformOp:translate = (0, 3, 0)
    uniform token[] xformOpOrder = ["xformOp:translate"]
    float physics:mass = 4
    float3 physics:diagonalInertia = (1, 1, 1)
    vector3f physics:velocity = (1, 0, 0)
    rel material:binding:physics = </Yard/stuff>
  }
  def Mesh "stone" (prepend apiSchemas = ["PhysicsRigidBodyAPI",
    "PhysicsCollisionAPI"]) {
    int[] faceVertexCounts = [3, 3, 3, 3]
    int[] faceVertexIndices = [0, 2, 1, 0, 1, 3, 1, 2, 3, 2, 0, 3]
    point3f[] points = [(0, 0, 0), (0.3, 0, 0), (0, 0.3, 0), (0, 0, 0.3)]
  }
  def Capsule "pole" (prepend apiSchemas = ["PhysicsRigidBodyAPI",
    "PhysicsCollisionAPI"]) {
    uniform token axis = "Y"
    bool physics:kinematicEnabled = 0
  }
  def PhysicsRevoluteJoint "hinge" {
    rel physics:body0 = </Yard/crate>
    rel physics:body1 = </Yard/stone>
    float physics:lowerLimit = -30
    float physics:upperLimit = 40
  }
  def PhysicsSphericalJoint "hip" {
    rel physics:body1 = </Yard/pole>
    float physics:coneAngle0Limit = 30
    float physics:coneAngle1Limit = 40
  }
  def PhysicsPrismaticJoint "rail" (
    prepend apiSchemas = ["PhysicsDriveAPI:linear"]) {
    rel physics:body0 = </Yard/pole>
    rel physics:body1 = </Yard/stone>
    float physics:lowerLimit = -1
    float physics:upperLimit = 2
    float drive:linear:physics:stiffness = 10
    float drive:linear:physics:maxForce = 5
  }
  def Material "stuff" (prepend apiSchemas = ["PhysicsMaterialAPI"]) {
    float physics:dynamicFriction = 0.5
    float physics:restitution = 0.25
  }
}
"""
HEAD = "metersPerUnit = 1\n kilogramsPerUnit = 1"


def read(folder: Path, *changes: tuple[str, str], head: str = HEAD) -> Physics:
    text = YARD
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    file = folder / "yard.usda"
    file.write_text(f"#usda 1.0\n({head})\n{text}", "utf-8")
    return read_bodies(file, "/Yard", None)


def test_what_is_sound_is_read_without_a_word(tmp_path: Path) -> None:
    physics = read(tmp_path)
    assert [body.name for body in physics.bodies] == ["crate", "stone", "pole"]
    assert [joint.name for joint in physics.joints] == ["hinge", "hip", "rail"]
    assert not physics.notices
    assert_allclose(physics.gravity, [0, -1.62, 0], rtol=1e-6)
    shape = physics.bodies[0].shapes[0]
    assert (shape.friction, shape.restitution) == (0.5, 0.25)
    assert physics.joints[2].drive is not None
    assert physics.joints[2].drive.max_force == 5


@pytest.mark.parametrize(
    ("old", "new", "where", "value"),
    [
        ("[3, 3, 3, 3]", "[2147483647]", "stone", "2147483647"),
        ("[3, 3, 3, 3]", "[3, 3, 3, -1]", "stone", "-1"),
        ("1, 2, 3, 2, 0, 3]", "1, 2, 3, 2, 0, 99]", "stone", "99"),
        ("1, 2, 3, 2, 0, 3]", "1, 2, 3, 2, 0, -5]", "stone", "-5"),
        ("1, 2, 3, 2, 0, 3]", "1, 2, 3]", "stone", "9"),
        ("(0.3, 0, 0)", "(nan, 0, 0)", "stone", "not finite"),
        ("(0.3, 0, 0)", "(1e38, 0, 0)", "stone", "1e+38"),
        ("(0, 3, 0)", "(0, nan, 0)", "crate", "nan"),
        ("(0, 3, 0)", "(0, inf, 0)", "crate", "nan"),
        ("(0, 3, 0)", "(0, 1e38, 0)", "crate", "1e+38"),
        ("mass = 4", "mass = -4", "crate.physics:mass", "-4"),
        ("mass = 4", "mass = nan", "crate.physics:mass", "nan"),
        ("(1, 1, 1)", "(1, -2, 1)", "crate.physics:diagonalInertia", "-2"),
        ("(1, 0, 0)", "(1, inf, 0)", "crate.physics:velocity", "inf"),
        ("= 1.62", "= inf", "scene.physics:gravityMagnitude", "inf"),
        ("(0, -1, 0)", "(0, nan, 0)", "scene.physics:gravityDirection", "nan"),
        ('"Y"', '"W"', "pole.axis", "'W'"),
        ("</Yard/crate>", "</Yard/crane>", "hinge", "'/Yard/crane'"),
        ("Limit = 30", "Limit = nan", "hip.physics:coneAngle0Limit", "nan"),
        ("= 10", "= -10", "rail.drive:linear:physics:stiffness", "-10"),
        ("Friction = 0.5", "Friction = nan", "stuff.physics:dynamicFriction", "nan"),
    ],
)
def test_what_no_body_can_be_is_refused(
    tmp_path: Path, old: str, new: str, where: str, value: str
) -> None:
    with pytest.raises(FormatError) as error:
        read(tmp_path, (old, new))
    (fault,) = error.value.faults
    assert (fault.code, fault.where) == ("SIM051", f"/Yard/{where}")
    assert value in fault.message


@pytest.mark.parametrize("kilograms", ["0", "-1", "nan", "1e30", "inf"])
def test_an_odd_unit_of_mass_is_refused(tmp_path: Path, kilograms: str) -> None:
    with raises(FormatError, "SIM051", match="kilogramsPerUnit"):
        read(tmp_path, head=f"metersPerUnit = 1\n kilogramsPerUnit = {kilograms}")


def test_bodies_without_a_shape_that_is_read_are_refused_by_its_type(
    tmp_path: Path,
) -> None:
    kinds = [('Cube "', 'Cylinder "'), ('Mesh "', 'Cone "'), ('Capsule "', 'Cone "')]
    with raises(FormatError, "SIM051", match="/Yard/crate.*Cylinder"):
        read(tmp_path, *kinds)


@pytest.mark.parametrize(
    ("old", "new", "joints", "said"),
    [
        ("</Yard/crate>", "</Yard/stone>", 2, "itself"),
        ("Enabled = 0", "Enabled = 1", 2, "joins no dynamic body and is skipped"),
        ("Limit = -30", "Limit = 60", 3, "above its upper"),
        ("Limit = 40", "Limit = 400", 3, "more than 360 degrees"),
        ("restitution = 0.25", "restitution = 7", 3, "restitution 7"),
        ("size = 2", "size = -2", 3, "size of [-2.0"),
        ("size = 2", "size = -2", 3, "'/Yard/crate', a body that is not supported"),
        ('Cube "', 'Cone "', 3, "of type Cone"),
    ],
)
def test_what_is_left_out_is_said(
    tmp_path: Path, old: str, new: str, joints: int, said: str
) -> None:
    physics = read(tmp_path, (old, new))
    assert len(physics.joints) == joints
    assert {notice.code for notice in physics.notices} == {"SIM136"}
    assert any(said in notice.message for notice in physics.notices)


def test_limits_without_an_end_are_none(tmp_path: Path) -> None:
    def hip(*changes: tuple[str, str]) -> tuple[float, float] | None:
        return read(tmp_path, *changes).joints[1].swing

    assert hip(("Limit = 30", "Limit = inf"), ("1Limit = 40", "1Limit = inf")) is None
    one = hip(("0Limit = 30", "0Limit = inf"))
    assert one is not None
    assert_allclose(np.degrees(one), [40, 179], rtol=1e-6)
    endless = ("upperLimit = 2", "upperLimit = inf")
    low, high = read(tmp_path, endless).joints[2].limits or (math.nan, math.nan)
    assert low == -1
    assert high > 1e9


def test_no_force_of_a_drive_is_none(tmp_path: Path) -> None:
    drive = read(tmp_path, ("maxForce = 5", "maxForce = 0")).joints[2].drive
    assert drive is not None
    assert drive.max_force == 0
    endless = read(tmp_path, ("maxForce = 5", "maxForce = inf")).joints[2].drive
    assert endless is not None
    assert endless.max_force is None
