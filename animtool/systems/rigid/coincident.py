"""Warns of bodies at the same position, which are likely copies of each other."""

from __future__ import annotations

import numpy as np

from animtool.core.errors import Fault, counted, warning
from animtool.systems.rigid.bodies import RigidBodies, locate_fault
from animtool.systems.rigid.joints import Joints
from animtool.systems.rigid.kind import BodyKind

# A joint this near to the centre of a body, relative to its bounding radius, links
# bodies that coincide on purpose, such as those of a gimbal [1].
_MAX_GIMBAL_OFFSET = 0.01
# Decimals of equal positions and rotations.
_DECIMALS = 9


def coincident_pairs(bodies: RigidBodies, joints: Joints) -> list[tuple[int, int]]:
    """Return pairs of equal shape, position and rotation, the second a dynamic body.

    Bodies joined at their centres are excluded.
    """
    gimbal_pairs = {
        frozenset(joint.excluded_pair)
        for joint, parameters in zip(joints.members, joints.parameters, strict=True)
        if float(np.linalg.norm(parameters[7:10]))
        <= _MAX_GIMBAL_OFFSET * bodies.bounding_radii[joint.bodies[1]]
    }
    shape_keys = [_shape_key(kind) for kind in bodies.kinds]
    first_body_by_key: dict[tuple[object, ...], int] = {}
    pairs = []
    for i, pose in enumerate(bodies.poses):
        pose_values = np.round(pose.at(bodies.begin), _DECIMALS) + 0.0
        key = (shape_keys[int(bodies.kind_of_body[i])], *pose_values.tolist())
        first_body = first_body_by_key.setdefault(key, i)
        is_dynamic = bodies.is_dynamic[i] or bodies.is_dynamic[first_body]
        if (
            first_body != i
            and is_dynamic
            and frozenset((first_body, i)) not in gimbal_pairs
        ):
            pairs.append((first_body, i))
    return pairs


def _shape_key(kind: BodyKind) -> tuple[object, ...]:
    """Return a key that is equal for bodies of equal shapes and masses."""
    shapes = kind.model.model_dump(include={"shape", "shapes"})
    # The points of a mesh are not in the model.
    numbers = np.concatenate([[kind.mass], kind.centre, kind.moments])
    return repr(shapes), *(f"{number:.9g}" for number in numbers.tolist())


def coincident_notices(
    bodies: RigidBodies, pairs: list[tuple[int, int]]
) -> list[Fault]:
    """Return a warning for each entry whose bodies coincide with others (SIM126)."""
    pairs_by_kind: dict[int, list[tuple[int, int]]] = {}
    for pair in pairs:
        pairs_by_kind.setdefault(int(bodies.kind_of_body[pair[1]]), []).append(pair)
    notices = []
    for kind_index, kind_pairs in pairs_by_kind.items():
        first, second = (bodies.names[i] for i in kind_pairs[0])
        message = f"{second!r} has the shape, position and rotation of {first!r}"
        if len(kind_pairs) > 1:
            message += f", and {counted(len(kind_pairs) - 1, 'other')} of another body"
        hint = "was it copied? move it, or remove it"
        kind = bodies.kinds[kind_index]
        fault = warning("SIM126", message, hint, "at")
        notices.append(locate_fault(fault, kind.location, kind.origin))
    return notices
