"""Builds the rig of a robot: a joint for every link and every moving joint.

A joint that moves a link of the same name in the same frame is merged with it;
otherwise the link is a fixed joint below. Children of a link are attached to the joint
that moves it, so that IK chains consist of moving joints. Fixed joints only have the
name of their link.
"""

from __future__ import annotations

import re
from dataclasses import replace
from fractions import Fraction

import numpy as np

from animtool.core.errors import Severity, counted, listed
from animtool.core.quantities import CONTROL_CHARACTERS, length_text
from animtool.core.record import dataclass
from animtool.core.units import LengthUnit, UpAxis
from animtool.formats.robots.diagnostics import XmlDiagnostics
from animtool.formats.robots.parts import ORIGIN, Robot, RobotJoint
from animtool.formats.robots.solids import build_capsule, build_mass
from animtool.formats.robots.triangles import merge_surfaces
from animtool.ik.sub_rig import start_coordinates
from animtool.motion.motion import Channel, Motion
from animtool.motion.take import TakeStream
from animtool.rig.joints import local_from_coordinates
from animtool.rig.kinematics import rest_world
from animtool.rig.parts import Collider, LoadedArray, Mass, Mesh, Skin, Subdivision
from animtool.rig.skeleton import MAX_RIG_SIZE, Joint, JointType, Rig
from animtool.rig.suspicious_shape import rest_pose_without_kernels

MAX_LISTED_JOINTS = 8
# Sizes of most robots [m].
ROBOT_SIZES = (0.3, 10.0)
# If no shape is longer than this fraction of a robot [1], its positions are in another
# unit than its shapes.
MIN_SHAPE_FRACTION = 0.03
# Longest name in rig files.
MAX_NAME_LENGTH = 4000
# Arbitrary: one frame has no rate.
POSE_RATE = Fraction(24)
_CONTROL_PATTERN = re.compile(f"[{CONTROL_CHARACTERS}]")


@dataclass(frozen=True, slots=True)
class RobotCodes:
    """Rule codes of notices about differences between a robot and its rig."""

    renamed_code: str  # renamed links and joints
    approximate_code: str  # approximate colliders
    ignored_code: str  # contents that are not read


def _replace_control_characters(name: str) -> str:
    r"""Return a name with ``_`` for characters that text files cannot contain.

    >>> _replace_control_characters("a\x1bb"), _replace_control_characters("elbow flex")
    ('a_b', 'elbow flex')
    """
    return _CONTROL_PATTERN.sub("_", name)[:MAX_NAME_LENGTH]


def build_rig(robot: Robot, diagnostics: XmlDiagnostics, codes: RobotCodes) -> Rig:
    """Return a robot's rig: metres, radians, Z up, at rest at zero coordinates.

    The rig has the notices of ``diagnostics``, to which contents that are not read are
    added.
    """
    joint_names = _assign_names(robot, diagnostics, codes)
    joints: list[Joint] = []
    attach_joints: list[int] = []
    colliders: list[Collider] = []
    masses: list[Mass] = []
    largest_error = 0.0
    for i, link in enumerate(robot.links):
        parent = attach_joints[link.parent] if link.parent >= 0 else -1
        for robot_joint, name in zip(link.joints, joint_names.joints[i], strict=True):
            joints.append(_rig_joint(robot_joint, name, parent, joint_names))
            parent = len(joints) - 1
        moving_joint = parent
        if not joint_names.is_merged[i]:
            name = joint_names.links[i]
            joints.append(Joint(name, parent, JointType.FIXED, link.offset))
            if not link.joints or np.any(link.offset):
                parent = len(joints) - 1
        attach_joints.append(parent)
        for site, position, rotation in link.sites:
            name, fixed = joint_names.sites[i, site], JointType.FIXED
            joints.append(Joint(name, attach_joints[i], fixed, position, rotation))
        joint_name = joints[moving_joint if link.joints else parent].name
        link_offset = link.offset if link.joints else ORIGIN
        for shape in link.solids:
            capsule, error = build_capsule(shape, link_offset)
            largest_error = max(largest_error, error)
            colliders.append(Collider(joint_name, capsule))
        if link.mass is not None:
            masses.append(build_mass(joint_name, link.mass, link_offset))
    if largest_error:
        _note_approximate_colliders(robot, diagnostics, codes, largest_error)
    meshes = _build_link_meshes(robot, joint_names, joints)
    _warn_of_size(diagnostics, joints, colliders)
    if diagnostics.ignored_labels:
        message = f"the rig leaves out {listed(list(diagnostics.ignored_labels), 20)}"
        diagnostics.add(codes.ignored_code, None, message, severity=Severity.NOTE)
    return Rig(
        _replace_control_characters(robot.name) or diagnostics.path.stem,
        tuple(joints),
        up=UpAxis.Z,
        meshes=meshes,
        colliders=tuple(colliders),
        masses=tuple(masses),
        radians_per_unit=1.0,
        notices=tuple(diagnostics.notices),
    )


def _warn_of_size(
    diagnostics: XmlDiagnostics, joints: list[Joint], colliders: list[Collider]
) -> None:
    """Warn about a size that suggests another unit than metres (RIG217)."""
    positions, _ = rest_pose_without_kernels(Rig("", tuple(joints)))
    size = float(np.linalg.norm(np.ptp(positions, axis=0)))
    if size <= MAX_RIG_SIZE:
        return
    message = f"the robot measures {length_text(size)}, with lengths in m"
    hint, divided = "check the positions", "all lengths"
    capsules = [collider.capsule for collider in colliders]
    shape_size = max((2 * c.radius + c.length for c in capsules), default=size)
    if shape_size < MIN_SHAPE_FRACTION * size:
        message += f", but its shapes at most {length_text(shape_size)}"
        divided = "the xyz of joint origins"
    for unit in (LengthUnit.CM, LengthUnit.MM):
        if ROBOT_SIZES[0] <= size * unit.meters <= ROBOT_SIZES[1]:
            hint = f"if they are in {unit}, divide {divided} by {1 / unit.meters:g}: "
            hint += length_text(size * unit.meters)
    diagnostics.add("RIG217", None, message, hint, severity=Severity.WARNING)


def _build_link_meshes(
    robot: Robot, names: _JointNames, joints: list[Joint]
) -> tuple[Mesh, ...]:
    """Return one rigid mesh per visible link."""
    if not any(link.surfaces for link in robot.links):
        return ()
    rest_rig = Rig("", tuple(joints))
    world = rest_world(rest_rig)
    meshes = []
    for link, name in zip(robot.links, names.links, strict=True):
        if not link.surfaces:
            continue
        surface, joint_index = merge_surfaces(link.surfaces), rest_rig.index(name)
        bind = np.eye(4)
        bind[:3, :3], bind[:3, 3] = (
            world.linear[0, joint_index],
            world.positions[0, joint_index],
        )
        point_count = len(surface.points)
        skin = Skin(
            "linear",
            (name,),
            LoadedArray(np.zeros((point_count, 1))),
            LoadedArray(np.ones((point_count, 1))),
        )
        meshes.append(
            Mesh(
                name,
                LoadedArray(surface.points),
                LoadedArray(surface.faces.astype(np.float64)),
                geom_bind=tuple(bind.ravel().tolist()),
                skin=skin,
                subdivision=Subdivision.NONE,
            )
        )
    return tuple(meshes)


def _rig_joint(
    robot_joint: RobotJoint, name: str, parent: int, names: _JointNames
) -> Joint:
    mimic, driver, rig_names = robot_joint.mimic, robot_joint.driver, names.by_file_name
    if mimic is not None:
        mimic = replace(mimic, joint=rig_names[mimic.joint])
    return Joint(
        name,
        parent,
        robot_joint.type,
        robot_joint.translation,
        robot_joint.rotation,
        robot_joint.axis,
        limits=robot_joint.limits,
        mimic=mimic,
        driven=None if driver is None else driver.with_renamed_joints(rig_names),
    )


@dataclass(frozen=True, slots=True)
class _JointNames:
    """Names of the rig's joints for the links, joints and sites of a robot."""

    links: list[str]  # name of each link
    joints: list[list[str]]  # names of the joints of each link
    is_merged: list[bool]  # whether each link is merged with its last joint
    sites: dict[tuple[int, str], str]  # name of each site, by link and site
    by_file_name: dict[str, str]  # name of each joint, by its name in the file


def _assign_names(
    robot: Robot, diagnostics: XmlDiagnostics, codes: RobotCodes
) -> _JointNames:
    """Return unique names of the rig's joints; record changed names."""
    used_names: set[str] = set()
    last_numbers: dict[str, int] = {}
    name_changes: list[str] = []

    def unique_name(name: str, source: str, suffix: str = "") -> str:
        """Return a name that is not used yet; changed names are recorded."""
        candidate = name
        if candidate in used_names and suffix:
            candidate = f"{name}{suffix}"
        stem = candidate
        while candidate in used_names:
            last_numbers[stem] = last_numbers.get(stem, 1) + 1
            candidate = f"{stem}_{last_numbers[stem]}"
        used_names.add(candidate)
        if source and candidate != source:
            name_changes.append(f"{source!r} is {candidate!r}")
        return candidate

    link_names = [
        unique_name(_replace_control_characters(link.name), link.name)
        for link in robot.links
    ]
    joint_names: list[list[str]] = []
    merged_flags: list[bool] = []
    name_of_file_joint: dict[str, str] = {}
    for link, name in zip(robot.links, link_names, strict=True):
        last_joint = link.joints[-1] if link.joints else None
        # Whether the last joint has the name and frame of the link.
        is_merged = last_joint is not None and last_joint.name in {"", link.name}
        is_merged = is_merged and not np.any(link.offset)
        merged_flags.append(is_merged)
        new_names = []
        for k, robot_joint in enumerate(link.joints):
            if is_merged and robot_joint is last_joint:
                new_name = name
            elif robot_joint.name:
                new_name = unique_name(
                    _replace_control_characters(robot_joint.name),
                    robot_joint.name,
                    "_joint",
                )
            else:
                new_name = unique_name(f"{name}_joint_{k + 1}", "")
            new_names.append(new_name)
            if robot_joint.name:
                name_of_file_joint[robot_joint.name] = new_name
        joint_names.append(new_names)
    sites = {
        (i, site): unique_name(_replace_control_characters(site), site, "_site")
        for i, link in enumerate(robot.links)
        for site, _, _ in link.sites
    }
    if name_changes:
        message = f"{counted(len(name_changes), 'name')} changed, as links and joints "
        message += "of a rig share their names: "
        message += listed(name_changes, MAX_LISTED_JOINTS)
        diagnostics.add(codes.renamed_code, None, message, severity=Severity.NOTE)
    return _JointNames(link_names, joint_names, merged_flags, sites, name_of_file_joint)


def _note_approximate_colliders(
    robot: Robot, diagnostics: XmlDiagnostics, codes: RobotCodes, largest_error: float
) -> None:
    count = sum(
        s.kind in {"box", "cylinder"} for link in robot.links for s in link.solids
    )
    verb = "is" if count == 1 else "are"
    message = f"{counted(count, 'box or cylinder', 'boxes and cylinders')} {verb} "
    message += "approximated by capsules, whose surfaces are off by up to "
    message += length_text(largest_error)
    hint = "to use other capsules, define them in a rig file that extends this one"
    diagnostics.add(codes.approximate_code, None, message, hint, severity=Severity.NOTE)


def zero_pose_stream(rig: Rig, format_name: str) -> TakeStream:
    """Return a take of one frame with all coordinates at 0, or at the nearest limit."""
    local = local_from_coordinates(rig, start_coordinates(rig))
    motion = Motion(
        Channel.from_dense(local.translations), Channel.from_dense(local.rotations)
    )
    stream = TakeStream(rig, POSE_RATE, Fraction(1), Fraction(1), iter([motion]))
    stream.notices += rig.notices
    stream.details = {"format": format_name}
    return stream
