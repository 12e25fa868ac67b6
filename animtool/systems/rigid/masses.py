"""What bodies of a ragdoll weigh, where the rig states it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from animtool.core.array_types import FloatArray, IntArray
from animtool.maths import so3
from animtool.rig.kinematics import WorldTransforms
from animtool.rig.parts import Mass
from animtool.rig.skeleton import Rig
from animtool.systems.rigid.kind import Kind, principal


def weighed(
    rig: Rig, world: WorldTransforms, joints: IntArray, kinds: Sequence[Kind]
) -> list[Kind]:
    """Return bodies that weigh what the rig's masses on them do.

    A mass is of the body of its joint, or of the next above, with which it is stiff.
    Bodies without one stay as they are.

    Args:
        rig: With masses.
        world: One frame.
        joints: Of the bodies ``(N,)``.
        kinds: Of the bodies.
    """
    place = {int(j): i for i, j in enumerate(joints)}
    parts: dict[int, list[Mass]] = {}
    for mass in rig.masses:
        upwards = rig.upwards(rig.index(mass.joint))
        body = next((place[j] for j in upwards if j in place), None)
        if body is not None:
            parts.setdefault(body, []).append(mass)
    turns = so3.split_scale(world.linear[0])[0]
    found = list(kinds)
    for body, masses in parts.items():
        if all(mass.inertia is None for mass in masses):
            total = sum(mass.mass for mass in masses)
            share = total / kinds[body].mass
            moments = kinds[body].moments * share
            found[body] = replace(kinds[body], mass=total, moments=moments)
            continue
        found[body] = _of_parts(
            rig, world, turns, int(joints[body]), masses, kinds[body]
        )
    return found


def _of_parts(
    rig: Rig,
    world: WorldTransforms,
    turns: FloatArray,
    body: int,
    masses: Sequence[Mass],
    kind: Kind,
) -> Kind:
    """Return a body of several masses, in the frame of its joint."""
    back = so3.conjugate(turns[body])
    total = sum(mass.mass for mass in masses)
    centres, inertias = [], []
    for mass in masses:
        j = rig.index(mass.joint)
        at = world.positions[0, j] + so3.rotate(turns[j], np.array(mass.centre))
        centres.append(so3.rotate(back, at - world.positions[0, body]))
        turn = so3.multiply(so3.multiply(back, turns[j]), np.array(mass.axes))
        matrix = so3.to_matrix(turn)
        # One without moments is a point among the others.
        own = np.diag(mass.inertia or (0.0, 0.0, 0.0))
        inertias.append(matrix @ own @ matrix.T)
    weights = np.array([mass.mass for mass in masses])
    centre = (weights[:, None] * np.array(centres)).sum(axis=0) / total
    inertia = np.sum(inertias, axis=0)
    for weight, at in zip(weights, np.array(centres) - centre, strict=True):
        inertia = inertia + weight * ((at @ at) * np.eye(3) - np.outer(at, at))
    moments, axes = principal(inertia)
    return replace(kind, mass=total, centre=centre, moments=moments, axes=axes)
