"""Every integrator on every motion with a reference answer."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from adapters.sim import Problem, read_problems
from support.data import data_files
from support.suite import every_other, some_quick

from animtool.sim import (
    INTEGRATORS,
    IntegrateOptions,
    Integrator,
    Status,
    Trajectory,
    find_integrator,
    integrate,
)
from animtool.sim.integrators.integrator import EquationForm, StepControl

# Of the reference's accuracy: the data's own.
NEAR = 10.0
# What rounding leaves of a motion of thousands of steps.
ROUNDING = 1e-12
# The error may be this many times what a method says it is, or is said to be a tenth of
# the motion or more.
HONEST, WORTHLESS = 10.0, 0.1
TOLERANCE, CLOSE = 1e-6, 1e-1
# What the fastest motion turns by in a part of a problem that tells [rad].
MAX_TURNED = 15.0
# Evaluations of methods that are not for stiff systems, on one.
BUDGET = 20_000
HEADER = (
    f"{'problem':24} {'integrator':18} {'error':>8} {'said':>8} {'steps':>6} "
    f"{'rejected':>8} {'evaluations':>11}  status"
)


def problems() -> list[Any]:
    """Return a parameter a problem."""
    found: list[Any] = []
    for param in data_files("sim", "*.json"):
        (path,) = param.values
        if path is None:
            return [param]
        found += [
            pytest.param(problem, id=problem.name.replace(" ", "_"))
            for problem in read_problems(path)
        ]
    return found


def problems_and_integrators() -> list[Any]:
    """Return a parameter a problem and integrator that can serve it, by turns."""
    return [
        pytest.param(part, name, marks=param.marks, id=f"{param.id}-{name}")
        for turn, param in enumerate(problems())
        for part in map(beginning, param.values)
        for name in every_other(list(INTEGRATORS), turn)
        if part is None or serves(find_integrator(name), part)
    ]


def beginning(problem: Problem | None) -> Problem | None:
    """Return as much of a problem as tells methods apart."""
    if problem is None or problem.fastest is None:
        return problem
    times = problem.times - problem.times[0]
    count = max(2, int((times * problem.fastest[0] <= MAX_TURNED).sum()))
    return replace(problem, times=problem.times[:count], states=problem.states[:count])


def serves(integrator: Integrator, problem: Problem) -> bool:
    """Return whether a method can serve a problem at all."""
    if integrator.form is EquationForm.ACCELERATIONS:
        return problem.states.ndim == 3 and problem.system.state.ndim == 3
    stepped = integrator.control is StepControl.FIXED and not integrator.is_implicit
    return not (stepped and problem.fastest is None)


def step_for(integrator: Integrator, problem: Problem) -> float:
    """Return a step with which a fixed method is stable and sees the motion."""
    gap = float(problem.times[-1] - problem.times[0]) / (len(problem.times) - 1)
    if integrator.is_implicit or problem.fastest is None:
        return gap / 20
    omega, _ = problem.fastest
    limit = integrator.largest_step(*problem.fastest)
    return min(gap / 4, 0.25 / omega, 0.5 * limit if limit else np.inf)


def trajectory(problem: Problem, name: str, **more: float) -> Trajectory:
    integrator = find_integrator(name)
    if integrator.control is StepControl.FIXED:
        more = {"step": step_for(integrator, problem), **more}
    else:
        more = {"tolerance": TOLERANCE, **more}
    options = IntegrateOptions(name, estimate=True, budget=BUDGET * 10, **more)
    if problem.fastest is None and not integrator.is_implicit:
        options = IntegrateOptions(name, budget=BUDGET, **more)
    return integrate(problem.system, problem.times, options)


def error_of(problem: Problem, found: Trajectory) -> float:
    """Return the largest error of the states that were reached."""
    reference = problem.states[: len(found.times)]
    return float(np.abs(found.positions - reference).max())


@pytest.mark.parametrize(("problem", "name"), some_quick(problems_and_integrators(), 6))
def test_what_is_said_of_the_error_is_true(
    problem: Problem, name: str, record_property: Callable[[str, object], None]
) -> None:
    found, integrator = trajectory(problem, name), find_integrator(name)
    stats, error = found.stats, error_of(problem, found)
    said = "" if stats.error is None else f"{stats.error:8.1e}"
    rejected = "" if stats.rejected is None else stats.rejected
    record_property(
        HEADER,
        f"{problem.name:24} {name:18} {error:8.1e} {said:>8} {stats.steps:6} "
        f"{rejected:>8} {stats.evaluations:11}  {stats.status}",
    )
    assert np.isfinite(found.states).all()
    if stats.status is not Status.OK or stats.error is None:
        # It says that it did not get through, and what to change.
        assert stats.status is not Status.OK or problem.fastest is None
        assert stats.status is Status.OK or found.notices[-1].hint
        return
    bound = max(NEAR * problem.accuracy, ROUNDING)
    # Of a stiff system with steps far too long, no comparison tells.
    seen = problem.fastest is not None or integrator.control is not StepControl.FIXED
    if seen and stats.error < WORTHLESS * problem.size:
        assert error <= max(HONEST * stats.error, bound)
    if integrator.control is not StepControl.FIXED:
        assert error <= CLOSE * problem.size


EXACT = {"stiff_ode": ("radau", 1e-10, 1e-14)}


@pytest.mark.slow(0.5)
@pytest.mark.parametrize("problem", some_quick(problems(), 6))
def test_references_are_reached(
    problem: Problem, record_property: Callable[[str, object], None]
) -> None:
    kind = problem.name.split()[0]
    name, tolerance, absolute = EXACT.get(kind, ("dop853", 3e-14, 1e-15))
    if problem.fastest is not None and problem.fastest[1] > 1:
        name, tolerance = "rk45", 1e-12
    options = IntegrateOptions(name, tolerance=tolerance, absolute=absolute)
    found = integrate(problem.system, problem.times, options)
    assert found.stats.status is Status.OK
    error = error_of(problem, found)
    bound = max(NEAR * problem.accuracy, ROUNDING * max(1.0, problem.size))
    record_property(
        f"{'problem':24} {'integrator':18} {'error':>8} {'allowed':>8}",
        f"{problem.name:24} {name:18} {error:8.1e} {bound:8.1e}",
    )
    assert error <= bound, problem.name
    if problem.kept is not None:
        what, measure = problem.kept
        values = [measure(state) for state in found.states]
        assert np.ptp(values) <= 1e-10 * max(1.0, abs(values[0])), what


@pytest.mark.parametrize("path", data_files("sim", "vortex*.json"))
def test_euler_spirals_out_as_it_must(path: Path) -> None:
    for problem in read_problems(path):
        if "rot" not in problem.name:
            continue
        assert problem.fastest is not None
        omega, h, count = problem.fastest[0], 1 / 512, 512
        options = IntegrateOptions("euler", step=h)
        radii = [
            float(np.linalg.norm(state))
            for state in integrate(problem.system, [0, count * h], options).states
        ]
        grown = (1 + (omega * h) ** 2) ** (count / 2)
        assert radii[1] / radii[0] == pytest.approx(grown, rel=1e-10)
