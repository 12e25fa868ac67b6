"""How fast animtool reads an FBX, beside pufbx, a binding of ufbx.

A chain of joints with a key a frame in nine curves each, as exporters that bake write
them: binary 7400, arrays deflated; see README.md beside this file.
"""

from __future__ import annotations

import sys
import tempfile
import tracemalloc
from pathlib import Path

import numpy as np
from figures import Accuracy, Bound, Row, ratio_rows, time_rows
from measuring import ROOT, begin, in_process, in_turn, parser, run_peer, taken_of

sys.path.insert(0, str(ROOT / "tests"))

from support.fbx import TICKS, Tree, array, as_binary

from animtool.formats.fbx.read import read_fbx
from animtool.maths import so3

READ, PEER = "read", "pufbx: load and bake"
PEAK = "peak memory / inflated file [x]"
FPS = 30
PROPERTIES = ("Lcl Translation", "Lcl Rotation", "Lcl Scaling")


def row(name: str, kind: str, *values: object) -> Tree:
    """Return a property."""
    return "P", [name, kind, "", "A", *values], []


def chain_trees(joints: int, frames: int) -> list[Tree]:
    """Return a chain of joints that turn at random."""
    rng = np.random.default_rng(0)
    times = array(np.arange(frames) * (TICKS // FPS), "<i8")
    objects: list[Tree] = []
    links: list[Tree] = [("C", ["OO", 2, 1], [])]
    for j in range(joints):
        own = 100 * (j + 1)
        rest = row(PROPERTIES[0], PROPERTIES[0], 0.0, 10.0 if j else 0.0, 0.0)
        model = [own, f"joint_{j}\x00\x01Model", "LimbNode"]
        objects.append(("Model", model, [("Properties70", [], [rest])]))
        links.append(("C", ["OO", own, own - 100 if j else 0], []))
        walks = rng.normal(0, 1, (3, 3, frames)).cumsum(axis=2)
        scaled = np.array([0.02, 1.0, 1e-5])[:, None, None]
        start = np.array([[0, 10.0 if j else 0, 0], [0, 0, 0], [1, 1, 1]])
        for k, name in enumerate(PROPERTIES):
            node = own + 10 * (k + 1)
            kind = [node, f"{name[4]}\x00\x01AnimCurveNode", ""]
            objects.append(("AnimationCurveNode", kind, [("Properties70", [], [])]))
            links.append(("C", ["OO", node, 2], []))
            links.append(("C", ["OP", node, own, name], []))
            for part, axis in enumerate("XYZ"):
                values = start[k, part] + walks[k, part] * scaled[k]
                below: list[Tree] = [
                    ("KeyTime", [times], []),
                    ("KeyValueFloat", [array(values.ravel(), "<f4")], []),
                    ("KeyAttrFlags", [array([24836], "<i4")], []),
                    ("KeyAttrDataFloat", [array([0, 0, 9.4e-30, 0], "<f4")], []),
                    ("KeyAttrRefCount", [array([frames], "<i4")], []),
                ]
                curve = [node + 1 + part, "\x00\x01AnimCurve", ""]
                objects.append(("AnimationCurve", curve, below))
                links.append(("C", ["OP", curve[0], node, f"d|{axis}"], []))
    stop = int(times[-1])
    span = [row("LocalStart", "KTime", 0), row("LocalStop", "KTime", stop)]
    objects += [
        ("AnimationStack", [1, "s\x00\x01AnimStack", ""], [("Properties70", [], span)]),
        ("AnimationLayer", [2, "l\x00\x01AnimLayer", ""], []),
    ]
    settings = [row("TimeMode", "enum", 6), row("UnitScaleFactor", "double", 1.0)]
    return [
        ("FBXHeaderExtension", [], [("FBXVersion", [7400], [])]),
        ("GlobalSettings", [], [("Properties70", [], settings)]),
        ("Objects", [], objects),
        ("Connections", [], links),
    ]


def blocks(path: Path) -> list[object]:
    """Read a take, all its blocks."""
    return list(read_fbx(path).blocks)


def peak_of(path: Path) -> int:
    """Return the peak of memory of reading a take block by block [bytes]."""
    tracemalloc.start()
    for _ in read_fbx(path).blocks:
        pass
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    return peak


def apart(path: Path, theirs: Path) -> float:
    """Return the largest angle between rotations of both [degrees]."""
    take = read_fbx(path).collect()
    rotations = take.motion.rotations.dense()
    with np.load(theirs) as found:
        angles = [
            so3.angle_between(rotations[:, j], so3.normalize(found[name])).max()
            for j, name in enumerate(take.rig.names)
        ]
    return float(np.degrees(max(angles)))


def main() -> None:
    """Measure, print the tables, write the CSV."""
    made = parser(__doc__, "fbx.csv", runs=7)
    made.add_argument("--joints", type=int, default=60)
    made.add_argument("--frames", type=int, default=10_000)
    made.add_argument("--pufbx-python", help="interpreter with pufbx and numpy")
    options = made.parse_args()
    session = begin(
        options,
        (sys.executable, ["animtool", "numpy"]),
        (options.pufbx_python, ["pufbx", "numpy"]),
    )
    rows: list[Row] = []
    with tempfile.TemporaryDirectory() as folder:
        path, theirs = Path(folder) / "chain.fbx", Path(folder) / "theirs.npz"
        trees = chain_trees(options.joints, options.frames)
        inflated = len(as_binary(trees, inflated=True))
        path.write_bytes(as_binary(trees))
        own = in_turn({"animtool": in_process(lambda: blocks(path))}, options.runs)
        taken = own["animtool"]
        rows += time_rows(READ, "animtool", taken, unit="ms")
        if options.pufbx_python:
            told = ("fbx_pufbx.py", path, options.runs, theirs)
            peer = taken_of(run_peer(options.pufbx_python, *told))
            rows += time_rows(READ, PEER, peer, unit="ms")
            near = Accuracy(
                "rotations apart [deg]", apart(path, theirs), Bound(False, 0.01)
            )
            rows += ratio_rows(
                READ,
                "animtool",
                taken,
                peer,
                name="pufbx",
                wanted=Bound(False, 3.0),
                accuracy=[near],
            )
        share = peak_of(path) / inflated
        rows.append(Row(READ, "animtool", PEAK, [share], Bound(False, 3.0)))
    session.finish(options.csv, rows)


if __name__ == "__main__":
    main()
