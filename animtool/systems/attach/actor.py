"""Simulation of one attachment through a take."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from animtool.core.array_types import FloatArray, IntArray
from animtool.core.errors import Fault, ToleranceError
from animtool.core.record import dataclass
from animtool.maths import so3
from animtool.motion.frames import MAX_FRAME_VALUE
from animtool.rig.skeleton import Rig
from animtool.sim.colliders import Colliders, Sheet
from animtool.systems.attach.bodies import (
    AttachedBody,
    MassSpringNetwork,
    max_pin_hops,
)
from animtool.systems.attach.colliders import (
    DEPENETRATION_SPEED,
    CharacterColliders,
    ClothMotion,
    CollisionSurroundings,
)
from animtool.systems.attach.poses import LocalPose, interpolate_poses
from animtool.systems.attach.settings import AttachSettings, SimulateOptions
from animtool.systems.attach.skins import FramePoses, SkinSurface, skin_margin
from animtool.systems.framework.meter import ContactMeter, MeasuredSurface
from animtool.systems.springs.body import TargetSprings
from animtool.systems.springs.checks import coincident_notices, tangle_notices
from animtool.systems.springs.choosing import SolverChoice
from animtool.systems.springs.constraints import Pins, PointTargets
from animtool.systems.springs.motion import at_rest, move_rigidly
from animtool.systems.springs.records import Air, SelfContact, Solver, SpringOptions
from animtool.systems.springs.solvers import SpringPlan
from animtool.systems.springs.system import SpringSystem

# Design acceleration for the step rate [m/s²]: twice that of gravity.
DESIGN_ACCELERATION = 20.0
# Design angular velocity of strand springs for the step rate [rad/s].
DESIGN_ANGULAR_VELOCITY = 30.0
# Measured load of cloth springs, relative to a single row of particles [1].
CLOTH_LOAD_FACTOR = 10.0
# Lowest step rates of cloth and of strands [1/s].
MIN_CLOTH_STEP_RATE = 240.0
MIN_STRAND_STEP_RATE = 360.0
MAX_STEP_RATE = 20_000.0
# Largest refinement of steps in a cloth frame with too much strain or piercing [1].
MAX_STEP_REFINEMENT = 4
# Default self-contact distance of cloth, relative to its edges [1].
THICKNESS_RATIO = 1 / 3
# Largest frequency of the pull that steers a cycle to the last one [Hz].
STEERING_FREQUENCY = 40.0
# Limits of the number of cells of a frame; the animation is linear in a cell.
MIN_CELLS_PER_FRAME, MAX_CELLS_PER_FRAME = 5, 8


class AttachmentActor:
    """Simulates one attachment of a rig, frame by frame."""

    def __init__(
        self,
        rig: Rig,
        body: AttachedBody,
        options: SimulateOptions,
        frame_duration: float,
        pose: LocalPose,
        skins: Sequence[SkinSurface],
        world: Colliders,
        layers: Sequence[Sheet],
    ) -> None:
        """Start with all particles at rest in a pose, at the scale of the pose.

        ``layers`` are cloth surfaces that are simulated before this attachment.
        """
        self.body, self._rig = body, rig
        settings = self.settings = AttachSettings.from_options(options, body.kind)
        start_samples = interpolate_poses(rig, pose, pose, 1)
        volume = abs(np.linalg.det(start_samples.world.linear[0, body.carrier]))
        scale = float(np.cbrt(volume))
        # Rotations have a determinant of 1 up to rounding.
        scale = scale if abs(scale - 1) > 1e-9 else 1.0
        network = replace(body.network, points=scale * body.network.points)
        down = -np.array(rig.up.vector)
        self._plan = build_plan(network, settings, down, frame_duration)
        self._cells_per_frame = round(frame_duration / self._plan.choice.cell)
        self.steps_per_frame = self._cells_per_frame * self._plan.choice.substeps
        self.teleport_count = 0
        self.seconds = 0.0
        self._frame_duration = frame_duration
        self.meter = ContactMeter()
        self_contact = self._plan.system.self_contact
        thickness = 0.0 if self_contact is None else self_contact.thickness
        # Without triangles there are no sides of cloth, and without self-contact and
        # skins no piercing to count.
        edge_count = len(network.structural) if len(network.triangles) else 0
        self._measured_surface = MeasuredSurface.of_edges(
            network.structural[:edge_count],
            network.rest_lengths[:edge_count],
            network.is_pinned,
            network.triangles if thickness or skins else network.triangles[:0],
        )
        margin = skin_margin(network.median_edge_length, settings.radius)
        self._colliders = CharacterColliders(
            rig, body, settings, start_samples, scale, margin, skins, world, layers
        )
        self.animated_positions = positions = body.targets(start_samples)[0]
        self._joint_transforms, self._time = start_samples.world, 0.0
        rest_lengths = network.rest_lengths
        # Springs that all have no length have no direction either.
        expected_lengths = rest_lengths if rest_lengths.any() else rest_lengths + 1.0
        self.start_warnings = coincident_notices(
            network.structural, expected_lengths, positions, f"{body.name}: "
        )
        self._plan.system.joint_colliders = self._colliders.character_range
        self.grid = self._plan.start(0.0, at_rest(positions))
        # Cloth with self-contact, as a collider of later attachments.
        path = np.zeros(2), np.stack([positions, positions])
        self._cloth_motion = ClothMotion(network.triangles, path)
        self.sheet: Sheet | None = None
        if thickness:
            subject = f"the cloth {body.name}"
            self.start_warnings += tangle_notices(positions, network.triangles, subject)
            self.sheet = Sheet(
                self._cloth_motion,
                thickness / 2,
                friction=settings.options.friction,
                name=body.name,
                depenetration=DEPENETRATION_SPEED,
            )

    @property
    def positions(self) -> FloatArray:
        """Particle positions ``(N, 3)`` [m]."""
        return np.asarray(self.grid.state.motion[0])

    def set_motion(self, motion: FloatArray, piercings: IntArray | None = None) -> None:
        """Set the positions and velocities of the particles ``(2, N, 3)`` [m, m/s]."""
        state = self.grid.state
        new_piercings = state.passages if piercings is None else piercings
        state = replace(state, motion=motion, passages=new_piercings)
        self.grid = replace(self.grid, state=state)

    def _move_sheet(self, times: tuple[float, float], begin: FloatArray) -> None:
        """Set the motion of the attachment's own cloth collider over a frame."""
        points = np.stack([begin, self.positions])
        self._cloth_motion.path = np.array(times), points

    def advance_frame(
        self, frame_poses: FramePoses, frame: int, steering: CycleSteering | None = None
    ) -> None:
        """Advance the simulation by a frame; frame 0 is the first frame of the take."""
        start_seconds = time.perf_counter()
        plan, grid, cells = self._plan, self.grid, self._cells_per_frame
        motion = frame_poses.sample(cells)
        targets = self.body.targets(motion)
        # Colliders are sampled at times of the take, which starts at 0.
        take_grid = replace(grid, index=frame * cells)
        colliders = self._colliders.kernel_arguments(frame_poses, take_grid, cells)
        begin_points = self.positions
        goals = targets
        if steering is not None and steering.weight > 0:
            system, goals = self._steered(targets, steering)
            plan = replace(plan, system=system)
        plan.system.set_constraint_paths(self._frame_duration, goals)
        if not plan.system.body.strands:
            # Paths start at cell 0; strands always take the same steps.
            state = replace(grid.state, substeps=plan.choice.substeps, calm=0)
            grid = replace(grid, index=0, state=state)
        end = plan.advance(grid, cells, colliders)
        check_motion(end.state.motion)
        if not plan.system.body.strands:
            # Compliance is included, as in the strain that kernels measure for strands.
            surface = self._measured_surface
            strains = surface.lengths(end.state.motion[0]) / surface.rest_lengths - 1
            max_strain = max(grid.max_strain, float(strains.max(initial=0.0)))
            end = replace(end, max_strain=max_strain)
        self.grid = end
        self.animated_positions = targets[-1]
        self._joint_transforms = motion.world
        self._time = (frame + 1) * self._frame_duration
        self._move_sheet((frame * self._frame_duration, self._time), begin_points)
        self.seconds += time.perf_counter() - start_seconds

    def _steered(
        self, targets: FloatArray, steering: CycleSteering
    ) -> tuple[SpringSystem, FloatArray]:
        """Return a system that is also pulled to another motion, and its targets.

        A single pull replaces both. The target is the mean of the animated particles
        ``(K, N, 3)`` [m] and that motion over the frame, weighted by stiffness.
        """
        system, settings = self._plan.system, self.settings
        steering_frequency = steering.weight * STEERING_FREQUENCY
        stiffness = settings.frequency**2 + steering_frequency**2
        frequency = math.sqrt(stiffness)
        damping = settings.options.ratio * settings.frequency + steering_frequency
        free_particles = np.flatnonzero(~system.is_pinned)
        pull = _pull(system.body.masses, free_particles, frequency, damping / frequency)
        motion = steering.positions(len(targets) - 1, self._frame_duration)
        fraction, goals = steering_frequency**2 / stiffness, targets.copy()
        goals[:, free_particles] += fraction * (
            motion[:, free_particles] - goals[:, free_particles]
        )
        return system.with_target_springs(pull), goals

    def surroundings(self) -> CollisionSurroundings:
        """Return the surfaces around the attachment at the end of the frame."""
        return self._colliders.surroundings(self._joint_transforms, self._time)

    def measure(
        self, frame: float, points: FloatArray, surroundings: CollisionSurroundings
    ) -> None:
        """Measure contact and strain of points ``(N, 3)`` [m] at a time code."""
        depths = self._colliders.depths(surroundings, points)
        solids, layers = surroundings.solids, surroundings.layers
        surface = self._measured_surface
        self.meter.measure(frame, points, surface, solids, depths, layers)

    def follow_animation(self, frame_poses: FramePoses) -> None:
        """Follow the animation for a frame, without simulation."""
        self.animated_positions = self.body.targets(frame_poses.sample(1))[-1]
        no_piercings = self.grid.state.passages[:0]
        self.set_motion(at_rest(self.animated_positions), no_piercings)
        self._move_sheet((0.0, 0.0), self.positions)

    def set_target(self, pose: LocalPose) -> None:
        """Set the animated positions from a pose; the simulated state is unchanged."""
        samples = interpolate_poses(self._rig, pose, pose, 1)
        self.animated_positions = self.body.targets(samples)[0]

    def teleport(self, frame_poses: FramePoses) -> None:
        """Advance over a teleport: all particles move rigidly with their joint."""
        motion = frame_poses.sample(1)
        self.animated_positions = self.body.targets(motion)[-1]
        world, joint = motion.world, self.body.carrier
        before, after = so3.split_scale(world.linear[:, joint])[0]
        rotation = so3.multiply(after, so3.conjugate(before))
        origin, goal = world.positions[:, joint]
        shift = goal - so3.rotate(rotation, origin)
        state = move_rigidly(self.grid.state.motion, shift, rotation)
        pinned = self.body.network.pinned
        state[0, pinned] = self.animated_positions[pinned]
        self.set_motion(state)
        self._move_sheet((0.0, 0.0), self.positions)
        self.teleport_count += 1

    def speed(self, frame_poses: FramePoses) -> float:
        """Return the speed of the carrier joint over a frame [m/s]."""
        positions = frame_poses.sample(1).world.positions[:, self.body.carrier]
        return float(np.linalg.norm(positions[1] - positions[0])) / self._frame_duration


def step_rate(network: MassSpringNetwork, settings: AttachSettings) -> float:
    """Return the step rate that keeps springs within their strain limit [1/s].

    Springs of strands are solved together: a spring that rotates by an angle in a step
    is strained by half its square. Other springs are visited once per step. In
    equilibrium the spring at the pinned end of a row of n carries all of them, and its
    strain is n a h² over its rest length for an acceleration a.
    """
    if settings.options.rate is not None:
        return settings.options.rate
    if network.strands:
        rate = DESIGN_ANGULAR_VELOCITY / math.sqrt(2 * settings.stretch)
        return min(max(rate, MIN_STRAND_STEP_RATE), MAX_STEP_RATE)
    edge = network.median_edge_length
    if not edge:
        return MIN_CLOTH_STEP_RATE
    load = max_pin_hops(network) * DESIGN_ACCELERATION * CLOTH_LOAD_FACTOR
    rate = math.sqrt(load / (settings.stretch * edge))
    return min(max(rate, MIN_CLOTH_STEP_RATE), MAX_STEP_RATE)


def check_motion(motion: FloatArray) -> None:
    """Raise SIM102 if a state ``(2, N, 3)`` is not finite or out of bounds."""
    if np.abs(motion).max(initial=0.0) <= MAX_FRAME_VALUE:
        return
    magnitudes = np.abs(motion[0])
    magnitudes = np.where(np.isnan(magnitudes), np.inf, magnitudes)
    particle_index = int(np.argmax(magnitudes.max(axis=-1)))
    message = f"the simulation blew up: particle {particle_index} is at "
    message += f"{np.array2string(motion[0, particle_index], precision=3)} m"
    hint = "lower its frequency, bend, diagonals, gravity, wind or drag"
    raise ToleranceError(Fault("SIM102", message, hint=hint))


def cells_and_substeps(step_count: int) -> tuple[int, int]:
    """Return cells per frame and substeps per cell, at least ``steps`` steps in total.

    >>> cells_and_substeps(3), cells_and_substeps(10), cells_and_substeps(46)
    ((3, 1), (5, 2), (8, 6))
    """
    if step_count <= MAX_CELLS_PER_FRAME:
        return step_count, 1
    cell_counts = range(MAX_CELLS_PER_FRAME, MIN_CELLS_PER_FRAME - 1, -1)
    candidates = [(count, math.ceil(step_count / count)) for count in cell_counts]
    return min(candidates, key=math.prod)


@dataclass(frozen=True, slots=True, eq=False)
class CycleSteering:
    """A motion over one frame to which particles are pulled."""

    motions: FloatArray  # states at the start and end ``(2, 2, N, 3)`` [m, m/s]
    weight: float  # strength of the pull, from 0 to 1

    def positions(self, count: int, duration: float) -> FloatArray:
        """Return positions at evenly spaced times ``(count + 1, N, 3)`` [m]."""
        u = (np.arange(count + 1) / count)[:, None, None]
        (x0, v0), (x1, v1) = self.motions
        ends = x0 + u * u * (3 - 2 * u) * (x1 - x0)
        return np.asarray(ends + duration * u * (1 - u) * ((1 - u) * v0 - u * v1))


def self_contact_distance(
    network: MassSpringNetwork, settings: AttachSettings
) -> float:
    """Return the self-contact distance of cloth [m]; 0 is off."""
    if settings.thickness is not None:
        return settings.thickness
    if not len(network.triangles):
        return 0.0
    distance = THICKNESS_RATIO * network.median_edge_length
    return min(settings.radius or math.inf, distance)


def build_plan(
    network: MassSpringNetwork,
    settings: AttachSettings,
    down: FloatArray,
    frame_duration: float,
) -> SpringPlan:
    """Return the xpbd plan of a network: its spring system, and the steps of a frame.

    ``down`` is the direction of gravity ``(3,)``; ``frame_duration`` is in [s].
    """
    options, thickness = settings.options, self_contact_distance(network, settings)
    body = network.body(options.diagonals, settings.bend)
    pulled_particles = np.flatnonzero(~network.is_pinned & bool(settings.frequency))
    pull = _pull(body.masses, pulled_particles, settings.frequency, options.ratio)
    pulled_positions = body.positions[pulled_particles]
    # Air acts on the triangles of cloth; other kinds have linear drag.
    wind, is_cloth = np.array(options.wind), len(network.triangles) > 0
    linear_drag = 0.0 if is_cloth else options.drag
    system = SpringSystem(
        body,
        pins=Pins(network.pinned),
        targets=PointTargets(pulled_particles, pulled_positions, *pull[1:]),
        gravity=options.gravity * down + linear_drag * wind,
        drag=linear_drag,
        air=Air(wind, options.drag, options.drag / 2) if is_cloth else None,
        self_contact=SelfContact(thickness, options.friction) if thickness else None,
    )
    min_steps = math.ceil(step_rate(network, settings) * frame_duration - 1e-9)
    cell_count, substeps = cells_and_substeps(max(1, min_steps))
    spring_options = SpringOptions(
        Solver.XPBD,
        stretch=settings.stretch,
        max_substeps=substeps * (MAX_STEP_REFINEMENT if options.rate is None else 1),
        # The strain of stiff cloth springs is clamped too.
        clamped_strain=settings.stretch if is_cloth else 0.0,
    )
    choice = SolverChoice(
        Solver.XPBD, frame_duration / cell_count, substeps, "", math.inf
    )
    return SpringPlan(system, spring_options, choice)


def _pull(
    masses: FloatArray, particles: IntArray, frequency: float, ratio: float
) -> TargetSprings:
    """Return springs to the targets of particles with a frequency [Hz] and ratio."""
    moving_masses, omega = masses[particles], 2 * math.pi * frequency
    stiffness = moving_masses * omega**2
    return TargetSprings(particles, stiffness, moving_masses * (2 * ratio * omega))
