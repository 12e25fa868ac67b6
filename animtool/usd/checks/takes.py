"""Builds takes from the animations of a stage and the samples that checks cached."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
from pxr import UsdGeom, UsdSkel

from animtool.core.array_types import FloatArray
from animtool.core.clock import Clock, time_fraction
from animtool.core.errors import AnimtoolError
from animtool.core.rates import rate_from_float
from animtool.core.record import dataclass
from animtool.maths import so3
from animtool.motion.motion import Channel, Motion
from animtool.motion.reorient import transform_motion
from animtool.motion.take import Take
from animtool.rig.parts import Shape
from animtool.rig.skeleton import Joint, Rig
from animtool.usd.checks.checked_stage import CheckedStage
from animtool.usd.layers.faults import (
    PrimLocation,
    matrix_array,
    token_array,
    transform_attributes,
)
from animtool.usd.rigs.placement import (
    NO_PLACEMENT,
    SkeletonPlacement,
    animated_ancestors,
    rig_at_stage_placement,
    skeleton_placement,
)
from animtool.usd.rigs.prims import (
    SkeletonRig,
    find_skeletons,
    rig_from_tokens,
    skeleton_rig,
    stored_data,
    up_axis,
)
from animtool.usd.takes.animation_values import build_scale_channel, fill_with_rest
from animtool.usd.takes.library import stored_take_range


@dataclass(frozen=True, slots=True)
class AnimationTake:
    """A SkelAnimation with its Skeleton."""

    path: str  # path of the SkelAnimation
    take: Take  # F frames, one per sample
    # Time codes of the samples in the file ``(F,)``; None if it has none.
    codes: FloatArray | None
    # Frame range authored for the take, or for the stage if this take spans it.
    frame_range: tuple[float, float] | None
    has_rest: bool  # whether the Skeleton is on the stage
    # Names of joints that influence points; None if no mesh is skinned.
    influencing_joints: frozenset[str] | None
    # Joint positions of the bind pose, world ``(J, 3)`` [m].
    bind_positions: FloatArray | None
    # framesPerSecond of the stage; None if not authored or invalid.
    frames_per_second: float | None
    is_reduced: bool  # whether redundant samples were removed


@dataclass(frozen=True, slots=True)
class _StageData:
    """Stage data shared by all animations, read once."""

    # First and last sample of each prim, by path.
    spans_by_path: dict[Any, tuple[float, float]]
    # First and last sample of the stage; None if it has none.
    stage_range: tuple[float, float] | None
    # Bindings and their joint indices, by the path of their Skeleton.
    skins_by_skeleton: dict[Any, list[tuple[Any, Any]]]

    @staticmethod
    def from_stage(checked_stage: CheckedStage) -> _StageData:
        """Return the shared data of a stage."""
        spans_by_path: dict[Any, tuple[float, float]] = {}
        for attr in checked_stage.attributes:
            if times := checked_stage.times(attr):
                path = attr.GetPrimPath()
                first_code, last_code = spans_by_path.get(path, (times[0], times[-1]))
                spans_by_path[path] = (
                    min(first_code, times[0]),
                    max(last_code, times[-1]),
                )
        spans_by_end = list(zip(*spans_by_path.values(), strict=True))
        skins_by_skeleton: dict[Any, list[tuple[Any, Any]]] = {}
        for prim in checked_stage.prims:
            binding = UsdSkel.BindingAPI(prim)
            indices = binding.GetJointIndicesPrimvar()
            if not (indices and indices.HasAuthoredValue()):
                continue
            if skeleton := binding.GetInheritedSkeleton():
                skins_by_skeleton.setdefault(skeleton.GetPath(), []).append(
                    (binding, indices)
                )
        stage_range = (
            (min(spans_by_end[0]), max(spans_by_end[1])) if spans_by_end else None
        )
        return _StageData(spans_by_path, stage_range, skins_by_skeleton)


def animation_takes(checked_stage: CheckedStage, path: Path) -> list[AnimationTake]:
    """Return the valid animations of a stage as takes.

    Animations with wrong array lengths or non-finite values are omitted, since the
    checks report them.
    """
    skeletons = list(checked_stage.prims_of_type(UsdSkel.Skeleton))
    # Other checks visit equal instances once; here all of them are searched.
    skeletons_by_animation = _bound_skeletons(find_skeletons(checked_stage.stage))
    stage_data = _StageData.from_stage(checked_stage)
    takes = []
    for animation in checked_stage.prims_of_type(UsdSkel.Animation):
        skeleton = skeletons_by_animation.get(animation.GetPath())
        if skeleton is None:
            # A shared animation is not the motion of a single character.
            if stored_data(animation.GetPrim()).get("shared"):
                continue
            skeleton = _nearest_skeleton(animation, skeletons)
        try:
            take = _animation_take(checked_stage, path, animation, skeleton, stage_data)
        except AnimtoolError:
            continue
        if take is not None:
            takes.append(take)
    return takes


def _bound_skeletons(skeletons: list[Any]) -> dict[Any, Any]:
    """Return the Skeleton that each animation is bound to."""
    skeletons_by_animation: dict[Any, Any] = {}
    for skeleton in skeletons:
        binding = UsdSkel.BindingAPI(skeleton.GetPrim())
        source = binding.GetInheritedAnimationSource()
        if source:
            skeletons_by_animation.setdefault(source.GetPath(), skeleton)
    return skeletons_by_animation


def _nearest_skeleton(animation: Any, skeletons: list[Any]) -> Any:
    """Return the Skeleton with most of an animation's joints; None for half or less."""
    joints = set(token_array(animation.GetJointsAttr()))
    nearest = None
    max_count = len(joints) // 2
    for skeleton in skeletons:
        common_count = len(joints.intersection(token_array(skeleton.GetJointsAttr())))
        if common_count > max_count:
            nearest, max_count = skeleton, common_count
    return nearest


def _animation_take(
    checked_stage: CheckedStage,
    path: Path,
    animation: Any,
    skeleton: Any,
    stage_data: _StageData,
) -> AnimationTake | None:
    joints = token_array(animation.GetJointsAttr())
    shapes = token_array(animation.GetBlendShapesAttr())
    rig_data = _skeleton_rig_of_animation(
        checked_stage, animation, skeleton, joints, path
    )
    placement_attributes = animated_ancestors(skeleton.GetPrim()) if skeleton else []
    components = zip(transform_attributes(animation).values(), (3, 4, 3), strict=True)
    attributes = [(attr, len(joints), width) for attr, width in components]
    attributes.append((animation.GetBlendShapeWeightsAttr(), len(shapes), 1))
    times = {
        t for attr, count, _ in attributes if count for t in checked_stage.times(attr)
    }
    times.update(t for attr in placement_attributes for t in attr.GetTimeSamples())
    custom_data, stage = stored_data(animation.GetPrim()), checked_stage.stage
    codes = np.array(sorted(times), np.float64)
    if custom_data.get("shared"):
        # Its characters have time offsets, so samples may lie outside the frames.
        first_code, last_code = stage.GetStartTimeCode(), stage.GetEndTimeCode()
        codes = np.arange(first_code, last_code + 1)
    attribute_rows = [
        _attribute_rows(checked_stage, *entry, codes) for entry in attributes
    ]
    motion = _motion_arrays(rig_data, joints, shapes, attribute_rows)
    if motion is None:
        return None
    translations, rotations, scales, weights = motion
    motion_channels = Motion(
        Channel.from_dense(translations),
        Channel.from_dense(rotations),
        build_scale_channel(scales),
        None if weights is None else Channel.from_dense(weights),
    )
    placement = NO_PLACEMENT
    if skeleton is not None:
        placement = skeleton_placement(skeleton.GetPrim(), rig_data.rig, codes.tolist())
    if not placement.full_placement.is_identity:
        roots = np.array(rig_data.rig.roots, np.int64)
        motion_channels = transform_motion(
            motion_channels, roots, placement.full_placement
        ).map(Channel.compact)
    rig = replace(rig_data.rig, shapes=tuple(Shape(name) for name in shapes))
    rig = rig_at_stage_placement(rig, placement)
    take = Take(rig, _build_clock(checked_stage, codes), motion_channels)
    rate = float(stage.GetFramesPerSecond())
    return AnimationTake(
        str(animation.GetPath()),
        take,
        codes if len(codes) else None,
        _frame_range(checked_stage, animation, stage_data),
        skeleton is not None,
        _influencing_joints(skeleton, rig_data, stage_data) if skeleton else None,
        _bind_positions(skeleton, rig_data.rig, placement) if skeleton else None,
        rate if stage.HasAuthoredMetadata("framesPerSecond") and rate > 0.0 else None,
        bool(custom_data.get("reduced") or custom_data.get("thinned")),
    )


def _skeleton_rig_of_animation(
    checked_stage: CheckedStage,
    animation: Any,
    skeleton: Any,
    joints: list[str],
    path: Path,
) -> SkeletonRig:
    """Return an animation's rig; without a Skeleton, its first sample is the rest."""
    if skeleton is not None and token_array(skeleton.GetJointsAttr()):
        return skeleton_rig(skeleton, path)
    meters_per_unit = UsdGeom.GetStageMetersPerUnit(checked_stage.stage)
    up = up_axis(checked_stage.stage)
    name = str(animation.GetPrim().GetName())
    if not joints:
        # A face with shapes only has no joint to rotate.
        rig = Rig(name, (Joint(name, -1),), meters_per_unit, up)
        return SkeletonRig(rig, [], np.ones((1, 3)))
    rest = np.tile(np.eye(4), (len(joints), 1, 1))
    array = checked_stage.sampled_array(animation.GetTranslationsAttr())
    sample_indices, values = array.rows(len(joints), 3)
    if len(sample_indices):
        rest[:, 3, :3] = values[0]
    location = PrimLocation.from_prim(path, animation)
    return rig_from_tokens(joints, rest, name, location, meters_per_unit, up, {})


def _attribute_rows(
    checked_stage: CheckedStage, attr: Any, count: int, width: int, codes: FloatArray
) -> FloatArray | None:
    """Return attribute values at time codes ``(F, count, width)``; None if invalid."""
    if not count or not attr:
        return None
    array = checked_stage.sampled_array(attr)
    sample_indices, samples = array.rows(count, width)
    if not len(sample_indices) or len(sample_indices) != len(array.times):
        return None
    values = np.asarray(samples, np.float64)
    if not np.isfinite(values).all():
        return None
    frame_count = max(len(codes), 1)
    if not array.is_animated or len(values) == 1:
        return np.repeat(values[:1], frame_count, axis=0)
    if np.array_equal(array.times, codes):
        return values
    next_index = np.searchsorted(array.times, codes).clip(1, len(values) - 1)
    time_before, time_after = array.times[next_index - 1], array.times[next_index]
    fraction = ((codes - time_before) / (time_after - time_before)).clip(0.0, 1.0)[
        :, None, None
    ]
    if width == 4:
        values = so3.align_signs(values)
    return np.asarray(
        values[next_index - 1] * (1.0 - fraction) + values[next_index] * fraction
    )


def _motion_arrays(
    rig_data: SkeletonRig,
    joints: list[str],
    shapes: list[str],
    attribute_rows: Sequence[FloatArray | None],
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray | None] | None:
    """Return translations, rotations, scales and weights; None if invalid."""
    rig = rig_data.rig
    weights = attribute_rows[3]
    if (joints and any(row is None for row in attribute_rows[:3])) or (
        not joints and weights is None
    ):
        return None
    frame_count = next(len(row) for row in attribute_rows if row is not None)
    if shapes and weights is None:
        weights = np.zeros((frame_count, len(shapes), 1))
    rests = (
        rig.rest_translations / rig.meters_per_unit,
        rig.rest_rotations,
        rig_data.rest_scales,
    )
    index_by_token = {token: i for i, token in enumerate(rig_data.tokens)}
    joint_indices = np.array(
        [index_by_token.get(token, -1) for token in joints], np.int64
    )
    translations, rotations, scales = (
        fill_with_rest(rest, row, joint_indices, frame_count)
        for rest, row in zip(rests, attribute_rows[:3], strict=True)
    )
    if not (np.linalg.norm(rotations, axis=2) > 0.0).all():
        return None
    translations *= rig.meters_per_unit
    return translations, so3.align_signs(so3.normalize(rotations)), scales, weights


def _build_clock(checked_stage: CheckedStage, codes: FloatArray) -> Clock:
    fps = rate_from_float(checked_stage.stage.GetTimeCodesPerSecond())
    start = time_fraction(float(codes[0])) if len(codes) else Fraction(1)
    step = time_fraction(float(np.median(np.diff(codes)))) if len(codes) > 1 else 1
    return Clock(fps, start, Fraction(step) or Fraction(1), max(len(codes), 1))


def _frame_range(
    checked_stage: CheckedStage, animation: Any, stage_data: _StageData
) -> tuple[float, float] | None:
    """Return the frame range of an animation, or of its stage.

    The stage's range does not apply if other prims have samples over a longer time.
    """
    authored_range = stored_take_range(animation)
    if authored_range is not None:
        return float(authored_range[0]), float(authored_range[1])
    stage = checked_stage.stage
    if not (
        stage.HasAuthoredMetadata("startTimeCode")
        and stage.HasAuthoredMetadata("endTimeCode")
    ):
        return None
    span = stage_data.spans_by_path.get(animation.GetPath())
    if span is None or span != stage_data.stage_range:
        return None
    return float(stage.GetStartTimeCode()), float(stage.GetEndTimeCode())


def _influencing_joints(
    skeleton: Any, skeleton_rig: SkeletonRig, stage_data: _StageData
) -> frozenset[str] | None:
    """Return the joints that influence points, and their ancestors."""
    used_joints: set[int] = set()
    skins_by_skeleton = stage_data.skins_by_skeleton.get(skeleton.GetPath())
    if not skins_by_skeleton:
        return None
    index_by_token = {token: i for i, token in enumerate(skeleton_rig.tokens)}
    for binding, indices in skins_by_skeleton:
        binding_joints = token_array(binding.GetJointsAttr()) or skeleton_rig.tokens
        used_joints |= {
            index_by_token[binding_joints[i]]
            for i in _weighted_joints(binding, indices, len(binding_joints))
            if binding_joints[i] in index_by_token
        }
    for joint in sorted(used_joints):
        parent = skeleton_rig.rig.joints[joint].parent
        while parent >= 0 and parent not in used_joints:
            used_joints.add(parent)
            parent = skeleton_rig.rig.joints[parent].parent
    return frozenset(skeleton_rig.rig.joints[i].name for i in used_joints)


def _weighted_joints(binding: Any, indices: Any, joint_count: int) -> Iterator[int]:
    """Yield the indices of the joints with a nonzero weight."""
    joint_indices = np.array(indices.Get() or (), np.int64)
    weights = np.array(binding.GetJointWeightsPrimvar().Get() or (), np.float64)
    if len(weights) == len(joint_indices):
        joint_indices = joint_indices[weights > 0.0]
    yield from np.unique(
        joint_indices[(joint_indices >= 0) & (joint_indices < joint_count)]
    ).tolist()


def _bind_positions(
    skeleton: Any, rig: Rig, placement: SkeletonPlacement
) -> FloatArray | None:
    """Return the world joint positions of the bind pose; None if invalid."""
    matrices = matrix_array(skeleton.GetBindTransformsAttr())
    if len(matrices) != len(rig.joints) or not np.isfinite(matrices).all():
        return None
    # Identity matrices are reported by another check.
    if (matrices == np.eye(4)).all():
        return None
    return placement.rest_placement.transform_points(
        matrices[:, 3, :3] * rig.meters_per_unit
    )
