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


def check_surface() -> None:
    """Raise if the packages that surfaces need are missing."""
    if find_spec("skimage") is None:
        message = "the surface of a fluid needs scikit-image, which is not installed"
        hint = "pip install 'animtool[surface]'"
        raise OptionError(Fault("SIM065", message, where="surface", hint=hint))


def surface_of(
    spec: FluidModel,
    points: FloatArray,
    velocities: FloatArray,
    primvars: Mapping[str, Any],
) -> MeshFrame:
    """Return the surface of particles ``(N, 3)``; its faces change by frame.

    Velocities and primvars are those of the nearest particle.
    """
    assert spec.surface is not None
    if not len(points):
        return _surface_mesh(
            points, velocities, np.zeros((0, 3), np.int64), dict(primvars)
        )
    from scipy.spatial import cKDTree
    from skimage.measure import marching_cubes

    cell = spec.surface.cell or DEFAULT_CELL * spec.spacing
    radius = (1 + spec.surface.smoothing) * spec.spacing
    low = points.min(axis=0) - radius - 2 * cell
    sizes = np.ceil((points.max(axis=0) + radius + 2 * cell - low) / cell) + 1
    if np.prod(sizes) > spec.surface.max_cells:
        message = f"its surface needs {np.prod(sizes):,.0f} cells of {cell:g} m, but "
        message += f"{spec.surface.max_cells:,} are allowed: it is spread far"
        hint = "drain stray particles, use larger cells, or raise max_cells"
        raise OptionError(Fault("SIM064", message, where="surface", hint=hint))
    shape = tuple(int(size) for size in sizes)
    values = density_field(points, low, shape, cell, radius, spec.spacing)
    if not values.max() > ISO_LEVEL:
        vertex_primvars = {name: array[:0] for name, array in primvars.items()}
        return _surface_mesh(
            points[:0], points[:0], np.zeros((0, 3), np.int64), vertex_primvars
        )
    vertices, faces, _, _ = marching_cubes(values, ISO_LEVEL)
    # Winding so that the field decreases outwards.
    vertices, faces = vertices.astype(np.float64) * cell + low, faces[:, ::-1]
    _, nearest = cKDTree(points).query(vertices)
    vertex_primvars = {name: values[nearest] for name, values in primvars.items()}
    return _surface_mesh(
        vertices, velocities[nearest], faces.astype(np.int64), vertex_primvars
    )


def _surface_mesh(
    points: FloatArray, velocities: FloatArray, faces: Any, primvars: dict[str, Any]
) -> MeshFrame:
    counts = np.full(len(faces), 3, np.int64)
    return MeshFrame(
        points, velocities, counts, faces.reshape(-1), True, primvars, tears=True
    )


def density_field(
    points: FloatArray,
    low: FloatArray,
    shape: tuple[int, ...],
    cell: float,
    radius: float,
    spacing: float,
) -> FloatArray:
    """Return the fluid fraction around grid nodes.

    Sums of H. Wendland's C2 function over particles ``(N, 3)``; 1 within.
    """
    nodes = np.floor((points - low) / cell).astype(np.int64)
    cell_range = int(np.ceil(radius / cell))
    values = np.zeros(int(np.prod(shape)))
    strides = np.array([shape[1] * shape[2], shape[2], 1])
    scale = (spacing / radius) ** 3 / KERNEL_INTEGRAL
    for offset in product(range(-cell_range, cell_range + 2), repeat=3):
        corner = nodes + offset
        q = np.linalg.norm(corner * cell + low - points, axis=1) / radius
        is_near = q < 1
        if is_near.any():
            q = q[is_near]
            weights = scale * (1 - q) ** 4 * (4 * q + 1)
            values += np.bincount(corner[is_near] @ strides, weights, len(values))
    return values.reshape(shape)
