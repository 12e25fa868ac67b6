"""Dam breaks with closed-form bounds: compression, walls, energy, rest."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from adapters.dams import Dam, read_dams
from support.data import data_files
from support.suite import is_full

FPS, STEP = 24, 1 / 96
# The data's bounds: of the mean in every frame, of the most after 2 s, of energy.
MEAN, MOST, GAIN = 0.01, 0.05, 0.01
# Of the height that water settles at, and of pressure.
SETTLED = 0.05
# Most in the default run: larger ones are slow.
SMALL = 2000


def dams() -> list[Any]:
    """Return a parameter a dam."""
    found: list[Any] = []
    for param in data_files("sim", "*.json"):
        (path,) = param.values
        if path is None:
            return [param]
        for one in read_dams(path):
            marks = [pytest.mark.slow] if one.params["n"] > SMALL else []
            found.append(pytest.param(one, id=one.name, marks=marks))
    return found or [pytest.param(None, marks=pytest.mark.skip("no file of dams"))]


@pytest.mark.slow
@pytest.mark.parametrize("dam", dams())
def test_bounds_hold_in_every_frame(dam: Dam) -> None:
    """No particle is ever before the fastest front, nor outside."""
    fluid = dam.fluid(step=STEP)
    state = fluid.initial_state()
    begin = fluid.diagnostics(state, 0.0).energy
    assert begin is not None
    # By default the large ones run until they have met the far wall.
    seconds = 2.0 if is_full() or dam.params["n"] <= SMALL else 0.75
    for k in range(1, round(seconds * FPS) + 1):
        for j in range(4):
            t = (4 * (k - 1) + j) * STEP
            state = fluid.step(state, t, STEP).state
        points = state.motion[0]
        over = np.maximum(dam.densities(points) - 1, 0.0)
        assert over.mean() <= MEAN
        assert ((points >= 0) & (points <= dam.tank)).all()
        energy = fluid.diagnostics(state, k / FPS).energy
        assert energy is not None
        assert energy.total <= begin.total * (1 + GAIN)
        front = dam.params["column"][0] * dam.params["spacing"]
        front += dam.reference["front_speed_bound"] * k / FPS
        assert points[:, 0].max() <= front
    if seconds == 2.0:
        assert over.max() <= MOST


@pytest.mark.slow
@pytest.mark.parametrize("dam", dams())
def test_it_settles_at_its_height_and_pressure(dam: Dam) -> None:
    """Viscous, so that little but a low swell is left after 7 s.

    Pressure is that of the depth, by least squares over all particles and frames of a
    swell there and back.
    """
    if dam.params["n"] > SMALL and not is_full():
        pytest.skip("for --hypothesis-profile=full")
    fluid = dam.fluid(step=STEP, viscosity=0.003)
    state, heights, pressures = fluid.initial_state(), [], []
    for k in range(round(9 / STEP)):
        state = fluid.step(state, k * STEP, STEP).state
        if k * STEP > 7:
            heights.append(state.motion[0][:, 1])
            pressures.append(state.pressures)
    y, p = np.array(heights), np.array(pressures)
    middle = dam.reference["settled_centre_of_mass_z"]
    assert y.mean() == pytest.approx(middle, rel=SETTLED)
    deep = np.maximum(dam.reference["settled_depth"] - y, 0.0)
    wanted = dam.params["rest_density"] * dam.params["g"] * deep
    found = (p * wanted).sum() / (wanted**2).sum()
    assert found == pytest.approx(1.0, rel=SETTLED)
