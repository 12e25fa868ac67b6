"""Which solver `auto` takes, and what steps cost."""

import re
from dataclasses import replace

import numpy as np
import pytest

from animtool.systems.springs import (
    Family,
    Pins,
    Solver,
    SpringOptions,
    SpringSystem,
    rope,
    sheet,
    simulate_springs,
)
from animtool.systems.springs.choosing import (
    CELL,
    INITIAL_SUBSTEPS,
    NEGLIGIBLE_TIME,
    STEP_COSTS,
    STEP_SAFETY_FACTOR,
    SolverChoice,
    bdf2_step_cost,
    choose_solver,
    explicit_limit,
)

# Steps of bdf2 a second where none is asked for.
FINE = INITIAL_SUBSTEPS[Solver.BDF2] / CELL


def cloth(
    size: int, stiffness: float, weight: float = 0.3, pins: int = 2
) -> SpringSystem:
    """Return a sheet of a metre, held along one side."""
    family = Family(stiffness, ratio=0.02)
    body = sheet(size, size, mass=weight / size**2, structural=family, diagonals=family)
    return SpringSystem(body, pins=Pins(range(0, size, (size - 1) // (pins - 1))))


def chosen(system: SpringSystem, **options: float) -> SolverChoice:
    """Return what is taken."""
    return choose_solver(
        system, SpringOptions(**options), Solver.AUTO, 0.0, system.state
    )


def times(system: SpringSystem) -> tuple[float, float]:
    """Return what a second of explicit steps and of bdf2 is expected to take [s]."""
    springs = len(system.body.springs.rest)
    rate = 1 / (STEP_SAFETY_FACTOR * explicit_limit(system, 0.0, system.state))
    return (
        rate * STEP_COSTS[Solver.SYMPLECTIC_EULER] * springs,
        FINE * bdf2_step_cost(system, rate / FINE) * springs,
    )


@pytest.mark.parametrize("size", [20, 50])
@pytest.mark.parametrize("stiffness", [1e2, 1e4, 1e6])
def test_the_time_that_is_expected_decides(size: int, stiffness: float) -> None:
    system = cloth(size, stiffness)
    explicit, implicit = times(system)
    quick = explicit <= max(NEGLIGIBLE_TIME, implicit)
    wanted = Solver.SYMPLECTIC_EULER if quick else Solver.BDF2
    assert chosen(system).solver is wanted


def test_a_light_sheet_of_many_particles_takes_explicit_steps() -> None:
    found = chosen(cloth(60, 1000.0))
    assert found.solver is Solver.SYMPLECTIC_EULER
    assert "which take less time than" in found.reason


def test_a_stiff_sheet_takes_implicit_steps() -> None:
    found = chosen(cloth(30, 1e8), stretch=0.5)
    assert found.solver is Solver.BDF2
    assert "too many" in found.reason


def test_a_stiff_rope_takes_implicit_steps() -> None:
    line = rope([0, 0, 0], [0, 0, -1], 400, Family(1e6), mass=2.5e-5)
    system = SpringSystem(line, pins=Pins([0]))
    found = chosen(system)
    assert found.solver is Solver.BDF2
    explicit, implicit = times(system)
    share = re.search(r"takes (\d+)% of their time", found.reason)
    assert share is not None
    assert int(share[1]) == round(100 * implicit / explicit)


def test_little_is_done_explicitly_however_stiff() -> None:
    found = chosen(cloth(4, 1e6), stretch=0.5)
    assert found.solver is Solver.SYMPLECTIC_EULER
    assert "little time" in found.reason


@pytest.mark.parametrize("size", [4, 20])
@pytest.mark.parametrize("stiffness", [1e2, 1e5, 1e8, 1e11])
@pytest.mark.parametrize("step", [None, 1e-4, 1e-3, 1 / 24])
@pytest.mark.parametrize("stretch", [1e-4, 0.5])
def test_xpbd_is_taken_for_what_nothing_else_does(
    size: int, stiffness: float, step: float | None, stretch: float
) -> None:
    system = cloth(size, stiffness)
    options = SpringOptions(step=step, stretch=stretch)
    found = choose_solver(system, options, Solver.AUTO, 0.0, system.state)
    assert found.solver in {Solver.SYMPLECTIC_EULER, Solver.BDF2}
    if found.solver is Solver.SYMPLECTIC_EULER:
        assert found.cell / found.substeps <= found.limit


def test_an_error_comes_before_time() -> None:
    system = cloth(30, 1e6)
    assert chosen(system, stretch=0.1, error=1e-3).solver is Solver.BDF2
    # Explicit steps for half as long as the fewest implicit ones.
    rate = STEP_COSTS[Solver.BDF2] * INITIAL_SUBSTEPS[Solver.BDF2] / CELL
    soft = cloth(30, 1.0)
    found = 1 / (STEP_SAFETY_FACTOR * explicit_limit(soft, 0.0, soft.state))
    stiffness = (0.5 * rate / (found * STEP_COSTS[Solver.SYMPLECTIC_EULER])) ** 2
    near = chosen(cloth(30, stiffness), error=1e-3)
    assert near.solver is Solver.SYMPLECTIC_EULER
    assert "of bdf2" in near.reason


def test_what_doubles_do_not_solve_takes_xpbd() -> None:
    assert chosen(cloth(4, 1e20)).solver is Solver.XPBD


@pytest.mark.parametrize("stiffness", [1e3, 1e6])
def test_a_step_is_the_longest_that_is_taken(stiffness: float) -> None:
    system = cloth(30, stiffness)
    limit = explicit_limit(system, 0.0, system.state)
    for step in (0.3 * limit, 3 * limit, 30 * limit):
        found = chosen(system, step=step)
        assert found.cell / found.substeps <= step


def test_a_smaller_step_never_takes_a_solver_of_longer_ones() -> None:
    for stiffness in (1e3, 1e5, 1e7):
        system = cloth(30, stiffness)
        taken = [chosen(system, step=0.1 / 2**k).solver for k in range(16)]
        assert taken == sorted(taken)
        assert taken[-1] is Solver.SYMPLECTIC_EULER


def test_an_explicit_step_is_the_cheapest_and_an_implicit_one_the_dearest() -> None:
    explicit, implicit = STEP_COSTS[Solver.SYMPLECTIC_EULER], STEP_COSTS[Solver.BDF2]
    assert explicit < implicit


@pytest.mark.parametrize("solver", [Solver.BDF2, Solver.IMPLICIT_EULER])
@pytest.mark.parametrize("bend", [None, Family(50.0, 0.01)])
@pytest.mark.parametrize("pins", [[0], [0, 29], []])
def test_chains_move_as_the_same_springs_in_another_order(
    solver: Solver, bend: Family | None, pins: list[int]
) -> None:
    line = rope([0, 0, 0], [1, 0, 0], 30, Family(1e4, 0.1), mass=0.01, bend=bend)
    order = np.random.default_rng(3).permutation(30)
    places = np.argsort(order)
    springs = replace(line.springs, ends=places[line.springs.ends])
    mixed = replace(
        line,
        positions=line.positions[order],
        masses=line.masses[order],
        springs=springs,
    )
    first, second = (
        simulate_springs(
            SpringSystem(body, pins=Pins(held), drag=0.2),
            [0, 0.5],
            SpringOptions(solver),
        ).positions[-1]
        for body, held in ((line, pins), (mixed, places[pins]))
    )
    np.testing.assert_allclose(second[places], first, atol=1e-5)
