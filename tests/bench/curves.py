"""How fast animtool evaluates Bézier curves, beside Ts, Blender and np.interp.

Every route evaluates the same channels at the same frames on one thread, timed from
inside its process without making the curves; see README.md beside this file.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

import mpmath
import numpy as np
import numpy.typing as npt
from clock import Taken
from figures import Accuracy, Bound, Row, ratio_rows, time_rows
from measuring import (
    begin,
    floor_work,
    floors,
    in_process,
    in_turn,
    on_one_thread,
    parser,
    run_peer,
    taken_of,
)
from pxr import Ts

from animtool.maths.curves import Curves, Extrapolation, SegmentKind, evaluate

Array = npt.NDArray[np.float64]

SEED = 4
ERROR = "largest error [1]"
# What a ratio needs, where values are about 10: float32 is as near.
NEAR_ENOUGH = Bound(at_least=False, bound=1e-3)
# Short runs go over the sample so often.
OFTEN = 10
BATCH, SINGLE = "all channels and frames, one call", "a call a value"
OWN, LINES = "animtool", "np.interp (straight lines)"
TS, BLENDER = "Ts, Spline.Eval", "Blender, convert_to_samples"
BLENDER_ONE = "Blender, FCurve.evaluate"


def make_keys(channels: int, count: int, frames: int) -> Array:
    """Return handle, key and handle ``(C, K, 6)``, each number a float32's."""
    rng = np.random.default_rng(SEED)
    times = np.cumsum(rng.uniform(0.5, 1.5, (channels, count)), axis=1)
    times -= times[:, :1]
    times *= (frames - 1) / times[:, -1:]
    spans = np.diff(times, axis=1)
    before, behind = np.zeros_like(times), np.zeros_like(times)
    before[:, 1:] = spans * rng.uniform(0.1, 0.9, spans.shape)
    behind[:, :-1] = spans * rng.uniform(0.1, 0.9, spans.shape)
    values = rng.normal(0, 10, times.shape)
    rises = rng.normal(0, 3, (2, *times.shape))
    columns = [times - before, values - rises[0], times, values]
    columns += [times + behind, values + rises[1]]
    return np.stack(columns, axis=-1).astype(np.float32).astype(np.float64)


def as_curves(keys: Array) -> Curves:
    """Return the keys as animtool's curves."""
    channels, count, _ = keys.shape
    flat = keys.reshape(-1, 6)
    return Curves(
        first_keys=np.arange(channels + 1) * count,
        times=flat[:, 2].copy(),
        values=flat[:, 3].copy(),
        kinds=np.full(len(flat), SegmentKind.BEZIER),
        in_handles=flat[:, :2] - flat[:, 2:4],
        out_handles=flat[:, 4:] - flat[:, 2:4],
        pre=(Extrapolation.HOLD,) * channels,
        post=(Extrapolation.HOLD,) * channels,
    )


def as_splines(keys: Array) -> list[Ts.Spline]:
    """Return the keys as Ts splines."""
    splines = []
    for rows in keys:
        spline = Ts.Spline("double")
        for before, low, key, value, behind, high in rows.tolist():
            knot = Ts.Knot("double")
            knot.SetTime(key)
            knot.SetValue(value)
            knot.SetNextInterpolation(Ts.InterpCurve)
            if key > before:
                knot.SetPreTanWidth(key - before)
                knot.SetPreTanSlope((value - low) / (key - before))
            if behind > key:
                knot.SetPostTanWidth(behind - key)
                knot.SetPostTanSlope((high - value) / (behind - key))
            spline.SetKnot(knot)
        splines.append(spline)
    return splines


def truth(rows: Array, frame: float) -> float:
    """Return a channel's value at a frame, with 50 digits."""
    k = min(int(np.searchsorted(rows[:, 2], frame, "right")), len(rows) - 1) - 1
    numbers = [*rows[k, 2:], *rows[k + 1, :4]]
    with mpmath.workdps(50):
        t0, v0, t1, v1, t2, v2, t3, v3 = map(mpmath.mpf, numbers)
        low, high = mpmath.mpf(0), mpmath.mpf(1)
        for _ in range(170):
            u = (low + high) / 2
            late = _bernstein(t0, t1, t2, t3, u) > frame
            low, high = (low, u) if late else (u, high)
        return float(_bernstein(v0, v1, v2, v3, low))


def _bernstein(
    a: mpmath.mpf, b: mpmath.mpf, c: mpmath.mpf, d: mpmath.mpf, u: mpmath.mpf
) -> mpmath.mpf:
    w = 1 - u
    return a * w**3 + 3 * b * w**2 * u + 3 * c * w * u**2 + d * u**3


class Problem:
    """The curves in the form of every route, and true values of a sample.

    Attributes:
        frames: Whole ones ``(F,)``.
        chosen: Channels and frames of the sample, a row each ``(N, 2)``.
        true: Their values ``(N,)``.
    """

    def __init__(self, options: argparse.Namespace) -> None:
        self.keys = make_keys(options.channels, options.keys, options.frames)
        self.frames = np.arange(options.frames, dtype=np.float64)
        rng = np.random.default_rng(SEED)
        ends = options.channels, options.frames
        self.chosen = np.stack([rng.integers(n, size=options.samples) for n in ends], 1)
        pairs = self.chosen.tolist()
        self.true = np.array([truth(self.keys[c], float(f)) for c, f in pairs])

    def error(self, values: Array) -> float:
        """Return how far off values ``(C, F)`` are at most."""
        return float(np.abs(values[tuple(self.chosen.T)] - self.true).max())


def batch(problem: Problem, options: argparse.Namespace, folder: Path) -> list[Row]:
    """Time all values in one call, where a tool has one."""
    keys, frames = problem.keys, problem.frames
    curves, splines, listed = as_curves(keys), as_splines(keys), frames.tolist()
    works: dict[str, Callable[[], Array]] = {
        OWN: lambda: evaluate(curves, frames),
        LINES: lambda: np.array(
            [np.interp(frames, rows[:, 2], rows[:, 3]) for rows in keys]
        ),
        TS: lambda: np.array([[spline.Eval(t) for t in listed] for spline in splines]),
    }
    libraries = floors(options.compiler, folder)
    kept = np.ones((len(keys), len(frames)))
    for name, library in libraries.items():
        sizes = len(keys), keys.shape[1]
        work = floor_work(library, "curves", keys, *sizes, frames, len(frames), kept)
        works[name] = lambda work=work: (work(), kept)[1]
    values = {name: np.array(work()) for name, work in works.items()}
    routes = {name: in_process(work) for name, work in works.items()}
    if options.bpy_python:
        routes[BLENDER] = lambda: blender(options, keys, folder, "samples")[0]
    taken = in_turn(routes, options.runs)
    if options.bpy_python:
        values[BLENDER] = blender(options, keys, folder, "samples")[1]
    errors = {name: problem.error(v) for name, v in values.items() if name != LINES}
    # Ts has no call for many times, so a loop of its calls is all there is.
    bounds = {TS: 5.0, BLENDER: 1.2}
    rows = rows_of(
        BATCH, taken, errors, bounds, float(len(keys) * len(frames)), "ns/value"
    )
    for name in libraries:
        rows += ratio_rows(BATCH, OWN, taken[OWN], taken[name], name=name)
    return rows


def single(problem: Problem, options: argparse.Namespace, folder: Path) -> list[Row]:
    """Time the sample, each value by a call of its own."""
    keys = problem.keys
    curves = [as_curves(rows[None]) for rows in keys]
    splines, chosen = as_splines(keys), problem.chosen.tolist() * OFTEN
    works: dict[str, Callable[[], Array]] = {
        OWN: lambda: np.array([evaluate(curves[c], [f])[0, 0] for c, f in chosen]),
        TS: lambda: np.array([splines[c].Eval(f) for c, f in chosen]),
    }
    routes = {name: in_process(work) for name, work in works.items()}
    true = np.tile(problem.true, OFTEN)
    errors = {name: float(np.abs(work() - true).max()) for name, work in works.items()}
    if options.bpy_python:
        np.save(folder / "chosen.npy", np.array(chosen))
        routes[BLENDER_ONE] = lambda: blender(options, keys, folder, "evaluate")[0]
    taken = in_turn(routes, options.runs)
    if options.bpy_python:
        values = blender(options, keys, folder, "evaluate")[1]
        errors[BLENDER_ONE] = float(np.abs(values - true).max())
    bounds = {TS: 1.0, BLENDER_ONE: 1.0}
    return rows_of(SINGLE, taken, errors, bounds, float(len(chosen)), "us/value")


def rows_of(
    section: str,
    taken: dict[str, list[Taken]],
    errors: dict[str, float],
    bounds: dict[str, float],
    count: float,
    unit: str,
) -> list[Row]:
    """Return the figures of every route, a value each."""
    rows = []
    for name, runs in taken.items():
        rows += time_rows(section, name, runs, unit=unit, per=count)
        near = []
        if name in errors:
            rows.append(Row(section, name, ERROR, [errors[name]]))
            near = [Accuracy(ERROR, errors[name], NEAR_ENOUGH)]
        if name != OWN:
            bound = Bound(True, bounds[name]) if name in bounds else None
            own = taken[OWN]
            rows += ratio_rows(section, name, runs, own, wanted=bound, accuracy=near)
    return rows


def blender(
    options: argparse.Namespace, keys: Array, folder: Path, how: str
) -> tuple[Taken, Array]:
    """Time Blender in its own interpreter."""
    source, output = folder / "keys.npy", folder / "values.npy"
    np.save(source, keys)
    told = how, source, output, options.frames, folder / "chosen.npy"
    report = run_peer(options.bpy_python, "blender_curves.py", *told)
    return taken_of(report)[0], np.load(output)


def main() -> None:
    """Measure, print the tables, write the CSV."""
    made = parser(__doc__, "curves.csv", runs=7)
    add = made.add_argument
    add("--channels", type=int, default=200)
    add("--keys", type=int, default=50, help="of each channel")
    add("--frames", type=int, default=5000)
    add("--samples", type=int, default=300, help="values compared with 50 digits")
    add("--compiler", default="c++", help="of the plain loops; '' skips them")
    add("--bpy-python", help="interpreter with bpy; without it Blender is skipped")
    options = made.parse_args()
    on_one_thread()
    session = begin(
        options,
        (sys.executable, ["animtool", "usd-core", "numpy"]),
        (options.bpy_python, ["bpy", "numpy"]),
        notes=[
            f"{options.channels} channels, {options.keys} keys, {options.frames} frames"
        ],
    )
    problem = Problem(options)
    with tempfile.TemporaryDirectory(prefix="animtool-bench-") as name:
        folder = Path(name)
        rows = batch(problem, options, folder) + single(problem, options, folder)
    session.finish(options.csv, rows)


if __name__ == "__main__":
    main()
