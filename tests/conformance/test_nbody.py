"""Discs under their own gravity: accelerations, what stays, and how they turn."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from adapters.nbody import Disc, read_discs
from numpy.testing import assert_allclose
from support.data import data_files

# Of accelerations, direct and by a tree: the data's own.
DIRECT, TREE = 1e-12, 1e-3
# Of trajectories, over the difference of the reference and one with half its step.
NEAR = 10.0
# Bodies up to which a trajectory is quick.
FEW = 500


def discs() -> list[Any]:
    """Return a parameter a disc."""
    found: list[Any] = []
    for param in data_files("sim", "*.json"):
        (path,) = param.values
        if path is None:
            return [param]
        found += [pytest.param(one, id=one.name) for one in read_discs(path)]
    return found or [pytest.param(None, marks=pytest.mark.skip("no file of discs"))]


@pytest.mark.parametrize("disc", discs())
def test_accelerations_energy_and_momenta(disc: Disc) -> None:
    x, v, masses = disc.start()
    assert_allclose(x[:5], disc.first["x"], atol=1e-12)
    assert_allclose(v[:5], disc.first["v"], atol=1e-12)
    made = disc.nbody(accuracy=0)
    state, reference = made.initial_state(), disc.reference
    found = state.gravity.accelerations
    rms = np.sqrt((found**2).sum(axis=1).mean())
    assert rms == pytest.approx(reference["accel_rms"], rel=DIRECT)
    assert_allclose(found[:10], reference["accel_first10"], atol=DIRECT * rms)
    energy = made.diagnostics(state, 0.0).energy
    assert energy is not None
    assert energy.total == pytest.approx(reference["energy"], rel=1e-10)
    momenta = masses[:, None] * v
    assert_allclose(momenta.sum(axis=0), reference["momentum"], atol=1e-12)
    spin = np.cross(x, momenta).sum(axis=0)
    assert_allclose(spin, reference["angular_momentum"], atol=1e-12)


@pytest.mark.parametrize("disc", discs())
def test_a_tree_is_as_near_as_the_data_ask(disc: Disc) -> None:
    exact = disc.nbody(accuracy=0).initial_state().gravity.accelerations
    for accuracy in (TREE, 1e-4):
        made = disc.nbody(accuracy=accuracy)
        found = made.initial_state().gravity.accelerations
        errors = np.linalg.norm(found - exact, axis=1) / np.linalg.norm(exact, axis=1)
        assert np.sqrt((errors**2).mean()) < accuracy
        if made.uses_tree:
            told = made.diagnostics(made.initial_state(), 0.0).values["force_error"]
            assert 0 < told < 3 * accuracy


def trajectories() -> list[Any]:
    found = []
    for param in discs():
        (disc,) = param.values
        if disc is None:
            return [param]
        if disc.trajectory is not None:
            few = disc.params["n"] <= FEW
            marks = [] if few else [pytest.mark.slow(seconds=6)]
            found.append(pytest.param(disc, marks=marks, id=disc.name))
    return found


@pytest.mark.slow
@pytest.mark.parametrize("disc", trajectories())
def test_leapfrog_turns_it_as_the_reference_does(disc: Disc) -> None:
    told = disc.trajectory
    assert told is not None
    step = told["leapfrog_h"]
    made = disc.nbody(step, accuracy=0)
    state = made.initial_state()
    for k in range(round(told["T"] / step)):
        state = made.step(state, k * step, step)
    found = state.motion[0][:10]
    within = NEAR * told["rms_difference_h_vs_half"]
    errors = np.linalg.norm(found - told["x_first10"], axis=1)
    assert np.sqrt((errors**2).mean()) < within
    values = made.diagnostics(state, told["T"]).values
    drift = abs(told["leapfrog_relative_energy_drift"])
    assert abs(values["energy_drift"]) < NEAR * max(drift, 1e-9)
    assert values["momentum_drift"] < 1e-12
    assert values["angular_momentum_drift"] < 1e-12
