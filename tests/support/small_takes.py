"""One small take, and what a take holds as bytes."""

from __future__ import annotations

from fractions import Fraction

import numpy as np

from animtool.maths import so3
from animtool.rig.skeleton import Joint, Rig
from animtool.take import Channel, Clock, Motion, Take

__all__ = ["content", "small"]


def small(count: int = 12) -> Take:
    """Return three joints, of which the last never moves."""
    rng = np.random.default_rng(3)
    turns = so3.exp(np.cumsum(rng.normal(0, 0.1, (count, 3, 3)), axis=0))
    turns[:, 2] = so3.IDENTITY
    slides = np.cumsum(rng.normal(0, 0.1, (count, 3, 3)), axis=0)
    slides[:, 1:] = [0.0, 0.5, 0.0]
    rig = Rig("small", (Joint("hips", -1), Joint("arm_l", 0), Joint("arm_r", 0)))
    motion = Motion(
        Channel.from_dense(slides), Channel.from_dense(so3.align_signs(turns))
    )
    return Take(rig, Clock(Fraction(30), Fraction(1), Fraction(1), count), motion)


def content(take: Take) -> bytes:
    return b"".join(
        part.tobytes()
        for channel in (take.motion.translations, take.motion.rotations)
        for part in (channel.rest, channel.animated, channel.values)
    )
