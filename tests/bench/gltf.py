"""How fast animtool reads and writes glTF, beside its bytes and pygltflib.

A chain of joints that turn at random, a key a frame; see README.md beside this file.
The floor of reading is `json.loads` and a copy of the floats to float64, that of
writing the bytes of the file.
"""

from __future__ import annotations

import ctypes
import json
import os
import struct
import sys
import tempfile
from collections.abc import Callable
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path

import numpy as np
from figures import Accuracy, Bound, Row, ratio_rows, time_rows
from measuring import ROOT, begin, in_process, in_turn, parser

sys.path.insert(0, str(ROOT / "tests"))

from support.gltf import Maker, as_glb, chain

from animtool.core.array_types import FloatArray
from animtool.formats.gltf.read import read_gltf
from animtool.formats.gltf.write import build_gltf_files
from animtool.motion.take import Take
from animtool.motion.take_files import WriteOptions

READ, WRITE = "read", "write"
FLOOR, PEER = "json.loads and floats to float64", "pygltflib and numpy"
BYTES = "the bytes alone"
PEAK = "peak memory / file [x]"


def chain_file(path: Path, joints: int, frames: int) -> None:
    """Write a chain of joints with a key a frame."""
    made = Maker()
    nodes = chain(made, [f"joint_{j}" for j in range(joints)])
    rng = np.random.default_rng(0)
    times = made.accessor(np.arange(frames) / 30)
    samplers, channels = [], []
    for node in nodes:
        angles = rng.normal(0, 0.02, (frames, 3)).cumsum(axis=0)
        size = np.linalg.norm(angles, axis=1, keepdims=True)
        rows = np.concatenate([angles / size * np.sin(size / 2), np.cos(size / 2)], 1)
        target = {"node": node, "path": "rotation"}
        channels.append({"sampler": len(samplers), "target": target})
        samplers.append({"input": times, "output": made.accessor(rows)})
    made.json["animations"] = [{"channels": channels, "samplers": samplers}]
    made.json["scenes"], made.json["scene"] = [{"nodes": [nodes[0]]}], 0
    path.write_bytes(as_glb(*made.done()))


def floor(path: Path) -> FloatArray:
    """Read the bytes, the JSON, and all numbers as float64."""
    content = path.read_bytes()
    (length,) = struct.unpack_from("<I", content, 12)
    json.loads(content[20 : 20 + length])
    start = 28 + length
    count = (len(content) - start) // 4
    return np.frombuffer(content, "<f4", count, start).astype(np.float64)


def blocks(path: Path) -> list[object]:
    """Read a take, all its blocks."""
    return list(read_gltf(path).blocks)


def by_pygltflib(path: Path) -> list[FloatArray]:
    """Read the rotations with pygltflib, as its documentation reads numbers."""
    from pygltflib import GLTF2

    found = GLTF2().load(str(path))
    assert found is not None
    blob = found.binary_blob()
    values = []
    for sampler in found.animations[0].samplers:
        accessor = found.accessors[sampler.output]
        view = found.bufferViews[accessor.bufferView]
        rows = [
            struct.unpack_from("<4f", blob, view.byteOffset + 16 * k)
            for k in range(accessor.count)
        ]
        values.append(np.array(rows))
    return values


def write_take(take: Take, path: Path) -> None:
    """Write a take to a GLB."""
    made = build_gltf_files(take, path, WriteOptions(names=("take",)))
    with path.open("wb") as file:
        for part in made.contents[path]:
            file.write(part)  # type: ignore[arg-type]


def peak_of(work: Callable[[], object], size: int) -> float:
    """Return the peak of resident memory in its own process, by the size of a file.

    What kernels take counts, which Python does not see.
    """
    near, far = os.pipe()
    if os.fork() == 0:
        ctypes.CDLL(None).malloc_trim(0)
        Path("/proc/self/clear_refs").write_text("5")
        before = resident("VmRSS")
        work()
        os.write(far, str(resident("VmHWM") - before).encode())
        os._exit(0)
    os.wait()
    return int(os.read(near, 100)) / size


def resident(name: str) -> int:
    """Return a figure of this process' memory [bytes]."""
    lines = Path("/proc/self/status").read_text().splitlines()
    (line,) = [line for line in lines if line.startswith(f"{name}:")]
    return 1024 * int(line.split()[1])


def main() -> None:
    """Measure, print the tables, write the CSV."""
    made = parser(__doc__, "gltf.csv", runs=9)
    made.add_argument("--joints", type=int, default=60)
    made.add_argument("--frames", type=int, default=10_000)
    options = made.parse_args()
    session = begin(options, (sys.executable, ["animtool", "numpy"]))
    rows: list[Row] = []
    with tempfile.TemporaryDirectory() as folder:
        path, output = Path(folder) / "chain.glb", Path(folder) / "out.glb"
        chain_file(path, options.joints, options.frames)
        content = path.read_bytes()
        routes = {"animtool": lambda: blocks(path), FLOOR: lambda: floor(path)}
        if find_spec("pygltflib"):
            routes[PEER] = lambda: by_pygltflib(path)
        works = {name: in_process(work) for name, work in routes.items()}
        taken = in_turn(works, options.runs)
        for name, own in taken.items():
            rows += time_rows(READ, name, own, unit="ms")
        rows += ratio_rows(
            READ,
            "animtool",
            taken["animtool"],
            taken[FLOOR],
            name="floor",
            wanted=Bound(False, 2.0),
        )
        if PEER in taken:
            rows += ratio_rows(
                READ, PEER, taken[PEER], taken["animtool"], wanted=Bound(True, 20.0)
            )
        memory = peak_of(lambda: blocks(path), len(content))
        rows.append(Row(READ, "animtool", PEAK, [memory], Bound(False, 3.0)))
        take = replace(read_gltf(path).collect(), curve=None)
        works = {
            "animtool": in_process(lambda: write_take(take, output)),
            BYTES: in_process(lambda: output.write_bytes(content)),
        }
        taken = in_turn(works, options.runs)
        for name, own in taken.items():
            rows += time_rows(WRITE, name, own, unit="ms")
        near = Accuracy(
            "bytes written [x]", output.stat().st_size / len(content), Bound(True, 0.9)
        )
        rows += ratio_rows(
            WRITE,
            "animtool",
            taken["animtool"],
            taken[BYTES],
            name="bytes",
            wanted=Bound(False, 2.0),
            accuracy=[near],
        )
    session.finish(options.csv, rows)


if __name__ == "__main__":
    main()
