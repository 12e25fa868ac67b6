"""Drives of joints against the closed form of a damped spring."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.linalg import expm
from support.rigid import GRAVITY, Rigid, ball, box
from support.suite import some_quick

from animtool.core.array_types import FloatArray

STEP = 1 / 120
MASS, SIZE = 1.5, (0.5, 0.2, 0.1)
MOMENT = MASS * (SIZE[0] ** 2 + SIZE[1] ** 2) / 12
DECADES = [10.0**k for k in range(-3, 4)]
STILL: dict[str, Any] = {"forces": [], "sleep": {"speed": 0}, "step": STEP}


def exact(square: float, damping: float, begin: FloatArray, t: float) -> FloatArray:
    """Return place and speed of ``x'' = -square x - damping x'`` after a time."""
    rates = np.array([[0.0, 1.0], [-square, -damping]])
    return np.asarray(expm(rates * t) @ begin)


def rotor(
    folder: Path,
    square: float,
    damping: float,
    spin: float,
    off: float = 0,
    **keys: Any,
) -> Rigid:
    """Return a box on a pin, drawn to 10 degrees from what its drive says."""
    moment = MOMENT + MASS * off**2
    drive = {"stiffness": square * moment, "damping": damping * moment, "target": -10}
    body = box(SIZE, mass=MASS, at=[off, 0, 0], spin=[0, 0, math.degrees(spin)])
    body["velocity"] = [0, spin * off, 0]
    pin = {"type": "pin", "body": "box", "axis": [0, 0, 1], "at": [0, 0, 0]}
    return Rigid(folder, body, joints=[{**pin, "drive": drive}], **{**STILL, **keys})


@pytest.mark.parametrize("damping", [0.0, *DECADES])
@pytest.mark.parametrize("square", some_quick(DECADES, 3))
def test_a_spring_swings_as_its_closed_form(
    tmp_path: Path, square: float, damping: float
) -> None:
    """Of k/I·h² and c/I·h over six decades: no energy is lost that damping does not."""
    rates = square / STEP**2, damping / STEP
    found, begin = rotor(tmp_path, *rates, 2.0), np.array([math.radians(10), 2.0])
    size = np.hypot(math.sqrt(rates[0]) * begin[0], begin[1])
    for count in (1, 7, 24):
        found.to(count * STEP)
        speed = exact(*rates, begin, count * STEP)[1]
        assert found.spins()[0, 2] == pytest.approx(speed, abs=1e-9 * size)
    assert found.codes() == []


@pytest.mark.parametrize("damping", DECADES)
def test_a_spin_decays_as_its_closed_form(tmp_path: Path, damping: float) -> None:
    found = rotor(tmp_path, 0, damping / STEP, 3.0)
    for count in (1, 5):
        found.to(count * STEP)
        speed = 3 * math.exp(-damping * count)
        assert found.spins()[0, 2] == pytest.approx(speed, abs=1e-9)


@pytest.mark.parametrize("damping", [0.0, 0.1, 10])
@pytest.mark.parametrize("square", [0.01, 1.0])
def test_a_drive_moves_what_hangs_off_its_axis(
    tmp_path: Path, square: float, damping: float
) -> None:
    """The pin's own forces are part of the motion, and the mass is that about it."""
    rates = square / STEP**2, damping / STEP
    begin = np.array([math.radians(10), 2.0])
    found = rotor(tmp_path, *rates, 2.0, off=0.25, residual=1e-8)
    size = np.hypot(math.sqrt(rates[0]) * begin[0], begin[1])
    for count in (1, 12, 24):
        found.to(count * STEP)
        speed = exact(*rates, begin, count * STEP)[1]
        assert found.spins()[0, 2] == pytest.approx(speed, abs=2e-3 * size)


def test_a_spring_keeps_its_energy_for_long(tmp_path: Path) -> None:
    found = rotor(tmp_path, 4 / STEP**2, 0, 0.0, off=0.2, residual=1e-8)
    moment = MOMENT + MASS * 0.2**2
    energy = []
    for t in np.linspace(1, 3, 41):
        y, x = found.to(t)[0, 1], found.to(t)[0, 0]
        angle = math.atan2(y, x) + math.radians(10)
        kinetic = found.energy()
        energy.append(kinetic + 2 / STEP**2 * moment * angle**2)
    begun = 2 / STEP**2 * moment * math.radians(10) ** 2
    assert_allclose(energy, begun, rtol=0.02)


def test_what_is_fixed_to_a_body_is_moved_with_it(tmp_path: Path) -> None:
    """A drive finds the mass behind other joints."""
    one = box(SIZE, mass=MASS)
    two = {**box(SIZE, mass=MASS), "name": "two", "at": [0, 0, 0.3]}
    drive = {"stiffness": 2 * MOMENT * 0.5 / STEP**2, "target": 10}
    joints = [
        {"type": "pin", "body": "box", "axis": [0, 0, 1], "drive": drive},
        {"type": "fixed", "body": "two", "to": "box", "at": [0, 0, 0.15]},
    ]  # fmt: skip
    found = Rigid(tmp_path, one, two, joints=joints, residual=1e-9, **STILL)
    begin = np.array([-math.radians(10), 0.0])
    for count in (5, 24):
        found.to(count * STEP)
        speed = exact(0.5 / STEP**2, 0, begin, count * STEP)[1]
        assert_allclose(found.spins()[:, 2], speed, atol=1e-3 * abs(begin[0]) / STEP)


@pytest.mark.parametrize("damping", [0.0, 0.1, 100.0])
def test_a_slide_hangs_where_spring_and_weight_are_equal(
    tmp_path: Path, damping: float
) -> None:
    """Gravity is part of what a drive solves: rest and swing about it are right."""
    square = 0.3 / STEP**2
    drive = {"stiffness": 2 * square, "damping": 2 * damping / STEP, "target": 0}
    slide = {"type": "prismatic", "body": "ball", "axis": [0, 1, 0], "drive": drive}
    keys = {**STILL, "forces": [{"gravity": {"acceleration": [0, -GRAVITY, 0]}}]}
    found = Rigid(tmp_path, ball(0.1, mass=2), joints=[slide], **keys)
    sag = -GRAVITY / square
    for count in (1, 10, 60):
        at = found.to(count * STEP)[0, 1]
        off = exact(square, damping / STEP, np.array([-sag, 0]), count * STEP)[0]
        assert at == pytest.approx(sag + off, abs=1e-6 * abs(sag))


def test_a_swing_that_no_step_follows_is_said(tmp_path: Path) -> None:
    """SIM171 names a step that follows it; below that nothing is said."""
    rate = 2000 / STEP
    found = rotor(tmp_path, rate**2, 0, 0.0)
    found.to(2 * STEP)
    (said,) = [one for one in found.run.notices if one.code == "SIM171"]
    assert said.hint is not None
    step = float(said.hint.split(",")[0].removeprefix("use step: "))
    assert STEP / 50 < step < STEP
    shorter = rotor(tmp_path, rate**2, 0, 0.0, step=step)
    shorter.to(2 * step)
    assert shorter.codes() == []
    damped = rotor(tmp_path, rate**2, 2 * rate, 0.0)
    damped.to(2 * STEP)
    assert damped.codes() == []


@pytest.mark.slow
def test_a_drive_within_limits_stays_there(tmp_path: Path) -> None:
    for damping in (0.0, 1.0, 100.0):
        body = box(SIZE, mass=MASS)
        drive = {"stiffness": 400, "damping": damping, "target": 60}
        pin = {"type": "pin", "body": "box", "axis": [0, 0, 1], "limits": [-20, 20]}
        found = Rigid(tmp_path, body, joints=[{**pin, "drive": drive}], **STILL)
        found.to(4.0 if damping < 100 else 8.0)
        turn = 2 * math.degrees(math.asin(found.state.motion[0, 5]))
        assert turn < 20.5
