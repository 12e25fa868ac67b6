"""Frames of coloured points side by side on a dark ground, by matplotlib."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from labelled import save
from numpy.typing import NDArray
from pxr import Usd, UsdGeom

Array = NDArray[np.float64]
NIGHT, WORDS = "#0b0d14", "#c8ccd4"


def seen(points: Array, turn: float, tilt: float) -> tuple[Array, Array]:
    """Return where points are in a picture ``(N, 2)``, and how near ``(N,)``.

    Seen from above and aside: turned about y, then about x [rad].
    """
    x, y, z = points.T
    across = np.cos(turn) * x - np.sin(turn) * z
    ahead = np.sin(turn) * x + np.cos(turn) * z
    up = np.cos(tilt) * y - np.sin(tilt) * ahead
    return np.stack([across, up], axis=-1), np.sin(tilt) * y + np.cos(tilt) * ahead


def cloud(stage: Usd.Stage, path: str, frame: float) -> tuple[Array, Array, Array]:
    """Return points, colours and widths of a prim at a frame."""
    prim = UsdGeom.Points(stage.GetPrimAtPath(path))
    colours = UsdGeom.PrimvarsAPI(prim).GetPrimvar("displayColor")
    attributes = (prim.GetPointsAttr(), colours, prim.GetWidthsAttr())
    points, shades, widths = (np.array(each.Get(frame)) for each in attributes)
    return points, shades, widths


def draw_clouds(
    baked: Path,
    out: Path,
    *,
    path: str,
    frames: Sequence[int],
    view: tuple[float, float, float],
) -> None:
    """Write frames of a prim as a picture: ``view`` is turn, tilt and half a width."""
    import matplotlib as mpl

    mpl.use("Agg")
    import matplotlib.pyplot as plt

    stage = Usd.Stage.Open(str(baked))
    turn, tilt, half = view
    figure, axes = plt.subplots(
        1, len(frames), figsize=(3.2 * len(frames), 3.2), dpi=96, layout="constrained"
    )
    figure.set_facecolor(NIGHT)
    middle: Any = None
    for axis, frame in zip(axes, frames, strict=True):
        points, colours, widths = cloud(stage, path, frame)
        places, near = seen(points, turn, tilt)
        middle = places.mean(axis=0) if middle is None else middle
        order = np.argsort(near, kind="stable")
        sizes = (widths[order] / (2 * half) * 3.2 * 72) ** 2
        axis.scatter(*(places - middle)[order].T, s=sizes, c=colours[order], lw=0)
        axis.set_facecolor(NIGHT)
        axis.set(xlim=(-half, half), ylim=(-half, half), aspect="equal")
        axis.set(xticks=[], yticks=[])
        axis.spines[:].set_visible(False)
        axis.text(0.03, 0.94, f"frame {frame}", color=WORDS, transform=axis.transAxes)
    save(figure, out)
