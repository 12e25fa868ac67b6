"""Delimited text: cells that are empty, short rows, commas, and what is no number."""

from __future__ import annotations

import numpy as np
import pytest
from support.faults import raises

from animtool.core.errors import Fault, FormatError
from animtool.formats.delimited import gather_rows


def fault(message: str, line: int) -> FormatError:
    return FormatError(Fault("TRC002", message, None, (line,)))


@pytest.mark.parametrize("separator", [b"\t", b";", b","])
def test_empty_cells_are_nan_wherever_they_are(separator: bytes) -> None:
    lines = [b"head", b"|1|||2|", b"", b"3|4", b"|||", b" 5 | 6 || |"]
    rows = gather_rows([line.replace(b"|", separator) for line in lines], 1, separator)
    assert rows.line_numbers.tolist() == [2, 4, 6]
    assert rows.value_counts.tolist() == [5, 2, 2]
    assert rows.cell_counts.tolist() == [6, 2, 5]
    nan = np.nan
    np.testing.assert_array_equal(
        rows.values(5, fault),
        [[nan, 1, nan, nan, 2], [3, 4, nan, nan, nan], [5, 6, nan, nan, nan]],
    )


def test_decimals_and_decimal_commas() -> None:
    rows = gather_rows([b"1;0,250;1", b"2;0,5;1,75"], 0, b";")
    assert rows.has_decimal_commas
    assert rows.decimals(1) == 3
    assert rows.values(3, fault).tolist() == [[1, 0.25, 1], [2, 0.5, 1.75]]
    mixed = gather_rows([b"1;0.250;1", b"2;0,5;1"], 0, b";")
    with raises(FormatError, "TRC002") as caught:
        mixed.values(3, fault)
    assert caught.value.faults[0].lines == (2,)


def test_one_wide_row_does_not_widen_all(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("animtool.formats.delimited.FREE_PADDING_VALUES", 100)
    rows = gather_rows([b"\t".join([b"1"] * 50), *[b"1"] * 200], 0, b"\t")
    with raises(FormatError, "TRC002") as caught:
        rows.values(50, fault)
    assert caught.value.faults[0].lines == (1,)
