"""Channels of keys on named targets, and how each runs from key to key."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

from animtool._types import FloatArray
from animtool.errors import counted
from animtool.maths.extrapolation import Extrapolation


class Interp(StrEnum):
    """How a channel runs from a key to the next."""

    STEP = "step"
    LINEAR = "linear"
    BEZIER = "bezier"
    CATMULL_ROM = "catmull_rom"
    TCB = "tcb"
    HERMITE = "hermite"
    SLERP = "slerp"
    SQUAD = "squad"
    SPLINE = "spline"


class Tangent(StrEnum):
    """How steep a curve is at a key: given, or by a rule."""

    FREE = "free"
    FLAT = "flat"
    LINEAR = "linear"
    AUTO = "auto"
    AUTO_CLAMPED = "auto_clamped"


class Parametrization(StrEnum):
    """How Catmull-Rom spaces its knots."""

    UNIFORM = "uniform"
    CENTRIPETAL = "centripetal"
    CHORDAL = "chordal"


@dataclass(frozen=True, slots=True)
class ClipChannel:
    """K keys of a target with D components, in metres, radians and frames.

    Attributes:
        target: ``control/NAME``, ``shape/NAME`` or ``joint/NAME.PART``.
        times: Ascending [frames] ``(K,)``.
        values: ``(K, D)``; quaternions (x, y, z, w), Euler angles [rad] in the
            order's own sequence.
        interps: Of the segment after each key, K long.
        tangents: Of each key, before and behind it, K long.
        ins: Handles before the keys, as offsets: time, then D values ``(K, 1 + D)``;
            meant where the tangent is free.
        outs: Handles behind the keys.
        tcb: Tension, continuity, bias ``(K, 3)``.
        parametrization: For Catmull-Rom.
        euler: Order of the angles; empty for other channels.
        pre: Before the first key.
        post: Behind the last.
    """

    target: str
    times: FloatArray
    values: FloatArray
    interps: tuple[Interp, ...]
    tangents: tuple[tuple[Tangent, Tangent], ...]
    ins: FloatArray
    outs: FloatArray
    tcb: FloatArray
    parametrization: Parametrization = Parametrization.UNIFORM
    euler: str = ""
    pre: Extrapolation = Extrapolation.HOLD
    post: Extrapolation = Extrapolation.HOLD

    def __repr__(self) -> str:
        """Return the target and the number of keys."""
        return f"<ClipChannel {self.target!r}: {counted(len(self.times), 'key')}>"
