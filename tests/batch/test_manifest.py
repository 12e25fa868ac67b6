"""What was made is read as it was written."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from animtool.batch.manifest import (
    FileRecord,
    ItemRecord,
    Manifest,
    ManifestWriter,
    read_manifest,
    rewrite_manifest,
)
from animtool.batch.spec import path_of_name, relative_name
from animtool.core.files.reading import FileState
from animtool.core.values import plain_value

SHARED = FileRecord("../rig.yaml", FileState(3, 4, 5), "ab")
ABSENT = FileRecord("../animtool.toml", None)


def item(number: int, at: int = 1) -> ItemRecord:
    own = FileRecord(f"../take{number}.bvh", FileState(number, 2, 3), "cd")
    output = FileRecord(f"{number}.usdc", FileState(9, 9, 9), "ef")
    return ItemRecord(
        f"{number}.usdc", "how", "versions", (ABSENT, SHARED, own), (output,), at
    )


def test_items_come_back(tmp_path: Path) -> None:
    path = tmp_path / "a.jsonl"
    with ManifestWriter(path, Manifest()) as writer:
        writer.add_names(["1.usdc", "2.usdc"])
        writer.add(item(1))
    first = read_manifest(path)
    with ManifestWriter(path, first) as writer:
        writer.add(item(2))
    found = read_manifest(path)
    assert found.items == {"1.usdc": item(1), "2.usdc": item(2)}
    assert found.known_names == {"1.usdc", "2.usdc"}
    # What both were made of stands there once.
    assert path.read_text().count("rig.yaml") == 1


def test_the_younger_of_two_counts() -> None:
    manifest, other = Manifest(), Manifest()
    manifest.add(item(1, at=5))
    other.add(item(1, at=4))
    other.add(item(2))
    manifest.merge(other)
    assert manifest.items == {"1.usdc": item(1, at=5), "2.usdc": item(2)}


def test_writing_again_keeps_what_was_begun(tmp_path: Path) -> None:
    path = tmp_path / "a.jsonl"
    rewrite_manifest(path, [item(1)], ["begun.usdc"])
    found = read_manifest(path)
    assert found.known_names == {"1.usdc", "begun.usdc"}
    assert list(found.items) == ["1.usdc"]


FILE = '{"file":0,"path":"a","size":1,"changed":2,"inode":3,"sha256":"ab"}'
MADE = (
    '{"item":"a","how":"h","versions":"v","inputs":[0],'
    '"outputs":[{"path":"o","size":1,"changed":2,"inode":3,"sha256":"cd"}],"at":4,'
    '"scores":[{"pass":"p","where":"w","scores":[{"name":"drift","value":0.5,'
    '"unit":"m","usual":1,"ideal":0}],"names":{"lost":["a"]}}]}'
)


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("", ""),
        ('"item":"a"', '"item":["a"]'),
        ('"item":"a"', '"item":"a\\u0000"'),
        ('"how":"h",', ""),
        ('"versions":"v"', '"versions":{}'),
        ("[0]", "[1]"),
        ("[0]", "[true]"),
        ("[0]", "[0.0]"),
        ("[0]", "[]"),
        ("[0]", "{}"),
        ('"at":4', '"at":4.0'),
        ('"at":4', f'"at":{10**30}'),
        ('"at":4', '"at":true'),
        ('[{"path":"o"', '["o",{"path":"o"'),
        ('"changed":2,"inode":3,"sha256":"cd"', '"changed":null'),
        ('"size":1', '"size":-1'),
        ('"path":"o",', '"path":"o","absent":1,'),
        ('"path":"o",', '"path":"o","absent":true,'),
        ('"item":"a"', '"made":"a"'),
        ('"item":"a"', '"known":[1],"item":"a"'),
        ('"scores":[{"p', '"scores":{},"x":[{"p'),
        ('"scores":[{"name"', '"scores":[],"x":[{"name"'),
        ('"value":0.5', '"value":null'),
        ('"value":0.5', '"value":1e999'),
        ('"unit":"m"', '"unit":"km"'),
        ('"usual":1', '"usual":0'),
        ('["a"]', '"a"'),
        ('"where":"w",', ""),
    ],
)
def test_lines_that_are_damaged_are_left_out(
    tmp_path: Path, old: str, new: str
) -> None:
    path = tmp_path / "a.jsonl"
    line = MADE.replace(old, new, 1) if old else MADE
    path.write_text(f'{{"manifest":"animtool/1"}}\n{FILE}\n{line}\n')
    found = read_manifest(path)
    assert list(found.items) == ([] if old else ["a"])
    if not old:
        (own,) = found.items["a"].scores
        assert plain_value(own) == json.loads(line)["scores"][0]
    assert [notice.code for notice in found.damage_warnings] == (
        ["BAT070"] if old else []
    )
    assert not found.known_names - {"o"}


def test_a_number_of_two_files_is_of_none(tmp_path: Path) -> None:
    path = tmp_path / "a.jsonl"
    other = FILE.replace('"path":"a"', '"path":"b"')
    text = "\n".join(['{"manifest":"animtool/1"}', FILE, MADE, other, MADE, ""])
    path.write_text(text)
    found = read_manifest(path)
    # Before the second, the number meant the first.
    assert list(found.items) == ["a"]
    assert found.damage_warnings[0].lines == (4, 5)
    assert (found.file_numbers, found.next_number) == ({}, 1)


def test_a_damaged_item_may_be_made_again(tmp_path: Path) -> None:
    path = tmp_path / "a.jsonl"
    rewrite_manifest(path, [item(1)], ["1.usdc"])
    lines = path.read_bytes().splitlines(keepends=True)
    path.write_bytes(b"".join(lines[:-1]) + lines[-1].replace(b"how", b"hov"))
    found = read_manifest(path)
    assert (found.items, found.known_names) == ({}, {"1.usdc"})
    assert len(found.damage_warnings) == 1


def test_a_name_that_leads_above_everything() -> None:
    assert path_of_name("../" * 9 + "a", Path("/job/out")) == Path("/a")


NAMES = st.lists(st.sampled_from(["a", "b", "c d"]), max_size=5).map("/".join)


@given(NAMES, NAMES)
def test_names_lead_back(name: str, root: str) -> None:
    path, folder = Path("/job", name), Path("/job", root)
    assert path_of_name(relative_name(path, folder), folder) == path


@pytest.mark.parametrize(
    ("path", "root"),
    [("/job/../a", "/job/out"), ("/other/a", "/job/out"), ("/a", "/job/../b")],
)
def test_names_that_stay_whole(path: str, root: str) -> None:
    assert relative_name(Path(path), Path(root)) == path
