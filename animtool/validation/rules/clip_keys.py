"""Keys of a clip: where they stand, and which way a turn goes between them."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from animtool._types import IntArray
from animtool.clip.channels import ClipChannel, Interp
from animtool.errors import Fault, counted, listed
from animtool.maths import so3
from animtool.maths.curves import Extrapolation
from animtool.validation.subjects.clip import ClipSubject

# Nearer to half a turn, rounding decides which way a turn goes.
HALF_TURN = math.radians(178.0)
# What goes on beyond the keys without repeating them.
_STILL = frozenset({Extrapolation.HOLD, Extrapolation.LINEAR})


def outside_range(subject: ClipSubject) -> Iterator[Fault]:
    """Yield channels with keys outside the clip's range that do nothing (CLIP201).

    The first one on either side shapes the curve on its way there, and all are played
    where a channel repeats them.
    """
    clip = subject.clip
    first, last = float(clip.first), float(clip.last)
    for i, channel in enumerate(clip.channels):
        outside = beyond(channel, first, last)
        if not len(outside):
            continue
        k = int(outside[0])
        keys = counted(len(outside), "key")
        frames = listed([f"{t:g}" for t in channel.times[outside]])
        message = (
            f"{keys} of {channel.target!r} outside the range from {first:g} to "
            f"{last:g}: {frames}"
        )
        hint = "widen the range, or leave out what is never played"
        yield subject.fault("CLIP201", ("channels", i, "keys", k, "t"), message, hint)


def beyond(channel: ClipChannel, first: float, last: float) -> IntArray:
    """Return the keys of a channel outside some frames that do nothing in them."""
    if not {channel.pre, channel.post} <= _STILL:
        return np.zeros(0, np.int64)
    before = np.flatnonzero(channel.times < first)[:-1]
    behind = np.flatnonzero(channel.times > last)[1:]
    return np.concatenate([before, behind])


def half_turns(subject: ClipSubject) -> Iterator[Fault]:
    """Yield keys half a turn from the one before: which way is open (CLIP202)."""
    for i, channel in enumerate(subject.clip.channels):
        if channel.values.shape[1] != 4:
            continue
        angles = so3.angle_between(channel.values[:-1], channel.values[1:])
        for k in np.flatnonzero(angles > HALF_TURN).tolist():
            if channel.interps[k] is Interp.STEP:
                continue
            message = (
                f"{channel.target!r} turns {math.degrees(angles[k]):.1f}"
                f"\N{DEGREE SIGN} from frame {channel.times[k]:g} to "
                f"{channel.times[k + 1]:g}: it may go either way"
            )
            hint = "a key between them says which; euler: XYZ turns as far as it says"
            at = ("channels", i, "keys", k + 1, "v")
            yield subject.fault("CLIP202", at, message, hint)
