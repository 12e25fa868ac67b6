"""Draw the fall of this folder from aside: one pose every few frames, on the stairs.

Usage: ``python make_picture.py [OUT]``; ``OUT`` is ``fall.png`` here unless given.
Needs matplotlib.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from pxr import Usd, UsdGeom

sys.path.append(str(Path(__file__).parents[1] / "pictures"))

from bodies import View, draw_faces
from labelled import make_picture, save

HERE = Path(__file__).parent

FRAMES = [1, 20, 26, 32, 38, 44, 52, 92]
COLOURS = ["#c98a5b", "#a9adb3"]
STEPS = [(-3.0, 1.0, 0.0)]
STEPS += [(1.0 + 0.32 * k, 1.32 + 0.32 * k, -0.18 * (k + 1)) for k in range(5)]
STEPS += [(2.6, 8.6, -1.08)]


def draw(baked: Path, out: Path) -> None:
    """Write the picture of a bake."""
    import matplotlib as mpl

    mpl.use("Agg")
    import matplotlib.pyplot as plt

    stage = Usd.Stage.Open(str(baked))
    body = UsdGeom.Mesh(stage.GetPrimAtPath("/biped/Rig/body"))
    ends = np.cumsum(body.GetFaceVertexCountsAttr().Get())[:-1]
    corners = np.split(np.array(body.GetFaceVertexIndicesAttr().Get()), ends)
    view = View(-np.pi / 2, 0.0)
    figure, axes = plt.subplots(2, 4, figsize=(9, 5), dpi=96, layout="constrained")
    figure.set_facecolor("#f2f0ec")
    for axis, frame in zip(axes.flat, FRAMES, strict=True):
        for begin, end, height in STEPS:
            axis.fill_between([begin, end], -3, height, color="#b9bdc4", lw=0)
        points = np.array(body.GetPointsAttr().Get(frame), np.float64)
        draw_faces(axis, view, [(0, points[face]) for face in corners], COLOURS)
        middle = float(points[:, 2].mean())
        axis.set(xlim=(middle - 1.1, middle + 1.1), ylim=(-1.3, 1.7))
        axis.set(aspect="equal", xticks=[], yticks=[], facecolor="#f2f0ec")
        axis.spines[:].set_visible(False)
        axis.set_title(f"frame {frame}", fontsize=9)
    save(figure, out)


if __name__ == "__main__":
    make_picture(HERE / "fall.scene.yaml", draw, *map(Path, sys.argv[1:2]))
