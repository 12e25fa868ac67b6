"""How cloth lies on a character by frame: pierced edges, depth and strain, by pxr.

    python tests/bench/readers/garments.py dance.usdc --cloth cape --skin body
    python tests/bench/readers/garments.py dance.usdc --by-frame frames.csv

Nothing of animtool is asked: points are those that the stage has at each time code, in
the world (skins need to be written deformed). An edge pierces a triangle that has
neither of its ends where it goes through it: edges of the cloth through triangles of
skin and of cloth, and edges of the skin through triangles of cloth, each pair once. A
point is inside the skin where it is behind a nearest triangle and the winding number of
all of them is over a half, as deep as that triangle is far. Strain is how much longer
or shorter sides of faces are than those of the mesh of the file ``--rest``, or at the
first time code where none is named; sides between two of its ``pins`` are as the
animation has them, and not looked at.
"""

from __future__ import annotations

import argparse
import csv
from pathlib import Path

import numpy as np
import numpy.typing as npt
from pxr import Usd, UsdGeom
from scipy.spatial import cKDTree

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int64]
# Points farther from the skin than this are not asked whether they are inside [m].
NEAR = 0.05
# Nearest triangles are among so many with the nearest middles.
AMONG = 24
# Triangles are as near as each other where distances differ by less [m].
TIED = 1e-6
COLUMNS = (
    "frame",
    "cloth_through_skin",
    "skin_through_cloth",
    "cloth_through_cloth",
    "inside",
    "deepest_mm",
    "strain_99",
    "strain_max",
)


class Surface:
    """A mesh over time: corners of its triangles, sides of its faces, points."""

    def __init__(self, mesh: UsdGeom.Mesh) -> None:
        self.mesh = mesh
        counts = np.array(mesh.GetFaceVertexCountsAttr().Get(), np.int64)
        corners = np.array(mesh.GetFaceVertexIndicesAttr().Get(), np.int64)
        firsts = np.cumsum(counts) - counts
        fans, sides = [], []
        for first, count in zip(firsts.tolist(), counts.tolist(), strict=True):
            face = corners[first : first + count]
            sides += list(zip(face, np.roll(face, -1), strict=True))
            fans += [(face[0], face[k], face[k + 1]) for k in range(1, count - 1)]
        self.triangles: Ints = np.array(fans, np.int64).reshape(-1, 3)
        self.sides: Ints = _pairs(np.array(sides, np.int64))
        each = self.triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
        self.edges: Ints = _pairs(each)

    def points(self, time: Usd.TimeCode) -> Floats:
        """Return where its points are in the world ``(N, 3)`` [m]."""
        local = np.array(self.mesh.GetPointsAttr().Get(time), np.float64)
        rows = np.array(self.mesh.ComputeLocalToWorldTransform(time))
        unit = UsdGeom.GetStageMetersPerUnit(self.mesh.GetPrim().GetStage())
        return np.asarray((local @ rows[:3, :3] + rows[3, :3]) * unit)


def _pairs(pairs: Ints) -> Ints:
    return np.unique(np.sort(pairs, axis=1), axis=0)


def pierced(
    x: Floats, edges: Ints, y: Floats, triangles: Ints, *, own: bool = False
) -> int:
    """Return how many pairs of an edge and a triangle there are, one through the other.

    Where both are of one mesh (``own``), those that share a point are left out.
    """
    a, b = x[edges[:, 0]], x[edges[:, 1]]
    corners = y[triangles]
    middles = corners.mean(axis=1)
    round_ = np.linalg.norm(corners - middles[:, None], axis=2).max(axis=1)
    half = np.linalg.norm(b - a, axis=1) / 2
    tree = cKDTree(middles)
    near = tree.query_ball_point((a + b) / 2, half + round_.max())
    e = np.repeat(np.arange(len(edges)), [len(one) for one in near])
    t = np.fromiter((k for one in near for k in one), np.int64, len(e))
    if own:
        shared = (edges[e][:, :, None] == triangles[t][:, None]).any(axis=(1, 2))
        e, t = e[~shared], t[~shared]
    p, q = a[e], b[e]
    u, v, w = (corners[t, k] for k in range(3))
    normal = np.cross(v - u, w - u)
    first = ((p - u) * normal).sum(1)
    last = ((q - u) * normal).sum(1)
    across = first * last < 0
    share = np.where(across, first / np.where(across, first - last, 1.0), 0.0)
    at = p + share[:, None] * (q - p)
    for one, other in ((u, v), (v, w), (w, u)):
        across &= (np.cross(other - one, at - one) * normal).sum(1) > 0
    return int(across.sum())


def distances(points: Floats, corners: Floats) -> tuple[Floats, Floats]:
    """Return how far points ``(N, 3)`` are from triangles, each its own ``(N, 3, 3)``.

    With how high they are above the planes of these.
    """
    a, b, c = corners.transpose(1, 0, 2)
    best = np.full(len(points), np.inf)
    for one, other in ((a, b), (b, c), (c, a)):
        way = other - one
        square = np.maximum((way * way).sum(1), 1e-300)
        share = np.clip(((points - one) * way).sum(1) / square, 0, 1)
        off = np.linalg.norm(points - one - share[:, None] * way, axis=1)
        best = np.minimum(best, off)
    normal = np.cross(b - a, c - a)
    size = np.maximum(np.linalg.norm(normal, axis=1), 1e-300)
    unit = normal / size[:, None]
    height = ((points - a) * unit).sum(1)
    foot = points - height[:, None] * unit
    within = np.ones(len(points), bool)
    for one, other in ((a, b), (b, c), (c, a)):
        within &= (np.cross(other - one, foot - one) * normal).sum(1) >= 0
    return np.where(within, np.minimum(best, np.abs(height)), best), height


def winding(points: Floats, corners: Floats) -> Floats:
    """Return how often triangles ``(T, 3, 3)`` go round points ``(N, 3)``."""
    found = np.zeros(len(points))
    for n, point in enumerate(points):
        a, b, c = (corners - point).transpose(1, 0, 2)
        la, lb, lc = (np.linalg.norm(one, axis=1) for one in (a, b, c))
        top = (a * np.cross(b, c)).sum(1)
        low = la * lb * lc + (a * b).sum(1) * lc
        low += (b * c).sum(1) * la + (c * a).sum(1) * lb
        found[n] = np.arctan2(top, low).sum() / (2 * np.pi)
    return found


def depths(points: Floats, skin: Floats, triangles: Ints) -> Floats:
    """Return how deep points that are inside a skin are ``(N,)`` [m], 0 outside."""
    corners = skin[triangles]
    tree = cKDTree(corners.mean(axis=1))
    near, which = tree.query(points, k=min(AMONG, len(triangles)))
    close = np.flatnonzero(near[:, 0] < NEAR)
    rows = which[close]
    spread = np.repeat(points[close], rows.shape[1], axis=0)
    off, height = distances(spread, corners[rows.ravel()])
    off, height = off.reshape(rows.shape), height.reshape(rows.shape)
    least = off.min(axis=1)
    behind = ((off < least[:, None] + TIED) & (height < 0)).any(axis=1)
    close, least = close[behind], least[behind]
    made = np.zeros(len(points))
    inside = winding(points[close], corners) > 0.5
    made[close[inside]] = least[inside]
    return made


def strains(x: Floats, rest: Floats, sides: Ints) -> Floats:
    """Return by how much sides are longer or shorter than at rest [1]."""

    def lengths(points: Floats) -> Floats:
        return np.asarray(
            np.linalg.norm(points[sides[:, 0]] - points[sides[:, 1]], axis=1)
        )

    before = lengths(rest)
    kept = before > 0
    return np.asarray(lengths(x)[kept] / before[kept] - 1)


def measure(
    path: Path, cloth: str, skin: str, rest_of: Path | None
) -> list[tuple[float, ...]]:
    """Return a row of `COLUMNS` for each frame of a layer."""
    stage = Usd.Stage.Open(str(path))
    named = {
        prim.GetName(): Surface(UsdGeom.Mesh(prim))
        for prim in stage.Traverse()
        if prim.IsA(UsdGeom.Mesh) and prim.GetName() in {cloth, skin}
    }
    garment, body = named[cloth], named.get(skin)
    times = garment.mesh.GetPointsAttr().GetTimeSamples()
    rest = garment.points(Usd.TimeCode(times[0]))
    sides = garment.sides
    if rest_of is not None:
        with np.load(rest_of) as archive:
            rest = archive["points"]
            held = np.isin(sides, archive["pins"]) if "pins" in archive else sides < 0
        sides = sides[~held.all(axis=1)]
    rows: list[tuple[float, ...]] = []
    for time in times:
        x = garment.points(Usd.TimeCode(time))
        through = [0, 0, pierced(x, garment.edges, x, garment.triangles, own=True)]
        deep = np.zeros(len(x))
        if body is not None:
            y = body.points(Usd.TimeCode(time))
            low, high = x.min(axis=0) - NEAR, x.max(axis=0) + NEAR
            ends = y[body.edges]
            about = ((ends >= low) & (ends <= high)).all(axis=2).any(axis=1)
            through[0] = pierced(x, garment.edges, y, body.triangles)
            through[1] = pierced(y, body.edges[about], x, garment.triangles)
            deep = depths(x, y, body.triangles)
        strain = np.abs(strains(x, rest, sides))
        rows.append(
            (
                time,
                *through,
                int((deep > 0).sum()),
                1000 * float(deep.max()),
                float(np.quantile(strain, 0.99)),
                float(strain.max()),
            )
        )
    return rows


def main() -> None:
    """Print the worst of all frames; write a table of each where it is asked for."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("layers", nargs="+", type=Path)
    parser.add_argument("--cloth", default="cape")
    parser.add_argument("--skin", default="body")
    parser.add_argument("--rest", type=Path, help="a file (.npz) of the mesh at rest")
    parser.add_argument("--by-frame", type=Path, help="a CSV file")
    options = parser.parse_args()
    print(*COLUMNS[1:], sep="  ")
    for path in options.layers:
        rows = measure(path, options.cloth, options.skin, options.rest)
        worst = np.array(rows)[:, 1:].max(axis=0)
        print(path, "  ".join(f"{value:.4g}" for value in worst))
        if options.by_frame is not None:
            with options.by_frame.open("w", newline="") as file:
                csv.writer(file).writerows([COLUMNS, *rows])


if __name__ == "__main__":
    main()
