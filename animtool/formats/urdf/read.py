"""Reads a URDF as a rig, or as a take of one frame."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from animtool.core.errors import Severity, counted, excerpt, listed
from animtool.formats.robots.build import RobotCodes, build_rig, zero_pose_stream
from animtool.formats.robots.diagnostics import XmlDiagnostics
from animtool.formats.robots.parts import (
    Link,
    Robot,
    RobotJoint,
    Triangles,
    float_vector,
)
from animtool.formats.urdf.elements import (
    SCALAR_KINDS,
    UrdfFile,
    UrdfJoint,
    UrdfJointKind,
    add_joint_fault,
)
from animtool.formats.urdf.file import read_file
from animtool.formats.urdf.meshes import find_mesh_files, read_surfaces
from animtool.formats.urdf.tree import check_tree, resolve_mimics
from animtool.maths import so3
from animtool.motion.take import TakeStream
from animtool.rig.skeleton import JointType, Mimic, Rig

MAX_LISTED_JOINTS = 8
_CODES = RobotCodes("URD102", "URD106", "URD101")
_JOINT_TYPES = {
    UrdfJointKind.REVOLUTE: JointType.PIN,
    UrdfJointKind.CONTINUOUS: JointType.PIN,
    UrdfJointKind.PRISMATIC: JointType.PRISMATIC,
    UrdfJointKind.FLOATING: JointType.FREE,
    UrdfJointKind.FIXED: JointType.FIXED,
}
# Rounding error by which a mimic may exceed its limits [rad], [m].
LIMIT_TOLERANCE = 1e-9


def read_urdf_rig(path: Path | str) -> Rig:
    """Return the rig of a URDF: metres, radians, Z up, at rest with its joints at 0.

    Every link becomes a joint of its name, and so does every joint that moves one.
    Simple colliding shapes become capsules, inertias masses, and visuals meshes if they
    are simple shapes, OBJ or STL.

    Args:
        path: A .urdf file.
    """
    path = Path(path)
    diagnostics = XmlDiagnostics(path, "URD007")
    file = read_file(path, diagnostics)
    check_tree(file, diagnostics)
    mimics = resolve_mimics(file, diagnostics)
    mesh_files = find_mesh_files(file, path, diagnostics)
    diagnostics.raise_faults()
    _note_unactuated_joints(file, diagnostics)
    _check_ranges(file, mimics, diagnostics)
    surfaces = read_surfaces(file, mesh_files, diagnostics)
    robot = Robot(file.name or path.stem, _links_depth_first(file, mimics, surfaces))
    return build_rig(robot, diagnostics, _CODES)


def read_urdf(path: Path | str) -> TakeStream:
    """Open a URDF as a take of one frame, joints at 0 or the nearest limit.

    Args:
        path: A .urdf file.
    """
    return zero_pose_stream(read_urdf_rig(path), "URDF")


def _links_depth_first(
    file: UrdfFile, mimics: dict[str, Mimic], surfaces: dict[str, list[Triangles]]
) -> list[Link]:
    """Return links depth-first, parents before children."""
    child_joints: dict[str, list[UrdfJoint]] = {name: [] for name in file.links}
    for urdf_joint in file.joints.values():
        child_joints[urdf_joint.parent].append(urdf_joint)
    children = {urdf_joint.child for urdf_joint in file.joints.values()}
    root = next(name for name in file.links if name not in children)
    links: list[Link] = []
    pending: list[tuple[str, int, UrdfJoint | None]] = [(root, -1, None)]
    while pending:
        name, parent, joint = pending.pop()
        urdf_link = file.links[name]
        rig_joints = (
            [] if joint is None else _build_rig_joints(joint, mimics.get(joint.name))
        )
        links.append(
            Link(
                name,
                parent,
                rig_joints,
                solids=urdf_link.solids,
                surfaces=surfaces.get(name, []),
                mass=urdf_link.mass,
            )
        )
        index = len(links) - 1
        pending += [(j.child, index, j) for j in reversed(child_joints[name])]
    return links


def _build_rig_joints(joint: UrdfJoint, mimic: Mimic | None) -> list[RobotJoint]:
    """Return the rig joints that represent a joint."""
    if joint.kind is UrdfJointKind.PLANAR:
        return _planar_joints(joint)
    is_fixed = joint.kind is UrdfJointKind.FIXED
    return [
        RobotJoint(
            "" if is_fixed else joint.name,
            _JOINT_TYPES[joint.kind],
            joint.position,
            joint.rotation,
            joint.axis if joint.kind in SCALAR_KINDS else (0.0, 0.0, 1.0),
            joint.limits,
            mimic,
        )
    ]


def _planar_joints(joint: UrdfJoint) -> list[RobotJoint]:
    """Return a planar joint as prismatic joints along x and y and a pin on its axis."""
    rotation = so3.shortest_rotation(np.array([0.0, 0.0, 1.0]), np.array(joint.axis))
    x, y = (float_vector(so3.rotate(rotation, np.eye(3)[k])) for k in (0, 1))
    prismatic = JointType.PRISMATIC
    slide_x = RobotJoint(
        f"{joint.name}_x", prismatic, joint.position, joint.rotation, x
    )
    slide_y = RobotJoint(f"{joint.name}_y", prismatic, axis=y)
    return [slide_x, slide_y, RobotJoint(joint.name, JointType.PIN, axis=joint.axis)]


def _note_unactuated_joints(file: UrdfFile, diagnostics: XmlDiagnostics) -> None:
    """Record joints without transmissions if other joints have them."""
    unactuated_names = [
        j.name
        for j in file.joints.values()
        if j.kind in SCALAR_KINDS
        and j.mimic is None
        and j.name not in file.actuated_joints
    ]
    if unactuated_names and file.has_actuators:
        message = f"no transmission drives {counted(len(unactuated_names), 'joint')}: "
        message += listed(
            [excerpt(name) for name in unactuated_names], MAX_LISTED_JOINTS
        )
        hint = "in a rig they move as all others do"
        diagnostics.add("URD105", None, message, hint, severity=Severity.NOTE)


def _check_ranges(
    file: UrdfFile, mimics: dict[str, Mimic], diagnostics: XmlDiagnostics
) -> None:
    """Record limits that exclude 0, and mimics beyond their limits."""
    joints_without_zero = [
        joint.name
        for joint in file.joints.values()
        if joint.limits is not None
        and joint.name not in mimics
        and not joint.limits.low <= 0.0 <= joint.limits.high
    ]
    if joints_without_zero:
        message = "0 is outside the limits of "
        message += f"{counted(len(joints_without_zero), 'joint')}: "
        message += listed(
            [excerpt(name) for name in joints_without_zero], MAX_LISTED_JOINTS
        )
        hint = "the rest pose is still at 0; a take uses the nearest limit"
        diagnostics.add("URD109", None, message, hint, severity=Severity.NOTE)
    for name, mimic in mimics.items():
        follower, leader = file.joints[name], file.joints[mimic.joint]
        if follower.limits is None or leader.limits is None:
            continue
        follower_range = [
            mimic.gain * end + mimic.offset
            for end in (leader.limits.low, leader.limits.high)
        ]
        lower = follower.limits.low - LIMIT_TOLERANCE
        upper = follower.limits.high + LIMIT_TOLERANCE
        if min(follower_range) < lower or max(follower_range) > upper:
            message = (
                f"where it mimics {leader.location}, it goes from "
                f"{min(follower_range):.4g} to {max(follower_range):.4g}, beyond its "
                f"limits {follower.limits.low:.4g} to {follower.limits.high:.4g}"
            )
            hint = "make its limits wider, or those of the joint that it mimics "
            hint += "narrower"
            warning = Severity.WARNING
            add_joint_fault(
                diagnostics, "URD108", follower, message, hint, severity=warning
            )
