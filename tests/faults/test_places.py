"""Where outputs may go: links, devices, modes, folders of others, full disks."""

from __future__ import annotations

import os
import shutil
import socket
import stat
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

import pytest
from support.bvh import random_rows, small_bvh
from support.cli import Done, animtool

from animtool import bake
from animtool.core.errors import OutputError
from animtool.core.files.output import atomic_outputs, check_outputs, replacement_path
from faults.calls import in_child

FAULTS = "fault | what happened | what was lost"
NOBODY = 65534
Record = Callable[[str, object], None]
posix = pytest.mark.skipif(os.name == "nt", reason="POSIX files")


@pytest.fixture
def take(disk: Path) -> Path:
    path = disk / "take.bvh"
    path.write_text(small_bvh(random_rows(4)), "utf-8")
    return path


def link_to_itself(path: Path) -> None:
    path.symlink_to(path.name)


def link_to_nothing(path: Path) -> None:
    path.symlink_to("missing.usda")


def pipe(path: Path) -> None:
    os.mkfifo(path)


def link_to_device(path: Path) -> None:
    device = path.with_name("device")
    try:
        os.mknod(device, 0o600 | stat.S_IFCHR, os.makedev(1, 3))
    except PermissionError:
        reason = "only root can make a device"
        pytest.skip(reason)
    path.symlink_to(device.name)


def socket_of_others(path: Path) -> None:
    with socket.socket(socket.AF_UNIX) as made:
        made.bind(os.fspath(path))


@posix
@pytest.mark.parametrize(
    "make",
    [link_to_itself, link_to_nothing, pipe, link_to_device, socket_of_others],
    ids=lambda f: f.__name__,
)
def test_an_output_that_is_no_file(
    make: Callable[[Path], None], disk: Path, take: Path, record_property: Record
) -> None:
    output = disk / "o.usda"
    make(output)
    names = sorted(path.name for path in disk.iterdir())
    before = output.stat() if output.exists() else output.lstat()
    for arguments in (
        ("bake", take, "-o", output, "--overwrite"),
        ("bake", take, "-o", output),
        ("validate", take, "--output-file", output),
    ):
        done = animtool(*arguments)
        assert done.code == 3
        assert "OUT005" in done.stderr
    # Nothing of animtool's stands next to it, either.
    assert sorted(path.name for path in disk.iterdir()) == names
    after = output.stat() if output.exists() else output.lstat()
    assert stat.S_IFMT(after.st_mode) == stat.S_IFMT(before.st_mode)
    with pytest.raises(OutputError), replacement_path(output):
        pass
    row = f"-o is a {make.__name__.replace('_', ' ')}"
    record_property(FAULTS, f"{row} | OUT005 | nothing")


@posix
def test_what_is_replaced_keeps_its_mode_and_owner(
    disk: Path, take: Path, record_property: Record
) -> None:
    output, link = disk / "o.usda", disk / "link.usda"
    mask = os.umask(0o027)
    try:
        assert animtool("bake", take, "-o", output).code == 0
        # A new one has that of the umask.
        assert stat.S_IMODE(output.stat().st_mode) == 0o640
        if os.getuid() == 0:
            os.chown(output, NOBODY, NOBODY)
        output.chmod(0o4604)
        link.symlink_to(output.name)
        assert animtool("bake", take, "-o", link, "--overwrite").code == 0
    finally:
        os.umask(mask)
    assert link.is_symlink()
    found = output.stat()
    # What runs with the rights of its owner is what the owner wrote alone.
    assert stat.S_IMODE(found.st_mode) == 0o604
    if os.getuid() == 0:
        assert (found.st_uid, found.st_gid) == (NOBODY, NOBODY)
    record_property(FAULTS, "--overwrite of mode 4604, nobody's | 0604, his | nothing")


@posix
def test_a_folder_and_a_file_that_are_not_mine(
    disk: Path, record_property: Record
) -> None:
    if os.getuid() != 0:
        reason = "only root can become another user"
        pytest.skip(reason)
    closed, shared = disk / "closed", disk / "shared"
    closed.mkdir(mode=0o755)
    shared.mkdir()
    shared.chmod(0o777)
    (shared / "o.txt").write_text("theirs", "utf-8")
    (shared / "o.txt").chmod(0o644)
    hidden = disk / "hidden"
    hidden.mkdir(mode=0o700)

    def work() -> None:
        os.setgid(NOBODY)
        os.setuid(NOBODY)
        for path in (closed / "o.txt", shared / "o.txt", hidden / "o.txt"):
            with pytest.raises(OutputError) as caught:
                check_outputs([path], [], overwrite=True)
            assert caught.value.code == "OUT002"
            # Whoever does not look before finds out at the end.
            if path.parent == closed:
                with (
                    pytest.raises(PermissionError),
                    replacement_path(path) as temporary,
                ):
                    temporary.touch()
        # A set of which one file cannot be written.
        paths = [shared / "new.txt", closed / "new.txt"]
        with pytest.raises(PermissionError):
            both(paths)

    assert in_child(work) == 0
    assert [path.name for path in shared.iterdir()] == ["o.txt"]
    assert (shared / "o.txt").read_text("utf-8") == "theirs"
    assert list(closed.iterdir()) == []
    row = "read-only folder, read-only file, folder of others (as nobody)"
    record_property(FAULTS, f"{row} | OUT002 | nothing")


def both(paths: Sequence[Path]) -> None:
    with atomic_outputs():
        for path in paths:
            with replacement_path(path) as temporary:
                temporary.write_text("new", "utf-8")


FULL = {
    "bake a.usda": ("bake", "take.bvh", "-o", "o.usda", "--overwrite"),
    "bake a.usdc": ("bake", "take.bvh", "-o", "o.usdc", "--overwrite"),
    "bake --split": ("bake", "take.bvh", "-o", "o.usda", "--split", "--overwrite"),
    "convert to a clip": ("convert", "take.bvh", "o.clip.yaml", "--overwrite"),
    "convert to a rig": ("convert", "take.bvh", "o.rig.yaml", "--overwrite"),
}


@pytest.mark.slow
@posix
@pytest.mark.parametrize("name", FULL)
def test_a_full_disk(
    name: str,
    disk: Path,
    take: Path,
    record_property: Record,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(disk)
    assert animtool(*FULL[name]).code == 0
    before = {path.name: path.read_bytes() for path in disk.iterdir()}
    take.write_text(small_bvh(random_rows(40)), "utf-8")
    before["take.bvh"] = take.read_bytes()
    shutil.copytree(disk, disk / "again")
    refused = 0
    for limit in (0, 100, 1000, 3000):
        done = limited(limit, *FULL[name])
        found = {
            path.name: path.read_bytes() for path in disk.iterdir() if path.is_file()
        }
        assert done in {0, 3}
        assert done == 0 or found == before
        refused += done == 3
    assert refused >= 2
    row = f"{name}: files of up to 0, 100, 1000, 3000 bytes"
    record_property(FAULTS, f"{row} | OUT002 | nothing")


def limited(limit: int, *arguments: str) -> int:
    """Run a command that may write no more than some bytes to a file."""

    def work() -> None:
        import resource
        import signal

        # A module first imported here would be cached cut off at the limit.
        sys.dont_write_bytecode = True
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))
        done: Done = animtool(*arguments)
        if done.code == 3 and "OUT002" not in done.stderr:
            sys.exit(99)
        sys.exit(done.code)

    return in_child(work)


def test_names_that_are_too_long_or_none(disk: Path, take: Path) -> None:
    for name in ("n" * 260 + ".usda", "n\0.usda", "d" * 260 + "/o.usda"):
        with pytest.raises(OutputError) as caught:
            bake(take, disk / name)
        assert caught.value.code == "OUT002"
    long = disk / ("n" * 250 + ".usda")
    assert animtool("bake", take, "-o", long).code == 0
    assert long.exists()
    assert (
        animtool("validate", take, "--output-file", disk / f"a.{'s' * 253}").code == 0
    )


@posix
def test_names_that_are_no_text(
    disk: Path, take: Path, record_property: Record
) -> None:
    odd = Path(os.fsdecode(os.fsencode(disk) + b"/\xff.bvh"))
    shutil.copy(take, odd)
    assert animtool("bake", odd, "-o", disk / "o.usda").code == 0
    assert animtool("bake", odd, take, "-o", disk / "library.usda").code == 0
    # The clip would have a name that no text holds.
    assert animtool("convert", odd, odd.with_suffix(".clip.yaml")).code == 3
    for arguments in (
        ("bake", odd, "-o", odd.with_suffix(".usda")),
        ("bake", odd, "-o", odd.with_suffix(".usda"), "--split"),
        ("batch", odd, "-o", disk / "out/{stem}.usdc"),
    ):
        done = animtool(*arguments)
        assert done.code == 2
        assert "OUT006" in done.stderr
    record_property(FAULTS, "a name with the byte FF for USD | OUT006 | nothing")
