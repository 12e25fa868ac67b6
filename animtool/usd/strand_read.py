"""The curves that single joints of a Skeleton carry, as strands of its rig."""

from __future__ import annotations

from typing import Any

import numpy as np
from pxr import Usd, UsdGeom

from animtool._types import FloatArray
from animtool.errors import Fault, FormatError
from animtool.rig.parts import AttachKind, Attachment, HeldArray
from animtool.usd.rig_prims import (
    SkeletonRig,
)
from animtool.usd.skinned import (
    floats,
    joint_names,
    prim_name,
    skinned_prims,
    unique_name,
)
from animtool.usd.values import integers, numbers


def read_strands(skeleton: Any, rig: SkeletonRig, where: str) -> tuple[Attachment, ...]:
    """Return the linear curves that one joint each carries, as strands.

    Curves of other kinds, of different lengths, or that follow several joints, are
    passed over. Points are in the unit of the rig.

    Args:
        skeleton: A `UsdSkel.Skeleton`.
        rig: What was read of it.
        where: The file, for messages.

    Raises:
        FormatError: A number is not finite (USD017), or a joint is none of the
            Skeleton (USD018).
    """
    return tuple(entry for entry, _ in bound_strands(skeleton, rig, where))


def bound_strands(
    skeleton: Any, rig: SkeletonRig, where: str
) -> list[tuple[Attachment, Any]]:
    """Return what `read_strands` does, each with its prim.

    Raises:
        FormatError: As for `read_strands`.
    """
    made: list[tuple[Attachment, Any]] = []
    used: set[str] = set()
    for query in skinned_prims(skeleton, UsdGeom.BasisCurves):
        source = query.GetPrim()
        at = f"{where}<{source.GetPath()}>"
        joint = _carrier(query, rig, at)
        points = _points(UsdGeom.BasisCurves(source), query, at)
        if joint is not None and points is not None:
            name = unique_name(prim_name(source), used)
            kind, held = AttachKind.STRANDS.value, HeldArray(points)
            made.append((Attachment(name, kind, (joint,), points=held), source))
    return made


def _carrier(query: Any, rig: SkeletonRig, at: str) -> str | None:
    """Return the joint that carries a prim as a whole; None where it is not one."""
    if not query.HasJointInfluences() or not query.IsRigidlyDeformed():
        return None
    indices = integers(query.GetJointIndicesPrimvar().GetAttr(), Usd.TimeCode.Default())
    weights = numbers(
        query.GetJointWeightsPrimvar().GetAttr(), 1, Usd.TimeCode.Default()
    )
    if len(indices) != 1 or len(weights) != 1:
        return None
    names = joint_names(query, rig, at)
    if not 0 <= indices[0] < len(names):
        message = f"a jointIndex is not in 0 to {len(names) - 1}"
        raise FormatError(Fault("USD018", message, at))
    return names[int(indices[0])]


def _points(curves: Any, query: Any, at: str) -> FloatArray | None:
    """Return points ``(S, K, 3)`` at bind; None of curves that are no strands."""
    counts = integers(curves.GetCurveVertexCountsAttr())
    if curves.GetTypeAttr().Get() != UsdGeom.Tokens.linear or not len(counts):
        return None
    values = floats(curves.GetPointsAttr(), 3, at)
    if counts.min() < 2 or (counts != counts[0]).any() or counts.sum() != len(values):
        return None
    matrix = np.array(query.GetGeomBindTransform(), np.float64)
    if not np.isfinite(matrix).all():
        raise FormatError(Fault("USD017", "geomBindTransform is not finite", at))
    placed = values @ matrix[:3, :3] + matrix[3, :3]
    return np.asarray(placed.reshape(len(counts), -1, 3))
