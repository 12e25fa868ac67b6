"""Steps that are chosen by their errors: what is allowed, by size and without one."""

from __future__ import annotations

import numpy as np
import pytest
from support.motions import oscillator

from animtool.sim import IntegrateOptions, find_integrator, integrate
from animtool.sim.adaptive_steps import _error_ratio, _initial_step
from animtool.sim.checks import EnergyWatch
from animtool.sim.equations import Equations
from animtool.sim.integrators.integrator import StepResult
from animtool.sim.run import IntegrationRun


def test_an_error_is_allowed_by_the_size_of_what_it_is_in() -> None:
    """Of 10 at 1e-3 and 2e-3 beside it 12e-3 are allowed, of 0 only the 2e-3."""
    options = IntegrateOptions("rk45", tolerance=1e-3, absolute=2e-3)
    before, after = np.array([-10.0, 0.0, 1.0]), np.array([4.0, 0.0, 3.0])
    for error, ratio in (
        ([24e-3, 0.0, 0.0], 2.0),
        ([0.0, -1e-3, 0.0], 0.5),
        ([0.0, 0.0, 5e-3], 1.0),
        ([24e-3, 6e-3, 5e-3], 3.0),
    ):
        step = StepResult(after, error=np.array(error))
        assert _error_ratio(step, before, options) == pytest.approx(ratio)


def test_the_first_step_that_is_tried_is_that_of_any_unit() -> None:
    """It is a share of the time in which the state changes by its own size."""
    found = []
    for size in (1.0, 1e6):
        system = oscillator(start=(size, size / 2)).system
        options = IntegrateOptions("rk45", tolerance=1e-6, absolute=0.0)
        run = IntegrationRun(
            find_integrator("rk45"),
            Equations(system),
            options,
            EnergyWatch(system, options),
            7.0,
            0.0,
            system.state,
        )
        found.append(_initial_step(run))
    assert found[0] == pytest.approx(found[1])
    assert 1e-3 < found[0] < 1.0


def test_steps_are_those_of_any_unit_without_an_absolute_tolerance() -> None:
    found = []
    for size in (1.0, 1e6):
        motion = oscillator(start=(size, size / 2))
        options = IntegrateOptions("rk45", tolerance=1e-6, absolute=0.0)
        found.append(integrate(motion.system, [0.0, 7.0], options).stats.steps)
    assert found[0] == found[1] > 10
