"""Collision of particles with colliders at the end of a step."""

from __future__ import annotations

from collections.abc import Sequence
from enum import IntEnum
from functools import cached_property
from typing import Any

import numpy as np

from animtool import _kernels
from animtool.core.array_types import (
    ArrayLike,
    BoolArray,
    FloatArray,
    IntArray,
    as_floats,
)
from animtool.core.errors import Fault, OptionError
from animtool.core.record import dataclass
from animtool.sim.colliders.bodies import MovingBodies
from animtool.sim.colliders.collider import Collider
from animtool.sim.colliders.shapes import Box, Capsule, Mesh, Plane, Sphere
from animtool.sim.colliders.sheets import (
    Sheet,
    Surfaces,
    nearby_states,
    teleport_warning,
)

_SHAPE_KINDS: dict[type, int] = {Plane: 0, Sphere: 1, Capsule: 2, Box: 3, Mesh: 4}
# Columns for the sizes of a shape; a capsule has most.
_SIZES_PER_SHAPE = 7
_NO_MESH: tuple[Any, ...] = (
    np.zeros((0, 3)),
    np.zeros((0, 3), np.int32),
    np.zeros((0, 3)),
    np.zeros((0, 3, 3)),
    np.zeros((0, 6)),
    np.zeros((0, 2), np.int32),
)


class ContactKind(IntEnum):
    """The kind of contact a particle had in a step.

    Attributes:
        NONE: No contact.
        BOUNCED: The particle hit a collider and left it.
        RESTS: The particle is on the surface of a collider, at rest or sliding.
        UNRESOLVED: The particle remains inside a collider, moving out or blocked.
    """

    NONE = 0
    BOUNCED = 1
    RESTS = 2
    UNRESOLVED = 3


@dataclass(frozen=True, slots=True)
class Contacts:
    """The last contact of each of N particles in a step.

    Attributes:
        colliders: Index of the collider ``(N,)``, -1 for no contact; colliders of
            bodies come after the others, sheets after them.
        touches: Kind of contact, a `ContactKind` ``(N,)``.
        normals: Unit normals out of the collider ``(N, 3)``.
    """

    colliders: IntArray
    touches: IntArray
    normals: FloatArray

    @property
    def any(self) -> BoolArray:
        """Mask of the particles that touched a collider ``(N,)``."""
        return self.colliders >= 0


@dataclass(frozen=True, slots=True)
class CollisionResult:
    """Particles at the end of a step, after contact.

    Attributes:
        points: Positions ``(N, 3)`` [m].
        velocities: Velocities ``(N, 3)`` [m/s].
        contacts: The last contact of each particle.
    """

    points: FloatArray
    velocities: FloatArray
    contacts: Contacts


@dataclass(frozen=True, slots=True)
class ColliderSamples:
    """Distances, normals and velocities of C colliders at N points."""

    # Distances from the surfaces minus the margins, negative inside (C, N) [m].
    distances: FloatArray
    normals: FloatArray  # unit normals out of the colliders (C, N, 3)
    velocities: FloatArray  # velocities of the surfaces (C, N, 3) [m/s]


class Colliders(Sequence[Collider]):
    """A set of colliders, prepared for repeated queries.

    Attributes:
        rigid_colliders: Colliders of the sequence, then those of bodies, as kernels
            number them.
        sheets: Deforming surfaces; not members of the sequence.
        surfaces: The sheets, prepared for many substeps in one call.
        bodies: Bodies of other simulations; not members of the sequence.

    Raises:
        OptionError: A collider is invalid (SIM020).
    """

    def __init__(
        self,
        colliders: Sequence[Collider],
        sheets: Sequence[Sheet] = (),
        bodies: Sequence[MovingBodies] = (),
    ) -> None:
        self._colliders = tuple(colliders)
        self.sheets = tuple(sheets)
        self.bodies = tuple(bodies)
        body_colliders = [
            collider for system in bodies for collider in system.colliders
        ]
        rigid = self.rigid_colliders = (*self._colliders, *body_colliders)
        self.surfaces = Surfaces(self.sheets)
        faults = [
            fault
            for i, collider in enumerate(self._colliders)
            for fault in collider.faults(collider.name or f"colliders[{i}]")
        ]
        for i, sheet in enumerate(self.sheets):
            faults += sheet.faults(sheet.name or f"sheets[{i}]")
        if faults:
            raise OptionError(faults)
        self._meshes, root_nodes = _mesh_arrays([c.shape for c in rigid])
        kind_rows = [
            (_SHAPE_KINDS[type(c.shape)], _active_side(c), root)
            for c, root in zip(rigid, root_nodes, strict=True)
        ]
        self._kinds = np.array(kind_rows, np.int64).reshape(-1, 3)
        self._sizes = np.zeros((len(rigid), _SIZES_PER_SHAPE))
        for row, collider in zip(self._sizes, rigid, strict=True):
            sizes = collider.shape.sizes()
            row[: len(sizes)] = sizes
        self._materials = np.array([c.material for c in rigid]).reshape(-1, 4)
        first_poses = [[c.poses.rows[0]] * 2 for c in rigid]
        self._poses = np.array(first_poses).reshape(-1, 2, 7)
        is_moving = [not collider.poses.is_fixed for collider in self._colliders]
        self._moving_indices = np.flatnonzero(is_moving).tolist()

    def __len__(self) -> int:
        """Return the number of colliders."""
        return len(self._colliders)

    @property
    def has_any(self) -> bool:
        """Whether the set contains any collider."""
        return bool(self.rigid_colliders or self.sheets)

    def __getitem__(self, index: Any) -> Any:
        """Return a collider, or a slice of them."""
        return self._colliders[index]

    def label(self, index: int) -> str:
        """Return the quoted name of one of the `rigid_colliders`, or its key."""
        name = self.rigid_colliders[index].name
        return repr(name) if name else f"colliders[{index}]"

    def kernel_arrays(self, t0: float, t1: float) -> tuple[Any, ...]:
        """Return the kernel's arrays for a step between two times [s]."""
        poses, times = self._poses.copy(), np.array([t0, t1])
        for i in self._moving_indices:
            (poses[i],) = self._colliders[i].end_poses(times)
        poses[len(self) :] = self.body_end_poses(t0, t1)
        return self._kinds, self._sizes, self._materials, poses, *self._meshes

    def body_end_poses(self, t0: float, t1: float) -> FloatArray:
        """Return poses ``(B, 2, 7)`` of bodies at both ends of a step [s]."""
        ends = [system.end_poses(t0, t1) for system in self.bodies]
        return np.concatenate([np.zeros((0, 2, 7)), *ends])

    def sample(
        self, points: ArrayLike, t0: float, t1: float | None = None
    ) -> ColliderSamples:
        """Sample signed distances at points ``(N, 3)`` and a time [s].

        Velocities are those of the step that begins at ``t0``.
        """
        positions = as_floats(points, ("N", 3), "points")
        end_time = t0 if t1 is None else t1
        return ColliderSamples(
            *_kernels.sample_colliders(
                self.kernel_arrays(t0, end_time), positions, 0.0, end_time - t0
            )
        )

    @cached_property
    def as_solids(self) -> Colliders:
        """The same colliders, with watertight meshes as solids."""
        solids = [
            collider.as_solid()
            if isinstance(collider.shape, Mesh) and collider.shape.is_watertight
            else collider
            for collider in self
        ]
        if all(a is b for a, b in zip(solids, self, strict=True)):
            return self
        return Colliders(solids, self.sheets, self.bodies)

    @property
    def max_speed(self) -> float:
        """Maximum speed of any collider, teleports excluded [m/s].

        For surfaces and bodies, the highest so far.
        """
        body_speeds = (system.max_speed for system in self.bodies)
        return max(self._max_static_speed, self.surfaces.max_speed, *body_speeds)

    @cached_property
    def _max_static_speed(self) -> float:
        """Return the maximum speed of any rigid collider, teleports excluded [m/s]."""
        return max((collider.max_speed for collider in self._colliders), default=0.0)

    def notices(self) -> list[Fault]:
        """Return a warning for each teleport (SIM120); surfaces report those so far."""
        hint = "raise its speed limit if it should collide on its way"
        notices = [
            teleport_warning(
                collider.speed_limit, t, collider.name or f"colliders[{i}]", hint
            )
            for i, collider in enumerate(self._colliders)
            for t in collider.poses.sample_times[1:][collider.teleports].tolist()
        ]
        return notices + self.surfaces.notices()


def _active_side(collider: Collider) -> int:
    """Return the side on which a collider acts: 0 outside, 1 inside, 2 both."""
    if collider.container:
        return 1
    return 2 if isinstance(collider.shape, Mesh) and not collider.shape.closed else 0


def collide(
    points: ArrayLike,
    velocities: ArrayLike,
    before: ArrayLike,
    colliders: Colliders | Sequence[Collider],
    t0: float,
    t1: float,
    radii: ArrayLike = 0.0,
    spawned_at: ArrayLike | None = None,
) -> CollisionResult:
    """Return particles after contact at the end of a step.

    Paths are parabolas from the step's start to its end, so that particles do not
    tunnel, however long the step is. A particle bounces at the time of contact and
    continues from there; if it would return to the surface within the step, it stays
    there and slides with friction. Particles without contact are returned bit for bit.

    Args:
        points: Positions at the end of the step without contacts ``(N, 3)`` [m].
        velocities: Velocities at the end of the step ``(N, 3)`` [m/s].
        before: Positions and velocities at the start of the step ``(2, N, 3)``.
        colliders: Colliders to test against.
        t0: Start of the step [s].
        t1: End of the step [s].
        radii: Particle radii ``(N,)``, or one for all [m].
        spawned_at: Spawn times of particles that spawn within the step ``(N,)`` [s], at
            which they have the state `before`; None for the start of the step.

    Raises:
        OptionError: A collider is invalid (SIM020).

    >>> from animtool.sim.colliders import Collider, Plane
    >>> floor = Collider(Plane(), restitution=0.5)
    >>> above = [[[0, 1, 0]], [[0, -2, 0]]]
    >>> result = collide([[0, -1, 0]], [[0, -2, 0]], above, [floor], 0, 1)
    >>> result.points.tolist(), result.velocities.tolist()
    ([[0.0, 0.5, 0.0]], [[0.0, 1.0, 0.0]])
    """
    if not isinstance(colliders, Colliders):
        colliders = Colliders(colliders)
    positions = as_floats(points, ("N", 3), "points")
    particle_count = len(positions)
    end_velocities = as_floats(velocities, (particle_count, 3), "velocities")
    end_state = np.stack([positions, end_velocities])
    start_state = as_floats(before, (2, particle_count, 3), "before")
    radius_array = np.ascontiguousarray(
        np.broadcast_to(radii, particle_count), np.float64
    )
    spawn_times = (
        np.zeros(particle_count) if spawned_at is None else np.subtract(spawned_at, t0)
    )
    sheet_contacts = _stop_at_sheets(
        colliders, start_state, end_state, (t0, t1), radius_array, spawn_times
    )
    state, touches, normals = _kernels.collide_particles(
        colliders.kernel_arrays(t0, t1),
        start_state,
        end_state,
        radius_array,
        spawn_times,
        t1 - t0,
    )
    for indices, contact_kinds, sheet_normals in sheet_contacts:
        is_untouched = touches[indices, 0] < 0
        touches[indices[is_untouched]] = contact_kinds[is_untouched]
        normals[indices[is_untouched]] = sheet_normals[is_untouched]
    collider_indices, contact_kinds = touches.T.copy()
    return CollisionResult(
        state[0], state[1], Contacts(collider_indices, contact_kinds, normals)
    )


def _stop_at_sheets(
    collider_set: Colliders,
    start_state: FloatArray,
    end_state: FloatArray,
    interval: tuple[float, float],
    radii: FloatArray,
    spawn_times: FloatArray,
) -> list[tuple[IntArray, IntArray, FloatArray]]:
    """Stop particles at sheets, changing ``end_state``; return contacts of each sheet.

    Rigid colliders are applied afterwards, so that they win over sheets.
    """
    (t0, t1), contacts = interval, []
    for i, sheet in enumerate(collider_set.sheets if t1 > t0 else ()):
        nearby = nearby_states(
            sheet, start_state, end_state, interval, radii, spawn_times
        )
        if nearby is None:
            continue
        indices = nearby.indices
        state, touches, normals = _kernels.collide_particles(
            Colliders([nearby.collider]).kernel_arrays(t0, t1),
            nearby.start,
            nearby.end,
            radii[indices],
            spawn_times[indices],
            t1 - t0,
        )
        state[1] += nearby.velocity
        is_touching = touches[:, 0] >= 0
        indices = indices[is_touching]
        end_state[:, indices] = state[:, is_touching]
        touches[is_touching, 0] = len(collider_set.rigid_colliders) + i
        contacts.append((indices, touches[is_touching], normals[is_touching]))
    return contacts


def _mesh_arrays(shapes: Sequence[object]) -> tuple[tuple[Any, ...], list[int]]:
    """Return concatenated arrays of all meshes, and the root node of each shape."""
    meshes = [_NO_MESH]
    root_nodes, offsets = [], np.zeros(3, np.int32)
    for shape in shapes:
        root_nodes.append(int(offsets[2]))
        if isinstance(shape, Mesh):
            arrays = _offset_mesh(shape, *offsets.tolist())
            meshes.append(arrays)
            offsets += [len(arrays[0]), len(arrays[1]), len(arrays[5])]
    return tuple(
        np.concatenate(arrays) for arrays in zip(*meshes, strict=True)
    ), root_nodes


def _offset_mesh(
    shape: Mesh, point_offset: int, triangle_offset: int, node_offset: int
) -> tuple[Any, ...]:
    """Return the arrays of a mesh, with indices offset past earlier meshes."""
    points, corners = shape.weld()
    sorted_triangles, by_corner, by_edge, bounds, tree = _kernels.build_mesh_tree(
        points, corners
    )
    is_leaf = tree[:, :1] < 0
    tree = np.where(is_leaf, tree - [triangle_offset, 0], tree + node_offset)
    tree = tree.astype(np.int32)
    triangles = sorted_triangles + np.int32(point_offset)
    return points, triangles, by_corner, by_edge, bounds, tree
