"""Changes the up axis or the placement of a take."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from animtool.core.arguments import argument
from animtool.core.array_types import FloatArray, IntArray
from animtool.core.errors import Fault, Severity
from animtool.core.units import UpAxis, up_from_up
from animtool.maths import so3
from animtool.motion.motion import Channel, Motion
from animtool.motion.take import TakeStream
from animtool.motion.transforms import apply_animated_placement, rotate_track
from animtool.rig.placed import at_origin, transform_rig
from animtool.rig.placement import Placement
from animtool.rig.skeleton import Rig


def reorient(stream: TakeStream, up: UpAxis) -> TakeStream:
    """Return a take rotated to an up axis.

    Roots at rest and in motion, strands, tracks, and the pole directions of chains that
    begin at a root are rotated; everything below the roots is in their frames.
    """
    rotation = up_from_up(up, stream.rig.up)
    if rotation is None:
        return stream
    quaternion = np.array(rotation)
    result = _with_placement(stream, Placement.from_rotation(quaternion), up)
    result.tracks = tuple(rotate_track(track, quaternion) for track in stream.tracks)
    return result


def remove_placement(stream: TakeStream) -> TakeStream:
    """Return a take without its placement on the stage.

    Its size and its up axis are kept. Tracks that follow the placement move with it.
    """
    placement = stream.rig.placement
    if placement is None:
        return stream
    inverse = placement.inverse()
    result = _with_placement(stream, inverse, stream.rig.up)
    result.rig = at_origin(stream.rig)
    result.tracks = tuple(
        apply_animated_placement(track, lambda _: inverse)
        if track.follows_placement
        else track
        for track in stream.tracks
    )
    return result


def _with_placement(stream: TakeStream, placement: Placement, up: UpAxis) -> TakeStream:
    """Return a stream with a placement applied to its rig, blocks and curve."""
    roots, curve = np.array(stream.rig.roots, np.int64), stream.curve

    def transform(motion: Motion) -> Motion:
        """Return the transformed motion."""
        return transform_motion(motion, roots, placement)

    placed_stream = replace(
        stream,
        rig=transform_rig(stream.rig, placement, up),
        blocks=(transform(block) for block in stream.blocks),
    )
    if curve is not None:
        placed_stream.curve = lambda times: transform(curve(times))
    return placed_stream


def rotate_rig(rig: Rig, rotation: FloatArray, up: UpAxis) -> Rig:
    """Return a rig whose rest roots are rotated by a quaternion ``(4,)``."""
    return transform_rig(rig, Placement.from_rotation(rotation), up)


def transform_motion(motion: Motion, roots: IntArray, placement: Placement) -> Motion:
    """Apply a placement with one frame, or one per frame of the motion, to a motion.

    ``roots``: joints without a parent ``(R,)``.
    """
    rotations = _position_roots(motion.rotations, roots, placement, is_rotation=True)
    if placement.is_animated:
        root_rotations = so3.align_signs(rotations.gather(roots))
        rotations = rotations.put(roots, root_rotations)
    points = motion.points.items()
    return replace(
        motion,
        translations=_position_roots(
            motion.translations, roots, placement, is_rotation=False
        ),
        rotations=rotations,
        scales=_scale_roots(motion, roots, placement),
        points={name: _transform_points(rows, placement) for name, rows in points},
    )


def _position_roots(
    channel: Channel, roots: IntArray, placement: Placement, *, is_rotation: bool
) -> Channel:
    """Return a channel with its roots moved to a placement and its lengths scaled."""
    transform_values = (
        placement.transform_rotations if is_rotation else placement.transform_points
    )
    rest_values, values = channel.rest.copy(), channel.values.copy()
    is_root = np.isin(channel.animated, roots)
    if placement.size != 1.0 and not is_rotation:
        is_child = np.ones(len(rest_values), np.bool_)
        is_child[roots] = False
        rest_values[is_child] *= placement.size
        values[:, ~is_root] *= placement.size
    if placement.is_animated:
        placed_roots = transform_values(channel.gather(roots))
        return Channel(rest_values, channel.animated, values).put(roots, placed_roots)
    rest_values[roots] = transform_values(rest_values[roots])
    values[:, is_root] = transform_values(values[:, is_root])
    return Channel(rest_values, channel.animated, values)


def _scale_roots(
    motion: Motion, roots: IntArray, placement: Placement
) -> Channel | None:
    """Return scales times the placement's size relative to its first frame."""
    extra_scale = placement.sizes / placement.size
    if (extra_scale == 1.0).all():
        return motion.scales
    scales = motion.scales
    if scales is None:
        ones = np.ones((len(motion.translations.rest), 3))
        scales = Channel.static(ones, len(extra_scale))
    return scales.put(roots, scales.gather(roots) * extra_scale[:, None, None])


def _transform_points(channel: Channel, placement: Placement) -> Channel:
    """Return world points with a placement applied."""
    if placement.is_animated:
        point_indices = np.arange(len(channel.rest))
        return channel.put(
            point_indices, placement.transform_points(channel.gather(point_indices))
        )
    return replace(
        channel,
        rest=placement.transform_points(channel.rest),
        values=placement.transform_points(channel.values),
    )


def placement_notice(
    rig: Rig,
    location: str,
    *,
    is_kept: bool,
    rig_placement: Placement | None = None,
    is_in_joints: bool = False,
) -> list[Fault]:
    """Return a notice on a take's stage placement (USD124).

    is_kept: whether the placement is kept; rig_placement: placement of the layer's rig;
    is_in_joints: whether a parent animated the placement, which is now in the joints.
    """
    if rig.placement is None and not rig.has_animated_parents:
        return []
    clauses = [f"stands {rig.placement.description()}"] if rig.placement else []
    if rig.has_animated_parents:
        clauses.append("moves with a prim above its SkelRoot")
    message = f"the take {' and '.join(clauses)}, "
    message += "which is kept" if is_kept else "which is dropped"
    if rig_placement is not None and not rig_placement.is_identity:
        message += f"; the rig has its placement {rig_placement.description()}"
    if is_in_joints:
        message += "; the motion from above is in its joints, and is kept"
    hint = f"{argument('placement', 'drop' if is_kept else 'keep')} does the opposite"
    return [Fault("USD124", message, location, (), hint, Severity.NOTE)]
