"""When the rows of a TRC are: Time, Frame# and DataRate against one another."""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from support.faults import raises

from animtool.core.errors import FormatError
from animtool.formats.trc.read import read_trc
from animtool.formats.trc.write import write_trc
from animtool.motion.markers import Markers

NTSC = [f"{i * 1001 / 60000:.5f}" for i in range(400)]


def text(numbers: Sequence[object], times: Sequence[object], rate: object = 60) -> str:
    """Return a file whose marker is at ``(100 t, 1, 2)`` m."""
    head = (
        "PathFileType\t4\t(X/Y/Z)\ta.trc\nDataRate\tNumFrames\tNumMarkers\tUnits\n"
        f"{rate}\t{len(times)}\t1\tm\nFrame#\tTime\tA\t\t\n\t\tX1\tY1\tZ1\n\n"
    )
    rows = [
        f"{n}\t{t}\t{100 * float(t or 0):.6f}\t1\t2\n"
        for n, t in zip(numbers, times, strict=True)
    ]
    return head + "".join(rows)


def read(folder: Path, content: str, **options: object) -> Markers:
    path = folder / "a.trc"
    path.write_text(content)
    return read_trc(path, **options)  # type: ignore[arg-type]


def said(markers: Markers) -> list[str]:
    return [each.code for each in markers.notices if each.code != "MKR103"]


def even(frames: Sequence[int], rate: float, decimals: int = 5) -> list[str]:
    return [f"{(f - frames[0]) / rate:.{decimals}f}" for f in frames]


ROWS = list(range(1, 11))
GAP = [1, 2, 3, 9, 10, 11]


@pytest.mark.parametrize(
    ("numbers", "times", "rate", "codes", "found"),
    [
        (ROWS, even(ROWS, 60), 60, [], (10, 60, 1)),
        (ROWS, even(ROWS, 120), 60, ["TRC104"], (10, 120, 1)),
        (ROWS, even(ROWS, 60), 0, ["TRC104"], (10, 60, 1)),
        (range(1, 401), NTSC, 60, ["TRC104"], (400, Fraction(60000, 1001), 1)),
        (range(1, 401), NTSC, 59.94, [], (400, Fraction(60000, 1001), 1)),
        # Times that add up a rounded step.
        (ROWS, [f"{i * 0.00833:.5f}" for i in range(10)], 120, [], (10, 120, 1)),
        (ROWS, even(ROWS, 240, 3), 240, [], (10, 240, 1)),
        (GAP, even(GAP, 60), 60, ["TRC105"], (11, 60, 1)),
        (GAP, even(GAP, 240, 3), 240, ["TRC105"], (11, 240, 1)),
        (
            range(1, 6),
            ["0", ".01", ".02", ".04", ".05"],
            100,
            ["TRC107", "TRC105"],
            (6, 100, 1),
        ),
        (range(1, 7), even(GAP, 60), 60, ["TRC107", "TRC105"], (11, 60, 1)),
        (GAP, even(range(6), 60), 60, ["TRC107"], (6, 60, 1)),
        ([1, 2, 2, 3], even(range(4), 60), 60, ["TRC107"], (4, 60, 1)),
        ([1, 2, 1, 2], even(range(4), 60), 60, ["TRC107"], (4, 60, 1)),
        ([1, 3, 5, 7], even(range(4), 60), 60, ["TRC107"], (4, 60, 1)),
        ([""] * 4, even(range(4), 60), 60, ["TRC107"], (4, 60, 1)),
        ([7, 8, 9], ["0.1", "0.11667", "0.13333"], 60, [], (3, 60, 7)),
        ([7, 8, 9], even(range(3), 60), 60, ["TRC107"], (3, 60, 7)),
        (ROWS, [""] * 10, 60, ["TRC107"], (10, 60, 1)),
        (GAP, [""] * 6, 60, ["TRC107", "TRC105"], (11, 60, 1)),
        ([4], ["0.05"], 60, [], (1, 60, 4)),
    ],
)
def test_time_decides_and_what_disagrees_is_reported(
    tmp_path: Path,
    numbers: Sequence[object],
    times: Sequence[str],
    rate: float,
    codes: list[str],
    found: tuple[int, Fraction, int],
) -> None:
    markers = read(tmp_path, text(numbers, times, rate))
    assert said(markers) == codes
    clock = markers.clock
    assert (len(markers), clock.rate, clock.start) == found
    assert markers.visible.sum() == len(times)
    if times[0]:
        begin = float(times[0])
        at = begin + np.arange(len(markers)) / float(clock.rate)
        off = markers.positions[:, 0, 0] - 100 * at
        assert np.nanmax(np.abs(off)) < 0.11  # the last place of three is 0.05 m


def test_uneven_times_become_even_but_not_over_gaps(tmp_path: Path) -> None:
    steps = [0.0, 0.011, 0.019, 0.03, 0.041, 0.081, 0.09, 0.1]
    times = [f"{t:.5f}" for t in steps]
    numbers = list(range(5, 13))
    markers = read(tmp_path, text(numbers, times, 100))
    assert said(markers) == ["TRC106"]
    assert (len(markers), markers.clock.rate, markers.clock.start) == (11, 100, 5)
    x = markers.positions[:, 0, 0]
    assert x[[0, 1, 2, 3, 4]] == pytest.approx([0, 1, 2, 3, 4], abs=1e-6)
    assert x[[9, 10]] == pytest.approx([9, 10], abs=1e-6)
    assert np.isnan(x[5:9]).all()


@pytest.mark.parametrize(
    ("numbers", "frames", "codes"),
    [
        (ROWS, 10, []),
        (list(range(1, 20, 2)), 10, []),
        ([1, 2, 3, 6, 7, 8, 9, 10, 11, 12], 12, ["TRC105"]),
        ([5] * 10, 10, ["TRC107"]),
    ],
)
def test_a_rate_takes_rows_by_their_numbers(
    tmp_path: Path, numbers: list[int], frames: int, codes: list[str]
) -> None:
    markers = read(tmp_path, text(numbers, ["0"] * 10, 0), fps=50)
    assert said(markers) == codes
    assert (len(markers), markers.clock.rate) == (frames, 50)


@pytest.mark.parametrize(
    ("numbers", "times", "line", "words"),
    [
        ([1, 2, 2, 3], ["0", "0.1", "0.1", "0.2"], 9, "frame 2 in line 9"),
        ([1, 3, 2, 4], ["0", "0.2", "0.1", "0.3"], 9, "0.1 s"),
        ([1, 2, 1, 2], ["0", "0.1", "0", "0.1"], 9, "frame 1 in line 9"),
        ([1, 2, 3], ["0", "", "0.2"], 8, "line 8"),
        ([1, 2, 3], ["0", "0.1", "1e7"], 9, "3 rows"),
        ([1, 2, 3], ["0", "1e-9", "2e-9"], None, "1e-09"),
    ],
)
def test_times_that_do_not_grow_are_refused(
    tmp_path: Path, numbers: list[int], times: list[str], line: int | None, words: str
) -> None:
    with raises(FormatError, "TRC003", match=words) as caught:
        read(tmp_path, text(numbers, times, 10))
    assert caught.value.faults[0].lines == (() if line is None else (line,))


def test_a_first_time_of_few_decimals_is_kept(tmp_path: Path) -> None:
    markers = read(tmp_path, text(range(1, 4), ["0.01", "0.02", "0.03"], 100))
    assert (markers.clock.start, markers.begin) == (1, 0.01)


@pytest.mark.parametrize("first", [("101", "0"), ("1", "5"), ("101", "1.66667")])
def test_the_first_time_is_kept(tmp_path: Path, first: tuple[str, str]) -> None:
    number, begin = int(first[0]), float(first[1])
    times = [f"{begin + i / 60:.5f}" for i in range(4)]
    markers = read(tmp_path, text(range(number, number + 4), times))
    write_trc(markers, tmp_path / "b.trc")
    row = (tmp_path / "b.trc").read_text().splitlines()[6].split("\t")
    assert int(row[0]) == number
    assert float(row[1]) == pytest.approx(begin, abs=1e-5)
    again = read_trc(tmp_path / "b.trc")
    assert again.clock == markers.clock
