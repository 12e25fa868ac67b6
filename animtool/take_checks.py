"""Whether a rig, a clock, a motion and tracks make a take."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from animtool._types import FloatArray
from animtool.clock import Clock
from animtool.errors import Fault, counted
from animtool.motion import Channel, Motion
from animtool.rig.skeleton import Rig
from animtool.transforms import Track

# Half precision, the coarsest that USD keeps rotations in, is off by 5e-4.
UNIT_TOLERANCE = 1e-3


def misfits(
    rig: Rig, clock: Clock, motion: Motion, tracks: Sequence[Track]
) -> list[Fault]:
    """Return what is not of the same frames, joints, shapes and controls.

    Args:
        rig: J joints.
        clock: When the frames are.
        motion: What they hold.
        tracks: Things beside the rig.
    """
    frames = clock.count
    expected = [
        ("translations", motion.translations, len(rig.joints), 3),
        ("rotations", motion.rotations, len(rig.joints), 4),
        ("scales", motion.scales, len(rig.joints), 3),
        ("weights", motion.weights, len(rig.shapes), 1),
        ("controls", motion.controls, len(rig.controls), 1),
        ("track_times", motion.track_times, len(tracks), 1),
    ]
    faults = []
    if tracks and motion.track_times is None:
        message = f"track_times are missing of {counted(len(tracks), 'track')}"
        faults.append(Fault("TAKE001", message))
    for name, channel, many, width in expected:
        if channel is None:
            continue
        moving = len(channel.animated)
        for part, wanted, found in (
            ("rest", (many, width), channel.rest.shape),
            ("animated", (moving,), channel.animated.shape),
            ("values", (frames, moving, width), channel.values.shape),
        ):
            if wanted != found:
                message = f"{name}.{part} must have shape {wanted}, not {found}"
                faults.append(Fault("TAKE001", message))
        order = [-1, *channel.animated.ravel().tolist(), many]
        if not all(a < b for a, b in pairwise(order)):
            message = f"{name}.animated must ascend from 0 to below {many}"
            faults.append(Fault("TAKE002", message))
    return faults


_CHANNELS = (
    "translations",
    "rotations",
    "scales",
    "weights",
    "controls",
    "track_times",
)


def impossible_values(
    rig: Rig, clock: Clock, motion: Motion, tracks: Sequence[Track]
) -> list[Fault]:
    """Return what is no number, or no rotation: the first of each channel.

    Args:
        rig: J joints.
        clock: When the frames are.
        motion: What they hold; it fits all of them.
        tracks: Things beside the rig.
    """
    faults = []
    for name in _CHANNELS:
        channel: Channel | None = getattr(motion, name)
        if channel is None:
            continue
        for still, values in ((True, channel.rest), (False, channel.values)):
            wrong = _first_infinite(values)
            code, what = "TAKE004", "not finite"
            if wrong is None and name == "rotations":
                wrong = _first_unequal(values)
                code, what = "TAKE005", "no unit quaternion (x, y, z, w)"
            if wrong is not None:
                index = wrong[0] if still else int(channel.animated[wrong[1]])
                when = "" if still else f" at frame {float(clock.times[wrong[0]]):g}"
                place = f"{_owner(rig, tracks, name, index)}{when}"
                message = f"{name}: {place} is {values[wrong].tolist()}, {what}"
                faults.append(Fault(code, message))
    return faults


def _first_infinite(values: FloatArray) -> tuple[int, ...] | None:
    # A sum that is finite has no part that is not, and makes no copy.
    if np.isfinite(np.sum(values)):
        return None
    bad = np.argwhere(~np.isfinite(values).all(axis=-1))
    return tuple(bad[0].tolist()) if len(bad) else None


def _first_unequal(values: FloatArray) -> tuple[int, ...] | None:
    squares = np.einsum("...k,...k->...", values, values)
    # Twice, as the length is squared.
    off = np.abs(squares - 1.0) > 2 * UNIT_TOLERANCE
    return tuple(np.argwhere(off)[0].tolist()) if off.any() else None


def _owner(rig: Rig, tracks: Sequence[Track], name: str, index: int) -> str:
    """Return what a row of a channel is of."""
    if name == "track_times":
        return f"track {tracks[index].path!r}"
    kind = {"weights": "shapes", "controls": "controls"}.get(name, "joints")
    return f"{kind[:-1]} {getattr(rig, kind)[index].name!r}"
