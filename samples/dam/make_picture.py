"""Draw three frames of the dam of this folder.

Usage: ``python make_picture.py [OUT]``; ``OUT`` is ``dam.png`` here unless given. Needs
matplotlib.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from pxr import Usd, UsdGeom

sys.path.append(str(Path(__file__).parents[1] / "pictures"))

from labelled import make_picture, save

HERE = Path(__file__).parent
FRAMES = (8, 14, 22)
# Seen from the side and above: turned about y, then about x [rad].
TURN, TILT = -0.5, 0.45
TANK = np.array([2.4, 1.1, 0.8])
SKY, STONE, EDGE = "#f4f6f8", "#7d766c", "#9aa5b1"


def seen(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return where points are in the picture ``(..., 2)``, and how near ``(...)``."""
    x, y, z = np.moveaxis(np.asarray(points, float), -1, 0)
    across = np.cos(TURN) * x - np.sin(TURN) * z
    ahead = np.sin(TURN) * x + np.cos(TURN) * z
    up = np.cos(TILT) * y - np.sin(TILT) * ahead
    return np.stack([across, up], axis=-1), np.sin(TILT) * y + np.cos(TILT) * ahead


def draw(baked: Path, out: Path) -> None:
    """Write the picture of a bake."""
    import matplotlib as mpl

    mpl.use("Agg")
    import matplotlib.pyplot as plt

    stage = Usd.Stage.Open(str(baked))
    water = UsdGeom.Points(stage.GetPrimAtPath("/dam/water"))
    colors = UsdGeom.PrimvarsAPI(water.GetPrim()).GetPrimvar("displayColor")
    figure, axes = plt.subplots(1, 3, figsize=(12, 3.8), dpi=96, layout="constrained")
    figure.set_facecolor(SKY)
    corners = TANK * [[0, 0, 0], [1, 0, 0], [1, 0, 1], [0, 0, 1], [0, 0, 0]]
    angles = np.linspace(0, 2 * np.pi, 40)
    rim = np.stack([0.12 * np.cos(angles), 0 * angles, 0.12 * np.sin(angles)], axis=-1)
    for axis, frame in zip(axes, FRAMES, strict=True):
        axis.set_facecolor(SKY)
        axis.plot(*seen(corners)[0].T, color=EDGE, lw=1)
        for corner in corners[:4]:
            line = np.stack([corner, corner + np.array([0, TANK[1], 0])])
            axis.plot(*seen(line)[0].T, color=EDGE, lw=0.6)
        points = np.array(water.GetPointsAttr().Get(frame))
        places, near = seen(points)
        pillar = seen(np.array([1.4, 0.0, 0.4]))[1]
        depth = near - np.sin(TILT) * points[:, 1]
        before = depth > pillar
        shown = np.array(colors.Get(frame))
        for some, order in ((~before, 1), (before, 6)):
            rows = np.flatnonzero(some)[np.argsort(near[some])]
            axis.scatter(
                *places[rows].T, s=16, c=shown[rows], edgecolors="#0a2a55",
                linewidths=0.15, zorder=order,
            )  # fmt: skip
        for height in np.linspace(0.0, 1.1, 60):
            ring = rim + np.array([1.4, height, 0.4])
            axis.fill(*seen(ring)[0].T, color=STONE, lw=0, zorder=4)
        axis.set(
            xlim=(-0.1, 2.6), ylim=(-0.4, 1.9), aspect="equal", title=f"frame {frame}"
        )
        axis.set(xticks=[], yticks=[])
        axis.spines[:].set_visible(False)
    save(figure, out)


if __name__ == "__main__":
    make_picture(HERE / "dam.scene.yaml", draw, *map(Path, sys.argv[1:2]))
