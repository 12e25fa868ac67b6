"""Checks on every attribute: type, finite values, splines.

It reads layers, not the stage: what a stronger opinion hides, and the variants that are
not selected, are in the file too.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping
from functools import cache
from itertools import groupby
from typing import Any

import numpy as np
import numpy.typing as npt
from pxr import Sdf, Tf, Usd

from animtool.core.errors import Fault, counted
from animtool.core.rules import finding
from animtool.usd.checks.subject import StageSubject
from animtool.usd.layers.finite import floats_of, largest


def check_types(subject: StageSubject) -> Iterator[Fault]:
    """Check that the strongest opinion of an attribute has its schema's type.

    Properties of SkelBindingAPI count where it is not applied, too, and inbetweens.
    """
    for attr in subject.attributes:
        type_name, expected = attr.GetPropertyStack()[0].typeName, _expected_type(attr)
        if expected is not None and type_name.type != expected.type:
            message = (
                f"it is {type_name}, but its schema has {expected}; there may be "
                "more errors"
            )
            yield finding("USD280", attr.GetPath(), message)


def _expected_type(attr: Any) -> Any:
    """Return the type that an attribute should have; None if any is allowed."""
    name = attr.GetName()
    if name.startswith("inbetweens:"):
        return Sdf.ValueTypeNames.Vector3fArray
    binding = Usd.SchemaRegistry().FindAppliedAPIPrimDefinition("SkelBindingAPI")
    for definition in (attr.GetPrim().GetPrimDefinition(), binding):
        attribute_definition = definition.GetAttributeDefinition(name)
        if attribute_definition:
            return attribute_definition.GetTypeName()
    return None


def check_splines(subject: StageSubject) -> Iterator[Fault]:
    """Check that spline knots increase in time, and that no samples hide them.

    A knot that is not finite is refused by USD as the layer is read.
    """
    for attr in subject.attributes:
        specs = [spec for spec in attr.GetPropertyStack() if spec.HasSpline()]
        if not specs:
            continue
        spline = specs[0].GetSpline()
        if spline.HasRegressiveTangents():
            message = f"tangents of some of its {len(spline.GetKnots())} knots do"
            yield finding("USD274", attr.GetPath(), message)
        # Of one layer, samples win; a stronger layer may replace a spline by samples.
        layer, path = specs[0].layer, specs[0].path
        samples = layer.ListTimeSamplesForPath(path)
        if samples:
            message = (
                f"{counted(len(samples), 'sample')} and "
                f"{counted(len(spline.GetKnots()), 'knot')}"
            )
            yield finding("USD275", attr.GetPath(), message)


def check_uniform(subject: StageSubject) -> Iterator[Fault]:
    """Check that no uniform attribute has time samples."""
    for attr in subject.attributes:
        if attr.GetVariability() != Sdf.VariabilityUniform:
            continue
        times = subject.times(attr)
        if times:
            message = (
                f"{counted(len(times), 'sample')} from time code {times[0]:g} on a "
                "uniform attribute"
            )
            yield finding("USD211", attr.GetPath(), message)


# Codes that say the same of one kind of attribute.
ALREADY = frozenset(
    {"USD202", "USD225", "USD233", "USD235", "USD243", "USD265", "USD271", "USD272"}
)
# Of one prim, or of the metadata of a layer.
MAX_FINDINGS = 5
# What other rules look at in the root layer, and rates in all.
RATES = frozenset({"framesPerSecond", "timeCodesPerSecond"})
ROOT_ALREADY = frozenset({"startTimeCode", "endTimeCode", "metersPerUnit"})
# Not metadata, or without numbers.
NO_NUMBERS = frozenset(
    {
        "custom",
        "default",
        "specifier",
        "spline",
        "subLayerOffsets",
        "timeSamples",
        "typeName",
        "variability",
    }
)


def check_finite(subject: StageSubject) -> Iterator[Fault]:
    """Check that no number in any layer of a stage is NaN or infinite.

    An infinity that a schema itself has as its fallback, such as the limits of a
    physics joint, is one that is meant.
    """
    root = subject.stage.GetRootLayer()
    used = [layer for layer in subject.stage.GetUsedLayers() if layer != root]
    for layer in (root, *sorted(used, key=lambda layer: str(layer.identifier))):
        specs = _of_layer(subject, layer, is_root=layer == root)
        for _, group in groupby(specs, key=lambda item: item[0].GetPrimPath()):
            yield from _limited(list(group), "" if layer == root else _named(layer))


def _named(layer: Any) -> str:
    return f" (in {layer.GetDisplayName()})"


def _limited(problems: list[tuple[Any, str]], where: str) -> Iterator[Fault]:
    """Yield the first findings of a prim; the last one counts the rest."""
    for i, (path, message) in enumerate(problems[:MAX_FINDINGS], 1):
        rest = len(problems) - MAX_FINDINGS if i == MAX_FINDINGS else 0
        more = f"; so are {rest} more values of this prim" if rest > 0 else ""
        yield finding("USD171", path, f"{message}{where}{more}")


def _of_layer(
    subject: StageSubject, layer: Any, *, is_root: bool
) -> Iterator[tuple[Any, str]]:
    """Yield spec paths with non-finite numbers, grouped by prim."""
    paths: list[Any] = []
    layer.Traverse(Sdf.Path.absoluteRootPath, paths.append)
    for path in sorted(paths, key=lambda path: (str(path.GetPrimPath()), str(path))):
        spec = layer.GetObjectAtPath(path)
        if spec is None:
            continue
        skipped = NO_NUMBERS
        if path == Sdf.Path.absoluteRootPath:
            skipped = skipped | RATES | (ROOT_ALREADY if is_root else set())
            for i, offset in enumerate(layer.subLayerOffsets):
                if problem := _of_data(offset, f"subLayerOffsets[{i}]"):
                    yield path, problem
        for key in spec.ListInfoKeys():
            if key not in skipped and (problem := _of_data(spec.GetInfo(key), key)):
                yield path, problem
        floats = isinstance(spec, Sdf.AttributeSpec) and largest(spec.typeName)
        if floats and (problem := _of_attribute(subject, layer, spec)):
            yield path, problem


def _of_data(value: Any, name: str) -> str:
    """Return the fault of a metadata value; empty if valid."""
    if isinstance(value, Mapping):
        parts = (_of_data(item, f"{name}:{key}") for key, item in value.items())
        return next(filter(None, parts), "")
    if isinstance(value, Sdf.LayerOffset):
        value = [value.offset, value.scale]
    elif isinstance(value, (Sdf.ReferenceListOp, Sdf.PayloadListOp)):
        value = [
            number
            for item in value.GetAddedOrExplicitItems()
            for number in (item.layerOffset.offset, item.layerOffset.scale)
        ]
    elif isinstance(value, (str, bool, int)):
        return ""
    numbers = floats_of(value)
    if numbers is None or _is_finite(numbers):
        return ""
    return f"its metadata {name} is {_worst(numbers)}"


def _of_attribute(subject: StageSubject, layer: Any, spec: Any) -> str:
    """Return the fault of an attribute's values; empty if valid."""
    default = floats_of(spec.default) if spec.HasDefaultValue() else None
    problems = []
    if default is not None and not _is_allowed(subject, spec, default):
        problems.append(f"its default is {_worst(default)}{_element(default)}")
    path = spec.path
    times = [] if _is_known(subject, path) else layer.ListTimeSamplesForPath(path)
    if not all(map(math.isfinite, times)):
        problems.append("the time of a sample is not finite")
    query, bad, first = layer.QueryTimeSample, 0, ""
    for time in times:
        numbers = floats_of(query(path, time))
        if numbers is None or _is_allowed(subject, spec, numbers):
            continue
        bad += 1
        if not first:
            element = _element(numbers)
            first = f"it is {_worst(numbers)} at time code {time:.10g}{element}"
    if bad > 1:
        first += f", and in {counted(bad - 1, 'more sample')}"
    return "; ".join(filter(None, (*problems, first)))


def _is_known(subject: StageSubject, path: Any) -> bool:
    """Return whether another check already covers the attribute's only samples."""
    if path not in subject.finite:
        return False
    stack = subject.stage.GetAttributeAtPath(path).GetPropertyStack()
    counts: list[int] = [spec.layer.GetNumTimeSamplesForPath(path) for spec in stack]
    return sum(count > 0 for count in counts) == 1


def _is_finite(numbers: npt.NDArray[Any]) -> bool:
    if not numbers.size:
        return True
    # NaN comes through min and max, and through no comparison.
    return bool(numbers.min() > -math.inf and numbers.max() < math.inf)


def _is_allowed(subject: StageSubject, spec: Any, numbers: npt.NDArray[Any]) -> bool:
    if _is_finite(numbers):
        return True
    if np.isnan(numbers).any():
        return False
    path = spec.path.StripAllVariantSelections()
    prim = subject.stage.GetPrimAtPath(path.GetPrimPath())
    if not prim:
        return False
    fallback = prim.GetPrimDefinition().GetAttributeFallbackValue(path.name)
    fallback_values = None if fallback is None else floats_of(fallback)
    if fallback_values is None:
        # An attribute of a schema that the prim does not name, as some exporters write.
        return any(name.fullmatch(path.name) for name in _infinite_names())
    return not _is_finite(fallback_values)


@cache
def _infinite_names() -> tuple[re.Pattern[str], ...]:
    """Return attributes whose schema fallback is infinite."""
    registry, names = Usd.SchemaRegistry(), set()
    for schema in Tf.Type.Find(Usd.APISchemaBase).GetAllDerivedTypes():
        name = Usd.SchemaRegistry.GetSchemaTypeName(schema)
        definition = registry.FindAppliedAPIPrimDefinition(name)
        if definition is None:
            continue
        for attribute in definition.GetPropertyNames():
            fallback = definition.GetAttributeFallbackValue(attribute)
            numbers = None if fallback is None else floats_of(fallback)
            if numbers is not None and not _is_finite(numbers):
                names.add(re.escape(attribute).replace("__INSTANCE_NAME__", ".+"))
    return tuple(map(re.compile, sorted(names)))


def _bad(numbers: npt.NDArray[Any]) -> Any:
    return np.argwhere(~np.isfinite(numbers))[0]


def _worst(numbers: npt.NDArray[Any]) -> str:
    return f"{float(numbers[tuple(_bad(numbers))]):g}"


def _element(numbers: npt.NDArray[Any]) -> str:
    """Return the array index of the first non-finite number as text."""
    index = _bad(numbers)
    return f", element {index[0]}" if len(index) else ""
