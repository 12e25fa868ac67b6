"""One small take, and what a take holds as bytes."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction

import numpy as np

from animtool.core.clock import Clock
from animtool.maths import so3
from animtool.motion.motion import Channel, Motion
from animtool.motion.take import Take
from animtool.motion.transforms import Track, Transforms
from animtool.rig.skeleton import Joint, Rig

__all__ = ["content", "small", "with_tracks"]

JOINTS = (
    Joint("hips", -1, translation=(0.3, 0.9, -0.2), rotation=(0.6, 0.0, 0.0, 0.8)),
    Joint("arm_l", 0, translation=(0.2, 0.5, 0.1), rotation=(0.0, 0.8, 0.0, 0.6)),
    Joint("arm_r", 0, translation=(-0.3, 0.4, 0.1), rotation=(0.0, -0.6, 0.0, 0.8)),
)


def small(count: int = 12) -> Take:
    """Return three joints off the origin and turned, of which the last is still."""
    rng = np.random.default_rng(3)
    turns = so3.exp(np.cumsum(rng.normal(0, 0.1, (count, 3, 3)), axis=0))
    turns[:, 2] = so3.IDENTITY
    turns = so3.multiply(np.array([joint.rotation for joint in JOINTS]), turns)
    slides = np.cumsum(rng.normal(0, 0.1, (count, 3, 3)), axis=0)
    slides[:, 1:] = 0
    slides += np.array([joint.translation for joint in JOINTS])
    rig = Rig("small", JOINTS)
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


def with_tracks(take: Take) -> Take:
    """Return a take with a thing beside it that moves, and one that is still."""
    frames = np.arange(take.clock.count, dtype=np.float64)
    times = np.stack([7.5 + 0.8 * frames, frames], axis=1)[..., None]
    motion = replace(take.motion, track_times=Channel.from_dense(times))
    tracks = (Track("Props/ball", rolling), Track("/post", resting, is_animated=False))
    return replace(take, motion=motion, tracks=tracks)


def rolling(times: np.ndarray) -> Transforms:
    """Return what rolls along a curve."""
    turn = np.stack([times, 0.3 * times, 0 * times], axis=1) / 5
    place = np.stack([times, np.sin(times), times**2 / 9], axis=1)
    scale = np.stack([1 + times / 20, 1 + 0 * times, 2 + 0 * times], axis=1)
    return Transforms(place, so3.exp(turn), scale)


def resting(times: np.ndarray) -> Transforms:
    """Return what never moves."""
    return rolling(np.ones_like(times))
