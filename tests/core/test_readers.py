"""Every reader in the table keeps what the table promises; so must a plug-in's."""

from __future__ import annotations

import inspect
import os
from dataclasses import fields
from pathlib import Path

import pytest
from support.faults import raises
from support.plugins import install

from animtool.core.errors import AnimtoolError, FormatError, OptionError
from animtool.core.plugins import load_object
from animtool.core.readers import READERS, Reader, find_reader, listed_readers
from animtool.rig.skeleton import Rig
from animtool.scene.sources.open import SourceOptions, open_source
from animtool.validation.run import validate

DISTINCT = sorted(set(READERS.values()), key=lambda reader: reader.about)


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="the system has no named pipes")
def test_what_is_no_file_is_called_what_it_is(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    for name, kind in (
        ("pipe", "is a pipe, not a file"),
        (os.devnull, "is a device, not a file"),
        (".", "is a folder"),
        ("none", "does not exist"),
    ):
        with raises(FormatError, "IO001", match=kind):
            find_reader(tmp_path / name)


@pytest.mark.parametrize("reader", DISTINCT, ids=lambda reader: reader.about)
def test_a_reader_keeps_its_promises(reader: Reader) -> None:
    places = (reader.rig, reader.source, reader.markers)
    assert any(places)
    for place in filter(None, places):
        assert callable(load_object(place))
    takes = inspect.signature(load_object(reader.source or reader.markers)).parameters
    known = {field.name for field in fields(SourceOptions)} | {"progress"}
    assert set(reader.options) <= set(takes) & known


@pytest.mark.parametrize("suffix", READERS)
@pytest.mark.parametrize("text", [None, "", "nothing of the kind"])
def test_what_is_not_of_the_kind(tmp_path: Path, suffix: str, text: str | None) -> None:
    path = tmp_path / f"file{suffix}"
    if text is not None:
        path.write_text(text)
    reader = READERS[suffix]
    openings = {
        reader.rig: Rig.load,
        reader.source: open_source,
        reader.markers: reader.markers and reader.markers_opener(path),
    }
    for opening in (found for place, found in openings.items() if place):
        with pytest.raises(FormatError) as caught:
            opening(path)
        assert caught.value.faults[0].path == str(path)


@pytest.mark.parametrize(
    ("suffix", "given"),
    [
        (".bvh", {"clamp": True}),
        (".bvh", {"prim_path": "/hero"}),
        (".usda", {"clamp": True}),
        (".usda", {"fps": 24}),
        (".yaml", {"up": "Z"}),
    ],
)
def test_an_option_that_a_file_does_not_take(
    tmp_path: Path, suffix: str, given: dict[str, object]
) -> None:
    options = SourceOptions(**given)  # type: ignore[arg-type]
    with pytest.raises(AnimtoolError) as caught:
        open_source(tmp_path / f"file{suffix}", options)
    assert caught.value.code == "CLI004"


def test_a_reader_of_a_plugin(
    tmp_path: Path, walk: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "marks_reader.py").write_text(
        "from animtool.core.readers import Reader\n"
        "from animtool.formats.bvh.read import read_bvh\n"
        "READER = Reader('marks', source='marks_reader:open_marks', options=('fps',))\n"
        "def open_marks(path, fps=None):\n"
        "    return read_bvh(path.read_text(), fps=fps)\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    install(monkeypatch, "animtool.readers", marks="marks_reader:READER")
    path = tmp_path / "walk.marks"
    path.write_text(str(walk))
    assert open_source(path, SourceOptions(fps=24)).fps == 24
    row = listed_readers()[-1]
    assert (row.name, row.uses, row.about) == (".marks", ("source",), "marks")
    with raises(AnimtoolError, "IO002"):
        Rig.load(path)
    # Who cannot be told a unit states that of the rig.
    assert open_source(path).details["units"] == "cm"
    assert validate(path) == []
    path.write_text(str(tmp_path / "none"))
    assert [fault.code for fault in validate(path)] == ["IO001"]
    path = tmp_path / "walk.none"
    path.write_text("")
    with raises(
        OptionError, "IO002", match=r"not a kind of file that is checked.*\.marks"
    ):
        validate(path)


def test_rules_look_at_takes_of_a_plugin(
    tmp_path: Path, walk: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "bvh_marks_reader.py").write_text(
        "from animtool.core.readers import Reader\n"
        "from animtool.formats.bvh.read import read_bvh\n"
        "READER = Reader('marks', source='bvh_marks_reader:read_bvh')\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    install(monkeypatch, "animtool.readers", marks="bvh_marks_reader:READER")
    # A frame in which everything is somewhere else.
    rows = walk.read_text().splitlines()
    rows[-20] = " ".join(f"{float(number) + 60:g}" for number in rows[-20].split())
    found = []
    for name in ("walk.bvh", "walk.marks"):
        path = tmp_path / name
        path.write_text("\n".join(rows))
        found.append({f.code: f.frame for f in validate(path) if f.code[:3] == "MOT"})
    assert found[0] == found[1] != {}


@pytest.mark.parametrize(
    ("place", "why"),
    [("no_such_module:READER", "no_such_module"), ("fractions:Fraction", "no Reader")],
)
def test_a_broken_reader_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, place: str, why: str
) -> None:
    install(monkeypatch, "animtool.readers", marks=place)
    with raises(AnimtoolError, "IO003", match=why):
        find_reader(tmp_path / "walk.marks")
    row = listed_readers()[-1]
    assert not row.uses
    assert why in row.about


def test_a_reader_whose_function_is_missing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(READERS, ".marks", Reader("marks", "no_such_module:open_rig"))
    with raises(AnimtoolError, "IO003", match="no_such_module"):
        Rig.load(tmp_path / "walk.marks")


def test_a_plugin_does_not_replace_what_animtool_reads(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    install(monkeypatch, "animtool.readers", bvh="no_such_module:READER")
    assert find_reader(Path("walk.bvh")) is READERS[".bvh"]
    assert len(listed_readers()) == len(READERS)
