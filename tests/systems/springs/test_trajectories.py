"""Springs through time: solvers, steps, going on, what is said and refused."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from support.suite import examples

from animtool.core.array_types import FloatArray
from animtool.core.errors import OptionError, Severity
from animtool.sim import Checkpoint, IntegrateOptions, Status, integrate
from animtool.systems.springs import (
    Air,
    Body,
    Family,
    Pins,
    PointTargets,
    Solver,
    SpringOptions,
    SpringSystem,
    join,
    rope,
    sheet,
    simulate_springs,
)
from animtool.systems.springs.solvers import MIN_STEP

SOLVERS = [solver for solver in Solver if solver is not Solver.AUTO]
FRAMES = np.arange(13) / 24


def flag(columns: int = 6, **options: object) -> SpringSystem:
    """Return a small sheet that is held at two corners."""
    body = sheet(
        columns, columns, mass=0.01, structural=Family(300.0, ratio=0.05),
        diagonals=Family(100.0, ratio=0.05), bend=Family(10.0),
    )  # fmt: skip
    options = {"pins": Pins([0, columns - 1]), "drag": 0.2, **options}
    return SpringSystem(body, **options)


def waved() -> SpringSystem:
    """Return one with all there is: moved pins, wind in gusts, targets that move."""
    times = np.arange(13) / 24
    path = np.zeros((13, 2, 3))
    path[:, 1, 0] = 1.0
    path[:, :, 2] = np.sin(9 * times)[:, None]
    aims = np.zeros((13, 1, 3))
    aims[:, 0] = [0.5, 0.5, 0.2]
    aims[:, 0, 0] += times
    return flag(
        pins=Pins([0, 5], path, times),
        targets=PointTargets([14], aims, 5.0, 0.1, times),
        air=Air([[0, 3.0, 0], [2.0, 0, 0]], times=[0, 0.3]),
    )


def exact(system: SpringSystem, times: FloatArray) -> FloatArray:
    options = IntegrateOptions("dop853", tolerance=1e-11, absolute=1e-11)
    return integrate(system, times, options).positions


@pytest.mark.parametrize("solver", SOLVERS)
def test_the_error_goes_with_the_step(solver: Solver) -> None:
    system, times = flag(4), np.array([0.0, 0.1, 0.15])
    true = exact(system, times)
    errors = []
    for step in (1 / 2400, 1 / 4800, 1 / 9600):
        options = SpringOptions(solver, step=step, stretch=np.inf)
        found = simulate_springs(system, times, options)
        errors.append(np.abs(found.positions - true).max())
    order = np.log2(errors[1] / errors[2])
    assert order == pytest.approx(2 if solver is Solver.BDF2 else 1, abs=0.35)


@pytest.mark.parametrize("solver", Solver)
def test_times_between_steps_are_on_the_way(solver: Solver) -> None:
    options = SpringOptions(solver)
    times = np.arange(13) * 1001 / 24000
    found = simulate_springs(waved(), times, options)
    fine = simulate_springs(waved(), np.arange(62) / 120, options)
    between = [np.interp(times, fine.times, fine.positions[:, n, 2]) for n in (8, 30)]
    assert_allclose(found.positions[:, [8, 30], 2].T, between, atol=2e-3)


@pytest.mark.parametrize("solver", Solver)
@pytest.mark.parametrize("rate", [24.0, 24000 / 1001, 25.0])
def test_a_motion_in_parts_is_the_whole(solver: Solver, rate: float) -> None:
    times, options = np.arange(13) / rate, SpringOptions(solver)
    whole = simulate_springs(waved(), times, options)
    first = simulate_springs(waved(), times[:6], options)
    rest = simulate_springs(waved(), times[5:], options, first.checkpoint)
    again = simulate_springs(waved(), times, options)
    assert whole.states.tobytes() == again.states.tobytes()
    parts = np.concatenate([first.states, rest.states[1:]])
    assert whole.states.tobytes() == parts.tobytes()
    assert whole.checkpoint.state.tobytes() == rest.checkpoint.state.tobytes()


def test_a_state_alone_begins_again() -> None:
    system = flag()
    first = simulate_springs(system, FRAMES[:6])
    shifted = first.checkpoint.state.copy()
    shifted[0] += [1, 0, 0]
    begun = Checkpoint(first.checkpoint.time, shifted)
    found = simulate_springs(system, FRAMES[5:], checkpoint=begun)
    assert found.states[0].tobytes() == shifted.tobytes()


def test_a_spike_is_split() -> None:
    spike = np.concatenate([FRAMES[:3], FRAMES[9:]])
    whole = simulate_springs(flag(), FRAMES).states
    found = simulate_springs(flag(), spike).states
    assert found.tobytes() == np.concatenate([whole[:3], whole[9:]]).tobytes()


@settings(max_examples=examples(10))
@given(st.integers(0, 2**31))
def test_the_order_of_springs_changes_nothing(seed: int) -> None:
    system = flag(4)
    springs = system.body.springs
    mixed = np.random.default_rng(seed).permutation(len(springs.rest))
    body = replace(system.body, springs=springs.select(mixed))
    other = SpringSystem(body, pins=Pins([0, 3]), drag=0.2)
    for solver in SOLVERS:
        found, there = (
            simulate_springs(each, [0, 0.1], SpringOptions(solver))
            for each in (system, other)
        )
        assert found.states.tobytes() == there.states.tobytes()


@pytest.mark.parametrize("step", [None, 1 / 24])
@pytest.mark.parametrize("solver", [Solver.AUTO, Solver.XPBD, Solver.BDF2])
def test_a_stiff_rope_with_a_heavy_tip_does_not_stretch(
    solver: Solver, step: float | None
) -> None:
    line = rope([0, 0, 0], [0.9, 0, 0], 10, Family(1e6, 2.0), mass=0.01, tip_mass=10.0)
    system = SpringSystem(line, pins=Pins([0]), resistance=0.005)
    motion = simulate_springs(
        system, np.arange(49) / 24, SpringOptions(solver, step=step)
    )
    assert motion.stats.status is Status.OK
    lengths = np.linalg.norm(np.diff(motion.positions, axis=1), axis=2)
    assert lengths.max() < 0.1 * 1.0101
    assert not motion.notices


def test_auto_says_what_it_took_and_why() -> None:
    soft = simulate_springs(flag(), [0, 0.1])
    assert soft.solver is Solver.SYMPLECTIC_EULER
    assert "steps per second" in soft.reason
    family = Family(1e8)
    stiff = SpringSystem(
        sheet(20, 20, mass=1e-4, structural=family, diagonals=family), pins=Pins([0])
    )
    assert simulate_springs(stiff, [0, 1 / 240]).solver is Solver.BDF2
    near = simulate_springs(stiff, [0, 1 / 240], SpringOptions(error=1e-3))
    assert near.solver is Solver.BDF2
    long = simulate_springs(flag(), [0, 0.1], SpringOptions(step=0.1))
    assert long.solver is Solver.SYMPLECTIC_EULER
    assert long.step < 0.1


def test_an_error_is_kept() -> None:
    system, times = flag(4), np.array([0.0, 0.1, 0.2])
    motion = simulate_springs(system, times, SpringOptions(error=1e-4))
    assert motion.stats.error is not None
    assert motion.stats.error <= 1e-4
    assert np.abs(motion.positions - exact(system, times)).max() <= 2e-4


def test_an_error_that_cannot_be_kept_is_said() -> None:
    options = SpringOptions("implicit_euler", error=1e-12, step=1 / 240)
    motion = simulate_springs(flag(3), [0, 0.05], options)
    (notice,) = motion.notices
    assert notice.code == "SIM142"
    assert notice.message.endswith("but the limit is 0.001 nm")


def test_a_step_too_long_is_pointed_out_and_stopped() -> None:
    options = SpringOptions("symplectic_euler", step=1 / 24)
    motion = simulate_springs(flag(), np.arange(200) / 24, options)
    assert motion.stats.status is Status.UNSTABLE
    assert [notice.code for notice in motion.notices] == ["SIM101", "SIM102"]
    stable = motion.stats.stable_step
    assert stable is not None
    steady = simulate_springs(
        flag(), np.arange(200) / 24, SpringOptions("symplectic_euler", step=stable)
    )
    assert steady.stats.status is Status.OK
    assert not steady.notices


def test_springs_tear() -> None:
    line = rope(
        [0, 0, 0], [0, 0, -1], 3, Family(1e3, 1.0, tear=0.02), mass=0.1, tip_mass=5.0
    )
    for solver in SOLVERS:
        system = SpringSystem(line, pins=Pins([0]))
        motion = simulate_springs(system, [0, 0.25, 0.5], SpringOptions(solver))
        assert motion.torn.any()
        fell = motion.positions[-1, 2, 2] - motion.positions[1, 2, 2]
        assert fell < -0.25 * 9.81 * 0.25
        rest = simulate_springs(
            system, [0.5, 0.6], SpringOptions(solver), motion.checkpoint
        )
        assert (rest.torn >= motion.torn).all()


def test_torn_springs_are_those_of_the_body() -> None:
    lines = [
        rope([x, 0, 0], [x, 0, -1], 2, Family(1e3, tear=tear), mass=9.0)
        for x, tear in ((0, np.inf), (1, 0.01), (2, np.inf))
    ]
    body = join(lines[::-1])
    shuffled = replace(body, springs=body.springs.select([2, 0, 1]))
    system = SpringSystem(shuffled, pins=Pins([0, 2, 4]))
    motion = simulate_springs(system, [0, 0.5])
    assert motion.torn.tolist() == [False, False, True]


def test_limits_that_nothing_reaches_tear_nothing() -> None:
    """Far from the origin, where the other particles are light."""
    lines = [
        rope([100, y, 0], [100, y, -1], 4, Family(1e3, tear=0.05), mass=mass)
        for y, mass in ((0, 0.01), (1, 90.0))
    ]
    system = SpringSystem(join(lines), pins=Pins([0, 4]))
    motion = simulate_springs(system, [0, 0.25])
    assert not motion.torn[:3].any()
    assert motion.torn[3:].any()


def test_targets_draw_particles_home() -> None:
    home = np.array([[0.0, 0, 0], [0.1, 0, 0], [0.2, 0, 0]])
    line = rope(home[0], home[2], 3, Family(1e3, 0.5), mass=0.01)
    for solver in Solver:
        system = SpringSystem(line, targets=PointTargets([0, 1, 2], home, 50.0, 0.5))
        motion = simulate_springs(system, [0, 3], SpringOptions(solver))
        sag = 0.01 * 9.81 / 50
        assert_allclose(motion.positions[-1], home - [0, 0, sag], atol=1e-5)


@pytest.mark.parametrize("solver", SOLVERS)
def test_pins_go_along_their_path(solver: Solver) -> None:
    motion = simulate_springs(waved(), FRAMES, SpringOptions(solver))
    assert_allclose(motion.positions[:, 0, 2], np.sin(9 * FRAMES), rtol=0, atol=1e-12)


@pytest.mark.parametrize("solver", SOLVERS)
def test_springs_between_pins_are_passed_over(solver: Solver) -> None:
    line = rope([0, 0, 0], [1, 0, 0], 3, Family(1e3), mass=0.1)
    system = SpringSystem(line, pins=Pins([0, 1, 2], 2 * line.positions))
    motion = simulate_springs(system, [0, 0.1], SpringOptions(solver))
    assert np.isfinite(motion.states).all()
    assert motion.stretch <= 1e-12


@pytest.mark.parametrize("solver", SOLVERS)
def test_a_sheet_at_one_point_is_said_and_stays_finite(solver: Solver) -> None:
    body = sheet(4, 4, mass=0.01, structural=Family(100.0))
    at_one = Body(np.zeros((16, 3)), body.masses, body.springs, body.triangles)
    runs = [
        simulate_springs(SpringSystem(at_one, pins=Pins([0])), FRAMES,
                         SpringOptions(solver))
        for _ in range(2)
    ]  # fmt: skip
    assert np.isfinite(runs[0].states).all()
    assert runs[0].states.tobytes() == runs[1].states.tobytes()
    assert "SIM140" in [notice.code for notice in runs[0].notices]
    assert "every spring" in runs[0].notices[0].message


def test_a_stretch_that_cannot_be_kept_is_said() -> None:
    line = rope([0, 0, 0], [1, 0, 0], 60, Family(1e12), mass=1e-4, tip_mass=1.0)
    system = SpringSystem(line, pins=Pins([0]))
    motion = simulate_springs(system, [0, 1], SpringOptions("xpbd"))
    assert [notice.code for notice in motion.notices] == ["SIM131"]
    assert motion.step == MIN_STEP


def test_small_strains_are_written_with_their_digits() -> None:
    """A limit of 0.01% is not 0.0%, and strains of springs are percentages."""
    line = rope([0, 0, 0], [0.8, 0, 0], 15, Family(1e7), mass=0.02, tip_mass=50)
    system = SpringSystem(line, pins=Pins([0]))
    options = SpringOptions("xpbd", step=0.01, stretch=1e-4)
    (notice,) = simulate_springs(system, [0, 0.3], options).notices
    assert notice.code == "SIM131"
    assert notice.message.endswith("the limit is 0.01%")
    assert "strained by 0.0%" not in notice.message
    soft = sheet(12, 12, mass=1e-3, structural=Family(20.0, ratio=0.05))
    hung = SpringSystem(soft, pins=Pins([0, 11]), drag=1.0)
    (notice,) = simulate_springs(hung, [0, 1], SpringOptions("xpbd")).notices
    assert notice.code == "SIM161"
    assert notice.message.startswith("springs stretch by 2% or more, mostly")


def test_the_damping_of_a_soft_spring_asks_for_no_more_steps() -> None:
    family = Family(20.0, ratio=0.05)
    body = sheet(12, 12, mass=1e-3, structural=family, diagonals=family)
    system = SpringSystem(body, pins=Pins([0, 11]))
    motion = simulate_springs(system, [0, 1], SpringOptions("xpbd"))
    assert motion.stretch <= 0.01
    assert motion.step > 8 * MIN_STEP
    assert [notice.code for notice in motion.notices] == ["SIM161"]
    assert motion.notices[0].severity is Severity.NOTE


@pytest.mark.parametrize(
    ("options", "code"),
    [
        (SpringOptions("verlet"), "SIM001"),
        (SpringOptions(step=0.0), "SIM004"),
        (SpringOptions(stretch=-1.0), "SIM004"),
        (SpringOptions(error=np.inf), "SIM004"),
        (SpringOptions(longest=1.0), "SIM004"),
    ],
)
def test_options_are_in_their_ranges(options: SpringOptions, code: str) -> None:
    with pytest.raises(OptionError) as error:
        simulate_springs(flag(), [0, 1], options)
    assert error.value.code == code


def test_times_and_starts_are_checked() -> None:
    for times in ([1, 0], [0, np.nan], []):
        with pytest.raises(OptionError) as error:
            simulate_springs(flag(), times)
        assert error.value.code == "SIM002"
    for state in (np.zeros((2, 3, 3)), np.full((2, 36, 3), np.nan)):
        with pytest.raises(OptionError) as error:
            simulate_springs(flag(), [0, 1], checkpoint=Checkpoint(0.0, state))
        assert error.value.code == "SIM003"


def test_what_is_torn_off_may_fall_as_far_as_it_likes() -> None:
    line = rope(
        [0, 0, 0], [0, 0, -0.1], 2, Family(1e3, 1.0, tear=0.02), mass=0.1, tip_mass=5.0
    )
    system = SpringSystem(line, pins=Pins([0]))
    motion = simulate_springs(system, np.linspace(0, 3, 31))
    assert motion.torn.all()
    assert motion.stats.status is Status.OK
    assert motion.positions[-1, 1, 2] < -40


@pytest.mark.parametrize(("stiffness", "said"), [(1e3, ["SIM187"]), (1e6, [])])
def test_springs_that_double_in_length_are_named(
    stiffness: float, said: list[str]
) -> None:
    family = Family(stiffness, damping=2.0)
    line = rope([0, 0, 0], [0.9, 0, 0], 10, family, mass=0.01, tip_mass=10.0)
    system = SpringSystem(line, pins=Pins([0]))
    for options in (None, SpringOptions(error=1.0)):
        motion = simulate_springs(system, np.arange(25) / 24, options)
        assert [notice.code for notice in motion.notices] == said
        lengths = np.linalg.norm(np.diff(motion.positions, axis=1), axis=2)
        percent = f"{100 * float(f'{lengths.max() / 0.1 - 1:.2g}'):.0f}%"
        assert all(percent in notice.message for notice in motion.notices)
