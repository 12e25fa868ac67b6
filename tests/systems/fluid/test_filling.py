"""Where fluid begins and comes in, place by place."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

from animtool.core.errors import AnimtoolError
from animtool.maths import so3
from animtool.sim.colliders import (
    Box,
    Capsule,
    Collider,
    Colliders,
    Plane,
    Poses,
    Sphere,
)
from animtool.systems.fluid.filling import (
    Nozzle,
    _check_count,
    _check_distinct,
    _check_outside,
    _lattice_points,
    coarse_drop_warnings,
    find_clear_points,
    initial_fluid,
)
from animtool.systems.fluid.spec import FluidModel

NONE = Colliders([])
QUARTER = so3.exp(np.array([0.0, 0, np.pi / 2]))


def spec(**keys: Any) -> FluidModel:
    return FluidModel.model_validate({"name": "it", "spacing": 0.1, **keys})


def sorted_rows(x: Any) -> np.ndarray:
    x = np.round(np.asarray(x, float), 9) + 0.0
    return x[np.lexsort(x.T)]


def test_a_lattice_stands_about_the_middle_of_its_shape() -> None:
    """A turned box of 3 by 2 by 1; a ball off its origin; what is thin has a layer."""
    pose = Poses([0], [[5, 6, 7]], [QUARTER])
    found = _lattice_points(spec(), Box((0.3, 0.2, 0.1)), pose, 0.0)
    expected = [[5 - y, 6 + x, 7] for x in (-0.1, 0, 0.1) for y in (-0.05, 0.05)]
    assert_allclose(sorted_rows(found), sorted_rows(expected))
    ball = _lattice_points(spec(), Sphere(0.1, (1, 2, 3)), Poses.fixed(), 0.0)
    expected = np.array(np.meshgrid(*[[-0.05, 0.05]] * 3)).reshape(3, -1).T
    assert_allclose(sorted_rows(ball), sorted_rows(expected + np.array([1, 2, 3])))
    thin = _lattice_points(spec(), Box((0.1, 0.02, 0.26)), Poses.fixed(), 0.0)
    assert_allclose(sorted_rows(thin), [[0, 0, -0.1], [0, 0, 0], [0, 0, 0.1]])


def test_fills_end_half_a_spacing_before_walls_and_have_their_velocity() -> None:
    fill = {"shape": {"box": {"size": [0.1, 0.4, 0.1]}}, "velocity": [1, 2, 3]}
    own = spec(fills=[fill, {"points": "a.npz"}])
    shape = {"shape": Box((0.1, 0.4, 0.1)), "poses": Poses.fixed()}
    given = {"points": np.array([[7.0, 8, 9]]), "velocities": np.array([[4.0, 5, 6]])}
    for height, ys in (
        (-0.1, [-0.05, 0.05, 0.15]),
        (-0.10001, [-0.05, 0.05, 0.15]),
        (-0.0999, [0.05, 0.15]),
        (-0.11, [-0.05, 0.05, 0.15]),
    ):
        floor = Colliders([Collider(Plane(), Poses.fixed((0, height, 0)))])
        x, v = initial_fluid(own, [shape, given], floor, 0.0)
        assert_allclose(x, [*([0, y, 0] for y in ys), [7, 8, 9]], atol=1e-12)
        assert_allclose(v, [*[[1, 2, 3]] * len(ys), [4, 5, 6]])
    under = Colliders([Collider(Plane(), Poses.fixed((0, 0.19, 0)))])
    with pytest.raises(AnimtoolError, match="fill 0 is inside the collider") as error:
        initial_fluid(own, [shape, given], under, 0.0)
    assert error.value.faults[0].code == "SIM064"


def test_who_begins_in_a_collider_is_named_with_it() -> None:
    walls = Colliders(
        [
            Collider(Sphere(0.5), Poses.fixed((9, 0, 0))),
            Collider(Box((2, 2, 2)), container=True, name="tank"),
        ]
    )
    x = np.array([[0.0, 0, 0], [0, 1.25, 0], [0, 0, 0.5], [0, 1.5, 0]])
    it = ("it", "fills[0]")
    with pytest.raises(AnimtoolError) as error:
        _check_outside(x, walls, 0.0, "fill 3", "fills[3]")
    assert error.value.faults[0].where == "fills[3]"
    message = error.value.faults[0].message
    assert message.startswith(
        "particle 1 of fill 3 starts 0.25 m outside the container"
    )
    assert "'tank', and 1 other start" in message
    _check_outside(x[[0, 2]], Colliders([walls[1]]), 0.0, *it)
    _check_outside(
        np.array([[0, 1.0, 0]]), Colliders([walls[1]]), 0.0, "it", "fills[0]"
    )
    _check_outside(x[:0], walls, 0.0, *it)
    with pytest.raises(AnimtoolError, match="inside colliders") as error:
        _check_outside(
            np.array([[9.0, 0.3, 0]]), Colliders([walls[0]]), 0.0, "it", "fills[0]"
        )
    assert "0.2 m inside" in error.value.faults[0].message
    assert "other" not in error.value.faults[0].message


def test_two_nearer_than_a_quarter_of_the_spacing_are_named_by_their_fills() -> None:
    own = spec(fills=[{"name": "a", "points": "x"}, {"points": "y"}, {"points": "z"}])
    x = np.array([[0.0, 0, 0], [1, 0, 0], [2, 0, 0], [3, 0, 0], [2, 0.024, 0]])
    with pytest.raises(AnimtoolError) as error:
        _check_distinct(own, x, np.array([2, 3, 5]))
    message = error.value.faults[0].message
    assert message.startswith("particle 0 of fill 1 and particle 1 of fill 2 start")
    assert "start 0.024 m apart, but the spacing is 0.1 m" in message
    x[4] = [0.02, 0, 0]
    with pytest.raises(AnimtoolError, match="particle 0 of 'a' and particle 1 of fil"):
        _check_distinct(own, x, np.array([2, 3, 5]))
    x[4] = [0.026, 0, 0]
    _check_distinct(own, x, np.array([2, 3, 5]))
    _check_distinct(own, x[:1], np.array([1]))


def test_as_many_as_are_allowed_are() -> None:
    own = spec(max_particles=1000)
    _check_count(own, 1000, "fills")
    with pytest.raises(AnimtoolError) as error:
        _check_count(own, 8000.0, "fills")
    (fault,) = error.value.faults
    assert (fault.code, fault.where) == ("SIM064", "spacing")
    # Twice as far apart there are an eighth.
    assert str(fault.hint).startswith("use a spacing of 200 mm or")
    with pytest.raises(AnimtoolError) as error:
        _check_count(own, 1001, "fills")
    assert str(error.value.faults[0].hint).startswith("use a spacing of 101 mm or")


@pytest.mark.parametrize(
    ("keys", "shapes", "said"),
    [
        ({}, [Sphere(0.4999998)], []),
        ({"tension": 0.0}, [Sphere(0.1)], []),
        ({}, [Box((0.1, 0.1, 0.1)), None], []),
        ({}, [Sphere(0.6), Capsule(0.2, 3.0)], ["fill 1 has a radius of 0.2 m, 2 "]),
        ({}, [Sphere(0.3), Sphere(0.2)], ["fill 0 has a radius of 0.3 m, 3 "]),
    ],
)
def test_drops_of_less_than_five_spacings_are_told(
    keys: Any, shapes: Any, said: list[str]
) -> None:
    fills = [{"points": "x"} for _ in shapes]
    own = spec(**{"tension": 0.07, "fills": fills, **keys})
    parts = [{} if shape is None else {"shape": shape} for shape in shapes]
    found = list(coarse_drop_warnings(own, parts))
    assert len(found) == len(said)
    for fault, text in zip(found, said, strict=True):
        assert fault.code == "SIM175"
        assert fault.message.startswith(text)


def nozzle(begin: float = 0.0, poses: Poses | None = None, **keys: Any) -> Nozzle:
    own = spec(emitters=[{"speed": 2, "size": [0.1, 0.1], **keys}])
    return Nozzle(own, own.emitters[0], poses or Poses.fixed(), begin)


def test_layers_of_a_nozzle_are_full_of_places() -> None:
    """Of 0.3 by 0.2 six; of a round one those nearer than its radius."""
    found = nozzle(size=[0.3, 0.2])._layer_points
    expected = [[x, 0, z] for x in (-0.1, 0, 0.1) for z in (-0.05, 0.05)]
    assert_allclose(sorted_rows(found), sorted_rows(expected))
    for radius, count in ((0.1, 4), (0.15, 9), (0.14, 5), (0.25, 21)):
        own = spec(emitters=[{"speed": 2, "radius": radius}])
        made = Nozzle(own, own.emitters[0], Poses.fixed(), 0.0)._layer_points
        assert len(made) == count
        assert np.linalg.norm(made, axis=1).max() < radius


@pytest.mark.parametrize(
    ("keys", "span", "room", "births", "missed"),
    [
        # A layer every 0.05 s, the first as it opens.
        ({}, (0.0, 0.1), 9, [0, 0.05], 0),
        ({}, (0.1, 0.21), 9, [0.1, 0.15, 0.2], 0),
        ({}, (0.0, 0.05), 9, [0], 0),
        ({}, (0.0, 0.0), 9, [], 0),
        ({"begin": 1.0}, (1.0, 1.06), 9, [1, 1.05], 0),
        ({"begin": 1.0, "opens": [[0, 1.09]]}, (1.0, 2.0), 9, [1, 1.05], 0),
        ({"opens": [[0.2, 0.31], [0.4, 0.45]]}, (0, 1.0), 9, [0.2, 0.25, 0.3, 0.4], 0),
        ({"opens": [[0.2, 0.31], [0.4, 0.45]]}, (0, 1.0), 3, [0.2, 0.25, 0.3], 1),
        # 1.3 - 1.0 is more than 0.3 by rounding: none at the end all the same.
        ({"opens": [[1.0, 1.3]]}, (0.0, 9.0), 9, 1 + 0.05 * np.arange(6), 0),
        ({"opens": [[1.0, 1.301]]}, (0.0, 9.0), 9, 1 + 0.05 * np.arange(7), 0),
        ({"opens": [[1.0, 1.3]]}, (0.0, 1.3), 9, 1 + 0.05 * np.arange(6), 0),
        ({"opens": [[1.0, 1.3]]}, (1.3, 9.0), 9, [], 0),
        ({}, (0.0, 0.2), 2, [0, 0.05], 2),
        ({"size": [0.2, 0.1]}, (0.0, 0.2), 5, [0, 0, 0.05, 0.05], 4),
    ],
)
def test_layers_come_one_after_the_other(
    keys: Any, span: Any, room: int, births: Any, missed: int
) -> None:
    found = nozzle(**keys).inflow(*span, np.zeros(3), room)
    assert_allclose(found.births, births, atol=1e-12)
    assert found.skipped_count == missed
    assert found.state.shape == (2, len(births), 3)


def test_what_came_in_went_on_since() -> None:
    """Out of a turned nozzle that moves by 3 m/s, under gravity."""
    poses = Poses([0, 2], [[0, 0, 0], [0, 0, 6]], [QUARTER, QUARTER])
    own = nozzle(poses=poses, size=[0.2, 0.1])
    found = own.inflow(0.2, 0.26, np.array([0.0, -8, 0]), 99)
    since = np.array([0.06, 0.06, 0.01, 0.01])
    assert_allclose(found.births, 0.26 - since)
    rows = [
        [-2 * s, y - 4 * s * s, 3 * (0.26 - s) + 3 * s]
        for s, y in zip(since, [-0.05, 0.05, -0.05, 0.05], strict=True)
    ]
    assert_allclose(found.state[0], rows, atol=1e-9)
    assert_allclose(found.state[1], [[-2, -8 * s, 3] for s in since], atol=1e-6)


def test_who_has_room_is_six_tenths_of_a_spacing_from_others_and_in_no_wall() -> None:
    others = np.array([[0.0, 0, 0], [5, 5, 5]])
    x = np.array(
        [[0.061, 0, 0], [0.059, 0, 0], [0, 0, -0.059], [1, 0.02, 0], [1, 1, 1]]
    )
    found = find_clear_points(x, others, NONE, 0.0, 0.1)
    assert found.tolist() == [True, False, False, True, True]
    floor = Colliders([Collider(Plane(), Poses.fixed((0, 0.02, 0)))])
    found = find_clear_points(x, others[1:], floor, 0.0, 0.1)
    assert found.tolist() == [False, False, False, True, True]
    assert find_clear_points(x, others[:0], NONE, 0.0, 0.1).all()
    assert len(find_clear_points(x[:0], others, floor, 0.0, 0.1)) == 0
