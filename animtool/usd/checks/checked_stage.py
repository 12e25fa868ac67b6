"""Caches the prims and samples of a stage for the checks."""

from __future__ import annotations

from collections.abc import Iterator, Sized
from dataclasses import field
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt
from pxr import Usd

from animtool.core.array_types import BoolArray, FloatArray, IntArray
from animtool.core.errors import counted
from animtool.core.record import dataclass

AnyArray = npt.NDArray[Any]


@dataclass(frozen=True, slots=True)
class SampledArray:
    """All values of an array attribute, with their time codes."""

    times: FloatArray  # time codes ``(F,)``; NaN alone for the default
    arrays: list[Any]  # one per time; None if blocked
    counts: IntArray  # array lengths ``(F,)``; -1 if there is no value

    def rows(self, count: int, width: int) -> tuple[IntArray, AnyArray]:
        """Return the samples whose arrays have a given length.

        Returns their indices ``(N,)`` and values ``(N, count, width)``.
        """
        indices = np.flatnonzero(self.counts == count)
        if not len(indices) or not count:
            return indices[:0], np.zeros((0, count, width), np.float32)
        first_array = np.array(self.arrays[indices[0]])
        values = np.zeros((len(indices), *first_array.shape), first_array.dtype)
        # Each Vt array is a separate buffer and is copied once.
        for row, i in enumerate(indices.tolist()):
            values[row] = self.arrays[i]
        return indices, values.reshape(len(indices), count, width)

    @property
    def is_animated(self) -> bool:
        """Whether the attribute has time samples."""
        return not np.isnan(self.times).any()


def samples_text(array: SampledArray, selection: BoolArray | IntArray) -> str:
    """Describe which samples are selected by a mask or indices ``(F,)``."""
    indices = np.flatnonzero(selection) if selection.dtype == np.bool_ else selection
    if not array.is_animated:
        return "in the default value"
    text = f"at time code {array.times[indices[0]]:g}"
    if len(indices) == 1:
        return text
    return f"in {len(indices)} of {counted(len(array.times), 'sample')}, first {text}"


@dataclass
class CheckedStage:
    """A stage, with its prims and samples cached for the checks."""

    stage: Any  # a `Usd.Stage`
    # Paths of attributes whose samples are all known to be finite.
    finite_paths: set[Any] = field(default_factory=set)
    _sampled_arrays: dict[Any, SampledArray] = field(default_factory=dict)
    _times: dict[Any, list[float]] = field(default_factory=dict)

    @cached_property
    def prims(self) -> list[Any]:
        """Active prims including overs; equal instances only once."""
        predicate = Usd.PrimIsActive & Usd.PrimIsLoaded & ~Usd.PrimIsAbstract
        pseudo_root = self.stage.GetPseudoRoot()
        prims, visited = [], set()
        for prim in Usd.PrimRange(pseudo_root, Usd.TraverseInstanceProxies(predicate)):
            if prim.IsInstanceProxy():
                prototype_path = prim.GetPrimInPrototype().GetPath()
                if prototype_path in visited:
                    continue
                visited.add(prototype_path)
            prims.append(prim)
        return prims[1:]

    @cached_property
    def attributes(self) -> list[Any]:
        """Attributes with opinions on all prims."""
        return [a for prim in self.prims for a in prim.GetAuthoredAttributes()]

    @property
    def has_only_overs(self) -> bool:
        """Whether the rig is in another file: every root prim is an over."""
        roots = self.stage.GetPseudoRoot().GetAllChildren()
        return bool(roots) and not any(root.IsDefined() for root in roots)

    def prims_of_type(self, schema: Any) -> Iterator[Any]:
        """Yield the prims of a schema, wrapped in that schema."""
        return (schema(prim) for prim in self.prims if prim.IsA(schema))

    def times(self, attr: Any) -> list[float]:
        """Return the time codes of an attribute's samples."""
        key = attr.GetPath()
        if key not in self._times:
            self._times[key] = attr.GetTimeSamples()
        return self._times[key]

    def sampled_array(self, attr: Any) -> SampledArray:
        """Return all samples of an array attribute, or its default if it has none.

        An attribute without a value has no times.
        """
        key = attr.GetPath()
        if key in self._sampled_arrays:
            return self._sampled_arrays[key]
        times = self.times(attr)
        if times:
            arrays = _sample_values(attr, times)
        else:
            value = attr.Get()
            arrays = [] if value is None else [value]
        codes = times or [float("nan")] * len(arrays)
        counts = [len(a) if isinstance(a, Sized) else -1 for a in arrays]
        array = SampledArray(np.array(codes), arrays, np.array(counts, np.int64))
        self._sampled_arrays[key] = array
        return array


def _sample_values(attr: Any, times: list[float]) -> list[Any]:
    """Return the value at each sample, read from the layer if possible, for speed."""
    first_code = Usd.TimeCode(times[0])
    if attr.GetResolveInfo(first_code).GetSource() == Usd.ResolveInfoSourceTimeSamples:
        for spec, offset in attr.GetPropertyStackWithLayerOffsets(first_code):
            layer_times = spec.layer.ListTimeSamplesForPath(spec.path)
            if layer_times:
                if len(layer_times) == len(times) and offset.scale > 0:
                    query, path = spec.layer.QueryTimeSample, spec.path
                    values = (query(path, time) for time in layer_times)
                    return [v if isinstance(v, Sized) else None for v in values]
                break
    query = Usd.AttributeQuery(attr)
    return [query.Get(time) for time in times]
