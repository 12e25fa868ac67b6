"""Authoring strands that joints carry, as curves bound to the Skeleton."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from pxr import Sdf, UsdGeom, Vt

from animtool._types import FloatArray
from animtool.errors import Fault, FormatError
from animtool.rig.parts import Attachment
from animtool.rig.skeleton import Rig
from animtool.usd.layers import attribute, prim
from animtool.usd.names import distinct_names

__all__ = ["SCOPE", "author_strands"]

# Below the SkelRoot, what holds the curves.
SCOPE = "Strands"
# How wide curves are drawn [m]: the format of rigs says nothing of it.
WIDTH = 4e-4
_TYPES = Sdf.ValueTypeNames


def author_strands(
    layer: Any,
    rig: Rig,
    root: str,
    tokens: Mapping[str, str],
    meters_per_unit: float,
) -> None:
    """Write strands as linear curves below the SkelRoot, each bound to its joint.

    Args:
        layer: Where to.
        rig: What has them.
        root: Path of the SkelRoot.
        tokens: Path of each joint of the Skeleton, by the joint's name.
        meters_per_unit: Unit of the layer [m].

    Raises:
        FormatError: An array of the rig cannot be read any more (RIG018).
    """
    found = [entry for entry in rig.attach if entry.points is not None]
    if not found:
        return
    prim(layer, f"{root}/{SCOPE}", "Scope")
    wanted = [entry.name for entry in found]
    names = distinct_names(wanted, wanted, wanted).names
    for entry, name in zip(found, names, strict=True):
        points = _loaded(entry) * (rig.meters_per_unit / meters_per_unit)
        spec = prim(layer, f"{root}/{SCOPE}/{name}", "BasisCurves")
        if name != entry.name:
            spec.SetInfo("customData", {"animtool": {"name": entry.name}})
        _curves(spec, points, WIDTH / meters_per_unit)
        _bound(spec, tokens[entry.joints[0]])


def _loaded(entry: Attachment) -> FloatArray:
    assert entry.points is not None
    try:
        return entry.points.load()
    except ValueError as error:
        raise FormatError(Fault("RIG018", f"{entry.name!r}: {error}")) from error


def _curves(spec: Any, points: FloatArray, width: float) -> None:
    count, length = points.shape[:2]
    flat = np.ascontiguousarray(points.reshape(-1, 3), np.float32)
    places, widths = Vt.Vec3fArray.FromNumpy(flat), Vt.FloatArray([width])
    extent = UsdGeom.Curves.ComputeExtent(places, widths)
    attribute(spec, "extent", _TYPES.Float3Array, extent)
    attribute(spec, "type", _TYPES.Token, "linear", uniform=True)
    attribute(spec, "wrap", _TYPES.Token, "nonperiodic", uniform=True)
    counts = Vt.IntArray(count, length)
    attribute(spec, "curveVertexCounts", _TYPES.IntArray, counts)
    attribute(spec, "points", _TYPES.Point3fArray, places)
    attribute(spec, "widths", _TYPES.FloatArray, widths, interpolation="constant")


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
