from __future__ import annotations

from decimal import Decimal
from fractions import Fraction

import pytest
from hypothesis import given
from hypothesis import strategies as st

from animtool.core.rates import (
    RateKind,
    exact_number,
    parse_rate,
    rate_from_float,
    rate_from_frame_time,
    rate_label,
)


@pytest.mark.parametrize(
    ("text", "fps", "kind"),
    [
        ("0.0333333", "30", RateKind.REPRINTED),
        (".03333", "30", RateKind.REPRINTED),
        ("0.033333", "30", RateKind.REPRINTED),
        ("0.0333", "30", RateKind.REPRINTED),
        (".0083333", "120", RateKind.REPRINTED),
        ("0.008333", "120", RateKind.REPRINTED),
        ("0.0083", "120", RateKind.REPRINTED),
        ("0.008", "125", RateKind.REPRINTED),
        ("0.017", "60", RateKind.REPRINTED),
        ("0.016667", "60", RateKind.REPRINTED),
        ("0.016666666666666666", "60", RateKind.NEAREST),
        ("0.041667", "24", RateKind.REPRINTED),
        ("4.1667e-2", "24", RateKind.REPRINTED),
        ("0.01", "100", RateKind.REPRINTED),
        ("1.0", "1", RateKind.REPRINTED),
        ("0.0417083750417", "24000/1001", RateKind.NEAREST),
        ("0.041708", "24000/1001", RateKind.NEAREST),
        ("0.033367", "30000/1001", RateKind.NEAREST),
        ("0.0166833", "60000/1001", RateKind.NEAREST),
        ("0.03334", "30", RateKind.NEAREST),
        ("0.0353", "10000/353", RateKind.PRINTED),
        # From 30 to 29.97, the next rate that is known.
        ("0.033341", "30", RateKind.NEAREST),
        ("0.033343", "1000000/33343", RateKind.PRINTED),
        ("0.033357", "1000000/33357", RateKind.PRINTED),
        ("0.033359", "30000/1001", RateKind.NEAREST),
        ("0.041687", "1000000/41687", RateKind.PRINTED),
        ("0.0042", "240", RateKind.REPRINTED),
        ("0.009", "111", RateKind.REPRINTED),
        ("1e-6", "1000000", RateKind.PRINTED),
        ("100", "1/100", RateKind.PRINTED),
    ],
)
def test_frame_times(text: str, fps: str, kind: RateKind) -> None:
    choice = rate_from_frame_time(text)
    assert (choice.fps, choice.kind) == (Fraction(fps), kind)


@given(st.integers(1, 1000), st.integers(7, 15))
def test_every_integer_rate_is_found_again(rate: int, digits: int) -> None:
    choice = rate_from_frame_time(f"{1 / Decimal(rate):.{digits}f}")
    assert choice.fps == rate


@pytest.mark.parametrize(
    "text",
    ["", "x", "0", "-1", "nan", "inf", "1,5", "1e-400", "1e-9999999", "1e9999999"],
)
def test_what_is_no_frame_time(text: str) -> None:
    with pytest.raises(ValueError, match="number"):
        rate_from_frame_time(text)


def test_rivals_are_named_only_where_the_choice_is_open() -> None:
    assert rate_from_frame_time("0.017").ambiguous_rates == (58, 59)
    assert rate_from_frame_time("0.0042").ambiguous_rates == (236, 237, 238, 239)
    assert rate_from_frame_time("0.0080").ambiguous_rates == ()
    assert rate_from_frame_time("0.04").ambiguous_rates == ()
    # Exact at an uncommon rate, and a common one when rounded.
    assert rate_from_frame_time("0.008").ambiguous_rates == (120,)
    assert rate_from_frame_time(".004").ambiguous_rates == (240,)
    assert rate_from_frame_time("0.0333").ambiguous_rates == ()


@given(st.integers(1, 1000), st.booleans())
def test_floats_of_metadata(rate: int, broadcast: bool) -> None:
    exact = Fraction(rate * 1000, 1001) if broadcast else Fraction(rate)
    assert rate_from_float(float(exact)) == exact


@pytest.mark.parametrize(
    ("value", "rate"),
    [
        (23.976, "24000/1001"),
        (23.98, "24000/1001"),
        (29.97, "30000/1001"),
        (47.952, "48000/1001"),
        (59.94, "60000/1001"),
        (119.88, "120000/1001"),
        (0.2, "1/5"),
    ],
)
def test_decimals_in_metadata(value: float, rate: str) -> None:
    assert rate_from_float(value) == Fraction(rate)


@pytest.mark.parametrize("value", [0.0, -1.0, float("nan"), float("inf")])
def test_what_is_no_rate(value: float) -> None:
    with pytest.raises(ValueError, match="positive"):
        rate_from_float(value)


@pytest.mark.parametrize(
    ("text", "fps"),
    [
        ("24", "24"),
        ("23.976", "24000/1001"),
        ("24000/1001", "24000/1001"),
        ("12.5", "25/2"),
    ],
)
def test_what_people_write(text: str, fps: str) -> None:
    assert parse_rate(text) == Fraction(fps)


@pytest.mark.parametrize(
    "text", ["", "fast", "0", "-24", "1/0", "1e400", "1e-400", "1e12"]
)
def test_what_people_should_not_write(text: str) -> None:
    with pytest.raises(ValueError, match="rate"):
        parse_rate(text)


def test_label_of_an_odd_rate() -> None:
    assert rate_label(Fraction(10000, 353)) == "10000/353 (28.329) fps"


@pytest.mark.parametrize("text", ["1e99999999", "1e-99999999", "1" * 101, "1E+99999/3"])
def test_a_number_of_too_many_digits_is_refused_at_once(text: str) -> None:
    with pytest.raises(ValueError, match="is not a frame rate"):
        parse_rate(text)
    with pytest.raises(ValueError, match="too many digits"):
        exact_number(text)
