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
    """C colliders of the bodies, each shape in its local frame."""
    owners: IntArray
    """Index of the body of each collider ``(C,)``; -1 if it cannot be pushed."""
    count: int
    """Number of bodies that can be pushed."""
    masses: FloatArray
    """Masses of the bodies ``(count,)`` [kg]."""
    max_speed: float
    """Largest speed of a body so far [m/s]."""

    def end_poses(self, t0: float, t1: float) -> FloatArray:
        """Return poses of the colliders ``(C, 2, 7)`` at both ends of a step [s]."""

    def inverse_masses(
        self, t: float, owners: IntArray, points: FloatArray, directions: FloatArray
    ) -> FloatArray:
        """Return inverse effective masses of bodies ``(K,)`` [1/kg] at a time [s].

        The bodies ``owners`` ``(K,)`` are pushed at points ``(K, 3)`` [m] along unit
        vectors ``(K, 3)``.
        """

    def inertias(
        self, t: float, *, is_step_start: bool = False
    ) -> tuple[FloatArray, FloatArray]:
        """Return centres ``(count, 3)`` [m] and inverse inertias ``(count, 3, 3)``.

        The time [s] is the beginning or the end of a step. Inertias are in world space
        [1/(kg m²)].
        """

    def register_pusher(self, pusher: Pusher) -> None:
        """Register a system that applies impulses to the bodies."""

    def push(self, t: float, wrenches: Wrenches) -> None:
        """Apply impulses to the bodies at a time [s]."""

    def forget(self, t: float) -> None:
        """Release buffered states before a time [s]."""


@dataclass(frozen=True, slots=True)
class Wrenches:
    """Linear and angular impulses ``(count, 6)`` [N s], [N m s] about the origin."""

    impulses: FloatArray  # sum of the impulses
    # Sum of the impulses times the time since they were applied.
    time_weighted_impulses: FloatArray

    @staticmethod
    def zeros(count: int) -> Wrenches:
        """Return zero impulses on ``count`` bodies."""
        return Wrenches(np.zeros((count, 6)), np.zeros((count, 6)))

    @staticmethod
    def sum(wrenches: Sequence[Wrenches]) -> Wrenches:
        """Return the element-wise sum of several sets of impulses."""
        return Wrenches(
            np.sum([wrench.impulses for wrench in wrenches], axis=0),
            np.sum([wrench.time_weighted_impulses for wrench in wrenches], axis=0),
        )

    def delayed_by(self, duration: float) -> Wrenches:
        """Return the same impulses as if they were applied ``duration`` [s] earlier."""
        return Wrenches(
            self.impulses, self.time_weighted_impulses + duration * self.impulses
        )


def body_owners(
    bodies: Sequence[MovingBodies], static_count: int
) -> npt.NDArray[np.int32]:
    """Return the body index of each collider ``(C,)``; -1 if it has no body.

    The first ``static_count`` colliders have no body. Bodies are numbered across all
    systems.
    """
    owners, first_body = [np.full(static_count, -1)], 0
    for system in bodies:
        owners.append(np.where(system.owners >= 0, system.owners + first_body, -1))
        first_body += system.count
    return np.concatenate(owners).astype(np.int32)


def pushable_table(bodies: Sequence[MovingBodies], t0: float, t1: float) -> FloatArray:
    """Return the kernel's table of bodies that can be pushed in a step ``(B, 13)``.

    Columns: inverse masses [1/kg], inverse inertias (xx, yy, zz, xy, xz, yz), and
    centres of mass at both ends [m].
    """
    tables = [np.zeros((0, 13))]
    for system in bodies:
        if system.count:
            centres, inverse_inertias = system.inertias(t0, is_step_start=True)
            end_centres, _ = system.inertias(t1)
            inertia_rows = inverse_inertias[:, [0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
            inverse_masses = 1 / system.masses[:, None]
            columns = [inverse_masses, inertia_rows, centres, end_centres]
            tables.append(np.concatenate(columns, axis=1))
    return np.concatenate(tables)


def split_by_system(
    bodies: Sequence[MovingBodies], impulses: FloatArray
) -> list[FloatArray]:
    """Split impulses on all bodies ``(2, B, 6)`` into one array for each system."""
    end_indices = np.cumsum([system.count for system in bodies])
    return np.split(impulses, end_indices[:-1], axis=1) if bodies else []


def exchange_impulses(
    bodies: MovingBodies,
    t: float,
    collider_indices: IntArray,
    without_contacts: FloatArray,
    with_contacts: FloatArray,
    masses: FloatArray,
) -> tuple[FloatArray, Wrenches]:
    """Transfer the momentum that points lose in contacts to the bodies.

    A contact with an immovable body changes a point's velocity by d. With a movable
    body both velocities change so that they separate at the same speed: that of the
    point by a fraction of d; the displacement since the contact changes equally.
    Simultaneous contacts share the mass of a body, so that no energy is gained (Tonge,
    Benevolenski and Voroshilov 2012, "Mass splitting for jitter-free parallel rigid
    body simulation").

    ``collider_indices`` has the index of the collider that each point touched, negative
    for none ``(N,)``. States at the end of the step, at ``t`` [s], are positions, then
    velocities ``(2, N, 3)``; masses of points are ``(N,)`` [kg]. Returns the state of
    the points, and the impulses on the bodies.
    """
    owners = np.where(collider_indices >= 0, bodies.owners[collider_indices], -1)
    velocity_change = with_contacts[1] - without_contacts[1]
    speed_change = np.linalg.norm(velocity_change, axis=1)
    (touching_indices,) = np.nonzero((owners >= 0) & (speed_change > 0))
    wrenches = Wrenches.zeros(bodies.count)
    if not len(touching_indices):
        return with_contacts, wrenches
    owners = owners[touching_indices]
    velocity_change = velocity_change[touching_indices]
    speed_change = speed_change[touching_indices]
    directions = velocity_change / speed_change[:, None]
    displacement = (
        with_contacts[0, touching_indices] - without_contacts[0, touching_indices]
    )
    elapsed_times = np.maximum(
        (displacement * directions).sum(axis=1) / speed_change, 0.0
    )
    end_points, end_velocities = with_contacts[:, touching_indices]
    points = end_points - elapsed_times[:, None] * end_velocities
    contact_counts = np.bincount(owners, minlength=bodies.count)[owners]
    inverse_masses = 1.0 / masses[touching_indices]
    body_inverse_masses = bodies.inverse_masses(t, owners, points, directions)
    sums = inverse_masses + contact_counts * body_inverse_masses
    fraction = (inverse_masses / sums)[:, None]
    changes = fraction * np.stack([displacement, velocity_change])
    new_state = with_contacts.copy()
    new_state[:, touching_indices] = without_contacts[:, touching_indices] + changes
    impulses = -masses[touching_indices, None] * fraction * velocity_change
    pushes = np.concatenate([impulses, np.cross(points, impulses)], axis=1)
    np.add.at(wrenches.impulses, owners, pushes)
    np.add.at(wrenches.time_weighted_impulses, owners, elapsed_times[:, None] * pushes)
    return new_state, wrenches
