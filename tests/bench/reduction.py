"""How few keys animtool makes of motion, and how fast, beside plainer ways.

Every tool gets the same Euler angles of a real take; see README.md beside this file.
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
from clock import Taken, now, since
from figures import Accuracy, Bound, Clock, Row, ratio_rows, time_rows
from measuring import begin, parser, run_peer, taken_of

from animtool.clip.reduction.reduce import reduce_motion
from animtool.clip.reduction.tracks import euler_order
from animtool.core.array_types import FloatArray
from animtool.formats.bvh.read import read_bvh
from animtool.maths import euler
from animtool.maths.fit import evaluate_keys, fit_keys
from animtool.motion.take import Take

KEYS = "keys"
SAMPLES_PER_KEY = "samples a key [1]"
BUSY = "samples a key where it takes several [1]"
SPEED = "CPU speed [samples/s]"
COMPONENT = "largest error of a component [deg]"
DEGREES = "largest error [deg]"
METRES = "largest error [m]"
ROUNDS = "rounds"
SMOOTH = "inner keys of one slope [1]"
WORLD_TOLERANCES = (5e-4, 1e-3, 5e-3)


def rotation_samples(take: Take) -> list[FloatArray]:
    """Return the Euler angles ``(F, 3)`` [deg] of every joint that turns."""
    moving = take.motion.rotations
    found = []
    for i, joint in enumerate(moving.animated):
        values = moving.values[:, i]
        order = euler_order(take.rig.joints[joint], values)
        found.append(euler.from_quaternion(values, order))
    return found


def douglas_peucker(values: FloatArray, tolerance: float) -> FloatArray:
    """Return the samples that straight lines between them need ``(K,)`` [frame]."""
    kept, stack = {0, len(values) - 1}, [(0, len(values) - 1)]
    while stack:
        a, b = stack.pop()
        if b - a < 2:
            continue
        u = np.arange(1, b - a)[:, None] / (b - a)
        line = values[a] + u * (values[b] - values[a])
        off = np.linalg.norm(values[a + 1 : b] - line, axis=1)
        worst = int(off.argmax())
        if off[worst] > tolerance:
            middle = a + 1 + worst
            kept.add(middle)
            stack += [(a, middle), (middle, b)]
    return np.array(sorted(kept))


def busy_share(counts: list[int], frames: int) -> float:
    """Return samples a key of the channels that need more than one key."""
    busy = [count for count in counts if count > 1]
    return frames * len(busy) / max(1, sum(busy))


def timed(work: Callable[[], object], runs: int) -> tuple[object, list[Taken]]:
    """Return what some work gives and what each run took."""
    taken = []
    for _ in range(runs):
        began = now()
        result = work()
        taken.append(since(began))
    return result, taken


class Bench:
    """Runs the sections and gathers rows."""

    def __init__(self, options: argparse.Namespace) -> None:
        self.options = options
        self.rows: list[Row] = []

    def add(
        self,
        section: str,
        tool: str,
        measure: str,
        values: object,
        *wanted: Bound,
    ) -> None:
        """Add one figure."""
        listed = values if isinstance(values, list) else [float(values)]  # type: ignore[arg-type]
        self.rows.append(Row(section, tool, measure, listed, *wanted))

    def times(
        self,
        section: str,
        tool: str,
        samples: int,
        taken: list[Taken],
        *wanted: Bound,
    ) -> None:
        """Add what some runs took, and how many samples a second that is."""
        self.rows += time_rows(section, tool, taken)
        speeds = [samples / one.cpu for one in taken]
        self.rows.append(Row(section, tool, SPEED, speeds, *wanted, clock=Clock.CPU))

    def ratio(
        self,
        section: str,
        tool: str,
        taken: list[Taken],
        own: list[Taken],
        error: float,
        measure: str,
    ) -> None:
        """Compare a tool with animtool, where it kept the tolerance."""
        needed = Bound(at_least=False, bound=1.01 * self.options.degrees)
        near = [Accuracy(measure, error, needed)]
        self.rows += ratio_rows(section, tool, taken, own, accuracy=near)

    def file(self, path: Path) -> None:
        """Measure one take."""
        take = read_bvh(path).collect()
        self.curves(f"{path.stem}, {self.options.degrees:g} deg", take)
        self.world(path.stem, take)

    def curves(self, section: str, take: Take) -> None:
        """Reduce the rotations alone, each channel within an angle."""
        channels, limit = rotation_samples(take), self.options.degrees
        samples = sum(len(values) for values in channels)
        frames = np.arange(take.motion.frames)
        runs = self.options.runs

        def report(
            tool: str, keys: int, error: float, taken: list[Taken], *wanted: Bound
        ) -> None:
            self.add(section, tool, KEYS, keys)
            self.add(section, tool, SAMPLES_PER_KEY, samples / keys, *wanted[:1])
            self.add(section, tool, DEGREES, error)
            self.times(section, tool, samples, taken, *wanted[1:])

        fitted, taken = timed(lambda: [fit_keys(v, limit) for v in channels], runs)
        error = max(
            np.linalg.norm(evaluate_keys(k, frames) - v, axis=1).max()
            for k, v in zip(fitted, channels, strict=True)
        )
        keys = sum(len(k.frames) for k in fitted)
        dense = self.options.dense in section
        wanted = (Bound(True, 15),) if dense else ()
        report("animtool", keys, error, taken, *wanted, *(Bound(True, 1e5),) * dense)
        counts = [len(k.frames) for k in fitted]
        self.add(section, "animtool", BUSY, busy_share(counts, len(frames)))
        inner = np.concatenate([k.smooth[1:-1] for k in fitted])
        self.add(section, "animtool", SMOOTH, inner.mean() if len(inner) else 1.0)

        own = taken
        lines, taken = timed(
            lambda: [douglas_peucker(v, limit) for v in channels], runs
        )
        error = max(
            np.linalg.norm(
                np.stack([np.interp(frames, k, v[k, d]) for d in range(3)], 1) - v,
                axis=1,
            ).max()
            for k, v in zip(lines, channels, strict=True)
        )
        tool = "Douglas-Peucker"
        report(tool, sum(map(len, lines)), error, taken)
        self.ratio(section, tool, taken, own, error, DEGREES)
        if self.options.bpy_python:
            self.blender(section, channels, samples, own)

    def blender(
        self, section: str, channels: list[FloatArray], samples: int, own: list[Taken]
    ) -> None:
        """Decimate each component as an F-curve of its own."""
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "samples.npy"
            np.save(path, np.concatenate(channels, axis=1))
            told = "blender_decimate.py", path, self.options.degrees
            found = run_peer(self.options.bpy_python, *told)
        tool, keys, error = "Blender decimate", found["keys"], found["error"]
        self.add(section, tool, "keys, one component each", keys)
        self.add(section, tool, "samples a key, one component [1]", 3 * samples / keys)
        self.add(section, tool, COMPONENT, error)
        taken = taken_of(found)
        self.times(section, tool, samples, taken)
        self.ratio(section, tool, taken, own, error, COMPONENT)

    def world(self, name: str, take: Take) -> None:
        """Reduce the whole take within a distance in the world."""
        for tolerance in WORLD_TOLERANCES:
            section = f"{name}, {tolerance * 1e3:g} mm"
            found, taken = timed(
                lambda tolerance=tolerance: reduce_motion(take, tolerance),
                self.options.runs,
            )
            add = self.add
            add(section, "animtool", KEYS, found.keys)
            add(section, "animtool", SAMPLES_PER_KEY, found.samples_per_key)
            counts = [len(c.keys.frames) for c in found.channels]
            add(section, "animtool", BUSY, busy_share(counts, take.motion.frames))
            add(
                section,
                "animtool",
                METRES,
                found.error,
                Bound(False, tolerance),
            )
            add(section, "animtool", ROUNDS, found.rounds)
            wanted = (Bound(True, 1e5),) * (self.options.dense in section)
            self.times(section, "animtool", found.samples, taken, *wanted)


def main() -> None:
    """Measure, print the tables, write the CSV."""
    data = Path(os.environ.get("ANIMTOOL_DATA", "data")) / "bvh"
    made = parser(__doc__, "reduction.csv", runs=3)
    add = made.add_argument
    names = ("ad_jesse_dance", "pybvh_cmu_12_01", "assimp_cmu_01_03")
    files = [data / f"{name}.bvh" for name in names]
    add("--files", type=Path, nargs="+", default=files)
    add("--dense", default=names[0], help="the file that the bounds are for")
    add("--degrees", type=float, default=0.5, help="tolerance of a rotation")
    add("--bpy-python", help="interpreter with bpy; without it Blender is skipped")
    options = made.parse_args()
    session = begin(
        options,
        (sys.executable, ["animtool", "usd-core", "numpy"]),
        (options.bpy_python, ["bpy", "numpy"]),
    )
    bench = Bench(options)
    for path in options.files:
        bench.file(path)
    session.finish(options.csv, bench.rows)


if __name__ == "__main__":
    main()
