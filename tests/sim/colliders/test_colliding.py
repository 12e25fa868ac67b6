"""Particles among colliders: closed forms, laws and hard cases."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal
from support.suite import examples

from animtool.core.array_types import ArrayLike, FloatArray
from animtool.core.errors import OptionError
from animtool.maths import so3
from animtool.sim.colliders import (
    Box,
    Capsule,
    Collider,
    Colliders,
    CollisionResult,
    ContactKind,
    Mesh,
    Plane,
    Poses,
    Shape,
    Sphere,
    collide,
)

GRAVITY = 9.81
CORNERS = np.array(list(product((-0.5, 0.5), repeat=3)))
# Of a unit cube, counter-clockwise from outside.
CUBE = [
    *([0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1]),
    *([2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3]),
]
SHAPES: dict[str, Shape] = {
    "plane": Plane((1, 2, -1), 0.3),
    "sphere": Sphere(0.7, (0.2, 0, -0.1)),
    "capsule": Capsule(0.4, 1.5, (1, 1, 0), (0.1, 0.2, 0)),
    "box": Box((1, 2, 0.5)),
    "mesh": Mesh(CORNERS * [1, 2, 0.5], CUBE, closed=True),
}
CLOSED = ["sphere", "capsule", "box", "mesh"]


class Falling:
    """Particles under gravity, each step exact but for what they run into."""

    def __init__(
        self,
        colliders: Sequence[Collider],
        position: ArrayLike,
        velocity: ArrayLike = (0, 0, 0),
        gravity: float = GRAVITY,
    ) -> None:
        self.x = np.atleast_2d(np.asarray(position, np.float64))
        self.v = np.broadcast_to(np.asarray(velocity, np.float64), self.x.shape)
        self.colliders = Colliders(colliders)
        self.pull = np.array([0, -gravity, 0])
        self.time = 0.0

    def step(self, h: float) -> CollisionResult:
        x = self.x + self.v * h + self.pull * (h * h / 2)
        v = self.v + self.pull * h
        begin, self.time = self.time, self.time + h
        before = np.stack([self.x, self.v])
        done = collide(x, v, before, self.colliders, begin, self.time)
        self.x, self.v = done.points, done.velocities
        return done


def distances(collider: Collider, points: ArrayLike, t: float = 0.0) -> FloatArray:
    return Colliders([collider]).sample(points, t).distances[0]


def moving(shape: Shape, velocity: ArrayLike, **options: object) -> Collider:
    origins = np.outer([0.0, 10.0], np.asarray(velocity))
    poses = Poses([0, 10], origins, [[0, 0, 0, 1]] * 2)
    return Collider(shape, poses, **options)  # type: ignore[arg-type]


# Shapes


@pytest.mark.parametrize("name", CLOSED)
def test_distances_are_those_to_the_surface(name: str) -> None:
    points = np.random.default_rng(1).normal(0, 1, (400, 3))
    seen = Colliders([Collider(SHAPES[name])]).sample(points, 0.0)
    near = points - seen.normals[0] * seen.distances[0][:, None]
    assert_allclose(distances(Collider(SHAPES[name]), near), 0, atol=1e-12)
    assert_allclose(np.linalg.norm(seen.normals[0], axis=1), 1)


def test_a_capsule_is_the_union_of_balls_along_it() -> None:
    points = np.random.default_rng(2).normal(0, 1.5, (200, 3))
    capsule = SHAPES["capsule"]
    assert isinstance(capsule, Capsule)
    a, b = capsule.anchors()
    along = np.linspace(a, b, 4001)
    balls = np.linalg.norm(points[:, None] - along, axis=2).min(axis=1) - 0.4
    assert_allclose(distances(Collider(capsule), points), balls, atol=1e-6)


def test_a_mesh_of_a_box_is_the_box() -> None:
    points = np.random.default_rng(3).normal(0, 1, (2000, 3))
    box, mesh = (Colliders([Collider(SHAPES[n])]) for n in ("box", "mesh"))
    a, b = box.sample(points, 0.0), mesh.sample(points, 0.0)
    assert_allclose(a.distances, b.distances, atol=1e-12)
    assert_allclose(a.normals, b.normals, atol=1e-9)


def test_faces_with_corners_of_their_own_close_up() -> None:
    points = (CORNERS * [1, 2, 0.5])[np.array(CUBE).ravel()]
    apart = Mesh(points, np.arange(len(points)).reshape(-1, 3), closed=True)
    where = np.random.default_rng(4).normal(0, 1, (300, 3))
    whole = distances(Collider(SHAPES["mesh"]), where)
    assert_allclose(distances(Collider(apart), where), whole, atol=1e-12)


def test_several_meshes_keep_apart() -> None:
    small = Mesh(CORNERS * 0.2, CUBE, closed=True)
    both = Colliders([Collider(SHAPES["mesh"]), Collider(small)])
    points = np.random.default_rng(5).normal(0, 1, (100, 3))
    seen = both.sample(points, 0.0).distances
    assert_allclose(seen[1], distances(Collider(small), points))
    assert_allclose(seen[0], distances(Collider(SHAPES["mesh"]), points))


def test_beyond_the_rim_of_an_open_mesh_nothing_is_inside() -> None:
    corners = [[0, 0, 0], [0, 0, 1], [1, 0, 0]]
    sheet = Mesh(corners, [[0, 1, 2]], closed=True)
    seen = distances(Collider(sheet), [[0.2, -0.1, 0.2], [-1, -0.1, 0.2]])
    assert seen[0] == pytest.approx(-0.1)
    assert seen[1] > 1


def test_the_middle_of_a_shape_has_a_way_out() -> None:
    shapes = [Sphere(1), Capsule(1, 2), Capsule(1, 0), Box((1, 1, 1))]
    seen = Colliders([Collider(shape) for shape in shapes]).sample([[0, 0, 0]], 0.0)
    assert_allclose(np.linalg.norm(seen.normals, axis=2), 1)
    assert_allclose(seen.distances[:, 0], [-1, -1, -1, -0.5])


def test_containers_are_the_other_way_round() -> None:
    points = [[0.1, 0.2, 0.3], [2, 2, 2]]
    for shape in SHAPES.values():
        inside = distances(Collider(shape, container=True), points)
        assert_allclose(inside, -distances(Collider(shape), points))


# Contacts


@pytest.mark.parametrize(
    "shape", [Plane(), Box((9, 2, 9)), Mesh(CORNERS * 9, CUBE, closed=True)]
)
@pytest.mark.parametrize("restitution", [0.3, 0.8, 1.0])
def test_bounces_are_as_high_as_they_should(shape: Shape, restitution: float) -> None:
    top = {Plane: 0.0, Box: 1.0, Mesh: 4.5}[type(shape)]
    floor = Collider(shape, restitution=restitution)
    ball = Falling([floor], [0.01, top + 1, 0.02])
    heights, up = [], False
    while len(heights) < 3:
        h = 1 / 173
        rising = ball.v[0, 1] > 0
        if up and not rising:
            heights.append(ball.x[0, 1] + ball.v[0, 1] ** 2 / (2 * GRAVITY) - top)
        up = rising
        ball.step(h)
    expected = restitution ** (2 * np.arange(1, 4))
    assert_allclose(heights, expected, rtol=1e-6, atol=1e-7)


@pytest.mark.parametrize("h", [1 / 24, 1 / 240])
def test_sliding_stops_where_friction_says(h: float) -> None:
    puck = Falling([Collider(Plane(), friction=0.3)], [0, 0, 0], [2, 0, 1])
    for _ in range(round(2 / h)):
        puck.step(h)
    way = np.hypot(2, 1) ** 2 / (2 * 0.3 * GRAVITY)
    assert np.linalg.norm(puck.x) == pytest.approx(way, rel=1e-9)
    assert_array_equal(puck.v, 0)


@pytest.mark.parametrize(("friction", "slides"), [(0.5, True), (0.6, False)])
def test_a_slope_holds_up_to_its_friction(friction: float, slides: bool) -> None:
    angle = np.radians(29)
    slope = Plane((np.sin(angle), np.cos(angle), 0))
    puck = Falling([Collider(slope, friction=friction)], [0, 0, 0])
    for _ in range(48):
        puck.step(1 / 24)
    pull = GRAVITY * (np.sin(angle) - friction * np.cos(angle))
    expected = pull * 2 if slides else 0
    assert np.linalg.norm(puck.v) == pytest.approx(expected, rel=1e-6, abs=1e-9)


def test_a_particle_at_rest_stays_a_minute_without_a_sign_of_life() -> None:
    puck = Falling([Collider(Plane(), friction=0.5, restitution=0.5)], [0, 0, 0])
    for _ in range(60 * 24):
        puck.step(1 / 24)
        assert np.abs(puck.v).max() < 1e-6
    assert_allclose(puck.x, 0, atol=1e-9)


def test_a_piston_gives_its_speed_twice_over() -> None:
    piston = moving(Box((1, 1, 1)), (3, 0, 0), restitution=1.0)
    ball = Falling([piston], [1, 0.1, 0], gravity=0)
    for _ in range(24):
        ball.step(1 / 24)
    assert_allclose(ball.v, [[6, 0, 0]], atol=1e-9)
    # It was hit after 0.5 m of the piston's way.
    assert_allclose(ball.x, [[1 + 6 * (1 - 0.5 / 3), 0.1, 0]], atol=1e-6)


def test_a_lift_carries_what_stands_on_it() -> None:
    lift = moving(Box((2, 1, 2)), (1, 2, 0), friction=1.0)
    puck = Falling([lift], [0, 0.5, 0], [1, 2, 0])
    for _ in range(24):
        puck.step(1 / 24)
    assert_allclose(puck.x, [[1, 2.5, 0]], atol=1e-8)
    assert_allclose(puck.v, [[1, 2, 0]], atol=1e-8)


def test_a_turning_bat_hits_with_the_speed_of_its_place() -> None:
    times = np.linspace(0, 1, 25)
    turns = so3.from_axis_angle([0, 1, 0], times[:, None] * np.pi)
    poses = Poses(times, np.zeros((25, 3)), np.atleast_2d(turns).reshape(25, 4))
    bat = Collider(Capsule(0.05, 4, (1, 0, 0)), poses, restitution=1.0)
    ball = Falling([bat], [0, 0, -1.5], gravity=0)
    for _ in range(24):
        ball.step(1 / 24)
    assert np.linalg.norm(ball.v) == pytest.approx(2 * np.pi * 1.5, rel=2e-3)


@settings(max_examples=examples(60))
@given(
    st.sampled_from(["sphere", "capsule", "box", "mesh"]),
    st.floats(1, 2000),
    st.integers(0, 10_000),
)
def test_nothing_is_passed_through_however_long_the_step(
    name: str, speed: float, seed: int
) -> None:
    random = np.random.default_rng(seed)
    way = random.normal(size=(20, 3))
    way /= np.linalg.norm(way, axis=1)[:, None]
    x = -way * 5
    collider = Collider(SHAPES[name])
    end = x + way * speed * 0.5
    before = np.stack([x, way * speed])
    done = collide(end, way * speed, before, [collider], 0, 0.5)
    if name in {"box", "mesh"} and speed > 10:
        assert done.contacts.any.all()
    assert (distances(collider, done.points) >= -1e-9).all()


@pytest.mark.parametrize("speed", [1.0, 30.0, 150.0])
def test_a_thin_board_sweeps_up_what_stands_in_its_way(speed: float) -> None:
    board = moving(Box((0.001, 2, 2)), (speed, 0, 0))
    ball = Falling([board], [0.3, 0.1, 0], gravity=0)
    for h in (1 / 24, 0.5, 1 / 24):
        ball.step(h)
    assert ball.v[0, 0] == pytest.approx(speed)
    assert ball.x[0, 0] >= speed * ball.time


@pytest.mark.parametrize("name", CLOSED)
def test_what_is_in_a_container_stays_there(name: str) -> None:
    container = Collider(SHAPES[name], container=True, restitution=0.9, friction=0.1)
    random = np.random.default_rng(7)
    flies = Falling([container], np.full((20, 3), 0.05), random.normal(0, 20, (20, 3)))
    for h in [1 / 24] * 20 + [0.5, 1 / 24]:
        flies.step(h)
        assert (distances(container, flies.x) >= -1e-8).all()
        assert np.isfinite(flies.v).all()


def test_a_corner_of_floor_and_walls_holds() -> None:
    corner = [Collider(Plane(n), friction=0.2) for n in np.eye(3)]
    puck = Falling(corner, [0.3, 0.3, 0.3], [-3, 0, -2])
    for _ in range(48):
        puck.step(1 / 24)
        assert (puck.x >= -1e-9).all()
    assert_allclose(puck.v, 0, atol=1e-9)


def test_margins_and_radii_add_up() -> None:
    floor = Collider(Plane(), margin=0.1)
    before = [[[0, 1, 0]], [[0, -9, 0]]]
    done = collide([[0, -1, 0]], [[0, -9, 0]], before, [floor], 0, 1, radii=0.2)
    assert done.points[0, 1] == pytest.approx(0.3)


def test_what_meets_nothing_is_bit_for_bit_what_it_was() -> None:
    random = np.random.default_rng(8)
    x, v, x0, v0 = random.normal(0, 1, (4, 50, 3))
    far = Collider(Sphere(1, (90, 0, 0)))
    done = collide(x, v, [x0, v0], [far], 0, 1 / 24)
    assert_array_equal(done.points, x)
    assert_array_equal(done.velocities, v)
    assert not done.contacts.any.any()
    none = collide(x, v, [x0, v0], [], 0, 1 / 24)
    assert_array_equal(none.points, x)


# Hard cases


@pytest.mark.parametrize("name", CLOSED)
def test_a_deep_start_leaves_without_a_pop(name: str) -> None:
    collider = Collider(SHAPES[name], depenetration=0.5)
    sunk = Falling([collider], [0.05, 0.1, 0.02], gravity=0)
    deep = distances(collider, sunk.x)[0]
    for _ in range(72):
        before = sunk.x
        done = sunk.step(1 / 24)
        assert np.linalg.norm(sunk.x - before) <= 0.5 / 24 + 1e-9
        assert np.linalg.norm(sunk.v) < 1e-9
        if distances(collider, before)[0] < -0.1:
            assert done.contacts.touches[0] == ContactKind.UNRESOLVED
    assert deep < -0.1
    assert distances(collider, sunk.x)[0] >= -1e-8


def test_a_collider_that_jumps_takes_nothing_along() -> None:
    times = [0, 1, 1 + 1 / 24, 2]
    origins = [[0, 0, 0], [0, 0, 0], [100, 0, 0], [100, 0, 0]]
    jumping = Collider(Sphere(1), Poses(times, origins, [[0, 0, 0, 1]] * 4))
    dust = Falling([jumping], [[1.5, 0, 0], [50, 0, 0], [100.5, 0, 0]], gravity=0)
    for _ in range(60):
        dust.step(1 / 48)
    assert_array_equal(dust.v, 0)
    assert_array_equal(dust.x[:2], [[1.5, 0, 0], [50, 0, 0]])
    assert 100.5 < dust.x[2, 0] <= 101
    codes = [notice.code for notice in Colliders([jumping]).notices()]
    assert codes == ["SIM120"]


@pytest.mark.parametrize("restitution", [0.0, 0.9])
def test_what_is_pinched_is_finite_and_said(restitution: float) -> None:
    closing = [
        moving(Capsule(0.2, 1, centre=(-0.5, 0, 0)), (0.5, 0, 0)),
        moving(Capsule(0.2, 1, centre=(0.5, 0, 0)), (-0.5, 0, 0)),
    ]
    closing = [
        Collider(c.shape, c.poses, restitution=restitution, friction=0.3)
        for c in closing
    ]
    pea = Falling(closing, [0.01, 0, 0], gravity=0)
    touches = [int(pea.step(1 / 24).contacts.touches[0]) for _ in range(20)]
    assert np.isfinite(pea.x).all()
    assert np.abs(pea.v).max() <= 5
    assert ContactKind.UNRESOLVED in touches


def test_a_step_of_no_time_changes_nothing() -> None:
    floor = Collider(Plane())
    done = collide(
        [[0, -1, 0]], [[0, 1, 0]], [[[0, -1, 0]], [[0, 1, 0]]], [floor], 1, 1
    )
    assert_array_equal(done.points, [[0, -1, 0]])


@settings(max_examples=examples(40))
@given(
    st.sampled_from(sorted(SHAPES)),
    st.integers(0, 10_000),
    st.booleans(),
)
def test_it_does_not_matter_where_the_world_is(
    name: str, seed: int, container: bool
) -> None:
    random = np.random.default_rng(seed)
    origins = random.normal(0, 0.2, (2, 3))
    turns = so3.exp(random.normal(0, 0.3, (2, 3)))
    x0, v0, x1, v1 = random.normal(0, 1.5, (4, 30, 3))
    away, turn = random.normal(0, 5, 3), so3.exp(random.normal(0, 2, 3))

    def done(shift: FloatArray, spin: FloatArray) -> tuple[FloatArray, FloatArray]:
        def turned(values: FloatArray) -> FloatArray:
            return so3.rotate(spin, values)

        poses = Poses([0, 0.1], turned(origins) + shift, so3.multiply(spin, turns))
        one = Collider(
            SHAPES[name], poses, restitution=0.4, friction=0.2, container=container
        )
        before = np.stack([turned(x0) + shift, turned(v0)])
        found = collide(turned(x1) + shift, turned(v1), before, [one], 0, 0.1)
        back = so3.conjugate(spin)
        points = so3.rotate(back, found.points - shift)
        return points, so3.rotate(back, found.velocities)

    here = done(np.zeros(3), np.array([0.0, 0, 0, 1]))
    there = done(away, turn)
    # Where faces of a container meet, rounding says which is met first, and friction on
    # it changes what the other does.
    edged = container and name in {"box", "mesh"}
    apart = np.abs(here[0] - there[0]).max(axis=1) > 1e-6
    apart |= np.abs(here[1] - there[1]).max(axis=1) > 1e-5
    assert apart.sum() <= (2 if edged else 0)


# Faults


def test_all_that_makes_no_sense_is_said_at_once() -> None:
    odd = [
        Collider(Sphere(-1), restitution=2, friction=-1, margin=np.nan),
        Collider(Box((1, 0, 1)), depenetration=0, speed_limit=-1),
        Collider(Capsule(1, -1, (0, 0, 0))),
        Collider(Plane((np.nan, 0, 0), np.inf)),
        Collider(Mesh([[0, 0, 0]], [[0, 0, 1]])),
        Collider(Mesh([[0, 0, 0]], [[0, 0, 0]])),
        Collider(Sphere(1), Poses([1, 1], [[0, 0, 0]], [[0, 0, 0, 1]])),
        Collider(Sphere(1), Poses([0], [[0, 0]], [[0, 0, 0, 0]])),
    ]
    with pytest.raises(OptionError) as error:
        Colliders(odd)
    assert {fault.code for fault in error.value.faults} == {"SIM020"}
    assert [fault.where for fault in error.value.faults] == [
        f"colliders[{i}]" for i in (0, 0, 0, 0, 1, 1, 1, 2, 2, 3, 3, 4, 5, 6, 7, 7)
    ]


@pytest.mark.parametrize("side", [1.0, -1.0])
@pytest.mark.parametrize(("out", "met"), [(0.5, False), (1e-3, False), (-0.5, True)])
def test_who_leaves_a_sheet_of_two_sides_does_not_touch_it(
    side: float, out: float, met: bool
) -> None:
    """It is on it, a radius off, and goes its own way along it."""
    points = np.array([[-1.0, 0, -1], [1, 0, -1], [1, 0, 1], [-1, 0, 1]])
    sheet = Collider(Mesh(points, np.array([[0, 1, 2], [0, 2, 3]])))
    x = np.array([[0.2, 0.1 * side, 0.1]])
    v = np.array([[0.3, out * side, 0.0]])
    after = x + 0.25 * v
    found = collide(after, v, np.stack([x, v]), [sheet], 0.0, 0.25, 0.1)
    assert found.contacts.any.tolist() == [met]
    if not met:
        assert_allclose(found.points, after, atol=1e-12)
        assert_allclose(found.velocities, v, atol=1e-12)


@pytest.mark.parametrize("wall", [1.0, 0.5, -0.5])
@pytest.mark.parametrize("across", [0.0, 2.0])
def test_who_meets_a_wall_on_its_way_bounces_as_it_comes(
    wall: float, across: float
) -> None:
    """By 1 m/s against a wall a metre off that goes by as much, or goes away."""
    ends = [[0.0, 0, 0], [wall * 4, across * 4, 0]]
    poses = Poses([0.0, 4.0], ends, [[0, 0, 0, 1]] * 2)
    own = Collider(Plane((1.0, 0, 0), 0.0), poses, restitution=1.0)
    x, v = np.array([[1.0, 0.0, 0.0]]), np.array([[-1.0, across / 2, 0]])
    found = collide(x + 4 * v, v, np.stack([x, v]), [own], 0.0, 4.0)
    t = 1 / (1 + wall)
    away = 2 * wall + 1
    assert_allclose(found.velocities, [[away, across / 2, 0]], atol=1e-6)
    assert_allclose(found.points, [[1 - t + away * (4 - t), 2 * across, 0]], atol=1e-6)
