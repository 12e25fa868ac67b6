"""Meshes and colliders."""

from __future__ import annotations

from typing import Any

import numpy as np

from animtool import _kernels
from fuzz.kernels import Maker
from fuzz.kernels.curves import rotations

Rng = np.random.Generator


def mesh(rng: Rng) -> dict[str, Any]:
    """Return points and triangles, some of these degenerate."""
    points, triangles = int(rng.integers(3, 20)), int(rng.integers(1, 40))
    return {
        "points": rng.normal(size=(points, 3)),
        "triangles": rng.integers(0, points, (triangles, 3), dtype=np.int32),
    }


def colliders(rng: Rng) -> tuple[Any, ...]:
    """Return colliders of all kinds, as kernels take them."""
    count = int(rng.integers(0, 4))
    kinds = np.zeros((count, 3), np.int64)
    kinds[:, 0] = rng.integers(0, 5, count)
    kinds[:, 1] = rng.integers(0, 2, count)
    sizes = rng.uniform(0.1, 2, (count, 7))
    sizes[kinds[:, 0] == 0, :3] = [0, 1, 0]
    materials = rng.uniform(0, 1, (count, 4))
    poses = np.zeros((count, 2, 7))
    poses[..., :3] = rng.normal(size=(count, 2, 3))
    poses[..., 3:] = rotations(rng, count, 2)
    made = mesh(rng)
    tree = _kernels.build_mesh_tree(**made)
    return kinds, sizes, materials, poses, made["points"], *tree


def _collide(rng: Rng) -> dict[str, Any]:
    count = int(rng.integers(0, 6))
    before = rng.normal(size=(2, count, 3))
    after = before + rng.normal(size=(2, count, 3))
    return {
        "colliders": colliders(rng),
        "before": before,
        "after": after,
        "radii": rng.uniform(0, 0.2, count),
        "begins": rng.choice([0.0, 0.01], count),
        "step": 0.04,
    }


def _sample(rng: Rng) -> dict[str, Any]:
    return {
        "colliders": colliders(rng),
        "points": rng.normal(size=(rng.integers(0, 9), 3)),
        "fraction": float(rng.uniform(0, 1)),
        "step": 0.04,
    }


def _distances(rng: Rng) -> dict[str, Any]:
    made = mesh(rng)
    return {
        "self": _kernels.MeshSurface(**made),
        "positions": made["points"] + rng.normal(size=made["points"].shape),
        "points": rng.normal(size=(rng.integers(0, 9), 3)),
    }


CALLS: dict[str, Maker] = {
    "build_mesh_tree": mesh,
    "MeshSurface": mesh,
    "MeshSurface.distances": _distances,
    "collide_particles": _collide,
    "sample_colliders": _sample,
}
UNBOUNDED: frozenset[str] = frozenset()
