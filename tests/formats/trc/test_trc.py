"""TRC files: there and back, empty cells, and rows that are none."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

from animtool.clock import Clock
from animtool.errors import FormatError
from animtool.formats.trc import read_trc, write_trc
from animtool.markers import Markers

HEAD = (
    "PathFileType\t4\t(X/Y/Z)\ta.trc\n"
    "DataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits\n"
    "100\t100\t2\t2\tm\n"
    "Frame#\tTime\tA\t\t\tB\t\t\n"
    "\t\tX1\tY1\tZ1\tX2\tY2\tZ2\n\n"
)


def read(folder: Path, text: str) -> Markers:
    path = folder / "a.trc"
    path.write_bytes(text.encode())
    return read_trc(path)


def test_there_and_back(tmp_path: Path) -> None:
    positions = np.random.default_rng(2).normal(size=(50, 4, 3))
    positions[10:20, 2] = positions[-1, 3] = np.nan
    clock = Clock(Fraction(120), Fraction(5), Fraction(1), 50)
    markers = Markers(("A", "B", "C", "D"), clock, positions)
    path = tmp_path / "take.trc"
    write_trc(markers, path)
    back = read_trc(path)
    assert (back.names, back.clock) == (markers.names, clock)
    np.testing.assert_allclose(back.positions, positions, atol=1e-9)


def test_rows_at_once_do_not_show(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    clock = Clock(Fraction(60), Fraction(3), Fraction(1), 7)
    positions = np.random.default_rng(3).normal(size=(7, 2, 3))
    positions[4, 1] = np.nan
    markers = Markers(("A", "B"), clock, positions)
    path = tmp_path / "take.trc"
    write_trc(markers, path)
    whole = path.read_bytes()
    assert len(whole.splitlines()) == 6 + 7
    path.unlink()
    monkeypatch.setattr("animtool.formats.trc.write.ROWS_AT_ONCE", 3)
    write_trc(markers, path)
    assert path.read_bytes() == whole


@pytest.mark.parametrize("end", ["\n", "\r\n", "\r"])
def test_empty_cells_and_nan_are_not_seen(tmp_path: Path, end: str) -> None:
    rows = "1\t0.0\t1\t2\t3\t\t\t\n2\t0.01\tnan\tNaN\tnan\t4\t5\t6\n"
    markers = read(tmp_path, (HEAD + rows).replace("\n", end))
    assert markers.seen.tolist() == [[True, False], [False, True]]
    assert markers.positions[1, 1].tolist() == [4.0, 5.0, 6.0]
    assert not [n for n in markers.notices if n.code != "MKR103"]


def test_a_short_row_ends_in_empty_cells(tmp_path: Path) -> None:
    markers = read(tmp_path, HEAD + "1\t0\t1\t2\t3\n2\t.01\t1\t2\t3\n")
    assert markers.seen.tolist() == [[True, False]] * 2


@pytest.mark.parametrize(
    ("code", "text"),
    [
        ("TRC001", "nothing"),
        ("TRC001", "PathFileType\t4\n1\t2\n"),
        ("TRC002", HEAD + "1\t0\t1\t2\t3\t4\t5\t6\t7\n"),
        ("TRC002", HEAD + "1\t0\t1\t2\tx\t4\t5\t6\n"),
        ("MKR010", HEAD.replace("100\t100", "0\t0") + "1\t0\t1\t2\t3\t4\t5\t6\n"),
        ("MKR011", HEAD.replace("\tm\n", "\tell\n") + "1\t0\t1\t2\t3\t4\t5\t6\n"),
        ("MKR013", HEAD),
    ],
)
def test_what_cannot_be_read(tmp_path: Path, code: str, text: str) -> None:
    with pytest.raises(FormatError) as caught:
        read(tmp_path, text)
    assert caught.value.code == code


def test_counts_that_disagree_are_said(tmp_path: Path) -> None:
    markers = read(tmp_path, HEAD + "1\t0\t1\t2\t3\t4\t5\t6\n")
    assert "TRC101" in {notice.code for notice in markers.notices}
