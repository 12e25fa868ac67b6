"""Light geometry that shows a skeleton in any viewer."""

from __future__ import annotations

from typing import Any

import numpy as np
from pxr import Gf, Sdf, Vt

from animtool._types import FloatArray, IntArray
from animtool.rig.kinematics import rest_world
from animtool.rig.skeleton import Rig
from animtool.usd.finite import Labels, narrowed
from animtool.usd.layers import attribute, prim, relationship
from animtool.usd.paths import RigPaths

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
    schemas = Sdf.TokenListOp()
    schemas.prependedItems = ["SkelBindingAPI"]
    spec.SetInfo("apiSchemas", schemas)
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
        made = attribute(
            spec, f"primvars:skel:{name}", kind, value, interpolation="vertex"
        )
        made.SetInfo("elementSize", 1)
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
