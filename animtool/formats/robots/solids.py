"""Link shapes and masses as rig colliders and masses."""

from __future__ import annotations

import math

import numpy as np

from animtool.core.array_types import FloatArray
from animtool.formats.robots.parts import SimpleShape, Weight, quaternion, vector
from animtool.maths import so3
from animtool.rig.mass_entries import inertia_problem
from animtool.rig.parts import Capsule, Mass, Vector


def capsule_of(solid: SimpleShape, shift: Vector) -> tuple[Capsule, float]:
    """Return the capsule of a shape, and its surface error [m].

    A cylinder that is longer than wide has a capsule of its radius and length, a
    flatter one a ball of its volume; a box has a capsule along its longest side, as
    thick as its cross section in area. ``shift`` is from the joint to the link.

    >>> rod = SimpleShape("cylinder", (0.1, 1.0))
    >>> capsule, off = capsule_of(rod, (0.0, 0.0, 0.0))
    >>> capsule.length, capsule.axis, round(off, 4)
    (0.8, (0.0, 0.0, 1.0), 0.0414)
    """
    along, far = np.array([0.0, 0.0, 1.0]), 0.0
    if solid.kind == "sphere":
        radius, length = solid.size[0], 0.0
    elif solid.kind == "capsule":
        radius, length = solid.size
    elif solid.kind == "cylinder":
        radius, length, far = _round(*solid.size)
    else:
        sides = np.array(solid.size)
        along = np.eye(3)[int(np.argmax(sides))]
        radius, length, far = _square(*sorted(sides.tolist()))
    axis = so3.rotate(solid.rotation, along)
    offset = np.array(solid.position) + np.array(shift)
    return Capsule(radius, length, vector(axis), vector(offset)), far


def _round(radius: float, height: float) -> tuple[float, float, float]:
    """Return radius, length and error of a cylinder's capsule."""
    if height >= 2 * radius:
        return radius, height - 2 * radius, (math.sqrt(2) - 1) * radius
    ball = (0.75 * radius * radius * height) ** (1 / 3)
    return ball, 0.0, max(math.hypot(radius, height / 2) - ball, ball - height / 2)


def _square(thin: float, wide: float, long: float) -> tuple[float, float, float]:
    """Return radius, length and error of a box's capsule."""
    radius = math.sqrt(thin * wide / math.pi)
    length = max(long - 2 * radius, 0.0)
    corner = math.hypot(thin / 2, wide / 2, (long - length) / 2)
    return radius, length, max(corner - radius, radius - thin / 2)


def masses_of(joint: str, weight: Weight, shift: Vector) -> Mass:
    """Return a rig joint's mass; ``shift`` is from joint to link."""
    principal, axes = np.linalg.eigh(weight.inertia)
    if np.linalg.det(axes) < 0:
        axes[:, 0] = -axes[:, 0]
    a, b, c = np.maximum(principal, 0.0).tolist()
    centre = vector(np.array(weight.centre) + np.array(shift))
    rotation = quaternion(so3.from_matrix(axes))
    return Mass(joint, weight.mass, centre, (a, b, c), rotation)


def weight_problem(mass: float, inertia: FloatArray) -> str:
    """Return why mass and inertia ``(3, 3)`` are impossible; empty if possible."""
    if not mass > 0:
        return f"its mass is {mass:g} kg"
    problem = inertia_problem(np.linalg.eigvalsh(inertia).tolist())
    return f"its moments of inertia, {problem}" if problem else ""
