"""Checks on what skel relationships lead to."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from pxr import UsdSkel

from animtool.errors import Fault
from animtool.usd.checks.subject import Subject
from animtool.usd.checks.table import finding

_WANTED = {
    "skel:animationSource": UsdSkel.Animation,
    "skel:skeleton": UsdSkel.Skeleton,
    "skel:blendShapeTargets": UsdSkel.BlendShape,
}
_NAMES = {
    "skel:animationSource": "SkelAnimation",
    "skel:skeleton": "Skeleton",
    "skel:blendShapeTargets": "BlendShape",
}


def check_bindings(subject: Subject) -> Iterator[Fault]:
    """Check that bindings lead to prims of their kind.

    In a layer whose rig is elsewhere, prims that it lacks may be there.
    """
    for prim in subject.prims:
        for name, schema in _WANTED.items():
            relationship = prim.GetRelationship(name)
            if not relationship:
                continue
            for target in relationship.GetTargets():
                found = subject.stage.GetPrimAtPath(target)
                if not found and subject.alone:
                    continue
                if found and not found.GetTypeName() and not found.IsDefined():
                    continue
                yield from _target(relationship, target, found, schema, _NAMES[name])


def _target(
    relationship: Any, target: Any, found: Any, schema: Any, wanted: str
) -> Iterator[Fault]:
    if not found:
        message = f"{target} is not there"
        yield finding("USD208", relationship.GetPath(), message)
    elif not found.IsA(schema):
        kind = found.GetTypeName() or "prim without a type"
        message = f"{target} is a {kind}, not a {wanted}"
        yield finding("USD208", relationship.GetPath(), message)
