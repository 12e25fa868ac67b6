"""Names, folders and globs as files."""

from __future__ import annotations

import os
import socket
from pathlib import Path

import pytest
from support.faults import raises

from animtool.batch.item import read_path_rules
from animtool.cli.main import run
from animtool.clip.clip import Clip
from animtool.core.config import find_config
from animtool.core.errors import AnimtoolError, FormatError
from animtool.core.files import reading as files
from animtool.core.files.reading import (
    matching_files,
    nearest_file,
    open_input,
    read_input,
    recorded_inputs,
    require_file,
    unreadable_error,
)
from animtool.formats.bvh.read import read_bvh
from animtool.ik.file import load_targets
from animtool.rig.skeleton import Rig


@pytest.fixture
def tree(tmp_path: Path) -> Path:
    for name in ("b.bvh", "a.bvh", "x/c.bvh", "x/y/d.bvh", "x/.e/f.bvh", "x/n.txt"):
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.touch()
    return tmp_path


def found(folder: Path, text: str) -> list[tuple[str, str]]:
    """Return files and where each was searched, from a folder."""
    return [
        (
            file.path.relative_to(folder).as_posix(),
            file.search_folder.relative_to(folder).name,
        )
        for file in matching_files(str(folder / text), [".bvh"])
    ]


@pytest.mark.parametrize(
    ("text", "files", "base"),
    [
        (".", ["a.bvh", "b.bvh", "x/c.bvh", "x/y/d.bvh"], ""),
        ("x", ["x/c.bvh", "x/y/d.bvh"], "x"),
        ("x/**/*.bvh", ["x/c.bvh", "x/y/d.bvh"], "x"),
        ("*/*", ["x/c.bvh", "x/n.txt"], ""),
        ("x/.*/*.bvh", ["x/.e/f.bvh"], "x"),
        ("a.bvh", ["a.bvh"], ""),
        ("none.bvh", ["none.bvh"], ""),
        ("none*.bvh", [], ""),
    ],
)
def test_what_is_meant(tree: Path, text: str, files: list[str], base: str) -> None:
    assert found(tree, text) == [(file, base) for file in files]


def test_a_name_with_wildcards_that_is_there_is_meant(tree: Path) -> None:
    (tree / "take[1].bvh").touch()
    (tree / "take1.bvh").touch()
    assert found(tree, "take[1].bvh") == [("take[1].bvh", "")]


@pytest.mark.parametrize(
    ("name", "meant"),
    [
        (
            "A.bvh",
            None if Path(__file__.upper()).exists() else "did you mean 'a.bvh'?",
        ),
        ("x/y/dd.bvh", "did you mean 'x/y/d.bvh'?"),
        ("x/y/other.usda", None),
        ("xx/../b.bvh", "there is no folder 'xx'"),
        ("xx/**/b.bvh", "there is no folder 'xx'"),
        ("x/*/*/b.bvh", None),
        ("a.bvh", None),
    ],
)
def test_the_nearest_file(tree: Path, name: str, meant: str | None) -> None:
    assert nearest_file(Path(name), tree) == meant


@pytest.mark.parametrize(
    ("name", "meant"),
    [
        ("walk.bvh", "did you mean 'takes/left/walk.bvh' or 'takes/right/walk.bvh'?"),
        ("takes/walk.bvh", "did you mean 'takes/left/walk.bvh' or "),
        ("takes/left/run.bvh", "did you mean 'takes/right/run.bvh'?"),
        ("takes/old/run.bvh", "did you mean 'takes/right/run.bvh'?"),
        ("takes/old/jump.bvh", "there is no folder 'takes/old'"),
        ("takes/left/hid.bvh", None),
        ("takes/deep.bvh", None),
        ("takes/left/*.bvh", None),
    ],
)
def test_a_file_that_was_moved_is_found_nearby(
    tmp_path: Path, name: str, meant: str | None
) -> None:
    for path in ("left/walk", "right/walk", "right/run", ".git/hid", "a/b/c/deep"):
        file = tmp_path / "takes" / f"{path}.bvh"
        file.parent.mkdir(parents=True, exist_ok=True)
        file.touch()
    hint = nearest_file(Path(name), tmp_path)
    assert hint == meant or (meant and str(hint).startswith(meant))


def test_the_nearest_folder(tree: Path) -> None:
    (tree / "takes").mkdir()
    hint = nearest_file(tree / "take/a.bvh")
    assert hint == f"did you mean the folder {(tree / 'takes').as_posix()!r}?"


def test_every_file_that_is_missing_has_the_nearest_name(tree: Path) -> None:
    error = unreadable_error(tree / "bb.bvh", "does not exist")
    assert error.code == "IO001"
    assert "b.bvh" in str(error.faults[0].hint)


posix = pytest.mark.skipif(os.name == "nt", reason="has no such files")
SPECIAL = ["folder", "fifo", "socket", "device", "fifo link", "device link"]


def special(folder: Path, kind: str, name: str) -> Path:
    """Return a path that is no regular file."""
    path = folder / name
    what = path if "link" not in kind else folder / f"{name}.target"
    if kind == "folder":
        what.mkdir()
    elif kind.startswith("fifo"):
        os.mkfifo(what)
    elif kind == "socket":
        # Its own path may be longer than addresses of sockets.
        here = Path.cwd()
        os.chdir(folder)
        with socket.socket(socket.AF_UNIX) as made:
            made.bind(name)
        os.chdir(here)
    else:
        what = Path("/dev/zero")
    if what != path:
        path.symlink_to(what)
    return path


@posix
@pytest.mark.parametrize("kind", SPECIAL)
def test_what_is_no_file_is_not_opened(tmp_path: Path, kind: str) -> None:
    path = special(tmp_path, kind, "walk.bvh")
    with pytest.raises(FormatError) as error:
        open_input(path)
    assert error.value.code == "IO001"
    word = kind.removesuffix(" link").replace("fifo", "pipe")
    assert f"is a {word}" in error.value.faults[0].message


@posix
@pytest.mark.parametrize("kind", ["fifo", "device"])
@pytest.mark.parametrize(
    ("name", "command"),
    [
        ("walk.bvh", ["info", "{}"]),
        ("walk.bvh", ["validate", "{}"]),
        ("hero.rig.yaml", ["validate", "{}"]),
        ("hero.usda", ["validate", "{}"]),
        ("hero.usdc", ["info", "{}"]),
        ("edit.otio", ["batch", "{}", "-o", "{{shot}}.usdc"]),
        ("map.json", ["batch", "a.bvh", "--path-mapping", "{}", "-o", "x.usdc"]),
    ],
)
def test_no_command_waits_for_what_is_no_file(
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    kind: str,
    name: str,
    command: list[str],
) -> None:
    if name == "edit.otio":
        pytest.importorskip("opentimelineio")
    path = special(tmp_path, f"{kind} link", name)
    assert run([part.format(path) for part in command]) in {1, 2, 3}
    said = capsys.readouterr()
    assert "not a file" in said.err + said.out


@posix
def test_standard_input_is_no_file() -> None:
    reader, writer = os.pipe()
    try:
        with raises(FormatError, "IO001"):
            open_input(Path(f"/dev/fd/{reader}"))
    finally:
        os.close(reader)
        os.close(writer)


def test_a_name_that_no_file_can_have(tmp_path: Path) -> None:
    for name in ("a\0b", "\ud800", "n" * 5000):
        with pytest.raises(FormatError) as error:
            open_input(tmp_path / name)
        assert error.value.code == "IO001"


def test_a_file_over_the_limit_is_not_read(tmp_path: Path) -> None:
    path = tmp_path / "large"
    path.write_bytes(b"12345")
    assert read_input(path, 5) == b"12345"
    with pytest.raises(FormatError) as error:
        read_input(path, 4)
    assert error.value.code == "IO010"
    with path.open("wb") as file:
        file.truncate(files.MAX_INPUT_BYTES + 1)
    with raises(FormatError, "IO010"):
        read_input(path)


@pytest.mark.parametrize("name", ["animtool.toml", "pyproject.toml"])
def test_settings_are_not_read_without_end(tmp_path: Path, name: str) -> None:
    with (tmp_path / name).open("wb") as file:
        file.truncate(files.MAX_TEXT_BYTES + 1)
    with raises(AnimtoolError, "CFG001"):
        find_config(tmp_path / "a.bvh")


def test_rules_of_paths_are_not_read_without_end(tmp_path: Path) -> None:
    path = tmp_path / "rules.json"
    with path.open("wb") as file:
        file.truncate(files.MAX_TEXT_BYTES + 1)
    with raises(FormatError, "BAT038"):
        read_path_rules(path)


def test_a_file_that_grows_is_read_as_long_as_it_was(tmp_path: Path) -> None:
    path = tmp_path / "grows"
    path.write_bytes(b"12345")
    with open_input(path) as file, path.open("ab") as more:
        more.write(b"67")
        more.flush()
        assert file.readall() == b"12345"
        with raises(FormatError, "IO004"):
            file.check()


def test_what_is_read_is_what_was_noted(tmp_path: Path) -> None:
    path = tmp_path / "a"
    path.write_bytes(b"one")
    with recorded_inputs() as inputs:
        read_input(path)
        kept = path.rename(tmp_path / "kept")
        path.write_bytes(b"another")
        read_input(path)
        # It is the first one again: what was read in between was not.
        kept.replace(path)
    with raises(FormatError, "IO004"):
        inputs.check()


def test_rows_are_those_of_the_header(walk: Path, tmp_path: Path) -> None:
    path = tmp_path / "walk.bvh"
    path.write_bytes(walk.read_bytes())
    stream = read_bvh(path)
    path.write_bytes(walk.read_bytes() + b"\n")
    with raises(FormatError, "IO004"):
        next(stream.blocks)


@pytest.mark.skipif(not Path("/proc/self/fd").exists(), reason="none to count by")
def test_what_is_refused_is_closed(tmp_path: Path) -> None:
    (tmp_path / "a").write_bytes(b"one")
    before = len(list(Path("/proc/self/fd").iterdir()))
    for name, limit in (("a", 1), ("b", 1), (".", 1), ("a", 9)):
        try:
            read_input(tmp_path / name, limit)
        except FormatError:
            continue
    assert len(list(Path("/proc/self/fd").iterdir())) == before


@pytest.mark.parametrize(
    ("kind", "names", "meant"),
    [
        ("targets", ["a.clip.yaml", "b.targets.yaml"], "b.targets.yaml"),
        ("clip", ["a.bvh", "a.rig.yaml"], None),
        ("rig", ["a.scene.yaml", "a.bvh", "b.rig.yaml"], "b.rig.yaml"),
        ("rig", ["a.clip.yaml", "b.bvh", "a.sh"], "b.bvh"),
    ],
)
def test_a_folder_names_a_file_of_the_kind(
    tmp_path: Path, kind: str, names: list[str], meant: str | None
) -> None:
    for name in names:
        (tmp_path / name).touch()
    with pytest.raises(FormatError) as caught:
        require_file(tmp_path, kind)
    hint = f"name a {kind} file"
    if meant is not None:
        hint += f" in it, such as {tmp_path / meant}"
    assert (caught.value.code, caught.value.faults[0].hint) == ("IO001", hint)


def test_readers_of_one_kind_name_such_a_file(tmp_path: Path) -> None:
    for name in ("a.scene.yaml", "b.clip.yaml", "c.rig.yaml", "d.targets.yaml"):
        (tmp_path / name).touch()
    loaders = {"b.clip.yaml": Clip.load, "c.rig.yaml": Rig.load}
    loaders["d.targets.yaml"] = load_targets
    for name, load in loaders.items():
        with raises(FormatError, "IO001", match=f"{name}$"):
            load(tmp_path)


def test_a_file_without_permission_has_a_way_on(tmp_path: Path) -> None:
    error = unreadable_error(tmp_path / "a.bvh", PermissionError())
    assert "chmod u+r" in str(error.faults[0].hint)
