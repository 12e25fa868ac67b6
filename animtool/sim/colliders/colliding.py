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
from animtool.core.errors import Fault, OptionError, warning
from animtool.core.record import dataclass
from animtool.sim.colliders.bodies import MovingBodies
from animtool.sim.colliders.collider import Collider
from animtool.sim.colliders.shapes import Box, Capsule, Mesh, Plane, Sphere
from animtool.sim.colliders.sheets import Sheet, collide_with_sheet
from animtool.sim.colliders.surfaces import Surfaces

_KINDS: dict[type, int] = {Plane: 0, Sphere: 1, Capsule: 2, Box: 3, Mesh: 4}
_SIZES = 7
_NO_MESH: tuple[Any, ...] = (
    np.zeros((0, 3)),
    np.zeros((0, 3), np.int32),
    np.zeros((0, 3)),
    np.zeros((0, 3, 3)),
    np.zeros((0, 6)),
    np.zeros((0, 2), np.int32),
)


class Touch(IntEnum):
    """The kind of contact a particle had in a step.

    Attributes:
        NONE: Not at all.
        BOUNCED: It hit one and left it.
        RESTS: It is on one, and slides there if it moves.
        UNRESOLVED: It is still inside one, on its way out or held by several.
    """

    NONE = 0
    BOUNCED = 1
    RESTS = 2
    UNRESOLVED = 3


@dataclass(frozen=True, slots=True)
class Contacts:
    """The last contact of each particle in a step.

    Attributes:
        colliders: Index of the collider ``(N,)``, those of bodies behind the others and
            those of sheets behind these, -1 where there was none.
        touches: How, as of `Touch` ``(N,)``.
        normals: The way out of it ``(N, 3)``.
    """

    colliders: IntArray
    touches: IntArray
    normals: FloatArray

    @property
    def any(self) -> BoolArray:
        """Whether each particle touched a collider ``(N,)``."""
        return self.colliders >= 0


@dataclass(frozen=True, slots=True)
class Collided:
    """Particles at the end of a step, after contact.

    Attributes:
        points: ``(N, 3)`` [m].
        velocities: ``(N, 3)`` [m/s].
        contacts: What they met.
    """

    points: FloatArray
    velocities: FloatArray
    contacts: Contacts


@dataclass(frozen=True, slots=True)
class Samples:
    """Distances, normals and velocities of C colliders at N points.

    Attributes:
        distances: From the surfaces less the margins, negative inside ``(C, N)`` [m].
        normals: Ways out ``(C, N, 3)``.
        velocities: Of the surfaces ``(C, N, 3)`` [m/s].
    """

    distances: FloatArray
    normals: FloatArray
    velocities: FloatArray


class Colliders(Sequence[Collider]):
    """A set of colliders, prepared for repeated queries.

    Attributes:
        sheets: Surfaces that change their shape, which are no members.
        surfaces: These, ready for many steps at once.
        bodies: What other simulations move, which are no members.

    Raises:
        OptionError: Something of them makes no sense (SIM020).
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
        # All rigid colliders, in the kernels' numbering.
        rigid = [
            *self._colliders,
            *(one for system in bodies for one in system.colliders),
        ]
        self.rigid = len(rigid)
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
        self._meshes, roots = _meshes([c.shape for c in rigid])
        self._kinds = np.array(
            [
                (_KINDS[type(c.shape)], _side(c), root)
                for c, root in zip(rigid, roots, strict=True)
            ],
            np.int64,
        ).reshape(-1, 3)
        self._sizes = np.zeros((len(rigid), _SIZES))
        for row, collider in zip(self._sizes, rigid, strict=True):
            sizes = collider.shape.sizes()
            row[: len(sizes)] = sizes
        self._materials = np.array([c.material for c in rigid]).reshape(-1, 4)
        self._poses = np.array(
            [np.stack([c.poses.rows[0]] * 2) for c in rigid]
        ).reshape(-1, 2, 7)
        self._moving = [
            i for i, c in enumerate(self._colliders) if len(c.poses.sample_times) > 1
        ]

    def __len__(self) -> int:
        """Return the number of colliders."""
        return len(self._colliders)

    @property
    def active(self) -> bool:
        """Whether there are any."""
        return bool(self.rigid or self.sheets)

    def __getitem__(self, index: Any) -> Any:
        """Return one, or a subset."""
        return self._colliders[index]

    def arrays(self, t0: float, t1: float) -> tuple[Any, ...]:
        """Return the kernel's arrays for a step between two times [s]."""
        poses = self._poses.copy()
        for i in self._moving:
            poses[i] = self._colliders[i].ends(t0, t1)
        poses[len(self) :] = self.body_ends(t0, t1)
        return self._kinds, self._sizes, self._materials, poses, *self._meshes

    def body_ends(self, t0: float, t1: float) -> FloatArray:
        """Return poses ``(B, 2, 7)`` of bodies at both ends of a step [s]."""
        ends = [system.ends(t0, t1) for system in self.bodies]
        return np.concatenate([np.zeros((0, 2, 7)), *ends])

    def sample(self, points: ArrayLike, t0: float, t1: float | None = None) -> Samples:
        """Sample signed distances at points ``(N, 3)`` and a time [s].

        Velocities are those of the step that begins then.
        """
        positions = as_floats(points, ("N", 3), "points")
        end = t0 if t1 is None else t1
        return Samples(
            *_kernels.sample_colliders(self.arrays(t0, end), positions, 0.0, end - t0)
        )

    @cached_property
    def volumes(self) -> Colliders:
        """The same colliders, with watertight meshes as solids."""
        volumes = [
            one.volume()
            if isinstance(one.shape, Mesh) and one.shape.watertight
            else one
            for one in self
        ]
        if all(a is b for a, b in zip(volumes, self, strict=True)):
            return self
        return Colliders(volumes, self.sheets, self.bodies)

    @property
    def fastest(self) -> float:
        """The highest collider speed [m/s]; teleports do not count.

        Of surfaces and bodies so far.
        """
        moving = (system.fastest for system in self.bodies)
        return max(self._fastest, self.surfaces.fastest, *moving)

    @cached_property
    def _fastest(self) -> float:
        return max((collider.speed for collider in self._colliders), default=0.0)

    def notices(self) -> list[Fault]:
        """Return a warning for each teleport (SIM120).

        Of surfaces, so far.
        """
        return [*self._jumps(), *self.surfaces.notices()]

    def _jumps(self) -> list[Fault]:
        return [
            _jump(collider, collider.name or f"colliders[{i}]", k)
            for i, collider in enumerate(self._colliders)
            for k in np.flatnonzero(collider.jumps).tolist()
        ]


def _side(collider: Collider) -> int:
    """Return the side it collides on: 0 outside, 1 inside, 2 both."""
    if collider.container:
        return 1
    return 2 if isinstance(collider.shape, Mesh) and not collider.shape.closed else 0


def _jump(collider: Collider, where: str, k: int) -> Fault:
    speed, when = collider.speed_limit, collider.poses.sample_times[k + 1]
    message = (
        f"it moves faster than {speed:g} m/s until {when:g} s: it collides with nothing"
    )
    hint = "raise its speed limit if it should collide on its way"
    return warning("SIM120", message, hint, where)


def collide(
    points: ArrayLike,
    velocities: ArrayLike,
    before: ArrayLike,
    colliders: Colliders | Sequence[Collider],
    t0: float,
    t1: float,
    radii: ArrayLike = 0.0,
    begins: ArrayLike | None = None,
) -> Collided:
    """Return particles after contact at the end of a step.

    Paths are parabolas from the step's start to its end, so that nothing is passed
    through however long the step is. A particle bounces at the moment of contact and
    goes on from there; where it would be back on the surface within the step, it stays
    there and slides against friction. What meets nothing is returned bit for bit.

    Args:
        points: Where the step led ``(N, 3)`` [m].
        velocities: There ``(N, 3)`` [m/s].
        before: Positions, then velocities at the start of the step ``(2, N, 3)``.
        colliders: What they may run into.
        t0: Start of the step [s].
        t1: Its end [s].
        radii: Of the particles ``(N,)``, or one [m].
        begins: From when on particles are there that come within the step ``(N,)``
            [s]; `before` is then. None is from its start.

    Raises:
        OptionError: Something of the colliders makes no sense (SIM020).

    >>> from animtool.sim.colliders import Collider, Plane
    >>> floor = Collider(Plane(), restitution=0.5)
    >>> above = [[[0, 1, 0]], [[0, -2, 0]]]
    >>> done = collide([[0, -1, 0]], [[0, -2, 0]], above, [floor], 0, 1)
    >>> done.points.tolist(), done.velocities.tolist()
    ([[0.0, 0.5, 0.0]], [[0.0, 1.0, 0.0]])
    """
    ready = colliders if isinstance(colliders, Colliders) else Colliders(colliders)
    positions = as_floats(points, ("N", 3), "points")
    after = np.stack(
        [positions, as_floats(velocities, (len(positions), 3), "velocities")]
    )
    start = as_floats(before, (2, len(positions), 3), "before")
    sizes = np.ascontiguousarray(np.broadcast_to(radii, len(positions)), np.float64)
    late = np.zeros(len(positions)) if begins is None else np.subtract(begins, t0)
    at_sheets = _hold_at_sheets(ready, start, after, (t0, t1), sizes, late)
    state, touches, normals = _kernels.collide_particles(
        ready.arrays(t0, t1), start, after, sizes, late, t1 - t0
    )
    for rows, touched, directions in at_sheets:
        only = touches[rows, 0] < 0
        touches[rows[only]], normals[rows[only]] = touched[only], directions[only]
    contacts, touched = touches.T.copy()
    return Collided(state[0], state[1], Contacts(contacts, touched, normals))


def _hold_at_sheets(
    ready: Colliders,
    start: FloatArray,
    after: FloatArray,
    span: tuple[float, float],
    sizes: FloatArray,
    late: FloatArray,
) -> list[tuple[IntArray, IntArray, FloatArray]]:
    """Stop particles at sheets in place; return which ones touched them.

    What is rigid comes after them: particles between both are held by that.
    """
    step, contacts = span[1] - span[0], []

    def settle(
        collider: Collider,
        begin: FloatArray,
        end: FloatArray,
        radii: FloatArray,
        begins: FloatArray,
    ) -> Any:
        arrays = Colliders([collider]).arrays(*span)
        return _kernels.collide_particles(arrays, begin, end, radii, begins, step)

    for i, sheet in enumerate(ready.sheets if step > 0 else ()):
        met = collide_with_sheet(sheet, start, after, span, sizes, late, settle)
        if met is None:
            continue
        near, (state, touches, normals) = met
        hit = touches[:, 0] >= 0
        rows = near[hit]
        after[:, rows] = state[:, hit]
        touches[hit, 0] = ready.rigid + i
        contacts.append((rows, touches[hit], normals[hit]))
    return contacts


def _meshes(shapes: Sequence[object]) -> tuple[tuple[Any, ...], list[int]]:
    """Return the arrays of all meshes joined, and the tree node of each shape."""
    parts = [_NO_MESH]
    roots, shift = [], np.zeros(3, np.int32)
    for shape in shapes:
        roots.append(int(shift[2]))
        if isinstance(shape, Mesh):
            part = _mesh(shape, *shift.tolist())
            parts.append(part)
            shift += [len(part[0]), len(part[1]), len(part[5])]
    return tuple(np.concatenate(arrays) for arrays in zip(*parts, strict=True)), roots


def _mesh(shape: Mesh, points: int, triangles: int, nodes: int) -> tuple[Any, ...]:
    """Return a mesh's arrays, numbered after those of the meshes before it."""
    welded, corners = shape.welded()
    order, by_corner, by_edge, bounds, tree = _kernels.build_mesh_tree(welded, corners)
    leaf = tree[:, :1] < 0
    tree = np.where(leaf, tree - [triangles, 0], tree + nodes).astype(np.int32)
    return welded, order + np.int32(points), by_corner, by_edge, bounds, tree
