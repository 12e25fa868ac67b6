"""Left and right of a rig that are written each on its own."""

from __future__ import annotations

from collections.abc import Iterator
from functools import lru_cache

import numpy as np

from animtool._types import BoolArray
from animtool.errors import Fault
from animtool.rig.limits import BallLimit, RangeLimit
from animtool.rig.sides import pair_sides
from animtool.rig.skeleton import Joint
from animtool.validation.subjects.rig import RigSubject

# Bones that differ by less of the rig's size are alike [1].
SAME_PLACE = 1e-4
# Limits that differ by less are alike [rad], [m].
SAME_LIMIT = 1e-6


def other_place(rig: RigSubject) -> Iterator[Fault]:
    """Yield bones of a pair that are no mirror images at rest (RIG212)."""
    pairs, alike = _compared(rig)
    if not _symmetric(alike):
        return
    for (left, right), same in zip(pairs, alike.tolist(), strict=True):
        if not same:
            at = (*rig.at("joints", right.name), "translate")
            message = f"{right.name!r} is no mirror image of {left.name!r} at rest"
            hint = f"mirror: {right.name} in {left.name!r} writes it"
            yield rig.fault("RIG212", at, message, hint)


def other_limits(rig: RigSubject) -> Iterator[Fault]:
    """Yield joints of a pair with other types or limits (RIG213)."""
    pairs, alike = _compared(rig)
    if not _symmetric(alike):
        return
    for left, right in pairs:
        what = "limits"
        if left.type is not right.type:
            what = "type"
        elif _same_limits(left, right):
            continue
        at = (*rig.at("joints", right.name), what)
        message = f"{right.name!r} has another {what} than {left.name!r}"
        if what == "limits":
            message = f"{right.name!r} has other limits than {left.name!r}"
        hint = f"mirror: {right.name} in {left.name!r} writes it"
        yield rig.fault("RIG213", at, message, hint)


@lru_cache(maxsize=1)
def _compared(rig: RigSubject) -> tuple[list[tuple[Joint, Joint]], BoolArray]:
    """Return the pairs of a rig, and which are mirror images."""
    pairs = _pairs(rig)
    return pairs, _alike(rig, pairs)


def _pairs(rig: RigSubject) -> list[tuple[Joint, Joint]]:
    """Return joints and their counterparts that no mirror wrote."""
    partners = pair_sides(rig.rig.names, rig.rig.parents).partners.tolist()
    return [
        (joint, rig.rig.joints[other])
        for i, (joint, other) in enumerate(zip(rig.rig.joints, partners, strict=True))
        if other > i and not joint.mirror
    ]


def _alike(rig: RigSubject, pairs: list[tuple[Joint, Joint]]) -> BoolArray:
    """Return whether pairs are mirror images ``(P,)``, in the plane that most are."""
    positions, _ = rig.rest
    parents = rig.rig.parents
    bones = positions - np.where(parents[:, None] < 0, 0.0, positions[parents])
    left, right = (
        bones[[rig.rig.index(pair[side].name) for pair in pairs]].reshape(-1, 3)
        for side in (0, 1)
    )
    best = np.zeros(len(pairs), bool)
    for axis in range(3):
        across = np.ones(3)
        across[axis] = -1.0
        off = np.linalg.norm(left * across - right, axis=1)
        alike = off <= SAME_PLACE * max(rig.size, SAME_PLACE)
        # Bones in the plane itself are alike in any.
        if np.count_nonzero(alike) > np.count_nonzero(best):
            best = alike
    return best


def _symmetric(alike: BoolArray) -> bool:
    """Return whether a rig is meant to have two sides that are alike."""
    return len(alike) > 1 and 2 * int(np.count_nonzero(alike)) >= len(alike)


def _same_limits(left: Joint, right: Joint) -> bool:
    match left.limits, right.limits:
        case RangeLimit() as one, RangeLimit() as two:
            return _same_range((one.low, one.high), (two.low, two.high))
        case BallLimit() as one, BallLimit() as two:
            swings = (one.swing or (), two.swing or ())
            same = len(swings[0]) == len(swings[1]) and np.allclose(
                sorted(swings[0]), sorted(swings[1]), rtol=0, atol=SAME_LIMIT
            )
            if one.twist is None or two.twist is None:
                return bool(same) and one.twist == two.twist
            return bool(same) and _same_range(one.twist, two.twist)
        case one, two:
            return one is None and two is None


def _same_range(one: tuple[float, float], two: tuple[float, float]) -> bool:
    """Return whether two ranges are the same, or the same the other way round."""
    return any(
        np.allclose(one, other, rtol=0, atol=SAME_LIMIT)
        for other in (two, (-two[1], -two[0]))
    )
