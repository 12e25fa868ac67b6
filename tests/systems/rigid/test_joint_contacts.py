"""Joints switch off the contact of their two bodies, whatever moves these."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose
from support.rigid import Rigid, ball, box
from support.simulated import Simulator
from support.suite import some_quick

from animtool import BakeOptions
from animtool.maths import so3
from animtool.usd.physics.read import read_bodies

AWAKE = {"sleep": {"speed": 0}}
TYPES = ("pin", "ball", "prismatic", "fixed")
MOTIONS: dict[str, dict[str, Any]] = {
    "standing": {},
    "moving": {"moves": [[0, 0, 0, 0], [1, 0.5, 0, 0]]},
    "turning": {"turns": [[0, 1, 0, 0, 0], [1, 0.7071, 0, 0, 0.7071]]},
    "dynamic": {"kinematic": False},
}
# Where the joint is on the wheel and on the rod that begins through it [m].
ON_WHEEL, ON_ROD = np.array([0.15, 0.0, 0.0]), np.array([-0.3, 0.0, 0.0])


def joined(folder: Path, kind: str, motion: dict[str, Any], **joint: Any) -> Rigid:
    """Return a rod joined to a wheel that it overlaps by half of its length."""
    wheel = box((0.4, 0.4, 0.03), name="wheel", mass=1, **{"kinematic": True, **motion})
    rod = box((0.6, 0.03, 0.03), name="rod", mass=1, at=[0.45, 0, 0])
    entry = {"type": kind, "body": "rod", "to": "wheel", "axis": [0, 0, 1], **joint}
    return Rigid(
        folder, wheel, rod, joints=[{"at": ON_WHEEL.tolist(), **entry}], forces=[],
        **AWAKE,
    )  # fmt: skip


@pytest.mark.parametrize("motion", some_quick(MOTIONS, 2))
@pytest.mark.parametrize("kind", TYPES)
def test_a_joint_holds_what_overlaps(tmp_path: Path, kind: str, motion: str) -> None:
    found = joined(tmp_path, kind, MOTIONS[motion])
    apart = []
    for t in np.linspace(0.1, 1.0, 10):
        found.to(t)
        frame = found.run.at(float(t))
        wheel, rod = (
            frame.points[i] + so3.rotate(frame.rotations[i], at)
            for i, at in enumerate((ON_WHEEL, ON_ROD))
        )
        off = so3.rotate(so3.conjugate(frame.rotations[0]), rod - wheel)
        apart.append(off[:2] if kind == "prismatic" else off)
    assert np.abs(apart).max() < 1e-4
    assert found.simulation.diagnostics(found.state, 1.0).values["contacts"] == 0


@pytest.mark.slow
@pytest.mark.parametrize("kinematic", [True, False])
def test_contacts_are_asked_for(tmp_path: Path, kinematic: bool) -> None:
    post = box((0.2, 0.2, 0.2), name="post", mass=1e6, kinematic=kinematic)
    arm = box(
        (0.6, 0.05, 0.05), name="arm", mass=1, at=[0.5, 0.4, 0], spin=[0, 0, -90],
        velocity=[0, -0.125 * np.pi, 0],
    )  # fmt: skip
    pin = {"type": "pin", "body": "arm", "to": "post", "axis": [0, 0, 1]}
    pin["at"] = [0.25, 0.4, 0]
    lowest = []
    for contacts in (False, True):
        own = [{**pin, "contacts": contacts}]
        found = Rigid(tmp_path, post, arm, joints=own, forces=[], **AWAKE)
        path = found.path(np.linspace(0.1, 3.0, 30))
        # Turned by half a turn, the arm would be in the post.
        lowest.append((path[:, 1, 0] - 0.25).min())
    free, stopped = lowest
    assert free < -0.24
    assert stopped > -0.2


def test_others_still_collide_with_what_is_joined(tmp_path: Path) -> None:
    """A joint switches off the contact of its own two bodies alone."""
    table = box((2, 0.1, 2), name="table", kinematic=True)
    arm = box((0.4, 0.05, 0.05), name="arm", at=[0, 0.075, 0], mass=1)
    stray = ball(0.1, name="stray", at=[0.5, 0.6, 0], mass=1)
    pin = {"type": "pin", "body": "arm", "to": "table", "axis": [0, 1, 0]}
    found = Rigid(tmp_path, table, arm, stray, joints=[pin])
    assert_allclose(found.to(1.5)[2, 1], 0.15, atol=2e-3)


def test_four_bars_with_a_driven_crank_close(tmp_path: Path) -> None:
    crank = box(
        (0.24, 0.04, 0.04), name="crank", kinematic=True,
        turns=[[k / 4, *so3.exp(np.array([0, 0, k * np.pi / 2]))[[3, 0, 1, 2]].tolist()]
               for k in range(13)],
    )  # fmt: skip
    # Ground pivots at 0 and .5 m; the crank is .1, the coupler .5 and the rocker .3 m.
    x = (0.4**2 + 0.5**2 - 0.3**2) / (2 * 0.4)
    high = np.sqrt(0.5**2 - x**2)
    joint, end = np.array([0.1, 0, 0]), np.array([0.1 + x, high, 0])
    ground = np.array([0.5, 0, 0])

    def bar(name: str, a: Any, b: Any) -> dict[str, Any]:
        way = b - a
        turn = so3.exp(np.array([0, 0, np.arctan2(way[1], way[0])]))
        size = (float(np.linalg.norm(way)) + 0.04, 0.04, 0.04)
        place = {"at": ((a + b) / 2).tolist(), "rotate": turn[[3, 0, 1, 2]].tolist()}
        return box(size, name=name, mass=0.5, **place)

    def pin(body: str, to: str | None, at: Any) -> dict[str, Any]:
        on = {} if to is None else {"to": to}
        return {
            "type": "pin", "body": body, "axis": [0, 0, 1], "at": at.tolist(), **on,
        }  # fmt: skip

    joints = [
        pin("coupler", "crank", joint), pin("rocker", "coupler", end),
        pin("rocker", None, ground),
    ]  # fmt: skip
    found = Rigid(
        tmp_path, crank, bar("coupler", joint, end), bar("rocker", end, ground),
        joints=joints, forces=[], **AWAKE,
    )  # fmt: skip
    for t in np.linspace(0.1, 3.0, 30):
        points = found.to(t)
        angle = 2 * np.pi * t
        tip = 0.1 * np.array([np.cos(angle), np.sin(angle), 0])
        # Half of the coupler from the crank's tip, half of the rocker from the ground.
        assert_allclose(np.linalg.norm(points[1] - tip), 0.25, atol=1e-3)
        assert_allclose(np.linalg.norm(points[2] - ground), 0.15, atol=1e-3)


@pytest.mark.parametrize("contacts", [True, False])
def test_stages_say_whether_joined_bodies_collide(
    tmp_path: Path, contacts: bool
) -> None:
    wheel = box((0.4, 0.4, 0.03), name="wheel", kinematic=True)
    rod = box((0.6, 0.03, 0.03), name="rod", mass=1, at=[0.45, 0, 0])
    pin = {"type": "pin", "body": "rod", "to": "wheel", "axis": [0, 0, 1]}
    entry = {
        "name": "it", "bodies": [wheel, rod], "prims": "xforms", "physics": True,
        "joints": [{**pin, "at": [0.15, 0, 0], "contacts": contacts}], "forces": [],
    }  # fmt: skip
    stage, _ = Simulator(tmp_path).baked([{"rigid": entry}], BakeOptions())
    file = Path(stage.GetRootLayer().realPath)
    (joint,) = read_bodies(file, "/", None).joints
    assert joint.contacts == contacts
