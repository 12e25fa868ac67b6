"""Checks of ropes and of pinned cloth."""

from __future__ import annotations

from collections import Counter

import numpy as np
import numpy.typing as npt
from pxr import UsdGeom

from support.reported.bodies import GRAVITY, system_prim
from support.reported.outcome import Outcome, require
from support.reported.stages import ClockedStage, open_clocked

Floats = npt.NDArray[np.float64]


def read_points(
    outcome: Outcome, of: str | None, system: str | None, *kinds: object
) -> tuple[ClockedStage, object, Floats]:
    """Return the stage, the prim and the points ``(F, N, 3)`` [m] of a system."""
    clocked = open_clocked(outcome.file(of))
    prim = system_prim(clocked, system, *(kinds or (UsdGeom.PointBased,)))
    attribute = UsdGeom.PointBased(prim).GetPointsAttr()
    frames = []
    for code in clocked.codes:
        local = attribute.Get(code)
        require(local, f"{prim.GetName()} has no points at {code:g}")
        frames.append(clocked.points(np.array(local), prim, code))
    same = len({len(points) for points in frames}) == 1
    require(same, f"{prim.GetName()} has not as many points in every frame")
    points = np.stack(frames)
    require(np.isfinite(points).all(), "a point is not finite")
    return clocked, prim, points


def _rope(outcome: Outcome, of: str | None, system: str | None) -> tuple[float, Floats]:
    """Return the rate and the points of a rope, which is one curve."""
    clocked, prim, points = read_points(outcome, of, system, UsdGeom.BasisCurves)
    counts = UsdGeom.BasisCurves(prim).GetCurveVertexCountsAttr().Get()
    require(counts is not None and len(counts) == 1, "it is not one curve")
    require(points.shape[1] > 1, "the rope has one point")
    return clocked.fps, points


def rope_stretch_m(
    outcome: Outcome,
    *,
    length: float,
    value: float,
    tolerance: float,
    system: str | None = None,
    of: str | None = None,
) -> None:
    """Require how much longer than a length a rope is, in every frame."""
    _, points = _rope(outcome, of, system)
    lengths = np.linalg.norm(np.diff(points, axis=1), axis=2).sum(axis=1)
    off = np.abs(lengths - length - value)
    worst = int(off.argmax())
    text = f"{1000 * (lengths[worst] - length):.4g} mm in frame {worst + 1}"
    require(off.max() <= tolerance, f"{text}, not {1000 * value:.4g}")


def swing_kept(
    outcome: Outcome,
    *,
    window: int,
    min: float,
    max: float = np.inf,
    system: str | None = None,
    of: str | None = None,
) -> None:
    """Require the share of a swinging rope's energy that is left.

    That of the last frames against that of the first ones, each their mean: of the
    height of its points above where it hangs straight down, and of their speed.
    """
    fps, points = _rope(outcome, of, system)
    require(0 < 2 * window <= len(points), f"{len(points)} frames, not twice {window}")
    segments = np.linalg.norm(np.diff(points[0], axis=0), axis=1)
    hanging = points[0, 0, 1] - np.concatenate([[0.0], np.cumsum(segments)])
    speed = np.gradient(points, 1.0 / fps, axis=0)
    height = GRAVITY * (points[:, :, 1] - hanging)
    energy = (0.5 * (speed**2).sum(axis=2) + height).sum(axis=1)
    first, last = energy[:window].mean(), energy[-window:].mean()
    require(first > 1e-9, "it does not swing")
    share = float(last / first)
    require(min <= share <= max, f"{share:.4f} of its energy is left, not {min}")


def rim_moves_m(
    outcome: Outcome,
    *,
    count: int,
    max: float,
    system: str | None = None,
    of: str | None = None,
) -> None:
    """Require that the points on the rim of a cloth stay, and how many they are."""
    _, prim, points = read_points(outcome, of, system, UsdGeom.Mesh)
    rim = _rim(UsdGeom.Mesh(prim))
    require(len(rim) == count > 0, f"{len(rim)} points on the rim, not {count}")
    moves = np.linalg.norm(points[:, rim] - points[:1, rim], axis=2)
    text = f"a point of the rim moves {moves.max():.3g} m"
    require(moves.max() <= max, f"{text}, at most {max}")


def _rim(mesh: UsdGeom.Mesh) -> list[int]:
    """Return the points of edges that one face has."""
    indices = list(mesh.GetFaceVertexIndicesAttr().Get() or ())
    edges: Counter[tuple[int, int]] = Counter()
    begin = 0
    for corners in mesh.GetFaceVertexCountsAttr().Get() or ():
        face = indices[begin : begin + corners]
        begin += corners
        for a, b in zip(face, [*face[1:], face[0]], strict=True):
            edges[min(a, b), max(a, b)] += 1
    return sorted(
        {point for edge, faces in edges.items() if faces == 1 for point in edge}
    )


CHECKS = {
    "rim_moves_m": rim_moves_m,
    "rope_stretch_m": rope_stretch_m,
    "swing_kept": swing_kept,
}
