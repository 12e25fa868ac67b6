"""The format's complete example: read, written, and played through every target."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from pxr import UsdSkel
from support.cli import animtool_process
from support.example_rig import write_example_rig
from support.usd import joint_positions, open_stage, skeleton_query, validation_errors

from animtool.clip.file import load_clip, open_clip
from animtool.clip.sample import sample_channels
from animtool.maths import so3
from animtool.rig.file import load_rig
from animtool.rig.kinematics import forward_kinematics, rest_size
from animtool.rig.skeleton import Rig
from animtool.rig.write import rig_text

CLIP = """\
clip: animtool/1
rig: hero.rig.yaml
fps: 24000/1001
range: [1, 13]
channels:
- {target: control/grin, keys: [{t: 1, v: 0}, {t: 13, v: .9}]}
- {target: control/curl, interp: linear, keys: [{t: 1, v: 0}, {t: 13, v: .5}]}
- {target: shape/smile, interp: linear, keys: [{t: 1, v: .25}, {t: 13, v: 0}]}
- {target: shape/jaw, interp: linear, keys: [{t: 1, v: 0}, {t: 13, v: 1}]}
- {target: joint/elbow_l.angle, keys: [{t: 1, v: 10, out: [3, 20]}, {t: 13, v: 60}]}
- {target: joint/elbow_r.angle, interp: tcb, keys: [{t: 1, v: 0}, {t: 13, v: 30}]}
- {target: joint/piston.slide, interp: catmull_rom,
   keys: [{t: 1, v: 0}, {t: 5, v: .08}, {t: 13, v: .02}]}
- {target: joint/shoulder_l.rotation, interp: squad,
   keys: [{t: 1, v: [1, 0, 0, 0]}, {t: 13, v: [.8, 0, 0, .6]}]}
- {target: joint/shoulder_r.rotation, euler: XYZ, interp: step,
   keys: [{t: 1, v: [0, 0, 0]}, {t: 7, v: [0, 20, 30]}]}
- {target: joint/hips.translation, interp: hermite,
   keys: [{t: 1, v: [0, 0, 0], out: [1, [0, 0, .1]]}, {t: 13, v: [0, .1, 1]}]}
- {target: joint/hips.rotation, euler: YXZ,
   keys: [{t: 1, v: [0, 0, 0]}, {t: 13, v: [720, 0, 0]}]}
- {target: joint/wrist_l.local_translation, keys: [{t: 1, v: [.3, 0, .02]}]}
- {target: joint/chest.local_rotation, interp: slerp,
   keys: [{t: 1, v: [1, 0, 0, 0]}, {t: 13, v: [.96, 0, .28, 0]}]}
- {target: joint/hair1.local_rotation, keys: [{t: 1, v: [.8, .6, 0, 0]}]}
- {target: joint/hair1.local_translation, interp: linear,
   keys: [{t: 1, v: [0, .3, -.1]}, {t: 13, v: [0, .3, -.2]}]}
"""
CODES = np.arange(1.0, 14.0)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    write_example_rig(tmp_path)
    (tmp_path / "shot.clip.yaml").write_text(CLIP, "utf-8")
    return tmp_path


@pytest.fixture
def rig(folder: Path) -> Rig:
    return load_rig(folder / "hero.rig.yaml")


def test_it_loads_whole(rig: Rig) -> None:
    assert sorted(rig.names) == [
        *("chest", "elbow_l", "elbow_r", "hair1", "hips", "piston"),
        *("shoulder_l", "shoulder_r", "wrist_l", "wrist_r"),
    ]
    assert not rig.bind
    (mesh,), (smile, jaw, both) = rig.meshes, rig.shapes
    assert mesh.skin is not None
    assert mesh.skin.joints == ("hips", "chest", "shoulder_l", "elbow_l")
    assert (jaw.combine, both.combine) == ((), ("smile", "jaw"))
    assert [(step.at, step.deltas.key) for step in smile.inbetweens] == [
        (0.5, "smile50")
    ]
    follower = rig.joints[rig.index("piston")]
    assert follower.mimic is not None
    assert follower.mimic.gain * np.radians(150) == pytest.approx(0.09)
    assert [c.name for c in rig.controls] == ["grin", "curl"]
    assert [len(part) for part in (rig.chains, rig.attach, rig.colliders)] == [1, 1, 1]


def test_it_comes_back_from_what_is_written(folder: Path, rig: Rig) -> None:
    again = folder / "again.rig.yaml"
    again.write_text(rig_text(rig), "utf-8")
    back = load_rig(again)
    assert back == rig
    assert rig_text(back) == rig_text(rig)


@pytest.mark.slow
def test_every_kind_of_target_plays_in_usd(folder: Path, rig: Rig) -> None:
    done = animtool_process("bake", "shot.clip.yaml", "-o", "shot.usdc", cwd=folder)
    assert done.code == 0, done.stderr
    # The elbow has keys besides the control that curls it.
    assert re.findall(r"warning: (\S+)", done.stderr) == ["CLIP111"]
    stage = open_stage(folder / "shot.usdc")
    assert validation_errors(stage) == []
    clip = load_clip(open_clip(folder / "shot.clip.yaml"), rig)
    motion = sample_channels(clip.channels, rig, CODES).motion
    world = forward_kinematics(rig, *motion.dense())
    np.testing.assert_allclose(
        joint_positions(stage, CODES), world.positions, atol=1e-6 * rest_size(rig)
    )


def test_every_kind_of_target_does_what_it_says(folder: Path, rig: Rig) -> None:
    clip = load_clip(open_clip(folder / "shot.clip.yaml"), rig)
    motion = sample_channels(clip.channels, rig, CODES).motion
    translations, rotations, _ = motion.dense()

    def turns(name: str) -> np.ndarray:
        return rotations[-1, rig.index(name)]

    def places(name: str) -> np.ndarray:
        return translations[-1, rig.index(name)]

    angles = so3.angle_between(rotations, so3.IDENTITY)[-1]
    # Keys, and what the control adds: half of 140 degrees.
    assert np.degrees(angles[rig.index("elbow_l")]) == pytest.approx(60 + 70)
    assert np.degrees(angles[rig.index("elbow_r")]) == pytest.approx(30)
    np.testing.assert_allclose(places("piston"), [0, 0.02, 0], atol=1e-12)
    np.testing.assert_allclose(turns("shoulder_l"), [0, 0, 0.6, 0.8], atol=1e-12)
    np.testing.assert_allclose(places("hips"), [0, 0.95 + 0.1, 1], atol=1e-12)
    np.testing.assert_allclose(places("wrist_l"), [0.3, 0, 0.02], atol=1e-12)
    np.testing.assert_allclose(np.abs(turns("chest")), [0, 0.28, 0, 0.96], atol=1e-12)
    np.testing.assert_allclose(turns("hair1"), [0.6, 0, 0, 0.8], atol=1e-12)
    np.testing.assert_allclose(places("hair1"), [0, 0.3, -0.2], atol=1e-12)
    assert motion.weights is not None
    # Of smile, jaw and their product; grin has a tenth of curl added.
    weights = motion.weights.dense()[:, :, 0]
    np.testing.assert_allclose(weights[-1], [0.95, 1, 0.95], atol=1e-12)
    np.testing.assert_allclose(weights[0], [0.25, 0, 0], atol=1e-12)


@pytest.mark.slow
def test_shapes_reach_usd(folder: Path, rig: Rig) -> None:
    done = animtool_process("bake", "shot.clip.yaml", "-o", "shot.usda", cwd=folder)
    assert done.code == 0, done.stderr
    clip = load_clip(open_clip(folder / "shot.clip.yaml"), rig)
    motion = sample_channels(clip.channels, rig, CODES).motion
    assert motion.weights is not None
    stage = open_stage(folder / "shot.usda")
    query = skeleton_query(stage).GetAnimQuery()
    animation = UsdSkel.Animation(query.GetPrim())
    names = list(animation.GetBlendShapesAttr().Get())
    order = [names.index(shape.name) for shape in rig.shapes]
    for code, weights in zip(CODES, motion.weights.dense(), strict=True):
        found = np.array(query.ComputeBlendShapeWeights(float(code)))
        np.testing.assert_allclose(found[order], weights[:, 0], atol=1e-7)
