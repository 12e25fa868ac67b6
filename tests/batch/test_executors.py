"""What every executor of the table owes."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from importlib.metadata import EntryPoint
from pathlib import Path

import pytest
from support.batch import take_files
from support.faults import raises
from support.workers import serve_and_end, serve_garbage, serve_nothing

from animtool.batch import pool
from animtool.batch.discover import find_batch
from animtool.batch.executors import (
    EXECUTORS,
    Executor,
    Work,
    find_executor,
    listed_executors,
)
from animtool.batch.item import Item
from animtool.batch.spec import BatchSpec, Limits
from animtool.batch.work import ItemBuilder, ItemStatus
from animtool.core.errors import OptionError, OutputError

OTHER = Executor("another", "animtool.batch.executors:serial")
NUMBER = 1


def work(folder: Path, count: int, **given: object) -> Work:
    take_files(folder / "takes", count)
    spec = BatchSpec(("takes/*.bvh",), folder, output="out/{stem}.usdc")
    batch = find_batch(spec)
    builder = ItemBuilder(batch.item_task, batch.root)
    settings = {"limits": Limits(), "jobs": 2, **given}
    return Work(builder, iter(batch.items), **settings)  # type: ignore[arg-type]


@pytest.fixture(params=sorted(EXECUTORS))
def name(request: pytest.FixtureRequest) -> str:
    """Give the name of each executor of the table."""
    return str(request.param)


@pytest.fixture
def argument(name: str, request: pytest.FixtureRequest) -> str:
    """Give the argument that an executor needs."""
    return str(request.getfixturevalue("cluster")) if name == "dask" else ""


@pytest.mark.slow
def test_every_item_is_made_once(name: str, argument: str, tmp_path: Path) -> None:
    made = work(tmp_path, 5, argument=argument)
    (tmp_path / "takes/take002.bvh").write_text("HIERARCHY\n")
    found = {o.number: o for o in find_executor(name).load()(made)}
    assert sorted(found) == [1, 2, 3, 4, 5]
    failed = [o.number for o in found.values() if o.status is ItemStatus.FAILED]
    assert failed == [3]
    assert found[3].faults[0].code.startswith("BVH")
    for number in (1, 2, 4, 5):
        outcome = found[number]
        assert [Path(f.path).name for f in outcome.outputs] == [
            f"take00{number - 1}.usdc"
        ]
        assert f"../takes/take00{number - 1}.bvh" in {f.path for f in outcome.inputs}
        assert outcome.measurements is not None
        assert outcome.measurements.sample_count == 4
    # The bytes are those that any other makes.
    list(find_executor("serial").load()(work(tmp_path / "other", 5)))
    outputs = sorted((tmp_path / "out").iterdir())
    assert len(outputs) == 4
    for path in outputs:
        assert path.read_bytes() == (tmp_path / "other/out" / path.name).read_bytes()


@pytest.mark.slow
def test_items_are_taken_when_they_are_begun(
    name: str, argument: str, tmp_path: Path
) -> None:
    made, taken = work(tmp_path, 6), []

    def counted(items: Iterator[Item]) -> Iterator[Item]:
        for item in items:
            taken.append(item.number)
            yield item

    counting = Work(made.builder, counted(made.items), made.limits, 2, argument)
    outcomes = find_executor(name).load()(counting)
    next(iter(outcomes))
    assert len(taken) <= 3
    close = getattr(outcomes, "close", None)
    if close is not None:
        close()


def test_no_items_are_no_outcomes(name: str, argument: str, tmp_path: Path) -> None:
    some = work(tmp_path, 1)
    none = Work(some.builder, iter(()), Limits(), 1, argument)
    assert list(find_executor(name).load()(none)) == []


def test_an_argument_that_it_has_no_use_for(name: str, tmp_path: Path) -> None:
    with pytest.raises(OptionError) as error:
        list(find_executor(name).load()(work(tmp_path, 1, argument="8")))
    assert error.value.code == "BAT031"


def test_serial_keeps_no_limits(tmp_path: Path) -> None:
    with pytest.raises(OptionError) as error:
        find_executor("serial").load()(work(tmp_path, 1, limits=Limits(1.0)))
    assert error.value.code == "BAT031"


@pytest.mark.parametrize(
    ("serve", "said"), [(serve_nothing, "does not respond"), (serve_and_end, "with 9")]
)
@pytest.mark.slow
def test_processes_that_do_not_begin_end_the_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, serve: object, said: str
) -> None:
    monkeypatch.setattr(pool, "serve", serve)
    limit = 0.2 if serve is serve_nothing else 60.0
    monkeypatch.setattr(pool, "MAX_START_SECONDS", limit)
    with raises(OutputError, "BAT071", match=said):
        list(find_executor("processes").load()(work(tmp_path, 1, jobs=1)))


@pytest.mark.slow
def test_answers_that_make_no_sense_cost_their_items(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(pool, "serve", serve_garbage)
    monkeypatch.setattr(pool, "JOIN_TIMEOUT", 0.1)
    outcomes = list(find_executor("processes").load()(work(tmp_path, 2, jobs=1)))
    assert [o.number for o in outcomes] == [1, 2]
    assert [o.faults[0].code for o in outcomes] == ["BAT020", "BAT020"]
    assert not list((tmp_path / "out").glob(".animtool-*"))


@pytest.mark.skipif(sys.platform != "linux", reason="/proc")
def test_closing_ends_the_processes(tmp_path: Path) -> None:
    outcomes = find_executor("processes").load()(work(tmp_path, 4))
    next(iter(outcomes))
    frame = outcomes.gi_frame  # type: ignore[attr-defined]
    numbers = [worker.process.pid for worker in frame.f_locals["pool"].workers]
    assert numbers
    outcomes.close()  # type: ignore[attr-defined]
    assert not [n for n in numbers if Path(f"/proc/{n}/cmdline").exists()]


def test_the_environment_is_as_it_was(tmp_path: Path) -> None:
    before = dict(os.environ)
    list(find_executor("processes").load()(work(tmp_path, 1)))
    assert dict(os.environ) == before


@pytest.mark.parametrize(
    ("name", "value", "loads"),
    [("farm", "OTHER", True), ("farm", "NUMBER", False), ("farm", "none", False)],
)
def test_executors_of_plug_ins(
    monkeypatch: pytest.MonkeyPatch, name: str, value: str, loads: bool
) -> None:
    point = EntryPoint(name, f"batch.test_executors:{value}", "animtool.executors")
    monkeypatch.setattr("animtool.core.plugins.may_have_plugins", lambda _: True)
    monkeypatch.setattr("importlib.metadata.entry_points", lambda **_: [point])
    listed = {entry.name: entry.uses for entry in listed_executors()}
    assert listed == {**dict.fromkeys(EXECUTORS, True), name: loads}
    if loads:
        assert find_executor(name) == OTHER
        return
    with pytest.raises(OptionError) as error:
        find_executor(name)
    assert error.value.code == "IO003"


def test_one_that_there_is_none_of() -> None:
    with raises(OptionError, "BAT030"):
        find_executor("proceses")
