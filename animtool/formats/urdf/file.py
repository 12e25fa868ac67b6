"""Parses a URDF: links and joints, and notices about other contents."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path

from animtool.core.errors import Severity, counted, excerpt
from animtool.core.files.signatures import expects_format
from animtool.formats.robots.notes import XmlNotes, to_number
from animtool.formats.robots.xml import XmlElement, read_xml
from animtool.formats.urdf.elements import CODES, UrdfFile, UrdfJoint, UrdfLink
from animtool.formats.urdf.joints import add_joint
from animtool.formats.urdf.links import add_link

_XACRO_MARKERS = "${", "$("
EXPAND_HINT = "expand it: xacro robot.urdf.xacro -o robot.urdf (from the package of "
EXPAND_HINT += "ROS)"


@expects_format("URD001", "a URDF file")
def read_file(path: Path, notes: XmlNotes) -> UrdfFile:
    """Return a file's links and joints; record faults."""
    root = read_xml(path, CODES)
    _check_root(root, notes)
    notes.check()
    links: dict[str, UrdfLink] = {}
    joints: dict[str, UrdfJoint] = {}
    for element in root.children:
        if element.tag == "link":
            add_link(element, links, notes)
        elif element.tag == "joint":
            add_joint(element, joints, notes)
    if not links and not notes.faults:
        message = "the robot has no link"
        notes.add("URD006", root, message, "a robot is links, and joints between them")
    _warn_about_degrees(root, notes)
    actuated_joints, has_actuators = _actuated_joints(root)
    notes.leave_out(_ignored_labels(root))
    name = root.attributes.get("name", "")
    return UrdfFile(name, links, joints, actuated_joints, has_actuators)


def _check_root(root: XmlElement, notes: XmlNotes) -> None:
    """Record roots other than <robot>, and xacro files."""
    for element in root.walk():
        texts = element.attributes.values()
        is_macro = element.tag.startswith("xacro:")
        if is_macro or any(start in text for text in texts for start in _XACRO_MARKERS):
            macro_text = next(
                (t for t in texts if any(start in t for start in _XACRO_MARKERS)),
                "",
            )
            macro_label = f"<{element.tag}>" if is_macro else excerpt(macro_text)
            message = f"is a xacro file: it holds {macro_label}, which a URDF is made "
            message += "from"
            notes.add("URD005", element, message, EXPAND_HINT)
            return
    if root.tag == "robot":
        return
    hints = {
        "sdf": "convert it: gz sdf -p model.sdf prints it, and sdf2urdf makes a URDF",
        "mujoco": "it is MJCF: name it .xml",
        "COLLADA": "it is a mesh or a scene in COLLADA",
    }
    hint = hints.get(root.tag, "the root element of a URDF is <robot>")
    notes.add("URD004", root, f"no URDF: its root element is <{root.tag[:60]}>", hint)


# Two revolutions, which robot angles do not exceed [rad], and in degrees; larger limits
# mean no limits.
MAX_RADIANS = 4 * math.pi
MAX_DEGREES = 720.0


def _warn_about_degrees(root: XmlElement, notes: XmlNotes) -> None:
    """Warn about joint angles that are likely degrees, and name the first of them."""
    texts: list[tuple[XmlElement, str, str]] = []
    for joint in root.all("joint"):
        if joint.attributes.get("type") == "revolute":
            for limit in joint.all("limit"):
                texts += [
                    (limit, n, limit.attributes.get(n, "")) for n in _LIMIT_ATTRIBUTES
                ]
    texts += [
        (element, "rpy", element.attributes.get("rpy", ""))
        for element in root.walk()
        if element.tag == "origin"
    ]
    in_degrees = [
        (element, name, value)
        for element, name, text in texts
        for value in map(to_number, text.split())
        if value is not None and MAX_RADIANS < abs(value) <= MAX_DEGREES
    ]
    if not in_degrees:
        return
    element, name, value = in_degrees[0]
    message = f"{counted(len(in_degrees), 'angle')} beyond two revolutions in radians, "
    message += f"such as {name} {value:g} of <{element.tag}>"
    hint = f"URDF has radians: {value:g} degrees are {math.radians(value):.6g}"
    notes.add("URD111", element, message, hint, severity=Severity.WARNING)


_LIMIT_ATTRIBUTES = ("lower", "upper")
# Elements that are not read, and their labels.
_HANDLED_TAGS = {"link", "joint", "material"}
_JOINT_CONTENTS = {
    "dynamics": "damping and friction of joints",
    "safety_controller": "safety controllers",
    "calibration": "calibrations",
}


def _ignored_labels(root: XmlElement) -> Iterator[str]:
    """Yield labels of contents that a rig cannot store."""
    for element in root.children:
        if element.tag == "material":
            yield "materials"
        elif element.tag not in _HANDLED_TAGS:
            yield f"<{element.tag[:40]}>"
        for child in element.children:
            if element.tag == "joint" and child.tag in _JOINT_CONTENTS:
                yield _JOINT_CONTENTS[child.tag]
            elif element.tag == "joint" and child.tag == "limit":
                names = {"effort", "velocity"} & set(child.attributes)
                yield from ("limits of effort and velocity",) if names else ()


def _actuated_joints(root: XmlElement) -> tuple[frozenset[str], bool]:
    """Return joints named by transmissions or controllers, and if any exist."""
    actuators = [*root.all("transmission"), *root.all("ros2_control")]
    names = {
        joint.attributes.get("name", "")
        for actuator in actuators
        for joint in actuator.walk()
        if joint.tag == "joint"
    }
    return frozenset(names), bool(actuators)
