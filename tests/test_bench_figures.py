"""Figures of the benchmarks: what gives a ratio, and what is quoted under load."""

from __future__ import annotations

import csv
import importlib.util
import math
import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import pytest

FAST = (0.1, 0.2)


@pytest.fixture(scope="module")
def figures(root: Path) -> Iterator[ModuleType]:
    pytest.importorskip("resource", reason="benchmarks time children as Unix has it")
    folder = root / "tests/bench"
    spec = importlib.util.spec_from_file_location("figures", folder / "figures.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(folder))
        patch.setitem(sys.modules, "figures", module)
        spec.loader.exec_module(module)
        yield module
    sys.modules.pop("clock", None)


def ratios(figures: ModuleType, error: float) -> list[object]:
    slow = [figures.Taken(0.4, 0.3), figures.Taken(0.9, 0.6), figures.Taken(0.9, 0.9)]
    own = [figures.Taken(*FAST)] * 2
    near = figures.Accuracy("error [mm]", error, figures.Bound(False, 10.0))
    bound = figures.Bound(True, 2.0)
    made: list[object] = figures.ratio_rows(
        "section", "peer", slow, own, wanted=bound, accuracy=[near]
    )
    return made


def test_runs_are_compared_pair_by_pair(figures: ModuleType) -> None:
    wall, cpu = ratios(figures, 10.0)
    assert wall.values == pytest.approx([4.0, 9.0])
    assert cpu.values == pytest.approx([1.5, 3.0])
    assert cpu.median == pytest.approx(2.25)
    assert (wall.measure, cpu.measure) == ("wall / animtool [x]", "CPU / animtool [x]")


@pytest.mark.parametrize("error", [10.1, math.nan, math.inf])
def test_a_peer_that_is_far_off_or_diverged_gives_no_ratio(
    figures: ModuleType, error: float
) -> None:
    for row in ratios(figures, error):
        assert row.values == []
        assert row.met(loaded=False) == "no ratio"
        assert "error [mm]" in row.note


def test_wall_time_under_load_gets_no_verdict(figures: ModuleType) -> None:
    wall, cpu = ratios(figures, 0.0)
    assert (wall.met(loaded=False), cpu.met(loaded=False)) == ("yes", "yes")
    assert (wall.met(loaded=True), cpu.met(loaded=True)) == ("under load", "yes")


def test_under_load_ratios_of_cpu_time_alone_are_quoted(figures: ModuleType) -> None:
    rows = [*figures.time_rows("s", "t", [figures.Taken(*FAST)]), *ratios(figures, 0)]
    assert figures.quotable(rows, loaded=False) == rows
    named = [row.measure for row in figures.quotable(rows, loaded=True)]
    assert named == ["wall [s]", "CPU [s]", "CPU / animtool [x]"]


def test_times_are_scaled_to_their_unit(figures: ModuleType) -> None:
    taken = [figures.Taken(*FAST)]
    wall, cpu = figures.time_rows("s", "t", taken, unit="ms/frame", per=4)
    assert (wall.median, cpu.median) == pytest.approx((25.0, 50.0))


def test_the_csv_marks_load_and_missing_ratios(
    figures: ModuleType, tmp_path: Path
) -> None:
    path = tmp_path / "made.csv"
    rows = [*ratios(figures, 0.0), *ratios(figures, math.inf)]
    figures.write_csv(path, ["date: today"], rows, loaded=True)
    head, *lines = path.read_text("utf-8").splitlines()
    assert head == "# date: today"
    found = list(csv.DictReader(lines))
    assert {row["load"] for row in found} == {"under load"}
    assert [row["met"] for row in found] == ["under load", "yes", *["no ratio"] * 2]
    assert found[1]["median"] == "2.25"
    assert found[3]["median"] == ""
    assert found[3]["note"].startswith("diverged")
