"""What another machine built, against what is seen here."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from animtool.batch.delivery import Delivery
from animtool.batch.manifest import FileRecord, file_digest
from animtool.batch.work import ItemOutcome, ItemStatus
from animtool.core.files.reading import FileState


def record(path: Path) -> FileRecord:
    """Return a file as another machine saw it: the same content, another state."""
    state = FileState.of(path)
    assert state is not None
    return FileRecord(
        str(path), replace(state, inode=7, changed_at=7), file_digest(path)
    )


def test_an_input_that_another_machine_has_otherwise(tmp_path: Path) -> None:
    path, gone = tmp_path / "a.bvh", tmp_path / "none.bvh"
    path.write_text("here")
    delivery = Delivery(tmp_path)
    absent = FileRecord(str(gone), None)
    same = ItemOutcome(1, ItemStatus.DONE, 0.0, inputs=(record(path), absent))
    assert delivery.inputs_that_differ(same) == []
    stale = replace(record(path), sha256="0" * 64)
    built = ItemOutcome(
        1, ItemStatus.DONE, 0.0, inputs=(stale, replace(stale, path=str(gone)))
    )
    assert delivery.inputs_that_differ(built) == [path, gone]
    # It is the other machine's that differ: here, nothing changed.
    assert delivery.locally_changed([path, gone]) == []


def test_an_input_that_changes_here_meanwhile(tmp_path: Path) -> None:
    path = tmp_path / "a.bvh"
    path.write_text("before")
    delivery = Delivery(tmp_path)
    delivery.first_state(path)
    built = ItemOutcome(1, ItemStatus.DONE, 0.0, inputs=(record(path),))
    path.write_text("after, and longer")
    other = delivery.inputs_that_differ(built)
    assert other == [path]
    assert delivery.locally_changed(other) == [path]


def test_an_output_is_seen_with_the_content_that_was_written(tmp_path: Path) -> None:
    path = tmp_path / "a.usdc"
    path.write_text("whole")
    built = ItemOutcome(1, ItemStatus.DONE, 0.0, outputs=(record(path),))
    path.unlink()
    delivery = Delivery(tmp_path)
    assert delivery.with_local_outputs(built) is None
    path.write_text("half")
    assert delivery.with_local_outputs(built) is None
    path.write_text("whole")
    seen = delivery.with_local_outputs(built)
    assert seen is not None
    state = FileState.of(path)
    assert state is not None
    assert (seen.outputs[0].state, seen.written_at) == (state, state.changed_at)
