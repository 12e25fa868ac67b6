"""Drops in the open: what tension and pressure do to each moves it nowhere."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from animtool import _kernels
from animtool.maths import so3
from animtool.sim.colliders import Collider, Colliders, Plane, Poses


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
    arrays = Colliders([]).kernel_arrays(0.0, 0.001)
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


@pytest.mark.parametrize(
    ("wall", "before", "after"),
    [
        ((0.0, 1.0), 0.0, (0.3, 1.0)),
        ((0.0, 0.0), -1.0, (0.3, 0.0)),
        ((0.0, -1.0), -3.0, (0.3, -1.0)),
        ((0.0, 1.0), 2.0, (0.3, 2.0)),
        # With friction it is taken along by a wall that goes sideways.
        ((2.0, 0.0), -3.0, (2.0, 0.0)),
        ((2.0, 0.0), -0.5, (0.3 + 0.5 * 1.7 / np.hypot(1.7, 0.4), 0.0)),
    ],
)
def test_who_meets_a_wall_goes_with_it(
    wall: tuple[float, float], before: float, after: tuple[float, float]
) -> None:
    """One alone, half a spacing over it."""
    spacing, step = 0.1, 0.01
    x, y = wall
    ends = [[0, 0, 0], [x * step, y * step, 0]]
    poses = Poses([0, step], ends, [[0, 0, 0, 1]] * 2)
    around = Colliders([Collider(Plane(), poses, friction=1.0 if x else 0.0)])
    points = np.array([[1.0, spacing / 2 + 1e-9, 2.0]])
    speeds = np.array([[0.3, before, -0.4]])
    state, *_ = _kernels.fluid_steps(
        around.kernel_arrays(0.0, step), np.full(1, -1, np.int32), np.zeros((0, 13)),
        np.stack([points, speeds]), np.zeros_like(points), spacing, 1000.0, 0.0, 0.0,
        1e-6, step, 1,
    )  # fmt: skip
    assert_allclose(state[1, 0, :2], after, atol=0.05)
    assert state[0, 0, 1] >= spacing / 2 + y * step - 1e-6


@pytest.mark.parametrize("tension", [0.0, 0.07])
@pytest.mark.parametrize("viscosity", [1e-6, 1e-3])
def test_no_axis_is_another_one_for_a_drop(tension: float, viscosity: float) -> None:
    """Axes exchanged before a step and after it give the same, walls and all."""
    rng = np.random.default_rng(7)
    spacing, count = 0.01, 64
    sites = np.stack(np.meshgrid(*[np.arange(4.0)] * 3), -1).reshape(-1, 3)
    points = (sites + rng.uniform(-0.2, 0.2, (count, 3))) * spacing
    speeds = rng.normal(0, 0.2, (count, 3))
    pulls = np.tile([1.0, -9.0, 4.0], (count, 1))
    low = points.min(axis=0) - 0.4 * spacing

    def after(order: list[int]) -> tuple[np.ndarray, np.ndarray, float, float]:
        walls = []
        for k, axis in enumerate(order):
            normal = np.zeros(3)
            normal[k] = 1.0
            turn = so3.shortest_rotation(np.array([0.0, 1, 0]), normal)
            at = low[axis] * normal
            walls.append(Collider(Plane(), Poses.fixed(at, turn), friction=0.3))
        around = Colliders([walls[order.index(axis)] for axis in range(3)])
        arrays = around.kernel_arrays(0.0, 0.002)
        state, pressures, _, dense = _kernels.fluid_steps(
            arrays, np.full(3, -1, np.int32), np.zeros((0, 13)),
            np.stack([points[:, order], speeds[:, order]]),
            np.ascontiguousarray(pulls[:, order]),
            spacing, 1000.0, viscosity, tension, 2.0, 0.002, 3,
        )  # fmt: skip
        back = np.argsort(order)
        area = _kernels.fluid_area(np.ascontiguousarray(points[:, order]), spacing)
        return state[:, :, back], pressures, dense, area

    first = after([0, 1, 2])
    assert np.abs(first[0][1] - speeds).max() > 0.01
    for order in ([1, 2, 0], [2, 0, 1], [0, 2, 1]):
        found = after(order)
        assert_allclose(found[0][0], first[0][0], atol=1e-8)
        assert_allclose(found[0][1], first[0][1], atol=1e-5)
        assert_allclose(found[1], first[1], rtol=1e-4, atol=1e-2)
        assert_allclose(found[2:], first[2:], rtol=1e-5)
