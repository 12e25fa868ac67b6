"""What a rig holds."""

from __future__ import annotations

from collections import Counter
from dataclasses import asdict, dataclass
from pathlib import Path

from animtool.errors import Fault
from animtool.rig.arkit import arkit_name
from animtool.rig.kinematics import rest_size
from animtool.rig.skeleton import Rig
from animtool.rig.surfaces import surfaces_of
from animtool.units import unit_name


@dataclass(frozen=True, slots=True)
class MeshDescription:
    """A mesh in numbers.

    Attributes:
        name: As the rig names it.
        points: Number of points.
        faces: Number of faces.
        method: How it follows joints; None where it follows none.
        joints: Joints that it follows.
        influences: Most joints that one point follows.
        shapes: Blend shapes that it has.
    """

    name: str
    points: int
    faces: int
    method: str | None
    joints: int
    influences: int
    shapes: int


@dataclass(frozen=True, slots=True)
class RigDescription:
    """A rig in numbers.

    Attributes:
        path: The file.
        name: What the rig is called.
        joints: Number of joints, by type.
        limited: Joints with limits.
        size: Diagonal of the joints' bounds at rest, in ``units``.
        meshes: One a mesh.
        shapes: Number of blend shapes.
        combined: Those that combine others.
        arkit: How many of ARKit's 52 shapes there are.
        controls: Number of controls.
        ik: Number of chains that reach for goals.
        attach: Number of attachments.
        colliders: Number of colliders.
        units: Unit of the file.
        up: Up axis.
        notices: What is odd.
    """

    path: str
    name: str
    joints: dict[str, int]
    limited: int
    size: float
    meshes: list[MeshDescription]
    shapes: int
    combined: int
    arkit: int
    controls: int
    ik: int
    attach: int
    colliders: int
    units: str
    up: str
    notices: list[Fault]

    def as_dict(self) -> dict[str, object]:
        """Return plain values for a JSON report."""
        return {**asdict(self), "notices": [n.as_dict() for n in self.notices]}


def describe_rig(path: Path | str, rig: Rig, notices: list[Fault]) -> RigDescription:
    """Describe a rig.

    Args:
        path: Its file, for the report.
        rig: It, opened.
        notices: What was said when it was opened.

    Raises:
        FormatError: An array of the rig cannot be read.
    """
    types = Counter(str(joint.type) for joint in rig.joints)
    meshes = [
        MeshDescription(
            surface.name,
            len(surface.points),
            len(surface.counts),
            None if surface.skin is None else surface.skin.method,
            0 if surface.skin is None else len(surface.skin.joints),
            0
            if surface.skin is None
            else int((surface.skin.weights > 0).sum(axis=1).max(initial=0)),
            len(surface.shapes),
        )
        for surface in surfaces_of(rig)
    ]
    return RigDescription(
        str(path),
        rig.name,
        dict(types),
        sum(joint.limits is not None for joint in rig.joints),
        rest_size(rig) / rig.meters_per_unit,
        meshes,
        len(rig.shapes),
        sum(bool(shape.combine) for shape in rig.shapes),
        len({arkit_name(shape.name) for shape in rig.shapes} - {None}),
        len(rig.controls),
        len(rig.ik),
        len(rig.attach),
        len(rig.colliders),
        unit_name(rig.meters_per_unit),
        rig.up.value,
        notices,
    )
