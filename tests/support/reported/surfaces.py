"""Checks of a cloth over a rod, and of a pool."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
from pxr import UsdGeom

from support.reported.bodies import read_bodies
from support.reported.outcome import Outcome, close, require
from support.reported.springs import read_points

Floats = npt.NDArray[np.float64]
_SIDEWAYS = (1.0, 0.0, 0.0)


def rod_pierces(
    outcome: Outcome,
    *,
    half: float,
    at: Any,
    moves: Any,
    axis: Any = _SIDEWAYS,
    system: str | None = None,
    of: str | None = None,
) -> None:
    """Require that a rod crosses no triangle of a cloth, and ends under it.

    Args:
        outcome: With the cloth.
        half: Of the rod's length [m].
        at: Its centre.
        moves: How it moves, straight between rows of seconds, x, y and, where it
            does, z.
        axis: Along which it lies.
        system: By name, else the first.
        of: File.
    """
    clocked, prim, points = read_points(outcome, of, system, UsdGeom.Mesh)
    triangles = _triangles(UsdGeom.Mesh(prim))
    require(len(triangles), "the cloth has no faces")
    rows = np.array([[*row, 0.0][:4] for row in moves], float)
    seconds = (clocked.codes - clocked.codes[0]) / clocked.fps
    offsets = [np.interp(seconds, rows[:, 0], rows[:, 1 + k]) for k in range(3)]
    centres = np.asarray(at, float) + np.stack(offsets, axis=1)
    arm = half * np.asarray(axis, float)
    for frame, centre in enumerate(centres):
        hit = crossed(points[frame][triangles], centre - arm, centre + arm)
        text = f"it crosses {hit.sum()} triangles in frame {frame + 1}"
        require(not hit.any(), text)
    above = _heights(points[-1][triangles], centres[-1])
    require(len(above), "no cloth is over or under it at the end")
    lowest = float(above.min() - centres[-1, 1])
    require(lowest > 0.0, f"it is {-lowest:.3g} m above the cloth at the end")


def _triangles(mesh: UsdGeom.Mesh) -> npt.NDArray[np.int64]:
    """Return the faces of a mesh as fans of triangles ``(T, 3)``."""
    indices = np.array(mesh.GetFaceVertexIndicesAttr().Get() or (), int)
    found, begin = [], 0
    for corners in mesh.GetFaceVertexCountsAttr().Get() or ():
        face = indices[begin : begin + corners]
        begin += corners
        found += [(face[0], face[k], face[k + 1]) for k in range(1, corners - 1)]
    return np.array(found, int).reshape(-1, 3)


def crossed(corners: Floats, start: Floats, end: Floats) -> npt.NDArray[np.bool_]:
    """Return which triangles ``(T, 3, 3)`` a segment crosses (Möller and Trumbore)."""
    origin = corners[:, 0]
    first, second = corners[:, 1] - origin, corners[:, 2] - origin
    along = end - start
    p = np.cross(along, second)
    area = (first * p).sum(axis=1)
    flat = np.abs(area) < 1e-15
    scale = 1.0 / np.where(flat, 1.0, area)
    away = start - origin
    u = scale * (away * p).sum(axis=1)
    q = np.cross(away, first)
    v = scale * (q * along).sum(axis=1)
    t = scale * (q * second).sum(axis=1)
    inside = (u >= 0) & (v >= 0) & (u + v <= 1) & (t >= 0) & (t <= 1)
    return np.asarray(inside & ~flat)


def _heights(corners: Floats, point: Floats) -> Floats:
    """Return the heights of triangles ``(T, 3, 3)`` where they are over a point."""
    tall = 1.0 + 2.0 * float(np.abs(corners[..., 1] - point[1]).max())
    up = np.array([0.0, tall, 0.0])
    over = corners[crossed(corners, point - up, point + up)]
    normals = np.cross(over[:, 1] - over[:, 0], over[:, 2] - over[:, 0])
    flat = point - over[:, 0]
    drop = flat[:, 0] * normals[:, 0] + flat[:, 2] * normals[:, 2]
    return np.asarray(over[:, 0, 1] - drop / normals[:, 1])


def rms_speed_m_s(
    outcome: Outcome,
    *,
    from_s: float,
    max: float,
    system: str | None = None,
    of: str | None = None,
) -> None:
    """Require that particles are at rest from a time on, by their positions."""
    bodies = read_bodies(outcome, of, system)
    begin = int(np.ceil(bodies.clocked.at(from_s)))
    steps = np.diff(bodies.centres[begin:], axis=0)
    seen = np.isfinite(steps).all(axis=2)
    require(seen.any(), f"there is no step from {from_s} s on")
    squares = (steps[seen] ** 2).sum(axis=1) * bodies.clocked.fps**2
    speed = float(np.sqrt(squares.mean()))
    require(speed <= max, f"{speed:.4g} m/s, at most {max}")


def mean_height_m(
    outcome: Outcome,
    *,
    value: float,
    tolerance: float,
    system: str | None = None,
    of: str | None = None,
) -> None:
    """Require the mean height of particles in the last frame."""
    heights = read_bodies(outcome, of, system).centres[-1, :, 1]
    require(np.isfinite(heights).any(), "nothing is left in the last frame")
    mean = float(np.nanmean(heights))
    require(close(mean, value, tolerance), f"{mean:.4g} m, not {value}")


CHECKS = {
    "mean_height_m": mean_height_m,
    "rms_speed_m_s": rms_speed_m_s,
    "rod_pierces": rod_pierces,
}
