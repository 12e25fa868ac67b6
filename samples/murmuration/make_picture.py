"""Draw the flock of this folder around its tower: a frame, and the ways to it.

Usage: ``python make_picture.py [OUT]``; ``OUT`` is ``murmuration.png`` here unless
given. Needs matplotlib.
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

FRAME, TRAIL = 30, 12
SKY, STONE, GRASS = "#e9eef4", "#8a8478", "#b9c3a6"
STARLING, HAWK = "#2b2f3a", "#c2410c"
# Seen from above and aside: turned about y, then about x [rad].
TURN, TILT = 0.6, 0.35


def seen(points: Array) -> tuple[Array, Array]:
    """Return where points are in the picture ``(..., 2)``, and how near ``(...)``."""
    x, y, z = np.moveaxis(points, -1, 0)
    across = np.cos(TURN) * x - np.sin(TURN) * z
    ahead = np.sin(TURN) * x + np.cos(TURN) * z
    up = np.cos(TILT) * y - np.sin(TILT) * ahead
    return np.stack([across, up], axis=-1), np.sin(TILT) * y + np.cos(TILT) * ahead


def birds(stage: Usd.Stage) -> tuple[list[Array], Array, Array]:
    """Return the corners of each face of all birds, whose they are, and ways."""
    instancer = UsdGeom.PointInstancer(stage.GetPrimAtPath("/murmuration/birds"))
    meshes = []
    for path in instancer.GetPrototypesRel().GetTargets():
        mesh = UsdGeom.Mesh(stage.GetPrimAtPath(path))
        points = np.array(mesh.GetPointsAttr().Get())
        ends = np.cumsum(mesh.GetFaceVertexCountsAttr().Get())[:-1]
        corners = np.split(np.array(mesh.GetFaceVertexIndicesAttr().Get()), ends)
        meshes.append([points[face] for face in corners])
    placed = np.array(instancer.ComputeInstanceTransformsAtTime(FRAME, FRAME))
    shown = np.array(instancer.GetProtoIndicesAttr().Get(FRAME))
    primvars = UsdGeom.PrimvarsAPI(instancer.GetPrim())
    kinds = np.array(primvars.GetPrimvar("species").Get(FRAME))
    faces, whose = [], []
    for matrix, mesh, kind in zip(placed, shown, kinds, strict=True):
        scale = 1.3 if kind == 0 else 4.0
        for face in meshes[mesh]:
            faces.append(scale * face @ matrix[:3, :3] + matrix[3, :3])
            whose.append(kind)
    positions = instancer.GetPositionsAttr()
    ways = np.array([positions.Get(FRAME - k) for k in range(TRAIL)])
    return faces, np.array(whose), ways


def draw_tower(axis: Any) -> None:
    """Draw the capsule of the scene as it is seen."""
    angles = np.linspace(0, 2 * np.pi, 60)
    for height in np.linspace(0.0, 13.0, 40):
        ring = np.stack(
            [2 * np.cos(angles), np.full(60, height), 2 * np.sin(angles)], axis=-1
        )
        axis.fill(*seen(ring)[0].T, color=STONE, lw=0, zorder=2)
    dome = np.linspace(0, np.pi / 2, 12)
    for lift in dome:
        ring = np.stack(
            [
                2 * np.cos(lift) * np.cos(angles),
                np.full(60, 13 + 2 * np.sin(lift)),
                2 * np.cos(lift) * np.sin(angles),
            ],
            axis=-1,
        )
        axis.fill(*seen(ring)[0].T, color=STONE, lw=0, zorder=2)


def draw(baked: Path, out: Path) -> None:
    """Write the picture of a bake."""
    import matplotlib as mpl

    mpl.use("Agg")
    import matplotlib.pyplot as plt
    from matplotlib.collections import LineCollection, PolyCollection

    faces, whose, ways = birds(Usd.Stage.Open(str(baked)))
    figure, axis = plt.subplots(figsize=(9, 5.6), dpi=96, layout="constrained")
    figure.set_facecolor(SKY)
    axis.set_facecolor(SKY)
    angles = np.linspace(0, 2 * np.pi, 90)
    ground = np.stack([14 * np.cos(angles), 0 * angles, 14 * np.sin(angles)], axis=-1)
    axis.fill(*seen(ground)[0].T, color=GRASS, lw=0)
    draw_tower(axis)
    near = np.array([seen(face)[1].mean() for face in faces])
    tower = seen(np.array([0.0, 9.0, 0.0]))[1]
    for front in (False, True):
        for kind, colour in enumerate((STARLING, HAWK)):
            which = np.flatnonzero((whose == kind) & ((near > tower) == front))
            shapes = [seen(faces[i])[0] for i in which]
            axis.add_collection(
                PolyCollection(shapes, facecolors=colour, lw=0, zorder=6 * front + 1)
            )
    lines, _ = seen(ways.swapaxes(0, 1))
    colours = [STARLING] * (len(lines) - 1) + [HAWK]
    axis.add_collection(
        LineCollection(list(lines), colors=colours, alpha=0.18, lw=0.7, zorder=1)
    )
    axis.set(xlim=(-16, 16), ylim=(-6, 17), aspect="equal", xticks=[], yticks=[])
    axis.spines[:].set_visible(False)
    axis.set_title(f"frame {FRAME}, and the ways since frame {FRAME - TRAIL + 1}")
    save(figure, out)


if __name__ == "__main__":
    make_picture(HERE / "murmuration.scene.yaml", draw, *map(Path, sys.argv[1:2]))
