"""What a targets file gives a goal: a value for any frame, held or eased."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from typing import Protocol, TypeAlias

import numpy as np

from animtool._types import FloatArray
from animtool.clip.channels import ClipChannel, evaluate_channels
from animtool.errors import Fault, OptionError
from animtool.maths import so3

Span = tuple[float, float]


def smoothstep(share: FloatArray) -> FloatArray:
    """Return an ease from 0 to 1 whose speed and acceleration are 0 at both ends.

    >>> smoothstep(np.array([-1.0, 0.5, 2.0])).tolist()
    [0.0, 0.5, 1.0]
    """
    u = np.clip(share, 0.0, 1.0)
    # Rounding may lead past 1.
    return np.minimum(u * u * u * (u * (6.0 * u - 15.0) + 10.0), 1.0)


def hold_shares(times: FloatArray, spans: Sequence[Span], ease: float) -> FloatArray:
    """Return how much each of H spans holds at times ``(H, F)``, 0 to 1.

    It is 1 inside the span. Where two spans are nearer than both eases, each has half
    of the gap, so that at no time more than one holds.

    ``times`` [frame] ``(F,)``, ``ease`` [frame].

    >>> hold_shares(np.array([0.0, 2.0, 4.0, 9.0]), [(4.0, 6.0)], 4.0).tolist()
    [[0.0, 0.5, 1.0, 0.103515625]]
    """
    shares = np.zeros((len(spans), len(times)))
    for i, (first, last) in enumerate(spans):
        before = ease if i == 0 else min(ease, (first - spans[i - 1][1]) / 2)
        behind = (
            ease if i + 1 == len(spans) else min(ease, (spans[i + 1][0] - last) / 2)
        )
        inside = (times >= first) & (times <= last)
        shares[i, inside] = 1.0
        for length, way in ((before, first - times), (behind, times - last)):
            near = (way > 0) & (way < length)
            shares[i, near] = smoothstep(1.0 - way[near] / length)
    return shares


def held(values: FloatArray, shares: FloatArray, stills: FloatArray) -> FloatArray:
    """Return a motion with spans held.

    Args:
        values: The free motion ``(F, 3)``, or rotations ``(F, 4)``, which go to the
            held one by the shortest way.
        shares: From `hold_shares` ``(H, F)``.
        stills: What each span holds ``(H, 3)`` or ``(H, 4)``.

    >>> held(np.zeros((2, 3)), np.array([[0.5, 1.0]]), np.ones((1, 3)))[:, 0].tolist()
    [0.5, 1.0]
    """
    out = values.copy()
    for share, still in zip(shares, stills, strict=True):
        part = (share > 0) & (share < 1)
        if values.shape[1] == 4:
            ends = np.broadcast_to(still, out[part].shape)
            out[part] = so3.slerp(out[part], ends, share[part])
        else:
            out[part] += share[part, None] * (still - out[part])
        out[share >= 1] = still
    return so3.align_signs(out) if values.shape[1] == 4 else out


# From seconds (F,) to the positions [m] (F, 3) and rotations (F, 4) of a prim, in the
# world of the rig.
PrimMotion: TypeAlias = Callable[[FloatArray], tuple[FloatArray, FloatArray]]

# A time this near to a row [frame] is meant to be the row.
ON_ROW = 1e-9


@dataclass(frozen=True, slots=True)
class Frames:
    """When values are wanted."""

    times: FloatArray  # [frame] ``(F,)``
    fps: Fraction  # frames a second

    @property
    def seconds(self) -> FloatArray:
        """The times [s]; frame 0 is second 0."""
        return np.asarray(self.times / float(self.fps))


class Value(Protocol):
    """Points ``(F, 3)`` [m], rotations ``(F, 4)`` or weights ``(F, 1)`` over frames."""

    def at(self, frames: Frames) -> FloatArray:
        """Return the values at frames."""
        ...


@dataclass(frozen=True, slots=True)
class Still:
    """One value, always."""

    value: tuple[float, ...]

    def at(self, frames: Frames) -> FloatArray:
        """Return the value for each time."""
        return np.tile(np.array(self.value, np.float64), (len(frames.times), 1))


@dataclass(frozen=True, slots=True)
class Keyed:
    """The curve of keys."""

    channel: ClipChannel

    def at(self, frames: Frames) -> FloatArray:
        """Return the curve at times."""
        found = evaluate_channels([self.channel], frames.times)[self.channel.target]
        return np.array(np.broadcast_to(found, (len(frames.times), found.shape[1])))


@dataclass(frozen=True, slots=True)
class Rows:
    """An array with a row for each frame."""

    name: str  # as the file spells it
    values: FloatArray = field(repr=False)  # ``(R, 3)`` or ``(R, 4)``
    first: Fraction | None  # frame of the first row; None where nothing says: 1
    place: tuple[int, int] = (1, 1)  # line and column of the name in the file

    def at(self, frames: Frames) -> FloatArray:
        """Return the rows at times, and between two rows what lies between them.

        Raises:
            OptionError: There is no row for a time (TGT015).
        """
        first = 1.0 if self.first is None else float(self.first)
        places = frames.times - first
        last = len(self.values) - 1
        beyond = (places < -ON_ROW) | (places > last + ON_ROW)
        if beyond.any():
            message = f"{self.name!r} has {last + 1} rows, for the frames {first:g} to "
            message += (
                f"{first + last:g}, and none for frame {frames.times[beyond][0]:g}"
            )
            hint = "write range into the targets, or an array of another length"
            raise OptionError(self.fault(message, hint))
        return between(self.values, places)

    def fault(self, message: str, hint: str, path: str | None = None) -> Fault:
        """Return what is wrong with frames and rows, in its place (TGT015)."""
        line, column = self.place
        return Fault("TGT015", message, path, (line,), hint, column=column)


def between(values: FloatArray, places: FloatArray) -> FloatArray:
    """Return rows at places ``(F,)``, held at both ends.

    Between two, rotations ``(R, 4)`` go by the shortest arc, points straight.

    >>> between(np.array([[0.0], [2.0]]), np.array([0.25, 9.0])).tolist()
    [[0.5], [2.0]]
    """
    places = np.clip(places, 0.0, len(values) - 1.0)
    near = np.round(places)
    places = np.where(np.abs(places - near) <= ON_ROW, near, places)
    low = np.floor(places).astype(np.int64)
    share = places - low
    found = values[low]
    part = share > 0
    if part.any():
        high = values[low[part] + 1]
        if values.shape[1] == 4:
            found[part] = so3.slerp(found[part], high, share[part])
        else:
            found[part] += share[part, None] * (high - found[part])
    return found


@dataclass(frozen=True, slots=True)
class PrimPlace:
    """A point that a prim carries."""

    motion: PrimMotion  # of the prim
    offset: tuple[float, ...]  # the point in its frame [m]

    def at(self, frames: Frames) -> FloatArray:
        """Return where the point is."""
        positions, rotations = self.motion(frames.seconds)
        return np.asarray(positions + so3.rotate(rotations, np.array(self.offset)))


@dataclass(frozen=True, slots=True)
class PrimTurn:
    """A rotation that a prim carries."""

    motion: PrimMotion  # of the prim
    turn: tuple[float, ...]  # from its frame, quaternion

    def at(self, frames: Frames) -> FloatArray:
        """Return how it is turned."""
        _, rotations = self.motion(frames.seconds)
        return so3.align_signs(so3.multiply(rotations, np.array(self.turn)))
