"""Records of URDF links and joints, and readers of elements that both have."""

from __future__ import annotations

import math
from dataclasses import field
from enum import StrEnum

from animtool.core.errors import Severity
from animtool.core.record import dataclass
from animtool.formats.robots.diagnostics import XmlDiagnostics, element_label
from animtool.formats.robots.parts import ORIGIN, LinkMass, SimpleShape
from animtool.formats.robots.xml import XmlCodes, XmlElement
from animtool.rig.limits import RangeLimit
from animtool.rig.parts import Vector
from animtool.rig.skeleton import Mimic, Quaternion

XML_CODES = XmlCodes("URD001", "URD002", "URD003")


class UrdfJointKind(StrEnum):
    """The joint types that URDF defines."""

    REVOLUTE = "revolute"
    CONTINUOUS = "continuous"
    PRISMATIC = "prismatic"
    FIXED = "fixed"
    FLOATING = "floating"
    PLANAR = "planar"


# Joint types with one coordinate.
SCALAR_KINDS = frozenset(
    {UrdfJointKind.REVOLUTE, UrdfJointKind.CONTINUOUS, UrdfJointKind.PRISMATIC}
)


@dataclass(slots=True, eq=False)
class UrdfJoint:
    """A joint of the file before its tree is checked."""

    element: XmlElement
    name: str
    kind: UrdfJointKind
    parent: str
    child: str
    position: Vector = ORIGIN
    rotation: Quaternion = (0.0, 0.0, 0.0, 1.0)
    axis: Vector = (1.0, 0.0, 0.0)
    limits: RangeLimit | None = None
    mimic: Mimic | None = None

    @property
    def location(self) -> str:
        """Label of the joint in messages, such as ``joint 'elbow'``."""
        return element_label("joint", self.name)


@dataclass(frozen=True, slots=True, eq=False)
class Visual:
    """A visual of a link: a mesh or a primitive shape."""

    mesh: XmlElement | None
    solid: SimpleShape  # for a mesh, only its pose is used
    scale: Vector = (1.0, 1.0, 1.0)


@dataclass(slots=True, eq=False)
class UrdfLink:
    """A link of the file before its tree is checked."""

    element: XmlElement
    name: str
    mass: LinkMass | None = None
    solids: list[SimpleShape] = field(default_factory=list)
    meshes: list[XmlElement] = field(default_factory=list)
    visuals: list[Visual] = field(default_factory=list)


@dataclass(slots=True, eq=False)
class UrdfFile:
    """The links and joints of a URDF before its tree is checked."""

    name: str
    links: dict[str, UrdfLink]
    joints: dict[str, UrdfJoint]
    actuated_joints: frozenset[str]  # joints with a transmission or controller
    has_actuators: bool  # whether there are transmissions or controllers


def add_joint_fault(
    diagnostics: XmlDiagnostics,
    code: str,
    joint: UrdfJoint,
    message: str,
    hint: str | None = None,
    element: XmlElement | None = None,
    severity: Severity = Severity.ERROR,
) -> None:
    """Record a fault of a joint, at an element inside it or at the joint."""
    location, name = joint.location, joint.name
    element = element or joint.element
    diagnostics.add(
        code, element, message, hint, location=location, joint=name, severity=severity
    )


def find_single_child(
    element: XmlElement,
    tag: str,
    location: str,
    diagnostics: XmlDiagnostics,
    *,
    is_required: bool = False,
) -> XmlElement | None:
    """Return the only child with a tag, or None; record a fault if it is required."""
    elements = element.find_all(tag)
    if any(child.attributes != elements[0].attributes for child in elements):
        message = f"<{tag}> is given {len(elements)} times with different values"
        diagnostics.add("URD006", elements[1], message, "keep one", location=location)
    if not elements and is_required:
        diagnostics.add("URD006", element, f"<{tag}> is missing", location=location)
    return elements[0] if elements else None


def require_text(
    element: XmlElement,
    name: str,
    location: str | None,
    diagnostics: XmlDiagnostics,
    hint: str = "",
) -> str:
    """Return a required attribute; record a fault and return "" if it is missing."""
    text = element.attributes.get(name, "")
    if not text.strip():
        problem = "is empty" if name in element.attributes else "is missing"
        message = f"{name} of <{element.tag}> {problem}"
        diagnostics.add("URD006", element, message, hint or None, location=location)
        return ""
    return text


def read_pose(
    element: XmlElement, location: str, diagnostics: XmlDiagnostics
) -> tuple[Vector, Quaternion]:
    """Return position [m] and rotation of an element's origin, by default identity."""
    origin = find_single_child(element, "origin", location, diagnostics)
    if origin is None:
        return ORIGIN, (0.0, 0.0, 0.0, 1.0)
    x, y, z = diagnostics.read_numbers(origin, "xyz", 3, ORIGIN, location)
    roll, pitch, yaw = diagnostics.read_numbers(origin, "rpy", 3, ORIGIN, location)
    return (x, y, z), rotation_from_rpy(roll, pitch, yaw)


def rotation_from_rpy(roll: float, pitch: float, yaw: float) -> Quaternion:
    """Return the rotation by roll, pitch and yaw about fixed x, y and z [rad].

    >>> rotation_from_rpy(0.0, 0.0, math.pi)
    (0.0, 0.0, 1.0, 6.123233995736766e-17)
    """
    a, b = math.sin(roll / 2), math.cos(roll / 2)
    c, d = math.sin(pitch / 2), math.cos(pitch / 2)
    e, f = math.sin(yaw / 2), math.cos(yaw / 2)
    x, y = a * d * f - b * c * e, b * c * f + a * d * e
    z, w = b * d * e - a * c * f, b * d * f + a * c * e
    return (x + 0.0, y + 0.0, z + 0.0, w + 0.0)
