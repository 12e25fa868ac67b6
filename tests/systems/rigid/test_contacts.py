"""Stacks, heavy on light, joints, sleep, and what is in each other."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from support.rigid import FLOOR, GRAVITY, Rigid, ball, box
from support.suite import at_night

from animtool.maths import so3
from animtool.systems.framework.run import ReachedState

CUBE = (1, 1, 1)
AWAKE = {"sleep": {"speed": 0}}
# What stands does so for a minute, and may move by a millimetre [s, m].
STANDING = at_night(60.0, 15.0)
CREEP = 1e-3 * STANDING / 60


def stack(count: int) -> dict[str, Any]:
    """Return boxes upon each other."""
    grid = {"count": [1, count, 1], "spacing": [0, 1, 0]}
    return box(CUBE, at=[0, 0.5, 0], grid=grid, density=500)


@pytest.mark.slow
@pytest.mark.parametrize("keys", [{}, AWAKE])
def test_ten_boxes_stand(tmp_path: Path, keys: dict[str, Any]) -> None:
    found = Rigid(tmp_path, stack(10), colliders=[FLOOR], **keys)
    begin = found.to(0.0)
    for t in (1.0, STANDING):
        assert_allclose(found.to(t), begin, atol=CREEP)
    assert np.abs(found.velocities()).max() < (5e-3 if keys else 1e-12)


def test_a_light_box_bears_a_heavy_one(tmp_path: Path) -> None:
    """1 kg below a tonne: at most 1 % of the height is lost."""
    heavy = {**box(CUBE, at=[0, 1.5, 0], mass=1000), "name": "heavy"}
    found = Rigid(
        tmp_path, box(CUBE, at=[0, 0.5, 0], mass=1), heavy, colliders=[FLOOR], **AWAKE
    )
    for t in (0.1, 0.3, 1, 5):
        heights = found.to(float(t))[:, 1]
        assert_allclose(heights, [0.5, 1.5], atol=0.01)
        assert_allclose(heights, [0.5, 1.5], atol=0.005)


def card_house(levels: int) -> list[dict[str, Any]]:
    """Return cards that lean on each other, and lie between the levels."""
    length, width, thick, lean = 0.088, 0.063, 0.003, math.radians(18)
    card = {"shape": {"box": {"size": [thick, length, width]}}, "mass": 0.002}
    base = 2 * (length * math.sin(lean) + thick * math.cos(lean))
    low = -length / 2 * math.cos(lean) - thick / 2 * math.sin(lean)
    cards: list[dict[str, Any]] = []

    def add(x: float, y: float, angle: float, **keys: Any) -> None:
        turn = [math.cos(angle / 2), 0, 0, math.sin(angle / 2)]
        name = f"card {len(cards)}"
        placed = {**card, "name": name, "at": [x, y, 0], "rotate": turn}
        cards.append({**placed, "friction": 0.6, **keys})

    floor = 0.0
    for level in range(levels):
        for k in range(levels - level):
            middle = (k - (levels - level - 1) / 2) * base
            for sign in (-1, 1):
                angle, off = sign * lean, -sign * thick / 2
                top = math.cos(angle) * off - math.sin(angle) * length / 2
                add(middle - top, floor - low, angle)
        floor += 2 * abs(low)
        if level < levels - 1:
            size = [base * 0.98, thick, width]
            for k in range(levels - level - 1):
                middle = (k - (levels - level - 2) / 2) * base
                add(middle, floor + thick / 2, 0, shape={"box": {"size": size}})
            floor += thick
    return cards


@pytest.mark.slow
@pytest.mark.parametrize("keys", [{}, AWAKE])
def test_a_house_of_cards_stands(tmp_path: Path, keys: dict[str, Any]) -> None:
    levels, last = (5, STANDING) if not keys else (3, 10.0)
    found = Rigid(tmp_path, *card_house(levels), colliders=[FLOOR], **keys)
    begin = found.to(0.0)
    assert_allclose(found.to(last), begin, atol=CREEP)


def test_a_house_of_cards_without_friction_falls(tmp_path: Path) -> None:
    cards = [{**card, "friction": 0.05} for card in card_house(3)]
    found = Rigid(tmp_path, *cards, colliders=[FLOOR])
    assert found.to(2.0)[:, 1].max() < 0.05


SHAPES = {
    "ball": {"sphere": {"radius": 0.1}},
    "capsule": {"capsule": {"radius": 0.06, "length": 0.15, "axis": [1, 2, 0]}},
    "box": {"box": {"size": [0.3, 0.15, 0.2]}},
}


@pytest.mark.slow
def test_shapes_of_all_kinds_come_to_rest_in_a_container(tmp_path: Path) -> None:
    random = np.random.default_rng(3)
    points = random.normal(size=(30, 3)) * 0.06
    np.savez(tmp_path / "rock.npz", points=points, triangles=[[0, 1, 2]])
    rock = {"mesh": {key: f"rock.npz#{key}" for key in ("points", "triangles")}}
    bodies = []
    for k, (name, shape) in enumerate({**SHAPES, "rock": rock}.items()):
        turn = so3.normalize(random.normal(size=4)).tolist()
        grid = {"count": [2, 3, 2], "spacing": [0.5, 0.7, 0.5]}
        at = [-0.3 + 0.05 * k, 0.7 + 0.6 * k, -0.25]
        bodies.append(
            {"name": name, "shape": shape, "at": at, "rotate": turn, "grid": grid}
        )
    tank = {"shape": {"box": {"size": [1.4, 9, 1.4]}}, "at": [0, 4.5, 0]}
    found = Rigid(tmp_path, *bodies, colliders=[{**tank, "container": True}])
    found.to(6.0)
    simulation, state = found.simulation, found.state
    assert np.abs(found.velocities()).max() < 0.1
    cores, owners = simulation.bodies.cores_and_bodies
    for core, i in zip(cores, owners, strict=True):
        row = state.motion[i]
        places = row[:3] + so3.rotate(row[3:7], core.points)
        assert (np.abs(places[:, [0, 2]]) < 0.7 - core.radius + 1e-3).all()
        assert places[:, 1].min() > core.radius - 1e-3
    assert "SIM125" in found.codes()


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("other", ["box", "capsule", "sphere", "mesh"])
def test_every_shape_rests_on_every_collider(
    tmp_path: Path, shape: str, other: str
) -> None:
    """At the height that both say."""
    x, z = np.meshgrid(np.linspace(-2, 2, 9), np.linspace(-2, 2, 9))
    grid = np.arange(81).reshape(9, 9)
    a, b, c, d = (
        grid[i : i + 8 or None, j : j + 8].ravel() for i in (0, 1) for j in (0, 1)
    )
    triangles = np.concatenate([np.stack([a, c, b], 1), np.stack([b, c, d], 1)])
    points = np.stack([x.ravel(), 0 * x.ravel(), z.ravel()], 1)
    np.savez(tmp_path / "ground.npz", points=points, triangles=triangles)
    files = {key: f"ground.npz#{key}" for key in ("points", "triangles")}
    colliders = {
        "box": {"shape": {"box": {"size": [4, 1, 4]}}, "at": [0, -0.5, 0]},
        "capsule": {
            "shape": {"capsule": {"radius": 1, "length": 4, "axis": [1, 0, 0]}},
            "at": [0, -1, 0],
        },
        "sphere": {"shape": {"sphere": {"radius": 5}}, "at": [0, -5, 0]},
        "mesh": {"shape": {"mesh": files}},
    }
    height = {"ball": 0.1, "capsule": 0.06, "box": 0.075}[shape]
    shapes = {
        **SHAPES,
        "capsule": {"capsule": {"radius": 0.06, "length": 0.15, "axis": [1, 0, 0]}},
    }
    body = {"name": shape, "shape": shapes[shape], "at": [0, height + 0.05, 0]}
    found = Rigid(tmp_path, {**body, "friction": 1}, colliders=[colliders[other]])
    assert found.to(1.5)[0, 1] == pytest.approx(height, abs=5e-4)


def test_what_slides_over_a_mesh_does_not_stumble(tmp_path: Path) -> None:
    """Edges between triangles of one plane are no bumps."""
    steps = np.linspace(-1, 9, 41)
    points = np.array([[x, 0, z] for x in steps for z in (-1.0, 1.0)])
    k = 2 * np.arange(40)
    triangles = np.concatenate(
        [np.stack([k, k + 1, k + 2], 1), np.stack([k + 2, k + 1, k + 3], 1)]
    )
    np.savez(tmp_path / "lane.npz", points=points, triangles=triangles)
    files = {key: f"lane.npz#{key}" for key in ("points", "triangles")}
    slab = box((0.3, 0.1, 0.3), at=[0, 0.05, 0], velocity=[4, 0, 0], friction=0)
    found = Rigid(tmp_path, slab, colliders=[{"shape": {"mesh": files}}])
    path = found.path(np.arange(1, 41) / 20)[:, 0]
    assert_allclose(path[:, 1], 0.05, atol=2e-4)
    assert_allclose(path[-1, 0], 8.0, rtol=1e-3)


def test_bodies_in_each_other_part_slowly(tmp_path: Path) -> None:
    other = {**box(CUBE, at=[0.2, 0.1, 0]), "name": "other"}
    found = Rigid(tmp_path, box(CUBE), other, forces=[])
    found.to(1.0)
    assert "SIM126" in found.codes()
    assert np.abs(found.velocities()).max() <= 2.0
    apart = found.to(2.0)
    assert np.abs(apart[1] - apart[0]).max() > 0.95


def test_who_sleeps_wakes_when_touched_and_when_its_support_goes(
    tmp_path: Path,
) -> None:
    plate = box((2, 0.2, 2), at=[0, -0.1, 0], kinematic=True)
    plate["moves"] = [[2, 0, 0, 0], [2.5, 0, -1, 0], [9, 0, -1, 0]]
    far = {**stack(3), "name": "far", "at": [8, 0.5, 0]}
    shot = {**ball(0.2, at=[3.2, 1.5, 0], velocity=[1.2, 0, 0]), "name": "shot"}
    found = Rigid(
        tmp_path, {**plate, "name": "plate"}, stack(3), far, {**shot, "mass": 900},
        colliders=[{**FLOOR, "at": [0, -1, 0]}, {"shape": {"box": {"size": [4, 1, 4]}},
                                                 "at": [8, -0.5, 0]}],
        forces=[{"gravity": {}}],
    )  # fmt: skip
    found.to(1.5)
    idle = found.state.motion[:, 13]
    assert (idle[:6] >= 0.5).all()
    assert idle[6] == 0
    found.to(2.4)
    assert (found.state.motion[:3, 13] == 0).all()
    assert found.to(4.0)[1, 1] == pytest.approx(-0.5, abs=0.02)
    assert (found.state.motion[3:6, 13] >= 0.5).all()


def test_a_chain_holds_together_and_keeps_its_energy(tmp_path: Path) -> None:
    link = {"shape": {"box": {"size": [0.2, 0.04, 0.04]}}, "mass": 0.1}
    bodies = [
        {"name": f"link {k}", **link, "at": [0.1 + 0.2 * k, 0, 0]} for k in range(8)
    ]
    joints = [
        {"type": "ball", "body": f"link {k}", "at": [0.2 * k, 0, 0],
         **({"to": f"link {k - 1}"} if k else {})}
        for k in range(8)
    ]  # fmt: skip
    found = Rigid(tmp_path, *bodies, joints=joints, residual=1e-6, iterations=100)
    begin = found.energy()
    for t in np.arange(1, 14) / 10:
        frame = found.run.at(float(t))
        ends = frame.points + so3.rotate(frame.rotations, np.array([0.1, 0, 0]))
        starts = frame.points + so3.rotate(frame.rotations, np.array([-0.1, 0, 0]))
        assert np.abs(ends[:-1] - starts[1:]).max() < 1e-3
        assert np.abs(starts[0]).max() < 1e-3
    assert found.energy() == pytest.approx(begin, abs=0.02)


def test_a_closed_loop_of_pins_stays_closed(tmp_path: Path) -> None:
    """Two bars and what hangs on them swing as a parallelogram."""
    bar = {"mass": 1}
    up, along = {"box": {"size": [0.05, 1, 0.05]}}, {"box": {"size": [1, 0.05, 0.05]}}
    bodies = [
        {"name": "left", "shape": up, "at": [0, -0.5, 0], **bar},
        {"name": "right", "shape": up, "at": [1, -0.5, 0], **bar},
        {
            "name": "top",
            "shape": along,
            "at": [0.5, -1, 0],
            **bar,
            "velocity": [1, 0, 0],
        },
    ]
    pin = {"type": "pin", "axis": [0, 0, 1]}
    joints = [
        {**pin, "body": "left", "at": [0, 0, 0]},
        {**pin, "body": "right", "at": [1, 0, 0]},
        {**pin, "body": "top", "to": "left", "at": [0, -1, 0]},
        {**pin, "body": "top", "to": "right", "at": [1, -1, 0]},
    ]
    found = Rigid(tmp_path, *bodies, joints=joints, **AWAKE)
    for t in np.arange(1, 30) / 10:
        frame = found.run.at(float(t))
        assert np.abs(frame.rotations[2, :3]).max() < 2e-3
        assert_allclose(frame.points[1] - frame.points[0], [1, 0, 0], atol=2e-3)
    assert frame.points[2, 1] > -1


@pytest.mark.slow
@pytest.mark.parametrize("side", [-1, 1])
def test_limits_hold(tmp_path: Path, side: int) -> None:
    arm = box((0.6, 0.1, 0.1), at=[0.3 * side, 0, 0])
    pin = {"type": "pin", "body": "box", "axis": [0, 0, 1], "limits": [-30, 20]}
    limit = math.radians(30 if side > 0 else 20)
    found = Rigid(tmp_path, arm, joints=[pin])
    assert found.to(3.0)[0, 1] == pytest.approx(-0.3 * math.sin(limit), abs=1e-3)
    cone = {
        "type": "ball",
        "body": "box",
        "axis": [side, 0, 0],
        "swing": 40,
        "twist": [-5, 5],
    }
    found = Rigid(tmp_path, arm, joints=[cone])
    assert found.to(3.0)[0, 1] == pytest.approx(
        -0.3 * math.sin(math.radians(40)), abs=1e-3
    )
    slide = {"type": "prismatic", "body": "box", "axis": [0, 1, 0], "limits": [-0.4, 1]}
    found = Rigid(tmp_path, arm, joints=[slide])
    assert_allclose(found.to(3.0)[0], [0.3 * side, -0.4, 0], atol=1e-3)


def angles(found: Rigid, times: Any) -> np.ndarray:
    """Return by how much a body has turned about z at times [deg]."""
    turns = np.array([found.run.at(float(t)).rotations[0] for t in times])
    return np.degrees(np.unwrap(2 * np.arctan2(turns[:, 2], turns[:, 3])))


@pytest.mark.parametrize("most", [190, 270, 350])
@pytest.mark.parametrize("side", [-1, 1])
def test_limits_beyond_half_a_turn_hold(tmp_path: Path, most: int, side: int) -> None:
    limits = sorted([0, side * most])
    pin = {"type": "pin", "body": "box", "axis": [0, 0, 1], "limits": limits}
    arm = box((1, 0.2, 0.2), spin=[0, 0, side * 400])
    found = Rigid(tmp_path, arm, joints=[pin], forces=[])
    turned = side * angles(found, np.arange(1, 31) / 20)
    assert_allclose(turned[:9], 20.0 * np.arange(1, 10), atol=1e-6)
    assert_allclose(turned[-10:], most, atol=0.1)


def test_a_motor_that_swings_past_half_a_turn_comes_back(tmp_path: Path) -> None:
    drive = {"target": 170, "stiffness": 50, "damping": 10}
    pin = {"type": "pin", "body": "box", "axis": [0, 0, 1], "drive": drive}
    found = Rigid(tmp_path, box((1, 0.2, 0.2)), joints=[pin], forces=[])
    turned = angles(found, np.arange(1, 101) / 20)
    assert 180 < turned.max() < 280
    assert turned[-1] == pytest.approx(170, abs=1)


@pytest.mark.parametrize("spin", [-90, 90])
@pytest.mark.parametrize("keys", [{"limits": [-5, 5]}, {"drive": {"stiffness": 9}}])
def test_limits_about_a_rod_leave_the_rest_of_its_joint(
    tmp_path: Path, keys: dict[str, Any], spin: float
) -> None:
    rod = ball(0.1, mass=1, inertia=[0, 0.3, 0.3], spin=[0, 0, spin])
    pin = {"type": "pin", "body": "ball", "axis": [1, 0, 0], **keys}
    found = Rigid(tmp_path, rod, joints=[pin], forces=[], step=0.01, substeps=1)
    assert_allclose(found.run.at(0.01).rotations, [[0, 0, 0, 1]], atol=1e-3)


def test_drives_hold_what_springs_hold(tmp_path: Path) -> None:
    arm = box((0.6, 0.1, 0.1), at=[0.3, 0, 0], mass=2)
    drive = {"stiffness": 300, "damping": 30, "target": 10}
    pin = {"type": "pin", "body": "box", "axis": [0, 0, 1], "drive": drive}
    found = Rigid(tmp_path, arm, joints=[pin], residual=1e-8)
    angle = math.asin(found.to(6.0)[0, 1] / 0.3)
    pull = 300 * (math.radians(10) - angle)
    assert pull == pytest.approx(2 * GRAVITY * 0.3 * math.cos(angle), rel=0.01)
    # What is too weak gives way.
    drive["most"] = 3
    found = Rigid(tmp_path, arm, joints=[pin])
    assert found.to(0.5)[0, 1] < -0.25


def test_a_motor_turns_a_ball_to_where_it_says(tmp_path: Path) -> None:
    goal = so3.exp(np.array([0.2, 0.5, -0.3]))
    drive = {"stiffness": 500, "damping": 40, "rotation": goal[[3, 0, 1, 2]].tolist()}
    ball_joint = {"type": "ball", "body": "box", "axis": [0, 1, 0], "drive": drive}
    found = Rigid(tmp_path, box((0.2, 0.3, 0.1)), joints=[ball_joint], forces=[])
    found.to(3.0)
    assert so3.angle_between(found.run.at(3.0).rotations[0], goal) < 1e-3


def test_a_joint_goes_with_what_moves(tmp_path: Path) -> None:
    hook = {"type": "ball", "body": "ball", "at": [0, 1, 0]}
    hook["moves"] = [[0, 0, 0, 0], [1, 1, 0, 0], [9, 1, 0, 0]]
    found = Rigid(tmp_path, ball(0.1, mass=5), joints=[hook])
    assert found.to(0.4)[0, 0] < 0.39
    for t in np.arange(5, 30) / 10:
        place = found.to(float(t))[0] - [min(t, 1.0), 1, 0]
        assert np.linalg.norm(place) == pytest.approx(1, abs=1e-3)


def test_a_saved_state_goes_on_as_the_whole(tmp_path: Path) -> None:
    one, other = (Rigid(tmp_path, stack(4), colliders=[FLOOR]) for _ in range(2))
    for run in (one, other):
        motion = run.state.motion.copy()
        motion[3, 7:10] = 0.5
        run.run.state = ReachedState(0, replace(run.state, motion=motion))
    one.to(0.4)
    other.run.state = one.run.state
    assert_array_equal(one.path([0.5, 1, 2]), other.path([0.5, 1, 2]))
