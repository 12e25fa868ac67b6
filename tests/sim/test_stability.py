from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.motions import oscillator

from animtool.sim import find_integrator
from animtool.sim.equations import Equations
from animtool.sim.integrators.integrator import allowed_step
from animtool.sim.modes import modes_at
from animtool.sim.stability import rate_limit

RK4 = (1, 1, 1 / 2, 1 / 6, 1 / 24)


@given(omega=st.floats(1e-3, 1e6), damping=st.floats(0, 1e3))
def test_limits_are_in_units_of_the_frequency(omega: float, damping: float) -> None:
    for name in ("euler", "heun", "rk4", "rk45", "symplectic_euler", "velocity_verlet"):
        integrator = find_integrator(name)
        here, there = (
            integrator.largest_step(1.0, damping),
            integrator.largest_step(omega, damping),
        )
        assert here is not None
        assert there == pytest.approx(here / omega, rel=1e-9)


@given(damping=st.floats(1.0, 1e3))
def test_strong_damping_is_the_fastest_decay(damping: float) -> None:
    fastest = damping + math.sqrt(damping**2 - 1)
    for name, most in (("euler", 2.0), ("heun", 2.0), ("rk4", 2.785293563405)):
        limit = find_integrator(name).largest_step(1.0, damping)
        assert limit == pytest.approx(most / fastest, rel=1e-6)


@pytest.mark.parametrize("damping", [1e9, 1e160, 1e300])
def test_damping_may_be_any_number(damping: float) -> None:
    for name, most in (("euler", 2.0), ("heun", 2.0), ("rk4", 2.785293563405)):
        limit = find_integrator(name).largest_step(1.0, damping)
        assert limit == pytest.approx(most / damping / 2, rel=1e-6)
    verlet = find_integrator("velocity_verlet").largest_step
    ratio = verlet(1.0, damping) / verlet(1.0, 1e3)  # type: ignore[operator]
    assert ratio == pytest.approx(1e3 / damping, rel=1e-5)


def test_solvers_keep_to_their_limits() -> None:
    assert find_integrator("dop853").largest_step(1.0) is None
    assert find_integrator("radau").largest_step(1.0) is None


def test_a_step_is_stable_for_every_motion() -> None:
    euler = find_integrator("euler")
    assert allowed_step(euler, np.array([[10.0, 1.0], [1.0, 0.01]])) == pytest.approx(
        0.02
    )
    assert allowed_step(euler, np.zeros((0, 2))) == math.inf
    assert allowed_step(find_integrator("radau"), np.array([[1.0, 0.0]])) is None


@given(omega=st.floats(0.5, 1e3), damping=st.floats(0.01, 0.95))
def test_motions_are_found_by_differences(omega: float, damping: float) -> None:
    motion = oscillator(omega, damping)
    motion.system._frequencies = None
    found = modes_at(Equations(motion.system), 0.0, motion.system.state)
    assert found is not None
    np.testing.assert_allclose(found, [[omega, damping]] * 2, rtol=1e-3)


def test_a_window_beyond_the_first_limit_is_left_out() -> None:
    assert rate_limit(RK4)(1.0, 0.0) == pytest.approx(math.sqrt(8))
