"""Results of key reduction, and their conversion to a clip."""

from __future__ import annotations

import math
from enum import StrEnum
from fractions import Fraction

import numpy as np

from animtool.clip.channels import ClipChannel, ClipUnits
from animtool.clip.clip import Clip
from animtool.core.array_types import ArrayLike, FloatArray
from animtool.core.clock import Clock
from animtool.core.record import dataclass
from animtool.maths.curves import Interp
from animtool.maths.fit import FittedKeys
from animtool.maths.tangents import Tangent
from animtool.rig.skeleton import Rig


class ChannelKind(StrEnum):
    """Kinds of keyed channels: parts of a joint's transform, or a shape's weight."""

    TRANSLATION = "translation"
    ROTATION = "rotation"
    SCALE = "scale"
    WEIGHT = "weight"


@dataclass(frozen=True, slots=True)
class ReducedChannel:
    """Reduced keys of a joint transform, a shape weight or a control."""

    target: str  # target in a clip
    order: str | None  # of the Euler angles, left to right; else None
    # Frames from 0, not time codes. Translations are in [m], rotations in [deg],
    # continuous over revolutions, and others in [1]. Handles lie at thirds of the
    # segments next to a key.
    keys: FittedKeys


@dataclass(frozen=True, slots=True)
class Reduction:
    """Sparse keys of a take, and the errors of the motion that they produce."""

    clock: Clock  # clock of the take, F frames
    # Ordered by translation, rotation, scale of each joint, then the weights. Parts at
    # rest have no channel; constant parts have one key.
    channels: tuple[ReducedChannel, ...]
    samples: int  # F times the number of moving channels
    error: float  # largest distance of a point from its original position [m]
    joint: str  # name of the joint that the point belongs to
    frame: int  # frame of the largest distance
    held: bool  # whether every joint is within its tolerance
    weight_error: float  # largest error of a weight [1]
    rounds: int  # number of world-error measurements

    @property
    def keys(self) -> int:
        """Number of keys of all channels; components of a channel share keys."""
        return sum(len(channel.keys.frames) for channel in self.channels)

    @property
    def samples_per_key(self) -> float:
        """Samples per key [1]."""
        return self.samples / max(1, self.keys)


# Significant digits; rounding is far below any tolerance.
SIGNIFICANT_DIGITS = 10


def clip_of_reduction(reduction: Reduction, rig: Rig, name: str) -> Clip:
    """Return a reduction as a clip, its numbers rounded in the units of the rig.

    Keys are Hermite with slopes per frame, so that each segment is the fitted cubic.
    Rotations are Euler angles; a pin has one angle.
    """
    clock, units = reduction.clock, ClipUnits.of_rig(rig)
    last = clock.start + (clock.count - 1) * clock.step
    channels = []
    for channel in reduction.channels:
        target, euler = channel.target, channel.order or ""
        unit = units.unit_of(target, euler)
        channels.append(fitted_channel(target, channel.keys, clock, unit, euler))
    first_and_last = Fraction(float(clock.start)), Fraction(float(last))
    return Clip(name, clock.fps, *first_and_last, tuple(channels))


def fitted_channel(
    target: str, keys: FittedKeys, clock: Clock, unit: float, euler: str = ""
) -> ClipChannel:
    """Return fitted keys as a channel of Hermite keys.

    The keys are in metres, degrees or [1], with frames from 0; written values in
    ``unit``.
    """
    # Unit of the fitted keys relative to the unit of the file.
    is_rotation = bool(euler) or target.endswith(".angle")
    factor = (math.radians(1.0) if is_rotation else 1.0) / unit
    times = float(clock.start) + keys.frames.astype(np.float64) * float(clock.step)
    intervals = np.diff(times)[:, None]
    key_count, component_count = keys.values.shape
    in_handles, out_handles = np.zeros((2, key_count, 1 + component_count))
    in_handles[1:, 0], out_handles[:-1, 0] = -1.0, 1.0
    in_handles[1:, 1:] = _round_in_unit(
        3 * keys.in_handles[1:] / intervals * factor, unit
    )
    out_handles[:-1, 1:] = _round_in_unit(
        3 * keys.out_handles[:-1] / intervals * factor, unit
    )
    free_tangents = (Tangent.FREE,) * (key_count - 1)
    tangents_before = Tangent.AUTO_CLAMPED, *free_tangents
    tangents_after = *free_tangents, Tangent.AUTO_CLAMPED
    return ClipChannel(
        target,
        times,
        _round_in_unit(keys.values * factor, unit),
        (Interp.HERMITE,) * key_count,
        tuple(zip(tangents_before, tangents_after, strict=True)),
        in_handles,
        out_handles,
        np.zeros((key_count, 3)),
        euler=euler,
    )


def _round_in_unit(values: ArrayLike, unit: float) -> FloatArray:
    """Round values to the digits of a file unit; return metres and radians."""
    rounded_values = [
        float(f"{value + 0.0:.{SIGNIFICANT_DIGITS}g}") * unit
        for value in np.ravel(values).tolist()
    ]
    return np.reshape(rounded_values, np.shape(values))
