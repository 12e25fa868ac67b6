"""Character poses between frames, and the travel over a cycle."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from animtool.core.array_types import FloatArray
from animtool.core.record import dataclass
from animtool.edit.travel import FramePositions, vertical_twist
from animtool.maths import so3
from animtool.motion.motion import Channel, Motion
from animtool.rig.kinematics import (
    WorldTransforms,
    bind_rotations,
    forward_kinematics,
)
from animtool.rig.skeleton import Rig
from animtool.skin.character import CharacterMesh
from animtool.skin.deform import deform

# A root is stationary if a cycle ends within this many steps of its start [1].
STATIONARY_STEPS = 2.0
# A cycle comes round if no joint's step over the seam is longer than this multiple of
# its longest other step [1], or than these: a fraction of the character's size [1], an
# angle [deg]. Fewer poses have no typical steps.
MAX_SEAM_RATIO, MIN_GAP, MIN_GAP_ANGLE, MIN_CYCLE_POSES = 2.0, 0.01, 3.0, 6
# Fractions of a cycle over which the seam residual is blended [1], and over which a
# cycle is steered to the last one [1].
SEAM_FRACTION, STEERED_FRACTION = 0.25, 0.5


@dataclass(frozen=True, slots=True, eq=False)
class LocalPose:
    """Local joint transforms and shape weights of one frame."""

    translations: FloatArray  # ``(J, 3)`` [m], parent space
    rotations: FloatArray  # ``(J, 4)``
    scales: FloatArray | None  # ``(J, 3)`` [1]; None is unscaled
    weights: FloatArray | None  # ``(S, 1)`` [1]; None if the take has none


@dataclass(frozen=True, slots=True, eq=False)
class PoseSamples:
    """World transforms and shape weights at K evenly spaced times in one frame."""

    world: WorldTransforms  # joint transforms
    # Shape weights ``(K, S)`` [1]; None without shapes.
    weights: FloatArray | None

    def deform(self, mesh: CharacterMesh) -> FloatArray:
        """Return the points of a mesh, deformed by shapes and skin ``(K, V, 3)``."""
        weights = None if self.weights is None else mesh.weights(self.weights)
        return deform(mesh.mesh, weights, self.world).points


def pose_at(motion: Motion, frame: int) -> LocalPose:
    """Return the local pose at a frame of a motion."""
    one_frame = motion.select(slice(frame, frame + 1))
    translations, rotations, scales = one_frame.dense()
    weights = one_frame.weights
    return LocalPose(
        translations[0],
        rotations[0],
        None if scales is None else scales[0],
        None if weights is None else weights.dense()[0],
    )


def interpolate_poses(
    rig: Rig, before: LocalPose, after: LocalPose, step_count: int
) -> PoseSamples:
    """Return the poses of a character at evenly spaced times between two poses.

    Local rotations are interpolated by slerp and other values linearly, as for motion
    blur.
    """
    fractions = np.arange(step_count + 1) / step_count
    frames = np.arange(step_count + 1) // step_count
    positions = FramePositions(frames, fractions - frames)

    def sample(first: FloatArray, last: FloatArray) -> FloatArray:
        channel = Channel.from_dense(np.stack([first, last]))
        return positions.interpolate(channel).dense()

    scales, weights = (
        None if a is None or b is None else sample(a, b)
        for a, b in ((before.scales, after.scales), (before.weights, after.weights))
    )
    translations = sample(before.translations, after.translations)
    rotations = sample(before.rotations, after.rotations)
    world = forward_kinematics(rig, translations, rotations, scales)
    return PoseSamples(world, None if weights is None else weights[..., 0])


def extrapolate_roots(
    rig: Rig, first: LocalPose, second: LocalPose, frames: float
) -> LocalPose:
    """Extrapolate the pose ``frames`` before the first, with constant root velocity."""
    translations = first.translations.copy()
    roots = np.array(rig.roots)
    step = second.translations[roots] - first.translations[roots]
    translations[roots] -= frames * step
    return LocalPose(translations, first.rotations, first.scales, first.weights)


def bind_around(rig: Rig, pose: LocalPose, joint: int) -> LocalPose:
    """Return a pose with the bind rotations, except of a joint and its ancestors."""
    rotations, kept_joints = bind_rotations(rig), rig.upwards(joint)
    rotations[kept_joints] = pose.rotations[kept_joints]
    return replace(pose, rotations=rotations)


def ease_rotations(
    before: LocalPose, after: LocalPose, step_count: int
) -> Iterator[LocalPose]:
    """Yield poses from one to another that differs in rotations, ``step_count + 1``."""
    for fraction in np.arange(step_count + 1) / step_count:
        weight = fraction * fraction * (3 - 2 * fraction)
        rotations = so3.slerp(before.rotations, after.rotations, weight)
        yield replace(after, rotations=rotations)


@dataclass(frozen=True, slots=True, eq=False)
class CycleShift:
    """Displacement of a character over one cycle, along the ground."""

    shift: FloatArray  # translation after the rotation ``(3,)`` [m]
    rotation: FloatArray  # rotation about the up axis through the origin ``(4,)``


def cycle_travel(rig: Rig, poses: Sequence[LocalPose]) -> CycleShift:
    """Return the travel of a cycle, from its first two poses and its last two.

    The travel is zero if the first root returns to its start. Otherwise, the
    step from the last frame to the next cycle has the mean speed of both ends.
    """
    root, ends = rig.roots[0], (poses[0], poses[:2][-1], poses[-2:][0], poses[-1])
    first, second, second_last, last = (pose.translations[root] for pose in ends)
    start_step, end_step = second - first, last - second_last
    max_step = max(np.linalg.norm(start_step), np.linalg.norm(end_step))
    if np.linalg.norm(last - first) <= STATIONARY_STEPS * max_step + 1e-9:
        return CycleShift(np.zeros(3), so3.IDENTITY)
    rotations = [pose.rotations[root] for pose in ends]
    next_rotation = so3.multiply(
        rotations[3], so3.multiply(so3.conjugate(rotations[0]), rotations[1])
    )
    up = np.array(rig.up.vector)
    change = so3.multiply(next_rotation, so3.conjugate(rotations[0]))
    rotation = vertical_twist(change, up)
    goal = last + (end_step + so3.rotate(rotation, start_step)) / 2
    shift = goal - so3.rotate(rotation, first)
    return CycleShift(shift - float((shift * up).sum()) * up, rotation)


@dataclass(frozen=True, slots=True)
class CycleGap:
    """A take that is no cycle: how it gets from its last frame to the first."""

    joint: str  # joint whose step is out of proportion
    distance: float  # farthest distance of a joint in the last frame from the first [m]
    angle: float  # largest rotation of a joint from the last frame to the first [deg]
    step: float  # step of the joint to the next cycle, without its travel [m] or [deg]
    typical_step: float  # longest step of that joint within the cycle, likewise
    is_rotation: bool  # whether both steps are rotations


def cycle_gap(rig: Rig, poses: Sequence[LocalPose]) -> CycleGap | None:
    """Return the gap of a cycle that does not come round; None if it does.

    ``poses`` are those of the cycle, and the first one moved by `cycle_travel`.
    """
    if len(poses) < MIN_CYCLE_POSES:
        return None
    translations, rotations = (
        np.stack([getattr(pose, name) for pose in poses])
        for name in ("translations", "rotations")
    )
    world = forward_kinematics(rig, translations, rotations)
    positions = world.positions
    shifts = np.linalg.norm(np.diff(positions, axis=0), axis=-1)
    angles = np.degrees(so3.angle_between(rotations[:-1], rotations[1:]))
    min_shift = MIN_GAP * float(np.ptp(positions[0], axis=0).max())
    for steps, minimum in ((shifts, min_shift), (angles, MIN_GAP_ANGLE)):
        limits = np.maximum(MAX_SEAM_RATIO * steps[:-1].max(axis=0), minimum)
        ratios = steps[-1] / np.maximum(limits, np.finfo(float).tiny)
        joint = int(ratios.argmax())
        if ratios[joint] > 1.0:
            ends = np.linalg.norm(positions[-2] - positions[0], axis=-1)
            turns = so3.angle_between(rotations[-2], rotations[0])
            return CycleGap(
                rig.joints[joint].name,
                float(ends.max()),
                float(np.degrees(turns.max())),
                float(steps[-1, joint]),
                float(steps[:-1, joint].max()),
                steps is angles,
            )
    return None


def advance_cycle(rig: Rig, pose: LocalPose, travel: CycleShift) -> LocalPose:
    """Return a pose transformed by the travel of one cycle."""
    translations, rotations = pose.translations.copy(), pose.rotations.copy()
    roots = np.array(rig.roots)
    rotated_roots = so3.rotate(travel.rotation, translations[roots])
    translations[roots] = rotated_roots + travel.shift
    rotations[roots] = so3.multiply(travel.rotation, rotations[roots])
    return replace(pose, translations=translations, rotations=rotations)


def seam_weights(frames: int, seam_fraction: float = SEAM_FRACTION) -> FloatArray:
    """Return the weight of the seam correction for each frame ``(F,)``.

    The weight increases from 0 to 1 over a fraction of the cycle, at its end.

    >>> seam_weights(8).round(3).tolist()
    [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.5]
    """
    fractions = (np.arange(frames) / frames - 1 + seam_fraction) / seam_fraction
    fractions = np.clip(fractions, 0.0, 1.0)
    return np.asarray(fractions * fractions * (3 - 2 * fractions))
