"""Masses of ragdoll bodies, from the rig."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from animtool.core.array_types import FloatArray, IntArray
from animtool.maths import so3
from animtool.rig.kinematics import WorldTransforms
from animtool.rig.parts import Mass
from animtool.rig.skeleton import Rig
from animtool.systems.rigid.kind import BodyKind, principal


def weighed(
    rig: Rig, world: WorldTransforms, joints: IntArray, kinds: Sequence[BodyKind]
) -> list[BodyKind]:
    """Return bodies with the masses that the rig states.

    A mass is of the body of its joint, or of the next above, with which it is stiff.
    Bodies without one stay as they are.

    Args:
        rig: With masses.
        world: One frame.
        joints: Of the bodies ``(N,)``.
        kinds: Of the bodies.
    """
    numbers = {int(j): i for i, j in enumerate(joints)}
    parts: dict[int, list[Mass]] = {}
    for mass in rig.masses:
        upwards = rig.upwards(rig.index(mass.joint))
        body = next((numbers[j] for j in upwards if j in numbers), None)
        if body is not None:
            parts.setdefault(body, []).append(mass)
    rotations = so3.split_scale(world.linear[0])[0]
    weighed_kinds = list(kinds)
    for body, masses in parts.items():
        if all(mass.inertia is None for mass in masses):
            total = sum(mass.mass for mass in masses)
            factor = total / kinds[body].mass
            moments = kinds[body].moments * factor
            weighed_kinds[body] = replace(kinds[body], mass=total, moments=moments)
            continue
        weighed_kinds[body] = _of_parts(
            rig, world, rotations, int(joints[body]), masses, kinds[body]
        )
    return weighed_kinds


def _of_parts(
    rig: Rig,
    world: WorldTransforms,
    rotations: FloatArray,
    body: int,
    masses: Sequence[Mass],
    kind: BodyKind,
) -> BodyKind:
    """Return a body of several point masses, in the frame of its joint."""
    back = so3.conjugate(rotations[body])
    total = sum(mass.mass for mass in masses)
    centres, inertias = [], []
    for mass in masses:
        j = rig.index(mass.joint)
        at = world.positions[0, j] + so3.rotate(rotations[j], np.array(mass.centre))
        centres.append(so3.rotate(back, at - world.positions[0, body]))
        rotation = so3.multiply(so3.multiply(back, rotations[j]), np.array(mass.axes))
        matrix = so3.to_matrix(rotation)
        # One without inertia is a point mass.
        local_inertia = np.diag(mass.inertia or (0.0, 0.0, 0.0))
        inertias.append(matrix @ local_inertia @ matrix.T)
    weights = np.array([mass.mass for mass in masses])
    centre = (weights[:, None] * np.array(centres)).sum(axis=0) / total
    inertia = np.sum(inertias, axis=0)
    for weight, at in zip(weights, np.array(centres) - centre, strict=True):
        inertia = inertia + weight * ((at @ at) * np.eye(3) - np.outer(at, at))
    moments, axes = principal(inertia)
    return replace(kind, mass=total, centre=centre, moments=moments, axes=axes)
