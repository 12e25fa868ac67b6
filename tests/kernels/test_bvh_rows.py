from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_array_equal

from animtool import _kernels


def parse(text: str | bytes, columns: int = 1, *, final: bool = True) -> tuple:  # type: ignore[type-arg]
    data = text.encode() if isinstance(text, str) else text
    return _kernels.parse_bvh_rows(data, columns, 1 << 30, final)


@given(st.floats(allow_nan=False, allow_infinity=False))
def test_shortest_representation_is_read_exactly(value: float) -> None:
    found = parse(repr(value))[0][0, 0]
    assert found == value
    assert math.copysign(1, found) == math.copysign(1, value)


@given(st.decimals(allow_nan=False, allow_infinity=False, places=6))
def test_decimals_are_read_as_python_reads_them(value: object) -> None:
    text = format(value, "f")
    assert parse(text)[0][0, 0] == float(text)


@pytest.mark.parametrize(
    "text",
    [
        ".5", "5.", "+1.5", "-.25", "1e5", "1E-5", "1.5e+3", "0", "-0", "00012.50",
        "9007199254740993", "9007199254740993.0000000000", "1e22", "1e23", "1e-22",
        "123456789012345678901234567890", "2.2250738585072011e-308", "5e-324", "1e-400",
        "179769313486231570000000000000000000000e270",
        "0.1000000000000000055511151231257827",
        "8.5e-3",
        "0." + "0" * 400 + "1e5", "0" * 400 + "e9",
        "12345678.12345678", "1234567.1", "0." + "0" * 400 + "1",
    ],
)  # fmt: skip
def test_numbers_by_name(text: str) -> None:
    for tail in ("", "\n", " \r\n", "         \n"):
        values, _, consumed, _, fault, _, _ = parse(text + tail)
        assert fault == 0, repr(tail)
        assert consumed == len(text + tail), repr(tail)
        assert values[0, 0] == float(text), repr(tail)


@pytest.mark.parametrize(
    "text", ["nan", "NaN", "-nan", "inf", "-Infinity", "1.#QNAN", "-1.#IND", "1.#INF"]
)
def test_what_is_not_finite_is_nan(text: str) -> None:
    assert np.isnan(parse(f"1 {text}", 2)[0][0, 1])


@pytest.mark.parametrize(
    "text", ["1e400", "-1e999", "1" + "0" * 400, "1" + "0" * 400 + "e-5", "0.1e400"]
)
def test_overflow_is_infinity(text: str) -> None:
    value = parse(text)[0][0, 0]
    assert np.isinf(value)
    assert np.sign(value) == (-1 if text[0] == "-" else 1)


@pytest.mark.parametrize(
    "text",
    ["x", "1,5", "1.2.3", "--1", "+-1", "1e", "1e+", "-", ".", "+.", "e5", "0x10",
     "1_0", "12x", "nano", "infin", "1\x00", "½"],
)  # fmt: skip
def test_what_is_no_number(text: str) -> None:
    _, _, consumed, lines, fault, found, token = parse(f"1 2\n3 {text}\n", 2)
    assert (fault, found, lines, consumed) == (2, 1, 1, 4)
    assert token == text.encode()


@pytest.mark.parametrize("row", ["1", "1 2 3"])
def test_wrong_count(row: str) -> None:
    values, _, _, lines, fault, found, _ = parse(f"1 2\n\n{row}\n", 2)
    assert (len(values), lines, fault, found) == (1, 2, 1, len(row.split()))


@pytest.mark.parametrize("end", ["\n", "\r\n", "\r"])
def test_line_ends_and_numbers(end: str) -> None:
    text = end.join(["", "1 2", " \t", "3\t4  ", "", "5 6", ""])
    values, row_lines, *_ = parse(text, 2)
    assert_array_equal(values, [[1, 2], [3, 4], [5, 6]])
    assert row_lines.tolist() == [1, 3, 5]


@given(st.integers(1, 60), st.sampled_from(["\n", "\r\n", "\r"]), st.integers(0, 5))
def test_chunks_change_nothing(size: int, end: str, seed: int) -> None:
    rows = np.round(np.random.default_rng(seed).normal(size=(7, 3)) * 100, 3)
    text = end.join(" ".join(map(str, row)) for row in rows).encode()
    held, found, lines = b"", [], []
    done = 0
    for start in range(0, len(text) + size, size):
        held += text[start : start + size]
        final = start + size >= len(text)
        values, row_lines, consumed, count, fault, *_ = parse(held, 3, final=final)
        assert fault == 0
        found.append(values)
        lines += (row_lines + done).tolist()
        held, done = held[consumed:], done + count
    assert_array_equal(np.concatenate(found), rows)
    assert lines == list(range(7))


def test_a_limit_stops_between_rows() -> None:
    values, _, consumed, *_ = _kernels.parse_bvh_rows(b"1\n2\n3\n", 1, 2, True)
    assert (len(values), consumed) == (2, 4)


@given(st.lists(st.floats(-1e9, 1e9), min_size=1, max_size=8), st.integers(0, 9))
def test_format_is_read_back(values: list[float], places: int) -> None:
    row = np.array([values])
    text = _kernels.format_bvh_rows(row, np.full(len(values), places))
    back = parse(text, len(values))[0]
    # Half a unit of the last place, and what two roundings of the number move it,
    # the first as a whole number of those units, whose spacing may be coarser.
    bound = 0.5 * 10.0**-places * (1 + 1e-6)
    assert (np.abs(back - row) <= bound + 1.5 * np.spacing(np.abs(row))).all()


def test_format_is_short() -> None:
    row = np.array([[0.5, -0.25, 1e-12, -1e-12, 12.0, 1e300]])
    text = _kernels.format_bvh_rows(row, np.full(6, 4)).decode().split()
    assert text[:5] == ["0.5", "-0.25", "0", "0", "12"]
    assert float(text[5]) == 1e300


def test_bad_shapes_are_refused() -> None:
    with pytest.raises(ValueError, match="decimal"):
        _kernels.format_bvh_rows(np.zeros((1, 2)), np.zeros(1, np.int64))
