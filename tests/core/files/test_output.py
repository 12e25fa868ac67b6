from __future__ import annotations

import errno
import os
import subprocess
import sys
from pathlib import Path

import pytest
from support.faults import raises

from animtool.core.errors import AnimtoolError, OptionError, OutputError
from animtool.core.files.commit import output_error
from animtool.core.files.leftovers import (
    new_temporary_path,
    remove_leftovers,
    temporary_prefix,
)
from animtool.core.files.output import (
    after_commit,
    atomic_outputs,
    check_outputs,
    protect_inputs,
    replacement_path,
    written_size,
)
from animtool.core.files.reading import record_input


def test_a_file_appears_whole(tmp_path: Path) -> None:
    target = tmp_path / "a.txt"
    with replacement_path(target) as temporary:
        temporary.write_text("done")
        assert not target.exists()
        assert temporary.parent == target.parent
    assert target.read_text() == "done"
    assert list(tmp_path.iterdir()) == [target]


@pytest.mark.parametrize("error", [RuntimeError, KeyboardInterrupt])
def test_a_failure_leaves_what_was(tmp_path: Path, error: type[BaseException]) -> None:
    target = tmp_path / "a.txt"
    target.write_text("old")

    def fail() -> None:
        with replacement_path(target) as temporary:
            temporary.write_text("half")
            raise error

    with pytest.raises(error):
        fail()
    assert target.read_text() == "old"
    assert list(tmp_path.iterdir()) == [target]


def test_many_outputs_that_exist_are_one_fault(tmp_path: Path) -> None:
    outputs = [tmp_path / f"a.{k:03d}.usdc" for k in range(5)]
    for path in outputs:
        path.touch()
    with raises(OptionError, "OUT001", match="4") as caught:
        check_outputs(outputs, [], overwrite=False)
    (fault,) = caught.value.faults
    assert (fault.code, fault.path) == ("OUT001", str(outputs[0]))
    assert fault.hint == "overwrite=True replaces them"


def test_a_temporary_file_is_not_named(tmp_path: Path) -> None:
    path = tmp_path / "a.usdc"
    (fault,) = output_error(
        path, f"no room for '{new_temporary_path(path)}': full"
    ).faults
    assert fault.message == f"cannot be written: no room for '{path}': full"


def test_nothing_written_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(OutputError), replacement_path(tmp_path / "a.txt"):
        pass


@pytest.mark.parametrize(
    ("name", "error", "code", "why"),
    [
        ("there.usda", OptionError, "OUT001", "exists"),
        ("missing/a.usda", OutputError, "OUT002", "does not exist"),
        ("there.usda/a.usda", OutputError, "OUT002", "is not a folder"),
        ("folder", OutputError, "OUT002", "folder"),
        ("input.bvh", OptionError, "OUT003", "input"),
        ("../{}/input.bvh", OptionError, "OUT003", "input"),
    ],
)
def test_refusals(
    tmp_path: Path, name: str, error: type[AnimtoolError], code: str, why: str
) -> None:
    (tmp_path / "there.usda").write_text("mine")
    (tmp_path / "folder").mkdir()
    source = tmp_path / "input.bvh"
    source.write_text("")
    output = tmp_path / name.format(tmp_path.name)
    with pytest.raises(error) as caught:
        check_outputs([output], [source], overwrite=False)
    assert (caught.value.code, why in str(caught.value)) == (code, True)


def test_overwrite_allows_what_exists(tmp_path: Path) -> None:
    there = tmp_path / "there.usda"
    there.write_text("mine")
    check_outputs([there], [], overwrite=True)
    with pytest.raises(OptionError):
        check_outputs([there], [there], overwrite=True)


def test_a_link_stays_a_link(tmp_path: Path) -> None:
    target, link = tmp_path / "real.txt", tmp_path / "link.txt"
    target.write_text("old")
    link.symlink_to(target)
    with replacement_path(link) as temporary:
        temporary.write_text("new")
    assert link.is_symlink()
    assert target.read_text() == "new"


def test_several_writers_of_one_file(tmp_path: Path) -> None:
    target = tmp_path / "a.txt"
    with replacement_path(target) as one, replacement_path(target) as two:
        assert one != two
        one.write_text("one")
        two.write_text("two")
    assert target.read_text() == "one"


def test_what_dead_processes_of_this_host_left_is_removed(tmp_path: Path) -> None:
    # A process that has ended; its number is not given again so soon.
    ended = subprocess.run(
        [sys.executable, "-c", "import os; print(os.getpid())"],
        capture_output=True,
        text=True,
        check=True,
    )
    dead = int(ended.stdout)
    left = tmp_path / f"{temporary_prefix(dead)}0123.usdc"
    kept = [
        tmp_path / f"{temporary_prefix()}0123.usdc",
        tmp_path / f".animtool-00000000-{dead}-0123.usdc",
        tmp_path / "take.usdc",
    ]
    for path in (left, *kept):
        path.touch()
    assert remove_leftovers([tmp_path, tmp_path / "none"]) == [left]
    assert sorted(tmp_path.iterdir()) == sorted(kept)


@pytest.mark.skipif(sys.platform != "linux", reason="the state is read from /proc")
def test_what_a_process_left_that_nobody_asked_after_is_removed(tmp_path: Path) -> None:
    with subprocess.Popen([sys.executable, "-c", ""]) as ended:
        os.waitid(os.P_PID, ended.pid, os.WEXITED | os.WNOWAIT)
        left = tmp_path / f"{temporary_prefix(ended.pid)}0123.usdc"
        left.touch()
        assert remove_leftovers([tmp_path]) == [left]


def test_what_one_process_left_is_removed(tmp_path: Path) -> None:
    own = tmp_path / f"{temporary_prefix()}0123.usdc"
    own.touch()
    assert remove_leftovers([tmp_path], os.getpid()) == [own]


def test_files_get_their_names_together(tmp_path: Path) -> None:
    one, other = tmp_path / "one.txt", tmp_path / "other.txt"
    one.write_text("before", "utf-8")
    with atomic_outputs():
        with replacement_path(one) as temporary:
            temporary.write_text("after", "utf-8")
        with replacement_path(other) as temporary:
            temporary.write_text("after", "utf-8")
        assert one.read_text("utf-8") == "before"
        assert not other.exists()
    assert [path.read_text("utf-8") for path in (one, other)] == ["after", "after"]
    assert sorted(tmp_path.iterdir()) == [one, other]


def test_sizes_are_known_before_names(tmp_path: Path) -> None:
    one = tmp_path / "one.txt"
    one.write_text("before all", "utf-8")
    with atomic_outputs():
        with replacement_path(one) as temporary:
            temporary.write_text("after", "utf-8")
        assert written_size(one) == 5
    assert written_size(one) == 5
    with pytest.raises(FileNotFoundError):
        written_size(tmp_path / "other.txt")


@pytest.mark.parametrize("sound", [True, False])
def test_some_props_are_done_once_files_have_names(tmp_path: Path, sound: bool) -> None:
    one, found = tmp_path / "one.txt", []

    def write() -> None:
        with atomic_outputs():
            with replacement_path(one) as temporary:
                temporary.write_text("after", "utf-8")
            after_commit(lambda: found.append(one.exists()))
            assert found == []
            if not sound:
                raise KeyboardInterrupt

    if sound:
        write()
    else:
        with pytest.raises(KeyboardInterrupt):
            write()
    assert found == [True] * sound
    after_commit(lambda: found.append(False))
    assert found[-1] is False


def test_what_is_together_within_waits_for_the_whole(tmp_path: Path) -> None:
    one = tmp_path / "one.txt"
    with atomic_outputs():
        with atomic_outputs(), replacement_path(one) as temporary:
            temporary.write_text("after", "utf-8")
        assert not one.exists()
    assert one.read_text("utf-8") == "after"


@pytest.mark.parametrize("inside", [True, False])
def test_none_gets_its_name_where_one_fails(tmp_path: Path, inside: bool) -> None:
    one = tmp_path / "one.txt"

    def write() -> None:
        with atomic_outputs():
            with replacement_path(one) as temporary:
                temporary.write_text("after", "utf-8")
            with replacement_path(tmp_path / "other.txt") as temporary:
                temporary.write_text("after", "utf-8")
                if inside:
                    raise KeyboardInterrupt
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write()
    assert list(tmp_path.iterdir()) == []
    with replacement_path(one) as temporary:
        temporary.write_text("alone", "utf-8")
    assert one.read_text("utf-8") == "alone"


def test_what_was_read_is_not_replaced(tmp_path: Path) -> None:
    def read(*outputs: Path) -> None:
        with protect_inputs(outputs):
            record_input(tmp_path / "shot.usda")
            record_input(tmp_path / "layer.usda", is_composed=True)

    (tmp_path / "shot.usda").touch()
    read(tmp_path / "other.usda", tmp_path / "layer.usda")
    with pytest.raises(OptionError) as caught:
        read(tmp_path / "other.usda", tmp_path / "shot.usda")
    assert caught.value.code == "OUT003"


@pytest.mark.skipif(os.name == "nt", reason="has no such files")
def test_what_a_set_left_is_no_pipe(tmp_path: Path) -> None:
    # No process has this number.
    pipe = tmp_path / f"{temporary_prefix(2**30)}0123456789ab.set"
    os.mkfifo(pipe)
    assert remove_leftovers([tmp_path]) == [pipe]


def test_an_input_by_another_spelling_is_not_replaced(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    source, output = tmp_path / "walk.usda", tmp_path / "WALK.usda"
    source.touch()
    output.touch()
    check_outputs([output], [source], overwrite=True)
    # As it is on a disk that takes both names for one.
    monkeypatch.setattr(Path, "samefile", lambda *_: True)
    with pytest.raises(OptionError) as caught:
        check_outputs([output], [source], overwrite=True)
    assert caught.value.code == "OUT003"


def test_two_outputs_of_one_name_are_refused(tmp_path: Path) -> None:
    paths = [tmp_path / "walk.usda", tmp_path / "Walk.usda"]
    with pytest.raises(OptionError) as caught:
        check_outputs(paths, [], overwrite=True)
    assert caught.value.code == "OUT007"

    def write() -> None:
        with atomic_outputs():
            for path in paths:
                with replacement_path(path) as temporary:
                    temporary.touch()

    with pytest.raises(OptionError):
        write()
    assert list(tmp_path.iterdir()) == []


def test_a_folder_without_permission_has_a_way_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("os.access", lambda *_: False)
    with pytest.raises(OutputError) as caught:
        check_outputs([tmp_path / "a.usdc"], [], overwrite=False)
    assert caught.value.code == "OUT002"
    assert caught.value.faults[0].hint
    for number in (errno.ENOSPC, errno.EACCES, errno.EROFS, errno.ENAMETOOLONG):
        error = output_error(tmp_path / "a.usdc", OSError(number, "no"))
        assert error.faults[0].hint
