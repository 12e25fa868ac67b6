"""Make ``vase.usda``, a closed vase of revolution that stands on the floor.

Usage: ``python make_vase.py [OUT]``; ``OUT`` is ``vase.usda`` beside this file unless
given.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from pxr import Usd, UsdGeom, Vt

# Radius and height of rings, from the foot up and over the lip [m].
PROFILE = (
    (0.10, 0.00), (0.11, 0.01), (0.10, 0.03), (0.13, 0.10), (0.175, 0.19), (0.19, 0.27),
    (0.175, 0.35), (0.13, 0.42), (0.085, 0.47), (0.068, 0.52), (0.07, 0.57),
    (0.09, 0.61), (0.10, 0.625), (0.09, 0.635),
)  # fmt: skip
SIDES = 32


def main(out: Path) -> None:
    """Write the vase."""
    turn = np.arange(SIDES) * (2 * np.pi / SIDES)
    rings = [
        np.stack([r * np.sin(turn), np.full(SIDES, y), r * np.cos(turn)], axis=1)
        for r, y in PROFILE
    ]
    ends = [[0.0, PROFILE[0][1], 0.0], [0.0, PROFILE[-1][1], 0.0]]
    points = np.concatenate([*rings, ends]).round(6)
    low, high = len(points) - 2, len(points) - 1
    a = np.arange(SIDES)
    b = (a + 1) % SIDES
    top = (len(PROFILE) - 1) * SIDES
    walls = [
        np.stack([k + a, k + b, k + SIDES + b, k + SIDES + a], axis=1)
        for k in range(0, top, SIDES)
    ]
    caps = [
        np.stack([np.full(SIDES, low), b, a], axis=1),
        np.stack([np.full(SIDES, high), top + a, top + b], axis=1),
    ]
    corners = np.concatenate([each.ravel() for each in (*walls, *caps)])
    counts = np.repeat([4, 3], [SIDES * len(walls), SIDES * 2])
    stage = Usd.Stage.CreateInMemory()
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.y)
    model = UsdGeom.Xform.Define(stage, "/vase")
    stage.SetDefaultPrim(model.GetPrim())
    Usd.ModelAPI(model).SetKind("component")
    mesh = UsdGeom.Mesh.Define(stage, "/vase/body")
    mesh.CreatePointsAttr(Vt.Vec3fArray.FromNumpy(points.astype(np.float32)))
    mesh.CreateFaceVertexCountsAttr(Vt.IntArray.FromNumpy(counts.astype(np.int32)))
    mesh.CreateFaceVertexIndicesAttr(Vt.IntArray.FromNumpy(corners.astype(np.int32)))
    mesh.CreateSubdivisionSchemeAttr(UsdGeom.Tokens.none)
    extent = np.stack([points.min(axis=0), points.max(axis=0)]).astype(np.float32)
    mesh.CreateExtentAttr(Vt.Vec3fArray.FromNumpy(extent))
    colour = Vt.Vec3fArray.FromNumpy(np.array([[0.24, 0.42, 0.46]], np.float32))
    mesh.CreateDisplayColorAttr(colour)
    stage.GetRootLayer().Export(str(out))


if __name__ == "__main__":
    here = Path(__file__).parent
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else here / "vase.usda")
