"""How fast animtool deforms meshes, beside UsdSkel and a plain product of matrices.

Every route works on the same mesh and frames, on one thread, from arrays in memory to
points in memory; see README.md beside this file.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import numpy.typing as npt
from figures import HERE, Row, Wanted, machine, table, verdicts, write_csv
from pxr import Gf, Sdf, Usd, UsdGeom, UsdSkel, Vt

from animtool import _kernels
from animtool.maths import so3
from animtool.output import replacing
from animtool.rig.kinematics import WorldTransforms
from animtool.scene.bake import bake
from animtool.scene.options import BakeOptions
from animtool.skin.shapes import ShapeDeltas, blend_points, prepare_shapes
from animtool.skin.skinning import Binding, SkinMethod, prepare_skin, skin_points

Array = npt.NDArray[np.float64]
Route = Callable[[], object]

SEED = 11
TIME, RATIO = "time [ms/frame]", "time / animtool, out= [x]"
ERROR = "largest error [1e-6]"
OURS, INTO = "animtool", "animtool, out="


@dataclass
class Peer:
    """A route beside animtool's: its work, and how many times slower it should be."""

    name: str
    route: Route
    bound: Wanted | None = None


def in_turn(routes: dict[str, Route], runs: int) -> dict[str, list[float]]:
    """Return the seconds of each route, run in turn behind a round that warms up."""
    seconds: dict[str, list[float]] = {name: [] for name in routes}
    for i in range(-1, runs):
        for name, route in routes.items():
            began = time.perf_counter()
            result = route()
            took = time.perf_counter() - began
            del result
            if i >= 0:
                seconds[name].append(took)
    return seconds


def rows_of(
    section: str,
    ours: Callable[[Array | None], Array],
    peers: list[Peer],
    truth: Array,
    options: argparse.Namespace,
) -> list[Row]:
    """Time routes to points ``(F, V, 3)`` and compare them with float64 reference."""
    out = ours(None)
    routes: dict[str, Route] = {OURS: lambda: ours(None), INTO: lambda: ours(out)}
    routes.update((peer.name, peer.route) for peer in peers)
    seconds = in_turn(routes, options.runs)
    own = statistics.median(seconds[INTO])
    bounds = {peer.name: peer.bound for peer in peers}
    rows = []
    for name, route in routes.items():
        each = [s * 1e3 / options.frames for s in seconds[name]]
        ratio = statistics.median(seconds[name]) / own
        rows.append(Row(section, name, TIME, each))
        rows.append(Row(section, name, RATIO, [ratio], bounds.get(name)))
        points = np.asarray(route())[: len(truth)].reshape(truth.shape)
        error = float(np.abs(points - truth).max())
        rows.append(Row(section, name, ERROR, [error * 1e6]))
        print(f"  {section}, {name}: {statistics.median(each):.4f} ms", file=sys.stderr)
    return rows


def float32(values: Array) -> Array:
    """Return values that float32 holds, so that UsdSkel gets the same."""
    return values.astype(np.float32).astype(np.float64)


def make_shapes(
    rng: np.random.Generator, vertices: int, densities: Array
) -> list[ShapeDeltas]:
    """Return a shape a density, each at random vertices."""
    shapes = []
    for i, density in enumerate(densities):
        at = np.flatnonzero(rng.random(vertices) < density)
        offsets = float32(rng.normal(0, 0.01, (len(at), 3)))
        shapes.append(ShapeDeltas(f"shape_{i}", offsets, at))
    return shapes


def face_shapes(path: Path) -> tuple[Array, list[ShapeDeltas]]:
    """Return points and shapes of an npz with ptr, indices and offsets."""
    face = np.load(path)
    shapes = []
    for i, (low, high) in enumerate(
        zip(face["ptr"][:-1], face["ptr"][1:], strict=True)
    ):
        offsets = face["offsets"][low:high].astype(np.float64)
        at = face["indices"][low:high].astype(np.int64)
        shapes.append(ShapeDeltas(f"shape_{i}", offsets, at))
    return face["points"].astype(np.float64), shapes


def measure_shapes(
    section: str,
    points: Array,
    shapes: list[ShapeDeltas],
    options: argparse.Namespace,
    *,
    against_product: bool,
) -> list[Row]:
    """Time points under shapes that all show."""
    rng = np.random.default_rng(SEED)
    weights = float32(rng.uniform(0.05, 1, (options.frames, len(shapes))))
    made = prepare_shapes(shapes, points)
    matrix = np.zeros((len(shapes), *points.shape))
    for row, shape in zip(matrix, shapes, strict=True):
        row[shape.indices] = shape.offsets
    matrix = matrix.reshape(len(shapes), -1)
    truth = (weights[:4] @ matrix).reshape(4, *points.shape) + points
    bound = Wanted(True, 1 / 1.5) if against_product else None
    space = np.zeros((options.frames, matrix.shape[1]))
    product = "dense product alone"
    floor = Peer(product, lambda: np.matmul(weights, matrix, out=space), bound)
    deformed = usd_blend(points, shapes, weights)
    peer = Peer("UsdSkel, ComputeDeformedPoints", deformed, Wanted(True, 3))
    rows = rows_of(
        section,
        lambda out: blend_points(made, weights, out=out),
        [floor, peer],
        truth,
        options,
    )
    # The product leaves the points out, so its difference is no error.
    return [r for r in rows if (r.tool, r.measure) != (floor.name, ERROR)]


def usd_blend(points: Array, shapes: list[ShapeDeltas], weights: Array) -> Route:
    """Return UsdSkel's route over all frames, everything it can prepare prepared."""
    stage = Usd.Stage.CreateInMemory()
    root = UsdSkel.Root.Define(stage, "/root")
    mesh = UsdGeom.Mesh.Define(stage, "/root/mesh")
    targets = []
    for shape in shapes:
        prim = UsdSkel.BlendShape.Define(stage, f"/root/mesh/{shape.name}")
        offsets = np.asarray(shape.offsets, np.float32)
        prim.CreateOffsetsAttr(Vt.Vec3fArray.FromNumpy(offsets))
        at = np.asarray(shape.indices, np.int32)
        prim.CreatePointIndicesAttr(Vt.IntArray.FromNumpy(at))
        targets.append(prim.GetPath())
    binding = UsdSkel.BindingAPI.Apply(mesh.GetPrim())
    binding.CreateBlendShapeTargetsRel().SetTargets(targets)
    query = UsdSkel.BlendShapeQuery(binding)
    indices = query.ComputeBlendShapePointIndices()
    offsets_of = query.ComputeSubShapePointOffsets()
    rest = Vt.Vec3fArray.FromNumpy(points.astype(np.float32))
    frames = [Vt.FloatArray.FromNumpy(row) for row in weights.astype(np.float32)]

    def route() -> list[Vt.Vec3fArray]:
        made = []
        for frame in frames:
            deformed = Vt.Vec3fArray(rest)
            parts = query.ComputeSubShapeWeights(frame)
            query.ComputeDeformedPoints(*parts, indices, offsets_of, deformed)
            made.append(deformed)
        return made

    # A query lives as long as its stage.
    route.keep = stage, root  # type: ignore[attr-defined]
    return route


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


USD_NAMES = {
    SkinMethod.LINEAR: "classicLinear",
    SkinMethod.DUAL_QUATERNION: "dualQuaternion",
}


def measure_skin(
    section: str,
    method: SkinMethod,
    bound: float,
    options: argparse.Namespace,
    *,
    scaled: bool = False,
) -> list[Row]:
    """Time points that follow joints."""
    made = make_skin(options, scaled=scaled)
    binding = Binding(
        made.binding.indices, made.binding.weights, made.binding.bind, method=method
    )
    skin = prepare_skin(binding, len(made.points))
    still = made.points[None]
    transforms = np.zeros((options.frames, options.joints, 4, 4))
    transforms[..., :3, :3], transforms[..., 3, 3] = made.world.linear, 1
    transforms[..., :3, 3] = made.world.positions
    moved = transforms @ np.linalg.inv(np.asarray(binding.bind))
    few = WorldTransforms(made.world.positions[:4], made.world.linear[:4])
    if method is SkinMethod.LINEAR:
        truth = numpy_linear(made, moved[:4])
    else:
        # Held against a plain reference by the tests; here it measures UsdSkel.
        truth = skin_points(skin, still, few)
    peers = [
        Peer("UsdSkel, SkinPoints", usd_skin(made, moved, method), Wanted(True, bound)),
        Peer("UsdSkel, ComputeSkinnedPoints", usd_query(made, moved, method)),
    ]
    if method is SkinMethod.LINEAR:
        peers.append(Peer("numpy", lambda: numpy_linear(made, moved)))
    rows = rows_of(
        section,
        lambda out: skin_points(skin, still, made.world, out=out),
        peers,
        truth,
        options,
    )
    own = method is SkinMethod.DUAL_QUATERNION
    return [
        r for r in rows if not (own and r.tool in {OURS, INTO} and r.measure == ERROR)
    ]


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


def usd_transforms(moved: Array) -> list[Vt.Matrix4dArray]:
    """Return transforms for column vectors as arrays of USD's matrices."""
    rows = np.ascontiguousarray(moved.swapaxes(-1, -2))
    return [Vt.Matrix4dArray.FromNumpy(frame) for frame in rows]


def usd_skin(made: Skinned, moved: Array, method: SkinMethod) -> Route:
    """Return UsdSkel's function on arrays, all of them prepared."""
    count = np.asarray(made.binding.indices).shape[1]
    rest = Vt.Vec3fArray.FromNumpy(made.points.astype(np.float32))
    indices = Vt.IntArray.FromNumpy(np.asarray(made.binding.indices, np.int32).ravel())
    weights = np.asarray(made.binding.weights, np.float32).ravel()
    weights = Vt.FloatArray.FromNumpy(weights)
    frames, geom = usd_transforms(moved), Gf.Matrix4d(1)

    def route() -> list[Vt.Vec3fArray]:
        result = []
        for frame in frames:
            points = Vt.Vec3fArray(rest)
            UsdSkel.SkinPoints(
                USD_NAMES[method], geom, frame, indices, weights, count, points
            )
            result.append(points)
        return result

    return route


def usd_query(made: Skinned, moved: Array, method: SkinMethod) -> Route:
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

    def route() -> list[Vt.Vec3fArray]:
        result = []
        for frame in frames:
            points = Vt.Vec3fArray(rest)
            query.ComputeSkinnedPoints(frame, points, Usd.TimeCode.Default())
            result.append(points)
        return result

    route.keep = stage, cache  # type: ignore[attr-defined]
    return route


def measure_columns(options: argparse.Namespace) -> list[Row]:
    """Time the two products of shapes beside each other, column by column."""
    rng = np.random.default_rng(SEED)
    vertices, count = options.vertices, options.shapes
    weights = rng.random((options.frames, count))
    rest = np.zeros((1, vertices, 3))
    matrix = rng.normal(size=(count, 3 * vertices))
    whole = np.zeros((options.frames, vertices, 3))
    empty = np.zeros(vertices + 1, np.int64)
    none = np.zeros(0, np.int32), np.zeros((0, 3))
    first = np.arange(vertices + 1) * count
    columns = np.tile(np.arange(count, dtype=np.int32), vertices)
    offsets = rng.normal(size=(vertices * count, 3))
    routes: dict[str, Route] = {
        "dense column": lambda: weights @ matrix,
        "full sparse column": lambda: _kernels.add_sparse(
            rest, weights, first, columns, offsets, whole
        ),
        "pass over the points": lambda: _kernels.add_sparse(
            whole, weights, empty, *none, whole
        ),
    }
    seconds = in_turn(routes, options.runs)
    rows = []
    for name, taken in seconds.items():
        parts = 1 if name.startswith("pass") else count
        each = [s * 1e6 / options.frames / parts for s in taken]
        rows.append(Row("columns", name, "time [us/frame]", each))
    dense = rows[0].median
    for row in list(rows):
        ratio = [row.median / dense]
        rows.append(Row("columns", row.tool, "time / dense column [x]", ratio))
    return rows


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
    with replacing(path) as temporary:
        layer.Export(str(temporary))


def measure_bake(options: argparse.Namespace) -> list[Row]:
    """Time a whole deformed bake beside writing its points alone."""
    with TemporaryDirectory() as name:
        folder = Path(name)
        clip = write_take(folder, options)
        ready = BakeOptions(deform=True, overwrite=True)
        output, floor = folder / "cache.usdc", folder / "floor.usdc"
        reports = []

        def ours() -> None:
            reports.append(bake(clip, output, ready))

        ours()
        stage = Usd.Stage.Open(str(output))
        points = UsdGeom.Mesh(stage.GetPrimAtPath("/mesh/Rig/body")).GetPointsAttr()
        frames = np.array([points.Get(code) for code in points.GetTimeSamples()])
        reports.clear()
        whole, alone = "animtool bake --deform", "points alone"
        routes: dict[str, Route] = {
            whole: ours,
            alone: lambda: write_points(frames, floor),
        }
        seconds = in_turn(routes, options.runs)
    opened = "of it behind opening the take"
    # The first round warms up.
    seconds[opened] = [report.seconds["total"] for report in reports[1:]]
    least = statistics.median(seconds[alone])
    rows = []
    for tool, taken in seconds.items():
        each = [s * 1e3 / len(frames) for s in taken]
        bound = Wanted(False, 3) if tool == whole else None
        ratio = statistics.median(taken) / least
        rows.append(Row("bake", tool, TIME, each))
        rows.append(Row("bake", tool, "time / points alone [x]", [ratio], bound))
        print(f"  bake, {tool}: {statistics.median(each):.4f} ms", file=sys.stderr)
    meshes = [report.takes[0].meshes[0] for report in reports[1:]]
    deformed = [mesh.seconds * 1e3 / len(frames) for mesh in meshes]
    rows.append(Row("bake", "of it deforming, in a thread", TIME, deformed))
    return rows


def measure(options: argparse.Namespace) -> list[list[Row]]:
    """Return the rows of every section."""
    rng = np.random.default_rng(SEED)
    points = float32(rng.normal(size=(options.vertices, 3)))
    broad = make_shapes(rng, options.vertices, rng.uniform(0.3, 0.6, options.shapes))
    narrow = make_shapes(rng, options.vertices, np.full(options.shapes, 0.05))
    sections = [
        measure_shapes("broad shapes", points, broad, options, against_product=True),
        measure_shapes("narrow shapes", points, narrow, options, against_product=False),
    ]
    root = os.environ.get("ANIMTOOL_DATA")
    face = Path(root, "rigs", "real", "ict_face_narrow.npz") if root else None
    if face is not None and face.is_file():
        sections.append(
            measure_shapes("a face", *face_shapes(face), options, against_product=True)
        )
    else:
        print("  the face is skipped: no ANIMTOOL_DATA with it", file=sys.stderr)
    linear, dual = SkinMethod.LINEAR, SkinMethod.DUAL_QUATERNION
    sections += [
        measure_skin("linear blend", linear, 3, options),
        measure_skin("dual quaternions", dual, 2, options),
        measure_skin("dual quaternions, scaled", dual, 2, options, scaled=True),
        measure_columns(options),
        measure_bake(options),
    ]
    return sections


def parser() -> argparse.ArgumentParser:
    """Return the options."""
    made = argparse.ArgumentParser(
        description=__doc__.splitlines()[0] if __doc__ else None,
        formatter_class=argparse.ArgumentDefaultsHelpFormatter,
    )
    add = made.add_argument
    add("--vertices", type=int, default=10_000)
    add("--joints", type=int, default=60)
    add("--influences", type=int, default=4)
    add("--shapes", type=int, default=53)
    add("--frames", type=int, default=64)
    add("--bake-frames", type=int, default=240, help="frames of the whole bake")
    add("--bake-shapes", type=int, default=20, help="shapes of the whole bake")
    add("--runs", type=int, default=9, help="runs of each route; the median counts")
    add("--csv", type=Path, default=HERE / "results" / "deform.csv")
    return made


# Libraries read these as they load.
ONE_THREAD = {
    "OPENBLAS_NUM_THREADS": "1",
    "OMP_NUM_THREADS": "1",
    "MKL_NUM_THREADS": "1",
    "PXR_WORK_THREAD_LIMIT": "1",
}


def on_one_thread(arguments: Sequence[str]) -> None:
    """Start again with libraries that use one thread, unless they do."""
    if any(os.environ.get(name) != value for name, value in ONE_THREAD.items()):
        command = [sys.executable, __file__, *arguments]
        os.execve(sys.executable, command, {**os.environ, **ONE_THREAD})


def main() -> None:
    """Measure, print the tables, write the CSV."""
    options = parser().parse_args()
    on_one_thread(sys.argv[1:])
    about = machine((sys.executable, ["animtool", "usd-core", "numpy"]))
    about.append(
        f"{options.vertices} vertices, {options.joints} joints, "
        f"{options.influences} influences, {options.shapes} shapes, "
        f"{options.frames} frames, one thread"
    )
    sections = measure(options)
    print("\n".join(about))
    for rows in sections:
        print("\n".join(["", *table(rows), "", *verdicts(rows)]))
    write_csv(options.csv, about, [row for rows in sections for row in rows])


if __name__ == "__main__":
    main()
