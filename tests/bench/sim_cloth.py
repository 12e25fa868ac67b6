"""How fast a cape on a fast dance and a rope are simulated, and how they lie.

The biped dances in its cape for 72 frames, and in a cycle; a rope swings for ten
seconds. See README.md beside this file.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from clock import now, since
from figures import Bound, Clock, Row
from measuring import ROOT, begin, parser

import animtool
from animtool.motion.motion import Motion
from animtool.motion.passes import PassContext
from animtool.motion.take import Take, TakeStream
from animtool.rig.file import load_rig
from animtool.systems.attach.settings import SimulateOptions
from animtool.systems.attach.take_pass import simulate
from animtool.systems.springs import (
    Family,
    Pins,
    SpringSystem,
    rope,
    simulate_springs,
)

FRAMES = 72
CPU = "CPU [s]"
# Of a cape: what is allowed at most.
BOUNDS = {
    CPU: 20.0,
    "pierced pairs": 0.0,
    "depth in the skin [mm]": 2.0,
    "strain, 99th percentile [%]": 8.0,
    "strain, largest [%]": 15.0,
}
PARTICLES, SECONDS = 200, 10


def dance(frames: int) -> Take:
    """Return the dance on the biped; it repeats every two seconds."""
    take = animtool.open_source(ROOT / "samples/dance/dance.clip.yaml").collect()
    motion, count = take.motion, take.clock.count
    repeated = Motion.concatenate([motion] * -(-frames // count))
    return replace(
        take,
        rig=load_rig(ROOT / "rigs/biped/biped.rig.yaml"),
        clock=replace(take.clock, count=frames),
        motion=repeated.select(slice(0, frames)),
    )


def cape(take: Take, **options: Any) -> dict[str, float]:
    """Return what one run took, and the worst of all frames."""
    began = now()
    context = PassContext(lambda _: take, ROOT)
    asked = SimulateOptions(("cape",), **options)
    stream = simulate(TakeStream.of(take), asked, context)
    for _ in stream.blocks:
        pass
    taken = since(began)
    (report,) = stream.simulated
    return {
        CPU: taken.cpu,
        "pierced pairs": report["pierced"]["value"],
        "depth in the skin [mm]": 1e3 * report["depth"]["value"],
        "strain, 99th percentile [%]": 100 * report["strain_99"]["value"],
        "strain, largest [%]": 100 * report["strain"]["value"],
    }


def swing() -> dict[str, float]:
    """Return what a rope that swings took, by the solver that it chooses."""
    line = rope(
        [0, 0, 0], [3, 0, -1], PARTICLES, Family(axial_stiffness=5000, ratio=0.1),
        mass=1 / PARTICLES,
    )  # fmt: skip
    system, began = SpringSystem(line, pins=Pins([0])), now()
    motion = simulate_springs(system, np.arange(24 * SECONDS + 1) / 24)
    lengths = np.linalg.norm(np.diff(motion.positions, axis=1), axis=2)
    return {
        CPU: since(began).cpu,
        "strain, largest [%]": 100 * float((lengths / line.springs.rest).max() - 1),
    }


def rows_of(
    section: str, tool: str, runs: list[dict[str, float]], bounds: Mapping[str, float]
) -> list[Row]:
    """Return the rows of some runs."""
    return [
        Row(
            section,
            tool,
            measure,
            [one[measure] for one in runs],
            Bound(at_least=False, bound=bounds[measure]) if measure in bounds else None,
            Clock.CPU if measure == CPU else Clock.NONE,
        )
        for measure in runs[0]
    ]


def main() -> None:
    """Measure, print the tables, write the CSV."""
    options = parser(__doc__, "sim_cloth.csv", runs=3).parse_args()
    session = begin(options, (sys.executable, ["animtool", "numpy"]))
    long, cycle = dance(FRAMES), dance(48)
    points = f"cape of 775 points, {FRAMES} frames"
    runs = [cape(long) for _ in range(options.runs)]
    rows = rows_of(points, "simulate", runs, BOUNDS)
    loops = [cape(cycle, loop=True, loop_repeats=2)]
    lies = {name: bound for name, bound in BOUNDS.items() if name != CPU}
    rows += rows_of("cape in a cycle, 2 repeats", "simulate", loops, lies)
    swings = [swing() for _ in range(options.runs)]
    name = f"rope of {PARTICLES} particles, {SECONDS} s"
    rows += rows_of(name, "simulate_springs", swings, {})
    session.finish(options.csv, rows)


if __name__ == "__main__":
    main()
