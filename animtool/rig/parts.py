"""Parts of a rig: meshes, shapes, chains, attachments, colliders; their order."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from enum import StrEnum
from graphlib import CycleError, TopologicalSorter
from pathlib import Path
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from animtool.core.array_types import FloatArray
from animtool.core.errors import cycle_text
from animtool.core.record import dataclass
from animtool.documents.arrays import Archives, load_array

if TYPE_CHECKING:
    from animtool.rig.drivers import Driver

Vector = tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class ArrayRef:
    """A reference to an array in an npz file."""

    text: str  # as spelled in its file, ``face.npz#smile``
    path: Path  # resolved path of the file
    key: str  # name of the array in the file

    def load(self, archives: Archives | None = None) -> FloatArray:
        """Return the read-only array.

        Args:
            archives: Cache of open files.

        Raises:
            ValueError: The array cannot be read or has non-finite values.
        """
        if archives is None:
            return load_array(self.path, self.key)
        return archives.load(self.path, self.key)


@dataclass(frozen=True, slots=True, eq=False)
class LoadedArray:
    """An array in memory, from a file that contains the complete rig."""

    values: FloatArray  # finite values

    def load(self, _archives: Archives | None = None) -> FloatArray:
        """Return the array in memory; open files are not needed."""
        return self.values

    def __eq__(self, other: object) -> bool:
        """Return whether the values are equal."""
        if not isinstance(other, LoadedArray):
            return NotImplemented
        return bool(np.array_equal(self.values, other.values))

    def __hash__(self) -> int:
        """Return a hash of the shape; values are only compared."""
        return hash(self.values.shape)


ArraySource: TypeAlias = ArrayRef | LoadedArray


class Subdivision(StrEnum):
    """Subdivision scheme of a surface."""

    NONE = "none"
    CATMULL_CLARK = "catmull_clark"
    LOOP = "loop"
    BILINEAR = "bilinear"


@dataclass(frozen=True, slots=True)
class Skin:
    """Skin binding of a mesh."""

    method: str  # ``linear`` or ``dual_quaternion``
    joints: tuple[str, ...]  # names of the joints that the indices count
    indices: ArraySource  # ``(V, I)`` into ``joints``
    weights: ArraySource  # ``(V, I)`` [1]


@dataclass(frozen=True, slots=True)
class Mesh:
    """A polygon mesh of a rig, with references to its arrays.

    Attributes:
        name: Unique name among the rig's meshes.
        points: Vertex positions ``(V, 3)`` in the rig's unit.
        faces: Vertex indices ``(N, K)``; -1 fills a face of fewer than K vertices.
        normals: ``(V, 3)``; None if the mesh has none.
        geom_bind: World transform of the points at bind time, 16 numbers row by row,
            for column vectors; None for the identity.
        skin: Skin binding; None if the mesh follows no joint.
        subdivision: Subdivision scheme; None means no subdivision for meshes with
            normals, else Catmull-Clark.
    """

    name: str
    points: ArraySource
    faces: ArraySource
    normals: ArraySource | None = None
    geom_bind: tuple[float, ...] | None = None
    skin: Skin | None = None
    subdivision: Subdivision | None = None


@dataclass(frozen=True, slots=True)
class Inbetween:
    """Deltas of a shape at a weight between 0 and 1."""

    at: float  # weight of the shape at which the deltas apply
    deltas: ArraySource  # offsets, of the same array shape as the blend shape's deltas
    # Likewise for the normals; None leaves them unchanged.
    normals: ArraySource | None = None


@dataclass(frozen=True, slots=True)
class Shape:
    """A blend shape of a rig, with references to its arrays.

    Attributes:
        name: Unique name among the rig's shapes.
        mesh: Name of the mesh that it deforms.
        deltas: Vertex offsets added at weight 1 ``(V, 3)``.
        normals: Offsets of the normals ``(V, 3)``; None leaves them unchanged.
        inbetweens: In-betweens, ascending by weight.
        combine: Names of the shapes whose product of weights is this shape's weight;
            empty for an independent shape.
        vertices: Indices of the vertices of deltas, normals and inbetweens ``(N,)``;
            None for all vertices.
        driven: Driver of the shape's weight.
    """

    name: str
    mesh: str = ""
    deltas: ArraySource | None = None
    normals: ArraySource | None = None
    inbetweens: tuple[Inbetween, ...] = ()
    combine: tuple[str, ...] = ()
    vertices: ArraySource | None = None
    driven: Driver | None = None


@dataclass(frozen=True, slots=True)
class IkChain:
    """A chain that reaches for a goal."""

    name: str  # unique among the rig's chains
    root: str  # name of the first joint
    tip: str  # name of the last joint
    goal: str = "pose"  # ``position``, ``orientation`` or ``pose``
    # Direction of the chain's middle joint in the frame of the root joint's parent;
    # None leaves it undefined.
    pole_dir: Vector | None = None
    stretch: float = 0.0  # fraction of its length by which it may stretch


class AttachKind(StrEnum):
    """Known kinds of attachments."""

    SPRING_CHAIN = "spring_chain"
    CLOTH = "cloth"
    STRANDS = "strands"


@dataclass(frozen=True, slots=True)
class Attachment:
    """Geometry or joints that a simulation moves."""

    name: str  # unique among the rig's attachments
    kind: str  # one of `AttachKind`; other names are allowed for joints
    # Joints that move; for strands the joint that carries their roots; none for cloth.
    joints: tuple[str, ...] = ()
    mesh: str = ""  # mesh of a cloth
    # For cloth, the vertices that stay with the skin ``(N,)``; None for none.
    pins: ArraySource | None = None
    # For strands, points from root to tip in the world at bind time ``(S, K, 3)``, in
    # the rig's unit.
    points: ArraySource | None = None


@dataclass(frozen=True, slots=True)
class Capsule:
    """A cylinder with round ends, in the frame of a joint.

    Attributes:
        radius: Radius of the cylinder and its ends [m].
        length: Distance between the centres of its ends [m]; 0 for a ball.
        axis: Unit direction of the cylinder.
        offset: Centre of the cylinder, from the joint's origin [m].
    """

    radius: float
    length: float
    axis: Vector = (0.0, 1.0, 0.0)
    offset: Vector = (0.0, 0.0, 0.0)


@dataclass(frozen=True, slots=True)
class Collider:
    """A capsule that moves with a joint and that simulations collide with."""

    joint: str
    capsule: Capsule


@dataclass(frozen=True, slots=True)
class Mass:
    """Mass properties of a joint's rigid body, in the joint's frame.

    Attributes:
        joint: Name of the joint.
        mass: Mass above 0 [kg].
        centre: Centre of mass, from the joint's origin [m].
        inertia: Moments about the principal axes through the centre [kg m²]; None uses
            those of the colliders.
        axes: Rotation of these axes in the joint's frame, a quaternion (x, y, z, w).
    """

    joint: str
    mass: float
    centre: Vector = (0.0, 0.0, 0.0)
    inertia: Vector | None = None
    axes: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 1.0)


# Rounding tolerance of the triangle inequality, as a fraction of the sum.
INERTIA_TOLERANCE = 1e-3


def inertia_problem(inertia: Sequence[float]) -> str:
    """Return why moments of inertia are impossible; empty if valid.

    >>> inertia_problem([1.0, 1.0, 2.0]), inertia_problem([1.0, 1.0, 3.0])
    ('', 'of 1, 1, 3 kg m² one is above the sum of the others')
    """
    smallest, middle, largest = sorted(inertia)
    inertia_text = ", ".join(f"{value:.3g}" for value in inertia)
    if smallest < -INERTIA_TOLERANCE * largest or not middle > 0:
        return f"{inertia_text} kg m² are not all above 0"
    if largest > (smallest + middle) * (1 + INERTIA_TOLERANCE):
        return f"of {inertia_text} kg m² one is above the sum of the others"
    return ""


class DependencyCycleError(ValueError):
    """Parts of a rig depend on each other in a cycle.

    Attributes:
        cycle: Names of the parts, each depending on the next; the first one again at
            the end.
    """

    def __init__(self, cycle: list[str]) -> None:
        self.cycle = cycle
        super().__init__(cycle_text(cycle))


def dependency_order(dependencies_by_name: Mapping[str, Iterable[str]]) -> list[str]:
    """Return names in dependency order: each after those that it depends on.

    >>> dependency_order({"both": ["smile", "jaw"]})
    ['smile', 'jaw', 'both']
    """
    try:
        return list(TopologicalSorter(dependencies_by_name).static_order())
    except CycleError as error:
        # The sorter names each part before those that need it; reverse that.
        raise DependencyCycleError(list(reversed(error.args[1]))) from error
