"""Springs, and what holds, draws and slows particles, as kernels take them."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from animtool import _kernels
from animtool._types import FloatArray, IntArray
from animtool.systems.springs.body import Springs
from animtool.systems.springs.records import SelfContact

# Fields of `Springs` that are the columns of kernels, in their order.
COLUMNS = ("rest", "stiffness", "damping", "limit")


class Draws(NamedTuple):
    """What draws particles to points, by springs of no length."""

    particles: IntArray  # ``(A,)``
    stiffness: FloatArray  # ``(A,)`` [N/m]
    damping: FloatArray  # ``(A,)`` [N s/m]


NO_DRAWS = Draws(np.zeros(0, np.int64), np.zeros(0), np.zeros(0))


class Paths(NamedTuple):
    """Where holders are, and how the air moves, over times that all share."""

    knots: FloatArray  # ``(K,)`` [s]
    held: FloatArray  # of held particles ``(K or 1, P, 3)`` [m]
    drawn: FloatArray  # of the points that others are drawn to ``(K or 1, A, 3)`` [m]
    wind: FloatArray  # ``(K or 1, 1, 3)`` [m/s]


def spring_network(
    inverse_masses: FloatArray,
    drags: FloatArray,
    springs: Springs,
    triangles: IntArray,
    gravity: FloatArray,
    pressures: tuple[float, float],
    held: IntArray,
    draws: Draws,
    paths: Paths,
) -> _kernels.SpringNetwork:
    """Return what kernels step.

    Args:
        inverse_masses: Of particles ``(N,)`` [1/kg], 0 of those that are held.
        drags: What slows each, over its mass and speed ``(N,)`` [1/s].
        springs: In the order in which they are gone through.
        triangles: What the air acts on ``(T, 3)``.
        gravity: ``(3,)`` [m/s²].
        pressures: Drag and lift of triangles, over area and the square of speed.
        held: Particles that are ``(P,)``.
        draws: What draws others.
        paths: Of both, and of the air.
    """
    return _kernels.SpringNetwork(
        inverse_masses=inverse_masses,
        drags=drags,
        ends=np.ascontiguousarray(springs.ends),
        numbers=np.stack([getattr(springs, name) for name in COLUMNS], axis=1),
        triangles=triangles,
        field=np.array([*gravity, *pressures], np.float64),
        knots=paths.knots,
        held=held,
        held_path=paths.held,
        anchors=draws.particles,
        anchor_numbers=np.stack([draws.stiffness, draws.damping], axis=1),
        anchor_path=paths.drawn,
        winds=paths.wind,
    )


def spring_layers(
    network: _kernels.SpringNetwork, contact: SelfContact, rest: FloatArray
) -> _kernels.SpringLayers:
    """Return what of a surface kernels keep apart; at rest it is at ``(N, 3)`` [m]."""
    numbers = contact.thickness, contact.friction, contact.speed
    return _kernels.SpringLayers(network, rest, *numbers)
