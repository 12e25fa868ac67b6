"""Particles and springs as a system for integrators."""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from animtool import _kernels
from animtool.core.array_types import (
    ArrayLike,
    BoolArray,
    FloatArray,
    IntArray,
    as_floats,
)
from animtool.core.errors import Fault, refuse
from animtool.sim.colliders import Collider, Colliders, Contacts, collide
from animtool.sim.contact import SPEED_LIMIT
from animtool.sim.system import Energy, Matrix, NativeAdvance, SecondOrder
from animtool.systems.springs.body import (
    Body,
    PrescribedMotion,
    SpringForces,
    TargetSprings,
    TornFlags,
)
from animtool.systems.springs.body_coupling import BodyCoupling
from animtool.systems.springs.checks import (
    check_body,
    check_path,
    check_self_contact,
    coincident_notices,
    tangle_notices,
    thickness_notices,
)
from animtool.systems.springs.constraints import (
    Pins,
    PointTargets,
    Teleports,
    TimedPositions,
    max_speed_and_travel,
    position_at,
    resample_to_shared_times,
)
from animtool.systems.springs.jacobians import acceleration_jacobians, mode_bounds
from animtool.systems.springs.motion import at_rest
from animtool.systems.springs.records import Air, SelfContact

# Interval for estimating target velocities when no step is given [s].
TARGET_SPEED_INTERVAL = 1e-6
# Most steps in one kernel call.
MAX_STEPS_PER_CALL = 1 << 20


class _Stage(NamedTuple):
    """Paths of pins and targets between two teleports, and the kernel network."""

    teleport_count: int  # number of teleports before it
    pins: TimedPositions
    targets: TimedPositions
    network: _kernels.SpringNetwork


class SpringSystem(SecondOrder):
    """A body of springs with pins and targets, in gravity and air.

    A spring from a to b pulls with k (|d| - rest) + c (ḋ·d)/|d| along d = b - a, and
    not at all if its ends coincide. Only `simulate_springs` tears springs.

    Attributes:
        contacts: Contacts of the last step of `integrate`; None before it.

    Args:
        body: Particles, springs and triangles.
        pins: Pinned particles and their paths.
        targets: Points that pull particles.
        gravity: ``(3,)`` [m/s²].
        drag: Drag per mass and speed [1/s].
        resistance: Drag per speed, of each particle ``(N,)`` or all [N s/m].
        air: Air that acts on the triangles.
        velocities: At the start ``(N, 3)`` [m/s]; None is at rest.
        colliders: Colliders of the particles.
        radius: Distance that particles keep from colliders [m].
        speed_limit: Faster pins and targets count as teleports: attached particles move
            along rigidly and gain no velocity [m/s].
        self_contact: Self-contact of the triangles; None turns it off.

    Raises:
        OptionError: A body, pin or option is invalid (SIM004, SIM040 to SIM045), or a
            collider is (SIM020).

    >>> from animtool.systems.springs.shapes import rope
    >>> from animtool.systems.springs import Family
    >>> line = rope([0, 0, 0], [1, 0, 0], 3, Family(100.0), mass=0.5)
    >>> system = SpringSystem(line, pins=Pins([0]))
    >>> x, v = system.state
    >>> system.acceleration(0.0, x + [0, 0, 0], v)[1:, 2].tolist()
    [-9.81, -9.81]
    """

    velocity_dependent = True

    def __init__(
        self,
        body: Body,
        *,
        pins: Pins | None = None,
        targets: PointTargets | None = None,
        gravity: ArrayLike = (0.0, 0.0, -9.81),
        drag: float = 0.0,
        resistance: ArrayLike = 0.0,
        air: Air | None = None,
        velocities: ArrayLike | None = None,
        colliders: Sequence[Collider] = (),
        radius: float = 0.0,
        speed_limit: float = SPEED_LIMIT,
        self_contact: SelfContact | None = None,
    ) -> None:
        pins, air = pins or Pins(()), air or Air(drag=0.0, lift=0.0)
        targets = targets or PointTargets((), np.zeros((0, 3)), 0.0)
        self.pinned, target_particles = (
            np.asarray(constraints.particles, np.int64).reshape(-1)
            for constraints in (pins, targets)
        )
        check_body(body, self.pinned, target_particles)
        if not speed_limit > 0:
            message = f"speed_limit must be above 0, not {speed_limit:g}"
            refuse("SIM004", message, "speed_limit")
        if self_contact is not None:
            check_self_contact(self_contact, body)
        count = len(body.positions)
        self.body = body
        self.gravity = as_floats(gravity, (3,), "gravity")
        self.drag = float(drag)
        self.resistance = np.broadcast_to(np.asarray(resistance, np.float64), count)
        # Air drag and lift per area and squared speed.
        self.air_coefficients = (
            0.5 * air.density * air.drag,
            0.5 * air.density * air.lift,
        )
        wind_velocities = np.asarray(air.wind, np.float64)[..., None, :]
        self._wind_path = check_path("air", wind_velocities, air.times, 1)
        self.is_pinned: BoolArray = np.isin(np.arange(count), self.pinned)
        pinned_positions = (
            body.positions[self.pinned] if pins.positions is None else pins.positions
        )
        pin_path = check_path("pins", pinned_positions, pins.times, len(self.pinned))
        target_path = check_path(
            "targets", targets.positions, targets.times, len(target_particles)
        )
        stiffness, damping = (
            np.array(np.broadcast_to(value, target_particles.shape), np.float64)
            for value in (targets.stiffness, targets.damping)
        )
        self.target_springs = TargetSprings(target_particles, stiffness, damping)
        driven_particles = np.append(self.pinned, target_particles)
        self._constraint_paths = (pin_path, target_path)
        self.teleports = Teleports(
            body, driven_particles, self._constraint_paths, speed_limit
        )
        self._cached_stage: _Stage | None = None
        self.contacts: Contacts | None = None
        self.coupling: BodyCoupling | None = None  # pins on rigid bodies
        # Span of the last paths [s], and their positions of all particles.
        self.particle_path: tuple[float, FloatArray] = (0.0, np.zeros((0, count, 3)))
        # First index and count of colliders that segments of strands ignore.
        self.joint_colliders = (0, 0)
        self._kernel_strands: _kernels.SpringStrands | None = None
        self.colliders = (
            colliders if isinstance(colliders, Colliders) else Colliders(colliders)
        )
        self.radius, self.speed_limit = float(radius), float(speed_limit)
        self._has_moving_pins = len(pin_path[0]) > 1
        self.self_contact = self_contact
        requested_rest = None if self_contact is None else self_contact.rest
        rest_positions = body.positions if requested_rest is None else requested_rest
        self._rest = np.ascontiguousarray(rest_positions, np.float64)
        self._has_contacts = self.colliders.has_any or self_contact is not None
        has_teleports = len(self.teleports) > 0
        self.settles = self._has_moving_pins or self._has_contacts or has_teleports
        speeds = np.zeros((count, 3)) if velocities is None else velocities
        speeds = as_floats(speeds, (count, 3), "velocities")
        self._state = np.stack([body.positions, speeds])
        self._state[1, self.pinned] = 0.0

    @property
    def mean_rest_length(self) -> float:
        """Mean rest length of the springs [m]; 1 if all rest lengths are 0."""
        rest = self.body.springs.rest
        return float(rest.mean()) if rest.any() else 1.0

    def network(self, stage: int) -> _kernels.SpringNetwork:
        """Return the kernel network of a stage between teleports."""
        return self._stage(stage).network

    def set_constraint_paths(self, span: float, path: FloatArray) -> None:
        """Move pins and targets along a path over the next span of time [s].

        ``path`` has positions of all particles at even times ``(K, N, 3)`` [m], between
        which they are linear.
        """
        self.particle_path = span, path
        if self.body.strands:
            return
        knots = np.linspace(0.0, span, len(path))
        pins, targets = (
            (knots, np.ascontiguousarray(path[:, particles]))
            for particles in (self.pinned, self.target_springs.particles)
        )
        has_same_knots = np.array_equal(self._constraint_paths[0][0], knots)
        self._constraint_paths, stage = (pins, targets), self._cached_stage
        self._cached_stage = None
        if stage is not None and has_same_knots:
            stage.network.set_paths(pins[1], targets[1])
            self._cached_stage = _Stage(0, pins, targets, stage.network)

    def _stage(self, teleport_count: int) -> _Stage:
        """Return the paths and the kernel network of a stage, cached."""
        stage = self._cached_stage
        if stage is None or stage.teleport_count != teleport_count:
            has_teleports = len(self.teleports) > 0
            pins, targets = (
                self.teleports.stage_paths(teleport_count)
                if has_teleports
                else self._constraint_paths
            )
            knots, paths = resample_to_shared_times([pins, targets, self._wind_path])
            network = self._network(PrescribedMotion(knots, *paths))
            stage = self._cached_stage = _Stage(teleport_count, pins, targets, network)
        return stage

    def _network(self, prescribed: PrescribedMotion) -> _kernels.SpringNetwork:
        """Return the kernel network over paths, with springs in kernel order."""
        springs = self.body.springs.select(self.spring_order)
        return replace(self.forces, springs=springs).network(prescribed)

    def cell_network(
        self, stage: int, t0: float, t1: float
    ) -> tuple[_kernels.SpringNetwork, PrescribedMotion]:
        """Return the kernel network of a cell and its paths between two times [s].

        The paths have a knot at both ends of the cell, and at all knots between them.
        """
        stage_paths = self._stage(stage)
        paths = stage_paths.pins, stage_paths.targets, self._wind_path
        all_knots = np.unique(np.concatenate([times for times, _ in paths]))
        inner = all_knots[(all_knots > t0) & (all_knots < t1)]
        knots = np.concatenate([[t0], inner, [t1]])
        times = knots.tolist()
        positions = (np.array([position_at(path, t) for t in times]) for path in paths)
        cell_motion = PrescribedMotion(knots, *positions)
        return self._network(cell_motion), cell_motion

    @property
    def forces(self) -> SpringForces:
        """Properties of particles, springs and air that determine the forces."""
        return SpringForces(
            self.inverse_masses, self.drags, self.body.springs, self.body.triangles,
            self.gravity, self.air_coefficients, self.pinned, self.target_springs,
        )  # fmt: skip

    @cached_property
    def kernel_self_contact(self) -> _kernels.SpringLayers | None:
        """Kernel self-contact of the surface; None if it is off."""
        contact = self.self_contact
        if contact is None:
            return None
        settings = contact.thickness, contact.friction, contact.speed
        return _kernels.SpringLayers(self.network(0), self._rest, *settings)

    def kernel_strands(self, max_strain: float) -> _kernels.SpringStrands:
        """Return the kernel solver of strands.

        Strands that a step strains beyond a limit [1] are corrected once more.
        """
        if self._kernel_strands is None:
            springs, targets = self.body.springs, self.target_springs
            strands, stiffness = self.body.strands, springs.stiffness
            count = len(self.body.positions) // strands - 1
            sides, bends = np.split(springs.rest, [strands * count])
            has_bends = len(bends) > 0
            if not has_bends:
                bends = np.zeros(strands * max(count - 1, 0))
            inverse_mass = 1.0 / float(self.body.masses[0])
            self._kernel_strands = _kernels.SpringStrands(
                sides.reshape(strands, count),
                bends.reshape(strands, max(count - 1, 0)),
                gravity=self.gravity,
                drag=self.drag,
                stiffness=inverse_mass * float(stiffness[:1].sum()),
                fold_stiffness=inverse_mass * float(stiffness[-1])
                if has_bends
                else 0.0,
                draw_stiffness=inverse_mass * float(targets.stiffness[:1].sum()),
                draw_damping=inverse_mass * float(targets.damping[:1].sum()),
                stretch=max_strain,
            )
        return self._kernel_strands

    @cached_property
    def spring_order(self) -> IntArray:
        """Spring indices in kernel order ``(S,)``."""
        count = len(self.body.positions)
        return _kernels.spring_order(self.body.springs.ends, count)

    @cached_property
    def untorn_flags(self) -> TornFlags:
        """Flags of intact springs, in kernel order ``(S,)``."""
        return np.zeros(len(self.body.springs.rest), np.uint8)

    def torn(self, flags: TornFlags) -> BoolArray:
        """Return torn flags in body order ``(S,)``, from those in kernel order."""
        torn = np.zeros(len(flags), np.bool_)
        torn[self.spring_order] = flags.astype(np.bool_)
        return torn

    @cached_property
    def inverse_masses(self) -> FloatArray:
        """Inverse masses ``(N,)`` [1/kg], 0 for pinned particles."""
        masses = np.where(self.is_pinned, 1.0, self.body.masses)
        return np.where(self.is_pinned, 0.0, 1.0 / masses)

    @cached_property
    def free_masses(self) -> FloatArray:
        """Masses ``(N,)`` [kg], 0 for pinned particles."""
        return np.where(self.is_pinned, 0.0, self.body.masses)

    @cached_property
    def drags(self) -> FloatArray:
        """Drag rate of each particle: drag force over mass and speed ``(N,)`` [1/s]."""
        return self.drag + self.resistance * self.inverse_masses

    @property
    def state(self) -> FloatArray:
        """Initial positions and velocities ``(2, N, 3)``."""
        return self._state

    def acceleration(self, t: float, x: FloatArray, v: FloatArray) -> FloatArray:
        """Return accelerations ``(N, 3)`` [m/s²], 0 for pinned particles."""
        network = self.network(self.teleports.stage(t))
        return _kernels.spring_accelerations(
            network, t, TARGET_SPEED_INTERVAL, np.array((x, v)), self.untorn_flags
        )

    def jacobians(
        self, t: float, x: FloatArray, v: FloatArray
    ) -> tuple[Matrix, Matrix] | None:
        """Return Jacobians of acceleration with respect to positions and velocities."""
        masses, wind = self.free_masses, self.wind(t)
        by_x, by_v = acceleration_jacobians(self.forces, masses, wind, x, v)
        return by_x, by_v

    def stiffness(self, t: float, x: FloatArray) -> Matrix:
        """Return the sparse stiffness matrix: the negative force Jacobian.

        The shape is ``(3 N, 3 N)``.

        The matrix includes springs and targets; rows of pinned particles are 0.
        """
        from scipy.sparse import diags_array

        masses, v = self.free_masses, np.zeros_like(x)
        by_x = next(acceleration_jacobians(self.forces, masses, self.wind(t), x, v))
        return diags_array(np.repeat(-masses, 3)) @ by_x

    def frozen_at(self, t: float, body: Body, drag: float = 0.0) -> SpringSystem:
        """Return the system with pins and targets frozen at a time, without air.

        Args:
            t: The time [s].
            body: Positions and springs.
            drag: Drag per mass and speed [1/s].
        """
        stage = self._stage(self.teleports.stage(t))
        target_positions, springs = position_at(stage.targets, t), self.target_springs
        return SpringSystem(
            body,
            pins=Pins(self.pinned, position_at(stage.pins, t)),
            targets=PointTargets(
                springs.particles, target_positions, springs.stiffness, springs.damping
            ),
            gravity=self.gravity,
            drag=drag,
        )

    def with_target_springs(self, target_springs: TargetSprings) -> SpringSystem:
        """Return the system with other springs to targets; set their paths next."""
        result = copy(self)
        result.target_springs = target_springs
        result._cached_stage, result._kernel_strands = None, None
        return result

    def without_springs(self, is_removed: BoolArray) -> SpringSystem:
        """Return the system without the springs selected by a mask ``(S,)``."""
        result = copy(self)
        result.body = replace(self.body, springs=self.body.springs.select(~is_removed))
        result._cached_stage = None
        for name in ("spring_order", "untorn_flags"):
            result.__dict__.pop(name, None)
        return result

    def starting_at(self, positions: ArrayLike) -> SpringSystem:
        """Return the system starting at rest in other positions.

        Args:
            positions: ``(N, 3)`` [m].
        """
        points = as_floats(positions, self.body.positions.shape, "positions")
        result = copy(self)
        result.body = replace(self.body, positions=points)
        result._state = at_rest(points)
        return result

    # Overflow gives an infinite energy.
    @np.errstate(over="ignore", invalid="ignore")
    def energy(self, t: float, state: FloatArray) -> Energy:
        """Return the kinetic energy, and the potential energy of springs and gravity.

        Moving pins, targets and wind may supply about the kinetic energy of all
        particles at their speed.
        """
        (x, v), masses = state, self.free_masses
        kinetic = 0.5 * float(masses @ np.einsum("nk,nk->n", v, v))
        stage = self._stage(self.teleports.stage(t))
        potential, _ = _kernels.spring_energy(stage.network, np.ascontiguousarray(x))
        potential -= float(masses @ x @ self.gravity)
        springs = self.target_springs
        if len(springs.particles):
            gaps = x[springs.particles] - position_at(stage.targets, t)
            potential += 0.5 * float(springs.stiffness @ (gaps * gaps).sum(axis=1))
        mass, square_speed, speed = self._supply
        supply = mass * (square_speed + max(speed, self.colliders.max_speed) ** 2)
        return Energy(kinetic, potential, supply)

    @cached_property
    def _supply(self) -> tuple[float, float, float]:
        """Terms of the energy that may be supplied.

        They are the moving mass [kg], the squared speed from wind and gravity, and the
        speed of pins and targets.
        """
        mass = float(self.body.masses[~self.is_pinned].sum())
        wind_speed = float(np.linalg.norm(self._wind_path[1], axis=2).max(initial=0.0))
        speeds, travels = zip(
            *map(max_speed_and_travel, self._constraint_paths), strict=True
        )
        gravity = float(np.linalg.norm(self.gravity))
        square_speed = wind_speed**2 + gravity * max(travels)
        # Teleports supply no speed.
        return mass, square_speed, min(max(speeds), self.speed_limit)

    def wind(self, t: float) -> FloatArray:
        """Return the velocity of the air at a time ``(1, 3)`` [m/s]."""
        return position_at(self._wind_path, t)

    def stretch(self, t: float, state: FloatArray) -> float | None:
        """Return the largest ratio of spring length to rest length [1]."""
        points = np.ascontiguousarray(state[0])
        network = self.network(self.teleports.stage(t))
        max_ratio = _kernels.spring_energy(network, points)[1]
        return max_ratio if (self.body.springs.rest > 0).any() else None

    def frequencies(self, t: float, state: FloatArray) -> FloatArray | None:  # noqa: ARG002
        """Return upper bounds of the fastest modes ``(M, 2)``, at any positions."""
        return mode_bounds(self.forces)

    def settle(
        self, t: float, h: float, before: FloatArray, after: FloatArray
    ) -> FloatArray:
        """Return the state after a step, with pins and contacts applied."""
        if not self.settles:
            return after
        result = after.copy()
        layers = self.kernel_self_contact
        if layers is not None:
            network = self.network(self.teleports.stage(t))
            result = _kernels.part_springs(network, layers, before[0], result, h)
        if self.colliders.has_any:
            collision = collide(
                result[0], result[1], before, self.colliders, t - h, t, self.radius
            )
            result = np.stack([collision.points, collision.velocities])
            self.contacts = collision.contacts
        result[:, self.pinned] = after[:, self.pinned]
        if not self._has_moving_pins and not len(self.teleports):
            return result
        begin, end = self.teleports.stage(t - h), self.teleports.stage(t)
        result = self.teleports.apply(result, begin, end)
        previous = self.teleports.apply(before, begin, end)[0, self.pinned]
        result[0, self.pinned] = position_at(self._stage(end).pins, t)
        result[1, self.pinned] = (result[0, self.pinned] - previous) / h
        return result

    def native(self, method: str) -> NativeAdvance | None:
        """Return a compiled loop of symplectic_euler, or None if it does not apply."""
        if method != "symplectic_euler" or self._has_contacts or len(self.teleports):
            return None

        def take_steps(t: float, state: FloatArray, h: float, count: int) -> FloatArray:
            motion = np.ascontiguousarray(state)
            for first in range(0, count, MAX_STEPS_PER_CALL):
                motion = _kernels.step_springs(
                    self.network(0), motion, self.untorn_flags, t, first, h,
                    min(MAX_STEPS_PER_CALL, count - first), 1, None,
                )[0]  # fmt: skip
            return motion

        return take_steps

    def notices(self) -> list[Fault]:
        """Return warnings about the initial state and teleports."""
        springs, positions = self.body.springs, self.body.positions
        notices = coincident_notices(
            springs.ends, springs.rest, positions, where="body"
        )
        notices += self.colliders.notices()
        if self.self_contact is not None:
            notices += thickness_notices(self.self_contact, self.body)
            notices += tangle_notices(self.body.positions, self.body.triangles)
        return notices + self.teleports.notices()

    def suspected_cause(self, t: float, state: FloatArray) -> str:  # noqa: ARG002
        """Return which spring has the largest extension, as text."""
        springs = self.body.springs
        if not len(springs.rest):
            return ""
        spring_index = int(np.argmax(springs.lengths(state[0]) - springs.rest))
        first, second = springs.ends[spring_index].tolist()
        return f"the spring of particles {first} and {second} has the largest strain"
