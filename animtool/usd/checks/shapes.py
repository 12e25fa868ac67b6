"""Checks on blend shapes, and on the prims that they move."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from pxr import UsdSkel

from animtool._types import FloatArray, IntArray
from animtool.errors import Fault, excerpt, listed
from animtool.usd.checks.animation import duplicates, tokens
from animtool.usd.checks.skin import has_points, point_count
from animtool.usd.checks.subject import Subject
from animtool.usd.checks.table import finding


def check_targets(subject: Subject) -> Iterator[Fault]:
    """Check that a prim with points names one target for each shape."""
    for prim in subject.prims:
        if not has_points(prim):
            continue
        binding = UsdSkel.BindingAPI(prim)
        attr, targets = binding.GetBlendShapesAttr(), binding.GetBlendShapeTargetsRel()
        names = tokens(attr)
        found = targets.GetTargets() if targets else []
        twice = duplicates(names)
        if len(names) != len(found) and (names or found):
            message = f"{len(names)} blendShapes for {len(found)} targets"
            yield finding("USD245", f"{prim.GetPath()}.skel:blendShapes", message)
        elif twice:
            message = f"{len(twice)} shapes stand twice: {listed(twice)}"
            yield finding("USD245", attr.GetPath(), message)


def check_shapes(subject: Subject) -> Iterator[Fault]:
    """Check offsets, indices and inbetweens of every BlendShape."""
    points = _points(subject)
    for shape in subject.of_type(UsdSkel.BlendShape):
        yield from _shape(shape, points.get(shape.GetPath()))


def _points(subject: Subject) -> dict[Any, int]:
    """Return the number of points of what each shape moves."""
    found: dict[Any, int] = {}
    for prim in subject.prims:
        targets = prim.GetRelationship("skel:blendShapeTargets")
        count = point_count(prim) if targets else None
        if count:
            found |= dict.fromkeys(targets.GetTargets(), count)
    return found


def _rows(attr: Any) -> FloatArray:
    value = attr.Get() if attr else None
    return np.array(value or (), np.float64).reshape(-1, 3)


def _shape(shape: Any, points: int | None) -> Iterator[Fault]:
    offsets = _rows(shape.GetOffsetsAttr())
    indices = np.array(shape.GetPointIndicesAttr().Get() or (), np.int64)
    wanted = len(indices) or points
    path = shape.GetOffsetsAttr().GetPath()
    normals = _rows(shape.GetNormalOffsetsAttr())
    if not len(offsets) and len(normals):
        # A shape may turn normals alone.
        offsets = np.zeros((len(normals) if wanted is None else wanted, 3))
    if wanted is not None and len(offsets) != wanted:
        counted_as = "pointIndices" if len(indices) else "points"
        yield finding(
            "USD240", path, f"{len(offsets)} offsets for {wanted} {counted_as}"
        )
    yield from _indices(shape, indices, points)
    yield from _finite(shape.GetOffsetsAttr(), offsets)
    inbetweens = list(shape.GetInbetweens())
    moves = [offsets, normals, *(_rows(step.GetAttr()) for step in inbetweens)]
    if len(offsets) and not any(rows.any() for rows in moves):
        yield finding("USD246", path, f"all {len(offsets)} offsets are 0")
    count = wanted if wanted is not None else len(offsets)
    yield from _normals(shape.GetNormalOffsetsAttr(), count)
    yield from _inbetweens(inbetweens, count)


def _indices(shape: Any, indices: IntArray, points: int | None) -> Iterator[Fault]:
    path = shape.GetPointIndicesAttr().GetPath()
    last = np.iinfo(np.int64).max if points is None else points - 1
    wrong = indices[(indices < 0) | (indices > last)]
    if len(wrong):
        end = "" if points is None else f" to {last}"
        message = (
            f"{len(wrong)} of {len(indices)} are not in 0{end}, the first is {wrong[0]}"
        )
        yield finding("USD241", path, message)
    elif len(np.unique(indices)) != len(indices):
        held, counts = np.unique(indices, return_counts=True)
        twice = held[counts > 1]
        message = f"{len(twice)} of {len(indices)} stand twice, the first is {twice[0]}"
        yield finding("USD241", path, message)


def _finite(attr: Any, rows: FloatArray) -> Iterator[Fault]:
    bad = np.flatnonzero(~np.isfinite(rows).all(axis=1))
    if len(bad):
        message = f"{len(bad)} of {len(rows)} are not finite, the first is {bad[0]}"
        yield finding("USD243", attr.GetPath(), message)


def _normals(attr: Any, wanted: int) -> Iterator[Fault]:
    rows = _rows(attr)
    if attr and attr.HasAuthoredValue() and len(rows) not in {0, wanted}:
        message = f"{len(rows)} normalOffsets for {wanted} offsets"
        yield finding("USD242", attr.GetPath(), message)
    yield from _finite(attr, rows)


def _inbetweens(steps: list[Any], wanted: int) -> Iterator[Fault]:
    taken: dict[float, str] = {}
    for step in steps:
        attr, weight = step.GetAttr(), step.GetWeight()
        rows = _rows(attr)
        if len(rows) != wanted:
            message = f"{len(rows)} offsets for {wanted}"
            yield finding("USD240", attr.GetPath(), message)
        yield from _finite(attr, rows)
        yield from _normals(step.GetNormalOffsetsAttr(), wanted)
        if weight is None or not np.isfinite(weight) or weight in {0.0, 1.0}:
            have = "no weight" if weight is None else f"weight {weight:g}"
            yield finding("USD244", attr.GetPath(), have)
        elif weight in taken:
            message = f"weight {weight:g}, as {excerpt(taken[weight])}"
            yield finding("USD244", attr.GetPath(), message)
        else:
            taken[weight] = attr.GetName()
