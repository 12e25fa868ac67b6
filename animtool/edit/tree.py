"""Changes to the joint tree of a take: joints inserted, removed and attached."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from fnmatch import fnmatchcase

import numpy as np

from animtool.core.array_types import BoolArray, FloatArray
from animtool.core.errors import Fault, OptionError, excerpt
from animtool.core.loaded import check_loaded
from animtool.core.record import dataclass
from animtool.core.units import UpAxis
from animtool.maths import so3
from animtool.motion.motion import Channel
from animtool.motion.passes import FrameScope, OptionChecks, Pass, PassContext, TakePart
from animtool.motion.take import Take
from animtool.rig.drivers import split_coordinate
from animtool.rig.joints import DRIVEN_PARTS, split_part
from animtool.rig.kinematics import WorldTransforms, rest_world
from animtool.rig.skeleton import Joint, JointType, Pose, Rig


def joint_index(rig: Rig, name: str, option: str) -> int:
    """Return the index of a joint that an option names (unknown joint: SCN012)."""
    if name not in rig.names:
        raise _unknown_joint_error(rig, name, option)
    return rig.index(name)


def match_joints(
    rig: Rig, patterns: str | Sequence[str], *, includes_children: bool = False
) -> list[int]:
    """Return the joints that match names or glob patterns, ascending.

    >>> from animtool.rig.skeleton import Joint
    >>> arm = Rig("arm", (Joint("a", -1), Joint("b", 0), Joint("c", -1)))
    >>> match_joints(arm, ["a"], includes_children=True)
    [0, 1]
    """
    joint_indices: set[int] = set()
    for pattern in [patterns] if isinstance(patterns, str) else patterns:
        matches = {i for i, name in enumerate(rig.names) if fnmatchcase(name, pattern)}
        if not matches:
            raise _unknown_joint_error(rig, pattern, "joints")
        joint_indices |= matches
    if includes_children:
        for i, joint in enumerate(rig.joints):
            if joint.parent in joint_indices:
                joint_indices.add(i)
    return sorted(joint_indices)


def _unknown_joint_error(rig: Rig, name: str, option: str) -> OptionError:
    """Return the error for an unknown joint in an option (SCN012)."""
    message = f"{option}: unknown joint {excerpt(name)} of {rig.name!r}"
    return OptionError(Fault("SCN012", message, hint=rig.joint_hint(name)))


# Scales, and angles [rad], that differ by less are equal: files have float32 or half
# precision, and 1e-9 is invisible.
EQUAL_VALUE_TOLERANCE = 1e-9


@dataclass(frozen=True, slots=True)
class JointTransforms:
    """Local transforms of a joint: ``(F, 3)`` [m] and ``(F, 4)``, or one frame."""

    translations: FloatArray
    rotations: FloatArray


def set_joint(take: Take, joint: int, transforms: JointTransforms) -> Take:
    """Return a take with other transforms of a joint; its children stay in place."""
    motion = take.motion
    child_indices = np.flatnonzero(take.rig.parents == joint)
    joint_and_children = np.concatenate([[joint], child_indices])
    translations = motion.translations.gather(joint_and_children)
    rotations = motion.rotations.gather(joint_and_children)
    inverse_rotations = so3.conjugate(transforms.rotations)
    rotation = so3.multiply(inverse_rotations, rotations[:, 0])[:, None]
    is_rotated = (
        so3.angle_between(transforms.rotations, rotations[:, 0]) > EQUAL_VALUE_TOLERANCE
    )
    scale = _joint_scale(take, joint, is_rotated)[:, None]
    offset = translations[:, 0] - transforms.translations
    shift = so3.rotate(inverse_rotations, offset)[:, None]
    rotated_offsets = so3.rotate(rotation, scale * translations[:, 1:])
    translations[:, 1:] = (rotated_offsets + shift) / scale
    rotations[:, 1:] = so3.multiply(rotation, rotations[:, 1:])
    translations[:, 0], rotations[:, 0] = transforms.translations, transforms.rotations
    motion = replace(
        motion,
        translations=motion.translations.put(joint_and_children, translations),
        rotations=motion.rotations.put(joint_and_children, rotations),
    )
    return replace(take, motion=motion)


def _joint_scale(take: Take, joint: int, is_rotated: BoolArray) -> FloatArray:
    """Return the scale of a joint ``(F, 3)``, uniform where the joint rotates."""
    scales = take.motion.scales
    if scales is None:
        return np.ones((1, 3))
    values = scales.gather(np.array([joint]))[:, 0]
    is_uneven = np.ptp(values, axis=-1) > EQUAL_VALUE_TOLERANCE * np.abs(values).max(
        axis=-1
    )
    if (values == 0).any() or (is_uneven & is_rotated).any():
        message = f"{take.rig.names[joint]!r} has a scale of 0 or one that differs by "
        message += "axis, which would shear the joints below it"
        raise OptionError(Fault("SCN020", message, hint="scale its children instead"))
    return values


def insert_joint(take: Take, name: str, child: int) -> Take:
    """Return a take with a static joint inserted between a joint and its parent.

    The new joint takes the child's index; the child's index grows by one.
    """
    old_joints = take.rig.joints
    new_joints = [replace(j, parent=j.parent + (j.parent >= child)) for j in old_joints]
    parent = new_joints[child].parent
    new_joints[child] = replace(new_joints[child], parent=child)
    new_joints.insert(child, Joint(name, parent))

    def insert_row(channel: Channel, neutral: FloatArray) -> Channel:
        """Return a channel with a row for the new joint."""
        return Channel(
            np.insert(channel.rest, child, neutral, axis=0),
            channel.animated + (channel.animated >= child),
            channel.values,
        )

    rig = replace(take.rig, joints=tuple(new_joints))
    return _with_changed_channels(take, rig, insert_row)


def remove_joint(take: Take, joint: int) -> Take:
    """Return a take without a joint that coincides with its parent.

    Its children move to its parent and take over its scale and rest pose.
    """
    take = _move_scale_to_children(take, joint)
    rig = take.rig
    name, parent = rig.names[joint], rig.joints[joint].parent
    if name in _referenced_joints(rig):
        message = f"the rig's skins, chains or controls refer to {name!r}"
        raise OptionError(Fault("SCN020", message, hint="keep the joint"))
    kept_joints = []
    for i, rig_joint in enumerate(rig.joints):
        if rig_joint.parent == joint:
            pose = _relative_pose(rig.joints[joint].rest_pose, rig_joint.rest_pose)
            rig_joint = replace(  # noqa: PLW2901
                rig_joint,
                parent=parent,
                translation=pose.translation,
                rotation=pose.rotation,
            )
        elif rig_joint.parent > joint:
            rig_joint = replace(rig_joint, parent=rig_joint.parent - 1)  # noqa: PLW2901
        if i != joint:
            kept_joints.append(rig_joint)

    def remove_row(channel: Channel, _: FloatArray) -> Channel:
        """Return a channel without the row of the joint."""
        is_kept = channel.animated != joint
        animated_rows = channel.animated[is_kept]
        return Channel(
            np.delete(channel.rest, joint, axis=0),
            animated_rows - (animated_rows > joint),
            channel.values[:, is_kept],
        )

    bind = _bind_poses_without(rig, joint)
    smaller_rig = replace(rig, joints=tuple(kept_joints), bind=bind)
    return _with_changed_channels(take, smaller_rig, remove_row)


def _move_scale_to_children(take: Take, joint: int) -> Take:
    """Multiply the scale of a joint into its children, and reset it."""
    scales = take.motion.scales
    if scales is None:
        return take
    scale = _joint_scale(take, joint, np.ones(1, np.bool_))[:, None]
    child_indices = np.flatnonzero(take.rig.parents == joint)
    translations = take.motion.translations
    joint_and_children = np.concatenate([[joint], child_indices])
    scale_values = scales.gather(joint_and_children) * scale
    scale_values[:, 0] = 1.0
    motion = replace(
        take.motion,
        scales=scales.put(joint_and_children, scale_values),
        translations=translations.put(
            child_indices, translations.gather(child_indices) * scale
        ),
    )
    return replace(take, motion=motion)


def _with_changed_channels(
    take: Take, rig: Rig, change: Callable[[Channel, FloatArray], Channel]
) -> Take:
    """Return a take with another rig, its channels changed accordingly."""
    motion = take.motion
    motion = replace(
        motion,
        translations=change(motion.translations, np.zeros(3)),
        rotations=change(motion.rotations, so3.IDENTITY),
        scales=None if motion.scales is None else change(motion.scales, np.ones(3)),
    )
    return replace(take, rig=rig, motion=motion)


def _relative_pose(parent_pose: Pose, pose: Pose) -> Pose:
    """Compose a parent's pose with a child's, relative to the parent's parent."""
    offset = so3.rotate(parent_pose.rotation, pose.translation)
    x, y, z = (offset + parent_pose.translation).tolist()
    a, b, c, w = so3.multiply(parent_pose.rotation, pose.rotation).tolist()
    return Pose((x, y, z), (a, b, c, w))


def _bind_poses_without(rig: Rig, joint: int) -> dict[str, Pose]:
    """Return the bind poses of a rig after a joint is removed."""
    removed_joint = rig.joints[joint]
    bind_pose_by_joint = {
        name: pose for name, pose in rig.bind.items() if name != removed_joint.name
    }
    parent_pose = rig.bind.get(removed_joint.name, removed_joint.rest_pose)
    for child in rig.joints:
        if child.parent == joint and {child.name, removed_joint.name} & set(rig.bind):
            pose = rig.bind.get(child.name, child.rest_pose)
            bind_pose_by_joint[child.name] = _relative_pose(parent_pose, pose)
    return bind_pose_by_joint


def _referenced_joints(rig: Rig) -> set[str]:
    """Return the joints that other parts of a rig reference."""
    joint_names = {name for chain in rig.chains for name in (chain.root, chain.tip)}
    joint_names.update(
        *(mesh.skin.joints for mesh in rig.meshes if mesh.skin is not None)
    )
    joint_names.update(*(attachment.joints for attachment in rig.attach))
    for control in rig.controls:
        for drive in control.drives:
            kind, _, name = drive.target.partition("/")
            if kind == "joint":
                joint_names.add(split_part(name, DRIVEN_PARTS)[0])
    drivers = (
        *(joint.driven for joint in rig.joints),
        *(shape.driven for shape in rig.shapes),
        *(control.driven for control in rig.controls),
    )
    for driver in filter(None, drivers):
        joint_names.update(split_coordinate(name)[0] for name in driver.names)
    for joint in rig.joints:
        if joint.driven is not None:
            joint_names.add(joint.name)
        if joint.mimic is not None:
            joint_names.add(joint.mimic.joint)
    joint_names.update(collider.joint for collider in rig.colliders)
    return joint_names.union(mass.joint for mass in rig.masses)


@dataclass(frozen=True, slots=True)
class HangOptions:
    """The joint to attach, and the rope particle that carries it.

    Attributes:
        joint: A free joint of the rig; its descendants move with it.
        system: Name of a rope or of strands of the scene's ``systems``.
        particle: Particle of the system, by its location name or number.
        axis: Axis of the joint, in its own frame, that is aligned with the last
            segment, away from the rope; None uses the axis that points down at rest,
            and zeros keep the joint's rotation.
    """

    joint: str = ""
    system: str = ""
    particle: str = "end"
    axis: Sequence[float] | None = None


def hang(
    take: Take, joint: str, ends: FloatArray, axis: Sequence[float] | None = None
) -> Take:
    """Return a take whose joint follows the last segment of a rope.

    The joint's origin is at the end of the segment. Its rotation is that of the take,
    rotated along the shortest arc until its axis is aligned with the segment.

    Limits: if the axis is opposite to the segment, the direction of rotation is
    arbitrary.

    Args:
        take: A take of F frames.
        joint: Name of a free joint.
        ends: Positions of the last two particles ``(F, 2, 3)`` [m], in the space of the
            take.
        axis: As in `HangOptions`.

    Raises:
        OptionError: The joint is unknown, not free or below one that is scaled to 0,
            or the axis is not finite (SIM192).
    """
    check_loaded(take, Take, "take")
    rig, motion = take.rig, take.motion
    _check_axis(axis)
    if joint not in rig.names:
        hint = rig.joint_hint(joint)
        raise _hang_error(f"unknown joint {joint!r}", "joint", hint)
    index = rig.index(joint)
    if rig.joints[index].type is not JointType.FREE:
        message = (
            f"joint {joint!r} is of type {rig.joints[index].type}, and cannot leave "
        )
        raise _hang_error(f"{message}its parent", "joint", "make it `type: free`")
    joint_row, world = np.array([index]), take.world()
    _check_scales(take, world, index)
    rotation = world.rotations[:, index]
    down_vector = -np.eye(3)[{UpAxis.Y: 1, UpAxis.Z: 2}[take.rig.up]]
    rest_rotation = rest_world(take.rig).rotations[0, index]
    local_axis = so3.rotate(so3.conjugate(rest_rotation), down_vector)
    if axis is not None:
        local_axis = np.asarray(axis, np.float64)
    if local_axis.any():
        segment = ends[:, 1] - ends[:, 0]
        swing = _shortest_rotations(so3.rotate(rotation, local_axis), segment)
        rotation = so3.multiply(swing, rotation)
    parent = rig.joints[index].parent
    positions, rotations = _to_parent_space(world, parent, ends[:, 1], rotation)
    rotations = so3.align_signs(rotations)
    motion = replace(
        motion,
        translations=motion.translations.put(joint_row, positions[:, None]).compact(),
        rotations=motion.rotations.put(joint_row, rotations[:, None]).compact(),
    )
    return replace(take, motion=motion)


def _shortest_rotations(
    start_directions: FloatArray, end_directions: FloatArray
) -> FloatArray:
    """Return the shortest rotations ``(F, 4)`` between directions ``(F, 3)``."""
    lengths = [
        np.linalg.norm(v, axis=1, keepdims=True)
        for v in (start_directions, end_directions)
    ]
    # A segment without length has no direction.
    is_zero = (lengths[0] == 0) | (lengths[1] == 0)
    start_units, end_units = (
        np.divide(v, length, out=np.zeros_like(v), where=length > 0)
        for v, length in zip((start_directions, end_directions), lengths, strict=True)
    )
    cross = np.cross(start_units, end_units)
    sine = np.linalg.norm(cross, axis=1, keepdims=True)
    angle = np.arctan2(sine, (start_units * end_units).sum(1, keepdims=True))
    # Half a revolution may be about any perpendicular axis.
    perpendicular = np.cross(start_units, np.eye(3)[np.abs(start_units).argmin(axis=1)])
    axis = np.where(sine < 1e-12, perpendicular, cross)
    axis = axis / np.maximum(np.linalg.norm(axis, axis=1, keepdims=True), 1e-300)
    return so3.exp(np.where(is_zero, 0.0, axis * angle))


def _to_parent_space(
    world: WorldTransforms, parent: int, positions: FloatArray, rotations: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Convert world transforms of a joint to the space of its parent."""
    if parent < 0:
        return positions, rotations
    inverse_linear = np.linalg.inv(world.linear[:, parent])
    offsets = positions - world.positions[:, parent]
    local_positions = np.einsum("fij,fj->fi", inverse_linear, offsets)
    inverse_parent = so3.conjugate(world.rotations[:, parent])
    return np.ascontiguousarray(local_positions), so3.multiply(
        inverse_parent, rotations
    )


def _check_scales(take: Take, world: WorldTransforms, joint: int) -> None:
    """Raise for a joint below a zero scale, since no local value can place it."""
    parent = take.rig.joints[joint].parent
    if parent < 0:
        return
    singular_frames = np.flatnonzero(np.linalg.det(world.linear[:, parent]) == 0.0)
    if len(singular_frames):
        message = (
            f"joint {take.rig.names[joint]!r} cannot be attached: a joint above it "
            f"has a scale of 0 at frame {take.clock.times[singular_frames[0]]:g}"
        )
        raise _hang_error(message, "joint", "set another scale there")


def _check_axis(axis: Sequence[float] | None) -> None:
    """Raise if an axis is not three finite numbers."""
    if axis is None:
        return
    if len(axis) != 3 or not all(math.isfinite(value) for value in axis):
        message = f"axis must be three finite numbers, not {list(axis)}"
        raise _hang_error(message, "axis")


def _require_option(options: HangOptions, key: str) -> None:
    """Raise if an option is empty."""
    if not getattr(options, key):
        raise _hang_error(f"{key} is missing", key)


def _hang_error(message: str, where: str, hint: str | None = None) -> OptionError:
    """Return the error for a joint that cannot hang on a rope (SIM192)."""
    return OptionError(Fault("SIM192", message, where=where, hint=hint))


def _run(take: Take, options: HangOptions, context: PassContext) -> Take:
    """Run the pass: simulate the rope and attach the joint."""
    if context.simulate_segments is None:
        message = "attaching a joint needs a scene with systems"
        raise _hang_error(message, "system")
    ends = context.simulate_segments(
        take, options.system, options.particle, context.progress
    )
    return hang(take, options.joint, ends, options.axis)


def _checks(options: HangOptions) -> OptionChecks:
    """Return the checks of the options, by option name."""
    return {
        "joint": lambda: _require_option(options, "joint"),
        "system": lambda: _require_option(options, "system"),
        "axis": lambda: _check_axis(options.axis),
    }


PASS = Pass(
    "hang",
    "Attach a joint to the end of a simulated rope",
    HangOptions,
    FrameScope.CLIP,
    _run,
    _checks,
    reads=frozenset({TakePart.RIG, TakePart.JOINTS, TakePart.CLOCK}),
    changes=frozenset({TakePart.JOINTS}),
    reports_progress=True,
)
