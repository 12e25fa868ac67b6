"""Meshes that `deform.py` measures, and the routes of UsdSkel and numpy to points."""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt
from pxr import Gf, Sdf, Usd, UsdGeom, UsdSkel, Vt

from animtool.core.files.output import replacement_path
from animtool.maths import so3
from animtool.rig.kinematics import WorldTransforms
from animtool.rig.surfaces import SurfaceShape
from animtool.skin.skinning import Binding, SkinMethod

Array = npt.NDArray[np.float64]
Work = Callable[[], object]
SEED = 11


def float32(values: Array) -> Array:
    """Return values that float32 holds, so that UsdSkel gets the same."""
    return values.astype(np.float32).astype(np.float64)


def make_shapes(
    rng: np.random.Generator, vertices: int, densities: Array
) -> list[SurfaceShape]:
    """Return a shape a density, each at random vertices."""
    shapes = []
    for i, density in enumerate(densities):
        at = np.flatnonzero(rng.random(vertices) < density)
        offsets = float32(rng.normal(0, 0.01, (len(at), 3)))
        shapes.append(SurfaceShape(f"shape_{i}", offsets, at))
    return shapes


def face_shapes(path: Path) -> tuple[Array, list[SurfaceShape]]:
    """Return points and shapes of an npz with ptr, indices and offsets."""
    face = np.load(path)
    shapes = []
    for i, (low, high) in enumerate(
        zip(face["ptr"][:-1], face["ptr"][1:], strict=True)
    ):
        offsets = face["offsets"][low:high].astype(np.float64)
        at = face["indices"][low:high].astype(np.int64)
        shapes.append(SurfaceShape(f"shape_{i}", offsets, at))
    return face["points"].astype(np.float64), shapes


def usd_blend(points: Array, shapes: list[SurfaceShape], weights: Array) -> Work:
    """Return UsdSkel's route over all frames, everything it can prepare prepared."""
    stage = Usd.Stage.CreateInMemory()
    root = UsdSkel.Root.Define(stage, "/root")
    mesh = UsdGeom.Mesh.Define(stage, "/root/mesh")
    targets = []
    for shape in shapes:
        prim = UsdSkel.BlendShape.Define(stage, f"/root/mesh/{shape.name}")
        offsets = np.asarray(shape.deltas, np.float32)
        prim.CreateOffsetsAttr(Vt.Vec3fArray.FromNumpy(offsets))
        at = np.asarray(shape.vertices, np.int32)
        prim.CreatePointIndicesAttr(Vt.IntArray.FromNumpy(at))
        targets.append(prim.GetPath())
    binding = UsdSkel.BindingAPI.Apply(mesh.GetPrim())
    binding.CreateBlendShapeTargetsRel().SetTargets(targets)
    query = UsdSkel.BlendShapeQuery(binding)
    indices = query.ComputeBlendShapePointIndices()
    offsets_of = query.ComputeSubShapePointOffsets()
    rest = Vt.Vec3fArray.FromNumpy(points.astype(np.float32))
    frames = [Vt.FloatArray.FromNumpy(row) for row in weights.astype(np.float32)]

    def work() -> list[Vt.Vec3fArray]:
        made = []
        for frame in frames:
            deformed = Vt.Vec3fArray(rest)
            parts = query.ComputeSubShapeWeights(frame)
            query.ComputeDeformedPoints(*parts, indices, offsets_of, deformed)
            made.append(deformed)
        return made

    # A query lives as long as its stage.
    work.keep = stage, root  # type: ignore[attr-defined]
    return work


@dataclass
class Skinned:
    """A mesh on joints, and the transforms of these."""

    points: Array
    binding: Binding
    world: WorldTransforms


def make_skin(options: argparse.Namespace, *, scaled: bool) -> Skinned:
    """Return a mesh whose vertices follow neighbours among the joints."""
    rng = np.random.default_rng(SEED)
    vertices, joints, count = options.vertices, options.joints, options.influences
    near = np.arange(vertices) * joints // vertices
    picks = np.stack([(near + i) % joints for i in range(count)], axis=1)
    weights = rng.random((vertices, count)) + 0.05
    weights = float32(weights / weights.sum(axis=1, keepdims=True))
    bind = np.tile(np.eye(4), (joints, 1, 1))
    bind[:, :3, :3] = so3.to_matrix(so3.normalize(rng.normal(size=(joints, 4))))
    bind[:, :3, 3] = rng.normal(size=(joints, 3))
    turns = so3.normalize(rng.normal(size=(options.frames, joints, 4)))
    linear = so3.to_matrix(turns)
    if scaled:
        linear = linear * rng.uniform(0.8, 1.25, (options.frames, joints, 1, 3))
    world = WorldTransforms(rng.normal(size=(options.frames, joints, 3)), linear)
    points = float32(rng.normal(size=(vertices, 3)))
    return Skinned(points, Binding(picks, weights, bind), world)


def numpy_linear(made: Skinned, moved: Array) -> Array:
    """Return linear blend skinning as numpy does it best, a frame at a time."""
    ends = np.concatenate([made.points, np.ones((len(made.points), 1))], axis=1)
    indices, weights = (
        np.asarray(made.binding.indices),
        np.asarray(made.binding.weights),
    )
    result = np.empty((len(moved), *made.points.shape))
    for f, frame in enumerate(moved[:, :, :3]):
        blended = np.einsum("vi,virc->vrc", weights, frame[indices])
        result[f] = np.einsum("vrc,vc->vr", blended, ends)
    return result


USD_NAMES = {
    SkinMethod.LINEAR: "classicLinear",
    SkinMethod.DUAL_QUATERNION: "dualQuaternion",
}


def usd_transforms(moved: Array) -> list[Vt.Matrix4dArray]:
    """Return transforms for column vectors as arrays of USD's matrices."""
    rows = np.ascontiguousarray(moved.swapaxes(-1, -2))
    return [Vt.Matrix4dArray.FromNumpy(frame) for frame in rows]


def usd_skin(made: Skinned, moved: Array, method: SkinMethod) -> Work:
    """Return UsdSkel's function on arrays, all of them prepared."""
    count = np.asarray(made.binding.indices).shape[1]
    rest = Vt.Vec3fArray.FromNumpy(made.points.astype(np.float32))
    indices = Vt.IntArray.FromNumpy(np.asarray(made.binding.indices, np.int32).ravel())
    weights = np.asarray(made.binding.weights, np.float32).ravel()
    weights = Vt.FloatArray.FromNumpy(weights)
    frames, geom = usd_transforms(moved), Gf.Matrix4d(1)

    def work() -> list[Vt.Vec3fArray]:
        result = []
        for frame in frames:
            points = Vt.Vec3fArray(rest)
            UsdSkel.SkinPoints(
                USD_NAMES[method], geom, frame, indices, weights, count, points
            )
            result.append(points)
        return result

    return work


def usd_query(made: Skinned, moved: Array, method: SkinMethod) -> Work:
    """Return UsdSkel's query of a mesh on a stage."""
    stage = Usd.Stage.CreateInMemory()
    root = UsdSkel.Root.Define(stage, "/root")
    skeleton = UsdSkel.Skeleton.Define(stage, "/root/skeleton")
    names = [f"j{i}" for i in range(moved.shape[1])]
    skeleton.CreateJointsAttr(names)
    bind = np.asarray(made.binding.bind).swapaxes(-1, -2)
    skeleton.CreateBindTransformsAttr([Gf.Matrix4d(m.tolist()) for m in bind])
    skeleton.CreateRestTransformsAttr([Gf.Matrix4d(m.tolist()) for m in bind])
    mesh = UsdGeom.Mesh.Define(stage, "/root/mesh")
    rest = Vt.Vec3fArray.FromNumpy(made.points.astype(np.float32))
    mesh.CreatePointsAttr(rest)
    binding = UsdSkel.BindingAPI.Apply(mesh.GetPrim())
    binding.CreateSkeletonRel().SetTargets([skeleton.GetPath()])
    count = np.asarray(made.binding.indices).shape[1]
    indices = np.asarray(made.binding.indices, np.int32).ravel()
    binding.CreateJointIndicesPrimvar(False, count).Set(Vt.IntArray.FromNumpy(indices))
    weights = np.asarray(made.binding.weights, np.float32).ravel()
    binding.CreateJointWeightsPrimvar(False, count).Set(
        Vt.FloatArray.FromNumpy(weights)
    )
    attribute = mesh.GetPrim().CreateAttribute(
        "primvars:skel:skinningMethod", Sdf.ValueTypeNames.Token
    )
    attribute.Set(USD_NAMES[method])
    cache = UsdSkel.Cache()
    cache.Populate(root, Usd.PrimDefaultPredicate)
    query = cache.GetSkinningQuery(mesh.GetPrim())
    frames = usd_transforms(moved)

    def work() -> list[Vt.Vec3fArray]:
        result = []
        for frame in frames:
            points = Vt.Vec3fArray(rest)
            query.ComputeSkinnedPoints(frame, points, Usd.TimeCode.Default())
            result.append(points)
        return result

    work.keep = stage, cache  # type: ignore[attr-defined]
    return work


def write_take(folder: Path, options: argparse.Namespace) -> Path:
    """Write a rig of one mesh, its arrays, and a clip that turns every joint."""
    rng = np.random.default_rng(SEED)
    vertices, joints = options.vertices, options.joints
    made = make_skin(options, scaled=False)
    shapes = {
        f"s{i}": rng.normal(0, 0.01, (vertices, 3)) * (rng.random((vertices, 1)) < 0.4)
        for i in range(options.bake_shapes)
    }
    np.savez(
        folder / "mesh.npz",
        points=made.points,
        faces=np.arange(vertices // 3 * 3).reshape(-1, 3),
        indices=np.asarray(made.binding.indices),
        weights=np.asarray(made.binding.weights),
        **shapes,
    )
    rig = {
        "rig": "animtool/1",
        "name": "mesh",
        "units": {"length": "m", "angle": "deg"},
        "up": "Y",
        "joints": [
            {"name": f"j{i}", "type": "free", "translate": [0.1, 0.1, 0.0]}
            | ({"parent": f"j{(i - 1) // 2}"} if i else {})
            for i in range(joints)
        ],
        "meshes": [
            {
                "name": "body",
                "points": "mesh.npz",
                "faces": "mesh.npz",
                "skin": {
                    "method": "linear",
                    "joints": [f"j{i}" for i in range(joints)],
                    "indices": "mesh.npz",
                    "weights": "mesh.npz",
                },
            }
        ],
        "shapes": [
            {"name": name, "mesh": "body", "deltas": f"mesh.npz#{name}"}
            for name in shapes
        ],
    }
    last = options.bake_frames
    turn = [{"t": 1, "v": [1, 0, 0, 0]}, {"t": last, "v": [0.8, 0.6, 0, 0]}]
    grow = [{"t": 1, "v": 0.1}, {"t": last, "v": 1}]
    channels: list[dict[str, object]] = [
        {"target": f"joint/j{i}.rotation", "interp": "slerp", "keys": turn}
        for i in range(joints)
    ]
    channels += [{"target": f"shape/{name}", "keys": grow} for name in shapes]
    clip = {
        "clip": "animtool/1",
        "rig": "mesh.rig.json",
        "fps": 24,
        "range": [1, last],
        "channels": channels,
    }
    (folder / "mesh.rig.json").write_text(json.dumps(rig), "utf-8")
    path = folder / "mesh.clip.json"
    path.write_text(json.dumps(clip), "utf-8")
    return path


def write_points(points: npt.NDArray[np.float32], path: Path) -> None:
    """Write points and nothing else, as quickly as USD takes them."""
    layer = Sdf.Layer.CreateAnonymous(".usdc")
    with Sdf.ChangeBlock():
        spec = Sdf.CreatePrimInLayer(layer, "/body")
        kind = Sdf.ValueTypeNames.Point3fArray
        at = Sdf.AttributeSpec(spec, "points", kind).path
        for code, frame in enumerate(points, 1):
            layer.SetTimeSample(at, code, Vt.Vec3fArray.FromNumpy(frame))
    with replacement_path(path) as temporary:
        layer.Export(str(temporary))
