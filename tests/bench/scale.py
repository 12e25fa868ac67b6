"""How CPU time grows with joints, shapes, keys, frames, channels and files.

Each case runs at a quarter, half and all of its size; the exponent is that of the least
CPU times from the smallest to the largest size, 1 where time is proportional. A long
clip is baked in a process of its own, whose memory is held against the file.
"""

from __future__ import annotations

import json
import math
import sys
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from figures import Bound, Clock, Row, time_rows
from measuring import Run, begin, in_process, in_turn, on_one_thread, parser, run

from animtool import (
    BakeOptions,
    RunOptions,
    bake,
    load_batch,
    run_batch,
    validate,
)
from animtool.clip.file import load_clip_of
from animtool.rig.skeleton import Rig

# Largest growth: time is proportional to n^1.1 at most.
LARGEST_EXPONENT = 1.1
PARTS = (4, 2, 1)
# Joints of a chain, after which the next chain begins: as long as those of characters.
CHAIN = 25
# Of the clip whose memory is measured.
ROTATIONS, LONG = 667, 10_000


@dataclass(frozen=True)
class Case:
    """Something that grows.

    Attributes:
        name: What is counted.
        size: The largest number of it.
        prepare: Writes the inputs of a size into a folder, and returns the work.
    """

    name: str
    size: int
    prepare: Callable[[int, Path], Callable[[], object]]


def write_rig(
    folder: Path, joints: int = 1, controls: int = 0, shapes: int = 0
) -> Path:
    """Write a rig of chains of pins, with controls and shapes."""
    lines = [
        "rig: animtool/1",
        "name: a",
        "up: Y",
        "joints:",
        "- {name: j0, type: free}",
    ]
    for i in range(1, joints):
        parent = f"j{i - 1}" if i % CHAIN else "j0"
        lines.append(
            f"- {{name: j{i}, parent: {parent}, type: pin, axis: [0, 0, 1], "
            "translate: [0, 0.1, 0]}"
        )
    if controls:
        lines.append("controls:")
        lines += [
            f"- {{name: c{i}, min: -1, max: 1, default: 0}}" for i in range(controls)
        ]
    if shapes:
        lines.append("shapes:")
        lines += [f"- {{name: s{i}}}" for i in range(shapes)]
    path = folder / "a.rig.yaml"
    path.write_text("\n".join(lines) + "\n")
    return path


def write_clip(folder: Path, channels: list[str], last: int = 24) -> Path:
    """Write a clip of a rig beside it."""
    path = folder / "a.clip.yaml"
    head = ["clip: animtool/1", "rig: a.rig.yaml", "fps: 24", f"range: [1, {last}]"]
    path.write_text("\n".join([*head, "channels:", *channels]) + "\n")
    return path


def _angle(target: str, keys: int = 5) -> str:
    listed = ", ".join(f"{{t: {1 + 5 * k}, v: {k % 3 / 10}}}" for k in range(keys))
    return f"- {{target: {target}, keys: [{listed}]}}"


def _baked(clip: Path) -> Callable[[], object]:
    options = BakeOptions(overwrite=True)
    return lambda: bake(clip, clip.with_name("out.usdc"), options)


def joints(size: int, folder: Path) -> Callable[[], object]:
    """Bake a clip that moves every joint."""
    write_rig(folder, joints=size)
    channels = [_angle(f"joint/j{i}.angle") for i in range(1, size)]
    return _baked(write_clip(folder, channels))


def shapes(size: int, folder: Path) -> Callable[[], object]:
    """Bake a clip with a weight for every shape."""
    write_rig(folder, shapes=size)
    return _baked(write_clip(folder, [_angle(f"shape/s{i}") for i in range(size)]))


def channels(size: int, folder: Path) -> Callable[[], object]:
    """Validate a clip with a channel for every control."""
    write_rig(folder, controls=size)
    clip = write_clip(folder, [_angle(f"control/c{i}") for i in range(size)])
    return lambda: validate([clip])


def keys(size: int, folder: Path) -> Callable[[], object]:
    """Load a clip with keys in an array."""
    rig = Rig.load(write_rig(folder, joints=2))
    times = 1 + np.arange(size) * 0.01
    rows = np.stack([times, np.sin(times / 40)], axis=1)
    np.savez(folder / "keys.npz", knee=rows)
    channel = "- {target: joint/j1.angle, keys: keys.npz#knee}"
    clip = write_clip(folder, [channel], math.ceil(times[-1]))
    return lambda: load_clip_of(clip, rig).sample(rig)


def frames(size: int, folder: Path) -> Callable[[], object]:
    """Bake a clip of many frames."""
    write_rig(folder, joints=2)
    return _baked(write_clip(folder, [_angle("joint/j1.angle")], last=size))


def files(size: int, folder: Path) -> Callable[[], object]:
    """Plan a batch of many files."""
    write_rig(folder)
    for i in range(size):
        text = "clip: animtool/1\nrig: a.rig.yaml\nfps: 24\nrange: [1, 2]\n"
        (folder / f"take{i}.clip.yaml").write_text(text)
    batch = folder / "all.batch.yaml"
    batch.write_text(
        "batch: animtool/1\ninputs: ['take*.clip.yaml']\noutput: 'out/{stem}.usdc'\n"
    )
    options = RunOptions(dry_run=True)
    return lambda: run_batch(load_batch(batch), options)


CASES = (
    Case("joints, baked", 1_000, joints),
    Case("shapes, baked", 5_000, shapes),
    Case("channels, validated", 2_000, channels),
    Case("keys of an array, loaded and sampled", 1_000_000, keys),
    Case("frames, baked", 1_000_000, frames),
    Case("files, planned", 10_000, files),
)


def rotations(folder: Path, last: int) -> Path:
    """Write a clip that turns every joint of a rig of balls."""
    joints = [
        f"- {{name: j{i}, type: ball, translate: [0, 0.1, 0]"
        + (f", parent: {f'j{i - 1}' if i % CHAIN else 'j0'}}}" if i else "}")
        for i in range(ROTATIONS)
    ]
    folder.mkdir()
    head = ["rig: animtool/1", "name: a", "up: Y", "joints:"]
    (folder / "a.rig.yaml").write_text("\n".join([*head, *joints]) + "\n")
    rng = np.random.default_rng(0)
    times = np.linspace(1, LONG, 40).round().tolist()
    channels = []
    for i in range(ROTATIONS):
        walk = np.cumsum(rng.normal(size=(len(times), 4)), 0) * 0.3 + [1, 0, 0, 0]
        values = (walk / np.linalg.norm(walk, axis=1, keepdims=True)).tolist()
        keys = [{"t": t, "v": v} for t, v in zip(times, values, strict=True)]
        target = f"joint/j{i}.rotation"
        channels.append({"target": target, "interp": "slerp", "keys": keys})
    clip = {"clip": "animtool/1", "rig": "a.rig.yaml", "fps": 24, "range": [1, last]}
    path = folder / "a.clip.json"
    path.write_text(json.dumps({**clip, "channels": channels}))
    return path


def memory_rows(folder: Path, runs: int) -> list[Row]:
    """Return time and memory of a long clip, beyond those of its first frame."""
    section = f"{ROTATIONS} rotations, {LONG:,} frames, baked"
    peaks: dict[int, list[Run]] = {}
    for last in (1, LONG):
        clip = rotations(folder / str(last), last)
        output = clip.with_name("out.usdc")
        options = ["-o", str(output), "--overwrite", "--format", "json"]
        command = [sys.executable, "-m", "animtool", "bake", str(clip), *options]
        peaks[last] = [run(command) for _ in range(runs)]
    size = output.stat().st_size
    rows = time_rows(section, "animtool", [one.taken for one in peaks[LONG]])
    peak, short = ([one.peak_bytes for one in peaks[n]] for n in (LONG, 1))
    beyond = [(one - min(short)) / size for one in peak]
    bound = Bound(at_least=False, bound=2.0)
    return [
        *rows,
        Row(section, "animtool", "peak memory [MB]", [one / 1e6 for one in peak]),
        Row(section, "a frame", "peak memory [MB]", [one / 1e6 for one in short]),
        Row(section, "animtool", "peak beyond a frame / file [x]", beyond, bound),
    ]


def rows_of(case: Case, folder: Path, runs: int) -> list[Row]:
    """Time a case at its sizes, and return its figures."""
    works = {}
    for part in PARTS:
        size = case.size // part
        below = folder / case.name.replace(" ", "_").replace(",", "") / str(size)
        below.mkdir(parents=True)
        works[f"{size:,}"] = in_process(case.prepare(size, below))
    taken = in_turn(works, runs)
    rows: list[Row] = []
    for name, runs_of in taken.items():
        rows += time_rows(case.name, name, runs_of, unit="ms")
    least = [min(one.cpu for one in runs_of) for runs_of in taken.values()]
    exponent = math.log(least[-1] / least[0]) / math.log(PARTS[0])
    bound = Bound(at_least=False, bound=LARGEST_EXPONENT)
    last = list(taken)[-1]
    rows.append(Row(case.name, last, "exponent [1]", [exponent], bound, Clock.CPU))
    return rows


def main() -> None:
    """Measure, print the table, write the CSV."""
    made = parser(__doc__, "scale.csv", runs=3)
    made.add_argument("--cases", default="", help="run only cases that contain this")
    options = made.parse_args()
    on_one_thread()
    session = begin(options, (sys.executable, ["animtool", "numpy", "usd-core"]))
    rows = []
    with tempfile.TemporaryDirectory(prefix="animtool-bench-") as folder:
        for case in CASES:
            if options.cases in case.name:
                rows += rows_of(case, Path(folder), options.runs)
        if options.cases in "rotations":
            rows += memory_rows(Path(folder), options.runs)
    session.finish(options.csv, rows)


if __name__ == "__main__":
    main()
