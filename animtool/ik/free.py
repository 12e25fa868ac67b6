"""Where an effector is without its goal, and the way from there to its targets."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from animtool._types import BoolArray, FloatArray
from animtool.ik.goals import Goal, GoalKind, TargetValue
from animtool.ik.limbs import limb_joints
from animtool.ik.two_bone import bend
from animtool.ik.values import smoothstep
from animtool.maths import so3
from animtool.rig.kinematics import WorldTransforms
from animtool.rig.skeleton import JointType, Rig

# Shorter than this share of what it points along, a direction is unknown.
UNKNOWN = 1e-6
# Limbs that bend by less than the first of these are straight, and those that bend by
# more than the second are not [rad].
STRAIGHT, BENT = np.radians([5.0, 20.0])


@dataclass(frozen=True, slots=True)
class FreeEffector:
    """Where an effector is without its goal."""

    rig: Rig  # J joints
    goal: Goal  # the effector, its point and axis
    world: WorldTransforms  # of the joints without the goal, F frames

    def place(self) -> FloatArray:
        """Return where its point is ``(F, 3)`` [m]."""
        j = self.rig.index(self.goal.joint)
        offset = self.world.linear[:, j] @ np.array(self.goal.offset)
        return np.asarray(self.world.positions[:, j] + offset)

    def turn(self) -> FloatArray:
        """Return how its joint is turned ``(F, 4)``."""
        linear = self.world.linear[:, self.rig.index(self.goal.joint)]
        return so3.align_signs(so3.split_scale(linear)[0])

    def towards(
        self, kind: GoalKind, values: FloatArray, shares: FloatArray
    ) -> FloatArray:
        """Return targets on the way from where it is to where they are to be.

        Points go straight, rotations by the shortest arc; points that an axis or a
        limb's middle is to point at go about the effector or the limb's root. Points at
        the end of a straight limb go about its root too, as far off as a limb is that
        bends evenly: on the straight way its first degrees would take no time.

        Args:
            kind: What is asked.
            values: The targets, points ``(F, 3)`` or rotations ``(F, 4)``.
            shares: 0 where it is free, 1 at the targets ``(F,)``.
        """
        out = values.copy()
        rows = (shares > 0) & (shares < 1)
        share = shares[rows]
        if not len(share):
            return out
        if kind.value is TargetValue.ROTATION:
            out[rows] = so3.slerp(self.turn()[rows], values[rows], share)
            return so3.align_signs(out)
        if not kind.directed:
            out[rows] = self._reaching(values, rows, share)
            return out
        origins, directions = self._axis() if kind.turning else self._bend(values)
        away = values[rows] - origins[rows]
        out[rows] = origins[rows] + swung(directions[rows], away, share)
        return out

    def _reaching(
        self, values: FloatArray, rows: BoolArray, share: FloatArray
    ) -> FloatArray:
        """Return positions on the way in some rows ``(N, 3)``."""
        here, there = self.place()[rows], values[rows]
        straight = here + share[:, None] * (there - here)
        limb = self._limb()
        if limb is None or not self._is_whole(limb[0]):
            return np.asarray(straight)
        root, middle = (self.world.positions[rows, j] for j in limb)
        a, b, reach, wanted = (
            np.linalg.norm(way, axis=1)
            for way in (middle - root, here - middle, here - root, there - root)
        )
        bends = bend(a, b, reach), bend(a, b, wanted)
        angle = bends[0] + share * (bends[1] - bends[0])
        away = np.sqrt(np.maximum(a**2 + b**2 + 2 * a * b * np.cos(angle), 0.0))
        away += share * np.maximum(wanted - (a + b), 0.0)
        known = (wanted > UNKNOWN * (a + b))[:, None]
        ends = np.where(known, there - root, here - root)
        way = swung(here - root, ends, share)
        size = np.maximum(np.linalg.norm(way, axis=1), 1e-300)
        bent = smoothstep((bends[0] - STRAIGHT) / (BENT - STRAIGHT))
        about = root + way * (away / size)[:, None]
        return np.asarray(about + bent[:, None] * (straight - about))

    def _limb(self) -> tuple[int, int] | None:
        """Return the joints at the root and in the middle of the limb."""
        moving = {
            j
            for j, joint in enumerate(self.rig.joints)
            if joint.type is not JointType.FIXED
        }
        origins, point = self.world.positions[0], self.place()[0]
        return limb_joints(self.rig, self.goal, moving, origins, point)

    def _is_whole(self, root: int) -> bool:
        """Whether no joint above a limb's root moves for its goal."""
        if self.goal.root is not None:
            return True
        above = self.rig.joints[root].parent
        while above >= 0 and self.rig.joints[above].type is JointType.FIXED:
            above = self.rig.joints[above].parent
        return above < 0

    def _axis(self) -> tuple[FloatArray, FloatArray]:
        """Return where the aiming axis begins and points ``(F, 3)``."""
        return self.place(), so3.rotate(self.turn(), np.array(self.goal.aim_axis))

    def _bend(self, poles: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the limb's root, and how its middle stands off ``(F, 3)``.

        A straight limb has no such direction; it is taken to bend towards its poles.
        """
        point = self.place()
        found = self._limb()
        if found is None:
            return point, poles - point
        root, middle = (self.world.positions[:, j] for j in found)
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
