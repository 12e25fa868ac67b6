"""Root motion: hip travel moved to a root joint above, and back."""

from __future__ import annotations

import math
from dataclasses import replace
from enum import StrEnum

import numpy as np

from animtool.core.arguments import argument
from animtool.core.errors import Fault, OptionError, warning
from animtool.core.loaded import check_loaded
from animtool.core.quantities import length_text
from animtool.core.record import dataclass
from animtool.edit.combine import align_signs
from animtool.edit.travel import (
    joint_frame,
    parent_frame,
    rest_rotation,
    travelling_joint,
    vertical_twist,
)
from animtool.edit.tree import (
    JointTransforms,
    insert_joint,
    joint_index,
    remove_joint,
    set_joint,
)
from animtool.maths import so3
from animtool.motion.keyed import parse_choice
from animtool.motion.motion import Channel
from animtool.motion.passes import FrameScope, Pass, PassContext, TakePart
from animtool.motion.take import Take
from animtool.rig.kinematics import rest_size

# Travel along an axis that a root motion lacks: relative to the rig's size, and to the
# travel along those that it has.
MIN_TRAVEL, MIN_TRAVEL_RATIO = 0.2, 2.0


class RootMode(StrEnum):
    """Whether root motion is extracted to a root joint or recomposed."""

    EXTRACT = "extract"
    RECOMPOSE = "recompose"


@dataclass(frozen=True, slots=True)
class RootMotionOptions:
    """Which motion is moved between the hips and the root joint.

    Attributes:
        mode: ``extract`` moves the travel to the root joint, ``recompose`` moves it
            back.
        root: Name of the root joint; ``extract`` adds it if the rig lacks it.
        hips: Joint whose travel is moved; empty selects the topmost travelling joint
            (below ``root`` if the rig has it), else the first.
        axes: World axes of the moved position, such as ``xz``; empty selects the
            ground.
        yaw: Whether the rotation about the up axis is moved too.
        keep: Whether ``recompose`` keeps the root joint in the rig, at rest.
    """

    mode: RootMode = RootMode.EXTRACT
    root: str = "root"
    hips: str = ""
    axes: str = ""
    yaw: bool = True
    keep: bool = False


def extract_root(
    take: Take, root: str = "root", axes: str = "", *, yaw: bool = True, hips: str = ""
) -> Take:
    """Extract root motion: move the hips' travel to a root joint above.

    A joint named ``root`` gets the travel instead of its own motion; if the rig has
    none, it is added directly above the hips. Joints below keep their world transforms.
    The yaw is undefined while the hips are upside down.

    Args:
        take: A take of F frames.
        root: Name of the joint that gets the travel.
        axes: World axes of the moved position, such as ``xz``; empty selects the
            ground.
        yaw: Whether the rotation about the up axis is moved too.
        hips: Joint whose travel is moved; empty selects the topmost travelling joint,
            below ``root`` if the rig has it, else the first.

    Raises:
        OptionError: Unknown joint (SCN012); unknown axis, the root joint is not above
            the hips, its scale does not allow it, or the rig has no joints (SCN020).
    """
    check_loaded(take, Take, "take")
    _check_axes(axes)
    rig = take.rig
    hip_index = _hips_index(take, root, hips)
    if root not in rig.names:
        take = insert_joint(take, root, hip_index)
        hip_index += 1
    root_index = take.rig.index(root)
    if root_index not in take.rig.upwards(hip_index)[1:]:
        name = take.rig.names[hip_index]
        message, hint = f"{root!r} is not above {name!r}", "choose other hips"
        if hip_index == root_index:
            top_name = take.rig.names[take.rig.roots[0]]
            message = f"{root!r} has no joint below it whose travel it could get"
            hint = "name a joint above the hips, or a new one: "
            hint += f"{argument('root', 'root')} is added above {top_name!r}"
        if hips and hip_index in take.rig.upwards(root_index)[1:]:
            message = f"{root!r} is below {name!r}: the root and the hips are exchanged"
            hint = f"write {argument('root', name)}, {argument('hips', root)}"
        raise _root_error(message, hint)
    root_transforms = _root_transforms(take, root_index, hip_index, axes.lower(), yaw)
    return _compact_take(set_joint(take, root_index, root_transforms))


def recompose_root(take: Take, root: str = "root", *, keep: bool = False) -> Take:
    """Return the take without a root joint; its children take over its motion.

    Joints below keep their world transforms.

    Args:
        take: A take of F frames.
        root: Name of the joint.
        keep: Keep the joint in the rig, at rest: the inverse of an extraction to an
            existing joint.

    Raises:
        OptionError: Unknown joint (SCN012); it has no child joint, its scale does not
            allow it, or the rig still refers to it (SCN020).
    """
    check_loaded(take, Take, "take")
    rig = take.rig
    root_index = joint_index(rig, root, "root")
    if root_index not in rig.parents:
        raise _root_error(f"{root!r} has no joint below it", "name one above the hips")
    root_joint = rig.joints[root_index]
    translations, rotations = np.zeros((1, 3)), so3.IDENTITY[None]
    if keep:
        translations = np.array([root_joint.translation])
        rotations = np.array([root_joint.rotation])
    take = set_joint(take, root_index, JointTransforms(translations, rotations))
    return _compact_take(take if keep else remove_joint(take, root_index))


def _check_axes(axes: str) -> None:
    """Raise if an axis is not x, y or z."""
    if not set(axes.lower()) <= set("xyz"):
        message = f"axes {axes!r} may contain only x, y and z"
        raise _root_error(message, "write xz, for example")


def _root_error(message: str, hint: str) -> OptionError:
    """Return the error for a root joint that cannot be used (SCN020)."""
    return OptionError(Fault("SCN020", message, hint=hint))


def _hips_index(take: Take, root: str, hips: str) -> int:
    """Return the joint whose travel is moved, as named or detected."""
    rig = take.rig
    if hips:
        return joint_index(rig, hips, "hips")
    if not rig.joints:
        message = "the rig has no joints, so there is no root motion"
        raise _root_error(message, "remove the pass")
    has_root = root in rig.names
    top_joint = rig.index(root) if has_root else rig.roots[0]
    hip_index = travelling_joint(rig, take.motion, top_joint, excludes_root=has_root)
    if hip_index is None and has_root:
        children = (
            j for j, joint in enumerate(rig.joints) if joint.parent == top_joint
        )
        hip_index = next(children, top_joint)
    return top_joint if hip_index is None else hip_index


def _root_transforms(
    take: Take, root_index: int, hip_index: int, axes: str, moves_yaw: bool
) -> JointTransforms:
    """Return the local transform of the root joint that carries the hips' travel."""
    rig, motion = take.rig, take.motion
    up = np.array(rig.up.vector)
    is_root_axis = np.array([axis in axes for axis in "xyz"]) if axes else up == 0
    hips_frame = joint_frame(rig, motion, hip_index)
    root_frame = joint_frame(rig, motion, root_index)
    parent = parent_frame(rig, motion, root_index)
    if (np.linalg.det(parent.linear) == 0).any():
        message = f"a joint above {rig.names[root_index]!r} has a scale of 0"
        raise _root_error(message, "set another scale")
    position = np.where(is_root_axis, hips_frame.position, root_frame.position)
    offset = (position - parent.position)[..., None]
    translations = np.asarray(
        np.linalg.solve(parent.linear, offset)[..., 0], np.float64
    )
    rotations = motion.rotations.gather(np.array([root_index]))[:, 0]
    if moves_yaw:
        inverse_rest = so3.conjugate(rest_rotation(rig, hip_index))
        from_rest = so3.multiply(hips_frame.rotation, inverse_rest)
        yaw_rotation = vertical_twist(from_rest, up)
        full_rotation = so3.multiply(yaw_rotation, rest_rotation(rig, root_index))
        rotations = so3.multiply(so3.conjugate(parent.rotation), full_rotation)
    return JointTransforms(translations, rotations)


def _compact_take(take: Take) -> Take:
    """Return a take whose constant channels are stored once."""
    return replace(take, motion=align_signs(take.motion).map(Channel.compact))


def _axes_warnings(take: Take, options: RootMotionOptions) -> list[Fault]:
    """Return a warning if the axes are the ground of another up axis (SCN121)."""
    rig, axes = take.rig, set(options.axes.lower())
    up = "xyz"[int(np.argmax(rig.up.vector))]
    if up not in axes or len(axes) != 2:
        return []
    hip_index = _hips_index(take, options.root, options.hips)
    positions = joint_frame(rig, take.motion, hip_index).position
    travel_by_axis = dict(zip("xyz", np.abs(positions[-1] - positions[0]), strict=True))
    (missing_axis,) = set("xyz") - axes
    root_travel = math.hypot(*(travel_by_axis[axis] for axis in axes))
    if travel_by_axis[missing_axis] < max(
        MIN_TRAVEL * rest_size(rig), MIN_TRAVEL_RATIO * root_travel
    ):
        return []
    axes_text = "".join(sorted(axes))
    missing_travel = length_text(travel_by_axis[missing_axis])
    message = (
        f"axes {axes_text} has the up axis {up}, and lacks {missing_axis}, along which "
        f"{rig.names[hip_index]!r} travels {missing_travel}: "
        f"the root travels {length_text(root_travel)}"
    )
    ground_axes = "xyz".replace(up, "")
    hint = f"the ground of this take is {ground_axes}: write 'axes: {ground_axes}', "
    return [warning("SCN121", message, f"{hint}or leave it out")]


def _run(take: Take, options: RootMotionOptions, context: PassContext) -> Take:
    """Run the pass: extract or recompose the root motion."""
    if parse_choice(RootMode, options.mode, "mode") is RootMode.RECOMPOSE:
        return recompose_root(take, options.root, keep=options.keep)
    _check_axes(options.axes)
    context.notices.extend(_axes_warnings(take, options))
    return extract_root(
        take, options.root, options.axes, yaw=options.yaw, hips=options.hips
    )


PASS = Pass(
    "root_motion",
    "Move the root motion to a root joint",
    RootMotionOptions,
    FrameScope.CLIP,
    _run,
    lambda options: {"axes": lambda: _check_axes(options.axes)},
    reads=frozenset({TakePart.RIG, TakePart.JOINTS, TakePart.CLOCK}),
    changes=frozenset({TakePart.RIG, TakePart.JOINTS}),
)
