"""Tracks of a rig's local transforms, one channel each."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np

from animtool.clip.reduction.keys import ChannelKind
from animtool.core.array_types import FloatArray
from animtool.core.record import dataclass
from animtool.maths import euler, so3
from animtool.maths.additive import add_offset, add_rotation, multiply_scale
from animtool.motion.motion import Channel, Motion
from animtool.rig.kinematics import WorldTransforms, forward_kinematics
from animtool.rig.limits import BallLimit, RangeLimit
from animtool.rig.skeleton import Joint, Rig

# Parts that replace a joint's full local transform.
LOCAL_PARTS = {
    ChannelKind.TRANSLATION: "local_translation",
    ChannelKind.ROTATION: "local_rotation",
    ChannelKind.SCALE: "scale",
}

# Minimum cosine of the middle angle, equal to some 80 degrees.
MIN_LOCK_COSINE = 0.17


@dataclass(frozen=True, slots=True)
class KeyTrack:
    """Samples of one channel of a joint or shape, and the space they are in."""

    kind: ChannelKind  # kind of its target
    index: int  # index of the joint in its rig, or of the weight
    order: str | None  # order of the Euler angles; None for other channels
    # ``(F, D)``, or ``(1, D)`` for a static channel: angles [deg], lengths [m], or [1].
    samples: FloatArray
    part: str = ""  # the joint's part in a clip; empty for a weight
    # Reference of the samples: rotations ``(F or 1, 4)``, or translations ``(F or 1,
    # 3)`` [m]; None for the parent's space.
    reference: FloatArray | None = None
    # Rotation of the frame that relative translations are in.
    rest_rotation: tuple[float, ...] = (0.0, 0.0, 0.0, 1.0)
    # Axis of a pin's angle or a slide, in the joint's rest frame.
    axis: tuple[float, float, float] = (0.0, 0.0, 1.0)
    # Limits of the joint, if the samples are its complete motion; None for no limits.
    limits: RangeLimit | BallLimit | None = None

    def to_parent_space(self, values: FloatArray) -> FloatArray:
        """Return values ``(F, D)`` in the space of the joint's parent."""
        if self.kind is ChannelKind.ROTATION:
            if self.order is None:
                rotation = so3.from_axis_angle(self.axis, np.radians(values[:, 0]))
            else:
                rotation = euler.to_quaternion(values, self.order)
            if self.reference is None:
                return rotation
            return so3.multiply(self.reference, rotation)
        if self.reference is None:
            return values
        vectors = values * np.array(self.axis) if values.shape[1] == 1 else values
        return np.asarray(self.reference + so3.rotate(self.rest_rotation, vectors))

    @property
    def range(self) -> tuple[float, float] | None:
        """Limits of a pin or slide in the unit of its samples; None if it has none."""
        if not isinstance(self.limits, RangeLimit) or self.samples.shape[1] != 1:
            return None
        lower, upper = self.limits.low, self.limits.high
        if self.kind is ChannelKind.ROTATION:
            return float(np.degrees(lower)), float(np.degrees(upper))
        return lower, upper

    def limit_excess(self, values: FloatArray) -> FloatArray:
        """Return the angle by which ball values ``(F, D)`` exceed the limits [rad]."""
        if not isinstance(self.limits, BallLimit) or self.order is None:
            return np.zeros(len(values))
        inverse_rest = so3.conjugate(np.array(self.rest_rotation))
        rotations = so3.multiply(inverse_rest, self.to_parent_space(values))
        return self.limits.excess(rotations)

    @property
    def is_animated(self) -> bool:
        """Whether the track has one sample per frame, rather than one constant."""
        return len(self.samples) > 1


def euler_order(joint: Joint, rotations: FloatArray) -> str:
    """Return the Euler order farthest from gimbal lock for rotations ``(F, 4)``.

    This is the joint's BVH channel order if its middle angle stays 10° from gimbal
    lock, else the order whose middle angle stays farthest from it.

    >>> euler_order(Joint("a", -1), np.array([[0, 0.5**0.5, 0, 0.5**0.5]]))
    'XZY'
    """
    bvh_order = "".join(
        c[0].upper() for c in joint.channels or () if c.lower().endswith("rotation")
    )
    is_valid_order = bvh_order in euler.ORDERS
    if is_valid_order and _lock_cosine(rotations, bvh_order) >= MIN_LOCK_COSINE:
        return bvh_order
    lock_cosine_by_order = {
        order: _lock_cosine(rotations, order) for order in euler.ORDERS
    }
    # Rounded, so that ties do not depend on the last digit.
    return max(euler.ORDERS, key=lambda order: round(lock_cosine_by_order[order], 6))


def find_tracks(rig: Rig, motion: Motion, rest: Motion) -> list[KeyTrack]:
    """Return the tracks of all channels that move or differ from rest."""
    return sort_tracks(_tracks(rig, motion, rest))


def sort_tracks(tracks: Iterable[KeyTrack]) -> list[KeyTrack]:
    """Return tracks sorted by joint, weights last."""
    kinds = list(ChannelKind)
    return sorted(
        tracks,
        key=lambda t: (t.kind is ChannelKind.WEIGHT, t.index, kinds.index(t.kind)),
    )


def _tracks(rig: Rig, motion: Motion, rest: Motion) -> Iterator[KeyTrack]:
    """Yield a track for each row of a channel that moves or differs from rest."""
    for kind, channel, rest_channel in (
        (ChannelKind.TRANSLATION, motion.translations, rest.translations),
        (ChannelKind.ROTATION, motion.rotations, rest.rotations),
        (ChannelKind.SCALE, motion.scales, rest.scales),
        (ChannelKind.WEIGHT, motion.weights, rest.weights),
    ):
        if channel is None or rest_channel is None:
            continue
        part = LOCAL_PARTS.get(kind, "")
        for index, values in _keyed_rows(channel.compact(), rest_channel):
            order, samples = None, np.ascontiguousarray(values)
            if kind is ChannelKind.ROTATION:
                order = euler_order(rig.joints[index], values)
                samples = euler.from_quaternion(values, order)
            yield KeyTrack(kind, index, order, samples, part)


def _keyed_rows(channel: Channel, rest: Channel) -> Iterator[tuple[int, FloatArray]]:
    """Yield rows that move or differ from rest, with their values."""
    for i, index in enumerate(channel.animated.tolist()):
        yield index, channel.values[:, i]
    is_off_rest = (channel.rest != rest.rest).any(axis=-1)
    is_off_rest[channel.animated] = False
    for index in np.flatnonzero(is_off_rest).tolist():
        yield index, channel.rest[index][None]


def _lock_cosine(rotations: FloatArray, order: str) -> float:
    """Return the minimum cosine of the middle Euler angle."""
    first_axis, middle_axis, last_axis = euler.axes_of(order)
    product = rotations[:, first_axis] * rotations[:, last_axis]
    twist = rotations[:, middle_axis] * rotations[:, 3]
    sign = 1.0 if (middle_axis - first_axis) % 3 == 1 else -1.0
    sine = np.abs(2.0 * (product + sign * twist)).max().clip(max=1.0)
    return float(np.sqrt(1.0 - sine * sine))


@dataclass(slots=True)
class ReducedPose:
    """Local transforms of a rig in every frame, on top of an optional base."""

    rig: Rig  # J joints
    translations: FloatArray  # ``(F, J, 3)`` [m]
    rotations: FloatArray  # ``(F, J, 4)``
    scales: FloatArray | None  # ``(F, J, 3)`` [1]; None if nothing is scaled
    # Base pose that the channels are added to; None for a complete pose.
    base: ReducedPose | None = None

    def set_track(self, track: KeyTrack, values: FloatArray) -> None:
        """Set a joint's transforms from the values ``(F, D)`` of one of its tracks."""
        j, base, local_values = track.index, self.base, track.to_parent_space(values)
        if track.kind is ChannelKind.ROTATION:
            if base is not None:
                local_values = add_rotation(base.rotations[:, j], local_values)
            self.rotations[:, j] = local_values
        elif track.kind is ChannelKind.TRANSLATION:
            if base is not None:
                local_values = add_offset(base.translations[:, j], local_values)
            self.translations[:, j] = local_values
        elif track.kind is ChannelKind.SCALE and self.scales is not None:
            base_scales = None if base is None else base.scales
            if base_scales is not None:
                local_values = multiply_scale(base_scales[:, j], local_values)
            self.scales[:, j] = local_values

    def world_transforms(self, out: WorldTransforms | None = None) -> WorldTransforms:
        """Return the world transforms, in ``out`` if given."""
        t, r, s = self.translations, self.rotations, self.scales
        return forward_kinematics(self.rig, t, r, s, out=out)

    def copy(self) -> ReducedPose:
        """Return a pose with copied arrays, on the same base."""
        scales = None if self.scales is None else self.scales.copy()
        return ReducedPose(
            self.rig, self.translations.copy(), self.rotations.copy(), scales, self.base
        )


def additive_pose(rig: Rig, motion: Motion, base: Motion | None) -> ReducedPose:
    """Return the pose of a motion, added to its base if it has a base."""
    if base is None:
        return ReducedPose(rig, *motion.dense())
    base_pose = additive_pose(rig, base, None)
    translations, rotations, scales = motion.dense()
    if base_pose.scales is not None and scales is not None:
        scales = multiply_scale(base_pose.scales, scales)
    elif base_pose.scales is not None:
        scales = base_pose.scales
    return ReducedPose(
        rig,
        add_offset(base_pose.translations, translations),
        add_rotation(base_pose.rotations, rotations),
        None if scales is None else np.ascontiguousarray(scales),
        base_pose,
    )
