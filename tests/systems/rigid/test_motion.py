"""Rigid bodies against closed forms: falling, sliding, rolling, bouncing, swinging."""

from __future__ import annotations

import math
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.special import ellipk
from support.rigid import FLOOR, GRAVITY, Rigid, ball, box

from animtool.maths import so3

SLOPE = math.radians(25)
TILT = [math.cos(-SLOPE / 2), 0, 0, math.sin(-SLOPE / 2)]
DOWN = np.array([math.cos(SLOPE), -math.sin(SLOPE), 0])
UP = np.array([math.sin(SLOPE), math.cos(SLOPE), 0])


def on_slope(folder: Path, body: dict[str, Any], height: float, **keys: Any) -> Rigid:
    """Return a body on a slope down along x, a height above it."""
    placed = {**body, "at": (height * UP).tolist(), "rotate": TILT}
    floor = {**FLOOR, "rotate": TILT}
    return Rigid(folder, placed, colliders=[floor], sleep={"speed": 0}, **keys)


def test_a_throw_is_exact(tmp_path: Path) -> None:
    found = Rigid(tmp_path, box((1, 2, 3), velocity=[3, 4, 0], spin=[100, 300, -200]))
    times = np.arange(1, 20) / 7
    path = found.path(times)[:, 0]
    parabola = np.stack([3 * times, 4 * times - GRAVITY / 2 * times**2, 0 * times], 1)
    assert_allclose(path, parabola, atol=1e-11)


@pytest.mark.parametrize("friction", [0.0, 0.2, 0.4])
def test_a_block_slides_down_a_slope(tmp_path: Path, friction: float) -> None:
    found = on_slope(tmp_path, box((0.5, 0.2, 0.4), friction=friction), 0.1)
    found.to(1.0)
    pull = GRAVITY * (math.sin(SLOPE) - friction * math.cos(SLOPE))
    assert found.velocities()[0] @ DOWN == pytest.approx(pull, rel=1e-3)
    way = found.to(1.0)[0] - 0.1 * UP
    assert way @ DOWN == pytest.approx(pull / 2, rel=2e-3)
    assert abs(way @ UP) < 1e-4


def test_a_block_stays_on_a_slope(tmp_path: Path) -> None:
    friction = 1.02 * math.tan(SLOPE)
    found = on_slope(tmp_path, box((0.5, 0.2, 0.4), friction=friction), 0.1)
    assert_allclose(found.to(10.0)[0], 0.1 * UP, atol=5e-4)
    assert np.abs(found.velocities()).max() < 1e-4


def test_a_ball_rolls_down_a_slope(tmp_path: Path) -> None:
    found = on_slope(tmp_path, ball(0.2, friction=1.0), 0.2)
    found.to(1.0)
    speed = 5 / 7 * GRAVITY * math.sin(SLOPE)
    assert found.velocities()[0] @ DOWN == pytest.approx(speed, rel=1e-3)
    assert_allclose(found.spins()[0], [0, 0, -speed / 0.2], rtol=1e-3, atol=1e-9)


@pytest.mark.slow
def test_a_ball_bounces_lower_each_time(tmp_path: Path) -> None:
    share, radius = 0.8, 0.1
    found = Rigid(
        tmp_path,
        ball(radius, at=[0, 1 + radius, 0], restitution=share),
        colliders=[FLOOR],
    )
    heights = found.path(np.arange(0, 2000) / 800)[:, 0, 1] - radius
    tops = [
        h
        for g, h, i in zip(heights, heights[1:], heights[2:], strict=False)
        if g < h >= i
    ]
    assert_allclose(tops[:4], [share ** (2 * n) for n in (1, 2, 3, 4)], rtol=2e-3)
    assert heights.min() > -1e-4


def test_what_bounces_comes_to_rest(tmp_path: Path) -> None:
    found = Rigid(
        tmp_path,
        ball(0.1, at=[0, 0.6, 0], restitution=0.6),
        box(
            (0.3, 0.2, 0.1),
            at=[1, 0.6, 0],
            rotate=[0.9, 0.3, 0.2, 0.1],
            restitution=0.6,
        ),
        colliders=[FLOOR],
    )
    found.to(8.0)
    assert np.abs(found.velocities()).max() < 1e-6
    assert (found.state.motion[:, 13] >= 0.5).all()


@pytest.mark.parametrize("share", [0.0, 0.5, 1.0])
def test_two_that_collide_keep_their_momentum(tmp_path: Path, share: float) -> None:
    one = ball(0.1, mass=1, velocity=[2, 0, 0], restitution=share, friction=0)
    other = {**ball(0.1, mass=3, at=[0.5, 0, 0]), "name": "other", "friction": 0}
    found = Rigid(tmp_path, one, other, forces=[])
    found.to(1.0)
    first, second = found.velocities()[:, 0]
    assert first + 3 * second == pytest.approx(2, abs=1e-12)
    assert second - first == pytest.approx(2 * share, abs=1e-3)
    assert_allclose(found.velocities()[:, 1:], 0, atol=1e-12)


def test_spinning_bodies_collide_and_keep_momentum(tmp_path: Path) -> None:
    one = box((0.3, 0.2, 0.1), mass=2, velocity=[3, 0.2, 0], spin=[300, 100, 700])
    other = {**box((0.2, 0.4, 0.2), mass=1, at=[1, 0.1, 0.05]), "name": "other"}
    found = Rigid(tmp_path, one, other, forces=[])

    def momenta() -> tuple[np.ndarray, np.ndarray]:
        motion, masses = found.state.motion, found.simulation.bodies.masses[:, None]
        linear = masses * motion[:, 7:10]
        return linear.sum(0), (np.cross(motion[:, :3], linear) + motion[:, 10:13]).sum(
            0
        )

    before, energy = momenta(), found.energy()
    found.to(1.0)
    assert np.abs(found.velocities()[1]).max() > 0.5
    after = momenta()
    assert_allclose(after[0], before[0], atol=1e-12)
    assert_allclose(after[1], before[1], atol=2e-3)
    assert found.energy() < energy


@pytest.mark.slow(0.5)
def test_a_compound_pendulum_swings_as_it_should(tmp_path: Path) -> None:
    length, thick = 1.0, 0.1
    joint = {"type": "pin", "body": "box", "axis": [0, 0, 1]}

    def swing(substeps: int) -> tuple[float, float]:
        found = Rigid(
            tmp_path,
            box((length, thick, thick), mass=2, at=[length / 2, 0, 0]),
            joints=[joint],
            substeps=substeps,
            residual=1e-9,
            sleep={"speed": 0},
        )
        times, begin = np.arange(1, 700) / 100, found.energy()
        x, y = found.path(times)[:, 0, :2].T
        angles = np.unwrap(np.arctan2(x, -y))
        cross = [k for k, (a, b) in enumerate(pairwise(angles)) if (a > 0) != (b > 0)]
        at = [times[k] - angles[k] * 0.01 / (angles[k + 1] - angles[k]) for k in cross]
        lengths = np.hypot(x, y)
        assert_allclose(lengths, length / 2, atol=2e-4)
        return 2 * float(np.mean(np.diff(at))), abs(found.energy() - begin)

    inertia = 2 / 12 * (length**2 + thick**2) + 2 * (length / 2) ** 2
    slow = math.sqrt(2 * GRAVITY * length / 2 / inertia)
    period = 4 * ellipk(0.5) / slow
    errors = [abs(swing(n)[0] / period - 1) for n in (2, 4)]
    assert errors[1] < 1e-4
    # The second order of it: half the step, a quarter of the error.
    assert 3 < errors[0] / errors[1] < 8
    assert swing(8)[1] < 1e-3


@pytest.mark.slow
def test_free_turning_keeps_energy_whatever_the_step(tmp_path: Path) -> None:
    found = Rigid(
        tmp_path, box((0.1, 0.4, 0.3), spin=[20, 2000, 30]), forces=[], step=1 / 24,
        substeps=1,
    )  # fmt: skip
    begin, momentum = found.energy(), found.state.motion[0, 10:13]
    found.to(100.0)
    assert found.energy() == pytest.approx(begin, rel=1e-12)
    assert_allclose(found.state.motion[0, 10:13], momentum, rtol=1e-12)


def test_the_euler_of_the_lectures_gains_energy(tmp_path: Path) -> None:
    """The reason for another default: at the rate of a film it doubles in a second."""
    spinning = box((0.1, 0.4, 0.3), spin=[20, 600, 30])

    def gain(method: str) -> float:
        found = Rigid(
            tmp_path, spinning, forces=[], step=1 / 24, substeps=1, method=method
        )
        begin = found.energy()
        found.to(2.0)
        return abs(found.energy() / begin - 1)

    assert gain("explicit_euler") > 0.05
    assert gain("rk4") < 1e-3
    assert gain("splitting") < 1e-12


@pytest.mark.parametrize("speed", [60.0, 2000.0])
@pytest.mark.parametrize("way", ["collider", "mesh", "body"])
def test_nothing_goes_through_a_thin_wall(
    tmp_path: Path, speed: float, way: str
) -> None:
    bullet = ball(0.01, velocity=[speed, 0, 0])
    others, keys = [], {}
    if way == "body":
        wall = box((0.002, 2, 2), at=[1, 0, 0], mass=1e6)
        others.append({**wall, "name": "wall"})
    elif way == "mesh":
        points = np.array([[1.0, -1, -1], [1, -1, 1], [1, 1, 1], [1, 1, -1]])
        np.savez(tmp_path / "wall.npz", points=points, triangles=[[0, 1, 2], [0, 2, 3]])
        files = {key: f"wall.npz#{key}" for key in ("points", "triangles")}
        keys["colliders"] = [{"shape": {"mesh": files}}]
    else:
        size = [0.002, 2, 2]
        keys["colliders"] = [{"shape": {"box": {"size": size}}, "at": [1, 0, 0]}]
    found = Rigid(tmp_path, bullet, *others, forces=[], **keys)
    for k in range(1, 40):
        assert found.to(k / 50)[0, 0] < 1.0


def test_what_passes_by_is_not_touched(tmp_path: Path) -> None:
    """The way of a fast body is looked along, not the box about its way."""
    bullet = ball(0.01, velocity=[900, 0, 0])
    post = {"shape": {"box": {"size": [0.1, 2, 2]}}, "at": [3, 1.02, 0]}
    found = Rigid(tmp_path, bullet, forces=[], colliders=[post])
    assert_allclose(found.to(0.5)[0], [450, 0, 0], atol=1e-9)


def test_a_kinematic_body_pushes_and_carries(tmp_path: Path) -> None:
    lift = box((1, 0.1, 1), at=[0, 0, 0], kinematic=True, friction=0.8)
    lift["moves"] = [[0, 0, 0, 0], [1, 0, 2, 0]]
    load = {**box((0.2, 0.2, 0.2), at=[0, 0.15, 0]), "name": "load"}
    found = Rigid(tmp_path, {**lift, "name": "lift"}, load)
    found.to(0.5)
    frame = found.run.at(0.75)
    assert_allclose(frame.points, [[0, 1.5, 0], [0, 1.65, 0]], atol=1e-3)
    assert_allclose(frame.velocities, [[0, 2, 0], [0, 2, 0]], atol=1e-3)
    # It stops at once: the load flies on, comes back and stays.
    assert found.to(1.2)[1, 1] == pytest.approx(
        2.15 + 0.4 - GRAVITY / 2 * 0.04, abs=2e-3
    )
    assert_allclose(found.to(3.0)[1], [0, 2.15, 0], atol=1e-3)


def test_a_belt_takes_along_what_is_on_it(tmp_path: Path) -> None:
    belt = box(
        (9, 0.1, 1), kinematic=True, friction=0.8, moves=[[0, 0, 0, 0], [2, 2, 0, 0]]
    )
    load = {**box((0.2, 0.2, 0.2), at=[0, 0.15, 0]), "name": "load"}
    found = Rigid(tmp_path, {**belt, "name": "belt"}, load)
    # It slides until it is as fast: v / (friction g) long.
    late = 1 / (2 * 0.8 * GRAVITY)
    assert found.to(1.0)[1, 0] == pytest.approx(1 - late, abs=2e-3)


def test_pushes_act_at_a_point_for_a_time(tmp_path: Path) -> None:
    pushes = [{"force": [6, 0, 0], "at": [0, 0.2, 0], "start": 0.103, "end": 0.203}]
    found = Rigid(tmp_path, ball(0.5, mass=2, pushes=pushes), forces=[])
    found.to(1.0)
    assert_allclose(found.velocities()[0], [0.3, 0, 0], atol=1e-12)
    inertia = 0.4 * 2 * 0.25
    assert found.spins()[0, 2] == pytest.approx(-0.6 * 0.2 / inertia, rel=1e-4)
    turning = [{"torque": [0, 3, 0], "local": True}]
    found = Rigid(tmp_path, ball(0.5, mass=2, pushes=turning), forces=[])
    found.to(2.0)
    assert_allclose(found.spins()[0], [0, 6 / inertia, 0], atol=1e-9)


def test_the_same_every_time_and_at_any_rate(tmp_path: Path) -> None:
    heap = [
        box((0.2, 0.1, 0.3), at=[0, 0.5, 0], rotate=[0.9, 0.1, 0.3, 0.2],
            grid={"count": [2, 4, 2], "spacing": [0.21, 0.3, 0.3], "stagger": 0.4})
    ]  # fmt: skip
    one, other = (Rigid(tmp_path, *heap, colliders=[FLOOR]) for _ in range(2))
    slow, fast = one.path(np.arange(25) / 24), other.path(np.arange(61) / 60)
    assert_array_equal(slow[::2], fast[::5])
    assert np.abs(so3.log(one.run.at(1.0).rotations)).max() > 0.1


def test_a_ball_joint_that_swings_anywhere_is_held_short_of_its_pole(
    tmp_path: Path,
) -> None:
    def heights(swing: float) -> np.ndarray:
        folder = tmp_path / str(swing)
        folder.mkdir()
        joint = {"name": "neck", "type": "ball", "body": "box", "at": [0, 1, 0],
                 "axis": [0, -1, 0], "swing": swing}  # fmt: skip
        top = box([0.1, 0.5, 0.1], at=[0.02, 1.3, 0])
        return Rigid(folder, top, joints=[joint]).path(np.arange(1, 25) / 24)[:, 0, 1]

    free, held = heights(180), heights(179)
    assert held.min() < 0.8
    np.testing.assert_array_equal(free, held)
