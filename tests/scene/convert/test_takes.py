"""Takes as keys: of additive takes, measured on what they are put on."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest
from support.cli import animtool

from animtool.clip.reduction.points import SHELL_DISTANCE, attached_points, point_errors
from animtool.core.errors import OptionError
from animtool.rig.file import load_rig
from animtool.scene.bake.bake import bake
from animtool.scene.convert.takes import convert
from animtool.scene.file.read import load_scene
from animtool.scene.sources.open import open_source

TOLERANCE = 2e-3


@pytest.fixture
def delta(walk: Path, tmp_path: Path) -> Path:
    """What the walk has beyond its first frame, as USD."""
    (tmp_path / "walk.bvh").write_bytes(walk.read_bytes())
    scene = tmp_path / "delta.scene.yaml"
    scene.write_text(
        "scene: animtool/1\nsource: {file: walk.bvh}\n"
        "passes: [{difference: {base: walk.bvh, frame: 1}}]\n"
    )
    bake(scene, tmp_path / "delta.usdc")
    return tmp_path / "delta.usdc"


def test_additive_keys_give_the_sum_within_the_tolerance(
    walk: Path, delta: Path, tmp_path: Path
) -> None:
    scene = tmp_path / "still.scene.yaml"
    scene.write_text(
        "scene: animtool/1\nsource: {file: walk.bvh}\n"
        "passes: [{time_warp: {curve: [[1, 1], [64, 1]]}}]\n"
    )
    bake(scene, tmp_path / "still.usdc")
    report = convert(
        delta,
        tmp_path / "add.clip.yaml",
        reduce=TOLERANCE,
        base=tmp_path / "still.usdc",
    )
    assert report.reduction is not None
    assert report.reduction.held
    assert report.reduction.keys < report.reduction.samples / 2
    scene.write_text(
        "scene: animtool/1\nsource: {file: still.usdc}\n"
        "passes: [{layer: {take: add.clip.yaml, mode: additive}}]\n"
    )
    summed = load_scene(scene).open().collect()
    wanted = open_source(walk).collect()
    points = attached_points(wanted.rig, SHELL_DISTANCE)
    errors = point_errors(points, wanted.world(), summed.world())
    # Samples of USD are float32.
    assert errors.max() <= TOLERANCE + 1e-5
    assert errors.max() > TOLERANCE / 10


def test_an_additive_take_rests_where_nothing_changes(
    delta: Path, tmp_path: Path
) -> None:
    convert(delta, tmp_path / "add.clip.yaml", base=tmp_path / "walk.bvh")
    take = open_source(tmp_path / "add.clip.yaml").collect()
    assert not take.rig.rest_translations.any()
    first = take.motion.select(slice(0, 1)).dense()[0]
    np.testing.assert_allclose(first, 0, atol=2e-3)


@pytest.mark.parametrize("suffix", ["bvh", "usdc"])
@pytest.mark.parametrize(
    "options", [{"reduce": 1e-3}, {"reduce_at": (("Hips", 1e-3),)}, {"base": Path("x")}]
)
def test_options_of_keys_are_for_clips(
    walk: Path, tmp_path: Path, suffix: str, options
) -> None:
    with pytest.raises(OptionError) as caught:
        convert(walk, tmp_path / f"o.{suffix}", **options)
    assert [fault.code for fault in caught.value.faults] == ["CLI004"]
    assert not list(tmp_path.iterdir())


def test_the_base_has_the_same_joints(walk: Path, tmp_path: Path) -> None:
    rig = tmp_path / "post.rig.yaml"
    rig.write_text("rig: animtool/1\nname: post\njoints: [{name: top, type: free}]\n")
    clip = tmp_path / "post.clip.yaml"
    clip.write_text(
        "clip: animtool/1\nrig: post.rig.yaml\nfps: 24\nrange: [1, 4]\nchannels: []\n"
    )
    with pytest.raises(OptionError) as caught:
        convert(walk, tmp_path / "add.clip.yaml", base=clip)
    assert [fault.code for fault in caught.value.faults] == ["SCN017"]
    assert not (tmp_path / "add.clip.yaml").exists()


def test_keys_of_a_rig_with_meshes_take_its_arrays_along(
    root: Path, tmp_path: Path
) -> None:
    made = tmp_path / "walk.clip.yaml"
    convert(root / "samples/stride/stride.clip.yaml", made)
    rig = load_rig(tmp_path / "walk.rig.yaml")
    shipped = load_rig(root / "rigs/biped/biped.rig.yaml")
    for ours, theirs in zip(rig.meshes, shipped.meshes, strict=True):
        assert np.array_equal(ours.points.load(), theirs.points.load())
    with pytest.raises(OptionError) as caught:
        convert(root / "samples/stride/stride.clip.yaml", made)
    assert caught.value.faults


@pytest.mark.skipif(os.name == "nt", reason="no such names of files")
@pytest.mark.parametrize(
    ("source", "output"),
    [
        ("a\x1b.bvh", "o.clip.yaml"),
        ("a\x1b.bvh", "o.rig.yaml"),
        ("a.bvh", "o\x1b.clip.yaml"),
    ],
)
def test_what_would_not_be_read_again_is_not_written(
    walk: Path, tmp_path: Path, source: str, output: str
) -> None:
    (tmp_path / source).write_bytes(walk.read_bytes())
    done = animtool("convert", source, output, cwd=tmp_path)
    assert done.code == 3
    assert "DOC023" in done.stderr
    assert [path.name for path in tmp_path.iterdir()] == [source]


@pytest.mark.parametrize("suffix", [".bvh", ".clip.yaml", ".glb", ".usda"])
def test_what_is_noticed_while_frames_are_read_is_reported(
    walk: Path, tmp_path: Path, suffix: str
) -> None:
    text = walk.read_text("utf-8").replace("Zrotation Xrotation", "Xrotation Zrotation")
    (tmp_path / "other.bvh").write_text(text, "utf-8")
    report = convert(tmp_path / "other.bvh", tmp_path / f"out{suffix}")
    assert [notice.code for notice in report.notices].count("BVH117") == 1
