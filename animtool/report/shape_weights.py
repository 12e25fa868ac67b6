"""How far the blend shape weights of two takes are apart."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from animtool._types import FloatArray
from animtool.errors import counted, listed
from animtool.rig.arkit import arkit_name
from animtool.take import Take


@dataclass(frozen=True, slots=True)
class ShapeDifference:
    """The largest difference of weights.

    Attributes:
        value: How large [1].
        shape: Of which shape, as the first take has it.
        code: Time code in the first take.
    """

    value: float = 0.0
    shape: str = ""
    code: float = 0.0


def compare_weights(
    first: Take, second: Take, frames: int
) -> tuple[ShapeDifference, int, list[str]]:
    """Compare the weights of two takes of one rate, shapes by name.

    Shapes of ARKit's are the same however they are spelled. A shape that only one take
    has is a mismatch where its weight is ever other than 0.

    Args:
        first: A take.
        second: Another, of the same rate.
        frames: How many frames to compare.

    Returns:
        The largest difference, how many shapes were compared, and which only one has.
    """
    a, b = (_weights(take) for take in (first, second))
    names = [[shape.name for shape in take.rig.shapes] for take in (first, second)]
    pairs = _pairs(*names)
    mismatches = []
    for column, (weights, other) in enumerate(((a, "second"), (b, "first"))):
        alone = set(range(weights.shape[1])) - {pair[column] for pair in pairs}
        lost = [names[column][s] for s in sorted(alone) if weights[:, s].any()]
        if lost:
            are = "is" if len(lost) == 1 else "are"
            mismatches.append(
                f"{counted(len(lost), 'shape')} {are} not in the {other}: "
                f"{listed(lost)}"
            )
    mine, theirs = [s for s, _ in pairs], [s for _, s in pairs]
    apart = np.abs(a[:frames, mine] - b[:frames, theirs])
    if not apart.size:
        return ShapeDifference(), 0, mismatches
    frame, pair = np.unravel_index(np.argmax(apart), apart.shape)
    largest = ShapeDifference(
        float(apart[frame, pair]),
        names[0][mine[int(pair)]],
        float(first.clock.times[frame]),
    )
    return largest, len(pairs), mismatches


def _weights(take: Take) -> FloatArray:
    """Return the weights of every shape ``(F, S)``; those of a take without are 0."""
    if take.motion.weights is None:
        return np.zeros((take.clock.count, len(take.rig.shapes)))
    return take.motion.weights.dense()[..., 0]


def _pairs(first: Sequence[str], second: Sequence[str]) -> list[tuple[int, int]]:
    """Match shapes by name, then by ARKit's name for them, in order."""
    pairs = [(i, second.index(name)) for i, name in enumerate(first) if name in second]
    mine, theirs = {i for i, _ in pairs}, {k for _, k in pairs}
    spelled = {
        arkit: k
        for k, name in enumerate(second)
        if k not in theirs and (arkit := arkit_name(name)) is not None
    }
    for i, name in enumerate(first):
        found = None if i in mine else spelled.pop(arkit_name(name) or "", None)
        if found is not None:
            pairs.append((i, found))
    return sorted(pairs)
