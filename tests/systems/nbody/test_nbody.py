"""Galaxies that stay, orbits on which two meet, what is refused, and going on."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from adapters.nbody import _Context, nbody
from numpy.testing import assert_allclose, assert_array_equal
from support.faults import raises
from support.simulated import Simulator

from animtool.core.errors import AnimtoolError, ToleranceError
from animtool.scene.systems.simulation import open_systems
from animtool.sim.colliders import Poses
from animtool.systems.framework.matter import PointMasses
from animtool.systems.framework.run import ReachedState, SimulationRun
from animtool.systems.nbody.galaxies import (
    MassProfile,
    build_galaxy,
    disc_velocities,
    enclosed_mass,
    orbit_motions,
)
from animtool.systems.nbody.nbody import MAX_STEP_PHASE, RECOMMENDED_STEP, build
from animtool.systems.nbody.spec import EncounterModel, GalaxyModel, NbodyModel

DISC = {"count": 700, "mass": 1, "radius": 1, "cutoff": 4}
BULGE = {"count": 150, "mass": 0.3, "radius": 0.2}
HALO = {"count": 700, "mass": 4, "radius": 2, "cutoff": 5}
SPIRAL = {"name": "spiral", "disc": DISC, "bulge": BULGE, "halo": HALO, "seed": 4}


@pytest.fixture
def simulator(tmp_path: Path) -> Simulator:
    return Simulator(tmp_path)


def bodies(**keys: Any) -> list[dict[str, Any]]:
    return [{"nbody": {"name": "it", **keys}}]


def opened(simulator: Simulator, **keys: Any) -> SimulationRun:
    (run,) = open_systems(simulator.scene(bodies(**keys)).systems, 10.0)
    assert isinstance(run, SimulationRun)
    return run


@pytest.mark.slow
def test_a_galaxy_stays_as_it_is(simulator: Simulator) -> None:
    """After the disc went around once at its scale length, radii are what they were."""
    run = opened(simulator, galaxies=[SPIRAL], softening=0.1, step=0.05, accuracy=1e-3)
    first = run.at(0.0).points
    last = run.at(6.0).points
    # Bulges of few bodies are warmed by the heavy ones of the halo.
    for part, near in (
        (slice(700), 0.15),
        (slice(700, 850), 0.3),
        (slice(850, 1550), 0.15),
    ):
        before, after = (
            np.median(np.linalg.norm(x[part] - np.median(x, axis=0), axis=1))
            for x in (first, last)
        )
        assert after == pytest.approx(before, rel=near)
    values = run.diagnostics.values
    assert abs(values["energy_drift"]) < 2e-3
    assert values["momentum_drift"] < 1e-3


def test_the_rotation_curve_is_that_of_its_mass() -> None:
    """What bodies are accelerated by towards the centre is the square of the curve."""
    galaxy = GalaxyModel.model_validate(
        {**SPIRAL, "disc": {**DISC, "count": 8000, "stability": 0, "thickness": 0.01}}
        | {"halo": {**HALO, "count": 8000}, "bulge": {**BULGE, "count": 2000}}
    )
    made = build_galaxy(galaxy, 2.0, 0.05)
    profile = MassProfile(galaxy, 2.0, 0.05)
    from animtool import _kernels

    pulls = _kernels.gravity(made.points, made.masses, 2.0, 0.05, 1e-3)[0]
    x, v = made.points[:8000], made.velocities[:8000]
    r = np.hypot(x[:, 0], x[:, 2])
    to_local = -(pulls[:8000] * x)[:, [0, 2]].sum(axis=1) / r
    for low, high in ((0.5, 1), (1, 2), (2, 3)):
        ring = (r > low) & (r < high)
        curve = np.interp(r[ring], profile.r, profile.circular_velocities)
        found = np.sqrt((to_local * r)[ring].mean())
        assert found == pytest.approx(np.sqrt((curve**2).mean()), rel=0.04)
        # Cold, it goes around as the curve has it.
        assert_allclose(np.linalg.norm(v[ring], axis=1), curve, rtol=0.02)
    spin = np.cross(x, v).sum(axis=0)
    assert spin[1] > 100 * np.abs(spin[[0, 2]]).max()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("eccentricity", "separation"), [(0.6, 3.0), (1.0, 4.0), (2.0, 5.0)]
)
def test_two_meet_where_their_orbit_says(
    simulator: Simulator, eccentricity: float, separation: float
) -> None:
    points = [{"name": n, "nucleus": m} for n, m in (("a", 2.0), ("b", 0.5))]
    orbit = {"separation": separation, "pericentre": 1, "eccentricity": eccentricity}
    orbit |= {"at": [1, 2, 3], "rotate": [0.9, 0.1, 0.4, 0]}
    run = opened(simulator, galaxies=points, encounter=orbit, softening=0, step=0.005)
    times = np.arange(0, 6, 0.02)
    frames = np.array([run.at(t).points for t in times])
    apart = np.linalg.norm(frames[:, 0] - frames[:, 1], axis=1)
    assert apart[0] == pytest.approx(separation)
    assert apart.min() == pytest.approx(1.0, abs=2e-3)
    assert 0 < np.argmin(apart) < len(times) - 1
    middle = (2.0 * frames[:, 0] + 0.5 * frames[:, 1]) / 2.5
    assert_allclose(middle, np.broadcast_to([1, 2, 3], middle.shape), atol=1e-9)


def test_gone_on_from_the_middle_it_is_the_same(simulator: Simulator) -> None:
    whole = opened(
        simulator, galaxies=[{"name": "a", "bulge": {**BULGE, "count": 1300}}]
    )
    whole.at(0.1)
    middle = whole.state
    assert isinstance(middle, ReachedState)
    end = whole.at(0.2)
    again = SimulationRun("it", whole.simulation, 0.0, whole.step_length, middle)
    assert_array_equal(again.at(0.2).points, end.points)


def test_rates_below_0_of_a_state_divide_no_step(simulator: Simulator) -> None:
    """A file may hold any; a step begins whole, and is divided where two come close."""
    whole = opened(simulator, galaxies=[{"name": "a", "bulge": {**BULGE, "count": 9}}])
    whole.at(0.1)
    middle = whole.state
    end = whole.at(0.2)
    pulls = replace(middle.state.gravity, rates=-middle.state.gravity.rates)
    spoiled = replace(middle, state=replace(middle.state, gravity=pulls))
    again = SimulationRun("it", whole.simulation, 0.0, whole.step_length, spoiled)
    assert_array_equal(again.at(0.2).points, end.points)


def test_halos_need_not_show_and_colours_follow(simulator: Simulator) -> None:
    dark = {**SPIRAL, "shows_halo": False}
    for by in ("speed", "density", "energy", "acceleration", "species"):
        run = opened(
            simulator,
            galaxies=[dark, {**SPIRAL, "name": "other", "at": [9, 0, 0]}],
            colour={"by": by},
        )
        frame = run.at(0.0)
        assert len(frame.points) == 850 + 1550
        assert frame.ids[849:851].tolist() == [849, 1550]
        assert frame.primvars["species"].tolist() == [0] * 850 + [1] * 1550
        colours = frame.primvars["displayColor"]
        assert colours.shape == (2400, 3)
        assert len(np.unique(colours, axis=0)) > (1 if by == "species" else 500)
        assert ((colours >= 0) & (colours <= 1)).all()


TWO = np.array([[0.0, 0, 0], [1, 0, 0]])


@pytest.mark.parametrize(
    ("keys", "text"),
    [
        ({}, "it has no bodies"),
        ({"galaxies": [{"name": "void"}]}, "galaxy 'void' has no bodies"),
        (
            {"bodies": [{"points": np.ones((2, 3))}]},
            "bodies 0 and 1 start at the same position",
        ),
        ({"bodies": [{"points": TWO[:, :2]}]}, r"points have shape \(2, 2\)"),
        (
            {"bodies": [{"points": TWO, "velocities": TWO[:1]}]},
            r"velocities have shape \(1, 3\)",
        ),
        (
            {"galaxies": [SPIRAL], "encounter": {"separation": 3, "pericentre": 1}},
            "needs two galaxies",
        ),
        (
            {
                "galaxies": [SPIRAL, SPIRAL],
                "encounter": {"separation": 9, "pericentre": 1, "eccentricity": 0.5},
            },
            r"nbody\.encounter\.separation: .* 9 m.* 3 m",
        ),
        (
            {
                "galaxies": [SPIRAL, SPIRAL],
                "encounter": {"separation": 1, "pericentre": 7},
            },
            r"nbody\.encounter\.separation: .* 1 m.* 7 m",
        ),
        ({"galaxies": [SPIRAL], "colour": {"by": "taste"}}, "unknown quantity"),
        (
            {"galaxies": [{**SPIRAL, "rotate": [0, 0, 0, 0]}]},
            "rotate is a zero quaternion, which has no rotation",
        ),
    ],
)
def test_what_makes_no_sense_is_refused(
    simulator: Simulator, keys: dict[str, Any], text: str
) -> None:
    with pytest.raises(AnimtoolError, match=text) as error:
        opened(simulator, **keys)
    assert error.value.code in ("SIM070", "SIM020")


def test_a_file_may_hold_no_bodies(simulator: Simulator) -> None:
    run = opened(simulator, bodies=[{"points": TWO}, {"points": np.zeros((0, 3))}])
    assert_array_equal(run.at(0.0).points, TWO)


def test_bodies_are_drawn_with_the_radii_that_they_are_given(
    simulator: Simulator,
) -> None:
    """2 cm without one, of files and of galaxies."""
    points = [
        {"name": n, "nucleus": 1, "at": [9, y, 0]} for n, y in (("a", 0), ("b", 5))
    ]
    given = [{"points": TWO}, {"points": TWO + 3, "radius": 0.3}]
    points[0]["radius"] = 0.7
    run = opened(simulator, bodies=given, galaxies=points)
    assert_allclose(run.at(0.0).radii, [0.02, 0.02, 0.3, 0.3, 0.7, 0.02])


@pytest.mark.parametrize(
    ("mass", "text"),
    [(0, "0 is not above 0"), (-1, "-1 is not above 0"), (1e-320, "is below 1e-36")],
)
def test_numbers_that_nothing_divides_by_are_refused(
    simulator: Simulator, mass: float, text: str
) -> None:
    with raises(AnimtoolError, "DOC022", match=text):
        opened(simulator, bodies=[{"points": TWO, "mass": mass}])


def test_a_step_that_is_too_long_stops_with_one_that_is_not(
    simulator: Simulator,
) -> None:
    x = np.random.default_rng(1).normal(size=(40, 3))
    keys = {"bodies": [{"points": x}], "softening": 0.4}
    keys |= {"attractors": [{"mass": 900, "softening": 0.02}]}
    with pytest.raises(ToleranceError) as error:
        simulator.simulate(bodies(**keys, step=0.1), [0, 3])
    fault = error.value.faults[-1]
    assert fault.code == "SIM102"
    assert "its energy changed to" in fault.message
    assert fault.hint is not None
    step = float(fault.hint.split("step: ")[1])
    assert 1e-4 < step < 0.1


def test_a_galaxy_is_where_its_centre_of_mass_is() -> None:
    """A nucleus as heavy as all the rest is half of it, however few bodies it is."""
    galaxy = GalaxyModel.model_validate(
        {
            "name": "it",
            "nucleus": 3,
            "disc": {**DISC, "mass": 3, "count": 40},
            "seed": 1,
        }
    )
    made = build_galaxy(galaxy, 2.0, 0.05)
    assert made.masses[0] == pytest.approx(made.masses[1:].sum())
    for each in (made.points, made.velocities):
        assert_allclose(made.masses @ each, 0, atol=1e-12)
        assert_allclose(each[0], -each[1:].mean(axis=0), atol=1e-12)
        assert np.abs(each[0]).max() > 1e-3


def profile_of(softening: float = 0.0, **parts: Any) -> MassProfile:
    galaxy = GalaxyModel.model_validate({"name": "it", "nucleus": 0, **parts})
    return MassProfile(galaxy, 2.0, softening)


def test_spheroids_have_the_mass_and_the_dispersion_of_their_profile() -> None:
    """Plummer: G M / (6 √(r² + a²)) is the square of its dispersion (1911).

    Hernquist: of its mass a quarter is within a.
    """
    plummer = {
        "mass": 3,
        "radius": 0.5,
        "cutoff": 100,
        "profile": "plummer",
        "count": 9,
    }
    own = profile_of(halo=plummer)
    r = np.array([0.1, 0.5, 1.0, 2.0])
    found = np.interp(r, own.r, own.velocity_dispersion(own.galaxy.halo))
    assert_allclose(found**2, 2 * 3 / (6 * np.sqrt(r**2 + 0.25)), rtol=0.01)
    # Its potential is that of a point, seen over a softening of a.
    escape = np.interp(r, own.r, own.escape_velocities)
    assert_allclose(escape**2, 2 * 2 * 3 / np.sqrt(r**2 + 0.25), rtol=0.01)
    hernquist = {
        "mass": 3,
        "radius": 0.5,
        "cutoff": 100,
        "profile": "hernquist",
        "count": 9,
    }
    own = profile_of(halo=hernquist)
    found = enclosed_mass(own.galaxy.halo, np.array([0.5, 1.5, 1e9]))
    whole = (100 / 101) ** 2  # of an endless one that is within the cut-off
    assert_allclose(found, [0.75 / whole, 1.6875 / whole, 3.0])


def test_a_light_disc_about_a_point_swings_as_planets_do() -> None:
    """Kepler: it goes out and in as often as around, with half the spread around."""
    light = {"mass": 1e-6, "radius": 1, "cutoff": 5, "thickness": 0.1, "count": 10}
    own = profile_of(nucleus=3.0, disc=light | {"stability": 1.5})
    disc = own.galaxy.disc
    radial, around, upward, mean = disc_velocities(disc, own)
    r = np.array([0.5, 1.0, 2.0])
    rows = [np.interp(r, own.r, each) for each in (radial, around, upward, mean)]
    surface = 1e-6 / (2 * np.pi) * np.exp(-r) / (1 - 6 * np.exp(-5))
    assert_allclose(rows[0], 1.5 * 3.36 * 2 * surface / np.sqrt(6 / r**3), rtol=1e-3)
    assert_allclose(rows[1], rows[0] / 2, rtol=1e-3)
    assert_allclose(rows[2], np.sqrt(np.pi * 2 * surface * 0.1), rtol=1e-3)
    assert_allclose(rows[3], np.sqrt(6 / r), rtol=1e-3)


def test_two_of_unequal_mass_meet_about_their_centre_of_mass() -> None:
    """Parabolas of 3 and 1: the light one is three times as far, and as fast."""
    orbit = EncounterModel(
        pericentre=0.5, eccentricity=1.0, separation=4.0, at=[1.0, 2.0, 3.0]
    )
    (x, v), (y, w) = orbit_motions(orbit, [3.0, 1.0], 2.0)
    at = np.array([1.0, 2.0, 3.0])
    assert_allclose(3 * (x - at) + (y - at), 0, atol=1e-12)
    assert_allclose(3 * v + w, 0, atol=1e-12)
    assert np.linalg.norm(y - x) == pytest.approx(4.0)
    # Without energy, with the angular momentum of its pericentre, and coming in.
    assert (w - v) @ (w - v) == pytest.approx(2 * 2 * 4 / 4.0)
    turning = np.linalg.norm(np.cross(y - x, w - v))
    assert turning == pytest.approx(np.sqrt(2 * 2 * 4 * 0.5))
    assert (y - x) @ (w - v) < 0


@pytest.mark.parametrize(
    ("kind", "mass"), [("disc", 3.0), ("bulge", 0.25), ("halo", 7.0)]
)
def test_as_much_is_within_radii_as_the_profile_says(kind: str, mass: float) -> None:
    """Shares of the mass within each body's radius are even from 0 to 1."""
    part = {"count": 4000, "mass": mass, "radius": 0.8, "cutoff": 4}
    galaxy = GalaxyModel.model_validate({"name": "it", kind: part, "seed": 2})
    made = build_galaxy(galaxy, 2.0, 0.0)
    x = made.points - made.points.mean(axis=0)
    r = np.linalg.norm(x[:, [0, 2]] if kind == "disc" else x, axis=1)
    shares = np.sort(enclosed_mass(getattr(galaxy, kind), r)) / mass
    # Kolmogorov and Smirnov: in one of a thousand samples it is more.
    assert np.abs(shares - (np.arange(4000) + 0.5) / 4000).max() < 1.95 / np.sqrt(4000)
    assert made.masses.sum() == pytest.approx(mass)


def test_a_step_is_advised_by_how_soon_a_body_would_reach_the_centre() -> None:
    """Of two bodies d³/(G M) is the square of that time, however unequal they are."""
    x = np.array([[1.0, 2, 3], [1, 6, 3]])
    made = nbody(
        x, np.array([[9.0, 0, 0], [0, 0, -2]]), np.array([3.0, 1.0]), 2.0, 0.0, 0.01
    )
    assert made._potential(made.initial_state(), 0.0) == pytest.approx(-2 * 3 * 1 / 4)
    expected = RECOMMENDED_STEP * np.sqrt(4.0**3 / (2 * 4.0))
    assert made._suggested_step(made.initial_state(), 0.0) == pytest.approx(expected)


@pytest.mark.parametrize(
    ("phase", "parts"), [(0.0, 1), (0.99, 1), (1.5, 2), (4.0, 4), (4.1, 8), (64.5, 128)]
)
def test_a_step_is_parted_until_the_closest_pair_turns_little(
    phase: float, parts: int
) -> None:
    """A power of two; what is beyond the most parts is told by twice as many."""
    x = np.array([[0.0, 0, 0], [4, 0, 0]])
    made = nbody(x, 0 * x, np.ones(2), 2.0, 0.1, 0.01, substeps=64)
    rates = np.array([0.0, (phase * MAX_STEP_PHASE / 0.02) ** 2])
    assert made._required_substeps(rates, 0.02) == parts
    assert made._required_substeps(rates[:0], 0.02) == 1
    # A method that finds its steps by itself parts none.
    adaptive = nbody(x, 0 * x, np.ones(2), 2.0, 0.1, 0.01, method="rk45")
    assert adaptive._required_substeps(rates, 0.02) == 1


def test_a_step_that_ends_where_two_are_close_is_done_again_in_parts() -> None:
    """Far apart as it begins; in the end ω² is G M / r³, of which it takes four."""
    x = np.array([[1.0, 0.1, 0], [-1, -0.1, 0]])
    v = np.array([[-10.0, 0, 0], [10, 0, 0]])
    made = nbody(x, v, np.array([0.015, 0.005]), 1.0, 0.0, 0.1)
    state = made.initial_state()
    assert made._required_substeps(state.gravity.rates, 0.1) == 1
    after = made.step(state, 0.0, 0.1)
    assert (after.encounters, after.divided) == (1, 4)
    assert np.linalg.norm(np.subtract(*after.motion[0])) == pytest.approx(0.2, rel=0.01)
    again = made.step(after, 0.1, 1e-4)
    assert (again.encounters, again.divided) == (1, 4)


def test_what_attracts_from_outside_counts_in_energies_and_accelerations() -> None:
    """Of two bodies and a mass of 5 at (3, 0, 0), softened by 4 and by nothing."""
    spec = NbodyModel.model_validate(
        {
            "name": "it", "gravity_constant": 2, "softening": 0, "step": 0.01,
            "bodies": [{"points": "a.npz#x", "mass": 2}],
            "attractors": [{"mass": 5, "softening": 4, "at": [3, 0, 0]}],
        }
    )  # fmt: skip
    x, v = np.array([[0.0, 0, 0], [0, 0, 8]]), np.array([[1.0, 2, 0], [0, 1, 3]])
    parts = {
        "bodies": [{"points": x, "velocities": v}],
        "attractors": [{"poses": Poses.fixed((3.0, 0.0, 0.0))}],
    }
    made = build(spec, _Context(parts))
    state = made.initial_state()
    found = made._quantities(state, 0.0)
    far = np.array([5.0, np.sqrt(9 + 64 + 16)])
    potentials = -2 * 2 / 8 - 2 * 5 / far
    assert_allclose(found["energy"](), np.array([2.5, 5.0]) + potentials)
    pull = (2 * 5 / far**3)[:, None] * ([3.0, 0, 0] - x)
    pull += 2 * 2 / 8**2 * np.array([[0.0, 0, 1], [0, 0, -1]])
    assert_allclose(found["acceleration"](), np.linalg.norm(pull, axis=1))
    # Of the pair one half is each body's; what is outside acts on masses.
    expected = -2 * 2 * 2 / 8 - 2 * (2 * 5 / far).sum()
    assert made._potential(state, 0.0) == pytest.approx(expected)
    momenta = [[2, 6, 6], [-16, 0, 0]]
    assert_allclose(made._momenta(state), momenta)


@pytest.mark.parametrize(
    ("accuracy", "count", "tree"),
    [(2e-4, 1000, False), (2e-4, 1001, True), (2e-2, 159, True), (2e-2, 158, False)],
)
def test_a_tree_is_for_as_many_bodies_as_an_accuracy_asks(
    accuracy: float, count: int, tree: bool
) -> None:
    """A thousand at 2e-4; a hundredfold error with a 0.4th power of it as many."""
    x = np.random.default_rng(1).normal(size=(count, 3))
    made = nbody(x, 0 * x, np.ones(count), 1.0, 0.1, 0.01, accuracy=accuracy)
    assert made.uses_tree is tree


@pytest.mark.parametrize(("accuracy", "tree"), [(1e-6, True), (0.99e-6, False)])
def test_finer_than_single_precision_is_summed_directly(
    accuracy: float, tree: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("animtool.systems.nbody.nbody.TREE_MIN_BODIES", 1.0)
    x = np.random.default_rng(1).normal(size=(50, 3))
    made = nbody(x, 0 * x, np.ones(50), 1.0, 0.1, 0.01, accuracy=accuracy)
    assert made.uses_tree is tree


def test_one_body_beyond_numbers_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    """As of a galaxy that is so far away that its place is none."""
    spec = NbodyModel.model_validate(
        {
            "name": "it", "step": 0.01, "bodies": [{"points": "a.npz"}],
            "galaxies": [{"name": "far", "nucleus": 1}],
        }
    )  # fmt: skip
    context = _Context({"bodies": [{"points": TWO}]})
    far = PointMasses(np.array([[np.inf, 0, 0]]), np.zeros((1, 3)), np.ones(1))
    monkeypatch.setattr("animtool.systems.nbody.nbody.build_galaxies", lambda _: [far])
    with pytest.raises(AnimtoolError, match="numbers overflow") as error:
        build(spec, context)
    assert error.value.faults[0].code == "SIM070"


def test_a_pair_that_is_too_close_at_once_is_named_with_its_distance(
    simulator: Simulator,
) -> None:
    points = np.array([[0.0, 0, 0], [9.0, 9, 9], [0.003, 0.004, 0]])
    np.savez(simulator.folder / "near.npz", points=points)
    own = {"points": str(simulator.folder / "near.npz"), "mass": 1.0}
    run = opened(
        simulator, bodies=[own], gravity_constant=1.0, softening=1e-6, step=0.1,
        substeps=1,
    )  # fmt: skip
    with raises(ToleranceError, "SIM110", match="bodies 0 and 2 are 0.005 m apart at"):
        run.at(0.1)
