"""A leg that swings while it goes on, for tests of cycles."""

from __future__ import annotations

from fractions import Fraction

import numpy as np

from animtool.core.array_types import FloatArray
from animtool.core.clock import Clock
from animtool.core.units import UpAxis
from animtool.maths import so3
from animtool.motion.motion import Channel, Motion
from animtool.motion.take import Take
from animtool.rig.skeleton import Joint, Rig

LEG = (
    Joint("hips", -1, translation=(0, 1, 0)),
    Joint("knee", 0, translation=(0, -0.5, 0)),
    Joint("foot", 1, translation=(0, -0.5, 0)),
)


def swinging(
    angle: FloatArray, fps: int = 30, yaw: float = 0.0, up: UpAxis = UpAxis.Y
) -> Take:
    """Return a leg that swings by angles ``(F, 2)`` while it goes on and turns."""
    count = len(angle)
    time = np.arange(count) / fps
    turns = np.tile(so3.IDENTITY, (count, 3, 1))
    heading = so3.exp(yaw * time[:, None] * np.array(up.vector))
    turns[:, 0] = heading
    turns[:, 1] = so3.exp(angle[:, :1] * [1, 0, 0])
    turns[:, 2] = so3.exp(angle[:, 1:] * [1, 0, 0])
    places = np.tile([j.translation for j in LEG], (count, 1, 1)).astype(float)
    places[:, 0] += np.cumsum(so3.rotate(heading, [0.04, 0, 0]), axis=0)
    motion = Motion(Channel.from_dense(places), Channel.from_dense(turns))
    clock = Clock(Fraction(fps), Fraction(101), Fraction(1), count)
    return Take(Rig("leg", LEG, up=up), clock, motion)


def gait(count: int, period: float, phase: float = 0.0) -> FloatArray:
    """Return two angles that repeat after ``period`` frames."""
    turn = 2 * np.pi * (np.arange(count) + phase) / period
    return np.stack(
        [0.6 * np.sin(turn), 0.4 * np.cos(turn) + 0.2 * np.sin(2 * turn)], axis=1
    )
