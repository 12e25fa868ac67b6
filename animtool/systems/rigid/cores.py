"""Convex cores of shapes, and their mass properties.

Meshes that are not convex are decomposed by the package coacd, if it is installed.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from importlib.util import find_spec

import numpy as np

from animtool.core.array_types import FloatArray, IntArray
from animtool.core.record import dataclass
from animtool.maths import so3
from animtool.sim.colliders import Box, Capsule, Mesh, Shape, Sphere

# Hull faces with normals closer than this are merged [rad].
COPLANAR_ANGLE = 1e-6
# A mesh is convex if its volume differs from its hull's by less than this fraction.
CONVEX_TOLERANCE = 1e-3

# Box faces: +x, -x and so on; corner i is on +x if its bit 0 is set, and so on.
_BOX_FACES = (
    (1, 3, 7, 5), (0, 4, 6, 2), (2, 6, 7, 3), (0, 1, 5, 4), (4, 5, 7, 6), (0, 2, 3, 1),
)  # fmt: skip
# Number of facets around displayed spheres and capsules.
FACET_COUNT = 16
# Largest deviation of pieces from the mesh, relative to its size; coacd's default.
CONCAVITY_THRESHOLD = 0.05
# Number of surface points that measure the deviation.
MANIFOLD_RESOLUTION = 400
INSTALL_COMMAND = "pip install 'animtool[convex]'"


@dataclass(frozen=True, slots=True)
class ConvexCore:
    """A convex shape: the hull of points, rounded by a radius."""

    points: FloatArray  # (P, 3) [m]
    faces: Sequence[IntArray]  # corners, counter-clockwise from outside
    radius: float = 0.0  # distance from the hull of the points to the surface [m]

    def transformed(self, translation: FloatArray, rotation: FloatArray) -> ConvexCore:
        """Return the core rotated by a quaternion and moved by ``(3,)`` [m]."""
        points = translation + so3.rotate(rotation, self.points)
        return ConvexCore(points, self.faces, self.radius)


@dataclass(frozen=True, slots=True)
class SolidProperties:
    """Volume, centre of mass and inertia of a solid of density 1."""

    volume: float  # [m³]
    centre: FloatArray  # (3,) [m]
    inertia: FloatArray  # inertia about the centre of mass (3, 3) [m⁵]

    def transformed(
        self, translation: FloatArray, rotation: FloatArray
    ) -> SolidProperties:
        """Return the properties after a rotation and a translation."""
        matrix = so3.to_matrix(rotation)
        centre = translation + so3.rotate(rotation, self.centre)
        return SolidProperties(self.volume, centre, matrix @ self.inertia @ matrix.T)


def combine_solids(
    solids: Sequence[SolidProperties], densities: Sequence[float]
) -> SolidProperties:
    """Return the combined mass properties of solids with densities [kg/m³].

    In the result, ``volume`` holds the mass [kg], and the inertia is in [kg m²].
    """
    masses = np.array([solid.volume for solid in solids]) * np.array(densities)
    centres = np.array([solid.centre for solid in solids])
    centre = masses @ centres / masses.sum()
    inertia = np.zeros((3, 3))
    for solid, density, mass in zip(solids, densities, masses, strict=True):
        inertia += density * solid.inertia
        inertia += point_inertia(mass, solid.centre - centre)
    return SolidProperties(float(masses.sum()), centre, inertia)


def point_inertia(mass: float, offset: FloatArray) -> FloatArray:
    """Return the inertia ``(3, 3)`` of a point mass at an offset from the origin."""
    return mass * (offset @ offset * np.eye(3) - np.outer(offset, offset))


def core_of(shape: Shape) -> ConvexCore:
    """Return the convex core of a shape; for a mesh, its convex hull."""
    match shape:
        case Sphere():
            return ConvexCore(np.array([shape.centre], np.float64), [], shape.radius)
        case Capsule():
            ends = shape.anchors() if shape.length else shape.anchors()[:1]
            return ConvexCore(ends, [], shape.radius)
        case Box():
            half_extents = shape.sizes()
            signs = np.indices((2, 2, 2)).reshape(3, 8)[::-1].T * 2.0 - 1.0
            faces = [np.array(face) for face in _BOX_FACES]
            return ConvexCore(signs * half_extents, faces)
        case Mesh():
            return _convex_hull(np.asarray(shape.points, np.float64))
    raise ValueError("a plane is infinite: use it as a collider, not as a body")


def _convex_hull(points: FloatArray) -> ConvexCore:
    """Return the convex hull of points, with coplanar triangles merged."""
    from scipy.spatial import ConvexHull, QhullError

    try:
        hull = ConvexHull(points)
    except QhullError:
        raise ValueError("its points are coplanar: it has no volume") from None
    # Coplanar triangles are merged to one face.
    normals, plane_groups = hull.equations[:, :3], []
    remaining_faces = list(range(len(normals)))
    while remaining_faces:
        first_face = remaining_faces[0]
        differences = normals[remaining_faces] - normals[first_face]
        is_coplanar = np.linalg.norm(differences, axis=1) < COPLANAR_ANGLE
        plane_groups.append(
            (normals[first_face], np.array(remaining_faces)[is_coplanar])
        )
        remaining_faces = np.array(remaining_faces)[~is_coplanar].tolist()
    corners = np.unique(hull.simplices)
    new_indices = np.full(len(points), -1)
    new_indices[corners] = np.arange(len(corners))
    faces = []
    for normal, triangles in plane_groups:
        face_corners = np.unique(hull.simplices[triangles])
        offsets = points[face_corners] - points[face_corners].mean(axis=0)
        tangent = np.cross(normal, offsets[0])
        parallel = offsets @ offsets[0] * np.linalg.norm(normal)
        angles = np.arctan2(offsets @ tangent, parallel)
        faces.append(new_indices[face_corners[np.argsort(angles)]])
    return ConvexCore(points[corners], faces)


def core_solid(shape: Shape, core: ConvexCore) -> SolidProperties:
    """Return the mass properties of a shape of density 1; for a mesh, of its hull."""
    match shape:
        case Sphere(radius=r):
            volume = 4 / 3 * np.pi * r**3
            inertia = 0.4 * volume * r * r * np.eye(3)
            return SolidProperties(volume, core.points[0], inertia)
        case Capsule():
            return _capsule_properties(shape)
        case Box():
            volume = float(np.prod(shape.size))
            squared_sizes = np.square(np.asarray(shape.size, np.float64))
            inertia = np.diag(squared_sizes.sum() - squared_sizes) * volume / 12
            return SolidProperties(volume, np.zeros(3), inertia)
    return hull_solid(core)


def hull_solid(core: ConvexCore) -> SolidProperties:
    """Return the mass properties of the hull of a core's points, of density 1."""
    triangles = [
        core.points[[face[0], face[k], face[k + 1]]]
        for face in core.faces
        for k in range(1, len(face) - 1)
    ]
    return enclosed_solid(np.array(triangles))


def _capsule_properties(shape: Capsule) -> SolidProperties:
    """Return the mass properties of a capsule of density 1."""
    r, length = shape.radius, shape.length
    cylinder_volume, caps_volume = np.pi * r * r * length, 4 / 3 * np.pi * r**3
    # Two hemispheres, with centres 3/8 of the radius beyond the ends of the segment.
    axial_moment = 0.5 * cylinder_volume * r * r + 0.4 * caps_volume * r * r
    transverse_moment = cylinder_volume * (r * r / 4 + length**2 / 12)
    transverse_moment += caps_volume * (
        0.4 * r * r + length**2 / 4 + 3 / 8 * length * r
    )
    axis = np.asarray(shape.axis, np.float64) / np.linalg.norm(shape.axis)
    inertia = transverse_moment * np.eye(3) + (
        axial_moment - transverse_moment
    ) * np.outer(axis, axis)
    centre = np.asarray(shape.centre, np.float64)
    return SolidProperties(cylinder_volume + caps_volume, centre, inertia)


def enclosed_solid(triangles: FloatArray) -> SolidProperties:
    """Return the mass properties of the volume enclosed by triangles ``(T, 3, 3)``.

    Eberly (2002), "Polyhedral mass properties (revisited)", in the sums of Blow and
    Binstock (2004).
    """
    origin = triangles.reshape(-1, 3).mean(axis=0)
    a, b, c = (triangles - origin).swapaxes(0, 1)
    volumes = np.einsum("ti,ti->t", a, np.cross(b, c)) / 6
    volume = float(volumes.sum())
    corner_sums = a + b + c
    centre = volumes @ corner_sums / 4 / volume
    products = sum(
        np.einsum("t,ti,tj->ij", volumes, p, p) for p in (a, b, c, corner_sums)
    )
    moment_matrix = np.asarray(products) / 20 - volume * np.outer(centre, centre)
    inertia = np.trace(moment_matrix) * np.eye(3) - moment_matrix
    return SolidProperties(volume, origin + centre, inertia)


def is_convex(mesh: Mesh, hull_properties: SolidProperties) -> bool:
    """Return whether a closed mesh is convex: equal in volume to its hull."""
    points, triangles = mesh.weld()
    volume = abs(enclosed_solid(points[triangles]).volume)
    hull_volume = hull_properties.volume
    return abs(volume - hull_volume) <= CONVEX_TOLERANCE * hull_volume


def core_mesh(core: ConvexCore) -> tuple[FloatArray, IntArray, IntArray]:
    """Return points, corner counts and corners of a display mesh of a core."""
    if core.faces:
        counts = np.array([len(face) for face in core.faces])
        return core.points, counts, np.concatenate(core.faces).astype(np.int64)
    first_end, last_end = core.points[0], core.points[-1]
    axis = last_end - first_end
    length = float(np.linalg.norm(axis))
    y_axis = axis / length if length else np.array([0.0, 1.0, 0.0])
    x_axis = np.cross(y_axis, [1.0, 0, 0] if abs(y_axis[0]) < 0.9 else [0.0, 1, 0])
    x_axis /= np.linalg.norm(x_axis)
    cap_axes = np.stack([x_axis, y_axis, np.cross(x_axis, y_axis)])
    angles = np.arange(FACET_COUNT) * (2 * np.pi / FACET_COUNT)
    circle = np.stack([np.cos(angles), np.ones(FACET_COUNT), np.sin(angles)], axis=1)
    rings, rings_per_cap = [], FACET_COUNT // 4
    for i, height in enumerate([*range(1 - rings_per_cap, 1), *range(rings_per_cap)]):
        angle = height * np.pi / 2 / rings_per_cap
        ring = circle * np.array([np.cos(angle), np.sin(angle), np.cos(angle)])
        end = first_end if i < rings_per_cap else last_end
        rings.append(end + core.radius * ring @ cap_axes)
    # A sphere has one ring at its equator.
    rings = rings if length else rings[:rings_per_cap] + rings[rings_per_cap + 1 :]
    offset = core.radius * y_axis
    points = np.concatenate([*rings, [first_end - offset, last_end + offset]])
    ring_count, facets = len(rings), np.arange(FACET_COUNT)
    next_facets = (facets + 1) % FACET_COUNT
    quads = [
        np.stack([r * FACET_COUNT + facets, (r + 1) * FACET_COUNT + facets,
                  (r + 1) * FACET_COUNT + next_facets, r * FACET_COUNT + next_facets],
                 axis=1)
        for r in range(ring_count - 1)
    ]  # fmt: skip
    bottom_pole = np.full(FACET_COUNT, ring_count * FACET_COUNT)
    last_ring = (ring_count - 1) * FACET_COUNT
    caps = [
        np.stack([bottom_pole, facets, next_facets], axis=1),
        np.stack(
            [bottom_pole + 1, last_ring + next_facets, last_ring + facets], axis=1
        ),
    ]
    counts = np.repeat([4, 3], [FACET_COUNT * (ring_count - 1), 2 * FACET_COUNT])
    corners = np.concatenate([*(q.ravel() for q in quads), *(c.ravel() for c in caps)])
    return points, counts, corners


def can_decompose() -> bool:
    """Return whether the package for convex decomposition is installed."""
    return find_spec("coacd") is not None


def convex_pieces(mesh: Mesh) -> list[tuple[Mesh, ConvexCore]]:
    """Return the convex decomposition of a mesh, deterministic; empty if it is open.

    Wei, Liu, Ling and Su (2022), "Approximate convex decomposition for 3D meshes with
    collision-aware concavity and tree search".
    """
    if not mesh.is_watertight:
        return []
    points, triangles = mesh.weld()
    return _decompose(points.tobytes(), triangles.tobytes())


@lru_cache(maxsize=64)
def _decompose(
    point_bytes: bytes, corner_bytes: bytes
) -> list[tuple[Mesh, ConvexCore]]:
    """Return the cached convex decomposition of points and triangles."""
    import coacd

    points = np.frombuffer(point_bytes, np.float64).reshape(-1, 3)
    triangles = np.frombuffer(corner_bytes, np.int32).reshape(-1, 3)
    coacd.set_log_level("off")
    hulls = coacd.run_coacd(
        coacd.Mesh(points, triangles),
        threshold=CONCAVITY_THRESHOLD,
        preprocess_mode="off",
        resolution=MANIFOLD_RESOLUTION,
        seed=0,
    )
    pieces = []
    for vertices, faces in hulls:
        piece_mesh = Mesh(
            np.asarray(vertices, np.float64), np.asarray(faces), closed=True
        )
        try:
            pieces.append((piece_mesh, core_of(piece_mesh)))
        except ValueError:
            # Pieces without volume support nothing.
            continue
    return pieces


def mesh_solid(mesh: Mesh) -> SolidProperties:
    """Return the mass properties of a watertight mesh of density 1."""
    points, triangles = mesh.weld()
    solid = enclosed_solid(points[triangles])
    if solid.volume > 0:
        return solid
    return enclosed_solid(points[triangles[:, ::-1]])


def excess_volume(mesh: Mesh, cores: Sequence[ConvexCore]) -> float:
    """Return the excess volume of the pieces, relative to the mesh volume [1]."""
    volume = mesh_solid(mesh).volume
    return sum(hull_solid(core).volume for core in cores) / volume - 1
