"""Joint coordinates to local transforms and back, and the names of joint parts.

Coordinates q of a joint, in this order, in one row of a ``(F, Q)`` array:

========== = ==========================================================
free       7 translation [m], quaternion (x, y, z, w)
ball       4 quaternion (x, y, z, w)
pin        1 angle about the axis [rad]
prismatic  1 slide along the axis [m]
fixed      0
========== = ==========================================================

All are relative to the rest frame: ``local = T(rest) · R(rest) · motion(q)``.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from animtool.core.array_types import ArrayLike, FloatArray, as_floats
from animtool.core.names import MAX_NAME_LENGTH, most_similar
from animtool.core.record import dataclass
from animtool.maths import so3
from animtool.rig.skeleton import COORDINATE_WIDTHS, JointType, Rig


@dataclass(frozen=True, slots=True)
class LocalTransforms:
    """Local transforms of every joint, parent space."""

    translations: FloatArray  # ``(F, J, 3)`` [m]
    rotations: FloatArray  # unit quaternions ``(F, J, 4)``


def coordinate_slices(rig: Rig) -> list[slice]:
    """Return the slice of each joint's coordinates in a row of q."""
    first_columns = rig.joint_arrays.columns.tolist()
    return [
        slice(first, first + COORDINATE_WIDTHS[joint.type])
        for joint, first in zip(rig.joints, first_columns, strict=True)
    ]


def rest_coordinates(rig: Rig, frame_count: int) -> FloatArray:
    """Return the joint coordinates ``(F, Q)`` of the rest pose."""
    slices = coordinate_slices(rig)
    coordinates = np.zeros((frame_count, slices[-1].stop if slices else 0))
    for joint, columns in zip(rig.joints, slices, strict=True):
        if joint.type in {JointType.BALL, JointType.FREE}:
            coordinates[:, columns.stop - 1] = 1.0
    return coordinates


def local_from_coordinates(rig: Rig, coordinates: ArrayLike) -> LocalTransforms:
    """Return the local transforms of joint coordinates ``(F, Q)``.

    Quaternions are normalised. Limits are not applied.

    Raises:
        ValueError: Q does not fit the rig.

    >>> from animtool.rig.skeleton import Joint
    >>> door = Rig("door", (Joint("hinge", -1, JointType.PIN, axis=(0, 1, 0)),))
    >>> local = local_from_coordinates(door, [[np.pi]])
    >>> local.rotations[0, 0].round(12).tolist()
    [0.0, 1.0, 0.0, 0.0]
    """
    # Imported here, since reading rigs needs no kernels.
    from animtool import _kernels

    q = as_floats(coordinates, ("F", rig.coordinates), "coordinates")
    local = _kernels.coordinates_to_local(
        *rig.joint_arrays, rig.rest_translations, rig.rest_rotations, q
    )
    return LocalTransforms(*local)


def project_to_coordinates(rig: Rig, local: LocalTransforms) -> FloatArray:
    """Project local transforms to joint coordinates ``(F, Q)``.

    Motion that a joint's type does not allow is dropped: a pin keeps the rotation about
    its axis, a prismatic joint the slide along it. Pin angles are continuous along F.
    """
    joint_count = len(rig.joints)
    translations = as_floats(local.translations, ("F", joint_count, 3), "translations")
    rotations = as_floats(local.rotations, ("F", joint_count, 4), "rotations")
    slices = coordinate_slices(rig)
    coordinates = np.zeros((len(translations), slices[-1].stop if slices else 0))
    for j, (joint, columns) in enumerate(zip(rig.joints, slices, strict=True)):
        inverse_rest = so3.conjugate(rig.rest_rotations[j])
        rotation = so3.multiply(inverse_rest, rotations[:, j])
        offset = so3.rotate(inverse_rest, translations[:, j] - rig.rest_translations[j])
        match joint.type:
            case JointType.FREE:
                coordinates[:, columns] = np.concatenate(
                    [offset, so3.align_signs(rotation)], axis=1
                )
            case JointType.BALL:
                coordinates[:, columns] = so3.align_signs(rotation)
            case JointType.PIN:
                sine_along_axis = rotation[:, :3] @ np.asarray(joint.axis)
                coordinates[:, columns.start] = np.unwrap(
                    2.0 * np.arctan2(sine_along_axis, rotation[:, 3])
                )
                if len(coordinates):
                    revolutions = (
                        2
                        * np.pi
                        * np.round(coordinates[0, columns.start] / (2 * np.pi))
                    )
                    coordinates[:, columns.start] -= revolutions
            case JointType.PRISMATIC:
                coordinates[:, columns.start] = offset @ np.asarray(joint.axis)
            case JointType.FIXED:
                continue
    return coordinates


_ROTATING_TYPES = (JointType.FREE, JointType.BALL)
_ALL_TYPES = tuple(JointType)

# Parts that a control may add to, and joint types that have them.
DRIVEN_PARTS: dict[str, tuple[JointType, ...]] = {
    "angle": (JointType.PIN,),
    "slide": (JointType.PRISMATIC,),
    **{f"rotation.{axis}": _ROTATING_TYPES for axis in "xyz"},
    **{f"translation.{axis}": (JointType.FREE,) for axis in "xyz"},
}
# Parts that a clip's channel may key.
KEYED_PARTS: dict[str, tuple[JointType, ...]] = {
    "angle": (JointType.PIN,),
    "slide": (JointType.PRISMATIC,),
    "rotation": _ROTATING_TYPES,
    "translation": (JointType.FREE,),
    "local_translation": _ALL_TYPES,
    "local_rotation": _ALL_TYPES,
    "scale": _ALL_TYPES,
}


# Other tools' names of joint parts, without an axis.
_PART_SYNONYMS = {
    "position": "translation",
    "translate": "translation",
    "location": "translation",
    "pos": "translation",
    "t": "translation",
    "rotate": "rotation",
    "rotationeuler": "rotation",
    "orientation": "rotation",
    "rot": "rotation",
    "r": "rotation",
    "quaternion": "rotation",
    "quat": "rotation",
}
# Parts of joints with one degree of freedom.
_SINGLE_PARTS = {
    (JointType.PIN, "rotation"): "angle",
    (JointType.PRISMATIC, "translation"): "slide",
}


def part_hint(
    text: str,
    parts: Mapping[str, Sequence[JointType]],
    joint_type: JointType | None = None,
) -> str:
    """Return a hint that suggests the joint part for a misspelled target.

    Args:
        text: The target: the joint's name, and an unknown part.
        parts: Allowed parts, and the joints that have them.
        joint_type: Type of the joint; None if unknown.

    >>> part_hint("elbow_l.angel", KEYED_PARTS)
    "did you mean '.angle'?"
    >>> part_hint("knee.rotateX", DRIVEN_PARTS, JointType.PIN)
    'the part is .angle'
    """
    allowed_parts = [
        part
        for part, kinds in parts.items()
        if joint_type is None or joint_type in kinds
    ]
    text_parts = text[-MAX_NAME_LENGTH:].split(".")
    suffixes = [".".join(text_parts[i:]) for i in range(1, len(text_parts))]
    for suffix in suffixes:
        normalized_name = re.sub("[._]", "", suffix.lower())
        name_without_axis = normalized_name
        if normalized_name[-1:] in ("x", "y", "z"):
            name_without_axis = normalized_name[:-1]
        intended_part = _PART_SYNONYMS.get(name_without_axis, name_without_axis)
        axis = normalized_name[-1] if name_without_axis != normalized_name else "x"
        single_part = (
            _SINGLE_PARTS.get((joint_type, intended_part))
            if joint_type is not None
            else None
        )
        for part in (single_part, intended_part, f"{intended_part}.{axis}"):
            if part in allowed_parts:
                return f"the part is .{part}"
    similar_part = next(
        filter(None, (most_similar(suffix, allowed_parts) for suffix in suffixes)), None
    )
    if similar_part is not None:
        return f"did you mean '.{similar_part}'?"
    if joint_type is None:
        return f"write a joint's name and one of .{', .'.join(allowed_parts)}"
    allowed_text = (
        f".{', .'.join(allowed_parts)}" if allowed_parts else "nothing that moves"
    )
    return f"a {joint_type} joint has {allowed_text}"


def split_part(text: str, parts: Iterable[str]) -> tuple[str, str]:
    """Split a target into joint name and part; the part may be empty.

    >>> split_part("arm.l.rotation.x", DRIVEN_PARTS)
    ('arm.l', 'rotation.x')
    """
    for part in sorted(parts, key=len, reverse=True):
        if text.endswith(f".{part}"):
            return text[: -len(part) - 1], part
    return text, ""
