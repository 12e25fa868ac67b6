"""Reports animated meshes without a skin, which a point cache does not contain."""

from __future__ import annotations

from typing import Any

import numpy as np
from pxr import Usd, UsdGeom, UsdSkel

from animtool.core.arguments import argument
from animtool.core.errors import Fault, Severity, counted, listed
from animtool.usd.caches.reader import PointReader
from animtool.usd.caches.writer import bounds_corners
from animtool.usd.props.prim_transforms import world_matrices
from animtool.usd.rigs.placement import (
    DROP_PLACEMENT,
    animated_ancestors,
    fixed_matrices,
)
from animtool.usd.rigs.prims import number_rows, sample_times
from animtool.usd.rigs.skinned import MAX_LISTED_PRIMS, is_rig_mesh, skeleton_bindings

# Maximum times at which a transform is evaluated.
MAX_SAMPLED_TIMES = 256
# Smaller motion is rounding [m].
MOTION_TOLERANCE = 1e-6


def animated_mesh_notice(
    skeleton: Any, file_path: str, placement_choice: str | None = None
) -> list[Fault]:
    """Return a warning about animated meshes that no joint deforms (USD147).

    ``placement_choice``: ``drop`` ignores motion of the character's placement.
    """
    root = UsdSkel.Root.Find(skeleton.GetPrim())
    if not root:
        return []
    skinned_paths = {
        query.GetPrim().GetPath()
        for binding in skeleton_bindings(root)
        for query in binding.GetSkinningTargets()
        if query.HasJointInfluences()
    }
    distances = {
        str(prim.GetPath()): distance
        for prim in Usd.PrimRange(root.GetPrim(), Usd.TraverseInstanceProxies())
        if is_rig_mesh(prim) and prim.GetPath() not in skinned_paths
        if (distance := _max_displacement(prim, skeleton.GetPrim(), placement_choice))
        > MOTION_TOLERANCE
    }
    if not distances:
        return []
    mesh_count = counted(len(distances), "mesh", "meshes")
    largest_distance = max(distances.values())
    message = (
        f"transforms move {mesh_count} without a skin by up to {largest_distance:.4g} "
        f"m, but the cache does not: {listed(list(distances), MAX_LISTED_PRIMS)}"
    )
    hint = (
        f"bind them to a joint; if the source is also {argument('rig_layer')}, "
        "meshes without "
        "shapes keep their transforms"
    )
    return [Fault("USD147", message, file_path, (), hint, Severity.WARNING)]


def _max_displacement(prim: Any, skeleton: Any, placement_choice: str | None) -> float:
    """Return the largest displacement of a mesh from its first position [m]."""
    xformables = [
        *animated_ancestors(prim),
        *(animated_ancestors(skeleton) if placement_choice == DROP_PLACEMENT else ()),
    ]
    times = sample_times(xformables)
    if len(times) < 2:
        return 0.0
    sample_indices = np.linspace(0, len(times) - 1, min(len(times), MAX_SAMPLED_TIMES))
    codes = np.array(times)[sample_indices.round().astype(int)]
    matrices = world_matrices(prim, codes)
    if placement_choice == DROP_PLACEMENT:
        matrices = matrices @ np.linalg.inv(fixed_matrices(skeleton, codes.tolist()))
    points = number_rows(PointReader(prim).points_attr, 3, Usd.TimeCode.EarliestTime())
    corners = bounds_corners(points) if len(points) else np.zeros((1, 3))
    positions = corners @ matrices[:, :3, :3] + matrices[:, None, 3, :3]
    max_distance = np.linalg.norm(positions - positions[:1], axis=-1).max(initial=0.0)
    unit = UsdGeom.GetStageMetersPerUnit(prim.GetStage())
    return float(max_distance) * float(unit) if np.isfinite(max_distance) else 0.0
