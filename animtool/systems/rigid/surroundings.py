"""Forces, pushes and colliders of rigid bodies during a step."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property
from typing import Any

import numpy as np

from animtool.core.array_types import BoolArray, FloatArray
from animtool.maths import so3
from animtool.sim.colliders import Collider, Colliders, Poses, Sheet
from animtool.systems.particles.forces.base import Force
from animtool.systems.particles.state import ParticleState
from animtool.systems.rigid.bodies import RigidBodies
from animtool.systems.rigid.spec import PushModel

# Relative change of a force in a step that wakes a sleeping body [1].
WAKE_CHANGE = 1e-9


class BodyForces:
    """Forces and pushes on N dynamic bodies."""

    def __init__(
        self, bodies: RigidBodies, forces: Sequence[Force], begin: float
    ) -> None:
        self._bodies, self.forces, self._begin = bodies, forces, begin
        # Whether any force depends on position, velocity or time.
        self.is_variable = any(force.is_variable for force in forces)
        self._pushes = [
            (body, push)
            for body, i in enumerate(bodies.dynamic_indices.tolist())
            for push in bodies.kinds[bodies.kind_of_body[i]].model.pushes
        ]

    def step_wrenches(self, t: float, dt: float, body_states: FloatArray) -> FloatArray:
        """Return forces [N] and torques [N m] of a step ``(N, 6)``.

        The fields `forces` are evaluated at the start of the step.
        """
        wrenches = self.push_wrenches(t, dt, body_states)
        x, v = body_states[:, :3], body_states[:, 7:10]
        for force in self.forces:
            wrenches[:, :3] += force.force(t, x, v, self._particles)
        return wrenches

    def push_wrenches(self, t: float, dt: float, body_states: FloatArray) -> FloatArray:
        """Return forces and torques of pushes in a step ``(N, 6)``.

        Pushes are evaluated for the orientations in the middle of the step, so that the
        energy of bodies that swing under a push does not drift.
        """
        wrenches = np.zeros((len(body_states), 6))
        if not self._pushes:
            return wrenches
        middle_states = body_states.copy()
        spins = self._bodies.spins(body_states)
        rotations = so3.exp(spins * (dt / 2))
        middle_states[:, 3:7] = so3.multiply(rotations, body_states[:, 3:7])
        interval = t, t + dt
        for body, push in self._pushes:
            wrenches[body] += self._wrench_of_push(body, push, interval, middle_states)
        return wrenches

    def accelerations(self, t: float, x: FloatArray, v: FloatArray) -> FloatArray:
        """Return accelerations at positions and velocities ``(N, 3)``."""
        forces = np.zeros_like(x)
        for force in self.forces:
            forces += force.force(t, x, v, self._particles)
        return forces / self._bodies.masses[:, None]

    def jacobians(
        self, t: float, x: FloatArray, v: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Return Jacobians of accelerations by position and velocity ``(N, 3, 3)``."""
        jacobians = np.zeros((2, len(x), 3, 3))
        for force in self.forces:
            if force.is_variable:
                jacobians += force.jacobians(t, x, v, self._particles)
        by_position, by_velocity = jacobians / self._bodies.masses[:, None, None]
        return by_position, by_velocity

    def oscillation_rates(
        self, t: float, dt: float, body_states: FloatArray
    ) -> FloatArray:
        """Return rates of oscillation and of spin under pushes ``(2, N)`` [rad/s].

        The first is the frequency of a pendulum with the force as its weight. The
        second is the spin of bodies whose torque changes as they rotate, else 0.
        """
        rates = np.zeros((2, len(body_states)))
        moments = self._bodies.moments
        for body, push in self._pushes:
            if not self._active_fraction(push, (t, t + dt)):
                continue
            lever_arm = np.array(push.at) - self._bodies.centres[body]
            torque = float(np.linalg.norm(lever_arm) * np.linalg.norm(push.force))
            nonzero_inertia = moments[body][moments[body] > 0]
            if torque and not push.local and len(nonzero_inertia):
                rates[0, body] += torque / nonzero_inertia.min()
            if torque or push.local:
                spin = self._bodies.spins(body_states)[body]
                rates[1, body] = np.linalg.norm(spin)
        rates[0] = np.sqrt(rates[0])
        return rates

    def has_changed(
        self, forces: FloatArray, t: float, dt: float, body_states: FloatArray
    ) -> BoolArray:
        """Return a mask of the bodies whose force changes in the next step ``(N,)``."""
        next_wrenches = self.step_wrenches(t + dt, dt, body_states)
        magnitudes = np.linalg.norm(forces, axis=1)
        changes = np.linalg.norm(next_wrenches - forces, axis=1)
        return np.asarray(changes > WAKE_CHANGE * magnitudes)

    def potential(self, body_states: FloatArray) -> float:
        """Return the potential energy of conservative forces [J]."""
        potential = 0.0
        for force in self.forces:
            energies = force.potential(body_states[:, :3], self._particles)
            potential += 0.0 if energies is None else float(energies.sum())
        return potential

    def _active_fraction(self, push: PushModel, interval: tuple[float, float]) -> float:
        """Return the fraction of an interval in which a push is active [1]."""
        t, end = interval
        push_start = self._begin if push.start is None else push.start
        push_end = np.inf if push.end is None else push.end
        return float(max(min(end, push_end) - max(t, push_start), 0.0) / (end - t))

    def _wrench_of_push(
        self,
        body: int,
        push: PushModel,
        interval: tuple[float, float],
        body_states: FloatArray,
    ) -> FloatArray:
        """Return the mean force and torque of a push over an interval ``(6,)``."""
        fraction = self._active_fraction(push, interval)
        if not fraction:
            return np.zeros(6)
        bodies, axes = self._bodies, body_states[body, 3:7]
        body_rotation = so3.multiply(axes, so3.conjugate(bodies.axes[body]))
        force, torque = np.array(push.force), np.array(push.torque)
        if push.local:
            force, torque = (
                so3.rotate(body_rotation, force),
                so3.rotate(body_rotation, torque),
            )
        lever_arm = so3.rotate(body_rotation, np.array(push.at) - bodies.centres[body])
        return np.concatenate([force, torque + np.cross(lever_arm, force)]) * fraction

    @cached_property
    def _particles(self) -> ParticleState:
        """Dynamic bodies as particles, for force fields."""
        bodies = self._bodies
        count = len(bodies.dynamic_indices)
        return ParticleState(
            np.arange(count),
            bodies.masses,
            np.zeros(count),
            bodies.bounding_radii,
            np.full(count, self._begin),
            np.full(count, np.inf),
            bodies.initial_states[:, :3],
        )


class StepColliders:
    """Colliders of a step, in the kernel's layout.

    Attributes:
        colliders: All colliders of the step.
        first_collider: Index of the first collider of a kinematic body.
    """

    def __init__(self, colliders: Colliders, first_collider: int = 0) -> None:
        self.colliders, self.first_collider = colliders, first_collider
        # Surface points of the last step, and all colliders with those surfaces.
        self._cached_colliders: tuple[list[FloatArray], Colliders] | None = None

    def kernel_arrays(self, t: float, end: float) -> tuple[Any, ...]:
        """Return the colliders of a step as kernel arrays."""
        sheets = self.colliders.sheets
        if not sheets:
            return self.colliders.kernel_arrays(t, end)
        point_arrays = [
            point for sheet in sheets for point in _end_points(sheet, t, end)
        ]
        cached_colliders = self._cached_colliders
        if cached_colliders is None or any(
            old_points is not new_points
            for old_points, new_points in zip(
                cached_colliders[0], point_arrays, strict=True
            )
        ):
            sheet_colliders = [_rigid_collider(sheet, t, end) for sheet in sheets]
            step_colliders = Colliders(
                [*self.colliders, *sheet_colliders], (), self.colliders.bodies
            )
            cached_colliders = self._cached_colliders = point_arrays, step_colliders
        return cached_colliders[1].kernel_arrays(t, end)


def _end_points(sheet: Sheet, t: float, end: float) -> tuple[FloatArray, FloatArray]:
    """Return the points of a surface at the start and the end of a step.

    Both are the same array if the surface teleports in the step.
    """
    sheet.motion.forget(t)
    return sheet.motion.points(t), sheet.motion.points(end)


def _rigid_collider(sheet: Sheet, t: float, end: float) -> Collider:
    """Return a surface as a collider with the shape at the start of a step.

    The pose follows the least-squares rigid motion of the points (Kabsch, 1976).
    """
    start_points, end_points = _end_points(sheet, t, end)
    collider = sheet.collider(start_points, sheet.motion.triangles(t))
    if start_points is end_points or (start_points == end_points).all():
        return collider
    centre, end_centre = start_points.mean(axis=0), end_points.mean(axis=0)
    u, _, v = np.linalg.svd((end_points - end_centre).T @ (start_points - centre))
    rotation = u @ np.diag([1.0, 1.0, np.linalg.det(u @ v)]) @ v
    poses = Poses(
        (t, end),
        np.stack([np.zeros(3), end_centre - rotation @ centre]),
        np.stack([so3.IDENTITY, so3.from_matrix(rotation)]),
    )
    return replace(collider, poses=poses)
