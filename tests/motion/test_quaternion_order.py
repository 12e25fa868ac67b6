"""Quaternions that are near the rest pose only in the other order."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from animtool import (
    BakeOptions,
    OpenTake,
    TakeStream,
    bake,
    convert,
    open_source,
    usd,
    write_bvh,
)
from animtool.maths import so3
from animtool.motion.motion import Channel
from animtool.motion.quaternion_order import (
    find_swapped_order,
    order_warning,
    python_order_warning,
)
from animtool.motion.take import Take

WALK = Path(__file__).parents[2] / "samples/walk/walk.bvh"


@pytest.fixture(scope="module")
def walk() -> Take:
    return open_source(WALK).collect()


def codes(take: Take, rotations: np.ndarray) -> list[str]:
    channel = Channel.from_dense(rotations)
    motion = replace(take.motion, rotations=channel)
    return [one.code for one in order_warning(take.rig, motion, "a.usda")]


def opened(take: Take) -> OpenTake:
    return OpenTake(Path("made"), TakeStream.of(take))


def written_codes(take: Take, folder: Path) -> list[list[str]]:
    """Return the codes of this warning, as each writer of takes has it."""
    stage, output = folder / "a.usda", folder / "a.bvh"
    written = (
        usd.write(take, stage, overwrite=True).notices,
        write_bvh(take, output, overwrite=True),
        bake(opened(take), stage, BakeOptions(overwrite=True)).notices,
        convert(opened(take), output, overwrite=True).notices,
    )
    return [[n.code for n in notices if n.code == "MOT222"] for notices in written]


@pytest.mark.parametrize(("shift", "found"), [(-1, True), (1, True), (0, False)])
def test_w_at_the_other_end(walk: Take, shift: int, found: bool) -> None:
    rotations = np.roll(walk.motion.rotations.dense(), shift, axis=2)
    assert codes(walk, rotations) == ["MOT222"] * found


def test_a_body_that_rolls_is_turned_at_its_root_alone(walk: Take) -> None:
    rotations = walk.motion.rotations.dense().copy()
    turn = so3.from_axis_angle((1.0, 0.0, 0.0), np.linspace(0, 12, len(rotations)))
    rotations[:, 0] = so3.multiply(turn, rotations[:, 0])
    assert codes(walk, rotations) == []


def test_joints_that_are_all_half_turned_are_no_other_order(walk: Take) -> None:
    half = so3.from_axis_angle((0.6, 0.0, 0.8), np.array(np.pi))
    rotations = so3.multiply(half, walk.motion.rotations.dense())
    assert codes(walk, rotations) == []


def test_a_few_joints_may_be_half_turned(walk: Take) -> None:
    rotations = walk.motion.rotations.dense().copy()
    rotations[:, 1:9] = np.roll(rotations[:, 1:9], 1, axis=2)
    assert codes(walk, rotations) == []


def test_the_angles_of_the_warning_are_medians(walk: Take) -> None:
    shape = walk.motion.rotations.dense().shape
    rotations = np.zeros(shape)
    rotations[..., 0] = 1.0
    motion = replace(walk.motion, rotations=Channel.from_dense(rotations))
    order = find_swapped_order(walk.rig, motion)
    assert order is not None
    assert (order.angle_as_read, order.angle_swapped) == pytest.approx((180, 0))
    assert "more than" not in order.message


def test_identities_with_w_first(walk: Take, tmp_path: Path) -> None:
    shape = walk.motion.rotations.dense().shape
    first, last = np.zeros(shape), np.zeros(shape)
    first[..., 0] = last[..., 3] = 1.0
    assert codes(walk, first) == ["MOT222"]
    assert codes(walk, last) == []
    for rotations, found in ((first, 1), (last, 0)):
        motion = replace(walk.motion, rotations=Channel.from_dense(rotations))
        take = replace(walk, motion=motion)
        assert written_codes(take, tmp_path) == 4 * [["MOT222"] * found]


@pytest.mark.parametrize(("rest", "found"), [((1, 0, 0, 0), 1), ((0, 0, 0, 1), 0)])
def test_a_rest_pose_with_w_first(
    walk: Take, tmp_path: Path, rest: tuple[float, float, float, float], found: int
) -> None:
    joints = tuple(replace(joint, rotation=rest) for joint in walk.rig.joints)
    take = replace(walk, rig=replace(walk.rig, joints=joints))
    assert written_codes(take, tmp_path) == 4 * [["MOT222"] * found]
    frames_and_joints = walk.motion.rotations.dense().shape[:2]
    rotations = np.tile(np.array(rest, float), (*frames_and_joints, 1))
    motion = replace(walk.motion, rotations=Channel.from_dense(rotations))
    notices = python_order_warning(take.rig, motion, "a")
    assert len(notices) == found
    for notice in notices:
        assert notice.message.startswith("rest rotations of")
