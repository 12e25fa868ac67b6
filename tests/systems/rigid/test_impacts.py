"""Impacts: heights, energy, what is passed on, and what friction does in one."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose
from support.rigid import FLOOR, GRAVITY, Rigid, ball, box
from support.suite import some_quick

from animtool.maths import so3

AWAKE = {"sleep": {"speed": 0}}
FREE = {"forces": [], **AWAKE}
# Of heights and speeds after an impact.
HEIGHT, SPEED = 0.01, 1e-6
# Of energy, where neither friction nor restitution takes any.
GAIN, KEPT = 1e-3, 0.98

FEET = [{"shape": {"box": {"size": [0.1] * 3}}, "at": [x, 0, 0]} for x in (-0.3, 0.3)]
LYING: dict[str, tuple[Any, float]] = {
    "cube": ({"box": {"size": [0.4, 0.4, 0.4]}}, 0.2),
    "slab": ({"box": {"size": [0.6, 0.2, 0.9]}}, 0.1),
    "two boxes": (FEET, 0.05),
    "capsule": ({"capsule": {"radius": 0.1, "length": 0.4, "axis": [1, 0, 0]}}, 0.1),
    "ball": ({"sphere": {"radius": 0.2}}, 0.2),
}


@pytest.mark.parametrize("step", [1 / 60, 1 / 240])
@pytest.mark.parametrize("e", some_quick([0.2, 0.5, 0.8, 1.0], 2))
@pytest.mark.parametrize("name", LYING)
def test_what_falls_flat_rises_and_does_not_turn(
    tmp_path: Path, name: str, e: float, step: float
) -> None:
    shape, low = LYING[name]
    body = {"name": "it", "at": [0, low + 1, 0], "restitution": e}
    body |= {"shapes" if isinstance(shape, list) else "shape": shape}
    found = Rigid(tmp_path, body, colliders=[FLOOR], step=step, **AWAKE)
    lands = np.sqrt(2 / 9.81)
    top = lands * (1 + e)
    rise = found.path(top + np.linspace(-0.02, 0.02, 9))[:, 0, 1].max() - low
    assert rise == pytest.approx(e**2, rel=HEIGHT)
    assert np.abs(found.spins()).max() < 1e-4


@pytest.mark.parametrize("size", [0.02, 1.0, 20.0])
@pytest.mark.parametrize("lean", [0, 37])
@pytest.mark.parametrize("origin", [[0, 0, 0], [1000, -2000, 500]])
def test_a_bounce_is_the_same_at_any_place_attitude_and_size(
    tmp_path: Path, origin: list[int], lean: int, size: float
) -> None:
    angle = math.radians(lean)
    up = np.array([math.sin(angle), math.cos(angle), 0])
    turn = [math.cos(angle / 2), 0, 0, -math.sin(angle / 2)]
    at = (np.array(origin) + up * 1.2 * size).tolist()
    keys = {"rotate": turn, "restitution": 0.5, "friction": 0}
    found = Rigid(
        tmp_path,
        box([0.4 * size] * 3, at=at, **keys),
        colliders=[{"shape": {"plane": {}}, "at": origin, "rotate": turn}],
        forces=[{"gravity": {"acceleration": (-GRAVITY * up).tolist()}}],
        **AWAKE,
    )
    top = 1.5 * math.sqrt(2 * size / GRAVITY)
    path = found.path(top + np.linspace(-0.02, 0.02, 9))[:, 0] - origin
    rise = (path @ up).max() / size - 0.2
    assert rise == pytest.approx(0.25, abs=1e-5)
    assert np.abs(found.spins()).max() < 1e-5


@pytest.mark.slow(0.5)
@pytest.mark.parametrize("step", [None, 1 / 240, 1 / 1000])
def test_energy_is_kept_and_never_grows(tmp_path: Path, step: float | None) -> None:
    """A box that tumbles, a capsule, and five boxes above each other, without loss."""
    bodies = [
        box([0.4, 0.3, 0.2], at=[0, 1.5, 0], rotate=[0.1, 0.3, 0.2, 0.9]),
        {
            "name": "c",
            "shape": {"capsule": {"radius": 0.1, "length": 0.4}},
            "at": [9, 1.5, 0],
            "rotate": [0, 0, 0.26, 0.97],
            "velocity": [2, 0, 0],
        },
        *(box([0.2] * 3, at=[-9, 0.1 + k / 2, k / 100]) for k in range(5)),
    ]
    for k, body in enumerate(bodies):
        body |= {"name": f"b{k}", "restitution": 1, "friction": 0}
    keys = AWAKE if step is None else {"step": step, **AWAKE}
    found = Rigid(tmp_path, *bodies, colliders=[FLOOR], **keys)
    found.to(0.0)
    begin = found.energy()
    for t in np.arange(1, 60) / 20:
        found.to(float(t))
        assert KEPT < found.energy() / begin < 1 + GAIN


@pytest.mark.parametrize("coming", [1, 2, 3])
def test_as_many_leave_a_row_as_come(tmp_path: Path, coming: int) -> None:
    row = [
        ball(0.1, at=[0.2 * k - 0.3 * (k < coming), 0, 0], friction=0, restitution=1)
        for k in range(6)
    ]
    for k, one in enumerate(row):
        one |= {"name": f"b{k}", "velocity": [2.0 * (k < coming), 0, 0]}
    found = Rigid(tmp_path, *row, **FREE)
    found.to(0.5)
    expected = [2.0 * (k >= 6 - coming) for k in range(6)]
    assert_allclose(found.velocities()[:, 0], expected, atol=1e-3)


@pytest.mark.parametrize("e", [0.0, 0.3, 1.0])
@pytest.mark.parametrize("ratio", [0.01, 0.5, 7.0, 1000.0])
def test_unequal_masses_meet(tmp_path: Path, ratio: float, e: float) -> None:
    """v1 = (m1 - e m2) u / (m1 + m2), v2 = (1 + e) m1 u / (m1 + m2)."""
    keys = {"friction": 0, "restitution": e}
    one = box([0.2] * 3, at=[-1, 0, 0], velocity=[3, 0, 0], mass=1.0, **keys)
    other = {**box([0.2] * 3, mass=ratio, **keys), "name": "other"}
    found = Rigid(tmp_path, one, other, **FREE)
    found.to(0.6)
    expected = [3 * (1 - e * ratio) / (1 + ratio), 3 * (1 + e) / (1 + ratio)]
    assert_allclose(found.velocities()[:, 0], expected, atol=1e-3 if e == 0 else SPEED)


@pytest.mark.parametrize(("friction", "slides"), [(0.1, True), (2.0, False)])
def test_friction_acts_in_an_impact(
    tmp_path: Path, friction: float, slides: bool
) -> None:
    """A ball without spin loses mu (1 + e) v, or 2/7 of its speed where it grips."""
    e, down, along = 0.8, 3.0, 4.0
    body = ball(0.1, at=[0, 0.4, 0], velocity=[along, -down, 0], restitution=e)
    body |= {"friction": friction}
    floor = {**FLOOR, "friction": 0}
    found = Rigid(tmp_path, body, colliders=[floor], **FREE)
    found.to(0.2)
    speed = along - friction * (1 + e) * down if slides else along * 5 / 7
    assert_allclose(found.velocities()[0], [speed, e * down, 0], atol=1e-4)
    spin = 2.5 * (along - speed) / 0.1
    assert_allclose(found.spins()[0], [0, 0, -spin], atol=1e-2)


@pytest.mark.slow
def test_bounces_of_a_crowd_settle(tmp_path: Path) -> None:
    rng = np.random.default_rng(8)
    turns = rng.normal(size=(24, 4))
    walls = [
        {"shape": {"plane": {"normal": n, "offset": -0.4}}}
        for n in ([1, 0, 0], [-1, 0, 0], [0, 0, 1], [0, 0, -1])
    ]
    boxes = []
    for k, turn in enumerate(turns / np.linalg.norm(turns, axis=1, keepdims=True)):
        at = [0.36 * (k % 2 - 0.5), 0.36 * (k // 4 + 0.8), 0.36 * (k // 2 % 2 - 0.5)]
        one = box([0.2] * 3, at=at, rotate=turn.tolist(), restitution=0.5)
        boxes.append(one | {"name": f"b{k}"})
    found = Rigid(tmp_path, *boxes, colliders=[FLOOR, *walls])
    found.to(8.0)
    assert np.abs(found.velocities()).max() < 5e-3
    assert found.state.deepest[0] < 0.01


def test_edges_that_cross_meet_where_they_are(tmp_path: Path) -> None:
    """Two roofs, ridge over ridge at right angles: each is wide below the other's.

    By 1 m/s over a gap of 0.1 m, and back at the speed that it came with.
    """
    ridge = [[-1.0, 0, 0], [1, 0, 0]]
    eaves = [[-1.0, 1, -1], [1, 1, -1], [1, 1, 1], [-1, 1, 1]]
    points = np.array([*ridge, *eaves])
    sides = [[0, 1, 3], [0, 3, 2], [0, 4, 1], [0, 5, 4], [0, 2, 5], [1, 4, 3]]
    triangles = np.array([*sides, [2, 3, 4], [2, 4, 5]])
    np.savez(tmp_path / "roof.npz", points=points, triangles=triangles[:, ::-1])
    shape = {"mesh": {"points": "roof.npz", "triangles": "roof.npz"}}
    common = {"shape": shape, "friction": 0, "restitution": 1}
    # Upside down about x, then its ridge along z.
    turn = so3.multiply(
        so3.exp(np.array([0.0, np.pi / 2, 0])), so3.exp(np.array([np.pi, 0, 0]))
    )
    lower = {**common, "name": "lower", "rotate": turn[[3, 0, 1, 2]].tolist()}
    upper = {**common, "name": "upper", "at": [0.05, 0.1, 0], "velocity": [0, -1, 0]}
    found = Rigid(tmp_path, lower, upper, forces=[], sleep={"speed": 0}, step=1 / 240)
    before = found.to(0.08)
    assert_allclose(before, [[0, 0, 0], [0.05, 0.02, 0]], atol=1e-9)
    assert_allclose(found.velocities(), [[0, 0, 0], [0, -1, 0]], atol=1e-9)
    found.to(0.2)
    # Equal masses along one line exchange their speeds.
    assert_allclose(found.velocities()[:, 1], [-1, 0], atol=0.02)
