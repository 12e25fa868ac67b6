"""A Skeleton prim as a rig, and where a character's prims stand on a stage."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
from pxr import Usd, UsdGeom, UsdSkel

from animtool._types import FloatArray
from animtool.errors import Fault, FormatError, excerpt
from animtool.maths import so3
from animtool.rig.skeleton import Joint, Rig
from animtool.units import UpAxis
from animtool.usd.layers import check_prim_path, find_layer

__all__ = [
    "SkeletonRig",
    "decompose",
    "find_skeletons",
    "open_stage",
    "rig_from_tokens",
    "skeleton_rig",
]


@dataclass(frozen=True, slots=True)
class SkeletonRig:
    """A rig made of a Skeleton prim.

    Attributes:
        rig: Its joints, named by the last part of their path.
        tokens: Their paths as the prim has them.
        rest_scales: Scale of the rest transforms ``(J, 3)``.
    """

    rig: Rig
    tokens: list[str]
    rest_scales: FloatArray


def open_stage(path: Path) -> Any:
    """Open a stage.

    Raises:
        FormatError: The file does not exist, is no USD layer or does not compose.
    """
    layer = find_layer(path)
    try:
        return Usd.Stage.Open(layer)
    except Exception as error:
        fault = Fault("USD001", f"does not compose: {error}", str(path))
        raise FormatError(fault) from error


def find_skeletons(stage: Any, below: str = "/") -> list[Any]:
    """Return the Skeleton prims on a stage, those inside instances too."""
    start = stage.GetPrimAtPath(below)
    if not start:
        return []
    found = Usd.PrimRange(start, Usd.TraverseInstanceProxies())
    return [UsdSkel.Skeleton(p) for p in found if p.IsA(UsdSkel.Skeleton)]


def decompose(matrices: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Split row-vector matrices ``(..., 4, 4)`` into T, R, S, with M = S·R·T.

    A mirror becomes a negative scale on all three axes. Shear is left out.
    """
    rows = matrices[..., :3, :3]
    scales = np.linalg.norm(rows, axis=-1)
    mirrored = np.linalg.det(rows) < 0
    scales = np.where(mirrored[..., None], -scales, scales)
    divisor = np.where(scales == 0, 1.0, scales)[..., None]
    rotations = so3.from_matrix((rows / divisor).swapaxes(-1, -2))
    return matrices[..., 3, :3], rotations, scales


def skeleton_rig(skeleton: Any, path: Path) -> SkeletonRig:
    """Return the rig of a Skeleton prim, in metres.

    Raises:
        FormatError: It has no joints, or their order or rest transforms are wrong.
    """
    stage = skeleton.GetPrim().GetStage()
    where = f"{path}<{skeleton.GetPath()}>"
    tokens = [str(token) for token in skeleton.GetJointsAttr().Get() or ()]
    if not tokens:
        _fail("USD002", "the Skeleton has no joints", where)
    matrices = skeleton.GetRestTransformsAttr().Get() or ()
    if len(matrices) != len(tokens):
        message = f"{len(matrices)} restTransforms for {len(tokens)} joints"
        _fail("USD003", message, where, "UsdSkel ignores such a Skeleton")
    rest = np.array(matrices, np.float64).reshape(-1, 4, 4)
    if not np.isfinite(rest).all():
        _fail("USD004", "a rest transform is not finite", where)
    data = skeleton.GetPrim().GetCustomDataByKey("animtool") or {}
    model = skeleton.GetPrim().GetParent().GetParent() or skeleton.GetPrim()
    name = model.GetName() if model.GetName() != "/" else skeleton.GetPrim().GetName()
    return rig_from_tokens(
        tokens,
        rest,
        name,
        where,
        UsdGeom.GetStageMetersPerUnit(stage),
        up_axis(stage),
        data,
    )


def rig_from_tokens(
    tokens: Sequence[str],
    rest: FloatArray,
    name: str,
    where: str,
    meters_per_unit: float,
    up: UpAxis,
    data: dict[str, Any],
) -> SkeletonRig:
    """Return the rig of joint paths and rest transforms ``(J, 4, 4)``, file units."""
    index = {token: i for i, token in enumerate(tokens)}
    if len(index) != len(tokens):
        _fail("USD005", "a joint stands twice", where)
    extras = _extras(data, where)
    originals = dict(data.get("names", {}))
    translations, rotations, scales = decompose(rest)
    joints: list[Joint] = []
    used: set[str] = set()
    for i, token in enumerate(tokens):
        parent = _parent(token, index)
        if parent >= i:
            message = f"joint {excerpt(token)} stands before its parent"
            _fail("USD006", message, where, "UsdSkel wants parents first")
        leaf = token.rpartition("/")[2]
        unique, number = leaf, 2
        while unique in used:
            unique, number = f"{leaf}_{number}", number + 1
        used.add(unique)
        own = extras.get(leaf, {})
        channels = own.get("channels")
        x, y, z = (translations[i] * meters_per_unit).tolist()
        a, b, c, w = rotations[i].tolist()
        joints.append(
            Joint(
                unique,
                parent,
                translation=(x, y, z),
                rotation=(a, b, c, w),
                source_name=str(originals.get(leaf, "" if unique == leaf else leaf)),
                channels=None if channels is None else tuple(channels),
                tips=tuple((t[0], t[1], t[2]) for t in own.get("tips", ())),
            )
        )
    rig = Rig(name, tuple(joints), meters_per_unit, up)
    return SkeletonRig(rig, list(tokens), scales)


def _parent(token: str, index: dict[str, int]) -> int:
    """Return the nearest ancestor that is a joint, as UsdSkel.Topology does."""
    while token := token.rpartition("/")[0]:
        if token in index:
            return index[token]
    return -1


def _extras(data: dict[str, Any], where: str) -> dict[str, dict[str, Any]]:
    text = data.get("rig", "")
    if not text:
        return {}
    try:
        content = json.loads(text)
        version = content["animtool"]
        joints: dict[str, dict[str, Any]] = content["joints"]
    except (ValueError, KeyError, TypeError) as error:
        _fail("USD007", f"customData animtool:rig is malformed: {error}", where)
    if version != 1:
        _fail("USD007", f"customData animtool:rig needs animtool/{version}", where)
    return joints


def up_axis(stage: Any) -> UpAxis:
    """Return the up axis of a stage."""
    return UpAxis(str(UsdGeom.GetStageUpAxis(stage)))


def prim_below(stage: Any, prim_path: str | None) -> str:
    """Return the prim to look below: the one named, the default one, or all.

    Raises:
        OptionError: The path is no prim path.
    """
    if prim_path is not None:
        check_prim_path(prim_path)
        return prim_path
    default = stage.GetDefaultPrim()
    if default and find_skeletons(stage, str(default.GetPath())):
        return str(default.GetPath())
    return "/"


def _fail(code: str, message: str, where: str, hint: str | None = None) -> NoReturn:
    raise FormatError(Fault(code, message, where, (), hint))
