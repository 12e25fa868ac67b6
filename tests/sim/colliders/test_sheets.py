"""Particles among surfaces that change their shape."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from support.suite import examples

from animtool.core.array_types import FloatArray, IntArray
from animtool.core.errors import OptionError
from animtool.sim.colliders import Collider, Colliders, Plane, Sheet, collide
from animtool.sim.colliders.sheets import hull
from animtool.systems.springs import Family, sheet

RADIUS = 0.01
FLAT = sheet(
    9, 9, mass=1.0, structural=Family(1.0), corner=[-1, 0, -1], across=[2, 0, 0],
    up=[0, 0, 2],
)  # fmt: skip


@dataclass
class Moving:
    """A flat sheet, its front up or down, that moves, and bulges if it is to."""

    velocity: FloatArray
    bulge: float = 0.0

    def points(self, t: float) -> FloatArray:
        points = FLAT.positions + self.velocity * t
        points[:, 1] += self.bulge * t * (FLAT.positions[:, 0] + 1)
        return points

    def triangles(self, t: float) -> IntArray:  # noqa: ARG002
        return FLAT.triangles

    def forget(self, t: float) -> None:
        pass


def met(motion: Moving, **options: float) -> Colliders:
    return Colliders([], [Sheet(motion, RADIUS, **options)])  # type: ignore[arg-type]


def fallen(
    colliders: Colliders, x: FloatArray, v: FloatArray, steps: int = 60, h: float = 0.01
) -> FloatArray:
    state, g = np.stack([x, v]), np.array([0, -9.81, 0])
    for k in range(steps):
        speed = state[1] + h * g
        place = state[0] + h * (state[1] + speed) / 2
        done = collide(place, speed, state, colliders, k * h, (k + 1) * h)
        state = np.stack([done.points, done.velocities])
    return state


@pytest.mark.parametrize("side", [1, -1])
def test_particles_stay_on_their_side(side: int) -> None:
    x = np.array([[0.1, side * 0.3, 0.2], [-0.3, side * 0.5, 0.1]])
    v = np.array([[0.0, -side * 30, 0], [0.0, -side * 60, 0]])
    for h in (0.001, 0.01, 0.03):
        done = collide(x + h * v, v, [x, v], met(Moving(np.zeros(3))), 0.0, h, 0.02)
        assert (done.points[:, 1] * side >= 0.03 - 1e-6).all()


def test_what_falls_rests_at_half_the_thickness() -> None:
    x = np.array([[0.1, 0.3, 0.2], [-0.31, 0.5, 0.13]])
    state = fallen(met(Moving(np.zeros(3))), x, np.zeros_like(x), 100)
    assert_allclose(state[0, :, 1], RADIUS, atol=1e-6)
    assert_allclose(state[1], 0, atol=1e-9)


def test_a_sheet_that_rises_takes_along() -> None:
    x = np.array([[0.1, 0.05, 0.2]])
    state = fallen(met(Moving(np.array([0, 1.5, 0]))), x, np.zeros_like(x), 60)
    assert_allclose(state[0, 0, 1], 0.9 + RADIUS, atol=1e-3)
    assert_allclose(state[1, 0, 1], 1.5, atol=1e-6)


def test_friction_takes_along_sideways() -> None:
    x = np.array([[0.1, 0.02, 0.2]])
    rough = fallen(met(Moving(np.array([0.5, 0, 0])), friction=1.0), x, 0 * x, 80)
    smooth = fallen(met(Moving(np.array([0.5, 0, 0]))), x, 0 * x, 80)
    assert rough[1, 0, 0] == pytest.approx(0.5, abs=1e-6)
    assert smooth[1, 0, 0] == pytest.approx(0.0, abs=1e-9)


def test_a_sheet_that_bends_takes_along_where_it_is() -> None:
    x = np.array([[-0.5, 0.02, 0.0], [0.5, 0.02, 0.0]])
    state = fallen(met(Moving(np.zeros(3), bulge=0.5)), x, 0 * x, 60)
    heights = 0.5 * 0.6 * (state[0, :, 0] + 1)
    tilt = np.sqrt(1 + 0.3**2)
    assert_allclose(state[0, :, 1], heights + RADIUS * tilt, atol=2e-3)


def test_beyond_the_rim_there_is_nothing() -> None:
    x = np.array([[1.2, 0.3, 0.0]])
    state = fallen(met(Moving(np.zeros(3))), x, 0 * x, 60)
    assert state[0, 0, 1] < -1


def test_what_meets_nothing_is_the_same_bit_for_bit() -> None:
    rng = np.random.default_rng(3)
    x = rng.normal(0, 1, (40, 3))
    x[:, 1] = np.abs(x[:, 1]) + 0.2
    v = rng.normal(0, 1, (40, 3))
    done = collide(x + 0.01 * v, v, [x, v], met(Moving(np.zeros(3))), 0.0, 0.01)
    assert (done.points == x + 0.01 * v).all()
    assert (done.velocities == v).all()
    assert not done.contacts.any.any()


@settings(max_examples=examples(30), deadline=None)
@given(st.integers(0, 10**6))
def test_only_motion_between_them_counts(seed: int) -> None:
    rng = np.random.default_rng(seed)
    x = rng.uniform(-0.8, 0.8, (6, 3)) * [1, 0.1, 1]
    x[:, 1] += 0.02 * np.sign(x[:, 1])
    v, ride = rng.normal(0, 3, (6, 3)), rng.normal(0, 3, 3)
    h = 0.02
    still = collide(x + h * v, v, [x, v], met(Moving(np.zeros(3)), friction=0.3), 0, h)
    both = v + ride
    moved = collide(
        x + h * both, both, [x, both], met(Moving(ride), friction=0.3), 0, h
    )
    assert_allclose(moved.points, still.points + h * ride, atol=1e-9)
    assert_allclose(moved.velocities, still.velocities + ride, atol=1e-9)


def test_what_is_rigid_holds_what_a_sheet_presses() -> None:
    floor = Collider(Plane(offset=-0.5))
    both = Colliders([floor], [Sheet(Moving(np.array([0, -1.0, 0])), RADIUS)])
    state = fallen(both, np.array([[0.1, -0.1, 0.2]]), np.zeros((1, 3)), 80)
    assert state[0, 0, 1] >= -0.5 - 1e-6


def test_a_hull_is_closed_and_its_outside_is_outside() -> None:
    made = hull(FLAT.positions, FLAT.triangles, RADIUS)
    faces = np.asarray(made.triangles)
    sides = np.concatenate([faces[:, [k, (k + 1) % 3]] for k in range(3)])
    assert {tuple(s) for s in sides.tolist()} == {
        tuple(s) for s in sides[:, ::-1].tolist()
    }
    seen = Colliders([Collider(made)])
    points = [[0.1, 0.02, 0.1], [0.1, -0.02, 0.1], [1.1, 0, 0], [0.1, 0, 0.1]]
    found = seen.sample(points, 0.0).distances[0]
    assert_allclose(found, [0.01, 0.01, 0.1, -0.01], atol=1e-9)


def test_a_sheet_without_thickness_is_refused() -> None:
    with pytest.raises(OptionError) as error:
        Colliders([], [Sheet(Moving(np.zeros(3)), 0.0)])
    assert error.value.code == "SIM020"
