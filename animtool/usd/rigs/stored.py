"""Merges rig data stored in customData with the current USD content."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from animtool.core.arguments import argument
from animtool.core.array_types import FloatArray
from animtool.core.errors import Fault, FormatError, Severity, listed
from animtool.documents.document import document_of
from animtool.maths import so3
from animtool.rig.controls import Control
from animtool.rig.drivers import Driver, split_coordinate
from animtool.rig.file import rig_of_document
from animtool.rig.parts import AttachKind, Attachment, LoadedArray, Mesh, Shape
from animtool.rig.skeleton import Joint, Pose, Rig
from animtool.usd.layers.faults import PrimLocation, matrix_array
from animtool.usd.layers.sdf import usd_errors
from animtool.usd.layers.stderr import without_usd_warnings
from animtool.usd.rigs.mesh_read import read_meshes, read_strands
from animtool.usd.rigs.placement import local_placement, rest_rig, uneven_notice
from animtool.usd.rigs.prims import (
    LARGEST_REST,
    SkeletonRig,
    check_moves,
    composition_notices,
    decompose,
    find_skeletons,
    numbers,
    open_stage,
    others_notice,
    prim_below,
    skeleton_rig,
    stored_data,
)
from animtool.usd.rigs.skeleton import skeleton_hash
from animtool.usd.rigs.skinned import unique_name


def joined_attachments(
    rig: Rig, strands: Mapping[str, Attachment], pins: Mapping[str, Any]
) -> tuple[tuple[Attachment, ...], list[str]]:
    """Return a rig's attachments with arrays, and names of dropped ones.

    Strands come from USD; those unknown to the rig are last. Dropped entries have lost
    their mesh or curves, or the vertices they pin.
    """
    others = dict(strands)
    counts = {mesh.name: len(mesh.points.load()) for mesh in rig.meshes}
    attachments: list[Attachment] = []
    lost: list[str] = []
    for entry in rig.attach:
        if entry.kind == AttachKind.STRANDS and entry.name in others:
            attachments.append(others.pop(entry.name))
        elif entry.kind == AttachKind.CLOTH and _fits(entry, counts, pins):
            pin_values = (
                np.array(pins[entry.name], float) if entry.name in pins else None
            )
            attachments.append(
                replace(
                    entry, pins=None if pin_values is None else LoadedArray(pin_values)
                )
            )
        elif entry.kind in {AttachKind.STRANDS, AttachKind.CLOTH}:
            lost.append(entry.name)
        else:
            attachments.append(entry)
    used = {entry.name for entry in attachments}
    attachments += [
        replace(entry, name=unique_name(entry.name, used)) for entry in others.values()
    ]
    return tuple(attachments), lost


def _fits(entry: Attachment, counts: dict[str, int], pins: Mapping[str, Any]) -> bool:
    """Return whether a cloth's mesh exists and its pins are valid vertices."""
    indices = np.array(pins.get(entry.name, ()))
    count = counts.get(entry.mesh, 0)
    integral = indices.ndim == 1 and (not len(indices) or indices.dtype.kind in "iu")
    return bool(count and integral and ((indices >= 0) & (indices < count)).all())


# Rest transforms closer than this [m], [1] differ only by rounding.
SAME = 1e-9


def joined_rig(
    read: Rig,
    data: dict[str, Any],
    tokens: list[str],
    rest: Any,
    bind: Any,
    path: Path,
) -> tuple[Rig, list[Fault]]:
    """Return a rig with the data of its customData.

    If the Skeleton is unchanged since it was written, joints equal those of the source
    rig. Otherwise USD's hierarchy, rest and bind win, references to removed joints are
    dropped with a warning (USD117). Cloth and strands have no arrays yet; see
    `with_attachments`.
    """
    text = data.get("rig")
    if not text:
        return read, []
    document = document_of(str(text), path)
    # USD holds what these name.
    document.partial |= {"meshes", "attach"}
    try:
        stored = rig_of_document(document)
    except FormatError as error:
        reason = error.faults[0].message
        message = f"customData animtool:rig is malformed: {reason}"
        raise FormatError(Fault("USD007", message, str(path))) from error
    shapes = _shapes(stored, read)
    joined = replace(
        stored,
        meshes=read.meshes,
        shapes=shapes,
        meters_per_unit=read.meters_per_unit,
    )
    notices: list[Fault] = []
    if data.get("hash") != skeleton_hash(tokens, rest, bind):
        joined, notices = _edited(joined, read, str(path))
    names = dict(zip(read.names, joined.names, strict=True))
    meshes = tuple(_renamed(mesh, names) for mesh in joined.meshes)
    return replace(joined, meshes=meshes), notices


def with_attachments(
    joined: Rig, read: Rig, data: dict[str, Any], path: Path
) -> tuple[Rig, list[Fault]]:
    """Return a joined rig whose cloth and strands have their USD arrays.

    Those with missing or invalid mesh or curves are dropped and reported (USD119).
    """
    if not data.get("rig"):
        return joined, []
    names = dict(zip(read.names, joined.names, strict=True))
    strands = {
        entry.name: replace(entry, joints=tuple(names[name] for name in entry.joints))
        for entry in read.attach
    }
    attach, lost = joined_attachments(joined, strands, data.get("pins", {}))
    rig = replace(joined, attach=attach)
    if not lost:
        return rig, []
    message = f"attachments whose mesh or curves were removed or edited: {listed(lost)}"
    return rig, [Fault("USD119", message, str(path), severity=Severity.WARNING)]


def _renamed(mesh: Mesh, names: dict[str, str]) -> Mesh:
    """Return a mesh whose skin uses the rig's joint names."""
    if mesh.skin is None:
        return mesh
    joints = tuple(names[name] for name in mesh.skin.joints)
    return replace(mesh, skin=replace(mesh.skin, joints=joints))


def _shapes(stored: Rig, read: Rig) -> tuple[Shape, ...]:
    """Return shapes in stored order, with USD's arrays."""
    by_name = {shape.name: shape for shape in read.shapes}
    known = {shape.name for shape in stored.shapes}
    return (
        *(
            replace(by_name[shape.name], combine=shape.combine, driven=shape.driven)
            if shape.name in by_name
            else shape
            for shape in stored.shapes
        ),
        *(shape for shape in read.shapes if shape.name not in known),
    )


def _edited(stored: Rig, read: Rig, where: str) -> tuple[Rig, list[Fault]]:
    known = {joint.name: joint for joint in stored.joints}
    parents = {
        joint.name: stored.joints[joint.parent].name if joint.parent >= 0 else ""
        for joint in stored.joints
    }
    joints: list[Joint] = []
    changed: list[str] = []
    for joint in read.joints:
        old = known.get(joint.source_name or joint.name)
        parent = joints[joint.parent].name if joint.parent >= 0 else ""
        if old is None:
            changed.append(joint.name)
            joints.append(joint)
        elif parents[old.name] == parent and _equal_rest(old, joint):
            joints.append(replace(old, parent=joint.parent))
        else:
            changed.append(old.name)
            joints.append(
                replace(
                    old,
                    parent=joint.parent,
                    translation=joint.translation,
                    rotation=joint.rotation,
                )
            )
    gone = sorted(set(known) - {joint.name for joint in joints})
    if not changed and not gone and stored.bind == read.bind:
        return stored, []
    message = "the Skeleton was edited after it was written; using the edited one"
    if changed:
        message += f"; joints that differ: {listed(changed)}"
    if gone:
        message += f"; removed: {listed(gone)}"
    notice = Fault("USD117", message, where, severity=Severity.WARNING)
    return _without(replace(stored, joints=tuple(joints), bind=read.bind), gone), [
        notice
    ]


def _equal_rest(one: Joint, other: Joint) -> bool:
    offset = np.abs(np.subtract(one.translation, other.translation)).max()
    along = abs(float(np.dot(one.rotation, other.rotation)))
    return bool(offset <= SAME and along >= 1 - SAME)


def _without(rig: Rig, gone: list[str]) -> Rig:
    """Return a rig without references to removed joints."""
    lost = set(gone)
    joints = tuple(
        replace(
            joint,
            mirror="" if joint.mirror in lost else joint.mirror,
            mimic=None if joint.mimic and joint.mimic.joint in lost else joint.mimic,
            driven=_driver(joint.driven, lost),
        )
        for joint in rig.joints
    )
    return replace(
        rig,
        joints=joints,
        shapes=tuple(
            replace(shape, driven=_driver(shape.driven, lost)) for shape in rig.shapes
        ),
        controls=tuple(_control(control, lost) for control in rig.controls),
        chains=tuple(
            chain for chain in rig.chains if not {chain.root, chain.tip} & lost
        ),
        attach=tuple(entry for entry in rig.attach if not set(entry.joints) & lost),
        colliders=tuple(one for one in rig.colliders if one.joint not in lost),
        masses=tuple(one for one in rig.masses if one.joint not in lost),
    )


def _control(control: Control, lost: set[str]) -> Control:
    drives = tuple(
        drive
        for drive in control.drives
        if not any(drive.target.startswith(f"joint/{name}.") for name in lost)
    )
    return replace(control, drives=drives, driven=_driver(control.driven, lost))


def _driver(driver: Driver | None, lost: set[str]) -> Driver | None:
    """Return a driver; None if it reads a removed joint."""
    read = () if driver is None else driver.names
    return None if lost & {split_coordinate(name)[0] for name in read} else driver


# A bind pose nearer to rest [rad], [1] is rest with the rounding of other tools.
BIND_TOLERANCE = 1e-6
# A scale this near to 1 is that, with the rounding of other tools.
SCALE_TOLERANCE = 1e-4


def read_rig(path: Path) -> Rig:
    """Return the rig of a USD file with its notices."""
    rig, notices = read_rig_with_data(path)
    return replace(rig, notices=tuple(notices))


def read_rig_with_data(
    path: Path, prim_path: str | None = None
) -> tuple[Rig, list[Fault]]:
    """Return the rig of a USD file's Skeleton, that of its default prim first.

    With bind pose, meshes, shapes and strands, and what its customData holds beyond
    USD.
    """
    with usd_errors(path), without_usd_warnings():
        stage = open_stage(path)
        skeletons = find_skeletons(stage, prim_below(stage, prim_path))
        if not skeletons:
            below = "" if prim_path is None else f" at {prim_path}"
            message = f"has no Skeleton{below}"
            raise FormatError(Fault("USD008", message, str(path)))
        of_skeleton = skeleton_rig(skeletons[0], path, animated=False)
        skeleton = skeletons[0]
        meshes, shapes, notices = read_meshes(skeleton, of_skeleton, str(path))
        where = PrimLocation.of(path, skeleton)
        check_moves(len(of_skeleton.rig.joints), len(shapes), where)
        notices += of_skeleton.notices
        notices += others_notice(
            skeletons, str(path), f"choose one with {argument('source.prim_path')}"
        )
        notices += composition_notices(stage, str(path))
        bind, bind_scales = _bind_poses(skeleton, of_skeleton)
        notices += _scale_notice(of_skeleton, bind_scales, str(path))
        rig = replace(
            of_skeleton.rig,
            bind=bind,
            meshes=meshes,
            shapes=shapes,
            attach=read_strands(skeleton, of_skeleton, str(path)),
        )
        data = stored_data(skeleton.GetPrim())
        joined, edits = joined_rig(
            rig,
            data,
            of_skeleton.tokens,
            matrix_array(skeleton.GetRestTransformsAttr()),
            matrix_array(skeleton.GetBindTransformsAttr()),
            path,
        )
        complete, losses = with_attachments(joined, rig, data, path)
        placement = local_placement(skeleton.GetPrim(), of_skeleton.rig)
        notices += uneven_notice(placement, where)
        return rest_rig(complete, placement), notices + edits + losses


def _bind_poses(
    skeleton: Any, of_skeleton: SkeletonRig
) -> tuple[dict[str, Pose], FloatArray]:
    """Return local bind transforms that differ from rest, and their scales.

    The scales ``(J, 3)`` are no part of the poses.
    """
    rig = of_skeleton.rig
    world = numbers(skeleton.GetBindTransformsAttr(), 16).reshape(-1, 4, 4)
    if (
        not rig.joints
        or len(world) != len(rig.joints)
        or not (np.abs(world) <= LARGEST_REST).all()
    ):
        return {}, np.ones((len(rig.joints), 3))
    above = np.where((rig.parents < 0)[:, None, None], np.eye(4), world[rig.parents])
    if (np.linalg.det(above) == 0).any():
        return {}, np.ones((len(rig.joints), 3))
    translations, rotations, scales = decompose(world @ np.linalg.inv(above))
    translations = translations * rig.meters_per_unit
    moved = np.abs(translations - rig.rest_translations).max(axis=1)
    moved = moved > BIND_TOLERANCE * np.abs(rig.rest_translations).max()
    moved |= so3.angle_between(rotations, rig.rest_rotations) > BIND_TOLERANCE
    poses = {
        rig.names[j]: Pose(
            tuple(translations[j].tolist()), tuple(rotations[j].tolist())
        )
        for j in np.flatnonzero(moved).tolist()
    }
    return poses, scales


def _scale_notice(rig: SkeletonRig, bind: FloatArray, where: str) -> list[Fault]:
    """Report joints with a rest or bind scale, which rigs cannot hold."""
    off = np.abs(np.stack([rig.rest_scales, bind]) - 1.0).max(axis=(0, 2))
    names = [rig.rig.names[j] for j in np.flatnonzero(off > SCALE_TOLERANCE)]
    if not names:
        return []
    message = f"the scale of rest or bind transforms is ignored: {listed(names)}"
    hint = "a rig cannot store it; a take of the file itself, and its meshes, keep it"
    return [Fault("USD120", message, where, (), hint, Severity.WARNING)]
