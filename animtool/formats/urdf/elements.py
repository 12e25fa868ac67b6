"""The links and joints of a URDF as they are written, with every fault of theirs."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import field
from enum import StrEnum
from pathlib import Path

import numpy as np

from animtool.core.array_types import FloatArray
from animtool.core.errors import Severity, excerpt
from animtool.core.names import nearest
from animtool.core.record import dataclass
from animtool.formats.robots.notes import LARGEST, Notes, named
from animtool.formats.robots.parts import ORIGIN, Solid, Weight, vector
from animtool.formats.robots.solids import weight_problem
from animtool.formats.robots.xml import Element, XmlCodes, read_xml
from animtool.maths import so3
from animtool.rig.limits import RangeLimit
from animtool.rig.parts import Vector
from animtool.rig.skeleton import Mimic, Quaternion

CODES = XmlCodes("URD001", "URD002", "URD003")
# An axis that is shorter has no direction.
SHORTEST = 1e-9
_XACRO = "${", "$("
EXPAND = "expand it: xacro robot.urdf.xacro -o robot.urdf (from the package of ROS)"


class Kind(StrEnum):
    """What a joint of a URDF does."""

    REVOLUTE = "revolute"
    CONTINUOUS = "continuous"
    PRISMATIC = "prismatic"
    FIXED = "fixed"
    FLOATING = "floating"
    PLANAR = "planar"


# Kinds with one coordinate.
SCALAR = frozenset({Kind.REVOLUTE, Kind.CONTINUOUS, Kind.PRISMATIC})
_LIMITED = frozenset({Kind.REVOLUTE, Kind.PRISMATIC})


@dataclass(slots=True, eq=False)
class UrdfJoint:
    """A joint as it is written."""

    element: Element
    name: str
    kind: Kind
    parent: str
    child: str
    position: Vector = ORIGIN
    rotation: Quaternion = (0.0, 0.0, 0.0, 1.0)
    axis: Vector = (1.0, 0.0, 0.0)
    limits: RangeLimit | None = None
    mimic: Mimic | None = None

    @property
    def where(self) -> str:
        """What faults call it."""
        return named("joint", self.name)


@dataclass(slots=True, eq=False)
class UrdfLink:
    """A link as it is written."""

    element: Element
    name: str
    weight: Weight | None = None
    solids: list[Solid] = field(default_factory=list)
    meshes: list[Element] = field(default_factory=list)


@dataclass(slots=True, eq=False)
class UrdfFile:
    """A URDF: what it says, before its tree is looked at."""

    name: str
    links: dict[str, UrdfLink]
    joints: dict[str, UrdfJoint]
    driven: frozenset[str]  # joints that a transmission or controller names
    has_drives: bool  # whether it names any


def read_file(path: Path, notes: Notes) -> UrdfFile:
    """Return a file's links and joints; faults are noted.

    Raises:
        FormatError: It is no URDF in XML (URD001 to URD005).
    """
    root = read_xml(path, CODES)
    _check_root(root, notes)
    notes.check()
    links: dict[str, UrdfLink] = {}
    joints: dict[str, UrdfJoint] = {}
    for element in root.children:
        if element.tag == "link":
            _add_link(element, links, notes)
        elif element.tag == "joint":
            _add_joint(element, joints, notes)
    if not links and not notes.faults:
        message = "the robot has no link"
        notes.add("URD006", root, message, "a robot is links, and joints between them")
    driven, drives = _driven(root)
    notes.leave_out(_not_read(root))
    name = root.attributes.get("name", "")
    return UrdfFile(name, links, joints, driven, drives)


def _check_root(root: Element, notes: Notes) -> None:
    """Note what is no URDF, and a xacro file, which makes one."""
    for element in root.walk():
        texts = element.attributes.values()
        macro = element.tag.startswith("xacro:")
        if macro or any(mark in text for text in texts for mark in _XACRO):
            shown = next(
                (text for text in texts if any(mark in text for mark in _XACRO)), ""
            )
            what = f"<{element.tag}>" if macro else excerpt(shown)
            message = f"is a xacro file: it holds {what}, which a URDF is made from"
            notes.add("URD005", element, message, EXPAND)
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


def _one(
    element: Element, tag: str, where: str, notes: Notes, *, needed: bool = False
) -> Element | None:
    """Return the child of a name; none where it is missing, the first of several."""
    found = element.all(tag)
    if any(one.attributes != found[0].attributes for one in found):
        message = f"<{tag}> is given {len(found)} times, not alike"
        notes.add("URD006", found[1], message, "keep one", where=where)
    if not found and needed:
        notes.add("URD006", element, f"<{tag}> is missing", where=where)
    return found[0] if found else None


def _text(
    element: Element, name: str, where: str | None, notes: Notes, hint: str = ""
) -> str:
    """Return an attribute that must be there; empty where it is not."""
    text = element.attributes.get(name, "")
    if not text.strip():
        what = "is empty" if name in element.attributes else "is missing"
        message = f"{name} of <{element.tag}> {what}"
        notes.add("URD006", element, message, hint or None, where=where)
        return ""
    return text


def _pose(element: Element, where: str, notes: Notes) -> tuple[Vector, Quaternion]:
    """Return the origin of an element."""
    origin = _one(element, "origin", where, notes)
    if origin is None:
        return ORIGIN, (0.0, 0.0, 0.0, 1.0)
    x, y, z = notes.numbers(origin, "xyz", 3, ORIGIN, where)
    r, p, w = notes.numbers(origin, "rpy", 3, ORIGIN, where)
    return (x, y, z), from_rpy(r, p, w)


def from_rpy(roll: float, pitch: float, yaw: float) -> Quaternion:
    """Return the rotation by roll, pitch and yaw about fixed x, y and z [rad].

    >>> from_rpy(0.0, 0.0, math.pi)
    (0.0, 0.0, 1.0, 6.123233995736766e-17)
    """
    a, b = math.sin(roll / 2), math.cos(roll / 2)
    c, d = math.sin(pitch / 2), math.cos(pitch / 2)
    e, f = math.sin(yaw / 2), math.cos(yaw / 2)
    x, y = a * d * f - b * c * e, b * c * f + a * d * e
    z, w = b * d * e - a * c * f, b * d * f + a * c * e
    return (x + 0.0, y + 0.0, z + 0.0, w + 0.0)


def _add_link(element: Element, links: dict[str, UrdfLink], notes: Notes) -> None:
    name = _text(element, "name", None, notes)
    if not name:
        return
    where = named("link", name)
    if name in links:
        first = links[name].element.line
        message = f"two links are named {excerpt(name)}"
        notes.add("URD009", element, message, f"the first is in line {first}")
        return
    link = links[name] = UrdfLink(element, name)
    inertial = _one(element, "inertial", where, notes)
    if inertial is not None:
        link.weight = _weight(inertial, where, notes)
    link.meshes += [
        mesh
        for shown in (*element.all("visual"), *element.all("collision"))
        for geometry in shown.all("geometry")
        for mesh in geometry.all("mesh")
        if mesh.attributes.get("filename")
    ]
    for part in element.all("collision"):
        solid = _solid(part, where, notes)
        if solid is not None:
            link.solids.append(solid)


def _weight(inertial: Element, where: str, notes: Notes) -> Weight | None:
    """Return the mass of a link; None where no body has it, with a warning."""
    position, turn = _pose(inertial, where, notes)
    before = len(notes.faults)
    mass_element = _one(inertial, "mass", where, notes)
    tensor = _one(inertial, "inertia", where, notes)
    mass = 0.0
    if mass_element is not None:
        mass = notes.number(mass_element, "value", 0.0, where)
    inertia = np.zeros((3, 3))
    if tensor is not None:
        for i, a in enumerate("xyz"):
            for j, b in enumerate("xyz"[i:], i):
                value = notes.number(tensor, f"i{a}{b}", 0.0, where)
                inertia[i, j] = inertia[j, i] = value
    if len(notes.faults) > before:
        return None
    if not mass and not inertia.any():
        return None  # a frame that weighs nothing
    problem = weight_problem(mass, inertia)
    if problem:
        message = f"no body weighs that: {problem}; it is left out"
        hint = "bodies of a ragdoll then weigh what the density of colliders gives"
        notes.add(
            "URD107", inertial, message, hint, where=where, severity=Severity.WARNING
        )
        return None
    matrix = so3.to_matrix(np.array(turn))
    return Weight(mass, position, matrix @ inertia @ matrix.T)


def _solid(part: Element, where: str, notes: Notes) -> Solid | None:
    """Return the shape of a collision; None of what no collider can be, and listed."""
    geometry = _one(part, "geometry", where, notes)
    shape = next(iter(geometry.children), None) if geometry is not None else None
    if shape is None or shape.tag not in _SHAPES:
        tag = "of no shape" if shape is None else f"of <{shape.tag[:40]}>"
        notes.leave_out(
            ["collision meshes" if tag == "of <mesh>" else f"collisions {tag}"]
        )
        return None
    position, rotation = _pose(part, where, notes)
    size: list[float] = []
    before = len(notes.faults)
    for name, count in _SHAPES[shape.tag]:
        if _text(shape, name, where, notes):
            size += notes.numbers(shape, name, count, (1.0,) * count, where)
    if len(notes.faults) > before:
        return None
    if min(size) <= 0:
        notes.leave_out(["collisions without size"])
        return None
    return Solid(shape.tag, tuple(size), position, rotation)


# Shapes, and which numbers each has.
_SHAPES: dict[str, tuple[tuple[str, int], ...]] = {
    "box": (("size", 3),),
    "sphere": (("radius", 1),),
    "cylinder": (("radius", 1), ("length", 1)),
    "capsule": (("radius", 1), ("length", 1)),
}


def _add_joint(element: Element, joints: dict[str, UrdfJoint], notes: Notes) -> None:
    name = _text(element, "name", None, notes)
    if not name:
        return
    where = named("joint", name)
    if name in joints:
        first = joints[name].element.line
        message = f"two joints are named {excerpt(name)}"
        hint = f"the first is in line {first}"
        notes.add("URD009", element, message, hint, joint=name)
        return
    allowed = ", ".join(Kind)
    text = _text(element, "type", where, notes, f"allowed: {allowed}")
    if text not in list(Kind):
        if text:
            message = f"unknown joint type {excerpt(text)}"
            hint = nearest(text, list(Kind))
            notes.add("URD008", element, message, hint, where=where, joint=name)
        text = Kind.FIXED
    ends = []
    for tag in ("parent", "child"):
        end = _one(element, tag, where, notes, needed=True)
        ends.append("" if end is None else _text(end, "link", where, notes))
    position, rotation = _pose(element, where, notes)
    joint = UrdfJoint(element, name, Kind(text), ends[0], ends[1], position, rotation)
    joints[name] = joint
    if joint.kind not in {Kind.FIXED, Kind.FLOATING}:
        joint.axis = _axis(joint, notes)
    joint.limits = _limits(joint, notes)
    joint.mimic = _mimic(joint, notes)


def _axis(joint: UrdfJoint, notes: Notes) -> Vector:
    element = _one(joint.element, "axis", joint.where, notes)
    if element is None:
        return (1.0, 0.0, 0.0)
    values = notes.numbers(element, "xyz", 3, (1.0, 0.0, 0.0), joint.where)
    if max(map(abs, values)) < SHORTEST:
        text = element.attributes.get("xyz", "")
        message = f"axis {excerpt(text)} has no length, and so no direction"
        hint = "write the direction that the joint turns about or slides along"
        at = joint.where
        notes.add("URD013", element, message, hint, where=at, joint=joint.name)
        return (1.0, 0.0, 0.0)
    return unit(np.array(values))


def unit(values: FloatArray) -> Vector:
    """Return a direction at unit length, to the last digit."""
    direction = values / np.abs(values).max()
    return vector(direction / math.sqrt(float(direction @ direction)))


def _limits(joint: UrdfJoint, notes: Notes) -> RangeLimit | None:
    where, name = joint.where, joint.name
    element = _one(joint.element, "limit", where, notes)
    if joint.kind not in _LIMITED:
        return None
    if element is None:
        message = f"is {joint.kind} and has no <limit>"
        hint = 'write <limit lower="…" upper="…" effort="…" velocity="…"/>'
        if joint.kind is Kind.REVOLUTE:
            hint += ", or make it continuous"
        notes.add("URD014", joint.element, message, hint, where=where, joint=name)
        return None
    low, high = (
        notes.numbers(element, name, 1, (0.0,), where, most=math.inf)[0]
        for name in ("lower", "upper")
    )
    if low > high:
        message = f"its lower limit {low:g} is above its upper limit {high:g}"
        hint = f'write lower="{high:g}" upper="{low:g}" if they are swapped'
        notes.add("URD014", element, message, hint, where=where, joint=name)
        return None
    if low == high:
        message = f"its limits are both {low:g}: it cannot move"
        notes.add(
            "URD104", element, message, where=where, joint=name,
            severity=Severity.WARNING,
        )  # fmt: skip
    if low <= -LARGEST and high >= LARGEST:
        return None
    return RangeLimit(max(low, -LARGEST), min(high, LARGEST))


def _mimic(joint: UrdfJoint, notes: Notes) -> Mimic | None:
    where = joint.where
    element = _one(joint.element, "mimic", where, notes)
    if element is None:
        return None
    if joint.kind is Kind.FIXED:
        notes.leave_out(["mimics of fixed joints"])
        return None
    leader = _text(element, "joint", where, notes)
    gain = notes.number(element, "multiplier", 1.0, where)
    offset = notes.number(element, "offset", 0.0, where)
    if joint.kind not in SCALAR:
        message = f"is {joint.kind}, and mimics {excerpt(leader)}"
        hint = "revolute, continuous and prismatic joints can mimic another"
        notes.add("URD015", element, message, hint, where=where, joint=joint.name)
        return None
    return Mimic(leader, gain, offset) if leader else None


# Elements that a robot may have, and what they are called where they are not read.
_KNOWN = {"link", "joint", "material"}
_OF_JOINTS = {
    "dynamics": "damping and friction of joints",
    "safety_controller": "safety controllers",
    "calibration": "calibrations",
}


def _not_read(root: Element) -> Iterator[str]:
    """Yield what of a robot no rig holds, in words."""
    for element in root.children:
        if element.tag == "material":
            yield "materials"
        elif element.tag not in _KNOWN:
            yield f"<{element.tag[:40]}>"
        for child in element.children:
            if element.tag == "joint" and child.tag in _OF_JOINTS:
                yield _OF_JOINTS[child.tag]
            elif element.tag == "joint" and child.tag == "limit":
                names = {"effort", "velocity"} & set(child.attributes)
                yield from ("limits of effort and velocity",) if names else ()
            elif element.tag == "link" and child.tag == "visual":
                yield "visuals"


def _driven(root: Element) -> tuple[frozenset[str], bool]:
    """Return the joints that transmissions or controllers name, and if any exists."""
    drives = [*root.all("transmission"), *root.all("ros2_control")]
    names = {
        joint.attributes.get("name", "")
        for drive in drives
        for joint in drive.walk()
        if joint.tag == "joint"
    }
    return frozenset(names), bool(drives)
