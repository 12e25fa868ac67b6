"""Forward kinematics against UsdSkel's, for every rig."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from support.data import data_files

from animtool.rig.kinematics import forward
from animtool.rig.skeleton import Joint, Rig

# UsdSkel works from float32 values, as a share of the rig's size; along a long chain
# its roundings add up.
TOLERANCE = 1e-6
LONG_CHAIN_TOLERANCE = 1e-4
LONG_CHAIN = 100  # joints


@pytest.mark.parametrize("path", data_files("rigs", "*.json"))
def test_joints_are_where_usdskel_puts_them(path: Path) -> None:
    data = json.loads(path.read_text("utf-8"))
    parents = [joint["parent"] for joint in data["joints"]]
    joints = tuple(Joint(f"j{i}", parent) for i, parent in enumerate(parents))
    frames = data["frames"]
    translations = np.array([frame["translations"] for frame in frames])
    rotations = np.array([frame["rotations_wxyz"] for frame in frames])
    rotations /= np.linalg.norm(rotations, axis=-1, keepdims=True)
    scales = np.array([frame["scales"] for frame in frames])
    world = forward(
        Rig("rig", joints), translations, np.roll(rotations, -1, axis=-1), scales
    )
    truth = np.array([frame["joint_skel"] for frame in frames])
    truth = truth.reshape(*truth.shape[:2], 4, 4)
    size = max(1.0, float(np.abs(truth).max()))
    tolerance = LONG_CHAIN_TOLERANCE if len(joints) > LONG_CHAIN else TOLERANCE
    assert np.abs(world.positions - truth[..., 3, :3]).max() <= tolerance * size
    # Row vectors: the linear part is the transpose of ours.
    linear = truth[..., :3, :3].swapaxes(-1, -2)
    assert np.abs(world.linear - linear).max() <= tolerance * size
