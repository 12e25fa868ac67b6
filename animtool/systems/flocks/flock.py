"""Flock simulation: integrated members, shown as points or meshes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from animtool.core.array_types import FloatArray, IntArray
from animtool.core.errors import Fault, refuse_all, warning
from animtool.core.quantities import plain_number
from animtool.core.record import dataclass
from animtool.maths import so3
from animtool.motion.frames import MeshFrame, PointsFrame, TransformsFrame
from animtool.sim.checks import check_supported
from animtool.sim.colliders import Box, Collider, Colliders, Poses
from animtool.sim.colliders.colliding import collide
from animtool.sim.equations import Equations
from animtool.sim.integrators.integrator import Integrator, StepControl, allowed_step
from animtool.sim.options import IntegrateOptions, checked_integrator
from animtool.sim.system import SecondOrder
from animtool.systems.flocks.members import Members, key_problems
from animtool.systems.flocks.rules import (
    START_PASSES,
    FlockRule,
    Spacing,
    build_rules,
    rule_accelerations,
)
from animtool.systems.flocks.spec import DomainModel, FlocksModel
from animtool.systems.flocks.steering import (
    avoidance_accelerations,
    clamp_speeds,
    goal_accelerations,
    limit_displacements,
    limit_steering,
)
from animtool.systems.framework.interacting import integrate_step
from animtool.systems.framework.simulation import Diagnostics, SimContext
from animtool.systems.particles.emitter import uniform_samples
from animtool.systems.particles.forces.base import Force

GRAVITY = 9.81  # [m/s²]
# Time constant of banking [s].
BANKING_TIME = 0.15
_UP = np.array([0.0, 1.0, 0.0])
_TINY_LENGTH = 1e-9  # shorter vectors have no direction


@dataclass(frozen=True, slots=True)
class MemberHeadings:
    """Orientations of N members: z forward, y up."""

    rotations: FloatArray  # unit quaternions x, y, z, w (N, 4)
    spins: FloatArray  # world angular velocities (N, 3) [rad/s]
    phases: FloatArray  # animation cycles so far (N,)


def initial_headings(members: Members, v: FloatArray) -> MemberHeadings:
    """Return the initial orientations of members with velocities ``(N, 3)`` [m/s]."""
    count = len(v)
    identity = np.broadcast_to(so3.IDENTITY, (count, 4))
    phases = [
        uniform_samples(
            species.seed, np.arange(member_range.stop - member_range.start), 1
        )[:, 0]
        for species, member_range in zip(
            members.entries, members.ranges_by_entry, strict=True
        )
    ]
    return MemberHeadings(
        _look_rotations(identity, v, _UP), np.zeros((count, 3)), np.concatenate(phases)
    )


def advance_headings(
    members: Members,
    headings: MemberHeadings,
    start_velocities: FloatArray,
    end_velocities: FloatArray,
    dt: float,
) -> MemberHeadings:
    """Return orientations after a step [s] with velocities ``(N, 3)`` at both ends.

    Members bank like aircraft: their up vector follows the lift. It is perpendicular to
    the velocity, and balances gravity and the centripetal acceleration.
    """
    banking_factors = members.repeat_per_individual(
        [entry.banking for entry in members.entries]
    )
    accelerations = banking_factors[:, None] * (end_velocities - start_velocities) / dt
    lift = accelerations + GRAVITY * _UP
    up = so3.rotate(headings.rotations, _UP)
    # Only the component perpendicular to the velocity is lift.
    end_speeds = np.linalg.norm(end_velocities, axis=1)
    directions = end_velocities / np.maximum(end_speeds, _TINY_LENGTH)[:, None]
    lift = lift - (lift * directions).sum(axis=1)[:, None] * directions
    length = np.linalg.norm(lift, axis=1)[:, None]
    correction = lift / np.maximum(length, _TINY_LENGTH) - up
    banked_up = up + correction * -np.expm1(-dt / BANKING_TIME)
    banked_up = np.where(length > _TINY_LENGTH, banked_up, up)
    look_rotations = _look_rotations(headings.rotations, end_velocities, banked_up)
    rotations = so3.align_signs(look_rotations[None], headings.rotations)[0]
    step_rotation = so3.multiply(rotations, so3.conjugate(headings.rotations))
    spins = so3.log(step_rotation) / dt
    cycles_per_metre = members.repeat_per_individual(
        [entry.beat / entry.speed.cruise for entry in members.entries]
    )
    speeds = (np.linalg.norm(start_velocities, axis=1) + end_speeds) / 2
    phases = headings.phases + cycles_per_metre * speeds * dt
    return MemberHeadings(rotations, spins, phases)


def _look_rotations(
    previous_rotations: FloatArray, v: FloatArray, up: FloatArray
) -> FloatArray:
    """Return rotations ``(N, 4)`` with z along velocities and y near an up vector.

    Members at rest keep their rotation.
    """
    speeds = np.linalg.norm(v, axis=1)[:, None]
    forward = v / np.maximum(speeds, _TINY_LENGTH)
    left = so3.cross(np.broadcast_to(up, v.shape), forward)
    # In vertical flight, members keep their left axis.
    length = np.linalg.norm(left, axis=1)[:, None]
    previous_left = so3.rotate(previous_rotations, np.array([1.0, 0.0, 0.0]))
    previous_left -= (previous_left * forward).sum(axis=1)[:, None] * forward
    unit_left = left / np.maximum(length, _TINY_LENGTH)
    left = np.where(length > 1e-6, unit_left, previous_left)
    left = left / np.maximum(np.linalg.norm(left, axis=1)[:, None], _TINY_LENGTH)
    axes = np.stack([left, so3.cross(forward, left), forward], axis=-1)
    return np.where(speeds > _TINY_LENGTH, so3.from_matrix(axes), previous_rotations)


def mesh_indices(
    members: Members, mesh_ranges: IntArray, phases: FloatArray
) -> IntArray:
    """Return the mesh index of each member, by species and animation phase ``(N,)``.

    ``mesh_ranges`` has the first mesh and the number of meshes of each species
    ``(S, 2)``.
    """
    first_meshes, counts = mesh_ranges[members.entry_indices].T
    frame_indices = np.floor((phases % 1.0) * counts).astype(np.int64)
    return np.asarray(first_meshes + frame_indices % counts)


@dataclass(frozen=True, slots=True)
class FlockState:
    """State of the members of a flock."""

    motion: FloatArray  # positions [m], then velocities [m/s] (2, N, 3)
    heading: MemberHeadings | None  # orientations; None if members are shown as points


@dataclass(frozen=True)
class FlockForces(SecondOrder):
    """Members of a flock as a second-order system."""

    members: Members
    domain: DomainModel | None
    colliders: Colliders
    forces: Sequence[Force]
    rules: Sequence[FlockRule]
    motion: FloatArray  # (2, N, 3)
    spacing: Spacing | None = None
    settles = True

    @property
    def state(self) -> FloatArray:
        """Initial positions and velocities ``(2, N, 3)``."""
        return self.motion

    def acceleration(self, t: float, x: FloatArray, v: FloatArray) -> FloatArray:
        """Return accelerations ``(N, 3)`` [m/s²]."""
        members = self.members
        accelerations = rule_accelerations(self.rules, self.domain, x, v)
        accelerations += goal_accelerations(members, t, x, v)
        if self.colliders.rigid_colliders:
            accelerations += avoidance_accelerations(members, self.colliders, t, x, v)
        accelerations = limit_steering(members, v, accelerations)
        if self.forces:
            particles = members.particles
            external_forces = sum(
                force.force(t, x, v, particles) for force in self.forces
            )
            accelerations = accelerations + external_forces / particles.masses[:, None]
        return accelerations

    def settle(
        self, t: float, h: float, before: FloatArray, after: FloatArray
    ) -> FloatArray:
        """Return the state after speed limits, spacing and collisions."""
        positions, velocities = after[0], after[1]
        if self.spacing is not None:
            velocities = self._brake_velocities(h, before[1], positions, velocities)
            positions, _ = self.spacing.separate(positions)
        velocities = clamp_speeds(self.members, velocities)
        positions = limit_displacements(self.members, before[0], positions, h)
        if self.colliders.has_any:
            radii = self.members.radii
            collision = collide(
                positions, velocities, before, self.colliders, t - h, t, radii
            )
            positions, velocities = collision.points, collision.velocities
        if positions is after[0] and velocities is after[1]:
            return after
        return np.stack([positions, velocities])

    def _brake_velocities(
        self, h: float, before: FloatArray, x: FloatArray, v: FloatArray
    ) -> FloatArray:
        """Return velocities ``(N, 3)`` after braking for members ahead."""
        assert self.spacing is not None
        brakes = self.spacing.braking_accelerations(x, v)
        accelerations = limit_steering(self.members, before, (v - before) / h + brakes)
        is_braking = (brakes != 0).any(axis=1, keepdims=True)
        return np.where(is_braking, before + h * accelerations, v)


def build(spec: FlocksModel, context: SimContext) -> Flock:
    """Build the flock of a spec; members start apart and outside of colliders.

    Raises SIM001, SIM005, SIM006 or SIM060 if the spec is invalid.
    """
    refuse_all("SIM060", key_problems(spec))
    options = IntegrateOptions(spec.method, spec.step, spec.tolerance)
    integrator, colliders = checked_integrator(options), context.colliders
    if spec.domain is not None and not spec.domain.wrap:
        domain_walls = Collider(
            Box(spec.domain.size),
            Poses.fixed(spec.domain.at),
            name="domain",
            container=True,
        )
        colliders = Colliders(
            [*colliders, domain_walls], colliders.sheets, colliders.bodies
        )
    species_data = context.entry_data["species"]
    members = Members.from_spec(spec, species_data, context.begin)
    spacing = Spacing.for_members(members, spec.domain)
    points, notices = members.clear_positions(colliders, spec.domain)
    if spacing is not None:
        points, overlap = spacing.separate(points, START_PASSES)
        # Members that were moved to a surface are close to each other there.
        notices = notices or members.separation_notices(points, overlap)
        points, _ = replace(members, points=points).clear_positions(colliders)
    system = FlockForces(
        members,
        spec.domain,
        colliders,
        context.entry_data.get("forces", ()),
        build_rules(members),
        wrap_motion(np.stack([points, members.velocities]), spec.domain),
        spacing,
    )
    check_supported(Equations(system), integrator)
    notices += stability_notices(spec, integrator)
    mesh_sources = [data.get("shows") for data in species_data]
    # Species that show the same meshes share them.
    meshes: list[MeshFrame] = []
    mesh_ranges = {None: (0, 0)}
    for source in dict.fromkeys(mesh_sources):
        if source is not None:
            cycle_meshes = source()
            mesh_ranges[source] = len(meshes), len(cycle_meshes)
            meshes += cycle_meshes
    mesh_ranges_by_species = np.array([mesh_ranges[source] for source in mesh_sources])
    return Flock(system, options, notices, tuple(meshes), mesh_ranges_by_species)


def stability_notices(spec: FlocksModel, integrator: Integrator) -> list[Fault]:
    """Return a warning about a speed rule that is too stiff for the step (SIM101)."""
    if integrator.control is not StepControl.FIXED:
        return []
    speed_rates = [2 * s.speed.weight * s.speed.cruise**2 for s in spec.species]
    stable_step = allowed_step(integrator, np.array([[max(speed_rates), 1.0]]))
    if stable_step is None or spec.step <= stable_step:
        return []
    species = spec.species[speed_rates.index(max(speed_rates))]
    weight = species.speed.weight * stable_step / spec.step
    message = f"{integrator.name} is not stable with steps of "
    message += f"{plain_number(spec.step)} s: {species.name!r} reaches its cruise of "
    message += (
        f"{species.speed.cruise:g} m/s within {plain_number(1 / max(speed_rates))} s"
    )
    hint = f"write step: {stable_step:.2g}, or a speed with weight: {weight:.2g}"
    return [warning("SIM101", message, hint)]


def wrap_motion(motion: FloatArray, domain: DomainModel | None) -> FloatArray:
    """Return a motion ``(2, N, 3)`` with positions wrapped into a periodic domain."""
    if domain is None or not domain.wrap:
        return motion
    size = np.array(domain.size)
    low = np.array(domain.at) - size / 2
    wrap_counts = np.floor((motion[0] - low) / size)
    if wrap_counts.any():
        return np.stack([motion[0] - wrap_counts * size, motion[1]])
    return motion


@dataclass(frozen=True, eq=False)
class Flock:
    """Simulates a flock."""

    system: FlockForces  # members and their forces at the start
    options: IntegrateOptions
    notices: Sequence[Fault]
    meshes: tuple[MeshFrame, ...]  # meshes of all species
    mesh_ranges: IntArray  # first mesh and number of meshes of each species (S, 2)

    def initial_state(self) -> FlockState:
        """Return the members at the start, with headings if they are meshes."""
        motion = self.system.motion
        if not self.meshes:
            return FlockState(motion, None)
        return FlockState(motion, initial_headings(self.system.members, motion[1]))

    def step(self, state: FlockState, t: float, dt: float) -> FlockState:
        """Return the state after a step [s]."""
        system = replace(self.system, motion=state.motion)
        motion = integrate_step(system, replace(self.options, step=dt), t, dt)
        heading = state.heading
        if heading is not None:
            heading = advance_headings(
                self.system.members, heading, state.motion[1], motion[1], dt
            )
        return FlockState(wrap_motion(motion, system.domain), heading)

    def frame(self, state: FlockState, t: float) -> PointsFrame | TransformsFrame:  # noqa: ARG002
        """Return members as points or meshes."""
        members, heading = self.system.members, state.heading
        points, velocities = state.motion
        ids = np.arange(len(members))
        has_many_species = len(members.entries) > 1
        primvars = {"species": members.entry_indices} if has_many_species else {}
        if heading is None:
            return PointsFrame(ids, points, velocities, members.radii, primvars)
        return TransformsFrame(
            ids,
            points,
            velocities,
            heading.rotations,
            heading.spins,
            np.ones((len(members), 3)),
            mesh_indices(members, self.mesh_ranges, heading.phases),
            self.meshes,
            primvars,
        )

    def diagnostics(self, state: FlockState, t: float) -> Diagnostics:  # noqa: ARG002
        """Return the number, speed and alignment (order parameter) of members."""
        velocities = state.motion[1]
        speeds = np.linalg.norm(velocities, axis=1)
        is_moving = speeds > 0
        values = {"members": float(len(speeds))}
        if is_moving.any():
            directions = velocities[is_moving] / speeds[is_moving, None]
            values["speed"] = float(speeds.mean())
            values["order"] = float(np.linalg.norm(directions.mean(axis=0)))
        return Diagnostics(values=values, notices=self.notices)
