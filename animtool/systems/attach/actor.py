"""Simulation of one attachment through a take."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import field, replace
from typing import Any, NamedTuple

import numpy as np

from animtool.core.array_types import FloatArray, IntArray
from animtool.core.record import dataclass
from animtool.core.units import UpAxis
from animtool.maths import so3
from animtool.rig.kinematics import WorldTransforms
from animtool.rig.skeleton import Rig
from animtool.sim.colliders import Colliders, Sheet
from animtool.sim.colliders.on_joints import JointCapsules
from animtool.systems.attach.bodies import AttachedBody, ChainBody
from animtool.systems.attach.layers import ClothMotion, cloth_sheet
from animtool.systems.attach.network import (
    Network,
    coincident_link_count,
    median_edge_length,
)
from animtool.systems.attach.poses import LocalPose, PosePath, interpolate_poses
from animtool.systems.attach.settings import AttachSettings
from animtool.systems.attach.skins import SkinContacts, SkinSurface, skin_margin
from animtool.systems.attach.stepping import AttachedSprings, CycleSteering
from animtool.systems.attach.strands import (
    DEPENETRATION_SPEED,
    CharacterColliders,
    bind_depths,
)
from animtool.systems.framework.meter import (
    ClosedSurface,
    ContactMeter,
    MeasuredSurface,
)
from animtool.systems.springs.checks import tangle_notices
from animtool.systems.springs.contacts import Cells


def up_direction(rig: Rig) -> FloatArray:
    """Return the up direction of a rig ``(3,)``."""
    return np.asarray(np.eye(3)[{UpAxis.Y: 1, UpAxis.Z: 2}[rig.up]])


@dataclass
class PosePaths:
    """Poses of a character within one frame, cached by number of steps."""

    rig: Rig  # the character
    before: LocalPose  # pose at the start
    after: LocalPose  # pose at the end
    _by_steps: dict[int, PosePath] = field(default_factory=dict)
    _skin_points: dict[tuple[int, int], FloatArray] = field(default_factory=dict)

    def of(self, steps: int) -> PosePath:
        """Return the poses at the start and end of each of ``steps`` equal steps."""
        if steps not in self._by_steps:
            self._by_steps[steps] = interpolate_poses(
                self.rig, self.before, self.after, steps
            )
        return self._by_steps[steps]

    def skin_points(self, skin: SkinSurface, steps: int) -> FloatArray:
        """Return the points of a skin at the ends of the steps ``(K, P, 3)`` [m]."""
        key = id(skin), steps
        if key not in self._skin_points:
            self._skin_points[key] = skin.points(self.of(steps))
        return self._skin_points[key]


class CollisionSurroundings(NamedTuple):
    """Surfaces around an attachment at the end of a frame, to measure contact."""

    world: WorldTransforms  # joint transforms
    time: float  # end of the frame [s]
    solids: Sequence[ClosedSurface]  # closed surfaces, such as skins
    layers: Sequence[ClosedSurface]  # cloth of other attachments


class AttachmentActor:
    """Simulates one attachment of a rig, frame by frame."""

    def __init__(
        self,
        rig: Rig,
        body: AttachedBody,
        settings: AttachSettings,
        frame_duration: float,
        pose: LocalPose,
        skins: Sequence[SkinSurface] = (),
        world: Colliders | None = None,
        layers: Sequence[Sheet] = (),
    ) -> None:
        """Start with all particles at rest in a pose, at the scale of the pose.

        ``layers`` are cloth surfaces that are simulated before this attachment.
        """
        self.body, self.settings = body, settings
        self._rig = rig
        start_path = interpolate_poses(rig, pose, pose, 1)
        scale = _joint_scale(start_path.world, body.carrier)
        network = replace(body.network, points=scale * body.network.points)
        self._springs = AttachedSprings(
            network, settings, -up_direction(rig), frame_duration
        )
        self.steps = self._springs.cells * self._springs.substeps
        self.teleport_count = 0
        self.seconds = 0.0
        self._frame_duration = frame_duration
        self.meter = ContactMeter()
        self._measured_surface = _surface_to_measure(network)
        if not self._springs.thickness and not skins:
            # Without self-contact and skins there is no piercing to count.
            self._measured_surface = replace(
                self._measured_surface, triangles=network.triangles[:0]
            )
        self._skin_surfaces = skins
        self._skin_solids: list[
            ClosedSurface
        ] = []  # skins at the end of the last frame
        self._skins = SkinContacts(
            list(skins),
            settings.options.friction,
            skin_margin(median_edge_length(network), settings.radius),
            DEPENETRATION_SPEED,
        )
        capsules = (
            JointCapsules.of(rig)
            if settings.options.capsules
            else JointCapsules.empty()
        )
        if self._skins:
            # Joints with a skin collide with that instead of their capsules.
            has_skin = np.any([skin.joints for skin in skins], axis=0)
            capsules = capsules.select(~has_skin[capsules.joints])
        bind_points = body.network.points
        depths = scale * bind_depths(
            capsules, rig, bind_points, settings.radius / scale
        )
        self.target = body.targets(start_path)[0]
        is_chain = isinstance(body, ChainBody)
        skin_depths = self._skins.depths(
            start_path, self.target, settings.radius, inside=is_chain
        )
        self._colliders = CharacterColliders(
            capsules,
            capsules.world_radii(start_path.world),
            (depths, skin_depths),
            settings.radius,
            settings.options.friction,
            world,
            layers,
        )
        self._cloth_motions = [layer.motion for layer in layers]
        self._joint_transforms, self._time = start_path.world, 0.0
        self.coincident_links = coincident_link_count(network, self.target)
        self.tangle_warnings = (
            tangle_notices(self.target, network.triangles, f"the cloth {body.name}")
            if self._springs.thickness
            else []
        )
        self.grid = self._springs.start(self.target)
        # Cloth with self-contact, as a collider of later attachments.
        self.sheet: Sheet | None = None
        if self._springs.thickness:
            self.sheet = cloth_sheet(
                body.name,
                self.target,
                network.triangles,
                self._springs.thickness,
                settings.options.friction,
                DEPENETRATION_SPEED,
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
        if self.sheet is not None:
            motion = self.sheet.motion
            assert isinstance(motion, ClothMotion)
            motion.begin, motion.end = begin, self.positions
            motion.times = times

    def add_velocity(self, velocity: FloatArray) -> None:
        """Add a velocity ``(3,)`` [m/s] to all particles."""
        motion = self.grid.state.motion
        self.set_motion(np.stack([motion[0], motion[1] + velocity]))

    def advance_frame(
        self, paths: PosePaths, frame: int, steering: CycleSteering | None = None
    ) -> None:
        """Advance the simulation by a frame; frame 0 is the first frame of the take."""
        start_seconds = time.perf_counter()
        cells = self._springs.cells
        motion = paths.of(cells)
        targets = self.body.targets(motion)
        surfaces: list[Any] = []
        if self._skins:
            points = [paths.skin_points(skin, cells) for skin in self._skin_surfaces]
            surfaces = self._skins.kernel_surfaces(points)
            self._skin_solids = self._skins.solids(points)
        kernel_cells = Cells(0.0, self.grid.cell, frame * cells, cells)
        colliders = self._colliders.kernel_arguments(
            motion.world, kernel_cells, surfaces
        )
        begin_points = self.positions
        springs, goals = self._springs, targets
        if steering is not None and steering.weight > 0:
            springs, goals = self._springs.with_steering(targets, steering)
        self.grid = springs.advance_frame(
            self.grid, goals, colliders, self._colliders.character_range
        )
        self.target = targets[-1]
        self._joint_transforms = motion.world
        self._time = (frame + 1) * self._frame_duration
        self._move_sheet((frame * self._frame_duration, self._time), begin_points)
        self.seconds += time.perf_counter() - start_seconds

    def surroundings(self) -> CollisionSurroundings:
        """Return the surfaces around the attachment at the end of the frame."""
        solids = [*self._skin_solids, *self._colliders.solids(self._time)]
        layers = [
            ClosedSurface(layer.points(self._time), layer.triangles(self._time))
            for layer in self._cloth_motions
        ]
        return CollisionSurroundings(self._joint_transforms, self._time, solids, layers)

    def measure(
        self, frame: float, points: FloatArray, surroundings: CollisionSurroundings
    ) -> None:
        """Measure contact and strain of points ``(N, 3)`` [m] at a time code."""
        depths = self._colliders.depths(surroundings.world, points, surroundings.time)
        self.meter.measure(
            frame,
            points,
            self._measured_surface,
            surroundings.solids,
            depths,
            surroundings.layers,
        )

    def follow_animation(self, paths: PosePaths) -> None:
        """Follow the animation for a frame, without simulation."""
        self.target = self.body.targets(paths.of(1))[-1]
        motion = np.stack([self.target, np.zeros_like(self.target)])
        self.set_motion(motion, self.grid.state.passages[:0])
        self._move_sheet((0.0, 0.0), self.positions)

    def set_target(self, pose: LocalPose) -> None:
        """Set the animated positions from a pose; the simulated state is unchanged."""
        self.target = self.body.targets(PosePaths(self._rig, pose, pose).of(1))[0]

    def teleport(self, paths: PosePaths) -> None:
        """Advance over a teleport: all particles move rigidly with their joint."""
        motion = paths.of(1)
        self.target = self.body.targets(motion)[-1]
        shift, rotation = _joint_motion(motion.world, self.body.carrier)
        state = move_rigidly(self.grid.state.motion, shift, rotation)
        pinned = self.body.network.pinned
        state[0, pinned] = self.target[pinned]
        self.set_motion(state)
        self._move_sheet((0.0, 0.0), self.positions)
        self.teleport_count += 1

    def speed(self, paths: PosePaths) -> float:
        """Return the speed of the carrier joint over a frame [m/s]."""
        positions = paths.of(1).world.positions[:, self.body.carrier]
        return float(np.linalg.norm(positions[1] - positions[0])) / self._frame_duration


def _surface_to_measure(network: Network) -> MeasuredSurface:
    """Return the edges and triangles to measure: structural springs of cloth."""
    is_pinned = np.zeros(network.count, np.bool_)
    is_pinned[network.pinned] = True
    ends, rest_lengths = network.sides, network.rests
    is_measured = (rest_lengths > 0) & ~is_pinned[ends].all(axis=1)
    is_measured &= len(network.triangles) > 0
    return MeasuredSurface(
        network.free, network.triangles, ends[is_measured], rest_lengths[is_measured]
    )


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
