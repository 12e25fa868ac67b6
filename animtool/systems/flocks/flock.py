"""Flock simulation: integrated members, shown as points or meshes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from animtool.core.array_types import FloatArray, IntArray
from animtool.core.errors import Fault
from animtool.core.record import dataclass
from animtool.maths import so3
from animtool.motion.frames import MeshFrame, PointsFrame, TransformsFrame
from animtool.sim.checks import check_supported
from animtool.sim.colliders import Box, Collider, Colliders, Poses
from animtool.sim.colliders.colliding import collide
from animtool.sim.equations import Equations
from animtool.sim.options import IntegrateOptions, check_options
from animtool.sim.system import SecondOrder
from animtool.systems.flocks.members import Members, check_species
from animtool.systems.flocks.rules import FlockRule, flocking, rules_of
from animtool.systems.flocks.spacing import FIRST_PASSES, Spacing
from animtool.systems.flocks.spec import DomainModel, FlocksModel
from animtool.systems.flocks.steering import (
    avoidance,
    goal_accelerations,
    kept_speeds,
    steered,
)
from animtool.systems.framework.interacting import integrated
from animtool.systems.framework.simulation import Diagnostics, SimContext
from animtool.systems.particles.emitter import uniforms
from animtool.systems.particles.forces.base import Force

GRAVITY = 9.81  # [m/s²]
# Time constant of banking [s].
LEANING = 0.15
_UP = np.array([0.0, 1.0, 0.0])
_TINY = 1e-9  # shorter vectors have no direction


@dataclass(frozen=True, slots=True)
class Heading:
    """Orientations of N members: z forward, y up."""

    rotations: FloatArray  # unit quaternions x, y, z, w (N, 4)
    spins: FloatArray  # angular velocities, in the world (N, 3) [rad/s]
    phases: FloatArray  # cycles of the shown animation so far (N,)


def first_heading(members: Members, v: FloatArray) -> Heading:
    """Return initial orientations for velocities ``(N, 3)`` [m/s]."""
    count = len(v)
    identity = np.broadcast_to(so3.IDENTITY, (count, 4))
    phases = [
        uniforms(species.seed, np.arange(rows.stop - rows.start), 1)[:, 0]
        for species, rows in zip(members.entries, members.parted, strict=True)
    ]
    return Heading(
        _along(identity, v, _UP), np.zeros((count, 3)), np.concatenate(phases)
    )


def next_heading(
    members: Members, heading: Heading, v0: FloatArray, v1: FloatArray, dt: float
) -> Heading:
    """Return orientations after a step [s]: ``v0`` and ``v1`` ``(N, 3)``.

    What carries a wing is at right angles to the way, and makes up for gravity and for
    the turn: so is the up that they lean to.
    """
    banking = members.each([one.banking for one in members.entries])[:, None]
    lift = banking * (v1 - v0) / dt + GRAVITY * _UP
    up = so3.rotate(heading.rotations, _UP)
    # Across the velocity; along it is speed gain.
    directions = v1 / np.maximum(np.linalg.norm(v1, axis=1), _TINY)[:, None]
    lift = lift - (lift * directions).sum(axis=1)[:, None] * directions
    size = np.linalg.norm(lift, axis=1)[:, None]
    leaned = up + (lift / np.maximum(size, _TINY) - up) * -np.expm1(-dt / LEANING)
    turned = _along(heading.rotations, v1, np.where(size > _TINY, leaned, up))
    rotations = so3.align_signs(turned[None], heading.rotations)[0]
    change = so3.multiply(rotations, so3.conjugate(heading.rotations))
    spins = so3.log(change) / dt
    beats = members.each([one.beat / one.speed.cruise for one in members.entries])
    speeds = (np.linalg.norm(v0, axis=1) + np.linalg.norm(v1, axis=1)) / 2
    return Heading(rotations, spins, heading.phases + beats * speeds * dt)


def _along(before: FloatArray, v: FloatArray, up: FloatArray) -> FloatArray:
    """Return rotations ``(N, 4)`` with z along velocities, and y near an up vector.

    Members at rest keep their rotation.
    """
    speeds = np.linalg.norm(v, axis=1)[:, None]
    forward = v / np.maximum(speeds, _TINY)
    side = so3.cross(np.broadcast_to(up, v.shape), forward)
    # Straight up or down, it keeps its right side.
    size = np.linalg.norm(side, axis=1)[:, None]
    right = so3.rotate(before, np.array([1.0, 0.0, 0.0]))
    right = right - (right * forward).sum(axis=1)[:, None] * forward
    side = np.where(size > 1e-6, side / np.maximum(size, _TINY), right)
    side = side / np.maximum(np.linalg.norm(side, axis=1)[:, None], _TINY)
    axes = np.stack([side, so3.cross(forward, side), forward], axis=-1)
    return np.where(speeds > _TINY, so3.from_matrix(axes), before)


def shown(members: Members, meshes: IntArray, phases: FloatArray) -> IntArray:
    """Return the mesh index of each member ``(N,)``, by its species and phase.

    ``meshes``: first of each species, and how many it has ``(S, 2)``.
    """
    first, counts = meshes[members.kinds].T
    return np.asarray(
        first + np.floor((phases % 1.0) * counts).astype(np.int64) % counts
    )


@dataclass(frozen=True, slots=True)
class FlockState:
    """Positions, velocities and orientations of members."""

    motion: FloatArray  # positions [m], then velocities [m/s] (2, N, 3)
    heading: Heading | None  # None if points are shown


@dataclass(frozen=True)
class FlockForces(SecondOrder):
    """N members as a second-order system."""

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
        """The initial state."""
        return self.motion

    def acceleration(self, t: float, x: FloatArray, v: FloatArray) -> FloatArray:
        """Return accelerations ``(N, 3)`` [m/s²]."""
        members = self.members
        accelerations = flocking(self.rules, self.domain, x, v)
        accelerations += goal_accelerations(members, t, x, v)
        if self.colliders.rigid:
            accelerations += avoidance(members, self.colliders, t, x, v)
        accelerations = steered(members, v, accelerations)
        if self.forces:
            particles = members.particles
            pushed = sum(force.force(t, x, v, particles) for force in self.forces)
            accelerations = accelerations + pushed / particles.masses[:, None]
        return accelerations

    def settle(
        self, t: float, h: float, before: FloatArray, after: FloatArray
    ) -> FloatArray:
        """Return the state within speed limits, spacing and colliders."""
        x, v = after[0], after[1]
        if self.spacing is not None:
            v = self._braked(h, before[1], x, v)
            x, _ = self.spacing.separated(x)
        v = kept_speeds(self.members, v)
        if self.colliders.active:
            radii = self.members.radii
            done = collide(x, v, before, self.colliders, t - h, t, radii)
            x, v = done.points, done.velocities
        return after if x is after[0] and v is after[1] else np.stack([x, v])

    def _braked(
        self, h: float, before: FloatArray, x: FloatArray, v: FloatArray
    ) -> FloatArray:
        """Return velocities after braking for others ``(N, 3)``."""
        assert self.spacing is not None
        brakes = self.spacing.braking(x, v)
        braking = steered(self.members, before, (v - before) / h + brakes)
        acts = (brakes != 0).any(axis=1, keepdims=True)
        return np.where(acts, before + h * braking, v)


def build(spec: FlocksModel, context: SimContext) -> Flock:
    """Return the flock of a spec, its members apart and out of colliders.

    Raises:
        OptionError: Something of the spec makes no sense (SIM001, SIM005, SIM006,
            SIM060).
    """
    check_species(spec)
    options = IntegrateOptions(spec.method, spec.step, spec.tolerance)
    integrator, colliders = check_options(options), context.colliders
    if spec.domain is not None and not spec.domain.wrap:
        walls = Collider(
            Box(spec.domain.size),
            Poses.fixed(spec.domain.at),
            name="domain",
            container=True,
        )
        colliders = Colliders([*colliders, walls], colliders.sheets, colliders.bodies)
    parts = context.parts["species"]
    members = Members.of(spec, parts, context.begin)
    spacing = Spacing.of(members, spec.domain)
    points, notices = members.outside(colliders)
    if spacing is not None:
        points, overlap = spacing.separated(points, FIRST_PASSES)
        notices += members.spread(points, overlap)
        points, _ = replace(members, points=points).outside(colliders)
    system = FlockForces(
        members,
        spec.domain,
        colliders,
        context.parts.get("forces", ()),
        rules_of(members),
        wrapped(np.stack([points, members.velocities]), spec.domain),
        spacing,
    )
    check_supported(Equations(system), integrator)
    shows = [part.get("shows") for part in parts]
    # Species with the same meshes share them.
    cycles = {show: show() for show in shows if show is not None}
    ends = dict(zip(cycles, np.cumsum([len(c) for c in cycles.values()]), strict=True))
    return Flock(
        system,
        options,
        notices,
        tuple(mesh for cycle in cycles.values() for mesh in cycle),
        np.array(
            [(ends[s] - len(cycles[s]), len(cycles[s])) if s else (0, 0) for s in shows]
        ),
    )


def wrapped(motion: FloatArray, domain: DomainModel | None) -> FloatArray:
    """Return a motion ``(2, N, 3)`` with positions wrapped into a periodic domain."""
    if domain is None or not domain.wrap:
        return motion
    size = np.array(domain.size)
    low = np.array(domain.at) - size / 2
    wraps = np.floor((motion[0] - low) / size)
    return np.stack([motion[0] - wraps * size, motion[1]]) if wraps.any() else motion


@dataclass(frozen=True, eq=False)
class Flock:
    """A flock, in steps."""

    system: FlockForces  # members and their forces at the start
    options: IntegrateOptions
    notices: Sequence[Fault]
    meshes: tuple[MeshFrame, ...]  # of all species
    shown: IntArray  # first mesh and number of meshes of each species (S, 2)

    def initial(self) -> FlockState:
        """Return the initial state."""
        motion = self.system.motion
        if not self.meshes:
            return FlockState(motion, None)
        return FlockState(motion, first_heading(self.system.members, motion[1]))

    def step(self, state: FlockState, t: float, dt: float) -> FlockState:
        """Return the state after a step [s].

        Raises:
            StoppedError: The method could not go on (SIM102 to SIM105).
        """
        system = replace(self.system, motion=state.motion)
        motion = integrated(system, replace(self.options, step=dt), t, dt)
        heading = state.heading
        if heading is not None:
            heading = next_heading(
                self.system.members, heading, state.motion[1], motion[1], dt
            )
        return FlockState(wrapped(motion, system.domain), heading)

    def frame(self, state: FlockState, t: float) -> PointsFrame | TransformsFrame:  # noqa: ARG002
        """Return points and meshes at a time."""
        members, heading = self.system.members, state.heading
        points, velocities = state.motion
        ids = np.arange(len(members))
        several = len(members.entries) > 1
        primvars = {"species": members.kinds} if several else {}
        if heading is None:
            return PointsFrame(ids, points, velocities, members.radii, primvars)
        return TransformsFrame(
            ids,
            points,
            velocities,
            heading.rotations,
            heading.spins,
            np.ones((len(members), 3)),
            shown(members, self.shown, heading.phases),
            self.meshes,
            primvars,
        )

    def diagnostics(self, state: FlockState, t: float) -> Diagnostics:  # noqa: ARG002
        """Return speeds, and the order parameter (alignment) of members."""
        velocities = state.motion[1]
        speeds = np.linalg.norm(velocities, axis=1)
        moving = speeds > 0
        values = {"members": float(len(speeds))}
        if moving.any():
            directions = velocities[moving] / speeds[moving, None]
            values["speed"] = float(speeds.mean())
            values["order"] = float(np.linalg.norm(directions.mean(axis=0)))
        return Diagnostics(values=values, notices=self.notices)
