"""Every writer in the table is one of `bake`, `convert`, scenes and batches alike."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest
from support.cli import animtool
from support.plugins import install

from animtool.core.errors import AnimtoolError, OptionError
from animtool.core.plugins import load_object
from animtool.core.writers import (
    WRITERS,
    Writer,
    listed_writers,
    marker_writer,
    take_writer,
    writer_of,
)

# Of the formats that hold joints; a recording of a face holds shapes alone.
JOINTS = [
    ".clip.yaml" if suffix == ".yaml" else suffix
    for suffix, writer in WRITERS.items()
    if (writer.stage or "joints" in writer.holds) and suffix != ".yml"
]


@pytest.fixture
def folder(walk: Path, tmp_path: Path) -> Path:
    shutil.copy(walk, tmp_path / "walk.bvh")
    return tmp_path


@pytest.mark.parametrize(
    "writer", dict.fromkeys(WRITERS.values()), ids=lambda one: one.name
)
def test_a_writer_keeps_its_promises(writer: Writer) -> None:
    places = (writer.take, writer.text, writer.markers, writer.rig)
    assert writer.stage or any(places)
    for place in filter(None, places):
        assert callable(load_object(place))


@pytest.mark.slow
@pytest.mark.parametrize("suffix", JOINTS)
def test_every_way_writes_the_same(suffix: str, folder: Path) -> None:
    source = folder / "walk.bvh"
    scene = folder / "s.scene.yaml"
    made = folder / "made"
    made.mkdir()
    files = [made / kind / f"walk{suffix}" for kind in ("bake", "convert", "scene")]
    files.append(made / "batch" / f"walk{suffix}")
    for path in files:
        path.parent.mkdir()
    text = "scene: animtool/1\nsource: {file: walk.bvh, units: cm}\n"
    scene.write_text(f"{text}output: {{file: {files[2]}}}\n")
    (folder / "animtool.toml").touch()
    for done in (
        animtool("bake", source, "-o", files[0]),
        animtool("convert", source, files[1]),
        animtool("bake", scene),
        animtool("batch", source, "-o", made / "batch" / f"{{stem}}{suffix}"),
    ):
        assert done.code == 0, done.stderr
    first = files[0].read_bytes()
    if suffix != ".usdz":  # a zip file states its date
        assert [path.read_bytes() == first for path in files] == [True] * 4
    else:
        assert all(path.stat().st_size for path in files)


def test_options_of_usd_are_refused_elsewhere(folder: Path) -> None:
    out = folder / "o.bvh"
    for options, code in (
        (("--deform",), "CLI002"),
        (("--to-up", "Z"), "CLI002"),
        (("--reduce", "1mm"), "CLI004"),
    ):
        done = animtool("bake", folder / "walk.bvh", "-o", out, *options)
        assert (done.code, code in done.stderr) == (2, True), done.stderr
    clip = folder / "o.clip.yaml"
    done = animtool("bake", folder / "walk.bvh", "-o", clip, "--reduce", "1mm")
    assert done.code == 0, done.stderr


def test_a_range_and_a_rate_are_those_of_every_format(folder: Path) -> None:
    sizes = {}
    for suffix in (".bvh", ".mot"):
        out = folder / f"o{suffix}"
        options = ("--fps", "15", "--range", "3-10")
        done = animtool("bake", folder / "walk.bvh", "-o", out, *options)
        assert done.code == 0, done.stderr
        sizes[suffix] = [line for line in out.read_text().splitlines() if line.strip()]
    assert "Frames: 8" in sizes[".bvh"]
    assert "nRows=8" in sizes[".mot"]


def test_what_is_simulated_has_no_place(folder: Path) -> None:
    path = folder / "s.scene.yaml"
    path.write_text(
        "scene: animtool/1\nrange: [1, 3]\noutput: {file: o.mot}\n"
        "systems:\n- rain: {kind: particles, spawn: {box: {size: [1, 1, 1]}}}\n"
    )
    done = animtool("bake", path)
    assert done.code != 0
    assert not (folder / "o.mot").exists()


@pytest.mark.parametrize(
    "name", ["a", "a.txt", "a.rig.yaml", "a.map.yml", "a.c3d", "a.npz", ""]
)
def test_names_of_what_holds_no_motion(name: str, tmp_path: Path) -> None:
    with pytest.raises(OptionError) as caught:
        take_writer(tmp_path / name)
    assert caught.value.code == "OUT004"


def test_names_of_what_holds_no_markers(tmp_path: Path) -> None:
    with pytest.raises(OptionError) as caught:
        marker_writer(tmp_path / "a.bvh")
    assert caught.value.code == "OUT004"


def test_a_writer_of_a_plugin(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (folder / "count_writer.py").write_text(
        "from animtool.core.writers import Writer\n"
        "from animtool.formats.take_text import TakeText\n"
        "WRITER = Writer('count', 'how many', text='count_writer:text')\n"
        "def text(take):\n"
        "    return TakeText([str(take.clock.count)], iter(()), [])\n"
    )
    monkeypatch.syspath_prepend(folder)
    install(
        monkeypatch,
        "animtool.writers",
        count="count_writer:WRITER",
        bvh="no_such_module:WRITER",
    )
    assert writer_of(Path("walk.bvh")) is WRITERS[".bvh"]
    done = animtool("bake", folder / "walk.bvh", "-o", folder / "walk.count")
    assert done.code == 0, done.stderr
    assert (folder / "walk.count").read_text() == "64\n"
    row = listed_writers()[-1]
    assert (row.name, row.uses, row.about) == (".count", ("motion",), "how many")


def test_a_broken_writer_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    install(monkeypatch, "animtool.writers", marks="no_such_module:WRITER")
    with pytest.raises(AnimtoolError) as caught:
        take_writer(tmp_path / "walk.marks")
    assert caught.value.code == "IO003"
    row = listed_writers()[-1]
    assert (row.name, row.uses) == (".marks", ())
