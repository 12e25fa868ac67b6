"""Authoring a rig's prims: model, SkelRoot, Skeleton."""

from __future__ import annotations

import hashlib
import json
from dataclasses import replace
from typing import Any

import numpy as np
from pxr import Gf, Sdf, Vt

from animtool._types import FloatArray, IntArray
from animtool.errors import Fault, FormatError
from animtool.maths import so3
from animtool.rig.kinematics import bind_world, rest_world
from animtool.rig.parts import ArraySource, Shape
from animtool.rig.skeleton import JointType, Rig
from animtool.rig.write import rig_text
from animtool.usd.finite import Labels, narrowed
from animtool.usd.layers import (
    apply_schemas,
    attribute,
    author_model,
    prim,
    relationship,
)
from animtool.usd.names import RigPaths, UsdNames

_EXTRAS_VERSION = 1


def author_rig(
    layer: Any, rig: Rig, names: UsdNames, paths: RigPaths, meters_per_unit: float
) -> None:
    """Write the model, the SkelRoot and the Skeleton of a rig, with its strands."""
    author_model(layer, paths.model)
    prim(layer, paths.root, "SkelRoot")
    spec = prim(layer, paths.skeleton, "Skeleton")
    types = Sdf.ValueTypeNames
    tokens = Vt.TokenArray(rig.paths(names.names))
    attribute(spec, "joints", types.TokenArray, tokens, uniform=True)
    world = bind_world(rig)
    bind = _matrices(world.positions[0] / meters_per_unit, world.linear[0])
    local = so3.to_matrix(rig.rest_rotations)
    rest = _matrices(rig.rest_translations / meters_per_unit, local)
    matrices = types.Matrix4dArray
    attribute(spec, "bindTransforms", matrices, bind, uniform=True)
    attribute(spec, "restTransforms", matrices, rest, uniform=True)
    if any(entry.points is not None for entry in rig.attach):
        from animtool.rig.surfaces import strands_of
        from animtool.usd.meshes import author_strands

        named = dict(zip(rig.names, map(str, tokens), strict=True))
        author_strands(layer, strands_of(rig), paths, named, meters_per_unit)
    data: dict[str, Any] = {}
    if says_more(rig):
        data["rig"] = rig_text(stripped(rig))
        if pins := _pins(rig):
            data["pins"] = pins
        data["hash"] = skeleton_hash(tokens, rest, bind)
    if extras := joint_extras(rig, names.names):
        data["joints"] = extras
    if names.originals:
        data["names"] = names.originals
    if data:
        spec.SetInfo("customData", {"animtool": data})


def says_more(rig: Rig) -> bool:
    """Return whether a rig holds what USD has no place for.

    The type of a joint with channels follows from these, which stand apart.
    """
    parts = (rig.controls, rig.ik, rig.attach, rig.colliders)
    return any(map(bool, parts)) or any(
        (joint.type is not JointType.FREE and joint.channels is None)
        or joint.limits is not None
        or joint.mimic is not None
        or joint.mirror
        for joint in rig.joints
    )


def stripped(rig: Rig) -> Rig:
    """Return a rig without the arrays, which USD holds."""
    shapes = tuple(Shape(shape.name, combine=shape.combine) for shape in rig.shapes)
    attach = tuple(replace(entry, pins=None, points=None) for entry in rig.attach)
    return replace(rig, meshes=(), shapes=shapes, attach=attach)


def _pins(rig: Rig) -> dict[str, Any]:
    """Return the vertices that stay with the skin, by the cloth's name."""
    return {
        entry.name: Vt.IntArray.FromNumpy(_whole(entry.pins, entry.name))
        for entry in rig.attach
        if entry.pins is not None
    }


def _whole(source: ArraySource, name: str) -> Any:
    try:
        return np.ascontiguousarray(source.load(), np.int32)
    except ValueError as error:
        raise FormatError(Fault("RIG018", f"{name!r}: {error}")) from error


def skeleton_hash(tokens: Any, rest: Any, bind: Any) -> str:
    """Return a hash of the joints, rest and bind transforms of a Skeleton."""
    digest = hashlib.sha256("\n".join(map(str, tokens)).encode())
    for matrices in (rest, bind):
        digest.update(np.array(matrices, "<f8").tobytes())
    return digest.hexdigest()


def _matrices(positions: FloatArray, linear: FloatArray) -> Any:
    """Return row-vector matrices, as USD has them."""
    whole = np.zeros((len(positions), 4, 4))
    whole[:, :3, :3] = linear.swapaxes(-1, -2)
    whole[:, 3, :3] = positions
    whole[:, 3, 3] = 1.0
    return Vt.Matrix4dArray.FromNumpy(whole)


def joint_extras(rig: Rig, names: list[str]) -> str:
    """Return what USD has no place for, as canonical JSON; empty if there is none.

    Channel orders and the ends of bones [m], by USD name.
    """
    joints: dict[str, dict[str, object]] = {}
    for joint, name in zip(rig.joints, names, strict=True):
        entry: dict[str, object] = {}
        if joint.channels is not None:
            entry["channels"] = list(joint.channels)
        if joint.tips:
            entry["tips"] = [list(tip) for tip in joint.tips]
        if entry:
            joints[name] = entry
    if not joints:
        return ""
    content = {"animtool": _EXTRAS_VERSION, "joints": joints}
    return json.dumps(content, sort_keys=True, separators=(",", ":"))


def author_binding(
    layer: Any, paths: RigPaths, *, skeleton: bool, animation: bool = True
) -> None:
    """Bind the animation, and the skeleton too where the rig does not."""
    spec = layer.GetPrimAtPath(paths.binding)
    if spec is None:
        spec = prim(layer, paths.binding, over=True)
    apply_schemas(spec, ["SkelBindingAPI"])
    if animation:
        relationship(spec, "skel:animationSource", paths.animation)
    if skeleton:
        relationship(spec, "skel:skeleton", paths.skeleton)


# A bone is an octahedron, widest a fifth of the way along.
WAIST = 0.2
HALF_WIDTH = 0.08
# Of the length, at either end: no two bones share a point, which tools would merge.
GAP = 0.005

_FACES = np.array([[[0, b, a], [5, a, b]] for a, b in ((1, 2), (2, 3), (3, 4), (4, 1))])


def bone_segments(rig: Rig) -> tuple[FloatArray, IntArray]:
    """Return bones at rest: ends ``(B, 2, 3)`` [m], world, and the joint of each.

    One bone leads from a joint to each of its children and each of its tips;
    those without length are left out.
    """
    world = rest_world(rig)
    ends, joints = [], []
    for i, joint in enumerate(rig.joints):
        if joint.parent >= 0:
            ends.append((world.positions[0, joint.parent], world.positions[0, i]))
            joints.append(joint.parent)
        for tip in joint.tips:
            here = world.positions[0, i]
            ends.append((here, here + world.linear[0, i] @ np.asarray(tip)))
            joints.append(i)
    segments = np.array(ends, np.float64).reshape(-1, 2, 3)
    owners = np.array(joints, np.int64)
    lengths = np.linalg.norm(segments[:, 1] - segments[:, 0], axis=-1)
    real = lengths > 1e-6 * lengths.max(initial=0.0)
    return segments[real], owners[real]


def author_bones(layer: Any, rig: Rig, paths: RigPaths, meters_per_unit: float) -> bool:
    """Write a mesh of octahedra, each bound rigidly to its joint.

    Returns whether there was a bone to write.
    """
    segments, owners = bone_segments(rig)
    if not len(segments):
        return False
    corners, outwards = _octahedra(segments / meters_per_unit)
    labels = Labels(f"{paths.root}/Bones.points", "point")
    points = narrowed(corners.reshape(-1, 3), "f", labels)
    normals = Vt.Vec3fArray.FromNumpy(outwards.reshape(-1, 3).astype(np.float32))
    faces = (_FACES.reshape(1, -1) + 6 * np.arange(len(segments))[:, None]).reshape(-1)
    spec = prim(layer, f"{paths.root}/Bones", "Mesh")
    apply_schemas(spec, ["SkelBindingAPI"])
    types = Sdf.ValueTypeNames
    counts = Vt.IntArray.FromNumpy(np.full(len(faces) // 3, 3, np.int32))
    attribute(spec, "faceVertexCounts", types.IntArray, counts)
    indices = Vt.IntArray.FromNumpy(faces.astype(np.int32))
    attribute(spec, "faceVertexIndices", types.IntArray, indices)
    attribute(spec, "points", types.Point3fArray, Vt.Vec3fArray.FromNumpy(points))
    attribute(spec, "normals", types.Normal3fArray, normals, interpolation="vertex")
    bounds = np.stack([points.min(axis=0), points.max(axis=0)])
    attribute(spec, "extent", types.Float3Array, Vt.Vec3fArray.FromNumpy(bounds))
    attribute(spec, "purpose", types.Token, "guide", uniform=True)
    attribute(spec, "subdivisionScheme", types.Token, "none", uniform=True)
    color = Vt.Vec3fArray([Gf.Vec3f(0.75, 0.72, 0.65)])
    attribute(
        spec,
        "primvars:displayColor",
        types.Color3fArray,
        color,
        interpolation="constant",
    )
    skinned = np.repeat(owners, 6).astype(np.int32)
    for name, kind, value in (
        ("jointIndices", types.IntArray, Vt.IntArray.FromNumpy(skinned)),
        (
            "jointWeights",
            types.FloatArray,
            Vt.FloatArray.FromNumpy(np.ones(len(skinned), np.float32)),
        ),
    ):
        attr = attribute(
            spec, f"primvars:skel:{name}", kind, value, interpolation="vertex"
        )
        attr.SetInfo("elementSize", 1)
    identity = Gf.Matrix4d(1.0)
    attribute(spec, "primvars:skel:geomBindTransform", types.Matrix4d, identity)
    relationship(spec, "skel:skeleton", paths.skeleton)
    return True


def _octahedra(segments: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return six points a bone: head, four about the waist, tail; and their normals.

    Both are ``(B, 6, 3)``.
    """
    along = segments[:, 1] - segments[:, 0]
    head, tail = segments[:, 0] + GAP * along, segments[:, 1] - GAP * along
    length = np.linalg.norm(along, axis=-1, keepdims=True)
    direction = along / length
    # The axis that the bone is least along gives a side that is never degenerate.
    other = np.eye(3)[np.argmin(np.abs(direction), axis=-1)]
    side = np.cross(direction, other)
    side /= np.linalg.norm(side, axis=-1, keepdims=True)
    front = np.cross(direction, side)
    waist = head + WAIST * along
    width = HALF_WIDTH * length
    around = [side, front, -side, -front]
    ring = [waist + width * v for v in around]
    return (
        np.stack([head, *ring, tail], axis=1),
        np.stack([-direction, *around, direction], axis=1),
    )
