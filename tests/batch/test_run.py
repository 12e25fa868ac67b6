"""Runs of a batch: what is begun, what is left, what may be replaced."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import cast

import pytest
from support.batch import take_files, whole_outputs

import animtool
from animtool.batch.executors import EXECUTORS, Executor, Work
from animtool.batch.item import Item
from animtool.batch.report import BatchReport, ItemReport
from animtool.batch.run import RunListener, RunOptions, run_batch
from animtool.batch.spec import BatchSpec
from animtool.batch.work import ItemOutcome, ItemStatus
from animtool.core.errors import ExitCode, OptionError
from animtool.core.units import UpAxis
from animtool.core.values import plain_value
from animtool.scene.bake.options import BakeOptions

SERIAL = RunOptions(executor="serial")


@pytest.fixture
def spec(tmp_path: Path) -> BatchSpec:
    """Return a batch of five takes of which two are malformed."""
    takes = take_files(tmp_path / "takes", 5)
    for path in (takes[1], takes[3]):
        path.write_text("HIERARCHY\n")
    return BatchSpec(("takes/*.bvh",), tmp_path, output="out/{stem}.usdc")


def statuses(report: BatchReport) -> list[str]:
    return [str(entry.status) for entry in report.items]


def test_failures_cost_nothing_else(spec: BatchSpec) -> None:
    report = run_batch(spec, SERIAL)
    assert statuses(report) == ["done", "failed", "done", "failed", "done"]
    assert report.exit_code is ExitCode.FINDINGS
    assert [entry.item.number for entry in report.failed] == [2, 4]
    assert report.failed[0].failure_text.startswith("BVH")


@pytest.mark.parametrize(
    ("most", "found"),
    [
        (1, ["done", "failed", "not run", "not run", "not run"]),
        (2, ["done", "failed", "done", "failed", "not run"]),
    ],
)
def test_so_many_failures_end_it(spec: BatchSpec, most: int, found: list[str]) -> None:
    assert statuses(run_batch(spec, replace(SERIAL, max_failures=most))) == found


def test_only_what_failed(spec: BatchSpec, tmp_path: Path) -> None:
    take_files(tmp_path / "takes", 4)
    (tmp_path / "takes/take001.bvh").write_text("HIERARCHY\n")
    first = run_batch(spec, replace(SERIAL, numbers=(1, 3)))
    assert statuses(first) == ["done", "failed", "done"]
    planned = run_batch(spec, replace(SERIAL, retry_failed=True, dry_run=True))
    assert [entry.item.number for entry in planned.items] == [2]
    retried = run_batch(spec, replace(SERIAL, retry_failed=True))
    assert [(e.item.number, str(e.reason)) for e in retried.items] == [
        (2, "failed last time")
    ]
    take_files(tmp_path / "takes", 5)
    assert statuses(run_batch(spec, replace(SERIAL, retry_failed=True))) == ["done"]
    assert run_batch(spec, replace(SERIAL, retry_failed=True)).items == ()
    assert statuses(run_batch(spec, SERIAL)) == ["skipped"] * 3 + ["done"] * 2


def test_parts_make_the_whole(spec: BatchSpec, tmp_path: Path) -> None:
    take_files(tmp_path / "takes", 5)
    for numbers in ((1, 2), (3, 5)):
        report = run_batch(spec, replace(SERIAL, numbers=numbers))
        assert statuses(report) == ["done"] * (numbers[1] - numbers[0] + 1)
    parts = whole_outputs(tmp_path / "out")
    assert statuses(run_batch(spec, SERIAL)) == ["skipped"] * 5
    forced = run_batch(spec, replace(SERIAL, force=True))
    assert statuses(forced) == ["done"] * 5
    assert whole_outputs(tmp_path / "out") == parts


@pytest.mark.parametrize("numbers", [(0, 1), (3, 2), (5, 6)])
def test_items_that_are_not_there(spec: BatchSpec, numbers: tuple[int, int]) -> None:
    with pytest.raises(OptionError) as error:
        run_batch(spec, replace(SERIAL, numbers=numbers))
    assert error.value.code == "BAT033"


def test_files_of_others_are_not_replaced(spec: BatchSpec, tmp_path: Path) -> None:
    (tmp_path / "out").mkdir()
    (tmp_path / "out/take002.usdc").write_text("mine")
    with pytest.raises(OptionError) as error:
        run_batch(spec, SERIAL)
    assert [fault.code for fault in error.value.faults] == ["OUT001"]
    assert not (tmp_path / "out/take000.usdc").exists()
    report = run_batch(spec, replace(SERIAL, overwrite=True))
    assert statuses(report)[2] == "done"


def test_an_output_that_a_killed_run_left_is_replaced(
    spec: BatchSpec, tmp_path: Path
) -> None:
    class Killed(RunListener):
        def on_end(self, report: ItemReport) -> None:
            raise KeyboardInterrupt(report.status)

    with pytest.raises(KeyboardInterrupt):
        run_batch(spec, SERIAL, Killed())
    records = tmp_path / "out/.animtool/batch-batch.jsonl"
    lines = records.read_bytes().splitlines(keepends=True)
    # Killed between the output and its record.
    records.write_bytes(b"".join(line for line in lines if b'"item"' not in line))
    report = run_batch(spec, SERIAL)
    assert statuses(report)[0] == "done"
    assert report.items[0].reason == "new"


def test_a_file_that_came_since_the_plan_is_not_replaced(
    spec: BatchSpec, tmp_path: Path
) -> None:
    class Other(RunListener):
        def on_plan(self, due: int, total: int) -> None:
            del due, total
            (tmp_path / "out").mkdir(exist_ok=True)
            (tmp_path / "out/take002.usdc").write_text("of another batch")

    report = run_batch(spec, SERIAL, Other())
    assert report.items[2].faults[0].code == "OUT001"
    assert (tmp_path / "out/take002.usdc").read_text() == "of another batch"
    assert statuses(report) == ["done", "failed", "failed", "failed", "done"]


def careless(work: Work) -> Iterator[ItemOutcome]:
    """Say nothing of the first item, and all else twice."""
    outcomes = [work.builder.build(item) for item in work.items]
    yield from outcomes[1:]
    yield from outcomes[1:]
    yield ItemOutcome(99, ItemStatus.DONE, 0.0)
    yield cast("ItemOutcome", "done")


def test_an_executor_that_is_careless(
    spec: BatchSpec, monkeypatch: pytest.MonkeyPatch
) -> None:
    executor = Executor("careless", "batch.test_run:careless")
    monkeypatch.setitem(EXECUTORS, "careless", executor)
    ended = []

    class Told(RunListener):
        def on_end(self, report: ItemReport) -> None:
            ended.append(report.item.number)

    report = run_batch(spec, RunOptions(executor="careless"), Told())
    assert sorted(ended) == [1, 2, 3, 4, 5]
    assert report.items[0].faults[0].code == "BAT020"
    assert statuses(run_batch(spec, SERIAL))[2:] == ["skipped", "failed", "skipped"]


@pytest.mark.parametrize(
    ("stated", "given", "jobs"),
    [(3, 2, (2, 2)), (3, None, (3, 3)), (None, 4, (4, 4)), (9, None, (5, 9))],
)
def test_how_many_are_made_at_a_time(
    spec: BatchSpec,
    monkeypatch: pytest.MonkeyPatch,
    stated: int | None,
    given: int | None,
    jobs: tuple[int, int],
) -> None:
    """What a run is told comes before what the batch says; no more than there are."""
    found = []

    def asking(work: Work) -> Iterator[ItemOutcome]:
        found.append((work.jobs, work.requested_jobs))
        return iter(())

    monkeypatch.setattr(Executor, "load", lambda _: asking)
    run_batch(replace(spec, jobs=stated), RunOptions(jobs=given))
    assert found == [jobs]


def test_damaged_records_are_told(spec: BatchSpec, tmp_path: Path) -> None:
    run_batch(spec, replace(SERIAL, max_failures=1))
    path = tmp_path / "out/.animtool/batch-batch.jsonl"
    lines = path.read_bytes().splitlines(keepends=True)
    path.write_bytes(b"".join([*lines[:-1], b"[" * 100_000, b"\n"]))
    for options in (replace(SERIAL, dry_run=True), SERIAL):
        report = run_batch(spec, options)
        assert [notice.code for notice in report.notices] == ["BAT070"]
        assert report.items[0].reason == "new"
    assert run_batch(spec, SERIAL).notices == ()


def test_whoever_listens_is_told(spec: BatchSpec) -> None:
    told: list[object] = []

    class Listening(RunListener):
        def on_plan(self, due: int, total: int) -> None:
            told.append((due, total))

        def on_start(self, item: Item) -> None:
            told.append(item.number)

        def on_end(self, report: ItemReport) -> None:
            told.append(str(report.status))

    run_batch(spec, replace(SERIAL, numbers=(1, 2)), Listening())
    assert told == [(2, 2), 1, "done", 2, "failed"]


def test_mixed_inputs_take_the_options_that_fit(workplace: Path) -> None:
    source = animtool.SourceOptions(up=UpAxis.Y, clamp=True)
    inputs = ("samples/walk/walk.bvh", "samples/bounce/bounce.clip.yaml")
    spec = BatchSpec(
        inputs, workplace, options=BakeOptions(source=source), output="out/{stem}.usdc"
    )
    report = run_batch(spec, SERIAL)
    assert statuses(report) == ["done", "done"], report.items


def test_a_rig_layer_that_changes_is_read_again(workplace: Path) -> None:
    layer = workplace / "walker.usda"
    animtool.bake(workplace / "samples/walk/walk.bvh", layer, BakeOptions(form="split"))
    options = BakeOptions(rig_layer=layer)
    spec = BatchSpec(
        ("samples/walk/walk.bvh",), workplace, options=options, output="out/{stem}.usda"
    )
    assert statuses(run_batch(spec, SERIAL)) == ["done"]
    rig = workplace / "walker.rig.usda"
    rig.write_text(rig.read_text().replace("startTimeCode = 1", "startTimeCode = 7"))
    report = run_batch(spec, SERIAL)
    assert [str(entry.reason) for entry in report.items] == ["input changed"]
    assert report.items[0].detail == "../walker.rig.usda"


@pytest.fixture
def several(tmp_path: Path) -> BatchSpec:
    """Return a batch of two takes whose scene names four files for each."""
    take_files(tmp_path / "takes", 2)
    (tmp_path / "t.scene.yaml").write_text(
        "scene: animtool/1\nsource:\n  file: ${input}\noutput:\n"
        "- file: out/${stem}.usda\n- file: out/${stem}.bvh\n"
        "- file: keys/${stem}.clip.yaml\n"
    )
    return BatchSpec(("takes",), tmp_path, scene=tmp_path / "t.scene.yaml")


def test_scenes_of_several_outputs(several: BatchSpec, tmp_path: Path) -> None:
    report = run_batch(several, SERIAL)
    assert statuses(report) == ["done", "done"]
    made = {
        **whole_outputs(tmp_path / "out"),
        **whole_outputs(tmp_path / "keys"),
    }
    suffixes = (".usda", ".bvh", ".rig.yaml", ".clip.yaml")
    assert set(made) == {f"take00{i}{suffix}" for i in (0, 1) for suffix in suffixes}
    plain = plain_value(report.items[0])
    assert [Path(name).suffix for name in plain["outputs"]] == [  # type: ignore[attr-defined]
        ".usda",
        ".bvh",
        ".yaml",
        ".yaml",
    ]
    assert report.items[0].measurements is not None
    assert statuses(run_batch(several, SERIAL)) == ["skipped"] * 2


@pytest.mark.parametrize("name", ["out/take001.bvh", "keys/take001.rig.yaml"])
def test_each_of_several_outputs_is_looked_at(
    several: BatchSpec, tmp_path: Path, name: str
) -> None:
    run_batch(several, SERIAL)
    kept = (tmp_path / name).read_bytes()
    (tmp_path / name).unlink()
    again = run_batch(several, SERIAL)
    assert statuses(again) == ["skipped", "done"]
    assert (str(again.items[1].reason), again.items[1].detail) == (
        "output changed",
        name,
    )
    assert (tmp_path / name).read_bytes() == kept


def test_none_of_several_outputs_that_are_not_the_batchs_is_replaced(
    several: BatchSpec, tmp_path: Path
) -> None:
    (tmp_path / "out").mkdir()
    (tmp_path / "out/take001.bvh").write_text("mine")
    with pytest.raises(OptionError) as error:
        run_batch(several, SERIAL)
    assert error.value.code == "OUT001"
