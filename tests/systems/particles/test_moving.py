"""Particles within a step, in numbers: births, walls, energies, and what blew up."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

from animtool import _kernels
from animtool.core.array_types import FloatArray
from animtool.sim import IntegrateOptions
from animtool.sim.colliders import Collider, Colliders, Plane, Poses
from animtool.sim.colliders.bodies import Wrenches
from animtool.systems.particles import (
    Emitter,
    Force,
    Particles,
    ParticleState,
    VelocityField,
    find_force,
    moving,
)
from animtool.systems.particles.moving import (
    DivergenceCheck,
    ParticleFlow,
    ParticleForces,
    advance_births,
    particle_energies,
)


def some(masses: list[float], births: list[float] | None = None, first: int = 0) -> Any:
    """Return particles without radii, ids from one on."""
    count = len(masses)
    return ParticleState.everlasting(
        first + np.arange(count),
        np.array(masses),
        0.1,
        np.zeros(count) if births is None else np.array(births),
        np.zeros((count, 3)),
    )


def setup(*names: tuple[str, dict[str, Any]], **keys: Any) -> Particles:
    forces: list[Force] = [find_force(name)(**given) for name, given in names]
    return Particles([Emitter(rate=1)], forces, **keys)


DOWN = ("gravity", {"acceleration": (0.0, -8.0, 0.0)})
FLOOR = Colliders([Collider(Plane(), Poses.fixed())])


def test_who_is_born_within_a_step_begins_then() -> None:
    """Of a force that grows with time the way is exact: t³ of each from its birth."""
    born = np.array([[[0.0, 5, 0]] * 2, [[1.0, 0, 0]] * 2])
    own = some([2.0, 4.0], [1.0, 1.5])
    found = advance_births(
        setup(("field", {"x": "6 * t * mass"}), DOWN), Colliders([]), own, born, 1, 2
    )
    for k, (since, t) in enumerate(((1.0, 1.0), (0.5, 1.5))):
        fast = 1 + 3 * (4 - t**2)
        way = since + (8 - t**3) - 3 * t**2 * since
        assert_allclose(found[0, k], [way, 5 - 4 * since**2, 0], atol=1e-12)
        assert_allclose(found[1, k], [fast, -8 * since, 0], atol=1e-12)


def test_who_is_born_in_a_field_goes_with_it_from_then_on() -> None:
    field = VelocityField("3 * t * t", "age", "0")
    own = some([1.0, 1.0], [1.0, 1.5])
    born = np.zeros((2, 2, 3))
    found = advance_births(
        Particles([Emitter(rate=1)], velocity=field), Colliders([]), own, born, 1, 2
    )
    assert_allclose(found[0], [[7, 0.5, 0], [8 - 1.5**3, 0.125, 0]], atol=1e-12)
    assert_allclose(found[1], 0)


def test_who_is_born_over_a_floor_ends_on_it() -> None:
    born = np.array([[[0.0, 1.0, 0], [0, 9, 0]], [[0.0, -5, 0], [0, -5, 0]]])
    own = some([1.0, 1.0], [0.25, 0.25])
    found = advance_births(setup(), FLOOR, own, born, 0.0, 1.0)
    assert_allclose(found[0], [[0, 0.1, 0], [0, 5.25, 0]], atol=1e-9)
    assert found[1, 0, 1] >= 0
    assert_allclose(found[1, 1], [0, -5, 0])


def test_a_step_ends_at_walls_and_who_meets_none_is_left() -> None:
    own, state = some([1.0, 2.0]), np.zeros((2, 2, 3))
    for system in (
        ParticleForces(setup(), FLOOR, own, state),
        ParticleFlow(
            Particles([Emitter(rate=1)], velocity=VelocityField("1")),
            FLOOR, own, state[0],
        ),
    ):  # fmt: skip
        before = np.array([[[0.0, 0.3, 0], [0, 4, 0]], [[1.0, -4, 0], [1, -4, 0]]])
        after = np.stack([before[0] + 0.125 * before[1], before[1]])
        flows = isinstance(system, ParticleFlow)
        begin, end = (before[0], after[0]) if flows else (before, after)
        found = system.settle(1.0, 0.125, begin, end)
        places = found if flows else found[0]
        assert_allclose(places, [[0.125, 0.1, 0], [0.125, 3.5, 0]], atol=1e-9)
        assert system.contacts is not None
        assert system.contacts.any.tolist() == [True, False]
        far = end + np.array([0.0, 9, 0])
        assert system.settle(1.0, 0.125, begin + np.array([0.0, 9, 0]), far) is far


def test_bodies_take_what_meets_their_own_shapes(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Behind two walls one of two shapes, one that is fixed, and one of three."""
    bodies = [
        SimpleNamespace(colliders=range(n), count=count, name=k)
        for k, (n, count) in enumerate([(2, 1), (1, 0), (3, 2)])
    ]
    hit = np.array([-1, 0, 1, 2, 3, 4, 5, 7])
    took: list[Any] = []

    def share(
        own: Any, t: float, shapes: Any, free: Any, state: Any, masses: Any
    ) -> Any:
        took.append((own.name, t, shapes.tolist(), free, masses))
        return state + 1.0, f"taken {own.name}"

    monkeypatch.setattr(moving, "exchange_impulses", share)
    monkeypatch.setattr(Wrenches, "sum", staticmethod(tuple))
    whole = SimpleNamespace(
        _colliders=type("Walls", (list,), {"bodies": bodies})([0, 0]),
        particles=SimpleNamespace(masses="masses"),
        wrenches=[
            SimpleNamespace(delayed_by=lambda h, k=k: f"before {k} by {h}")
            for k in range(3)
        ],
    )
    done = SimpleNamespace(
        points=np.zeros((8, 3)),
        velocities=np.full((8, 3), 5.0),
        contacts=SimpleNamespace(colliders=hit),
    )
    found = ParticleForces._exchange_momentum(whole, 2.0, 0.25, "free", done)  # type: ignore[arg-type]
    assert took == [
        (0, 2.0, [-3, -2, -1, 0, 1, -1, -1, -1], "free", "masses"),
        (2, 2.0, [-6, -5, -4, -3, -2, -1, 0, 2], "free", "masses"),
    ]
    assert (found[0] == 2).all()
    assert (found[1] == 7).all()
    assert whole.wrenches[0] == ("before 0 by 0.25", "taken 0")
    assert whole.wrenches[2] == ("before 2 by 0.25", "taken 2")


def test_energies_count_each_mass_and_what_walls_may_bring() -> None:
    piston = Collider(
        Plane(), Poses([0, 2], [[0, -9, 0], [0, -3, 0]], [[0, 0, 0, 1]] * 2)
    )
    own = some([2.0, 3.0])
    state = np.array([[[0.0, 5, 0], [1, -2, 0]], [[1.0, 2, 2], [0, 0, 4]]])
    forces = setup(DOWN, ("uniform", {"push": (0.5, 0, 0)}))
    found, known = particle_energies(forces, own, state)
    assert_allclose(found, [[9, 24], [80, -48 - 0.5]])
    assert known
    system = ParticleForces(forces, Colliders([piston]), own, state)
    energy = system.energy(0.0, state)
    assert energy is not None
    assert (energy.kinetic, energy.potential) == pytest.approx((33, 31.5))
    assert energy.supply == pytest.approx(5 * 3**2)
    windy = setup(DOWN, ("wind", {"drag": 1.0}))
    found, known = particle_energies(windy, own, state)
    assert_allclose(found[1], [80, -48])
    assert not known
    assert ParticleForces(windy, FLOOR, own, state).energy(0.0, state) is None
    found, known = particle_energies(setup(), own, state)
    assert_allclose(found, [[9, 24], [0, 0]])
    assert known


def test_the_suspect_is_who_is_accelerated_most() -> None:
    """The same force on the lighter one, which is neither the first nor the last."""
    state = np.zeros((2, 3, 3))
    own = some([2.0, 1.0, 3.0], first=7)
    forces = setup(("uniform", {"push": (1, 0, 0)}))
    said = ParticleForces(forces, FLOOR, own, state).suspected_cause(0.0, state)
    assert said == "particle 8 has the largest acceleration"
    nobody = some([])
    none = np.zeros((2, 0, 3))
    assert ParticleForces(forces, FLOOR, nobody, none).frequencies(0.0, none) is None


def placed(heights: list[float], speeds: list[float]) -> FloatArray:
    zeros = np.zeros(len(heights))
    return np.stack(
        [np.stack([zeros, heights, zeros], 1), np.stack([zeros, speeds, zeros], 1)]
    )


def checked(growth: float, *forces: Any, colliders: Any = ()) -> DivergenceCheck:
    options = IntegrateOptions("midpoint", step=0.01, growth=growth)
    return DivergenceCheck(setup(*forces, options=options), Colliders(list(colliders)))


@pytest.mark.parametrize(
    ("before", "after", "least"),
    [
        # Kinetic and potential energies [J] of 2 kg before; after; gained over usual.
        ((100.0, 0.0), (300.0, 0.0), 200 / 100),
        ((0.0, -80.0), (120.0, -80.0), 120 / 80),
        ((100.0, -80.0), (220.0, -80.0), 120 / 100),
        ((0.0, 160.0), (480.0, -80.0), 240 / 240),
        ((60.0, 40.0), (300.0, 40.0), 240 / 100),
    ],
)
def test_what_was_usual_is_the_most_of_what_there_was(
    before: Any, after: Any, least: float
) -> None:
    """Kinetic, potential, of both the sum, and what was fallen through since."""

    def state(kinetic: float, potential: float) -> FloatArray:
        return placed([potential / 16], [np.sqrt(kinetic)])

    for share, blown in ((0.99, True), (1.01, False)):
        check = checked(least * share, DOWN)
        check.set_particles(some([2.0]), state(*before))
        assert bool(check.divergence_reason(0.0, state(*after))) is blown
    spoiled = state(*after)
    spoiled[1, 0, 2] = np.nan
    assert check.divergence_reason(0.0, spoiled) == "its state is not finite"


def test_a_piston_may_bring_what_its_speed_gives() -> None:
    """Who stands has none: 2 kg by 3 m/s may gain 18 J that often."""
    moves = Poses([0, 2], [[0, -9, 0], [0, -3, 0]], [[0, 0, 0, 1]] * 2)
    for share, blown in ((0.99, True), (1.01, False)):
        check = checked(2.0 * share, DOWN, colliders=[Collider(Plane(), moves)])
        check.set_particles(some([2.0]), placed([0.0], [0.0]))
        assert bool(check.divergence_reason(0.0, placed([0.0], [6.0]))) is blown


def test_who_is_born_or_removed_is_no_gain() -> None:
    """The energy of each counts from where it was first seen, by its id."""
    check = checked(0.5, DOWN)
    check.set_particles(some([2.0, 2.0], first=4), placed([0.0, 5.0], [10.0, 0.0]))
    later = placed([5.0, 0.0], [0.0, 30.0])
    check.set_particles(some([2.0, 2.0], first=5), later)
    # Of id 5 as it was, of id 6 as it came: 80 J, and 900 J.
    assert_allclose(check._first_energies, [[0, 900], [80, 0]])
    assert not check.divergence_reason(0.0, later)
    check.reset_energies(np.array([True, False]), placed([1.0, 9.0], [3.0, 9.0]))
    assert_allclose(check._first_energies, [[9, 900], [16, 0]])
    check.set_particles(some([2.0], first=2), placed([1.0], [1.0]))
    assert_allclose(check._first_energies, [[1], [16]])
    check.set_particles(some([]), np.zeros((2, 0, 3)))
    check.set_particles(some([2.0], first=9), placed([1.0], [1.0]))
    assert_allclose(check._first_energies, [[1], [16]])


def test_without_all_potentials_energy_tells_of_steps_too_long_alone() -> None:
    far = placed([0.0], [900.0])
    for forces, too_long, blown in (
        ([DOWN], False, True),
        ([DOWN, ("wind", {"drag": 1.0})], False, False),
        ([DOWN, ("wind", {"drag": 1.0})], True, True),
        ([DOWN, ("charges", {})], True, False),
    ):
        check = checked(1.0, *forces)
        check.set_particles(some([2.0]), placed([0.0], [10.0]))
        check.has_long_steps = too_long
        assert bool(check.divergence_reason(0.0, far)) is blown
    field = Particles([Emitter(rate=1)], velocity=VelocityField("1"))
    check = DivergenceCheck(field, Colliders([]))
    check.set_particles(some([2.0]), placed([0.0], [10.0]))
    assert check.divergence_reason(0.0, far) == ""


def test_charges_are_softened_and_sum_over_more_than_a_block() -> None:
    """Of 300 in a row in the middle none is missing: those at the ends feel most."""
    count = 300
    x = np.zeros((count, 3))
    x[:, 0] = np.arange(count)
    zeros = np.zeros(count)
    own = ParticleState(
        np.arange(count), zeros + 1, np.where(np.arange(count) < 280, 1e-3, -2e-3),
        zeros, zeros, zeros, x,
    )  # fmt: skip
    force = find_force("charges")(constant=5.0, softening=2.0)
    found = force.force(0.0, x, 0 * x, own)
    for i in (0, 255, 256, 299):
        off = x[i, 0] - x[:, 0]
        pull = 5 * own.charges[i] * (own.charges * off / (off**2 + 4) ** 1.5).sum()
        assert_allclose(found[i], [pull, 0, 0], atol=1e-18, rtol=1e-12)


def test_turbulence_is_a_sum_of_octaves_of_half_the_size_and_strength() -> None:
    x = np.array([[0.3, -0.7, 1.9], [5.1, 0.2, -3.3]])
    own = some([2.0, 3.0])
    force = find_force("turbulence")(
        strength=1.5, size=4.0, change=0.25, octaves=3, seed=7
    )
    expected = np.zeros((2, 3))
    for k in range(3):
        times = np.full(2, 1.2 * 0.25 * 2**k)
        expected += _kernels.curl_noise(x / 4 * 2**k, times, 7 + k) / 2**k
    expected *= 1.5 * np.array([[2.0], [3.0]])
    assert_allclose(force.force(1.2, x, 0 * x, own), expected)
    each = force.force(np.array([1.2, 0.0]), x, 0 * x, own)
    assert_allclose(each[0], expected[0])
    assert not np.allclose(each[1], expected[1])
    for jacobian in force.jacobians(0.0, x, x, own):
        assert_allclose(jacobian, np.zeros((2, 3, 3)))


def test_dampings_and_signs_of_forces_in_numbers() -> None:
    own = ParticleState(
        np.arange(2), np.array([2.0, 3.0]), np.array([0.5, -0.9]),
        np.array([0.1, 0.2]), np.zeros(2), np.zeros(2), np.ones((2, 3)),
    )  # fmt: skip
    v = np.array([[0.0, 4, 3], [0, 0, 0]])
    for name, options, damping in (
        ("viscosity", {"viscosity": 0.5}, 6 * np.pi * 0.5 * 0.2),
        ("wind", {"drag": 0.7}, 0.7),
        ("friction", {"deceleration": 2.0, "smooth": 0.5}, 2 * 3 / 0.5),
        ("spring", {"kd": 0.3}, 0.3),
        ("gravity", {}, 0.0),
    ):
        assert find_force(name)(**options).damping(v, own) == pytest.approx(damping)
    field = find_force("electromagnetic")(electric=(1, 2, 3), magnetic=(0, 3, 4))
    x = np.array([[1.0, 1, 1], [2, 0, 0]])
    assert_allclose(field.potential(x, own), [-0.5 * 6, 0.9 * 2])
    found = field.force(0.0, x, v, own)
    assert_allclose(found, [[0.5 * (1 + 16 - 9), 1, 1.5], [-0.9, -1.8, -2.7]])
    spring = find_force("spring")(k=4.0, rest=2.0)
    # From where each was born, at (1, 1, 1).
    assert_allclose(
        spring.potential(x + np.array([3.0, 0, 0]), own),
        [2, 0.5 * 4 * (18**0.5 - 2) ** 2],
    )
    assert find_force("drag")(linear=1).potential(x, own).tolist() == [0, 0]
    assert find_force("wind")().potential(x, own) is None
    brake = find_force("propulsion")(thrust=-6.0, duration=1.0)
    by_place, by_speed = brake.jacobians(1.0, x, v, own)
    assert_allclose(by_place, np.zeros((2, 3, 3)))
    assert_allclose(by_speed[0], -6 / 5 * np.eye(3))
    assert_allclose(by_speed[1], -6 / 1e-9 * np.eye(3))
    assert not brake.jacobians(1.01, x, v, own)[1].any()
    for given in ({"thrust": 0.0}, {"thrust": -6.0, "direction": (1, 0, 0)}):
        assert not np.any(find_force("propulsion")(**given).jacobians(0.0, x, v, own))
    for power, softening, faulty in (
        (1.0, 0.0, False), (0.99, 0.0, True), (-2.0, 0.1, False),
    ):  # fmt: skip
        central = find_force("central")(power=power, softening=softening)
        assert bool(central.faults()) is faulty
