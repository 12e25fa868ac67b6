"""Finds the prims that a Skeleton deforms, and reads their bindings."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from pxr import Kind, Sdf, Usd, UsdGeom, UsdSkel

from animtool.core.arguments import flag
from animtool.core.array_types import FloatArray
from animtool.core.errors import Fault, OptionError, Severity, listed
from animtool.rig.kinematics import WorldTransforms
from animtool.usd.layers.faults import PrimLocation
from animtool.usd.rigs.prims import (
    SkeletonRig,
    find_skeletons,
    number_rows,
    self_and_ancestors,
    stored_data,
)


def is_bones(prim: Any) -> bool:
    """Return whether a prim is a mesh that visualizes bones."""
    return bool(prim.GetCustomDataByKey("animtool:bones"))


def is_shown_mesh(prim: Any) -> bool:
    """Return whether a prim is a visible mesh, not a guide or bones."""
    return bool(
        prim.IsA(UsdGeom.Mesh)
        and UsdGeom.Imageable(prim).ComputePurpose() != UsdGeom.Tokens.guide
        and not is_bones(prim)
    )


def skinned_prims(skeleton: Any, schema: Any) -> list[Any]:
    """Return queries of the prims of a schema that a Skeleton deforms."""
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


# Attributes that bind a prim's points to joints and shapes.
_BINDING_ATTRIBUTES = ("primvars:skel:jointIndices", "skel:blendShapeTargets")


def unbound_notice(skeleton: Any, where: str) -> list[Fault]:
    """Report prims that stay at rest because SkelBindingAPI is not applied."""
    root = UsdSkel.Root.Find(skeleton.GetPrim())
    if not root:
        return []
    descendants = Usd.PrimRange(root.GetPrim(), Usd.TraverseInstanceProxies())
    unbound_paths = [
        str(prim.GetPath())
        for prim in descendants
        if prim.IsA(UsdGeom.Gprim)
        and not prim.HasAPI(UsdSkel.BindingAPI)
        and any(prim.HasProperty(name) for name in _BINDING_ATTRIBUTES)
    ]
    if not unbound_paths:
        return []
    message = (
        f"SkelBindingAPI is not applied to {listed(unbound_paths, MAX_LISTED_PRIMS)}"
    )
    message += ", which no joint or shape deforms"
    return [Fault("USD144", message, where, (), BINDING_HINT, Severity.WARNING)]


def ignored_binding(skeleton: Any) -> str:
    """Return the prim whose binding UsdSkel ignores for lack of its schema, or None."""
    for prim in self_and_ancestors(skeleton):
        relationship = prim.GetRelationship("skel:animationSource")
        if (
            relationship
            and relationship.GetTargets()
            and not prim.HasAPI(UsdSkel.BindingAPI)
        ):
            return str(prim.GetPath())
    return ""


def missing_animation(skeleton: Any) -> str:
    """Return which animation a skeleton is bound to, and why it has no effect."""
    for prim in self_and_ancestors(skeleton):
        relationship = prim.GetRelationship("skel:animationSource")
        targets = relationship.GetTargets() if relationship else ()
        if targets:
            animation = prim.GetStage().GetPrimAtPath(targets[0])
            if not animation:
                return f"{targets[0]} does not exist"
            return "" if animation.IsActive() else f"{targets[0]} is deactivated"
    return ""


BINDING_HINT = (
    f"UsdSkel ignores the binding; apply it, as animtool validate {flag('fix')} does"
)


def prim_name(prim: Any) -> str:
    """Return the original name of a prim."""
    data = stored_data(prim)
    return str(data.get("name", prim.GetName()))


def unique_name(name: str, used_names: set[str]) -> str:
    """Return a name, numbered if already used, and add it to the used names."""
    unique, number = name, 2
    while unique in used_names:
        unique, number = f"{name}_{number}", number + 1
    used_names.add(unique)
    return unique


def float_rows(
    attr: Any, width: int, at: PrimLocation, code: str = "USD017"
) -> FloatArray:
    """Return the rows of an attribute ``(N, width)``.

    ``code`` is that of the fault for non-finite rows.
    """
    # Points without a default are those of the first sample.
    values = number_rows(attr, width, Usd.TimeCode.EarliestTime())
    if not np.isfinite(values).all():
        message = f"{attr.GetName()} contain a value that is not finite"
        at.fail(code, message)
    return values


def joint_names(query: Any, rig: SkeletonRig, at: PrimLocation) -> tuple[str, ...]:
    """Return the rig joint names that a prim's joint indices refer to."""
    order = query.GetJointOrder()
    index = {token: i for i, token in enumerate(rig.tokens)}
    tokens: Sequence[str] = rig.tokens if order is None else [str(t) for t in order]
    unknown = [token for token in tokens if token not in index]
    if unknown:
        message = f"{unknown[0]!r} is not a joint of the Skeleton"
        at.fail("USD238", message)
    return tuple(rig.rig.names[index[token]] for token in tokens)


def usdskel_world(path: Path, codes: FloatArray) -> WorldTransforms:
    """Return the world transforms of a stage's first skeleton, posed by UsdSkel.

    ``codes`` are the time codes, also between samples ``(F,)``.
    """
    stage = Usd.Stage.Open(str(path))
    prim = next(p for p in stage.Traverse() if p.IsA(UsdSkel.Skeleton))
    root = UsdSkel.Root.Find(prim)
    cache = UsdSkel.Cache()
    cache.Populate(root, Usd.PrimDefaultPredicate)
    query = cache.GetSkelQuery(UsdSkel.Skeleton(prim))
    joints = len(query.GetJointOrder())
    local = np.zeros((len(codes), joints, 4, 4))
    matrices = np.zeros((len(codes), 1, 4, 4))
    # UsdSkel evaluates one time at a time.
    for i, code in enumerate(codes.tolist()):
        time_code = Usd.TimeCode(code)
        local[i] = query.ComputeJointSkelTransforms(time_code)
        matrices[i] = UsdGeom.Xformable(prim).ComputeLocalToWorldTransform(time_code)
    # Rows of USD's matrices are columns of ours.
    world = np.swapaxes(local @ matrices, -1, -2)
    positions = world[..., :3, 3] * UsdGeom.GetStageMetersPerUnit(stage)
    return WorldTransforms(
        np.ascontiguousarray(positions), np.ascontiguousarray(world[..., :3, :3])
    )


MAX_LISTED_PRIMS = 40


def character_paths(stage: Any) -> list[str]:
    """Return the root prims of the characters of a stage.

    For each Skeleton this is its component, or its SkelRoot without one.
    """
    paths = [_character_root(skeleton.GetPrim()) for skeleton in find_skeletons(stage)]
    return list(dict.fromkeys(paths))


def _character_root(skeleton: Any) -> str:
    root = UsdSkel.Root.Find(skeleton)
    top_prim = root.GetPrim() if root else skeleton
    for prim in self_and_ancestors(top_prim):
        if Kind.Registry.IsA(Usd.ModelAPI(prim).GetKind(), Kind.Tokens.component):
            return str(prim.GetPath())
    return str(top_prim.GetPath())


def holds_character(stage: Any, prim_path: str, where: str) -> bool:
    """Return whether a stage has a character at a path, or could place one there.

    A rig layer has one character at the top, and no prim at the start of the path: a
    shot will place it at the path. Any other stage is the shot itself, and needs a
    character at the path.
    """
    if find_skeletons(stage, prim_path):
        return True
    characters = character_paths(stage)
    if not characters or _is_rig_alone(stage, prim_path, characters):
        return False
    existing = listed(characters, MAX_LISTED_PRIMS)
    message = f"has no character at {prim_path}, but at {existing}"
    hint = "only a file with a single rig can be given a new path"
    raise OptionError(Fault("USD033", message, where, (), hint))


def _is_rig_alone(stage: Any, prim_path: str, characters: list[str]) -> bool:
    if stage.GetPrimAtPath(Sdf.Path(prim_path).GetPrefixes()[0]):
        return False
    if len(characters) > 1:
        return False
    prim = stage.GetPrimAtPath(characters[0])
    # A component further down is part of a shot or a set.
    is_nested = Sdf.Path(characters[0]).pathElementCount > 1
    is_model = Kind.Registry.IsA(Usd.ModelAPI(prim).GetKind(), Kind.Tokens.component)
    return not (is_nested and is_model)
