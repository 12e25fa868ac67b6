"""Warns of bodies whose sizes are half of what their positions allow for."""

from __future__ import annotations

import numpy as np

from animtool.core.array_types import FloatArray
from animtool.core.errors import Fault, warning
from animtool.core.quantities import length_text
from animtool.maths import so3
from animtool.sim.colliders import Box, Capsule, Colliders, Sphere
from animtool.systems.rigid.bodies import RigidBodies, locate_fault
from animtool.systems.rigid.kind import BodyKind

# Fewer bodies may be meant to fall from that height.
MIN_BODIES = 2
# Relative tolerance of a gap that is half of a height [1].
TOLERANCE = 0.01


def half_size_notices(bodies: RigidBodies, colliders: Colliders) -> list[Fault]:
    """Return a warning if bodies start half of their height above the ground (SIM200).

    All bodies that near to a fixed collider must do so: they are placed for twice their
    size, as if sizes were half extents. Bodies of meshes are not checked.
    """
    ground = Colliders([c for c in colliders if c.poses.is_fixed])
    free = bodies.dynamic_indices[
        np.isinf(bodies.release_times[bodies.dynamic_indices])
    ]
    if not len(ground) or len(free) < MIN_BODIES:
        return []
    body_gaps, body_heights = [], []
    for i in free.tolist():
        kind, pose = bodies.kind_of(i), bodies.poses[i].at(bodies.begin)
        points, radius = _core_points(kind, pose)
        samples = ground.as_solids.sample(points, bodies.begin)
        nearest = np.unravel_index(samples.distances.argmin(), samples.distances.shape)
        body_gaps.append(float(samples.distances[nearest]) - radius)
        # Any axis may be up.
        height = np.ptp(points @ samples.normals[nearest])
        body_heights.append(float(height) + 2.0 * radius)
    gaps, heights = np.array(body_gaps), np.array(body_heights)
    near = np.flatnonzero(gaps <= (0.5 + TOLERANCE) * heights)
    is_half = np.abs(gaps - heights / 2) <= TOLERANCE * heights
    if len(near) < MIN_BODIES or not is_half[near].all():
        return []
    first = int(near[0])
    kind = bodies.kind_of(int(free[first]))
    size_text = _double_size_text(kind)
    if not size_text:
        return []
    kinds = bodies.kind_of_body[free]
    count = int((kinds[near] == kinds[first]).sum())
    subject = f"{kind.model.name!r} starts" if count == 1 else f"{count} copies of "
    subject += f"{kind.model.name!r} start" if count > 1 else ""
    message = f"{subject} {length_text(gaps[first])} above the ground, half of "
    message += f"{'its' if count == 1 else 'their'} height of "
    message += length_text(heights[first])
    hint = f"sizes are full sizes, not half extents: write {size_text}"
    fault = warning("SIM200", message, hint, "shape")
    return [locate_fault(fault, kind.location, kind.origin)]


def _core_points(kind: BodyKind, pose: FloatArray) -> tuple[FloatArray, float]:
    """Return the corners of a body in the world ``(P, 3)`` and their radius [m]."""
    points = np.concatenate([core.points for core in kind.cores])
    radius = max(core.radius for core in kind.cores)
    return pose[:3] + so3.rotate(pose[3:], points), radius


def _double_size_text(kind: BodyKind) -> str:
    """Return keys of a body's shape with twice its size; empty if it has several."""
    if len(kind.shapes) != 1:
        return ""
    shape = kind.shapes[0][0]
    if isinstance(shape, Box):
        sides = [length_text(2.0 * side) for side in shape.size]
        return f"size: [{', '.join(sides)}]"
    if not isinstance(shape, Sphere | Capsule):
        return ""
    text = f"radius: {length_text(2.0 * shape.radius)}"
    if isinstance(shape, Capsule):
        text += f", length: {length_text(2.0 * shape.length)}"
    return text
