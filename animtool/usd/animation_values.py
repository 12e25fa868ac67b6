"""The values of a SkelAnimation over frames, checked."""

from __future__ import annotations

from typing import Any

import numpy as np
from pxr import Usd

from animtool._types import FloatArray
from animtool.errors import Fault, FormatError, counted
from animtool.motion import Channel
from animtool.usd.values import array_value, numbers


def scale_channel(dense: FloatArray) -> Channel | None:
    """Return the channel of scales ``(F, J, 3)``; None where nothing is scaled."""
    return None if (dense == 1.0).all() else Channel.from_dense(dense)


def animated_shapes(animation: Any) -> list[str]:
    """Return the shapes that an animation has weights of."""
    if not animation.GetBlendShapeWeightsAttr().HasAuthoredValue():
        return []
    return [str(token) for token in array_value(animation.GetBlendShapesAttr())]


def shape_weights(
    animation: Any, codes: list[float], shapes: int, where: str
) -> Channel:
    """Return the weights of an animation's shapes at time codes; see `sampled_values`.

    Args:
        animation: The SkelAnimation.
        codes: F time codes.
        shapes: How many there are.
        where: The animation, for messages.
    """
    attr = animation.GetBlendShapeWeightsAttr()
    rows = sampled_values(attr, codes, shapes, 1, where, of="shape")
    return Channel.from_dense(np.repeat(rows, len(codes) // len(rows), axis=0))


def sampled_values(
    attr: Any,
    codes: list[float],
    count: int,
    width: int,
    where: str,
    *,
    of: str = "joint",
) -> FloatArray:
    """Return an attribute's samples ``(F, J, K)``; F is 1 where it does not change.

    Args:
        attr: Of a SkelAnimation, an array of values for every joint or shape.
        codes: F time codes.
        count: J.
        width: K.
        where: The animation, for messages.
        of: What the values are of.

    Raises:
        FormatError: There are not J values (USD013), or one is not finite (USD014).
    """
    changes = attr.GetNumTimeSamples() > 1
    when = (
        [Usd.TimeCode(c) for c in codes] if changes else [Usd.TimeCode.EarliestTime()]
    )
    rows = np.empty((len(when), count, width))
    for i, time in enumerate(when):
        value = numbers(attr, width, time)
        if len(value) != count:
            message = f"{attr.GetName()} has {counted(len(value), 'value')}"
            message += f" for {counted(count, of)}"
            hint = f"{_moment(time)}; UsdSkel falls back to rest"
            raise FormatError(Fault("USD013", message, where, (), hint))
        rows[i] = value
    if not np.isfinite(rows).all():
        frame, joint, _ = np.argwhere(~np.isfinite(rows))[0]
        message = f"{attr.GetName()} is not finite"
        hint = f"{_moment(when[frame])}, {of} {joint}"
        raise FormatError(Fault("USD014", message, where, (), hint))
    return rows


def _moment(time: Any) -> str:
    """Return a time in words; the earliest is that of a value that does not change."""
    if time.IsEarliestTime():
        return "the only value"
    return f"time code {time.GetValue():g}"
