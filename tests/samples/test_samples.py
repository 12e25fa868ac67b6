"""The sample clips do what their READMEs say."""

from __future__ import annotations

import runpy
import sys
from pathlib import Path

import numpy as np
import pytest
from support.cli import animtool
from support.suite import at_night

from animtool.clip.clip import Clip
from animtool.clip.file import load_clip, open_clip
from animtool.clip.sample import sample_channels
from animtool.core.files.reading import matching_files
from animtool.motion.motion import Channel
from animtool.rig.file import load_rig
from animtool.rig.kinematics import WorldTransforms, forward_kinematics
from animtool.rig.skeleton import Rig
from animtool.validation.run import INPUT_SUFFIXES

ROOT = Path(__file__).parents[2]
GRAVITY = 9.81 / 24**2


def load(name: str) -> tuple[Clip, Rig]:
    file = open_clip(ROOT / f"samples/{name}/{name}.clip.yaml")
    assert file.rig_path is not None
    rig = load_rig(file.rig_path)
    return load_clip(file, rig), rig


def dense(channel: Channel, count: int) -> np.ndarray:
    values = np.repeat(channel.rest[None], count, 0)
    values[:, channel.animated] = channel.values
    return values


def world(clip: Clip, rig: Rig, times: np.ndarray) -> WorldTransforms:
    sampled = sample_channels(clip.channels, rig, times)
    assert not sampled.notices
    motion = sampled.motion
    scales = None if motion.scales is None else dense(motion.scales, len(times))
    return forward_kinematics(
        rig,
        dense(motion.translations, len(times)),
        dense(motion.rotations, len(times)),
        scales,
    )


# To validate these is to simulate and to solve them again: their bakes say as much.
LONG = {"cape", "capture", "dance", "fall"}
FOLDERS = sorted(
    path.name
    for path in ROOT.glob("samples/*/")
    if any(matching_files(str(path), INPUT_SUFFIXES))
)


@pytest.mark.slow
def test_nothing_is_found_in_any() -> None:
    names = at_night(FOLDERS, [name for name in FOLDERS if name not in LONG])
    folders = [ROOT / "samples" / name for name in names]
    done = animtool("validate", *folders, "--strict", "-j", 1)
    assert done.code == 0, done.stderr


@pytest.mark.parametrize("name", ["bounce", "stride"])
def test_the_script_makes_the_clip(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    script, made = ROOT / f"samples/{name}/make_{name}.py", tmp_path / "made.yaml"
    monkeypatch.setattr(sys, "argv", [script.name, str(made)])
    runpy.run_path(str(script), run_name="__main__")
    kept = ROOT / f"samples/{name}/{name}.clip.yaml"
    assert made.read_bytes() == kept.read_bytes()


def test_the_script_makes_the_dancer(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    script = ROOT / "samples/dance/make_dance.py"
    monkeypatch.setattr(sys, "argv", [script.name, str(tmp_path)])
    runpy.run_path(str(script), run_name="__main__")
    for made in sorted(tmp_path.iterdir()):
        kept = script.parent / made.name
        if made.suffix != ".npz":
            assert made.read_bytes() == kept.read_bytes()
            continue
        with np.load(made) as one, np.load(kept) as other:
            assert {*one} == {*other}
            for name in one:
                np.testing.assert_array_equal(one[name], other[name])


def test_the_bounce_follows_gravity() -> None:
    clip, rig = load("bounce")
    times = np.arange(1, 133, 0.05)
    placed = world(clip, rig, times)
    height = placed.positions[:, rig.index("contact"), 1]
    land = 17.0
    fall = times <= land
    expected = GRAVITY / 2 * (16**2 - (times[fall] - 1) ** 2)
    assert np.abs(height[fall] - expected).max() < 1e-9
    for frames in (24, 18, 14, 10, 8, 6):
        touch = (times >= land) & (times <= land + 2)
        assert np.abs(height[touch]).max() < 1e-9
        since = times - land - 2
        air = (since >= 0) & (since <= frames)
        expected = GRAVITY / 2 * since[air] * (frames - since[air])
        assert np.abs(height[air] - expected).max() < 1e-9
        land += 2 + frames
    assert np.abs(height[times >= land]).max() < 1e-9

    # The lowest point of an ellipsoid with axes A: the centre less |row Y of A|.
    spin = rig.index("spin")
    reach = 0.11 * np.linalg.norm(placed.linear[:, spin, 1], axis=-1)
    lowest = placed.positions[:, spin, 1] - reach
    assert lowest.min() > -1e-6


def test_the_bounce_keeps_its_volume() -> None:
    clip, rig = load("bounce")
    ball = rig.index("ball")
    on_keys = world(clip, rig, np.arange(1, 133.1, 0.25)).linear[:, ball]
    assert np.abs(np.linalg.det(on_keys) - 1).max() < 1e-9
    between = world(clip, rig, np.arange(1, 133, 0.05)).linear[:, ball]
    assert np.abs(np.linalg.det(between) - 1).max() < 0.005
    assert between[:, 1, 1].min() < 0.65


def test_the_bounce_rolls_as_far_as_it_turns() -> None:
    clip, rig = load("bounce")
    channels = {channel.target: channel for channel in clip.channels}
    turned = -channels["joint/spin.rotation"].values[-1, 2]
    assert np.degrees(turned) == pytest.approx(1200)
    place = world(clip, rig, np.array([1.0, 133.0])).positions[:, 0, 0]
    assert place[1] - place[0] == pytest.approx(0.11 * turned, abs=1e-9)


def test_the_press_closes() -> None:
    clip, rig = load("press")
    placed = world(clip, rig, np.arange(1, 97, 0.1))  # two strokes
    piston = placed.positions[:, rig.index("piston")]
    apart = placed.positions[:, rig.index("rod_end")] - piston
    assert np.abs(apart).max() < 1e-12
    assert np.ptp(piston[:, 1]) == pytest.approx(0.24, abs=1e-9)
    crank = rig.index("crank")
    ends = world(clip, rig, np.array([1.0, 49.0, 97.0])).linear[:, crank]
    assert np.abs(ends - ends[0]).max() < 1e-12


@pytest.mark.parametrize(("side", "late"), [("l", 0.0), ("r", 12.0)])
def test_the_stride_slides_less_than_two_millimetres(side: str, late: float) -> None:
    clip, rig = load("stride")
    times = np.linspace(1, 49, 481)
    found = world(clip, rig, times)
    ankle, toe = rig.index(f"ankle_{side}"), rig.index(f"toe_{side}")
    heel = found.positions[:, ankle] + found.linear[:, ankle] @ [0, -0.08, -0.05]
    for points, first, last in (
        (heel, 1, 4),
        (found.positions[:, ankle], 4, 10),
        (found.positions[:, toe], 4, 16),
    ):
        during = (times >= late + first - 1e-9) & (times <= late + last + 1e-9)
        assert during.sum() >= 30
        slide = np.ptp(points[during][:, [0, 2]], axis=0)
        assert np.linalg.norm(slide) < 0.002


def test_the_stride_goes_on_where_it_began() -> None:
    clip, rig = load("stride")
    found = world(clip, rig, np.array([1.0, 25.0]))
    travel = found.positions[1] - found.positions[0]
    np.testing.assert_allclose(
        travel, np.broadcast_to([0, 0, 1.3], travel.shape), atol=1e-9
    )
    np.testing.assert_allclose(found.linear[1], found.linear[0], atol=1e-9)


def test_the_speech_shuts_its_lids_and_crosses_the_correctives() -> None:
    clip, rig = load("speech")
    weights = sample_channels(clip.channels, rig, np.arange(1.0, 121.0)).motion.weights
    assert weights is not None
    frames = dense(weights, 120)[:, :, 0]
    names = [shape.name for shape in rig.shapes]
    by_name = dict(zip(names, frames.T, strict=True))
    for side in ("Left", "Right"):
        shut = np.flatnonzero(by_name[f"eyeBlink{side}"] > 1 - 1e-9) + 1
        assert shut.tolist() == [7, 53, 94]
        smile = np.flatnonzero(by_name[f"jawOpen_mouthSmile{side}"] >= 0.25) + 1
        assert set(range(98, 110)) <= set(smile.tolist())
    assert by_name["jawOpen"].argmax() + 1 == 20
    assert by_name["mouthPucker"].argmax() + 1 == 85
