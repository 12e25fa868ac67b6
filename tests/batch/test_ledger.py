"""The records of a batch: one run at a time holds them, and parts come together."""

from __future__ import annotations

import json
import os
import platform
import subprocess
import sys
from pathlib import Path

import pytest

from animtool.batch import ledger
from animtool.batch.ledger import locked_ledger, read_history
from animtool.core.errors import LockedError, OutputError
from batch.test_manifest import item


@pytest.fixture(autouse=True)
def impatient(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ledger, "LOCK_TIMEOUT", 0.0)


@pytest.mark.parametrize(
    ("held", "wanted", "refused"),
    [
        ("", "", True),
        ("", "1-2", True),
        ("1-2", "", True),
        ("1-2", "1-2", True),
        ("1-2", "3-4", False),
        # Both would make item 2.
        ("1-2", "2-4", True),
        ("1-9", "3-4", True),
    ],
)
def test_who_may_run_props_whom(
    tmp_path: Path, held: str, wanted: str, refused: bool
) -> None:
    with locked_ledger(tmp_path, "a", held):
        error = refusal(tmp_path, "a", wanted)
        assert (error is not None) is refused
        if error is not None:
            assert isinstance(error, LockedError)
            assert error.code == "BAT010"
            assert str(os.getpid()) in str(error)
    assert refusal(tmp_path, "a", wanted) is None


def refusal(folder: Path, name: str, part: str = "") -> OutputError | None:
    """Return why a run may not begin; None where it does, and writes records."""
    try:
        with locked_ledger(folder, name, part) as ledger:
            ledger.add_names([f"{part}.usdc"])
    except OutputError as error:
        return error
    assert f"{part}.usdc" in read_history(folder, name).manifest.known_names
    return None


OWNERS = [
    b"",
    b"\0" * 20,
    b"[" * 100_000,
    b"[1]",
    b'{"process": 1',
    b'{"process": "1", "host": "a"}',
    b'{"process": true, "host": "a"}',
    b'{"process": -1, "host": "a"}',
    b'{"process": 1e999, "host": "a"}',
    b'{"process": 12, "host": ["a"]}',
    b'{"process": 12, "host": "' + b"a" * 10_000 + b'"}',
    b'{"process": 12, "process": 13, "host": "a"}',
    b'{"process": 12, "host": "\xff"}',
]


@pytest.mark.parametrize("data", OWNERS)
def test_an_owner_that_cannot_be_read_is_not_named(tmp_path: Path, data: bytes) -> None:
    owner = tmp_path / "batch-a.owner"
    with locked_ledger(tmp_path, "a"):
        owner.write_bytes(data)
        error = refusal(tmp_path, "a")
    assert error is not None
    assert error.code == "BAT010"
    assert "of an unknown process" in str(error)
    # Locks end with their process, whatever the file says.
    assert refusal(tmp_path, "a") is None


def owned(process: int, host: str) -> str:
    return json.dumps({"process": process, "host": host})


def test_whose_run_it_is(tmp_path: Path) -> None:
    with subprocess.Popen([sys.executable, "-c", ""]) as ended:
        pass
    here, owner = platform.node(), tmp_path / "batch-a.owner"
    names = {
        owned(os.getpid(), here): f"process {os.getpid()} on {here!r}",
        owned(12, "other\x1b[2J"): "process 12 on 'other\\x1b[2J'",
        owned(ended.pid, here): "of an unknown process",
    }
    for text, name in names.items():
        # What an earlier run left is no reason to wait.
        owner.write_text(text)
        with locked_ledger(tmp_path, "a"):
            owner.write_text(text)
            assert name in str(refusal(tmp_path, "a"))


@pytest.mark.skipif(os.name == "nt", reason="POSIX links and pipes")
def test_an_owner_is_not_written_through_a_link(tmp_path: Path) -> None:
    (tmp_path / "mine.txt").write_text("mine")
    owner = tmp_path / "batch-a.owner"
    owner.symlink_to("mine.txt")
    error = refusal(tmp_path, "a")
    assert error is not None
    assert error.code == "BAT012"
    assert (tmp_path / "mine.txt").read_text() == "mine"
    owner.unlink()
    os.mkfifo(owner)
    error = refusal(tmp_path, "a")
    assert error is not None
    assert error.code == "BAT012"


def test_damage_is_told_once_and_the_rest_stays(tmp_path: Path) -> None:
    folder = tmp_path / ".animtool"
    with locked_ledger(folder, "a") as run:
        for number in (1, 2):
            run.add(item(number))
        run.add_failure("3.usdc", "why")
    made, failed = folder / "batch-a.jsonl", folder / "batch-a.failed.jsonl"
    made.write_bytes(made.read_bytes().replace(b'"item":"2', b'"item":"3'))
    failed.write_bytes(failed.read_bytes().replace(b"why", b"who"))
    with locked_ledger(folder, "a") as run:
        assert [notice.code for notice in run.history.damage_warnings] == ["BAT070"] * 2
        assert set(run.history.manifest.items) == {"1.usdc"}
        assert run.history.failure_reasons == {}
        run.merge_records(lambda _: True)
    history = read_history(folder, "a")
    assert (set(history.manifest.items), history.damage_warnings) == ({"1.usdc"}, [])


def test_batches_of_other_names_run_props_each_other(tmp_path: Path) -> None:
    with locked_ledger(tmp_path, "a"):
        assert refusal(tmp_path, "b") is None
        assert refusal(tmp_path, "a") is not None


def test_parts_come_together(tmp_path: Path) -> None:
    folder = tmp_path / ".animtool"
    for number in (1, 2):
        (tmp_path / f"{number}.usdc").touch()
        with locked_ledger(folder, "a", f"{number}-{number}") as part:
            part.add_names([f"{number}.usdc"])
            part.add(item(number))
            part.add_failure("9.usdc", "why")
            part.merge_records(lambda _: True)
    history = read_history(folder, "a")
    assert set(history.manifest.items) == {"1.usdc", "2.usdc"}
    assert history.failure_reasons == {"9.usdc": "why"}
    with locked_ledger(folder, "a") as whole:
        whole.merge_records(lambda made: made.key == "1.usdc")
    history = read_history(folder, "a")
    assert set(history.manifest.items) == {"1.usdc"}
    # It is there, and a run of the batch made it.
    assert "2.usdc" in history.manifest.known_names
    assert not list((folder / "batch-a.d").glob("*.jsonl"))


def test_why_an_item_failed_is_what_its_latest_part_says(tmp_path: Path) -> None:
    folder = tmp_path / ".animtool"
    for part in ("", "1-1", "1-2"):
        with locked_ledger(folder, "a", part) as run:
            run.add_failure("1.usdc", f"part {part}")
            run.merge_records(lambda _: True)
    assert read_history(folder, "a").failure_reasons == {"1.usdc": "part 1-2"}


def test_what_is_made_has_not_failed(tmp_path: Path) -> None:
    folder = tmp_path / ".animtool"
    with locked_ledger(folder, "a") as run:
        run.add_failure("1.usdc", "why")
        run.merge_records(lambda _: True)
    assert read_history(folder, "a").failure_reasons == {"1.usdc": "why"}
    with locked_ledger(folder, "a") as run:
        run.add(item(1))
        run.merge_records(lambda _: True)
    assert read_history(folder, "a").failure_reasons == {}
    assert not list(folder.glob("*.failed.jsonl"))


def test_a_run_that_is_not_settled_is_not_lost(tmp_path: Path) -> None:
    with locked_ledger(tmp_path, "a") as run:
        run.add_names(["1.usdc"])
        run.add_failure("2.usdc", "why")
    history = read_history(tmp_path, "a")
    assert "1.usdc" in history.manifest.known_names
    assert history.failure_reasons == {"2.usdc": "why"}


def test_what_did_not_change_is_not_written_again(tmp_path: Path) -> None:
    folder = tmp_path / ".animtool"
    with locked_ledger(folder, "a") as run:
        run.add(item(1))
        run.merge_records(lambda _: True)
    before = (folder / "batch-a.jsonl").stat().st_ino
    with locked_ledger(folder, "a") as run:
        run.merge_records(lambda _: True)
    assert (folder / "batch-a.jsonl").stat().st_ino == before
