"""Reads URDF joints: type, links, origin, axis, limits and mimic."""

from __future__ import annotations

import math

import numpy as np

from animtool.core.array_types import FloatArray
from animtool.core.errors import Severity, excerpt
from animtool.core.names import nearest
from animtool.formats.robots.notes import MAX_VALUE, XmlNotes, element_label
from animtool.formats.robots.parts import float_vector
from animtool.formats.robots.xml import XmlElement
from animtool.formats.urdf.elements import (
    SCALAR_KINDS,
    UrdfJoint,
    UrdfJointKind,
    find_single_child,
    read_pose,
    require_text,
)
from animtool.rig.limits import RangeLimit
from animtool.rig.parts import Vector
from animtool.rig.skeleton import Mimic

# Shorter axes have no direction.
MIN_AXIS_LENGTH = 1e-9
_LIMITED_KINDS = frozenset({UrdfJointKind.REVOLUTE, UrdfJointKind.PRISMATIC})


def add_joint(
    element: XmlElement, joints: dict[str, UrdfJoint], notes: XmlNotes
) -> None:
    """Add a joint to the file's joints; record faults."""
    name = require_text(element, "name", None, notes)
    if not name:
        return
    where = element_label("joint", name)
    if name in joints:
        first_line = joints[name].element.line
        message = f"two joints are named {excerpt(name)}"
        hint = f"the first is in line {first_line}"
        notes.add("URD009", element, message, hint, joint=name)
        return
    kind_names = ", ".join(UrdfJointKind)
    type_name = require_text(element, "type", where, notes, f"allowed: {kind_names}")
    if type_name not in list(UrdfJointKind):
        if type_name:
            message = f"unknown joint type {excerpt(type_name)}"
            hint = nearest(type_name, [kind.value for kind in UrdfJointKind])
            notes.add("URD008", element, message, hint, where=where, joint=name)
        type_name = UrdfJointKind.FIXED
    link_names = []
    for tag in ("parent", "child"):
        link_element = find_single_child(element, tag, where, notes, needed=True)
        link_names.append(
            ""
            if link_element is None
            else require_text(link_element, "link", where, notes)
        )
    position, rotation = read_pose(element, where, notes)
    joint = UrdfJoint(
        element,
        name,
        UrdfJointKind(type_name),
        link_names[0],
        link_names[1],
        position,
        rotation,
    )
    joints[name] = joint
    if joint.kind not in {UrdfJointKind.FIXED, UrdfJointKind.FLOATING}:
        joint.axis = _read_axis(joint, notes)
    joint.limits = _read_limits(joint, notes)
    joint.mimic = _read_mimic(joint, notes)


def _read_axis(joint: UrdfJoint, notes: XmlNotes) -> Vector:
    element = find_single_child(joint.element, "axis", joint.where, notes)
    if element is None:
        return (1.0, 0.0, 0.0)
    values = notes.numbers(element, "xyz", 3, (1.0, 0.0, 0.0), joint.where)
    if max(map(abs, values)) < MIN_AXIS_LENGTH:
        text = element.attributes.get("xyz", "")
        message = f"axis {excerpt(text)} has no length, and so no direction"
        hint = "write the axis of rotation or the direction of travel"
        where = joint.where
        notes.add("URD013", element, message, hint, where=where, joint=joint.name)
        return (1.0, 0.0, 0.0)
    return unit_direction(np.array(values))


def unit_direction(values: FloatArray) -> Vector:
    """Return a unit vector, normalised to full precision."""
    direction = values / np.abs(values).max()
    return float_vector(direction / math.sqrt(float(direction @ direction)))


def _read_limits(joint: UrdfJoint, notes: XmlNotes) -> RangeLimit | None:
    where, name = joint.where, joint.name
    element = find_single_child(joint.element, "limit", where, notes)
    if joint.kind not in _LIMITED_KINDS:
        return None
    if element is None:
        message = f"is {joint.kind} and has no <limit>"
        hint = 'write <limit lower="…" upper="…" effort="…" velocity="…"/>'
        if joint.kind is UrdfJointKind.REVOLUTE:
            hint += ", or make it continuous"
        notes.add("URD014", joint.element, message, hint, where=where, joint=name)
        return None
    lower, upper = (
        notes.numbers(element, name, 1, (0.0,), where, limit=math.inf)[0]
        for name in ("lower", "upper")
    )
    if lower > upper:
        message = f"its lower limit {lower:g} is above its upper limit {upper:g}"
        hint = f'write lower="{upper:g}" upper="{lower:g}" if they are swapped'
        notes.add("URD014", element, message, hint, where=where, joint=name)
        return None
    if lower == upper:
        message = f"its limits are both {lower:g}: it cannot move"
        notes.add(
            "URD104", element, message, where=where, joint=name,
            severity=Severity.WARNING,
        )  # fmt: skip
    if lower <= -MAX_VALUE and upper >= MAX_VALUE:
        return None
    return RangeLimit(max(lower, -MAX_VALUE), min(upper, MAX_VALUE))


def _read_mimic(joint: UrdfJoint, notes: XmlNotes) -> Mimic | None:
    where = joint.where
    element = find_single_child(joint.element, "mimic", where, notes)
    if element is None:
        return None
    if joint.kind is UrdfJointKind.FIXED:
        notes.leave_out(["mimics of fixed joints"])
        return None
    leader = require_text(element, "joint", where, notes)
    gain = notes.number(element, "multiplier", 1.0, where)
    offset = notes.number(element, "offset", 0.0, where)
    if joint.kind not in SCALAR_KINDS:
        message = f"is {joint.kind}, and mimics {excerpt(leader)}"
        hint = "revolute, continuous and prismatic joints can mimic another"
        notes.add("URD015", element, message, hint, where=where, joint=joint.name)
        return None
    return Mimic(leader, gain, offset) if leader else None
