"""Strands four at a time: laws of one frame."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

from animtool import _kernels
from animtool.sim.colliders import (
    Box,
    Capsule,
    Collider,
    Colliders,
    Mesh,
    Plane,
    Sphere,
)

SPAN, LENGTH = 1 / 24, 0.02
FALL = [0.0, -9.81, 0.0]
SEEDS = st.integers(0, 2**31)


def strands(count: int, points: int, seed: int = 0) -> np.ndarray:
    """Return bent strands with equal steps ``(S, P, 3)``."""
    rng = np.random.default_rng(seed)
    ways = rng.normal(size=(count, 1, 3)) + 0.3 * rng.normal(
        size=(count, points - 1, 3)
    )
    ways *= LENGTH / np.linalg.norm(ways, axis=-1, keepdims=True)
    roots = rng.normal(scale=0.05, size=(count, 1, 3))
    return np.concatenate([roots, roots + np.cumsum(ways, axis=1)], axis=1)


def made(
    places: np.ndarray, fold: float = 150.0, draw: float = 150.0, drag: float = 0.5
) -> Any:
    rests = np.linalg.norm(np.diff(places, axis=1), axis=-1)
    folds = np.linalg.norm(places[:, 2:] - places[:, :-2], axis=-1)
    pulls = 1e12, fold, draw, 0.6 * np.sqrt(draw)
    return _kernels.SpringStrands(rests, folds, np.array(FALL), drag, *pulls, 0.01)


def checkpoint(places: np.ndarray, cells: int, way: np.ndarray | None = None) -> Any:
    """Return targets that go straight on ``(cells + 1, N, 3)``."""
    share = np.linspace(0, 1, cells + 1)[:, None, None]
    goal = np.zeros(3) if way is None else way
    return np.ascontiguousarray(places.reshape(1, -1, 3) + share * goal)


def met(
    colliders: list[Collider], cells: int, depths: np.ndarray | None = None
) -> tuple[Any, ...]:
    arrays = Colliders(colliders).kernel_arrays(0.0, 0.0)
    pose = np.array([0.0, 0, 0, 0, 0, 0, 1])
    poses = np.tile(pose, (cells, len(colliders), 2, 1))
    return arrays, poses, 0.0, depths, 1e-6, []


def run(
    places: np.ndarray,
    *,
    velocities: np.ndarray | None = None,
    colliders: tuple[Any, ...] | None = None,
    cells: int = 4,
    substeps: int = 3,
    way: np.ndarray | None = None,
    own: tuple[int, int] = (0, 0),
    **numbers: float,
) -> tuple[np.ndarray, int, int, float]:
    """Return positions and velocities ``(2, S, P, 3)``, and what was counted."""
    flat = places.reshape(-1, 3)
    speeds = np.zeros_like(flat) if velocities is None else velocities.reshape(-1, 3)
    state, *counts = _kernels.follow_strands(
        made(places, **numbers), checkpoint(places, cells, way),
        np.stack([flat, speeds]), SPAN, substeps, colliders, carrier_colliders=own,
    )  # fmt: skip
    return state.reshape(2, *places.shape), *counts


@settings(deadline=None)
@given(SEEDS, st.integers(1, 9), st.integers(2, 9))
def test_each_strand_is_as_if_it_were_alone(seed: int, count: int, points: int) -> None:
    places = strands(count, points, seed)
    colliders = [Collider(Sphere(0.05), friction=0.3), Collider(Capsule(0.02, 0.2))]
    whole, *_ = run(places, colliders=met(colliders, 4))
    for k in range(count):
        one, *_ = run(places[k : k + 1], colliders=met(colliders, 4))
        assert_array_equal(one[:, 0], whole[:, k])


def test_threads_make_no_difference() -> None:
    places = strands(150, 6)
    flat = np.stack([places.reshape(-1, 3), np.zeros((900, 3))])
    colliders = met([Collider(Sphere(0.05), friction=0.3)], 4)
    one, *counts = _kernels.follow_strands(
        made(places), checkpoint(places, 4), flat, SPAN, 3, colliders, 1
    )
    for threads in (2, 3, 64):
        other, *same = _kernels.follow_strands(
            made(places), checkpoint(places, 4), flat, SPAN, 3, colliders, threads
        )
        assert one.tobytes() == other.tobytes()
        assert counts == same


@settings(deadline=None)
@given(SEEDS, st.integers(2, 12))
@example(149423888, 2)  # all are shorter than at rest, by less than 1e-10
def test_lengths_are_kept(seed: int, points: int) -> None:
    places = strands(3, points, seed)
    state, _, _, stretch = run(places, way=np.array([0.02, 0.0, 0.01]), substeps=10)
    lengths = np.linalg.norm(np.diff(state[0], axis=1), axis=-1) / LENGTH
    assert stretch == pytest.approx(max(lengths.max() - 1, 0.0), abs=1e-12)
    assert_allclose(lengths, 1, atol=0.02)


@settings(deadline=None)
@given(SEEDS)
def test_roots_go_where_the_animation_has_them(seed: int) -> None:
    places = strands(5, 6, seed)
    way = np.random.default_rng(seed).normal(scale=0.05, size=3)
    state, *_ = run(places, way=way)
    assert_array_equal(
        state[0, :, 0], checkpoint(places, 4, way)[-1].reshape(5, 6, 3)[:, 0]
    )


def test_what_hangs_still_stays() -> None:
    places = np.zeros((2, 8, 3))
    places[..., 1] = -LENGTH * np.arange(8)
    places[1, :, 0] = 0.1
    state, touched, inside, stretch = run(places, draw=0.0)
    assert (touched, inside) == (0, 0)
    assert stretch < 1e-8
    assert_allclose(state[0], places, atol=1e-9)
    assert_allclose(state[1], 0, atol=1e-6)


def test_strands_without_pull_fall_as_their_roots_are_held() -> None:
    # Of two points the end turns about the root: a pendulum at its side.
    places = np.array([[[0.0, 0, 0], [LENGTH, 0, 0]]])
    state, *_ = run(places, fold=0.0, draw=0.0, drag=0.0, cells=8, substeps=400)
    turn = np.arctan2(-state[0, 0, 1, 1], state[0, 0, 1, 0])
    # From rest at the side: 2 g / L sin(turn) is the square of its speed.
    speed = np.linalg.norm(state[1, 0, 1]) / LENGTH
    assert speed**2 == pytest.approx(2 * 9.81 / LENGTH * np.sin(turn), rel=5e-3)


@pytest.mark.parametrize(
    "collider",
    [
        Collider(Sphere(0.1)),
        Collider(Capsule(0.1, 0.3, (1.0, 0.0, 0.0))),
        Collider(Plane((0.0, 1.0, 0.0), 0.1)),
        Collider(Box((1.0, 0.2, 1.0))),
    ],
    ids=["sphere", "capsule", "plane", "box"],
)
def test_nothing_falls_into_a_collider(collider: Collider) -> None:
    places = np.zeros((5, 6, 3))
    places[..., 1] = 0.101
    places[..., 0] = LENGTH * np.arange(6) - 0.05
    places[..., 2] = 0.001 * np.arange(5)[:, None]
    state, touched, inside, _ = run(
        places, colliders=met([collider], 4), velocities=0 * places - [0, 1, 0]
    )
    samples = Colliders([collider]).sample(state[0, :, 1:].reshape(-1, 3), 0.0)
    assert touched > 0
    assert inside == 0
    assert samples.distances.min() > -1e-9


def test_what_is_fast_is_stopped_on_its_way() -> None:
    places = np.zeros((1, 2, 3))
    places[0, 1, 0] = 10.0
    speeds = np.zeros_like(places)
    speeds[0, 1, 1] = -24.0
    ball = Capsule(0.1, 0.0, centre=(9.97, -0.5, 0.0))
    state, touched, *_ = run(
        places, velocities=speeds, colliders=met([Collider(ball)], 1), cells=1,
        substeps=1, draw=0.0,
    )  # fmt: skip
    assert touched == 1
    assert state[0, 0, 1, 1] > -0.5


def test_particles_may_be_as_deep_as_is_given() -> None:
    places = np.zeros((2, 5, 3))
    places[..., 1] = -LENGTH * np.arange(5)
    ball = [Collider(Sphere(0.2))]
    flat = places.reshape(-1, 3)
    found = Colliders(ball).sample(flat, 0.0).distances
    free, *_ = run(places)
    let, touched, inside, _ = run(
        places, colliders=met(ball, 4, np.minimum(found, 0.0))
    )
    assert (touched, inside) == (0, 0)
    assert_array_equal(let, free)
    pushed, touched, inside, _ = run(places, colliders=met(ball, 4))
    assert touched > 0
    assert inside > 0
    # It comes out no faster than it may, a metre a second.
    assert np.linalg.norm(pushed[0] - free[0], axis=-1).max() < 1.5 * SPAN


def test_points_in_one_place_stay_finite() -> None:
    state, *_ = run(np.zeros((3, 6, 3)))
    assert np.isfinite(state).all()


@pytest.mark.parametrize("points", [1, 2])
def test_the_shortest_strands(points: int) -> None:
    places = np.zeros((2, points, 3))
    places[..., 1] = -LENGTH * np.arange(points)
    state, *_ = run(places)
    assert_allclose(state[0], places, atol=1e-9)


def test_arrays_that_do_not_fit_are_refused() -> None:
    places = strands(2, 4)
    state = np.zeros((2, 8, 3))
    ready = made(places)
    for targets, given_state, substeps in (
        (checkpoint(places, 2)[:1], state, 1),
        (checkpoint(places, 2), state[:, :-1], 1),
        (checkpoint(places, 2), state, 0),
    ):
        with pytest.raises(ValueError, match=r"state|targets|step"):
            _kernels.follow_strands(
                ready, np.ascontiguousarray(targets),
                np.ascontiguousarray(given_state), SPAN, substeps, None,
            )  # fmt: skip
    with pytest.raises(ValueError, match="folds"):
        _kernels.SpringStrands(
            np.ones((2, 3)), np.ones((2, 3)), np.zeros(3), *np.zeros(6)
        )


HALF = np.array([0.04, 0.01, 0.04])
CORNERS = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
QUADS = np.array(
    [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]
)
TRIANGLES = np.concatenate([QUADS[:, [0, 1, 2]], QUADS[:, [0, 2, 3]]]).astype(np.int32)


def moving_mesh(cells: int, begin: np.ndarray, end: np.ndarray) -> tuple[Any, ...]:
    """Return the box as a mesh whose points move between two positions."""
    share = np.linspace(0, 1, cells + 1)[:, None, None]
    points = CORNERS * HALF + begin + share * (end - begin)
    numbers = (0.0, 0.0, 0.0, 1.0, 1e3)
    surface = _kernels.MeshSurface(points[0].copy(), TRIANGLES)
    arrays, poses, radius, depths, tolerance, _ = met([], cells)
    return arrays, poses, radius, depths, tolerance, [(surface, points, numbers, 1, 0)]


def hanging(count: int, points: int = 8) -> np.ndarray:
    """Return strands that hang side by side ``(S, P, 3)``."""
    places = np.zeros((count, points, 3))
    places[..., 0] = np.linspace(-0.03, 0.03, count)[:, None]
    places[..., 1] = -LENGTH * np.arange(points)
    return places


def test_a_mesh_that_does_not_move_is_a_collider() -> None:
    places, at = hanging(5), np.array([0.0, -0.1, -0.06])
    solid_box = Mesh(HALF * CORNERS, TRIANGLES.astype(np.int64), closed=True)
    thrown = np.zeros_like(places) + np.array([0.0, 0.0, -3.0])
    arrays, poses, *others = met([Collider(solid_box, friction=0.0)], 4)
    poses[..., :3] = at
    fixed = arrays, poses, *others
    # Its edges are for particles alone, as those of moving meshes are.
    solid = run(places, velocities=thrown, colliders=fixed, own=(0, 1))
    moving = run(places, velocities=thrown, colliders=moving_mesh(4, at, at))
    assert moving[1] == solid[1] > 0
    assert_allclose(moving[0][0], solid[0][0], atol=1e-9)


def test_a_moving_mesh_pushes_strands() -> None:
    places = hanging(5)
    begin, end = np.array([0.0, -0.1, 0.08]), np.array([0.0, -0.1, 0.0])
    state, touched, inside, _ = run(places, colliders=moving_mesh(4, begin, end))
    relative = (state[0] - end) / HALF
    assert touched > 0
    assert inside == 0
    assert (np.abs(relative).max(axis=-1) > 1 - 1e-3).all()
    free = run(places)[0]
    assert np.abs(state[0] - free[0]).max() > 0.005


@pytest.mark.parametrize("threads", [2, 3])
def test_threads_change_nothing_with_a_moving_mesh(threads: int) -> None:
    places = np.repeat(hanging(5), 40, axis=0)
    begin, end = np.array([0.0, -0.1, 0.08]), np.array([0.0, -0.1, 0.0])
    colliders, flat = moving_mesh(4, begin, end), places.reshape(-1, 3)
    rows = np.stack([flat, np.zeros_like(flat)])
    one, many = (
        _kernels.follow_strands(
            made(places), checkpoint(places, 4), rows, SPAN, 3, colliders, count
        )[0]
        for count in (1, threads)
    )
    assert_array_equal(many, one)
