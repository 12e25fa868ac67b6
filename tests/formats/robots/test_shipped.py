"""Robots that packages of PyPI ship, against pinocchio, where both are installed.

``pip install pin example-robot-data pybullet`` brings them; no other test needs them.
"""

from __future__ import annotations

import sys
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.robots import rig_matrices

from animtool import ik
from animtool.rig.skeleton import JointType, Rig

TOLERANCE = 1e-12
ROBOTS = "cmeel.prefix/share/example-robot-data/robots"
BULLET = "pybullet_data"
# Which package, file, and a link to reach with.
SHIPPED = [
    (ROBOTS, "panda_description/urdf/panda.urdf", "panda_hand"),
    (ROBOTS, "ur_description/urdf/ur5_robot.urdf", "ee_link"),
    (ROBOTS, "talos_data/robots/talos_full_v2.urdf", "gripper_left_base_link"),
    (ROBOTS, "solo_description/robots/solo12.urdf", "FL_FOOT"),
    (BULLET, "kuka_iiwa/model.urdf", "lbr_iiwa_link_7"),
    (BULLET, "r2d2.urdf", "gripper_pole"),
]


def shipped(folder: str, name: str) -> Path:
    """Return a robot of a package, or skip the test with what is missing."""
    for place in map(Path, sys.path):
        if (place / folder / name).is_file():
            return place / folder / name
    package = "example-robot-data" if folder == ROBOTS else "pybullet"
    pytest.skip(f"{name} is in the package {package}, which is not installed")


@pytest.mark.parametrize(("folder", "name", "_tip"), SHIPPED)
def test_links_are_where_pinocchio_has_them(folder: str, name: str, _tip: str) -> None:
    path = shipped(folder, name)
    if find_spec("pinocchio") is None:
        pytest.skip("pinocchio (pip install pin) is not installed")
    import pinocchio

    model: Any = pinocchio.buildModelFromUrdf(str(path))
    data, rig = model.createData(), Rig.load(path)
    rng = np.random.default_rng(0)
    for _ in range(5):
        q, values = pinocchio.neutral(model), {}
        for joint, own in list(zip(model.names, model.joints, strict=True))[1:]:
            value = float(rng.normal())
            turn = [np.cos(value), np.sin(value)]
            q[own.idx_q : own.idx_q + own.nq] = value if own.nq == 1 else turn
            values[joint] = value
        pinocchio.forwardKinematics(model, data, q)
        pinocchio.updateFramePlacements(model, data)
        ours = rig_matrices(rig, values)
        size = 1 + max(np.abs(matrix[:3, 3]).max() for matrix in ours.values())
        for frame, theirs in zip(model.frames, data.oMf, strict=True):
            if frame.type == pinocchio.FrameType.BODY:
                off = np.abs(ours[frame.name][:3, 3] - theirs.translation).max()
                assert off <= TOLERANCE * size
                turned = np.abs(ours[frame.name][:3, :3] - theirs.rotation).max()
                assert turned <= TOLERANCE


@pytest.mark.parametrize(("folder", "name", "tip"), SHIPPED)
def test_a_link_reaches_where_it_was(folder: str, name: str, tip: str) -> None:
    """IK brings it to places that a random pose inside the limits has."""
    rig = Rig.load(shipped(folder, name))
    above = [rig.joints[j] for j in rig.upwards(rig.index(tip))]
    moving = [
        joint
        for joint in above
        if joint.type in {JointType.PIN, JointType.PRISMATIC} and joint.mimic is None
    ]
    rng, places = np.random.default_rng(1), []
    for _ in range(20):
        values = {}
        for joint in moving:
            low, high = -1.0, 1.0
            if joint.limits is not None:
                low, high = max(joint.limits.low, -3.0), min(joint.limits.high, 3.0)
            values[joint.name] = rng.uniform(low, high)
        places.append(rig_matrices(rig, values)[tip][:3, 3])
    problem = ik.build(rig, [ik.Goal(tip)], joints=[joint.name for joint in moving])
    targets = ik.Targets(positions=np.array(places)[:, None])
    result = ik.solve(problem, None, targets)
    assert np.max(result.positions) <= 1e-4
