"""Making an item ends in an outcome, whatever happens."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from support.batch import take_files

from animtool.batch import work
from animtool.batch.discover import find_batch
from animtool.batch.item import ItemTask
from animtool.batch.spec import BatchSpec
from animtool.batch.work import ItemBuilder, ItemOutcome, ItemStatus


def made(folder: Path, count: int = 1) -> list[ItemOutcome]:
    spec = BatchSpec(("takes/*.bvh",), folder, output="out/{stem}.usdc")
    batch = find_batch(spec)
    builder = ItemBuilder(batch.item_task, batch.root)
    assert len(batch.items) == count
    return [builder.build(item) for item in batch.items]


@pytest.mark.parametrize(
    ("error", "code", "retired"),
    [
        (MemoryError(), "BAT022", True),
        (RuntimeError("no"), "BAT023", True),
        (OSError(5, "Input/output error", "a.npz"), "BAT023", False),
    ],
)
def test_what_nothing_was_prepared_for(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    error: Exception,
    code: str,
    retired: bool,
) -> None:
    take_files(tmp_path / "takes", 1)

    def fail(*_: object) -> None:
        raise error

    monkeypatch.setattr(ItemTask, "bake", fail)
    (outcome,) = made(tmp_path)
    assert outcome.status is ItemStatus.FAILED
    assert (outcome.faults[0].code, outcome.is_retired) == (code, retired)
    assert outcome.faults[0].path


def test_a_folder_that_cannot_be_made(tmp_path: Path) -> None:
    take_files(tmp_path / "takes", 1)
    (tmp_path / "out").touch()
    (outcome,) = made(tmp_path)
    assert outcome.faults[0].code == "OUT002"


def test_files_of_all_items_are_read_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for path in take_files(tmp_path / "takes", 2):
        os.utime(path, ns=(10**18, 10**18))
    settings = tmp_path / "animtool.toml"
    settings.write_text("start = 3\n")
    os.utime(settings, ns=(10**18, 10**18))
    read: list[str] = []
    record = work.record_file

    def counted(path: Path, *given: object) -> object:
        if given[1] is not None:
            read.append(path.name)
        return record(path, *given)  # type: ignore[arg-type]

    monkeypatch.setattr(work, "record_file", counted)
    outcomes = made(tmp_path, 2)
    assert read.count("animtool.toml") == 1
    names = [{file.path for file in outcome.inputs} for outcome in outcomes]
    assert all("../animtool.toml" in found for found in names)
