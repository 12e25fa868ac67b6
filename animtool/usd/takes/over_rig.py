"""What a layer holds of where a take is, over a rig that a stage has somewhere."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from animtool.core.array_types import FloatArray
from animtool.core.errors import Fault
from animtool.core.record import dataclass
from animtool.motion.reorient import off_its_place
from animtool.motion.take import TakeStream
from animtool.rig.kinematics import rest_world
from animtool.rig.placed import placed_rig, placement_notice
from animtool.rig.placement import Placement
from animtool.rig.skeleton import Rig
from animtool.usd.layers.faults import Spot
from animtool.usd.rigs.placement import (
    DROP,
    KEEP,
    SkeletonPlacement,
    refuse_uneven,
    uneven_notice,
)


@dataclass(frozen=True, slots=True)
class OverRig:
    """How a take comes to the numbers of a rig."""

    stream: TakeStream  # without where it stands, where that is dropped
    sized: Placement  # makes the rig, as its numbers are, as large and as upright
    # From where the take is to the rig's numbers, at time codes ``(F,)``; None: the
    # same.
    to_rig: Callable[[FloatArray], Placement] | None
    notices: list[Fault]  # what is kept or dropped


def over_rig(
    stream: TakeStream,
    placement: Callable[[FloatArray | None], SkeletonPlacement],
    choice: str | None,
    where: str,
    raw: Rig,
) -> OverRig:
    """Return how a take comes to the numbers of a rig that a stage has somewhere.

    The layer makes the character as large and as upright as the take. Where that
    stands is kept, or dropped: the rig's stage then has it where it has the rig.

    Args:
        stream: The take, with the up axis of the rig.
        placement: Where the rig's stage has it, at time codes; None is the first.
        choice: ``keep``, ``drop``, or None: drop where the rig stands somewhere, unless
            the take rides on what the rig does not.
        where: The rig layer, for notices.
        raw: The rig, as its numbers are.
    """
    own = placement(None)
    spot = Spot(where, "")
    if choice == KEEP:
        refuse_uneven(own, spot)
    notices = uneven_notice(own, spot)
    left = [notice for notice in stream.notices if notice.code == "USD109"]
    if own.uneven and left and all(own.uneven in notice.message for notice in left):
        # The rig has the very transform that the take is read without.
        others = [notice for notice in stream.notices if notice not in left]
        stream, notices = replace(stream, notices=others), []
    stands, rig = own.stands, stream.rig
    placed = own.rides or not own.fixed.is_none
    if choice is None and _stands_there(rig, raw, own):
        # Its numbers hold the place of the rig, and nothing records that.
        rig = replace(rig, stands=stands, rides=own.rides)
        stream = replace(stream, rig=rig)
    alone = not rig.has_rest and rig.stands is None and choice != KEEP
    if alone and _is_sized(rig, raw, own.sized.size):
        alone, choice = False, choice or KEEP
    if own.uneven or alone or not placed:
        # Without a rest pose it is in the space of its rig, which this is.
        stream = off_its_place(stream) if choice == DROP else stream
        kept = choice != DROP
        notices += placement_notice(rig, where, kept=kept, over=own.stands)
        return OverRig(stream, _NONE, None, notices)
    somewhere = own.rides or not stands.is_none
    kept = choice == KEEP or (choice is None and (stream.rig.rides or not somewhere))
    notices += placement_notice(rig, where, kept=kept, over=own.stands)
    if not kept:
        back = own.sized.inverse()
        to_rig = None if back.is_none else lambda _: back
        return OverRig(off_its_place(stream), own.sized, to_rig, notices)
    if not own.rides:
        back = own.fixed.inverse()
        return OverRig(stream, own.sized, lambda _: back, notices)
    return OverRig(
        stream, own.sized, lambda codes: placement(codes).fixed.inverse(), notices
    )


_NONE = Placement(np.zeros((1, 3)), np.array([[0.0, 0.0, 0.0, 1.0]]), np.ones(1))


# Rest poses nearer than this fraction of their size are the same.
NEAR = 1e-3


def _stands_there(take: Rig, raw: Rig, own: SkeletonPlacement) -> bool:
    """Return whether a take rests where a stage has a rig, and not where it is alone.

    As a take does that was read from such a stage, and came as another kind of file:
    a BVH, whose joints are not turned at rest, has its roots there.
    """
    if take.stands is not None or not take.has_rest or own.stands.is_none:
        return False
    index = {joint.source_name or joint.name: j for j, joint in enumerate(raw.joints)}
    pairs = [
        (j, index[name])
        for j, joint in enumerate(take.joints)
        if (name := joint.source_name or joint.name) in index
    ]
    if len(pairs) < 2:
        return False
    mine, theirs = np.array(pairs).T
    rests = rest_world(take).positions[0, mine]
    size = float(np.ptp(rests, axis=0).max())
    placed, alone = (
        np.abs(rest_world(placed_rig(raw, at)).positions[0, theirs] - rests).max(axis=1)
        for at in (own.rest, own.sized)
    )
    roots = np.array([take.joints[j].parent < 0 for j, _ in pairs])
    return any(
        bool(placed[some].max() <= NEAR * size < alone[some].max())
        for some in (np.full(len(pairs), True), roots)
        if some.any()
    )


def _is_sized(take: Rig, raw: Rig, size: float) -> bool:
    """Return whether bones are as long as a rig's in the world, and not in its space.

    An animation without its Skeleton says no more of the space that it is in.
    """
    lengths = {j.name: float(np.linalg.norm(j.translation)) for j in raw.joints}
    pairs = [
        (float(np.linalg.norm(joint.translation)), lengths[joint.name])
        for joint in take.joints
        if joint.parent >= 0 and joint.name in lengths
    ]
    mine, theirs = (sum(row) for row in zip(*pairs, strict=True)) if pairs else (0, 0)
    if not mine or not theirs:
        return False
    ratio = np.log(mine / theirs)
    return bool(abs(ratio - np.log(size)) < abs(ratio))
