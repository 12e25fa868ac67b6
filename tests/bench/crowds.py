"""How fast agents cross each other, beside pyrvo and jupedsim, and are written.

A thousand in four streams, 250 each: see README.md beside this file.
"""

from __future__ import annotations

import argparse
import math
import sys
import tempfile
from pathlib import Path

import numpy as np
from clock import Taken
from figures import Accuracy, Bound, Clock, Row, ratio_rows, time_rows
from measuring import begin, in_turn, on_one_thread, parser, run_peer, taken_of

SAMPLE = Path(__file__).parents[2] / "samples" / "crowd" / "square.scene.yaml"
RADIUS, STEP, SPEED, SEED = 0.25, 0.05, 1.4, 1
# From agent to agent, and from the middle to the first of each stream [m].
APART, GAP = 1.25, 10.0
# What two agents may be in each other [m].
TOUCHING = 0.01
OVERLAP, PROGRESS = "largest overlap [m]", "mean progress [m]"
FRAMES = "frames with an overlap above 1 cm [%]"
NONE = Bound(at_least=False, bound=TOUCHING)
FAR = Bound(at_least=True, bound=20)
TWICE = Bound(at_least=True, bound=2)
OWN, USUAL = "animtool, headway .4 s", "animtool"
ROUTES = {
    OWN: ("crowds_animtool.py", "0.4"),
    USUAL: ("crowds_animtool.py",),
    "pyrvo": ("crowds_pyrvo.py", "0"),
    "pyrvo, 3 cm safety": ("crowds_pyrvo.py", "0.03"),
    "jupedsim": ("crowds_jupedsim.py",),
}


def streams(count: int, seconds: float) -> dict[str, np.ndarray]:
    """Return starts, goals and speeds of four streams that meet in the middle."""
    rng = np.random.default_rng(SEED)
    own = count // 4
    wide = max(10, round(10 * math.sqrt(count / 1000)))
    k = np.arange(own)
    across, along = (k % wide - (wide - 1) / 2) * APART, -GAP - (k // wide) * APART
    starts, goals = [], []
    for way in np.array([[1.0, 0], [0, 1], [-1, 0], [0, -1]]):
        side = np.array([-way[1], way[0]])
        place = along[:, None] * way + across[:, None] * side
        place += rng.uniform(-0.1, 0.1, (own, 2))
        starts.append(place)
        goals.append(place + 200 * way)
    return {
        "starts": np.concatenate(starts),
        "goals": np.concatenate(goals),
        "speeds": np.full(4 * own, SPEED),
        "radius_step_steps_most": np.array(
            [RADIUS, STEP, round(seconds / STEP), 1.3 * SPEED]
        ),
    }


def judged(arrays: dict[str, np.ndarray], track: np.ndarray) -> tuple[float, ...]:
    """Return the largest overlap [m], frames with one [%], and mean progress [m]."""
    from scipy.spatial import cKDTree

    worst = []
    for places in track:
        pairs = cKDTree(places).query_pairs(2 * RADIUS, output_type="ndarray")
        far = np.linalg.norm(places[pairs[:, 0]] - places[pairs[:, 1]], axis=1)
        worst.append(float((2 * RADIUS - far).max(initial=0.0)))
    ways = arrays["goals"] - arrays["starts"]
    ways /= np.linalg.norm(ways, axis=1)[:, None]
    progress = ((track[-1] - track[0]) * ways).sum(axis=1).mean()
    share = 100 * float((np.array(worst) > TOUCHING).mean())
    return max(worst), share, float(progress)


def measure(options: argparse.Namespace, folder: Path) -> list[Row]:
    """Time every route in turn on a thousand agents."""
    arrays = streams(1000, 20.0)
    source, output = folder / "streams.npz", folder / "track.npy"
    np.savez(source, **arrays)
    found: dict[str, tuple[float, ...]] = {}

    def route(name: str) -> Taken:
        script, *how = ROUTES[name]
        own = script == "crowds_animtool.py"
        python = sys.executable if own else options.peer_python
        report = run_peer(python, script, source, options.repeats, output, *how)
        found[name] = judged(arrays, np.load(output))
        return min(taken_of(report), key=lambda taken: taken.cpu)

    names = [n for n in ROUTES if options.peer_python or n.startswith("animtool")]
    taken = in_turn({n: lambda n=n: route(n) for n in names}, options.runs)
    section, rows = "1000 agents, 20 s", []
    for name in names:
        overlap, share, progress = found[name]
        rows += time_rows(section, name, taken[name])
        wanted = (NONE, FAR) if name == OWN else (None, None)
        rows.append(Row(section, name, OVERLAP, [overlap], wanted[0]))
        rows.append(Row(section, name, FRAMES, [share]))
        rows.append(Row(section, name, PROGRESS, [progress], wanted[1]))
        if not name.startswith("animtool"):
            near = [Accuracy(OVERLAP, overlap, NONE)] if "safety" in name else []
            rows += ratio_rows(
                section, name, taken[name], taken[OWN], wanted=TWICE, accuracy=near
            )
    return rows


def growth(options: argparse.Namespace, folder: Path) -> list[Row]:
    """Return how times grow with the number of agents."""
    rows, medians = [], []
    for count in options.counts:
        source = folder / f"{count}.npz"
        np.savez(source, **streams(count, 5.0))

        def route(source: Path = source) -> Taken:
            script, output = "crowds_animtool.py", folder / "track.npy"
            report = run_peer(sys.executable, script, source, 1, output)
            return taken_of(report)[0]

        taken = in_turn({USUAL: route}, options.runs)[USUAL]
        rows += time_rows(f"{count} agents, 5 s", USUAL, taken)
        medians.append(sorted(one.cpu for one in taken)[len(taken) // 2])
    least, most = options.counts[0], options.counts[-1]
    exponent = math.log(medians[-1] / medians[0]) / math.log(most / least)
    bound = Bound(at_least=False, bound=1.15)
    row = Row("growth", USUAL, "exponent of CPU time", [exponent], bound, Clock.CPU)
    return [*rows, row]


def layer(options: argparse.Namespace, folder: Path) -> list[Row]:
    """Return how long the characters of the sample take to be written."""
    report = run_peer(sys.executable, "crowds_layer.py", SAMPLE, options.runs, folder)
    section, written = "layer of 200 characters, 20 s", taken_of(report)
    alone, whole = taken_of(report, "alone"), taken_of(report, "whole")
    rows = time_rows(section, "simulated", taken_of(report, "simulated"))
    rows += time_rows(section, "written", written)
    rows += time_rows(section, "all poses alone", whole)
    rows += time_rows(section, "what is left of them alone", alone)
    rows += ratio_rows(
        section, "written", written, whole, name="all poses",
        wanted=Bound(at_least=False, bound=3),
    )  # fmt: skip
    rows += ratio_rows(section, "written", written, alone, name="what is left")
    size = Bound(at_least=False, bound=20)
    rows.append(Row(section, "written", "size [MB]", [report["bytes"] / 1e6], size))
    for name, unit in (
        ("error", "joint, off [m]"),
        ("slide", "standing foot, off [m]"),
    ):
        rows.append(Row(section, "written", unit, [report[name]]))
    return rows


def main() -> None:
    """Measure, print the tables, write the CSV."""
    made = parser(__doc__, "crowds.csv", runs=3)
    made.add_argument("--peer-python", help="interpreter with pyrvo and jupedsim")
    made.add_argument("--counts", type=int, nargs="+", default=[1000, 4000, 20_000])
    made.add_argument("--repeats", type=int, default=2, help="of each process")
    options = made.parse_args()
    on_one_thread()
    session = begin(
        options,
        (sys.executable, ["animtool", "numpy"]),
        (options.peer_python, ["pyrvo", "jupedsim", "numpy"]),
    )
    with tempfile.TemporaryDirectory() as folder:
        rows = measure(options, Path(folder))
        rows += growth(options, Path(folder))
        rows += layer(options, Path(folder))
    session.finish(options.csv, rows)


if __name__ == "__main__":
    main()
