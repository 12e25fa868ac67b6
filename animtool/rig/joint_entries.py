"""Reads the joints of a rig file: a tree in any order, mirrored sides, limits."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import field, replace

from animtool.core.errors import counted, cycle_text, listed
from animtool.core.names import name_hint
from animtool.core.quantities import length_text
from animtool.core.record import dataclass
from animtool.documents.document import Document, Location
from animtool.maths import so3
from animtool.rig.driver_entries import read_driver
from animtool.rig.joint_schema import (
    BallJointModel,
    BallLimitsModel,
    JointModel,
    PinJointModel,
    PrismaticJointModel,
)
from animtool.rig.limits import BallLimit, RangeLimit
from animtool.rig.parts import Vector
from animtool.rig.sides import ORIGIN, PoseArrays, mirror_joint, world_transform_below
from animtool.rig.skeleton import Joint, JointType, Mimic
from animtool.rig.suspicions import warn_of_quaternion_length

# Shorter axes and quaternions are mistakes.
MIN_VECTOR_LENGTH = 1e-9
# Deviation from unit length that is rounding; such values are kept as written, so that
# files round-trip.
UNIT_TOLERANCE = 1e-15
# Joints this close to the middle plane are on it [m].
MIDDLE_TOLERANCE = 1e-6


@dataclass(frozen=True, slots=True)
class FileUnits:
    """Length unit [m] and angle unit [rad] of a file."""

    length: float
    angle: float

    def unit_of(self, joint_type: JointType) -> float:
        """Return the unit of a pin's or prismatic joint's coordinate."""
        return self.length if joint_type is JointType.PRISMATIC else self.angle


@dataclass(frozen=True, slots=True)
class FileJoints:
    """The joints of a rig file, and which of them are not fully known."""

    joints: tuple[Joint, ...]  # parents before children
    # Names of joints whose parent is unknown.
    orphaned_joints: frozenset[str] = frozenset()
    # Names of joints created by another joint's ``mirror``.
    mirrored_joints: frozenset[str] = frozenset()
    # Names of joints whose type is unknown.
    untyped_joints: frozenset[str] = frozenset()
    has_unknown_name: bool = False  # whether there are more joints, with unknown names


@dataclass(slots=True)
class _JointEntry:
    """A joint to build: a file's entry or its mirror image."""

    index: int
    source_name: str
    parent: str | None
    is_mirrored: bool = False
    is_orphaned: bool = False


@dataclass(slots=True)
class _JointTree:
    """Joints built so far, parents first; computes world transforms on demand."""

    joints: list[Joint] = field(default_factory=list)
    index_by_name: dict[str, int] = field(default_factory=dict)
    world_transforms: list[PoseArrays] = field(default_factory=list)

    def world_at_rest(self, joint: int) -> PoseArrays:
        """Return a joint's world transform at rest; identity for -1."""
        if joint < 0:
            return ORIGIN
        for next_joint in self.joints[len(self.world_transforms) : joint + 1]:
            parent = (
                self.world_transforms[next_joint.parent]
                if next_joint.parent >= 0
                else ORIGIN
            )
            self.world_transforms.append(
                world_transform_below(parent, next_joint.rest_pose)
            )
        return self.world_transforms[joint]


def read_joints(
    document: Document, models: list[JointModel], units: FileUnits
) -> FileJoints:
    """Return the joints of a file, parents before children; record faults."""
    has_unknown_name = document.has_unknown_name("joints", "name", "mirror")
    entry_by_name = _joint_entries(document, models, has_unknown_name=has_unknown_name)
    tree = _JointTree()
    for name in _in_dependency_order(document, entry_by_name):
        entry = entry_by_name[name]
        parent = (
            -1 if entry.parent is None else tree.index_by_name.get(entry.parent, -1)
        )
        if entry.is_mirrored:
            source = tree.index_by_name[entry.source_name]
            parent_world = tree.world_at_rest(parent)
            joint = mirror_joint(
                tree.joints[source], tree.world_at_rest(source), parent, parent_world
            )
            if parent >= 0 and tree.joints[source].parent == parent:
                _warn_of_off_centre_parent(
                    document, entry, joint, parent_world, tree.joints
                )
        else:
            joint = _read_joint(
                document, entry.index, models[entry.index], units, parent
            )
        tree.index_by_name[name] = len(tree.joints)
        tree.joints.append(joint)
    file_joints = FileJoints(
        tuple(tree.joints),
        frozenset(name for name, entry in entry_by_name.items() if entry.is_orphaned),
        frozenset(name for name, entry in entry_by_name.items() if entry.is_mirrored),
        frozenset(
            name
            for name, entry in entry_by_name.items()
            if document.is_placeholder(("joints", entry.index, "type"))
        ),
        has_unknown_name,
    )
    file_joints = _with_mimics(document, models, entry_by_name, file_joints, units)
    return _with_drivers(document, models, entry_by_name, file_joints, units)


def _joint_entries(
    document: Document, models: list[JointModel], *, has_unknown_name: bool
) -> dict[str, _JointEntry]:
    """Return the joints to build by name; record duplicates and unknown parents."""
    entry_by_name: dict[str, _JointEntry] = {}
    partner_by_name = {m.name: m.mirror for m in models if m.mirror is not None}
    partner_by_name |= {mirror: name for name, mirror in partner_by_name.items()}
    for i, model in enumerate(models):
        if model.name in entry_by_name:
            message = f"duplicate joint {model.name!r}"
            first_line = document.position(("joints", entry_by_name[model.name].index))[
                0
            ]
            hint = f"the first is on line {first_line}: rename one"
            document.add("RIG001", ("joints", i, "name"), message, hint)
            continue
        entry_by_name[model.name] = _JointEntry(i, model.name, model.parent)
    _warn_of_spaces(document, entry_by_name)
    for i, model in enumerate(models):
        if model.mirror is None or entry_by_name[model.name].index != i:
            continue
        if model.mirror == model.name:
            message = f"{model.name!r} mirrors itself"
            hint = "mirror names the joint on the other side"
        elif model.mirror in entry_by_name:
            message = f"mirror {model.mirror!r} is already a joint"
            hint = "mirror creates that joint; remove the other"
        else:
            parent = model.parent
            parent = partner_by_name.get(parent, parent) if parent is not None else None
            entry_by_name[model.mirror] = _JointEntry(
                i, model.name, parent, is_mirrored=True
            )
            continue
        document.add("RIG010", ("joints", i, "mirror"), message, hint)
    for entry in list(entry_by_name.values()):
        if entry.parent is not None and entry.parent not in entry_by_name:
            message = f"unknown parent {entry.parent!r}"
            location = ("joints", entry.index, "parent")
            if not entry.is_mirrored and not has_unknown_name:
                hint = name_hint(entry.parent, list(entry_by_name))
                document.add("RIG002", location, message, hint)
            entry.parent, entry.is_orphaned = None, True
    return entry_by_name


def _warn_of_spaces(
    document: Document, entry_by_name: Mapping[str, _JointEntry]
) -> None:
    """Warn once of all joint names that contain white space (RIG109)."""
    spaced_names = [name for name in entry_by_name if any(map(str.isspace, name))]
    if not spaced_names:
        return
    first_name = spaced_names[0]
    message = (
        f"{len(spaced_names)} of {counted(len(entry_by_name), 'joint name')} "
        f"{'contains' if len(spaced_names) == 1 else 'contain'} a space: {first_name!r}"
    )
    hint = (
        f"write {'_'.join(first_name.split())!r}: USD and expressions allow no spaces"
    )
    location = ("joints", entry_by_name[first_name].index, "name")
    document.warn("RIG109", location, message, hint)


def _in_dependency_order(
    document: Document, entry_by_name: dict[str, _JointEntry]
) -> Iterator[str]:
    """Yield joint names in file order, but parents and mirror sources first."""
    yielded_names: set[str] = set()
    for start_name in entry_by_name:
        # An ordered set.
        pending_names = {start_name: None}
        while pending_names:
            name = next(reversed(pending_names))
            entry = entry_by_name[name]
            mirror_source = entry.source_name if entry.is_mirrored else None
            required_names = (entry.parent, mirror_source)
            required_name = next(
                (n for n in required_names if n and n not in yielded_names), None
            )
            if name in yielded_names or required_name is None:
                del pending_names[name]
                if name not in yielded_names:
                    yielded_names.add(name)
                    yield name
                continue
            if required_name in pending_names:
                unfinished_names = list(pending_names)
                cycle_start = unfinished_names.index(required_name)
                ancestors = [required_name, *unfinished_names[cycle_start:][::-1]]
                message = f"the joints are their own ancestors: {cycle_text(ancestors)}"
                hint = "remove the parent of the one that is the root"
                document.add("RIG003", ("joints", entry.index), message, hint)
                entry.parent, entry.is_orphaned = None, True
                if entry.is_mirrored and required_name == entry.source_name:
                    del pending_names[name]
                    yielded_names.add(name)
                continue
            pending_names[required_name] = None


def _warn_of_off_centre_parent(
    document: Document,
    entry: _JointEntry,
    joint: Joint,
    parent_world: PoseArrays,
    joints: list[Joint],
) -> None:
    """Warn of a mirrored pair whose parent is off the middle plane."""
    distance = float(parent_world[0][0])
    if abs(distance) <= MIDDLE_TOLERANCE:
        return
    parent = joints[joint.parent].name
    message = (
        f"{joint.name!r} mirrors {entry.source_name!r} in the world's plane x = 0, but "
        f"their parent {parent!r} is {length_text(abs(distance), 4)} off that plane"
    )
    hint = f"give {parent!r} a mirror, or write both joints without one"
    document.note("RIG101", ("joints", entry.index, "mirror"), message, hint)


def _read_joint(
    document: Document, i: int, model: JointModel, units: FileUnits, parent: int
) -> Joint:
    """Build the joint of an entry, and record faults of its numbers."""
    location: Location = ("joints", i)
    rotation = unit_quaternion(document, (*location, "rotate"), model.rotate)
    tips = tuple(scale_vector(tip, units.length) for tip in model.tips)
    _check_repeated_channels(document, (*location, "channels"), model.channels or [])
    joint = Joint(
        model.name,
        parent,
        JointType(model.type),
        scale_vector(model.translate, units.length),
        rotation,
        channels=None if model.channels is None else tuple(model.channels),
        tips=tips,
        mirror=model.mirror or "",
    )
    if isinstance(model, PinJointModel | PrismaticJointModel):
        axis = unit_vector(document, (*location, "axis"), model.axis)
        limits = _range_limit(
            document, (*location, "limits"), model.limits, units.unit_of(joint.type)
        )
        joint = replace(joint, axis=axis, limits=limits)
    elif isinstance(model, BallJointModel) and model.limits is not None:
        limit = _ball_limit(document, (*location, "limits"), model.limits, units)
        joint = replace(joint, limits=limit)
    return joint


def _check_repeated_channels(
    document: Document, location: Location, channels: Sequence[str]
) -> None:
    """Record BVH channels that are listed twice."""
    for k, name in enumerate(channels):
        if name in channels[:k]:
            message = f"duplicate channel {name!r}"
            document.add("RIG028", (*location, k), message, "write each once")


def scale_vector(values: Sequence[float], unit: float) -> Vector:
    """Convert three numbers to metres by the file's length unit."""
    x, y, z = (value * unit for value in values)
    return (x, y, z)


def _range_limit(
    document: Document, location: Location, range_pair: list[float] | None, unit: float
) -> RangeLimit | None:
    """Return a range in metres or radians; record a fault if it is reversed."""
    if range_pair is None:
        return None
    lower, upper = range_pair
    if lower > upper:
        message = f"the range from {lower:g} to {upper:g} is reversed"
        document.add("RIG007", location, message, f"write [{upper:g}, {lower:g}]")
    return RangeLimit(lower * unit, upper * unit)


def _ball_limit(
    document: Document, location: Location, model: BallLimitsModel, units: FileUnits
) -> BallLimit:
    """Return the limits of a ball joint; record faults of its angles."""
    swing = None
    if model.swing is not None:
        angles = model.swing if isinstance(model.swing, list) else [model.swing] * 2
        if not all(0 <= angle * units.angle <= math.pi for angle in angles):
            max_swing = "π rad" if units.angle == 1 else "180°"
            message = f"swing {model.swing} is not between 0 and {max_swing}"
            document.add("RIG007", (*location, "swing"), message)
        swing = (angles[0] * units.angle, angles[1] * units.angle)
    twist = None
    if model.twist == "locked":
        twist = (0.0, 0.0)
    elif isinstance(model.twist, list):
        limit = _range_limit(document, (*location, "twist"), model.twist, units.angle)
        twist = None if limit is None else (limit.low, limit.high)
    axis = unit_vector(document, (*location, "twist_axis"), model.twist_axis)
    return BallLimit(swing, twist, axis)


def _with_drivers(
    document: Document,
    models: list[JointModel],
    entry_by_name: dict[str, _JointEntry],
    file_joints: FileJoints,
    units: FileUnits,
) -> FileJoints:
    """Return the joints with their drivers; inputs are checked later."""
    joint_by_name = {joint.name: joint for joint in file_joints.joints}
    file_units = (units.length, units.angle)
    mirror_by_name = {
        joint.name: joint.mirror for joint in file_joints.joints if joint.mirror
    }
    for i, model in enumerate(models):
        if not isinstance(model, PinJointModel | PrismaticJointModel):
            continue
        if model.driven is None or entry_by_name[model.name].index != i:
            continue
        unit = units.unit_of(JointType(model.type))
        driver = read_driver(
            document, ("joints", i, "driven"), model.driven, file_units, unit
        )
        for name in (model.name, model.mirror):
            if (
                driver is None
                or name not in joint_by_name
                or entry_by_name[name].index != i
            ):
                continue
            joint_driver = (
                driver.mirrored(mirror_by_name)
                if entry_by_name[name].is_mirrored
                else driver
            )
            joint_by_name[name] = replace(joint_by_name[name], driven=joint_driver)
    return replace(file_joints, joints=tuple(joint_by_name.values()))


def _with_mimics(
    document: Document,
    models: list[JointModel],
    entry_by_name: dict[str, _JointEntry],
    file_joints: FileJoints,
    units: FileUnits,
) -> FileJoints:
    """Return the joints with their mimics, whose leaders must exist."""
    joints_with_mimics = list(file_joints.joints)
    indices_by_name = {joint.name: i for i, joint in enumerate(joints_with_mimics)}
    scalar_types = (JointType.PIN, JointType.PRISMATIC)
    for name, entry in entry_by_name.items():
        model = models[entry.index]
        if not isinstance(model, PinJointModel | PrismaticJointModel) or not (
            model.mimic and name in indices_by_name
        ):
            continue
        mimic, location = model.mimic, ("joints", entry.index, "mimic", "joint")
        leader = indices_by_name.get(mimic.joint)
        if leader is None:
            message = f"unknown joint {mimic.joint!r}"
            if not file_joints.has_unknown_name:
                hint = name_hint(mimic.joint, list(indices_by_name))
                document.add("RIG008", location, message, hint)
            continue
        if mimic.joint in file_joints.untyped_joints:
            continue
        if joints_with_mimics[leader].type not in scalar_types:
            message = f"{mimic.joint!r} is a {joints_with_mimics[leader].type} joint"
            hint = "a mimic follows a pin or prismatic"
            document.add("RIG009", location, message, hint)
            continue
        leader_name = mimic.joint
        if entry.is_mirrored:
            leader_name = joints_with_mimics[leader].mirror or leader_name
        unit = units.unit_of(JointType(model.type))
        gain = mimic.gain * unit / units.unit_of(joints_with_mimics[leader].type)
        joint_mimic = Mimic(leader_name, gain, mimic.offset * unit)
        i = indices_by_name[name]
        joints_with_mimics[i] = replace(joints_with_mimics[i], mimic=joint_mimic)
    _check_mimic_chains(document, entry_by_name, joints_with_mimics)
    return replace(file_joints, joints=tuple(joints_with_mimics))


def _check_mimic_chains(
    document: Document, entry_by_name: dict[str, _JointEntry], joints: list[Joint]
) -> None:
    """Record a fault for a mimic of a mimic, and thereby for cycles."""
    mimic_names = {joint.name for joint in joints if joint.mimic}
    reported_names: set[str] = set()
    for joint in joints:
        if joint.mimic and joint.mimic.joint in mimic_names:
            entry = entry_by_name[joint.name]
            if not entry.is_mirrored:
                message = f"{joint.mimic.joint!r} is a mimic itself"
                hint = "name the joint that is keyed"
                cycle = _mimic_cycle(joints, joint.name)
                if joint.mimic.joint == joint.name:
                    message = f"{joint.name!r} follows itself"
                elif cycle:
                    if cycle & reported_names:
                        continue
                    reported_names |= cycle
                    message = f"{listed(sorted(cycle))} mimic each other"
                    hint = "remove one mimic: that joint is keyed then"
                location = ("joints", entry.index, "mimic", "joint")
                document.add("RIG009", location, message, hint)


def _mimic_cycle(joints: Sequence[Joint], name: str) -> set[str]:
    """Return the joints that mimic each other in a cycle with one; else none."""
    sources = {joint.name: joint.mimic.joint for joint in joints if joint.mimic}
    cycle = {name}
    source = sources.get(name)
    while source is not None and source not in cycle:
        cycle.add(source)
        source = sources.get(source)
    return cycle if source == name else set()


def unit_quaternion(
    document: Document, location: Location, wxyz: list[float]
) -> tuple[float, float, float, float]:
    """Convert a file's [w, x, y, z] to a unit quaternion (x, y, z, w)."""
    w, x, y, z = wxyz
    length = math.hypot(*wxyz)
    if abs(length - 1.0) <= UNIT_TOLERANCE:
        return (x, y, z, w)
    if not MIN_VECTOR_LENGTH < length < 1 / MIN_VECTOR_LENGTH:
        document.add("RIG006", location, f"quaternion {wxyz} is not a rotation")
        return (0.0, 0.0, 0.0, 1.0)
    warn_of_quaternion_length(document, location, wxyz)
    a, b, c, d = so3.normalize([x, y, z, w]).tolist()
    return (a, b, c, d)


def unit_vector(document: Document, location: Location, values: list[float]) -> Vector:
    """Normalize a direction; record a fault for zero length."""
    length = math.hypot(*values)
    if abs(length - 1.0) <= UNIT_TOLERANCE:
        length = 1.0
    if not MIN_VECTOR_LENGTH < length < 1 / MIN_VECTOR_LENGTH:
        message, hint = "an axis of zeros has no direction", "for example [1, 0, 0]"
        document.add("RIG005", location, message, hint)
        return (0.0, 0.0, 1.0)
    x, y, z = (value / length for value in values)
    return (x, y, z)
