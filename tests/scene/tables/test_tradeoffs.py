"""What inputs can trade, and whether what is recommended keeps its word."""

from __future__ import annotations

from fractions import Fraction
from itertools import pairwise
from pathlib import Path

import pytest
from support.beasts import write_beast

from animtool.core.errors import OptionError, Severity
from animtool.core.shot import FrameRange
from animtool.scene.bake.options import BakeOptions
from animtool.scene.file.read import load_scene
from animtool.scene.tables.take import KEYS, RATE
from animtool.scene.tables.tradeoffs import (
    SUITE_FILES,
    SUITE_FOLDER,
    measure_tradeoffs,
    suite_tradeoffs,
)
from animtool.sim.trials.table import TrialTable
from animtool.sim.trials.trial import CostMeasure, ErrorMeasure

SWING = """scene: animtool/1
source: {file: swing.clip.yaml}
passes:
- simulate: {what: [tail], settle: 0.1}
output: {file: out.usdc}
"""


@pytest.fixture(autouse=True)
def _once(monkeypatch: pytest.MonkeyPatch) -> None:
    # How long anything takes is of no interest here.
    monkeypatch.setattr("animtool.sim.trials.measuring.MAX_REPEATS", 1)


def budget_is_kept(table: TrialTable, budget: float) -> None:
    row = table.recommended
    assert row is not None
    error = table.error_of(row)
    assert error is not None
    assert error <= budget


def test_a_clip_is_traded_by_bytes_and_by_keys() -> None:
    samples, keys = measure_tradeoffs(
        SUITE_FOLDER / "arm.clip.yaml", budget=2e-3
    ).tables
    assert (samples.cost, keys.cost) == (CostMeasure.BYTES, CostMeasure.STEPS)
    assert {samples.error, keys.error} == {ErrorMeasure.LARGEST}
    rates = [row for row in samples.rows if row.setting.method == RATE]
    assert [row.setting["fps"] for row in rates] == [6, 12, 24, 48, 96]
    errors = [row.error.largest for row in rates if row.error]
    # Between samples motion is of second order.
    assert errors[2] / errors[3] == pytest.approx(4, rel=0.05)
    assert errors[3] / errors[4] == pytest.approx(4, rel=0.05)
    assert samples.lines == ("animtool bake arm.clip.yaml \ufdd0fps\ufdd2 48",)
    budget_is_kept(samples, 2e-3)
    budget_is_kept(keys, 2e-3)
    assert {row.setting.method for row in keys.rows} == {KEYS}


@pytest.mark.slow
def test_what_is_recommended_keeps_its_budget_when_it_is_baked_again() -> None:
    path = SUITE_FOLDER / "arm.clip.yaml"
    (samples, _) = measure_tradeoffs(path, budget=2e-3).tables
    assert samples.recommended is not None
    again = BakeOptions(fps=samples.recommended.setting["fps"])
    (samples, _) = measure_tradeoffs(path, again).tables
    assert samples.chosen.error is not None
    assert samples.chosen.error.largest <= 2e-3


def test_the_front_is_what_nothing_beats() -> None:
    for table in measure_tradeoffs(SUITE_FOLDER / "arm.clip.yaml").tables:
        costs = [
            (getattr(row, table.cost), row.error.largest, row.is_pareto_optimal)
            for row in table.rows
            if row.error is not None
        ]
        floor = max(1e-13 * table.extent, 0.0)
        for cost, error, best in costs:
            beaten = any(
                other <= cost and max(off, floor) <= max(error, floor)
                and (other < cost or max(off, floor) < max(error, floor))
                for other, off, _ in costs
            )  # fmt: skip
            assert not (best and beaten)


@pytest.mark.slow
def test_a_scene_is_traded_in_the_order_of_a_bake(tmp_path: Path) -> None:
    path = write_beast(tmp_path, SWING, bones=2, last=7, way=20)
    folder = tmp_path / "looks"
    folder.mkdir()
    report = measure_tradeoffs(load_scene(path), folder=folder)
    kinds = [table.kind for table in report.tables]
    assert kinds == ["spring_chain", "samples in USD", "keys of a clip"]
    assert [pair.table_index for pair in report.stage_pairs] == [0, 1]
    for pair in report.stage_pairs:
        assert pair.settings[0] == report.tables[pair.table_index].chosen.setting
        assert all(file.stat().st_size for file in pair.files)


def test_nothing_keeps_less_than_the_least() -> None:
    report = measure_tradeoffs(SUITE_FOLDER / "arm.clip.yaml", budget=1e-12)
    codes = [(notice.code, notice.severity) for notice in report.notices]
    # Keys of straight curves are exact to rounding.
    assert ("SIM176", Severity.WARNING) in codes


@pytest.mark.slow
def test_the_suite_has_all_that_can_be_traded() -> None:
    report = suite_tradeoffs(budget=1e-3)
    kinds = [table.kind.partition(",")[0] for table in report.tables]
    assert kinds == [
        "particles", "rope", "ik",
        "samples in USD", "keys of a clip", "samples in USD", "keys of a clip",
    ]  # fmt: skip
    assert {table.name for table in report.tables} >= {*SUITE_FILES} - {
        "orbits.scene.yaml",
        "rope.scene.yaml",
    }
    for table in report.tables:
        budget_is_kept(table, 1e-3)
        assert table.reference is not None
        assert not table.reference.sensitive


def test_samples_of_a_high_rate_are_compared_between_them() -> None:
    clip = SUITE_FOLDER / "arm.clip.yaml"
    (samples, _) = measure_tradeoffs(clip, BakeOptions(fps=Fraction(96))).tables
    rates = [row for row in samples.rows if row.setting.method == RATE]
    assert [row.setting["fps"] for row in rates] == [24, 48, 96, 192, 384]
    errors = [row.error.largest for row in rates if row.error]
    for coarse, fine in pairwise(errors):
        assert coarse / fine == pytest.approx(4, rel=0.1)


@pytest.mark.slow
@pytest.mark.parametrize(("fps", "first", "last"), [(None, 5, 13), (48, 9, 25)])
def test_a_range_is_of_the_frames_of_the_output(
    fps: int | None, first: int, last: int
) -> None:
    """Frames 5 to 13 at 24 fps are 9 to 25 at 48: a third of a second either way."""
    clip = SUITE_FOLDER / "arm.clip.yaml"
    rate = None if fps is None else Fraction(fps)
    options = BakeOptions(fps=rate, frame_range=FrameRange(first, last))
    samples, keys = measure_tradeoffs(clip, options).tables
    assert samples.span == keys.span == pytest.approx(1 / 3)
    assert samples.chosen.steps == last - first + 1
    (whole, _) = measure_tradeoffs(clip, BakeOptions(fps=rate)).tables
    assert samples.chosen.error is not None
    assert whole.chosen.error is not None
    assert samples.chosen.error.largest <= whole.chosen.error.largest
    assert not samples.notices


def test_a_range_beyond_the_take_is_cut_and_said_so() -> None:
    clip = SUITE_FOLDER / "arm.clip.yaml"
    options = BakeOptions(frame_range=FrameRange(20, 90))
    report = measure_tradeoffs(clip, options)
    assert report.tables[0].chosen.steps == 6
    assert [(one.code, one.path) for one in report.notices] == [("SCN013", str(clip))]
    with pytest.raises(OptionError, match="CLI005"):
        measure_tradeoffs(clip, BakeOptions(frame_range=FrameRange(70, 90)))


def test_every_second_frame_is_half_the_rate() -> None:
    clip = SUITE_FOLDER / "arm.clip.yaml"
    samples, keys = measure_tradeoffs(
        clip, BakeOptions(frame_range=FrameRange(1, 25, 2))
    ).tables
    (every, every_key) = measure_tradeoffs(
        clip, BakeOptions(frame_range=FrameRange(1, 25))
    ).tables
    assert samples.chosen.setting["fps"] == every.chosen.setting["fps"] / 2
    assert samples.chosen.steps == (every.chosen.steps + 1) // 2
    assert samples.chosen.bytes < every.chosen.bytes
    assert keys.span == every_key.span
