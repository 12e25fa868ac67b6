"""World frames of joints, positions between frames, and travel of cycles."""

from __future__ import annotations

from fractions import Fraction

import numpy as np

from animtool.core.array_types import ArrayLike, FloatArray, IntArray
from animtool.core.record import dataclass
from animtool.maths import so3
from animtool.motion.motion import Channel, Motion
from animtool.rig.kinematics import rest_size
from animtool.rig.skeleton import JointType, Rig


@dataclass(frozen=True, slots=True)
class JointFrame:
    """A joint's world frame in every frame of a take."""

    position: FloatArray  # world position of the origin ``(F, 3)`` [m]
    # Product of the rotations of the joint and its ancestors, without scales ``(F,
    # 4)``.
    rotation: FloatArray
    # Linear part including scales ``(F, 3, 3)``; column c is its axis c.
    linear: FloatArray


def parent_frame(rig: Rig, motion: Motion, joint: int) -> JointFrame:
    """Return the world frame of a joint's parent, in which the joint is local."""
    return _product_frame(motion, rig.upwards(joint)[:0:-1])


def joint_frame(rig: Rig, motion: Motion, joint: int) -> JointFrame:
    """Return a joint's world frame in every frame."""
    return _product_frame(motion, rig.upwards(joint)[::-1])


def rest_rotation(rig: Rig, joint: int) -> FloatArray:
    """Return the rotation of a joint in the world at rest ``(4,)``."""
    rotation = so3.IDENTITY
    for ancestor in rig.upwards(joint)[::-1]:
        rotation = so3.multiply(rotation, rig.joints[ancestor].rotation)
    return rotation


def _product_frame(motion: Motion, joint_indices: list[int]) -> JointFrame:
    """Multiply the local transforms of joints in order, the first leftmost."""
    position = np.zeros((motion.frames, 3))
    rotation = np.tile(so3.IDENTITY, (motion.frames, 1))
    linear = np.tile(np.eye(3), (motion.frames, 1, 1))
    for joint in joint_indices:
        local_values, local_rotation = (
            channel.gather(np.array([joint]))[:, 0]
            for channel in (motion.translations, motion.rotations)
        )
        position = position + np.einsum("fij,fj->fi", linear, local_values)
        rotation = so3.multiply(rotation, local_rotation)
        linear = linear @ so3.to_matrix(local_rotation)
        if motion.scales is not None:
            linear = linear * motion.scales.gather(np.array([joint]))
    return JointFrame(position, rotation, linear)


def vertical_twist(rotation: FloatArray, up: FloatArray) -> FloatArray:
    """Return the part of rotations ``(..., 4)`` about a unit axis ``(3,)``.

    It is the identity for half a revolution about a perpendicular axis.

    >>> up = np.array([0.0, 1.0, 0.0])
    >>> vertical_twist(np.array([0.0, 0.6, 0.8, 0.0]), up).tolist()
    [0.0, 1.0, 0.0, 0.0]
    """
    vector_on_axis = np.sum(rotation[..., :3] * up, axis=-1, keepdims=True) * up
    return so3.normalize(np.concatenate([vector_on_axis, rotation[..., 3:]], axis=-1))


# A position within this distance of a frame is that frame [frame]; the rounding error
# of a time code in the millions is smaller.
FRAME_TOLERANCE = 1e-9


@dataclass(frozen=True, slots=True)
class FramePositions:
    """Sample positions as a frame index and a fraction towards the next frame."""

    frames: IntArray  # frame at or before each sample ``(N,)``
    fractions: FloatArray  # fraction towards the next frame, in [0, 1) ``(N,)``

    def interpolate(self, channel: Channel) -> Channel:
        """Interpolate a channel at these positions.

        On a frame the result equals that frame exactly. Between two frames, rotations
        (K = 4) follow the shortest arc and other values are linear.
        """
        values = channel.values[self.frames]
        is_between = self.fractions > 0
        weight = self.fractions[is_between, None]
        if weight.size and values.size:
            lower = values[is_between]
            upper = channel.values[self.frames[is_between] + 1]
            if values.shape[-1] == 4:
                values[is_between] = so3.slerp(lower, upper, weight)
            else:
                values[is_between] = lower + (upper - lower) * weight[..., None]
        return Channel(channel.rest, channel.animated, values)

    def interpolate_spline(self, channel: Channel) -> Channel:
        """Interpolate a channel at these positions by a Catmull-Rom spline.

        The cubic of four frames (E. Catmull and R. Rom, A class of local interpolating
        splines, 1974), of class C1; rotations (K = 4) are interpolated by component and
        normalised. On a frame the result equals that frame exactly. A take of fewer
        than three frames is interpolated linearly.
        """
        values, frame_count = channel.values, len(channel.values)
        if frame_count < 3:
            return self.interpolate(channel)
        # The parabola of the last three frames continues beyond the ends.
        row_before = 3 * values[:1] - 3 * values[1:2] + values[2:3]
        row_after = 3 * values[-1:] - 3 * values[-2:-1] + values[-3:-2]
        is_rotation = values.shape[-1] == 4
        if is_rotation:
            values = so3.align_signs(values)
            row_before, row_after = so3.normalize(row_before), so3.normalize(row_after)
        extended_values = np.concatenate([row_before, values, row_after])
        values_at_frames = channel.values[self.frames]
        (is_between,) = np.nonzero(self.fractions > 0)
        t = self.fractions[is_between, None, None]
        a, b, c, d = (extended_values[self.frames[is_between] + k] for k in range(4))
        curvature = 2 * a - 5 * b + 4 * c - d + t * (3 * (b - c) + d - a)
        spline_values = b + t / 2 * (c - a + t * curvature)
        if is_rotation:
            spline_values = so3.normalize(spline_values)
        values_at_frames[is_between] = spline_values
        return Channel(channel.rest, channel.animated, values_at_frames)


def even_positions(
    frame_indices: IntArray, offset: Fraction | int, ratio: Fraction, frame_count: int
) -> FramePositions:
    """Return positions ``(index + offset) · ratio`` in ``frame_count`` frames.

    The positions are exact, and clamped at the ends of the take.

    >>> even_positions(np.arange(4), 0, Fraction(1, 2), 9).fractions.tolist()
    [0.0, 0.5, 0.0, 0.5]
    """
    exact_offset = Fraction(offset)
    scale = ratio.denominator * exact_offset.denominator
    numerator_step = ratio.numerator * exact_offset.denominator
    offset_numerator = ratio.numerator * exact_offset.numerator
    largest_index = max(abs(int(frame_indices[0])), abs(int(frame_indices[-1]))) + 1
    if max(scale, abs(numerator_step) * largest_index + abs(offset_numerator)) < 2**62:
        numerators = frame_indices.astype(np.int64) * numerator_step + offset_numerator
        frames, remainders = np.divmod(numerators, scale)
        fractions = remainders / float(scale)
    else:
        quotients = [divmod((int(i) + exact_offset) * ratio, 1) for i in frame_indices]
        bounded_frames = [min(max(frame, -1), frame_count) for frame, _ in quotients]
        frames = np.array(bounded_frames, np.int64)
        fractions = np.array([float(remainders) for _, remainders in quotients])
    return _clamp_positions(frames, fractions, frame_count)


def frame_positions(frame_indices: ArrayLike, frame_count: int) -> FramePositions:
    """Return the positions of fractional frame indices ``(N,)`` between frames.

    An index within 1e-9 of a frame is that frame; others are clamped to the take.

    >>> frame_positions([-3.0, 1.25, 1 + 1e-12], 4).frames.tolist()
    [0, 1, 1]
    """
    clamped_indices = np.clip(np.asarray(frame_indices, np.float64), 0, frame_count - 1)
    nearest_frames = np.round(clamped_indices)
    is_on_frame = np.abs(clamped_indices - nearest_frames) <= FRAME_TOLERANCE
    clamped_indices = np.where(is_on_frame, nearest_frames, clamped_indices)
    frames = np.floor(clamped_indices).astype(np.int64)
    return _clamp_positions(frames, clamped_indices - frames, frame_count)


def positions_between(codes: FloatArray, requested_times: ArrayLike) -> FramePositions:
    """Locate times ``(N,)`` between the times of samples ``(F,)``.

    Times are clamped at the ends.

    >>> positions_between(np.array([1.0, 2.0, 4.0]), [1.0, 3.0, 9.0]).fractions.tolist()
    [0.0, 0.5, 0.0]
    """
    times = np.clip(np.asarray(requested_times, np.float64), codes[0], codes[-1])
    frames = np.searchsorted(codes, times, side="right") - 1
    next_frames = np.minimum(frames + 1, len(codes) - 1)
    spans = np.where(next_frames > frames, codes[next_frames] - codes[frames], 1.0)
    return _clamp_positions(frames, (times - codes[frames]) / spans, len(codes))


def _clamp_positions(
    frames: IntArray, fractions: FloatArray, frame_count: int
) -> FramePositions:
    """Return positions clamped to the first and last frame."""
    is_outside = (frames < 0) | (frames >= frame_count - 1)
    fractions = np.where(is_outside, 0.0, fractions)
    return FramePositions(np.clip(frames, 0, frame_count - 1), fractions)


# A joint that moves by less than this fraction of the rig's size, or rotates by less
# than this [rad], is static: files round values, and captures jitter.
STATIC_FRACTION = 1e-3


@dataclass(frozen=True, slots=True)
class CycleTravel:
    """Map of each joint's local transform from one cycle to the next.

    ``translation`` becomes ``linear · translation + shift``, and ``rotation`` becomes
    ``rotations[j] · rotation``. Joints that do not travel have identities.
    """

    rotations: FloatArray  # rotation of each joint per cycle ``(J, 4)``
    linear: FloatArray  # linear map of translations per cycle ``(J, 3, 3)``
    shifts: FloatArray  # shift of translations per cycle ``(J, 3)`` [m]


def travelling_joint(
    rig: Rig, motion: Motion, root: int, *, excludes_root: bool = False
) -> int | None:
    """Return the joint that carries the full character, from a root down.

    This is the root if it moves. Otherwise it is a free joint with animated translation
    below static joints only: the one with the most descendants, then the first. None if
    nothing travels.
    """
    is_moving = _is_translated(rig, motion, root) or _is_rotated(motion, root)
    if is_moving and not excludes_root:
        return root
    moving_joints = _travelling_joints(rig, motion, root)
    return max(moving_joints, key=lambda j: (_subtree_size(rig, j), -j), default=None)


def cycle_travel(rig: Rig, motion: Motion) -> CycleTravel:
    """Return the travel of a cycle, from its first frame to its last.

    Motion on the ground and about the up axis accumulates; height and lean return. Each
    root travels independently, and joints below a static root move with the joint that
    `travelling_joint` returns.
    """
    joint_count = len(rig.joints)
    travel = CycleTravel(
        np.tile(so3.IDENTITY, (joint_count, 1)),
        np.tile(np.eye(3), (joint_count, 1, 1)),
        np.zeros((joint_count, 3)),
    )
    end_frames, up = motion.select(np.array([0, -1])), np.array(rig.up.vector)
    for root in rig.roots:
        main_joint = travelling_joint(rig, motion, root)
        if main_joint is None:
            continue
        travelling_joints = (
            [root] if main_joint == root else _travelling_joints(rig, motion, root)
        )
        main_joint_frame = joint_frame(rig, end_frames, main_joint)
        rotation_change = so3.multiply(
            main_joint_frame.rotation[1], so3.conjugate(main_joint_frame.rotation[0])
        )
        rotation = vertical_twist(rotation_change, up)
        displacement = main_joint_frame.position[1] - so3.rotate(
            rotation, main_joint_frame.position[0]
        )
        displacement = displacement - (displacement @ up) * up
        for joint in travelling_joints:
            _store_travel(travel, joint, rig, end_frames, rotation, displacement)
    return travel


def _store_travel(
    travel: CycleTravel,
    joint: int,
    rig: Rig,
    end_frames: Motion,
    world_rotation: FloatArray,
    displacement: FloatArray,
) -> None:
    """Convert the travel of a cycle to a joint's parent space, and store it."""
    if rig.joints[joint].parent < 0:
        travel.rotations[joint], travel.shifts[joint] = world_rotation, displacement
        travel.linear[joint] = so3.to_matrix(world_rotation)
        return
    local_frame = parent_frame(rig, end_frames, joint)
    position, rotation, linear = (
        local_frame.position[0],
        local_frame.rotation[0],
        local_frame.linear[0],
    )
    if np.linalg.det(linear) == 0:
        return
    local_rotation = so3.multiply(so3.conjugate(rotation), world_rotation)
    travel.rotations[joint] = so3.multiply(local_rotation, rotation)
    shift = so3.rotate(world_rotation, position) + displacement - position
    rotated_linear = so3.to_matrix(world_rotation) @ linear
    travel.linear[joint] = np.linalg.solve(linear, rotated_linear)
    travel.shifts[joint] = np.linalg.solve(linear, shift)


def _travelling_joints(rig: Rig, motion: Motion, root: int) -> list[int]:
    """Return the topmost moving free joints below a root."""
    moving_joints: list[int] = []
    static_joints = {root}
    for j, joint in enumerate(rig.joints):
        if joint.parent not in static_joints:
            continue
        if joint.type is JointType.FREE and _is_translated(rig, motion, j):
            moving_joints.append(j)
        elif not _is_rotated(motion, j):
            static_joints.add(j)
    return moving_joints


def _is_translated(rig: Rig, motion: Motion, joint: int) -> bool:
    """Return whether a joint's translation moves noticeably."""
    extent = np.ptp(motion.translations.gather(np.array([joint])), axis=0)
    return bool(np.linalg.norm(extent) > STATIC_FRACTION * rest_size(rig))


def _is_rotated(motion: Motion, joint: int) -> bool:
    """Return whether a joint's rotation moves noticeably."""
    values = motion.rotations.gather(np.array([joint]))
    return bool(so3.angle_between(values, values[:1]).max() > STATIC_FRACTION)


def _subtree_size(rig: Rig, joint: int) -> int:
    """Return the number of joints in a subtree."""
    subtree = {joint}
    for j, rig_joint in enumerate(rig.joints):
        if rig_joint.parent in subtree:
            subtree.add(j)
    return len(subtree)
