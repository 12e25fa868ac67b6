"""Slopes of forces by positions and velocities against differences of the forces."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

from animtool.systems.particles.forces.base import Force
from animtool.systems.particles.forces.table import FORCES, find_force
from animtool.systems.particles.state import ParticleState

OPTIONS: list[tuple[str, dict[str, Any]]] = [
    ("drag", {"linear": 0.3}),
    ("drag", {"linear": 0.3, "quadratic": 0.7}),
    ("viscosity", {"viscosity": 0.2}),
    ("wind", {"velocity": (1, 2, 3), "drag": 0.4}),
    ("spring", {"k": 3.0}),
    ("spring", {"k": 3.0, "anchor": (1, 0, 0)}),
    ("spring", {"k": 3.0, "anchor": (1, 0, 0), "rest": 0.5}),
    ("gravity", {}),
    ("uniform", {"push": (1, 2, 3)}),
]


def particles() -> ParticleState:
    flat, rows = np.array([1.0, 2.0, 0.5]), np.zeros((3, 3))
    return ParticleState(np.arange(3), flat, flat, flat, 0 * flat, flat, rows)


@pytest.mark.parametrize(("name", "options"), OPTIONS)
def test_they_are_those_of_the_force(name: str, options: dict[str, Any]) -> None:
    force, rng = find_force(name)(**options), np.random.default_rng(2)
    x, v = rng.normal(size=(2, 3, 3))
    found = force.jacobians(0.0, x, v, particles())
    expected = Force.jacobians(force, 0.0, x, v, particles())
    for one, other in zip(found, expected, strict=True):
        assert_allclose(one, other, atol=1e-7)


def test_what_a_spring_damps_is_along_it() -> None:
    force = find_force("spring")(k=3.0, anchor=(1, 0, 0), rest=0.5, kd=0.2)
    x, v = np.random.default_rng(2).normal(size=(2, 3, 3))
    by_speed = force.jacobians(0.0, x, v, particles())[1]
    assert_allclose(
        by_speed, Force.jacobians(force, 0.0, x, v, particles())[1], atol=1e-7
    )


@pytest.mark.parametrize("name", sorted(FORCES))
def test_what_does_not_vary_has_none(name: str) -> None:
    force = find_force(name)
    if force.is_variable:
        return
    x, v = np.random.default_rng(3).normal(size=(2, 3, 3))
    for jacobian in force().jacobians(0.0, x, v, particles()):
        assert_allclose(jacobian, 0, atol=1e-7)


@pytest.mark.parametrize(
    ("name", "options"),
    [("friction", {"deceleration": 2.0}), ("propulsion", {"thrust": -2.0})],
)
def test_those_of_a_brake_are_its_force_over_the_velocity(
    name: str, options: dict[str, Any]
) -> None:
    force = find_force(name)(**options)
    x, v = np.random.default_rng(2).normal(size=(2, 3, 3))
    by_speed = force.jacobians(0.0, x, v, particles())[1]
    pull = force.force(0.0, x, v, particles())
    assert_allclose((by_speed @ v[:, :, None])[:, :, 0], pull, atol=1e-12)
