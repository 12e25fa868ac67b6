"""Which workers are fit, and when an item of another machine is done."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from support.batch import take_files, whole_outputs
from support.cli import animtool
from support.cluster import small_cluster
from support.farm import other_worker, packages

from animtool.batch.cluster_worker import (
    InputCheck,
    WorkerRequirements,
    builder_versions,
    prepare_worker,
    stop_run,
    version_differences,
)
from animtool.batch.delivery import Delivery
from animtool.batch.discover import find_batch
from animtool.batch.manifest import file_digest
from animtool.batch.spec import BatchSpec, Limits
from animtool.batch.work import ItemBuilder, ItemOutcome
from animtool.batch.worker_process import WorkerTask


@pytest.fixture
def outcome(tmp_path: Path) -> tuple[Delivery, ItemOutcome]:
    """Give what a machine reports of one item, and what this one sees."""
    take_files(tmp_path / "takes", 1)
    batch = find_batch(BatchSpec(("takes/*",), tmp_path, output="out/{stem}.usdc"))
    builder = ItemBuilder(batch.item_task, batch.root)
    return Delivery(batch.root), builder.build(batch.items[0])


def test_done_is_what_is_seen_here(
    outcome: tuple[Delivery, ItemOutcome], tmp_path: Path
) -> None:
    delivery, done = outcome
    path = tmp_path / "out/take000.usdc"
    assert delivery.with_local_outputs(done) == done
    data = path.read_bytes()
    path.write_bytes(data[:-1] + bytes([data[-1] ^ 1]))
    assert delivery.with_local_outputs(done) is None
    path.unlink()
    assert delivery.with_local_outputs(done) is None


def test_an_input_that_is_another_here(
    outcome: tuple[Delivery, ItemOutcome], tmp_path: Path
) -> None:
    delivery, done = outcome
    assert delivery.inputs_that_differ(done) == []
    inputs = tuple(replace(one, sha256="0" * 64) for one in done.inputs)
    path = (tmp_path / "takes/take000.bvh").absolute()
    other = delivery.inputs_that_differ(replace(done, inputs=inputs))
    assert path in [one.resolve() for one in other]
    assert delivery.locally_changed(other) == []
    path.write_text("HIERARCHY\n")
    assert path in [one.resolve() for one in delivery.locally_changed(other)]


def check(folder: Path, **given: Any) -> WorkerRequirements:
    batch = find_batch(BatchSpec((str(folder / "takes"),), folder))
    builder = ItemBuilder(batch.item_task, batch.root)
    task = WorkerTask(builder, Limits(), str(folder))
    return replace(WorkerRequirements(task, (), {}), **given)


def test_what_a_worker_lacks(tmp_path: Path) -> None:
    import pickle

    (path,) = take_files(tmp_path / "takes", 1)
    size, sha256 = path.stat().st_size, file_digest(path)
    token = tmp_path / "token"
    token.write_text("a")
    right = InputCheck(str(path), size, sha256)

    def code(versions: Mapping[str, str] | None = None, **given: Any) -> str:
        worker = SimpleNamespace(plugins={})
        pickled = pickle.dumps(check(tmp_path, **given))
        found = prepare_worker(worker, "run", versions or builder_versions(), pickled)[
            0
        ]
        assert ("run" in worker.plugins) is not bool(found)
        stop_run(worker, "run")
        assert not worker.plugins
        return found

    assert code(inputs=(right,), tokens={str(token): "a"}) == ""
    assert code({**builder_versions(), "numpy": "0"}) == "BAT036"
    assert code(inputs=(replace(right, path=f"{path}x"),)) == "BAT074"
    assert code(inputs=(replace(right, size=size + 1, sha256=""),)) == "BAT074"
    assert code(inputs=(replace(right, sha256="0" * 64),)) == "BAT074"
    assert code(tokens={str(token): "b"}) == "BAT075"
    assert code(tokens={f"{token}x": "a"}) == "BAT075"


def test_versions_that_differ() -> None:
    assert version_differences({"a": "1"}, {"a": "1"}) == ""
    assert version_differences({"a": "1"}, {"b": "2"}) == (
        "a none instead of 1, b 2 instead of none"
    )


@pytest.mark.slow(seconds=6)
@pytest.mark.parametrize(
    ("spoilt", "code"),
    [("outputs", "BAT075"), ("inputs", "BAT074"), ("versions", "BAT036")],
)
def test_a_spoilt_worker_is_left_out(tmp_path: Path, spoilt: str, code: str) -> None:
    """The other one builds everything, as this machine alone does."""
    take_files(tmp_path / "takes", 6)
    words = ("batch", "takes", "--force", "--overwrite", "-o", "out/{stem}.usdc")
    assert animtool(*words, "--executor", "serial", cwd=tmp_path).code == 0
    local = whole_outputs(tmp_path / "out")
    for name in local:
        (tmp_path / "out" / name).unlink()
    hidden = {"outputs": tmp_path / "out", "inputs": tmp_path / "takes"}
    places = {hidden[spoilt]: None} if spoilt in hidden else {}
    environment = packages(tmp_path / "other", numpy="0.1") if not places else {}
    with (
        small_cluster(workers=1) as cluster,
        other_worker(cluster.scheduler_address, tmp_path, places, environment),
    ):
        from distributed import Client

        with Client(cluster, set_as_default=False) as client:
            client.wait_for_workers(2, timeout=60)
        done = animtool(
            *words, "--executor", f"dask={cluster.scheduler_address}", cwd=tmp_path
        )
    assert done.code == 0, done.stderr
    assert done.stderr.count(code) == 1
    assert whole_outputs(tmp_path / "out") == local
    assert not list((tmp_path / "out").rglob(".animtool-*"))
