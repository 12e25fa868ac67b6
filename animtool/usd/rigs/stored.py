"""Merges rig data stored in customData with the current USD content."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from animtool.core.array_types import FloatArray
from animtool.core.errors import Fault, FormatError, Severity, listed
from animtool.core.quantities import length_text
from animtool.documents.document import parse_document
from animtool.maths import so3
from animtool.rig.controls import Control
from animtool.rig.drivers import Driver, split_coordinate
from animtool.rig.file import parse_rig
from animtool.rig.kinematics import rest_size
from animtool.rig.parts import AttachKind, Attachment, LoadedArray, Mesh, Shape
from animtool.rig.skeleton import Joint, Pose, Rig
from animtool.usd.layers.dependencies import unresolved_hint
from animtool.usd.layers.faults import PrimLocation, matrix_array
from animtool.usd.layers.sdf import usd_errors
from animtool.usd.layers.stderr import without_usd_warnings
from animtool.usd.rigs.mesh_read import read_meshes, read_strands
from animtool.usd.rigs.placement import (
    local_placement,
    rig_at_stage_placement,
    unsupported_notice,
)
from animtool.usd.rigs.prims import (
    MAX_REST_VALUE,
    SkeletonRig,
    check_animatable,
    composition_notices,
    decompose,
    find_skeletons,
    number_rows,
    open_stage,
    search_root,
    skeleton_rig,
    skipped_skeletons_notice,
    stored_data,
)
from animtool.usd.rigs.skeleton import skeleton_hash
from animtool.usd.rigs.skinned import unique_name


def merge_attachments(
    rig: Rig, strands: Mapping[str, Attachment], pins: Mapping[str, Any]
) -> tuple[tuple[Attachment, ...], list[str]]:
    """Return a rig's attachments with arrays from USD, and names of dropped entries.

    Strands that the rig does not know come last. Entries are dropped if their mesh,
    curves or pinned vertices no longer exist.
    """
    unknown_strands = dict(strands)
    vertex_counts = {mesh.name: len(mesh.points.load()) for mesh in rig.meshes}
    attachments: list[Attachment] = []
    dropped_names: list[str] = []
    for entry in rig.attach:
        if entry.kind == AttachKind.STRANDS and entry.name in unknown_strands:
            attachments.append(unknown_strands.pop(entry.name))
        elif entry.kind == AttachKind.CLOTH and _is_valid_cloth(
            entry, vertex_counts, pins
        ):
            pin_array = None
            if entry.name in pins:
                pin_array = LoadedArray(np.array(pins[entry.name], float))
            attachments.append(replace(entry, pins=pin_array))
        elif entry.kind in {AttachKind.STRANDS, AttachKind.CLOTH}:
            dropped_names.append(entry.name)
        else:
            attachments.append(entry)
    used_names = {entry.name for entry in attachments}
    attachments += [
        replace(entry, name=unique_name(entry.name, used_names))
        for entry in unknown_strands.values()
    ]
    return tuple(attachments), dropped_names


def _is_valid_cloth(
    entry: Attachment, vertex_counts: dict[str, int], pins: Mapping[str, Any]
) -> bool:
    """Return whether a cloth's mesh exists and its pins are valid vertices."""
    indices = np.array(pins.get(entry.name, ()))
    vertex_count = vertex_counts.get(entry.mesh, 0)
    is_integral = indices.ndim == 1 and (not len(indices) or indices.dtype.kind in "iu")
    return bool(
        vertex_count
        and is_integral
        and ((indices >= 0) & (indices < vertex_count)).all()
    )


# Rest transforms closer than this [m], [1] differ only by rounding.
REST_TOLERANCE = 1e-9
# Difference of sizes below which they are the same in float32 [1].
UNIT_TOLERANCE = 1e-3


def merge_rig(
    usd_rig: Rig, skeleton: Any, tokens: list[str], path: Path
) -> tuple[Rig, list[Fault]]:
    """Merge a rig read from a Skeleton with the rig stored in its customData.

    If the Skeleton is unchanged since it was written, joints equal those of the stored
    rig. Otherwise USD's hierarchy, rest and bind replace them, and references to
    removed joints are dropped with a warning (USD117). Cloth and strands get their
    arrays in `merge_usd_attachments`.
    """
    custom_data = stored_data(skeleton.GetPrim())
    text = custom_data.get("rig")
    if not text:
        return usd_rig, []
    document = parse_document(str(text), path)
    # The referenced arrays are stored in USD.
    document.partial_lists |= {"meshes", "attach"}
    try:
        stored_rig = parse_rig(document)
    except FormatError as error:
        reason = error.faults[0].message
        message = f"customData animtool:rig is malformed: {reason}"
        raise FormatError(Fault("USD007", message, str(path))) from error
    shapes = _merge_shapes(stored_rig, usd_rig)
    merged_rig = replace(
        stored_rig,
        meshes=usd_rig.meshes,
        shapes=shapes,
        meters_per_unit=usd_rig.meters_per_unit,
    )
    notices: list[Fault] = []
    resized_notice = _resized_notice(stored_rig, usd_rig, path)
    rest = matrix_array(skeleton.GetRestTransformsAttr())
    bind = matrix_array(skeleton.GetBindTransformsAttr())
    if custom_data.get("hash") != skeleton_hash(tokens, rest, bind):
        merged_rig, notices = _merge_skeleton(merged_rig, usd_rig, str(path))
    elif resized_notice is not None:
        # The numbers are the same, and only their unit is another.
        merged_rig, _ = _merge_skeleton(merged_rig, usd_rig, str(path))
        notices = [resized_notice]
    merged_name_by_usd_name = dict(zip(usd_rig.names, merged_rig.names, strict=True))
    meshes = tuple(
        _rename_skin_joints(mesh, merged_name_by_usd_name) for mesh in merged_rig.meshes
    )
    return replace(merged_rig, meshes=meshes), notices


def _resized_notice(stored_rig: Rig, usd_rig: Rig, path: Path) -> Fault | None:
    """Return a warning if the stage's unit is not the one the rig was written in."""
    stored_size, size = rest_size(stored_rig), rest_size(usd_rig)
    if not min(stored_size, size) > 0 or abs(size / stored_size - 1) < UNIT_TOLERANCE:
        return None
    unit = usd_rig.meters_per_unit
    message = (
        f"metersPerUnit is {unit:g}, but the Skeleton was written with "
        f"{unit * stored_size / size:.4g}: it measures {length_text(size)} instead of "
        f"{length_text(stored_size)}"
    )
    hint = (
        f"set metersPerUnit = {unit * stored_size / size:.4g}, or convert the rig "
        "again if it is meant to have another size"
    )
    return Fault("USD126", message, str(path), (), hint, Severity.WARNING)


def merge_usd_attachments(
    merged_rig: Rig, usd_rig: Rig, custom_data: dict[str, Any], path: Path
) -> tuple[Rig, list[Fault]]:
    """Return a merged rig whose cloth and strands have their USD arrays.

    Attachments with a missing or invalid mesh or curves are dropped and reported
    (USD119).
    """
    if not custom_data.get("rig"):
        return merged_rig, []
    merged_name_by_usd_name = dict(zip(usd_rig.names, merged_rig.names, strict=True))
    strands = {
        entry.name: replace(
            entry, joints=tuple(merged_name_by_usd_name[name] for name in entry.joints)
        )
        for entry in usd_rig.attach
    }
    attach, dropped_names = merge_attachments(
        merged_rig, strands, custom_data.get("pins", {})
    )
    rig = replace(merged_rig, attach=attach)
    if not dropped_names:
        return rig, []
    message = (
        "attachments whose mesh or curves were removed or edited: "
        f"{listed(dropped_names)}"
    )
    return rig, [Fault("USD119", message, str(path), severity=Severity.WARNING)]


def _rename_skin_joints(mesh: Mesh, new_names: dict[str, str]) -> Mesh:
    """Return a mesh whose skin uses the rig's joint names."""
    if mesh.skin is None:
        return mesh
    joints = tuple(new_names[name] for name in mesh.skin.joints)
    return replace(mesh, skin=replace(mesh.skin, joints=joints))


def _merge_shapes(stored_rig: Rig, usd_rig: Rig) -> tuple[Shape, ...]:
    """Return shapes in stored order, with USD's arrays."""
    usd_shapes = {shape.name: shape for shape in usd_rig.shapes}
    stored_names = {shape.name for shape in stored_rig.shapes}
    return (
        *(
            replace(usd_shapes[shape.name], combine=shape.combine, driven=shape.driven)
            if shape.name in usd_shapes
            else shape
            for shape in stored_rig.shapes
        ),
        *(shape for shape in usd_rig.shapes if shape.name not in stored_names),
    )


def _merge_skeleton(
    stored_rig: Rig, usd_rig: Rig, file_path: str
) -> tuple[Rig, list[Fault]]:
    stored_joints = {joint.name: joint for joint in stored_rig.joints}
    parent_names = {
        joint.name: stored_rig.joints[joint.parent].name if joint.parent >= 0 else ""
        for joint in stored_rig.joints
    }
    joints: list[Joint] = []
    changed_names: list[str] = []
    for joint in usd_rig.joints:
        stored_joint = stored_joints.get(joint.source_name or joint.name)
        parent = joints[joint.parent].name if joint.parent >= 0 else ""
        if stored_joint is None:
            changed_names.append(joint.name)
            joints.append(joint)
        elif parent_names[stored_joint.name] == parent and _has_equal_rest(
            stored_joint, joint
        ):
            joints.append(replace(stored_joint, parent=joint.parent))
        else:
            changed_names.append(stored_joint.name)
            joints.append(
                replace(
                    stored_joint,
                    parent=joint.parent,
                    translation=joint.translation,
                    rotation=joint.rotation,
                )
            )
    removed_names = sorted(set(stored_joints) - {joint.name for joint in joints})
    if not changed_names and not removed_names and stored_rig.bind == usd_rig.bind:
        return stored_rig, []
    message = "the Skeleton was edited after it was written; using the edited one"
    if changed_names:
        message += f"; joints that differ: {listed(changed_names)}"
    if removed_names:
        message += f"; removed: {listed(removed_names)}"
    notice = Fault("USD117", message, file_path, severity=Severity.WARNING)
    return _remove_joints(
        replace(stored_rig, joints=tuple(joints), bind=usd_rig.bind), removed_names
    ), [notice]


def _has_equal_rest(first: Joint, second: Joint) -> bool:
    offset = np.abs(np.subtract(first.translation, second.translation)).max()
    rotation_dot = abs(float(np.dot(first.rotation, second.rotation)))
    return bool(offset <= REST_TOLERANCE and rotation_dot >= 1 - REST_TOLERANCE)


def _remove_joints(rig: Rig, removed_names: list[str]) -> Rig:
    """Return a rig without references to removed joints."""
    names = set(removed_names)
    joints = tuple(
        replace(
            joint,
            mirror="" if joint.mirror in names else joint.mirror,
            mimic=None if joint.mimic and joint.mimic.joint in names else joint.mimic,
            driven=_remove_from_driver(joint.driven, names),
        )
        for joint in rig.joints
    )
    return replace(
        rig,
        joints=joints,
        shapes=tuple(
            replace(shape, driven=_remove_from_driver(shape.driven, names))
            for shape in rig.shapes
        ),
        controls=tuple(
            _remove_from_control(control, names) for control in rig.controls
        ),
        chains=tuple(
            chain for chain in rig.chains if not {chain.root, chain.tip} & names
        ),
        attach=tuple(entry for entry in rig.attach if not set(entry.joints) & names),
        colliders=tuple(
            collider for collider in rig.colliders if collider.joint not in names
        ),
        masses=tuple(mass for mass in rig.masses if mass.joint not in names),
    )


def _remove_from_control(control: Control, removed_names: set[str]) -> Control:
    drives = tuple(
        drive
        for drive in control.drives
        if not any(drive.target.startswith(f"joint/{name}.") for name in removed_names)
    )
    return replace(
        control,
        drives=drives,
        driven=_remove_from_driver(control.driven, removed_names),
    )


def _remove_from_driver(
    driver: Driver | None, removed_names: set[str]
) -> Driver | None:
    """Return a driver, or None if the driver reads a removed joint."""
    driver_names = () if driver is None else driver.names
    if removed_names & {split_coordinate(name)[0] for name in driver_names}:
        return None
    return driver


# Tolerance of a bind pose equal to rest, for rounding of other tools [rad], [1].
BIND_TOLERANCE = 1e-6
# Tolerance of a scale of 1, for rounding of other tools.
SCALE_TOLERANCE = 1e-4


def read_rig(path: Path) -> Rig:
    """Return the rig of a USD file; the rig contains the warnings about the file."""
    rig, notices = read_rig_with_data(path)
    return replace(rig, notices=tuple(notices))


def read_rig_with_data(
    path: Path, prim_path: str | None = None, placement_choice: str | None = None
) -> tuple[Rig, list[Fault]]:
    """Return the rig of the first Skeleton below a prim, by default the default prim.

    ``placement_choice`` is its placement, as in `animtool.usd.takes.read.read_usd`.

    The rig has bind pose, meshes, shapes, strands, and the customData that USD cannot
    express.
    """
    with usd_errors(path), without_usd_warnings():
        stage = open_stage(path)
        skeletons = find_skeletons(stage, search_root(stage, prim_path))
        if not skeletons:
            location = "" if prim_path is None else f" at {prim_path}"
            message = f"has no Skeleton{location}"
            hint = unresolved_hint(stage)
            raise FormatError(Fault("USD008", message, str(path), (), hint))
        usd_skeleton = skeleton_rig(skeletons[0], path, is_animated=False)
        skeleton = skeletons[0]
        meshes, shapes, notices = read_meshes(skeleton, usd_skeleton, str(path))
        prim_location = PrimLocation.from_prim(path, skeleton)
        check_animatable(len(usd_skeleton.rig.joints), len(shapes), prim_location)
        notices += usd_skeleton.notices
        notices += skipped_skeletons_notice(skeletons, str(path))
        notices += composition_notices(stage, str(path))
        bind, bind_scales = _bind_poses(skeleton, usd_skeleton)
        notices += _scale_notice(usd_skeleton, bind_scales, str(path))
        rig = replace(
            usd_skeleton.rig,
            bind=bind,
            meshes=meshes,
            shapes=shapes,
            attach=read_strands(skeleton, usd_skeleton, str(path)),
        )
        merged_rig, edit_notices = merge_rig(rig, skeleton, usd_skeleton.tokens, path)
        full_rig, dropped_notices = merge_usd_attachments(
            merged_rig, rig, stored_data(skeleton.GetPrim()), path
        )
        placement = local_placement(skeleton.GetPrim(), usd_skeleton.rig)
        notices += unsupported_notice(placement, prim_location)
        rig_at_rest = rig_at_stage_placement(full_rig, placement, placement_choice)
        return rig_at_rest, notices + edit_notices + dropped_notices


def _bind_poses(
    skeleton: Any, skeleton_rig: SkeletonRig
) -> tuple[dict[str, Pose], FloatArray]:
    """Return local bind poses that differ from rest, and all bind scales ``(J, 3)``."""
    rig = skeleton_rig.rig
    bind_world = number_rows(skeleton.GetBindTransformsAttr(), 16).reshape(-1, 4, 4)
    if (
        not rig.joints
        or len(bind_world) != len(rig.joints)
        or not (np.abs(bind_world) <= MAX_REST_VALUE).all()
    ):
        return {}, np.ones((len(rig.joints), 3))
    parent_bind = np.where(
        (rig.parents < 0)[:, None, None], np.eye(4), bind_world[rig.parents]
    )
    if (np.linalg.det(parent_bind) == 0).any():
        return {}, np.ones((len(rig.joints), 3))
    translations, rotations, scales = decompose(bind_world @ np.linalg.inv(parent_bind))
    translations = translations * rig.meters_per_unit
    distances = np.abs(translations - rig.rest_translations).max(axis=1)
    is_different = distances > BIND_TOLERANCE * np.abs(rig.rest_translations).max()
    is_different |= so3.angle_between(rotations, rig.rest_rotations) > BIND_TOLERANCE
    poses = {
        rig.names[j]: Pose(
            tuple(translations[j].tolist()), tuple(rotations[j].tolist())
        )
        for j in np.flatnonzero(is_different).tolist()
    }
    return poses, scales


def _scale_notice(
    rig: SkeletonRig, bind_scales: FloatArray, file_path: str
) -> list[Fault]:
    """Return a warning if rest or bind poses have scales, which rigs cannot store."""
    deviations = np.abs(np.stack([rig.rest_scales, bind_scales]) - 1.0).max(axis=(0, 2))
    names = [rig.rig.names[j] for j in np.flatnonzero(deviations > SCALE_TOLERANCE)]
    if not names:
        return []
    message = f"the scale of rest or bind transforms is ignored: {listed(names)}"
    hint = "a rig cannot store it; a take of the file itself, and its meshes, keep it"
    return [Fault("USD120", message, file_path, (), hint, Severity.WARNING)]
