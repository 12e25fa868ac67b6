"""The sample scene: layers, a loop and inverse kinematics, as its README says."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from pxr import Gf, Usd, UsdGeom
from support.cli import animtool
from support.props import prop_matrices

from animtool import open_source
from animtool.motion.take import Take
from animtool.scene.file.read import load_scene

NAME = "samples/shot/shot.scene.yaml"


def hand(take: Take) -> np.ndarray:
    return take.world().positions[:, take.rig.index("RightHand")]


def test_the_scene_is_baked_without_a_warning(workplace: Path) -> None:
    done = animtool("bake", workplace / NAME, "--strict", "--set", "shot=one")
    assert done.code == 0, done.stderr
    assert "warning" not in done.stderr
    folder = workplace / "samples/shot"
    stage = open_source(folder / "one.usdc").collect()
    assert (stage.clock.fps, stage.clock.start) == (24, 1001)
    assert f"{76 * 3} samples" in done.stderr
    keys = open_source(folder / "one_keys.clip.yaml").collect()
    assert (keys.clock.start, keys.clock.count) == (1001, 76)
    whole = {frame: i for i, frame in enumerate(stage.clock.times.tolist())}
    frames = [whole[frame] for frame in keys.clock.times.tolist()]
    apart = stage.world().positions[frames] - keys.world().positions
    assert np.linalg.norm(apart, axis=-1).max() < 2e-3


def test_what_its_passes_do(root: Path) -> None:
    scene = load_scene(root / NAME)
    walk = open_source(root / "samples/walk/walk.bvh").collect()
    looped, looking, waving, done = (
        scene.until(str(i)).open().collect() for i in range(1, 5)
    )
    assert looped.clock.count == 96
    head, arm = walk.rig.index("Head"), walk.rig.index("LeftArm")
    turned = (looping.motion.rotations.dense() for looping in (looped, looking))
    before, after = turned
    changed = np.flatnonzero((before != after).any(axis=(0, 2)))
    assert set(changed.tolist()) == {head, walk.rig.index("Neck")}
    up = waving.world().positions[:, arm + 2, 1]
    assert up[:20].max() < 1.2
    assert up[40:60].min() > 1.6
    times = done.clock.times
    props = (times >= 30) & (times <= 74)
    rail = np.stack(
        [
            np.full(96, -0.36),
            np.ones(96),
            0.12 + (times - 2) / 95 * 4.28,
        ],
        axis=1,
    )
    missed = np.linalg.norm(hand(done) - rail, axis=1)
    assert missed[props].max() < 1e-4
    np.testing.assert_allclose(hand(done)[:15], hand(waving)[:15], atol=1e-9)


def test_what_is_props_the_walker(workplace: Path) -> None:
    """At every frame that is written, camera and lamp are where the set has them."""
    done = animtool("bake", workplace / NAME, "--strict", "--set", "shot=one")
    assert done.code == 0, done.stderr
    folder = workplace / "samples/shot"
    stage = Usd.Stage.Open(str(folder / "one.usdc"))
    model = stage.GetDefaultPrim().GetPath()
    frames = [t + o for t in range(1001, 1077) for o in (-0.25, 0, 0.25)][1:-1]
    places = {
        "/Set/camera": "/Cameras/main",
        "/Set/post/lamp": f"{model}/Props/lamp",
    }
    for theirs, ours in places.items():
        expected = prop_matrices(folder / "set.usda", theirs, frames)
        found = prop_matrices(stage, ours, frames)
        np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-7)
    camera = UsdGeom.Camera(stage.GetPrimAtPath("/Cameras/main"))
    source = Usd.Stage.Open(str(folder / "set.usda"))
    truth = UsdGeom.Camera(source.GetPrimAtPath("/Set/camera"))
    for frame in frames:
        ours, theirs = (c.GetCamera(Usd.TimeCode(frame)) for c in (camera, truth))
        assert ours.focalLength == pytest.approx(theirs.focalLength, rel=1e-6)
        assert ours.focusDistance == pytest.approx(theirs.focusDistance, rel=1e-6)
        wide = [c.GetFieldOfView(Gf.Camera.FOVHorizontal) for c in (ours, theirs)]
        assert wide[0] == pytest.approx(wide[1], rel=1e-6)
    lamp = stage.GetPrimAtPath(places["/Set/post/lamp"])
    state = lamp.GetAttribute("state")
    assert [state.Get(t) for t in (1001, 1039, 1040, 1076)] == [
        "off",
        "off",
        "on",
        "on",
    ]
    assert lamp.GetChild("glass")


def test_the_barrow_is_pushed_on(workplace: Path) -> None:
    animtool("bake", workplace / NAME, "--set", "shot=one")
    path = workplace / "samples/shot/one.usdc"
    stage, take = Usd.Stage.Open(str(path)), open_source(path).collect()
    frames = [frame for frame in take.clock.times.tolist() if frame == round(frame)]
    at = [take.clock.times.tolist().index(frame) for frame in frames]
    model = stage.GetDefaultPrim().GetPath()
    barrow = prop_matrices(stage, f"{model}/Props/barrow", frames)[:, 3, :3] / 100
    ahead = barrow[:, 2] - take.world().positions[at, 0, 2]
    assert 0.5 < ahead.min() < ahead.max() < 0.9
    assert np.diff(barrow[:, 2]).min() > 0


def test_the_files_of_the_scene_are_clean(root: Path) -> None:
    for path in sorted((root / "samples/shot").glob("*.yaml")):
        done = animtool("validate", path)
        assert done.code == 0, done.stdout + done.stderr
