"""What the table says of every integrator: order, limits, what stays."""

from __future__ import annotations

import importlib
import math
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from support.faults import raises
from support.motions import (
    Motion,
    logistic,
    oscillator,
    pendulum,
    pendulum_period,
    serves,
    step_matrix,
    stepped,
    turning,
)
from support.suite import at_night, examples

from animtool.core.errors import OptionError
from animtool.sim import (
    INTEGRATORS,
    ForceSystem,
    IntegrateOptions,
    Integrator,
    RateSystem,
    Status,
    find_integrator,
    integrate,
)
from animtool.sim.equations import Equations
from animtool.sim.integrators.adaptive import step_doubling
from animtool.sim.integrators.integrator import EquationForm, StepControl

ALL = [find_integrator(name) for name in INTEGRATORS]
STEPPED = [each for each in ALL if each.step is not None]
FIXED = [each for each in ALL if each.control is StepControl.FIXED]
DAMPING = [0.0, 0.063, 1.58]


def named(integrators: list[Integrator]) -> pytest.MarkDecorator:
    return pytest.mark.parametrize(
        "integrator", integrators, ids=lambda each: each.name
    )


def test_each_file_has_integrators_and_all_are_in_the_table(root: Path) -> None:
    files = {path.stem for path in (root / "animtool/sim/integrators").glob("*.py")}
    modules = {place.split(":")[0] for place in INTEGRATORS.values()}
    families = files - {"__init__", "integrator", "table"}
    assert {f"animtool.sim.integrators.{name}" for name in families} == modules
    for module in map(importlib.import_module, modules):
        found = [v for v in vars(module).values() if isinstance(v, Integrator)]
        assert {each.name for each in found} <= set(INTEGRATORS)
    assert [each.name for each in ALL] == list(INTEGRATORS)
    assert all(each.summary and each.order > 0 for each in ALL)


def test_names_that_there_are_none_of() -> None:
    with raises(OptionError, "SIM001", match="'heun'"):
        find_integrator("huen")


# Neither a whole nor a half period of any of them.
END = 2.3
MOTIONS = {
    "undamped": oscillator(1.3),
    "pendulum": pendulum(2.0),
    "damped": oscillator(1.3, 0.3),
    "logistic": logistic(),
}


def measured_order(integrator: Integrator, motion: Motion) -> float:
    """Return the order of a method between its two finest steps that are not exact."""
    counts = [5, 10, 20, 40, 80, 160]
    answer = motion.state(END)
    errors = [
        float(np.abs(stepped(integrator, motion.system, END, count) - answer).max())
        for count in counts
    ]
    clear = [error for error in errors if error > 1e-12]
    return [math.log2(a / b) for a, b in pairwise(clear)][-1]


@pytest.mark.parametrize("name", MOTIONS)
@named(STEPPED)
def test_orders(integrator: Integrator, name: str) -> None:
    motion = MOTIONS[name]
    if not serves(integrator, motion):
        pytest.skip("it is for accelerations")
    wanted = integrator.order
    if name == "damped" and integrator.drag_order is not None:
        wanted = integrator.drag_order
    assert measured_order(integrator, motion) == pytest.approx(wanted, abs=0.3)


def test_the_order_of_dop853() -> None:
    motion, errors = pendulum(2.0), []
    # At 32 steps the error is 3e-15: rounding, which differs between processors.
    for count in (8, 16):
        # A tolerance that leaves the bound on the step alone.
        options = IntegrateOptions("dop853", tolerance=1e3, step=END / count)
        found = integrate(motion.system, [0, END], options)
        assert found.stats.steps in {count, count + 1}
        errors.append(float(np.abs(found.states[-1] - motion.state(END)).max()))
    order = find_integrator("dop853").order
    assert math.log2(errors[0] / errors[1]) == pytest.approx(order, abs=0.6)


def test_the_order_of_radau() -> None:
    # It chooses its steps: the error goes with their number.
    motion, steps, errors = pendulum(2.0), [], []
    for tolerance in (1e-5, 1e-8):
        options = IntegrateOptions("radau", tolerance=tolerance)
        found = integrate(motion.system, [0, 7.3], options)
        steps.append(found.stats.steps)
        errors.append(float(np.abs(found.states[-1] - motion.state(7.3)).max()))
    slope = math.log(errors[0] / errors[1]) / math.log(steps[1] / steps[0])
    assert slope == pytest.approx(find_integrator("radau").order, abs=0.6)


def test_lsoda_has_no_order_of_its_own_but_heeds_the_tolerance() -> None:
    motion, errors = pendulum(2.0), []
    for tolerance in (1e-5, 1e-8, 1e-11):
        options = IntegrateOptions("lsoda", tolerance=tolerance)
        found = integrate(motion.system, [0, 23.0], options)
        errors.append(float(np.abs(found.states[-1] - motion.state(23.0)).max()))
    assert errors[0] > 50 * errors[1] > 2500 * errors[2]


def radius(integrator: Integrator, h: float, damping: float) -> float:
    """Return by how much a step of ω h makes the fastest growing motion grow."""
    matrix = step_matrix(integrator, oscillator(1.0, damping), h)
    return float(np.abs(np.linalg.eigvals(matrix)).max())


@pytest.mark.parametrize("damping", DAMPING)
@named([each for each in STEPPED if each.limit is not None])
def test_limits_of_stability(integrator: Integrator, damping: float) -> None:
    limit = integrator.largest_step(1.0, damping)
    assert limit is not None
    if math.isinf(limit):
        for h in (0.1, 10.0, 1e6):
            assert radius(integrator, h, damping) <= 1 + 1e-9
    elif limit == 0:
        assert radius(integrator, 0.3, damping) > 1 + 1e-9
    else:
        for h in np.linspace(0.02, 0.999, 60) * limit:
            assert radius(integrator, h, damping) <= 1 + 1e-12
        assert radius(integrator, 1.001 * limit, damping) > 1 + 1e-7


@pytest.mark.parametrize("damping", DAMPING)
@named([each for each in FIXED if each.limit is not None])
def test_motions_grow_above_the_limit_and_not_below(
    integrator: Integrator, damping: float
) -> None:
    limit = integrator.largest_step(10.0, damping)
    assert limit is not None
    system = oscillator(10.0, damping).system
    below = 1.0 if math.isinf(limit) else 0.99 * limit
    above = 1.1 * limit if limit else 0.1
    if limit:
        options = IntegrateOptions(integrator.name, step=below, growth=1e4)
        found = integrate(system, [0, 500 * below], options)
        assert found.stats.status is Status.OK
        assert not found.notices
        assert np.abs(found.states[-1]).max() < 200
    if not math.isinf(limit):
        options = IntegrateOptions(integrator.name, step=above)
        found = integrate(system, [0, 5000 * above], options)
        assert found.stats.status is Status.UNSTABLE
        assert [notice.code for notice in found.notices] == ["SIM101", "SIM102"]
        assert found.stats.stable_step == pytest.approx(limit, rel=1e-9, abs=1e-12)
        said = found.notices[1].hint or ""
        assert (f"{limit:.3g}" if limit else "symplectic_euler") in said


def test_limits_in_closed_form() -> None:
    for damping in DAMPING:
        root = np.sqrt(abs(damping**2 - 1))
        euler = 2 * damping if damping < 1 else 2 / (damping + root)
        semi = 2 * (np.sqrt(1 + damping**2) - damping)
        for name, limit in (
            ("euler", euler),
            ("modified_euler", min(4 * damping, 1 / damping if damping else 0.0)),
            ("symplectic_euler", semi),
            ("position_verlet", semi),
        ):
            found = find_integrator(name).largest_step(50.0, damping)
            assert found == pytest.approx(limit / 50, rel=1e-9)
    assert find_integrator("rk4").largest_step(1.0, 0.0) == pytest.approx(8**0.5)


def test_bdf2_and_implicit_steps_are_stable_with_any_step() -> None:
    for name in ("implicit_euler", "trapezoid", "bdf2"):
        for damping in DAMPING:
            system = oscillator(1000.0, damping).system
            options = IntegrateOptions(name, step=1.0)
            found = integrate(system, [0, 300.0], options)
            assert found.stats.status is Status.OK
            assert np.abs(found.states[-1][0]).max() <= 1.0 + 1e-9


RATES = {
    "implicit_euler": lambda z: 1 / (1 - z),
    "trapezoid": lambda z: (1 + z / 2) / (1 - z / 2),
}
parts = st.floats(-3, 3)


@given(real=parts, imaginary=parts, h=st.floats(0.01, 1.0))
def test_steps_grow_by_the_stability_polynomial(
    real: float, imaginary: float, h: float
) -> None:
    rate = complex(real, imaginary)
    assume(abs(1 - h * rate) > 0.05)
    assume(abs(1 - h * rate / 2) > 0.05)
    system = turning(rate)
    for integrator in STEPPED:
        if not (integrator.stability_polynomial or integrator.name in RATES):
            continue
        grown = (
            np.polynomial.polynomial.polyval(h * rate, integrator.stability_polynomial)
            if integrator.stability_polynomial
            else RATES[integrator.name](h * rate)
        )
        found = stepped(integrator, system, h, 1)
        assert complex(*found) == pytest.approx(grown, rel=1e-9, abs=1e-9)


@pytest.mark.parametrize("name", ["rk4", "heun", "midpoint", "implicit_euler"])
def test_doubling_takes_its_order_from_its_base(name: str) -> None:
    base = find_integrator(name)
    made = step_doubling(base)
    assert made.order == base.order + 1
    motion = MOTIONS["pendulum"]
    assert measured_order(made, motion) == pytest.approx(made.order, abs=0.3)


@pytest.mark.parametrize("name", ["rk45", "adaptive_doubling", "bdf2", "radau"])
def test_what_is_no_base_of_doubling(name: str) -> None:
    with raises(OptionError, "SIM006"):
        step_doubling(find_integrator(name))


@pytest.mark.slow
@named([each for each in STEPPED if each.is_symplectic])
def test_energy_stays_in_bounds_over_thousands_of_periods(
    integrator: Integrator,
) -> None:
    swing = 2.0
    system, period = pendulum(swing).system, pendulum_period(swing)
    options = IntegrateOptions(integrator.name, step=period / 12)
    count = at_night(10_000, 2_500)
    found = integrate(system, np.arange(count + 1) * period, options)
    assert found.stats.steps == 12 * count
    assert found.energies is not None
    off = np.abs(found.energies - found.energies[0])
    early, late = off[: count // 5].max(), off[-count // 5 :].max()
    assert late <= 1.5 * early
    assert off.max() < 0.5


@named([each for each in FIXED if each.name in {"euler", "midpoint", "implicit_euler"}])
def test_energy_drifts_with_others(integrator: Integrator) -> None:
    system = pendulum(2.0).system
    options = IntegrateOptions(integrator.name, step=0.1, growth=1e6)
    found = integrate(system, np.arange(200.0), options)
    assert found.energies is not None
    off = np.abs(found.energies - found.energies[0])
    assert off[100:].min() > 3 * off[:10].min()


@pytest.mark.parametrize("name", ["undamped", "pendulum"])
@named([each for each in FIXED if not each.is_multistep])
def test_a_step_back_undoes_a_step(integrator: Integrator, name: str) -> None:
    motion, h = MOTIONS[name], 0.2
    assert integrator.step is not None
    equations = Equations(motion.system)
    start = motion.state(0.7)
    there = integrator.step(equations, 0.0, start, h, None)
    assert there is not None
    back = integrator.step(equations, h, there.state, -h, None)
    assert back is not None
    off = float(np.abs(back.state - start).max())
    assert (off < 1e-13) == integrator.is_reversible


@given(
    coefficients=st.lists(st.floats(-2, 2), min_size=5, max_size=5),
    h=st.floats(0.1, 2.0),
)
def test_polynomials_are_exact_up_to_the_order(
    coefficients: list[float], h: float
) -> None:
    for integrator in STEPPED:
        if integrator.form is EquationForm.ACCELERATIONS or integrator.is_multistep:
            continue
        rate = np.polynomial.Polynomial(coefficients[: integrator.order])
        system = RateSystem(lambda t, y, rate=rate: np.full_like(y, rate(t)), [0.3])
        found = stepped(integrator, system, 3 * h, 3)
        wanted = 0.3 + rate.integ()(3 * h)
        assert found[0] == pytest.approx(wanted, rel=1e-9, abs=1e-9)


@pytest.mark.parametrize(
    "name", ["modified_euler", "velocity_verlet", "position_verlet"]
)
def test_a_throw_is_exact(name: str) -> None:
    field = np.array([0.0, -9.81])
    throw = ForceSystem(
        lambda _t, x, _v: np.broadcast_to(field, x.shape), [[0.0, 0.0]], [[3.0, 4.0]]
    )
    found = stepped(find_integrator(name), throw, 2.0, 7)
    np.testing.assert_allclose(found[0, 0], [6.0, 8.0 - 2 * 9.81], rtol=1e-13)
    np.testing.assert_allclose(found[1, 0], [3.0, 4.0 - 2 * 9.81], rtol=1e-13)


@settings(max_examples=examples(30))
@given(shift=st.floats(-100, 100), h=st.floats(0.01, 0.3))
def test_time_shifts_change_nothing(shift: float, h: float) -> None:
    pushed = ForceSystem(lambda t, x, v: np.sin(t) - x - 0.1 * v, [[1.0]], [[0.0]])
    later = ForceSystem(
        lambda t, x, v: np.sin(t - shift) - x - 0.1 * v, [[1.0]], [[0.0]]
    )
    for integrator in STEPPED:
        here = stepped(integrator, pushed, 5 * h, 5)
        there = stepped(integrator, later, shift + 5 * h, 5, start=shift)
        np.testing.assert_allclose(there, here, rtol=1e-9, atol=1e-9)


@settings(max_examples=examples(30))
@given(
    length=st.integers(-20, 20),
    duration=st.integers(-8, 8),
    damping=st.floats(0.0, 2.0),
    h=st.floats(0.01, 0.5),
)
def test_units_of_length_and_time_change_nothing(
    length: int, duration: int, damping: float, h: float
) -> None:
    # By powers of two, so that nothing is rounded otherwise.
    long, slow = 2.0**length, 2.0**duration
    for integrator in FIXED:
        plain = oscillator(1.0, damping, start=(1.0, 0.5))
        scaled = oscillator(1 / slow, damping, start=(long, 0.5 * long / slow))
        here = stepped(integrator, plain.system, 4 * h, 4)
        there = stepped(integrator, scaled.system, 4 * h * slow, 4)
        assert (there[0] / long).tobytes() == here[0].tobytes(), integrator.name
        assert (there[1] * slow / long).tobytes() == here[1].tobytes(), integrator.name


def test_forces_that_heed_no_velocity_are_asked_for_once_a_step() -> None:
    free, dragged = oscillator(1.0).system, oscillator(1.0, 0.1).system
    options = IntegrateOptions("velocity_verlet", step=0.01)
    counts = [integrate(s, [0, 1], options).stats.evaluations for s in (free, dragged)]
    assert counts[0] <= 103
    assert 200 <= counts[1] <= 203


def test_bdf2_takes_steps_of_changing_length() -> None:
    motion = pendulum(1.0)
    options = IntegrateOptions("bdf2", step=0.002)
    # The step follows the gaps: 0.0015, 0.002, 0.00199…
    times = np.cumsum([0, 0.3, 0.0015, 0.4, 0.003, 1.0, 0.597])
    found = integrate(motion.system, times, options)
    np.testing.assert_allclose(found.states[-1], motion.state(times[-1]), atol=2e-5)
