"""Surface meshes of fluids: marching cubes over a density field."""

from __future__ import annotations

from collections.abc import Mapping
from importlib.util import find_spec
from itertools import product
from typing import Any

import numpy as np

from animtool.core.array_types import FloatArray
from animtool.core.errors import Fault, OptionError
from animtool.motion.frames import MeshFrame
from animtool.systems.fluid.spec import FluidModel

# Iso level, low enough for the surface of a single particle.
ISO_LEVEL = 0.35
# Default cell size, in spacings.
DEFAULT_CELL = 0.75
# Integral of H. Wendland's C2 function over a ball of radius 1.
KERNEL_INTEGRAL = 2 * np.pi / 21
_NO_FACES = np.zeros((0, 3), np.int64)


def check_surface() -> None:
    """Raise SIM065 if scikit-image is not installed."""
    if find_spec("skimage") is None:
        message = "the surface of a fluid needs scikit-image, which is not installed"
        hint = "pip install 'animtool[surface]'"
        raise OptionError(Fault("SIM065", message, where="surface", hint=hint))


def build_surface(
    spec: FluidModel,
    points: FloatArray,
    velocities: FloatArray,
    primvars: Mapping[str, Any],
) -> MeshFrame:
    """Return the surface mesh of particles ``(N, 3)``; the topology differs by frame.

    Each vertex has the velocity and primvars of the nearest particle.
    """
    assert spec.surface is not None
    if not len(points):
        return _surface_mesh(points, velocities, _NO_FACES, dict(primvars))
    from scipy.spatial import cKDTree
    from skimage.measure import marching_cubes

    cell_size = spec.surface.cell or DEFAULT_CELL * spec.spacing
    radius = (1 + spec.surface.smoothing) * spec.spacing
    grid_origin = points.min(axis=0) - radius - 2 * cell_size
    grid_size = points.max(axis=0) + radius + 2 * cell_size - grid_origin
    node_counts = np.ceil(grid_size / cell_size) + 1
    if np.prod(node_counts) > spec.surface.max_cells:
        message = (
            f"its surface needs {np.prod(node_counts):,.0f} cells of {cell_size:g} m, "
        )
        message += f"but {spec.surface.max_cells:,} are allowed: it is spread far"
        hint = "drain stray particles, use larger cells, or raise max_cells"
        raise OptionError(Fault("SIM064", message, where="surface", hint=hint))
    shape = tuple(int(size) for size in node_counts)
    values = density_field(points, grid_origin, shape, cell_size, radius, spec.spacing)
    if not values.max() > ISO_LEVEL:
        vertex_primvars = {name: array[:0] for name, array in primvars.items()}
        return _surface_mesh(points[:0], points[:0], _NO_FACES, vertex_primvars)
    vertices, faces, _, _ = marching_cubes(values, ISO_LEVEL)
    # Winding so that the field decreases outwards.
    vertices, faces = (
        vertices.astype(np.float64) * cell_size + grid_origin,
        faces[:, ::-1],
    )
    _, nearest_particles = cKDTree(points).query(vertices)
    vertex_primvars = {
        name: values[nearest_particles] for name, values in primvars.items()
    }
    faces = faces.astype(np.int64)
    return _surface_mesh(
        vertices, velocities[nearest_particles], faces, vertex_primvars
    )


def _surface_mesh(
    points: FloatArray, velocities: FloatArray, faces: Any, primvars: dict[str, Any]
) -> MeshFrame:
    """Return a surface as a frame."""
    counts = np.full(len(faces), 3, np.int64)
    return MeshFrame(
        points, velocities, counts, faces.reshape(-1), True, primvars, tears=True
    )


def density_field(
    points: FloatArray,
    grid_origin: FloatArray,
    shape: tuple[int, ...],
    cell_size: float,
    radius: float,
    spacing: float,
) -> FloatArray:
    """Return the fluid fraction at the nodes of a grid.

    This is the sum of Wendland's C2 kernel over particles ``(N, 3)``; 1 in fluid.
    """
    node_indices = np.floor((points - grid_origin) / cell_size).astype(np.int64)
    cell_range = int(np.ceil(radius / cell_size))
    values = np.zeros(int(np.prod(shape)))
    strides = np.array([shape[1] * shape[2], shape[2], 1])
    scale = (spacing / radius) ** 3 / KERNEL_INTEGRAL
    for offset in product(range(-cell_range, cell_range + 2), repeat=3):
        corner_indices = node_indices + offset
        distances = np.linalg.norm(
            corner_indices * cell_size + grid_origin - points, axis=1
        )
        relative_distances = distances / radius
        is_near = relative_distances < 1
        if is_near.any():
            r = relative_distances[is_near]
            weights = scale * (1 - r) ** 4 * (4 * r + 1)
            values += np.bincount(
                corner_indices[is_near] @ strides, weights, len(values)
            )
    return values.reshape(shape)
