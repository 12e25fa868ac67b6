"""Rigid body simulation: forces, contacts and joints."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import Any

import numpy as np

from animtool import _kernels
from animtool.core.array_types import BoolArray, FloatArray
from animtool.core.errors import Fault, RefusalCollector, ToleranceError
from animtool.core.quantities import floor_to_two_digits, plain_number
from animtool.maths import so3
from animtool.motion.frames import TransformsFrame
from animtool.motion.physics import Physics
from animtool.sim.colliders import Collider, Colliders
from animtool.sim.system import Energy
from animtool.systems.framework.simulation import Diagnostics, SimContext
from animtool.systems.particles.forces.base import Force
from animtool.systems.rigid.active_sets import ActiveSet, ActiveSets
from animtool.systems.rigid.bodies import RigidBodies
from animtool.systems.rigid.coincident import coincident_notices, coincident_pairs
from animtool.systems.rigid.half_sizes import half_size_notices
from animtool.systems.rigid.joints import (
    Joints,
    build_joints,
    check_joints,
    joint_forces_and_torques,
)
from animtool.systems.rigid.loads import (
    StepForces,
    StepForceSolver,
    substeps_for_mass_factors,
)
from animtool.systems.rigid.locked import locked_notices
from animtool.systems.rigid.notices import (
    break_notices,
    depth_notices,
    oscillation_notices,
)
from animtool.systems.rigid.physics import (
    body_entries,
    physics_record,
    stage_joints,
    static_colliders,
)
from animtool.systems.rigid.shared import RigidState, RigidStates
from animtool.systems.rigid.spec import RigidModel
from animtool.systems.rigid.surroundings import BodyForces

# Above these values a simulation has diverged. Scene files allow values up to 1e18, and
# squares must be finite.
MAX_POSITION = 1e24  # positions [m] and velocities [m/s]
MAX_MOMENTUM = 1e100  # angular momenta [kg m²/s]


def build(spec: RigidModel, context: SimContext) -> RigidSimulation:
    """Build the simulation of a spec; raise SIM020 or SIM061 if a key is invalid."""
    entry_data, colliders = context.entry_data, context.colliders
    stages: Sequence[Physics] = entry_data.get("stages", ())
    models, body_data = list(spec.bodies), list(entry_data.get("bodies", ()))
    for k, stage in enumerate(stages):
        stage_models = body_entries(stage, f"stages[{k}].prim")
        models += stage_models[0]
        body_data += stage_models[1]
    refusals = RefusalCollector()
    with refusals.collect():
        bodies = RigidBodies.from_models(models, body_data, context.begin)
    with refusals.collect():
        check_joints(spec.joints, models)
    refusals.check()
    joints = build_joints(spec.joints, entry_data.get("joints", ()), bodies)
    first_stage_body = len(bodies.names) - sum(len(stage.bodies) for stage in stages)
    stage_colliders: list[Collider] = []
    for stage in stages:
        members = [*joints.members, *stage_joints(stage, bodies, first_stage_body)]
        joints = Joints(members, [*joints.notices, *stage.notices])
        first_stage_body += len(stage.bodies)
        stage_colliders += static_colliders(stage)
    forces = entry_data.get("forces", ())
    return RigidSimulation(
        spec, context.begin, bodies, joints, colliders, forces, stage_colliders
    )


class RigidSimulation(RigidStates):
    """Simulates rigid bodies and joints with colliders and forces."""

    def __init__(
        self,
        spec: RigidModel,
        begin: float,
        bodies: RigidBodies,
        joints: Joints,
        colliders: Colliders,
        forces: Sequence[Force] = (),
        stage_colliders: Sequence[Collider] = (),
    ) -> None:
        """Start at a time [s]; ``stage_colliders`` come after those of bodies."""
        self._spec, self._begin = spec, begin
        self.bodies, self.joints = bodies, joints
        self._active_sets = ActiveSets(bodies, joints, colliders, stage_colliders)
        self._forces = BodyForces(bodies, forces, begin)
        self._force_solver = StepForceSolver(spec.name, bodies, self._forces)
        last_set = self._active_sets.active_set(
            self._active_sets.last_index, np.zeros(0, np.bool_)
        )
        self._colliders = last_set.surroundings.colliders
        self._locked_notices = locked_notices(joints, bodies)
        self._size_notices = half_size_notices(bodies, colliders)
        self._coincident_pairs = coincident_pairs(bodies, joints)
        self._kernel_settings = (
            spec.methods.index(spec.method),
            spec.substeps,
            spec.iterations,
            spec.residual,
            spec.sleep.speed,
            spec.sleep.time,
        )

    def initial_state(self) -> RigidState:
        """Return all bodies at the start, without contacts or broken joints."""
        count = len(self.joints)
        return RigidState(
            self.bodies.initial_states,
            np.zeros((0, 2), np.int64),
            np.zeros((0, 6)),
            np.zeros((count, 12)),
            np.zeros(2),
            np.full((2, 2), -1),
            np.tile([np.inf, 0.0, 0.0], (count if self.joints.is_breakable else 0, 1)),
            awake=len(self.bodies.dynamic_indices),
        )

    def incompatibility(self, state: RigidState, t: float) -> str:
        """Return why a saved state cannot be resumed; empty if it can."""
        del t
        quaternion_lengths = np.linalg.norm(
            np.clip(state.motion[:, 3:7], -2, 2), axis=1
        )
        if not (quaternion_lengths > 0.5).all():
            return "the orientation of a body is not a rotation"
        joint = state.fastest_drive_joint
        if joint >= len(self.joints):
            return f"there is no joint {joint} with an oscillating drive"
        pairs, count = state.deepest_pairs, len(self._shape_names())
        if pairs.size and not -1 <= pairs.min() <= pairs.max() < count:
            return f"a shape that penetrates another is outside the {count}"
        return ""

    def step(self, state: RigidState, t: float, dt: float) -> RigidState:
        """Return the state after a step [s], in the substeps that forces require."""
        substep_count = self._force_solver.required_substep_count(t, dt, state.motion)
        if self._forces.is_variable:
            is_constrained = self._is_constrained(state, t, dt)
            substep_count = self._force_solver.constrained_substep_count(
                t, dt, substep_count, state.motion, is_constrained
            )
        while True:
            next_state, required_substep_count = self._take_substeps(
                state, t, dt, substep_count
            )
            if required_substep_count == substep_count:
                return next_state
            substep_count = required_substep_count

    def _take_substeps(
        self, state: RigidState, t: float, dt: float, substep_count: int
    ) -> tuple[RigidState, int]:
        """Return the state after substeps, and the number of substeps needed.

        More are needed if a body in free flight with drag hits something.
        """
        substep = dt / substep_count
        for k in range(substep_count):
            time, motion = t + k * substep, state.motion
            is_constrained = self._is_constrained(state, time, substep)
            solver = self._force_solver
            flight = solver.free_flight(time, substep, motion)
            forces = solver.step_forces(time, substep, motion, is_constrained, flight)
            next_state = self._solve(state, forces, time, substep)
            is_hit = forces.unexpected_contacts(
                next_state.motion[:, 7:10], is_constrained
            )
            if is_hit.any():
                assert flight is not None
                required_substep_count = substeps_for_mass_factors(
                    substep_count, flight.mass_factors[is_hit]
                )
                if required_substep_count > substep_count:
                    return state, required_substep_count
                is_constrained = is_constrained | is_hit
                forces = solver.step_forces(
                    time, substep, motion, is_constrained, flight
                )
                next_state = self._solve(state, forces, time, substep)
            state = next_state
        return state, substep_count

    def _current_set(self, state: RigidState, t: float, dt: float) -> ActiveSet:
        """Return the active set of a step that starts at a time [s]."""
        is_broken = np.isfinite(state.broken[:, 0])
        return self._active_sets.active_set(
            self._active_sets.set_index(t, dt), is_broken
        )

    def _is_constrained(self, state: RigidState, t: float, dt: float) -> BoolArray:
        """Return a mask of bodies with contacts or joints, or asleep ``(N,)``."""
        is_constrained = state.motion[:, 13] >= self._spec.sleep.time
        if not self._forces.is_variable:
            return is_constrained
        active_set = self._current_set(state, t - dt, dt)
        owners = np.append(self.bodies.cores_and_bodies[1], -1)
        pressing_pairs = state.pairs[state.contacts[:, 3:].any(axis=1)]
        pressing_shapes = active_set.full_shape_indices(pressing_pairs)
        body_indices = owners[np.minimum(pressing_shapes, len(owners) - 1)].ravel()
        joint_bodies = self.joints.kinds_and_bodies[:, 1:]
        body_indices = np.concatenate([body_indices, joint_bodies.ravel()])
        is_constrained[body_indices[body_indices >= 0]] = True
        return is_constrained

    def _solve(
        self, state: RigidState, step_forces: StepForces, t: float, dt: float
    ) -> RigidState:
        """Return the state after a substep with contacts and joints."""
        motion = self._wake_sleepers(state.motion, step_forces, t, dt)
        if step_forces.velocities is not None:
            motion = motion.copy()
            motion[:, 7:10] = step_forces.velocities
        active_set = self._current_set(state, t, dt)
        is_same_set = active_set.set_index == self._active_sets.set_index(t - dt, dt)
        is_free = active_set.is_free
        kernel_result = _kernels.step_rigid(
            self._kernel_arrays(active_set, step_forces, t + dt),
            motion[is_free],
            state.pairs if is_same_set else state.pairs[:0],
            state.contacts if is_same_set else state.contacts[:0],
            state.held[active_set.intact_joints],
            step_forces.forces[is_free],
            active_set.surroundings.kernel_arrays(t, t + dt),
            active_set.joints.anchor_frames(t, t + dt),
            dt,
            *self._kernel_settings,
        )
        next_motion, pairs, contacts, impulses, depth, residual, pressing = (
            kernel_result[:7]
        )
        awake = kernel_result[8]
        if not is_free.all():
            motion = motion.copy()
            motion[is_free] = next_motion
            for i in np.flatnonzero(~is_free).tolist():
                motion[i] = self.bodies.kinematic_state(i, t + dt, dt)
            next_motion = motion
        self._check_bounds(next_motion, t + dt)
        deepest, deepest_pairs = state.deepest.copy(), state.deepest_pairs.copy()
        for k, is_deeper in enumerate((depth > deepest[0], t == self._begin)):
            if is_deeper:
                pair = np.array(kernel_result[10:12])
                full_pair = active_set.full_shape_indices(pair)
                deepest[k] = depth
                deepest_pairs[k] = np.where(pair < 0, pair, full_pair)
        broken, impulses = self._break_joints(state, active_set, impulses, t + dt)
        max_step, oscillating_joint = (
            kernel_result[12] * self._spec.step / dt,
            kernel_result[13],
        )
        is_faster = state.fastest_drive_joint < 0 or max_step < state.max_drive_step
        is_worse = oscillating_joint >= 0 and is_faster
        return RigidState(
            next_motion,
            pairs,
            contacts,
            impulses,
            deepest,
            deepest_pairs,
            broken,
            pressing,
            awake,
            residual,
            max_step if is_worse else state.max_drive_step,
            int(active_set.intact_joints[oscillating_joint])
            if is_worse
            else state.fastest_drive_joint,
        )

    def _check_bounds(self, motion: FloatArray, t: float) -> None:
        """Raise SIM102 if a state is not finite or out of bounds."""
        is_finite = np.abs(motion[:, :10]).max(axis=1, initial=0.0) <= MAX_POSITION
        is_finite &= np.abs(motion[:, 10:13]).max(axis=1, initial=0.0) <= MAX_MOMENTUM
        if is_finite.all():
            return
        first_diverged = int(np.flatnonzero(~is_finite)[0])
        name = self.bodies.names[self.bodies.dynamic_indices[first_diverged]]
        scaled_velocity = motion[first_diverged, 7:10] / MAX_POSITION
        speed = float(np.linalg.norm(scaled_velocity)) * MAX_POSITION
        message = f"{self._spec.name} blew up at {t:g} s: {name!r} is at {speed:g} m/s"
        step = plain_number(floor_to_two_digits(self._spec.step / 2))
        hint = f"do joints start within their limits? if so, use step: {step}"
        raise ToleranceError(Fault("SIM102", message, hint=hint))

    def _kernel_arrays(
        self, active_set: ActiveSet, step_forces: StepForces, t: float
    ) -> Any:
        """Return the kernel object with current drives and mass factors."""
        drive_parameters_at = self.joints.drive_parameters_at
        mass_factors = step_forces.mass_factors
        if drive_parameters_at is None and mass_factors is None:
            return active_set.kernel
        parameters = active_set.joints.parameters
        if drive_parameters_at is not None:
            parameters = drive_parameters_at(t)[active_set.intact_joints]
        free_factors = 1.0 if mass_factors is None else mass_factors[active_set.is_free]
        return active_set.with_parameters(parameters, free_factors)

    def _break_joints(
        self, state: RigidState, active_set: ActiveSet, impulses: FloatArray, t: float
    ) -> tuple[FloatArray, FloatArray]:
        """Return break times and loads ``(K, 3)``, and the impulses of all joints."""
        all_impulses = impulses
        if len(active_set.intact_joints) < len(self.joints):
            all_impulses = np.zeros_like(state.held)
            all_impulses[active_set.intact_joints] = impulses
        if not len(state.broken):
            return state.broken, all_impulses
        forces_and_torques = joint_forces_and_torques(active_set.joints, impulses)
        is_broken = (forces_and_torques > active_set.joints.break_limits).any(axis=1)
        break_rows = state.broken.copy()
        break_rows[active_set.intact_joints[is_broken], 0] = t
        break_rows[active_set.intact_joints[is_broken], 1:] = forces_and_torques[
            is_broken
        ]
        return break_rows, all_impulses

    def _wake_sleepers(
        self, motion: FloatArray, step_forces: StepForces, t: float, dt: float
    ) -> FloatArray:
        """Return body states ``(N, 14)``; sleeping bodies wake where forces change."""
        is_asleep = motion[:, 13] >= self._spec.sleep.time
        if not is_asleep.any():
            return motion
        forces = step_forces.forces
        if self._forces.is_variable:
            forces = self._forces.step_wrenches(t, dt, motion)
        is_woken = is_asleep & self._forces.has_changed(forces, t, dt, motion)
        if not is_woken.any():
            return motion
        motion = motion.copy()
        motion[is_woken, 13] = 0.0
        return motion

    def frame(self, state: RigidState, t: float) -> TransformsFrame:
        """Return the poses and velocities of all bodies."""
        bodies, motion = self.bodies, state.motion
        count = len(bodies.names)
        points, velocities, spins = np.zeros((3, count, 3))
        rotations = np.tile(so3.IDENTITY, (count, 1))
        dynamic_indices = bodies.dynamic_indices
        points[dynamic_indices], rotations[dynamic_indices] = bodies.body_frames(motion)
        spins[dynamic_indices] = bodies.spins(motion)
        centre_offsets = points[dynamic_indices] - motion[:, :3]
        velocities[dynamic_indices] = motion[:, 7:10] + so3.cross(
            spins[dynamic_indices], centre_offsets
        )
        for i in np.flatnonzero(~bodies.is_dynamic).tolist():
            pose, step = bodies.poses[i].at(t), self._spec.step
            earlier_pose = bodies.poses[i].at(t - step / 2)
            later_pose = bodies.poses[i].at(t + step / 2)
            points[i], rotations[i] = pose[:3], pose[3:]
            velocities[i] = (later_pose[:3] - earlier_pose[:3]) / step
            rotation = so3.multiply(later_pose[3:], so3.conjugate(earlier_pose[3:]))
            spins[i] = so3.log(rotation) / step
        return TransformsFrame(
            np.arange(count),
            points,
            velocities,
            rotations,
            spins,
            np.ones((count, 3)),
            bodies.kind_of_body,
            tuple(kind.mesh for kind in bodies.kinds),
            names=tuple(bodies.names),
            xforms=self._spec.prims == "xforms",
            static=bodies.static_bodies,
            physics=self._physics,
        )

    def is_free(self, t: float) -> BoolArray:
        """Return a mask of bodies dynamic at and after a time [s] ``(count,)``."""
        return self._active_sets.is_free(t, self._spec.step)

    @cached_property
    def _physics(self) -> Physics | None:
        """The UsdPhysics records to write, if requested."""
        if not self._spec.physics:
            return None
        forces = self._forces.forces
        return physics_record(self.bodies, self.joints, self._colliders, forces)

    def energy(self, state: RigidState) -> Energy:
        """Return kinetic energy, and potential energy of conservative forces."""
        bodies, motion = self.bodies, state.motion
        local_momenta = so3.rotate(so3.conjugate(motion[:, 3:7]), motion[:, 10:13])
        kinetic = 0.5 * float(bodies.masses @ (motion[:, 7:10] ** 2).sum(axis=1))
        kinetic += 0.5 * float((local_momenta**2 * bodies.inverse_inertias).sum())
        return Energy(kinetic, self._forces.potential(motion))

    def diagnostics(self, state: RigidState, t: float) -> Diagnostics:  # noqa: ARG002
        """Return energy, contacts and penetration depths."""
        values = {
            "bodies": float(len(self.bodies.names)),
            "awake": float(state.awake),
            "contacts": float(state.pressing),
            "deepest": float(state.deepest[0]),
            "residual": state.residual,
        }
        notices = [*self.joints.notices, *self._locked_notices, *self._size_notices]
        notices += coincident_notices(self.bodies, self._coincident_pairs)
        notices += self._colliders.notices()
        notices += oscillation_notices(state, self.joints, self._spec.step)
        for kind in self.bodies.kinds:
            notices += kind.notices
        notices += break_notices(state, self.joints)
        min_radius = float(self.bodies.bounding_radii.min(initial=np.inf))
        body_names = self.bodies.names
        reported_pairs = [
            {body_names[i], body_names[j]} for i, j in self._coincident_pairs
        ]
        notices += depth_notices(state, min_radius, self._shape_names, reported_pairs)
        return Diagnostics(self.energy(state), values, notices)

    def _shape_names(self) -> list[str]:
        """Return the body name of each shape, followed by the collider names."""
        bodies, colliders = self.bodies, self._colliders
        shape_names = [
            bodies.names[bodies.dynamic_indices[i]] for i in bodies.cores_and_bodies[1]
        ]
        shape_names += [
            collider.name or f"colliders[{i}]" for i, collider in enumerate(colliders)
        ]
        shape_names += [sheet.name for sheet in colliders.sheets]
        return shape_names + [
            collider.name
            for system in colliders.bodies
            for collider in system.colliders
        ]
