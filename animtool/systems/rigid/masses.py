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
from animtool.systems.rigid.cores import point_inertia
from animtool.systems.rigid.kind import BodyKind, principal_inertia


def with_rig_masses(
    rig: Rig, world: WorldTransforms, joints: IntArray, kinds: Sequence[BodyKind]
) -> list[BodyKind]:
    """Return body kinds with their masses replaced by those of the rig.

    A mass is added to the body of its joint, or of the next ancestor that has a body.
    Bodies without a mass in the rig are unchanged.

    Args:
        rig: Rig with masses.
        world: World transforms of one frame.
        joints: Joints of the bodies ``(N,)``.
        kinds: Kind of each body.
    """
    body_of_joint = {int(j): i for i, j in enumerate(joints)}
    masses_by_body: dict[int, list[Mass]] = {}
    for mass in rig.masses:
        ancestors = rig.upwards(rig.index(mass.joint))
        body = next((body_of_joint[j] for j in ancestors if j in body_of_joint), None)
        if body is not None:
            masses_by_body.setdefault(body, []).append(mass)
    rotations = so3.split_scale(world.linear[0])[0]
    result = list(kinds)
    for body, masses in masses_by_body.items():
        kind, joint = kinds[body], int(joints[body])
        if all(mass.inertia is None for mass in masses):
            total = sum(mass.mass for mass in masses)
            moments = kind.moments * (total / kind.mass)
            result[body] = replace(kind, mass=total, moments=moments)
        else:
            result[body] = _combined_body(rig, world, rotations, joint, masses, kind)
    return result


def _combined_body(
    rig: Rig,
    world: WorldTransforms,
    rotations: FloatArray,
    body: int,
    masses: Sequence[Mass],
    kind: BodyKind,
) -> BodyKind:
    """Return a body kind with the combined masses of several joints."""
    world_to_body = so3.conjugate(rotations[body])
    total = sum(mass.mass for mass in masses)
    centres, inertias = [], []
    for mass in masses:
        j = rig.index(mass.joint)
        offset = so3.rotate(rotations[j], np.array(mass.centre))
        position = world.positions[0, j] + offset
        centres.append(so3.rotate(world_to_body, position - world.positions[0, body]))
        rotation = so3.multiply(world_to_body, rotations[j])
        matrix = so3.to_matrix(so3.multiply(rotation, np.array(mass.axes)))
        # A mass without inertia is a point mass.
        local_inertia = np.diag(mass.inertia or (0.0, 0.0, 0.0))
        inertias.append(matrix @ local_inertia @ matrix.T)
    mass_values = np.array([mass.mass for mass in masses])
    centre = (mass_values[:, None] * np.array(centres)).sum(axis=0) / total
    inertia = np.sum(inertias, axis=0)
    for mass_value, position in zip(mass_values, centres, strict=True):
        inertia = inertia + point_inertia(mass_value, position - centre)
    moments, axes = principal_inertia(inertia)
    return replace(kind, mass=total, centre=centre, moments=moments, axes=axes)
