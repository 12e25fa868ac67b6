"""Describes rigs and targets files."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

from animtool.core.errors import Fault
from animtool.core.rates import rate_label
from animtool.core.record import dataclass
from animtool.core.units import unit_name
from animtool.ik.file import load_targets
from animtool.rig.drivers import Driver
from animtool.rig.kinematics import rest_size
from animtool.rig.shapes import arkit_name
from animtool.rig.skeleton import Rig
from animtool.rig.surfaces import Surface, surfaces_of


@dataclass(frozen=True, slots=True)
class MeshDescription:
    """Counts of a mesh's points, faces, influences and shapes."""

    name: str  # name in the rig
    points: int  # number of points
    faces: int  # number of faces
    method: str | None  # skinning method; None if it has no skin
    joints: int  # joints that influence it
    influences: int  # most influences of one point
    shapes: int  # number of blend shapes


@dataclass(frozen=True, slots=True)
class RigDescription:
    """Facts about a rig, as `animtool info` prints them."""

    path: str  # path of the file
    name: str  # name of the rig
    joints: dict[str, int]  # number of joints, by type
    limited: int  # joints with limits
    size: float  # diagonal of the joints' bounds at rest, in ``units``
    meshes: list[MeshDescription]  # one a mesh
    shapes: int  # number of blend shapes
    combined: int  # shapes that combine other shapes
    arkit: int  # number of ARKit's 52 shapes
    controls: int  # number of controls
    control_names: list[str]  # their names
    driven: list[str]  # drivers, as formulas
    ik: int  # number of IK chains
    attach: int  # number of attachments
    colliders: int  # number of colliders
    mass: float | None  # total mass of the joints [kg]; None if no joint has one
    units: str  # unit of the file
    up: str  # up axis
    notices: list[Fault]  # warnings and notes

    @property
    def others(self) -> dict[str, int]:
        """Number of chains, attachments and colliders of a rig, by noun."""
        counts = {
            "chain": self.ik,
            "attachment": self.attach,
            "collider": self.colliders,
        }
        return {noun: count for noun, count in counts.items() if count}


def describe_rig(path: Path | str, rig: Rig, notices: list[Fault]) -> RigDescription:
    """Describe an open rig, with its notices."""
    joint_types = Counter(str(joint.type) for joint in rig.joints)
    return RigDescription(
        str(path),
        rig.name,
        dict(joint_types),
        sum(joint.limits is not None for joint in rig.joints),
        rest_size(rig) / rig.meters_per_unit,
        list(map(_describe_mesh, surfaces_of(rig))),
        len(rig.shapes),
        sum(bool(shape.combine) for shape in rig.shapes),
        len({arkit_name(shape.name) for shape in rig.shapes} - {None}),
        len(rig.controls),
        [control.name for control in rig.controls],
        _driver_formulas(rig),
        len(rig.chains),
        len(rig.attach),
        len(rig.colliders),
        sum(mass.mass for mass in rig.masses) if rig.masses else None,
        unit_name(rig.meters_per_unit),
        rig.up.value,
        notices,
    )


def _describe_mesh(surface: Surface) -> MeshDescription:
    method, joint_count, max_influences = None, 0, 0
    if surface.skin is not None:
        method, joint_count = surface.skin.method, len(surface.skin.joints)
        max_influences = int((surface.skin.weights > 0).sum(axis=1).max(initial=0))
    return MeshDescription(
        surface.name, len(surface.points), len(surface.counts),
        method, joint_count, max_influences, len(surface.shapes),
    )  # fmt: skip


def _driver_formulas(rig: Rig) -> list[str]:
    """Return the formulas of drivers, such as ``joint roll = wrist.twist / 2``."""
    if not rig.is_driven:
        return []
    drivers = [
        *(("joint", joint.name, joint.driven) for joint in rig.joints),
        *(("shape", shape.name, shape.driven) for shape in rig.shapes),
        *(("control", control.name, control.driven) for control in rig.controls),
    ]
    return [
        f"{kind} {name} = {_formula(driver)}"
        for kind, name, driver in drivers
        if driver is not None
    ]


def _formula(driver: Driver) -> str:
    if driver.expression is not None:
        return driver.expression.text
    kind = "smooth curve" if driver.is_smooth else "curve"
    return f"{kind} of {driver.curve_input}"


@dataclass(frozen=True, slots=True)
class GoalDescription:
    """Effector, goal kinds and hold spans of one goal."""

    effector: str  # name in the file
    asks: tuple[str, ...]  # goal kinds, such as position or orientation
    held: tuple[tuple[float, float], ...]  # hold spans, first and last frame


@dataclass(frozen=True, slots=True)
class TargetsDescription:
    """Description of a targets file, which is not checked against a rig."""

    path: Path  # path of the file
    fps: str  # frames per second; empty if not stated
    first: float  # first frame of its range, or of all its keys
    last: float  # last frame
    goals: tuple[GoalDescription, ...]
    notices: tuple[Fault, ...]  # warnings and notes


def describe_targets(path: Path) -> TargetsDescription:
    """Read and describe a targets file.

    Raises:
        FormatError: It cannot be read or is malformed.
    """
    tracks = load_targets(path)
    clock = tracks.clock
    kind_names_by_goal = [
        tuple(kind.name for kind in track.goal.kinds) for track in tracks.goals
    ]
    goals = tuple(
        GoalDescription(track.name, kind_names, track.spans)
        for track, kind_names in zip(tracks.goals, kind_names_by_goal, strict=True)
    )
    return TargetsDescription(
        path,
        "" if tracks.fps is None else rate_label(tracks.fps),
        float(clock.start),
        float(clock.span.last),
        goals,
        tracks.notices,
    )
