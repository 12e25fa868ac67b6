"""Which solver `auto` takes, what steps cost, and how many xpbd is expected to take."""

import math
import re

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
from animtool.systems.springs.solvers import (
    CELL,
    COSTS,
    FIRST,
    LITTLE,
    SAFE,
    SHORTEST,
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


def hanging(count: int = 11, mass: float = 0.01, pull: float = 10.0) -> SpringSystem:
    """Return a rope of a metre."""
    line = rope([0, 0, 0], [0, 0, -1], count, Family(1e5, 1.0), mass=mass)
    return SpringSystem(line, pins=Pins([0]), gravity=[0, 0, -pull])


def test_the_steps_of_xpbd_follow_from_what_springs_bear() -> None:
    # Ten particles of 10 g hang on springs of 0.1 m whose ends are 10 g each: a step
    # moves the first by F w h², of which half is within what is allowed.
    force, moved = 10 * 0.01 * 10, 2 / 0.01 / 0.1
    wanted = math.sqrt(2 * force * moved / 0.05)
    assert projected_rate(hanging(), 0.05) == pytest.approx(wanted)
    assert projected_rate(hanging(), 0.0125) == pytest.approx(2 * wanted)


def test_weight_alone_changes_no_steps_of_xpbd() -> None:
    light, heavy = hanging(mass=1e-4), hanging(mass=1.0)
    assert projected_rate(light, 0.01) == pytest.approx(projected_rate(heavy, 0.01))


def test_what_bears_nothing_needs_no_steps_of_xpbd() -> None:
    assert projected_rate(hanging(pull=0.0), 0.01) == 0
    assert projected_rate(hanging(), math.inf) == 0
    line = rope([0, 0, 0], [1, 0, 0], 3, Family(0.0), mass=1.0)
    assert projected_rate(SpringSystem(line), 0.01) == 0


def test_xpbd_takes_no_steps_shorter_than_it_may() -> None:
    assert projected_rate(hanging(), 1e-12) == 1 / SHORTEST


@pytest.mark.parametrize("stretch", [0.01, 0.05])
def test_xpbd_takes_about_as_many_steps_as_expected(stretch: float) -> None:
    family = Family(1e4, ratio=0.02)
    body = sheet(12, 12, mass=1e-3, structural=family, diagonals=family)
    system = SpringSystem(body, pins=Pins([0, 11]), drag=0.5)
    motion = simulate_springs(system, [0, 1], SpringOptions("xpbd", stretch=stretch))
    wanted = projected_rate(system, stretch)
    assert 0.4 * wanted < motion.stats.steps < 2.5 * wanted


def test_an_explicit_step_is_the_cheapest_and_an_implicit_one_the_dearest() -> None:
    explicit, implicit = COSTS[Solver.SYMPLECTIC_EULER], COSTS[Solver.BDF2]
    assert explicit < COSTS[Solver.XPBD] < implicit
