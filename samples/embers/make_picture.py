"""Draw the embers of this folder from the side: a frame, and the paths that led to it.

Usage: ``python make_picture.py [OUT]``; ``OUT`` is ``embers.png`` here unless given.
Needs matplotlib.
"""

from __future__ import annotations

import sys
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray
from pxr import Usd, UsdGeom

sys.path.append(str(Path(__file__).parents[1] / "pictures"))

from labelled import make_picture, save

HERE = Path(__file__).parent

Array = NDArray[np.float64]

FRAME, TRAIL = 40, 3
NIGHT, STONE, WORDS = "#15171c", "#3a3f4a", "#c8ccd4"
# Half the width of landing and steps [m].
WIDE = 1.0


def embers(stage: Usd.Stage, frame: float) -> tuple[Array, Array, Array, Array]:
    """Return ids, places, widths and ages, but of those that fell off aside."""
    prim = UsdGeom.Points(stage.GetPrimAtPath("/embers/embers"))
    age = UsdGeom.PrimvarsAPI(prim).GetPrimvar("age")
    attributes = (prim.GetIdsAttr(), prim.GetPointsAttr(), prim.GetWidthsAttr(), age)
    ids, points, widths, ages = (np.array(each.Get(frame)) for each in attributes)
    over = np.abs(points[:, 2]) < WIDE
    return ids[over], points[over], widths[over], ages[over]


def draw_stairs(axis: Any) -> None:
    """Draw the boxes that the scene names, from the side."""
    import matplotlib.pyplot as plt

    scene = yaml.safe_load((HERE / "embers.scene.yaml").read_text("utf-8"))
    for collider in scene["systems"][0]["particles"]["colliders"]:
        if "box" in collider["shape"]:
            width, height, _ = collider["shape"]["box"]["size"]
            x, y, _ = collider["at"]
            corner = (x - width / 2, y - height / 2)
            axis.add_patch(plt.Rectangle(corner, width, height, color=STONE))
    axis.axhline(0, color=STONE, linewidth=3)


def draw_embers(axis: Any, stage: Usd.Stage) -> Any:
    """Draw the embers of the frame and their paths; return what has their colours."""
    frames = [embers(stage, FRAME - TRAIL + k) for k in range(TRAIL + 1)]
    for (before, old, *_), (after, new, *_) in pairwise(frames):
        _, a, b = np.intersect1d(before, after, return_indices=True)
        x, y, _ = np.stack([old[a], new[b]]).transpose(2, 0, 1)
        axis.plot(x, y, color="#ff7a1a", alpha=0.4, lw=0.8)
    _, points, widths, ages = frames[-1]
    # Young ones are bright.
    return axis.scatter(
        *points.T[:2], c=ages, s=widths * 1100, cmap="YlOrRd", vmin=0, zorder=3
    )


def draw(baked: Path, out: Path) -> None:
    """Write the picture of a bake."""
    import matplotlib as mpl

    mpl.use("Agg")
    import matplotlib.pyplot as plt

    stage = Usd.Stage.Open(str(baked))
    figure, axis = plt.subplots(figsize=(9, 5.6), dpi=96, layout="constrained")
    figure.set_facecolor(NIGHT)
    axis.set_facecolor(NIGHT)
    draw_stairs(axis)
    colours = draw_embers(axis, stage)
    axis.set(xlim=(-0.8, 3), ylim=(-0.05, 2.7), aspect="equal", xticks=[], yticks=[])
    axis.spines[:].set_visible(False)
    axis.set_title(
        f"frame {FRAME}, and the way since frame {FRAME - TRAIL}", color=WORDS
    )
    bar = figure.colorbar(colours, ax=axis, shrink=0.6, aspect=30)
    bar.set_label("age [s]", color=WORDS)
    bar.ax.tick_params(colors=WORDS)
    bar.outline.set_visible(False)
    save(figure, out)


if __name__ == "__main__":
    make_picture(HERE / "embers.scene.yaml", draw, *map(Path, sys.argv[1:2]))
