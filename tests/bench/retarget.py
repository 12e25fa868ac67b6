"""How fast a walk goes onto other rigs, and what its feet do, beside other tools.

A loop of mink has targets frame by frame, and three.js its `retargetClip`; see
README.md beside this file.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from clock import Taken
from figures import Accuracy, Bound, Row, ratio_rows, time_rows
from measuring import HERE, begin, in_turn, on_one_thread, parser, run, taken_of
from retarget_case import case_of, measures

OWN, MINK, THREE = "animtool", "mink", "three.js retargetClip"
BIPED = HERE.parents[1] / "rigs/biped/biped.rig.yaml"
TARGETS = ["child", "giant", "dwarf"]
FASTEST = Bound(at_least=True, bound=8000.0)
FASTER = Bound(at_least=True, bound=1.0)
# A tool whose feet slide further does other work.
HELD = Bound(at_least=False, bound=5.0)
DRIFT = "largest drift [mm]"
# Of each measure of a take, what animtool is to reach.
BOUNDS = {
    "mean drift [mm]": 0.2,
    DRIFT: 0.8,
    "largest sole height [mm]": 1.0,
    "acceleration / source [x]": 1.1,
}


@dataclass(frozen=True)
class Walk:
    """A take whose contacts are known.

    Attributes:
        take: A BVH file.
        contacts: When the left and the right foot stand ``(F, 2)``.
    """

    take: Path
    contacts: np.ndarray


def measure(
    options: argparse.Namespace, walk: Walk, target: Path, name: str, folder: Path
) -> list[Row]:
    """Time every tool in turn on one target, and return its rows."""
    case = case_of(walk.take, target)
    asked = folder / f"{name}.json"
    asked.write_text(json.dumps(case.lists()), "utf-8")
    peers = HERE / "peers"
    commands = {
        OWN: [sys.executable, str(peers / "retarget_animtool.py"), walk.take, target],
        MINK: [options.peers_python, str(peers / "retarget_mink.py"), asked],
        THREE: ["node", str(peers / "retarget_three.mjs"), asked, options.three],
    }
    left_out = {MINK: not options.peers_python, THREE: not options.three}
    results: dict[str, np.ndarray] = {}

    def route(tool: str) -> Taken:
        out = folder / f"{name}-{list(commands).index(tool)}.json"
        environment = ["env", f"PYTHONPATH={HERE}"]
        command = [*environment, *map(str, commands[tool]), str(out)]
        report = run(command).report
        results[tool] = np.array(json.loads(out.read_text("utf-8")), np.float64)
        return taken_of(report)[0]

    tools = [tool for tool in commands if not left_out.get(tool)]
    taken = in_turn(
        {tool: lambda tool=tool: route(tool) for tool in tools}, options.runs
    )
    frames = len(walk.contacts)
    section = f"{walk.take.stem} onto {name}, {frames} frames"
    rows: list[Row] = []
    for tool in tools:
        own = tool == OWN
        rows += time_rows(section, tool, taken[tool])
        speeds = [frames / one.cpu for one in taken[tool]]
        bound = FASTEST if own and name == "biped" else None
        rows.append(Row(section, tool, "frames / CPU s", speeds, bound))
        values = measures(case, walk.contacts, results[tool])
        for title, value in values.items():
            most = BOUNDS.get(title) if own else None
            bound = None if most is None else Bound(at_least=False, bound=most)
            rows.append(Row(section, tool, title, [value], bound))
        if not own:
            near = [Accuracy(DRIFT, values[DRIFT], HELD)]
            rows += ratio_rows(
                *(section, tool, taken[tool], taken[OWN]), wanted=FASTER, accuracy=near
            )
    return rows


def main() -> None:
    """Measure, print the tables, write the CSV."""
    made = parser(__doc__, "retarget.csv", runs=3)
    made.add_argument("--peers-python", help="interpreter with mink and mujoco")
    made.add_argument("--three", help="folder of the package three, for node")
    made.add_argument("--targets", nargs="+", default=[*TARGETS, "biped"])
    options = made.parse_args()
    on_one_thread()
    notes = []
    if options.three:
        package = json.loads((Path(options.three) / "package.json").read_text("utf-8"))
        node = run(["node", "-p", "JSON.stringify({v: process.version})"]).report["v"]
        notes.append(f"three {package['version']}, node {node}")
    session = begin(
        options,
        (sys.executable, ["animtool", "numpy"]),
        (options.peers_python, ["mink", "mujoco", "daqp", "numpy"]),
        notes=notes or ["left out, no folder was given: three"],
    )
    data = Path(os.environ["ANIMTOOL_DATA"]) / "mocap"
    with np.load(data / "ret_a.truth.npz") as truth:
        walk = Walk(data / "ret_a.source.bvh", truth["contacts"])
    rows: list[Row] = []
    with tempfile.TemporaryDirectory() as folder:
        for name in options.targets:
            other = data / f"ret_a.target_{name}.bvh"
            target = BIPED if name == "biped" else other
            rows += measure(options, walk, target, name, Path(folder))
    session.finish(options.csv, rows)


if __name__ == "__main__":
    main()
