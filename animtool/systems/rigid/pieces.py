"""Convex decomposition of meshes by the package coacd, if it is installed."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from importlib.util import find_spec

import numpy as np

from animtool.sim.colliders import Mesh
from animtool.systems.rigid.cores import (
    ConvexCore,
    SolidProperties,
    core_of,
    enclosed_solid,
    hull_solid,
)

# Largest deviation of pieces from the mesh, relative to its size; coacd's default.
CONCAVITY_THRESHOLD = 0.05
# Number of surface points that measure the deviation.
MANIFOLD_RESOLUTION = 400
INSTALL_COMMAND = "pip install 'animtool[convex]'"


def is_available() -> bool:
    """Return whether the package for convex decomposition is installed."""
    return find_spec("coacd") is not None


def convex_pieces(mesh: Mesh) -> list[tuple[Mesh, ConvexCore]]:
    """Return the convex decomposition of a mesh, deterministic; empty if it is open.

    Wei, Liu, Ling and Su (2022), "Approximate convex decomposition for 3D meshes with
    collision-aware concavity and tree search".
    """
    if not mesh.watertight:
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
        piece = Mesh(np.asarray(vertices, np.float64), np.asarray(faces), closed=True)
        try:
            pieces.append((piece, core_of(piece)))
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
