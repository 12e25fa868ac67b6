"""Skin meshes of the character as moving collision surfaces."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import field, replace

import numpy as np

from animtool.core.array_types import BoolArray, FloatArray, IntArray
from animtool.core.record import dataclass
from animtool.maths.faces import directed_edges, triangulate
from animtool.rig.kinematics import bind_matrices
from animtool.rig.parts import AttachKind
from animtool.rig.skeleton import Rig
from animtool.rig.surfaces import Surface, surfaces_of
from animtool.sim.colliders import Collider, Colliders, Mesh
from animtool.skin.character import CharacterMesh, character_meshes
from animtool.systems.attach.poses import LocalPose, PoseSamples, interpolate_poses
from animtool.systems.framework.meter import ClosedSurface
from animtool.systems.springs.shapes import connected_groups

# Minimum distance of cloth from skins, relative to its edge length [1]. It limits how
# deep an edge cuts into a limb.
MIN_CLEARANCE = 1 / 4


@dataclass(frozen=True, slots=True, eq=False)
class SkinSurface:
    """A skinned mesh whose borders are closed by triangle fans."""

    mesh: CharacterMesh  # prepared mesh of V points
    triangles: IntArray  # counter-clockwise ``(T, 3)``; border centres from V on
    border_points: IntArray  # points at borders ``(P,)``
    borders: IntArray  # border index of each border point ``(P,)``
    has_joint_weight: BoolArray  # mask of joints with skin weight ``(J,)``

    def points(self, samples: PoseSamples) -> FloatArray:
        """Return deformed points, then border centres ``(K, V + B, 3)`` [m]."""
        return self.with_border_centres(samples.deform(self.mesh))

    def with_border_centres(self, points: FloatArray) -> FloatArray:
        """Return points ``(K, V, 3)`` and border centres ``(K, V + B, 3)`` [m]."""
        count = int(self.borders.max(initial=-1)) + 1
        middles = np.zeros((len(points), count, 3))
        for border in range(count):
            corners = self.border_points[self.borders == border]
            middles[:, border] = points[:, corners].mean(axis=1)
        return np.ascontiguousarray(np.concatenate([points, middles], axis=1))


@dataclass
class FramePoses:
    """Poses of a character within one frame, cached by number of steps."""

    rig: Rig  # the character
    before: LocalPose  # pose at the start
    after: LocalPose  # pose at the end
    _by_steps: dict[int, PoseSamples] = field(default_factory=dict)
    _skin_points: dict[tuple[int, int], FloatArray] = field(default_factory=dict)

    def sample(self, step_count: int) -> PoseSamples:
        """Return the poses at the ends of ``step_count`` equal steps."""
        if step_count not in self._by_steps:
            self._by_steps[step_count] = interpolate_poses(
                self.rig, self.before, self.after, step_count
            )
        return self._by_steps[step_count]

    def skin_points(self, skin: SkinSurface, step_count: int) -> FloatArray:
        """Return the points of a skin at the ends of the steps ``(K, P, 3)`` [m]."""
        key = id(skin), step_count
        if key not in self._skin_points:
            self._skin_points[key] = skin.points(self.sample(step_count))
        return self._skin_points[key]


def build_skins(rig: Rig, moving_joints: Sequence[int] = ()) -> list[SkinSurface]:
    """Return the skinned meshes of a rig except its cloth, as colliders.

    Faces with a skin weight on the ``moving_joints`` are left out.
    """
    cloth = {entry.mesh for entry in rig.attach if entry.kind == AttachKind.CLOTH}
    surfaces = [
        entry
        for entry in surfaces_of(rig)
        if entry.skin is not None and entry.name not in cloth
    ]
    shapes = [shape.name for shape in rig.shapes]
    meshes = character_meshes(surfaces, rig.names, bind_matrices(rig), shapes)
    skins = [
        _build_skin(rig, surface, mesh, moving_joints)
        for surface, mesh in zip(surfaces, meshes, strict=True)
    ]
    return [skin for skin in skins if len(skin.triangles)]


def _build_skin(
    rig: Rig, surface: Surface, mesh: CharacterMesh, moving_joints: Sequence[int]
) -> SkinSurface:
    """Build the collision surface of a skinned mesh."""
    skin, vertices = surface.skin, surface.points
    assert skin is not None
    joint_indices = np.array([rig.index(name) for name in skin.joints], np.int64)
    is_moving = np.isin(joint_indices[skin.indices], moving_joints)
    has_moving_weight = (skin.weights > 0) & is_moving
    corners = np.asarray(has_moving_weight.any(axis=1))[surface.indices]
    face_of_corner = np.repeat(np.arange(len(surface.counts)), surface.counts)
    is_used = np.bincount(face_of_corner, corners, len(surface.counts)) == 0
    faces = surface.counts[is_used], surface.indices[is_used[face_of_corner]]
    has_weight = np.zeros(len(rig.joints), np.bool_)
    has_weight[joint_indices[skin.indices[skin.weights > 0]]] = True
    has_weight[list(moving_joints)] = False
    capped_faces = triangulate_capped(*faces, len(vertices))
    collider = SkinSurface(mesh, *capped_faces, has_weight)
    (points,) = collider.with_border_centres(vertices[None])
    a, b, c = points[collider.triangles].swapaxes(0, 1)
    if (a * np.cross(b, c)).sum() < 0:
        outward = np.ascontiguousarray(collider.triangles[:, ::-1])
        collider = replace(collider, triangles=outward)
    return collider


def triangulate_capped(
    counts: IntArray, indices: IntArray, point_count: int
) -> tuple[IntArray, IntArray, IntArray]:
    """Triangulate polygons, and close each border with a triangle fan.

    Polygons have ``counts`` corners ``(M,)``, listed in ``indices``. Returns triangles
    ``(T, 3)``, with border middles numbered after the points; border points ``(P,)``;
    and the border index of each.

    >>> corners = np.array([0, 1, 2, 3])
    >>> triangles, points, borders = triangulate_capped(np.array([4]), corners, 4)
    >>> triangles[2:].tolist(), points.tolist(), borders.tolist()
    ([[1, 0, 4], [2, 1, 4], [3, 2, 4], [0, 3, 4]], [0, 1, 2, 3], [0, 0, 0, 0])
    """
    triangles = triangulate(counts, indices)
    edge_corners = directed_edges(counts, indices)
    edge_keys = np.sort(edge_corners, axis=1) @ [point_count, 1]
    _, numbers, uses = np.unique(edge_keys, return_inverse=True, return_counts=True)
    border_edges = edge_corners[uses[numbers.reshape(-1)] == 1]
    points, edge_points = np.unique(border_edges, return_inverse=True)
    edge_points = edge_points.reshape(-1, 2)
    borders = connected_groups(len(points), edge_points) if len(points) else points
    middles = point_count + borders[edge_points[:, 0]]
    fans = np.stack([border_edges[:, 1], border_edges[:, 0], middles], axis=1)
    return np.concatenate([triangles, fans]), points, borders


def skin_margin(edge: float, radius: float) -> float:
    """Return the margin between cloth and skins in addition to the radius [m].

    Long edges need a margin: they cut into a round limb even with both ends outside.

    >>> round(skin_margin(0.04, 0.005), 6), skin_margin(0.01, 0.005)
    (0.005, 0.0)
    """
    return max(0.0, MIN_CLEARANCE * edge - radius)


def contact_offsets(
    surface: ClosedSurface,
    points: FloatArray,
    distance: float,
    *,
    keeps_inside: bool = False,
) -> FloatArray:
    """Return offsets of the contact distance for points near a skin ``(N,)`` [m].

    Offsets are at most 0: points that start closer keep their initial distance. With
    ``keeps_inside``, points that start inside may stay as deep; without, those deeper
    than the distance have an offset of 0.
    """
    mesh = Mesh(surface.points, surface.triangles, closed=True)
    samples = Colliders([Collider(mesh)]).sample(points, 0.0, 1.0)
    distances = samples.distances[0]
    if keeps_inside:
        return np.asarray(np.minimum(distances, distance) - distance)
    # A pose that puts a limb through cloth says nothing about how close it is worn.
    is_through = distances < -distance
    offsets = np.clip(distances, 0.0, distance) - distance
    return np.where(is_through, 0.0, offsets)
