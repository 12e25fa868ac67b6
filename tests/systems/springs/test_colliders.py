"""Springs among colliders."""

from __future__ import annotations

import numpy as np
import pytest

from animtool.sim import Status
from animtool.sim.colliders import Box, Capsule, Collider, Mesh, Plane, Poses, Sphere
from animtool.systems.springs import (
    Family,
    Pins,
    Solver,
    SpringMotion,
    SpringOptions,
    SpringSystem,
    rope,
    sheet,
    simulate_springs,
)
from tests.support.loose import loose
from tests.support.loose import run as run_loose

SOLVERS = [solver for solver in Solver if solver is not Solver.AUTO]
UP = (0.0, 0.0, 1.0)
STILL = ((0.0, 0.0, 0.0, 1.0),)


def alone(
    *points: list[float], velocity: tuple[float, ...] = (0, 0, 0)
) -> SpringSystem:
    """Return particles without springs above a floor."""
    return loose(points, [Collider(Plane(UP), friction=0.5)], velocity)


def run(system: SpringSystem, end: float, solver: Solver | str) -> SpringMotion:
    return run_loose(system, end, solver, times=25)


@pytest.mark.parametrize("solver", SOLVERS)
def test_what_rests_on_a_plane_stays(solver: Solver) -> None:
    motion = simulate_springs(
        alone([0, 0, 0], [1, 0, 0.3]), np.arange(61), SpringOptions(solver)
    )
    assert np.abs(motion.velocities[1:]).max() < 1e-6
    assert np.abs(motion.positions[1:, :, 2]).max() < 1e-6
    assert not motion.unresolved
    assert motion.stats.status is Status.OK


@pytest.mark.parametrize("solver", SOLVERS)
def test_what_slides_is_slowed_by_friction(solver: Solver) -> None:
    motion = run(alone([0, 0, 0], velocity=(3.0, 0, 0)), 1.2, solver)
    way = 3.0**2 / (2 * 0.5 * 9.81)
    assert motion.positions[-1, 0, 0] == pytest.approx(way, rel=0.02)
    assert np.abs(motion.velocities[-1]).max() < 1e-6


@pytest.mark.parametrize("solver", SOLVERS)
def test_friction_holds_on_a_slope(solver: Solver) -> None:
    for slope, slides in ((0.4, False), (0.6, True)):
        tilted = (-slope, 0.0, 1.0)
        floor = Collider(Plane(tilted), friction=0.5)
        motion = run(loose([[0, 0, 0]], [floor]), 0.5, solver)
        assert (abs(motion.positions[-1, 0, 0]) > 1e-3) == slides


@pytest.mark.parametrize("solver", SOLVERS)
@pytest.mark.parametrize(
    "shape",
    [
        Sphere(0.1),
        Capsule(0.1, 1.0, (1.0, 0.0, 0.0)),
        Box((1.0, 1.0, 0.2)),
        Mesh([[-1, -1, 0.1], [1, -1, 0.1], [0, 1, 0.1], [0, 0, -1]],
             [[0, 1, 2], [0, 2, 3], [0, 3, 1], [1, 3, 2]]),
    ],
    ids=["sphere", "capsule", "box", "mesh"],
)  # fmt: skip
def test_nothing_fast_goes_through(solver: Solver, shape: object) -> None:
    system = loose([[0, 0, 1]], [Collider(shape)], (0, 0, -150.0))  # type: ignore[arg-type]
    motion = run(system, 0.1, solver)
    assert motion.positions[-1, 0, 2] == pytest.approx(0.1, abs=1e-6)


@pytest.mark.parametrize("solver", SOLVERS)
def test_what_starts_inside_leaves_without_a_pop(solver: Solver) -> None:
    ball = Collider(Sphere(1.0), depenetration=0.8)
    system = loose([[0, 0, 0.5]], [ball])
    motion = run(system, 0.4, solver)
    assert np.linalg.norm(motion.velocities, axis=2).max() <= 0.8 * 1.001
    assert motion.unresolved == 1
    assert "SIM123" in [notice.code for notice in motion.notices]
    assert run(system, 1.0, solver).positions[-1, 0, 2] >= 1 - 1e-6


@pytest.mark.parametrize("solver", SOLVERS)
def test_what_is_pinched_stays_finite(solver: Solver) -> None:
    times, shut = [0.0, 0.5, 1.0], np.array([0.3, 0.05, 0.05])
    closing = [
        Collider(
            Capsule(0.1, 1.0, (1.0, 0, 0)),
            Poses(times, np.outer(side * shut, UP), STILL * 3),
        )
        for side in (1, -1)
    ]
    system = loose([[0, 0, 0]], closing)
    motion = run(system, 1.0, solver)
    assert np.isfinite(motion.states).all()
    assert np.linalg.norm(motion.velocities, axis=2).max() < 10
    assert motion.unresolved == 1


@pytest.mark.parametrize("solver", SOLVERS)
def test_a_moving_collider_carries_what_lies_on_it(solver: Solver) -> None:
    lift = Collider(
        Box((2, 2, 0.2)),
        Poses([0, 1], [[0, 0, 0], [0.5, 0, 1.0]], STILL * 2),
        friction=10.0,
    )
    motion = run(loose([[0, 0, 0.1]], [lift]), 1.0, solver)
    np.testing.assert_allclose(motion.positions[-1, 0], [0.5, 0, 1.1], atol=0.02)
    np.testing.assert_allclose(motion.velocities[-1, 0], [0.5, 0, 1.0], atol=0.05)


@pytest.mark.parametrize("solver", SOLVERS)
def test_a_collider_that_jumps_hits_nothing_on_its_way(solver: Solver) -> None:
    ball = Collider(
        Sphere(0.5), Poses([0, 0.1, 0.15], [[-50, 0, 0], [-50, 0, 0], [50, 0, 0]],
                           STILL * 3)
    )  # fmt: skip
    system = loose([[0, 0, 0]], [ball])
    motion = run(system, 0.2, solver)
    assert np.abs(motion.positions[:, 0, 0]).max() == 0
    assert "SIM120" in [notice.code for notice in motion.notices]


@pytest.mark.parametrize("solver", Solver)
def test_cloth_lies_over_a_ball(solver: Solver) -> None:
    body = sheet(
        12, 12, mass=0.002, structural=Family(100.0, ratio=0.1),
        diagonals=Family(50.0, ratio=0.1), bend=Family(1.0),
        corner=[-0.5, -0.5, 0.32],
    )  # fmt: skip
    colliders = [Collider(Sphere(0.3), friction=0.3), Collider(Plane(UP, -0.5))]
    system = SpringSystem(body, drag=0.5, colliders=colliders, radius=0.01)
    motion = simulate_springs(system, np.arange(25) / 24, SpringOptions(solver))
    assert motion.stats.status is Status.OK
    assert np.linalg.norm(motion.positions, axis=2).min() >= 0.31 - 1e-6
    assert motion.positions[..., 2].min() >= -0.49 - 1e-6


@pytest.mark.parametrize("solver", Solver)
def test_among_colliders_a_motion_in_parts_is_the_whole(solver: Solver) -> None:
    line = rope([0, 0, 0], [0.6, 0, 0], 12, Family(500.0, 0.05), mass=0.01)
    arm = Collider(
        Capsule(0.05, 0.5, (0.0, 1.0, 0.0)),
        Poses([0, 0.25, 0.5], [[0.1, 0, -0.3], [0.3, 0, -0.2], [0, 0, -0.3]],
              [[0, 0, 0, 1], [0.3, 0, 0, 1], [0, 0, 0.5, 1]]),
        friction=0.4,
    )  # fmt: skip
    system = SpringSystem(line, pins=Pins([0]), colliders=[arm])
    for rate in (24.0, 24000 / 1001):
        times, options = np.arange(13) / rate, SpringOptions(solver)
        whole = simulate_springs(system, times, options)
        first = simulate_springs(system, times[:6], options)
        rest = simulate_springs(system, times[5:], options, first.checkpoint)
        parts = np.concatenate([first.states, rest.states[1:]])
        assert whole.states.tobytes() == parts.tobytes()


@pytest.mark.slow
@pytest.mark.parametrize("solver", [Solver.AUTO, Solver.BDF2, Solver.IMPLICIT_EULER])
def test_stiff_ropes_that_fall_on_a_floor_come_to_lie(solver: Solver) -> None:
    line = rope([0, 0, 0], [0.3, 0.1, -0.9], 151, Family(3e8, ratio=0.1), mass=6e-4)
    floor = Collider(Plane(UP, -1.0), friction=0.4)
    system = SpringSystem(line, colliders=[floor], radius=0.01)
    motion = simulate_springs(system, [0, 0.25, 0.5], SpringOptions(solver))
    assert motion.solver is not Solver.XPBD
    assert motion.stats.status is Status.OK
    assert motion.positions[..., 2].min() > -0.99 - 1e-6
    assert motion.notices == ()


# A rod of 2 cm below the middle of a segment of 10 cm, and what crosses it [m, m/s].
ROD, SEGMENTS, SPACING = 0.01, 10, 0.1


def thrown_rope(shape: object, speed: float, z: float = -0.15) -> SpringSystem:
    """Return a level rope that goes down past a collider between two particles."""
    line = rope(
        [-0.5, 0, 0], [0.5, 0, 0], SEGMENTS + 1, Family(2e3, ratio=0.1), mass=0.01
    )
    down = np.tile([0.0, 0.0, -speed], (SEGMENTS + 1, 1))
    poses = Poses.fixed(np.array([0.05, 0.0, z]), np.array(STILL[0]))
    bar = Collider(shape, poses, friction=0.0)  # type: ignore[arg-type]
    return SpringSystem(line, colliders=[bar], velocities=down)


def nearest_to_rod(points: np.ndarray, z: float) -> float:
    """Return the least distance of a rope from the middle of the rod [m]."""
    a, b = points[:-1, [0, 2]], points[1:, [0, 2]]
    along, off = b - a, np.array([0.05, z]) - a
    share = np.clip((off * along).sum(axis=1) / (along**2).sum(axis=1), 0.0, 1.0)
    return float(np.linalg.norm(off - share[:, None] * along, axis=1).min())


@pytest.mark.parametrize("solver", SOLVERS)
@pytest.mark.parametrize("speed", [5.0, 20.0])
@pytest.mark.parametrize(
    "shape",
    [Capsule(ROD, 1.0, (0.0, 1.0, 0.0)), Box((2 * ROD, 1.0, 2 * ROD))],
    ids=["rod", "bar"],
)
def test_a_segment_of_a_rope_is_stopped_by_a_thin_rod(
    solver: Solver, speed: float, shape: object
) -> None:
    z = -0.15
    motion = run(thrown_rope(shape, speed, z), 2.5 * -z / speed, solver)
    after = motion.positions[motion.times > 1.2 * -z / speed]
    over = [np.interp(0.05, x[:, 0], x[:, 2]) for x in after]
    # What is beside the rod goes on, and what is on it does not.
    assert after[-1, 0, 2] < 1.2 * z
    assert min(over) > z
    assert min(nearest_to_rod(x, z) for x in after) > 0.9 * ROD
