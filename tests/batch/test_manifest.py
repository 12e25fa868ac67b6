"""What was made is read as it was written."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from animtool.batch.manifest import (
    Manifest,
    ManifestWriter,
    read_manifest,
    rewrite_manifest,
)
from animtool.batch.places import named_from, place_of
from animtool.batch.records import FileRecord, ItemRecord
from animtool.errors import FormatError
from animtool.inputs import FileState

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
        writer.claim(["1.usdc", "2.usdc"])
        writer.add(item(1))
    first = read_manifest(path)
    with ManifestWriter(path, first) as writer:
        writer.add(item(2))
    found = read_manifest(path)
    assert found.items == {"1.usdc": item(1), "2.usdc": item(2)}
    assert found.known == {"1.usdc", "2.usdc"}
    # What both were made of stands there once.
    assert path.read_text().count("rig.yaml") == 1


def test_the_younger_of_two_counts() -> None:
    manifest, other = Manifest(), Manifest()
    manifest.add(item(1, at=5))
    other.add(item(1, at=4))
    other.add(item(2))
    manifest.join(other)
    assert manifest.items == {"1.usdc": item(1, at=5), "2.usdc": item(2)}


def test_writing_anew_keeps_what_was_begun(tmp_path: Path) -> None:
    path = tmp_path / "a.jsonl"
    rewrite_manifest(path, [item(1)], ["begun.usdc"])
    found = read_manifest(path)
    assert found.known == {"1.usdc", "begun.usdc"}
    assert list(found.items) == ["1.usdc"]


def test_lines_of_something_else(tmp_path: Path) -> None:
    path = tmp_path / "a.jsonl"
    path.write_text('{"manifest":"animtool/1"}\n{"item":"a"}\n')
    with pytest.raises(FormatError) as error:
        read_manifest(path)
    assert error.value.code == "BAT011"


NAMES = st.lists(st.sampled_from(["a", "b", "c d"]), max_size=5).map("/".join)


@given(NAMES, NAMES)
def test_names_lead_back(name: str, root: str) -> None:
    path, folder = Path("/job", name), Path("/job", root)
    assert place_of(named_from(path, folder), folder) == path


@pytest.mark.parametrize(
    ("path", "root"),
    [("/job/../a", "/job/out"), ("/other/a", "/job/out"), ("/a", "/job/../b")],
)
def test_names_that_stay_whole(path: str, root: str) -> None:
    assert named_from(Path(path), Path(root)) == path
