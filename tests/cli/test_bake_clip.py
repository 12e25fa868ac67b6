from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest
from pxr import UsdSkel
from support.cli import animtool
from support.clips import hero, write_clip
from support.usd import joint_positions, open_stage, skeleton_query, validation_errors

from animtool import compare
from animtool.clip.file import load_clip, open_clip
from animtool.clip.sample import sample_channels
from animtool.motion.motion import Motion
from animtool.rig.kinematics import forward_kinematics, rest_size
from animtool.rig.skeleton import Rig

MOVES = """\
- target: joint/hips.translation
  keys: [{t: 1, v: [0, 0, 0]}, {t: 5, v: [10, 0, 5]}, {t: 13, v: [10, 20, 0]}]
- target: joint/hips.rotation
  keys: [{t: 1, v: [1, 0, 0, 0]}, {t: 9, v: [0.6, 0, 0.8, 0]}]
- target: joint/elbow_l.angle
  pre: linear
  post: linear
  keys: [{t: 1, v: 0, out: [3, 40]}, {t: 13, v: 90, in: [-1, -9]}]
- {target: control/lean, keys: [{t: 1, v: 0}, {t: 7, v: 1}, {t: 13, v: 0}]}
"""
ARM = """\
- {target: joint/elbow_l.angle, keys: [{t: 1, v: 0}, {t: 13, v: 200}]}
"""


@pytest.fixture
def rig(tmp_path: Path) -> Rig:
    return hero(tmp_path)


@pytest.fixture
def shot(tmp_path: Path, rig: Rig) -> Path:
    assert rig.joints
    return write_clip(tmp_path, MOVES)


def sampled(path: Path, rig: Rig, times: npt.ArrayLike) -> Motion:
    clip = load_clip(open_clip(path), rig)
    return sample_channels(clip.channels, rig, np.asarray(times, np.float64)).motion


def assert_plays(output: Path, rig: Rig, motion: Motion, codes: npt.ArrayLike) -> None:
    """Assert that UsdSkel puts the joints where forward kinematics does."""
    stage = open_stage(output)
    ours = forward_kinematics(rig, *motion.dense()).positions / rig.meters_per_unit
    theirs = joint_positions(stage, codes)
    size = rest_size(rig) / rig.meters_per_unit
    np.testing.assert_allclose(theirs, ours, rtol=0, atol=1e-6 * size)
    assert validation_errors(stage) == []


def authored_codes(output: Path) -> list[float]:
    stage = open_stage(output)
    query = skeleton_query(stage).GetAnimQuery()
    return list(query.GetJointTransformTimeSamples())


def test_a_clip_plays_in_usd(shot: Path, rig: Rig, tmp_path: Path) -> None:
    output = tmp_path / "o.usda"
    done = animtool("bake", shot, "-o", output)
    assert done.code == 0, done.stderr
    codes = np.arange(1.0, 14.0)
    assert authored_codes(output) == codes.tolist()
    assert_plays(output, rig, sampled(shot, rig, codes), codes)


def test_another_rate_samples_the_curve(shot: Path, rig: Rig, tmp_path: Path) -> None:
    output = tmp_path / "o.usda"
    assert animtool("bake", shot, "-o", output, "--fps", 30).code == 0
    codes = np.arange(1.0, 17.0)
    assert authored_codes(output) == codes.tolist()
    motion = sampled(shot, rig, 1 + (codes - 1) * 24 / 30)
    assert_plays(output, rig, motion, codes)
    stage = open_stage(output)
    animation = UsdSkel.Animation(skeleton_query(stage).GetAnimQuery().GetPrim())
    order = list(animation.GetJointsAttr().Get())
    elbow = next(i for i, name in enumerate(order) if name.endswith("/elbow_l"))
    rotations = motion.rotations.dense()[:, rig.index("elbow_l")]
    for code, expected in zip(codes, rotations, strict=True):
        found = animation.GetRotationsAttr().Get(float(code))[elbow]
        made = np.array([*found.imaginary, found.real])
        # Signs are free.
        made *= np.sign(made @ expected)
        np.testing.assert_allclose(made, expected, rtol=0, atol=1e-7)


def test_samples_beyond_both_ends(shot: Path, rig: Rig, tmp_path: Path) -> None:
    output = tmp_path / "o.usda"
    done = animtool("bake", shot, "-o", output, "--samples", "-.25,0,.25")
    assert done.code == 0, done.stderr
    codes = (np.arange(1.0, 14.0)[:, None] + [-0.25, 0, 0.25]).ravel()
    assert authored_codes(output) == codes.tolist()
    motion = sampled(shot, rig, codes)
    assert_plays(output, rig, motion, codes)
    elbow = motion.rotations.dense()[:, rig.index("elbow_l")]
    assert (elbow[0] != elbow[1]).any()
    assert (elbow[-1] != elbow[-2]).any()


def test_start_and_range(shot: Path, rig: Rig, tmp_path: Path) -> None:
    output = tmp_path / "o.usda"
    given = ["--start", 1001, "--range", "1003-1007x2"]
    assert animtool("bake", shot, "-o", output, *given).code == 0
    assert authored_codes(output) == [1003, 1005, 1007]
    assert_plays(output, rig, sampled(shot, rig, [3, 5, 7]), [1003, 1005, 1007])


def test_a_split_rig_as_the_rig_layer(shot: Path, rig: Rig, tmp_path: Path) -> None:
    assert animtool("bake", shot, "-o", tmp_path / "hero.usda", "--split").code == 0
    layer, output = tmp_path / "hero.rig.usda", tmp_path / "o.usda"
    given = ["--rig-layer", layer, "--fps", 24]
    done = animtool("bake", shot, "-o", output, *given)
    assert done.code == 0, done.stderr
    stage = open_stage(layer)
    stage.GetRootLayer().subLayerPaths.append(str(output))
    codes = np.arange(1.0, 14.0)
    ours = forward_kinematics(rig, *sampled(shot, rig, codes).dense()).positions * 100
    np.testing.assert_allclose(joint_positions(stage, codes), ours, atol=2e-4)


def test_sparse_writes_what_moves(tmp_path: Path, rig: Rig) -> None:
    shot, output = write_clip(tmp_path, ARM), tmp_path / "o.usda"
    assert animtool("bake", shot, "-o", output, "--sparse").code == 0
    stage = open_stage(output)
    query = skeleton_query(stage).GetAnimQuery()
    names = {str(name).rpartition("/")[2] for name in query.GetJointOrder()}
    assert names == {"elbow_l", "rod"}
    codes = np.arange(1.0, 14.0)
    assert_plays(output, rig, sampled(shot, rig, codes), codes)


def test_limits_are_said_and_clamped(tmp_path: Path, rig: Rig) -> None:
    shot, output = write_clip(tmp_path, ARM), tmp_path / "o.usda"
    done = animtool("bake", shot, "-o", output)
    assert done.code == 0
    assert "CLIP102" in done.stderr
    assert "50° at frame 13" in done.stderr
    assert "--clamp" in done.stderr
    assert animtool("bake", shot, "-o", "-", "--strict").code == 1
    done = animtool("bake", shot, "-o", output, "--clamp", "--overwrite")
    assert done.code == 0
    codes = np.arange(1.0, 14.0)
    clip = load_clip(open_clip(shot), rig)
    assert_plays(
        output,
        rig,
        sample_channels(clip.channels, rig, codes, clamp=True).motion,
        codes,
    )


def test_another_rig(shot: Path, tmp_path: Path) -> None:
    other = tmp_path / "other.rig.yaml"
    text = (tmp_path / "hero.rig.yaml").read_text()
    other.write_text(text.replace("name: hero", "name: other"))
    output = tmp_path / "o.usda"
    done = animtool("bake", shot, "-o", output, "--rig", other, "--format", "json")
    assert done.code == 0, done.stderr
    assert json.loads(done.stdout)["samples"] == 13
    assert open_stage(output).GetPrimAtPath("/other")


def test_a_bad_clip_writes_nothing(tmp_path: Path, rig: Rig) -> None:
    assert rig.joints
    text = ARM.replace("elbow_l", "elbw_l") + MOVES.replace("t: 9", "t: 0")
    shot = write_clip(tmp_path, text, "fps: 0")
    before = sorted(tmp_path.iterdir())
    done = animtool("bake", shot, "-o", tmp_path / "o.usda")
    assert done.code == 3
    for code in ("SCN022", "CLIP002", "CLIP004"):
        assert code in done.stderr
    assert sorted(tmp_path.iterdir()) == before


def test_a_rig_that_is_missing(shot: Path, tmp_path: Path) -> None:
    for given in (["--rig", tmp_path / "none.rig.yaml"], ["--rig", tmp_path / "none"]):
        done = animtool("bake", shot, "-o", tmp_path / "o.usda", *given)
        assert done.code == 3, done.stderr
        assert "IO001" in done.stderr
    (tmp_path / "hero.rig.yaml").unlink()
    done = animtool("bake", shot, "-o", tmp_path / "o.usda")
    assert done.code == 3
    assert "hero.rig.yaml" in done.stderr
    assert not (tmp_path / "o.usda").exists()


@pytest.mark.parametrize(
    ("kind", "instead"),
    [
        ("rig", "animtool validate"),
        ("targets", "animtool ik"),
        ("scene", "end its name in .scene.yaml"),
    ],
)
def test_a_file_of_another_kind(tmp_path: Path, kind: str, instead: str) -> None:
    path = tmp_path / "x.yaml"
    path.write_text(f"{kind}: animtool/1\nname: x\n")
    done = animtool("bake", path, "-o", tmp_path / "o.usda")
    assert done.code == 3
    assert f"it looks like a {kind} file" in done.stderr
    assert instead in done.stderr


@pytest.mark.parametrize("rate", [(), ("--fps", "48"), ("--samples", "0,.5")])
def test_another_up_axis_turns_the_curve(
    shot: Path, tmp_path: Path, rate: tuple[str, ...]
) -> None:
    upright, turned = tmp_path / "y.usda", tmp_path / "z.usda"
    assert animtool("bake", shot, "-o", upright, *rate).code == 0
    assert animtool("bake", shot, "-o", turned, "--to-up", "Z", *rate).code == 0
    back = tmp_path / "back.usda"
    assert animtool("bake", turned, "-o", back, "--to-up", "Y").code == 0
    assert compare(upright, back).within(meters=1e-6, degrees=1e-3)


@pytest.mark.parametrize("value", ["1.0e+308", "1.1e+18"])
def test_a_value_beyond_reason_is_refused(tmp_path: Path, rig: Rig, value: str) -> None:
    clip = write_clip(
        tmp_path,
        f"- {{target: control/grin, keys: [{{t: 1, v: {value}}}, {{t: 9, v: 0}}]}}\n",
    )
    done = animtool("bake", clip, "-o", tmp_path / "o.usda")
    assert done.code == 3
    assert "DOC022 channels[0].keys[0].v: " in done.stderr
    assert rig.controls


@pytest.mark.parametrize(("scale", "half"), [(1.1, True), (1.5, False)])
def test_the_error_of_half_scales_is_not_called_float32s(
    tmp_path: Path, rig: Rig, scale: float, half: bool
) -> None:
    assert rig.joints
    clip = write_clip(
        tmp_path,
        f"- {{target: joint/hips.scale, interp: step, keys: [{{t: 1, v: [1, 1, 1]}}, "
        f"{{t: 5, v: [{scale}, {scale}, {scale}]}}]}}\n",
    )
    said = animtool("bake", clip, "-o", tmp_path / "o.usda").stderr
    assert ("largest error of float32 and half scales (up to 0.036% " in said) is half
    assert ("largest error of float32: " in said) is not half
    done = animtool("bake", clip, "-o", tmp_path / "p.usda", "--format", "json")
    error = json.loads(done.stdout)["error"]
    assert error["half_scales"] is half
    assert error["scales"] == pytest.approx(abs(float(np.float16(scale)) / scale - 1))
