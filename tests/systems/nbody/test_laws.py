"""Numbers of bodies, of profiles and of orbits, each by itself."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from adapters.nbody import _Context, nbody
from numpy.testing import assert_allclose, assert_array_equal

from animtool.core.errors import AnimtoolError
from animtool.maths import so3
from animtool.sim.colliders import Poses
from animtool.systems.framework import matter
from animtool.systems.nbody.galaxies import (
    MassProfile,
    _integral_to_end,
    build_galaxies,
    build_galaxy,
    disc_velocities,
    enclosed_mass,
    orbit_motions,
    squared_disc_speeds,
    surface_density,
)
from animtool.systems.nbody.nbody import (
    MAX_STEP_PHASE,
    MAX_UNSOFTENED_STEP_PHASE,
    MutualGravity,
    build,
)
from animtool.systems.nbody.spec import EncounterModel, GalaxyModel, NbodyModel
from animtool.systems.particles.emitter import uniform_samples

X = np.array([[0.0, 0, 0], [3, 4, 0], [3, 4, 2], [-9, 0, 0]])
MASSES = np.array([1.0, 2.0, 3.0, 0.5])


def pulls(x: Any, masses: Any, constant: float, softening: float) -> np.ndarray:
    """Return accelerations, summed pair by pair."""
    found = np.zeros((len(x), 3))
    for i, at in enumerate(x):
        for j, other in enumerate(x):
            if i != j:
                off = other - at
                far = off @ off + softening**2
                found[i] += constant * masses[j] * off / far**1.5
    return found


@pytest.mark.parametrize("softening", [0.0, 1.5])
def test_the_closest_pair_is_that_which_circles_fastest(softening: float) -> None:
    made = nbody(X, 0 * X, MASSES, 2.0, softening, 0.01)
    state = made.initial_state()
    reach = (4 + softening**2) ** 1.5
    assert state.gravity.rates.max() == pytest.approx(2 * 5 / reach)
    mass, said = made._fastest_pair(X, state.gravity.rates)
    assert (mass, said) == (5.0, "bodies 1 and 2 are 2 m apart")
    assert made.suspected_cause(X, state.gravity) == said
    found = made._fastest_pair(X, np.array([0.0, 0, 0, 9.0]))
    assert found == (1.5, "bodies 0 and 3 are 9 m apart")
    alone = MutualGravity(np.zeros((1, 3)), np.zeros(1), np.zeros(1))
    assert made.suspected_cause(X[:1], alone) == ""
    assert_allclose(state.gravity.accelerations, pulls(X, MASSES, 2.0, softening))
    assert_allclose(made._direct_sum(X, X[1]), pulls(X, MASSES, 2.0, softening)[1])
    assert made._force_error(X, state.gravity) < 1e-14
    off = state.gravity.accelerations.copy()
    off[3] *= 1.5
    wrong = MutualGravity(off, state.gravity.potentials, state.gravity.rates)
    # 16 of them are looked at, from the first to the last; the last is there once.
    rows = np.linspace(0, 3, 16).astype(int)
    share = (rows == 3).mean()
    assert made._force_error(X, wrong) == pytest.approx(0.5 * np.sqrt(share))
    assert share > 0


def test_who_stops_two_that_are_too_close_says_what_follows_them() -> None:
    """Softened by 5 % more than what 64 parts of a step of 0.02 s go through."""
    made = nbody(X, 0 * X, MASSES, 2.0, 0.0, 0.02, substeps=64)
    stopped = made._encounter_error(0.02, 1.5, X, made.initial_state().gravity.rates)
    (fault,) = stopped.faults
    assert fault.code == "SIM110"
    assert fault.message.startswith("bodies 1 and 2 are 2 m apart at 1.5 s")
    assert "steps of 0.000313 s" in fault.message
    enough = 1.05 * (2 * 5 / (MAX_STEP_PHASE * 64 / 0.02) ** 2) ** (1 / 3)
    assert f"softening: {enough:.3g}," in str(fault.hint)


@pytest.mark.parametrize(
    ("softening", "phase"), [(0.0, MAX_UNSOFTENED_STEP_PHASE), (0.5, MAX_STEP_PHASE)]
)
def test_without_softening_steps_are_finer(softening: float, phase: float) -> None:
    assert (MAX_UNSOFTENED_STEP_PHASE, MAX_STEP_PHASE) == (0.03, 0.15)
    made = nbody(X, 0 * X, MASSES, 2.0, softening, 0.01, substeps=8)
    for turned, parts in ((1.01, 2), (7.9, 8), (8.0, 16), (np.inf, 16), (0.0, 1)):
        rates = np.array([0.0, (turned * phase / 0.01) ** 2])
        assert made._required_substeps(rates, 0.01) == parts


@pytest.mark.parametrize("parts", [1, 4])
def test_within_a_step_a_pair_may_turn_half_as_much_again(
    parts: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """By 1.5 times 0.15 rad in each part of the step."""
    made = nbody(X, 0 * X, MASSES, 2.0, 0.5, 0.01)
    begun, limits = made.initial_state(), []
    turned = np.full(4, (0.9 * parts * 0.15 / 0.01) ** 2)
    state = replace(begun, gravity=replace(begun.gravity, rates=turned))
    system = made._system

    def seen(state: Any, check: Any) -> Any:
        limits.append(check.args[0])
        return system(state, check)

    monkeypatch.setattr(made, "_system", seen)
    after = made.step(state, 0.0, 0.01)
    assert limits == [pytest.approx((1.5 * 0.15 * parts / 0.01) ** 2)]
    assert after.divided == parts


def test_a_step_is_advised_by_the_first_to_fall() -> None:
    """About the centre of mass, no nearer than the softening."""
    made = nbody(X, 0 * X, MASSES, 2.0, 6.0, 0.01)
    state = made.initial_state()
    centre = MASSES @ X / 6.5
    reach = np.maximum(np.linalg.norm(X - centre, axis=1), 6.0)
    assert (reach == 6).any()
    assert (reach > 6).any()
    sizes = np.linalg.norm(pulls(X, MASSES, 2.0, 6.0), axis=1)
    expected = 0.1 * np.sqrt(reach / sizes).min()
    assert made._suggested_step(state, 0.0) == pytest.approx(expected)


def test_what_is_kept_is_told_over_what_there_is() -> None:
    v = np.array([[0.0, 1, 0], [1, 0, 0], [0, 0, 1], [0, 0, 2]])
    made = nbody(X, v, MASSES, 2.0, 0.5, 0.01)
    begin = made.initial_state()
    values = made._report_values(begin, 0.0)
    assert (values["bodies"], values["encounters"], values["substeps"]) == (4, 0, 1)
    assert values["energy_drift"] == values["momentum_drift"] == 0
    faster = replace(begin, motion=np.stack([X, v + np.array([0.5, 0, 0])]))
    values = made._report_values(faster, 0.0)
    fast = np.linalg.norm(v + np.array([0.5, 0, 0]), axis=1)
    usual = MASSES @ fast
    assert values["momentum_drift"] == pytest.approx(0.5 * 6.5 / usual)
    spin = np.cross(X, MASSES[:, None] * [0.5, 0, 0]).sum(axis=0)
    usual = (MASSES * fast) @ np.linalg.norm(X, axis=1)
    found = values["angular_momentum_drift"]
    assert found == pytest.approx(np.linalg.norm(spin) / usual)
    assert "force_error" not in values
    placed = NbodyModel.model_validate(
        {
            "name": "it", "step": 0.01, "bodies": [{"points": "a.npz"}],
            "attractors": [{"mass": 5}],
        }
    )  # fmt: skip
    parts = {
        "bodies": [{"points": X}],
        "attractors": [{"poses": Poses.fixed((9, 9, 9))}],
    }
    outside = build(placed, _Context(parts))
    assert "energy_drift" not in outside._report_values(outside.initial_state(), 0.0)
    # At an attractor without softening nothing is infinite.
    found = outside.external_effect(placed.attractors[0], X[0], X[:1])
    assert np.isfinite(found[0]).all()


def galaxy(**parts: Any) -> GalaxyModel:
    return GalaxyModel.model_validate({"name": "it", "nucleus": 0, "seed": 4, **parts})


def test_integrals_from_outside_are_those_of_trapezoids() -> None:
    r = np.array([1.0, 2, 4, 5])
    found = _integral_to_end(np.array([3.0, 5, 1, 7]), r)
    assert_allclose(found, [4 + 6 + 4, 6 + 4, 4, 0])


@pytest.mark.parametrize("softening", [0.0, 0.7])
def test_pulls_and_speeds_about_a_point_are_keplers(softening: float) -> None:
    """Softened as a sphere of Plummer; radii are tabulated far beyond the mass."""
    disc = {"mass": 1e-9, "radius": 0.5, "cutoff": 6, "count": 9}
    own = MassProfile(galaxy(nucleus=3, disc=disc), 2.0, softening)
    r = own.r
    assert (r[0], r[-1], len(r)) == pytest.approx((5e-5, 12, 4096))
    squares = 2 * 3 * r**2 / (r**2 + softening**2) ** 1.5
    assert_allclose(own.circular_velocities**2, squares, rtol=1e-6)
    assert_allclose(own.accelerations, squares / r, rtol=1e-6)
    if not softening:
        assert_allclose(own.escape_velocities**2, 2 * 2 * 3 / r, rtol=1e-4)
    alone = MassProfile(galaxy(nucleus=3), 2.0, 0.0)
    assert (alone.r[0], alone.r[-1]) == pytest.approx((1e-4, 4))


def test_all_parts_of_a_galaxy_pull() -> None:
    ball = {"mass": 2, "radius": 1, "cutoff": 4, "count": 9}
    parts = {"bulge": ball, "halo": {**ball, "mass": 5}, "disc": {**ball, "mass": 3}}
    own = MassProfile(galaxy(nucleus=1, **parts), 2.0, 0.0)
    at = [
        np.interp(9.0, own.r, each)
        for each in (own.accelerations, own.circular_velocities)
    ]
    assert at[0] == pytest.approx(2 * 11 / 81, rel=1e-4)
    far = own.r[-1]
    disc = float(squared_disc_speeds(own.galaxy.disc, np.array([far]))[0])  # type: ignore[arg-type]
    assert own.circular_velocities[-1] ** 2 == pytest.approx(2 * 8 / far + 2 * disc)
    assert far * disc == pytest.approx(3 / (1 - 5 * np.exp(-4)), rel=0.05)


def test_a_disc_turns_as_freeman_says() -> None:
    """At 2.2 radii most: 0.6² of the mass over the radius (Freeman 1970)."""
    disc = galaxy(disc={"mass": 3, "radius": 0.5, "cutoff": 50, "count": 9}).disc
    assert disc is not None
    r = np.linspace(0.02, 5, 500)
    found = squared_disc_speeds(disc, r)
    assert r[np.argmax(found)] / 0.5 == pytest.approx(2.15, abs=0.03)
    assert found.max() == pytest.approx(0.3874 * 3 / 0.5, rel=2e-3)
    assert squared_disc_speeds(disc, np.array([1e9]))[0] >= 0
    assert surface_density(disc, 0.0) == pytest.approx(3 / (2 * np.pi * 0.25))
    assert surface_density(disc, 0.5) == pytest.approx(3 / (2 * np.pi * 0.25) / np.e)
    cut = galaxy(disc={"mass": 3, "radius": 0.5, "cutoff": 2, "count": 9}).disc
    assert cut is not None
    whole = 1 - 3 * np.exp(-2)
    assert_allclose(
        enclosed_mass(cut, np.array([0.5, 1, 9])), [3 * (1 - 2 / np.e) / whole, 3, 3]
    )


def test_bodies_of_a_disc_are_where_their_numbers_say() -> None:
    """Heights as of sech², at right angles to the y that they turn about."""
    disc = {"mass": 3, "radius": 0.5, "cutoff": 4, "thickness": 0.2, "count": 50}
    own = galaxy(nucleus=2, disc={**disc, "stability": 1.2})
    made = build_galaxy(own, 2.0, 0.1)
    profile = MassProfile(own, 2.0, 0.1)
    u = uniform_samples(4, np.arange(50), 6)
    x = made.points[1:] - made.points[0]
    v = made.velocities[1:] - made.velocities[0]
    assert own.disc is not None
    r = np.interp(u[:, 0] * 3, enclosed_mass(own.disc, profile.r), profile.r)
    angle = 2 * np.pi * u[:, 1]
    assert_allclose(x[:, 0], r * np.sin(angle))
    assert_allclose(x[:, 2], r * np.cos(angle))
    up = 0.2 * 0.5 * np.arctanh(np.clip(2 * u[:, 2] - 1, -0.999, 0.999))
    assert_allclose(x[:, 1], up)
    out, around, upward, mean = (
        np.interp(r, profile.r, one) for one in disc_velocities(own.disc, profile)
    )
    chance = matter.normal_samples(u[:, 3:6])
    radial = (v[:, 0] * np.sin(angle)) + v[:, 2] * np.cos(angle)
    turning = (v[:, 0] * np.cos(angle)) - v[:, 2] * np.sin(angle)
    assert_allclose(radial, out * chance[:, 0], atol=1e-12)
    assert_allclose(turning, mean + around * chance[:, 1])
    assert_allclose(v[:, 1], upward * chance[:, 2], atol=1e-12)
    assert_allclose(made.masses, [2, *[3 / 50] * 50])
    # Hardly bound, its dispersion is a share of what it turns by.
    hot = disc_velocities(own.disc.model_copy(update={"stability": 99.0}), profile)
    dense = profile.r < 1
    assert_allclose(hot[0][dense], 0.7 * profile.circular_velocities[dense])
    cold = disc_velocities(own.disc.model_copy(update={"stability": 0.0}), profile)
    assert not cold[0].any()
    assert not cold[2].any()
    assert_allclose(cold[3], profile.circular_velocities)
    lag = hot[0] ** 2 - hot[1] ** 2 - 2 * profile.r / 0.5 * hot[0] ** 2
    expected = np.sqrt(np.maximum(profile.circular_velocities**2 + lag, 0))
    assert_allclose(hot[3], expected, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("kind", ["bulge", "halo"])
def test_bodies_of_a_spheroid_are_bound_and_drawn_by_their_own_seed(kind: str) -> None:
    part = {"mass": 3, "radius": 0.5, "cutoff": 6, "count": 60}
    own = galaxy(**{kind: part})
    made = build_galaxy(own, 2.0, 0.1)
    profile = MassProfile(own, 2.0, 0.1)
    u = uniform_samples(4 + (1000 if kind == "bulge" else 2000), np.arange(60), 6)
    model = getattr(own, kind)
    r = np.interp(u[:, 0] * 3, enclosed_mass(model, profile.r), profile.r)
    x = r[:, None] * matter.random_directions(u[:, 1:3])
    assert_allclose(made.points, x - x.mean(axis=0), atol=1e-12)
    sigma = np.interp(r, profile.r, profile.velocity_dispersion(model))
    v = sigma[:, None] * matter.normal_samples(u[:, 3:6])
    fast = np.linalg.norm(v, axis=1)
    most = 0.95 * np.interp(r, profile.r, profile.escape_velocities)
    v *= np.minimum(most / fast, 1)[:, None]
    assert_allclose(made.velocities, v - v.mean(axis=0), atol=1e-12)
    assert_allclose(made.masses, 0.05)
    # Beyond the cut-off there is no mass that moves.
    beyond = profile.r > 3.1
    assert not profile.velocity_dispersion(model)[beyond].any()
    assert profile.velocity_dispersion(model)[profile.r < 2.5].min() > 0


def test_galaxies_are_turned_and_put_and_moved() -> None:
    disc = {"mass": 3, "radius": 0.5, "count": 20}
    spec = NbodyModel.model_validate(
        {
            "name": "it", "gravity_constant": 2, "softening": 0.1, "step": 0.01,
            "galaxies": [
                {"name": "a", "disc": disc, "at": [1, 2, 3], "velocity": [4, 5, 6],
                 "rotate": [1, 1, 0, 0]},
                {"name": "b", "nucleus": 7},
            ],
        }
    )  # fmt: skip
    first, second = build_galaxies(spec)
    own = build_galaxy(spec.galaxies[0], 2.0, 0.1)
    turn = so3.exp(np.array([np.pi / 2, 0, 0]))
    assert_allclose(
        first.points, so3.rotate(turn, own.points) + np.array([1, 2, 3]), atol=1e-12
    )
    moved = so3.rotate(turn, own.velocities) + np.array([4, 5, 6])
    assert_allclose(first.velocities, moved, atol=1e-12)
    assert second.masses.tolist() == [7]
    made = build(spec, _Context({}))
    assert made.has_many_species
    assert made.species.tolist() == [0] * 20 + [1]
    assert_array_equal(made.written_indices, np.arange(21))
    assert nbody(X, 0 * X, MASSES, 2.0, 0.5, 0.01).has_many_species is False


@pytest.mark.parametrize(
    ("eccentricity", "separation"), [(0.0, 1.5), (0.5, 2.0), (1.0, 6.0), (3.0, 6.0)]
)
def test_what_stays_on_an_orbit_is_that_of_its_pericentre(
    eccentricity: float, separation: float
) -> None:
    """Energy e - 1 over the pericentre, angular momentum about y turned by the pose."""
    near = 1.5
    orbit = EncounterModel(
        pericentre=near, eccentricity=eccentricity, separation=separation,
        rotate=[1.0, 0, 0, 1],
    )  # fmt: skip
    (x, v), (y, w) = orbit_motions(orbit, [2.0, 3.0], 2.0)
    off, way = y - x, w - v
    mu = 2.0 * 5
    energy = way @ way / 2 - mu / np.linalg.norm(off)
    assert energy == pytest.approx(mu * (eccentricity - 1) / (2 * near), abs=1e-9)
    spin = np.cross(off, way)
    size = np.sqrt(mu * near * (1 + eccentricity))
    # From y a quarter about z is -x.
    assert_allclose(spin, [-size, 0, 0], atol=1e-9)
    assert_allclose(2 * x + 3 * y, 0, atol=1e-9)
    assert off @ way <= 1e-9


@pytest.mark.parametrize(
    ("softening", "why"),
    [(0.0, "attraction is infinite"), (0.5, "they cannot be told apart")],
)
def test_two_at_one_place_are_refused_for_what_they_do(
    softening: float, why: str
) -> None:
    x = np.array([[0.0, 0, 0], [1, 0, 0], [1, 0, 0]])
    with pytest.raises(AnimtoolError, match="bodies 1 and 2 start") as error:
        nbody(x, 0 * x, np.ones(3), 1.0, softening, 0.01)
    (fault,) = error.value.faults
    assert why in str(fault)
    assert fault.hint == "move one of them"


def test_two_may_begin_where_they_are_farthest() -> None:
    """Whatever rounding makes of it: at half a turn from the pericentre."""
    for e in np.linspace(0.05, 0.95, 181):
        far = 0.3 * (1 + e) / (1 - e)
        orbit = EncounterModel(pericentre=0.3, eccentricity=e, separation=far)
        (x, v), (y, w) = orbit_motions(orbit, [2.0, 3.0], 2.0)
        assert np.linalg.norm(y - x) == pytest.approx(far)
        assert (y - x) @ (w - v) == pytest.approx(0, abs=1e-6)
