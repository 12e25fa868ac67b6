"""Every call of writing fails, and every one is the last: what is lost is nothing."""

from __future__ import annotations

import errno
import json
import os
import shutil
import signal
import sys
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import pytest
from support.small_takes import small

from animtool.batch.bundle import Bundle, write_bundle
from animtool.core.errors import AnimtoolError, OptionError, OutputError
from animtool.core.files.commit import output_error
from animtool.core.files.leftovers import (
    remove_leftovers,
    roll_back_folder,
    temporary_prefix,
)
from animtool.core.files.output import (
    atomic_outputs,
    check_outputs,
    early_outputs,
    replacement_path,
)
from faults.calls import (
    Calls,
    Children,
    Files,
    failing,
    files_in,
    in_child,
    signalled,
    watched,
)

pytestmark = pytest.mark.slow


FAULTS = "fault | what happened | what was lost"
posix = pytest.mark.skipif(os.name == "nt", reason="POSIX processes")
Writer = Callable[[Path, str], None]


def write(path: Path, text: str) -> None:
    with replacement_path(path) as temporary:
        try:
            temporary.write_text(text, "utf-8")
        except OSError as error:
            raise output_error(path, error) from error


def one_file(folder: Path, text: str) -> None:
    check_outputs([folder / "a.txt"], [], overwrite=(folder / "a.txt").exists())
    write(folder / "a.txt", text)


def three_files(folder: Path, text: str) -> None:
    paths = [folder / name for name in ("a.txt", "b.txt", "c.txt")]
    check_outputs(paths, [], overwrite=paths[0].exists())
    with atomic_outputs():
        for path in paths:
            write(path, text)


def half_new(folder: Path, text: str) -> None:
    """Write two files, of which one is there only from the second time on."""
    with atomic_outputs():
        write(folder / "a.txt", text)
        if text == "new":
            write(folder / "b.txt", text)


def with_arrays(folder: Path, text: str) -> None:
    """Write a file that is read again before the one that names it is written."""
    paths = [folder / f"{text}.npz"] * (text == "new")
    with atomic_outputs():
        with early_outputs(paths):
            for path in paths:
                write(path, text)
        write(folder / "a.txt", text)


def bundle(folder: Path, text: str) -> None:
    write_bundle(Bundle({"name": text}, {}, 1, 1), folder, overwrite=True)


def split(folder: Path, text: str) -> None:
    from animtool.usd import write as write_take

    take = small(4 if text == "old" else 5)
    write_take(take, folder / "s.usda", split=True, overwrite=True)


WRITERS = [one_file, three_files, half_new, with_arrays, bundle, split]
BEFORE = ["old", ""]


@dataclass(frozen=True, slots=True)
class Stage:
    """A writer and a folder, before and after it.

    Attributes:
        writer: What writes.
        folder: Below it are the copies of the folder.
        old: The files before.
        new: The files after.
        calls: Of writing.
    """

    writer: Writer
    folder: Path
    old: Files
    new: Files
    calls: list[str]

    @classmethod
    def of(cls, writer: Writer, folder: Path, before: str) -> Stage:
        """Return a stage where there is something before, or nothing."""
        template = folder / "template"
        template.mkdir()
        if before:
            writer(template, before)
            for path in template.iterdir():
                path.chmod(0o640)
        calls = Calls(lambda _: None)
        made = shutil.copytree(template, folder / "made")
        with watched(calls):
            writer(made, "new")
        return cls(writer, folder, files_in(template), files_in(made), calls.names)

    def copy(self, number: int) -> Path:
        """Return the folder as it is before."""
        return shutil.copytree(self.folder / "template", self.folder / str(number))

    def run(self, folder: Path, calls: Calls) -> None:
        """Write, and tell of the calls."""
        with watched(calls):
            self.writer(folder, "new")


def hidden(folder: Path) -> list[Path]:
    return [path for path in folder.iterdir() if path.name.startswith(".animtool-")]


@pytest.mark.parametrize("before", BEFORE)
@pytest.mark.parametrize("writer", WRITERS)
def test_a_call_fails(
    writer: Writer,
    before: str,
    disk: Path,
    record_property: Callable[[str, object], None],
) -> None:
    stage = Stage.of(writer, disk, before)
    refused = 0
    for i, name in enumerate(stage.calls, 1):
        folder = stage.copy(i)
        code = ""
        try:
            stage.run(folder, failing(i))
        except OutputError as error:
            code = error.code
        # Without an error, nothing was to be lost by that call.
        assert code in {"", "OUT002"}
        expected = stage.old if code else stage.new
        assert files_in(folder) == expected, f"{name}, call {i}"
        refused += bool(code)
        if name != "unlink":
            assert hidden(folder) == [], f"{name}, call {i}"
    assert refused
    if before:
        row = f"{writer.__name__}: each of {len(stage.calls)} calls fails"
        said = f"{refused} typed errors, else written"
        record_property(FAULTS, f"{row} | {said} | nothing")


def stop_at(name: str, folder: str, at: int, number: int) -> None:
    """Write, and send this process a signal at a call.

    Signals that ask for an end raise, as the command line does.
    """
    if number != signal.SIGKILL:
        signal.signal(number, lambda signum, _: sys.exit(128 + signum))
    writer = next(each for each in WRITERS if each.__name__ == name)
    with watched(signalled(at, number)):
        writer(Path(folder), "new")


@posix
@pytest.mark.parametrize("before", BEFORE)
@pytest.mark.parametrize("writer", WRITERS[:-1])
def test_the_process_is_killed(
    writer: Writer,
    before: str,
    disk: Path,
    children: Children,
    record_property: Callable[[str, object], None],
) -> None:
    stage = Stage.of(writer, disk, before)
    found = []
    for i in range(1, len(stage.calls) + 1):
        folder = stage.copy(i)
        given = (writer.__name__, str(folder), i, int(signal.SIGKILL))
        assert children(stop_at, *given) == -signal.SIGKILL
        # What the next command that writes to the folder does first.
        roll_back_folder(folder)
        files = files_in(folder)
        # Nothing names an array file before the text is there.
        if writer is with_arrays and files.get("a.txt") == stage.old.get("a.txt"):
            files.pop("new.npz", None)
        assert files in (stage.old, stage.new), f"{stage.calls[i - 1]}, call {i}"
        found.append(files == stage.new)
        remove_leftovers([folder])
        assert hidden(folder) == []
    if before:
        row = f"{writer.__name__}: SIGKILL at each of {len(found)} calls"
        record_property(FAULTS, f"{row} | {sum(found)} whole, else as before | nothing")


@posix
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_the_process_is_asked_to_end(
    number: signal.Signals,
    disk: Path,
    children: Children,
    record_property: Callable[[str, object], None],
) -> None:
    stage = Stage.of(three_files, disk, "old")
    whole = 0
    for i in range(1, len(stage.calls) + 1):
        folder = stage.copy(i)
        given = (three_files.__name__, str(folder), i, int(number))
        assert children(stop_at, *given) == 128 + number
        assert files_in(folder) in (stage.old, stage.new)
        assert hidden(folder) == []
        whole += files_in(folder) == stage.new
    row = f"three_files: {number.name} at each of {len(stage.calls)} calls"
    record_property(FAULTS, f"{row} | {whole} whole, else as before | nothing")


def test_an_undo_that_fails_is_done_by_the_next(disk: Path) -> None:
    stage = Stage.of(three_files, disk, "old")
    renames = [i for i, name in enumerate(stage.calls, 1) if name == "replace"]

    def work(folder: Path, first: int) -> None:
        def act(at: int) -> None:
            # The disk goes in the middle of the names, and stays away.
            if at >= first:
                raise OSError(errno.EIO, os.strerror(errno.EIO))

        with pytest.raises(OutputError):
            stage.run(folder, Calls(act))

    for i in renames:
        folder = stage.copy(i)
        assert in_child(lambda i=i, folder=folder: work(folder, i)) == 0  # type: ignore[misc]
        roll_back_folder(folder)
        assert files_in(folder) == stage.old


@posix
def test_a_journal_of_others_reaches_no_other_files(disk: Path) -> None:
    dead = temporary_prefix(in_child_number())
    mine, folder = disk / "mine.txt", disk / "theirs"
    mine.write_text("mine", "utf-8")
    folder.mkdir()
    found = mine.stat()
    entry = {
        "final": "../mine.txt",
        "temporary": f"{dead}0.txt",
        "old": f"{dead}1.txt",
        "state": [found.st_ino, found.st_size, found.st_mtime_ns],
    }
    for text in (
        json.dumps({"folders": [str(folder)], "files": [entry]}),
        json.dumps({"folders": [str(folder)], "files": [{**entry, "final": ".."}]}),
        json.dumps({"folders": 3, "files": "x"}),
        json.dumps({"folders": ["a\0b"], "files": []}),
        json.dumps({"folders": [], "files": [{**entry, "final": "a\0b"}]}),
        json.dumps({"folders": [], "files": [{**entry, "state": [1e999, 1, 1]}]}),
        "[" * 100_000,
    ):
        (folder / f"{dead}2.set").write_text(text, "utf-8")
        remove_leftovers([folder])
        assert mine.read_text("utf-8") == "mine"
        assert hidden(folder) == []
    os.mkfifo(folder / f"{dead}2.set")
    roll_back_folder(folder)
    remove_leftovers([folder])
    assert hidden(folder) == []


def in_child_number() -> int:
    """Return the number of a process that has ended."""
    child = os.fork()
    if not child:
        os._exit(0)
    os.waitpid(child, 0)
    return child


@posix
def test_of_several_writers_one_wins(
    disk: Path, record_property: Callable[[str, object], None]
) -> None:
    names = ("a.txt", "b.txt", "c.txt")
    paths = [disk / name for name in names]
    ready, go = os.pipe(), os.pipe()
    children = []
    for i in range(6):
        child = os.fork()
        if not child:
            code = 70
            try:
                os.close(go[1])
                check_outputs(paths, [], overwrite=False)
                os.write(ready[1], b".")
                # All are let go at once.
                os.read(go[0], 1)
                with atomic_outputs():
                    for path in paths:
                        write(path, str(i))
                code = 0
            except AnimtoolError as error:
                code = 2 if error.code == "OUT001" else 3
            finally:
                os._exit(code)
        children.append(child)
    for _ in children:
        os.read(ready[0], 1)
    for end in (*ready, *go):
        os.close(end)
    codes = [os.waitstatus_to_exitcode(os.waitpid(c, 0)[1]) for c in children]
    assert sorted(codes) == [0, 2, 2, 2, 2, 2]
    assert {path.read_text("utf-8") for path in paths} == {str(codes.index(0))}
    assert hidden(disk) == []
    row = "6 processes write 3 files at once, without --overwrite"
    record_property(FAULTS, f"{row} | one wins, 5 end with OUT001 | nothing")


def test_a_file_that_appears_meanwhile_stays(disk: Path) -> None:
    for names in (["a.txt"], ["a.txt", "b.txt"], ["b.txt", "a.txt"]):
        folder = disk / "-".join(names)
        folder.mkdir()
        paths = [folder / name for name in names]
        check_outputs(paths, [], overwrite=False)
        (folder / "a.txt").write_text("theirs", "utf-8")

        def run(paths: Sequence[Path] = paths) -> None:
            with atomic_outputs():
                for path in paths:
                    write(path, "mine")

        with pytest.raises(OptionError) as caught:
            run()
        assert caught.value.code == "OUT001"
        assert files_in(folder).keys() == {"a.txt"}
        assert (folder / "a.txt").read_text("utf-8") == "theirs"
        assert hidden(folder) == []


@pytest.mark.slow
def test_a_disk_without_hard_links(
    disk: Path,
    monkeypatch: pytest.MonkeyPatch,
    record_property: Callable[[str, object], None],
) -> None:
    def link(*_: object, **__: object) -> None:
        raise OSError(errno.EPERM, os.strerror(errno.EPERM))

    monkeypatch.setattr(os, "link", link)
    for before in BEFORE:
        place = disk / f"before {before}"
        place.mkdir()
        stage = Stage.of(three_files, place, before)
        assert {content for content, _ in stage.new.values()} == {b"new"}
        for i in range(1, len(stage.calls) + 1):
            folder = stage.copy(i)
            with suppress(OutputError):
                stage.run(folder, failing(i))
            assert files_in(folder) in (stage.old, stage.new)
    path = disk / "a.txt"
    check_outputs([path], [], overwrite=False)
    path.write_text("theirs", "utf-8")
    with pytest.raises(OptionError):
        write(path, "mine")
    assert path.read_text("utf-8") == "theirs"
    row = "three_files, no hard links: each call fails"
    record_property(FAULTS, f"{row} | typed errors, else written | nothing")
