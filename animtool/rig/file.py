"""Reads rig files, ``*.rig.yaml``, and their bind poses."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from animtool.core.config import project_roots
from animtool.core.errors import AnimtoolError
from animtool.core.names import name_hint
from animtool.core.readers import RIG_AND_CLIP_FILES, find_reader
from animtool.core.units import LengthUnit, UpAxis
from animtool.documents.arrays import Archives
from animtool.documents.check import validate_file
from animtool.documents.document import Document, Location, read_document
from animtool.documents.references import resolve_reference
from animtool.rig.array_entries import ArrayReader
from animtool.rig.driver_entries import DriverCheck
from animtool.rig.joint_entries import (
    FileJoints,
    FileUnits,
    read_joints,
    scale_vector,
    unit_quaternion,
)
from animtool.rig.joint_schema import PoseModel
from animtool.rig.part_entries import PartReader
from animtool.rig.parts import Mass, Shape, inertia_problem
from animtool.rig.schema import MassModel, RigModel
from animtool.rig.sides import ORIGIN, PoseArrays, mirror_pose, world_transform_below
from animtool.rig.skeleton import Joint, Pose, Rig
from animtool.rig.suspicions import warn_of_angles, warn_of_drives, warn_of_w_last
from animtool.rig.suspicious_parts import warn_of_parts
from animtool.rig.suspicious_shape import warn_of_shape


def read_bind_poses(
    document: Document,
    model_by_joint: Mapping[str, PoseModel],
    file_joints: FileJoints,
    units: FileUnits,
    inherited_pose_by_joint: Mapping[str, Pose],
) -> dict[str, Pose]:
    """Return the bind poses that differ from the rest pose, and record faults.

    A mirrored joint takes the reflection of its partner's bind pose, unless the file
    states a bind pose for it.
    """
    joint_by_name = {joint.name: joint for joint in file_joints.joints}
    pose_by_joint = dict(inherited_pose_by_joint)
    for name, model in model_by_joint.items():
        if name not in joint_by_name:
            message = f"unknown joint {name!r}"
            if not file_joints.has_unknown_name:
                hint = name_hint(name, list(joint_by_name))
                document.add("RIG008", ("bind", name), message, hint)
            continue
        pose_by_joint[name] = _read_pose(
            document, name, model, joint_by_name[name], units
        )
    pose_by_joint |= _mirrored_poses(file_joints, pose_by_joint, set(model_by_joint))
    return {
        name: pose
        for name, pose in pose_by_joint.items()
        if (name in inherited_pose_by_joint and name not in model_by_joint)
        or pose != joint_by_name[name].rest_pose
    }


def _read_pose(
    document: Document,
    joint_name: str,
    model: PoseModel,
    rest_joint: Joint,
    units: FileUnits,
) -> Pose:
    """Return a bind pose; values that the file omits are taken from the rest pose."""
    translation, rotation = rest_joint.translation, rest_joint.rotation
    if model.translate is not None:
        translation = scale_vector(model.translate, units.length)
    if model.rotate is not None:
        rotation = unit_quaternion(
            document, ("bind", joint_name, "rotate"), model.rotate
        )
    stretch = None if model.stretch is None else tuple(model.stretch)
    return Pose(translation, rotation, stretch)


def _mirrored_poses(
    file_joints: FileJoints,
    bind_pose_by_joint: Mapping[str, Pose],
    explicit_names: set[str],
) -> dict[str, Pose]:
    """Return the bind poses of mirrored joints, parents before children."""
    pose_by_joint: dict[str, Pose] = {}
    if not file_joints.mirrored_joints - explicit_names or not bind_pose_by_joint:
        return pose_by_joint
    world_transforms: list[PoseArrays] = []
    index_by_name = {joint.name: i for i, joint in enumerate(file_joints.joints)}
    for joint in file_joints.joints:
        parent = world_transforms[joint.parent] if joint.parent >= 0 else ORIGIN
        if (
            joint.name in file_joints.mirrored_joints
            and joint.name not in explicit_names
            and joint.mirror in explicit_names
        ):
            partner_pose = bind_pose_by_joint[joint.mirror]
            pose_by_joint[joint.name] = mirror_pose(
                partner_pose, world_transforms[index_by_name[joint.mirror]], parent
            )
        pose = (
            pose_by_joint.get(joint.name)
            or bind_pose_by_joint.get(joint.name)
            or joint.rest_pose
        )
        world_transforms.append(world_transform_below(parent, pose))
    return pose_by_joint


# Limit of nested sidecars.
MAX_SIDECAR_DEPTH = 8


def load_rig(path: Path | str, parents: tuple[Path, ...] = ()) -> Rig:
    """Load a rig file, and the file that its ``from`` names."""
    return parse_rig(read_document(Path(path), "rig"), parents)


def parse_rig(document: Document, parents: tuple[Path, ...] = ()) -> Rig:
    """Return the rig of a document; see `load_rig`."""
    model = validate_file(document, "rig", RigModel)
    reference_roots = project_roots(document.path)
    units = FileUnits(
        LengthUnit(model.units.length).meters,
        math.radians(1.0) if model.units.angle == "deg" else 1.0,
    )
    base_rig = None
    if model.source is None:
        file_joints = read_joints(document, model.joints, units)
    else:
        base_rig = _load_base(document, model.source, reference_roots, parents)
        file_joints = (
            _joints_without_base(document, model, units)
            if base_rig is None
            else _overlay_joints(document, model, base_rig, units)
        )
    inherited_rig = Rig("", ()) if base_rig is None else base_rig
    if not (
        file_joints.joints
        or file_joints.has_unknown_name
        or model.shapes
        or inherited_rig.shapes
    ):
        message = "the rig has no joints and no shapes"
        document.add("RIG004", ("joints",), message)
    with Archives() as archives:
        array_reader = ArrayReader(document, reference_roots, archives)
        part_reader = PartReader(document, model, units, file_joints, array_reader)
        meshes = part_reader.read_meshes() or inherited_rig.meshes
        shapes = part_reader.read_shapes(
            [mesh.name for mesh in meshes],
            [shape.name for shape in inherited_rig.shapes],
        )
        bind = read_bind_poses(
            document, model.bind, file_joints, units, inherited_rig.bind
        )
        shapes = _merge_shapes(inherited_rig.shapes, shapes)
        controls = part_reader.read_controls(
            [shape.name for shape in shapes], inherited_rig.controls
        )
        chains = part_reader.read_chains(inherited_rig.chains)
        colliders = part_reader.read_colliders(inherited_rig.colliders)
        masses = _read_masses(
            document,
            model.masses,
            inherited_rig.masses,
            units.length,
            part_reader.check_joint,
        )
        attachments = part_reader.read_attachments(meshes, inherited_rig.attach)
    warn_of_angles(document, model.joints, model.units.angle)
    warn_of_w_last(document, model.joints)
    rig = Rig(
        model.name,
        file_joints.joints,
        units.length if base_rig is None else base_rig.meters_per_unit,
        UpAxis(model.up) if base_rig is None else base_rig.up,
        bind,
        meshes,
        shapes,
        controls,
        chains,
        attachments,
        colliders,
        units.angle,
        masses,
        (*inherited_rig.notices, *document.notices),
        placement=inherited_rig.placement,
        has_animated_parents=inherited_rig.has_animated_parents,
    )
    if rig.is_driven:
        has_unknown_name = {
            "joints": file_joints.has_unknown_name or bool(file_joints.orphaned_joints),
            "controls": bool(document.has_unknown_name("controls")),
        }
        DriverCheck(
            document, model, rig, has_unknown_name, file_joints.untyped_joints
        ).check()
    document.check()
    notice_count = len(document.notices)
    warn_of_shape(document, rig)
    warn_of_drives(document, rig)
    warn_of_parts(document, model, rig)
    return replace(rig, notices=(*rig.notices, *document.notices[notice_count:]))


def _read_masses(
    document: Document,
    entries: Sequence[MassModel],
    inherited_masses: Sequence[Mass],
    length_unit: float,
    check_joint: Callable[[Location, str], bool],
) -> tuple[Mass, ...]:
    """Return the masses of a file and of its base rig, and record faults.

    Args:
        document: Rig file.
        entries: Mass entries of the file.
        inherited_masses: Masses of the base rig.
        length_unit: Length unit [m].
        check_joint: Returns whether a joint exists, and records a fault otherwise.
    """
    listed_joints = {entry.joint for entry in entries}
    masses = [mass for mass in inherited_masses if mass.joint not in listed_joints]
    first_index_by_joint: dict[str, int] = {}
    for i, entry in enumerate(entries):
        location = ("masses", i)
        check_joint((*location, "joint"), entry.joint)
        if entry.joint in first_index_by_joint:
            line = document.position(("masses", first_index_by_joint[entry.joint]))[0]
            message = f"joint {entry.joint!r} has a mass twice"
            document.add(
                "RIG011", (*location, "joint"), message, f"first in line {line}"
            )
            continue
        first_index_by_joint[entry.joint] = i
        inertia = None
        if entry.inertia is not None:
            a, b, c = inertia = (entry.inertia[0], entry.inertia[1], entry.inertia[2])
            if problem := inertia_problem([a, b, c]):
                message = f"no body has such an inertia: {problem}"
                document.add("RIG047", (*location, "inertia"), message)
        axes = unit_quaternion(document, (*location, "axes"), entry.axes)
        centre = scale_vector(entry.centre, length_unit)
        masses.append(Mass(entry.joint, entry.mass, centre, inertia, axes))
    return tuple(masses)


def _merge_shapes(
    inherited_shapes: tuple[Shape, ...], new_shapes: tuple[Shape, ...]
) -> tuple[Shape, ...]:
    """Return inherited and new shapes; an entry of only a driver changes its shape."""
    inherited_names = {shape.name for shape in inherited_shapes}
    driver_by_shape = {
        shape.name: shape.driven
        for shape in new_shapes
        if shape.name in inherited_names
        and shape == Shape(shape.name, driven=shape.driven)
    }
    return (
        *(
            replace(shape, driven=driver_by_shape.get(shape.name) or shape.driven)
            for shape in inherited_shapes
        ),
        *(shape for shape in new_shapes if shape.name not in driver_by_shape),
    )


def _load_base(
    document: Document,
    base_reference: str,
    reference_roots: tuple[Path, ...],
    parents: tuple[Path, ...],
) -> Rig | None:
    """Load the base rig of a sidecar."""
    base_path = resolve_reference(document, ("from",), base_reference, reference_roots)
    if base_path is None:
        return None
    parents = (*parents, document.path.resolve())
    if base_path in parents:
        document.add(
            "RIG030", ("from",), f"{base_reference!r} refers back to this file"
        )
        return None
    if len(parents) >= MAX_SIDECAR_DEPTH:
        message = f"more than {MAX_SIDECAR_DEPTH} files refer to each other in a chain"
        document.add("RIG030", ("from",), message)
        return None
    try:
        if find_reader(base_path) is RIG_AND_CLIP_FILES:
            return load_rig(base_path, parents)
        return Rig.load(base_path)
    except AnimtoolError as error:
        for fault in error.faults:
            document.add("RIG023", ("from",), str(fault))
        return None


def _sidecar_roots(document: Document, model: RigModel, units: FileUnits) -> FileJoints:
    """Return the joints of a sidecar, which has no hierarchy, as roots."""
    cleared_keys = {"mirror": None, "parent": None}
    root_entries = [entry.model_copy(update=cleared_keys) for entry in model.joints]
    return read_joints(document, root_entries, units)


def _joints_without_base(
    document: Document, model: RigModel, units: FileUnits
) -> FileJoints:
    """Return a sidecar's joints, marked as incomplete, if its base cannot be read."""
    document.partial_lists |= {"joints", "meshes", "shapes", "controls"}
    joints = _sidecar_roots(document, model, units)
    return replace(
        joints, orphaned_joints=frozenset(joint.name for joint in joints.joints)
    )


def _overlay_joints(
    document: Document, model: RigModel, inherited_rig: Rig, units: FileUnits
) -> FileJoints:
    """Apply the joint types and limits of a sidecar to the joints of its base."""
    rig_name_by_source_name = {
        joint.source_name or joint.name: joint.name for joint in inherited_rig.joints
    }
    rig_name_by_source_name |= {
        joint.name: joint.name for joint in inherited_rig.joints
    }
    for i, entry in enumerate(model.joints):
        for key in ("name", "mirror"):
            named_joint = getattr(entry, key)
            if named_joint is not None and named_joint not in rig_name_by_source_name:
                message = f"unknown joint {named_joint!r} of {model.source}"
                hint = name_hint(named_joint, list(rig_name_by_source_name))
                document.add("RIG008", ("joints", i, key), message, hint)
        for key in ("parent", "translate", "rotate", "tips", "channels"):
            if key in entry.model_fields_set:
                message = f"{key} is defined by {model.source}"
                document.add("RIG023", ("joints", i, key), message, "remove it")
    sidecar_roots = _sidecar_roots(document, model, units)
    sidecar_joint_by_name = {
        rig_name_by_source_name.get(joint.name, joint.name): joint
        for joint in sidecar_roots.joints
    }
    mirror_by_name = {
        rig_name_by_source_name.get(
            entry.name, entry.name
        ): rig_name_by_source_name.get(entry.mirror or "", "")
        for entry in model.joints
    }
    overlaid_joints = []
    for joint in inherited_rig.joints:
        entry_joint = sidecar_joint_by_name.get(joint.name)
        if entry_joint is None:
            overlaid_joints.append(joint)
            continue
        driver, mimic = entry_joint.driven, entry_joint.mimic
        if mimic is not None:
            mimic = replace(
                mimic, joint=rig_name_by_source_name.get(mimic.joint, mimic.joint)
            )
        overlaid_joint = replace(
            joint,
            type=entry_joint.type,
            axis=entry_joint.axis,
            limits=entry_joint.limits,
            mimic=mimic,
            mirror=mirror_by_name[joint.name],
            driven=joint.driven
            if driver is None
            else driver.with_renamed_joints(rig_name_by_source_name),
        )
        overlaid_joints.append(overlaid_joint)
    untyped_names = frozenset(
        rig_name_by_source_name.get(name, name) for name in sidecar_roots.untyped_joints
    )
    return FileJoints(
        tuple(overlaid_joints),
        untyped_joints=untyped_names,
        has_unknown_name=sidecar_roots.has_unknown_name,
    )
