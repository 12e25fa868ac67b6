"""What hangs on a character against rods that are thinner than its segments."""

from __future__ import annotations

import numpy as np
import pytest
from support.attached import moved, sheet_rig, simulated, strands_rig, tail_rig, take_of

from animtool.rig.skeleton import Rig
from animtool.sim.colliders import Box, Capsule, Collider, Poses

RADIUS = 0.01
DOWN = (0.0, 0.0, -np.pi / 2)
RIGS = {"chain": tail_rig(3, 0.15), "strands": strands_rig(), "cloth": sheet_rig(6)}
SHAPES = {
    "rod": Capsule(RADIUS, 1.0, (1.0, 0.0, 0.0)),
    "bar": Box((1.0, 2 * RADIUS, 2 * RADIUS)),
}
# Between two rows of particles of each.
HEIGHTS = {"chain": -0.23, "strands": -0.26, "cloth": -0.15}
LINES = {"chain": (1, 4, 3), "strands": (3, 5, 3), "cloth": (6, 6, 3)}


def thrust(rig: Rig, shape: object, speed: float, height: float) -> np.ndarray:
    """Push a rod along x from behind what hangs to before it, at 24 frames a second."""
    begin, way = 0.25, 0.2
    places = np.array([[0.2, height, -way / 2], [0.2, height, way / 2]])
    turns = np.tile([0.0, 0, 0, 1], (2, 1))
    poses = Poses(np.array([begin, begin + way / speed]), places, turns)
    hung = {rig.joints[1].name: DOWN} if len(rig.joints) > 1 else {}
    take = take_of(rig, 24, 0.5, **hung)
    rod = Collider(shape, poses=poses)
    found, codes = simulated(take, colliders=(rod,), frequency=0.0, settle=0.5)
    assert "SIM102" not in codes
    return moved(found)


def crossings(lines: np.ndarray, height: float) -> np.ndarray:
    """Return z of lines ``(L, P, 3)`` where they go through a height."""
    above, below = lines[:, :-1], lines[:, 1:]
    off = (above[..., 1] - height) / (above[..., 1] - below[..., 1])
    z = above[..., 2] + off * (below[..., 2] - above[..., 2])
    return np.asarray(z[(off >= 0) & (off <= 1)])


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("speed", [5.0, 20.0])
@pytest.mark.parametrize("kind", RIGS)
def test_a_thin_rod_takes_what_hangs_along(kind: str, speed: float, shape: str) -> None:
    height = HEIGHTS[kind]
    points = thrust(RIGS[kind], SHAPES[shape], speed, height)
    assert np.isfinite(points).all()
    # The rod comes to rest at 0.1 m, right before this frame.
    lines = points[7].reshape(LINES[kind])
    lines = lines.swapaxes(0, 1) if kind == "cloth" else lines
    assert crossings(lines, height).min(initial=1.0) > 0.1
    assert points[7, :, 2].max() > 0.1
