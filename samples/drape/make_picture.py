"""Draw the cloth of this folder as it falls over the vase: four frames.

Usage: ``python make_picture.py [OUT]``; ``OUT`` is ``drape.png`` here unless given.
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
from props import floor

HERE = Path(__file__).parent
FRAMES = (1, 8, 16, 48)
LINEN, GLAZE, GROUND = (0.93, 0.88, 0.78), (0.24, 0.42, 0.46), (0.62, 0.58, 0.54)
CAMERA = Camera((0.0, 0.36, 0.0), 1.15, turn=24, lift=18)
SIZE = (290, 300)


def surface(mesh: UsdGeom.Mesh, frame: int, colour: tuple[float, ...]) -> Surface:
    """Return a mesh of triangles and quads in one colour."""
    points = np.array(mesh.GetPointsAttr().Get(frame), np.float64)
    counts = np.array(mesh.GetFaceVertexCountsAttr().Get())
    corners = np.array(mesh.GetFaceVertexIndicesAttr().Get())
    faces = np.full((len(counts), 4), -1)
    faces[np.arange(4) < counts[:, None]] = corners
    return Surface(points, triangulated(faces), np.tile(colour, (len(points), 1)))


def views(stage: Usd.Stage) -> list[Array]:
    """Return pictures of the frames."""
    props = Usd.Stage.Open(str(HERE / "vase.usda"))
    cloth = UsdGeom.Mesh(stage.GetPrimAtPath("/drape/cloth"))
    vase = UsdGeom.Mesh(props.GetPrimAtPath("/vase/body"))
    still = [surface(vase, 1, GLAZE), floor((0, 0, 0), 0.6, GROUND)]
    return [
        render([surface(cloth, frame, LINEN), *still], CAMERA, SIZE) for frame in FRAMES
    ]


def draw(baked: Path, out: Path) -> None:
    """Write the picture of a bake."""
    row = views(Usd.Stage.Open(str(baked)))
    save(image_grid([row], [f"frame {frame}" for frame in FRAMES]), out)


if __name__ == "__main__":
    make_picture(HERE / "drape.scene.yaml", draw, *map(Path, sys.argv[1:2]))
