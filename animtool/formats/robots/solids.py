"""Converts link shapes and masses to rig colliders and masses."""

from __future__ import annotations

import math

import numpy as np

from animtool.core.array_types import FloatArray
from animtool.formats.robots.parts import (
    LinkMass,
    SimpleShape,
    float_quaternion,
    float_vector,
)
from animtool.maths import so3
from animtool.rig.parts import Capsule, Mass, Vector, inertia_problem


def build_capsule(solid: SimpleShape, link_offset: Vector) -> tuple[Capsule, float]:
    """Return the capsule of a shape, and its surface error [m].

    A cylinder that is longer than wide becomes a capsule of its radius and length, a
    flatter one a ball of its volume; a box becomes a capsule along its longest side
    with its cross section in area. ``link_offset`` is from the joint to the link.

    >>> rod = SimpleShape("cylinder", (0.1, 1.0))
    >>> capsule, error = build_capsule(rod, (0.0, 0.0, 0.0))
    >>> capsule.length, capsule.axis, round(error, 4)
    (0.8, (0.0, 0.0, 1.0), 0.0414)
    """
    direction, error = np.array([0.0, 0.0, 1.0]), 0.0
    if solid.kind == "sphere":
        radius, length = solid.size[0], 0.0
    elif solid.kind == "capsule":
        radius, length = solid.size
    elif solid.kind == "cylinder":
        radius, length, error = _cylinder_capsule(*solid.size)
    else:
        sides = np.array(solid.size)
        direction = np.eye(3)[int(np.argmax(sides))]
        radius, length, error = _box_capsule(*sorted(sides.tolist()))
    axis = so3.rotate(solid.rotation, direction)
    offset = np.array(solid.position) + np.array(link_offset)
    return Capsule(radius, length, float_vector(axis), float_vector(offset)), error


def _cylinder_capsule(radius: float, height: float) -> tuple[float, float, float]:
    """Return radius and length of a capsule for a cylinder, and the surface error."""
    if height >= 2 * radius:
        return radius, height - 2 * radius, (math.sqrt(2) - 1) * radius
    ball_radius = (0.75 * radius * radius * height) ** (1 / 3)
    corner = math.hypot(radius, height / 2)
    return ball_radius, 0.0, max(corner - ball_radius, ball_radius - height / 2)


def _box_capsule(
    shortest: float, middle: float, longest: float
) -> tuple[float, float, float]:
    """Return radius and length of a capsule for a box, and the surface error."""
    radius = math.sqrt(shortest * middle / math.pi)
    length = max(longest - 2 * radius, 0.0)
    corner = math.hypot(shortest / 2, middle / 2, (longest - length) / 2)
    return radius, length, max(corner - radius, radius - shortest / 2)


def build_mass(joint: str, link_mass: LinkMass, link_offset: Vector) -> Mass:
    """Return a joint's mass and principal inertia; its link is at ``link_offset``."""
    principal_inertia, axes = np.linalg.eigh(link_mass.inertia)
    if np.linalg.det(axes) < 0:
        axes[:, 0] = -axes[:, 0]
    a, b, c = np.maximum(principal_inertia, 0.0).tolist()
    centre = float_vector(np.array(link_mass.centre) + np.array(link_offset))
    rotation = float_quaternion(so3.from_matrix(axes))
    return Mass(joint, link_mass.mass, centre, (a, b, c), rotation)


def find_mass_problem(mass: float, inertia: FloatArray) -> str:
    """Return the reason why mass and inertia ``(3, 3)`` are impossible, else ""."""
    if not mass > 0:
        return f"its mass is {mass:g} kg"
    problem = inertia_problem(np.linalg.eigvalsh(inertia).tolist())
    return f"its moments of inertia, {problem}" if problem else ""
