"""Draw the rope of this folder from the side: the frames of two swings, one on another.

Usage: ``python make_picture.py [OUT]``; ``OUT`` is ``rope.png`` here unless given.
Needs matplotlib.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pxr import Usd, UsdGeom

sys.path.append(str(Path(__file__).parents[1] / "pictures"))

from labelled import make_picture, save

HERE = Path(__file__).parent

Array = NDArray[np.float64]

# Frames of each drawing; those that are named are drawn in full.
SWINGS = (
    (
        "the trolley runs and stops",
        range(1, 53, 3),
        (1, 16, 28, 34, 43, 52),
    ),
    ("back again", range(52, 91, 3), (52, 61, 67, 76, 88)),
)
BEAM, TROLLEY, RAIL, ROPE, FLAME = "#59616b", "#d99926", "#8b9199", "#4a3423", "#e8a020"


def trolley_at(stage: Usd.Stage, frame: float) -> float:
    """Return where the trolley is along its beam [m]."""
    prim = UsdGeom.Xformable(stage.GetPrimAtPath("/World/trolley"))
    return float(prim.ComputeLocalToWorldTransform(frame).ExtractTranslation()[0])


def draw_crane(axis: Any, stage: Usd.Stage, frames: tuple[int, ...]) -> None:
    """Draw beam and rail, and the trolley where it is in some frames."""
    import matplotlib.pyplot as plt

    axis.add_patch(plt.Rectangle((-2.2, 3.1), 3.4, 0.12, color=BEAM))
    axis.add_patch(plt.Circle((0.4, 2.0), 0.05, color=RAIL, zorder=4))
    for place in sorted({round(trolley_at(stage, frame), 2) for frame in frames}):
        corner = (place - 0.12, 3.0)
        box = plt.Rectangle(corner, 0.24, 0.1, fc=TROLLEY, ec="white", alpha=0.75)
        axis.add_patch(box)


def draw_rope(axis: Any, points: Array, frame: int, *, named: bool) -> None:
    """Draw the rope ``(N, 3)`` and its lantern in a frame, faint where not named."""
    strength = 1.0 if named else 0.22
    axis.plot(*points.T[:2], color=ROPE, lw=1.8 if named else 1.0, alpha=strength)
    x, y, _ = points[-1]
    axis.scatter(x, y, s=150, color=FLAME, ec=ROPE, alpha=strength, zorder=3)
    if named:
        axis.annotate(str(frame), (x, y - 0.13), ha="center", va="top", fontsize=9)


def draw(baked: Path, out: Path) -> None:
    """Write the picture of a bake."""
    import matplotlib as mpl

    mpl.use("Agg")
    import matplotlib.pyplot as plt

    stage = Usd.Stage.Open(str(baked))
    curves = UsdGeom.BasisCurves(stage.GetPrimAtPath("/rope/rope"))
    points = {
        frame: np.array(curves.GetPointsAttr().Get(frame), np.float64)
        for _, frames, _ in SWINGS
        for frame in frames
    }
    crane = Usd.Stage.Open(str(HERE / "crane.usda"))
    figure, axes = plt.subplots(1, 2, figsize=(11, 4.9), dpi=96, layout="constrained")
    for axis, (title, frames, named) in zip(axes, SWINGS, strict=True):
        draw_crane(axis, crane, named)
        for frame in frames:
            draw_rope(axis, points[frame], frame, named=frame in named)
        axis.set(xlim=(-2.2, 1.6), ylim=(0.4, 3.3), aspect="equal", title=title)
        axis.set(xticks=[], yticks=[], facecolor="#dbe0e5")
        axis.spines[:].set_visible(False)
    save(figure, out)


if __name__ == "__main__":
    make_picture(HERE / "rope.scene.yaml", draw, *map(Path, sys.argv[1:2]))
