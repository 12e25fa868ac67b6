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
from animtool.core.names import unused_name
from animtool.rig.kinematics import WorldTransforms
from animtool.usd.layers.faults import PrimLocation
from animtool.usd.rigs.prims import (
    SkeletonRig,
    find_skeletons,
    number_rows,
    self_and_ancestors,
    stored_data,
)


def is_bone_mesh(prim: Any) -> bool:
    """Return whether a prim is a mesh that visualizes bones."""
    return bool(prim.GetCustomDataByKey("animtool:bones"))


def is_rig_mesh(prim: Any) -> bool:
    """Return whether a prim is a visible mesh, not a guide or bones."""
    return bool(
        prim.IsA(UsdGeom.Mesh)
        and UsdGeom.Imageable(prim).ComputePurpose() != UsdGeom.Tokens.guide
        and not is_bone_mesh(prim)
    )


def skinned_prims(skeleton: Any, schema: Any) -> list[Any]:
    """Return skinning queries of the prims of a schema that a Skeleton deforms."""
    root = UsdSkel.Root.Find(skeleton.GetPrim())
    if not root:
        return []
    return [
        query
        for binding in skeleton_bindings(root)
        if binding.GetSkeleton().GetPrim() == skeleton.GetPrim()
        for query in binding.GetSkinningTargets()
        if query.GetPrim().IsA(schema)
    ]


def skinned_mesh_names(skeleton: Any) -> tuple[str, ...]:
    """Return the names of the visible meshes that a Skeleton deforms."""
    prims = [query.GetPrim() for query in skinned_prims(skeleton, UsdGeom.Mesh)]
    return tuple(str(prim.GetName()) for prim in prims if is_rig_mesh(prim))


def skeleton_bindings(root: Any) -> Any:
    """Return the `UsdSkel.Binding` of each Skeleton below a SkelRoot."""
    cache, predicate = UsdSkel.Cache(), Usd.TraverseInstanceProxies()
    cache.Populate(root, predicate)
    return cache.ComputeSkelBindings(root, predicate)


# Attributes that bind a prim's points to joints and shapes.
_BINDING_ATTRIBUTES = ("primvars:skel:jointIndices", "skel:blendShapeTargets")


def unbound_notice(skeleton: Any, file_path: str) -> list[Fault]:
    """Return a warning if prims stay at rest because they lack SkelBindingAPI."""
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
        ", which no joint or shape deforms"
    )
    return [Fault("USD144", message, file_path, (), BINDING_HINT, Severity.WARNING)]


def unapplied_binding_path(skeleton: Any) -> str:
    """Return the path of a binding without SkelBindingAPI; empty if there is none."""
    for prim in self_and_ancestors(skeleton):
        relationship = prim.GetRelationship("skel:animationSource")
        if (
            relationship
            and relationship.GetTargets()
            and not prim.HasAPI(UsdSkel.BindingAPI)
        ):
            return str(prim.GetPath())
    return ""


def missing_animation_reason(skeleton: Any) -> str:
    """Return why the animation bound to a skeleton is missing; empty if it is not."""
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
    """Return a unique name, numbered if needed, and add it to the used names."""
    unique = unused_name(name, used_names)
    used_names.add(unique)
    return unique


def read_float_rows(
    attr: Any, location: PrimLocation, code: str = "USD017"
) -> FloatArray:
    """Return the rows of an attribute ``(N, 3)``.

    ``code`` is that of the fault for non-finite rows.
    """
    # The earliest time also reads values that have samples but no default.
    values = number_rows(attr, 3, Usd.TimeCode.EarliestTime())
    if not np.isfinite(values).all():
        message = f"{attr.GetName()} contain a value that is not finite"
        location.fail(code, message)
    return values


def influence_joint_names(
    query: Any, rig: SkeletonRig, location: PrimLocation
) -> tuple[str, ...]:
    """Return the rig joint names that a prim's joint indices refer to."""
    joint_order = query.GetJointOrder()
    index_by_token = {token: i for i, token in enumerate(rig.tokens)}
    tokens: Sequence[str] = (
        rig.tokens if joint_order is None else [str(t) for t in joint_order]
    )
    unknown_tokens = [token for token in tokens if token not in index_by_token]
    if unknown_tokens:
        message = f"{unknown_tokens[0]!r} is not a joint of the Skeleton"
        location.fail("USD238", message)
    return tuple(rig.rig.names[index_by_token[token]] for token in tokens)


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
    joint_count = len(query.GetJointOrder())
    local = np.zeros((len(codes), joint_count, 4, 4))
    matrices = np.zeros((len(codes), 1, 4, 4))
    # UsdSkel evaluates one time at a time.
    for i, code in enumerate(codes.tolist()):
        time_code = Usd.TimeCode(code)
        local[i] = query.ComputeJointSkelTransforms(time_code)
        matrices[i] = UsdGeom.Xformable(prim).ComputeLocalToWorldTransform(time_code)
    # USD uses row vectors; our matrices are for column vectors.
    world = np.swapaxes(local @ matrices, -1, -2)
    positions = world[..., :3, 3] * UsdGeom.GetStageMetersPerUnit(stage)
    return WorldTransforms(
        np.ascontiguousarray(positions), np.ascontiguousarray(world[..., :3, :3])
    )


MAX_LISTED_PRIMS = 40


def character_paths(stage: Any) -> list[str]:
    """Return the paths of the root prims of a stage's characters.

    For each Skeleton this is the enclosing component, or else the SkelRoot.
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


def has_character_at(stage: Any, prim_path: str, file_path: str) -> bool:
    """Return whether a stage has a character at a path; False for a movable rig layer.

    A rig layer has a single character at the top and no prim at the start of the path.
    Other stages are shots and must have a character at the path (USD033).
    """
    if find_skeletons(stage, prim_path):
        return True
    characters = character_paths(stage)
    if not characters or _is_movable_rig(stage, prim_path, characters):
        return False
    existing_paths = listed(characters, MAX_LISTED_PRIMS)
    message = f"has no character at {prim_path}, but at {existing_paths}"
    hint = "only a file with a single rig can be given a new path"
    raise OptionError(Fault("USD033", message, file_path, (), hint))


def _is_movable_rig(stage: Any, prim_path: str, characters: list[str]) -> bool:
    if stage.GetPrimAtPath(Sdf.Path(prim_path).GetPrefixes()[0]):
        return False
    if len(characters) > 1:
        return False
    prim = stage.GetPrimAtPath(characters[0])
    # A component further down is part of a shot or a set.
    is_nested = Sdf.Path(characters[0]).pathElementCount > 1
    is_model = Kind.Registry.IsA(Usd.ModelAPI(prim).GetKind(), Kind.Tokens.component)
    return not (is_nested and is_model)
