"""Two motions of one rig made into one, joint by joint.

What moves in neither stays stored once, unless the weight changes over time.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np

from animtool._types import FloatArray
from animtool.errors import Fault, OptionError
from animtool.motion import Channel, Motion
from animtool.rig.skeleton import Rig

# From values (F, A, K) of both and weights (F, 1, 1) to values (F, A, K).
Operation: TypeAlias = Callable[[FloatArray, FloatArray, FloatArray], FloatArray]


@dataclass(frozen=True, slots=True)
class Operations:
    """What is done to each kind of channel; ``numbers`` to weights and controls."""

    translations: Operation
    rotations: Operation
    scales: Operation
    numbers: Operation


@dataclass(frozen=True, slots=True)
class Strength:
    """How much of the second motion counts, and where.

    Attributes:
        weights: [1] ``(F,)``.
        steady: The weight never changes, in this block or another.
        joints: Those that change; None is all, and shapes and controls with them.
    """

    weights: FloatArray
    steady: bool = True
    joints: Sequence[int] | None = None


def check_same_rig(rig: Rig, other: Rig) -> None:
    """Refuse two takes of different skeletons.

    Raises:
        OptionError: Names or parents of joints differ (SCN017).
    """
    if rig.names == other.names and np.array_equal(rig.parents, other.parents):
        return
    missing = sorted(set(rig.names) ^ set(other.names))
    what = f"joint {missing[0]!r} is in one only" if missing else "joints stand apart"
    raise OptionError(
        Fault(
            "SCN017",
            f"the takes are of different rigs, {rig.name!r} with {len(rig.joints)} "
            f"joints and {other.name!r} with {len(other.joints)}: {what}",
            hint="retarget one of them first",
        )
    )


def combine(
    base: Motion, other: Motion, operations: Operations, strength: Strength
) -> Motion:
    """Return one motion of two that have the same frames and rig.

    A motion without scales has scale 1, one without shape weights has 0; controls
    are changed only where both have some.

    Raises:
        OptionError: The numbers of shapes or controls differ (SCN017).
    """
    whole = strength.joints is None

    def numbers(name: str) -> Channel | None:
        a, b = getattr(base, name), getattr(other, name)
        if not whole or (a is None and b is None):
            return _as_channel(a)
        if name == "controls" and (a is None or b is None):
            return _as_channel(a)
        a, b = a or _neutral(b, 0.0), b or _neutral(a, 0.0)
        if a.rest.shape != b.rest.shape:
            raise OptionError(
                Fault("SCN017", f"one take has {len(a.rest)} {name}, the other "
                      f"{len(b.rest)}")
            )  # fmt: skip
        return _joined(a, b, operations.numbers, strength)

    scales = base.scales
    if base.scales is not None or other.scales is not None:
        a = base.scales or _neutral(_some(other.scales), 1.0)
        b = other.scales or _neutral(a, 1.0)
        scales = _joined(a, b, operations.scales, strength)
    return Motion(
        _joined(
            base.translations, other.translations, operations.translations, strength
        ),
        _joined(base.rotations, other.rotations, operations.rotations, strength),
        scales,
        numbers("weights"),
        numbers("controls"),
        base.track_times,
    )


def _some(channel: Channel | None) -> Channel:
    assert channel is not None
    return channel


def _as_channel(value: object) -> Channel | None:
    return value if isinstance(value, Channel) else None


def _neutral(like: Channel, value: float) -> Channel:
    frames, _, width = like.values.shape
    return Channel(
        np.full(like.rest.shape, value),
        np.zeros(0, np.int64),
        np.zeros((frames, 0, width)),
    )


def _joined(
    a: Channel, b: Channel, operation: Operation, strength: Strength
) -> Channel:
    chosen = (
        np.arange(len(a.rest))
        if strength.joints is None
        else np.array(strength.joints, np.int64)
    )
    moves = np.isin(chosen, np.union1d(a.animated, b.animated)) | (not strength.steady)
    moving, still = chosen[moves], chosen[~moves]
    weights = strength.weights[:, None, None]
    rest = a.rest.copy()
    if len(still) and len(weights):
        rest[still] = operation(a.rest[still][None], b.rest[still][None], weights[:1])[
            0
        ]
    result = replace(a, rest=rest)
    if len(moving):
        both = a.gather(moving), b.gather(moving)
        result = result.put(moving, operation(*both, weights))
    return result
