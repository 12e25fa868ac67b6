"""How fast animtool deforms meshes, beside UsdSkel and a plain product of matrices.

Every route works on the same mesh and frames, on one thread, from arrays in memory to
points in memory; see README.md beside this file.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from clock import Taken
from deform_meshes import (
    SEED,
    Array,
    Work,
    face_shapes,
    float32,
    make_shapes,
    make_skin,
    numpy_linear,
    usd_blend,
    usd_query,
    usd_skin,
    write_points,
    write_take,
)
from figures import Accuracy, Bound, Clock, Row, ratio_rows, time_rows
from measuring import (
    begin,
    floor_work,
    floors,
    in_process,
    in_turn,
    on_one_thread,
    parser,
)
from pxr import Usd, UsdGeom

from animtool import _kernels
from animtool.rig.kinematics import WorldTransforms
from animtool.rig.surfaces import SurfaceShape
from animtool.scene.bake.bake import bake
from animtool.scene.bake.options import BakeOptions
from animtool.skin.shapes import blend_points, prepare_shapes
from animtool.skin.skinning import Binding, SkinMethod, prepare_skin, skin_points

ERROR = "largest error [1e-6]"
# What a ratio needs, of points about 1 in size: float32 is as near.
NEAR_ENOUGH = Bound(at_least=False, bound=100.0)
AHEAD = Bound(at_least=True, bound=1.0)
OURS, INTO, ONE = "animtool", "animtool, out=", "animtool, a call a frame"


@dataclass
class Peer:
    """A route beside animtool's.

    Attributes:
        name: Of the route.
        work: All frames.
        bound: How many times as long it should take.
        single: Whether it takes a call a frame, as animtool is called there too.
        exact: Whether its points are whole, so that they have an error.
    """

    name: str
    work: Work
    bound: Bound | None = None
    single: bool = True
    exact: bool = True


def rows_of(
    section: str,
    ours: Callable[[slice, Array | None], Array],
    peers: list[Peer],
    truth: Array | None,
    options: argparse.Namespace,
) -> list[Row]:
    """Time routes to points ``(F, V, 3)`` and compare them with float64 reference.

    Args:
        section: Of the tables.
        ours: Returns some frames, into an array where there is one.
        peers: Beside it.
        truth: Points of the first frames; None leaves animtool out, which is them.
        options: Of the script.
    """
    every = slice(0, options.frames)
    out = ours(every, None)
    frame = out[:1].copy()

    def each() -> None:
        for f in range(options.frames):
            ours(slice(f, f + 1), frame)

    works = {OURS: lambda: ours(every, None), INTO: lambda: ours(every, out), ONE: each}
    works |= {peer.name: peer.work for peer in peers}
    print(section, file=sys.stderr)
    taken = in_turn({n: in_process(w) for n, w in works.items()}, options.runs)
    near = dict[str, float]()
    own = ours(slice(0, 4), None)
    for name, points in [(OURS, own), *((p.name, p.work()) for p in peers if p.exact)]:
        true = own if truth is None else truth
        found = np.asarray(points)[: len(true)].reshape(true.shape)
        near[name] = 1e6 * float(np.abs(found - true).max())
    near[INTO] = near[ONE] = near[OURS]
    rows = []
    for title, base, also in (
        (f"{section}, one call", INTO, [OURS]),
        (f"{section}, a call a frame", ONE, []),
    ):
        bounds = {p.name: p.bound for p in peers}
        if base == ONE:
            bounds = {p.name: AHEAD if p.bound else None for p in peers if p.single}
        for name in (*also, base, *bounds):
            rows += time_rows(
                title, name, taken[name], unit="ms/frame", per=options.frames
            )
            faults = []
            if name in near and (truth is not None or name in bounds):
                rows.append(Row(title, name, ERROR, [near[name]]))
                faults = [Accuracy(ERROR, near[name], NEAR_ENOUGH)]
            if name != base:
                rows += ratio_rows(
                    title,
                    name,
                    taken[name],
                    taken[base],
                    wanted=bounds.get(name),
                    accuracy=faults,
                )
    return rows


def floor_peers(
    name: str, given: tuple[object, ...], out: Array, options: argparse.Namespace
) -> list[Peer]:
    """Return the plain loops of a name, which write into an array that they have."""
    made = []
    for title, library in options.libraries.items():
        work = floor_work(library, name, *given, options.frames, out)
        both = lambda work=work: (work(), out)[1]  # noqa: E731
        made.append(Peer(title, both, single=False))
    return made


def measure_shapes(
    section: str,
    points: Array,
    shapes: list[SurfaceShape],
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
        row[shape.vertices] = shape.deltas
    matrix = matrix.reshape(len(shapes), -1)
    truth = (weights[:4] @ matrix).reshape(4, *points.shape) + points
    bound = Bound(True, 1 / 1.5) if against_product else None
    space = np.zeros((options.frames, matrix.shape[1]))
    product = Peer(
        "dense product alone",
        lambda: np.matmul(weights, matrix, out=space),
        bound,
        single=False,
        exact=False,  # It leaves the points out.
    )
    plain = floor_peers(
        "shapes",
        (
            *(points, len(points), weights, len(shapes)),
            np.cumsum([0, *(len(shape.vertices) for shape in shapes)]).astype(np.int64),
            np.concatenate([shape.vertices for shape in shapes]).astype(np.int64),
            np.concatenate([np.asarray(shape.deltas, float) for shape in shapes]),
        ),
        np.ones((options.frames, *points.shape)),
        options,
    )
    deformed = usd_blend(points, shapes, weights)
    peer = Peer("UsdSkel, ComputeDeformedPoints", deformed, Bound(True, 3))
    return rows_of(
        section,
        lambda frames, out: blend_points(made, weights[frames], out=out),
        [product, *plain, peer],
        truth,
        options,
    )


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
    linear = method is SkinMethod.LINEAR
    peers = [
        Peer(
            "UsdSkel, SkinPoints",
            usd_skin(made, moved, method),
            Bound(True, bound),
        ),
        Peer("UsdSkel, ComputeSkinnedPoints", usd_query(made, moved, method)),
    ]
    if linear:
        whole = Peer("numpy", lambda: numpy_linear(made, moved), single=False)
        indices = np.asarray(binding.indices).astype(np.int64)
        sizes = np.asarray(binding.weights), indices.shape[1]
        flat = np.ascontiguousarray(moved[:, :, :3])
        given = made.points, len(made.points), indices, *sizes, flat, options.joints
        space = np.ones((options.frames, *made.points.shape))
        peers += [whole, *floor_peers("skin", given, space, options)]

    def ours(frames: slice, out: Array | None) -> Array:
        world = WorldTransforms(made.world.positions[frames], made.world.linear[frames])
        return skin_points(skin, still, world, out=out)

    # Dual quaternions are held against a plain reference by the tests.
    truth = numpy_linear(made, moved[:4]) if linear else None
    return rows_of(section, ours, peers, truth, options)


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
    works: dict[str, Work] = {
        "dense column": lambda: weights @ matrix,
        "full sparse column": lambda: _kernels.add_sparse(
            rest, weights, first, columns, offsets, whole
        ),
        "pass over the points": lambda: _kernels.add_sparse(
            whole, weights, empty, *none, whole
        ),
    }
    taken = in_turn({n: in_process(w) for n, w in works.items()}, options.runs)
    rows, base = [], "dense column"
    for name, runs in taken.items():
        # The pass is one for all columns.
        parts = options.frames * (1 if name.startswith("pass") else count)
        rows += time_rows("columns", name, runs, unit="us/frame", per=parts)
        if name != base:
            least = [
                Taken(*(part * options.frames / parts for part in one)) for one in runs
            ]
            dense = [Taken(*(part / count for part in one)) for one in taken[base]]
            rows += ratio_rows("columns", name, least, dense, name=base)
    return rows


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
        works = {whole: ours, alone: lambda: write_points(frames, floor)}
        taken = in_turn({n: in_process(w) for n, w in works.items()}, options.runs)
    rows, unit = [], "ms/frame"
    for name, runs in taken.items():
        rows += time_rows("bake", name, runs, unit=unit, per=len(frames))
    bound = Bound(False, 3)
    rows += ratio_rows(
        "bake", whole, taken[whole], taken[alone], name=alone, wanted=bound
    )
    # The first round warms up.
    parts = {
        "of it behind opening the take": [one.seconds["total"] for one in reports[1:]],
        "of it deforming, in a thread": [
            one.takes[0].meshes[0].seconds for one in reports[1:]
        ],
    }
    for name, seconds in parts.items():
        each = [second * 1e3 / len(frames) for second in seconds]
        rows.append(Row("bake", name, f"wall [{unit}]", each, clock=Clock.WALL))
    return rows


def measure(options: argparse.Namespace) -> list[Row]:
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
    return [row for rows in sections for row in rows]


def main() -> None:
    """Measure, print the tables, write the CSV."""
    made = parser(__doc__, "deform.csv", runs=9)
    add = made.add_argument
    add("--vertices", type=int, default=10_000)
    add("--joints", type=int, default=60)
    add("--influences", type=int, default=4)
    add("--shapes", type=int, default=53)
    add("--frames", type=int, default=64)
    add("--bake-frames", type=int, default=240, help="frames of the whole bake")
    add("--bake-shapes", type=int, default=20, help="shapes of the whole bake")
    add("--compiler", default="c++", help="of the plain loops; '' skips them")
    options = made.parse_args()
    on_one_thread()
    session = begin(
        options,
        (sys.executable, ["animtool", "usd-core", "numpy"]),
        notes=[
            f"{options.vertices} vertices, {options.joints} joints, "
            f"{options.influences} influences, {options.shapes} shapes, "
            f"{options.frames} frames, one thread"
        ],
    )
    with TemporaryDirectory(prefix="animtool-bench-") as folder:
        options.libraries = floors(options.compiler, Path(folder))
        rows = measure(options)
    session.finish(options.csv, rows)


if __name__ == "__main__":
    main()
