"""Rigs and takes as GLB: what is read back, what the reference validator finds."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from support.cli import animtool
from support.gltf import write_small
from support.gltf_validator import issues

from animtool.clip.clip import Clip
from animtool.core.units import UpAxis
from animtool.formats.gltf.document import Gltf, open_gltf
from animtool.formats.gltf.read import read_gltf
from animtool.motion.reorient import reorient
from animtool.report.compare import compare
from animtool.rig.skeleton import Rig
from animtool.scene.bake.bake import bake
from animtool.scene.bake.options import BakeOptions
from animtool.scene.convert.takes import convert
from animtool.scene.sources.open import SourceOptions, open_source

KINDS = ["plain", "cubic", "sparse", "skins"]


def keys(gltf: Gltf) -> list[object]:
    """Return clips with their keys: names, what moves, how, and when."""
    return [
        (
            one.name,
            [
                (str(track.path), str(track.interpolation), track.times.tolist())
                for track in one.tracks
            ],
        )
        for one in gltf.animations
    ]


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("suffix", [".glb", ".gltf"])
def test_a_file_comes_back(tmp_path: Path, kind: str, suffix: str) -> None:
    source = write_small(tmp_path / "hero.glb", kind)
    output = tmp_path / f"again{suffix}"
    convert(source, output, SourceOptions(prim_path="/"))
    # All clips, their names and keys.
    assert keys(open_gltf(output)) == keys(open_gltf(source))
    for take in open_gltf(source).animations:
        options = SourceOptions(prim_path="/", take=take.name)
        apart = compare(source, output, options)
        assert apart.world.value <= 1e-6
        assert not apart.mismatches
        assert apart.weight.value <= 1e-6
    whole = read_gltf(source, prim_path="/").rig
    again = read_gltf(output, prim_path="/").rig
    assert [mesh.name for mesh in again.meshes] == [mesh.name for mesh in whole.meshes]
    for one, other in zip(whole.meshes, again.meshes, strict=True):
        assert (one.points.load() == other.points.load()).all()
        assert one.skin is not None
        assert other.skin is not None
        np.testing.assert_allclose(one.skin.weights.load(), other.skin.weights.load())
    assert not issues(output)


@pytest.mark.parametrize("kind", KINDS)
def test_by_a_clip_file_keys_are_kept(tmp_path: Path, kind: str) -> None:
    source = write_small(tmp_path / "hero.glb", kind)
    clip, output = tmp_path / "wave.clip.yaml", tmp_path / "back.glb"
    options = SourceOptions(take="wave")
    report = convert(source, clip, options)
    convert(clip, output)
    assert compare(source, output, options, SourceOptions()).world.value <= 1e-4
    (back,) = [one for one in open_gltf(output).animations]
    wave = next(one for one in open_gltf(source).animations if one.name == "wave")
    assert back.name == "wave"
    own = {str(track.path): track.times.tolist() for track in back.tracks}
    for track in wave.tracks:
        times = track.times.tolist()
        if kind == "cubic" and track.path == "rotation":
            assert {notice.code for notice in report.notices} >= {"GLT118"}
            assert set(times) <= {round(time, 6) for time in own["rotation"]}
        else:
            assert own[str(track.path)] == times


def test_a_clip_keeps_its_keys(tmp_path: Path) -> None:
    source = write_small(tmp_path / "hero.glb", "cubic")
    path = tmp_path / "wave.clip.yaml"
    convert(source, path)
    clip = Clip.load(path)
    channels = {channel.target: channel for channel in clip.channels}
    hips = channels["joint/hips.local_translation"]
    assert hips.times.tolist() == [0, 12, 24]
    assert str(hips.interps[0]) == "bezier"
    assert "shape/a" in channels
    rig = Rig.load(tmp_path / "wave.rig.yaml")
    assert rig.meshes[0].skin is not None


def test_several_takes_become_one_file_and_a_library(tmp_path: Path) -> None:
    source = write_small(tmp_path / "hero.glb")
    library = tmp_path / "hero.usda"
    done = animtool("bake", source, "-o", library, "--as", "library")
    assert done.code == 0, done.stderr
    names = {"wave", "nod"}
    assert set(open_source(library).details["takes"]) == names  # type: ignore[call-overload]
    for name in names:
        options = SourceOptions(take=name)
        assert compare(source, library, options).world.value <= 1e-6
    one, two = tmp_path / "one.glb", tmp_path / "two.glb"
    for output, name in ((one, "wave"), (two, "nod")):
        assert animtool("bake", source, "--take", name, "-o", output).code == 0
    both = tmp_path / "both.glb"
    assert animtool("bake", one, two, "-o", both).code == 0
    assert [clip.name for clip in open_gltf(both).animations] == ["wave", "nod"]
    assert not issues(both)


def test_a_folder_gets_a_file_of_each_clip(tmp_path: Path) -> None:
    source = write_small(tmp_path / "hero.glb")
    done = animtool("convert", source, tmp_path / "out")
    assert done.code == 0, done.stderr
    files = sorted(path.name for path in (tmp_path / "out").iterdir())
    assert files == ["nod.usdc", "wave.usdc"]
    options = SourceOptions(take="nod")
    other = SourceOptions()
    apart = compare(source, tmp_path / "out/nod.usdc", options, other)
    assert apart.world.value <= 1e-6


def test_a_bvh_and_a_rig_with_z_up(tmp_path: Path, walk: Path) -> None:
    output = tmp_path / "walk.glb"
    done = animtool("bake", walk, "-o", output)
    assert done.code == 0, done.stderr
    stream = reorient(open_source(walk), UpAxis.Z)
    assert compare(walk, output).world.value <= 1e-5
    # Rates and first frames are kept beside the keys.
    back = read_gltf(output)
    assert (back.fps, back.start) == (stream.fps, 1)
    assert not issues(output)


def test_fewer_keys_within_a_tolerance(tmp_path: Path, walk: Path) -> None:
    whole, few = tmp_path / "whole.glb", tmp_path / "few.glb"
    assert animtool("convert", walk, whole).code == 0
    assert animtool("convert", walk, few, "--reduce", "1mm").code == 0
    counts = [
        sum(len(track.times) for track in open_gltf(path).animations[0].tracks)
        for path in (few, whole)
    ]
    assert counts[0] < 0.75 * counts[1]
    assert compare(whole, few).world.value <= 1e-2
    assert not issues(few)


def test_the_same_bytes_on_every_run(tmp_path: Path) -> None:
    source = write_small(tmp_path / "hero.glb", "cubic")
    files = [tmp_path / "a.glb", tmp_path / "b.glb"]
    for file in files:
        convert(source, file)
    assert files[0].read_bytes() == files[1].read_bytes()


def test_a_sidecar_rig_takes_its_joints_from_a_glb(tmp_path: Path) -> None:
    write_small(tmp_path / "hero.glb")
    (tmp_path / "hero.rig.yaml").write_text(
        "rig: animtool/1\nname: hero\nfrom: hero.glb\n"
        "controls: [{name: grin, drives: [{shape: a, expr: grin}]}]\n"
    )
    rig = Rig.load(tmp_path / "hero.rig.yaml")
    assert rig.names == ["hips", "chest", "head"]
    assert [mesh.name for mesh in rig.meshes] == ["body"]
    assert [control.name for control in rig.controls] == ["grin"]


def test_names_that_were_changed_are_written_back(tmp_path: Path) -> None:
    source = write_small(tmp_path / "two.glb", "skins")
    output = tmp_path / "again.glb"
    convert(source, output, SourceOptions(prim_path="/"))
    nodes = json.loads(json.dumps(open_gltf(output).json_root.values["nodes"]))
    renamed = [node for node in nodes if "extras" in node]
    assert [node["name"] for node in renamed] == ["hips"]
    assert renamed[0]["extras"]["animtool"]["name"] == "hips_2"


def test_a_character_in_usd_brings_its_meshes(tmp_path: Path) -> None:
    source = write_small(tmp_path / "hero.glb", "plain")
    stage, output = tmp_path / "hero.usdc", tmp_path / "again.glb"
    bake(source, stage, BakeOptions(source=SourceOptions(prim_path="/")))
    convert(stage, output)
    whole = read_gltf(source, prim_path="/").rig.meshes
    again = read_gltf(output, prim_path="/").rig.meshes
    assert len(whole) == len(again) > 0
    for one, other in zip(whole, again, strict=True):
        # USD has points in float32, as glTF does.
        assert np.array_equal(one.points.load(), other.points.load())
        assert one.skin is not None
        assert other.skin is not None
        weights = one.skin.weights.load(), other.skin.weights.load()
        assert np.abs(weights[0] - weights[1]).max() <= 1e-6


def test_shapes_that_an_animation_does_not_hold_come_along(
    tmp_path: Path, root: Path
) -> None:
    source = root / "samples/fox/fox.glb"
    stage, output = tmp_path / "fox.usdc", tmp_path / "again.glb"
    options = SourceOptions(take="trot")
    bake(source, stage, BakeOptions(source=options))
    convert(stage, output)
    assert len(open_source(stage).rig.shapes) < len(read_gltf(source).rig.shapes)
    assert len(read_gltf(output).rig.shapes) == len(read_gltf(source).rig.shapes)
    assert animtool("diff", source, output, "--take-a", "trot").code == 0
