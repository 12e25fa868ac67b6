"""What a rig says beyond USD, beside what USD says of it now."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from animtool.documents.document import document_of
from animtool.errors import Fault, FormatError, Severity, listed
from animtool.rig.controls import Control
from animtool.rig.file import rig_of_document
from animtool.rig.parts import Mesh, Shape
from animtool.rig.skeleton import Joint, Rig
from animtool.usd.skeleton import skeleton_hash
from animtool.usd.stored_attach import joined_attachments

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

    Args:
        read: As USD says.
        data: The Skeleton's customData ``animtool``.
        tokens: Paths of its joints.
        rest: Its rest transforms.
        bind: Its bind transforms.
        path: The file.

    Raises:
        FormatError: The customData is malformed (USD007).
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

    Args:
        joined: As `joined_rig` returns it.
        read: As USD says, its joints in the same order.
        data: The Skeleton's customData ``animtool``.
        path: The file.
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
    message = f"attachments whose mesh or curves are gone or edited: {listed(lost)}"
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
            replace(held[shape.name], combine=shape.combine)
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
    message = "the Skeleton was edited after it was written; what it says now counts"
    if changed:
        message += f"; joints that differ: {listed(changed)}"
    if gone:
        message += f"; gone: {listed(gone)}"
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
        )
        for joint in rig.joints
    )
    return replace(
        rig,
        joints=joints,
        controls=tuple(_control(control, lost) for control in rig.controls),
        ik=tuple(chain for chain in rig.ik if not {chain.root, chain.tip} & lost),
        attach=tuple(entry for entry in rig.attach if not set(entry.joints) & lost),
        colliders=tuple(one for one in rig.colliders if one.joint not in lost),
    )


def _control(control: Control, lost: set[str]) -> Control:
    drives = tuple(
        drive
        for drive in control.drives
        if not any(drive.target.startswith(f"joint/{name}.") for name in lost)
    )
    return replace(control, drives=drives)
