"""Checks on Skeleton prims, and on UsdPhysics joints."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np
from pxr import UsdPhysics, UsdSkel

from animtool.core.array_types import FloatArray
from animtool.core.errors import Fault, counted, listed
from animtool.core.rules import finding
from animtool.usd.checks.checked_stage import CheckedStage
from animtool.usd.layers.faults import (
    UNIT_TOLERANCE,
    bind_faults,
    joint_order_faults,
    joint_parents,
    matrix_array,
    token_array,
)
from animtool.usd.layers.finite import float_array
from animtool.usd.rigs.rest_pose import (
    collapsed_bone_faults,
    rest_faults,
    skeleton_space,
)


def check_physics_joints(checked_stage: CheckedStage) -> Iterator[Fault]:
    """Check bodies, frames, axes and limits of every physics joint."""
    for joint in checked_stage.prims_of_type(UsdPhysics.Joint):
        yield from _check_bodies(checked_stage, joint)
        yield from _check_frames(joint)
        yield from _check_axis(joint.GetPrim())
        yield from _check_limits(joint.GetPrim())


def _check_bodies(checked_stage: CheckedStage, joint: Any) -> Iterator[Fault]:
    targets = []
    for relationship in (joint.GetBody0Rel(), joint.GetBody1Rel()):
        bodies = relationship.GetTargets()
        targets += bodies
        if len(bodies) > 1:
            message = f"{counted(len(bodies), 'target')} instead of one"
            yield finding("USD270", relationship.GetPath(), message)
        for target in bodies:
            if (
                not checked_stage.stage.GetPrimAtPath(target)
                and not checked_stage.has_only_overs
            ):
                message = f"{target} does not exist"
                yield finding("USD270", relationship.GetPath(), message)
    if not targets and not checked_stage.has_only_overs and joint.GetPrim().IsDefined():
        yield finding("USD270", joint.GetPath(), "neither body0 nor body1 is named")


def _check_frames(joint: Any) -> Iterator[Fault]:
    for attr in (joint.GetLocalRot0Attr(), joint.GetLocalRot1Attr()):
        value = attr.Get()
        if not hasattr(value, "imaginary"):  # another type is USD280
            continue
        length = math.hypot(*value.imaginary, value.real)
        if not abs(length - 1.0) <= UNIT_TOLERANCE:
            yield finding("USD272", attr.GetPath(), f"its length is {length:.6g}")
    for attr in (joint.GetLocalPos0Attr(), joint.GetLocalPos1Attr()):
        value = attr.Get()
        numbers = None if value is None else float_array(value)
        if numbers is not None and not np.isfinite(numbers).all():
            yield finding("USD272", attr.GetPath(), "the position is not finite")


def _check_axis(prim: Any) -> Iterator[Fault]:
    attr = prim.GetAttribute("physics:axis")
    axis = attr.Get() if attr else None
    if axis is not None and str(axis) not in {"X", "Y", "Z"}:
        yield finding("USD273", attr.GetPath(), f"it is {str(axis)!r}")


def _check_limits(prim: Any) -> Iterator[Fault]:
    """Check limit pairs; in the limit API, low above high locks the axis."""
    yield from _check_pair(prim, "physics:lowerLimit", "physics:upperLimit")
    for schema in prim.GetAppliedSchemas():
        schema_name, _, name = str(schema).partition(":")
        if schema_name == "PhysicsLimitAPI":
            low_name, high_name = (
                f"limit:{name}:physics:{end}" for end in ("low", "high")
            )
            yield from _check_pair(prim, low_name, high_name, is_reversible=True)
    yield from _check_pair(
        prim, "physics:minDistance", "physics:maxDistance", unlimited_value=-1.0
    )
    for i in "01":
        yield from _check_numbers(prim, f"physics:coneAngle{i}Limit")


def _check_numbers(prim: Any, name: str) -> Iterator[Fault]:
    value = _number(prim, name)
    if value is not None and math.isnan(value):
        path = prim.GetAttribute(name).GetPath()
        yield finding("USD271", path, "it is not a number")


def _number(prim: Any, name: str) -> float | None:
    """Return the number of an attribute; None if absent or of another type."""
    attr = prim.GetAttribute(name)
    value = attr.Get() if attr else None
    return value if isinstance(value, (int, float)) else None


def _check_pair(
    prim: Any,
    lower_limit_name: str,
    upper_limit_name: str,
    *,
    is_reversible: bool = False,
    unlimited_value: float | None = None,
) -> Iterator[Fault]:
    yield from _check_numbers(prim, lower_limit_name)
    yield from _check_numbers(prim, upper_limit_name)
    lower_value = _number(prim, lower_limit_name)
    upper_value = _number(prim, upper_limit_name)
    if (
        lower_value is None
        or upper_value is None
        or is_reversible
        or unlimited_value in {lower_value, upper_value}
    ):
        return
    if lower_value > upper_value:
        lower_label = lower_limit_name.rpartition(":")[2]
        message = f"{lower_label} {lower_value:g} is above {upper_value:g}"
        path = prim.GetAttribute(lower_limit_name).GetPath()
        yield finding("USD271", path, message)


# Tolerance of transforms, relative to their largest number.
TRANSFORM_TOLERANCE = 1e-4


def check_skeletons(checked_stage: CheckedStage) -> Iterator[Fault]:
    """Check topology, rest and bind transforms of every Skeleton."""
    bound_skeletons = set()
    for prim in checked_stage.prims:
        binding = UsdSkel.BindingAPI(prim)
        if binding.GetJointIndicesAttr().HasAuthoredValue():
            inherited_skeleton = binding.GetInheritedSkeleton()
            bound_skeletons.add(
                inherited_skeleton.GetPrim().GetPath() if inherited_skeleton else None
            )
    for skeleton in checked_stage.prims_of_type(UsdSkel.Skeleton):
        joints = token_array(skeleton.GetJointsAttr())
        if not joints:
            continue
        yield from _check_order(skeleton, joints)
        yield from rest_faults(skeleton, joints)
        yield from _check_bind(
            skeleton, joints, is_skinned=skeleton.GetPath() in bound_skeletons
        )
        prim = skeleton.GetPrim()
        if prim.IsDefined() and not UsdSkel.Root.Find(prim):
            message = "there is no SkelRoot above the Skeleton"
            yield finding("USD237", prim.GetPath(), message)


def _check_order(skeleton: Any, joints: list[str]) -> Iterator[Fault]:
    path = skeleton.GetJointsAttr().GetPath()
    faults = list(joint_order_faults(path, joints))
    yield from faults
    if any(fault.code == "USD220" for fault in faults):
        return
    paths = set(joints)
    with_parents = ((name, name.rpartition("/")[0]) for name in joints)
    orphans = [name for name, parent in with_parents if parent and parent not in paths]
    if orphans:
        message = f"{len(orphans)} joints have a parent that does not exist: "
        message += listed(orphans)
        yield finding("USD222", path, message)


def _check_bind(
    skeleton: Any, joints: list[str], *, is_skinned: bool
) -> Iterator[Fault]:
    faults = list(bind_faults(skeleton, joints, is_skinned=is_skinned))
    yield from faults
    bind = matrix_array(skeleton.GetBindTransformsAttr())
    rest = matrix_array(skeleton.GetRestTransformsAttr())
    is_complete = not faults and len(bind) == len(rest) == len(joints)
    if is_complete and np.isfinite(rest).all():
        yield from _check_inverted(skeleton, joints, rest, bind, is_skinned)
        yield from collapsed_bone_faults(skeleton, joints)


def _check_inverted(
    skeleton: Any,
    joints: list[str],
    rest: FloatArray,
    bind: FloatArray,
    is_skinned: bool,
) -> Iterator[Fault]:
    """Yield a fault if bind transforms are identity, or rest and bind are inverses."""
    parents = joint_parents(joints)
    if (parents >= np.arange(len(joints))).any():
        return
    rest_in_skeleton = skeleton_space(rest, parents)
    identity = np.zeros_like(bind) + np.eye(4)
    if _nearly_equal(rest_in_skeleton, bind) or _nearly_equal(
        rest_in_skeleton, identity
    ):
        return
    path = skeleton.GetBindTransformsAttr().GetPath()
    if is_skinned and _nearly_equal(bind, identity):
        message = (
            f"all {len(bind)} are identity, but the joints have other rest positions"
        )
        yield finding("USD227", path, message)
        return
    inverse = np.asarray(np.linalg.inv(bind), np.float64)
    if _nearly_equal(rest_in_skeleton, inverse):
        message = f"all {len(bind)} are the inverse of the joints' rest transforms"
        yield finding("USD228", path, message)
    elif _nearly_equal(rest, inverse):
        message = f"all {len(bind)} are the inverse of the bindTransforms"
        yield finding("USD228", skeleton.GetRestTransformsAttr().GetPath(), message)


def _nearly_equal(left: FloatArray, right: FloatArray) -> bool:
    return bool(
        np.abs(left - right).max() <= TRANSFORM_TOLERANCE * max(np.abs(left).max(), 1.0)
    )
