"""Numbers with units as reports print them."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from animtool.core.quantities import duration_text, length_text, plain_number, size_text

NUMBERS = st.floats(1e-12, 1e12)
FACTORS = {
    length_text: {"m": 1.0, "mm": 1e-3, "µm": 1e-6, "nm": 1e-9},
    duration_text: {"s": 1.0, "ms": 1e-3, "µs": 1e-6},
    size_text: {"B": 1.0, "kB": 1e3, "MB": 1e6, "GB": 1e9},
}


@given(NUMBERS | NUMBERS.map(lambda number: -number), st.integers(1, 6))
def test_plain_numbers_have_no_exponent(number: float, digits: int) -> None:
    text = plain_number(number, digits)
    assert "e" not in text
    assert float(text) == float(f"{number:.{digits}g}")


@given(st.sampled_from(list(FACTORS)), NUMBERS)
def test_what_is_printed_is_the_number(printed: object, number: float) -> None:
    assert callable(printed)
    text, unit = printed(number).split()
    assert "e" not in text
    assert abs(float(text) * FACTORS[printed][unit] - number) <= 0.0051 * number


def test_zero_and_what_is_none() -> None:
    zeros = (length_text(0.0), duration_text(0.0), size_text(0))
    assert zeros == ("0 mm", "0 s", "0 B")
    assert length_text(float("inf")) == "inf m"
    assert length_text(1e-16) == "below 0.001 nm"
