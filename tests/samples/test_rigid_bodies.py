"""The samples of rigid bodies: the nut flips, dominoes fall, the wall comes down."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pxr import Usd
from support.printed import Printed

from animtool.maths import so3
from animtool.validation.run import validate

# Each takes a whole bake.
pytestmark = pytest.mark.slow(1)


def baked(printed: Printed, name: str) -> Path:
    scene = f"samples/{name}/{name}.scene.yaml"
    return printed(f"animtool bake {scene} -o {name}.usdc") / f"{name}.usdc"


def attribute(output: Path, path: str, name: str, frames: int) -> list[Any]:
    stage = Usd.Stage.Open(str(output))
    values = stage.GetPrimAtPath(path).GetAttribute(name)
    return [values.Get(frame) for frame in range(1, frames + 1)]


@pytest.mark.parametrize("name", ["wingnut", "dominoes", "wrecking_ball"])
def test_nothing_is_found(printed: Printed, name: str) -> None:
    assert list(validate([baked(printed, name)])) == []


def test_the_nut_flips_over_again_and_again(printed: Printed) -> None:
    output, ups = baked(printed, "wingnut"), []
    for (turn,) in attribute(output, "/wingnut/nut", "orientationsf", 240):
        quaternion = np.array([*turn.GetImaginary(), turn.GetReal()])
        ups.append(so3.rotate(quaternion, np.array([0.0, 1.0, 0.0]))[1])
    sides = np.sign([up for up in ups if abs(up) > 0.9])
    assert np.count_nonzero(np.diff(sides)) >= 3


def test_all_dominoes_fall_one_by_one(printed: Printed) -> None:
    output = baked(printed, "dominoes")
    places = np.array(attribute(output, "/dominoes/row", "positions", 72))
    heights = places[:, :-1, 1]
    assert (heights[0] > 0.0239).all()
    assert (heights[-1] < 0.018).all()
    fallen = (heights < 0.018).argmax(axis=0)
    assert fallen[0] < 16
    assert (np.diff(fallen) >= -1).all()


def test_a_bake_counts_bodies(printed: Printed) -> None:
    baked(printed, "dominoes")
    scene = "samples/dominoes/dominoes.scene.yaml"
    said = printed.stderr(f"animtool bake {scene} -o dominoes.usdc")
    assert "row: 59 bodies, 72 frames" in said


def test_the_ball_goes_through_the_wall_and_hangs_on(printed: Printed) -> None:
    output = baked(printed, "wrecking_ball")
    places = np.array(attribute(output, "/wrecking_ball/yard", "positions", 96))
    hook = np.array([0, 5.2, -0.1])
    arms = np.linalg.norm(places[:, 6] - hook, axis=1)
    assert arms.max() < 4.1 + 0.01
    assert places[:, 6, 2].max() > 1.5
    wall = places[:, 7:]
    assert wall[0, :, 1].max() > 2
    # It stands until the ball comes.
    assert np.abs(wall[:20] - wall[0]).max() < 1e-3
    assert wall[-1, :, 1].mean() < 0.5
    # Brick by brick above the ground, but for a corner that is turned down.
    assert wall[..., 1].min() > 0.09


def test_the_walk_ends_at_the_foot_of_the_stairs(printed: Printed) -> None:
    output = baked(printed, "fall")
    command = "animtool bake samples/fall/fall.scene.yaml -o fall.usdc"
    assert "warning: " not in printed.stderr(command)
    assert list(validate([output])) == []
    points = np.array(attribute(output, "/biped/Rig/body", "points", 92))
    assert points[0, :, 1].max() > 1.5
    assert points[-1, :, 1].max() < -0.3
    # In no step by more than skin is outside of the capsules.
    heights = np.select(
        [points[..., 2] < 1.0 + 0.32 * k for k in range(6)],
        [-0.18 * k for k in range(6)],
        -1.08,
    )
    assert (points[20:, :, 1] - heights[20:]).min() > -0.12
