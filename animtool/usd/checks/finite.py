"""Checks on every attribute: type, finite values, splines.

It reads layers, not the stage, to include values that a stronger opinion hides, and
variants that are not selected.
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
from animtool.usd.checks.checked_stage import CheckedStage
from animtool.usd.layers.finite import float_array, float_type_code


def check_types(checked_stage: CheckedStage) -> Iterator[Fault]:
    """Check that the strongest opinion of an attribute has its schema's type.

    Includes SkelBindingAPI properties on prims without the schema, and inbetweens.
    """
    for attr in checked_stage.attributes:
        authored_type = attr.GetPropertyStack()[0].typeName
        expected_type = _expected_type(attr)
        if expected_type is not None and authored_type.type != expected_type.type:
            message = (
                f"it is {authored_type}, but its schema has {expected_type}; "
                "there may be "
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


def check_splines(checked_stage: CheckedStage) -> Iterator[Fault]:
    """Check that spline knots increase in time, and that no samples hide them.

    USD itself refuses knots that are not finite when reading the layer.
    """
    for attr in checked_stage.attributes:
        specs = [spec for spec in attr.GetPropertyStack() if spec.HasSpline()]
        if not specs:
            continue
        spline = specs[0].GetSpline()
        if spline.HasRegressiveTangents():
            message = (
                f"some of its {len(spline.GetKnots())} knots have tangents so long "
                "that the curve goes back in time"
            )
            yield finding("USD274", attr.GetPath(), message)
        # In one layer, samples win; a stronger layer may replace a spline by samples.
        layer, path = specs[0].layer, specs[0].path
        samples = layer.ListTimeSamplesForPath(path)
        if samples:
            message = (
                f"{counted(len(samples), 'sample')} and "
                f"{counted(len(spline.GetKnots()), 'knot')}"
            )
            yield finding("USD275", attr.GetPath(), message)


def check_uniform(checked_stage: CheckedStage) -> Iterator[Fault]:
    """Check that no uniform attribute has time samples."""
    for attr in checked_stage.attributes:
        if attr.GetVariability() != Sdf.VariabilityUniform:
            continue
        times = checked_stage.times(attr)
        if times:
            message = (
                f"{counted(len(times), 'sample')} from time code {times[0]:g} on a "
                "uniform attribute"
            )
            yield finding("USD211", attr.GetPath(), message)


# Codes of checks that report non-finite values of specific attributes.
COVERED_CODES = frozenset(
    {"USD202", "USD225", "USD233", "USD235", "USD243", "USD265", "USD271", "USD272"}
)
# Attributes of physics engines, whose schemas are not registered: infinity is their
# default or no limit there (PhysX contactOffset, Newton limitStiffness).
ENGINE_ATTRIBUTES = ("physx.*:.+", "newton:.+")
# Maximum findings per prim, and per layer metadata.
MAX_FINDINGS = 5
# Metadata that other rules check in the root layer, and rates in all layers.
RATE_FIELDS = frozenset({"framesPerSecond", "timeCodesPerSecond"})
ROOT_FIELDS = frozenset({"startTimeCode", "endTimeCode", "metersPerUnit"})
# Fields that are not metadata, or have no numbers.
NON_NUMERIC_FIELDS = frozenset(
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


def check_finite(checked_stage: CheckedStage) -> Iterator[Fault]:
    """Check that no number in any layer of a stage is NaN or infinite.

    Infinities that are a schema's fallback, such as limits of physics joints, are
    allowed.
    """
    root = checked_stage.stage.GetRootLayer()
    layers = [layer for layer in checked_stage.stage.GetUsedLayers() if layer != root]
    for layer in (root, *sorted(layers, key=lambda layer: str(layer.identifier))):
        problems = _layer_problems(checked_stage, layer, is_root=layer == root)
        layer_suffix = "" if layer == root else f" (in {layer.GetDisplayName()})"
        for _, group in groupby(problems, key=lambda item: item[0].GetPrimPath()):
            yield from _first_findings(list(group), layer_suffix)


def _first_findings(
    problems: list[tuple[Any, str]], layer_suffix: str
) -> Iterator[Fault]:
    """Yield up to `MAX_FINDINGS` findings of a prim; the last one counts the rest."""
    for i, (path, message) in enumerate(problems[:MAX_FINDINGS], 1):
        omitted_count = len(problems) - MAX_FINDINGS if i == MAX_FINDINGS else 0
        suffix = ""
        if omitted_count > 0:
            suffix = f"; so are {omitted_count} more values of this prim"
        yield finding("USD171", path, f"{message}{layer_suffix}{suffix}")


def _layer_problems(
    checked_stage: CheckedStage, layer: Any, *, is_root: bool
) -> Iterator[tuple[Any, str]]:
    """Yield spec paths with non-finite numbers, grouped by prim."""
    paths: list[Any] = []
    layer.Traverse(Sdf.Path.absoluteRootPath, paths.append)
    for path in sorted(paths, key=lambda path: (str(path.GetPrimPath()), str(path))):
        spec = layer.GetObjectAtPath(path)
        if spec is None:
            continue
        ignored_fields = NON_NUMERIC_FIELDS
        if path == Sdf.Path.absoluteRootPath:
            ignored_fields = (
                ignored_fields | RATE_FIELDS | (ROOT_FIELDS if is_root else set())
            )
            for i, offset in enumerate(layer.subLayerOffsets):
                if problem := _metadata_problem(offset, f"subLayerOffsets[{i}]"):
                    yield path, problem
        for key in spec.ListInfoKeys():
            if key not in ignored_fields and (
                problem := _metadata_problem(spec.GetInfo(key), key)
            ):
                yield path, problem
        has_floats = isinstance(spec, Sdf.AttributeSpec) and float_type_code(
            spec.typeName
        )
        if has_floats and (problem := _attribute_problem(checked_stage, layer, spec)):
            yield path, problem


def _metadata_problem(value: Any, name: str) -> str:
    """Describe the non-finite number of a metadata value; empty if there is none."""
    if isinstance(value, Mapping):
        problems = (
            _metadata_problem(item, f"{name}:{key}") for key, item in value.items()
        )
        return next(filter(None, problems), "")
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
    numbers = float_array(value)
    if numbers is None or _is_finite(numbers):
        return ""
    return f"its metadata {name} is {_non_finite_number(numbers)}"


def _attribute_problem(checked_stage: CheckedStage, layer: Any, spec: Any) -> str:
    """Describe non-finite values and times of an attribute; empty if all are finite."""
    default = float_array(spec.default) if spec.HasDefaultValue() else None
    problems = []
    if default is not None and not _is_allowed(checked_stage, spec, default):
        problems.append(
            f"its default value is {_non_finite_number(default)}"
            f"{_element_index(default)}"
        )
    path = spec.path
    times = (
        [] if _is_covered(checked_stage, path) else layer.ListTimeSamplesForPath(path)
    )
    if not all(map(math.isfinite, times)):
        problems.append("the time of a sample is not finite")
    query_sample, non_finite_count, first_problem = layer.QueryTimeSample, 0, ""
    for time in times:
        numbers = float_array(query_sample(path, time))
        if numbers is None or _is_allowed(checked_stage, spec, numbers):
            continue
        non_finite_count += 1
        if not first_problem:
            element = _element_index(numbers)
            number = _non_finite_number(numbers)
            first_problem = f"it is {number} at time code {time:.10g}{element}"
    if non_finite_count > 1:
        first_problem += f", and in {counted(non_finite_count - 1, 'more sample')}"
    return "; ".join(filter(None, (*problems, first_problem)))


def _is_covered(checked_stage: CheckedStage, path: Any) -> bool:
    """Return whether another check covers all samples of an attribute."""
    if path not in checked_stage.finite_paths:
        return False
    stack = checked_stage.stage.GetAttributeAtPath(path).GetPropertyStack()
    counts: list[int] = [spec.layer.GetNumTimeSamplesForPath(path) for spec in stack]
    return sum(count > 0 for count in counts) == 1


def _is_finite(numbers: npt.NDArray[Any]) -> bool:
    if not numbers.size:
        return True
    # min and max propagate NaN, comparisons do not.
    return bool(numbers.min() > -math.inf and numbers.max() < math.inf)


def _is_allowed(
    checked_stage: CheckedStage, spec: Any, numbers: npt.NDArray[Any]
) -> bool:
    if _is_finite(numbers):
        return True
    if np.isnan(numbers).any():
        return False
    path = spec.path.StripAllVariantSelections()
    prim = checked_stage.stage.GetPrimAtPath(path.GetPrimPath())
    if not prim:
        return False
    fallback = prim.GetPrimDefinition().GetAttributeFallbackValue(path.name)
    fallback_values = None if fallback is None else float_array(fallback)
    if fallback_values is None:
        # An attribute of a schema that the prim does not apply, as some exporters
        # write.
        return any(
            pattern.fullmatch(path.name) for pattern in _infinite_fallback_patterns()
        )
    return not _is_finite(fallback_values)


@cache
def _infinite_fallback_patterns() -> tuple[re.Pattern[str], ...]:
    """Return name patterns of attributes with an infinite schema fallback."""
    registry, name_patterns = Usd.SchemaRegistry(), {*ENGINE_ATTRIBUTES}
    for schema in Tf.Type.Find(Usd.SchemaBase).GetAllDerivedTypes():
        schema_name = Usd.SchemaRegistry.GetSchemaTypeName(schema)
        definition = registry.FindAppliedAPIPrimDefinition(schema_name)
        if definition is None:
            definition = registry.FindConcretePrimDefinition(schema_name)
        if definition is None:
            continue
        for attribute in definition.GetPropertyNames():
            fallback = definition.GetAttributeFallbackValue(attribute)
            numbers = None if fallback is None else float_array(fallback)
            if numbers is not None and not _is_finite(numbers):
                name_patterns.add(
                    re.escape(attribute).replace("__INSTANCE_NAME__", ".+")
                )
    return tuple(map(re.compile, sorted(name_patterns)))


def _first_non_finite(numbers: npt.NDArray[Any]) -> Any:
    return np.argwhere(~np.isfinite(numbers))[0]


def _non_finite_number(numbers: npt.NDArray[Any]) -> str:
    return f"{float(numbers[tuple(_first_non_finite(numbers))]):g}"


def _element_index(numbers: npt.NDArray[Any]) -> str:
    """Return the array index of the first non-finite number as text."""
    index = _first_non_finite(numbers)
    return f", element {index[0]}" if len(index) else ""
