"""Prims that a Skeleton moves: which they are, and what they are read by."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from pxr import Usd, UsdGeom, UsdSkel

from animtool._types import FloatArray
from animtool.errors import Fault, FormatError
from animtool.usd.rig_prims import (
    SkeletonRig,
)
from animtool.usd.values import numbers, stored_data


def is_shown_mesh(prim: Any) -> bool:
    """Return whether a prim is a mesh, and no guide as the bones of a skeleton are."""
    return bool(
        prim.IsA(UsdGeom.Mesh)
        and UsdGeom.Imageable(prim).ComputePurpose() != UsdGeom.Tokens.guide
    )


def skinned_prims(skeleton: Any, schema: Any) -> list[Any]:
    """Return queries of the prims of a schema that a Skeleton moves."""
    root = UsdSkel.Root.Find(skeleton.GetPrim())
    if not root:
        return []
    cache = UsdSkel.Cache()
    cache.Populate(root, Usd.TraverseInstanceProxies())
    bindings = cache.ComputeSkelBindings(root, Usd.TraverseInstanceProxies())
    return [
        query
        for binding in bindings
        if binding.GetSkeleton().GetPrim() == skeleton.GetPrim()
        for query in binding.GetSkinningTargets()
        if query.GetPrim().IsA(schema)
    ]


def prim_name(prim: Any) -> str:
    """Return the name that a prim was written from."""
    data = stored_data(prim)
    return str(data.get("name", prim.GetName()))


def unique_name(name: str, used: set[str]) -> str:
    """Return a name, with a number where it is used; it is used from then on."""
    unique, number = name, 2
    while unique in used:
        unique, number = f"{name}_{number}", number + 1
    used.add(unique)
    return unique


def floats(attr: Any, width: int, at: str) -> FloatArray:
    """Return the rows of an attribute ``(N, width)``.

    Raises:
        FormatError: One is not finite (USD017).
    """
    # Points that are sampled only are those of the first sample.
    values = numbers(attr, width, Usd.TimeCode.EarliestTime())
    if not np.isfinite(values).all():
        message = f"{attr.GetName()} hold a value that is not finite"
        raise FormatError(Fault("USD017", message, at))
    return values


def joint_names(query: Any, rig: SkeletonRig, at: str) -> tuple[str, ...]:
    """Return the rig's names of the joints that a prim's indices count.

    Raises:
        FormatError: One is no joint of the Skeleton (USD018).
    """
    order = query.GetJointOrder()
    index = {token: i for i, token in enumerate(rig.tokens)}
    tokens: Sequence[str] = rig.tokens if order is None else [str(t) for t in order]
    unknown = [token for token in tokens if token not in index]
    if unknown:
        message = f"{unknown[0]!r} is no joint of the Skeleton"
        raise FormatError(Fault("USD018", message, at))
    return tuple(rig.rig.names[index[token]] for token in tokens)
