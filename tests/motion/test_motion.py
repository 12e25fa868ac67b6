"""Channels of values."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from animtool.core.errors import AnimtoolError
from animtool.motion.motion import Channel, Motion
from animtool.rig.kinematics import forward_kinematics
from animtool.rig.skeleton import Joint, Rig


def test_compact_keeps_the_values() -> None:
    rng = np.random.default_rng(0)
    values = rng.normal(size=(5, 4, 3))
    values[:, [1, 3]] = values[:1, [1, 3]]
    channel = Channel.from_dense(values)
    assert channel.animated.tolist() == [0, 2]
    assert channel.values.shape == (5, 2, 3)
    assert_array_equal(channel.dense(), values)
    assert_array_equal(channel.select(slice(1, 3)).dense(), values[1:3])


@pytest.mark.parametrize("frames", [1, 3])
def test_what_never_moves_has_no_values(frames: int) -> None:
    channel = Channel.from_dense(np.ones((frames, 2, 3)))
    assert channel.values.shape == (frames, 0, 3)
    assert_array_equal(channel.dense(), np.ones((frames, 2, 3)))


def test_concatenate_undoes_select() -> None:
    values = np.random.default_rng(0).normal(size=(6, 2, 4))
    channel = Channel.from_dense(values)
    parts = [channel.select(slice(0, 2)), channel.select(slice(2, 6))]
    assert_array_equal(Channel.concatenate(parts).dense(), values)


def test_gather_and_put() -> None:
    values = np.random.default_rng(0).normal(size=(5, 4, 3))
    values[:, 1] = values[0, 1]
    channel = Channel.from_dense(values)
    joints = np.array([1, 3])
    assert_array_equal(channel.gather(joints), values[:, joints])
    found = channel.put(joints, -values[:, joints])
    values[:, joints] *= -1
    assert_array_equal(found.dense(), values)
    assert found.animated.tolist() == [0, 1, 2, 3]


@pytest.mark.parametrize("shape", [(3,), (2, 3), (0, 2, 3)])
def test_what_is_no_channel(shape: tuple[int, ...]) -> None:
    with pytest.raises(AnimtoolError) as caught:
        Channel.from_dense(np.zeros(shape))
    assert caught.value.code == "TAKE001"


def test_joints_are_where_the_dense_motion_has_them() -> None:
    rng = np.random.default_rng(2)
    rig = Rig("tree", tuple(Joint(f"j{i}", (i - 1) // 2) for i in range(7)))
    dense = [rng.normal(size=(5, 7, 3)), rng.normal(size=(5, 7, 4)), np.ones((5, 7, 3))]
    dense[1] /= np.linalg.norm(dense[1], axis=-1, keepdims=True)
    dense[0][:, 2:5] = dense[0][:1, 2:5]
    dense[1][:, 1:3] = dense[1][:1, 1:3]
    dense[2][:, 4] = rng.uniform(0.5, 2, (5, 3))
    channels = [Channel.from_dense(values) for values in dense]
    for count in (2, 3):
        found = Motion(*channels[:count]).world(rig)
        world = forward_kinematics(rig, *dense[:count])
        np.testing.assert_array_equal(found.positions, world.positions)
        np.testing.assert_array_equal(found.linear, world.linear)
