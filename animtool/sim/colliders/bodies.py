"""Rigid bodies of another simulation as colliders, and impulses on them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np
import numpy.typing as npt

from animtool.core.array_types import FloatArray, IntArray
from animtool.core.record import dataclass
from animtool.sim.colliders.collider import Collider


class Pusher(Protocol):
    """A system that applies impulses to another system's bodies after its steps."""

    def advance(self, t: float) -> object:
        """Take all full steps that end at or before a time [s]."""


class MovingBodies(Protocol):
    """Bodies of another simulation, as colliders."""

    colliders: Sequence[Collider]
    """Their C shapes, each in its own frame."""
    owners: IntArray
    """The body that each shape is of ``(C,)``, -1 of what nothing pushes."""
    count: int
    """How many bodies can be pushed."""
    masses: FloatArray
    """Their masses ``(count,)`` [kg]."""
    fastest: float
    """Speed of the fastest so far [m/s]."""

    def ends(self, t0: float, t1: float) -> FloatArray:
        """Return poses of the shapes ``(C, 2, 7)`` at both ends of a step [s]."""

    def inverse_masses(
        self, t: float, owners: IntArray, points: FloatArray, directions: FloatArray
    ) -> FloatArray:
        """Return inverse effective masses ``(K,)`` [1/kg] at a time [s].

        Of bodies ``(K,)`` at points ``(K, 3)`` [m], along unit vectors ``(K, 3)``.
        """

    def inertias(
        self, t: float, *, begins: bool = False
    ) -> tuple[FloatArray, FloatArray]:
        """Return centres ``(count, 3)`` [m] and inverse inertias ``(count, 3, 3)``.

        At a time [s], as a step begins or one ends; inertias in the world [1/(kg m²)].
        """

    def pushed_by(self, pusher: Pusher) -> None:
        """Register a system that applies impulses to the bodies."""

    def push(self, t: float, wrenches: Wrenches) -> None:
        """Apply impulses to the bodies at a time [s]."""

    def forget(self, t: float) -> None:
        """Release buffered states before a time [s]."""


@dataclass(frozen=True, slots=True)
class Wrenches:
    """Impulses on bodies ``(count, 6)``: [N s], then angular, about the origin [N m s].

    Attributes:
        now: Their sum.
        moved: Each times how long ago it was, by which bodies have come on [s].
    """

    now: FloatArray
    moved: FloatArray

    @staticmethod
    def none(count: int) -> Wrenches:
        """Return zero impulses on a number of bodies."""
        return Wrenches(np.zeros((count, 6)), np.zeros((count, 6)))

    @staticmethod
    def sum(several: Sequence[Wrenches]) -> Wrenches:
        """Return the sum of several."""
        return Wrenches(
            np.sum([one.now for one in several], axis=0),
            np.sum([one.moved for one in several], axis=0),
        )

    def after(self, span: float) -> Wrenches:
        """Return them as applied some time later [s]."""
        return Wrenches(self.now, self.moved + span * self.now)


def owners_of(bodies: Sequence[MovingBodies], others: int) -> npt.NDArray[np.int32]:
    """Return the body of each collider ``(C,)``, -1 for none, after ``first`` others.

    Bodies of all systems are counted through.
    """
    owners, first = [np.full(others, -1)], 0
    for system in bodies:
        owners.append(np.where(system.owners >= 0, system.owners + first, -1))
        first += system.count
    return np.concatenate(owners).astype(np.int32)


def pushed_rows(bodies: Sequence[MovingBodies], t0: float, t1: float) -> FloatArray:
    """Return the kernel's table of bodies that a step [s] can push ``(B, 13)``.

    Inverse masses [1/kg], inverse inertias (xx, yy, zz, xy, xz, yz), and centres of
    mass at both ends [m].
    """
    rows = [np.zeros((0, 13))]
    for system in bodies:
        if system.count:
            centres, eases = system.inertias(t0, begins=True)
            ends, _ = system.inertias(t1)
            six = eases[:, [0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
            masses = 1 / system.masses[:, None]
            rows.append(np.concatenate([masses, six, centres, ends], axis=1))
    return np.concatenate(rows)


def by_system(bodies: Sequence[MovingBodies], pushes: FloatArray) -> list[FloatArray]:
    """Return impulses on bodies ``(2, B, 6)``, split by system."""
    ends = np.cumsum([system.count for system in bodies])
    return np.split(pushes, ends[:-1], axis=1) if bodies else []


def exchange_impulses(
    bodies: MovingBodies,
    t: float,
    shapes: IntArray,
    free: FloatArray,
    met: FloatArray,
    masses: FloatArray,
) -> tuple[FloatArray, Wrenches]:
    """Transfer the momentum that points lose in contacts to the bodies.

    A contact with an immovable body changes a point's velocity by d. With a movable
    body both change so that they separate at the same speed: the point by a fraction
    of d, and of the displacement since the contact. Simultaneous contacts with a body
    share its mass, so that no energy is gained (Tonge, Benevolenski and Voroshilov
    2012, "Mass splitting for jitter-free parallel rigid body simulation").

    Args:
        bodies: The bodies.
        t: When [s].
        shapes: Number of the shape that each point met, below 0 for none ``(N,)``.
        free: Positions, then velocities without contacts ``(2, N, 3)``.
        met: Likewise with contacts.
        masses: Of the points ``(N,)`` [kg].

    Returns:
        Positions and velocities of the points, and what the bodies take.
    """
    owners = np.where(shapes >= 0, bodies.owners[shapes], -1)
    change = met[1] - free[1]
    size = np.linalg.norm(change, axis=1)
    (rows,) = np.nonzero((owners >= 0) & (size > 0))
    wrenches = Wrenches.none(bodies.count)
    if not len(rows):
        return met, wrenches
    owners, change, size = owners[rows], change[rows], size[rows]
    directions, displacement = change / size[:, None], met[0, rows] - free[0, rows]
    since = np.maximum((displacement * directions).sum(axis=1) / size, 0.0)
    points = met[0, rows] - since[:, None] * met[1, rows]
    several = np.bincount(owners, minlength=bodies.count)[owners]
    inverse_masses = 1.0 / masses[rows]
    inverse = bodies.inverse_masses(t, owners, points, directions)
    fraction = (inverse_masses / (inverse_masses + several * inverse))[:, None]
    ended = met.copy()
    ended[:, rows] = free[:, rows] + fraction * np.stack([displacement, change])
    impulses = -masses[rows, None] * fraction * change
    pushes = np.concatenate([impulses, np.cross(points, impulses)], axis=1)
    np.add.at(wrenches.now, owners, pushes)
    np.add.at(wrenches.moved, owners, since[:, None] * pushes)
    return ended, wrenches
