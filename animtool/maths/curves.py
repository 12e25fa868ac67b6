"""Scalar curves over time: segments between keys, evaluated many at once."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

from animtool._types import FloatArray, IntArray
from animtool.maths.extrapolation import Extrapolation

__all__ = ["Curves", "SegmentKind"]


class SegmentKind(IntEnum):
    """How a curve runs from a key to the next."""

    HOLD = 0
    LINEAR = 1
    CUBIC = 2
    BEZIER = 3


@dataclass(frozen=True, slots=True)
class Curves:
    """C scalar curves with K keys in all.

    The segment after a key has the control values v, v + out dv, v' + in' dv', v'.
    A CUBIC segment is the cubic of these over time that runs evenly from key to key
    (its handles lie at thirds, whatever ``dt`` says); a BEZIER segment is the curve
    of the control points in time and value, solved for the time.

    Attributes:
        first: Index of each curve's first key, and K at the end ``(C + 1,)``.
        times: Of the keys, strictly ascending within a curve ``(K,)``.
        values: ``(K,)``.
        kinds: `SegmentKind` of the segment after each key ``(K,)``; that of a
            curve's last key says nothing.
        ins: Handle before each key, as offset (dt ≤ 0, dv) ``(K, 2)``.
        outs: Handle behind each key, as offset (dt ≥ 0, dv) ``(K, 2)``.
        pre: How each curve goes on before its first key, C long.
        post: How each curve goes on behind its last, C long.
    """

    first: IntArray
    times: FloatArray
    values: FloatArray
    kinds: IntArray
    ins: FloatArray
    outs: FloatArray
    pre: tuple[Extrapolation, ...]
    post: tuple[Extrapolation, ...]
