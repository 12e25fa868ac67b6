"""The sample scene: layers, a loop and inverse kinematics, as its README says."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from support.cli import animtool

from animtool import open_source
from animtool.scene.file import load_scene
from animtool.take import Take

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
    beside = (times >= 30) & (times <= 74)
    rail = np.stack(
        [
            np.full(96, -0.36),
            np.ones(96),
            0.12 + (times - 2) / 95 * 4.28,
        ],
        axis=1,
    )
    missed = np.linalg.norm(hand(done) - rail, axis=1)
    assert missed[beside].max() < 1e-4
    np.testing.assert_allclose(hand(done)[:15], hand(waving)[:15], atol=1e-9)


def test_the_files_of_the_scene_are_clean(root: Path) -> None:
    for path in sorted((root / "samples/shot").glob("*.yaml")):
        done = animtool("validate", path)
        assert done.code == 0, done.stdout + done.stderr
