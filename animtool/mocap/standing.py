"""Which axis a person stands along, of files that do not say which is up."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from animtool.errors import Fault, Severity
from animtool.motion import Motion
from animtool.rig.kinematics import forward
from animtool.rig.skeleton import Rig
from animtool.take import TakeStream
from animtool.units import UpAxis

# Cosine of the angle to an axis up to which a person stands along it [1].
STANDS = 0.8
# In all but this share of frames a person stands.
STANDING = 0.1


def stands_along(rig: Rig, motion: Motion, roles: tuple[str, ...]) -> UpAxis | None:
    """Return the axis that a person stands along all the time, if it is not the rig's.

    BVH files do not say which it is. ``roles`` of the joints ``(J,)``.
    """
    if "hips" not in roles or "head" not in roles:
        return None
    low, high = roles.index("hips"), roles.index("head")
    places = forward(rig, motion.translations.dense(), motion.rotations.dense())
    ways = places.positions[:, high] - places.positions[:, low]
    ways = ways / np.maximum(np.linalg.norm(ways, axis=1), 1e-12)[:, None]
    along = ways @ np.array(_other(rig.up).vector)
    return _other(rig.up) if float(np.quantile(along, STANDING)) > STANDS else None


def lying_notice(path: Path, rig: Rig, motion: Motion) -> list[Fault]:
    """Return a note of a person who stands along another axis than up (MOT214).

    The first frame alone is looked at where it is higher than deep.
    """
    if not rig.joints or not motion.frames:
        return []
    first = motion.select(slice(0, 1))
    pose = forward(rig, first.translations.dense(), first.rotations.dense())
    spans = np.ptp(pose.positions[0], axis=0)
    up, other = np.array(rig.up.vector), np.array(_other(rig.up).vector)
    if spans @ up >= spans @ other:
        return []
    from animtool.mocap.retarget.anatomy import anatomy

    axis = stands_along(rig, motion, anatomy(rig).roles)
    if axis is None:
        return []
    message = f"the body stands along {axis}, and {rig.up} is taken as up"
    hint = f"read it with --up {axis}"
    return [Fault("MOT214", message, str(path), (), hint, Severity.NOTE)]


def with_lying_notice(path: Path, stream: TakeStream) -> TakeStream:
    """Return a stream that says in its notices of whom its first block shows lying."""

    def blocks() -> Iterator[Motion]:
        for i, block in enumerate(stream.blocks):
            if i == 0:
                stream.notices.extend(lying_notice(path, stream.rig, block))
            yield block

    return replace(stream, blocks=blocks())


def _other(up: UpAxis) -> UpAxis:
    return UpAxis.Z if up is UpAxis.Y else UpAxis.Y
