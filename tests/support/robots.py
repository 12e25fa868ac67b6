"""Robots of random trees as URDF, and where their links are by arithmetic alone."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from xml.sax.saxutils import quoteattr

import numpy as np

from animtool.maths import so3
from animtool.rig.joints import coordinate_slices, local_from_coordinates
from animtool.rig.kinematics import forward_kinematics
from animtool.rig.skeleton import JointType, Rig

Matrix = np.ndarray

ARM = """\
<?xml version="1.0"?>
<robot name="arm">
  <link name="base"/>
  <link name="upper">
    <inertial><origin xyz="0 0 0.2"/><mass value="2"/>
      <inertia ixx="0.02" ixy="0" ixz="0" iyy="0.03" iyz="0" izz="0.01"/></inertial>
    <collision><origin xyz="0 0 0.2"/>
      <geometry><cylinder radius="0.04" length="0.4"/></geometry></collision>
  </link>
  <link name="lower"/>
  <link name="tool"/>
  <joint name="pan" type="continuous">
    <parent link="base"/><child link="upper"/><axis xyz="0 0 1"/>
  </joint>
  <joint name="elbow" type="revolute">
    <parent link="upper"/><child link="lower"/>
    <origin xyz="0 0 0.4" rpy="0.1 0 0"/><axis xyz="0 2 0"/>
    <limit lower="-2" upper="2" effort="1" velocity="1"/>
  </joint>
  <joint name="hand" type="fixed">
    <parent link="lower"/><child link="tool"/><origin xyz="0 0 0.3"/>
  </joint>
</robot>
"""


def write(folder: Path, text: str, name: str = "robot.urdf") -> Path:
    """Write a text to a file, and return its path."""
    path = folder / name
    path.write_text(text, "utf-8")
    return path


def turn(axis: Matrix, angle: float) -> Matrix:
    """Return Rodrigues' rotation about an axis of any length ``(3, 3)``."""
    x, y, z = np.asarray(axis, float) / np.linalg.norm(axis)
    k = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + math.sin(angle) * k + (1 - math.cos(angle)) * k @ k


def rpy_matrix(roll: float, pitch: float, yaw: float) -> Matrix:
    """Return the rotation about fixed x, then y, then z ``(3, 3)``."""
    axes = np.eye(3)
    return turn(axes[2], yaw) @ turn(axes[1], pitch) @ turn(axes[0], roll)


def placed(linear: Matrix, offset: Any) -> Matrix:
    """Return a transform of column vectors ``(4, 4)``."""
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = linear, offset
    return matrix


@dataclass
class RandomJoint:
    """A joint as the file has it."""

    name: str
    kind: str
    parent: str
    child: str
    xyz: Matrix
    rpy: Matrix
    axis: Matrix
    mimic: tuple[str, float, float] | None = None


@dataclass
class RandomRobot:
    """A robot, its text, and its values."""

    joints: list[RandomJoint]
    root: str
    text: str = ""
    values: dict[str, Any] = field(default_factory=dict)


KINDS = ("revolute", "continuous", "prismatic", "fixed", "floating", "planar")
SCALAR = ("revolute", "continuous", "prismatic")
_NAMES = ("l", "Glied", "лапа", "手", "a b", "x.y", "ns/l", "-", "l&<", "é")


def random_robot(rng: np.random.Generator, links: int) -> RandomRobot:
    """Return a robot of a random tree, with chains of mimics and odd names."""
    names = [f"{_NAMES[int(rng.integers(len(_NAMES)))]}{i}" for i in range(links)]
    joints: list[RandomJoint] = []
    for i in range(1, links):
        kind = KINDS[int(rng.choice(6, p=[0.35, 0.15, 0.2, 0.15, 0.05, 0.1]))]
        size = 10.0 ** rng.uniform(-4, 2)
        # Links and joints have names apart, and may share them.
        name = names[i] if rng.random() < 0.2 else f"j{i}"
        if rng.random() < 0.1:
            name = names[int(rng.integers(links))]
        if name in {joint.name for joint in joints}:
            name = f"j{i}"
        joint = RandomJoint(
            name,
            kind,
            names[int(rng.integers(i))],
            names[i],
            rng.normal(size=3) * size,
            rng.uniform(-7, 7, size=3),
            rng.normal(size=3) * 10.0 ** rng.uniform(-3, 3),
        )
        others = [one.name for one in joints if one.kind in SCALAR]
        if kind in SCALAR and others and rng.random() < 0.4:
            leader = others[int(rng.integers(len(others)))]
            joint.mimic = (leader, float(rng.normal()), float(rng.normal()))
        joints.append(joint)
    robot = RandomRobot(joints, names[0])
    robot.values = _values(rng, joints)
    robot.text = _text(rng, robot, names)
    return robot


def _values(rng: np.random.Generator, joints: list[RandomJoint]) -> dict[str, Any]:
    values: dict[str, Any] = {}
    for joint in joints:
        if joint.mimic is not None:
            leader, gain, offset = joint.mimic
            values[joint.name] = gain * values[leader] + offset
        elif joint.kind in SCALAR:
            values[joint.name] = float(rng.normal() * 2)
        elif joint.kind == "floating":
            values[joint.name] = (rng.normal(size=3), so3.normalize(rng.normal(size=4)))
        elif joint.kind == "planar":
            values[joint.name] = rng.normal(size=3)
    return values


def _numbers(values: Any) -> str:
    return " ".join(repr(float(value)) for value in values)


def _text(rng: np.random.Generator, robot: RandomRobot, names: list[str]) -> str:
    parts = [f"<link name={quoteattr(name)}/>" for name in names]
    for joint in robot.joints:
        inner = [
            f"<parent link={quoteattr(joint.parent)}/>",
            f"<child link={quoteattr(joint.child)}/>",
            f'<origin xyz="{_numbers(joint.xyz)}" rpy="{_numbers(joint.rpy)}"/>',
            f'<axis xyz="{_numbers(joint.axis)}"/>',
        ]
        if joint.kind in {"revolute", "prismatic"}:
            inner.append('<limit lower="-1e9" upper="1e9" effort="1" velocity="1"/>')
        if joint.mimic is not None:
            leader, gain, offset = joint.mimic
            inner.append(
                f"<mimic joint={quoteattr(leader)} multiplier={quoteattr(repr(gain))} "
                f"offset={quoteattr(repr(offset))}/>"
            )
        rng.shuffle(inner)
        body = " <!-- <joint/> -->\n".join(inner)
        name = quoteattr(joint.name)
        parts.append(f'<joint name={name} type="{joint.kind}">{body}</joint>')
    order = rng.permutation(len(parts))
    body = "\n<![CDATA[ <link/> ]]>\n".join(parts[k] for k in order)
    return f'<?xml version="1.0"?>\n<robot name="random" xmlns:g="g">{body}</robot>\n'


def link_matrices(robot: RandomRobot) -> dict[str, Matrix]:
    """Return where every link is, by arithmetic alone ``(4, 4)``."""
    found = {robot.root: np.eye(4)}
    for joint in robot.joints:
        origin = placed(rpy_matrix(*joint.rpy), joint.xyz)
        found[joint.child] = found[joint.parent] @ origin @ _motion(robot, joint)
    return found


def _motion(robot: RandomRobot, joint: RandomJoint) -> Matrix:
    unit = joint.axis / np.linalg.norm(joint.axis)
    value = robot.values.get(joint.name)
    match joint.kind:
        case "revolute" | "continuous":
            return placed(turn(unit, value), np.zeros(3))
        case "prismatic":
            return placed(np.eye(3), unit * value)
        case "floating":
            return placed(so3.to_matrix(value[1]), value[0])
        case "planar":
            x, y, angle = value
            across = _from_z(unit)
            slide = across @ np.array([x, y, 0.0])
            return placed(turn(unit, angle), slide)
    return np.eye(4)


def _from_z(axis: Matrix) -> Matrix:
    """Return the shortest rotation of z to an axis ``(3, 3)``."""
    about = np.cross([0.0, 0.0, 1.0], axis)
    length = float(np.linalg.norm(about))
    if length == 0.0:
        return np.eye(3)
    return turn(about, math.atan2(length, float(axis[2])))


def rig_matrices(rig: Rig, values: dict[str, Any]) -> dict[str, Matrix]:
    """Return where every joint of a rig is ``(4, 4)``, by values of its joints.

    Of a pin or slide a number, of a ball x, y, z, w, of a free joint both.
    """
    slices = coordinate_slices(rig)
    q = np.zeros((1, slices[-1].stop if slices else 0))
    for j, (joint, place) in enumerate(zip(rig.joints, slices, strict=True)):
        if joint.type in {JointType.FREE, JointType.BALL}:
            q[0, place.stop - 1] = 1.0
        if joint.name in values and place.stop > place.start:
            q[0, slices[j]] = values[joint.name]
    local = local_from_coordinates(rig, q)
    world = forward_kinematics(rig, local.translations, local.rotations)
    return {
        name: placed(world.linear[0, j], world.positions[0, j])
        for j, name in enumerate(rig.names)
    }


def names_in_rig(rig: Rig, robot: RandomRobot) -> dict[str, str]:
    """Return what the rig calls the joints of a robot: above their links."""
    found = {}
    for joint in robot.joints:
        above = rig.index(joint.child)
        if rig.joints[above].type is JointType.FIXED and joint.kind != "fixed":
            above = rig.joints[above].parent
        found[joint.name] = rig.names[above]
    return found


def rig_values(rig: Rig, robot: RandomRobot) -> dict[str, Any]:
    """Return the values of a robot as those of the joints of its rig."""
    names = names_in_rig(rig, robot)
    values: dict[str, Any] = {}
    for joint in robot.joints:
        value = robot.values.get(joint.name)
        own = names[joint.name]
        if joint.kind == "floating":
            values[own] = np.concatenate([value[0], value[1]])
        elif joint.kind == "planar":
            last = rig.index(own)
            second = rig.joints[last].parent
            first = rig.joints[second].parent
            for j, part in zip((first, second, last), value, strict=True):
                values[rig.names[j]] = part
        elif joint.kind != "fixed":
            values[own] = value
    return values
