"""What a rig has beside joints: meshes, shapes, chains, attachments, colliders."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

__all__ = [
    "ArrayRef",
    "Attachment",
    "Capsule",
    "Collider",
    "IkChain",
    "Inbetween",
    "Mesh",
    "Shape",
    "Skin",
]

Vector = tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class ArrayRef:
    """An array in an npz file.

    Attributes:
        text: As its file spells it, ``face.npz#smile``.
        path: The file, resolved.
        key: Name of the array.
    """

    text: str
    path: Path
    key: str


@dataclass(frozen=True, slots=True)
class Skin:
    """How a mesh follows joints.

    Attributes:
        method: ``linear`` or ``dual_quaternion``.
        joints: Names of the joints that the indices count.
        indices: ``(V, I)`` into ``joints``.
        weights: ``(V, I)`` [1].
    """

    method: str
    joints: tuple[str, ...]
    indices: ArrayRef
    weights: ArrayRef


@dataclass(frozen=True, slots=True)
class Mesh:
    """A surface.

    Attributes:
        name: Unique among the rig's meshes.
        points: ``(V, 3)`` in the rig's unit.
        faces: ``(N, 3 or 4)`` indices, -1 fills a triangle.
        normals: ``(V, 3)``; None where the mesh has none.
        geom_bind: World transform of the points at bind time, 16 numbers row by row,
            for column vectors; None is identity.
        skin: None where it follows no joint.
    """

    name: str
    points: ArrayRef
    faces: ArrayRef
    normals: ArrayRef | None = None
    geom_bind: tuple[float, ...] | None = None
    skin: Skin | None = None


@dataclass(frozen=True, slots=True)
class Inbetween:
    """The deltas of a shape at a weight between 0 and 1."""

    at: float
    deltas: ArrayRef


@dataclass(frozen=True, slots=True)
class Shape:
    """A blend shape.

    Attributes:
        name: Unique among the rig's shapes.
        mesh: Name of the mesh that it shapes.
        deltas: ``(V, 3)`` added at weight 1.
        normals: ``(V, 3)`` added to the normals; None leaves them.
        inbetweens: Ascending by weight.
        combine: Names of the shapes whose weights' product is this one's; empty for
            a shape with a weight of its own.
    """

    name: str
    mesh: str = ""
    deltas: ArrayRef | None = None
    normals: ArrayRef | None = None
    inbetweens: tuple[Inbetween, ...] = ()
    combine: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class IkChain:
    """A chain that reaches for a goal.

    Attributes:
        name: Unique among the rig's chains.
        root: Name of its first joint.
        tip: Name of its last.
        goal: ``position``, ``orientation`` or ``pose``.
        pole_dir: Where its middle points, in the frame of the root joint's parent;
            None leaves it open.
        stretch: Share of its length that it may grow by.
    """

    name: str
    root: str
    tip: str
    goal: str = "pose"
    pole_dir: Vector | None = None
    stretch: float = 0.0


@dataclass(frozen=True, slots=True)
class Attachment:
    """Joints that a simulation moves."""

    name: str
    kind: str
    joints: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Capsule:
    """A cylinder with round ends, in the frame of a joint.

    Attributes:
        radius: Of the cylinder and its ends [m].
        length: Of the cylinder, between the centres of its ends [m]; 0 is a ball.
        axis: Unit direction of the cylinder.
        offset: Centre of the cylinder, from the joint's origin [m].
    """

    radius: float
    length: float
    axis: Vector = (0.0, 1.0, 0.0)
    offset: Vector = (0.0, 0.0, 0.0)


@dataclass(frozen=True, slots=True)
class Collider:
    """What a simulation may not pass through, in the frame of a joint."""

    joint: str
    capsule: Capsule
