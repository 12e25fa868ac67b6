"""Takes as clips: what a bake of the clip gives on its rig."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from animtool.clip.file import load_clip_of
from animtool.clip.reduction.points import SHELL_DISTANCE, attached_points, point_errors
from animtool.clip.sample import sample_channels
from animtool.motion.take import Take
from animtool.rig.file import load_rig
from animtool.scene.bake.bake import bake
from animtool.scene.convert.takes import convert
from animtool.scene.sources.open import open_source

TOLERANCE = 5e-4
CHANNEL = (
    "- {{target: {0}, interp: linear, keys: [{{t: 1, v: {1}}}, {{t: 9, v: {2}}}]}}\n"
)


def taken(tmp_path: Path, rig: str, *channels: tuple[str, object, object]) -> Path:
    """Write a rig and a clip of ramps; return the clip."""
    (tmp_path / "one.rig.yaml").write_text(f"rig: animtool/1\nname: one\n{rig}")
    text = "clip: animtool/1\nrig: one.rig.yaml\nfps: 24\nrange: [1, 9]\n"
    text += "channels:\n" * bool(channels)
    text += "".join(CHANNEL.format(*channel) for channel in channels)
    source = tmp_path / "one.clip.yaml"
    source.write_text(text)
    return source


def check_back(source: Path, tmp_path: Path) -> tuple[Take, Take]:
    """Convert to keys; return what was and what a bake of these gives, both alike."""
    output = tmp_path / "back.clip.yaml"
    report = convert(source, output, reduce=TOLERANCE).reduction
    assert report is not None
    wanted, found = open_source(source).collect(), open_source(output).collect()
    points = attached_points(wanted.rig, SHELL_DISTANCE)
    errors = point_errors(points, wanted.world(), found.world())
    assert errors.max() <= TOLERANCE
    assert report.error == pytest.approx(errors.max(), abs=1e-9)
    assert report.held
    if wanted.motion.weights is not None:
        assert found.motion.weights is not None
        off = wanted.motion.weights.dense() - found.motion.weights.dense()
        assert np.abs(off).max() <= 1e-3
        assert report.weight_error == pytest.approx(np.abs(off).max(), abs=1e-9)
    return wanted, found


TURNING = "joints: [{name: a, type: pin, axis: [1, 0, 0]}]\n"


def test_motion_that_is_as_small_as_its_tolerance_is_kept(tmp_path: Path) -> None:
    """What is taken for rounding is always far less than the tolerance."""
    source = taken(
        tmp_path, TURNING, ("joint/a.local_translation", [0, 0, 0], [8e-7, 0, 0])
    )
    output = tmp_path / "back.clip.yaml"
    report = convert(source, output, reduce=1e-7).reduction
    assert report is not None
    assert report.held
    places = open_source(output).collect().motion.translations.dense()[:, 0, 0]
    np.testing.assert_allclose(places, np.linspace(0, 8e-7, 9), atol=1e-7)


DRIVEN = """joints:
- {name: a, type: pin, axis: [0, 0, 1]}
- {name: b, type: fixed, parent: a, translate: [1, 0, 0]}
controls:
- {name: c, default: 30, drives: [{joint: a.angle, expr: c}]}
"""


@pytest.mark.parametrize("first", [30, 0])
def test_a_default_that_drives_a_joint_is_not_added_to_its_keys(
    tmp_path: Path, first: float
) -> None:
    check_back(taken(tmp_path, DRIVEN, ("control/c", first, 60)), tmp_path)


def test_a_control_that_holds_a_joint_at_rest_has_a_key(tmp_path: Path) -> None:
    source = taken(tmp_path, DRIVEN, ("control/c", 0, 0))
    wanted, found = check_back(source, tmp_path)
    assert not wanted.motion.rotations.rest[0, :3].any()
    assert len(found.motion.rotations.animated) == 0
    text = (tmp_path / "back.clip.yaml").read_text()
    assert re.findall("target: (.*)", text) == ["control/c"]


FOLLOWING = """joints:
- {name: a, type: pin, axis: [0, 0, 1]}
- {name: b, type: pin, parent: a, translate: [1, 0, 0], axis: [0, 0, 1],
   mimic: {joint: a, gain: 0.5, offset: 20}}
- {name: s, type: prismatic, parent: a, axis: [1, 0, 0],
   mimic: {joint: a, gain: 0.01, offset: -0.3}}
- {name: c, type: fixed, parent: b, translate: [1, 0, 0]}
"""


def test_joints_that_follow_have_no_keys(tmp_path: Path) -> None:
    source = taken(tmp_path, FOLLOWING, ("joint/a.angle", 0, 60))
    _, found = check_back(source, tmp_path)
    text = (tmp_path / "back.clip.yaml").read_text()
    assert re.findall("target: (.*)", text) == ["joint/a.angle"]
    assert not found.notices


def test_a_mimic_that_comes_to_rest_stays_there(tmp_path: Path) -> None:
    # The leader's 30 degrees and the follower's offset cancel out.
    rig = FOLLOWING + "controls:\n"
    rig += "- {name: k, default: 30, drives: [{joint: a.angle, expr: k}]}\n"
    check_back(taken(tmp_path, rig), tmp_path)


SHAPED = """joints:
- {name: a, type: free}
shapes:
- {name: left}
- {name: right}
- {name: both, combine: [left, right]}
- {name: more, combine: [both, left]}
- {name: still}
controls:
- {name: c, default: 0.25, drives: [{shape: still, expr: c}]}
"""


def test_a_combined_shape_that_its_drivers_give_has_no_keys(tmp_path: Path) -> None:
    source = taken(tmp_path, SHAPED, ("shape/left", 0, 1), ("shape/right", 1, 0.3))
    check_back(source, tmp_path)
    text = (tmp_path / "back.clip.yaml").read_text()
    assert "shape/left" in text
    assert "shape/both" not in text
    assert "shape/more" not in text
    assert "shape/still" not in text


def test_keys_of_a_combined_shape_are_what_its_drivers_do_not_give(
    tmp_path: Path,
) -> None:
    source = taken(
        tmp_path,
        SHAPED,
        ("shape/left", 0, 1),
        ("shape/right", 1, 0.3),
        ("shape/both", 0.2, 0.5),
        ("control/c", 0, 1),
    )
    check_back(source, tmp_path)
    text = (tmp_path / "back.clip.yaml").read_text()
    assert "shape/both" in text
    assert "shape/more" not in text


@pytest.mark.slow
@pytest.mark.parametrize("suffix", ["clip.yaml", "usdc"])
def test_speech_comes_back_within_the_tolerance_of_weights(
    tmp_path: Path, suffix: str
) -> None:
    source = Path(__file__).parents[2] / "samples" / "speech" / "speech.clip.yaml"
    if suffix == "usdc":
        bake(source, tmp_path / "speech.usdc")
        source = tmp_path / "speech.usdc"
    check_back(source, tmp_path)


# What float32 makes of samples that stand on a limit [deg], [m].
ROUNDED = 1e-5

LIMITED = """joints:
- {name: a, type: pin, axis: [0, 0, 1], limits: [-30, 60]}
- {name: b, type: prismatic, parent: a, axis: [1, 0, 0], limits: [0, 0.5]}
"""


def test_keys_of_pins_and_slides_keep_limits_between_frames(tmp_path: Path) -> None:
    """Joints that stop dead at their limits, and leave one for the other in a frame."""
    keys = ((1, -30), (9, 60), (20, 60), (21, -30), (30, -30), (40, 10))
    rows = [{"t": t, "v": v} for t, v in keys]
    slides = [{"t": t, "v": (v + 30) / 180} for t, v in keys]
    text = f"""clip: animtool/1
rig: rig.rig.yaml
fps: 24
range: [1, 40]
channels:
- {{target: joint/a.angle, interp: linear, keys: {rows}}}
- {{target: joint/b.slide, interp: linear, keys: {slides}}}
"""
    (tmp_path / "rig.rig.yaml").write_text(f"rig: animtool/1\nname: rig\n{LIMITED}")
    source = tmp_path / "stops.clip.yaml"
    source.write_text(text.replace("'", ""))
    bake(source, tmp_path / "stops.usdc")
    back = tmp_path / "back.clip.yaml"
    convert(tmp_path / "stops.usdc", back)
    rig = load_rig(tmp_path / "rig.rig.yaml")
    clip = load_clip_of(back, rig)
    times = np.linspace(1, 40, 39 * 16 + 1)
    motion = sample_channels(clip.channels, rig, times).motion
    angles = 2 * np.arctan2(*motion.rotations.dense()[:, 0, 2:].T)
    slide = motion.translations.dense()[:, 1, 0]
    assert np.degrees(angles).min() >= -30 - ROUNDED
    assert np.degrees(angles).max() <= 60 + ROUNDED
    assert slide.min() >= -ROUNDED
    assert slide.max() <= 0.5 + ROUNDED
