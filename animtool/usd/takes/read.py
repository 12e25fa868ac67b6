"""Reads a SkelAnimation of a stage as a take."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
from pxr import Usd, UsdSkel

from animtool.core.arguments import argument
from animtool.core.array_types import FloatArray, IntArray
from animtool.core.clock import Clock, time_fraction
from animtool.core.errors import Fault, FormatError, Severity, listed
from animtool.core.rates import rate_from_float
from animtool.core.units import unit_name
from animtool.motion.motion import Channel, Motion
from animtool.motion.reorient import placed_motion, placement_notice, unplace_take
from animtool.motion.take import Take, TakeStream
from animtool.rig.parts import AttachKind, Shape
from animtool.rig.placement import Placement
from animtool.rig.skeleton import Rig
from animtool.usd.layers.composition import unresolved_hint
from animtool.usd.layers.faults import (
    PrimLocation,
    matrix_array,
)
from animtool.usd.layers.sdf import usd_errors
from animtool.usd.layers.stderr import without_usd_warnings
from animtool.usd.rigs.mesh_read import bound_shapes
from animtool.usd.rigs.placement import (
    DROP,
    NO_PLACEMENT,
    SkeletonPlacement,
    animated_ancestors,
    refuse_unsupported,
    rest_rig,
    skeleton_placement,
    unit_mismatch_notice,
    unsupported_notice,
)
from animtool.usd.rigs.prims import (
    SkeletonRig,
    animation_source,
    check_animatable,
    composition_notices,
    find_skeletons,
    open_stage,
    search_root,
    skeleton_rig,
    skipped_skeletons_notice,
    stored_data,
)
from animtool.usd.rigs.skeleton import apply_recorded_rest
from animtool.usd.rigs.skinned import (
    BINDING_HINT,
    MAX_LISTED_PRIMS,
    character_paths,
    missing_animation_reason,
    unapplied_binding_path,
)
from animtool.usd.takes.animation import (
    first_animation,
    read_animation,
    rig_of_animation,
    root_motion_notice,
)
from animtool.usd.takes.animation_values import nearest_samples, scale_channel
from animtool.usd.takes.library import TakeSet, find_take_set, select_take


def read_usd(
    path: Path | str,
    *,
    prim_path: str | None = None,
    take: str | None = None,
    placement: str | None = None,
) -> TakeStream:
    """Read the animation of a character on a stage, or of an animation layer alone.

    Joints without animation are at rest. The character has the size and position that
    pxr composes: roots and lengths include the transforms of the Skeleton and its
    ancestors. A layer without its rig has no rest pose: its joints rest at their first
    sample.

    Args:
        path: The file.
        prim_path: Path of the character; None is the first.
        take: Name of a take of a clip library; None is the selected one.
        placement: ``drop`` ignores position and heading of the character, except motion
            of its SkelRoot; size and up axis stay. None keeps it.
    """
    path = Path(path)
    with usd_errors(path), without_usd_warnings():
        return _read_stage(open_stage(path), path, prim_path, take, placement)


def _read_stage(
    stage: Any,
    path: Path,
    prim_path: str | None,
    take: str | None,
    choice: str | None,
) -> TakeStream:
    root_path = search_root(stage, prim_path)
    takes = _take_set(stage, root_path)
    if take is not None:
        takes = select_take(takes, take, str(path))
    stream = read_character(stage, path, root_path, choice)
    if takes is not None:
        stream.details["takes"] = list(takes.names)
        stream.details["take"] = takes.selected
    return stream


def _take_set(stage: Any, root_path: str) -> TakeSet | None:
    """Return the take set of the character."""
    skeletons = find_skeletons(stage, root_path)
    if skeletons:
        return find_take_set(skeletons[0].GetPrim())
    # An animation layer alone has only overs.
    root_prim = stage.GetPrimAtPath(root_path)
    prims = Usd.PrimRange(root_prim, Usd.PrimAllPrimsPredicate) if root_prim else ()
    return next((take_set for prim in prims if (take_set := find_take_set(prim))), None)


def read_character(
    stage: Any, path: Path, root_path: str, choice: str | None = None
) -> TakeStream:
    """Read the first character below a prim, or the animation of a layer alone.

    ``choice`` is its placement, as in `read_usd`.
    """
    skeletons = find_skeletons(stage, root_path)
    if skeletons:
        skeleton = skeleton_rig(skeletons[0], path)
        animation = _bound_animation(skeletons[0])
        prim = skeletons[0].GetPrim()
    else:
        animation = first_animation(stage, root_path)
        if animation is None:
            message = f"has no Skeleton and no SkelAnimation below {root_path}"
            characters = character_paths(stage)
            hint = "a character is needed; props go under props of a scene"
            if characters:
                names = listed(characters, MAX_LISTED_PRIMS)
                hint = f"choose one of {names} with {argument('source.prim_path')}"
            hint = unresolved_hint(stage) or hint
            raise FormatError(Fault("USD008", message, str(path), (), hint))
        skeleton = rig_of_animation(animation, path, stage)
        prim = None
    if animation is None:
        stream, placement = _rest_take(skeleton, stage, path, prim, choice)
    else:
        stream, placement = _animated_take(
            stage, path, skeleton, animation, prim, choice
        )
    stream.notices += skeleton.notices
    animation_prim = None if animation is None else animation.GetPrim()
    if prim is None:
        stream.notices += root_motion_notice(
            animation, PrimLocation.from_prim(path, animation)
        )
    else:
        _join_stored(stream, skeletons[0], skeleton, path)
    where = PrimLocation.from_prim(path, prim or animation_prim)
    stream.rig = apply_recorded_rest(stream.rig, prim, animation_prim, where)
    if choice == DROP:
        stream = _without_placement(stream, placement, prim, str(path))
    else:
        stream.rig = rest_rig(stream.rig, placement)
    stream.notices += skipped_skeletons_notice(
        skeletons,
        str(path),
        f"choose one with {argument('source.prim_path')}",
    )
    stream.notices += composition_notices(stage, str(path))
    return stream


def _placement_at(
    prim: Any,
    rig: Rig,
    codes: list[float] | None,
    where: PrimLocation,
    choice: str | None,
) -> tuple[SkeletonPlacement, list[Fault]]:
    """Return the placement of a Skeleton at time codes; its take includes it."""
    if prim is None:
        return NO_PLACEMENT, []
    placement = skeleton_placement(prim, rig, codes)
    if choice != DROP:
        refuse_unsupported(placement, where)
    notices = unsupported_notice(placement, where)
    notices += unit_mismatch_notice(placement, where.path or "")
    return (NO_PLACEMENT if placement.unsupported_reason else placement), notices


def _placed_on_stage(
    motion: Motion, rig: Rig, placement: SkeletonPlacement, choice: str | None
) -> Motion:
    """Return the motion moved to the stage placement of its rig."""
    path = placement.motion if choice == DROP else placement.full
    if path.is_identity:
        return motion
    roots = np.array(rig.roots, np.int64)
    return placed_motion(motion, roots, path).map(Channel.compact)


def _without_placement(
    stream: TakeStream, placement: SkeletonPlacement, prim: Any, path: str
) -> TakeStream:
    """Return a take without its stage placement, which is kept separately.

    Its joints still include the placement that the file records.
    """
    raw = stream.rig
    placed_rig = rest_rig(raw, placement)
    rig_ = replace(placed_rig, rides=placement.is_animated)
    stream.notices += placement_notice(rig_, path, kept=False, stays=raw.rides)
    stream.rig = rest_rig(raw, placement, DROP)
    stands = stream.rig.stands
    stream = unplace_take(stream)
    stream.rig = replace(stream.rig, rides=False)
    if rig_.stands is not None or rig_.rides:
        stream.dropped = _dropped_placement(placement, stands, prim, raw)
    return stream


def _dropped_placement(
    placement: SkeletonPlacement, rig_stands: Placement | None, prim: Any, rig: Rig
) -> Callable[[FloatArray], Placement]:
    """Return a function of the dropped placement by stage time codes."""
    stage: Any = None if prim is None else prim.GetStage()

    def placement_at(codes: FloatArray) -> Placement:
        at_codes = placement
        if placement.is_animated:
            # A reference keeps the stage and its prims alive as long as the function.
            skeleton = stage.GetPrimAtPath(prim.GetPath())
            at_codes = skeleton_placement(skeleton, rig, codes.tolist())
        stands, _ = at_codes.fixed.split(rig.up)
        return stands if rig_stands is None else stands.after(rig_stands)

    return placement_at


def _join_stored(
    stream: TakeStream, skeleton: Any, rig: SkeletonRig, path: Path
) -> None:
    """Add the rig data of the Skeleton's customData to a take."""
    data = stored_data(skeleton.GetPrim())
    if not data.get("rig"):
        return
    from animtool.usd.rigs.stored import merge_rig

    merged_rig, notices = merge_rig(
        stream.rig,
        data,
        rig.tokens,
        matrix_array(skeleton.GetRestTransformsAttr()),
        matrix_array(skeleton.GetBindTransformsAttr()),
        path,
    )
    names = [shape.name for shape in merged_rig.shapes]
    columns = np.array([names.index(s.name) for s in stream.rig.shapes], np.int64)
    stream.blocks = _spread_weights(stream.blocks, columns, len(names))
    # Meshes and curves stay in place, and with them cloth and strands.
    with_usd_arrays = {AttachKind.CLOTH, AttachKind.STRANDS}
    attach = tuple(
        entry for entry in merged_rig.attach if entry.kind not in with_usd_arrays
    )
    stream.rig = replace(merged_rig, meshes=(), attach=attach)
    stream.notices += notices


def _spread_weights(
    blocks: Iterator[Motion], columns: IntArray, count: int
) -> Iterator[Motion]:
    """Yield blocks with weights in the given columns; other columns are 0."""
    for block in blocks:
        channel = block.weights
        if channel is None:
            yield block
            continue
        rest = np.zeros((count, 1))
        rest[columns] = channel.rest
        animated = columns[channel.animated]
        order = np.argsort(animated)
        weights = Channel(rest, animated[order], channel.values[:, order])
        yield replace(block, weights=weights)


def _bound_animation(skeleton: Any) -> Any:
    if not UsdSkel.Root.Find(skeleton.GetPrim()):
        return None
    if source := animation_source(skeleton):
        return UsdSkel.Animation(source)
    # Includes an animation that UsdSkel cannot use: reading it reports why.
    binding = UsdSkel.BindingAPI(skeleton.GetPrim()).GetInheritedAnimationSource()
    return UsdSkel.Animation(binding) if binding and binding.IsActive() else None


def _rest_take(
    skeleton: SkeletonRig, stage: Any, path: Path, prim: Any, choice: str | None
) -> tuple[TakeStream, SkeletonPlacement]:
    """Return a take of one frame at rest, for a rig without animation."""
    shapes = () if skeleton.tokens else bound_shapes(UsdSkel.Skeleton(prim))
    rig = skeleton.rig
    check_animatable(len(rig.joints), len(shapes), PrimLocation.from_prim(path, prim))
    rig = replace(rig, shapes=tuple(Shape(name) for name in shapes))
    motion = Motion(
        Channel.from_dense(rig.rest_translations[None]),
        Channel.from_dense(rig.rest_rotations[None]),
        scale_channel(skeleton.rest_scales[None]),
        Channel.from_dense(np.zeros((1, len(shapes), 1))) if shapes else None,
    )
    placement, notices = _placement_at(
        prim, rig, None, PrimLocation.from_prim(path, prim), choice
    )
    motion = _placed_on_stage(motion, rig, placement, choice)
    fps = rate_from_float(stage.GetTimeCodesPerSecond())
    start = time_fraction(stage.GetStartTimeCode())
    stream = TakeStream.of(Take(rig, Clock(fps, start, Fraction(1), 1), motion))
    stream.details = _source_details(stage, skeleton)
    stream.details["animation"] = None
    if not stage.HasAuthoredMetadata("startTimeCode"):
        stream.start = None
    message = "no animation is bound to the skeleton; it is read at rest"
    hint = None
    if ignored := unapplied_binding_path(prim):
        message += f": {ignored} binds one, but SkelBindingAPI is not applied to it"
        hint = BINDING_HINT
    elif missing := missing_animation_reason(prim):
        message = f"its animation {missing}; the skeleton is read at rest"
        hint = "activate it, or correct the targets of skel:animationSource"
    warning = Severity.WARNING
    stream.notices.append(Fault("USD103", message, str(path), (), hint, warning))
    stream.notices += notices
    return stream, placement


def _animated_take(
    stage: Any,
    path: Path,
    skeleton: SkeletonRig,
    animation: Any,
    prim: Any,
    choice: str | None,
) -> tuple[TakeStream, SkeletonPlacement]:
    """Return the take of an animation, and the placement of its Skeleton."""
    where = PrimLocation.from_prim(path, animation)
    values = read_animation(stage, skeleton, animation, prim, where)
    ancestors = [] if prim is None else animated_ancestors(prim)
    sample_times = sorted(
        {time for mover in ancestors for time in mover.GetTimeSamples()}
    )
    codes = values.clock.times.tolist()
    ancestor_codes = nearest_samples(sample_times, codes, values.drift)
    rig = skeleton.rig
    placement, notices = _placement_at(prim, rig, ancestor_codes, where, choice)
    motion = _placed_on_stage(values.motion, rig, placement, choice)
    rig = replace(rig, shapes=tuple(Shape(name) for name in values.shapes))
    stream = TakeStream.of(Take(rig, values.clock, motion))
    stream.notices.extend([*values.notices, *notices])
    stream.details = _source_details(stage, skeleton)
    stream.details["animation"] = str(animation.GetPath())
    return stream, placement


def _source_details(stage: Any, skeleton: SkeletonRig) -> dict[str, object]:
    return {
        "format": "USD",
        "layers": len(stage.GetUsedLayers()),
        "units": unit_name(skeleton.rig.meters_per_unit),
    }
