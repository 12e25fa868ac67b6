"""Numbers and text that come back as they were."""

from __future__ import annotations

import math
from pathlib import Path

from hypothesis import given
from hypothesis import strategies as st
from support.faults import raises

from animtool.core.errors import FormatError
from animtool.core.names import (
    decimal_text,
    scaled_decimal,
    unreadable_character,
    yaml_scalar,
)
from animtool.documents.document import parse_document

FLOATS = st.floats(-1e9, 1e9, allow_nan=False)


@given(st.floats(allow_nan=False, allow_infinity=False))
def test_a_number_reads_back(value: float) -> None:
    assert float(decimal_text(value)) == value


@given(FLOATS, st.sampled_from([1.0, 0.01, 0.001, 0.0254, math.radians(1)]))
def test_a_scaled_number_reads_back_to_rounding(value: float, unit: float) -> None:
    assert math.isclose(float(scaled_decimal(value, unit)) * unit, value, rel_tol=3e-16)


@given(st.integers(-9000, 9000), st.sampled_from([0.01, 0.001, 0.0254]))
def test_what_a_person_wrote_comes_back(tenths: int, unit: float) -> None:
    written = tenths / 10
    assert float(scaled_decimal(written * unit, unit)) == written


@given(st.text(min_size=1, max_size=20))
def test_text_reads_back_as_text_or_is_not_written(value: str) -> None:
    line = f"a: {{b: {yaml_scalar(value)}}}" if not unreadable_character(value) else ""
    if line:
        assert parse_document(line, Path("a.yaml")).value == {"a": {"b": value}}
    else:
        with raises(FormatError, "DOC023"):
            yaml_scalar(value)
