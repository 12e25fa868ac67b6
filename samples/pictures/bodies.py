"""Rigid bodies of a bake, drawn face by face from far to near, by matplotlib."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from labelled import save
from numpy.typing import NDArray
from pxr import Gf, Usd, UsdGeom

Array = NDArray[np.float64]

# Where the light comes from.
LIGHT = np.array([0.4, 0.8, -0.45])


class View:
    """A look from aside and above: turned about y, then about x [rad]."""

    def __init__(self, turn: float, tilt: float) -> None:
        self.turn, self.tilt = turn, tilt

    def seen(self, points: Array) -> tuple[Array, Array]:
        """Return where points are in the picture ``(..., 2)``, and how near."""
        x, y, z = np.moveaxis(points, -1, 0)
        across = np.cos(self.turn) * x - np.sin(self.turn) * z
        ahead = np.sin(self.turn) * x + np.cos(self.turn) * z
        up = np.cos(self.tilt) * y - np.sin(self.tilt) * ahead
        near = np.sin(self.tilt) * y + np.cos(self.tilt) * ahead
        return np.stack([across, up], axis=-1), -near


def faces_of(stage: Usd.Stage, path: str, frame: float) -> list[tuple[int, Array]]:
    """Return the faces of all copies at a frame, each with the number of its mesh."""
    instancer = UsdGeom.PointInstancer(stage.GetPrimAtPath(path))
    meshes = []
    for target in instancer.GetPrototypesRel().GetTargets():
        mesh = UsdGeom.Mesh(stage.GetPrimAtPath(target))
        points = np.array(mesh.GetPointsAttr().Get(), np.float64)
        ends = np.cumsum(mesh.GetFaceVertexCountsAttr().Get())[:-1]
        corners = np.split(np.array(mesh.GetFaceVertexIndicesAttr().Get()), ends)
        meshes.append([points[face] for face in corners])
    placed: list[Gf.Matrix4d] = instancer.ComputeInstanceTransformsAtTime(frame, frame)
    shown = np.array(instancer.GetProtoIndicesAttr().Get(frame))
    return [
        (int(mesh), face @ matrix[:3, :3] + matrix[3, :3])
        for matrix, mesh in zip(np.array(placed), shown, strict=True)
        for face in meshes[mesh]
    ]


def draw_faces(
    axis: Any, view: View, faces: list[tuple[int, Array]], colours: list[str]
) -> None:
    """Draw faces that look this way, shaded, those behind first."""
    from matplotlib.collections import PolyCollection
    from matplotlib.colors import to_rgb

    corners = np.concatenate([face for _, face in faces])
    ends = np.cumsum([len(face) for _, face in faces])
    begins = np.append(0, ends[:-1])
    flat, near = view.seen(corners)
    a, b = (flat[begins + k] - flat[begins] for k in (1, 2))
    normals = np.cross(*(corners[begins + k] - corners[begins] for k in (1, 2)))
    normals /= np.maximum(np.linalg.norm(normals, axis=1), 1e-12)[:, None]
    lit = np.maximum(normals @ (LIGHT / np.linalg.norm(LIGHT)), 0.0)
    paint = np.array([to_rgb(colours[mesh]) for mesh, _ in faces])
    shades = (0.62 + 0.38 * lit)[:, None] * paint
    depths = np.add.reduceat(near, begins) / (ends - begins)
    order = np.argsort(depths, kind="stable")
    order = order[(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0] >= 0)[order]]
    axis.add_collection(
        PolyCollection(
            [flat[begins[i] : ends[i]] for i in order],
            facecolors=shades[order],
            edgecolors=0.7 * shades[order],
            lw=0.25,
        )
    )


def draw_cords(
    axis: Any, view: View, stage: Usd.Stage, path: str, frame: float
) -> None:
    """Draw curves at a frame as lines, in front of all."""
    curves = UsdGeom.BasisCurves(stage.GetPrimAtPath(path))
    points = np.array(curves.GetPointsAttr().Get(frame), np.float64)
    ends = np.cumsum(curves.GetCurveVertexCountsAttr().Get(frame))[:-1]
    for strand in np.split(view.seen(points)[0], ends):
        axis.plot(*strand.T, color="#4a3b2a", lw=1.2)


def draw_frames(
    baked: Path,
    out: Path,
    *,
    path: str,
    frames: Sequence[int],
    view: View,
    colours: list[str],
    limits: tuple[tuple[float, float], tuple[float, float]],
    columns: int,
    cord: str = "",
) -> None:
    """Write some frames of a bake as a picture, in rows; with curves of a path."""
    import matplotlib as mpl

    mpl.use("Agg")
    import matplotlib.pyplot as plt

    stage = Usd.Stage.Open(str(baked))
    rows = -(-len(frames) // columns)
    (left, right), (low, high) = limits
    width = 9.0 / columns
    size = (9.0, rows * (width * (high - low) / (right - left) + 0.3))
    figure, axes = plt.subplots(
        rows, columns, figsize=size, dpi=96, layout="constrained", squeeze=False
    )
    figure.set_facecolor("#f2f0ec")
    for axis, frame in zip(axes.flat, frames, strict=True):
        draw_faces(axis, view, faces_of(stage, path, frame), colours)
        if cord:
            draw_cords(axis, view, stage, cord, frame)
        axis.set(xlim=(left, right), ylim=(low, high), aspect="equal")
        axis.set(xticks=[], yticks=[], facecolor="#f2f0ec")
        axis.spines[:].set_visible(False)
        axis.set_title(f"frame {frame}", fontsize=9)
    save(figure, out)
