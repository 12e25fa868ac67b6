"""What a rig and a targets file hold."""

from __future__ import annotations

from collections import Counter
from dataclasses import asdict, dataclass
from pathlib import Path

from animtool.errors import Fault
from animtool.ik.file import load_targets
from animtool.ik.tracks import PARTS
from animtool.rates import rate_label
from animtool.rig.kinematics import rest_size
from animtool.rig.shapes import arkit_name
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


@dataclass(frozen=True, slots=True)
class GoalDescription:
    """A goal in words.

    Attributes:
        effector: As the file names it.
        asks: Which parts it gives a value.
        held: Its held spans, first and last frame.
    """

    effector: str
    asks: tuple[str, ...]
    held: tuple[tuple[float, float], ...]


@dataclass(frozen=True, slots=True)
class TargetsDescription:
    """A targets file, its effectors not compared with a rig.

    Attributes:
        path: The file.
        fps: Frames a second; empty where it does not say.
        first: First frame, of its range or of all that it mentions.
        last: Last frame.
        goals: Its goals.
        notices: What is odd about it.
    """

    path: Path
    fps: str
    first: float
    last: float
    goals: tuple[GoalDescription, ...]
    notices: tuple[Fault, ...]

    def as_dict(self) -> dict[str, object]:
        """Return it as plain values for a JSON report."""
        notices = [notice.as_dict() for notice in self.notices]
        return {**asdict(self), "path": str(self.path), "notices": notices}


def describe_targets(path: Path) -> TargetsDescription:
    """Return what a targets file asks for.

    Raises:
        FormatError: It is malformed, with every fault that shows without a rig.
    """
    tracks = load_targets(path)
    clock = tracks.clock
    goals = tuple(
        GoalDescription(
            track.name,
            tuple(part for part in PARTS if track.goal.weights[PARTS.index(part)]),
            track.spans,
        )
        for track in tracks.goals
    )
    return TargetsDescription(
        path,
        "" if tracks.fps is None else rate_label(tracks.fps),
        float(clock.start),
        float(clock.start + (clock.count - 1) * clock.step),
        goals,
        tracks.notices,
    )
