"""A character from one frame to the next: its joints at times between."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from animtool._types import FloatArray
from animtool.maths import so3
from animtool.motion import Channel, Motion
from animtool.rig.kinematics import WorldTransforms, forward
from animtool.rig.skeleton import Rig


@dataclass(frozen=True, slots=True, eq=False)
class Pose:
    """One frame of a motion.

    Attributes:
        translations: ``(J, 3)`` [m], parent space.
        rotations: ``(J, 4)``.
        scales: ``(J, 3)`` [1]; None is none.
        weights: Of the rig's shapes ``(S,)`` [1]; None where the take has none.
    """

    translations: FloatArray
    rotations: FloatArray
    scales: FloatArray | None
    weights: FloatArray | None


@dataclass(frozen=True, slots=True, eq=False)
class Way:
    """A character at K times, from one frame to another, both among them.

    Attributes:
        world: Where its joints are.
        weights: Of the rig's shapes ``(K, S)`` [1]; None where there are none.
    """

    world: WorldTransforms
    weights: FloatArray | None


def pose_at(motion: Motion, frame: int) -> Pose:
    """Return one frame of a motion."""

    def values(channel: Channel | None) -> FloatArray | None:
        if channel is None:
            return None
        whole = channel.rest.copy()
        whole[channel.animated] = channel.values[frame]
        return whole

    translations, rotations = values(motion.translations), values(motion.rotations)
    assert translations is not None
    assert rotations is not None
    weights = values(motion.weights)
    return Pose(
        translations,
        rotations,
        values(motion.scales),
        None if weights is None else weights[:, 0],
    )


def way(rig: Rig, before: Pose, after: Pose, steps: int) -> Way:
    """Return a character at even times from a pose to the next, ``steps`` apart.

    Joints turn in their parents along the shortest arc at constant speed; the rest
    goes straight, as samples for motion blur do.
    """
    share = np.arange(steps + 1) / steps
    world = forward(
        rig,
        _straight(before.translations, after.translations, share),
        _turned(before.rotations, after.rotations, share),
        None
        if before.scales is None or after.scales is None
        else _straight(before.scales, after.scales, share),
    )
    weights = None
    if before.weights is not None and after.weights is not None:
        weights = _straight(before.weights, after.weights, share)
    return Way(world, weights)


def _straight(a: FloatArray, b: FloatArray, share: FloatArray) -> FloatArray:
    between = a + (b - a) * share.reshape(-1, *(1,) * a.ndim)
    between[-1] = b
    return np.asarray(between)


def _turned(a: FloatArray, b: FloatArray, share: FloatArray) -> FloatArray:
    whole = np.repeat(a[None], len(share), axis=0)
    moving = np.flatnonzero((a != b).any(axis=-1))
    whole[:, moving] = so3.slerp(a[moving], b[moving], share[:, None])
    whole[0, moving], whole[-1, moving] = a[moving], b[moving]
    return whole


def extrapolated(rig: Rig, first: Pose, second: Pose, frames: float) -> Pose:
    """Return the first pose some frames earlier, at the speed of its roots [frame]."""
    translations = first.translations.copy()
    roots = np.array(rig.roots)
    step = second.translations[roots] - first.translations[roots]
    translations[roots] -= frames * step
    return Pose(translations, first.rotations, first.scales, first.weights)
