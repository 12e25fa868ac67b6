"""Draw the sheets of this folder at their last frame, hung above and draped below.

Usage: ``python make_picture.py [OUT]``; ``OUT`` is ``sheets.png`` here unless given.
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
from props import box, floor

HERE = Path(__file__).parent
FAMILIES = {
    "structural": "structural springs alone",
    "one_diagonal": "and one diagonal",
    "both_diagonals": "and both diagonals",
    "bend": "and weak bend springs",
}
ROWS = ("hung by two corners", "draped")
FRAME, APART = 96, 1.6
PARTICLES, FINER, CHECK = 25, 2, 3
RED, CREAM = (0.72, 0.16, 0.13), (0.93, 0.88, 0.78)
WOOD, STONE = (0.45, 0.33, 0.22), (0.74, 0.75, 0.76)
HUNG = Camera((0.0, 1.36, 0.0), 1.6, turn=20, lift=8)
DRAPED = Camera((0.0, 0.36, 2.0), 1.25, turn=30, lift=26)
SIZE = (290, 290)


def finer(points: Array) -> Array:
    """Return points ``(P, P, 3)`` of a grid with more between them."""
    old = np.arange(len(points))
    new = np.linspace(0, len(points) - 1, FINER * (len(points) - 1) + 1)
    for _ in range(2):
        flat = points.reshape(len(old), -1)
        columns = [np.interp(new, old, column) for column in flat.T]
        points = np.stack(columns, axis=-1).reshape(len(new), -1, 3).swapaxes(0, 1)
    return points


def sheet(points: Array) -> Surface:
    """Return a sheet in checks that are as many springs wide on every one."""
    grid = finer(points.reshape(PARTICLES, PARTICLES, 3))
    count = len(grid)
    row, column = np.mgrid[:count, :count]
    step = FINER * CHECK
    odd = ((row // step + column // step) % 2 == 1)[..., None]
    corner = (row * count + column)[:-1, :-1].ravel()
    ring = [corner, corner + 1, corner + count + 1, corner + count]
    faces = triangulated(np.stack(ring, axis=1))
    colours = np.where(odd, RED, CREAM)
    return Surface(grid.reshape(-1, 3), faces, colours.reshape(-1, 3))


def table(x: float) -> Surface:
    """Return the table that a sheet lies on."""
    world = np.diag([0.25, 0.3, 0.25, 1.0])
    world[:3, 3] = x, 0.3, 2.0
    return box(world, WOOD)


def views(stage: Usd.Stage) -> list[list[Array]]:
    """Return a picture of each sheet, those that are hung first."""
    rows = []
    for kind, camera in (("hung", HUNG), ("draped", DRAPED)):
        row = []
        for k, name in enumerate(FAMILIES):
            mesh = UsdGeom.Mesh(stage.GetPrimAtPath(f"/sheets/{kind}_{name}"))
            points = np.array(mesh.GetPointsAttr().Get(FRAME), np.float64)
            shift = np.array([APART * k, 0, 0])
            surfaces = [sheet(points - shift)]
            if kind == "draped":
                surfaces += [table(0.0), floor(DRAPED.centre, 0.75, STONE)]
            row.append(render(surfaces, camera, SIZE))
        rows.append(row)
    return rows


def draw(baked: Path, out: Path) -> None:
    """Write the picture of a bake."""
    rows = views(Usd.Stage.Open(str(baked)))
    save(image_grid(rows, list(FAMILIES.values()), ROWS), out)


if __name__ == "__main__":
    make_picture(HERE / "sheets.scene.yaml", draw, *map(Path, sys.argv[1:2]))
