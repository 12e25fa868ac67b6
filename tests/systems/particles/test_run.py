"""Particles through time: births, lives, ends."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal
from support.suite import examples

from animtool.core.errors import OptionError, ToleranceError
from animtool.sim import INTEGRATORS, IntegrateOptions, find_integrator
from animtool.sim.colliders import Box, Collider, Mesh, Plane, Poses, Sphere
from animtool.sim.integrators.integrator import EquationForm, StepControl
from animtool.systems.particles import (
    BoxShape,
    Disc,
    Emitter,
    KillRegion,
    MeshSurface,
    ParticleFrame,
    ParticleRun,
    Particles,
    Point,
    SphereShape,
    VelocityField,
    find_force,
)

GRAVITY = find_force("gravity")()
FOUNTAIN = Particles(
    [
        Emitter(
            place=Disc(0.1),
            rate=70,
            bursts=[(0.5, 20)],
            speed=3,
            speed_spread=1,
            spread=0.4,
            lifetime=0.8,
            lifetime_spread=0.3,
            seed=5,
        ),
        Emitter(place=SphereShape(0.2), rate=31.7, speed=1, spread=np.pi, lifetime=0.5),
    ],
    [GRAVITY, find_force("turbulence")(), find_force("drag")(linear=1e-3)],
    colliders=[Collider(Plane(), restitution=0.4, friction=0.3)],
)


def last(setup: Particles, t: float, begin: float = 0.0) -> ParticleFrame:
    return ParticleRun(setup, begin).at(t)


@cache
def fountain() -> ParticleFrame:
    """Return the fountain after a second."""
    return last(FOUNTAIN, 1.0)


def same(a: ParticleFrame, b: ParticleFrame) -> None:
    for name in ("ids", "points", "velocities", "radii", "ages"):
        assert_array_equal(getattr(a, name), getattr(b, name))


@pytest.mark.slow
@settings(max_examples=examples(5), deadline=None)
@given(st.lists(st.floats(0, 1), max_size=6))
def test_looking_changes_nothing(times: list[float]) -> None:
    run = ParticleRun(FOUNTAIN)
    for t in sorted(times):
        run.at(t)
    same(run.at(1.0), fountain())


def test_births_do_not_depend_on_the_step() -> None:
    emitter = FOUNTAIN.emitters[0]
    free = replace(FOUNTAIN, forces=[GRAVITY], colliders=[], emitters=[emitter])
    halved = replace(free, options=IntegrateOptions("midpoint", step=1 / 192))
    a, b = last(free, 1.0), last(halved, 1.0)
    assert_array_equal(a.ids, b.ids)
    assert_allclose(a.ages, b.ages, atol=1e-12)
    # Under gravity alone both are exact.
    assert_allclose(a.points, b.points, atol=1e-9)


def test_a_stream_has_no_lumps() -> None:
    stream = Particles([Emitter(rate=1000, speed=5, direction=(1, 0, 0))])
    frame = last(stream, 0.5)
    assert_allclose(np.diff(frame.points[:, 0]), -0.005, atol=1e-9)
    assert len(frame.ids) == 500


def test_going_on_from_the_middle_is_the_whole() -> None:
    half = ParticleRun(FOUNTAIN)
    half.at(0.5)
    rest = ParticleRun(FOUNTAIN, 0.0, half.state)
    same(rest.at(1.0), fountain())


def test_ids_are_never_used_again() -> None:
    run, living, gone = ParticleRun(FOUNTAIN), set[int](), set[int]()
    for k in range(40):
        frame = run.at(k / 24)
        assert (np.diff(frame.ids) > 0).all()
        now = set(frame.ids.tolist())
        gone |= living - now
        assert not now & gone
        living = now
    assert len(gone) > 50


def test_lives_end_in_time() -> None:
    frame = last(FOUNTAIN, 1.5)
    assert frame.ages.max() <= 1.1
    assert frame.ages.min() >= 0


def test_preroll_is_only_a_beginning() -> None:
    early = last(FOUNTAIN, 1.0, begin=-1.0)
    assert early.ages.max() > 0.9
    assert early.ids[0] > 0


def test_kill_regions_remove() -> None:
    below = KillRegion(Collider(Plane((0, 1, 0), -0.5)))
    outside = KillRegion(Collider(Box((2, 4, 2)), container=True))
    falling = Particles(
        [Emitter(rate=50, place=BoxShape((1.9, 0, 0)), speed=1)],
        [GRAVITY],
        kills=[below, outside],
    )
    frame = last(falling, 3.0)
    assert 0 < len(frame.ids) < 60
    assert frame.points[:, 1].min() >= -0.5


def test_what_there_is_no_room_for_is_not_born() -> None:
    crowded = Particles([Emitter(rate=100)], max_particles=30)
    run = ParticleRun(crowded)
    assert len(run.at(1.0).ids) == 30
    assert run.state.state.missed == 70
    assert [notice.code for notice in run.notices] == ["SIM121"]


@pytest.mark.parametrize(
    "place",
    [
        Point(),
        Disc(0.5),
        SphereShape(0.5),
        SphereShape(0.5, hollow=True),
        BoxShape((1, 2, 0)),
        MeshSurface(Mesh([[0, 0, 0], [0, 0, 1], [1, 0, 0]], [[0, 1, 2]])),
    ],
)
def test_places_are_filled_evenly(place: object) -> None:
    source = Emitter(place=place, bursts=[(0, 4000)], speed=0)  # type: ignore[arg-type]
    points = last(Particles([source]), 0.0).points
    low, high = points.min(axis=0), points.max(axis=0)
    middle = [1 / 3, 0, 1 / 3] if isinstance(place, MeshSurface) else [0, 0, 0]
    assert_allclose(points.mean(axis=0), middle, atol=0.05)
    radius = np.linalg.norm(points, axis=1)
    if isinstance(place, SphereShape):
        share = 0.0 if place.hollow else 0.5
        inner = (radius < 0.5 * 0.5 ** (1 / 3)).mean()
        assert inner == pytest.approx(share, abs=0.05)
    if isinstance(place, Disc):
        assert (radius < 0.5 * 0.5**0.5).mean() == pytest.approx(0.5, abs=0.05)
    if isinstance(place, BoxShape):
        assert_allclose(high - low, [1, 2, 0], atol=0.01)


def test_directions_fill_their_cone() -> None:
    cone = Emitter(bursts=[(0, 4000)], speed=2, spread=0.5, direction=(0, 0, 3))
    ways = last(Particles([cone]), 0.0).velocities / 2
    angles = np.arccos(np.clip(ways[:, 2], -1, 1))
    assert angles.max() <= 0.5
    assert (np.cos(angles) > (1 + np.cos(0.5)) / 2).mean() == pytest.approx(
        0.5, abs=0.05
    )


def test_surfaces_and_hollow_balls_throw_outwards() -> None:
    ball = Emitter(place=SphereShape(1, hollow=True), bursts=[(0, 100)], speed=1)
    frame = last(Particles([ball]), 0.0)
    assert_allclose(frame.velocities, frame.points, atol=1e-12)


def test_moving_emitters_lend_their_velocity() -> None:
    poses = Poses([0, 2], [[0, 0, 0], [6, 0, 0]], [[0, 0, 0, 1]] * 2)
    cart = Emitter(poses=poses, rate=10, speed=0, inherit=0.5)
    frame = last(Particles([cart]), 1.0)
    assert_allclose(frame.velocities[:, 0], 1.5, rtol=1e-6)
    assert_allclose(frame.points[:, 0], 3 * (1 - frame.ages) + 1.5 * frame.ages)


# Methods


@pytest.mark.parametrize("name", INTEGRATORS)
def test_every_integrator_serves(name: str) -> None:
    integrator = find_integrator(name)
    fixed = integrator.control is StepControl.FIXED
    throw = Particles(
        [Emitter(bursts=[(0, 3)], speed=3, spread=0.2)],
        [GRAVITY, find_force("drag")(linear=1e-4)],
        options=IntegrateOptions(name, step=1 / 96),
    )
    reference = replace(throw, options=IntegrateOptions("rk4", step=1 / 96))
    a, b = last(throw, 0.5), last(reference, 0.5)
    order = integrator.order if fixed else 4
    assert_allclose(a.points, b.points, atol={1: 0.1, 2: 1e-3}.get(order, 1e-4))


def test_a_particle_in_a_velocity_field_goes_round() -> None:
    whirl = VelocityField("-z * 2", "0.5", "x * 2")
    start = Poses.fixed((1, 0, 0))
    ring = Particles(
        [Emitter(poses=start, bursts=[(0, 1)])],
        velocity=whirl,
        options=IntegrateOptions("rk4", step=1 / 96),
    )
    frame = last(ring, np.pi / 4)
    assert_allclose(frame.points, [[0, np.pi / 8, 1]], atol=1e-6)
    assert_allclose(frame.velocities, [[-2, 0.5, 0]], atol=1e-5)


def test_colliders_stop_what_a_field_carries() -> None:
    ball = Collider(Sphere(0.5, (1, 0, 0)))
    stream = Particles(
        [Emitter(rate=20, place=Disc(0.3))],
        velocity=VelocityField("1"),
        colliders=[ball],
    )
    frame = last(stream, 2.0)
    off = np.linalg.norm(frame.points - [1, 0, 0], axis=1)
    assert off.min() >= 0.5 + 0.005 - 1e-6


def test_a_stiff_spring_is_warned_of_and_stopped() -> None:
    stiff = Particles(
        [Emitter(bursts=[(0, 2)], speed=1, mass=1)],
        [find_force("spring")(k=1e5)],
        options=IntegrateOptions("velocity_verlet", step=1 / 96),
    )
    run = ParticleRun(stiff)
    with pytest.raises(ToleranceError) as error:
        run.at(20.0)
    fault = error.value.faults[-1]
    assert fault.code == "SIM102"
    assert fault.hint is not None
    assert f"{2 / np.sqrt(1e5):.3g} s" in fault.hint


# Faults


def codes(setup: Particles) -> list[str]:
    with pytest.raises(OptionError) as error:
        ParticleRun(setup)
    return [fault.code for fault in error.value.faults]


@pytest.mark.parametrize(
    "wrong",
    [
        {"mass": 0.0},
        {"mass": np.nan},
        {"mass": -1.0},
        {"rate": -1.0},
        {"rate": np.inf},
        {"lifetime": -1.0},
        {"lifetime": np.nan},
        {"lifetime_spread": -1.0},
        {"radius": 0.0},
        {"speed": np.inf},
        {"spread": 4.0},
        {"start": 2.0, "end": 1.0},
        {"direction": (0, 0, 0)},
        {"bursts": [(np.nan, 1)]},
        {"bursts": [(50.0, 0.5)]},
        {"place": Disc(-1)},
        {"radius": 0.01, "radius_spread": 0.02},
        {"mass": 1e-320},
    ],
)
def test_emitters_that_make_no_sense(wrong: dict[str, object]) -> None:
    emitter = Emitter(name="jet", **{"rate": 1.0, **wrong})  # type: ignore[arg-type]
    assert set(codes(Particles([emitter]))) == {"SIM021"}


def test_everything_wrong_is_said_at_once() -> None:
    setup = Particles(
        [Emitter(mass=0)],
        [find_force("drag")(linear=-1)],
        velocity=VelocityField("y +"),
        colliders=[Collider(Sphere(-1))],
        options=IntegrateOptions("rk5"),
        max_particles=0,
    )
    assert sorted(codes(setup)) == [
        *("SIM001", "SIM020", "SIM021", "SIM022", "SIM022"),
        *("SIM024", "SIM024", "SIM024"),
    ]
    assert codes(Particles([])) == ["SIM024"]


def test_accelerations_have_no_place_in_a_velocity_field() -> None:
    assert find_integrator("velocity_verlet").form is EquationForm.ACCELERATIONS
    options = IntegrateOptions("velocity_verlet", step=0.01)
    setup = Particles([Emitter(rate=9)], velocity=VelocityField("1"), options=options)
    with pytest.raises(OptionError) as error:
        ParticleRun(setup)
    assert error.value.code == "SIM006"


def test_time_does_not_run_backwards() -> None:
    run = ParticleRun(FOUNTAIN)
    run.at(0.5)
    with pytest.raises(OptionError) as error:
        run.at(0.2)
    assert error.value.code == "SIM002"


def test_energies_beyond_numbers_are_none_without_a_warning() -> None:
    """A state may hold any masses: one high up and one far below sum to no number."""
    setup = Particles([Emitter(bursts=[(0, 2)])], [GRAVITY])
    run = ParticleRun(setup)
    run.at(0.5)
    state = run.state.state
    heavy = replace(state.particles, masses=np.array([1e308, 1e308]))
    places = np.array([[[0.0, 1e6, 0], [0, -1e6, 0]], np.zeros((2, 3))])
    found = run.simulation.diagnostics(
        replace(state, particles=heavy, state=places), 0.5
    ).energy
    assert found is not None
    assert np.isnan(found.potential)
    # Of those that there are: masses count, and each by itself.
    light = replace(state.particles, masses=np.array([2.0, 3.0]))
    places = np.array([[[0.0, 5, 0], [1, -2, 0]], [[1.0, 2, 2], [0, 0, 4]]])
    found = run.simulation.diagnostics(
        replace(state, particles=light, state=places), 0.5
    ).energy
    assert found is not None
    assert found.kinetic == pytest.approx(2 * 9 / 2 + 3 * 16 / 2)
    assert found.potential == pytest.approx(9.81 * (2 * 5 - 3 * 2), rel=1e-3)
