"""Draw samples that are simulated, at some frames.

Usage: ``python simulated.py NAME [OUT]``; ``OUT`` is ``NAME.png`` in the folder of the
sample unless given. Needs matplotlib.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from functools import partial
from pathlib import Path

from bodies import View, draw_frames
from clouds import draw_clouds
from labelled import make_picture

SAMPLES = Path(__file__).parents[1]
# By the name of a sample, what draws a bake of its scene.
DRAWN: dict[str, Callable[[Path, Path], None]] = {
    "argon": partial(
        draw_clouds,
        path="/argon/atoms",
        frames=(1, 50, 80, 120),
        view=(0.5, 0.35, 3.3),
    ),
    "dominoes": partial(
        draw_frames,
        path="/dominoes/row",
        frames=(1, 24, 40, 72),
        view=View(0.5, 0.7),
        colours=["#c96f3b", "#5b6770"],
        limits=((-0.3, 0.55), (-0.42, 0.12)),
        columns=2,
    ),
    "galaxies": partial(
        draw_clouds,
        path="/galaxies/stars",
        frames=(1, 36, 56, 80),
        view=(0.4, 0.9, 5.2),
    ),
    "swing": partial(
        draw_frames,
        path="/swing/lanterns",
        frames=(1, 4, 7, 10, 13, 17, 21, 25, 29, 34, 40, 46),
        view=View(0.35, 0.15),
        colours=["#c98f3b"],
        limits=((-1.35, 1.35), (0.3, 2.3)),
        columns=4,
        cord="/swing/cord",
    ),
    "wingnut": partial(
        draw_frames,
        path="/wingnut/nut",
        frames=range(58, 94, 5),
        view=View(0.5, 0.3),
        colours=["#8f9aa8"],
        limits=((-0.11, 0.11), (0.17, 0.41)),
        columns=4,
    ),
    "wrecking_ball": partial(
        draw_frames,
        path="/wrecking_ball/yard",
        frames=(1, 24, 30, 40),
        view=View(-0.9, 0.25),
        colours=["#6b7078"] * 6 + ["#3d434b", "#b5673a"],
        limits=((-4.2, 4.2), (-1.4, 5.6)),
        columns=2,
    ),
}


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("name", choices=DRAWN)
    parser.add_argument("out", type=Path, nargs="?")
    options = parser.parse_args()
    scene = SAMPLES / options.name / f"{options.name}.scene.yaml"
    make_picture(scene, DRAWN[options.name], options.out)
