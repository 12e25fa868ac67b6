"""Checks on PointInstancers: what they show copies of, and how these are placed."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from pxr import UsdGeom

from animtool.errors import Fault
from animtool.rules import finding
from animtool.usd.checks.subject import Sampled, Subject, at_samples
from animtool.usd.point_reader import UNIT_TOLERANCE

# Arrays with an entry a copy.
_EACH = (
    "positions",
    "orientations",
    "orientationsf",
    "scales",
    "velocities",
    "angularVelocities",
    "ids",
)


def check_copies(subject: Subject) -> Iterator[Fault]:
    """Check every PointInstancer: prototypes, lengths, numbers, unit orientations."""
    for instancer in subject.of_type(UsdGeom.PointInstancer):
        prim = instancer.GetPrim()
        indices = subject.sampled(instancer.GetProtoIndicesAttr())
        yield from _prototypes(subject, instancer, indices)
        for name in _EACH:
            attr = prim.GetAttribute(name)
            if not attr or not attr.HasAuthoredValue():
                continue
            sampled = subject.sampled(attr)
            yield from _lengths(attr, sampled, indices)
            if name != "ids":
                yield from _numbers(attr, sampled, unit=name.startswith("orientations"))


def _prototypes(subject: Subject, instancer: Any, indices: Sampled) -> Iterator[Fault]:
    relationship = instancer.GetPrototypesRel()
    targets = relationship.GetForwardedTargets()
    gone = [t for t in targets if not subject.stage.GetPrimAtPath(t)]
    if gone and not subject.alone:
        yield finding("USD287", relationship.GetPath(), f"there is no prim {gone[0]}")
    own = instancer.GetPath()
    around = [target for target in targets if own.HasPrefix(target)]
    if around:
        message = f"{around[0]} holds the copies of itself"
        yield finding("USD287", relationship.GetPath(), message)
    ends = [
        (int(np.min(array)), int(np.max(array))) if count > 0 else (0, -1)
        for array, count in zip(indices.arrays, indices.counts, strict=True)
    ]
    low, high = np.array(ends, np.int64).reshape(-1, 2).T
    bad = (low < 0) | (high >= len(targets))
    if bad.any() and not (subject.alone and not targets):
        worst = ends[int(np.argmax(bad))]
        index = worst[0] if worst[0] < 0 else worst[1]
        message = f"{index} names none of {len(targets)} {at_samples(indices, bad)}"
        yield finding("USD287", instancer.GetProtoIndicesAttr().GetPath(), message)


def _lengths(attr: Any, sampled: Sampled, indices: Sampled) -> Iterator[Fault]:
    """Compare lengths with those of protoIndices, held from sample to sample."""
    if not len(indices.counts):
        return
    held = np.zeros(len(sampled.counts), np.int64)
    if indices.animated and sampled.animated:
        held = np.searchsorted(indices.times, sampled.times, side="right") - 1
    wanted = indices.counts[np.clip(held, 0, None)]
    optional = not attr.GetName().startswith("positions")
    bad = (sampled.counts != wanted) & ~(optional & (sampled.counts <= 0))
    if bad.any():
        i = int(np.argmax(bad))
        message = (
            f"{sampled.counts[i]} for {wanted[i]} copies {at_samples(sampled, bad)}"
        )
        yield finding("USD269", attr.GetPath(), message)


def _numbers(attr: Any, sampled: Sampled, *, unit: bool) -> Iterator[Fault]:
    odd, off = np.zeros((2, len(sampled.counts)), bool)
    for i, array in enumerate(sampled.arrays):
        values = np.array(array, np.float64) if sampled.counts[i] > 0 else np.zeros(0)
        odd[i] = not np.isfinite(values).all()
        if unit and not odd[i] and len(values):
            sizes = np.linalg.norm(values.reshape(-1, 4), axis=1)
            off[i] = bool((np.abs(sizes - 1) > UNIT_TOLERANCE).any())
    if odd.any():
        message = f"{attr.GetName()} are not finite {at_samples(sampled, odd)}"
        yield finding("USD265", attr.GetPath(), message)
    if off.any():
        message = f"a quaternion is not of length 1 {at_samples(sampled, off)}"
        yield finding("USD288", attr.GetPath(), message)
