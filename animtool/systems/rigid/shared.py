"""Rigid bodies as colliders of other simulations, and as carriers of particles."""

from __future__ import annotations

from dataclasses import field, replace
from functools import cached_property

import numpy as np

from animtool.core.array_types import FloatArray, IntArray
from animtool.core.record import dataclass
from animtool.maths import so3
from animtool.sim.colliders.bodies import Wrenches
from animtool.systems.framework.simulation import (
    field_added_later,
    growing_field,
    saved_as,
)
from animtool.systems.framework.surfaces import SystemBodies
from animtool.systems.rigid.bodies import RigidBodies


@dataclass(frozen=True, slots=True)
class RigidState:
    """State of bodies, with the impulses of contacts and joints."""

    # For each of N bodies: centre of mass [m], orientation of the principal axes (x, y,
    # z, w), velocity [m/s], angular momentum [kg m²/s], and how long it has been slow
    # [s] (N, 14).
    motion: FloatArray
    # The two shapes of each contact point (M, 2).
    pairs: IntArray = field(metadata=growing_field())
    # Position of each contact point on the first body [m], and its force [N] (M, 6).
    contacts: FloatArray = field(metadata=growing_field())
    held: FloatArray  # constraint impulses of joints (K, 12)
    # Largest penetration depth so far, and in the first step [m] (2,).
    deepest: FloatArray
    # The shapes of these penetrations (2, 2); colliders are numbered after the bodies'
    # shapes, -1 is none.
    deepest_pairs: IntArray
    # Time at which each joint broke [s], infinite if it has not, and the force [N] and
    # torque [N m] at that time (K, 3); (0, 3) if no joint can break.
    broken: FloatArray
    pressing: int = 0  # number of contact points with a force
    awake: int = 0  # number of bodies that are awake
    residual: float = 0.0  # change of velocities in the last iteration [m/s]
    # Largest step that resolves the fastest oscillating drive [s].
    max_drive_step: float = field(
        default=0.0, metadata=field_added_later() | saved_as("follows")
    )
    # Joint of that drive; -1 is none.
    fastest_drive_joint: int = field(
        default=-1, metadata=field_added_later() | saved_as("swinging")
    )


class RigidStates:
    """Computes body quantities from states, for other simulations (`RigidSystem`).

    Attributes:
        bodies: The bodies of the simulation.
    """

    bodies: RigidBodies

    def body_poses(self, state: RigidState, t: float) -> FloatArray:
        """Return the poses of all bodies ``(B, 7)`` at a time [s]."""
        bodies = self.bodies
        frames = np.zeros((len(bodies.names), 7))
        origins, rotations = bodies.body_frames(state.motion)
        frames[bodies.dynamic_indices] = np.concatenate([origins, rotations], axis=1)
        for i in np.flatnonzero(~bodies.is_dynamic).tolist():
            frames[i] = bodies.poses[i].at(t)
        return frames

    def poses(self, state: RigidState, t: float) -> FloatArray:
        """Return the poses of collision shapes ``(C, 7)`` at a time [s]."""
        shapes = self.bodies.collision_shapes
        frames = self.body_poses(state, t)[shapes.body_of_shape]
        origins = frames[:, :3] + so3.rotate(frames[:, 3:], shapes.origins)
        rotations = so3.multiply(frames[:, 3:], shapes.rotations)
        return np.concatenate([origins, rotations], axis=1)

    @cached_property
    def shared(self) -> SystemBodies:
        """Names, masses and collision shapes of the bodies."""
        bodies, shapes = self.bodies, self.bodies.collision_shapes
        return SystemBodies(
            bodies.names,
            bodies.dynamic_indices,
            bodies.masses,
            [float(bodies.kinds[k].bounding_radius) for k in bodies.kind_of_body],
            shapes.colliders,
            shapes.body_of_shape,
        )

    def body_velocities(self, state: RigidState) -> FloatArray:
        """Return linear and angular velocities of dynamic bodies ``(count, 6)``."""
        spins = self.bodies.spins(state.motion)
        return np.concatenate([state.motion[:, 7:10], spins], axis=1)

    def pushed(self, state: RigidState, wrenches: Wrenches) -> RigidState:
        """Return a state with impulses applied to the bodies."""
        bodies, motion = self.bodies, state.motion.copy()

        def velocity_changes(pushes: FloatArray) -> tuple[FloatArray, FloatArray]:
            impulses, moments = pushes[:, :3], pushes[:, 3:]
            angular_impulses = moments - np.cross(state.motion[:, :3], impulses)
            return impulses / bodies.masses[:, None], angular_impulses

        displacement, twist = velocity_changes(wrenches.time_weighted_impulses)
        twisted_motion = motion.copy()
        twisted_motion[:, 10:13] = twist
        motion[:, :3] += displacement
        rotations = so3.exp(bodies.spins(twisted_motion))
        motion[:, 3:7] = so3.multiply(rotations, motion[:, 3:7])
        velocity_change, momenta = velocity_changes(wrenches.impulses)
        motion[:, 7:10] += velocity_change
        motion[:, 10:13] += momenta
        motion[wrenches.impulses.any(axis=1), 13] = 0.0
        return replace(state, motion=motion)

    def push_to(self, state: RigidState, target: RigidState) -> Wrenches:
        """Return the impulses that change one state to another."""
        before, after, masses = state.motion, target.motion, self.bodies.masses[:, None]
        axes = before[:, 3:7]
        rotation_vector = so3.log(so3.multiply(after[:, 3:7], so3.conjugate(axes)))
        local_vector = so3.rotate(so3.conjugate(axes), rotation_vector)
        twist = so3.rotate(axes, local_vector * self.bodies.moments)

        def impulse(displacement: FloatArray, angular_change: FloatArray) -> FloatArray:
            impulses = masses * displacement
            angular_impulses = angular_change + so3.cross(before[:, :3], impulses)
            return np.concatenate([impulses, angular_impulses], axis=1)

        state_change = after - before
        impulses = impulse(state_change[:, 7:10], state_change[:, 10:13])
        return Wrenches(impulses, impulse(state_change[:, :3], twist))

    def inverse_masses(
        self,
        state: RigidState,
        owners: IntArray,
        points: FloatArray,
        directions: FloatArray,
    ) -> FloatArray:
        """Return the inverse effective masses of bodies at points ``(K,)`` [1/kg].

        The bodies ``owners`` ``(K,)`` are pushed at points in the world ``(K, 3)`` [m]
        along unit vectors ``(K, 3)``.
        """
        motion, moments = state.motion[owners], self.bodies.moments[owners]
        lever_arms = np.cross(points - motion[:, :3], directions)
        squared_components = so3.rotate(so3.conjugate(motion[:, 3:7]), lever_arms) ** 2
        rotational = np.zeros_like(squared_components)
        np.divide(squared_components, moments, out=rotational, where=moments > 0)
        return np.asarray(1 / self.bodies.masses[owners] + rotational.sum(axis=1))

    def inertias(self, state: RigidState) -> tuple[FloatArray, FloatArray]:
        """Return centres of mass and inverse inertias of the bodies, in the world.

        Shapes ``(count, 3)`` [m] and ``(count, 3, 3)`` [1/(kg m²)].
        """
        motion, inverse_inertias = state.motion, self.bodies.inverse_inertias
        axes = so3.to_matrix(motion[:, 3:7])
        return motion[:, :3], (axes * inverse_inertias[:, None]) @ axes.swapaxes(1, 2)
