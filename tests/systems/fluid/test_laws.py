"""Numbers of a fluid's step: pulls, energies, drains, nozzles, its surface."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from animtool import _kernels
from animtool.core.errors import Fault, OptionError, Severity
from animtool.sim.colliders import Collider, Colliders, Plane, Poses, Sphere
from animtool.systems.fluid.fluid import Fluid, FluidState, PressureResult, build
from animtool.systems.fluid.spec import FluidModel
from animtool.systems.fluid.substeps import Substeps
from animtool.systems.fluid.surface import build_surface, density_field
from animtool.systems.framework.simulation import StoppedError
from animtool.systems.particles import find_force

X = np.array([[0.0, 1, 0], [3, 2, 0], [0, 5, 7]])
V = np.array([[1.0, 2, 2], [0, 0, 0], [4, 0, 3]])
MASS = 800 * 0.5**3
DOWN = find_force("gravity")(acceleration=(0.0, -8.0, 0.0))
SWINGS = Poses([0, 1], [[0, 0, 0], [0, 3, 0]], [[0, 0, 0, 1]] * 2)


class _Context:
    begin = 1.0

    def __init__(self, parts: dict[str, Any], colliders: Any) -> None:
        self.entry_data, self.colliders = parts, Colliders(list(colliders))


def fluid(
    x: Any = X, v: Any = V, *, forces: Any = (), colliders: Any = (), drains: Any = (),
    **keys: Any,
) -> Fluid:  # fmt: skip
    """Return particles of a file, half a metre apart and of 800 kg/m³."""
    given = {"fills": [{"points": "a.npz"}], "spacing": 0.5, "density": 800}
    spec = FluidModel.model_validate({"name": "it", **given, **keys})
    parts = {
        "fills": [{"points": np.array(x), "velocities": np.array(v)}],
        "forces": list(forces), "drains": list(drains),
        "emitters": [{"poses": Poses.fixed((20.0, 0, 0))}] * len(spec.emitters),
    }  # fmt: skip
    return build(spec, _Context(parts, colliders))  # type: ignore[arg-type]


def test_it_begins_with_the_energy_that_forces_give_it() -> None:
    """Kinetic and potential, and that of its surface; pulls are over the mass."""
    push = find_force("uniform")(push=(MASS, 0.0, 0))
    own = fluid(forces=[DOWN, push], tension=0.3)
    state = own.initial_state()
    assert state.ids.tolist() == [0, 1, 2]
    assert state.births.tolist() == [1, 1, 1]
    assert (state.made, state.held) == (3, 0)
    assert_allclose(own._accelerations(state, 0.0), [[1, -8, 0]] * 3)
    kinetic = MASS * (9 + 25) / 2
    area = _kernels.fluid_area(X, 0.5)
    total, found, known = own._energy(state)
    assert (found, known) == (pytest.approx(kinetic), True)
    assert total == pytest.approx(kinetic + MASS * (8 * 8 - 3) + 0.3 * area)
    assert state.energy == total
    wind = find_force("wind")(velocity=(1, 0, 0), drag=2.0)
    total, _, known = fluid(forces=[wind, DOWN])._energy(state)
    assert (total, known) == (pytest.approx(kinetic + MASS * 64), False)
    stokes = find_force("viscosity")(viscosity=0.1)
    found = fluid(forces=[stokes])._accelerations(state, 0.0)
    # Each has a radius of half the spacing.
    assert_allclose(found, -6 * np.pi * 0.1 * 0.25 * V / MASS)
    assert own.incompatibility(state, 0.0) == ""
    assert own.incompatibility(replace(state, sound=0.0), 0.0) == ""
    assert own.incompatibility(replace(state, sound=-1e-9), 0.0)


@pytest.mark.parametrize(
    ("keys", "closed"),
    [
        ({}, True),
        ({"colliders": [Collider(Plane((0, 1, 0), -9))]}, True),
        ({"colliders": [Collider(Plane((0, 1, 0), -9), SWINGS)]}, False),
        ({"forces": [find_force("wind")()]}, False),
    ],
)
def test_energy_out_of_nothing_is_a_gain(keys: Any, closed: bool) -> None:
    """Beyond a twentieth of what is in play: of motion, of heights, of pressure."""
    own = fluid(**keys)
    state = replace(own.initial_state(), energy=1000.0, sound=2.0)
    kinetic = own._energy(state)[1]
    spring = MASS * 3 * 4 * 0.01
    # Of the kinetic energy, which is more than there was before.
    for gain, gains in ((0.051, True), (0.049, False)):
        before = kinetic - gain * (kinetic + spring)
        assert own._has_energy_gain(replace(state, energy=before)) is (gains and closed)
    if closed and not keys:
        high = fluid(v=0 * V, forces=[DOWN])
        begin = replace(high.initial_state(), sound=2.0)
        total = high._energy(begin)[0]
        for lack, gains in ((0.06, True), (0.02, False)):
            # It hangs: of nothing but pressure.
            low = replace(begin, energy=total - lack * spring)
            assert high._has_energy_gain(low) is gains
        assert high.diagnostics(begin, 0.0).energy is not None
    energy = own.diagnostics(state, 0.0).energy
    assert (energy is not None) is closed


def test_a_step_that_gains_energy_is_said_to_be_too_long(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    own, told = fluid(), []

    def stop(*given: Any) -> None:
        told.append(given[1:5])

    monkeypatch.setattr(own, "_stop_for_long_step", stop)
    state = replace(own.initial_state(), energy=7.0)
    for gains in (False, True):
        monkeypatch.setattr(own, "_has_energy_gain", lambda _, gains=gains: gains)
        own._solve_pressure(state, 1.0, 0.001, np.zeros((3, 3)))
        assert len(told) == gains
    t, dt, message, shorter = told[0]
    assert (t, dt, shorter) == (1.0, 0.001, 1.0)
    assert message.startswith("its energy changed to")
    assert message.endswith(", from 7 J")


def test_what_drains_take_away_took_its_energy() -> None:
    floor = Collider(Plane(), Poses.fixed((0, 1.5, 0)))
    own = fluid(forces=[DOWN], drains=[floor, Collider(Sphere(1.0, (0, 5, 7)))])
    state = replace(own.initial_state(), pressures=np.array([5.0, 6, 7]))
    left = own._remove_drained(state, 0.0)
    assert left.ids.tolist() == [1]
    assert_array_equal(left.motion, np.stack([X[1:2], V[1:2]]))
    assert left.pressures.tolist() == [6]
    assert left.energy == pytest.approx(MASS * 16)
    assert left.made == 3
    at_bound = fluid(drains=[Collider(Plane(), Poses.fixed((0, 1.0, 0)))])
    assert at_bound._remove_drained(state, 0.0) is state


TAP = {"size": [0.5, 0.5], "speed": 2.0}


def test_what_comes_in_brings_its_energy_and_is_numbered_on() -> None:
    own = fluid(forces=[DOWN], emitters=[TAP], max_particles=4)
    state, notices = replace(own.initial_state(), made=7, held=2), list[Fault]()
    pull = np.tile([0.0, -8, 0], (3, 1))
    # A layer every quarter of a second; the one at 1.2 s is the second.
    fed = own._add_inflow(state, 1.0, 1.2, pull, notices)
    assert fed.ids.tolist() == [0, 1, 2, 7]
    assert (fed.made, fed.held, notices) == (8, 2, [])
    assert fed.births.tolist() == [1, 1, 1, 1]
    assert_allclose(fed.motion[:, 3], [[20, 0.4 - 4 * 0.04, 0], [0, 2 - 1.6, 0]])
    gained = MASS * (0.4**2 / 2 + 8 * (0.4 - 0.16))
    assert fed.energy - state.energy == pytest.approx(gained)
    full = own._add_inflow(fed, 1.2, 1.5, pull, notices)
    # That of 1.25 s.
    assert (full.made, full.held) == (8, 3)
    assert [notice.code for notice in notices] == ["SIM121"]
    assert "the limit of 4 particles is reached at 1.5 s" in notices[0].message
    walled = fluid(
        emitters=[TAP], colliders=[Collider(Sphere(1.0), Poses.fixed((20, 0, 0)))]
    )
    notices = []
    held = walled._add_inflow(state, 1.0, 1.2, pull, notices)
    assert (held.made, held.held, len(held.ids)) == (7, 3, 3)
    assert [notice.code for notice in notices] == ["SIM138"]
    assert notices[0].message.startswith("1 particle could not be emitted until 1.2 s")
    assert held.energy == state.energy


def pressed(own: Fluid, monkeypatch: pytest.MonkeyPatch, dense: float) -> Any:
    """Return the end of a step whose kernel says how dense it is."""
    state = own.initial_state()
    made = PressureResult(state.motion, state.pressures, dense, ())
    monkeypatch.setattr(own, "_run_kernel", lambda *_: made)
    notices: list[Fault] = []
    after, _ = own._solve_pressure(state, 0.0, 0.01, np.zeros((3, 3)), notices)
    return after, notices


@pytest.mark.parametrize(
    ("allowed", "dense", "code"),
    [
        (0.01, 0.01, None),
        (0.01, 0.0101, "SIM137"),
        (0.01, 0.1, "SIM137"),
        (0.01, 0.101, "SIM108"),
        (0.05, 0.25, "SIM137"),
        (0.05, 0.251, "SIM108"),
    ],
)
def test_what_is_denser_than_asked_for_is_told_and_collapses_in_the_end(
    monkeypatch: pytest.MonkeyPatch, allowed: float, dense: float, code: str | None
) -> None:
    """Beyond a tenth, and beyond five times what is allowed."""
    own = fluid(compression=allowed)
    if code == "SIM108":
        with pytest.raises(StoppedError, match=r"collapsed at 0\.01 s") as error:
            pressed(own, monkeypatch, dense)
        assert error.value.faults[-1].code == code
        return
    after, notices = pressed(own, monkeypatch, dense)
    assert [notice.code for notice in notices] == ([code] if code else [])
    assert after.compression == after.max_compression == dense
    begin = replace(own.initial_state(), max_compression=0.5)
    later, _ = own._solve_pressure(begin, 0.0, 0.01, np.zeros((3, 3)), notices)
    assert (later.max_compression, later.compression) == (0.5, dense)


def test_a_step_that_takes_too_many_parts_is_told_with_one_that_does_not(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The first that goes on of those 2, 4, 8 and 16 times shorter than must be."""
    own = fluid()
    asked: list[float] = []

    def goes(_: Any, __: float, step: float) -> bool:
        asked.append(step)
        return len(asked) == 3

    monkeypatch.setattr(own, "_is_stable_step", goes)
    state = own.initial_state()
    assert own._find_stable_step(state, 0.0, 0.96, 3.0) == asked[2]
    assert_allclose(asked, [0.16, 0.08, 0.04], rtol=0.05)
    asked.clear()
    with pytest.raises(StoppedError) as error:
        own._stop_for_long_step(state, 2.0, 0.96, "why", 3.0, [])
    (fault,) = error.value.faults
    assert (fault.code, fault.severity) == ("SIM102", Severity.ERROR)
    assert "blew up at 2.96 s: why" in fault.message
    assert str(fault.hint).startswith("step: 0.04, or use weaker")
    for shorter, notices in ((1000.0, []), (3.0, None)):
        asked.clear()
        with pytest.raises(StoppedError) as error:
            own._stop_for_long_step(state, 2.0, 0.96, "why", shorter, notices)
        assert (asked, str(error.value.faults[0].hint)[:10]) == ([], "use weaker")
    fast = replace(state, motion=np.stack([X, V * 1e6]))
    with pytest.raises(StoppedError, match="more than 4096 substeps"):
        own._solve_pressure(fast, 0.0, 0.01, np.zeros((3, 3)), None)


def test_sheets_are_looked_at_before_they_moved_half_a_spacing() -> None:
    own = Substeps(FluidModel.model_validate({"name": "it", "spacing": 0.1}))
    for fastest, parts, dt, pieces in (
        (30.0, 99, 0.01, 6),
        (30.0, 4, 0.01, 4),
        (300.0, 99, 0.01, 32),
        (0.1, 99, 0.01, 1),
        (0.1, 99, 0.1, 2),
    ):
        around = SimpleNamespace(
            sheets=[1], surfaces=SimpleNamespace(max_speed=fastest)
        )
        assert own.collision_substeps(around, parts, dt) == pieces  # type: ignore[arg-type]
    assert own.collision_substeps(Colliders([]), 9, 1.0) == 1


def state_of(own: Fluid) -> FluidState:
    return replace(
        own.initial_state(), pressures=np.array([5.0, 9, 7]), substep_count=3
    )


def test_what_is_told_and_shown_of_a_state() -> None:
    keys = {"primvars": ["age", "speed", "pressure"]}
    colour = {"by": "speed", "range": [0, 6], "ramp": [[0, 0, 0], [1, 1, 1]]}
    own = fluid(forces=[DOWN], colour=colour, **keys)
    values = own.diagnostics(state_of(own), 1.5).values
    assert values["particles"] == 3
    assert (values["pressure"], values["speed"], values["parts"]) == (9, 5, 3)
    assert "held_back" not in values
    held = own.diagnostics(replace(state_of(own), held=2), 1.5).values
    assert held["held_back"] == 2
    energy = own.diagnostics(state_of(own), 1.5).energy
    assert energy is not None
    assert (energy.kinetic, energy.potential) == pytest.approx((MASS * 17, MASS * 64))
    frame = own.frame(state_of(own), 1.5)
    assert frame.primvars["age"].tolist() == [0.5] * 3
    assert frame.primvars["speed"].tolist() == [3, 0, 5]
    assert frame.primvars["pressure"].tolist() == [5, 9, 7]
    assert_allclose(frame.primvars["displayColor"][:, 0], [0.5, 0, 5 / 6])
    assert frame.radii.tolist() == [0.25] * 3


def test_the_field_of_a_surface_is_that_of_wendland() -> None:
    """(1 - q)⁴ (4 q + 1) over its integral; 1 within a lattice, whatever the cells."""
    low, cell, radius, spacing = np.array([-1.0, -2, -1.5]), 0.25, 0.6, 0.3
    at = np.array([[0.1, -0.3, 0.2]])
    found = density_field(at, low, (9, 14, 12), cell, radius, spacing)
    grid = np.stack(
        np.meshgrid(*(np.arange(n) for n in (9, 14, 12)), indexing="ij"), -1
    )
    q = np.minimum(np.linalg.norm(grid * cell + low - at[0], axis=-1) / radius, 1)
    expected = 0.125 * (1 - q) ** 4 * (4 * q + 1) * 21 / (2 * np.pi)
    assert_allclose(found, expected, atol=1e-12)
    assert (expected > 0).sum() > 20
    axis = np.arange(-6, 7) * 0.3
    whole = np.stack(np.meshgrid(axis, axis, axis), -1).reshape(-1, 3)
    middle = density_field(whole, np.full(3, -2.5), (26, 26, 26), 0.2, 0.9, 0.3)
    assert_allclose(middle[11:15, 11:15, 11:15], 1, atol=0.01)


def surface(x: Any, v: Any, **keys: Any) -> Any:
    own = FluidModel.model_validate({"name": "it", "spacing": 0.5, "surface": keys})
    x = np.array(x, float).reshape(-1, 3)
    ages = {"age": np.arange(len(x)) + 1.0}
    return build_surface(own, x, np.array(v, float).reshape(-1, 3), ages)


def test_the_surface_of_two_is_about_each_and_goes_with_it() -> None:
    pytest.importorskip("skimage", reason="surfaces are made by scikit-image")
    mesh = surface([[0, 0, 0], [5, 1, 0]], [[1, 2, 3], [4, 5, 6]], smoothing=0.6)
    right = mesh.points[:, 0] > 2.5
    for which, at, v, age in (
        (~right, [0, 0, 0], [1, 2, 3], 1), (right, [5, 1, 0], [4, 5, 6], 2),
    ):  # fmt: skip
        off = mesh.points[which] - at
        # Where (1 - q)⁴ (4 q + 1) by the share of 0.5 in 0.8 m falls to 0.35.
        far = np.linalg.norm(off, axis=1)
        q = far.mean() / 0.8
        share = (0.5 / 0.8) ** 3 * 21 / (2 * np.pi) * (1 - q) ** 4 * (4 * q + 1)
        assert share == pytest.approx(0.35, abs=0.06)
        assert np.ptp(far) < 0.12
        assert np.abs(off.mean(axis=0)).max() < 0.08
        assert_array_equal(mesh.velocities[which], [v] * which.sum())
        assert_array_equal(mesh.primvars["age"][which], [age] * which.sum())
    assert (mesh.counts == 3).all()
    a, b, c = mesh.points[mesh.indices.reshape(-1, 3)].swapaxes(0, 1)
    assert np.einsum("ij,ij->i", a, np.cross(b, c)).sum() > 0


def test_a_surface_of_nobody_and_of_too_much_space() -> None:
    pytest.importorskip("skimage", reason="surfaces are made by scikit-image")
    for none in (surface([], []), surface([0, 0, 0], [0, 0, 0], smoothing=1.5)):
        assert (len(none.points), len(none.indices)) == (0, 0)
        assert len(none.primvars["age"]) == 0
    far = [[0, 0, 0], [9, 0, 0]]
    # Cells of 0.5 m over 0.8 m and two cells on each side, and the last corner.
    sides = np.ceil((np.array([9, 0, 0]) + 2 * (0.8 + 1)) / 0.5) + 1
    count = int(np.prod(sides))
    keys = {"cell": 0.5, "smoothing": 0.6}
    surface(far, far, max_cells=count, **keys)
    with pytest.raises(OptionError, match=r"cells of 0\.5 m") as error:
        surface(far, far, max_cells=count - 1, **keys)
    assert error.value.code == "SIM064"


def test_density_is_that_of_where_particles_are() -> None:
    """Over that at rest; of one alone it is its own share."""
    near = np.array([[0.0, 0, 0], [0.3, 0, 0], [9, 9, 9]])
    own = fluid(near, 5 * V, primvars=["density"])
    found = own.frame(own.initial_state(), 1.0).primvars["density"]
    arrays = Colliders([]).kernel_arrays(1.0, 1.0)
    assert_allclose(found, _kernels.fluid_densities(arrays, near, 0.5))
    assert found[0] == pytest.approx(found[1])
    assert 0 < found[2] < found[0]


def test_a_pull_beyond_numbers_asks_for_no_sound_at_first() -> None:
    own = Substeps(FluidModel.model_validate({"name": "it", "spacing": 0.1}))
    pull = np.full((3, 3), -1e308)
    with np.errstate(over="ignore", invalid="ignore"):
        assert own.initial_sound_speed(1e308 * np.sign(X - 2), pull) == 0


@pytest.mark.parametrize(("room", "tries"), [(2, 2), (1.9, 1), (4, 3), (3.9, 2)])
def test_parts_are_doubled_as_far_as_the_most_that_there_may_be(
    monkeypatch: pytest.MonkeyPatch, room: float, tries: int
) -> None:
    own = fluid()
    state = own.initial_state()
    asked: list[int] = []

    def steps(*given: Any) -> PressureResult:
        asked.append(given[-1])
        return PressureResult(
            state.motion, state.pressures, 0.08 * 0.5 ** len(asked), ()
        )

    monkeypatch.setattr(own, "_run_kernel", steps)
    still = np.zeros((3, 3))
    own._solve_pressure(state, 0.0, 0.01, still, [])
    first = asked[0]
    asked.clear()
    own._substeps.max_substeps = room * first  # type: ignore[assignment]
    own._solve_pressure(state, 0.0, 0.01, still, [])
    assert asked == [first * 2**k for k in range(tries)]


def test_pressure_begins_as_fast_as_the_depth_of_the_fluid_asks_for() -> None:
    """Of heights from 1 to 5 m under 8 m/s²: 1 % of 1.1 times the head."""
    begin = fluid(forces=[DOWN]).initial_state()
    assert begin.sound == pytest.approx(np.sqrt(32 * 1.1 / 0.01))
