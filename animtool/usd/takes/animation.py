"""Reads a SkelAnimation as motion of its joints, with or without a Skeleton."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from pxr import Usd, UsdGeom, UsdSkel

from animtool.core.array_types import FloatArray, IntArray
from animtool.core.clock import Clock
from animtool.core.errors import Fault, Severity, counted
from animtool.core.quantities import duration_text
from animtool.core.rates import rate_from_float
from animtool.core.record import dataclass
from animtool.maths import so3
from animtool.motion.motion import Channel, Motion
from animtool.usd.layers.faults import (
    PrimLocation,
    duplicate_name_faults,
    missing_transform_faults,
    token_array,
    transform_attributes,
    unknown_joint_faults,
)
from animtool.usd.rigs.placement import (
    animated_ancestors,
    has_animated_rotation_or_scale,
)
from animtool.usd.rigs.prims import (
    SkeletonRig,
    check_animatable,
    number_rows,
    rig_from_tokens,
    sample_times,
    stored_data,
    up_axis,
)
from animtool.usd.takes.animation_values import (
    SampleGrid,
    animated_shapes,
    build_scale_channel,
    fill_with_rest,
    find_sample_grid,
    normalize_rotations,
    read_samples,
    read_shape_weights,
    refine_to_frames,
)

# A take of so many frames whose stage plays several of them in a time code is slow by
# mistake: time codes of seconds have samples between them.
MIN_FRAMES, MIN_RATE_RATIO = 12, 4


@dataclass(frozen=True, slots=True)
class AnimationMotion:
    """Motion of an animation, before the stage placement of its Skeleton."""

    clock: Clock
    motion: Motion  # motion of all joints of the Skeleton
    shapes: list[str]  # names of the animated shapes
    max_time_offset: float  # largest distance of samples from their frames [time code]
    notices: list[Fault]


def read_animation(
    stage: Any, skeleton: SkeletonRig, animation: Any, prim: Any, location: PrimLocation
) -> AnimationMotion:
    """Return the motion of a Skeleton's joints and shapes from an animation.

    ``prim`` is the Skeleton; None for an animation layer without its rig.
    """
    joint_indices, notices = _match_joints(skeleton, animation, prim, location)
    attributes = _require_attributes(animation, joint_indices, location, notices)
    shapes = animated_shapes(animation)
    check_animatable(len(skeleton.rig.joints), len(shapes), location)
    sampled_objects = [
        *attributes.values(),
        *([] if prim is None else animated_ancestors(prim)),
    ]
    sampled_objects += [animation.GetBlendShapeWeightsAttr()] if shapes else []
    times = sample_times(sampled_objects)
    grid = find_sample_grid(stage, animation, times, location)
    if prim is not None and has_animated_rotation_or_scale(prim):
        grid = refine_to_frames(grid, stage, location)
    fps = rate_from_float(stage.GetTimeCodesPerSecond())
    clock = Clock(fps, grid.start, grid.step, grid.count)
    codes = clock.times.tolist()
    notices += _grid_notices(grid, len(times), location)
    notices += _rate_notices(stage, clock, location)
    rig = skeleton.rig
    meters_per_unit = rig.meters_per_unit

    def joint_values(name: str, rest: FloatArray) -> FloatArray:
        """Return an attribute of all joints; joints without values are at rest."""
        attr, width, values = attributes.get(name), rest.shape[1], None
        if attr is not None:
            values = read_samples(
                attr,
                codes,
                len(joint_indices),
                width,
                location,
                time_tolerance=grid.max_time_offset,
            )
        return fill_with_rest(rest, values, joint_indices, len(codes))

    translations = (
        joint_values("translations", rig.rest_translations / meters_per_unit)
        * meters_per_unit
    )
    rotations = joint_values("rotations", rig.rest_rotations)
    scales = joint_values("scales", skeleton.rest_scales)
    rotations, length_warnings = normalize_rotations(
        rotations, rig.names, codes, location
    )
    notices += length_warnings
    weights = None
    if shapes:
        weights = read_shape_weights(
            animation, codes, len(shapes), location, grid.max_time_offset
        )
    motion = Motion(
        Channel.from_dense(translations),
        Channel.from_dense(so3.align_signs(rotations)),
        build_scale_channel(scales),
        weights,
    )
    return AnimationMotion(clock, motion, shapes, grid.max_time_offset, notices)


def _require_attributes(
    animation: Any,
    joint_indices: IntArray,
    location: PrimLocation,
    notices: list[Fault],
) -> dict[str, Any]:
    """Return the joint attributes of an animation by name; refuse missing ones.

    Empty if it animates no joints: it has only shape weights, or lists joints that stay
    at rest.
    """
    if not len(joint_indices):
        return {}
    faults = list(
        missing_transform_faults(animation, token_array(animation.GetJointsAttr()))
    )
    if any(fault.severity is Severity.ERROR for fault in faults):
        location.raise_errors(faults)
    notices += [replace(fault, path=location.path) for fault in faults]
    if faults:
        return {}
    return transform_attributes(animation)


def _match_joints(
    skeleton: SkeletonRig, animation: Any, prim: Any, location: PrimLocation
) -> tuple[IntArray, list[Fault]]:
    """Return the Skeleton joint of each animation joint (-1 for none), and warnings."""
    attr = animation.GetJointsAttr()
    index_by_token = {token: i for i, token in enumerate(skeleton.tokens)}
    joint_indices = np.array(
        [index_by_token.get(token, -1) for token in token_array(attr)], np.int64
    )
    if prim is None:
        return joint_indices, []
    unknown_joints = unknown_joint_faults(attr, skeleton.tokens, prim.GetPath())
    return joint_indices, [
        replace(fault, path=location.path) for fault in unknown_joints
    ]


def _rate_notices(stage: Any, clock: Clock, location: PrimLocation) -> list[Fault]:
    """Return a warning if time codes look like frames but count seconds (TAKE009)."""
    displayed_rate = float(stage.GetFramesPerSecond())
    if not stage.HasAuthoredMetadata("framesPerSecond") or clock.count < MIN_FRAMES:
        return []
    if clock.step < 1 or not displayed_rate >= MIN_RATE_RATIO * clock.fps:
        return []
    duration = float((clock.count - 1) * clock.step / clock.fps)
    message = (
        f"timeCodesPerSecond is {float(clock.fps):g}, so {clock.count} frames last "
        f"{duration_text(duration)}; framesPerSecond is {displayed_rate:g}"
    )
    hint = f"if its time codes are frames, set timeCodesPerSecond = {displayed_rate:g}"
    return [Fault("TAKE009", message, location.path, (), hint, Severity.WARNING)]


def _grid_notices(
    grid: SampleGrid, sample_count: int, location: PrimLocation
) -> list[Fault]:
    """Return notices about samples that are irregular or not on frames."""
    notices = []
    interval = "time code" if grid.step == 1 else f"{float(grid.step):g} time codes"
    if not grid.is_regular:
        message = f"samples are unevenly spaced; read every {interval}"
        notices.append(location.fault("USD105", message, severity=Severity.NOTE))
    if grid.max_time_offset:
        message = (
            f"samples are up to {grid.max_time_offset:.2g} time codes off the frames "
            f"(at {grid.offset_code:.10g}); read as {counted(grid.count, 'frame')}, "
            f"one every {interval}"
        )
        notices.append(location.fault("USD121", message, severity=Severity.NOTE))
    if grid.between_count:
        message = (
            f"{grid.between_count} of {sample_count} samples fall between frames; "
            "only the values on frames are read"
        )
        hint = "resample the animation to whole frames in the tool that wrote it"
        warning = Severity.WARNING
        notices.append(location.fault("USD122", message, hint, warning))
    return notices


def find_first_animation(stage: Any, root_path: str) -> Any:
    """Return the first animation that a layer binds or contains, or None."""
    root_prim = stage.GetPrimAtPath(root_path)
    # An animation layer alone has only overs above its animation.
    predicate = Usd.PrimAllPrimsPredicate
    prims = list(Usd.PrimRange(root_prim, predicate)) if root_prim else []
    bindings = [
        stage.GetPrimAtPath(target)
        for prim in prims
        if (binding := prim.GetRelationship("skel:animationSource"))
        for target in binding.GetTargets()
    ]
    for prim in (*bindings, *prims):
        if prim and prim.IsA(UsdSkel.Animation):
            return UsdSkel.Animation(prim)
    return None


def root_motion_notice(animation: Any, location: PrimLocation) -> list[Fault]:
    """Return a warning if a layer that is read without its rig has root motion."""
    parent = animation.GetPrim().GetParent()
    order = parent.GetAttribute("xformOpOrder")
    if not order or not order.HasAuthoredValue():
        return []
    message = f"{parent.GetPath()} carries root motion, which is ignored"
    hint = "read a stage that contains the rig too"
    return [location.fault("USD113", message, hint, Severity.WARNING)]


def rig_from_animation(animation: Any, path: Path, stage: Any) -> SkeletonRig:
    """Return a rig for an animation without Skeleton; its first sample is the rest."""
    joints = token_array(animation.GetJointsAttr())
    location = PrimLocation.from_prim(path, animation)
    location.raise_errors(duplicate_name_faults(animation.GetJointsAttr()))
    custom_data = stored_data(animation.GetPrim())
    matrices = np.tile(np.eye(4), (len(joints), 1, 1))
    first_code = Usd.TimeCode.EarliestTime()
    positions = number_rows(animation.GetTranslationsAttr(), 3, first_code)
    if joints and len(positions) == len(joints):
        matrices[:, 3, :3] = positions
    rig = rig_from_tokens(
        joints,
        matrices,
        path.stem,
        location,
        UsdGeom.GetStageMetersPerUnit(stage),
        up_axis(stage),
        {"names": custom_data["names"]} if "names" in custom_data else {},
    )
    return replace(rig, rig=replace(rig.rig, has_rest=False))
