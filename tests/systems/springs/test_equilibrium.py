"""Where springs come to rest."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from animtool.core.errors import OptionError
from animtool.systems.springs import (
    Air,
    Family,
    Pins,
    PointTargets,
    SpringSystem,
    find_rest,
    rope,
    sheet,
)


def slack(side: int = 8, **options: object) -> SpringSystem:
    """Return a flat sheet that folds as it falls, held at two corners."""
    body = sheet(
        side, side, mass=0.003, structural=Family(500.0), diagonals=Family(200.0)
    )
    return SpringSystem(body, **{"pins": Pins([0, side - 1]), **options})


def test_a_sheet_that_folds_comes_to_rest_below_its_pins() -> None:
    system = slack()
    rest = find_rest(system)
    assert rest.solved
    still = np.zeros_like(rest.positions)
    assert np.abs(system.acceleration(0.0, rest.positions, still)).max() < 1e-6
    assert rest.positions[:, 2].min() < -0.9
    start, end = (
        system.energy(0.0, np.array((x, still))).potential
        for x in (system.state[0], rest.positions)
    )
    assert end < start


def test_rest_is_the_same_each_time() -> None:
    found = [find_rest(slack()).positions.tobytes() for _ in range(2)]
    assert found[0] == found[1]


def test_pins_and_targets_are_as_they_are_at_a_time() -> None:
    line = rope([0, 0, 0], [1, 0, 0], 6, Family(1e3), mass=0.01)
    ends, times = line.positions[[0, 5]], [0.0, 1.0]
    moved = np.stack([ends, ends + np.array([0, 2, 4])])
    system = SpringSystem(
        line,
        pins=Pins([0], moved[:, :1], times),
        targets=PointTargets([5], moved[:, 1:], 100.0, 1.0, times),
    )
    before, after = (find_rest(system, t) for t in (0.0, 0.5))
    assert before.solved
    assert after.solved
    assert_allclose(after.positions, before.positions + np.array([0, 1, 2]), atol=1e-6)


def test_air_is_left_out() -> None:
    windy = find_rest(slack(air=Air([3.0, 4.0, 0.0])))
    assert_allclose(windy.positions, find_rest(slack()).positions, atol=1e-12)


@pytest.mark.parametrize("gravity", [(0.0, 0.0, 0.0), (0.0, 0.0, -9.81)])
def test_what_is_at_rest_stays(gravity: tuple[float, ...]) -> None:
    line = rope([0, 0, 0], [0, 0, -1], 4, Family(1e3), mass=0.1)
    system = SpringSystem(line, pins=Pins([0]), gravity=gravity)
    rest = find_rest(system)
    again = find_rest(system.frozen_at(0.0, replace(line, positions=rest.positions)))
    assert again.steps == 0
    assert_allclose(again.positions, rest.positions, atol=0)


@pytest.mark.parametrize("count", [11, 41, 161])
def test_a_rope_of_axial_stiffness_hangs_as_far_down_with_any_number_of_springs(
    count: int,
) -> None:
    axial, load, mass, length = 5000.0, 20.0, 1.0, 2.0
    line = rope(
        [0, 0, 0],
        [0, 0, -length],
        count,
        Family(0.0, axial_stiffness=axial),
        mass=mass / count,
        tip_mass=load,
    )
    rest = find_rest(SpringSystem(line, pins=Pins([0])))
    assert rest.solved
    stretch = -rest.positions[-1, 2] - length
    whole = 9.81 * (load + mass / 2) * length / axial
    # Weight in lumps: the half of a lump at each end hangs elsewhere.
    assert stretch == pytest.approx(whole, rel=mass / load / count)


@pytest.mark.slow
@pytest.mark.parametrize("mass", [1e17, 1e100])
def test_forces_beyond_float64_find_no_rest(mass: float) -> None:
    line = rope([0, 0, 0], [0.3, 0, -1], 4, Family(1e3), mass=mass)
    rest = find_rest(SpringSystem(line, pins=Pins([0]), gravity=(0, 0, -1e150)))
    assert not rest.solved
    assert np.isfinite(rest.positions).all()


def test_a_damping_beyond_float64_is_refused() -> None:
    line = rope([0, 0, 0], [0, 0, -1], 4, Family(1e200), mass=1e150)
    with pytest.raises(OptionError) as error:
        SpringSystem(line, pins=Pins([0]))
    assert {fault.code for fault in error.value.faults} == {"SIM042"}
