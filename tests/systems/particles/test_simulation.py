"""Steps of particles in numbers: ids, room, ends of lives, what is said."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose
from support.faults import raises

from animtool.core.errors import OptionError, Severity
from animtool.sim import IntegrateOptions
from animtool.sim.colliders import Box, Collider, Plane, Poses, Sphere
from animtool.systems.particles import (
    Emitter,
    KillRegion,
    ParticleRun,
    Particles,
    VelocityField,
    find_force,
)
from animtool.systems.particles.simulation import ParticleSimulation

DOWN = find_force("gravity")()


def simulation(*emitters: Emitter, **keys: Any) -> ParticleSimulation:
    keys.setdefault("options", IntegrateOptions("midpoint", step=0.25))
    return ParticleSimulation(Particles(list(emitters), **keys), 0.0)


def test_ids_are_in_the_order_of_births_of_all_emitters() -> None:
    early = Emitter(rate=4.0, mass=2.0, charge=0.5, radius=0.3)
    late = Emitter(bursts=[(0.1, 2), (0.2, 1)], mass=3.0, lifetime=9.0)
    own = simulation(early, late)
    state = own.step(own.initial_state(), 0.0, 0.25).state
    made = state.particles
    assert made.ids.tolist() == [0, 1, 2, 3]
    assert_allclose(made.births, [0.1, 0.1, 0.125, 0.2])
    assert made.masses.tolist() == [3, 3, 2, 3]
    assert made.charges.tolist() == [0, 0, 0.5, 0]
    assert made.radii.tolist() == [0.005, 0.005, 0.3, 0.005]
    assert_allclose(made.deaths, [9.1, 9.1, np.inf, 9.2])
    later = own.step(state, 0.25, 0.25).state.particles
    assert later.ids.tolist() == [0, 1, 2, 3, 4]
    assert (later.births[4], state.born) == (0.375, 4)


@pytest.mark.parametrize(
    ("most", "living", "missed", "said"),
    [(4, 4, 0, []), (3, 3, 1, ["SIM121"]), (1, 1, 3, ["SIM121"])],
)
def test_who_has_no_room_is_counted_and_told_once(
    most: int, living: int, missed: int, said: list[str]
) -> None:
    own = simulation(
        Emitter(rate=4.0), Emitter(bursts=[(0.1, 2), (0.2, 1)]), max_particles=most,
        name="sparks",
    )  # fmt: skip
    stepped = own.step(own.initial_state(), 0.0, 0.25)
    assert (len(stepped.state.particles), stepped.state.missed) == (living, missed)
    assert stepped.state.born == 4
    assert [notice.code for notice in stepped.notices] == said
    for notice in stepped.notices:
        assert notice.severity is Severity.WARNING
        assert f"the limit of {most} particles" in notice.message
        assert notice.where == "sparks"
    again = own.step(stepped.state, 0.25, 0.25)
    assert again.state.missed == missed + (len(again.state.particles) == living)
    assert [n.code for n in again.notices] == (["SIM121"] if most == 4 else [])


def test_lives_end_at_the_end_of_the_step_that_they_last_to() -> None:
    """A life of a quarter of a second is over at a quarter, a longer one is not."""
    for life, left in ((0.25, 0), (0.2501, 2), (0.1, 0)):
        own = simulation(Emitter(bursts=[(0.0, 2)], lifetime=life))
        state = own.initial_state()
        assert len(state.particles) == 2
        assert len(own.step(state, 0.0, 0.25).state.particles) == left
        assert own.step(state, 0.0, 0.25).state.born == 2


def test_who_is_in_a_region_goes_and_who_is_at_its_bound_stays() -> None:
    ball = KillRegion(Collider(Sphere(1.0), Poses.fixed((0, -2, 0))))
    emitters = [
        Emitter(poses=Poses.fixed((x, -2.0, 0)), bursts=[(0.0, 1)], speed=0)
        for x in (0.0, 0.999, 1.0, 1.5)
    ]
    own = simulation(*emitters, kills=[ball])
    left = own.step(own.initial_state(), 0.0, 0.25).state
    assert left.particles.ids.tolist() == [2, 3]
    assert left.state[0, :, 0].tolist() == [1.0, 1.5]


def test_who_cannot_be_moved_out_is_named_with_what_holds_it() -> None:
    """The second of two, between two floors that look at each other."""
    plates = [
        Collider(Plane(), Poses.fixed((0, -99, 0)), name="deep"),
        Collider(Plane((0, 1, 0)), Poses.fixed((0, 0.01, 0))),
        Collider(Plane((0, -1, 0)), Poses.fixed((0, -0.01, 0)), name="lid"),
    ]
    emitter = Emitter(bursts=[(0.0, 1)], radius=0.1)
    own = simulation(emitter, colliders=plates, name="dust")
    found = own.step(own.initial_state(), 0.0, 0.25)
    (notice,) = found.notices
    assert (notice.code, notice.where) == ("SIM123", "dust")
    assert notice.message.startswith("particle 0 is inside ")
    held = own.contacts
    assert held is not None
    name = ["'deep'", "'colliders[1]'", "'lid'"][int(held.colliders[0])]
    assert f"{name} at 0.25 s" in notice.message


def test_energy_is_told_where_nothing_takes_or_brings_any() -> None:
    burst = Emitter(bursts=[(0.0, 2)], speed=3.0, mass=2.0)
    floor = Collider(Plane(), Poses.fixed((0, -9, 0)))
    drag = find_force("drag")(linear=1.0)
    still = find_force("drag")()
    field = {"velocity": VelocityField("1")}
    for keys, kinetic in (
        ({"forces": [DOWN]}, 18.0),
        ({"forces": [DOWN, still]}, 18.0),
        ({"forces": [DOWN, drag]}, None),
        ({"forces": [DOWN], "colliders": [floor]}, None),
        (field, None),
    ):
        own = simulation(burst, **keys)
        energy = own.diagnostics(own.initial_state(), 0.0).energy
        assert (None if energy is None else energy.kinetic) == kinetic
    nobody = simulation(Emitter(rate=1.0)).diagnostics(own.initial_state(), 0.0)
    assert [fault.code for fault in nobody.notices_if_empty] == ["SIM188"]


@pytest.mark.parametrize(
    ("shape", "container", "words"),
    [
        (Box((4, 4, 4)), False, "write container: true"),
        (Plane(offset=2.0), False, "lower its offset"),
        (Box((4, 4, 4)), True, None),
        (Plane(offset=-2.0), False, None),
    ],
)
def test_kill_regions_around_the_emitters(
    shape: Any, container: bool, words: str | None
) -> None:
    kill = KillRegion(Collider(shape, container=container))
    own = simulation(Emitter(rate=1.0), kills=[kill])
    (notice,) = own.diagnostics(own.initial_state(), 9.0).notices_if_empty
    assert (notice.code, notice.where) == ("SIM188", words and "kill[0]")
    assert words is None or words in str(notice.hint)


def test_steps_are_judged_again_where_motions_are_faster_by_a_twentieth(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    asked: list[float] = []

    def notices(_: Any, __: Any, ___: Any, times: Any, ____: Any) -> list[Any]:
        asked.append(float(times[0]))
        return []

    monkeypatch.setattr("animtool.systems.particles.simulation.step_warnings", notices)
    own = simulation(Emitter(bursts=[(0.0, 1)], mass=2.0), forces=[DOWN])

    class System:
        state = np.zeros((2, 1, 3))

        def __init__(self, *rows: tuple[float, float]) -> None:
            self.rows = np.array(rows)

        def frequencies(self, _: float, __: Any) -> Any:
            return self.rows

    for t, rows in enumerate(
        [[(2.0, 1.0)], [(2.09, 1.0)], [(2.11, 1.0)], [(2.0, 1.0)], [(2.0, 1.1)],
         [(2.0, 1.1), (1.0, 0.0)]]
    ):  # fmt: skip
        own._check_step_length(System(*rows), float(t), t + 1.0)  # type: ignore[arg-type]
    assert asked == [0, 2, 3, 4, 5]
    assert not own._divergence_check.has_long_steps


def test_the_largest_step_that_is_stable_is_of_the_fastest_motion() -> None:
    """2 / ω of a spring of 18 N/m and 2 kg, by a method that has a limit."""
    spring = find_force("spring")(anchor=(0, 0, 0), k=18.0)
    options = IntegrateOptions("velocity_verlet", step=0.01)
    own = simulation(
        Emitter(bursts=[(0.0, 1)], mass=2.0, speed=1.0),
        forces=[spring],
        options=options,
    )
    told = own.diagnostics(own.initial_state(), 0.0).stable_step
    assert told is not None
    assert told() == pytest.approx(2 / 3, rel=1e-6)
    empty = simulation(Emitter(rate=1.0), forces=[spring], options=options)
    assert empty._stable_step(empty.initial_state()) is None


def test_what_a_field_takes_along_has_its_speed_from_the_first_frame_on() -> None:
    field = VelocityField("2", "x", "0")
    place = Poses.fixed((3.0, 0, 0))
    run = ParticleRun(
        Particles([Emitter(bursts=[(0.0, 1)], poses=place)], velocity=field)
    )
    assert run.at(0.0).velocities.tolist() == [[2, 3, 0]]
    frame = run.at(0.5)
    assert_allclose(frame.points, [[4, 1.75, 0]])
    assert_allclose(frame.velocities, [[2, 4, 0]])
    assert (frame.time, frame.ages.tolist()) == (0.5, [0.5])


@pytest.mark.parametrize(
    ("keys", "wheres"),
    [
        ({"options": IntegrateOptions("midpoint")}, ["step", "step"]),
        ({"max_particles": 0}, ["max_particles"]),
        ({"max_particles": 1}, []),
        ({"emitters": []}, ["emitters"]),
        ({"forces": [DOWN], "velocity": VelocityField("1")}, ["velocity"]),
        ({"forces": [DOWN, find_force("drag")(linear=-1)]}, ["drag[1]"]),
        ({"velocity": VelocityField("vx")}, ["velocity"]),
        ({"colliders": [Collider(Sphere(1)), Collider(Sphere(-1))]}, ["colliders[1]"]),
        ({"kills": [KillRegion(Collider(Sphere(-1)))]}, ["kills[0]"]),
    ],
)
def test_faults_say_where_they_are(keys: Any, wheres: list[str]) -> None:
    setup = Particles(**{"emitters": [Emitter(rate=1)], **keys})
    found = setup._option_faults() + setup._part_faults()
    assert [str(fault.where).partition(".")[0] for fault in found] == wheres


def test_who_is_born_into_what_is_no_number_is_told_at_once() -> None:
    field = find_force("field")(x="1 / (t - t)")
    own = simulation(Emitter(rate=4.0), forces=[field])
    with np.errstate(all="ignore"), raises(OptionError, "SIM003"):
        own.step(own.initial_state(), 0.0, 0.25)


def test_a_burst_with_exchanged_columns() -> None:
    own = simulation(Emitter(bursts=[(4.0, 0)]))
    (notice,) = own.diagnostics(own.initial_state(), 9.0).notices_if_empty
    assert (notice.code, notice.where) == ("SIM188", "emitters[0].bursts[0]")
    assert "write [0, 4]" in str(notice.hint)
