"""Simulation of one attachment through a take."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from animtool.core.array_types import FloatArray, IntArray
from animtool.core.errors import Fault
from animtool.core.units import UpAxis
from animtool.maths import so3
from animtool.rig.kinematics import WorldTransforms
from animtool.rig.skeleton import Rig
from animtool.sim.colliders import Colliders, Sheet
from animtool.systems.attach.bodies import AttachedBody
from animtool.systems.attach.colliders import (
    DEPENETRATION_SPEED,
    CharacterColliders,
    ClothMotion,
    CollisionSurroundings,
)
from animtool.systems.attach.mass_spring import (
    coincident_link_count,
    median_edge_length,
)
from animtool.systems.attach.poses import LocalPose, interpolate_poses
from animtool.systems.attach.settings import AttachSettings
from animtool.systems.attach.skins import FramePoses, SkinSurface, skin_margin
from animtool.systems.attach.stepping import (
    CycleSteering,
    build_plan,
    check_motion,
    with_steering,
)
from animtool.systems.framework.meter import ContactMeter, MeasuredSurface
from animtool.systems.springs.checks import tangle_notices
from animtool.systems.springs.contacts import Cells
from animtool.systems.springs.motion import TimeGrid


def up_direction(rig: Rig) -> FloatArray:
    """Return the up direction of a rig ``(3,)``."""
    return np.asarray(np.eye(3)[{UpAxis.Y: 1, UpAxis.Z: 2}[rig.up]])


class AttachmentActor:
    """Simulates one attachment of a rig, frame by frame."""

    def __init__(
        self,
        rig: Rig,
        body: AttachedBody,
        settings: AttachSettings,
        frame_duration: float,
        pose: LocalPose,
        skins: Sequence[SkinSurface],
        world: Colliders,
        layers: Sequence[Sheet],
    ) -> None:
        """Start with all particles at rest in a pose, at the scale of the pose.

        ``layers`` are cloth surfaces that are simulated before this attachment.
        """
        self.body, self.settings = body, settings
        self._rig = rig
        start_samples = interpolate_poses(rig, pose, pose, 1)
        scale = _joint_scale(start_samples.world, body.carrier)
        network = replace(body.network, points=scale * body.network.points)
        down = -up_direction(rig)
        self._plan = build_plan(network, settings, down, frame_duration)
        self._cells = round(frame_duration / self._plan.choice.cell)
        self.steps = self._cells * self._plan.choice.substeps
        self.teleport_count = 0
        self.seconds = 0.0
        self._frame_duration = frame_duration
        self.meter = ContactMeter()
        self_contact = self._plan.system.self_contact
        thickness = 0.0 if self_contact is None else self_contact.thickness
        # Without triangles there are no sides of cloth, and without self-contact and
        # skins no piercing to count.
        is_cloth, can_pierce = len(network.triangles) > 0, bool(thickness or skins)
        self._measured_surface = MeasuredSurface.of_edges(
            network.structural if is_cloth else network.structural[:0],
            network.rests if is_cloth else network.rests[:0],
            network.is_pinned,
            network.triangles if can_pierce else network.triangles[:0],
        )
        margin = skin_margin(median_edge_length(network), settings.radius)
        self._colliders = CharacterColliders(
            rig, body, settings, start_samples, scale, margin, skins, world, layers
        )
        self.target = body.targets(start_samples)[0]
        self._joint_transforms, self._time = start_samples.world, 0.0
        self.coincident_links = coincident_link_count(network, self.target)
        self._plan.system.joint_colliders = self._colliders.character_range
        motion = np.stack([self.target, np.zeros_like(self.target)])
        self.grid = self._plan.start(0.0, motion)
        self.tangle_warnings: list[Fault] = []
        # Cloth with self-contact, as a collider of later attachments.
        self._cloth_motion = ClothMotion(network.triangles, self.target, self.target)
        self.sheet: Sheet | None = None
        if thickness:
            self.tangle_warnings = tangle_notices(
                self.target, network.triangles, f"the cloth {body.name}"
            )
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
        motion = self._cloth_motion
        motion.begin, motion.end, motion.times = begin, self.positions, times

    def add_velocity(self, velocity: FloatArray) -> None:
        """Add a velocity ``(3,)`` [m/s] to all particles."""
        motion = self.grid.state.motion
        self.set_motion(np.stack([motion[0], motion[1] + velocity]))

    def advance_frame(
        self, frame_poses: FramePoses, frame: int, steering: CycleSteering | None = None
    ) -> None:
        """Advance the simulation by a frame; frame 0 is the first frame of the take."""
        start_seconds = time.perf_counter()
        plan, grid, cells = self._plan, self.grid, self._cells
        motion = frame_poses.sample(cells)
        targets = self.body.targets(motion)
        kernel_cells = Cells(0.0, self.grid.cell, frame * cells, cells)
        colliders = self._colliders.kernel_arguments(frame_poses, kernel_cells)
        begin_points = self.positions
        goals, duration = targets, self._frame_duration
        if steering is not None and steering.weight > 0:
            system, goals = with_steering(
                plan.system, self.settings, targets, steering, duration
            )
            plan = replace(plan, system=system)
        plan.system.set_constraint_paths(duration, goals)
        if not plan.system.body.strands:
            # Paths start at cell 0; strands always take the same steps.
            state = replace(grid.state, substeps=plan.choice.substeps, calm=0)
            grid = replace(grid, index=0, state=state)
        end = plan.advance(grid, cells, colliders)
        check_motion(end.state.motion)
        self.grid = self._with_cloth_strain(end, grid.stretch)
        self.target = targets[-1]
        self._joint_transforms = motion.world
        self._time = (frame + 1) * self._frame_duration
        self._move_sheet((frame * self._frame_duration, self._time), begin_points)
        self.seconds += time.perf_counter() - start_seconds

    def _with_cloth_strain(self, end: TimeGrid, last_strain: float) -> TimeGrid:
        """Return the time grid with the largest strain of cloth, compliance included.

        For strands the kernel measures it.
        """
        surface = self._measured_surface
        if self._plan.system.body.strands:
            return end
        lengths = surface.lengths(end.state.motion[0])
        strain = float((lengths / surface.rest_lengths - 1).max(initial=0.0))
        return replace(end, stretch=max(last_strain, strain))

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
        self.target = self.body.targets(frame_poses.sample(1))[-1]
        motion = np.stack([self.target, np.zeros_like(self.target)])
        self.set_motion(motion, self.grid.state.passages[:0])
        self._move_sheet((0.0, 0.0), self.positions)

    def set_target(self, pose: LocalPose) -> None:
        """Set the animated positions from a pose; the simulated state is unchanged."""
        self.target = self.body.targets(FramePoses(self._rig, pose, pose).sample(1))[0]

    def teleport(self, frame_poses: FramePoses) -> None:
        """Advance over a teleport: all particles move rigidly with their joint."""
        motion = frame_poses.sample(1)
        self.target = self.body.targets(motion)[-1]
        shift, rotation = _joint_motion(motion.world, self.body.carrier)
        state = move_rigidly(self.grid.state.motion, shift, rotation)
        pinned = self.body.network.pinned
        state[0, pinned] = self.target[pinned]
        self.set_motion(state)
        self._move_sheet((0.0, 0.0), self.positions)
        self.teleport_count += 1

    def speed(self, frame_poses: FramePoses) -> float:
        """Return the speed of the carrier joint over a frame [m/s]."""
        positions = frame_poses.sample(1).world.positions[:, self.body.carrier]
        return float(np.linalg.norm(positions[1] - positions[0])) / self._frame_duration


def move_rigidly(
    motion: FloatArray, shift: FloatArray, rotation: FloatArray
) -> FloatArray:
    """Return a state ``(2, N, 3)`` rotated about the origin and then shifted."""
    result = so3.rotate(rotation, motion)
    result[0] += shift
    return result


def _joint_motion(world: WorldTransforms, joint: int) -> tuple[FloatArray, FloatArray]:
    """Return the displacement and rotation of a joint from first to last time."""
    rotations = so3.split_scale(world.linear[:, joint])[0]
    rotation = so3.multiply(rotations[-1], so3.conjugate(rotations[0]))
    positions = world.positions[:, joint]
    return positions[-1] - so3.rotate(rotation, positions[0]), rotation


def _joint_scale(world: WorldTransforms, joint: int) -> float:
    """Return the animated scale of a joint [1]."""
    scale = float(np.cbrt(abs(np.linalg.det(world.linear[0, joint]))))
    # Rotations have a determinant of 1 up to rounding.
    return scale if abs(scale - 1) > 1e-9 else 1.0
