"""Authoring strands that joints carry, as curves bound to the Skeleton."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from pxr import Sdf, UsdGeom, Vt

from animtool._types import FloatArray
from animtool.rig.surfaces import Strands
from animtool.usd.finite import Labels, narrowed
from animtool.usd.layers import attribute, prim
from animtool.usd.names import distinct_names
from animtool.usd.paths import RigPaths
from animtool.usd.point_based import author_linear, author_width

# Below the SkelRoot, what holds the curves.
SCOPE = "Strands"
# How wide curves are drawn [m]: the format of rigs says nothing of it.
WIDTH = 4e-4
_TYPES = Sdf.ValueTypeNames


def strand_paths(strands: Sequence[Strands], paths: RigPaths) -> tuple[str, ...]:
    """Return paths of the strands' prims."""
    wanted = [entry.name for entry in strands]
    names = distinct_names(wanted, wanted, wanted).names
    return tuple(f"{paths.root}/{SCOPE}/{name}" for name in names)


def author_strands(
    layer: Any,
    strands: Sequence[Strands],
    paths: RigPaths,
    tokens: Mapping[str, str],
    meters_per_unit: float,
    *,
    bound: bool = True,
) -> None:
    """Write strands as linear curves below the SkelRoot, each bound to its joint.

    Args:
        layer: Where to.
        strands: What to write.
        paths: The character's prims.
        tokens: Path of each joint of the Skeleton, by the joint's name.
        meters_per_unit: Unit of the layer [m].
        bound: Bind them; False writes curves alone.
    """
    if not strands:
        return
    prim(layer, f"{paths.root}/{SCOPE}", "Scope")
    for entry, path in zip(strands, strand_paths(strands, paths), strict=True):
        spec = prim(layer, path, "BasisCurves")
        if Sdf.Path(path).name != entry.name:
            spec.SetInfo("customData", {"animtool": {"name": entry.name}})
        _curves(spec, entry.points / meters_per_unit, WIDTH / meters_per_unit)
        if bound:
            _bound(spec, tokens[entry.joint])


def _curves(spec: Any, points: FloatArray, width: float) -> None:
    count, length = points.shape[:2]
    labels = Labels(f"{spec.path}.points", "point")
    flat = np.ascontiguousarray(narrowed(points.reshape(-1, 3), "f", labels))
    places, widths = Vt.Vec3fArray.FromNumpy(flat), Vt.FloatArray([width])
    extent = UsdGeom.Curves.ComputeExtent(places, widths)
    attribute(spec, "extent", _TYPES.Float3Array, extent)
    author_linear(spec)
    counts = Vt.IntArray(count, length)
    attribute(spec, "curveVertexCounts", _TYPES.IntArray, counts)
    attribute(spec, "points", _TYPES.Point3fArray, places)
    author_width(spec, width)


def _bound(spec: Any, token: str) -> None:
    """Bind a prim to one joint as a whole."""
    schemas = Sdf.TokenListOp()
    schemas.prependedItems = ["SkelBindingAPI"]
    spec.SetInfo("apiSchemas", schemas)
    own = Vt.TokenArray([token])
    attribute(spec, "skel:joints", _TYPES.TokenArray, own, uniform=True)
    for name, kind, value in (
        ("jointIndices", _TYPES.IntArray, Vt.IntArray([0])),
        ("jointWeights", _TYPES.FloatArray, Vt.FloatArray([1.0])),
    ):
        made = attribute(
            spec, f"primvars:skel:{name}", kind, value, interpolation="constant"
        )
        made.SetInfo("elementSize", 1)
