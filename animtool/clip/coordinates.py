"""Joint motion relative to rest, less what controls drive."""

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

# Revolutions to try for a pin's first angle.
MAX_REVOLUTIONS = 3
_COORDINATE = {JointType.PIN: "angle", JointType.PRISMATIC: "slide"}
_TURNING = {JointType.FREE, JointType.BALL}


@dataclass(frozen=True, slots=True)
class Same:
    """Differences below which no keys are needed [rad], [m], [1]."""

    angle: float
    length: float
    weight: float

    def of(self, target: str) -> float:
        """Return the tolerance of a control's target.

        >>> Same(1e-6, 1e-7, 1e-8).of("joint/hips.translation.x")
        1e-07
        """
        if target.startswith("shape/"):
            return self.weight
        part = split_part(target, DRIVEN_PARTS)[1]
        lengths = part == "slide" or part.startswith("translation")
        return self.length if lengths else self.angle


@dataclass(frozen=True, slots=True)
class JointMotion:
    """Motion of a joint relative to rest: n = F frames, or 1 if static."""

    rotation: FloatArray  # ``(n, 4)``, signs continuous
    shift: FloatArray  # ``(n, 3)`` [m]
    # Of a pin [rad], continuous, or of a prismatic joint [m] ``(n,)``, else 0.
    coordinate: FloatArray
    # Largest rotation that the joint's type does not allow [rad].
    rotation_error: float
    shift_error: float  # likewise of the shift [m]
    rotation_rests: bool  # the local rotation is that of rest, to the last digit
    shift_rests: bool  # the local translation is


def joint_motions(rig: Rig, motion: Motion, same: Same) -> list[JointMotion]:
    """Return the motion of every joint relative to rest.

    Revolutions of a pin's angle are chosen to keep it within its limits and agree
    with its mimic joints.
    """
    moves = [set(c.animated.tolist()) for c in (motion.translations, motion.rotations)]
    motions = []
    for j, joint in enumerate(rig.joints):
        at = np.array([j])
        local = [
            channel.gather(at)[:, 0] if j in moving else channel.rest[at]
            for channel, moving in zip(
                (motion.translations, motion.rotations), moves, strict=True
            )
        ]
        motions.append(_joint_motion(joint, local[0], local[1]))
    for j, joint in enumerate(rig.joints):
        if joint.type is JointType.PIN:
            motions[j] = _on_nearest_revolution(rig, motions, j, same)
    return motions


def _joint_motion(
    joint: Joint, translation: FloatArray, rotation: FloatArray
) -> JointMotion:
    undo = so3.conjugate(joint.rotation)
    relative = so3.align_signs(so3.multiply(undo, rotation))
    shift = so3.rotate(undo, translation - np.array(joint.translation))
    axis = np.array(joint.axis)
    coordinate = np.zeros(1)
    rotation_error, shift_error = 0.0, float(np.abs(shift).max(initial=0.0))
    if joint.type is JointType.PIN:
        coordinate = np.unwrap(2.0 * np.arctan2(relative[:, :3] @ axis, relative[:, 3]))
        coordinate = coordinate - 2 * np.pi * np.round(coordinate[:1] / (2 * np.pi))
        left = so3.angle_between(relative, so3.from_axis_angle(axis, coordinate))
        rotation_error = float(left.max(initial=0.0))
    elif joint.type not in _TURNING:
        rotation_error = float(
            so3.angle_between(relative, so3.IDENTITY).max(initial=0.0)
        )
    if joint.type is JointType.PRISMATIC:
        coordinate = shift @ axis
        left = shift - coordinate[:, None] * axis
        shift_error = float(np.abs(left).max(initial=0.0))
    elif joint.type is JointType.FREE:
        shift_error = 0.0
    return JointMotion(
        relative,
        shift,
        coordinate,
        rotation_error,
        shift_error,
        bool((rotation == np.array(joint.rotation)).all()),
        bool((translation == np.array(joint.translation)).all()),
    )


def _on_nearest_revolution(
    rig: Rig, motions: Sequence[JointMotion], j: int, same: Same
) -> JointMotion:
    """Return a pin's motion with its angle on the likeliest revolution."""
    joint, joint_motion = rig.joints[j], motions[j]
    led = [
        (motions[i], follower.mimic, follower.type)
        for i, follower in enumerate(rig.joints)
        if follower.mimic is not None and follower.mimic.joint == joint.name
    ]

    def misfit_cost(revolutions: int) -> tuple[bool, float, int]:
        angle = joint_motion.coordinate + 2 * np.pi * revolutions
        astray = False
        for motion, mimic, kind in led:
            off = motion.coordinate - (mimic.gain * angle + mimic.offset)
            pin = kind is JointType.PIN
            off = _wrapped(off) if pin else off
            most = same.angle if pin else same.length
            astray = astray or bool(np.abs(off).max(initial=0.0) > most)
        excess = 0.0
        if isinstance(joint.limits, RangeLimit):
            excess = float(np.abs(joint.limits.excess(angle)).max(initial=0.0))
        return astray, round(excess, 9), abs(revolutions)

    revolutions = min(range(-MAX_REVOLUTIONS, MAX_REVOLUTIONS + 1), key=misfit_cost)
    return replace(
        joint_motion, coordinate=joint_motion.coordinate + 2 * np.pi * revolutions
    )


def requested_of_joints(
    rig: Rig,
    motions: Sequence[JointMotion],
    targets: Set[str],
    near: Mapping[str, FloatArray],
    same: Same,
) -> tuple[dict[str, FloatArray], set[str]]:
    """Return what controls must add to joints, and the unreachable targets.

    Returns target values ``(F or 1,)``, and the targets of joints that also
    move along axes that no control drives.
    """
    requested: dict[str, FloatArray] = {}
    keyed: set[str] = set()
    for target in sorted(targets):
        group, _, name = target.partition("/")
        if group != "joint":
            continue
        joint, part = split_part(name, DRIVEN_PARTS)
        motion = motions[rig.index(joint)]
        kind, _, axis = part.partition(".")
        if kind == "rotation":
            parts = [f"joint/{joint}.rotation.{axis}" for axis in "xyz"]
            thought = [near.get(part, np.zeros(1)) for part in parts]
            vector = _near(motion.rotation, np.stack(np.broadcast_arrays(*thought), -1))
            requested[target] = vector[:, "xyz".index(axis)]
            spare = [i for i in range(3) if parts[i] not in targets]
            if np.abs(vector[:, spare]).max(initial=0.0) > same.angle:
                keyed.add(target)
        elif kind == "translation":
            requested[target] = motion.shift[:, "xyz".index(axis)]
        else:
            requested[target] = motion.coordinate
            off = motion.rotation_error > same.angle if kind == "angle" else False
            if off or (kind == "slide" and motion.shift_error > same.length):
                keyed.add(target)
    return requested, keyed


def _near(rotation: FloatArray, thought: FloatArray) -> FloatArray:
    """Return rotation vectors ``(n, 3)`` on the revolution nearest to a guess."""
    vector = so3.log(rotation)
    vector, thought = np.broadcast_arrays(vector, thought)
    length = np.linalg.norm(vector, axis=1, keepdims=True)
    size = np.linalg.norm(thought, axis=1, keepdims=True)
    axis = np.where(length > 1e-9, vector, thought)
    axis = axis / np.maximum(np.linalg.norm(axis, axis=1, keepdims=True), 1e-300)
    along = (thought * axis).sum(axis=1, keepdims=True)
    start = (vector * axis).sum(axis=1, keepdims=True)
    revolutions = np.round((along - start) / (2 * np.pi))
    return np.where(size > np.pi / 2, vector + 2 * np.pi * revolutions * axis, vector)


def joint_tracks(
    rig: Rig,
    motions: Sequence[JointMotion],
    driven: Mapping[str, FloatArray],
    fitted: Mapping[str, FloatArray],
    same: Same,
) -> list[KeyTrack]:
    """Return tracks of joint motion beyond controls and mimics."""
    tracks: dict[int, list[KeyTrack]] = {}
    coordinates: dict[str, FloatArray] = {}
    last = [j for j, joint in enumerate(rig.joints) if joint.mimic is not None]
    first = [j for j, joint in enumerate(rig.joints) if joint.mimic is None]
    for j in (*first, *last):
        joint = rig.joints[j]
        one = _OneJoint(joint, j, motions[j], driven, fitted, same)
        expected = one.driven(_COORDINATE.get(joint.type, ""))
        if joint.mimic is not None:
            mimic = joint.mimic
            leader = coordinates.get(mimic.joint, np.zeros(1))
            followed = mimic.gain * leader + mimic.offset
            expected = followed if followed.any() else expected
        tracks[j] = list(one.tracks(expected))
        parts = {track.part for track in tracks[j]}
        coordinates[joint.name] = (
            np.zeros(1)
            if "local_rotation" in parts or "local_translation" in parts
            else motions[j].coordinate
            if parts & {"angle", "slide"}
            else expected
        )
    return [track for j in range(len(rig.joints)) for track in tracks[j]]


@dataclass(frozen=True, slots=True)
class _OneJoint:
    """A joint to key."""

    joint: Joint
    index: int
    motion: JointMotion
    stated: Mapping[str, FloatArray]
    fitted: Mapping[str, FloatArray]
    same: Same

    def driven(self, part: str, *, fitted: bool = False) -> FloatArray:
        """Return the controls' contribution to a part ``(F or 1,)``."""
        source = self.fitted if fitted else self.stated
        return source.get(f"joint/{self.joint.name}.{part}", np.zeros(1))

    def vector(self, part: str, *, fitted: bool = False) -> FloatArray:
        """Return the controls' contribution to a vector part ``(F or 1, 3)``."""
        columns = [self.driven(f"{part}.{axis}", fitted=fitted) for axis in "xyz"]
        return np.stack(np.broadcast_arrays(*columns), axis=-1)

    def tracks(self, expected: FloatArray) -> Iterator[KeyTrack]:
        """Yield the tracks, translation first: ``expected`` ``(F or 1,)``."""
        yield from self._shift(expected)
        yield from self._rotation_tracks(expected)

    def _shift(self, expected: FloatArray) -> Iterator[KeyTrack]:
        motion, joint, same = self.motion, self.joint, self.same
        rest_t, rest_r = np.array(joint.translation), np.array(joint.rotation)
        if motion.shift_error > same.length and not motion.shift_rests:
            local = rest_t + so3.rotate(rest_r, motion.shift)
            yield self._track(ChannelKind.TRANSLATION, "local_translation", local)
        elif joint.type is JointType.PRISMATIC:
            off = motion.coordinate - expected
            if self._differs(off, same.length, rests=motion.shift_rests):
                before = self.driven("slide", fitted=True)
                yield self._track(
                    ChannelKind.TRANSLATION,
                    "slide",
                    (motion.coordinate - before)[:, None],
                    rest_t + so3.rotate(rest_r, before[:, None] * np.array(joint.axis)),
                )
        elif joint.type is JointType.FREE:
            added = self.vector("translation")
            off = motion.shift - added
            if self._differs(off, same.length, rests=motion.shift_rests):
                before = self.vector("translation", fitted=True)
                yield self._track(
                    ChannelKind.TRANSLATION,
                    "translation",
                    motion.shift - before,
                    rest_t + so3.rotate(rest_r, before),
                )

    def _rotation_tracks(self, expected: FloatArray) -> Iterator[KeyTrack]:
        motion, joint, same = self.motion, self.joint, self.same
        rest = np.array(joint.rotation)
        if motion.rotation_error > same.angle and not motion.rotation_rests:
            local = so3.align_signs(so3.multiply(rest, motion.rotation))
            yield self._euler("local_rotation", local, None)
        elif joint.type is JointType.PIN:
            off = _wrapped(motion.coordinate - expected)
            if self._differs(off, same.angle, rests=motion.rotation_rests):
                before = self.driven("angle", fitted=True)
                yield self._track(
                    ChannelKind.ROTATION,
                    "angle",
                    np.degrees(motion.coordinate - before)[:, None],
                    so3.multiply(rest, so3.from_axis_angle(joint.axis, before)),
                )
        elif joint.type in _TURNING:
            added = so3.exp(self.vector("rotation"))
            off = so3.angle_between(added, motion.rotation)
            if self._differs(off, same.angle, rests=motion.rotation_rests):
                before = so3.exp(self.vector("rotation", fitted=True))
                keyed = so3.align_signs(
                    so3.multiply(so3.conjugate(before), motion.rotation)
                )
                yield self._euler("rotation", keyed, so3.multiply(rest, before))

    def _differs(self, off: FloatArray, same: float, *, rests: bool) -> bool:
        """Return whether a coordinate needs keys."""
        name = f"joint/{self.joint.name}."
        driven = any(target.startswith(name) for target in self.stated)
        if not driven and self.joint.mimic is None:
            return not rests
        return bool(np.abs(off).max(initial=0.0) > same)

    def _euler(
        self, part: str, rotations: FloatArray, before: FloatArray | None
    ) -> KeyTrack:
        order = euler_order(self.joint, rotations)
        samples = euler.from_quaternion(rotations, order)
        return self._track(ChannelKind.ROTATION, part, samples, before, order)

    def _track(
        self,
        kind: ChannelKind,
        part: str,
        samples: FloatArray,
        before: FloatArray | None = None,
        order: str | None = None,
    ) -> KeyTrack:
        joint = self.joint
        constant: BoolArray = (samples == samples[:1]).all()
        name = f"joint/{joint.name}."
        alone = not any(target.startswith(name) for target in self.stated)
        return KeyTrack(
            kind,
            self.index,
            order,
            np.ascontiguousarray(samples[:1] if constant else samples),
            part,
            before,
            joint.rotation,
            joint.axis,
            joint.limits if alone else None,
        )


def _wrapped(angles: FloatArray) -> FloatArray:
    return np.asarray(angles - 2 * np.pi * np.round(angles / (2 * np.pi)))
