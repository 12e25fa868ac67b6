"""What a rig says beyond USD, beside what USD says of it now."""

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
from animtool.usd.layers.faults import Spot, own_matrices
from animtool.usd.layers.sdf import usd_errors
from animtool.usd.layers.stderr import without_usd_warnings
from animtool.usd.rigs.mesh_read import read_meshes, read_strands
from animtool.usd.rigs.placement import own_placement, rest_rig, uneven_notice
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
    """Return a rig's attachments with their arrays, and names of those left out.

    Strands are as USD has them; others than the rig's stand last. What is left out has
    lost its mesh or curves, or the vertices that it pins.
    """
    others = dict(strands)
    counts = {mesh.name: len(mesh.points.load()) for mesh in rig.meshes}
    attachments: list[Attachment] = []
    lost: list[str] = []
    for entry in rig.attach:
        if entry.kind == AttachKind.STRANDS and entry.name in others:
            attachments.append(others.pop(entry.name))
        elif entry.kind == AttachKind.CLOTH and _fits(entry, counts, pins):
            held = np.array(pins[entry.name], float) if entry.name in pins else None
            attachments.append(
                replace(entry, pins=None if held is None else LoadedArray(held))
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
    """Return whether a cloth has its mesh, and that the vertices of its pins."""
    given = np.array(pins.get(entry.name, ()))
    count = counts.get(entry.mesh, 0)
    whole = given.ndim == 1 and (not len(given) or given.dtype.kind in "iu")
    return bool(count and whole and ((given >= 0) & (given < count)).all())


# Rest transforms nearer than this [m], [1] are the same but for rounding.
SAME = 1e-9


def joined_rig(
    read: Rig,
    data: dict[str, Any],
    tokens: list[str],
    rest: Any,
    bind: Any,
    path: Path,
) -> tuple[Rig, list[Fault]]:
    """Return a rig with what its customData says beyond USD.

    Where the Skeleton is what it was when it was written, joints are exactly those of
    the rig that it was written from. Else USD's own tree, rest and bind count, what
    names joints that are gone is left out, and a warning says so (USD117). Cloth and
    strands have no arrays yet; see `with_attachments`.
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
    whole = replace(
        stored,
        meshes=read.meshes,
        shapes=shapes,
        meters_per_unit=read.meters_per_unit,
    )
    notices: list[Fault] = []
    if data.get("hash") != skeleton_hash(tokens, rest, bind):
        whole, notices = _edited(whole, read, str(path))
    names = dict(zip(read.names, whole.names, strict=True))
    meshes = tuple(_renamed(mesh, names) for mesh in whole.meshes)
    return replace(whole, meshes=meshes), notices


def with_attachments(
    joined: Rig, read: Rig, data: dict[str, Any], path: Path
) -> tuple[Rig, list[Fault]]:
    """Return a joined rig whose cloth and strands have what USD holds of them.

    Those whose mesh or curves USD lost or broke are left out, and named (USD119).
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
    """Return a mesh whose skin names joints as the rig does."""
    if mesh.skin is None:
        return mesh
    joints = tuple(names[name] for name in mesh.skin.joints)
    return replace(mesh, skin=replace(mesh.skin, joints=joints))


def _shapes(stored: Rig, read: Rig) -> tuple[Shape, ...]:
    """Return shapes in the stored order, their arrays as USD has them."""
    held = {shape.name: shape for shape in read.shapes}
    known = {shape.name for shape in stored.shapes}
    return (
        *(
            replace(held[shape.name], combine=shape.combine, driven=shape.driven)
            if shape.name in held
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
        elif parents[old.name] == parent and _alike(old, joint):
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


def _alike(one: Joint, other: Joint) -> bool:
    apart = np.abs(np.subtract(one.translation, other.translation)).max()
    along = abs(float(np.dot(one.rotation, other.rotation)))
    return bool(apart <= SAME and along >= 1 - SAME)


def _without(rig: Rig, gone: list[str]) -> Rig:
    """Return a rig without what names joints that are gone."""
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
    """Return a driver; None where it reads a joint that is lost."""
    read = () if driver is None else driver.names
    return None if lost & {split_coordinate(name)[0] for name in read} else driver


# A bind pose nearer to rest [rad], [1] is rest with the rounding of other tools.
BIND_TOLERANCE = 1e-6
# A scale this near to 1 is that, with the rounding of other tools.
SCALE_TOLERANCE = 1e-4


def read_rig(path: Path) -> Rig:
    """Return the rig of a USD file, with what there is to say of it as its notices."""
    rig, notices = read_whole_rig(path)
    return replace(rig, notices=tuple(notices))


def read_whole_rig(path: Path, prim_path: str | None = None) -> tuple[Rig, list[Fault]]:
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
        where = Spot.of(path, skeleton)
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
            own_matrices(skeleton.GetRestTransformsAttr()),
            own_matrices(skeleton.GetBindTransformsAttr()),
            path,
        )
        whole, losses = with_attachments(joined, rig, data, path)
        placement = own_placement(skeleton.GetPrim(), of_skeleton.rig)
        notices += uneven_notice(placement, where)
        return rest_rig(whole, placement), notices + edits + losses


def _bind_poses(
    skeleton: Any, of_skeleton: SkeletonRig
) -> tuple[dict[str, Pose], FloatArray]:
    """Return the local bind transforms that are not those of rest, and their scales.

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
    places, turns, scales = decompose(world @ np.linalg.inv(above))
    places = places * rig.meters_per_unit
    moved = np.abs(places - rig.rest_translations).max(axis=1)
    moved = moved > BIND_TOLERANCE * np.abs(rig.rest_translations).max()
    moved |= so3.angle_between(turns, rig.rest_rotations) > BIND_TOLERANCE
    poses = {
        rig.names[j]: Pose(tuple(places[j].tolist()), tuple(turns[j].tolist()))
        for j in np.flatnonzero(moved).tolist()
    }
    return poses, scales


def _scale_notice(rig: SkeletonRig, bind: FloatArray, where: str) -> list[Fault]:
    """Name the joints whose scale at rest or at bind time a rig does not hold."""
    apart = np.abs(np.stack([rig.rest_scales, bind]) - 1.0).max(axis=(0, 2))
    names = [rig.rig.names[j] for j in np.flatnonzero(apart > SCALE_TOLERANCE)]
    if not names:
        return []
    message = f"the scale of rest or bind transforms is ignored: {listed(names)}"
    hint = "a rig cannot store it; a take of the file itself, and its meshes, keep it"
    return [Fault("USD120", message, where, (), hint, Severity.WARNING)]
