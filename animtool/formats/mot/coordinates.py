"""Converts between columns of motion files and joint coordinates of a rig."""

from __future__ import annotations

import re

import numpy as np

from animtool.core.array_types import FloatArray
from animtool.core.record import dataclass
from animtool.maths import euler
from animtool.rig.joints import coordinate_slices, rest_coordinates
from animtool.rig.skeleton import Joint, JointType, Rig

# Rotation order of ball and free joints about rotating axes: R = Rx · Ry · Rz from the
# rest frame, as in OpenSim.
ROTATION_ORDER = "XYZ"
_TRANSLATION_SUFFIX_PATTERN = re.compile(
    r"(?:_t|_?trans(?:lation)?_?|\.translation\.)([xyz])|\.slide", re.IGNORECASE
)


@dataclass(frozen=True, slots=True)
class Coordinate:
    """An angle or a displacement of a joint, about or along one of its axes."""

    joint_index: int
    component: str  # ``angle``, ``slide``, ``rotation`` or ``translation``
    axis: int = 0  # axis of a rotation or translation

    @property
    def is_angle(self) -> bool:
        """Whether the coordinate is an angle."""
        return self.component in {"angle", "rotation"}


def list_coordinates(rig: Rig) -> list[Coordinate]:
    """Return the scalar coordinates of a rig's movable joints, in joint order."""
    coordinates = []
    for j, joint in enumerate(rig.joints):
        if joint.type is JointType.PIN:
            coordinates.append(Coordinate(j, "angle"))
        if joint.type is JointType.PRISMATIC:
            coordinates.append(Coordinate(j, "slide"))
        if joint.type in (JointType.BALL, JointType.FREE):
            coordinates += [Coordinate(j, "rotation", axis) for axis in range(3)]
        if joint.type is JointType.FREE:
            coordinates += [Coordinate(j, "translation", axis) for axis in range(3)]
    return coordinates


def coordinates_by_name(rig: Rig) -> dict[str, Coordinate]:
    """Return the coordinate of every column name that is accepted for a rig.

    These are ``knee.angle`` and ``knee`` for a pin, ``lift.slide`` and ``lift`` for a
    prismatic joint, ``hip.rotation.x`` and ``hip_x`` for a ball or free joint, and
    ``hip.translation.x`` and ``hip_tx`` for a free one. If two names are equal, a
    joint's full name takes precedence over a name with a suffix. Files separate columns
    by blanks and commas: names with these are also accepted with ``_`` instead.

    >>> door = Rig("door", (Joint("hinge", -1, JointType.PIN),))
    >>> list(coordinates_by_name(door))
    ['hinge.angle', 'hinge']
    """
    coordinate_by_name: dict[str, Coordinate] = {}
    all_coordinates = list_coordinates(rig)
    for coordinate in all_coordinates:
        coordinate_by_name[_dotted_name(rig, coordinate)] = coordinate
    for coordinate in sorted(
        all_coordinates,
        key=lambda coordinate: coordinate.component not in {"angle", "slide"},
    ):
        coordinate_by_name.setdefault(_short_name(rig, coordinate), coordinate)
    for coordinate in all_coordinates:
        name = _without_separators(_short_name(rig, coordinate))
        if name == _short_name(rig, coordinate):
            continue
        while coordinate_by_name.setdefault(name, coordinate) != coordinate:
            name += "_2"
    return coordinate_by_name


def column_names(rig: Rig, coordinates: list[Coordinate]) -> list[str]:
    """Return the column names of coordinates, short ones if they are unambiguous."""
    last_names = {c: name for name, c in coordinates_by_name(rig).items()}
    return [last_names[c] for c in coordinates]


def _without_separators(name: str) -> str:
    return "_".join(name.replace(",", " ").split())


def _dotted_name(rig: Rig, coordinate: Coordinate) -> str:
    name = f"{rig.joints[coordinate.joint_index].name}.{coordinate.component}"
    if coordinate.component in {"angle", "slide"}:
        return name
    return f"{name}.{'xyz'[coordinate.axis]}"


def _short_name(rig: Rig, coordinate: Coordinate) -> str:
    name, axis = rig.joints[coordinate.joint_index].name, "xyz"[coordinate.axis]
    suffixes = {"rotation": f"_{axis}", "translation": f"_t{axis}"}
    return name + suffixes.get(coordinate.component, "")


def parse_coordinate_name(column: str) -> str | None:
    """Return the coordinate that a column name states; None for speeds and the like.

    >>> parse_coordinate_name("/jointset/knee_r/knee_angle_r/value")
    'knee_angle_r'
    >>> parse_coordinate_name("knee_angle_r")
    'knee_angle_r'
    >>> parse_coordinate_name("/jointset/knee_r/knee_angle_r/speed")
    """
    if not column.startswith("/"):
        return column
    segments = column.split("/")
    return segments[-2] if segments[-1] == "value" and segments[-2] else None


def build_rig_from_columns(name: str, column_names: list[str]) -> Rig:
    """Return a rig with a joint for each column.

    The joint is a pin about Z, or prismatic if the name ends like a translation:
    ``pelvis_tx``, ``box_transX``.

    >>> rig = build_rig_from_columns("run", ["knee", "pelvis_ty"])
    >>> [(joint.type.value, joint.axis) for joint in rig.joints]
    [('pin', (0.0, 0.0, 1.0)), ('prismatic', (0.0, 1.0, 0.0))]
    """
    return Rig(name, tuple(_build_column_joint(column) for column in column_names))


def _build_column_joint(column: str) -> Joint:
    for match in _TRANSLATION_SUFFIX_PATTERN.finditer(column):
        if match.end() == len(column):
            axis_vectors = {"x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0)}
            axis = axis_vectors.get((match[1] or "z").lower(), (0.0, 0.0, 1.0))
            return Joint(column, -1, JointType.PRISMATIC, axis=axis)
    return Joint(column, -1, JointType.PIN)


def convert_columns_to_coordinates(
    rig: Rig, column_coordinates: list[Coordinate], values: FloatArray
) -> FloatArray:
    """Return joint coordinates ``(F, Q)`` [rad, m] of columns ``(F, C)`` [deg, m].

    Coordinates without a column are at rest.
    """
    slice_by_joint = coordinate_slices(rig)
    coordinates = rest_coordinates(rig, len(values))
    rotation_angles: dict[int, FloatArray] = {}
    for coordinate, column in zip(column_coordinates, values.T, strict=True):
        j = coordinate.joint_index
        if coordinate.component == "rotation":
            angles = rotation_angles.setdefault(j, np.zeros((len(values), 3)))
            angles[:, coordinate.axis] = column
        else:
            coordinates[:, slice_by_joint[j].start + coordinate.axis] = (
                np.radians(column) if coordinate.is_angle else column
            )
    for j, angles in rotation_angles.items():
        stop = slice_by_joint[j].stop
        coordinates[:, stop - 4 : stop] = euler.to_quaternion(angles, ROTATION_ORDER)
    return coordinates


def convert_coordinates_to_columns(
    rig: Rig, column_coordinates: list[Coordinate], coordinates: FloatArray
) -> FloatArray:
    """Return columns ``(F, C)`` [deg, m] of joint coordinates ``(F, Q)`` [rad, m]."""
    slice_by_joint = coordinate_slices(rig)
    values = np.zeros((len(coordinates), len(column_coordinates)))
    rotation_angles: dict[int, FloatArray] = {}
    for column_index, coordinate in enumerate(column_coordinates):
        j = coordinate.joint_index
        if coordinate.component == "rotation":
            if j not in rotation_angles:
                quaternions = coordinates[
                    :, slice_by_joint[j].stop - 4 : slice_by_joint[j].stop
                ]
                rotation_angles[j] = euler.from_quaternion(quaternions, ROTATION_ORDER)
            values[:, column_index] = rotation_angles[j][:, coordinate.axis]
        else:
            column = coordinates[:, slice_by_joint[j].start + coordinate.axis]
            values[:, column_index] = (
                np.degrees(column) if coordinate.is_angle else column
            )
    return values
