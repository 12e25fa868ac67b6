"""Workers of dask: what they owe beyond the suite of all executors."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from threading import current_thread
from typing import Any

import pytest
from support.batch import take_files, trouble_files
from support.cli import animtool
from support.cluster import small_cluster

from animtool.batch import cluster_worker
from animtool.batch.cluster import dask
from animtool.batch.cluster_client import scheduler_address
from animtool.batch.cluster_worker import check_task
from animtool.batch.discover import find_batch
from animtool.batch.executors import Work
from animtool.batch.item import Item
from animtool.batch.spec import BatchSpec, Limits
from animtool.batch.work import ItemBuilder, ItemOutcome, ItemStatus
from animtool.batch.worker_process import WorkerProcess, WorkerTask
from animtool.core.errors import Fault, OptionError, OutputError


def work(folder: Path, argument: str, limits: Limits | None = None) -> Work:
    spec = BatchSpec(("takes/*",), folder, output="out/{stem}.usdc")
    batch = find_batch(spec)
    builder = ItemBuilder(batch.item_task, batch.root)
    items = tuple(batch.items)
    inputs = tuple(item.file.path for item in items)
    folders = (
        batch.records_folder,
        *dict.fromkeys(f for i in items for f in i.folders),
    )
    return Work(
        builder,
        iter(items),
        limits or Limits(),
        2,
        argument,
        inputs=inputs,
        folders=folders,
    )


def built(made: Work) -> list[ItemOutcome]:
    """Return the outcomes, without warnings."""
    return [o for o in dask(made) if isinstance(o, ItemOutcome)]


@pytest.mark.parametrize(
    "text",
    [
        *("", "[]", "{}", "[" * 100_000, '{"address": 7}', '{"address": "a b"}'),
        *('{"address": "/dev/zero"}', '{"address": "tcp://a\\u0000b:1"}'),
    ],
)
def test_what_is_no_file_of_a_scheduler(tmp_path: Path, text: str) -> None:
    path = tmp_path / "scheduler.json"
    path.write_text(text)
    with pytest.raises(OutputError) as error:
        scheduler_address(path)
    assert error.value.code == "BAT035"


@pytest.mark.slow
def test_a_crash_costs_one_item(cluster: str, tmp_path: Path) -> None:
    take_files(tmp_path / "takes", 4)
    trouble_files(tmp_path / "takes", ["crash"])
    failed, *done = sorted(built(work(tmp_path, cluster)), key=lambda o: o.number)
    assert [fault.code for fault in failed.faults] == ["BAT020"]
    assert [outcome.status for outcome in done] == [ItemStatus.DONE] * 4


@pytest.mark.slow
def test_a_hang_costs_one_item(cluster: str, tmp_path: Path) -> None:
    """What hangs takes longer than any limit; what is sound is under none here."""
    hung, sound = tmp_path / "hung", tmp_path / "sound"
    trouble_files(hung / "takes", ["hang", "hang"])
    take_files(sound / "takes", 4)
    outcomes = built(work(hung, cluster, Limits(0.1)))
    assert [o.faults[0].code for o in outcomes] == ["BAT021", "BAT021"]
    done = built(work(sound, cluster))
    assert [outcome.status for outcome in done] == [ItemStatus.DONE] * 4


@pytest.mark.slow
def test_a_worker_that_ends_is_replaced(cluster: str, tmp_path: Path) -> None:
    """What it was at is begun again by another."""
    from distributed import Client

    take_files(tmp_path / "takes", 6)
    flag = tmp_path / "ended"

    # It is within the test because workers need not find the module of the test.
    def ends() -> None:
        if not flag.exists():
            flag.touch()
            os._exit(1)

    outcomes = dask(work(tmp_path, cluster))
    found = [next(outcomes)]
    with Client(cluster, set_as_default=False) as client:
        ended = client.submit(ends, pure=False)
        found += list(outcomes)
        ended.result()
    found = [o for o in found if isinstance(o, ItemOutcome)]
    assert sorted(o.number for o in found) == [1, 2, 3, 4, 5, 6]
    assert {o.status for o in found} == {ItemStatus.DONE}


@pytest.mark.slow
@pytest.mark.parametrize("whole", [False, True], ids=["workers", "scheduler"])
def test_a_cluster_that_is_lost_ends_the_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, whole: bool
) -> None:
    take_files(tmp_path / "takes", 6)
    with small_cluster(workers=1) as lost:
        from distributed import Client

        outcomes = dask(work(tmp_path, lost.scheduler_address))
        next(outcomes)
        monkeypatch.setattr("animtool.batch.cluster.MAX_WORKERLESS_SECONDS", 0.2)
        monkeypatch.setattr("animtool.batch.cluster.ANSWER_TIMEOUT", 0.5)
        monkeypatch.setattr("animtool.batch.cluster_client.ANSWER_TIMEOUT", 0.5)
        if whole:
            lost.close()
        else:
            with Client(lost, set_as_default=False) as client:
                lost.scale(0)
                while client.nthreads():
                    pass
        with pytest.raises(OutputError) as error:
            list(outcomes)
    assert error.value.code == "BAT035"
    assert "finished items are recorded; run the same command again to resume" in str(
        error.value.faults[0].hint
    )


@pytest.mark.slow
def test_no_result_is_waited_for_in_the_thread_of_all_callbacks(
    cluster: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One that is lost would hold up every later run of the process."""
    from distributed import Future

    threads: list[str] = []
    result = Future.result

    def noted(future: Any, *arguments: Any, **named: Any) -> Any:
        threads.append(current_thread().name)
        return result(future, *arguments, **named)

    monkeypatch.setattr(Future, "result", noted)
    take_files(tmp_path / "takes", 3)
    found = [
        one for one in dask(work(tmp_path, cluster)) if isinstance(one, ItemOutcome)
    ]
    assert [one.status for one in found] == [ItemStatus.DONE] * 3
    assert len(threads) > 3
    assert not [name for name in threads if name.startswith("Dask-Callback")]


def test_a_worker_without_animtool_can_be_told_of_items() -> None:
    """It would drop out of its cluster by a message that it cannot read."""
    pickle = pytest.importorskip("cloudpickle")
    read = "import pickle, sys; sys.modules['animtool'] = None; "
    read += "print(pickle.load(sys.stdin.buffer).__name__)"
    sent = pickle.dumps(check_task("name", {"animtool": "1"}))
    command = [sys.executable, "-c", read]
    done = subprocess.run(command, input=sent, capture_output=True, check=True)
    assert done.stdout.strip() == b"check_worker"


@pytest.mark.slow
def test_other_versions_are_named(
    cluster: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    take_files(tmp_path / "takes", 1)
    versions = {**cluster_worker.builder_versions(), "numpy": "0.1"}
    monkeypatch.setattr("animtool.batch.cluster.builder_versions", lambda: versions)
    outcomes = dask(work(tmp_path, cluster))
    found = [next(outcomes), next(outcomes)]
    assert [fault.code for fault in found] == ["BAT036", "BAT036"]  # type: ignore[union-attr]
    with pytest.raises(OutputError) as error:
        next(outcomes)
    assert error.value.code == "BAT035"
    assert all("instead of 0.1" in fault.message for fault in found)  # type: ignore[union-attr]
    assert not (tmp_path / "out/take000.usdc").exists()


@pytest.mark.slow
def test_the_command_line(cluster: str, tmp_path: Path) -> None:
    take_files(tmp_path / "takes", 3)
    words = ("--executor", f"dask={cluster}", "-o", "out/{stem}.usdc")
    done = animtool("batch", "takes", *words, cwd=tmp_path)
    assert done.code == 0, done.stderr
    assert "3 items: 3 done" in done.stderr
    assert "up to date" in animtool("batch", "takes", *words, cwd=tmp_path).stderr


@pytest.mark.slow
def test_no_cluster_there(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("distributed", reason="distributed is not installed (farm)")
    take_files(tmp_path / "takes", 1)
    monkeypatch.setattr("animtool.batch.cluster.ANSWER_TIMEOUT", 0.2)
    monkeypatch.setattr("animtool.batch.cluster_client.ANSWER_TIMEOUT", 0.2)
    for argument in ("tcp://127.0.0.1:1", str(tmp_path / "none.json")):
        with pytest.raises(OutputError) as error:
            list(dask(work(tmp_path, argument)))
        assert error.value.code == "BAT035"


def test_without_the_library(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    take_files(tmp_path / "takes", 1)
    monkeypatch.setattr("importlib.util.find_spec", lambda _: None)
    with pytest.raises(OptionError) as error:
        dask(work(tmp_path, "tcp://127.0.0.1:1"))
    assert error.value.code == "IO005"


@pytest.mark.slow
def test_a_worker_makes_items_one_after_another(tmp_path: Path) -> None:
    take_files(tmp_path / "takes", 2)
    given = work(tmp_path, "")
    items = list(given.items)
    process = WorkerProcess(WorkerTask(given.builder, Limits(), str(tmp_path)))
    try:
        made = [process.build_item(item) for item in items]
    finally:
        process.end()
    assert [outcome.status for outcome in made] == [ItemStatus.DONE, ItemStatus.DONE]
    lost = WorkerProcess(replace(process.task, folder=str(tmp_path / "none")))
    with pytest.raises(OSError, match="none"):
        lost.build_item(items[0])


def test_a_worker_that_ends_is_an_error(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    take_files(tmp_path / "takes", 1)
    given = work(tmp_path, "")
    monkeypatch.setattr(sys, "executable", "/bin/false")
    process = WorkerProcess(WorkerTask(given.builder, Limits(), str(tmp_path)))
    with pytest.raises((ConnectionError, BrokenPipeError)):
        process.build_item(next(given.items))
    process.end()


@pytest.mark.slow
def test_something_else_answers(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("distributed", reason="distributed is not installed (farm)")
    take_files(tmp_path / "takes", 1)
    monkeypatch.setattr("animtool.batch.cluster.ANSWER_TIMEOUT", 0.5)
    monkeypatch.setattr("animtool.batch.cluster_client.ANSWER_TIMEOUT", 0.5)
    with socket.create_server(("127.0.0.1", 0)) as mute:
        argument = f"tcp://127.0.0.1:{mute.getsockname()[1]}"
        with pytest.raises(OutputError) as error:
            list(dask(work(tmp_path, argument)))
    assert error.value.code == "BAT035"


@pytest.mark.slow
def test_a_cluster_without_workers_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    take_files(tmp_path / "takes", 1)
    monkeypatch.setattr("animtool.batch.cluster.MAX_WORKERLESS_SECONDS", 1.0)
    monkeypatch.setattr("animtool.batch.cluster.POLL_INTERVAL", 0.1)
    with small_cluster(workers=0) as empty:
        outcomes = dask(work(tmp_path, empty.scheduler_address))
        notice = next(outcomes)
        assert isinstance(notice, Fault)
        assert notice.code == "BAT076"
        with pytest.raises(OutputError) as error:
            list(outcomes)
    assert error.value.code == "BAT035"


@pytest.mark.slow
def test_a_run_that_stops_at_failures_sends_nothing_ahead(
    cluster: str, tmp_path: Path
) -> None:
    take_files(tmp_path / "takes", 8)
    given, taken = work(tmp_path, cluster), []

    def counted(items: Iterator[Item]) -> Iterator[Item]:
        for item in items:
            taken.append(item.number)
            yield item

    careful = replace(
        given, items=counted(given.items), requested_jobs=2, queue_next=False
    )
    for ended, _ in enumerate(dask(careful), 1):
        assert len(taken) <= ended + 1
