"""Where an effector is without its goal, and the way from there to its targets."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from animtool._types import FloatArray
from animtool.ik.chain import limb_joints
from animtool.ik.goals import Goal
from animtool.maths import so3
from animtool.rig.kinematics import WorldTransforms
from animtool.rig.skeleton import JointType, Rig

__all__ = ["FreeEffector", "swung"]

# Shorter than this share of what it points along, a direction is unknown.
UNKNOWN = 1e-6


@dataclass(frozen=True, slots=True)
class FreeEffector:
    """Where an effector is without its goal.

    Attributes:
        rig: J joints.
        goal: The effector, its point and axis.
        world: Of the joints without the goal, F frames.
    """

    rig: Rig
    goal: Goal
    world: WorldTransforms

    def place(self) -> FloatArray:
        """Return where its point is ``(F, 3)`` [m]."""
        j = self.rig.index(self.goal.joint)
        offset = self.world.linear[:, j] @ np.array(self.goal.offset)
        return np.asarray(self.world.positions[:, j] + offset)

    def turn(self) -> FloatArray:
        """Return how its joint is turned ``(F, 4)``."""
        linear = self.world.linear[:, self.rig.index(self.goal.joint)]
        return so3.align_signs(so3.split_scale(linear)[0])

    def towards(self, part: str, values: FloatArray, shares: FloatArray) -> FloatArray:
        """Return targets on the way from where it is to where they are to be.

        Points go straight, rotations by the shortest arc; points that an axis or a
        limb's middle is to point at go about the effector or the limb's root.

        Args:
            part: ``position``, ``orientation``, ``aim`` or ``pole``.
            values: The targets ``(F, 3)``, or of an orientation ``(F, 4)``.
            shares: 0 where it is free, 1 at the targets ``(F,)``.
        """
        out = values.copy()
        rows = (shares > 0) & (shares < 1)
        share = shares[rows]
        if not len(share):
            return out
        if part == "orientation":
            out[rows] = so3.slerp(self.turn()[rows], values[rows], share)
            return so3.align_signs(out)
        if part == "position":
            here = self.place()[rows]
            out[rows] = here + share[:, None] * (values[rows] - here)
            return out
        origins, directions = self._axis() if part == "aim" else self._bend(values)
        away = values[rows] - origins[rows]
        out[rows] = origins[rows] + swung(directions[rows], away, share)
        return out

    def _axis(self) -> tuple[FloatArray, FloatArray]:
        """Return where the aiming axis begins and points ``(F, 3)``."""
        return self.place(), so3.rotate(self.turn(), np.array(self.goal.aim_axis))

    def _bend(self, poles: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the limb's root, and how its middle stands off ``(F, 3)``.

        A straight limb has no such direction; it is taken to bend towards its poles.
        """
        point = self.place()
        moving = {
            j
            for j, joint in enumerate(self.rig.joints)
            if joint.type is not JointType.FIXED
        }
        origins = self.world.positions
        found = limb_joints(self.rig, self.goal, moving, origins[0], point[0])
        if found is None:
            return point, poles - point
        root, middle = (origins[:, j] for j in found)
        along, bone = point - root, middle - root
        square = np.maximum((along**2).sum(axis=1, keepdims=True), 1e-300)
        off = bone - (bone * along).sum(axis=1, keepdims=True) / square * along
        bent = np.linalg.norm(off, axis=1) > UNKNOWN * np.linalg.norm(bone, axis=1)
        return root, np.where(bent[:, None], off, poles - root)


def swung(start: FloatArray, end: FloatArray, share: FloatArray) -> FloatArray:
    """Return vectors ``(F, 3)`` as long as the end, turned from the start towards it.

    Args:
        start: Directions ``(F, 3)``, not 0.
        end: ``(F, 3)``.
        share: Of the angle between them, 0 to 1 ``(F,)``.

    >>> swung(np.eye(3)[:1], 2 * np.eye(3)[1:2], np.array([0.5])).round(6).tolist()
    [[1.414214, 1.414214, 0.0]]
    """
    length = np.linalg.norm(end, axis=1, keepdims=True)
    unit = start / np.maximum(np.linalg.norm(start, axis=1, keepdims=True), 1e-300)
    axis = np.cross(unit, end)
    sine = np.linalg.norm(axis, axis=1, keepdims=True)
    angle = np.arctan2(sine[:, 0], (unit * end).sum(axis=1))
    # Directions that are opposite turn about any axis across them.
    spare = np.cross(unit, np.eye(3)[np.abs(unit).argmin(axis=1)])
    axis = np.where(sine > UNKNOWN * length, axis, spare)
    axis = axis / np.linalg.norm(axis, axis=1, keepdims=True)
    turn = so3.from_axis_angle(axis, share * angle)
    return np.asarray(length * so3.rotate(turn, unit))
