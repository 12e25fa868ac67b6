"""The shipped rigs: they load, are symmetric, and their controls stay in limits."""

from __future__ import annotations

import itertools
import re
from pathlib import Path

import numpy as np
import pytest

from animtool.maths import so3
from animtool.rig.controls import Control, evaluate_controls
from animtool.rig.file import load_rig
from animtool.rig.joints import coordinate_slices, local_from_coordinates
from animtool.rig.kinematics import forward_kinematics, rest_world
from animtool.rig.limits import BallLimit, RangeLimit
from animtool.rig.skeleton import Rig

NAMES = ["arm", "ball", "biped", "head", "machine", "quadruped"]


def load(root: Path, name: str) -> Rig:
    return load_rig(root / f"rigs/{name}/{name}.rig.yaml")


def check_limits(rig: Rig, targets: dict[str, np.ndarray]) -> None:
    for joint in rig.joints:
        if isinstance(joint.limits, RangeLimit):
            part = "slide" if joint.type == "prismatic" else "angle"
            value = targets.get(f"joint/{joint.name}.{part}", np.zeros(1))
            assert np.abs(joint.limits.excess(value)).max() < 1e-9, joint.name
        elif isinstance(joint.limits, BallLimit):
            parts = [
                targets.get(f"joint/{joint.name}.rotation.{a}", np.zeros(1))
                for a in "xyz"
            ]
            turn = so3.exp(np.stack(np.broadcast_arrays(*parts), axis=-1))
            assert joint.limits.excess(turn).max() < 1e-9, joint.name


def reaches_joint(control: Control) -> bool:
    return not all(drive.target.startswith("shape/") for drive in control.drives)


def test_every_rig_is_listed(root: Path) -> None:
    assert sorted(p.parent.name for p in root.glob("rigs/*/*.rig.yaml")) == NAMES


@pytest.mark.parametrize("name", NAMES)
def test_readme_and_rest(root: Path, name: str) -> None:
    rig = load(root, name)
    text = (root / f"rigs/{name}/README.md").read_text("utf-8")
    found = re.search(r"(\d+) joints, ([\d.]+) m high", text)
    assert found
    assert len(rig.joints) == int(found[1])
    world = rest_world(rig)
    tops = list(world.positions[0])
    for i, joint in enumerate(rig.joints):
        rotation = world.linear[0, i]
        tops += [world.positions[0, i] + rotation @ np.array(t) for t in joint.tips]
    up = 2 if rig.up == "Z" else 1
    assert max(p[up] for p in tops) == pytest.approx(float(found[2]), abs=1e-9)
    assert min(p[up] for p in tops) == pytest.approx(0, abs=1e-9)
    for control in rig.controls:
        assert f"`{control.name}`" in text
    check_limits(rig, {})
    for i, joint in enumerate(rig.joints):
        if joint.mirror:
            other = world.positions[0, rig.index(joint.mirror)]
            np.testing.assert_allclose(
                other, world.positions[0, i] * [-1, 1, 1], atol=1e-12
            )


@pytest.mark.parametrize("name", NAMES)
def test_controls_stay_in_limits(root: Path, name: str) -> None:
    rig = load(root, name)
    assert all(None not in (c.low, c.high) for c in rig.controls)
    # Controls that reach no joint may stay where they are.
    ranges = {c.name: (c.low, c.high) for c in rig.controls if reaches_joint(c)}
    ends = np.array(list(itertools.product(*ranges.values())), float)
    keyed = {c: ends[:, i] for i, c in enumerate(ranges)}
    check_limits(rig, evaluate_controls(rig.controls, keyed).targets)


def test_slider_crank_closes(root: Path) -> None:
    rig = load(root, "machine")
    turns = np.linspace(-360, 720, 1081)
    targets = evaluate_controls(rig.controls, {"crank": turns}).targets
    q = np.zeros((len(turns), coordinate_slices(rig)[-1].stop))
    for joint, place in zip(rig.joints, coordinate_slices(rig), strict=True):
        if joint.type == "ball":
            q[:, place] = so3.IDENTITY
    for target in ("crank.angle", "rod.angle", "piston.slide"):
        place = coordinate_slices(rig)[rig.index(target.split(".")[0])]
        q[:, place.start] = targets[f"joint/{target}"]
    local = local_from_coordinates(rig, q)
    world = forward_kinematics(rig, local.translations, local.rotations).positions
    gap = world[:, rig.index("rod_end")] - world[:, rig.index("piston")]
    assert np.abs(gap).max() < 1e-12
    assert np.ptp(world[:, rig.index("piston"), 1]) == pytest.approx(0.24)
    check_limits(rig, targets)
