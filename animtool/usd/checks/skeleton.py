"""Checks on Skeleton prims, and on UsdPhysics joints."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np
from pxr import UsdPhysics, UsdSkel

from animtool._types import BoolArray, FloatArray, IntArray
from animtool.errors import Fault, counted, excerpt, listed
from animtool.rules import finding
from animtool.usd.checks.animation import UNIT_TOLERANCE, duplicates, tokens
from animtool.usd.checks.subject import Subject


def check_physics(subject: Subject) -> Iterator[Fault]:
    """Check bodies, frames, axes and limits of every joint prim."""
    for joint in subject.of_type(UsdPhysics.Joint):
        yield from _bodies(subject, joint)
        yield from _frames(joint)
        yield from _axis(joint.GetPrim())
        yield from _limits(joint.GetPrim())


def _bodies(subject: Subject, joint: Any) -> Iterator[Fault]:
    targets = []
    for relationship in (joint.GetBody0Rel(), joint.GetBody1Rel()):
        found = relationship.GetTargets()
        targets += found
        if len(found) > 1:
            message = f"{counted(len(found), 'target')}, not one"
            yield finding("USD270", relationship.GetPath(), message)
        for target in found:
            if not subject.stage.GetPrimAtPath(target) and not subject.alone:
                message = f"{target} is not there"
                yield finding("USD270", relationship.GetPath(), message)
    if not targets and not subject.alone and joint.GetPrim().IsDefined():
        yield finding("USD270", joint.GetPath(), "neither body0 nor body1 is named")


def _frames(joint: Any) -> Iterator[Fault]:
    for attr in (joint.GetLocalRot0Attr(), joint.GetLocalRot1Attr()):
        value = attr.Get()
        if value is None:
            continue
        length = math.hypot(*value.imaginary, value.real)
        if not abs(length - 1.0) <= UNIT_TOLERANCE:
            yield finding("USD272", attr.GetPath(), f"its length is {length:.6g}")
    for attr in (joint.GetLocalPos0Attr(), joint.GetLocalPos1Attr()):
        value = attr.Get()
        if value is not None and not np.isfinite(value).all():
            yield finding("USD272", attr.GetPath(), "the position is not finite")


def _axis(prim: Any) -> Iterator[Fault]:
    attr = prim.GetAttribute("physics:axis")
    axis = attr.Get() if attr else None
    if axis is not None and str(axis) not in {"X", "Y", "Z"}:
        yield finding("USD273", attr.GetPath(), f"it is {str(axis)!r}")


def _limits(prim: Any) -> Iterator[Fault]:
    """Check pairs of limits; of the limit API, low above high locks the axis."""
    yield from _pair(prim, "physics:lowerLimit", "physics:upperLimit")
    for schema in prim.GetAppliedSchemas():
        head, _, name = str(schema).partition(":")
        if head == "PhysicsLimitAPI":
            low, high = (f"limit:{name}:physics:{end}" for end in ("low", "high"))
            yield from _pair(prim, low, high, reversible=True)
    yield from _pair(prim, "physics:minDistance", "physics:maxDistance", free=-1.0)
    for side in "01":
        yield from _numbers(prim, f"physics:coneAngle{side}Limit")


def _numbers(prim: Any, name: str) -> Iterator[Fault]:
    attr = prim.GetAttribute(name)
    value = attr.Get() if attr else None
    if value is not None and math.isnan(value):
        yield finding("USD271", attr.GetPath(), "it is no number")


def _pair(
    prim: Any,
    lower: str,
    upper: str,
    *,
    reversible: bool = False,
    free: float | None = None,
) -> Iterator[Fault]:
    yield from _numbers(prim, lower)
    yield from _numbers(prim, upper)
    attributes = [prim.GetAttribute(name) for name in (lower, upper)]
    low, high = (attr.Get() if attr else None for attr in attributes)
    if low is None or high is None or reversible or free in {low, high}:
        return
    if low > high:
        message = f"{lower.rpartition(':')[2]} {low:g} is above {high:g}"
        yield finding("USD271", attributes[0].GetPath(), message)


# Of the largest number in a transform.
SAME = 1e-4
# Of what a transform with axes of its lengths could enclose.
SMALLEST_VOLUME = 1e-12


def check_skeletons(subject: Subject) -> Iterator[Fault]:
    """Check topology, rest and bind transforms of every Skeleton."""
    bound = set()
    for prim in subject.prims:
        binding = UsdSkel.BindingAPI(prim)
        if binding.GetJointIndicesAttr().HasAuthoredValue():
            held = binding.GetInheritedSkeleton()
            bound.add(held.GetPrim().GetPath() if held else None)
    for skeleton in subject.of_type(UsdSkel.Skeleton):
        joints = tokens(skeleton.GetJointsAttr())
        if not joints:
            continue
        yield from _order(skeleton, joints)
        yield from _rest(skeleton, joints)
        yield from _bind(skeleton, joints, skeleton.GetPath() in bound)
        yield from _root(skeleton)


def joint_parents(joints: list[str]) -> IntArray:
    """Return the parent of each joint as UsdSkel finds it, -1 for a root.

    >>> joint_parents(["a", "a/b/c"]).tolist()
    [-1, 0]
    """
    index = {name: i for i, name in enumerate(joints)}

    def above(name: str) -> int:
        while name := name.rpartition("/")[0]:
            if name in index:
                return index[name]
        return -1

    return np.array([above(name) for name in joints], np.int64)


def own_matrices(attr: Any) -> FloatArray:
    """Return the matrices of an attribute ``(N, 4, 4)``, as USD has them."""
    return np.array(attr.Get() or (), np.float64).reshape(-1, 4, 4)


def _order(skeleton: Any, joints: list[str]) -> Iterator[Fault]:
    path = skeleton.GetJointsAttr().GetPath()
    twice = duplicates(joints)
    if twice:
        message = f"{len(twice)} of {len(joints)} joints stand twice: {listed(twice)}"
        yield finding("USD220", path, message)
        return
    parents = joint_parents(joints)
    early = np.flatnonzero(parents > np.arange(len(joints)))
    if len(early):
        child = int(early[0])
        message = (
            f"joint {child}, {excerpt(joints[child])}, stands before its parent, "
            f"joint {parents[child]}"
        )
        yield finding("USD221", path, message)
    known = set(joints)
    parted = ((name, name.rpartition("/")[0]) for name in joints)
    lost = [name for name, parent in parted if parent and parent not in known]
    if lost:
        message = f"{len(lost)} joints have a parent that is none: {listed(lost)}"
        yield finding("USD222", path, message)


def _rest(skeleton: Any, joints: list[str]) -> Iterator[Fault]:
    attr = skeleton.GetRestTransformsAttr()
    rest = own_matrices(attr)
    if not len(rest):
        message = f"no restTransforms for {counted(len(joints), 'joint')}"
        yield finding("USD229", attr.GetPath(), message)
    elif len(rest) != len(joints):
        message = (
            f"{counted(len(rest), 'restTransform')} for {counted(len(joints), 'joint')}"
        )
        yield finding("USD223", attr.GetPath(), message)
    else:
        yield from _finite(attr, rest, joints)


def _finite(attr: Any, matrices: FloatArray, joints: list[str]) -> Iterator[Fault]:
    bad = np.flatnonzero(~np.isfinite(matrices).all(axis=(1, 2)))
    if len(bad):
        names = [joints[i] for i in bad]
        message = f"{len(bad)} transforms are not finite: {listed(names)}"
        yield finding("USD225", attr.GetPath(), message)


def _bind(skeleton: Any, joints: list[str], skins: bool) -> Iterator[Fault]:
    attr = skeleton.GetBindTransformsAttr()
    bind, rest = own_matrices(attr), own_matrices(skeleton.GetRestTransformsAttr())
    if len(bind) != len(joints):
        if len(bind) or skins:
            message = f"{counted(len(bind), 'bindTransform')}"
            message += f" for {counted(len(joints), 'joint')}"
            yield finding("USD224", attr.GetPath(), message)
        return
    if not np.isfinite(bind).all():
        yield from _finite(attr, bind, joints)
        return
    flat = np.flatnonzero(singular(bind))
    if len(flat):
        names = [joints[i] for i in flat]
        message = f"{len(flat)} bindTransforms have no inverse: {listed(names)}"
        yield finding("USD226", attr.GetPath(), message)
    elif len(rest) == len(joints) and np.isfinite(rest).all():
        yield from _swapped(skeleton, joints, rest, bind, skins)


def singular(matrices: FloatArray) -> BoolArray:
    """Return which matrices ``(N, 4, 4)`` have no inverse to speak of."""
    linear = matrices[:, :3, :3]
    lengths = np.linalg.norm(linear, axis=2).prod(axis=1)
    volumes = np.abs(np.linalg.det(linear))
    flat: BoolArray = (volumes <= SMALLEST_VOLUME * lengths) | (lengths == 0)
    return flat


def _swapped(
    skeleton: Any, joints: list[str], rest: FloatArray, bind: FloatArray, skins: bool
) -> Iterator[Fault]:
    """Tell transforms that stand for others from those that are as they should be."""
    parents = joint_parents(joints)
    if (parents >= np.arange(len(joints))).any():
        return
    world = rest.copy()
    for joint, parent in enumerate(parents.tolist()):
        if parent >= 0:
            world[joint] = rest[joint] @ world[parent]
    eye = np.zeros_like(bind) + np.eye(4)
    if _same(world, bind) or _same(world, eye):
        return
    path = skeleton.GetBindTransformsAttr().GetPath()
    if skins and _same(bind, eye):
        message = f"all {len(bind)} are identity, and the joints at rest are elsewhere"
        yield finding("USD227", path, message)
        return
    inverse = np.asarray(np.linalg.inv(bind), np.float64)
    if _same(world, inverse):
        message = f"all {len(bind)} are the inverse of the joints' places at rest"
        yield finding("USD228", path, message)
    elif _same(rest, inverse):
        message = f"all {len(bind)} are the inverse of the bindTransforms"
        yield finding("USD228", skeleton.GetRestTransformsAttr().GetPath(), message)


def _same(a: FloatArray, b: FloatArray) -> bool:
    return bool(np.abs(a - b).max() <= SAME * max(np.abs(a).max(), 1.0))


def _root(skeleton: Any) -> Iterator[Fault]:
    prim = skeleton.GetPrim()
    if prim.IsDefined() and not UsdSkel.Root.Find(prim):
        yield finding("USD237", prim.GetPath(), "no SkelRoot stands above the Skeleton")
