"""The arm of `samples/correctives`: what its drivers come to, in every motion."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from support.cli import animtool

from animtool import Rig, open_source
from animtool.ik.file import load_targets
from animtool.maths import so3
from animtool.motion.take import Take
from animtool.rig.limits import swing_twist

SAMPLE = Path(__file__).parents[2] / "samples/correctives"
TWIST = (1.0, 0.0, 0.0)


def angles(take: Take, name: str) -> np.ndarray:
    """Return the angle of a pin about its axis, in degrees."""
    rig, j = take.rig, take.rig.index(name)
    turn = so3.multiply(
        so3.conjugate(rig.rest_rotations[j]), take.motion.rotations.dense()[:, j]
    )
    along = turn[:, :3] @ np.array(rig.joints[j].axis)
    return np.degrees(2 * np.arctan2(along, turn[:, 3]))


def check_driven(take: Take) -> None:
    """Check what the rig's drivers say, by arithmetic of its own."""
    rig = take.rig
    wrist = take.motion.rotations.dense()[:, rig.index("wrist")]
    twist = np.degrees(swing_twist(wrist, TWIST)[1])
    assert np.abs(angles(take, "forearm") - twist / 2).max() < 1e-4
    ratio = angles(take, "finger_3") - 0.66 * angles(take, "finger_2")
    assert np.abs(ratio).max() < 1e-4
    assert take.motion.weights is not None
    weights = dict(
        zip(
            [shape.name for shape in rig.shapes],
            take.motion.weights.dense()[..., 0].T,
            strict=True,
        )
    )
    elbow = angles(take, "elbow")
    assert np.abs(weights["biceps"][elbow <= 20]).max(initial=0.0) == 0
    assert weights["biceps"].max() <= 1
    product = weights["biceps"] * weights["deltoid"]
    assert np.abs(weights["lifted"] - product).max() < 1e-6


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("correctives")
    for command in (
        ("bake", SAMPLE / "wave.clip.yaml", "-o", "wave.usdc"),
        (
            *("ik", SAMPLE / "arm.rig.yaml"),
            *("--targets", SAMPLE / "touch.targets.yaml", "-o", "touch.usdc"),
        ),
        (
            *("ik", SAMPLE / "arm.rig.yaml", "--clip", SAMPLE / "wave.clip.yaml"),
            *("--targets", SAMPLE / "touch.targets.yaml", "--smooth", "0.1"),
            *("-o", "both.usdc"),
        ),
    ):
        done = animtool(*command, cwd=folder)
        assert done.code == 0, done.stderr
        assert "warning" not in done.stderr
    return folder


@pytest.mark.slow
@pytest.mark.parametrize("name", ["wave", "touch", "both"])
def test_drivers_act_on_every_motion(made: Path, name: str) -> None:
    check_driven(open_source(made / f"{name}.usdc").collect())


@pytest.mark.slow(0.5)
def test_the_tip_touches_the_points(made: Path) -> None:
    rig = Rig.load(SAMPLE / "arm.rig.yaml")
    tracks = load_targets(SAMPLE / "touch.targets.yaml", rig)
    (track,) = tracks.goals
    offset = np.array(track.goal.offset)
    for name, frames in (("touch", range(25)), ("both", range(25))):
        take = open_source(made / f"{name}.usdc").collect()
        world, j = take.world(), take.rig.index("finger_3")
        tips = world.positions[:, j] + world.linear[:, j] @ offset
        keys = {0: (52, 150, 6), 12: (40, 166, 10), 24: (34, 158, 16)}
        for frame, point in keys.items():
            assert frame in frames
            away = np.linalg.norm(tips[frame] - np.array(point) / 100)
            assert away < 2e-6


@pytest.mark.slow(0.5)
def test_to_bake_again_changes_nothing(made: Path) -> None:
    done = animtool("bake", "wave.usdc", "-o", "again.usdc", cwd=made)
    assert done.code == 0
    assert "RIG104" not in done.stderr
    first, again = (
        open_source(made / name).collect() for name in ("wave.usdc", "again.usdc")
    )
    for one, two in zip(
        first.motion.dense()[:2], again.motion.dense()[:2], strict=True
    ):
        assert np.abs(one - two).max() < 1e-6


@pytest.mark.slow
def test_the_drivers_come_back_from_usd(made: Path) -> None:
    done = animtool("convert", "wave.usdc", "back.rig.yaml", cwd=made)
    assert done.code == 0
    rig, back = Rig.load(SAMPLE / "arm.rig.yaml"), Rig.load(made / "back.rig.yaml")
    assert [j.driven for j in back.joints] == [j.driven for j in rig.joints]
    assert [s.driven for s in back.shapes] == [s.driven for s in rig.shapes]
    assert back.controls == rig.controls
