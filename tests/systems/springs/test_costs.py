"""What steps cost, and how many xpbd is expected to take."""

import math

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
from animtool.systems.springs.solvers import COSTS, SHORTEST, projected_rate


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
