"""Which solver `auto` takes, and what it says of it."""

import re

import pytest

from animtool.systems.springs import (
    Family,
    Pins,
    Solver,
    SpringOptions,
    SpringSystem,
    sheet,
)
from animtool.systems.springs.solvers import (
    CELL,
    COSTS,
    FIRST,
    LITTLE,
    SAFE,
    WORTH,
    Choice,
    choose,
    explicit_limit,
    projected_rate,
)


def cloth(
    size: int, stiffness: float, weight: float = 0.3, pins: int = 2
) -> SpringSystem:
    """Return a sheet of a metre, held along one side."""
    family = Family(stiffness, ratio=0.02)
    body = sheet(size, size, mass=weight / size**2, structural=family, diagonals=family)
    return SpringSystem(body, pins=Pins(range(0, size, (size - 1) // (pins - 1))))


def chosen(system: SpringSystem, **options: float) -> Choice:
    """Return what is taken."""
    return choose(system, SpringOptions(**options), Solver.AUTO, 0.0, system.state)


def times(system: SpringSystem, stretch: float) -> tuple[float, float]:
    """Return what a second of explicit steps and of xpbd is expected to take [s]."""
    springs = len(system.body.springs.rest)
    rate = 1 / (SAFE * explicit_limit(system, 0.0, system.state))
    steps = max(projected_rate(system, stretch), FIRST[Solver.XPBD] / CELL)
    return (
        rate * COSTS[Solver.SYMPLECTIC_EULER] * springs,
        steps * COSTS[Solver.XPBD] * springs,
    )


@pytest.mark.parametrize("size", [20, 50])
@pytest.mark.parametrize("stiffness", [1e2, 1e4, 1e6])
@pytest.mark.parametrize("stretch", [0.01, 0.15])
def test_the_time_that_is_expected_decides(
    size: int, stiffness: float, stretch: float
) -> None:
    system = cloth(size, stiffness)
    explicit, projected = times(system, stretch)
    quick = explicit <= LITTLE or WORTH * explicit <= projected
    wanted = Solver.SYMPLECTIC_EULER if quick else Solver.XPBD
    assert chosen(system, stretch=stretch).solver is wanted


def test_a_light_sheet_of_many_particles_takes_explicit_steps() -> None:
    # xpbd would take half as many again to keep it within its stretch.
    found = chosen(cloth(60, 1000.0))
    assert found.solver is Solver.SYMPLECTIC_EULER
    assert "which take less time than" in found.reason


def test_a_stiff_sheet_that_may_stretch_takes_xpbd() -> None:
    system = cloth(30, 1e6)
    found = chosen(system, stretch=0.1)
    assert found.solver is Solver.XPBD
    explicit, projected = times(system, 0.1)
    share = re.search(r"take (\d+)% of their time", found.reason)
    assert share is not None
    assert int(share[1]) == round(100 * projected / explicit)


def test_little_is_done_explicitly_however_stiff() -> None:
    found = chosen(cloth(4, 1e6), stretch=0.5)
    assert found.solver is Solver.SYMPLECTIC_EULER
    assert "little time" in found.reason


def test_an_error_comes_before_time() -> None:
    system = cloth(30, 1e6)
    assert chosen(system, stretch=0.1, error=1e-3).solver is Solver.BDF2
    # Explicit steps for half as long as the fewest implicit ones.
    rate = COSTS[Solver.BDF2] * FIRST[Solver.BDF2] / CELL
    soft = cloth(30, 1.0)
    found = 1 / (SAFE * explicit_limit(soft, 0.0, soft.state))
    stiffness = (0.5 * rate / (found * COSTS[Solver.SYMPLECTIC_EULER])) ** 2
    near = chosen(cloth(30, stiffness), error=1e-3)
    assert near.solver is Solver.SYMPLECTIC_EULER
    assert "of bdf2" in near.reason


def test_a_step_that_is_asked_for_decides_by_what_is_stable() -> None:
    system = cloth(10, 1000.0)
    limit = explicit_limit(system, 0.0, system.state)
    short, long = 0.5 * limit, 2 * limit
    assert chosen(system, step=short).solver is Solver.SYMPLECTIC_EULER
    assert chosen(system, step=long).solver is Solver.XPBD
    assert chosen(system, step=long, error=1e-3).solver is Solver.BDF2
