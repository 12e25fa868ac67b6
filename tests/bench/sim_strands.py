"""How fast hair on a walking character is simulated, and what bounds it.

The biped of `rigs` walks with 1000 strands of 32 points in place of its ponytail, out
of all of its capsules; see README.md beside this file.
"""

from __future__ import annotations

import sys
import time
from dataclasses import replace
from typing import Any

import numpy as np
from clock import now, since
from figures import Bound, Clock, Row
from measuring import ROOT, begin, parser

import animtool
from animtool import _kernels
from animtool.motion.passes import PassContext
from animtool.motion.take import Take, TakeStream
from animtool.rig.file import load_rig
from animtool.rig.parts import LoadedArray
from animtool.rig.skeleton import Rig
from animtool.systems.attach.actor import cells_and_substeps
from animtool.systems.attach.settings import SimulateOptions
from animtool.systems.attach.take_pass import simulate

STRANDS, POINTS = 1000, 32
SECTION = f"{STRANDS} strands of {POINTS} points, {{}} capsules"
# Of a strand in a step: lengths, folds, and draws to the animation.
CONSTRAINTS = (POINTS - 1) + (POINTS - 2) + (POINTS - 1)
# Roots and quotients of a length and a fold, which nothing else in a step hides.
SLOW = {"sqrt": 2, "divide": 3}


def hair(rig: Rig, seed: int = 1) -> np.ndarray:
    """Return strands between those of the rig's ponytail ``(STRANDS, POINTS, 3)``."""
    (entry,) = [one for one in rig.attach if one.kind == "strands"]
    assert entry.points is not None
    given = entry.points.load()
    place = np.linspace(0, given.shape[1] - 1, POINTS)
    low = np.minimum(place.astype(int), given.shape[1] - 2)
    share = (place - low)[:, None]
    finer = given[:, low] * (1 - share) + given[:, low + 1] * share
    rng = np.random.default_rng(seed)
    one, other = rng.integers(0, len(given), (2, STRANDS))
    mixed = rng.random((STRANDS, 1, 1))
    made = finer[one] * (1 - mixed) + finer[other] * mixed
    # Strands that hang beside each other are worked on together.
    return np.asarray(made[np.argsort(made[:, -1, 0], kind="stable")])


def problem() -> Take:
    """Return the walk with the hair."""
    rig = load_rig(ROOT / "rigs/biped/biped.rig.yaml")
    take = animtool.open_source(ROOT / "samples/stride/stride.clip.yaml").collect()
    attach = tuple(
        replace(one, points=LoadedArray(hair(rig))) if one.kind == "strands" else one
        for one in rig.attach
    )
    return replace(take, rig=replace(rig, attach=attach))


class Spy:
    """Measures a kernel while it is used."""

    def __init__(self) -> None:
        self.seconds, self.steps = 0.0, 0
        self._kernel = _kernels.follow_strands

    def __call__(self, *given: Any) -> Any:
        """Do what the kernel does."""
        began = time.process_time()
        made = self._kernel(*given)
        self.seconds += time.process_time() - began
        self.steps += (len(given[1]) - 1) * given[4]
        return made


def once(take: Take, **options: Any) -> dict[str, float]:
    """Return what one run took, over the seconds that were simulated."""
    spy = Spy()
    _kernels.follow_strands = spy
    try:
        began = now()
        asked = SimulateOptions(what=("hair",), **options)
        context = PassContext(lambda _: take, ROOT)
        stream = simulate(TakeStream.of(take), asked, context)
        for _ in stream.blocks:
            pass
        taken = since(began)
    finally:
        _kernels.follow_strands = spy._kernel
    (report,) = stream.simulated
    simulated = spy.steps / report["steps"] / 24
    done = spy.steps * STRANDS
    return {
        "simulated / wall [x]": simulated / taken.wall,
        "simulated / CPU [x]": simulated / taken.cpu,
        "wall [s]": taken.wall,
        "CPU [s]": taken.cpu,
        "steps a second": report["steps"] * 24,
        "longest spring beyond rest [%]": 100 * report["stretch"],
        "particles in contact": report["contacts"],
        "constraints a second [million]": done * CONSTRAINTS / spy.seconds / 1e6,
        "a particle and step [ns]": 1e9 * spy.seconds / (done * POINTS),
    }


def slowest() -> float:
    """Return how long roots and quotients of a particle and step take at least [ns]."""
    a, b, out = np.random.default_rng(0).random((3, 1024)) + 1
    total = 0.0
    for name, count in SLOW.items():
        best, function = np.inf, getattr(np, name)
        given = (a,) if name == "sqrt" else (a, b)
        for _ in range(200):
            began = time.process_time()
            for _ in range(50):
                function(*given, out=out)
            best = min(best, (time.process_time() - began) / 50)
        total += 1e9 * count * best / len(a)
    return total


def floor(section: str, bare: list[float], steps: int) -> list[Row]:
    """Return what bounds the kernel, and how near to it it is without colliders.

    Args:
        section: Of the rows.
        bare: Times of a particle and step without colliders [ns].
        steps: In a frame.
    """
    # States are read and written once a frame, targets as each cell begins and ends.
    cells, _ = cells_and_substeps(steps)
    traffic = 3 * 8 * (4 + cells + 1) / (steps * CONSTRAINTS / POINTS)
    least = slowest()
    figures = {
        "roots and quotients, a particle and step [ns]": [least],
        "of the time without colliders [%]": [100 * least / value for value in bare],
        "memory read and written a constraint [B]": [traffic],
    }
    return [
        Row(section, "floor", name, values, clock=clock(name))
        for name, values in figures.items()
    ]


def clock(measure: str) -> Clock:
    """Return what a figure is timed by."""
    if "wall" in measure:
        return Clock.WALL
    timed = "CPU" in measure or measure.endswith(("[ns]", "[million]"))
    return Clock.CPU if timed else Clock.NONE


def main() -> None:
    """Measure, print the tables, write the CSV."""
    options = parser(__doc__, "sim_strands.csv", runs=5).parse_args()
    session = begin(options, (sys.executable, ["animtool", "numpy"]))
    take = problem()
    section = SECTION.format(len(take.rig.colliders))
    rows, bare = [], []
    for name, more in (("simulate", {}), ("without colliders", {"capsules": False})):
        once(take, **more)
        found = [once(take, **more) for _ in range(options.runs)]
        for measure in found[0]:
            wanted = None
            if name == "simulate" and measure == "simulated / wall [x]":
                wanted = Bound(at_least=True, bound=3.0)
            values = [one[measure] for one in found]
            rows.append(Row(section, name, measure, values, wanted, clock(measure)))
        bare = [one["a particle and step [ns]"] for one in found]
    rows += floor(section, bare, round(found[0]["steps a second"] / 24))
    session.finish(options.csv, rows)


if __name__ == "__main__":
    main()
