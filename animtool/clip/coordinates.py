"""Joint motion relative to rest, without the contributions of controls."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence, Set
from dataclasses import replace

import numpy as np

from animtool.clip.reduction.keys import ChannelKind
from animtool.clip.reduction.tracks import KeyTrack, euler_order
from animtool.core.array_types import BoolArray, FloatArray
from animtool.core.record import dataclass
from animtool.maths import euler, so3
from animtool.motion.motion import Motion
from animtool.rig.joints import DRIVEN_PARTS, split_part
from animtool.rig.limits import RangeLimit
from animtool.rig.skeleton import Joint, JointType, Rig

# Number of revolutions tried for a pin's first angle.
MAX_REVOLUTIONS = 3
COORDINATE_PARTS = {JointType.PIN: "angle", JointType.PRISMATIC: "slide"}
_ROTATING_TYPES = {JointType.FREE, JointType.BALL}


@dataclass(frozen=True, slots=True)
class Tolerances:
    """Differences below which values count as equal [rad], [m], [1]."""

    angle: float
    length: float
    weight: float

    def tolerance_of(self, target: str) -> float:
        """Return the tolerance of a control's target.

        >>> Tolerances(1e-6, 1e-7, 1e-8).tolerance_of("joint/hips.translation.x")
        1e-07
        """
        if target.startswith("shape/"):
            return self.weight
        part = split_part(target, DRIVEN_PARTS)[1]
        is_length = part == "slide" or part.startswith("translation")
        return self.length if is_length else self.angle


@dataclass(frozen=True, slots=True)
class JointMotion:
    """Motion of a joint relative to rest: n = F frames, or 1 if static."""

    rotation: FloatArray  # ``(n, 4)``, signs continuous
    translation: FloatArray  # ``(n, 3)`` [m]
    # Angle of a pin [rad], continuous, or offset of a prismatic joint [m] ``(n,)``,
    # else 0.
    coordinate: FloatArray
    # Largest rotation that the joint's type does not allow [rad].
    rotation_error: float
    # Largest translation that the joint's type does not allow [m].
    translation_error: float
    is_rotation_at_rest: bool  # whether the local rotation is exactly the rest rotation
    is_translation_at_rest: bool  # likewise for the translation


def relative_joint_motions(
    rig: Rig, motion: Motion, tolerances: Tolerances
) -> list[JointMotion]:
    """Return the motion of every joint relative to rest.

    Revolutions of a pin's angle are chosen to keep it within its limits and agree
    with its mimic joints.
    """
    channels = motion.translations, motion.rotations
    moving_joints = [set(channel.animated.tolist()) for channel in channels]
    motions = []
    for j, joint in enumerate(rig.joints):
        joint_index = np.array([j])
        translation, rotation = (
            channel.gather(joint_index)[:, 0]
            if j in moving_indices
            else channel.rest[joint_index]
            for channel, moving_indices in zip(channels, moving_joints, strict=True)
        )
        motions.append(_joint_motion(joint, translation, rotation))
    for j, joint in enumerate(rig.joints):
        if joint.type is JointType.PIN:
            motions[j] = _with_best_revolution(rig, motions, j, tolerances)
    return motions


def _joint_motion(
    joint: Joint, translation: FloatArray, rotation: FloatArray
) -> JointMotion:
    """Return a joint's motion relative to its rest frame."""
    inverse_rest = so3.conjugate(joint.rotation)
    rotation_from_rest = so3.align_signs(so3.multiply(inverse_rest, rotation))
    translation_from_rest = so3.rotate(
        inverse_rest, translation - np.array(joint.translation)
    )
    joint_axis = np.array(joint.axis)
    coordinate = np.zeros(1)
    rotation_error = 0.0
    translation_error = float(np.abs(translation_from_rest).max(initial=0.0))
    if joint.type is JointType.PIN:
        coordinate = np.unwrap(
            2.0
            * np.arctan2(
                rotation_from_rest[:, :3] @ joint_axis, rotation_from_rest[:, 3]
            )
        )
        coordinate = coordinate - 2 * np.pi * np.round(coordinate[:1] / (2 * np.pi))
        pin_rotation = so3.from_axis_angle(joint_axis, coordinate)
        residual = so3.angle_between(rotation_from_rest, pin_rotation)
        rotation_error = float(residual.max(initial=0.0))
    elif joint.type not in _ROTATING_TYPES:
        residual = so3.angle_between(rotation_from_rest, so3.IDENTITY)
        rotation_error = float(residual.max(initial=0.0))
    if joint.type is JointType.PRISMATIC:
        coordinate = translation_from_rest @ joint_axis
        residual = translation_from_rest - coordinate[:, None] * joint_axis
        translation_error = float(np.abs(residual).max(initial=0.0))
    elif joint.type is JointType.FREE:
        translation_error = 0.0
    return JointMotion(
        rotation_from_rest,
        translation_from_rest,
        coordinate,
        rotation_error,
        translation_error,
        bool((rotation == np.array(joint.rotation)).all()),
        bool((translation == np.array(joint.translation)).all()),
    )


def _with_best_revolution(
    rig: Rig, motions: Sequence[JointMotion], j: int, tolerances: Tolerances
) -> JointMotion:
    """Return a pin's motion, shifted by full revolutions to fit its mimic joints."""
    joint, joint_motion = rig.joints[j], motions[j]
    mimic_joints = [
        (motions[i], mimic_joint.mimic, mimic_joint.type)
        for i, mimic_joint in enumerate(rig.joints)
        if mimic_joint.mimic is not None and mimic_joint.mimic.joint == joint.name
    ]

    def mismatch_cost(revolutions: int) -> tuple[bool, float, int]:
        """Return the sort key of a shift by full revolutions; smaller fits better."""
        angle = joint_motion.coordinate + 2 * np.pi * revolutions
        has_mismatch = False
        for motion, mimic, joint_type in mimic_joints:
            differences = motion.coordinate - (mimic.gain * angle + mimic.offset)
            is_pin = joint_type is JointType.PIN
            differences = _wrap_angles(differences) if is_pin else differences
            tolerance = tolerances.angle if is_pin else tolerances.length
            has_mismatch |= bool(np.abs(differences).max(initial=0.0) > tolerance)
        excess = 0.0
        if isinstance(joint.limits, RangeLimit):
            excess = float(np.abs(joint.limits.excess(angle)).max(initial=0.0))
        return has_mismatch, round(excess, 9), abs(revolutions)

    revolutions = min(range(-MAX_REVOLUTIONS, MAX_REVOLUTIONS + 1), key=mismatch_cost)
    coordinate = joint_motion.coordinate + 2 * np.pi * revolutions
    return replace(joint_motion, coordinate=coordinate)


def required_control_values(
    rig: Rig,
    motions: Sequence[JointMotion],
    targets: Set[str],
    initial_values: Mapping[str, FloatArray],
    tolerances: Tolerances,
) -> tuple[dict[str, FloatArray], set[str]]:
    """Return the values that controls must add to joints, and unreachable targets.

    The values ``(F or 1,)`` are by target. Targets are unreachable if their joints also
    move along axes that no control drives.
    """
    requested_by_target: dict[str, FloatArray] = {}
    unreachable_targets: set[str] = set()
    for target in sorted(targets):
        group, _, name = target.partition("/")
        if group != "joint":
            continue
        joint, part = split_part(name, DRIVEN_PARTS)
        motion = motions[rig.index(joint)]
        kind, _, axis = part.partition(".")
        if kind == "rotation":
            axis_targets = [f"joint/{joint}.rotation.{axis}" for axis in "xyz"]
            columns = [initial_values.get(part, np.zeros(1)) for part in axis_targets]
            initial_vector = np.stack(np.broadcast_arrays(*columns), -1)
            vector = _nearest_revolution(motion.rotation, initial_vector)
            requested_by_target[target] = vector[:, "xyz".index(axis)]
            other_axes = [i for i in range(3) if axis_targets[i] not in targets]
            if np.abs(vector[:, other_axes]).max(initial=0.0) > tolerances.angle:
                unreachable_targets.add(target)
        elif kind == "translation":
            requested_by_target[target] = motion.translation[:, "xyz".index(axis)]
        else:
            requested_by_target[target] = motion.coordinate
            is_unreachable = (
                motion.rotation_error > tolerances.angle
                if kind == "angle"
                else motion.translation_error > tolerances.length
            )
            if is_unreachable:
                unreachable_targets.add(target)
    return requested_by_target, unreachable_targets


def _nearest_revolution(rotation: FloatArray, initial_vector: FloatArray) -> FloatArray:
    """Return rotation vectors ``(n, 3)`` on the revolution nearest to a guess."""
    shortest_vector = so3.log(rotation)
    shortest_vector, initial_vector = np.broadcast_arrays(
        shortest_vector, initial_vector
    )
    vector_length = np.linalg.norm(shortest_vector, axis=1, keepdims=True)
    initial_length = np.linalg.norm(initial_vector, axis=1, keepdims=True)
    rotation_axis = np.where(vector_length > 1e-9, shortest_vector, initial_vector)
    rotation_axis = rotation_axis / np.maximum(
        np.linalg.norm(rotation_axis, axis=1, keepdims=True), 1e-300
    )
    guess_on_axis = (initial_vector * rotation_axis).sum(axis=1, keepdims=True)
    vector_on_axis = (shortest_vector * rotation_axis).sum(axis=1, keepdims=True)
    revolutions = np.round((guess_on_axis - vector_on_axis) / (2 * np.pi))
    return np.where(
        initial_length > np.pi / 2,
        shortest_vector + 2 * np.pi * revolutions * rotation_axis,
        shortest_vector,
    )


def joint_tracks(
    rig: Rig,
    motions: Sequence[JointMotion],
    control_values: Mapping[str, FloatArray],
    fitted_values: Mapping[str, FloatArray],
    tolerances: Tolerances,
) -> list[KeyTrack]:
    """Return key tracks of the joint motion that controls and mimics do not produce."""
    tracks_by_joint: dict[int, list[KeyTrack]] = {}
    coordinates_by_joint: dict[str, FloatArray] = {}
    mimic_indices = [j for j, joint in enumerate(rig.joints) if joint.mimic is not None]
    leader_indices = [j for j, joint in enumerate(rig.joints) if joint.mimic is None]
    for j in (*leader_indices, *mimic_indices):
        joint = rig.joints[j]
        keyed_joint = _KeyedJoint(
            joint, j, motions[j], control_values, fitted_values, tolerances
        )
        driven_value = keyed_joint.driven_values(COORDINATE_PARTS.get(joint.type, ""))
        if joint.mimic is not None:
            mimic = joint.mimic
            leader = coordinates_by_joint.get(mimic.joint, np.zeros(1))
            mimic_value = mimic.gain * leader + mimic.offset
            driven_value = mimic_value if mimic_value.any() else driven_value
        tracks_by_joint[j] = list(keyed_joint.key_tracks(driven_value))
        keyed_parts = {track.part for track in tracks_by_joint[j]}
        coordinates_by_joint[joint.name] = driven_value
        if keyed_parts & {"angle", "slide"}:
            coordinates_by_joint[joint.name] = motions[j].coordinate
        if keyed_parts & {"local_rotation", "local_translation"}:
            coordinates_by_joint[joint.name] = np.zeros(1)
    return [track for j in range(len(rig.joints)) for track in tracks_by_joint[j]]


@dataclass(frozen=True, slots=True)
class _KeyedJoint:
    """A joint whose motion beyond its controls is keyed."""

    joint: Joint
    index: int
    motion: JointMotion
    control_values: Mapping[str, FloatArray]
    fitted_values: Mapping[str, FloatArray]
    tolerances: Tolerances

    def driven_values(self, part: str, *, use_fitted: bool = False) -> FloatArray:
        """Return the controls' contribution to a part ``(F or 1,)``."""
        values_by_target = self.fitted_values if use_fitted else self.control_values
        return values_by_target.get(f"joint/{self.joint.name}.{part}", np.zeros(1))

    def driven_vectors(self, part: str, *, use_fitted: bool = False) -> FloatArray:
        """Return the controls' contribution to a vector part ``(F or 1, 3)``."""
        parts = [f"{part}.{axis}" for axis in "xyz"]
        columns = [self.driven_values(p, use_fitted=use_fitted) for p in parts]
        return np.stack(np.broadcast_arrays(*columns), axis=-1)

    def key_tracks(self, expected_coordinates: FloatArray) -> Iterator[KeyTrack]:
        """Yield the tracks, translation first; the coordinates are ``(F or 1,)``."""
        yield from self._translation_tracks(expected_coordinates)
        yield from self._rotation_tracks(expected_coordinates)

    @property
    def is_driven(self) -> bool:
        """Whether controls contribute to the joint."""
        target_prefix = f"joint/{self.joint.name}."
        return any(target.startswith(target_prefix) for target in self.control_values)

    def _translation_tracks(
        self, expected_coordinates: FloatArray
    ) -> Iterator[KeyTrack]:
        """Yield tracks of the slide or translation that controls do not produce."""
        motion, joint, tolerances = self.motion, self.joint, self.tolerances
        rest_translation = np.array(joint.translation)
        rest_rotation = np.array(joint.rotation)
        is_at_rest = motion.is_translation_at_rest
        if motion.translation_error > tolerances.length and not is_at_rest:
            offset = so3.rotate(rest_rotation, motion.translation)
            yield self._key_track(
                ChannelKind.TRANSLATION, "local_translation", rest_translation + offset
            )
        elif joint.type is JointType.PRISMATIC:
            unexplained_motion = motion.coordinate - expected_coordinates
            if self._needs_keys(unexplained_motion, tolerances.length, is_at_rest):
                driven_part = self.driven_values("slide", use_fitted=True)
                driven_vector = driven_part[:, None] * np.array(joint.axis)
                yield self._key_track(
                    ChannelKind.TRANSLATION,
                    "slide",
                    (motion.coordinate - driven_part)[:, None],
                    rest_translation + so3.rotate(rest_rotation, driven_vector),
                )
        elif joint.type is JointType.FREE:
            unexplained_motion = motion.translation - self.driven_vectors("translation")
            if self._needs_keys(unexplained_motion, tolerances.length, is_at_rest):
                driven_part = self.driven_vectors("translation", use_fitted=True)
                yield self._key_track(
                    ChannelKind.TRANSLATION,
                    "translation",
                    motion.translation - driven_part,
                    rest_translation + so3.rotate(rest_rotation, driven_part),
                )

    def _rotation_tracks(self, expected_coordinates: FloatArray) -> Iterator[KeyTrack]:
        """Yield tracks of the angle or rotation that controls do not produce."""
        motion, joint, tolerances = self.motion, self.joint, self.tolerances
        rest_rotation = np.array(joint.rotation)
        is_at_rest = motion.is_rotation_at_rest
        if motion.rotation_error > tolerances.angle and not is_at_rest:
            local_rotation = so3.multiply(rest_rotation, motion.rotation)
            aligned_rotation = so3.align_signs(local_rotation)
            yield self._euler_track("local_rotation", aligned_rotation, None)
        elif joint.type is JointType.PIN:
            unexplained_angle = _wrap_angles(motion.coordinate - expected_coordinates)
            if self._needs_keys(unexplained_angle, tolerances.angle, is_at_rest):
                driven_part = self.driven_values("angle", use_fitted=True)
                driven_rotation = so3.from_axis_angle(joint.axis, driven_part)
                yield self._key_track(
                    ChannelKind.ROTATION,
                    "angle",
                    np.degrees(motion.coordinate - driven_part)[:, None],
                    so3.multiply(rest_rotation, driven_rotation),
                )
        elif joint.type in _ROTATING_TYPES:
            driven_rotation = so3.exp(self.driven_vectors("rotation"))
            unexplained_angle = so3.angle_between(driven_rotation, motion.rotation)
            if self._needs_keys(unexplained_angle, tolerances.angle, is_at_rest):
                driven_part = so3.exp(self.driven_vectors("rotation", use_fitted=True))
                inverse_driven_part = so3.conjugate(driven_part)
                keyed_rotation = so3.multiply(inverse_driven_part, motion.rotation)
                aligned_rotation = so3.align_signs(keyed_rotation)
                reference = so3.multiply(rest_rotation, driven_part)
                yield self._euler_track("rotation", aligned_rotation, reference)

    def _needs_keys(
        self, difference: FloatArray, tolerance: float, is_at_rest: bool
    ) -> bool:
        """Return whether a difference exceeds its tolerance, so that it needs keys."""
        if not self.is_driven and self.joint.mimic is None:
            return not is_at_rest
        return bool(np.abs(difference).max(initial=0.0) > tolerance)

    def _euler_track(
        self, part: str, rotations: FloatArray, reference: FloatArray | None
    ) -> KeyTrack:
        """Return a track of rotations as Euler angles [deg]."""
        order = euler_order(self.joint, rotations)
        samples = euler.from_quaternion(rotations, order)
        return self._key_track(ChannelKind.ROTATION, part, samples, reference, order)

    def _key_track(
        self,
        kind: ChannelKind,
        part: str,
        samples: FloatArray,
        reference: FloatArray | None = None,
        order: str | None = None,
    ) -> KeyTrack:
        """Return a track; constant samples are stored once."""
        joint = self.joint
        is_constant: BoolArray = (samples == samples[:1]).all()
        return KeyTrack(
            kind,
            self.index,
            order,
            np.ascontiguousarray(samples[:1] if is_constant else samples),
            part,
            reference,
            joint.rotation,
            joint.axis,
            None if self.is_driven else joint.limits,
        )


def _wrap_angles(angles: FloatArray) -> FloatArray:
    """Wrap angles to half a revolution on either side of 0 [rad]."""
    return np.asarray(angles - 2 * np.pi * np.round(angles / (2 * np.pi)))
