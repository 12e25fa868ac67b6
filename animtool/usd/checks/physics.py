"""Checks on UsdPhysics joints."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np
from pxr import UsdPhysics

from animtool.errors import Fault, counted
from animtool.usd.checks.animation import UNIT_TOLERANCE
from animtool.usd.checks.subject import Subject
from animtool.usd.checks.table import finding


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
