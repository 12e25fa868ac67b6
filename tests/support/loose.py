"""Particles without springs, and their motion."""

from __future__ import annotations

import numpy as np

from animtool.sim.colliders import Collider, Colliders
from animtool.systems.springs import (
    Body,
    Solver,
    SpringMotion,
    SpringOptions,
    Springs,
    SpringSystem,
    simulate_springs,
)


def loose(
    points: object,
    colliders: Colliders | list[Collider],
    velocity: tuple[float, ...] = (0, 0, 0),
    radius: float = 0.0,
    gravity: float = -9.81,
) -> SpringSystem:
    """Return particles without springs, all with one velocity [m/s]."""
    places = np.array(points, float).reshape(-1, 3)
    body = Body(places, np.ones(len(places)), Springs.none(), np.zeros((0, 3), int))
    speeds = np.tile(np.array(velocity, float), (len(places), 1))
    return SpringSystem(
        body, colliders=colliders, velocities=speeds, radius=radius,
        gravity=(0, 0, gravity),
    )  # fmt: skip


def run(
    system: SpringSystem,
    end: float,
    solver: Solver | str,
    step: float = 1 / 960,
    times: int = 13,
) -> SpringMotion:
    """Return the motion of a system at even times up to an end [s]."""
    options = SpringOptions(solver, step=step)
    return simulate_springs(system, np.linspace(0, end, times), options)
