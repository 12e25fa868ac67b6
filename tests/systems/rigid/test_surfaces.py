"""Rigid bodies as others of a scene run into them, and their states in files."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_array_equal
from support.rigid import FLOOR, Rigid, box
from support.simulated import Simulator

from animtool import BakeOptions
from animtool.maths import so3

SIZE = np.array([1.0, 0.4, 1.0])
BLOCK = box(SIZE, at=[0, 0.9, 0], spin=[40, 0, 60])
YARD = {"rigid": {"name": "yard", "bodies": [BLOCK], "colliders": [FLOOR]}}
RAIN = {
    "particles": {
        "name": "rain",
        "emitters": [
            {
                "rate": 200,
                "place": {"box": {"size": [1.2, 0.1, 1.2]}},
                "at": [0, 2, 0],
                "radius": 0.01,
            }
        ],
        "forces": [{"gravity": None}],
        "systems": [{"system": "yard"}],
    }
}
FRAMES = (np.arange(31) / 24).tolist()


def test_particles_land_on_a_body_that_tumbles(tmp_path: Path) -> None:
    rows = Simulator(tmp_path).simulate([YARD, RAIN], FRAMES)
    above = []
    for body, drops in zip(rows["yard"], rows["rain"], strict=True):
        own = so3.rotate(so3.conjugate(body.rotations), drops.points - body.points)
        excess_volume = np.abs(own) - SIZE / 2
        outside = excess_volume.max(axis=1, initial=-1.0)
        assert (outside > 0.01 - 1e-4).all()
        above.append(int((outside < 0.02).sum()))
    assert above[-1] > 20


@pytest.mark.slow
def test_who_is_run_into_moves_as_if_alone(tmp_path: Path) -> None:
    """Whoever looks, however often: steps of the body are its own."""
    alone = Simulator(tmp_path).simulate([YARD], FRAMES)["yard"]
    often = {**RAIN["particles"], "name": "mist", "step": 0.0031}
    several: list[dict[str, Any]] = [YARD, RAIN, {"particles": often}]
    seen = Simulator(tmp_path).simulate(several, FRAMES)["yard"]
    for one, other in zip(alone, seen, strict=True):
        assert_array_equal(one.points, other.points)
        assert_array_equal(one.rotations, other.rotations)


def test_bodies_are_where_they_were(tmp_path: Path) -> None:
    found = Rigid(tmp_path, BLOCK, colliders=[FLOOR])
    one, other = (found.run.body_colliders(0.0, 0.5, two_way=False) for _ in range(2))
    assert [collider.friction for collider in one.colliders] == [0.5]
    found.to(0.5)
    ends = one.end_poses(0.3, 0.305)
    assert_array_equal(other.end_poses(0.3, 0.305), ends)
    alone = Rigid(tmp_path, BLOCK, colliders=[FLOOR]).run.at(0.305)
    assert_array_equal(ends[0, 1], [*alone.points[0], *alone.rotations[0]])
    # What one lets go, another may still ask for.
    one.forget(0.4)
    other.forget(0.2)
    again = Rigid(tmp_path, BLOCK, colliders=[FLOOR]).run
    alike = again.body_colliders(0.0, 0.5, two_way=False)
    assert_array_equal(alike.end_poses(0.25, 0.25), other.end_poses(0.25, 0.25))


@pytest.mark.parametrize("frame", [8, 20])
def test_saved_states_go_on_bit_for_bit(tmp_path: Path, frame: int) -> None:
    stack = box((0.2, 0.2, 0.2), at=[0, 0.3, 0],
                grid={"count": [1, 4, 1], "spacing": [0, 0.25, 0]})  # fmt: skip
    entry = {"name": "it", "bodies": [stack], "colliders": [FLOOR]}
    simulator = Simulator(tmp_path)
    times = (np.arange(33) / 24).tolist()
    whole = simulator.simulate([{"rigid": entry}], times)["it"]
    saved = {**entry, "save": "it.npz", "save_at": frame}
    simulator.baked([{"rigid": saved}], BakeOptions())
    if not (tmp_path / "it.npz").exists():
        pytest.fail("no state was saved")
    resumed = {**entry, "resume": "it.npz"}
    later = [t for t in times if t >= 8 / 24]
    rows = simulator.simulate([{"rigid": resumed}], later)["it"]
    for t, row in zip(later, rows, strict=True):
        assert_array_equal(row.points, whole[times.index(t)].points)
