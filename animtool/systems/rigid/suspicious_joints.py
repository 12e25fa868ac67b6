"""Warns of bodies whose joints fit if their quaternions have w last."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from animtool.core.array_types import FloatArray
from animtool.core.errors import Fault, counted, warning
from animtool.core.quantities import length_text, vector_text
from animtool.maths import so3
from animtool.systems.rigid.bodies import RigidBodies

# A joint outside the box of a body by more than this fraction of the body's extent is
# away from it; one outside by no more than the rounding of a file touches it [1].
MIN_OUTSIDE_RATIO, ROUNDING_TOLERANCE = 0.2, 0.01
# Fewer ends of joints may fit another rotation by chance.
MIN_FITTING_ENDS = 2


class JointEnd(NamedTuple):
    """A body of a joint, and the position of the joint."""

    joint: int  # index of the joint
    body: int  # index among all bodies
    position: FloatArray  # of the joint at the start ``(3,)`` [m]


def quaternion_order_warnings(
    bodies: RigidBodies, ends: Sequence[JointEnd]
) -> list[Fault]:
    """Return a warning if joints are at bodies only with w last (SIM127).

    None is reported if a joint is at a body as it is read, but not with w last.
    """
    outside_ends: list[tuple[float, JointEnd]] = []
    for end, distance, other_distance in _distances(bodies, ends):
        extent = bodies.kind_of(end.body).bounding_radius
        if other_distance > ROUNDING_TOLERANCE * extent:
            if distance <= MIN_OUTSIDE_RATIO * extent:
                return []
        elif distance > MIN_OUTSIDE_RATIO * extent:
            outside_ends.append((distance, end))
    if len(outside_ends) < MIN_FITTING_ENDS:
        return []
    _, end = outside_ends[0]
    name, model = bodies.names[end.body], bodies.kind_of(end.body).model
    joint_count = len({each.joint for _, each in outside_ends})
    largest_distance = max(distance for distance, _ in outside_ends)
    verb = "is" if joint_count == 1 else "are up to"
    message = f"{counted(joint_count, 'joint')} {verb} {length_text(largest_distance)} "
    message += f"outside of the bodies joined, such as {name!r}, but at them if "
    message += "`rotate` is x, y, z, w"
    x, y, z, w = model.rotate
    hint = f"`rotate` is w, x, y, z: write {vector_text((w, x, y, z), 6)} for {name!r}"
    return [warning("SIM127", message, hint, f"joints[{end.joint}].at")]


def _distances(
    bodies: RigidBodies, ends: Sequence[JointEnd]
) -> Iterator[tuple[JointEnd, float, float]]:
    """Yield distances of joints from bodies, as they are read and with w last [m]."""
    for end in ends:
        kind, pose = bodies.kind_of(end.body), bodies.poses[end.body].at(bodies.begin)
        stated_rotation = so3.normalize(np.array(kind.model.rotate, np.float64))
        rotation = stated_rotation[[1, 2, 3, 0]]
        # Copies and bodies that follow a prim have other rotations.
        if abs(float(rotation @ pose[3:])) < 1 - ROUNDING_TOLERANCE**2:
            continue
        if abs(float(rotation @ stated_rotation)) > 1 - ROUNDING_TOLERANCE:
            continue  # it is nearly the same rotation with w last
        lower = np.min([c.points.min(axis=0) - c.radius for c in kind.cores], axis=0)
        upper = np.max([c.points.max(axis=0) + c.radius for c in kind.cores], axis=0)
        distances = []
        for each in (rotation, stated_rotation):
            offset = so3.rotate(so3.conjugate(each), end.position - pose[:3])
            outside_offset = np.maximum(np.maximum(lower - offset, offset - upper), 0.0)
            distances.append(float(np.linalg.norm(outside_offset)))
        yield end, distances[0], distances[1]
