"""Flocks with reference answers: accelerations, neighbours, and how they fly."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from adapters.boids import Boids, read_boids
from numpy.testing import assert_allclose
from support.data import data_files

from animtool import _kernels

# Of accelerations: the data's own.
WITHIN = 1e-9
# Of statistics: the data's own, and that of a mean over so many that it is near 0.
ALIKE, LEAST = 0.05, 0.005


def flocks() -> list[Any]:
    """Return a parameter a flock."""
    found: list[Any] = []
    for param in data_files("sim", "*.json"):
        (path,) = param.values
        if path is None:
            return [param]
        found += [pytest.param(one, id=one.name) for one in read_boids(path)]
    return found or [pytest.param(None, marks=pytest.mark.skip("no file of flocks"))]


@pytest.mark.parametrize("boids", flocks())
def test_accelerations_and_neighbours(boids: Boids) -> None:
    x, v = boids.start()
    assert_allclose(x[:5], boids.first["x"], atol=WITHIN)
    assert_allclose(v[:5], boids.first["v"], atol=WITHIN)
    found = boids.flock().system.acceleration(0.0, x, v)
    reference = boids.reference
    assert_allclose(found[:10], reference["accel_first10"], atol=WITHIN)
    assert_allclose(found.sum(axis=0), reference["accel_sum"], atol=WITHIN * len(x))
    rms = np.sqrt((found**2).sum(axis=1).mean())
    assert rms == pytest.approx(reference["accel_rms"], abs=WITHIN)


@pytest.mark.parametrize("boids", flocks())
@pytest.mark.parametrize("blocks", [1, 7])
def test_neighbours_are_counted_exactly(boids: Boids, blocks: int) -> None:
    x, v = boids.start()
    pull, open_ = np.array([0.0, 0.0]), np.zeros((2, 3))
    parts = np.array_split(np.arange(len(x), dtype=np.int32), blocks)
    counts = [
        _kernels.flock_accelerations(
            x, v, part, None, boids.params["radius"], -1.0, 0, pull, pull, pull, 0.1,
            open_, 1e12,
        )[1].sum()
        for part in parts
    ]  # fmt: skip
    assert sum(counts) == 2 * boids.reference["neighbour_pairs"]


FLYING = [param for param in flocks() if param.values[0] is None
          or param.values[0].statistics is not None]  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("boids", FLYING)
def test_it_flies_as_the_reference_does(boids: Boids) -> None:
    told = boids.statistics
    assert told is not None
    flock = boids.flock(step=told["h"])
    state, found = flock.initial_state(), []
    count = round(told["T"] / told["h"])
    every = count // len(told["polarisation_every_0_25s"])
    for i in range(count):
        state = flock.step(state, i * told["h"], told["h"])
        if (i + 1) % every == 0:
            found.append(flock.diagnostics(state, 0.0).values["order"])
    x, v = state.motion
    speeds = np.linalg.norm(v, axis=1)
    wanted = told["polarisation_every_0_25s"]
    assert_allclose(found, wanted, rtol=ALIKE, atol=LEAST)
    assert speeds.mean() == pytest.approx(told["speed_mean"], rel=ALIKE)
    assert speeds.std() == pytest.approx(told["speed_std"], rel=ALIKE)
    radius = np.sqrt((x**2).sum(axis=1).mean())
    assert radius == pytest.approx(told["radius_rms"], rel=ALIKE)
