"""Numbers and text that come back as they were."""

from __future__ import annotations

import math

import yaml
from hypothesis import given
from hypothesis import strategies as st

from animtool.documents.numbers import number, scaled, text

FLOATS = st.floats(-1e9, 1e9, allow_nan=False)


@given(st.floats(allow_nan=False, allow_infinity=False))
def test_a_number_reads_back(value: float) -> None:
    assert float(number(value)) == value


@given(FLOATS, st.sampled_from([1.0, 0.01, 0.001, 0.0254, math.radians(1)]))
def test_a_scaled_number_reads_back_to_rounding(value: float, unit: float) -> None:
    assert math.isclose(float(scaled(value, unit)) * unit, value, rel_tol=3e-16)


@given(st.integers(-9000, 9000), st.sampled_from([0.01, 0.001, 0.0254]))
def test_what_a_person_wrote_comes_back(tenths: int, unit: float) -> None:
    written = tenths / 10
    assert float(scaled(written * unit, unit)) == written


@given(st.text(min_size=1, max_size=20).filter(lambda t: "\x85" not in t))
def test_text_reads_back_as_text(value: str) -> None:
    if all(ord(c) < 0x10000 and (c.isprintable() or c in "\t\n") for c in value):
        assert yaml.safe_load(text(value)) == value
