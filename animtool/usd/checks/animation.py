"""Checks on SkelAnimation prims and on targets of skel relationships."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from pxr import UsdSkel

from animtool.core.array_types import BoolArray
from animtool.core.errors import Fault, counted, excerpt, listed
from animtool.core.rules import finding
from animtool.usd.checks.checked_stage import (
    AnyArray,
    CheckedStage,
    SampledArray,
    samples_text,
)
from animtool.usd.layers.faults import (
    UNIT_TOLERANCE,
    duplicate_name_faults,
    missing_transform_faults,
    token_array,
    transform_attributes,
    unknown_joint_faults,
)
from animtool.usd.rigs.skinned import is_rig_mesh

# Schema of a relationship's targets, and its name in messages.
_TARGET_SCHEMAS = {
    "skel:animationSource": (UsdSkel.Animation, "SkelAnimation"),
    "skel:skeleton": (UsdSkel.Skeleton, "Skeleton"),
    "skel:blendShapeTargets": (UsdSkel.BlendShape, "BlendShape"),
}


def check_bindings(checked_stage: CheckedStage) -> Iterator[Fault]:
    """Check that skel bindings target prims of the right type.

    In a layer over another file's rig, missing targets may be in that file.
    """
    for prim in checked_stage.prims:
        for name, (schema, schema_name) in _TARGET_SCHEMAS.items():
            relationship = prim.GetRelationship(name)
            if not relationship:
                continue
            for target in relationship.GetTargets():
                target_prim = checked_stage.stage.GetPrimAtPath(target)
                if not target_prim and checked_stage.has_only_overs:
                    continue
                if (
                    target_prim
                    and not target_prim.GetTypeName()
                    and not target_prim.IsDefined()
                ):
                    continue
                yield from _check_target(
                    relationship, target, target_prim, schema, schema_name
                )


def _check_target(
    relationship: Any, target: Any, prim: Any, schema: Any, schema_name: str
) -> Iterator[Fault]:
    if not prim:
        message = f"{target} does not exist"
        yield finding("USD208", relationship.GetPath(), message)
    elif not prim.IsA(schema):
        type_name = prim.GetTypeName() or "prim without a type"
        message = f"{target} is a {type_name}, not a {schema_name}"
        yield finding("USD208", relationship.GetPath(), message)


# Consecutive quaternions are treated as the same rotation if |cos| of half the angle
# between them is above this.
MIN_SAME_ROTATION_COSINE = 0.7


def check_animations(checked_stage: CheckedStage) -> Iterator[Fault]:
    """Check array lengths, values and rotations of every SkelAnimation sample."""
    for animation in checked_stage.prims_of_type(UsdSkel.Animation):
        joints = token_array(animation.GetJointsAttr())
        yield from duplicate_name_faults(animation.GetJointsAttr())
        if joints:
            yield from _check_transforms(checked_stage, animation, joints)
        shapes = token_array(animation.GetBlendShapesAttr())
        yield from duplicate_name_faults(animation.GetBlendShapesAttr())
        yield from _check_weights(
            checked_stage, animation.GetBlendShapeWeightsAttr(), shapes
        )


def _check_transforms(
    checked_stage: CheckedStage, animation: Any, joints: list[str]
) -> Iterator[Fault]:
    faults = list(missing_transform_faults(animation, joints))
    yield from faults
    if any(fault.code == "USD150" for fault in faults):
        return
    for name, attr in transform_attributes(animation).items():
        if not attr.HasAuthoredValue():
            continue
        width = 4 if name == "rotations" else 3
        array = checked_stage.sampled_array(attr)
        yield from _check_counts("USD200", attr, array, len(joints), "joints")
        sample_indices, values = array.rows(len(joints), width)
        is_non_finite = np.asarray(~np.isfinite(values).all(axis=-1))
        if len(sample_indices) == len(array.counts) and not is_non_finite.any():
            checked_stage.finite_paths.add(attr.GetPath())
        if is_non_finite.any():
            yield _non_finite_fault(attr, array, sample_indices, is_non_finite, joints)
        elif name == "rotations" and len(values):
            yield from _check_rotations(attr, array, sample_indices, values, joints)


def _check_counts(
    code: str, attr: Any, array: SampledArray, expected_count: int, noun: str
) -> Iterator[Fault]:
    is_wrong_count = array.counts != expected_count
    if is_wrong_count.any():
        count = array.counts[np.flatnonzero(is_wrong_count)[0]]
        count_text = "no value" if count < 0 else counted(count, "value")
        samples = samples_text(array, is_wrong_count)
        message = f"{count_text} for {expected_count} {noun} {samples}"
        yield finding(code, attr.GetPath(), message)


def _non_finite_fault(
    attr: Any,
    array: SampledArray,
    sample_indices: Any,
    is_non_finite: BoolArray,
    names: list[str],
) -> Fault:
    is_bad_sample = is_non_finite.any(axis=1)
    first_element = int(
        np.flatnonzero(is_non_finite[np.flatnonzero(is_bad_sample)[0]])[0]
    )
    samples = samples_text(array, sample_indices[is_bad_sample])
    message = f"{excerpt(names[first_element])} is not finite {samples}"
    return finding("USD202", attr.GetPath(), message)


def _check_weights(
    checked_stage: CheckedStage, attr: Any, shapes: list[str]
) -> Iterator[Fault]:
    array = checked_stage.sampled_array(attr)
    yield from _check_counts("USD206", attr, array, len(shapes), "blendShapes")
    sample_indices, values = array.rows(len(shapes), 1)
    is_not_finite = ~np.isfinite(values[..., 0])
    if is_not_finite.any():
        yield _non_finite_fault(attr, array, sample_indices, is_not_finite, shapes)


def _check_rotations(
    attr: Any,
    array: SampledArray,
    sample_indices: Any,
    values: AnyArray,
    joints: list[str],
) -> Iterator[Fault]:
    squared_lengths = np.einsum("fjc,fjc->fj", values, values)
    is_not_unit = np.abs(squared_lengths - 1.0) > 2 * UNIT_TOLERANCE
    if is_not_unit.any():
        row, joint = (int(i[0]) for i in np.nonzero(is_not_unit))
        message = (
            f"{excerpt(joints[joint])} has length "
            f"{squared_lengths[row, joint] ** 0.5:.6g} "
            f"{samples_text(array, sample_indices[is_not_unit.any(axis=1)])}"
        )
        yield finding("USD203", attr.GetPath(), message)
        return
    cosines = np.einsum("fjc,fjc->fj", values[1:], values[:-1])
    is_flipped = cosines < -MIN_SAME_ROTATION_COSINE
    if is_flipped.any():
        names = [joints[j] for j in np.flatnonzero(is_flipped.any(axis=0))]
        flipped_samples = sample_indices[1:][is_flipped.any(axis=1)]
        message = (
            f"signs of {listed(names)} change {samples_text(array, flipped_samples)}"
        )
        yield finding("USD204", attr.GetPath(), message)


def check_known_joints(checked_stage: CheckedStage) -> Iterator[Fault]:
    """Check that joints and shapes of animations exist in Skeletons and meshes."""
    shapes_by_animation: dict[Any, set[str]] = {}
    animations: dict[Any, Any] = {}
    for prim in checked_stage.prims:
        binding = UsdSkel.BindingAPI(prim)
        mesh_shapes = token_array(binding.GetBlendShapesAttr())
        is_skeleton = prim.IsA(UsdSkel.Skeleton)
        if not (mesh_shapes or is_skeleton):
            continue
        animation = binding.GetInheritedAnimationSource()
        if not animation and mesh_shapes:
            inherited_skeleton = binding.GetInheritedSkeleton()
            animation = (
                inherited_skeleton
                and UsdSkel.BindingAPI(
                    inherited_skeleton.GetPrim()
                ).GetInheritedAnimationSource()
            )
        if not animation or not animation.IsA(UsdSkel.Animation):
            continue
        animations[animation.GetPath()] = animation
        shapes_by_animation.setdefault(animation.GetPath(), set()).update(mesh_shapes)
        if is_skeleton:
            joints = token_array(UsdSkel.Skeleton(prim).GetJointsAttr())
            attr = UsdSkel.Animation(animation).GetJointsAttr()
            yield from unknown_joint_faults(attr, joints, prim.GetPath())
    for path, animation in animations.items():
        attr = UsdSkel.Animation(animation).GetBlendShapesAttr()
        unknown_shapes = [
            name for name in token_array(attr) if name not in shapes_by_animation[path]
        ]
        if (
            unknown_shapes
            and not checked_stage.has_only_overs
            and any(map(is_rig_mesh, checked_stage.prims))
        ):
            message = f"{len(unknown_shapes)} shapes that no mesh has: "
            yield finding("USD210", attr.GetPath(), message + listed(unknown_shapes))
