"""Draw the flag of this folder: four of its frames.

Usage: ``python make_picture.py [OUT]``; ``OUT`` is ``flag.png`` here unless given.
Needs matplotlib.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from pxr import Usd, UsdGeom

sys.path.append(str(Path(__file__).parents[1] / "pictures"))

from labelled import image_grid, make_picture, save
from picture import Array, Camera, Surface, render, triangulated
from props import rod

HERE = Path(__file__).parent
FRAMES = (6, 18, 30, 42)
RESOLUTION = (34, 23)
# The signal flag P: about to sail.
BLUE, WHITE, WOOD = (0.12, 0.26, 0.58), (0.94, 0.93, 0.90), (0.55, 0.42, 0.28)
CAMERA = Camera((0.74, 1.95, 0.0), 1.6, turn=22, lift=6)
SIZE = (290, 300)


def cloth(points: Array) -> Surface:
    """Return the flag ``(columns * rows, 3)``: a white square in a blue one."""
    columns, rows = RESOLUTION
    x, y = np.meshgrid(np.linspace(-1, 1, columns), np.linspace(-1, 1, rows))
    white = (np.abs(x) < 0.36) & (np.abs(y) < 0.36)
    corner = (np.arange(rows - 1)[:, None] * columns + np.arange(columns - 1)).ravel()
    ring = [corner, corner + 1, corner + columns + 1, corner + columns]
    faces = triangulated(np.stack(ring, axis=1))
    colours = np.where(white.reshape(-1, 1), WHITE, BLUE)
    return Surface(points, faces, colours)


def views(stage: Usd.Stage) -> list[Array]:
    """Return pictures of the frames."""
    mesh = UsdGeom.Mesh(stage.GetPrimAtPath("/flag/flag"))
    pole = rod((0, 0.5, 0), (0, 2.62, 0), 0.02, WOOD)
    return [
        render(
            [cloth(np.array(mesh.GetPointsAttr().Get(frame), np.float64)), pole],
            CAMERA,
            SIZE,
        )
        for frame in FRAMES
    ]


def draw(baked: Path, out: Path) -> None:
    """Write the picture of a bake."""
    row = views(Usd.Stage.Open(str(baked)))
    save(image_grid([row], [f"frame {frame}" for frame in FRAMES]), out)


if __name__ == "__main__":
    make_picture(HERE / "flag.scene.yaml", draw, *map(Path, sys.argv[1:2]))
