"""Springs among meshes, of which points may move."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal
from support.suite import examples

from animtool.core.array_types import FloatArray, IntArray
from animtool.sim import Status
from animtool.sim.colliders import Box, Collider, Colliders, Mesh, Poses, Sheet, Sphere
from animtool.systems.springs import (
    Family,
    Solver,
    SpringOptions,
    SpringSystem,
    rope,
    sheet,
    simulate_springs,
)
from tests.support.balls import ball_mesh, box_mesh
from tests.support.loose import loose, run

SOLVERS = [solver for solver in Solver if solver is not Solver.AUTO]
UPRIGHT = (0.0, 0.0, 0.0, 1.0)
FLAT = np.array([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
FLAT_FACES = np.array([[0, 1, 2], [0, 2, 3]])
BALL, BALL_FACES = ball_mesh(3, 0.3)


@dataclass
class Moving:
    """A surface whose points are a function of time."""

    places: Callable[[float], FloatArray]
    faces: IntArray

    def points(self, t: float) -> FloatArray:
        return self.places(t)

    def triangles(self, t: float) -> IntArray:  # noqa: ARG002
        return self.faces

    def forget(self, t: float) -> None:
        """Springs may look at any time."""


def moving(
    places: Callable[[float], FloatArray], faces: IntArray, **options: float
) -> Colliders:
    made = Sheet(Moving(places, faces), **{"radius": 0.001, **options})  # type: ignore[arg-type]
    return Colliders([], [made])


def still(points: FloatArray, faces: IntArray, **options: float) -> Colliders:
    return moving(lambda _: points, faces, **options)


def cloth(colliders: Colliders | list[Collider], height: float = 0.32) -> SpringSystem:
    body = sheet(
        11, 11, mass=0.002, structural=Family(200.0, ratio=0.3),
        diagonals=Family(100.0, ratio=0.3),
        corner=[-0.3, -0.3, height], across=[0.6, 0, 0], up=[0, 0.6, 0],
    )  # fmt: skip
    return SpringSystem(body, colliders=colliders, radius=0.005, drag=1.0)


@pytest.mark.parametrize("solver", SOLVERS)
def test_a_sheet_rests_on_the_mesh_of_a_box_as_on_the_box(solver: Solver) -> None:
    x, y = np.meshgrid(np.linspace(-0.7, 0.7, 8), np.linspace(-0.7, 0.7, 8))
    start = np.stack([x, y, np.full_like(x, 0.53)], axis=-1).reshape(-1, 3)
    rests = [
        run(loose(start, [Collider(shape, friction=0.5)], radius=0.01), 0.6, solver)
        for shape in (Box([1.0, 1.0, 1.0]), Mesh(*box_mesh(1.0)))
    ]
    above = np.abs(start[:, :2]).max(axis=1) < 0.5
    assert_allclose(rests[1].positions, rests[0].positions, atol=1e-9)
    assert_allclose(rests[1].positions[-1, above, 2], 0.51, atol=1e-6)
    assert not rests[1].unresolved


@pytest.mark.parametrize("solver", SOLVERS)
def test_a_rope_slides_down_a_mesh_against_friction(solver: Solver) -> None:
    slope, friction, end = 0.5, 0.3, 0.5
    turn = np.array([[np.cos(slope), 0, np.sin(slope)], [0, 1, 0],
                     [-np.sin(slope), 0, np.cos(slope)]])  # fmt: skip
    ramp = Mesh(4 * FLAT @ turn.T, FLAT_FACES)
    way, up = turn @ [1, 0, 0], turn @ [0, 0, 1]
    line = rope(0.01 * up, 0.01 * up + 0.5 * way, 6, Family(1e3, ratio=0.1), mass=0.1)
    for coefficient, pull in ((friction, 1.0), (0.6, 0.0)):
        collider = Collider(ramp, friction=coefficient)
        system = SpringSystem(line, colliders=[collider], radius=0.01)
        gone = (run(system, end, solver).positions[-1] - line.positions) @ way
        speeds_up = 9.81 * (np.sin(slope) - coefficient * np.cos(slope)) * pull
        # At rest, a step of weight may slip.
        assert_allclose(gone.mean(), speeds_up * end**2 / 2, rtol=0.02, atol=2e-3)


def test_meshes_of_a_ball_come_nearer_to_it_as_they_get_finer() -> None:
    x, y = np.meshgrid(np.linspace(-0.12, 0.12, 12), np.linspace(-0.12, 0.12, 12))
    start = np.stack([x, y, np.full_like(x, 0.32)], axis=-1).reshape(-1, 3)
    landed = []
    for shape in (Sphere(0.3), *(Mesh(*ball_mesh(k, 0.3)) for k in (2, 3, 4))):
        system = loose(start, [Collider(shape, friction=2.0)], radius=0.005)
        landed.append(run(system, 0.2, Solver.XPBD).positions[-1])
    errors = [float(np.linalg.norm(each - landed[0], axis=1).mean()) for each in landed]
    assert errors[2] < errors[1] / 3
    assert errors[3] < errors[2] / 3


@pytest.mark.parametrize("solver", SOLVERS)
def test_a_mesh_that_is_attached_is_one_whose_points_move(solver: Solver) -> None:
    way = np.array([0.4, 0.2, 0.3])
    poses = Poses([0, 1], [[0, 0, 0], way], [UPRIGHT] * 2)
    like = Collider(Mesh(BALL, BALL_FACES), poses, friction=0.3, margin=0.001)
    other = moving(lambda t: BALL + way * t, BALL_FACES, closed=True, friction=0.3)
    one, same = (run(cloth(each), 0.3, solver) for each in ([like], other))
    assert_allclose(same.positions, one.positions, atol=1e-5)
    assert one.stats.status is same.stats.status is Status.OK


@pytest.mark.slow(0.5)
@settings(max_examples=examples(10))
@given(order=st.permutations(range(len(BALL_FACES))), turns=st.integers(0, 2))
def test_the_order_of_triangles_makes_no_difference(
    order: list[int], turns: int
) -> None:
    shuffled = np.roll(BALL_FACES[order], turns, axis=1)
    one, other = (
        run(cloth([Collider(Mesh(BALL, faces), friction=0.3)]), 0.1, Solver.XPBD)
        for faces in (BALL_FACES, shuffled)
    )
    assert_allclose(other.positions, one.positions, atol=1e-9)


@pytest.mark.parametrize("solver", SOLVERS)
@pytest.mark.parametrize("closed", [True, False])
def test_motions_in_parts_are_the_motion_as_a_whole(
    solver: Solver, closed: bool
) -> None:
    def swelling(t: float) -> FloatArray:
        return BALL * (1 + 0.2 * np.sin(6 * t)) + [0.2 * t, 0, 0]

    options = SpringOptions(solver, step=1 / 960)
    parts = [
        cloth(moving(swelling, BALL_FACES, closed=closed, friction=0.3))
        for _ in range(2)
    ]
    whole = simulate_springs(parts[0], [0, 0.15, 0.3], options)
    first = simulate_springs(parts[1], [0, 0.1, 0.15], options)
    again = cloth(moving(swelling, BALL_FACES, closed=closed, friction=0.3))
    last = simulate_springs(again, [0.15, 0.2, 0.3], options, first.checkpoint)
    assert_array_equal(last.states[-1], whole.states[-1])


@pytest.mark.parametrize("solver", SOLVERS)
def test_an_open_mesh_is_met_from_both_sides(solver: Solver) -> None:
    flat = still(FLAT, FLAT_FACES)
    above = run(loose([0, 0.1, 0.1], flat, radius=0.01), 0.6, solver)
    below = run(loose([0, 0.1, -0.1], flat, radius=0.01, gravity=9.81), 0.6, solver)
    assert_allclose(above.positions[-1, 0, 2], 0.011, atol=1e-6)
    assert_allclose(below.positions[-1, 0, 2], -0.011, atol=1e-6)


@pytest.mark.parametrize("solver", SOLVERS)
@pytest.mark.parametrize("speed", [3.0, 80.0])
def test_nothing_goes_through_however_fast(solver: Solver, speed: float) -> None:
    shot = loose([0.1, 0.2, 1], still(FLAT, FLAT_FACES), (0, 0, -speed), gravity=0)
    motion = run(shot, 0.6, solver, 1 / 240)
    assert motion.positions[:, 0, 2].min() > 0

    def thrown(t: float) -> FloatArray:
        return FLAT + np.array([0, 0, speed * t - 1])

    hit = loose([0.1, 0.2, 0], moving(thrown, FLAT_FACES), gravity=0)
    motion = run(hit, 0.1, solver, 1 / 240)
    ahead = motion.positions[:, 0, 2] - (speed * motion.times - 1)
    assert ahead.min() > 0


@pytest.mark.parametrize("solver", SOLVERS)
def test_what_stands_on_a_moving_mesh_is_taken_along(solver: Solver) -> None:
    belt = moving(lambda t: 3 * FLAT + [0.5 * t, 0, 0], FLAT_FACES, friction=0.8)
    motion = run(loose([0, 0.1, 0.011], belt, radius=0.01), 1.0, solver)
    assert_allclose(motion.velocities[-1, 0], [0.5, 0, 0], atol=1e-3)
    slips = 0.5**2 / (2 * 0.8 * 9.81)
    assert motion.positions[-1, 0, 0] == pytest.approx(0.5 - slips, abs=2e-3)


@pytest.mark.parametrize("solver", SOLVERS)
def test_a_mesh_that_swells_and_turns_keeps_cloth_out(solver: Solver) -> None:
    def size(t: float) -> float:
        return 1 + 0.3 * np.sin(6 * t)

    def places(t: float) -> FloatArray:
        c, s = np.cos(2 * t), np.sin(2 * t)
        turned = BALL @ np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]).T
        return np.asarray(turned * size(t))

    motion = run(cloth(moving(places, BALL_FACES, closed=True)), 0.4, solver)
    assert motion.stats.status is Status.OK
    # What is flat between points is nearer to the middle than these.
    faces = np.linalg.norm(BALL[BALL_FACES].mean(axis=1), axis=1).min()
    for t, points in zip(motion.times, motion.positions, strict=True):
        nearest = np.linalg.norm(points, axis=1).min()
        assert nearest > faces * size(float(t)) + 0.005


@pytest.mark.parametrize("solver", SOLVERS)
def test_a_mesh_put_elsewhere_hits_nothing(solver: Solver) -> None:
    def places(t: float) -> FloatArray:
        return BALL + ([0.0, 0, -50] if t < 0.1 else [0.0, 0, 0])

    system = cloth(moving(places, BALL_FACES, closed=True), height=0.5)
    motion = run(system, 0.3, solver)
    assert motion.stats.status is Status.OK
    assert np.abs(motion.velocities).max() < 10
    codes = [fault.code for fault in motion.notices]
    assert codes.count("SIM120") == 1


@pytest.mark.parametrize("solver", SOLVERS)
@pytest.mark.parametrize("side", [1, -1])
def test_arrays_are_met_from_both_sides(solver: Solver, side: int) -> None:
    for speed in (1.0, 30.0, 300.0):
        thrown = loose(
            [0.1, 0.2, side * 0.5], [Collider(Mesh(FLAT, FLAT_FACES))],
            (0, 0, -side * speed), gravity=0,
        )  # fmt: skip
        motion = run(thrown, 1.0 if speed < 2 else 0.1, solver)
        assert (motion.positions[:, 0, 2] * side > -1e-6).all()
        assert abs(motion.positions[-1, 0, 2]) < 0.01


@pytest.mark.parametrize("solver", SOLVERS)
def test_what_begins_inside_leaves_without_a_pop(solver: Solver) -> None:
    for colliders in (
        [Collider(Mesh(*box_mesh(1.0), closed=True), depenetration=0.5)],
        still(*box_mesh(1.0), closed=True, depenetration=0.5),
    ):
        system = loose([0.1, 0, 0.35], colliders, gravity=0)
        motion = run(system, 0.4, solver)
        assert_allclose(motion.positions[-1, 0], [0.1, 0, 0.5], atol=2e-3)
        assert np.abs(motion.velocities[-1]).max() < 1e-6
        climbed = np.diff(motion.positions[:, 0, 2])
        assert climbed.max() < 0.5 * 0.4 / 12 + 2e-3
        early = run(system, 0.1, solver)
        assert early.unresolved == 1
        assert "SIM123" in [fault.code for fault in early.notices]


@pytest.mark.parametrize(
    "extra",
    [
        [[0, 0, 1]],
        [[0, 1, 1], [4, 7, 7]],
        [[4, 5, 8]],
        [[4, 5, 7]],
    ],
    ids=["of two points", "pinched", "a third face on an edge", "twice"],
)
@pytest.mark.parametrize("points_move", [True, False])
def test_triangles_that_make_no_surface_do_no_harm(
    extra: list[list[int]], points_move: bool
) -> None:
    points, faces = box_mesh(1.0)
    points = np.concatenate([points, [[0.0, -1.0, 1.0], [0.5, 0.5, 0.5]]])
    faces = np.concatenate([faces, extra])
    colliders = (
        still(points, faces, closed=True)
        if points_move
        else [Collider(Mesh(points, faces), margin=0.001)]
    )
    motion = run(loose([0.1, 0.2, 0.6], colliders), 0.5, Solver.XPBD)
    assert_allclose(motion.positions[-1, 0], [0.1, 0.2, 0.501], atol=1e-6)


def test_points_at_one_place_are_one() -> None:
    points, faces = box_mesh(1.0)
    apart, own = points[faces].reshape(-1, 3), np.arange(36).reshape(-1, 3)
    motion = run(
        loose([0.4, 0.4, 0.4], still(apart, own, closed=True)), 0.4, Solver.XPBD
    )
    assert np.abs(motion.positions[-1, 0]).max() > 0.5


def test_a_mesh_may_grow_out_of_a_point() -> None:
    def places(t: float) -> FloatArray:
        return BALL * min(t, 1.0)

    motion = run(loose([0, 0.01, 0.25], moving(places, BALL_FACES, closed=True),
                       gravity=0), 1.0, Solver.XPBD)  # fmt: skip
    assert np.linalg.norm(motion.positions[-1, 0]) > 0.29


def test_a_mesh_without_faces_is_met_by_nothing() -> None:
    nothing = still(FLAT, np.zeros((0, 3), int))
    motion = run(loose([0, 0, 1], nothing), 0.5, Solver.XPBD)
    assert motion.positions[-1, 0, 2] < 0


def test_particles_may_be_kept_inside_a_mesh() -> None:
    like = Collider(Mesh(*box_mesh(1.0)), container=True)
    motion = run(loose([0.1, 0, 0], [like], (3, 1, 0), 0.01), 1.0, Solver.XPBD)
    assert np.abs(motion.positions).max() < 0.49 + 1e-6
    assert motion.positions[-1, 0, 2] == pytest.approx(-0.49, abs=1e-6)


def test_systems_that_meet_a_surface_settle_with_other_methods_too() -> None:
    flat = still(FLAT, FLAT_FACES)
    system = loose([0, 0, 0.02], flat, radius=0.01)
    state = system.settle(
        0.1, 0.1, system.state, np.array([[[0, 0, -0.1]], [[0, 0, -1.0]]])
    )
    assert state[0, 0, 2] == pytest.approx(0.011, abs=1e-6)
    again = simulate_springs(system, [0, 0.5], replace(SpringOptions(), step=1 / 480))
    assert again.positions[-1, 0, 2] == pytest.approx(0.011, abs=1e-6)
