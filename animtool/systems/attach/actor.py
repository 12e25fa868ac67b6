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
from animtool.sim.colliders.on_joints import Capsules
from animtool.systems.attach.bodies import AttachedBody, ChainBody
from animtool.systems.attach.layers import ClothMotion, cloth_sheet
from animtool.systems.attach.network import Network, lost_links, typical_edge
from animtool.systems.attach.poses import LocalPose, PosePath, pose_path
from animtool.systems.attach.settings import AttachSettings
from animtool.systems.attach.skins import SkinContacts, SkinSurface, margin_for
from animtool.systems.attach.stepping import AttachedSprings, Steering
from animtool.systems.attach.strands import (
    DEPENETRATION,
    CharacterColliders,
    depth_at_bind,
)
from animtool.systems.framework.meter import (
    ClosedSurface,
    ContactMeter,
    MeasuredSurface,
)
from animtool.systems.springs.checks import tangle_notices
from animtool.systems.springs.contacts import Cells


def upwards(rig: Rig) -> FloatArray:
    """Return the direction away from the ground ``(3,)``."""
    return np.asarray(np.eye(3)[{UpAxis.Y: 1, UpAxis.Z: 2}[rig.up]])


@dataclass
class PosePaths:
    """Character poses within one frame, cached by number of steps."""

    rig: Rig  # the character
    before: LocalPose  # pose at the start
    after: LocalPose  # pose at the end
    _by_steps: dict[int, PosePath] = field(default_factory=dict)
    _skin_points: dict[tuple[int, int], FloatArray] = field(default_factory=dict)

    def of(self, steps: int) -> PosePath:
        """Return the poses at the start and end of each step."""
        if steps not in self._by_steps:
            self._by_steps[steps] = pose_path(self.rig, self.before, self.after, steps)
        return self._by_steps[steps]

    def skin_points(self, skin: SkinSurface, steps: int) -> FloatArray:
        """Return points of a skin at these times ``(K, P, 3)`` [m]."""
        key = id(skin), steps
        if key not in self._skin_points:
            self._skin_points[key] = skin.points(self.of(steps))
        return self._skin_points[key]


class AttachedSurroundings(NamedTuple):
    """Colliders of an attachment at the end of a frame."""

    world: WorldTransforms  # joint transforms
    time: float  # [s]
    solids: Sequence[ClosedSurface]
    layers: Sequence[ClosedSurface]  # other cloth


class Actor:
    """Simulates one attachment frame by frame."""

    def __init__(
        self,
        rig: Rig,
        body: AttachedBody,
        settings: AttachSettings,
        span: float,
        pose: LocalPose,
        skins: Sequence[SkinSurface] = (),
        world: Colliders | None = None,
        layers: Sequence[Sheet] = (),
    ) -> None:
        """Start at rest in a pose, at its scale; a frame lasts ``span`` [s].

        ``layers`` is cloth that was simulated before.
        """
        self.body, self.settings = body, settings
        self._rig = rig
        first = pose_path(rig, pose, pose, 1)
        scale = _size(first.world, body.carrier)
        network = replace(body.network, points=scale * body.network.points)
        self._springs = AttachedSprings(network, settings, -upwards(rig), span)
        self.steps = self._springs.cells * self._springs.substeps
        self.jumps = 0
        self.seconds = 0.0
        self._span = span
        self.meter = ContactMeter()
        self._sides = _sides(network)
        if not self._springs.thickness and not skins:
            # Without self-contact and skins there is no piercing to count.
            self._sides = replace(self._sides, triangles=network.triangles[:0])
        self._meshes = skins
        self._solids: list[ClosedSurface] = []  # skins as the last frame ended
        self._skins = SkinContacts(
            list(skins),
            settings.options.friction,
            margin_for(typical_edge(network), settings.radius),
            DEPENETRATION,
        )
        capsules = Capsules.of(rig) if settings.options.capsules else Capsules.none()
        if self._skins:
            # Joints with a skin collide with that instead of their capsules.
            covered = np.any([skin.joints for skin in skins], axis=0)
            capsules = capsules.select(~covered[capsules.joints])
        bind_points = body.network.points
        depths = scale * depth_at_bind(
            capsules, rig, bind_points, settings.radius / scale
        )
        self.target = body.targets(first)[0]
        is_chain = isinstance(body, ChainBody)
        skin_depths = self._skins.depths(
            first, self.target, settings.radius, inside=is_chain
        )
        self._contacts = CharacterColliders(
            capsules,
            capsules.world_radii(first.world),
            (depths, skin_depths),
            settings.radius,
            settings.options.friction,
            world,
            layers,
        )
        self._layers = [layer.motion for layer in layers]
        self._world, self._time = first.world, 0.0
        self.lost = lost_links(network, self.target)
        self.tangles = (
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
                DEPENETRATION,
            )

    @property
    def positions(self) -> FloatArray:
        """Particle positions ``(N, 3)`` [m]."""
        return np.asarray(self.grid.state.motion[0])

    def move(self, motion: FloatArray, passages: IntArray | None = None) -> None:
        """Set the state: positions and velocities ``(2, N, 3)`` [m, m/s]."""
        state = self.grid.state
        new_passages = state.passages if passages is None else passages
        state = replace(state, motion=motion, passages=new_passages)
        self.grid = replace(self.grid, state=state)

    def _move_sheet(self, times: tuple[float, float], begin: FloatArray) -> None:
        """Set the motion of the collider over a frame, from points at its start."""
        if self.sheet is not None:
            motion = self.sheet.motion
            assert isinstance(motion, ClothMotion)
            motion.begin, motion.end = begin, self.positions
            motion.times = times

    def rush(self, speed: FloatArray) -> None:
        """Add a velocity ``(3,)`` [m/s] to all particles."""
        motion = self.grid.state.motion
        self.move(np.stack([motion[0], motion[1] + speed]))

    def cross(
        self, paths: PosePaths, frame: int, steering: Steering | None = None
    ) -> None:
        """Advance by a frame; frame 0 is the first of the take."""
        started = time.perf_counter()
        count = self._springs.cells
        motion = paths.of(count)
        targets = self.body.targets(motion)
        surfaces: list[Any] = []
        if self._skins:
            points = [paths.skin_points(skin, count) for skin in self._meshes]
            surfaces = self._skins.over(points)
            self._solids = [
                ClosedSurface(rows[-1], skin.triangles)
                for skin, rows in zip(self._meshes, points, strict=True)
            ]
        cells = Cells(0.0, self.grid.cell, frame * count, count)
        colliders = self._contacts.over(motion.world, cells, surfaces)
        begin_points = self.positions
        springs, pulled_to = self._springs, targets
        if steering is not None and steering.weight > 0:
            springs, pulled_to = self._springs.steered(targets, steering)
        self.grid = springs.cross(self.grid, pulled_to, colliders, self._contacts.own)
        self.target = targets[-1]
        self._world = motion.world
        self._time = (frame + 1) * self._span
        self._move_sheet((frame * self._span, self._time), begin_points)
        self.seconds += time.perf_counter() - started

    def surroundings(self) -> AttachedSurroundings:
        """Return the colliders at the end of a frame."""
        solids = [*self._solids, *self._contacts.solids(self._time)]
        layers = [
            ClosedSurface(layer.points(self._time), layer.triangles(self._time))
            for layer in self._layers
        ]
        return AttachedSurroundings(self._world, self._time, solids, layers)

    def measure(
        self, frame: float, points: FloatArray, at: AttachedSurroundings
    ) -> None:
        """Measure contact and strain of points ``(N, 3)`` [m] at a time code."""
        depths = self._contacts.depths(at.world, points, at.time)
        self.meter.measure(frame, points, self._sides, at.solids, depths, at.layers)

    def follow(self, paths: PosePaths) -> None:
        """Follow the animation for a frame without simulation."""
        self.target = self.body.targets(paths.of(1))[-1]
        motion = np.stack([self.target, np.zeros_like(self.target)])
        self.move(motion, self.grid.state.passages[:0])
        self._move_sheet((0.0, 0.0), self.positions)

    def set_target(self, pose: LocalPose) -> None:
        """Set the animated target from a pose; the state stays."""
        self.target = self.body.targets(PosePaths(self._rig, pose, pose).of(1))[0]

    def jump(self, paths: PosePaths) -> None:
        """Advance over a teleport: all particles move rigidly with the carrier."""
        motion = paths.of(1)
        self.target = self.body.targets(motion)[-1]
        shift, rotation = _move(motion.world, self.body.carrier)
        state = rigidly_moved(self.grid.state.motion, shift, rotation)
        pinned = self.body.network.pinned
        state[0, pinned] = self.target[pinned]
        self.move(state)
        self._move_sheet((0.0, 0.0), self.positions)
        self.jumps += 1

    def speed(self, paths: PosePaths) -> float:
        """Return the speed of the carrier joint over a frame [m/s]."""
        positions = paths.of(1).world.positions[:, self.body.carrier]
        return float(np.linalg.norm(positions[1] - positions[0])) / self._span


def _sides(network: Network) -> MeasuredSurface:
    """Return the sides to measure: structural springs of cloth."""
    pinned = np.zeros(network.count, np.bool_)
    pinned[network.pinned] = True
    ends, rests = network.sides, network.rests
    measured = (rests > 0) & ~pinned[ends].all(axis=1)
    measured &= len(network.triangles) > 0
    return MeasuredSurface(
        network.free, network.triangles, ends[measured], rests[measured]
    )


def rigidly_moved(
    motion: FloatArray, shift: FloatArray, rotation: FloatArray
) -> FloatArray:
    """Return a state ``(2, N, 3)`` rotated about the origin and then shifted."""
    result = so3.rotate(rotation, motion)
    result[0] += shift
    return result


def _move(world: WorldTransforms, joint: int) -> tuple[FloatArray, FloatArray]:
    """Return shift and rotation of a joint from the first to the last time."""
    rotations = so3.split_scale(world.linear[:, joint])[0]
    rotation = so3.multiply(rotations[-1], so3.conjugate(rotations[0]))
    positions = world.positions[:, joint]
    return positions[-1] - so3.rotate(rotation, positions[0]), rotation


def _size(world: WorldTransforms, joint: int) -> float:
    """Return the animated scale of a joint [1]."""
    size = float(np.cbrt(abs(np.linalg.det(world.linear[0, joint]))))
    # Rotations have a determinant of 1 up to rounding.
    return size if abs(size - 1) > 1e-9 else 1.0
