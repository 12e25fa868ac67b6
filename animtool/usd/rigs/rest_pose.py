"""Reads the rest pose of a Skeleton, or derives one if none is authored.

UsdSkel poses a Skeleton without restTransforms only if its animation has all joints.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from pxr import Usd, UsdSkel

from animtool.core.array_types import FloatArray, IntArray
from animtool.core.errors import Fault, Severity, counted, listed
from animtool.core.record import dataclass
from animtool.core.rules import finding
from animtool.maths import so3
from animtool.usd.layers.faults import (
    PrimLocation,
    is_singular,
    joint_parents,
    matrix_array,
    non_finite_faults,
    token_array,
    transform_attributes,
)

MAX_LISTED_JOINTS = 6
# Largest length of a collapsed bone and smallest of another, relative to the longest.
MAX_COLLAPSED_LENGTH, MIN_BONE_LENGTH = 1e-5, 0.02


@dataclass(frozen=True, slots=True)
class RestPose:
    """Rest transforms of a Skeleton's joints."""

    matrices: FloatArray  # relative to the parents, row vectors ``(J, 4, 4)``
    source: str = ""  # where replaced transforms come from; empty if authored


def find_rest_pose(skeleton: Any, joints: Sequence[str]) -> RestPose | None:
    """Return the rest pose of a Skeleton; None if no pose can replace a missing one.

    The rest pose is the authored one, else the bind pose, else the first sample of a
    bound animation of all joints.
    """
    rest = matrix_array(skeleton.GetRestTransformsAttr())
    if len(rest):
        return RestPose(rest)
    bind = local_bind_transforms(skeleton, joints)
    if bind is not None:
        return RestPose(bind, "the bind pose")
    first_pose = _first_pose(_bound_animation(skeleton), joints)
    if first_pose is None:
        return None
    return RestPose(first_pose, "the animation's first sample")


def local_bind_transforms(skeleton: Any, joints: Sequence[str]) -> FloatArray | None:
    """Return the bind transforms relative to their parents ``(J, 4, 4)``.

    None if their count is wrong, if one is not finite or singular, or if several joints
    have identities, which are placeholders.
    """
    bind = matrix_array(skeleton.GetBindTransformsAttr())
    if len(bind) != len(joints) or not np.isfinite(bind).all():
        return None
    if is_singular(bind).any() or (len(bind) > 1 and (bind == np.eye(4)).all()):
        return None
    local = np.array(bind, np.float64)
    for joint, parent in enumerate(joint_parents(joints).tolist()):
        if parent >= 0:
            local[joint] = bind[joint] @ np.linalg.inv(bind[parent])
    return np.ascontiguousarray(local)


def skeleton_space(local: FloatArray, parents: IntArray) -> FloatArray:
    """Return local matrices ``(J, 4, 4)``, parents first, in Skeleton space."""
    matrices = local.copy()
    for joint, parent in enumerate(parents.tolist()):
        if parent >= 0:
            matrices[joint] = local[joint] @ matrices[parent]
    return matrices


def collapsed_bone_faults(skeleton: Any, joints: Sequence[str]) -> Iterator[Fault]:
    """Yield a warning about bones that only the bind pose collapses (USD290).

    Helper joints, at the position of their parent in both poses, are not reported.
    """
    attr = skeleton.GetBindTransformsAttr()
    bind = matrix_array(attr)
    rest = matrix_array(skeleton.GetRestTransformsAttr())
    parents = joint_parents(joints)
    is_ordered = bool((parents < np.arange(len(joints))).all())
    if not (is_ordered and len(bind) == len(rest) == len(joints)):
        return
    rest_in_skeleton = skeleton_space(rest, parents)
    bind_lengths, rest_lengths = (
        _bone_lengths(pose, parents) for pose in (bind, rest_in_skeleton)
    )
    max_length = rest_lengths.max(initial=0.0)
    max_bind_length = bind_lengths.max(initial=0.0)
    is_collapsed = (rest_lengths > MIN_BONE_LENGTH * max_length) & (
        bind_lengths < MAX_COLLAPSED_LENGTH * max_bind_length
    )
    names = [
        joints[j].rpartition("/")[2] for j in np.flatnonzero(is_collapsed).tolist()
    ]
    if not names:
        return
    message = (
        f"{counted(len(names), 'joint')} with the bind position of the parent, but "
        f"another one at rest: {listed(names, MAX_LISTED_JOINTS)}; {names[0]!r} rests "
        f"{rest_lengths[is_collapsed][0]:.4g} from it"
    )
    yield finding("USD290", attr.GetPath(), message)


def _bone_lengths(matrices: FloatArray, parents: IntArray) -> FloatArray:
    """Return the distance of each joint from its parent ``(J,)``; 0 for roots."""
    points = matrices[:, 3, :3]
    offsets = np.where(parents[:, None] < 0, 0.0, points - points[parents])
    return np.asarray(np.linalg.norm(offsets, axis=1))


def rest_faults(
    skeleton: Any, joints: Sequence[str], *, is_animated: bool = True
) -> Iterator[Fault]:
    """Yield faults in the rest transforms of a Skeleton with joints.

    ``is_animated`` says whether its bound animation applies, which a layer over the rig
    replaces.
    """
    attr = skeleton.GetRestTransformsAttr()
    rest = matrix_array(attr)
    if not len(rest):
        yield _missing_rest_fault(skeleton, joints, is_animated=is_animated)
    elif len(rest) != len(joints):
        message = (
            f"{counted(len(rest), 'restTransform')} for {counted(len(joints), 'joint')}"
        )
        yield finding("USD223", attr.GetPath(), message)
    else:
        yield from non_finite_faults(attr, rest, joints)


def _missing_rest_fault(
    skeleton: Any, joints: Sequence[str], *, is_animated: bool
) -> Fault:
    """Return a fault for missing rest transforms, a warning if they are replaceable."""
    location = skeleton.GetRestTransformsAttr().GetPath()
    message = f"no restTransforms for {counted(len(joints), 'joint')}"
    unanimated_joints = (
        _unanimated_joints(_bound_animation(skeleton), joints) if is_animated else []
    )
    if unanimated_joints:
        message += (
            f", and the animation does not have {len(unanimated_joints)} of them: "
        )
        message += f"{listed(unanimated_joints, MAX_LISTED_JOINTS)}; UsdSkel poses none"
        return finding("USD239", location, message)
    pose = find_rest_pose(skeleton, joints)
    if pose is None:
        message += (
            ", and neither bindTransforms nor an animation of all joints to use instead"
        )
        return finding("USD239", location, message)
    return finding(
        "USD229", location, f"{message}; using {pose.source} as the rest pose"
    )


def read_rest(
    skeleton: Any,
    joints: Sequence[str],
    location: PrimLocation,
    *,
    is_animated: bool = True,
) -> tuple[FloatArray, list[Fault]]:
    """Return rest transforms ``(J, 4, 4)``, and a warning if they are replaced.

    Faults that readers cannot accept are raised.
    """
    faults = list(rest_faults(skeleton, joints, is_animated=is_animated))
    replacement_faults = [fault for fault in faults if fault.code == "USD229"]
    location.raise_errors(fault for fault in faults if fault not in replacement_faults)
    pose = find_rest_pose(skeleton, joints)
    matrices = np.zeros((0, 4, 4)) if pose is None else pose.matrices
    warning = Severity.WARNING
    return matrices, [
        replace(fault, path=location.path, severity=warning)
        for fault in replacement_faults
    ]


def _bound_animation(skeleton: Any) -> Any:
    """Return the animation bound to a Skeleton; None if unbound."""
    binding = UsdSkel.BindingAPI(skeleton.GetPrim())
    source = binding.GetInheritedAnimationSource()
    return UsdSkel.Animation(source) if source else None


def _unanimated_joints(animation: Any, joints: Sequence[str]) -> list[str]:
    """Return the Skeleton's joints that an animation with transforms does not list."""
    if animation is None:
        return []
    animated_joints = set(token_array(animation.GetJointsAttr()))
    attributes = transform_attributes(animation).values()
    if not animated_joints or not all(attr.HasAuthoredValue() for attr in attributes):
        return []
    return [joint for joint in joints if joint not in animated_joints]


def _first_pose(animation: Any, joints: Sequence[str]) -> FloatArray | None:
    """Return the first pose of an animation of all joints, as USD matrices."""
    if animation is None or _unanimated_joints(animation, joints):
        return None
    index_by_joint = {
        name: i for i, name in enumerate(token_array(animation.GetJointsAttr()))
    }
    first_code = Usd.TimeCode.EarliestTime()
    components = []
    for attr, width in zip(
        transform_attributes(animation).values(), (3, 4, 3), strict=True
    ):
        rows = np.array(attr.Get(first_code) or (), np.float64)
        if rows.shape != (len(index_by_joint), width) or not np.isfinite(rows).all():
            return None
        components.append(rows[[index_by_joint[joint] for joint in joints]])
    translations, rotations, scales = components
    if not np.linalg.norm(rotations, axis=1).all():
        return None
    matrices = np.tile(np.eye(4), (len(joints), 1, 1))
    linear = so3.to_matrix(so3.normalize(rotations)).swapaxes(-1, -2)
    matrices[:, :3, :3] = scales[:, :, None] * linear
    matrices[:, 3, :3] = translations
    return matrices
