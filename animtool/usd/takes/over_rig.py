"""Converts a take for a layer over a rig that a stage places."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from animtool.core.array_types import FloatArray
from animtool.core.errors import Fault
from animtool.core.record import dataclass
from animtool.motion.reorient import placement_notice, unplace_take
from animtool.motion.take import TakeStream
from animtool.rig.kinematics import rest_world
from animtool.rig.placed import placed_rig
from animtool.rig.placement import Placement
from animtool.rig.skeleton import Rig
from animtool.usd.layers.faults import PrimLocation
from animtool.usd.rigs.placement import (
    DROP,
    KEEP,
    SkeletonPlacement,
    refuse_uneven,
    uneven_notice,
)


@dataclass(frozen=True, slots=True)
class OverRig:
    """A take converted to the space of a rig layer."""

    stream: TakeStream  # the take, without its placement if dropped
    sized: Placement  # scale and upright rotation from rig to take
    # Returns the placement from take space to the rig's space at time codes ``(F,)``;
    # None is the identity.
    to_rig: Callable[[FloatArray], Placement] | None
    notices: list[Fault]  # notices about kept and dropped placements


def convert_over_rig(
    stream: TakeStream,
    placement: Callable[[FloatArray | None], SkeletonPlacement],
    choice: str | None,
    where: str,
    raw: Rig,
) -> OverRig:
    """Return a take in the space of a rig that a stage places.

    The layer gives the character the size and up axis of the take. The take's placement
    is kept, or dropped in favor of the stage placement of the rig.

    Args:
        stream: The take, with the up axis of the rig.
        placement: Returns the stage placement of the rig at time codes; None is the
            first.
        choice: ``keep``, ``drop``, or None: drop if the rig is placed, unless the take
            moves with a prim that the rig does not follow.
        where: Path of the rig layer, for notices.
        raw: The rig in local values.
    """
    rig_placement = placement(None)
    location = PrimLocation(where, "")
    if choice == KEEP:
        refuse_uneven(rig_placement, location)
    notices = uneven_notice(rig_placement, location)
    scale_notices = [notice for notice in stream.notices if notice.code == "USD109"]
    if (
        rig_placement.uneven
        and scale_notices
        and all(rig_placement.uneven in notice.message for notice in scale_notices)
    ):
        # The rig has the same transform that the take was read without.
        other_notices = [
            notice for notice in stream.notices if notice not in scale_notices
        ]
        stream, notices = replace(stream, notices=other_notices), []
    stands, rig = rig_placement.stands, stream.rig
    is_placed = rig_placement.rides or not rig_placement.fixed.is_identity
    if choice is None and _rests_at_stage_placement(rig, raw, rig_placement):
        # The values include the rig's placement, which is not recorded.
        rig = replace(rig, stands=stands, rides=rig_placement.rides)
        stream = replace(stream, rig=rig)
    has_no_rest = not rig.has_rest and rig.stands is None and choice != KEEP
    if has_no_rest and _is_sized(rig, raw, rig_placement.sized.size):
        has_no_rest, choice = False, choice or KEEP
    if rig_placement.uneven or has_no_rest or not is_placed:
        # Without a rest pose the take is in the space of its rig, which is this one.
        stream = unplace_take(stream) if choice == DROP else stream
        keeps_placement = choice != DROP
        notices += placement_notice(
            rig, where, kept=keeps_placement, over=rig_placement.stands
        )
        return OverRig(stream, _IDENTITY_PLACEMENT, None, notices)
    somewhere = rig_placement.rides or not stands.is_identity
    keeps_placement = choice == KEEP or (
        choice is None and (stream.rig.rides or not somewhere)
    )
    notices += placement_notice(
        rig, where, kept=keeps_placement, over=rig_placement.stands
    )
    if not keeps_placement:
        inverse_size = rig_placement.sized.inverse()
        to_rig = None if inverse_size.is_identity else lambda _: inverse_size
        return OverRig(unplace_take(stream), rig_placement.sized, to_rig, notices)
    if not rig_placement.rides:
        inverse_size = rig_placement.fixed.inverse()
        return OverRig(stream, rig_placement.sized, lambda _: inverse_size, notices)
    return OverRig(
        stream,
        rig_placement.sized,
        lambda codes: placement(codes).fixed.inverse(),
        notices,
    )


_IDENTITY_PLACEMENT = Placement(
    np.zeros((1, 3)), np.array([[0.0, 0.0, 0.0, 1.0]]), np.ones(1)
)


# Rest poses closer than this, relative to their size, are equal.
REST_TOLERANCE = 1e-3


def _rests_at_stage_placement(
    take: Rig, raw: Rig, rig_placement: SkeletonPlacement
) -> bool:
    """Return whether a take rests at the stage placement of the rig, not its own.

    This is so for a take that was read from such a stage and converted to another
    format: a BVH, whose joints have no rest rotation, has its roots there.
    """
    if take.stands is not None or not take.has_rest or rig_placement.stands.is_identity:
        return False
    index = {joint.source_name or joint.name: j for j, joint in enumerate(raw.joints)}
    pairs = [
        (j, index[name])
        for j, joint in enumerate(take.joints)
        if (name := joint.source_name or joint.name) in index
    ]
    if len(pairs) < 2:
        return False
    take_joints, rig_joints = np.array(pairs).T
    rests = rest_world(take).positions[0, take_joints]
    size = float(np.ptp(rests, axis=0).max())
    fits_placed, fits_unplaced = (
        np.abs(rest_world(placed_rig(raw, at)).positions[0, rig_joints] - rests).max(
            axis=1
        )
        for at in (rig_placement.rest, rig_placement.sized)
    )
    roots = np.array([take.joints[j].parent < 0 for j, _ in pairs])
    return any(
        bool(
            fits_placed[selected].max()
            <= REST_TOLERANCE * size
            < fits_unplaced[selected].max()
        )
        for selected in (np.full(len(pairs), True), roots)
        if selected.any()
    )


def _is_sized(take: Rig, raw: Rig, size: float) -> bool:
    """Return whether bone lengths match the rig in world scale, not in local scale.

    Without its Skeleton, the space of an animation is not stated.
    """
    lengths = {j.name: float(np.linalg.norm(j.translation)) for j in raw.joints}
    pairs = [
        (float(np.linalg.norm(joint.translation)), lengths[joint.name])
        for joint in take.joints
        if joint.parent >= 0 and joint.name in lengths
    ]
    take_length, raw_length = (
        (sum(row) for row in zip(*pairs, strict=True)) if pairs else (0, 0)
    )
    if not take_length or not raw_length:
        return False
    ratio = np.log(take_length / raw_length)
    return bool(abs(ratio - np.log(size)) < abs(ratio))
