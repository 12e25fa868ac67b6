"""What members do by themselves, in numbers: goals, ways, speeds, walls and limits."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

from animtool.core.errors import Severity
from animtool.sim.colliders import Collider, Colliders, Plane, Poses, Sphere
from animtool.systems.flocks.flock import FlockForces
from animtool.systems.flocks.members import Members
from animtool.systems.flocks.rules import Spacing, build_rules, periodic_box
from animtool.systems.flocks.spec import DomainModel, SpeciesModel
from animtool.systems.flocks.steering import (
    avoidance_accelerations,
    clamp_speeds,
    goal_accelerations,
    limit_steering,
)


def members(*species: dict[str, Any], count: int = 1, goals: int = 0) -> Members:
    """Return so many members of each species."""
    models = [
        SpeciesModel.model_validate({"name": f"s{i}", **one})
        for i, one in enumerate(species)
    ]
    places = {"goals": [{"poses": Poses.fixed((1.0, 0.0, 0.0))}] * goals}
    ends = (np.arange(len(models)) + 1) * count
    rows = np.zeros((len(models) * count, 3))
    return Members(models, ends.tolist(), [places] * len(models), 0.0, rows, rows)


def ways(x: list[float], v: list[float], goals: int = 0, **keys: Any) -> np.ndarray:
    own = members(keys, goals=goals)
    return goal_accelerations(own, 0.0, np.array([x], float), np.array([v], float))[0]


@pytest.mark.parametrize(("speed", "gain"), [(2.0, 3.0), (3.0, 0.0), (5.0, -24.0)])
def test_they_tend_to_their_cruise_by_the_lack_of_its_square(
    speed: float, gain: float
) -> None:
    """0.3 of (9 - speed²) times the velocity."""
    found = ways([0, 0, 0], [0, speed, 0], speed={"cruise": 3, "weight": 0.3})
    assert_allclose(found, [0, gain, 0], atol=1e-12)


@pytest.mark.parametrize(
    ("x", "goal", "pull"),
    [
        (6.0, {"weight": 2}, -10.0),
        (6.0, {"weight": 2, "radius": 2}, -6.0),
        (2.5, {"weight": 2, "radius": 2}, 0.0),
        (6.0, {"weight": 2, "radius": 2, "limit": 4}, -4.0),
        (6.0, {"weight": -1}, 5.0),
    ],
)
def test_a_goal_pulls_by_what_is_beyond_its_radius(
    x: float, goal: dict[str, float], pull: float
) -> None:
    quiet = {"weight": 0}
    own = members({"speed": quiet, "goals": [{"at": [1, 0, 0], **goal}]}, goals=1)
    found = goal_accelerations(own, 0.0, np.array([[x, 0.0, 0.0]]), np.zeros((1, 3)))
    assert_allclose(found, [[pull, 0, 0]], atol=1e-12)


@pytest.mark.parametrize(
    ("x", "target", "more"),
    [
        # 2 m ahead of where it is nearest, round the corner and not beyond the end.
        ([1, 1, 0], [3, 0, 0], {}),
        ([3, -1, 0], [4, 1, 0], {}),
        ([5, 2, 0], [4, 3, 0], {}),
        ([5, 2, 0], [1.6, 1.2, 0], {"closed": True, "ahead": 4}),
        ([-3, 0, 0], [2, 0, 0], {}),
    ],
)
def test_a_way_is_followed_so_far_ahead(
    x: list[float], target: list[float], more: dict[str, Any]
) -> None:
    path = {"points": [[0, 0, 0], [4, 0, 0], [4, 3, 0]], "weight": 0.5, "ahead": 2}
    keys = {"speed": {"weight": 0}, "paths": [{**path, **more}]}
    found = ways(x, [0, 0, 0], **keys)
    assert_allclose(found, 0.5 * (np.array(target, float) - x), atol=1e-12)


@pytest.mark.parametrize(
    ("height", "speed", "away"),
    [
        (3.1, -3.0, 0.0),
        (1.6, -3.0, 0.5 * (0.5 * 10 + 9 / 3)),  # 1.5 m left: half as near
        (1.6, 3.0, 0.5 * 0.5 * 10),
        (0.7, -4.0, 0.8 * (0.8 * 10 + 16 / 1.2)),
        (0.1, -1.0, 10 + 1 / 0.2),  # the room is a radius at least
    ],
)
def test_a_wall_stops_who_comes_within_the_room_that_is_left(
    height: float, speed: float, away: float
) -> None:
    """From 3 m on; by the square of its speed over twice the room, beside a push."""
    own = members({"radius": 0.1, "avoidance": {"distance": 3, "weight": 10}})
    floor = Colliders([Collider(Plane(), Poses.fixed())])
    x, v = np.array([[0.0, height, 0.0]]), np.array([[1.0, speed, 0.0]])
    found = avoidance_accelerations(own, floor, 0.0, x, v)
    assert_allclose(found, [[0, away, 0]], atol=1e-9)


def test_a_wall_that_comes_is_avoided_as_one_that_is_flown_at() -> None:
    own = members({"radius": 0.1, "avoidance": {"distance": 3, "weight": 10}})
    ends = [[0.0, -2.0, 0.0], [0.0, 2.0, 0.0]]
    ball = Collider(Sphere(1.0), Poses([0.0, 1.0], ends, [[0, 0, 0, 1]] * 2))
    x, still, down = np.array([[0.0, 1.0, 0.0]]), np.zeros((1, 3)), np.zeros((1, 3))
    down[0, 1] = -4.0
    comes = avoidance_accelerations(own, Colliders([ball]), 0.25, x, still)
    held = Collider(Sphere(1.0), Poses([0.0], [[0.0, -1.0, 0.0]], [[0, 0, 0, 1]]))
    flown = avoidance_accelerations(own, Colliders([held]), 0.25, x, down)
    assert_allclose(comes, flown, rtol=1e-9)
    # Braked by the square of 4 m/s over twice the gap of .9 m, and pushed by .7 of 10.
    assert comes[0, 1] == pytest.approx(0.7 * (7.0 + 16.0 / 1.8), rel=1e-9)


def test_walls_push_each_by_itself_whoever_is_far_from_the_first() -> None:
    """A floor far below two, and two balls of which each is near one of them."""
    own = members({"radius": 0.1, "avoidance": {"distance": 3, "weight": 10}}, count=2)
    x = np.array([[0.0, 50.0, 0.0], [9.0, 50.0, 0.0]])
    walls = [
        Collider(Plane(), Poses.fixed()),
        Collider(Sphere(1.0), Poses.fixed((0.0, 51.6, 0.0))),
        Collider(Sphere(1.0), Poses.fixed((11.6, 50.0, 0.0))),
    ]
    found = avoidance_accelerations(own, Colliders(walls), 0.0, x, np.zeros((2, 3)))
    away = [10 * (1 - gap / 3) ** 2 for gap in (0.5, 1.5)]
    assert_allclose(found, [[0, -away[0], 0], [-away[1], 0, 0]], atol=1e-9)


def test_a_wall_is_avoided_from_a_metre_and_a_half_on() -> None:
    """Unless another distance is given; its push of 10 m/s² grows to the wall."""
    floor = Colliders([Collider(Plane(), Poses.fixed())])
    own = members({"radius": 0.1})
    for gap, push in ((1.51, 0.0), (0.75, 2.5), (0.3, 6.4), (0.0, 10.0)):
        x = np.array([[0.0, gap + 0.1, 0.0]])
        found = avoidance_accelerations(own, floor, 0.0, x, np.zeros((1, 3)))
        assert_allclose(found, [[0, push, 0]], atol=1e-9)


@pytest.mark.parametrize(
    ("apart", "closing", "each"),
    [
        (1.7, 3.0, 0.3 * 9 / (2 * 0.7) / 2),
        (1.05, 3.0, 0.95 * 9 / (2 * 0.1) / 2),  # a tenth of the distance at least
        (0.9, 3.0, 9 / (2 * 0.1) / 2),
        (1.7, -3.0, 0.0),
        (2.1, 3.0, 0.0),  # beyond twice the distance
    ],
)
def test_two_that_close_in_brake_by_the_room_that_is_left(
    apart: float, closing: float, each: float
) -> None:
    """Of a least distance of a metre, off axis; one stands, both brake alike.

    The less the nearer they are to twice the distance.
    """
    spacing = Spacing(np.array([1.0, 1.0]), np.zeros((2, 3)))
    way = np.array([2.0, -1, 2]) / 3
    x = np.array([[5.0, 6, 7], [5, 6, 7] + apart * way])
    found = spacing.braking_accelerations(x, np.array([closing * way, [0, 0, 0]]))
    assert_allclose(found, each * np.array([-way, way]), atol=1e-9)


def test_a_step_ends_at_a_wall_and_is_itself_away_from_it() -> None:
    """A plane holds a member a radius off, and its speed towards it is lost."""
    own = members({"radius": 0.1}, count=2)
    floor = Colliders([Collider(Plane(), Poses.fixed())])
    forces = FlockForces(own, None, floor, (), (), np.zeros((2, 2, 3)))
    v = np.array([[1.0, -2, 0.5], [1, -2, 0.5]])
    before = np.stack([np.array([[0.0, 0.3, 0], [3, 2, 0]]), v])
    after = np.stack([before[0] + 0.125 * v, v])
    found = forces.settle(0.5, 0.125, before, after)
    assert_allclose(found[0], [[0.125, 0.1, 0.0625], [3.125, 1.75, 0.0625]])
    assert_allclose(found[1][1], v[1])
    assert found[1][0, 1] >= 0
    assert_allclose(found[1][0, [0, 2]], [1, 0.5])


def test_who_closes_in_is_slower_at_the_end_of_a_step() -> None:
    """By the step times what stops both; who is far off keeps the step's speed."""
    own = members({"radius": 0.1}, count=3)
    spacing = Spacing(np.array([1.0, 1.0, 1.0]), np.zeros((2, 3)))
    forces = FlockForces(
        own, None, Colliders([]), (), (), np.zeros((2, 3, 3)), spacing=spacing
    )
    x = np.array([[5.0, 6, 7], [6.7, 6, 7], [50, 6, 7]])
    before = np.array([[2.0, 0, 0], [0, 0, 0], [1, 1, 1]])
    v = np.array([[3.0, 0, 0], [0, 0, 0], [2, 2, 2]])
    each = 0.3 * 9 / (2 * 0.7) / 2
    found = forces._brake_velocities(0.1, before, x, v)
    expected = [[3 - 0.1 * each, 0, 0], [0.1 * each, 0, 0], [2, 2, 2]]
    assert_allclose(found, expected, atol=1e-12)
    settled = forces.settle(0.0, 0.1, np.stack([x, before]), np.stack([x, v]))
    assert_allclose(settled, [x, expected], atol=1e-12)


def test_who_is_moved_apart_is_named_where_a_file_gave_the_place() -> None:
    """Both are warnings; of the others nobody is told but that there are too many."""
    model = SpeciesModel.model_validate({"name": "s", "radius": 0.1})
    rows = np.array([[0.0, 0, 0], [1, 0, 0], [1.05, 0, 0]])
    for parts, codes in (({"points": rows}, ["SIM147"]), ({}, [])):
        own = Members([model], [3], [parts], 0.0, rows, 0 * rows)
        moved = rows + np.array([[0.0, 0, 0], [0, 0, 0], [0.15, 0, 0]])
        found = own.separation_notices(moved, 0.0)
        assert [fault.code for fault in found] == codes
        for fault in found:
            assert fault.severity is Severity.WARNING
            assert "1 member would" in fault.message
            assert "member 2 of 's' first: moved apart by up to 0.15 m" in fault.message
        (crowded,) = own.separation_notices(rows, 0.05)
        assert (crowded.code, crowded.severity) == ("SIM147", Severity.WARNING)
        assert "50 mm closer" in crowded.message
        assert crowded.where == "species[0].count"


def test_limits_of_turning_and_acceleration() -> None:
    """At 2 m/s 90 degrees a second are an acceleration of pi m/s² across."""
    own = members({"turning": 90})
    v = np.array([[2.0, 0.0, 0.0]])
    assert_allclose(limit_steering(own, v, np.array([[5.0, 8, 0]])), [[5, np.pi, 0]])
    assert_allclose(limit_steering(own, v, np.array([[5.0, 3, 0]])), [[5, 3, 0]])
    assert_allclose(limit_steering(own, 0 * v, np.array([[5.0, 8, 0]])), [[5, 8, 0]])
    own = members({"acceleration": 2})
    assert_allclose(limit_steering(own, v, np.array([[3.0, 0, 4]])), [[1.2, 0, 1.6]])


def test_speeds_are_those_of_each_species() -> None:
    own = members({"speed": {"least": 1, "most": 2}}, {"speed": {"cruise": 2}}, count=2)
    v = np.array([[0.3, 0.4, 0], [3, 4, 0], [3, 4, 0], [0.3, 0.4, 0]])
    expected = [[0.6, 0.8, 0], [1.2, 1.6, 0], [2.4, 3.2, 0], [0.3, 0.4, 0]]
    assert_allclose(clamp_speeds(own, v), expected)
    assert_allclose(clamp_speeds(own, 0 * v), 0)


def test_rules_are_of_half_the_angle_and_no_farther_than_they_see() -> None:
    vision = {"radius": 2, "angle": 200, "nearest": 7}
    keys = {"attraction": {"weight": 1, "radius": 5}, "alignment": {"weight": 2}}
    repulsion = {"weight": 3, "radius": 0.5, "softening": 0.2}
    (rule,) = build_rules(members({"vision": vision, **keys, "repulsion": repulsion}))
    assert rule.view_cosine == pytest.approx(-np.sin(np.radians(10)))
    assert (rule.radius, rule.nearest, rule.softening) == (2, 7, 0.2)
    assert rule.attraction == (1, 2)
    assert rule.alignment == (2, 2)
    assert rule.repulsion == (3, 0.5)


def test_who_flees_and_who_chases_heeds_the_other_species_alone() -> None:
    none = {k: {"weight": 0} for k in ("attraction", "alignment", "repulsion")}
    flees = [{"species": "s1", "weight": 40, "radius": 6}]
    chases = [{"species": "s0", "weight": 3, "radius": 20}]
    own = members({**none, "flees": flees}, {**none, "chases": chases}, count=2)
    away, after = build_rules(own)
    assert away.members is not None
    assert away.targets is not None
    assert (away.members.tolist(), away.targets.tolist()) == ([0, 1], [2, 3])
    assert (away.repulsion, away.radius, away.nearest) == ((40, 6), 6, 0)
    assert after.targets is not None
    assert after.targets.tolist() == [0, 1]
    assert (after.attraction, after.radius, after.nearest) == ((3, 20), 20, 1)


def test_a_domain_that_wraps_is_about_its_middle() -> None:
    domain = DomainModel(at=[1, 5, -2], size=[4, 10, 6], wrap=True)
    assert_allclose(periodic_box(domain), [[-1, 0, -5], [4, 10, 6]])
    assert not periodic_box(DomainModel(size=[4, 10, 6])).any()


def test_what_they_would_like_to_do_is_left_as_it_is() -> None:
    wanted, v = np.full((2, 3), 40.0), np.tile([3.0, 0, 0], (2, 1))
    own = members({"turning": 30, "acceleration": 5}, count=2)
    found = limit_steering(own, v, wanted)
    assert (wanted == 40).all()
    assert (v == [3, 0, 0]).all()
    assert_allclose(np.linalg.norm(found, axis=1), 5.0)
