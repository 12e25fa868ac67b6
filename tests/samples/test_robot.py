"""The arm as a URDF: the one of the rigs, which reaches along a path."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
from numpy.testing import assert_allclose
from support.cli import animtool
from support.robots import rig_matrices

from animtool import Rig
from animtool.scene.sources.open import open_source

AXES = [f"axis_{i}" for i in range(1, 7)]


def test_it_is_the_arm_of_the_rigs(root: Path) -> None:
    robot = Rig.load(root / "samples/robot/arm.urdf")
    arm = Rig.load(root / "rigs/arm/arm.rig.yaml")
    rng = np.random.default_rng(0)
    values = dict(zip(AXES, rng.uniform(-1, 1, size=6), strict=True))
    fingers = {"grip": 0.02, "grip_r": 0.02, "finger_l": 0.02, "finger_r": 0.02}
    own = {k: v for k, v in fingers.items() if k.startswith("grip")}
    ours = rig_matrices(robot, values | own)
    theirs = rig_matrices(arm, values | {k: fingers[k] for k in fingers if "f" in k})
    for name in [*AXES, "tool", "finger_l", "finger_r"]:
        assert_allclose(ours[name], theirs[name], atol=1e-12)
    mimic = robot.joints[robot.index("grip_r")].mimic
    assert mimic is not None
    assert mimic.joint == "grip"
    limits = robot.joints[robot.index("axis_1")].limits
    assert limits is not None
    assert math.isclose(limits.high, math.radians(170), abs_tol=1e-4)


def test_the_tool_follows_its_path(root: Path, tmp_path: Path) -> None:
    arm, made = root / "samples/robot/arm.urdf", tmp_path / "reach.usda"
    targets = root / "samples/robot/reach.targets.yaml"
    done = animtool("ik", arm, "--targets", targets, "-o", made, "--missed", "0.01mm")
    assert done.code == 0, done.stderr
    take = open_source(made).collect()
    assert take.motion.frames == 73
    tool = take.world().positions[:, take.rig.index("tool")]
    assert_allclose(tool[0], [0.68, 0.0, 0.62], atol=1e-5)
    assert np.ptp(tool[:, 1]) > 0.5  # from side to side
