"""Forces on particles: closed forms, potentials, faults."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from support.faults import raises

from animtool import _kernels
from animtool.core.array_types import ArrayLike, FloatArray
from animtool.core.errors import OptionError
from animtool.sim import IntegrateOptions
from animtool.sim.colliders import Colliders
from animtool.systems.particles import (
    FORCES,
    Emitter,
    Force,
    ParticleRun,
    Particles,
    ParticleState,
    find_force,
)
from animtool.systems.particles.moving import ParticleForces

# One of each kind that does something.
EXAMPLES: dict[str, dict[str, object]] = {
    "central": {"centre": (1, 0, 0), "strength": 2.0, "softening": 0.1},
    "charges": {"softening": 0.1},
    "drag": {"linear": 0.1, "quadratic": 0.2},
    "electromagnetic": {"electric": (1, 2, 0), "magnetic": (0, 0, 3)},
    "field": {"x": "-x * mass", "y": "sin(t) - vy", "z": "age"},
    "friction": {"deceleration": 2.0},
    "gravity": {},
    "propulsion": {"thrust": 0.5, "direction": (0, 0, 1), "duration": 1.0},
    "spring": {"anchor": (0, 1, 0), "k": 3.0, "kd": 0.0, "rest": 0.2},
    "turbulence": {"strength": 2.0},
    "uniform": {"push": (1, 0, 2)},
    "viscosity": {"viscosity": 1.0},
    "wind": {"velocity": (1, 0, 0), "drag": 0.3},
}


def some(count: int, seed: int = 0) -> ParticleState:
    random = np.random.default_rng(seed)
    return ParticleState(
        np.arange(count),
        random.uniform(0.5, 2, count),
        random.normal(0, 1e-5, count),
        np.full(count, 0.1),
        np.zeros(count),
        np.full(count, np.inf),
        random.normal(0, 1, (count, 3)),
    )


def moved(
    forces: list[Force], speed: ArrayLike, t: float, **options: object
) -> tuple[FloatArray, FloatArray]:
    """Return where one particle of 2 kg gets from the origin, and how fast."""
    way = np.asarray(speed, np.float64)
    fast = float(np.linalg.norm(way))
    one = Emitter(
        bursts=[(0.0, 1)],
        direction=way if fast else (0, 1, 0),
        speed=fast,
        mass=2.0,
        **options,  # type: ignore[arg-type]
    )
    setup = Particles([one], forces, options=IntegrateOptions("rk4", step=1 / 96))
    frame = ParticleRun(setup).at(t)
    return frame.points[0], frame.velocities[0]


def test_the_examples_are_the_table() -> None:
    assert sorted(EXAMPLES) == sorted(FORCES)


@pytest.mark.parametrize("name", FORCES)
def test_all_particles_at_once_are_each_alone(name: str) -> None:
    force, particles = find_force(name)(**EXAMPLES[name]), some(7)
    x, v = np.random.default_rng(1).normal(0, 1, (2, 7, 3))
    whole = force.force(0.3, x, v, particles)
    assert whole.shape == (7, 3)
    assert np.abs(whole).max() > 0
    assert force.faults() == []
    if not force.is_pair_force:
        alone = force.force(0.3, x[2:3], v[2:3], particles.select(np.array([2])))
        assert_allclose(whole[2:3], alone, rtol=1e-12)
    each = force.force(np.full(7, 0.3), x, v, particles)
    assert_allclose(whole, each)


@pytest.mark.parametrize("name", FORCES)
def test_forces_are_slopes_of_their_potentials(name: str) -> None:
    force, particles = find_force(name)(**EXAMPLES[name]), some(5)
    x = np.random.default_rng(2).normal(0, 1, (5, 3))
    if force.potential(x, particles) is None or force.is_dissipative:
        return
    slopes = np.zeros((5, 3))
    for i, step in enumerate(np.eye(3) * 1e-6):
        up, down = (
            force.potential(x + step, particles),
            force.potential(x - step, particles),
        )
        assert up is not None
        assert down is not None
        slopes[:, i] = (up - down) / 2e-6
    assert_allclose(
        force.force(0.0, x, 0 * x, particles), -slopes, rtol=1e-6, atol=1e-8
    )


@pytest.mark.parametrize("name", FORCES)
def test_what_drains_never_pushes(name: str) -> None:
    force, particles = find_force(name)(**EXAMPLES[name]), some(50)
    x, v = np.random.default_rng(3).normal(0, 2, (2, 50, 3))
    if force.is_dissipative:
        assert ((force.force(0.0, x, v, particles) * v).sum(axis=1) <= 0).all()
        assert force.damping(v, particles) > 0


def test_a_throw_is_a_parabola() -> None:
    x, v = moved([find_force("gravity")()], (3, 4, 0), 0.7)
    assert_allclose(x, [2.1, 4 * 0.7 - 0.5 * 9.81 * 0.49, 0], atol=1e-12)
    assert_allclose(v, [3, 4 - 9.81 * 0.7, 0], atol=1e-12)


def test_drag_slows_as_it_should() -> None:
    _, v = moved([find_force("drag")(linear=3.0)], (5, 0, 0), 1.0)
    assert v[0] == pytest.approx(5 * np.exp(-1.5), rel=1e-7)
    _, v = moved([find_force("drag")(quadratic=3.0)], (5, 0, 0), 1.0)
    assert v[0] == pytest.approx(5 / (1 + 5 * 1.5), rel=1e-5)


def test_a_charge_goes_round_in_a_magnetic_field() -> None:
    field = find_force("electromagnetic")(magnetic=(0, 0, 4.0))
    # Half a turn: angle q B / m t.
    x, v = moved([field], (1, 0, 0), 1.0, charge=np.pi / 2)
    assert_allclose(v, [-1, 0, 0], atol=1e-6)
    assert_allclose(x, [0, -2 / np.pi, 0], atol=1e-6)


def test_a_spring_to_the_place_of_birth_swings() -> None:
    spring = find_force("spring")(k=2 * (2 * np.pi) ** 2)
    x, _ = moved([spring], (0, 1, 0), 0.25)
    assert_allclose(x, [0, 1 / (2 * np.pi), 0], atol=1e-6)


def test_expressions_know_place_time_and_age() -> None:
    x, v = moved([find_force("field")(x="6 * t * mass")], (0, 0, 0), 1.0)
    assert_allclose([x[0], v[0]], [1, 3], rtol=1e-9)


def test_charges_push_each_other_apart_evenly() -> None:
    charges = find_force("charges")(softening=1e-6)
    particles = some(2)
    x = np.array([[0.0, 0, 0], [2, 0, 0]])
    found = charges.force(0.0, x, 0 * x, particles)
    size = 8.9875517862e9 * particles.charges.prod() / 4
    assert_allclose(found, [[-size, 0, 0], [size, 0, 0]], rtol=1e-6)


def test_turbulence_has_no_sources() -> None:
    random = np.random.default_rng(4)
    points, times = random.normal(0, 5, (500, 3)), random.uniform(-9, 9, 500)
    small, divergence = 1e-5, np.zeros(500)
    for i, step in enumerate(np.eye(3) * small):
        up = _kernels.curl_noise(points + step, times, 3)
        down = _kernels.curl_noise(points - step, times, 3)
        divergence += (up - down)[:, i] / (2 * small)
    assert_allclose(divergence, 0, atol=1e-7)
    swirls = _kernels.curl_noise(points, times, 3)
    assert np.sqrt((swirls**2).sum(axis=1).mean()) == pytest.approx(1.2, abs=0.2)
    assert np.abs(swirls.mean(axis=0)).max() < 0.15
    other = _kernels.curl_noise(points, times, 4)
    assert np.abs(np.corrcoef(swirls[:, 0], other[:, 0])[0, 1]) < 0.2


def test_unknown_forces_are_refused_with_the_nearest() -> None:
    with raises(OptionError, "SIM023", match="'gravity'"):
        find_force("gravty")


def test_all_faults_of_forces_are_said_at_once() -> None:
    wrong: list[tuple[str, dict[str, object]]] = [
        ("gravity", {"acceleration": (0, np.nan, 0)}),
        ("central", {"power": np.inf, "softening": -1.0}),
        ("charges", {"softening": 0.0}),
        ("drag", {"linear": -1.0}),
        ("field", {"x": "spam", "y": "1 +", "z": "sine(x)"}),
        ("friction", {"smooth": 0.0}),
        ("propulsion", {"direction": (0, 0, 0), "duration": -1.0}),
        ("spring", {"k": -1.0}),
        ("turbulence", {"size": 0.0, "octaves": 0}),
        ("viscosity", {"viscosity": np.nan}),
        ("wind", {"velocity": (0, 0)}),
        ("uniform", {"push": (0, 0, np.inf)}),
        ("electromagnetic", {"magnetic": (np.nan, 0, 0)}),
    ]
    forces = [find_force(name)(**given) for name, given in wrong]
    with pytest.raises(OptionError) as error:
        Particles([Emitter(rate=1)], forces).check()
    where = [fault.where for fault in error.value.faults]
    assert {fault.code for fault in error.value.faults} == {"SIM022"}
    assert {f"{name}[{i}]" for i, (name, _) in enumerate(wrong)} == set(where)


def test_drag_grows_with_twice_the_speed_by_its_square() -> None:
    """The steepest of (0.1 + 0.2 v) v is 0.1 + 0.4 v, here of the faster of two."""
    v = np.array([[3.0, 4.0, 0.0], [1.0, 0.0, 0.0]])
    drag = find_force("drag")(linear=0.1, quadratic=0.2)
    assert drag.damping(v, some(2)) == pytest.approx(2.1)
    assert_allclose(drag.force(0.0, 0 * v, v, some(2)), [[-3.3, -4.4, 0], [-0.3, 0, 0]])


def test_forces_of_one_particle_in_numbers() -> None:
    """Of 2 kg, a radius of 0.1 m, at (3, 4, 0) m and born there a second ago."""
    one = replace(some(1), masses=np.array([2.0]), births=np.array([1.0]))
    x, v = np.array([[3.0, 4.0, 0.0]]), np.array([[0.0, 2.0, 0.0]])
    brake = 2.0 * 3.0 / np.hypot(2.0, 1.5)
    for name, options, expected in (
        ("viscosity", {"viscosity": 0.5}, [0, -0.6 * np.pi, 0]),
        ("wind", {"velocity": (1, 0, 2), "drag": 0.5}, [0.5, -1, 1]),
        ("friction", {"deceleration": 3.0, "smooth": 1.5}, [0, -brake * 2, 0]),
        (
            "central",
            {"strength": 50.0, "softening": 0.0, "power": 1.0},
            [-300, -400, 0],
        ),
        ("central", {"strength": 50.0, "softening": 1e-9}, [-2.4, -3.2, 0]),
        ("spring", {"anchor": (0, 0, 0), "k": 2, "rest": 1, "kd": 0.5}, None),
        ("propulsion", {"thrust": 7.0, "direction": (0, 0, 3)}, [0, 0, 7]),
        ("propulsion", {"thrust": -7.0}, [0, -7, 0]),
        ("uniform", {"push": (1, 2, 3)}, [1, 2, 3]),
    ):
        found = find_force(name)(**options).force(2.0, x, v, one)
        # 2 N/m by 4 m, and 0.5 kg/s by the 1.6 m/s along the spring.
        along = -(8 + 0.5 * 1.6) * np.array([0.6, 0.8, 0])
        assert_allclose(found[0], along if expected is None else expected, atol=1e-9)


@pytest.mark.parametrize(("t", "burns"), [(1.0, 1), (2.5, 1), (2.6, 0)])
def test_a_thrust_lasts_from_birth_on(t: float, burns: int) -> None:
    one = replace(some(1), births=np.array([1.0]))
    thrust = find_force("propulsion")(thrust=2.0, direction=(1, 0, 0), duration=1.5)
    found = thrust.force(t, np.zeros((1, 3)), np.ones((1, 3)), one)
    assert_allclose(found, [[2.0 * burns, 0, 0]])


@pytest.mark.parametrize(
    ("power", "energy"), [(-2.0, 1 - 1 / 3), (-1.0, np.log(3)), (0.0, 2), (1.0, 4)]
)
def test_the_energy_of_a_centre_is_the_work_against_it(
    power: float, energy: float
) -> None:
    """Of 2 kg from 1 m to 3 m, against 5 m/s² at a metre."""
    force = find_force("central")(strength=5.0, power=power, softening=1e-9)
    two = replace(some(2), masses=np.array([2.0, 2.0]))
    near, far = force.potential(np.array([[0.0, 1, 0], [3, 0, 0]]), two)
    assert far - near == pytest.approx(2 * 5 * energy)


def state_of(masses: list[float], charges: list[float]) -> ParticleState:
    """Return particles of masses [kg] and charges [C]."""
    count = len(masses)
    return ParticleState(
        np.arange(count), np.array(masses), np.array(charges), np.ones(count),
        np.zeros(count), np.full(count, np.inf), np.zeros((count, 3)),
    )  # fmt: skip


@pytest.mark.parametrize(
    ("linear", "quadratic", "share"),
    [(0.5, 0.0, 0.5), (0.0, 2.0, 6.0), (0.5, 1.0, 3.5), (0.5, 2.0, 6.5)],
)
def test_drag_is_linear_and_quadratic_at_once(
    linear: float, quadratic: float, share: float
) -> None:
    """At 3 m/s off every axis: a part of the velocity, against it."""
    v = np.array([[1.0, -2, 2]])
    drag = find_force("drag")(linear=linear, quadratic=quadratic)
    found = drag.force(0.0, 0 * v, v, state_of([5.0], [0.0]))
    assert_allclose(found, -share * v)


def test_the_fastest_motions_are_those_of_the_lightest() -> None:
    """Of springs ω² is k / m; of a field what turns is the charge over the mass."""
    own = state_of([4.0, 3.0], [0.5, -0.9])
    spring = find_force("spring")(anchor=(0, 0, 0), k=12.0, kd=2.0)
    field = find_force("electromagnetic")(magnetic=(0.0, 3.0, 4.0))
    drag = find_force("drag")(linear=6.0)
    state = np.zeros((2, 2, 3))
    for forces, rows in (
        ([spring], [(2.0, 2 / 3 / (2 * 2.0))]),
        ([spring, spring], [(np.sqrt(8), 4 / 3 / (2 * np.sqrt(8)))]),
        ([field], [(1.5, 0.0)]),
        ([field, spring], [(1.5, 0.0), (2.0, 1 / 6)]),
        ([drag], [(2.0, 1.0)]),
    ):
        setup = Particles([Emitter()], forces)
        found = ParticleForces(setup, Colliders([]), own, state).frequencies(0.0, state)
        assert found is not None
        assert_allclose(found, rows)
    still = ParticleForces(
        Particles([Emitter()], []), Colliders([]), own, state
    ).frequencies(0.0, state)
    assert still is None
