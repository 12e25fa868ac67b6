"""What hangs on a character among shapes of the world."""

from __future__ import annotations

import numpy as np
import pytest
from support.attached import moved, sheet_rig, simulated, strands_rig, tail_rig, take_of

from animtool.motion.take import Take
from animtool.sim.colliders import Box, Capsule, Collider, Plane, Poses

RIGS = {"chain": tail_rig(3, 0.2), "strands": strands_rig(), "cloth": sheet_rig(6)}
LOOSE = {"frequency": 0.0, "settle": 0.5, "drag": 2.0}
RADIUS = 0.005


def still(kind: str, seconds: float = 1.0) -> Take:
    return take_of(RIGS[kind], 24, seconds)


@pytest.mark.parametrize("kind", RIGS)
def test_a_floor_keeps_what_falls_above_it(kind: str) -> None:
    """Without it the same is far below."""
    floor = Collider(Plane((0.0, 1.0, 0.0), -0.12))
    free, _ = simulated(still(kind), **LOOSE)
    kept, codes = simulated(still(kind), colliders=(floor,), **LOOSE)
    assert moved(free)[:, :, 1].min() < -0.28
    assert moved(kept)[:, :, 1].min() > -0.12 + RADIUS - 1e-3
    assert "SIM180" not in codes


def wall(*times: float) -> Collider:
    """Return a wall below what is held that comes 10 cm past it, between two times."""
    places = np.array([[0.0, -0.4, -0.6], [0.0, -0.4, 0.0]])
    turns = np.tile([0.0, 0, 0, 1], (2, 1))
    return Collider(Box((4.0, 0.6, 0.2)), poses=Poses(np.array(times), places, turns))


@pytest.mark.parametrize("kind", RIGS)
def test_what_moves_pushes_it_at_its_time(kind: str) -> None:
    """It is not there before, and is not passed after."""
    free = moved(simulated(still(kind), **LOOSE)[0])
    pushed = moved(simulated(still(kind), colliders=(wall(0.5, 1.0),), **LOOSE)[0])
    np.testing.assert_allclose(pushed[:12], free[:12], atol=1e-9)
    before = free[-1, :, 1] < -0.15
    assert before.any()
    assert pushed[-1, before, 2].min() > 0.05
    low = pushed[-1][pushed[-1, :, 1] < -0.15]
    assert low[:, 2].min(initial=1.0) > 0.1 + RADIUS - 1e-3


@pytest.mark.slow
def test_the_meter_sees_what_a_pin_holds_in_a_box() -> None:
    """The pinned row is in the box, and what hangs on it can not be outside."""
    rod = Collider(Capsule(0.2, 1.0, (1.0, 0.0, 0.0)))
    _, codes = simulated(still("cloth", 0.2), colliders=(rod,), **LOOSE)
    assert "SIM182" in codes or "SIM180" in codes


def test_a_saved_frame_goes_on_in_the_same_world(tmp_path: object) -> None:
    path, given = f"{tmp_path}/states.npz", {"colliders": (wall(0.0, 1.0),), **LOOSE}
    whole, _ = simulated(still("cloth"), save=path, save_at=(13.0,), **given)
    rest, _ = simulated(still("cloth"), resume=path, **given)
    blocks, _ = simulated(still("cloth"), blocks=5, **given)
    np.testing.assert_array_equal(moved(rest)[12:], moved(whole)[12:])
    np.testing.assert_array_equal(moved(blocks), moved(whole))
