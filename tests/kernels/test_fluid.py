"""Drops in the open: what tension and pressure do to each moves it nowhere."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from animtool import _kernels
from animtool.sim.colliders import Colliders


@pytest.mark.parametrize("count", [2, 5, 30])
def test_momenta_of_drops_stay_whatever_tension_does(count: int) -> None:
    """Two that nothing is near, each off the origin, turning and going its way."""
    rng = np.random.default_rng(count)
    spacing = 0.01
    own = rng.uniform(-1, 1, (count, 3)) * spacing * count ** (1 / 3) / 1.5
    points = np.concatenate(
        [own + np.array([3.0, -2, 1]), own[::-1] * [1, -1, 1] + [-5.0, 4, 7]]
    )
    speeds = rng.normal(0, 0.01, (2 * count, 3))
    arrays = Colliders([]).arrays(0.0, 0.001)
    state, *_ = _kernels.fluid_steps(
        arrays, np.zeros(0, np.int32), np.zeros((0, 13)), np.stack([points, speeds]),
        np.zeros_like(points), spacing, 1000.0, 1e-6, 0.07, 1.0, 0.001, 4,
    )  # fmt: skip
    assert np.abs(state[1] - speeds).max() > 1e-4
    for drop in (slice(0, count), slice(count, None)):
        before, after = speeds[drop], state[1][drop]
        assert_allclose(after.mean(axis=0), before.mean(axis=0), atol=1e-9)
        place = points[drop].mean(axis=0)
        spins = [
            np.cross(x[drop] - place, v[drop]).sum(axis=0)
            for x, v in ((points, speeds), (state[0], state[1]))
        ]
        assert_allclose(spins[1], spins[0], atol=2e-7 * count)
