"""Converts a take to the space of a rig that its stage places."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from animtool.core.array_types import FloatArray
from animtool.core.errors import Fault
from animtool.core.record import dataclass
from animtool.maths import so3
from animtool.motion.reorient import placement_notice, remove_placement
from animtool.motion.take import TakeStream
from animtool.rig.kinematics import rest_world
from animtool.rig.placed import transform_rig
from animtool.rig.placement import Placement
from animtool.rig.skeleton import Rig
from animtool.usd.layers.faults import PrimLocation
from animtool.usd.rigs.placement import (
    DROP_PLACEMENT,
    KEEP_PLACEMENT,
    SkeletonPlacement,
    refuse_unsupported,
    unsupported_notice,
)


@dataclass(frozen=True, slots=True)
class RigSpaceTake:
    """A take converted to the space of a rig layer."""

    stream: TakeStream  # the take, without its placement if dropped
    upright_placement: Placement  # scale and upright rotation from rig to take
    # Returns the placement from take space to the rig's space at time codes ``(F,)``;
    # None is the identity.
    rig_from_take: Callable[[FloatArray], Placement] | None
    notices: list[Fault]  # notices about kept and dropped placements


def convert_to_rig_space(
    stream: TakeStream,
    placement_at: Callable[[FloatArray | None], SkeletonPlacement],
    placement_choice: str | None,
    file_path: str,
    local_rig: Rig,
) -> RigSpaceTake:
    """Return a take in the space of a rig that a stage places.

    The layer gives the character the size and up axis of the take. The take's placement
    is kept, or dropped in favor of the stage placement of the rig.

    Args:
        stream: The take, with the up axis of the rig.
        placement_at: Returns the rig's stage placement at time codes; None is the
            first.
        placement_choice: ``keep`` or ``drop``. None drops it if the rig is placed,
            unless the take follows an animated prim that the rig does not follow.
        file_path: Path of the rig layer, for notices.
        local_rig: The rig in local space.
    """
    rig_placement = placement_at(None)
    location = PrimLocation(file_path, "")
    if placement_choice == KEEP_PLACEMENT:
        refuse_unsupported(rig_placement, location)
    notices = unsupported_notice(rig_placement, location)
    scale_notices = [notice for notice in stream.notices if notice.code == "USD109"]
    if (
        rig_placement.unsupported_reason
        and scale_notices
        and all(
            rig_placement.unsupported_reason in notice.message
            for notice in scale_notices
        )
    ):
        # The take was read without the transform that the rig has too.
        other_notices = [
            notice for notice in stream.notices if notice not in scale_notices
        ]
        stream, notices = replace(stream, notices=other_notices), []
    heading_placement, rig = rig_placement.heading_placement, stream.rig
    is_transformed = (
        rig_placement.is_animated or not rig_placement.fixed_placement.is_identity
    )
    if placement_choice is None and _is_rest_placed(rig, local_rig, rig_placement):
        # The values include the rig's placement, although it is not recorded.
        rig = replace(
            rig,
            placement=heading_placement,
            has_animated_parents=rig_placement.is_animated,
        )
        stream = replace(stream, rig=rig)
    has_no_rest = (
        not rig.has_rest
        and rig.placement is None
        and placement_choice != KEEP_PLACEMENT
    )
    if has_no_rest and _has_world_lengths(
        rig, local_rig, rig_placement.upright_placement.size
    ):
        has_no_rest, placement_choice = False, placement_choice or KEEP_PLACEMENT
    # Without a rest pose the take is in the space of its rig, which is this one.
    is_in_rig_space = (
        bool(rig_placement.unsupported_reason) or has_no_rest or not is_transformed
    )
    has_placement = rig_placement.is_animated or not heading_placement.is_identity
    if is_in_rig_space:
        keeps_placement = placement_choice != DROP_PLACEMENT
    else:
        keeps_placement = placement_choice == KEEP_PLACEMENT or (
            placement_choice is None
            and (stream.rig.has_animated_parents or not has_placement)
        )
    notices += placement_notice(
        rig, file_path, is_kept=keeps_placement, rig_placement=heading_placement
    )
    if not keeps_placement:
        stream = remove_placement(stream)
    if is_in_rig_space:
        identity = Placement.from_rotation(so3.IDENTITY)
        return RigSpaceTake(stream, identity, None, notices)
    upright_placement = rig_placement.upright_placement
    if keeps_placement and rig_placement.is_animated:
        return RigSpaceTake(
            stream,
            upright_placement,
            lambda codes: placement_at(codes).fixed_placement.inverse(),
            notices,
        )
    inverse_placement = (
        rig_placement.fixed_placement if keeps_placement else upright_placement
    ).inverse()
    is_needed = keeps_placement or not inverse_placement.is_identity
    return RigSpaceTake(
        stream,
        upright_placement,
        (lambda _: inverse_placement) if is_needed else None,
        notices,
    )


# Rest poses closer than this, relative to their size, are equal.
REST_TOLERANCE = 1e-3


def _is_rest_placed(
    take_rig: Rig, local_rig: Rig, rig_placement: SkeletonPlacement
) -> bool:
    """Return whether a take's rest pose is at the stage placement of the rig.

    This holds for takes read from such a stage and converted to another format. In a
    BVH, whose joints have no rest rotation, only the roots are placed.
    """
    if (
        take_rig.placement is not None
        or not take_rig.has_rest
        or rig_placement.heading_placement.is_identity
    ):
        return False
    rig_index_by_name = {
        joint.source_name or joint.name: j for j, joint in enumerate(local_rig.joints)
    }
    joint_pairs = [
        (j, rig_index_by_name[name])
        for j, joint in enumerate(take_rig.joints)
        if (name := joint.source_name or joint.name) in rig_index_by_name
    ]
    if len(joint_pairs) < 2:
        return False
    take_joints, rig_joints = np.array(joint_pairs).T
    rest_positions = rest_world(take_rig).positions[0, take_joints]
    extent = float(np.ptp(rest_positions, axis=0).max())
    placed_errors, unplaced_errors = (
        np.abs(
            rest_world(transform_rig(local_rig, candidate)).positions[0, rig_joints]
            - rest_positions
        ).max(axis=1)
        for candidate in (rig_placement.rest_placement, rig_placement.upright_placement)
    )
    is_root = np.array([take_rig.joints[j].parent < 0 for j, _ in joint_pairs])
    return any(
        bool(
            placed_errors[is_compared].max()
            <= REST_TOLERANCE * extent
            < unplaced_errors[is_compared].max()
        )
        for is_compared in (np.full(len(joint_pairs), True), is_root)
        if is_compared.any()
    )


def _has_world_lengths(take_rig: Rig, local_rig: Rig, scale: float) -> bool:
    """Return whether bone lengths match the rig in world scale rather than local scale.

    An animation without its Skeleton does not state its space.
    """
    rig_lengths = {
        j.name: float(np.linalg.norm(j.translation)) for j in local_rig.joints
    }
    length_pairs = [
        (float(np.linalg.norm(joint.translation)), rig_lengths[joint.name])
        for joint in take_rig.joints
        if joint.parent >= 0 and joint.name in rig_lengths
    ]
    take_length, rig_length = (
        (sum(row) for row in zip(*length_pairs, strict=True))
        if length_pairs
        else (0, 0)
    )
    if not take_length or not rig_length:
        return False
    ratio = np.log(take_length / rig_length)
    return bool(abs(ratio - np.log(scale)) < abs(ratio))
