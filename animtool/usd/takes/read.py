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
from animtool.motion.reorient import (
    placement_notice,
    remove_placement,
    transform_motion,
)
from animtool.motion.take import Take, TakeStream
from animtool.rig.parts import AttachKind, Shape
from animtool.rig.placement import Placement
from animtool.rig.skeleton import Rig
from animtool.usd.layers.dependencies import unresolved_hint
from animtool.usd.layers.faults import PrimLocation
from animtool.usd.layers.sdf import usd_errors
from animtool.usd.layers.stderr import without_usd_warnings
from animtool.usd.rigs.mesh_read import bound_shapes
from animtool.usd.rigs.placement import (
    DROP_PLACEMENT,
    NO_PLACEMENT,
    SkeletonPlacement,
    animated_ancestors,
    refuse_unsupported,
    rig_at_stage_placement,
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
    sample_times,
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
    skinned_mesh_names,
    unapplied_binding_path,
)
from animtool.usd.takes.animation import (
    find_first_animation,
    read_animation,
    rig_from_animation,
    root_motion_notice,
)
from animtool.usd.takes.animation_values import build_scale_channel, nearest_samples
from animtool.usd.takes.library import TakeSet, find_take_set, select_take


def read_usd(
    path: Path | str,
    *,
    prim_path: str | None = None,
    take: str | None = None,
    placement: str | None = None,
) -> TakeStream:
    """Read the animation of a character on a stage, or an animation layer without rig.

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
        stage = open_stage(path)
        root_path = search_root(stage, prim_path)
        take_set = _take_set(stage, root_path)
        if take is not None:
            take_set = select_take(take_set, take, str(path))
        stream = read_character(stage, path, root_path, placement)
        if take_set is not None:
            stream.details["takes"] = list(take_set.names)
            stream.details["take"] = take_set.selected_name
        return stream


def _take_set(stage: Any, root_path: str) -> TakeSet | None:
    """Return the take set of the first character; None if it has none."""
    skeletons = find_skeletons(stage, root_path)
    if skeletons:
        return find_take_set(skeletons[0].GetPrim())
    # An animation layer without its rig has only overs.
    root_prim = stage.GetPrimAtPath(root_path)
    prims = Usd.PrimRange(root_prim, Usd.PrimAllPrimsPredicate) if root_prim else ()
    return next((take_set for prim in prims if (take_set := find_take_set(prim))), None)


def read_characters(path: Path) -> dict[str, Callable[[], TakeStream]]:
    """Return functions that read the take of each Skeleton, by Skeleton path.

    Empty for a layer without its rig.
    """
    with usd_errors(path), without_usd_warnings():
        stage = open_stage(path)

        def reader(skeleton_path: str) -> Callable[[], TakeStream]:
            def read() -> TakeStream:
                with usd_errors(path), without_usd_warnings():
                    return read_character(stage, path, skeleton_path)

            return read

        paths = [str(skeleton.GetPath()) for skeleton in find_skeletons(stage)]
        return {skeleton_path: reader(skeleton_path) for skeleton_path in paths}


def read_character(
    stage: Any, path: Path, root_path: str, placement_choice: str | None = None
) -> TakeStream:
    """Read the first character below a prim, or the animation of a layer without rig.

    ``placement_choice`` is its placement, as in `read_usd`.
    """
    skeletons = find_skeletons(stage, root_path)
    if skeletons:
        skeleton = skeleton_rig(skeletons[0], path)
        animation = _bound_animation(skeletons[0])
        skeleton_prim = skeletons[0].GetPrim()
    else:
        animation = find_first_animation(stage, root_path)
        if animation is None:
            message = f"has no Skeleton and no SkelAnimation below {root_path}"
            characters = character_paths(stage)
            hint = "a character is needed; props go under props of a scene"
            if characters:
                names = listed(characters, MAX_LISTED_PRIMS)
                hint = f"choose one of {names} with {argument('source.prim_path')}"
            hint = unresolved_hint(stage) or hint
            raise FormatError(Fault("USD008", message, str(path), (), hint))
        skeleton = rig_from_animation(animation, path, stage)
        skeleton_prim = None
    if animation is None:
        stream, placement = _rest_take(
            skeleton, stage, path, skeleton_prim, placement_choice
        )
    else:
        stream, placement = _animated_take(
            stage, path, skeleton, animation, skeleton_prim, placement_choice
        )
    stream.notices += skeleton.notices
    animation_prim = None if animation is None else animation.GetPrim()
    if skeleton_prim is None:
        stream.notices += root_motion_notice(
            animation, PrimLocation.from_prim(path, animation)
        )
    else:
        stream.unread_meshes = _mesh_reader(stage, skeletons[0], path)
        _merge_stored_rig(stream, skeletons[0], skeleton, path)
        if animation is not None and not UsdSkel.Root.Find(skeleton_prim):
            stream.notices.append(_missing_root_notice(skeleton_prim, animation, path))
    location = PrimLocation.from_prim(path, skeleton_prim or animation_prim)
    stream.rig = apply_recorded_rest(
        stream.rig, skeleton_prim, animation_prim, location
    )
    if placement_choice == DROP_PLACEMENT:
        stream = _without_placement(stream, placement, skeleton_prim, str(path))
    else:
        stream.rig = rig_at_stage_placement(stream.rig, placement)
    stream.notices += skipped_skeletons_notice(skeletons, str(path))
    stream.notices += composition_notices(stage, str(path))
    return stream


def _mesh_reader(
    stage: Any, skeleton: Any, path: Path
) -> Callable[[], tuple[str, ...]]:
    """Return a function that names the skinned meshes, which few readers need."""
    skeleton_path = skeleton.GetPath()

    def mesh_names() -> tuple[str, ...]:
        # The reference to the stage keeps its prims alive.
        with usd_errors(path), without_usd_warnings():
            prim = stage.GetPrimAtPath(skeleton_path)
            return skinned_mesh_names(UsdSkel.Skeleton(prim))

    return mesh_names


def _find_placement(
    prim: Any,
    rig: Rig,
    codes: list[float] | None,
    location: PrimLocation,
    placement_choice: str | None,
) -> tuple[SkeletonPlacement, list[Fault]]:
    """Return the placement of a Skeleton at time codes, and notices about it."""
    if prim is None:
        return NO_PLACEMENT, []
    placement = skeleton_placement(prim, rig, codes)
    if placement_choice != DROP_PLACEMENT:
        refuse_unsupported(placement, location)
    notices = unsupported_notice(placement, location)
    notices += unit_mismatch_notice(placement, location.path or "")
    return (NO_PLACEMENT if placement.unsupported_reason else placement), notices


def _apply_placement(
    motion: Motion, rig: Rig, placement: SkeletonPlacement, placement_choice: str | None
) -> Motion:
    """Apply the stage placement of a rig to its motion."""
    applied_placement = (
        placement.motion
        if placement_choice == DROP_PLACEMENT
        else placement.full_placement
    )
    if applied_placement.is_identity:
        return motion
    roots = np.array(rig.roots, np.int64)
    return transform_motion(motion, roots, applied_placement).map(Channel.compact)


def _without_placement(
    stream: TakeStream, placement: SkeletonPlacement, prim: Any, path: str
) -> TakeStream:
    """Return a take without its stage placement; the take can still evaluate it.

    Joints still include the placement that the file's customData records.
    """
    local_rig = stream.rig
    placed_rig = rig_at_stage_placement(local_rig, placement)
    source_rig = replace(placed_rig, has_animated_parents=placement.is_animated)
    stream.notices += placement_notice(
        source_rig, path, is_kept=False, is_in_joints=local_rig.has_animated_parents
    )
    stream.rig = rig_at_stage_placement(local_rig, placement, DROP_PLACEMENT)
    heading_placement = stream.rig.placement
    stream = remove_placement(stream)
    stream.rig = replace(stream.rig, has_animated_parents=False)
    if source_rig.placement is not None or source_rig.has_animated_parents:
        stream.dropped = _dropped_placement_reader(
            placement, heading_placement, prim, local_rig
        )
    return stream


def _dropped_placement_reader(
    placement: SkeletonPlacement,
    recorded_placement: Placement | None,
    prim: Any,
    rig: Rig,
) -> Callable[[FloatArray], Placement]:
    """Return a function that evaluates the dropped placement at stage time codes."""
    stage: Any = None if prim is None else prim.GetStage()

    def placement_at(codes: FloatArray) -> Placement:
        current_placement = placement
        if placement.is_animated:
            # This reference keeps the stage and its prims alive as long as the
            # function.
            skeleton = stage.GetPrimAtPath(prim.GetPath())
            current_placement = skeleton_placement(skeleton, rig, codes.tolist())
        heading_placement, _ = current_placement.fixed_placement.split(rig.up)
        if recorded_placement is None:
            return heading_placement
        return heading_placement.after(recorded_placement)

    return placement_at


def _merge_stored_rig(
    stream: TakeStream, skeleton: Any, rig: SkeletonRig, path: Path
) -> None:
    """Merge the rig stored in a Skeleton's customData into a take."""
    if not stored_data(skeleton.GetPrim()).get("rig"):
        return
    from animtool.usd.rigs.stored import merge_rig

    merged_rig, notices = merge_rig(stream.rig, skeleton, rig.tokens, path)
    names = [shape.name for shape in merged_rig.shapes]
    shape_indices = np.array([names.index(s.name) for s in stream.rig.shapes], np.int64)
    stream.blocks = _remap_weights(stream.blocks, shape_indices, len(names))
    # A take has no meshes or curves, and so neither cloth nor strands.
    array_kinds = {AttachKind.CLOTH, AttachKind.STRANDS}
    attach = tuple(
        entry for entry in merged_rig.attach if entry.kind not in array_kinds
    )
    stream.rig = replace(merged_rig, meshes=(), attach=attach)
    stream.notices += notices


def _remap_weights(
    blocks: Iterator[Motion], shape_indices: IntArray, shape_count: int
) -> Iterator[Motion]:
    """Yield blocks whose shape weights are moved to given columns; the others are 0."""
    for block in blocks:
        channel = block.weights
        if channel is None:
            yield block
            continue
        rest = np.zeros((shape_count, 1))
        rest[shape_indices] = channel.rest
        animated_shapes = shape_indices[channel.animated]
        order = np.argsort(animated_shapes)
        weights = Channel(rest, animated_shapes[order], channel.values[:, order])
        yield replace(block, weights=weights)


def _bound_animation(skeleton: Any) -> Any:
    if source := animation_source(skeleton):
        return UsdSkel.Animation(source)
    # Also return an animation that UsdSkel cannot use, since reading it reports why.
    source = UsdSkel.BindingAPI(skeleton.GetPrim()).GetInheritedAnimationSource()
    return UsdSkel.Animation(source) if source and source.IsActive() else None


def _missing_root_notice(prim: Any, animation: Any, path: Path) -> Fault:
    """Return a warning that USD ignores the animation of a Skeleton."""
    message = f"{prim.GetPath()} is not in a SkelRoot, so USD viewers ignore its "
    message += f"animation {animation.GetPath()}; it is read anyway"
    hint = "make a prim above the Skeleton a SkelRoot"
    return Fault("USD237", message, str(path), (), hint, Severity.WARNING)


def _rest_take(
    skeleton: SkeletonRig,
    stage: Any,
    path: Path,
    prim: Any,
    placement_choice: str | None,
) -> tuple[TakeStream, SkeletonPlacement]:
    """Return a one-frame take at rest, and the placement of its Skeleton."""
    shapes = () if skeleton.tokens else bound_shapes(UsdSkel.Skeleton(prim))
    rig = skeleton.rig
    check_animatable(len(rig.joints), len(shapes), PrimLocation.from_prim(path, prim))
    rig = replace(rig, shapes=tuple(Shape(name) for name in shapes))
    motion = Motion(
        Channel.from_dense(rig.rest_translations[None]),
        Channel.from_dense(rig.rest_rotations[None]),
        build_scale_channel(skeleton.rest_scales[None]),
        Channel.from_dense(np.zeros((1, len(shapes), 1))) if shapes else None,
    )
    placement, notices = _find_placement(
        prim, rig, None, PrimLocation.from_prim(path, prim), placement_choice
    )
    motion = _apply_placement(motion, rig, placement, placement_choice)
    fps = rate_from_float(stage.GetTimeCodesPerSecond())
    start = time_fraction(stage.GetStartTimeCode())
    stream = TakeStream.of(Take(rig, Clock(fps, start, Fraction(1), 1), motion))
    stream.details = _source_details(stage, skeleton)
    stream.details["animation"] = None
    if not stage.HasAuthoredMetadata("startTimeCode"):
        stream.start = None
    message = "no animation is bound to the skeleton; it is read at rest"
    hint = None
    if ignored_path := unapplied_binding_path(prim):
        message += (
            f": {ignored_path} binds one, but SkelBindingAPI is not applied to it"
        )
        hint = BINDING_HINT
    elif missing_reason := missing_animation_reason(prim):
        message = f"its animation {missing_reason}; the skeleton is read at rest"
        hint = "activate it, or correct the targets of skel:animationSource"
    severity = Severity.WARNING
    stream.notices.append(Fault("USD103", message, str(path), (), hint, severity))
    stream.notices += notices
    return stream, placement


def _animated_take(
    stage: Any,
    path: Path,
    skeleton: SkeletonRig,
    animation: Any,
    prim: Any,
    placement_choice: str | None,
) -> tuple[TakeStream, SkeletonPlacement]:
    """Return the take of an animation, and the placement of its Skeleton."""
    location = PrimLocation.from_prim(path, animation)
    animation_motion = read_animation(stage, skeleton, animation, prim, location)
    ancestors = [] if prim is None else animated_ancestors(prim)
    codes = animation_motion.clock.times.tolist()
    ancestor_codes = nearest_samples(
        sample_times(ancestors), codes, animation_motion.max_time_offset
    )
    rig = skeleton.rig
    placement, notices = _find_placement(
        prim, rig, ancestor_codes, location, placement_choice
    )
    motion = _apply_placement(animation_motion.motion, rig, placement, placement_choice)
    rig = replace(rig, shapes=tuple(Shape(name) for name in animation_motion.shapes))
    stream = TakeStream.of(Take(rig, animation_motion.clock, motion))
    stream.notices.extend([*animation_motion.notices, *notices])
    stream.details = _source_details(stage, skeleton)
    stream.details["animation"] = str(animation.GetPath())
    return stream, placement


def _source_details(stage: Any, skeleton: SkeletonRig) -> dict[str, object]:
    return {
        "format": "USD",
        "layers": len(stage.GetUsedLayers()),
        "units": unit_name(skeleton.rig.meters_per_unit),
    }
