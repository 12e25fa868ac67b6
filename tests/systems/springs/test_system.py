"""The forces of springs, and what is said of them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from support.suite import examples

from animtool.core.array_types import FloatArray
from animtool.core.errors import OptionError
from animtool.sim import IntegrateOptions, find_integrator, integrate
from animtool.systems.springs import (
    Air,
    Body,
    Family,
    Pins,
    PointTargets,
    Springs,
    SpringSystem,
    block,
    rope,
    sheet,
)

SEEDS = st.integers(0, 2**31)
AIR = [1.0, 2.0, 3.0]  # [m/s]


def shaken(seed: int, **options: object) -> SpringSystem:
    """Return a crumpled block that moves."""
    rng = np.random.default_rng(seed)
    family = Family(float(rng.uniform(1, 50)), float(rng.uniform(0, 2)))
    made = block(
        (2, 3, 2), [1, 2, 1], mass=0.5, structural=family, face_diagonals=family
    )
    places = made.positions + rng.normal(scale=0.2, size=made.positions.shape)
    masses = rng.uniform(0.1, 2, len(places))
    body = Body(places, masses, made.springs, made.triangles)
    return SpringSystem(body, velocities=rng.normal(size=places.shape), **options)


def flow_through(system: SpringSystem, wind: list[float]) -> FloatArray:
    """Return how fast air goes through each triangle [m/s]."""
    x, v = (part[system.body.triangles] for part in system.state)
    normals = np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0])
    flows = ((np.array(wind) - v.mean(axis=1)) * normals).sum(axis=1)
    return np.abs(flows) / np.linalg.norm(normals, axis=1)


def forces(system: SpringSystem, state: FloatArray, t: float = 0.0) -> FloatArray:
    return system.acceleration(t, *state) * system.body.masses[:, None]


@given(SEEDS)
def test_forces_are_the_slope_of_the_energy(seed: int) -> None:
    system = shaken(
        seed, pins=Pins([0, 5]), targets=PointTargets([1, 1, 2], np.eye(3), 3.0)
    )
    x = system.state[0]
    still = np.zeros_like(x)
    found = forces(system, np.array((x, still)))
    way = np.random.default_rng(seed).normal(size=x.shape)
    way[system.pinned] = 0
    h = 1e-6
    ahead, behind = (
        system.energy(0, np.array((x + side * h * way, still))).potential
        for side in (1, -1)
    )
    assert (found * way).sum() == pytest.approx((behind - ahead) / (2 * h), rel=1e-6)


@given(SEEDS)
def test_slopes_are_those_of_differences(seed: int) -> None:
    system = shaken(
        seed, pins=Pins([3]), targets=PointTargets([1], [[1, 2, 3]], 3.0, 0.5),
        air=Air(AIR), drag=0.3, resistance=0.2,
    )  # fmt: skip
    x, v = system.state
    # Pressure has a kink where air goes along a triangle.
    assume(flow_through(system, AIR).min() > 1e-2)
    by_x, by_v = (matrix.toarray() for matrix in system.jacobians(0.0, x, v))
    h, rng = 1e-6, np.random.default_rng(seed)
    for matrix, part in ((by_x, 0), (by_v, 1)):
        way = rng.normal(size=x.shape)
        moved = np.zeros((2, *x.shape))
        moved[part] = h * way
        ahead = system.acceleration(0.0, *(system.state + moved))
        behind = system.acceleration(0.0, *(system.state - moved))
        slope = ((ahead - behind) / (2 * h)).ravel()
        assert_allclose(matrix @ way.ravel(), slope, rtol=0, atol=1e-4)


@given(SEEDS)
def test_springs_alone_keep_momentum_and_turning(seed: int) -> None:
    system = shaken(seed, gravity=(0, 0, 0))
    pulls = forces(system, system.state)
    assert_allclose(pulls.sum(axis=0), 0, atol=1e-11)
    assert_allclose(np.cross(system.state[0], pulls).sum(axis=0), 0, atol=1e-11)


@given(SEEDS)
def test_springs_do_not_know_where_they_are(seed: int) -> None:
    from scipy.spatial.transform import Rotation

    system = shaken(seed, gravity=(0, 0, 0))
    turn = Rotation.random(random_state=seed % 1000).as_matrix()
    turned = system.state @ turn.T
    turned[0] += [1, 2, 3]
    there = system.acceleration(0.0, *turned)
    assert_allclose(there, system.acceleration(0, *system.state) @ turn.T, atol=1e-10)


@given(SEEDS)
def test_the_order_of_particles_does_not_matter(seed: int) -> None:
    system = shaken(seed, gravity=(0, 0, -1))
    rng = np.random.default_rng(seed)
    order = rng.permutation(len(system.body.masses))
    springs = system.body.springs
    mixed = rng.permutation(len(springs.rest))
    place = np.argsort(order)
    swapped = replace(springs, ends=place[springs.ends]).select(mixed)
    body = Body(
        system.body.positions[order], system.body.masses[order], swapped,
        place[system.body.triangles],
    )  # fmt: skip
    other = SpringSystem(body, gravity=(0, 0, -1), velocities=system.state[1][order])
    there = other.acceleration(0.0, *other.state)
    here = system.acceleration(0.0, *system.state)
    assert_allclose(there, here[order], atol=1e-11)


@given(SEEDS)
def test_no_motion_is_faster_than_its_bound(seed: int) -> None:
    system = shaken(seed, pins=Pins([2]), targets=PointTargets([4], [[0, 0, 0]], 30.0))
    springs = system.body.springs
    # Springs at rest are stiffest along themselves.
    rest = np.linalg.norm(
        np.diff(system.body.positions[springs.ends], axis=1)[:, 0], axis=1
    )
    body = replace(system.body, springs=replace(springs, rest=rest))
    relaxed = SpringSystem(
        body, pins=Pins([2]), targets=PointTargets([4], [[0, 0, 0]], 30.0)
    )
    x, v = relaxed.state
    by_x, by_v = (matrix.toarray() for matrix in relaxed.jacobians(0.0, x, 0 * v))
    modes = relaxed.frequencies(0.0, relaxed.state)
    assert modes is not None
    assert np.sqrt(-np.linalg.eigvals(by_x).real.min()) <= modes[0, 0] * (1 + 1e-9)
    slowed = -np.linalg.eigvals(by_v).real.min()
    assert slowed <= 2 * modes[0, 1] * modes[0, 0] * (1 + 1e-9)


def test_a_lone_particle_has_no_fastest_motion() -> None:
    alone = Body(np.zeros((1, 3)), np.ones(1), Springs.none(), np.zeros((0, 3), int))
    system = SpringSystem(alone)
    assert system.frequencies(0.0, system.state) is None
    assert system.stretch(0.0, system.state) is None
    assert system.suspected_cause(0.0, system.state) == ""


def test_a_spring_of_no_length_pulls_by_its_distance() -> None:
    columns = np.array([[0.0], [3.0], [0.0], [np.inf]])
    springs = Springs(np.array([[0, 1]]), *columns)
    for gap in (0.0, 1e-200, 1e-9, 2.0):
        body = Body(
            np.array([[0.0, 0, 0], [gap, 0, 0]]), np.ones(2), springs,
            np.zeros((0, 3), int),
        )  # fmt: skip
        system = SpringSystem(body, gravity=(0, 0, 0))
        found = system.acceleration(0.0, *system.state)[0].tolist()
        assert found == [pytest.approx(3 * gap, abs=1e-300), 0.0, 0.0]


def test_ends_at_one_place_pull_nothing() -> None:
    body = rope([1, 1, 1], [1, 1, 1], 3, Family(100.0, 1.0), mass=1.0)
    stretched = replace(body, springs=replace(body.springs, rest=np.ones(2)))
    system = SpringSystem(stretched, gravity=(0, 0, 0), velocities=np.eye(3))
    assert not system.acceleration(0.0, *system.state).any()
    by_x, _ = system.jacobians(0.0, *system.state)
    assert np.isfinite(by_x.toarray()).all()


def test_wind_presses_a_sheet_and_not_its_edge() -> None:
    body = sheet(3, 3, mass=1.0, structural=Family(1.0))
    for wind, area in (([0, 0, 2], 1.0), ([2, 0, 0], 0.0), ([0, 0, -2], 1.0)):
        system = SpringSystem(
            body, gravity=(0, 0, 0), air=Air(wind, drag=1.5, lift=0.7, density=1.2)
        )
        whole = forces(system, system.state).sum(axis=0)
        expected = 0.5 * 1.2 * 1.5 * area * 2 * np.array(wind)
        assert_allclose(whole, expected, atol=1e-12)


def test_lift_is_across_the_wind() -> None:
    body = sheet(2, 2, mass=1.0, across=[1, 0, 0.5])
    system = SpringSystem(body, gravity=(0, 0, 0), air=Air([3.0, 0, 0], drag=0, lift=1))
    whole = forces(system, system.state).sum(axis=0)
    assert whole[0] == pytest.approx(0, abs=1e-12)
    assert whole[2] < 0


def test_air_that_goes_along_presses_nothing() -> None:
    body = sheet(2, 2, mass=1.0)
    going = np.tile([0.0, 0, 4.0], (4, 1))
    system = SpringSystem(
        body, gravity=(0, 0, 0), air=Air([0, 0, 4.0]), velocities=going
    )
    assert not forces(system, system.state).any()


def test_wind_goes_with_its_times() -> None:
    body = sheet(2, 2, mass=1.0)
    air = Air([[0, 0, 1.0], [0, 0, 3.0]], times=[0, 2])
    system = SpringSystem(body, gravity=(0, 0, 0), air=air)
    pushed = [forces(system, system.state, t).sum() for t in (-1, 0, 1, 5)]
    assert_allclose(np.sqrt(np.array(pushed) / pushed[0]), [1, 1, 2, 3])


@pytest.mark.slow
@pytest.mark.parametrize(
    "method", ["symplectic_euler", "velocity_verlet", "rk4", "rk45", "bdf2", "radau"]
)
def test_integrators_take_springs_through_time(method: str) -> None:
    line = rope([0, 0, 0], [0.3, 0, 0], 4, Family(200.0, 0.05), mass=0.02)
    system = SpringSystem(line, pins=Pins([0]), drag=0.5)
    fixed = find_integrator(method).control == "fixed"
    rate = 1200 if method == "bdf2" else 4800
    options = IntegrateOptions(method, step=1 / rate if fixed else None)
    exact = integrate(system, [0, 0.2], IntegrateOptions("dop853", tolerance=1e-10))
    found = integrate(system, [0, 0.2], options)
    assert found.stats.status == "ok"
    assert_allclose(found.positions[-1], exact.positions[-1], atol=5e-4)


@settings(max_examples=examples(10))
@given(SEEDS, st.integers(1, 70))
def test_kernels_step_as_the_table_does(seed: int, count: int) -> None:
    system = shaken(
        seed, pins=Pins([3]), targets=PointTargets([1], [[1, 2, 3]], 3.0, 0.5),
        air=Air([1.0, 2.0, 3.0]), drag=0.3,
    )  # fmt: skip
    options = IntegrateOptions("symplectic_euler", step=2.0**-10)
    times = [0.0, count * 2.0**-10]
    found = integrate(system, times, options).states[-1]
    system.native = lambda _method: None  # type: ignore[method-assign, assignment]
    stepped = integrate(system, times, options).states[-1]
    assert found.tobytes() == stepped.tobytes()


def test_moved_pins_are_where_they_are_to_be() -> None:
    line = rope([0, 0, 0], [0.3, 0, 0], 4, Family(200.0, 0.05), mass=0.02)
    path = np.array([[[0.0, 0, 0]], [[0, 0.5, 0]]])
    system = SpringSystem(line, pins=Pins([0], path, [0, 0.5]))
    options = IntegrateOptions("symplectic_euler", step=1 / 1024)
    found = integrate(system, [0, 0.25, 0.5, 1], options)
    assert_allclose(found.positions[:, 0, 1], [0, 0.25, 0.5, 0.5], atol=1e-12)
    assert_allclose(found.velocities[:, 0, 1], [0, 1, 1, 0], atol=1e-9)
    system.native = lambda _method: None  # type: ignore[method-assign, assignment]
    stepped = integrate(system, [0, 0.25, 0.5, 1], options)
    assert_allclose(found.states, stepped.states, rtol=0, atol=1e-9)


def faults(**changes: object) -> list[str]:
    """Return the codes of what is wrong with a rope of three particles."""
    base = rope([0, 0, 0], [2, 0, 0], 3, Family(1.0), mass=1.0)
    parts = {
        name: changes.pop(name, getattr(base, name))
        for name in ("positions", "masses", "springs", "triangles")
    }
    with pytest.raises(OptionError) as error:
        SpringSystem(Body(**parts), **changes)
    return [fault.code for fault in error.value.faults]


@pytest.mark.parametrize("mass", [0.0, -1.0, np.nan, np.inf])
def test_free_particles_have_a_mass(mass: float) -> None:
    assert faults(masses=np.array([1.0, mass, 1.0])) == ["SIM040"]
    line = rope([0, 0, 0], [2, 0, 0], 3, Family(1.0), mass=1.0)
    body = Body(line.positions, np.array([mass, 1, 1]), line.springs, line.triangles)
    assert SpringSystem(body, pins=Pins([0])).inverse_masses.tolist() == [0, 1, 1]


def test_positions_are_finite() -> None:
    assert faults(positions=np.diag([1.0, np.nan, 1.0])) == ["SIM041"]


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("ends", [[0, 3]]),
        ("ends", [[1, 1]]),
        ("rest", [-1.0]),
        ("stiffness", [np.nan]),
        ("damping", [-1.0]),
        ("limit", [0.5]),
    ],
)
def test_springs_have_ends_and_numbers(field: str, value: object) -> None:
    numbers: dict[str, object] = {
        "ends": [[0, 1]], "rest": [1.0], "stiffness": [1.0], "damping": [0.0],
        "limit": [np.inf],
    }  # fmt: skip
    values = {k: np.array(v) for k, v in {**numbers, field: value}.items()}
    assert faults(springs=Springs(**values)) == ["SIM042"]


def test_triangles_have_corners() -> None:
    assert faults(triangles=np.array([[0, 1, 7]])) == ["SIM042"]


def test_pins_and_targets_are_of_particles() -> None:
    assert faults(pins=Pins([0, 5])) == ["SIM043"]
    assert faults(pins=Pins([1, 1])) == ["SIM043"]
    assert faults(targets=PointTargets([-1], [[0, 0, 0]], 1.0)) == ["SIM043"]


@pytest.mark.parametrize(
    ("positions", "times"),
    [
        (np.zeros((2, 1, 3)), None),
        (np.zeros((2, 1, 3)), [0, 0]),
        (np.zeros((2, 2, 3)), [0, 1]),
        (np.full((1, 3), np.nan), None),
        (np.zeros((0, 1, 3)), []),
    ],
)
def test_paths_fit_their_times(positions: FloatArray, times: object) -> None:
    assert faults(pins=Pins([0], positions, times)) == ["SIM044"]  # type: ignore[arg-type]
    assert faults(targets=PointTargets([0], positions, 1.0, times=times)) == ["SIM044"]  # type: ignore[arg-type]


def test_many_faults_are_counted() -> None:
    body = sheet(9, 9, mass=0.0)
    with pytest.raises(OptionError) as error:
        SpringSystem(body)
    assert len(error.value.faults) == 6
    assert "76 more" in error.value.faults[-1].message
