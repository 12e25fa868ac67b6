"""How fast markers are solved, and how far off they are, beside OpenSim's IK tool.

Both get the same skeleton and the same markers: the clouds as observed, and without
what is wrong in them (spikes, swapped labels), as OpenSim's tool takes every marker
for right. See README.md beside this file.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import tempfile
from pathlib import Path

import numpy as np
from clock import Taken
from figures import Accuracy, Bound, Row, ratio_rows, time_rows
from measuring import HERE, begin, in_turn, on_one_thread, parser, run, taken_of

OWN, OPENSIM = "animtool", "OpenSim IK tool"
FASTEST = Bound(at_least=True, bound=400.0)
FASTER = Bound(at_least=True, bound=1.0)
ERROR = "markers to truth, RMS [mm]"
# What is farther from the truth is wrong, not noise [m].
WRONG = 0.015


def case(folder: Path, stem: str, *, cleaned: bool) -> tuple[Path, np.ndarray]:
    """Write a case for the tools; its file, and the true markers [m]."""
    data = Path(os.environ["ANIMTOOL_DATA"]) / "mocap"
    truth = json.loads((data / f"{stem}.truth.json").read_text("utf-8"))
    with np.load(data / f"{stem}.npz") as arrays:
        positions = arrays["markers_mm"].astype(np.float64) / 1000
        fps = int(arrays["fs"])
    with np.load(data / f"{stem}.truth.npz") as arrays:
        true = arrays["markers_mm"].astype(np.float64) / 1000
    if cleaned:
        away = np.linalg.norm(positions - true, axis=2)
        positions[away > WRONG] = np.nan
    path = folder / f"{stem}-{cleaned}.npz"
    text = json.dumps(truth["skeleton"])
    np.savez(path, skeleton=text, fps=fps, positions=positions)
    return path, true


def measure(
    options: argparse.Namespace, stem: str, folder: Path, *, cleaned: bool
) -> list[Row]:
    """Time both tools in turn on a cloud, and return their rows."""
    path, true = case(folder, stem, cleaned=cleaned)
    peers = HERE / "peers"
    commands = {OWN: [sys.executable, str(peers / "mocap_solve_animtool.py")]}
    if options.peers_python:
        script = str(peers / "mocap_solve_opensim.py")
        commands[OPENSIM] = [options.peers_python, script]
    found: dict[str, np.ndarray] = {}

    def route(tool: str) -> Taken:
        out = folder / f"{path.stem}-{list(commands).index(tool)}.npy"
        environment = ["env", f"PYTHONPATH={HERE}"]
        report = run([*environment, *commands[tool], str(path), str(out)]).report
        found[tool] = np.load(out)
        return taken_of(report)[0]

    taken = in_turn(
        {tool: lambda tool=tool: route(tool) for tool in commands}, options.runs
    )
    frames = len(true)
    what = "without wrong markers" if cleaned else "as observed"
    section = f"{stem}, {frames} frames, {what}"
    errors = {
        tool: 1000 * float(np.sqrt(((each - true) ** 2).sum(axis=2).mean()))
        for tool, each in found.items()
    }
    rows: list[Row] = []
    for tool in commands:
        rows += time_rows(section, tool, taken[tool])
        speeds = [frames / one.cpu for one in taken[tool]]
        bound = FASTEST if tool == OWN else None
        rows.append(Row(section, tool, "frames / CPU s", speeds, bound))
        most = errors.get(OPENSIM)
        wanted = (
            Bound(at_least=False, bound=most)
            if tool == OWN and most is not None
            else None
        )
        rows.append(Row(section, tool, ERROR, [errors[tool]], wanted))
        if tool != OWN:
            held = Bound(at_least=False, bound=1000 * WRONG)
            near = [Accuracy(ERROR, errors[tool], held)]
            rows += ratio_rows(
                *(section, tool, taken[tool], taken[OWN]), wanted=FASTER, accuracy=near
            )
    return rows


def main() -> None:
    """Measure, print the tables, write the CSV."""
    made = parser(__doc__, "mocap_solve.csv", runs=3)
    made.add_argument("--peers-python", help="interpreter with opensim")
    options = made.parse_args()
    on_one_thread()
    session = begin(
        options,
        (sys.executable, ["animtool", "numpy"]),
        (options.peers_python, ["opensim", "numpy"]),
    )
    data = Path(os.environ["ANIMTOOL_DATA"]) / "mocap"
    paths = sorted(data.glob("cloud_*.truth.json"))
    stems = [path.name.removesuffix(".truth.json") for path in paths]
    rows: list[Row] = []
    with tempfile.TemporaryDirectory() as folder:
        for stem in stems:
            for cleaned in (True, False):
                rows += measure(options, stem, Path(folder), cleaned=cleaned)
    session.finish(options.csv, rows)


if __name__ == "__main__":
    main()
