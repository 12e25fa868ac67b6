"""Colliders of an attachment: the character, cloth named before it, and the world."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from animtool import _kernels
from animtool.core.array_types import FloatArray, IntArray
from animtool.core.record import dataclass
from animtool.rig.kinematics import WorldTransforms, bind_world
from animtool.rig.skeleton import Rig
from animtool.sim.colliders import Capsule, Collider, Colliders, Sheet
from animtool.sim.colliders.on_joints import JointCapsules
from animtool.sim.contact import SPEED_LIMIT
from animtool.systems.attach.bodies import AttachedBody, ChainBody
from animtool.systems.attach.poses import PoseSamples
from animtool.systems.attach.settings import AttachSettings
from animtool.systems.attach.skins import FramePoses, SkinSurface, contact_offsets
from animtool.systems.framework.meter import (
    ClosedSurface,
    closed_surfaces,
    collider_depths,
)
from animtool.systems.springs.constraints import TimedPositions, position_at
from animtool.systems.springs.motion import TimeGrid
from animtool.systems.springs.solvers import CellColliders, cell_colliders

# Speed at which particles that start inside a collider are moved out [m/s].
DEPENETRATION_SPEED = 1.0
# Particles that start deeper than this in a collider count as unresolved [m].
UNRESOLVED_DEPTH = 1e-3


@dataclass(eq=False)
class ClothMotion:
    """Points of simulated cloth over the last simulated frame.

    Points move linearly within the frame, and are constant before and after it.
    """

    faces: IntArray  # triangles ``(T, 3)``
    path: TimedPositions  # points at the start and end of the frame ``(2, N, 3)`` [m]

    def points(self, t: float) -> FloatArray:
        """Return the points at a time [s] ``(N, 3)`` [m]."""
        return position_at(self.path, t)

    def triangles(self, t: float) -> IntArray:  # noqa: ARG002
        """Return the constant triangles ``(T, 3)``."""
        return self.faces

    def forget(self, t: float) -> None:
        """Do nothing, as only the last frame is stored."""


def capsule_distances(
    points: FloatArray, ends: FloatArray, radius: float
) -> FloatArray:
    """Return signed distances of points ``(N, 3)`` from a capsule ``(N,)`` [m].

    The ends of the capsule are ``(2, 3)`` [m].
    """
    axis = ends[1] - ends[0]
    square = float((axis * axis).sum())
    offsets = points - ends[0]
    fractions = np.zeros(len(points))
    if square > 0:
        fractions = np.clip((offsets * axis).sum(axis=1) / square, 0.0, 1.0)
    radial = offsets - fractions[:, None] * axis
    return np.asarray(np.sqrt((radial * radial).sum(axis=1)) - radius)


class CollisionSurroundings(NamedTuple):
    """Surfaces around an attachment at the end of a frame, to measure contact."""

    world: WorldTransforms  # joint transforms
    time: float  # end of the frame [s]
    solids: Sequence[ClosedSurface]  # closed surfaces, such as skins
    layers: Sequence[ClosedSurface]  # cloth of other attachments


class CharacterColliders:
    """Capsules and skins of a character, together with colliders of the world."""

    def __init__(
        self,
        rig: Rig,
        body: AttachedBody,
        settings: AttachSettings,
        start: PoseSamples,
        scale: float,
        margin: float,
        skins: Sequence[SkinSurface],
        world: Colliders,
        layers: Sequence[Sheet],
    ) -> None:
        """Set up the constants of all frames from the first pose.

        The scale [1] is that of the character in the first pose. Skins have a margin
        [m] in addition to the radius. Layers are cloth of other attachments.
        """
        options, radius = settings.options, settings.radius
        friction = options.friction
        capsules = (
            JointCapsules.from_rig(rig) if options.capsules else JointCapsules.empty()
        )
        if skins:
            # Joints with a skin collide with that instead of their capsules.
            has_skin = np.any([skin.has_joint_weight for skin in skins], axis=0)
            capsules = capsules.select(~has_skin[capsules.joints])
        self._capsules, self._radius, self._world_colliders = capsules, radius, world
        capsule_collider = Collider(
            Capsule(1.0, 0.0), friction=friction, depenetration=DEPENETRATION_SPEED
        )
        rigid_colliders = [*world, *([capsule_collider] * len(capsules))]
        sheets = [*world.sheets, *layers]
        self._colliders = Colliders(rigid_colliders, sheets, world.bodies)
        # First index and count of the character's rigid colliders.
        self.character_range = len(world), len(capsules)
        self._capsule_rows = slice(len(world), len(self._colliders))
        all_sizes = self._colliders.kernel_arrays(0.0, 0.0)[1]
        self._sizes = all_sizes[self._capsule_rows].copy()
        self._sizes[:, 6] = capsules.world_radii(start.world)
        # Capsules may be thicker than the body: points of it that start inside at bind
        # may stay that deep. Allowed signed distances, at most 0 ``(C, N)`` [m].
        points = body.network.points
        depths = np.zeros((len(capsules), len(points)))
        bind_ends = capsules.world_ends(bind_world(rig))[0]
        for c, bind_radius in enumerate((capsules.radii + radius / scale).tolist()):
            distances = capsule_distances(points, bind_ends[c], bind_radius)
            depths[c] = np.minimum(distances, 0.0)
        self._allowed_depths = scale * depths
        rigid_depths = np.zeros((len(self._colliders.rigid_colliders), len(points)))
        rigid_depths[self._capsule_rows] = self._allowed_depths
        targets = body.targets(start)[0]
        skin_depths = [
            contact_offsets(
                ClosedSurface(skin.points(start)[0], skin.triangles),
                targets,
                radius + margin,
                keeps_inside=isinstance(body, ChainBody),
            )
            for skin in skins
        ]
        self._depths = np.vstack([rigid_depths, *skin_depths])
        self._skins = skins
        self._skin_material = (0.0, friction, margin, DEPENETRATION_SPEED, SPEED_LIMIT)
        self._skin_kernels: list[Any] = []
        # The same, or None for skins in which points coincide.
        self._solid_kernels: list[Any] = []
        self._skin_solids: list[ClosedSurface] = []  # skins at the end of a frame
        self._cloth_motions = [layer.motion for layer in layers]

    def depths(
        self, surroundings: CollisionSurroundings, points: FloatArray
    ) -> FloatArray:
        """Return penetration depths of points beyond the allowed depths ``(N,)`` [m].

        Depths are in the deepest rigid collider; below 0 is outside.
        """
        depths = collider_depths(self._world_colliders, points, surroundings.time)
        radii, allowed_depths = self._sizes[:, 6], self._allowed_depths + self._radius
        for c, ends in enumerate(self._capsules.world_ends(surroundings.world)[-1]):
            distances = capsule_distances(points, ends, radii[c])
            penetration = np.minimum(allowed_depths[c], 0.0) - distances
            np.maximum(depths, penetration, out=depths)
        return depths

    def surroundings(self, world: WorldTransforms, t: float) -> CollisionSurroundings:
        """Return the surfaces at the end of the last frame, at a time [s]."""
        solids = [*self._skin_solids, *closed_surfaces(self._world_colliders, t)]
        layers = [
            ClosedSurface(motion.points(t), motion.triangles(t))
            for motion in self._cloth_motions
        ]
        return CollisionSurroundings(world, t, solids, layers)

    def kernel_arguments(
        self, frame_poses: FramePoses, grid: TimeGrid, step_count: int
    ) -> CellColliders | None:
        """Return kernel arguments for the cells of a frame; None without colliders."""
        if not self._colliders.has_any and not self._skins:
            return None
        cells = cell_colliders(self._colliders, self._radius, grid, step_count)
        world = frame_poses.sample(step_count).world
        poses, ends = self._capsules.joint_poses_and_ends(world)
        kinds, all_sizes, *materials = cells.arrays
        sizes, rows = all_sizes.copy(), self._capsule_rows
        sizes[rows] = self._sizes
        sizes[rows, :6] = ends.reshape(-1, 6)
        cells.poses[:, rows] = np.stack([poses[:-1], poses[1:]], axis=2)
        return cells._replace(
            arrays=(kinds, sizes, *materials),
            depths=np.pad(self._depths, ((0, len(cells.surfaces)), (0, 0))),
            max_depth=UNRESOLVED_DEPTH,
            surfaces=[*self._kernel_skins(frame_poses, step_count), *cells.surfaces],
        )

    def _kernel_skins(
        self, frame_poses: FramePoses, step_count: int
    ) -> list[tuple[Any, ...]]:
        """Return kernel arguments of the skins, and store their end as solids."""
        points = [frame_poses.skin_points(skin, step_count) for skin in self._skins]
        if not self._skin_kernels:
            self._skin_kernels = [
                _kernels.MeshSurface(rows[0], skin.triangles.astype(np.int32))
                for skin, rows in zip(self._skins, points, strict=True)
            ]
            self._solid_kernels = [
                kernel if len(np.unique(rows[0], axis=0)) == rows.shape[1] else None
                for kernel, rows in zip(self._skin_kernels, points, strict=True)
            ]
        solids = zip(self._skins, points, self._solid_kernels, strict=True)
        self._skin_solids = [
            ClosedSurface(rows[-1], skin.triangles, kernel)
            for skin, rows, kernel in solids
        ]
        return [
            (kernel, rows, self._skin_material, 1, 0)
            for kernel, rows in zip(self._skin_kernels, points, strict=True)
        ]
