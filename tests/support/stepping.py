"""What legs do in a walk or a run: joint angles, contact and slides, of a take."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from animtool import Take
from animtool.core.array_types import FloatArray
from animtool.maths import so3
from animtool.rig.kinematics import rest_world

# A point of a sole is on the ground where it is less above it [m].
GROUND = 0.004
# The heel behind the ankle, where a rig has no joint there [m].
HEEL = 0.05
LEGS = (
    ("LeftUpLeg", "LeftLeg", "LeftFoot", ("LeftToe", "LeftToeBase")),
    ("RightUpLeg", "RightLeg", "RightFoot", ("RightToe", "RightToeBase")),
)
RIGGED = (
    ("hip_l", "knee_l", "ankle_l", ("toe_l",)),
    ("hip_r", "knee_r", "ankle_r", ("toe_r",)),
)


@dataclass(frozen=True)
class Leg:
    """A leg over F frames, y up.

    Attributes:
        hip: Flexion of the thigh, seen from the vertical ``(F,)`` [deg].
        knee: Flexion; 0 where thigh and shank are in line ``(F,)`` [deg].
        ankle: Of the foot, toes up, seen from the pose of rest ``(F,)`` [deg].
        sole: Heel, ball and tip of the toes ``(F, 3, 3)`` [m].
        stands: Where a point of the sole is on the ground ``(F,)``.
    """

    hip: FloatArray
    knee: FloatArray
    ankle: FloatArray
    sole: FloatArray
    stands: npt.NDArray[np.bool_]

    @property
    def strikes(self) -> npt.NDArray[np.intp]:
        """First frames of stances that begin within the take."""
        return np.flatnonzero(self.stands[1:] & ~self.stands[:-1]) + 1

    @property
    def slides(self) -> FloatArray:
        """How far the point goes that the foot stands on, a frame ``(F - 1,)`` [m]."""
        low = self.sole[..., 1] < GROUND
        way = np.linalg.norm(np.diff(self.sole[..., [0, 2]], axis=0), axis=-1)
        way = np.where(low[1:] & low[:-1], way, np.inf).min(axis=1)
        return np.asarray(np.where(np.isfinite(way), way, 0.0))


def angle_between(one: FloatArray, other: FloatArray) -> FloatArray:
    """Return the angles of vectors ``(..., 3)`` [deg]."""
    cross = np.linalg.norm(np.cross(one, other), axis=-1)
    return np.degrees(np.arctan2(cross, (one * other).sum(axis=-1)))


def sagittal(way: FloatArray, side: FloatArray) -> FloatArray:
    """Return how far vectors point ahead of straight down, seen from ``side`` [deg]."""
    ahead = np.cross(side, [0.0, 1.0, 0.0])
    ahead /= np.linalg.norm(ahead, axis=-1, keepdims=True)
    return np.degrees(np.arctan2((way * ahead).sum(axis=-1), -way[..., 1]))


def legs(take: Take) -> tuple[Leg, Leg]:
    """Return the left and the right leg of a take."""
    table = LEGS if LEGS[0][0] in take.rig.names else RIGGED
    left, right = (_leg(take, *names) for names in table)
    return left, right


def _leg(take: Take, hip: str, knee: str, ankle: str, toes: tuple[str, ...]) -> Leg:
    """Return a leg by the names of its joints."""
    rig, world = take.rig, take.world()
    toe = next(name for name in toes if name in rig.names)
    h, k, a, t = (rig.index(name) for name in (hip, knee, ankle, toe))
    places = world.positions
    thigh, shank = places[:, k] - places[:, h], places[:, a] - places[:, k]
    rest = rest_world(rig).positions[0]
    tip = np.array(rig.joints[t].tips[0])
    ground = rest[t, 1] + tip[1]
    # Heel and ball lie in the foot, the tip in the toes.
    heel = np.array([0.0, ground - rest[a, 1], -HEEL])
    ball = rest[t] - rest[a] + [0.0, ground - rest[t, 1], 0.0]
    sole = np.stack(
        [
            places[:, a] + so3.rotate(world.rotations[:, a], heel),
            places[:, a] + so3.rotate(world.rotations[:, a], ball),
            places[:, t] + so3.rotate(world.rotations[:, t], tip),
        ],
        axis=1,
    )
    hips = rig.index("Hips" if "Hips" in rig.names else "hips")
    side = so3.rotate(world.rotations[:, hips], [1.0, 0.0, 0.0])
    foot = places[:, t] - places[:, a]
    level = sagittal(rest[t] - rest[a], np.array([1.0, 0.0, 0.0]))
    return Leg(
        hip=sagittal(thigh, side),
        knee=angle_between(thigh, shank),
        ankle=sagittal(foot, side) - level - sagittal(shank, side),
        sole=sole,
        stands=(sole[..., 1] < GROUND).any(axis=1),
    )
