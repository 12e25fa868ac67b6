"""Names that files of others state: none leads out of the folder of the outputs."""

from __future__ import annotations

import json
import unicodedata
from collections.abc import Callable
from pathlib import Path

import pytest
from support.batch import take_files
from support.bvh import random_rows, small_bvh
from support.cli import Done, animtool

FAULTS = "fault | what happened | what was lost"
Record = Callable[[str, object], None]


@pytest.fixture
def show(disk: Path) -> Path:
    """Return a project in a folder that nothing else may be in."""
    folder = disk / "work" / "show"
    take_files(folder, 1)
    (folder / "animtool.toml").touch()
    return folder


def refused(show: Path, code: str, *arguments: object) -> Done:
    """Run a command that writes nothing, neither in the project nor out of it."""
    before = sorted((show.parent.parent).rglob("*"))
    done = animtool(*arguments, cwd=show)
    assert done.code in {2, 3}, done.stderr
    assert code in done.stderr
    assert sorted((show.parent.parent).rglob("*")) == before
    return done


UNSAFE = {
    "up": "../../evil",
    "a folder": "..",
    "a path": "/tmp/evil",
    "a separator": "a/b",
    "another separator": "a\\b",
    "nothing": "",
    "a device": "AUX",
    "a space at its end": "a ",
    "too long": "n" * 256,
    "a record": ".animtool",
    "a control character": "a\x07b",
}


def timeline(show: Path, clip: str) -> None:
    """Write a timeline of one clip, as its file is whatever writes it."""
    import opentimelineio as otio

    rate = otio.opentime.RationalTime
    span = otio.opentime.TimeRange(rate(0, 30), rate(3, 30))
    media = otio.schema.ExternalReference("take000.bvh", span)
    track = otio.schema.Track("V1", [otio.schema.Clip(clip, media, span)])
    made = otio.schema.Timeline("edit", None, None)
    made.tracks.append(track)
    (show / "edit.otio").write_text(otio.adapters.write_to_string(made), "utf-8")


@pytest.mark.parametrize("name", UNSAFE)
def test_a_clip_of_a_cut_list(name: str, show: Path, record_property: Record) -> None:
    timeline(show, UNSAFE[name])
    cut = ("batch", "--cut", "edit.otio")
    done = refused(show, "OUT006", *cut, "-o", "out/{clip}/o.usdc")
    assert "edit.otio" in done.stderr
    scene = "scene: animtool/1\nsource: {file: '${input}'}\noutput: {file: '%s'}\n"
    (show / "s.scene.yaml").write_text(scene % "out/${clip}/o.usdc", "utf-8")
    refused(show, "OUT006", *cut, "--scene", "s.scene.yaml")
    # What is made of it is no other.
    lines = scene.replace("source", "variables: {v: '${clip}'}\nsource")
    (show / "s.scene.yaml").write_text(lines % "out/${v}/o.usdc", "utf-8")
    refused(show, "OUT006", *cut, "--scene", "s.scene.yaml")
    if name == "up":
        row = f"a clip of a cut list has one of {len(UNSAFE)} unsafe names"
        record_property(FAULTS, f"{row} | OUT006 | nothing")


def test_a_shot_is_always_legal(show: Path) -> None:
    timeline(show, "../../evil")
    done = animtool("batch", "--cut", "edit.otio", "-o", "out/{shot}/o.usdc", cwd=show)
    assert done.code == 0, done.stderr
    assert [path.parent.name for path in show.rglob("*.usdc")] == ["evil"]


def test_the_stem_of_an_input(show: Path) -> None:
    (show / "...bvh").write_text(small_bvh(random_rows(4)), "utf-8")
    refused(show, "OUT006", "batch", "...bvh", "-o", "out/{stem}/o.usdc")


def test_a_variable(show: Path) -> None:
    words = ("batch", "take000.bvh", "-o", "out/{v}/o.usdc")
    refused(show, "OUT006", *words, "--set", "v=../../evil")
    # Folders are no way out.
    done = animtool(*words, "--set", "v=s01/e02", cwd=show)
    assert done.code == 0, done.stderr
    assert (show / "out/s01/e02/o.usdc").exists()


def test_a_link_in_the_folder_of_the_outputs(show: Path) -> None:
    (show / "out").mkdir()
    (show / "out/take000").symlink_to(show.parent.parent)
    done = refused(show, "OUT006", "batch", "take000.bvh", "-o", "out/{stem}/o.usdc")
    assert "link" in done.stderr


def test_a_batch_file(show: Path, disk: Path, record_property: Record) -> None:
    (show / "j.batch.yaml").write_text(
        "batch: animtool/1\ninputs: [take000.bvh]\noutput: ../../evil/{stem}.usdc\n"
    )
    refused(show, "DOC014", "batch", "j.batch.yaml")
    refused(show, "DOC014", "job", "j.batch.yaml", "-o", "job")
    # What a user types may go anywhere.
    done = animtool("batch", "j.batch.yaml", "-o", disk / "made/{stem}.usdc", cwd=show)
    assert done.code == 0, done.stderr
    assert (disk / "made/take000.usdc").exists()
    record_property(FAULTS, "a batch file states ../../evil | DOC014 | nothing")


def test_states_that_a_pass_saves(show: Path) -> None:
    (show / "s.scene.yaml").write_text(
        "scene: animtool/1\nsource: {file: take000.bvh}\npasses:\n"
        "- simulate: {save: ../../evil.npz, save_at: [1]}\noutput: {file: o.usdc}\n"
    )
    refused(show, "DOC014", "bake", "s.scene.yaml")


def test_a_key_of_weights_is_no_path(show: Path) -> None:
    from animtool.validation.fixes.draft import NotFixedError
    from animtool.validation.fixes.texts import _unused_path

    with pytest.raises(NotFixedError):
        _unused_path(show / "body.npz", "../../evil")


@pytest.mark.parametrize("form", ["NFC", "case"])
def test_two_outputs_that_are_one_file_on_some_disks(
    form: str, show: Path, record_property: Record
) -> None:
    names = ["\u00e9", unicodedata.normalize("NFD", "\u00e9")]
    if form == "case":
        names = ["walk", "WALK"]
    (show / "takes").mkdir()
    for name in names:
        (show / f"takes/{name}.bvh").write_text(small_bvh(random_rows(4)), "utf-8")
    if len(list((show / "takes").iterdir())) < 2:
        reason = "this disk takes the two for one"
        pytest.skip(reason)
    refused(show, "OUT007", "batch", "takes", "-o", "out/{stem}.usdc")
    entries = json.dumps([{"file": f"{name}.usda"} for name in names])
    scene = f"scene: animtool/1\nsource: {{file: take000.bvh}}\noutput: {entries}\n"
    (show / "s.scene.yaml").write_text(scene, "utf-8")
    refused(show, "OUT007", "bake", "s.scene.yaml")
    record_property(FAULTS, f"outputs that differ in {form} | OUT007, OUT007 | nothing")
