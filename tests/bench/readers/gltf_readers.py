"""What Blender and three.js make of the glTF that animtool writes.

Rigs and samples with joints are written as GLB, all clips in one. Each reader plays
each clip at some times, and its positions are compared with those of the source, by
the size of the character. See README.md beside this file.
"""

from __future__ import annotations

import json
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

READERS = Path(__file__).resolve().parent
sys.path.insert(0, str(READERS.parent))
sys.path.insert(0, str(READERS))

from figures import Bound, Row, tables  # noqa: E402
from measuring import ROOT, begin, parser  # noqa: E402
from readers import MAX_POINTS, animtool, apart, peer  # noqa: E402

from animtool.formats.gltf.read import take_names  # noqa: E402
from animtool.rig.kinematics import bind_matrices, forward_kinematics  # noqa: E402
from animtool.rig.surfaces import surfaces_of  # noqa: E402
from animtool.scene.sources.open import SourceOptions, open_source  # noqa: E402
from animtool.skin.character import character_meshes  # noqa: E402
from animtool.skin.deform import deform  # noqa: E402

# Of float32 positions, by the size of the character [1].
# Blender goes between two keys of a rotation on straight lines of its four numbers.
BOUNDS = {"three.js": 1e-6, "Blender": 1e-4}
TIMES = 5


def written(folder: Path) -> list[tuple[str, Path, Path]]:
    """Return name, source and GLB of each sample."""
    found = []
    sources = [
        *ROOT.glob("samples/fox/*.glb"),
        *ROOT.glob("samples/walk/*.bvh"),
        *ROOT.glob("samples/swing/*.clip.yaml"),
        *ROOT.glob("samples/stride/*.clip.yaml"),
    ]
    for source in sorted(sources):
        path = folder / f"{source.name.split('.')[0]}.glb"
        animtool(folder, "convert", source, path, "-q")
        found.append((path.stem, source, path))
    return found


def reference(source: Path, clip: str) -> dict[str, Any]:
    """Return times, and what the source says of joints and points at them."""
    own = clip if source.suffix == ".glb" else None
    take = open_source(source, SourceOptions(take=own)).collect()
    rig, clock = take.rig, take.clock
    chosen = np.unique(np.linspace(0, clock.count - 1, TIMES).astype(int))
    poses = [channel[chosen] for channel in take.motion.dense() if channel is not None]
    world = forward_kinematics(rig, *poses, *[None] * (3 - len(poses)))
    places = world.positions
    joints = {name: places[:, j] for j, name in enumerate(rig.names)}
    shapes = [shape.name for shape in rig.shapes]
    bind = bind_matrices(rig)
    weights = take.motion.weights
    points = {}
    for mesh in character_meshes(surfaces_of(rig), rig.names, bind, shapes):
        uncombined_weights = None
        if weights is not None:
            uncombined_weights = mesh.weights(weights.dense()[chosen][:, :, 0])
        moved = deform(mesh.mesh, uncombined_weights, world).points
        points[mesh.name] = moved[:, :: moved.shape[1] // MAX_POINTS + 1]
    seconds = (clock.times[chosen] - float(clock.start)) / float(clock.fps)
    size = float(np.ptp(places.reshape(-1, 3), axis=0).max())
    return {"times": seconds, "joints": joints, "points": points, "size": size}


def rows_of(
    tool: str, name: str, ref: dict[str, Any], found: dict[str, Any] | None
) -> list[Row]:
    """Return the figures of one reader and clip."""
    rows = [Row(name, tool, "opens", [float(found is not None)], Bound(True, 1))]
    if found is None:
        return rows
    matched = [joint for joint in ref["joints"] if joint in found["joints"]]
    wanted = Bound(True, len(ref["joints"]))
    rows.append(Row(name, tool, "joints", [float(len(matched))], wanted))
    bound = Bound(False, BOUNDS[tool])
    for kind in ("joints", "points"):
        error = apart(ref[kind], found[kind])
        if error is not None:
            label = f"{kind}, largest error / size [1]"
            rows.append(Row(name, tool, label, [error / ref["size"]], bound))
    return rows


def main() -> None:
    """Write, read, compare, print and store."""
    made = parser(__doc__, "gltf_readers.csv", runs=1)
    made.add_argument("--bpy-python", type=Path)
    made.add_argument("--three", type=Path, help="folder with three installed")
    options = made.parse_args()
    notes = ["left out, no folder was given: three"]
    if options.three:
        package = options.three / "node_modules/three/package.json"
        notes = [f"three {json.loads(package.read_text('utf-8'))['version']}"]
    session = begin(
        options,
        (sys.executable, ["animtool", "numpy"]),
        (options.bpy_python and str(options.bpy_python), ["bpy"]),
        notes=notes,
        clocked=False,
    )
    rows: list[Row] = []
    with tempfile.TemporaryDirectory() as place:
        for name, source, path in written(Path(place)):
            for clip in take_names(path):
                ref = reference(source, clip)
                times = [repr(float(one)) for one in ref["times"]]
                call = [str(path), "OUTPUT", clip, *times]
                own = []
                if options.bpy_python:
                    script = str(READERS / "blender_gltf.py")
                    found = peer([str(options.bpy_python), script, *call])
                    own += rows_of("Blender", f"{name} {clip}", ref, found)
                if options.three:
                    script = str(READERS / "three_gltf.mjs")
                    found = peer(["node", script, *call], options.three)
                    own += rows_of("three.js", f"{name} {clip}", ref, found)
                print("\n".join(tables(own)), file=sys.stderr, flush=True)
                rows += own
    session.finish(options.csv, rows)


if __name__ == "__main__":
    main()
