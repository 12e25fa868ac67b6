"""TRC files: there and back, empty cells, and rows that are none."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from support.faults import raises

from animtool.core.clock import Clock
from animtool.core.errors import FormatError
from animtool.formats.trc.read import read_trc
from animtool.formats.trc.write import write_trc
from animtool.motion.markers import Markers

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
    monkeypatch.setattr("animtool.formats.trc.write.CHUNK_ROWS", 3)
    write_trc(markers, path)
    assert path.read_bytes() == whole


@pytest.mark.parametrize("end", ["\n", "\r\n", "\r"])
def test_empty_cells_and_nan_are_not_seen(tmp_path: Path, end: str) -> None:
    rows = "1\t0.0\t1\t2\t3\t\t\t\n2\t0.01\tnan\tNaN\tnan\t4\t5\t6\n"
    markers = read(tmp_path, (HEAD + rows).replace("\n", end))
    assert markers.visible.tolist() == [[True, False], [False, True]]
    assert markers.positions[1, 1].tolist() == [4.0, 5.0, 6.0]
    assert not [n for n in markers.notices if n.code != "MKR103"]


@pytest.mark.parametrize("code", ["9999999.0", "-3.697314e28", "99999"])
def test_a_number_for_points_that_were_not_seen(tmp_path: Path, code: str) -> None:
    rows = f"1\t0.0\t1\t2\t3\t{code}\t{code}\t{code}\n"
    rows += "2\t0.01\t4\t4\t4\t2000\t2001\t2000\n"
    markers = read(tmp_path, HEAD + rows)
    assert markers.visible.tolist() == [[True, False], [True, True]]
    (notice,) = [n for n in markers.notices if n.code == "MKR102"]
    assert f"{float(code):g}" in notice.message


def test_a_short_row_ends_in_empty_cells(tmp_path: Path) -> None:
    markers = read(tmp_path, HEAD + "1\t0\t1\t2\t3\n2\t.01\t1\t2\t3\n")
    assert markers.visible.tolist() == [[True, False]] * 2


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


WIDE = "1\t0\t1\t2\t3\t4\t5\t6\t7\t8\t9\n2\t0.01\t1\t2\t3\t4\t5\t6\t7\t8\t9\n"
ROWS = "1\t0\t1.5\t2\t3\t4\t5\t6.5\n2\t0.01\t1.5\t2\t3\t4\t5\t6.5\n"


def codes(markers: Markers) -> list[str]:
    return [each.code for each in markers.notices if each.code != "MKR103"]


@pytest.mark.parametrize(
    ("content", "names", "said"),
    [
        (HEAD + WIDE, ("A", "B", "*2"), ["TRC103"]),
        (HEAD.replace("2\t2\tm", "2\t3\tm") + WIDE, ("A", "B", "*2"), ["TRC103"]),
        (HEAD + WIDE[: WIDE.index("\n") + 1] + "2\t.01\t1\t2\t3\n",
         ("A", "B", "*2"), ["TRC103"]),
        (HEAD.replace("\tA\t", "\t\t") + ROWS, ("*0", "B"), ["TRC103"]),
        (HEAD.replace("2\t2\tm", "2\t7\tm") + ROWS, ("A", "B"), ["TRC101"]),
        (HEAD.replace("2\t2\tm", "2\t1\tm") + ROWS, ("A", "B"), ["TRC101"]),
        (HEAD.replace("A\t\t\tB\t\t", "A\tB") + ROWS, ("A", "B"), []),
        (HEAD.replace("A\t\t\tB\t\t", "A\t\tB") + ROWS, ("A", "B"), []),
        (HEAD.replace("A\t\t\tB\t\t", "A_X\tA_Y\tA_Z\tBx\tBy\tBz") + ROWS,
         ("A", "B"), []),
        (HEAD.replace("A\t\t\tB", "Left A\t\t\tLeft B") + ROWS,
         ("Left A", "Left B"), []),
    ],
)  # fmt: skip
def test_rows_say_how_many_markers_there_are(
    tmp_path: Path, content: str, names: tuple[str, ...], said: list[str]
) -> None:
    markers = read(tmp_path, content)
    assert (markers.names, codes(markers)) == (names, said)


@pytest.mark.parametrize("separator", [",", ";", "\t", " "])
@pytest.mark.parametrize("comma", [False, True])
def test_separators_and_decimal_commas(
    tmp_path: Path, separator: str, comma: bool
) -> None:
    text = HEAD + ROWS
    if comma:
        text = text.replace(".", ",")
    if separator == " ":
        text = text.replace("\t\t\t", " ").replace("\tm\n", "\tm \n")
    text = text.replace("\t", separator)
    if comma and separator == ",":
        with raises(FormatError, "TRC002"):
            read(tmp_path, text)
        return
    markers = read(tmp_path, text)
    assert codes(markers) == (["TRC108"] if comma else [])
    assert markers.names == ("A", "B")
    assert markers.positions[1].tolist() == [[1.5, 2, 3], [4, 5, 6.5]]


def test_names_between_blanks_have_no_blanks(tmp_path: Path) -> None:
    text = (HEAD + ROWS).replace("A\t\t\tB\t\t", "Left A B").replace("\t", " ")
    with pytest.raises(FormatError) as caught:
        read(tmp_path, text)
    assert caught.value.code == "TRC001"


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16", "latin-1"])
def test_encodings(tmp_path: Path, encoding: str) -> None:
    path = tmp_path / "a.trc"
    text = (HEAD + ROWS).replace("\tA\t", "\tGrößeA\t")
    path.write_bytes(text.encode(encoding))
    assert read_trc(path).names == ("GrößeA", "B")


@pytest.mark.parametrize(
    ("rows", "frames", "seen", "said"),
    [
        (ROWS + "3\t.02\t1\t2", 2, 4, ["TRC109"]),
        (ROWS + "3\t.02\t1\t2\t3", 2, 4, ["TRC109"]),
        (ROWS.replace("\t4\t5\t6.5\n", "\n", 1) + "3\t.02\t1\t2\t3", 3, 4, ["TRC101"]),
        (ROWS.replace("\t5\t6.5\n", "\n", 1), 2, 3, ["TRC109"]),
        (ROWS.replace("\t4\t5\t6.5\n", "\n", 1), 2, 3, []),
    ],
)
def test_rows_that_are_cut_short(
    tmp_path: Path, rows: str, frames: int, seen: int, said: list[str]
) -> None:
    markers = read(tmp_path, HEAD + rows)
    assert (len(markers), int(markers.visible.sum())) == (frames, seen)
    assert codes(markers) == said


@pytest.mark.slow
def test_opensim_reads_what_is_written(tmp_path: Path) -> None:
    reason = "opensim is not installed: pip install opensim"
    opensim = pytest.importorskip("opensim", reason=reason)
    opensim.Logger.setLevelString("off")
    positions = np.random.default_rng(4).normal(size=(9, 3, 3))
    for frame, marker in ((0, 2), (3, 0), (4, 1), (8, 2), (5, 0), (5, 1), (5, 2)):
        positions[frame, marker] = np.nan
    clock = Clock(Fraction(120), Fraction(31), Fraction(1), 9)
    path = tmp_path / "a.trc"
    write_trc(Markers(("Left A", "*1", "B"), clock, positions), path)
    table = opensim.TimeSeriesTableVec3(str(path))
    assert table.getNumRows() == 9
    assert table.getNumColumns() == 3
    times = np.array(table.getIndependentColumn())
    assert times == pytest.approx((30 + np.arange(9)) / 120, abs=1e-9)
    read_there = np.array(
        [
            [table.getRowAtIndex(i)[j][k] for j in range(3) for k in range(3)]
            for i in range(9)
        ]
    ).reshape(9, 3, 3)
    np.testing.assert_allclose(read_there, 1000 * positions, atol=1e-5)


@pytest.mark.parametrize(
    ("change", "rows", "message"),
    [
        (
            ("\t2\t2\tm", "\t9\t2\tm"),
            ROWS,
            "the header states 9 frames",
        ),
        (
            ("\t2\t2\tm", "\t2\t5\tm"),
            ROWS,
            "the header states 5 markers",
        ),
        (("\tB\t", "\t\t"), ROWS, "1 of 2 markers has no name, the first in column 6"),
        (("\tm\n", "\t\n"), ROWS, "the file states no unit; using mm"),
        (("", ""), ROWS[:-5], "the last row is truncated (7 of 8 values)"),
        (
            ("", ""),
            f"{ROWS}8\t.07\t1\t2\t3\t4\t5\t6\n",
            "5 frames (0.05 s) are missing before line 9",
        ),
    ],
)
def test_warnings_say_what_the_header_and_the_rows_have(
    tmp_path: Path, change: tuple[str, str], rows: str, message: str
) -> None:
    markers = read(tmp_path, HEAD.replace(*change) + rows)
    assert [one for one in markers.notices if one.message.startswith(message)]
