"""Convex cores of shapes, and their mass properties."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from animtool.core.array_types import FloatArray, IntArray
from animtool.core.record import dataclass
from animtool.maths import so3
from animtool.sim.colliders import Box, Capsule, Mesh, Shape, Sphere

# Hull faces with normals closer than this are merged [rad].
FLAT = 1e-6
# A mesh whose volume equals its hull's within this fraction is convex.
CONVEX = 1e-3

# Box faces: +x, -x and so on; corner i is on +x if its bit 0 is set, and so on.
_BOX_FACES = (
    (1, 3, 7, 5), (0, 4, 6, 2), (2, 6, 7, 3), (0, 1, 5, 4), (4, 5, 7, 6), (0, 2, 3, 1),
)  # fmt: skip
# Facets around a sphere or capsule end, as drawn.
ROUND = 16


@dataclass(frozen=True, slots=True)
class Core:
    """A convex core: points, faces, and a rounding radius."""

    points: FloatArray  # (P, 3) [m]
    faces: Sequence[IntArray]  # corners, counter-clockwise from outside
    radius: float = 0.0  # [m]

    def placed(self, at: FloatArray, rotation: FloatArray) -> Core:
        """Return it moved by a translation ``(3,)`` [m] and a quaternion ``(4,)``."""
        return Core(at + so3.rotate(rotation, self.points), self.faces, self.radius)


@dataclass(frozen=True, slots=True)
class SolidProperties:
    """Volume, centre and inertia of a solid of density 1."""

    volume: float  # [m³]
    centre: FloatArray  # (3,) [m]
    inertia: FloatArray  # about the centre (3, 3) [m⁵]

    def placed(self, at: FloatArray, rotation: FloatArray) -> SolidProperties:
        """Return them moved to another frame."""
        matrix = so3.to_matrix(rotation)
        centre = at + so3.rotate(rotation, self.centre)
        return SolidProperties(self.volume, centre, matrix @ self.inertia @ matrix.T)


def together(
    solids: Sequence[SolidProperties], densities: Sequence[float]
) -> SolidProperties:
    """Return several solids as one, with mass [kg] as volume and inertia in [kg m²]."""
    masses = np.array([s.volume * d for s, d in zip(solids, densities, strict=True)])
    centres = np.array([s.centre for s in solids])
    centre = masses @ centres / masses.sum()
    inertia = np.zeros((3, 3))
    for solid, density, mass in zip(solids, densities, masses, strict=True):
        off = solid.centre - centre
        inertia += density * solid.inertia
        inertia += mass * (off @ off * np.eye(3) - np.outer(off, off))
    return SolidProperties(float(masses.sum()), centre, inertia)


def core_of(shape: Shape) -> Core:
    """Return the core of a shape; the hull of a mesh.

    Raises:
        ValueError: It has no volume.
    """
    match shape:
        case Sphere():
            return Core(np.array([shape.centre], np.float64), [], shape.radius)
        case Capsule():
            ends = shape.anchors() if shape.length else shape.anchors()[:1]
            return Core(ends, [], shape.radius)
        case Box():
            half_step_text = shape.sizes()
            signs = np.indices((2, 2, 2)).reshape(3, 8)[::-1].T * 2.0 - 1.0
            return Core(signs * half_step_text, [np.array(face) for face in _BOX_FACES])
        case Mesh():
            return _hull(np.asarray(shape.points, np.float64))
    raise ValueError("a plane is infinite: use it as a collider, not as a body")


def _hull(points: FloatArray) -> Core:
    from scipy.spatial import ConvexHull, QhullError

    try:
        hull = ConvexHull(points)
    except QhullError:
        raise ValueError("its points are coplanar: it has no volume") from None
    # Coplanar triangles are merged to one face.
    normals, planes = hull.equations[:, :3], []
    rest = list(range(len(normals)))
    while rest:
        first = rest[0]
        coplanar = np.linalg.norm(normals[rest] - normals[first], axis=1) < FLAT
        planes.append((normals[first], np.array(rest)[coplanar]))
        rest = np.array(rest)[~coplanar].tolist()
    corners = np.unique(hull.simplices)
    number = np.full(len(points), -1)
    number[corners] = np.arange(len(corners))
    faces = []
    for normal, triangles in planes:
        used = np.unique(hull.simplices[triangles])
        off = points[used] - points[used].mean(axis=0)
        across = np.cross(normal, off[0])
        angles = np.arctan2(off @ across, off @ off[0] * np.linalg.norm(normal))
        faces.append(number[used[np.argsort(angles)]])
    return Core(points[corners], faces)


def solid_of(shape: Shape, core: Core) -> SolidProperties:
    """Return the mass properties of a shape of density 1; of a mesh's hull."""
    match shape:
        case Sphere(radius=r):
            volume = 4 / 3 * np.pi * r**3
            return SolidProperties(
                volume, core.points[0], 0.4 * volume * r * r * np.eye(3)
            )
        case Capsule():
            return _capsule(shape)
        case Box():
            volume = float(np.prod(shape.size))
            squares = np.square(np.asarray(shape.size, np.float64))
            return SolidProperties(
                volume, np.zeros(3), np.diag(squares.sum() - squares) * volume / 12
            )
    triangles = [
        (core.points[face[0]], core.points[face[k]], core.points[face[k + 1]])
        for face in core.faces
        for k in range(1, len(face) - 1)
    ]
    return filled(np.array(triangles))


def _capsule(shape: Capsule) -> SolidProperties:
    r, length = shape.radius, shape.length
    middle, ends = np.pi * r * r * length, 4 / 3 * np.pi * r**3
    # Two hemispheres, with centres 3/8 of the radius beyond the ends of the segment.
    along = 0.5 * middle * r * r + 0.4 * ends * r * r
    across = middle * (r * r / 4 + length**2 / 12)
    across += ends * (0.4 * r * r + length**2 / 4 + 3 / 8 * length * r)
    axis = np.asarray(shape.axis, np.float64) / np.linalg.norm(shape.axis)
    inertia = across * np.eye(3) + (along - across) * np.outer(axis, axis)
    return SolidProperties(middle + ends, np.asarray(shape.centre, np.float64), inertia)


def filled(triangles: FloatArray) -> SolidProperties:
    """Return the mass properties enclosed by triangles ``(T, 3, 3)``, by tetrahedra.

    Eberly (2002), "Polyhedral mass properties (revisited)", in the sums of Blow and
    Binstock (2004).
    """
    base = triangles.reshape(-1, 3).mean(axis=0)
    a, b, c = (triangles - base).swapaxes(0, 1)
    volumes = np.einsum("ti,ti->t", a, np.cross(b, c)) / 6
    volume = float(volumes.sum())
    corners = a + b + c
    centre = volumes @ corners / 4 / volume
    products = sum(np.einsum("t,ti,tj->ij", volumes, p, p) for p in (a, b, c, corners))
    second = np.asarray(products) / 20 - volume * np.outer(centre, centre)
    return SolidProperties(volume, base + centre, np.trace(second) * np.eye(3) - second)


def convex(mesh: Mesh, hull: SolidProperties) -> bool:
    """Return whether a closed mesh equals its hull, by volume."""
    points, triangles = mesh.weld()
    inside = abs(filled(points[triangles]).volume)
    return abs(inside - hull.volume) <= CONVEX * hull.volume


def shown(core: Core) -> tuple[FloatArray, IntArray, IntArray]:
    """Return points, corner counts and corners of a mesh that shows a core."""
    if core.faces:
        counts = np.array([len(face) for face in core.faces])
        return core.points, counts, np.concatenate(core.faces).astype(np.int64)
    first, last = core.points[0], core.points[-1]
    axis = last - first
    length = float(np.linalg.norm(axis))
    up = axis / length if length else np.array([0.0, 1.0, 0.0])
    side = np.cross(up, [1.0, 0, 0] if abs(up[0]) < 0.9 else [0.0, 1, 0])
    side /= np.linalg.norm(side)
    frame = np.stack([side, up, np.cross(side, up)])
    around = np.arange(ROUND) * (2 * np.pi / ROUND)
    rings, rings_per_cap = [], ROUND // 4
    heights = [-k for k in range(rings_per_cap - 1, -1, -1)] + list(
        range(rings_per_cap)
    )
    for i, height in enumerate(heights):
        angle = height * np.pi / 2 / rings_per_cap
        ring = np.stack(
            [
                np.cos(around) * np.cos(angle),
                np.full(ROUND, np.sin(angle)),
                np.sin(around) * np.cos(angle),
            ],
            axis=1,
        )
        rings.append(
            (first if i < rings_per_cap else last) + core.radius * ring @ frame
        )
    # A sphere has one ring at its equator.
    rings = rings if length else rings[:rings_per_cap] + rings[rings_per_cap + 1 :]
    poles = np.stack([first - core.radius * up, last + core.radius * up])
    points = np.concatenate([*rings, poles])
    count, k = len(rings), np.arange(ROUND)
    after = (k + 1) % ROUND
    quads = [
        np.stack([r * ROUND + k, (r + 1) * ROUND + k, (r + 1) * ROUND + after,
                  r * ROUND + after], axis=1)
        for r in range(count - 1)
    ]  # fmt: skip
    low, high = count * ROUND, count * ROUND + 1
    top = (count - 1) * ROUND
    caps = [
        np.stack([np.full(ROUND, low), k, after], axis=1),
        np.stack([np.full(ROUND, high), top + after, top + k], axis=1),
    ]
    counts = np.concatenate([np.full(ROUND * (count - 1), 4), np.full(2 * ROUND, 3)])
    corners = np.concatenate([*(q.ravel() for q in quads), *(c.ravel() for c in caps)])
    return points, counts, corners
