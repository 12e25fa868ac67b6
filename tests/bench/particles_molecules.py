"""How fast argon is stepped, beside LAMMPS and OpenMM, and time against error.

See README.md beside this file.
"""

from __future__ import annotations

import argparse
import math
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from figures import Accuracy, Bound, Clock, Row, ratio_rows, time_rows
from measuring import begin, draw, on_one_thread, parser, run_peer, taken_of

# Of the melt that LAMMPS is measured by: density, temperature, cut-off, skin and step.
DENSITY, TEMPERATURE, CUTOFF, SKIN, STEP = 0.8442, 1.44, 2.5, 0.3, 0.005
SIGMA, EPSILON, MASS, BOLTZMANN = 0.3405, 0.9961, 39.948, 0.00831446
TIME = SIGMA * math.sqrt(MASS / EPSILON)  # [ps]
OWN, LAMMPS, OPENMM = "animtool", "LAMMPS", "OpenMM, CPU platform"
ROUTES = {
    OWN: "molecules_animtool.py",
    LAMMPS: "molecules_lammps.py",
    OPENMM: "molecules_openmm.py",
}
POTENTIAL = "error of the first energy"
SAME = Bound(at_least=False, bound=1e-4)
# A peer may take 1/1.5 of our time, or must take longer.
WANTED = {
    LAMMPS: Bound(at_least=True, bound=1 / 1.5),
    OPENMM: Bound(at_least=True, bound=1.0),
}
METHODS = ("symplectic_euler", "velocity_verlet", "position_verlet", "rk4")


def ask(folder: Path, count: int, warm: int, step: float, switch: float) -> Path:
    """Write what all tools are asked for; sizes in nm, ps and K."""
    path = folder / f"{count}_{step:g}_{switch:g}.npz"
    side = (count / DENSITY) ** (1 / 3) * SIGMA
    np.savez(
        path,
        count=count,
        box=np.full(3, side),
        cutoff=CUTOFF * SIGMA,
        switch=switch * CUTOFF * SIGMA,
        skin=SKIN * SIGMA,
        temperature=TEMPERATURE * EPSILON / BOLTZMANN,
        dt=step * TIME,
        warm=warm,
    )
    return path


def measure(options: argparse.Namespace, count: int, folder: Path) -> list[Row]:
    """Time every tool in turn on a melt of some atoms."""
    source = ask(folder, count, options.warm, STEP, 1.0)
    steps = max(options.work // count, 10)
    reports: dict[str, dict[str, Any]] = {}
    for name, script in ROUTES.items():
        python = sys.executable if name == OWN else options.peer_python
        if not python or (name != OWN and count > options.peers_to):
            continue
        print(f"  {count}: {name}", file=sys.stderr)
        reports[name] = run_peer(python, script, source, options.runs, steps)
    rows, section = [], f"{count} atoms"
    own = reports[OWN]
    for name, report in reports.items():
        taken = taken_of(report)
        rows += time_rows(section, name, taken, unit="ns/atom", per=steps * count)
        rows.append(Row(section, name, "temperature [K]", [report["temperature"]]))
        if name == OWN:
            rows.append(Row(section, name, "drift of energy", [report["drift"]]))
            continue
        error = abs(report["potential"] / own["potential"] - 1)
        rows.append(Row(section, name, POTENTIAL, [error], SAME))
        rows += ratio_rows(
            section, name, taken, taken_of(own), wanted=WANTED[name],
            accuracy=[Accuracy(POTENTIAL, error, SAME)],
        )  # fmt: skip
    return rows


def methods(folder: Path) -> list[Row]:
    """Return time against the drift of energy of methods and steps, of 500 atoms."""
    rows = []
    span = 2.0  # in units of the time of argon
    for method in METHODS:
        for step in (0.01, 0.005, 0.0025):
            source = ask(folder, 500, 100, step, 0.9)
            report = run_peer(
                sys.executable, ROUTES[OWN], source, 1, round(span / step), method
            )
            tool = f"{method}, {step:g}"
            rows += time_rows("methods", tool, taken_of(report))
            rows.append(Row("methods", tool, "drift of energy", [report["drift"]]))
    return rows


def growth(rows: list[Row], counts: list[int]) -> list[Row]:
    """Return the exponent that a step grows with, from the least to the most atoms."""
    each = [
        count * row.median
        for count in (counts[0], counts[-1])
        for row in rows
        if (row.section, row.tool, row.measure)
        == (f"{count} atoms", OWN, "CPU [ns/atom]")
    ]
    exponent = math.log(each[1] / each[0]) / math.log(counts[-1] / counts[0])
    return [Row("growth", OWN, "exponent of CPU time", [exponent], None, Clock.CPU)]


def main() -> None:
    """Measure, print the tables, write the CSV."""
    made = parser(__doc__, "particles_molecules.csv", runs=3)
    add = made.add_argument
    add("--peer-python", help="interpreter with lammps and openmm")
    add("--counts", type=int, nargs="+", default=[864, 4000, 32000, 256000, 1048576])
    add("--peers-to", type=int, default=32000, help="most atoms of peers")
    add("--warm", type=int, default=100, help="steps before")
    add("--work", type=int, default=2 * 10**6, help="atoms times steps of a run")
    add("--methods", action=argparse.BooleanOptionalAction, default=True)
    options = made.parse_args()
    on_one_thread()
    session = begin(
        options,
        (sys.executable, ["animtool", "numpy"]),
        (options.peer_python, ["lammps", "openmm", "numpy"]),
    )
    rows: list[Row] = []
    with tempfile.TemporaryDirectory() as folder:
        for count in options.counts:
            rows += measure(options, count, Path(folder))
        if options.methods:
            rows += methods(Path(folder))
    if len(options.counts) > 1:
        rows += growth(rows, options.counts)
    session.finish(options.csv, rows)
    draw(sys.executable, options.csv, "drift of energy")


if __name__ == "__main__":
    main()
