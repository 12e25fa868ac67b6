"""What work looked at is noted, whatever reads it."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from animtool import BakeOptions, bake
from animtool.core.errors import FormatError
from animtool.core.files.output import replacement_path
from animtool.core.files.reading import (
    FileState,
    RecordedInputs,
    record_input,
    recorded_inputs,
)
from animtool.rig.file import load_rig
from animtool.scene.bake.progress import prefetch
from animtool.scene.file.read import load_scene


def names(inputs: RecordedInputs, folder: Path) -> set[str]:
    """Return the files below a folder that are there and were looked at."""
    return {
        path.relative_to(folder).as_posix()
        for path, state in inputs.states.items()
        if state is not None and path.is_relative_to(folder)
    }


def test_nothing_is_noted_without_a_record(tmp_path: Path) -> None:
    record_input(tmp_path / "a")
    with recorded_inputs() as inputs:
        record_input(tmp_path / "b")
    record_input(tmp_path / "c")
    assert list(inputs.states) == [tmp_path / "b"]
    assert inputs.states[tmp_path / "b"] is None


def test_a_record_reaches_into_threads_that_read_ahead(tmp_path: Path) -> None:
    def items() -> object:
        record_input(tmp_path / "ahead")
        yield 1

    with recorded_inputs() as inputs:
        assert list(prefetch(items())) == [1]  # type: ignore[arg-type]
    assert tmp_path / "ahead" in inputs.states


def test_a_clip_its_rig_and_arrays_are_noted(workplace: Path) -> None:
    clip = workplace / "samples/speech/speech.clip.yaml"
    with recorded_inputs() as inputs:
        bake(clip, workplace / "o.usdc")
    found = names(inputs, workplace)
    assert {"samples/speech/speech.clip.yaml", "rigs/head/head.rig.yaml"} <= found
    assert any(name.endswith(".npz") for name in found)
    assert "animtool.toml" in found
    # Settings nearer than those that are there would take their place.
    assert inputs.states[workplace / "samples/speech/animtool.toml"] is None
    assert "o.usdc" not in found


def test_a_scene_with_targets_is_noted(workplace: Path) -> None:
    with recorded_inputs() as inputs:
        scene = load_scene(workplace / "samples/stride/rail.scene.yaml")
        bake(scene, workplace / "o.usdc")
    assert {
        "samples/stride/rail.scene.yaml",
        "samples/stride/stride.clip.yaml",
        "samples/stride/rail.targets.yaml",
        "rigs/biped/biped.rig.yaml",
    } <= names(inputs, workplace)


def test_a_capture_that_is_a_rig_is_noted(walk: Path, tmp_path: Path) -> None:
    (tmp_path / "walk.bvh").write_bytes(walk.read_bytes())
    sidecar = tmp_path / "walk.rig.yaml"
    sidecar.write_text("rig: animtool/1\nname: walk\nfrom: walk.bvh\n")
    with recorded_inputs() as inputs:
        load_rig(sidecar)
    assert {"walk.bvh", "walk.rig.yaml"} <= names(inputs, tmp_path)


def test_every_layer_of_a_rig_is_noted(walk: Path, tmp_path: Path) -> None:
    bake(walk, tmp_path / "hero.usda", BakeOptions(form="split"))
    text = "#usda 1.0\n(subLayers = [@./hero.usda@, @./late.usda@])\n"
    (tmp_path / "shot.usda").write_text(text)
    with recorded_inputs() as inputs:
        layer = BakeOptions(rig_layer=tmp_path / "shot.usda")
        bake(walk, tmp_path / "o.usdc", layer)
    assert {"shot.usda", "hero.usda", "hero.rig.usda", "hero.anim.usdc"} <= names(
        inputs, tmp_path
    )
    assert inputs.states[tmp_path / "late.usda"] is None


def test_what_changed_meanwhile_replaces_nothing(tmp_path: Path) -> None:
    source, output = tmp_path / "source", tmp_path / "output"
    source.write_text("one")
    output.write_text("before")

    def make() -> None:
        with recorded_inputs(), replacement_path(output) as temporary:
            record_input(source)
            temporary.write_text("after")
            os.utime(source, ns=(1, 1))

    with pytest.raises(FormatError) as error:
        make()
    assert error.value.code == "IO004"
    assert error.value.faults[0].path == str(source)
    assert output.read_text() == "before"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["output", "source"]


def test_states_tell_files_apart(tmp_path: Path) -> None:
    path = tmp_path / "a"
    assert FileState.of(path) is None
    path.write_text("one")
    first = FileState.of(path)
    assert FileState.of(path) == first
    path.write_text("two!")
    assert FileState.of(path) != first


def test_records_inside_of_others_are_theirs_too(tmp_path: Path) -> None:
    with recorded_inputs() as outer:
        record_input(tmp_path / "a")
        with recorded_inputs() as inner:
            record_input(tmp_path / "b")
        record_input(tmp_path / "c")
    assert list(inner.states) == [tmp_path / "b"]
    assert [path.name for path in outer.states] == ["a", "b", "c"]


def test_a_layer_that_a_file_brings_in_is_not_opened_itself(tmp_path: Path) -> None:
    shot, layer = tmp_path / "shot", tmp_path / "layer"
    with recorded_inputs() as inputs:
        record_input(layer, is_composed=True)
        record_input(shot)
        record_input(shot, is_composed=True)
    assert set(inputs.states) == {shot, layer}
    assert inputs.opened_paths == {shot}
