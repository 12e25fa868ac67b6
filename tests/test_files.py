"""Names, folders and globs as files."""

from __future__ import annotations

from pathlib import Path

import pytest

from animtool.files import files_meant, nearest_file, unreadable


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
        (file.path.relative_to(folder).as_posix(), file.base.relative_to(folder).name)
        for file in files_meant(str(folder / text), [".bvh"])
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
        ("A.bvh", None if Path(__file__.upper()).exists() else "a.bvh"),
        ("x/y/dd.bvh", "x/y/d.bvh"),
        ("x/y/other.usda", None),
        ("xx/../b.bvh", None),
        ("a.bvh", None),
    ],
)
def test_the_nearest_file(tree: Path, name: str, meant: str | None) -> None:
    hint = nearest_file(Path(name), tree)
    assert hint == (meant and f"did you mean {meant!r}?")


def test_the_nearest_folder(tree: Path) -> None:
    (tree / "takes").mkdir()
    hint = nearest_file(tree / "take/a.bvh")
    assert hint == f"did you mean the folder {(tree / 'takes').as_posix()!r}?"


def test_every_file_that_is_missing_has_the_nearest_name(tree: Path) -> None:
    error = unreadable(tree / "bb.bvh", "does not exist")
    assert error.code == "IO001"
    assert "b.bvh" in str(error.faults[0].hint)
