# ruff: noqa: ARG001, ARG002, ARG005 - methods of systems share signatures
"""Integrating: times, statistics, what stops it, going on, and what is refused."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.faults import raises
from support.motions import logistic, oscillator, pendulum
from support.suite import examples

from animtool.core.array_types import FloatArray
from animtool.core.errors import OptionError, Severity
from animtool.sim import (
    INTEGRATORS,
    Energy,
    ForceSystem,
    IntegrateOptions,
    RateSystem,
    SecondOrder,
    Status,
    find_integrator,
    integrate,
)
from animtool.sim.integrators.integrator import StepControl
from animtool.sim.system import NativeAdvance

OURS = [
    name
    for name in INTEGRATORS
    if find_integrator(name).control is not StepControl.SCIPY
]


def options_for(name: str, **more: float) -> IntegrateOptions:
    if find_integrator(name).control is StepControl.FIXED:
        return IntegrateOptions(name, step=1 / 96, **more)
    return IntegrateOptions(name, tolerance=1e-8, **more)


@pytest.mark.parametrize("name", INTEGRATORS)
def test_values_stand_at_the_times_asked_for(name: str) -> None:
    motion = pendulum(1.0)
    times = [0.0, 0.1, 1 / 3, 0.7, 2.0]
    found = integrate(motion.system, times, options_for(name))
    assert found.times.tolist() == times
    assert found.states.shape == (5, 2, 1, 1)
    assert found.states[0].tobytes() == motion.system.state.tobytes()
    wanted = np.array([motion.state(t) for t in times])
    near = 0.05 if find_integrator(name).order == 1 else 1e-3
    np.testing.assert_allclose(found.states, wanted, atol=near)
    assert found.positions.shape == found.velocities.shape == (5, 1, 1)
    assert found.energies is not None
    assert found.energies.shape == (5,)


@pytest.mark.parametrize("name", INTEGRATORS)
def test_statistics(name: str) -> None:
    found = integrate(pendulum(1.0).system, [0, 1, 2], options_for(name, estimate=True))
    stats, integrator = found.stats, find_integrator(name)
    assert (stats.status, stats.time, stats.reason) == (Status.OK, 2.0, "")
    assert stats.steps >= 2
    assert stats.evaluations >= stats.steps
    assert 0 < stats.smallest <= stats.largest <= 2
    assert stats.error is not None
    assert 0 < stats.error < 0.1
    assert (stats.local_error is None) == (integrator.error_order == 0)
    assert (stats.rejected is None) == (integrator.control is StepControl.SCIPY)
    if integrator.control is StepControl.FIXED:
        assert (stats.steps, stats.rejected) == (192, 0)
        assert stats.largest == 1 / 96
    assert found.notices == () or name in {"euler", "modified_euler"}


@pytest.mark.slow
@settings(max_examples=examples(6))
@given(parts=st.lists(st.integers(1, 12), min_size=2, max_size=5))
def test_a_motion_in_parts_is_the_whole_bit_for_bit(parts: list[int]) -> None:
    system = ForceSystem(
        lambda t, x, v: np.sin(3 * t) - 9 * x - 0.2 * v,
        [[1.0]],
        velocity_dependent=True,
    )
    times = np.arange(sum(parts) + 1) / 24
    for name in OURS:
        options = options_for(name)
        whole = integrate(system, times, options)
        checkpoint, at, states = None, 0, [whole.states[0]]
        for part in parts:
            found = integrate(system, times[at : at + part + 1], options, checkpoint)
            checkpoint, at = found.checkpoint, at + part
            states += list(found.states[1:])
        assert np.array(states).tobytes() == whole.states.tobytes(), name


def test_the_rate_of_output_does_not_change_the_motion() -> None:
    system = oscillator(6.0, 0.1).system
    options = IntegrateOptions("symplectic_euler", step=1 / 480)
    film = integrate(system, np.arange(25) / 24, options)
    fast = integrate(system, np.arange(61) / 60, options)
    assert film.states[-1].tobytes() == fast.states[-1].tobytes()
    assert film.states[12].tobytes() == fast.states[30].tobytes()


def test_steps_divide_gaps_that_they_do_not_fit() -> None:
    options = IntegrateOptions("rk4", step=0.1)
    found = integrate(oscillator().system, [0, 0.25, 1.0], options)
    assert found.stats.steps == 3 + 8
    assert found.stats.largest < 0.1


def test_one_time_is_the_start() -> None:
    found = integrate(oscillator().system, [3.0])
    assert found.states.shape == (1, 2, 1, 1)
    assert found.stats.steps == 0
    assert found.stats.smallest == 0


def test_fixed_particles_keep_their_velocity() -> None:
    held = np.array([True, False, True])
    pulled = ForceSystem(
        lambda _t, x, _v: np.full_like(x, -9.81),
        np.zeros((3, 1)),
        [[0.0], [0.0], [2.0]],
        fixed=held,
        jacobians=lambda _t, x, _v: (np.eye(x.size), np.eye(x.size)),
    )
    for name in INTEGRATORS:
        found = integrate(pulled, [0, 0.5], options_for(name))
        np.testing.assert_allclose(found.positions[-1, [0, 2], 0], [0.0, 1.0])
        assert found.positions[-1, 1, 0] < -1


def test_explicit_euler_warns_before_and_stops_when_it_blows_up() -> None:
    spring = oscillator(100.0, 0.1).system
    options = IntegrateOptions("euler", step=1 / 24)
    found = integrate(spring, np.arange(100) / 24, options)
    assert found.stats.status is Status.UNSTABLE
    assert found.stats.stable_step == pytest.approx(2 * 0.1 / 100)
    before, after = found.notices
    assert (before.code, after.code) == ("SIM101", "SIM102")
    assert "0.002" in (before.hint or "")
    assert "0.002" in (after.hint or "")
    assert "energy" in after.message
    assert before.severity is after.severity is Severity.WARNING
    assert np.isfinite(found.states).all()
    assert len(found.times) < 100
    assert found.stats.time < 3


@pytest.mark.parametrize(("step", "codes"), [(24.0, ["SIM109"]), (0.9, []), (2.5, [])])
def test_a_step_that_is_a_rate(step: float, codes: list[str]) -> None:
    free = ForceSystem(lambda _t, x, _v: -x, [[1.0]])
    times = np.arange(1 + 72) / 24
    found = integrate(free, times, IntegrateOptions("rk4", step=step))
    assert [notice.code for notice in found.notices] == codes


def test_a_step_that_is_a_rate_hides_no_instability() -> None:
    spring = oscillator(100.0, 0.1).system
    found = integrate(spring, np.arange(25) / 24, IntegrateOptions("euler", step=24.0))
    assert [notice.code for notice in found.notices] == ["SIM109", "SIM101", "SIM102"]


def test_the_stable_step_is_found_where_the_system_says_nothing() -> None:
    spring = ForceSystem(
        lambda _t, x, v: -1e4 * x - 20 * v,
        [[1.0]],
        energy=lambda _t, y: Energy(
            float((y[1] ** 2).sum()) / 2, 5e3 * float((y[0] ** 2).sum())
        ),
    )
    options = IntegrateOptions("euler", step=1 / 24)
    found = integrate(spring, np.arange(100) / 24, options)
    assert [notice.code for notice in found.notices] == ["SIM102"]
    assert found.stats.stable_step == pytest.approx(0.002, rel=1e-5)


def test_numbers_that_overflow_without_energy_to_judge_by() -> None:
    runaway = RateSystem(lambda _t, y: y * y, [1.0])
    found = integrate(runaway, np.arange(20.0), IntegrateOptions("rk4", step=0.5))
    assert found.stats.status is Status.UNSTABLE
    assert found.stats.reason == "its state is not finite"
    assert np.isfinite(found.states).all()


class Chain(SecondOrder):
    """A spring that is driven until it is far too long."""

    settles = True

    def __init__(self) -> None:
        self.count = 0

    @property
    def state(self) -> FloatArray:
        return np.array([[[0.0]], [[1.0]]])

    def acceleration(self, t: float, x: FloatArray, v: FloatArray) -> FloatArray:
        return np.zeros_like(x)

    def stretch(self, t: float, state: FloatArray) -> float:
        return 1 + float(state[0, 0, 0])

    def settle(
        self, t: float, h: float, before: FloatArray, after: FloatArray
    ) -> FloatArray:
        self.count += 1
        if after[0, 0, 0] < 2:
            return after
        return np.array([[[2.0]], after[1]])


def test_stretch_is_watched() -> None:
    found = integrate(
        Chain(), np.arange(100.0), IntegrateOptions("euler", step=1.0, stretch=2.5)
    )
    assert found.stats.status is Status.UNSTABLE
    assert "times its rest length" in found.stats.reason


@pytest.mark.parametrize("name", OURS)
def test_states_are_settled_after_every_step(name: str) -> None:
    chain = Chain()
    found = integrate(chain, np.arange(5.0), options_for(name, growth=math.inf))
    np.testing.assert_allclose(found.positions[:, 0, 0], [0, 1, 2, 2, 2])
    assert chain.count == found.stats.steps


@pytest.mark.parametrize("name", ["dop853", "lsoda", "radau"])
def test_solvers_that_cannot_settle_are_refused(name: str) -> None:
    assert refused(Chain(), [0, 1], IntegrateOptions(name)) == ["SIM006"]


def test_lengths_kept_by_moving_positions_lose_no_order_of_size() -> None:
    class Rod(SecondOrder):
        """A pendulum whose length is kept as by position-based methods."""

        settles = True

        @property
        def state(self) -> FloatArray:
            return np.array([[[1.0, 0.0]], [[0.0, 0.0]]])

        def acceleration(self, t: float, x: FloatArray, v: FloatArray) -> FloatArray:
            return np.array([[0.0, -1.0]])

        def settle(
            self, t: float, h: float, before: FloatArray, after: FloatArray
        ) -> FloatArray:
            x = after[0] / np.linalg.norm(after[0])
            return np.array([x, (x - before[0]) / h])

    swing = pendulum(np.pi / 2)
    options = IntegrateOptions("symplectic_euler", step=1e-4)
    found = integrate(Rod(), [0, 1.0], options)
    angle = swing.state(1.0)[0, 0, 0]
    wanted = [np.sin(angle), -np.cos(angle)]
    np.testing.assert_allclose(found.positions[-1, 0], wanted, atol=2e-4)


class Fast(Chain):
    """Takes its steps itself, as compiled loops do."""

    settles = False

    def native(self, method: str) -> NativeAdvance | None:
        def steps(t: float, state: FloatArray, h: float, count: int) -> FloatArray:
            self.count += count
            for _ in range(count):
                state = np.array([state[0] + h * state[1], state[1]])
            return state

        return steps if method == "symplectic_euler" else None


def test_native_steps_are_those_of_the_table() -> None:
    options = IntegrateOptions("symplectic_euler", step=0.01, stretch=100)
    fast, slow = Fast(), Fast()
    slow.native = lambda method: None  # type: ignore[method-assign]
    times = [0, 0.5, 1.37, 3.0]
    made, wanted = (integrate(each, times, options) for each in (fast, slow))
    assert made.states.tobytes() == wanted.states.tobytes()
    assert fast.count == made.stats.steps == wanted.stats.steps
    assert slow.count == 0


def test_the_budget_is_kept() -> None:
    options = IntegrateOptions("rk4", step=1e-3, budget=100)
    found = integrate(oscillator().system, [0, 0.01, 1], options)
    assert found.stats.status is Status.OUT_OF_BUDGET
    assert found.times.tolist() == [0, 0.01]
    assert found.notices[-1].code == "SIM104"
    assert found.stats.evaluations < 110


def test_equations_without_a_solution() -> None:
    # y = 1 + h (y² + 1) has none with this step.
    steep = RateSystem(lambda _t, y: y * y + 1, [1.0])
    found = integrate(steep, [0, 1], IntegrateOptions("implicit_euler", step=0.5))
    assert found.stats.status is Status.NOT_SOLVED
    assert found.notices[-1].code == "SIM105"
    assert found.times.tolist() == [0]


@pytest.mark.slow
def test_doubling_goes_on_with_shorter_steps_where_one_is_not_solved() -> None:
    steep = RateSystem(lambda _t, y: y * y + 1, [1.0])
    options = IntegrateOptions(
        "adaptive_doubling", base="implicit_euler", tolerance=1e-6
    )
    found = integrate(steep, [0, 0.7], options)
    assert found.stats.status is Status.OK
    assert found.states[-1, 0] == pytest.approx(np.tan(0.7 + np.pi / 4), rel=1e-3)


def test_doubling_with_implicit_steps_is_for_stiff_systems() -> None:
    stiff = RateSystem(lambda t, y: -1e5 * (y - np.cos(t)), [0.0])
    few = IntegrateOptions("adaptive_doubling", base="implicit_euler", tolerance=1e-4)
    found = integrate(stiff, [0, 10.0], few)
    assert found.states[-1, 0] == pytest.approx(np.cos(10.0), abs=1e-3)
    plain = integrate(stiff, [0, 10.0], IntegrateOptions("rk45", budget=20_000))
    assert found.stats.steps < 400
    assert plain.stats.status is Status.OUT_OF_BUDGET


@pytest.mark.slow
def test_sparse_derivatives_serve_as_dense_ones_do() -> None:
    from scipy.sparse import csr_array

    count = 20
    matrix = -np.eye(count) * 2 + np.eye(count, k=1) + np.eye(count, k=-1)

    def system(sparse: bool) -> ForceSystem:
        by_x, by_v = 900 * matrix, 3 * matrix
        given_ = (csr_array(by_x), csr_array(by_v)) if sparse else (by_x, by_v)
        return ForceSystem(
            lambda _t, x, v: by_x @ x + by_v @ v,
            np.sin(np.arange(count))[:, None],
            jacobians=lambda *_: given_,
            fixed=np.arange(count) == 0,
        )

    for name in ("implicit_euler", "trapezoid", "bdf2", "radau", "lsoda"):
        dense, sparse = (
            integrate(system(kind), [0, 0.5], options_for(name))
            for kind in (False, True)
        )
        np.testing.assert_allclose(dense.states, sparse.states, atol=1e-7)
        assert dense.positions[-1, 0] == 0


def test_bounds_on_chosen_steps() -> None:
    for name in ("rk45", "adaptive_doubling", "dop853", "lsoda", "radau"):
        options = IntegrateOptions(name, tolerance=1e-3, step=0.01)
        found = integrate(oscillator().system, [0, 1], options)
        assert found.stats.largest <= 0.01 * (1 + 1e-12)


def test_systems_of_rates_have_no_velocities() -> None:
    found = integrate(logistic().system, [0, 1])
    assert found.positions.tobytes() == found.states.tobytes()
    with pytest.raises(AttributeError, match="velocities"):
        _ = found.velocities


def refused(
    system: object, times: object, options: IntegrateOptions | None = None
) -> list[str]:
    """Return the codes with which integrating is refused."""
    with pytest.raises(OptionError) as error:
        integrate(system, times, options)  # type: ignore[arg-type]
    return [fault.code for fault in error.value.faults]


@pytest.mark.parametrize(
    "times", [[], [[0, 1]], [0, np.nan], [0, np.inf], [0, 2, 1], [1, 0]]
)
def test_times_that_are_refused(times: list[float]) -> None:
    assert refused(oscillator().system, times) == ["SIM002"]


def test_a_single_time_is_refused_with_the_list_to_write() -> None:
    with pytest.raises(OptionError) as error:
        integrate(oscillator().system, 24)  # type: ignore[arg-type]
    (fault,) = error.value.faults
    assert (fault.code, (fault.hint or "").split()[-1]) == ("SIM002", "[24]")


def test_what_is_attached_is_at_its_own_time() -> None:
    system = oscillator().system
    checkpoint = integrate(system, [0, 1]).checkpoint
    with raises(OptionError, "SIM002"):
        integrate(system, [2, 3], None, checkpoint)


def test_the_checkpoint_of_another_system_is_refused() -> None:
    checkpoint = integrate(oscillator().system, [0, 1]).checkpoint
    pair = ForceSystem(lambda _t, x, _v: -x, [[0.0], [1.0]])
    with raises(OptionError, "SIM002", match="shape"):
        integrate(pair, [1, 2], None, checkpoint)


def test_starts_that_are_refused() -> None:
    def still(_t: float, x: FloatArray, _v: FloatArray) -> FloatArray:
        return np.zeros_like(x)

    odd = ForceSystem(still, [[0.0], [np.nan], [np.inf]])
    assert refused(odd, [0, 1]) == ["SIM003", "SIM003"]
    flat = ForceSystem(still, [0.0, 1.0])
    assert refused(flat, [0, 1]) == ["SIM003"]
    short = ForceSystem(lambda *_: np.zeros((1, 1)), [[0.0], [1.0]])
    assert refused(short, [0, 1]) == ["SIM003"]
    holed = ForceSystem(still, [[0.0], [1.0]], fixed=np.array([True]))
    assert refused(holed, [0, 1]) == ["SIM003"]
    wild = RateSystem(lambda _t, y: y / 0, [1.0])
    assert refused(wild, [0, 1]) == ["SIM003"]
    with raises(OptionError, "SIM003", "SIM003", match="particle 1"):
        integrate(odd, [0, 1])


def test_options_that_are_refused_all_at_once() -> None:
    options = IntegrateOptions("rk4", step=-1.0, floor=-1.0, budget=0, tolerance=1e-3)
    codes = refused(oscillator().system, [0, 1], options)
    assert sorted(codes) == ["SIM004"] * 3 + ["SIM005"]
    assert refused(oscillator().system, [0, 1], IntegrateOptions("rk4")) == ["SIM005"]
    nan = IntegrateOptions("rk45", tolerance=np.nan, stretch=1.0, growth=0.0)
    assert refused(oscillator().system, [0, 1], nan) == ["SIM004"] * 3
    unknown = IntegrateOptions("rk5")
    assert refused(oscillator().system, [0, 1], unknown) == ["SIM001"]
    base = IntegrateOptions("adaptive_doubling", base="bdf2")
    assert refused(oscillator().system, [0, 1], base) == ["SIM006"]


def test_methods_for_accelerations_are_refused_for_rates() -> None:
    options = IntegrateOptions("velocity_verlet", step=0.1)
    assert refused(logistic().system, [0, 1], options) == ["SIM006"]
    assert refused(42.0, [0, 1]) == ["SIM006"]
