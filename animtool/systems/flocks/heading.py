"""How members that show a mesh are turned: along their way, leaning into turns."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from animtool._types import FloatArray, IntArray
from animtool.maths import so3
from animtool.systems.flocks.members import Members
from animtool.systems.particles.emitter import uniforms

GRAVITY = 9.81  # [m/s²]
# How long a lean takes to follow what it should be [s].
LEANING = 0.15
_UP = np.array([0.0, 1.0, 0.0])
_TINY = 1e-9  # what is shorter has no direction


@dataclass(frozen=True, slots=True)
class Heading:
    """How N members are turned: their z goes ahead, their y up."""

    rotations: FloatArray  # unit quaternions x, y, z, w (N, 4)
    spins: FloatArray  # angular velocities, in the world (N, 3) [rad/s]
    phases: FloatArray  # cycles of what is shown since the beginning (N,)


def first_heading(members: Members, v: FloatArray) -> Heading:
    """Return how members are turned that begin with velocities ``(N, 3)`` [m/s]."""
    count = len(v)
    still = np.broadcast_to(so3.IDENTITY, (count, 4))
    phases = [
        uniforms(species.seed, np.arange(own.stop - own.start), 1)[:, 0]
        for species, own in zip(members.species, members.parted, strict=True)
    ]
    return Heading(_along(still, v, _UP), np.zeros((count, 3)), np.concatenate(phases))


def next_heading(
    members: Members, heading: Heading, v0: FloatArray, v1: FloatArray, dt: float
) -> Heading:
    """Return how members are turned a step [s] later: ``v0`` and ``v1`` ``(N, 3)``.

    What carries a wing is at right angles to the way, and makes up for gravity and for
    the turn: so is the up that they lean to.
    """
    banking = members.each([one.banking for one in members.species])[:, None]
    lift = banking * (v1 - v0) / dt + GRAVITY * _UP
    up = so3.rotate(heading.rotations, _UP)
    # Across the way, else what is gained along it would count.
    ways = v1 / np.maximum(np.linalg.norm(v1, axis=1), _TINY)[:, None]
    lift = lift - (lift * ways).sum(axis=1)[:, None] * ways
    size = np.linalg.norm(lift, axis=1)[:, None]
    leaned = up + (lift / np.maximum(size, _TINY) - up) * -np.expm1(-dt / LEANING)
    turned = _along(heading.rotations, v1, np.where(size > _TINY, leaned, up))
    rotations = so3.align_signs(turned[None], heading.rotations)[0]
    change = so3.multiply(rotations, so3.conjugate(heading.rotations))
    spins = so3.log(change) / dt
    beats = members.each([one.beat / one.speed.cruise for one in members.species])
    speeds = (np.linalg.norm(v0, axis=1) + np.linalg.norm(v1, axis=1)) / 2
    return Heading(rotations, spins, heading.phases + beats * speeds * dt)


def _along(before: FloatArray, v: FloatArray, up: FloatArray) -> FloatArray:
    """Return rotations ``(N, 4)`` whose z is along velocities, and y near an up.

    Who stands stays as it was.
    """
    speeds = np.linalg.norm(v, axis=1)[:, None]
    ahead = v / np.maximum(speeds, _TINY)
    side = so3.cross(np.broadcast_to(up, v.shape), ahead)
    # Straight up or down, it keeps its side.
    size = np.linalg.norm(side, axis=1)[:, None]
    held = so3.rotate(before, np.array([1.0, 0.0, 0.0]))
    held = held - (held * ahead).sum(axis=1)[:, None] * ahead
    side = np.where(size > 1e-6, side / np.maximum(size, _TINY), held)
    side = side / np.maximum(np.linalg.norm(side, axis=1)[:, None], _TINY)
    axes = np.stack([side, so3.cross(ahead, side), ahead], axis=-1)
    return np.where(speeds > _TINY, so3.from_matrix(axes), before)


def shown(members: Members, meshes: IntArray, phases: FloatArray) -> IntArray:
    """Return which mesh each member shows ``(N,)``: of its species, by its phase.

    ``meshes``: first of each species, and how many it has ``(S, 2)``.
    """
    first, counts = meshes[members.kinds].T
    return np.asarray(
        first + np.floor((phases % 1.0) * counts).astype(np.int64) % counts
    )
