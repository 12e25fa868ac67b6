"""How fast animtool evaluates Bézier curves, beside Ts, Blender and np.interp.

Every route evaluates the same channels at the same frames on one thread, timed from
inside its process without making the curves; see README.md beside this file.
"""

from __future__ import annotations

import argparse
import statistics
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import mpmath
import numpy as np
import numpy.typing as npt
from figures import HERE, Row, Wanted, machine, run, table, verdicts, write_csv
from pxr import Ts

from animtool.maths.curves import Curves, SegmentKind, evaluate
from animtool.maths.extrapolation import Extrapolation

Array = npt.NDArray[np.float64]

SEED = 4
SECTION = "curves"
TIME, SPEED, RATIO = "time [s]", "speed [Meval/s]", "time / animtool [x]"
ERROR = "largest error [1]"


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
        first=np.arange(channels + 1) * count,
        times=flat[:, 2].copy(),
        values=flat[:, 3].copy(),
        kinds=np.full(len(flat), SegmentKind.BEZIER),
        ins=flat[:, :2] - flat[:, 2:4],
        outs=flat[:, 4:] - flat[:, 2:4],
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


def timed(route: Callable[[], Array], runs: int) -> tuple[list[float], Array]:
    """Return the seconds of each run behind a warm-up, and the values."""
    values = route()
    seconds = []
    for _ in range(runs):
        began = time.perf_counter()
        values = route()
        seconds.append(time.perf_counter() - began)
    return seconds, values


def measure(options: argparse.Namespace) -> list[Row]:
    """Time every route and compare a sample of its values with 50 digits."""
    keys = make_keys(options.channels, options.keys, options.frames)
    frames = np.arange(options.frames, dtype=np.float64)
    curves, splines = as_curves(keys), as_splines(keys)
    rng = np.random.default_rng(SEED)
    places = [rng.integers(n, size=options.samples) for n in keys.shape[:1]]
    places.append(rng.integers(options.frames, size=options.samples))
    wanted = [truth(keys[c], float(f)) for c, f in zip(*places, strict=True)]
    listed = frames.tolist()
    routes: dict[str, Callable[[], Array]] = {
        "animtool": lambda: evaluate(curves, frames),
        "np.interp (straight lines)": lambda: np.array(
            [np.interp(frames, rows[:, 2], rows[:, 3]) for rows in keys]
        ),
        "Ts, Spline.Eval": lambda: np.array(
            [[spline.Eval(t) for t in listed] for spline in splines]
        ),
    }
    found = {}
    for name, route in routes.items():
        slow = name.startswith("Ts")
        found[name] = timed(route, 2 if slow else options.runs)
        print(f"  {name}: {statistics.median(found[name][0]):.4f} s", file=sys.stderr)
    if options.bpy_python:
        found["Blender, convert_to_samples"] = blender(options, keys)
    else:
        print("  Blender skipped: no --bpy-python", file=sys.stderr)
    bounds = {"Ts, Spline.Eval": 5.0, "Blender, convert_to_samples": 1.2}
    own = statistics.median(found["animtool"][0])
    rows = []
    for name, (seconds, values) in found.items():
        ratio = statistics.median(seconds) / own
        bound = Wanted(True, bounds[name]) if name in bounds else None
        rows.append(Row(SECTION, name, TIME, seconds))
        speeds = [values.size / 1e6 / second for second in seconds]
        rows.append(Row(SECTION, name, SPEED, speeds))
        rows.append(Row(SECTION, name, RATIO, [ratio], bound))
        if not name.startswith("np.interp"):
            error = float(np.abs(values[tuple(places)] - wanted).max())
            rows.append(Row(SECTION, name, ERROR, [error]))
    return rows


def blender(options: argparse.Namespace, keys: Array) -> tuple[list[float], Array]:
    """Time Blender in its own interpreter."""
    with tempfile.TemporaryDirectory(prefix="animtool-bench-") as folder:
        source, output = Path(folder, "keys.npy"), Path(folder, "values.npy")
        np.save(source, keys)
        script = str(HERE / "peers" / "blender_curves.py")
        command = [options.bpy_python, script, str(source), str(output)]
        command += [str(options.frames), str(options.runs)]
        seconds = run(command).report["seconds"]
        return seconds, np.load(output)


def parser() -> argparse.ArgumentParser:
    """Return the options."""
    made = argparse.ArgumentParser(
        description=__doc__.splitlines()[0] if __doc__ else None,
        formatter_class=argparse.ArgumentDefaultsHelpFormatter,
    )
    add = made.add_argument
    add("--channels", type=int, default=200)
    add("--keys", type=int, default=50, help="of each channel")
    add("--frames", type=int, default=5000)
    add("--runs", type=int, default=7, help="runs of each route; the median counts")
    add("--samples", type=int, default=300, help="values compared with 50 digits")
    add("--bpy-python", help="interpreter with bpy; without it Blender is skipped")
    add("--csv", type=Path, default=HERE / "results" / "curves.csv")
    return made


def main() -> None:
    """Measure, print the table, write the CSV."""
    options = parser().parse_args()
    about = machine(
        (sys.executable, ["animtool", "usd-core", "numpy"]),
        (options.bpy_python, ["bpy", "numpy"]),
    )
    about.append(
        f"{options.channels} channels, {options.keys} keys, {options.frames} frames"
    )
    rows = measure(options)
    print("\n".join([*about, "", *table(rows), "", *verdicts(rows)]))
    write_csv(options.csv, about, rows)


if __name__ == "__main__":
    main()
