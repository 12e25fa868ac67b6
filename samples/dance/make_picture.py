"""Draw twelve frames of the two dances of this folder, from before and behind.

Usage: ``python make_picture.py [DANCE CAPE [OUT]]``: bakes of the two scenes, made here
where none are named; ``OUT`` is ``dance.png`` here unless given.
"""

from __future__ import annotations

import sys
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from pxr import Usd, UsdGeom

sys.path.append(str(Path(__file__).parents[1] / "pictures"))

from labelled import image_grid, save
from picture import Camera, Surface, render, ribbons

from animtool import bake

HERE = Path(__file__).parent
FRAMES = (5, 13, 21, 29, 37, 45)
SIZE = (300, 190)
COLOURS = {
    "body": (0.75, 0.62, 0.52),
    "skirt": (0.20, 0.36, 0.56),
    "sleeve_l": (0.80, 0.66, 0.24),
    "sleeve_r": (0.80, 0.66, 0.24),
    "cape": (0.62, 0.13, 0.14),
}
BROWN = (0.34, 0.24, 0.17)


def surfaces(stage: Usd.Stage, frame: float, camera: Camera) -> list[Surface]:
    """Return what a stage has at a frame."""
    made = []
    for prim in stage.Traverse():
        if prim.IsA(UsdGeom.Mesh) and prim.GetName() in COLOURS:
            mesh = UsdGeom.Mesh(prim)
            points = np.array(mesh.GetPointsAttr().Get(frame), np.float64)
            quads = np.array(mesh.GetFaceVertexIndicesAttr().Get()).reshape(-1, 4)
            triangles = np.concatenate([quads[:, :3], quads[:, [0, 2, 3]]])
            colours = np.tile(COLOURS[prim.GetName()], (len(points), 1))
            made.append(Surface(points, triangles, colours))
        if prim.IsA(UsdGeom.BasisCurves):
            curves = UsdGeom.BasisCurves(prim)
            points = np.array(curves.GetPointsAttr().Get(frame), np.float64)
            count = len(curves.GetCurveVertexCountsAttr().Get())
            made.append(ribbons(points.reshape(count, -1, 3), BROWN, 0.012, camera))
    return made


def draw(dance: Path, cape: Path, out: Path) -> None:
    """Write the picture of two bakes."""
    rows = []
    for baked, turn in ((dance, 0.0), (cape, 180.0)):
        stage = Usd.Stage.Open(str(baked))
        camera = Camera((0.0, 0.9, -0.2), 1.9, turn=turn, lift=8)
        rows.append([render(surfaces(stage, k, camera), camera, SIZE) for k in FRAMES])
    titles = [f"frame {frame}" for frame in FRAMES]
    save(image_grid(rows, titles, ("before", "behind")), out)


def main() -> None:
    """Bake what is not named, and draw."""
    given = [Path(one) for one in sys.argv[1:]]
    out = given[2] if len(given) > 2 else HERE / "dance.png"
    if given:
        draw(given[0], given[1], out)
        return
    with TemporaryDirectory() as folder:
        made = [Path(folder) / f"{name}.usdc" for name in ("dance", "cape")]
        for path in made:
            bake(HERE / f"{path.stem}.scene.yaml", path)
        draw(made[0], made[1], out)


if __name__ == "__main__":
    main()
