"""Into how many parts a step is parted, in numbers."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from animtool.systems.fluid.spec import FluidModel
from animtool.systems.fluid.substeps import Substeps

SPACING, DENSITY = 0.1, 800.0


def substeps(**keys: Any) -> Substeps:
    """Return those of a fluid that may become 1 % denser."""
    given = {"spacing": SPACING, "density": DENSITY, "compression": 0.01, **keys}
    return Substeps(FluidModel.model_validate({"name": "it", **given}))


def sound(head: float) -> float:
    """Return how fast pressure goes for 1 %, over the density, and 1.1 for room."""
    return float(np.sqrt(1.1 * head / 0.01))


def test_pressure_goes_as_fast_as_the_depth_asks_for() -> None:
    points = np.array([[0.0, 1.0, 0.0], [0.0, 3.0, 0.0], [9.0, 2.0, 0.0]])
    pull = np.tile([0.0, -9.81, 0.0], (3, 1))
    assert substeps().initial_sound_speed(points, pull) == pytest.approx(
        sound(2 * 9.81)
    )
    assert substeps().initial_sound_speed(points[:0], pull[:0]) == 0


@pytest.mark.parametrize(
    ("pressure", "speed", "pull", "head"),
    [
        (0.0, 3.0, 0.0, 4.5),
        (8000.0, 0.0, 0.0, 10.0),
        (8000.0, 3.0, 0.0, 14.5),
        (0.0, 0.0, 10.0, 2 * 0.1 * 10 + 0.005),  # two layers, and a step of 10 ms
        (8000.0, 2.0, 10.0, 10 + 2.1**2 / 2),
    ],
)
def test_what_presses_and_what_meets_add_up(
    pressure: float, speed: float, pull: float, head: float
) -> None:
    own = substeps()
    found = own.step_sound_speed(
        0.0, np.full(9, pressure), np.full(9, speed), pull, 0.01
    )
    assert found == pytest.approx(sound(head))


def test_few_particles_ask_for_nothing_and_a_drop_always_does() -> None:
    """Of 1,000, five may be faster; Laplace's pressure is 2 tension over a radius."""
    speeds = np.full(1000, 1.0)
    speeds[:5] = 100.0
    blank = np.zeros(1000)
    assert substeps().step_sound_speed(0.0, blank, speeds, 0.0, 0.1) == pytest.approx(
        sound(0.5)
    )
    speeds[5] = 100.0
    found = substeps().step_sound_speed(0.0, blank, speeds, 0.0, 0.1)
    assert found == pytest.approx(sound(5000.0))
    drop = substeps(tension=40.0).step_sound_speed(0.0, blank, blank, 0.0, 0.1)
    assert drop == pytest.approx(sound(2 * 40 / (0.5 * DENSITY)))


def test_it_slows_down_within_a_second_and_gets_faster_within_a_twentieth() -> None:
    own, blank = substeps(), np.zeros(9)
    fast = np.full(9, np.sqrt(2.0))
    needed = sound(1.0)
    assert own.step_sound_speed(1.19 * needed, blank, fast, 0.0, 0.01) == 1.19 * needed
    assert own.step_sound_speed(needed / 1.19, blank, fast, 0.0, 0.01) == needed / 1.19
    for before, expected in ((2.0, 2 * np.exp(-0.01)), (0.5, 0.5 * np.exp(0.2))):
        found = own.step_sound_speed(before * needed, blank, fast, 0.0, 0.01)
        assert found == pytest.approx(expected * needed)


@pytest.mark.parametrize(
    ("keys", "fastest", "sound", "parts"),
    [
        ({}, 0.0, 30.0, 30),
        ({}, 10.0, 30.0, 40),  # a quarter of the spacing
        ({"viscosity": 0.5}, 0.0, 30.0, 50),
        ({}, 0.0, 0.0, 1),
        # The shortest ripples last 2.5 of what comes out.
        ({"tension": 10.0}, 0.0, 0.0, np.ceil(0.25 * np.sqrt(20 * np.pi / 0.8))),
        ({"tension": 1000.0}, 0.0, 0.0, np.ceil(0.25 * np.sqrt(2000 * np.pi / 0.8))),
    ],
)
def test_parts_of_a_tenth_of_a_second(
    keys: dict[str, float], fastest: float, sound: float, parts: int
) -> None:
    assert substeps(**keys).substep_count(0.1, fastest, sound) == parts
