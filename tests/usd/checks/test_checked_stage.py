"""Samples as the checks read them are those that USD gives."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pxr import Sdf, Usd, Vt
from support.suite import examples

from animtool.usd.checks.checked_stage import CheckedStage, SampledArray, samples_text

TYPES = Sdf.ValueTypeNames


def layered(offset: float, scale: float, rate: float, counts: list[int]) -> Usd.Stage:
    """Return a stage with an attribute in a sublayer, its samples of given counts."""
    below = Sdf.Layer.CreateAnonymous(".usda")
    below.timeCodesPerSecond = rate
    spec = Sdf.CreatePrimInLayer(below, "/A")
    spec.specifier = Sdf.SpecifierDef
    Sdf.AttributeSpec(spec, "x", TYPES.Float3Array)
    for code, count in enumerate(counts):
        rows = np.full((count, 3), code, np.float32)
        value = Vt.Vec3fArray.FromNumpy(rows) if count else Sdf.ValueBlock()
        below.SetTimeSample("/A.x", float(code), value)
    top = Sdf.Layer.CreateAnonymous(".usda")
    top.timeCodesPerSecond = 24
    top.subLayerPaths.append(below.identifier)
    top.subLayerOffsets[0] = Sdf.LayerOffset(offset, scale)
    return Usd.Stage.Open(top)


# Times that floats hold: USD maps others back to a rounding before the sample.
@given(
    st.integers(-400, 400).map(lambda quarters: quarters / 4),
    st.sampled_from([0.5, 1.0, 2.0]),
    st.sampled_from([24.0, 48.0]),
    st.lists(st.integers(0, 3), min_size=1, max_size=6),
)
@settings(max_examples=examples(40))
def test_samples_are_those_of_usd(
    offset: float, scale: float, rate: float, counts: list[int]
) -> None:
    stage = layered(offset, scale, rate, counts)
    attr = stage.GetAttributeAtPath("/A.x")
    found = CheckedStage(stage).sampled_array(attr)
    assert found.times.tolist() == attr.GetTimeSamples()
    for time, array, count in zip(found.times, found.arrays, found.counts, strict=True):
        theirs = attr.Get(time)
        assert count == (-1 if theirs is None else len(theirs))
        assert (array is None) == (theirs is None)
        if array is not None:
            assert np.array_equal(np.array(array), np.array(theirs))
    for count in (1, 2, 3):
        which, values = found.rows(count, 3)
        assert which.tolist() == [i for i, n in enumerate(found.counts) if n == count]
        assert values.shape == (len(which), count, 3)


def test_a_sample_is_read_once() -> None:
    checked_stage = CheckedStage(layered(0, 1, 24, [1, 1, 1]))
    attr = checked_stage.stage.GetAttributeAtPath("/A.x")
    assert checked_stage.sampled_array(attr) is checked_stage.sampled_array(attr)


@pytest.mark.parametrize(
    ("times", "bad", "text"),
    [
        ([np.nan], [0], "in the default value"),
        ([1.0, 2.5], [1], "at time code 2.5"),
        ([1.0, 2.0, 3.0], [1, 2], "in 2 of 3 samples, first at time code 2"),
    ],
)
def test_places_are_said(times: list[float], bad: list[int], text: str) -> None:
    sampled = SampledArray(np.array(times), [], np.zeros(len(times), np.int64))
    assert samples_text(sampled, np.array(bad)) == text
    mask = np.isin(np.arange(len(times)), bad)
    assert samples_text(sampled, mask) == text
