"""Quaternion signs that stay continuous along a take, from block to block."""

from __future__ import annotations

from dataclasses import replace

from animtool._types import FloatArray
from animtool.maths import so3
from animtool.motion import Motion


def continuous(motion: Motion, previous: FloatArray | None = None) -> Motion:
    """Return the motion with rotation signs continuous along its frames.

    Args:
        motion: F frames, A joints that turn.
        previous: Rotations of the frame before ``(A, 4)``; None keeps the signs of
            the first frame.
    """
    channel = motion.rotations
    if not channel.values.size:
        return motion
    before = channel.values[0] if previous is None else previous
    values = so3.align_signs(channel.values, before)
    return replace(motion, rotations=replace(channel, values=values))
