"""Parses a URDF: links and joints, and notices about other contents."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from animtool.core.array_types import FloatArray
from animtool.core.errors import Severity, counted, excerpt
from animtool.core.files.signatures import expects_format
from animtool.core.names import name_hint
from animtool.formats.robots.diagnostics import (
    MAX_VALUE,
    XmlDiagnostics,
    element_label,
    to_number,
)
from animtool.formats.robots.parts import LinkMass, SimpleShape, float_vector
from animtool.formats.robots.solids import find_mass_problem
from animtool.formats.robots.xml import XmlElement, read_xml
from animtool.formats.urdf.elements import (
    SCALAR_KINDS,
    XML_CODES,
    UrdfFile,
    UrdfJoint,
    UrdfJointKind,
    UrdfLink,
    Visual,
    add_joint_fault,
    find_single_child,
    read_pose,
    require_text,
)
from animtool.formats.urdf.misplaced import STANDARD_TAGS, warn_about_misplaced
from animtool.maths import so3
from animtool.rig.limits import RangeLimit
from animtool.rig.parts import Vector
from animtool.rig.skeleton import Mimic

_XACRO_MARKERS = "${", "$("
EXPAND_HINT = "expand it: xacro robot.urdf.xacro -o robot.urdf (from the package of "
EXPAND_HINT += "ROS)"
# Two revolutions, which robot angles do not exceed [rad], and in degrees; larger limits
# mean no limits.
MAX_PLAUSIBLE_RADIANS = 4 * math.pi
MAX_PLAUSIBLE_DEGREES = 720.0
_LIMIT_ATTRIBUTES = ("lower", "upper")
# Elements of joints that are not read, and their labels.
_IGNORED_JOINT_LABELS = {
    "dynamics": "damping and friction of joints",
    "safety_controller": "safety controllers",
    "calibration": "calibrations",
}
# Shorter axes have no direction.
MIN_AXIS_LENGTH = 1e-9
_LIMITED_KINDS = frozenset({UrdfJointKind.REVOLUTE, UrdfJointKind.PRISMATIC})
# Shapes and their attributes.
_SHAPE_ATTRIBUTES: dict[str, tuple[tuple[str, int], ...]] = {
    "box": (("size", 3),),
    "sphere": (("radius", 1),),
    "cylinder": (("radius", 1), ("length", 1)),
    "capsule": (("radius", 1), ("length", 1)),
}


@expects_format("URD001", "a URDF file")
def read_file(path: Path, diagnostics: XmlDiagnostics) -> UrdfFile:
    """Return the links and joints of a URDF; record faults in ``diagnostics``."""
    root = read_xml(path, XML_CODES)
    _check_root(root, diagnostics)
    diagnostics.raise_faults()
    links: dict[str, UrdfLink] = {}
    joints: dict[str, UrdfJoint] = {}
    for element in root.children:
        if element.tag == "link":
            _read_link(element, links, diagnostics)
        elif element.tag == "joint":
            _read_joint(element, joints, diagnostics)
    if not links and not diagnostics.faults:
        message = "the robot has no link"
        diagnostics.add(
            "URD006", root, message, "a robot is links, and joints between them"
        )
    _warn_about_degrees(root, diagnostics)
    misplaced_count = len(diagnostics.notices)
    warn_about_misplaced(root, diagnostics)
    if diagnostics.faults:
        # What is misplaced is missing elsewhere.
        diagnostics.faults += diagnostics.notices[misplaced_count:]
    diagnostics.record_ignored(_ignored_labels(root))
    name = root.attributes.get("name", "")
    return UrdfFile(name, links, joints, *_actuated_joints(root))


def _check_root(root: XmlElement, diagnostics: XmlDiagnostics) -> None:
    """Record a fault if the root is not <robot>, or the file is xacro to expand."""
    for element in root.walk():
        macros = [f"<{element.tag}>"] if element.tag.startswith("xacro:") else []
        for text in element.attributes.values():
            if any(marker in text for marker in _XACRO_MARKERS):
                macros.append(excerpt(text))
        if macros:
            message = (
                f"is a xacro file: it holds {macros[0]}, which a URDF is made from"
            )
            diagnostics.add("URD005", element, message, EXPAND_HINT)
            return
    if root.tag == "robot":
        return
    hints = {
        "sdf": "convert it: gz sdf -p model.sdf prints it, and sdf2urdf makes a URDF",
        "mujoco": "it is MJCF: name it .xml",
        "COLLADA": "it is a mesh or a scene in COLLADA",
    }
    hint = hints.get(root.tag, "the root element of a URDF is <robot>")
    diagnostics.add(
        "URD004", root, f"no URDF: its root element is <{root.tag[:60]}>", hint
    )


def _warn_about_degrees(root: XmlElement, diagnostics: XmlDiagnostics) -> None:
    """Warn about joint angles that are likely degrees, and name the first of them."""
    angle_texts: list[tuple[XmlElement, str, str]] = []
    for joint in root.find_all("joint"):
        if joint.attributes.get("type") == "revolute":
            for limit in joint.find_all("limit"):
                angle_texts += [
                    (limit, n, limit.attributes.get(n, "")) for n in _LIMIT_ATTRIBUTES
                ]
    angle_texts += [
        (element, "rpy", element.attributes.get("rpy", ""))
        for element in root.walk()
        if element.tag == "origin"
    ]
    degree_angles = [
        (element, name, value)
        for element, name, text in angle_texts
        for value in map(to_number, text.split())
        if value is not None
        and MAX_PLAUSIBLE_RADIANS < abs(value) <= MAX_PLAUSIBLE_DEGREES
    ]
    if not degree_angles:
        return
    element, name, value = degree_angles[0]
    verb = "is" if len(degree_angles) == 1 else "are"
    message = f"{counted(len(degree_angles), 'angle')} {verb} over two revolutions, "
    message += f'such as {name}="{value:g}" in <{element.tag}>'
    hint = f"URDF angles are in radians: write {math.radians(value):.6g} for {value:g}°"
    diagnostics.add("URD111", element, message, hint, severity=Severity.WARNING)


def _ignored_labels(root: XmlElement) -> Iterator[str]:
    """Yield labels of contents that a rig cannot store."""
    for element in root.children:
        if element.tag == "material":
            yield "materials"
        elif element.tag not in STANDARD_TAGS:
            yield f"<{element.tag[:40]}>"
        for child in element.children:
            if element.tag == "joint" and child.tag in _IGNORED_JOINT_LABELS:
                yield _IGNORED_JOINT_LABELS[child.tag]
            elif element.tag == "joint" and child.tag == "limit":
                names = {"effort", "velocity"} & set(child.attributes)
                yield from ("effort and velocity limits",) if names else ()


def _actuated_joints(root: XmlElement) -> tuple[frozenset[str], bool]:
    """Return joints of transmissions or controllers, and whether there are any."""
    actuators = [*root.find_all("transmission"), *root.find_all("ros2_control")]
    names = {
        joint.attributes.get("name", "")
        for actuator in actuators
        for joint in actuator.walk()
        if joint.tag == "joint"
    }
    return frozenset(names), bool(actuators)


def _read_joint(
    element: XmlElement, joints: dict[str, UrdfJoint], diagnostics: XmlDiagnostics
) -> None:
    """Read a joint into the joints of the file; record faults."""
    name = require_text(element, "name", None, diagnostics)
    if not name:
        return
    location = element_label("joint", name)
    if name in joints:
        message = f"two joints are named {excerpt(name)} (the first is in line "
        message += f"{joints[name].element.line})"
        diagnostics.add("URD009", element, message, "rename one of them", joint=name)
        return
    kind_names = ", ".join(UrdfJointKind)
    type_name = require_text(
        element, "type", location, diagnostics, f"allowed: {kind_names}"
    )
    if type_name not in list(UrdfJointKind):
        if type_name:
            message = f"unknown joint type {excerpt(type_name)}"
            hint = name_hint(type_name, [kind.value for kind in UrdfJointKind])
            diagnostics.add(
                "URD008", element, message, hint, location=location, joint=name
            )
        type_name = UrdfJointKind.FIXED
    link_names = []
    for tag in ("parent", "child"):
        reference = find_single_child(
            element, tag, location, diagnostics, is_required=True
        )
        link = (
            ""
            if reference is None
            else require_text(reference, "link", location, diagnostics)
        )
        link_names.append(link)
    parent, child = link_names
    kind, pose = UrdfJointKind(type_name), read_pose(element, location, diagnostics)
    joint = joints[name] = UrdfJoint(element, name, kind, parent, child, *pose)
    if joint.kind not in {UrdfJointKind.FIXED, UrdfJointKind.FLOATING}:
        joint.axis = _read_axis(joint, diagnostics)
    joint.limits = _read_limits(joint, diagnostics)
    joint.mimic = _read_mimic(joint, diagnostics)


def _read_axis(joint: UrdfJoint, diagnostics: XmlDiagnostics) -> Vector:
    element = find_single_child(joint.element, "axis", joint.location, diagnostics)
    if element is None:
        return (1.0, 0.0, 0.0)
    values = diagnostics.read_numbers(
        element, "xyz", 3, (1.0, 0.0, 0.0), joint.location
    )
    if max(map(abs, values)) < MIN_AXIS_LENGTH:
        text = element.attributes.get("xyz", "")
        message = f"axis {excerpt(text)} has no length, and so no direction"
        hint = "write the axis of rotation or the direction of travel"
        add_joint_fault(diagnostics, "URD013", joint, message, hint, element)
        return (1.0, 0.0, 0.0)
    return _unit_direction(np.array(values))


def _unit_direction(values: FloatArray) -> Vector:
    """Return a unit vector, normalised to full precision."""
    direction = values / np.abs(values).max()
    return float_vector(direction / math.sqrt(float(direction @ direction)))


def _read_limits(joint: UrdfJoint, diagnostics: XmlDiagnostics) -> RangeLimit | None:
    location = joint.location
    element = find_single_child(joint.element, "limit", location, diagnostics)
    if joint.kind not in _LIMITED_KINDS:
        return None
    if element is None:
        message = f"is {joint.kind} and has no <limit>"
        hint = 'write <limit lower="…" upper="…" effort="…" velocity="…"/>'
        if joint.kind is UrdfJointKind.REVOLUTE:
            hint += ", or make it continuous"
        add_joint_fault(diagnostics, "URD014", joint, message, hint)
        return None
    lower, upper = (
        diagnostics.read_numbers(
            element, name, 1, (0.0,), location, max_value=math.inf
        )[0]
        for name in _LIMIT_ATTRIBUTES
    )
    if lower > upper:
        message = f"its lower limit {lower:g} is above its upper limit {upper:g}"
        hint = f'write lower="{upper:g}" upper="{lower:g}" if they are swapped'
        add_joint_fault(diagnostics, "URD014", joint, message, hint, element)
        return None
    if lower == upper:
        message = f"its limits are both {lower:g}: it cannot move"
        warning = Severity.WARNING
        add_joint_fault(diagnostics, "URD104", joint, message, None, element, warning)
    if lower <= -MAX_VALUE and upper >= MAX_VALUE:
        return None
    return RangeLimit(max(lower, -MAX_VALUE), min(upper, MAX_VALUE))


def _read_mimic(joint: UrdfJoint, diagnostics: XmlDiagnostics) -> Mimic | None:
    location = joint.location
    element = find_single_child(joint.element, "mimic", location, diagnostics)
    if element is None:
        return None
    if joint.kind is UrdfJointKind.FIXED:
        diagnostics.record_ignored(["mimics of fixed joints"])
        return None
    leader = require_text(element, "joint", location, diagnostics)
    gain = diagnostics.read_number(element, "multiplier", 1.0, location)
    offset = diagnostics.read_number(element, "offset", 0.0, location)
    if joint.kind not in SCALAR_KINDS:
        message = f"is {joint.kind}, and mimics {excerpt(leader)}"
        hint = "revolute, continuous and prismatic joints can mimic another"
        add_joint_fault(diagnostics, "URD015", joint, message, hint, element)
        return None
    return Mimic(leader, gain, offset) if leader else None


def _read_link(
    element: XmlElement, links: dict[str, UrdfLink], diagnostics: XmlDiagnostics
) -> None:
    """Read a link into the links of the file; record faults."""
    name = require_text(element, "name", None, diagnostics)
    if not name:
        return
    link_label = element_label("link", name)
    if name in links:
        message = f"two links are named {excerpt(name)} (the first is in line "
        message += f"{links[name].element.line})"
        diagnostics.add("URD009", element, message, "rename one of them")
        return
    link = links[name] = UrdfLink(element, name)
    inertial = find_single_child(element, "inertial", link_label, diagnostics)
    if inertial is not None:
        link.mass = _read_mass(inertial, link_label, diagnostics)
    link.meshes += [
        mesh
        for shape in (*element.find_all("visual"), *element.find_all("collision"))
        for geometry in shape.find_all("geometry")
        for mesh in geometry.find_all("mesh")
        if mesh.attributes.get("filename")
    ]
    for shape_element in element.find_all("collision"):
        solid = _read_shape(shape_element, link_label, diagnostics)
        if solid is not None:
            link.solids.append(solid)
    for shape_element in element.find_all("visual"):
        link.visuals += _read_visual(shape_element, link_label, diagnostics)


def _read_visual(
    element: XmlElement, location: str, diagnostics: XmlDiagnostics
) -> Iterator[Visual]:
    """Yield the visual of an element; record an invalid one as ignored."""
    visual_diagnostics = XmlDiagnostics(diagnostics.path, diagnostics.number_code)
    meshes = [m for g in element.find_all("geometry") for m in g.find_all("mesh")]
    visual: Visual | None = None
    if meshes and meshes[0].attributes.get("filename"):
        position, rotation = read_pose(element, location, visual_diagnostics)
        x, y, z = visual_diagnostics.read_numbers(
            meshes[0], "scale", 3, (1.0, 1.0, 1.0), location
        )
        pose = SimpleShape("mesh", (), position, rotation)
        visual = Visual(meshes[0], pose, (x, y, z))
    elif not meshes:
        solid = _read_shape(element, location, visual_diagnostics)
        visual = None if solid is None else Visual(None, solid)
    if visual_diagnostics.faults:
        diagnostics.record_ignored(["visuals with faults"])
    elif visual is not None:
        yield visual
    else:
        diagnostics.record_ignored(["visuals without a shape"])


def _read_mass(
    inertial: XmlElement, location: str, diagnostics: XmlDiagnostics
) -> LinkMass | None:
    """Return a link's mass; None if missing or, with a warning, impossible."""
    position, rotation = read_pose(inertial, location, diagnostics)
    fault_count = len(diagnostics.faults)
    mass_element = find_single_child(inertial, "mass", location, diagnostics)
    inertia_element = find_single_child(inertial, "inertia", location, diagnostics)
    mass = 0.0
    if mass_element is not None:
        mass = diagnostics.read_number(mass_element, "value", 0.0, location)
    inertia = np.zeros((3, 3))
    if inertia_element is not None:
        for i, row_axis in enumerate("xyz"):
            for j, column_axis in enumerate("xyz"[i:], i):
                value = diagnostics.read_number(
                    inertia_element, f"i{row_axis}{column_axis}", 0.0, location
                )
                inertia[i, j] = inertia[j, i] = value
    if len(diagnostics.faults) > fault_count:
        return None
    if not mass and not inertia.any():
        return None  # a frame without mass
    problem = find_mass_problem(mass, inertia)
    if problem:
        message = f"no body can have this mass: {problem}; it is ignored"
        hint = "bodies of a ragdoll then weigh what the density of colliders gives"
        severity = Severity.WARNING
        diagnostics.add(
            "URD107", inertial, message, hint, location=location, severity=severity
        )
        return None
    matrix = so3.to_matrix(np.array(rotation))
    return LinkMass(mass, position, matrix @ inertia @ matrix.T)


def _read_shape(
    element: XmlElement, location: str, diagnostics: XmlDiagnostics
) -> SimpleShape | None:
    """Return the primitive shape of a visual or collision; None for other geometry."""
    geometry = find_single_child(element, "geometry", location, diagnostics)
    shape = next(iter(geometry.children), None) if geometry is not None else None
    if shape is None or shape.tag not in _SHAPE_ATTRIBUTES:
        tag = "of no shape" if shape is None else f"of <{shape.tag[:40]}>"
        label = "collision meshes" if tag == "of <mesh>" else f"collisions {tag}"
        diagnostics.record_ignored([label])
        return None
    position, rotation = read_pose(element, location, diagnostics)
    size: list[float] = []
    fault_count = len(diagnostics.faults)
    for name, count in _SHAPE_ATTRIBUTES[shape.tag]:
        if require_text(shape, name, location, diagnostics):
            size += diagnostics.read_numbers(
                shape, name, count, (1.0,) * count, location
            )
    if len(diagnostics.faults) > fault_count:
        return None
    if min(size) <= 0:
        diagnostics.record_ignored(["collisions without size"])
        return None
    return SimpleShape(shape.tag, tuple(size), position, rotation)
