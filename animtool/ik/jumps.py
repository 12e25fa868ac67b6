"""Finds joints that jump between two frames, compared with the source motion."""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar

import numpy as np

from animtool.core.array_types import BoolArray, FloatArray, IntArray
from animtool.core.record import dataclass
from animtool.maths import so3
from animtool.maths.pops import find_rotation_pops, find_translation_pops
from animtool.rig.joints import LocalTransforms

# A joint jumps if it moves by more than this [rad] or fraction of the chain's length,
# plus this per second; at low frame rates any rotation above the maximum is a jump.
MIN_JUMP, MIN_SPEED, MAX_ROTATION = 0.1, 8.0, 0.5
# Goals explain a step up to this multiple of their own motion, plus MIN_JUMP.
GOAL_MOTION_FACTOR = 2.0
# Slower jumps are reported if the joint moves this many times farther than within this
# many frames before and after.
NEIGHBOUR_FACTOR, NEIGHBOUR_COUNT = 4.0, 2
# Unpredicted slides, and noise [chain lengths]: half the thresholds of rule MOT202,
# since a chain may be longer than its rig at rest.
MIN_SLIDE, SLIDE_NOISE = 0.1, 0.001


@dataclass(frozen=True, slots=True)
class Jump:
    """A discontinuity: a joint moves much farther in a frame than in the source.

    Attributes:
        frame: Index of the frame after the jump.
        joint: Name of the joint.
        size: Rotation [rad] or slide [m] of the joint.
        source: The same in the source motion.
        slides: Whether the sizes are lengths.
        by_goals: Whether the goals move far enough in this frame to explain it.
    """

    frame: int
    joint: str
    size: float
    source: float = 0.0
    slides: bool = False
    by_goals: bool = False
    json_keys: ClassVar[str] = "frame joint unit size source by_goals"

    @property
    def unit(self) -> str:
        """Unit of ``size`` and ``source``: ``m`` for a slide, else ``rad``."""
        return "m" if self.slides else "rad"


def jump_threshold(fps: float) -> float:
    """Return the jump threshold of a frame: rotation [rad], slide [chain lengths]."""
    return min(MIN_JUMP + MIN_SPEED / fps, MAX_ROTATION)


def find_jumps(
    joint_names: Sequence[str],
    source_poses: LocalTransforms | None,
    solved_poses: LocalTransforms,
    goal_moves: FloatArray,
    *,
    fps: float,
    length: float,
    revolutions: FloatArray | None = None,
) -> tuple[Jump, ...]:
    """Return the jumps of joints, by frame and joint.

    A joint jumps where it rotates by more than `jump_threshold` beyond the source, or
    by more than .5 rad and .1 rad beyond it; where it starts from rest and stops in
    one step; and where the motion around a step does not predict it, as in rule MOT202.

    Args:
        joint_names: Names of the J joints.
        source_poses: The F source poses; None is a static source.
        solved_poses: The F solved poses.
        goal_moves: Motion of the goals from frame to frame ``(F - 1,)`` [rad], [chain
            lengths].
        fps: Frames a second.
        length: Length of the chain [m].
        revolutions: Full revolutions of joints between frames ``(F - 1, J)`` [rad],
            which quaternions do not show; None for none.
    """
    pose_count = len(solved_poses.rotations)
    if pose_count < 2:
        return ()
    moving_joints = _moving_joints(source_poses, solved_poses, revolutions)
    if not len(moving_joints):
        return ()
    joint_names = [joint_names[j] for j in moving_joints]
    solved_poses = _select_joints(solved_poses, moving_joints)
    if source_poses is not None:
        source_poses = _select_joints(source_poses, moving_joints)
    else:
        source_poses = LocalTransforms(
            solved_poses.translations[:1].repeat(pose_count, 0),
            solved_poses.rotations[:1].repeat(pose_count, 0),
        )
    is_cut_before = np.zeros(pose_count - 1, np.bool_)
    goal_steps = goal_moves[:, None]
    solved_steps = _rotation_steps(solved_poses.rotations)
    source_steps = _rotation_steps(source_poses.rotations)
    solved_angles = np.linalg.norm(solved_steps, axis=2)
    source_angles = np.linalg.norm(source_steps, axis=2)
    if revolutions is not None:
        solved_angles = solved_angles + revolutions[:, moving_joints]
    excess_steps = solved_angles - source_angles
    is_jump = (solved_angles > MAX_ROTATION) & (excess_steps > MIN_JUMP)
    is_jump |= excess_steps > jump_threshold(fps)
    is_jump |= _find_isolated_steps(excess_steps, goal_steps)
    is_pop = find_rotation_pops(solved_steps, 1.0 / fps, is_cut_before)[0]
    is_jump |= is_pop & ~find_rotation_pops(source_steps, 1.0 / fps, is_cut_before)[0]
    jumps = _jumps_at(joint_names, is_jump, solved_angles, source_angles, goal_steps)
    solved_steps = np.diff(solved_poses.translations, axis=0)
    source_steps = np.diff(source_poses.translations, axis=0)
    solved_sizes, source_sizes = (
        np.linalg.norm(steps, axis=2) / length for steps in (solved_steps, source_steps)
    )
    excess_steps = solved_sizes - source_sizes
    is_jump = excess_steps > jump_threshold(fps)
    is_jump |= _find_isolated_steps(excess_steps, goal_steps)
    pop_limits = (1.0 / fps, is_cut_before, MIN_SLIDE * length, SLIDE_NOISE * length)
    is_pop = find_translation_pops(solved_steps, *pop_limits)[0]
    is_jump |= is_pop & ~find_translation_pops(source_steps, *pop_limits)[0]
    jumps += _jumps_at(
        joint_names,
        is_jump,
        solved_sizes,
        source_sizes,
        goal_steps,
        chain_length=length,
    )
    return tuple(sorted(jumps, key=lambda jump: jump.frame))


def _moving_joints(
    source_poses: LocalTransforms | None,
    solved_poses: LocalTransforms,
    revolutions: FloatArray | None,
) -> IntArray:
    """Return the joints that move in the solved or the source motion."""
    is_moving = np.zeros(solved_poses.rotations.shape[1], np.bool_)
    for poses in (solved_poses, source_poses):
        if poses is not None:
            for values in (poses.rotations, poses.translations):
                is_moving |= (values != values[:1]).any(axis=(0, 2))
    if revolutions is not None:
        is_moving |= revolutions.any(axis=0)
    return np.asarray(np.flatnonzero(is_moving))


def _select_joints(poses: LocalTransforms, joints: IntArray) -> LocalTransforms:
    """Return the poses of the selected joints."""
    return LocalTransforms(poses.translations[:, joints], poses.rotations[:, joints])


def _rotation_steps(rotations: FloatArray) -> FloatArray:
    """Return rotation vectors from frame to frame ``(F - 1, J, 3)``."""
    return so3.log(so3.multiply(rotations[1:], so3.conjugate(rotations[:-1])))


def _find_isolated_steps(steps: FloatArray, goal_moves: FloatArray) -> BoolArray:
    """Return a mask of steps ``(F - 1, N)`` that far exceed the adjacent steps."""
    largest_neighbour = np.zeros_like(steps)
    for offset in range(1, NEIGHBOUR_COUNT + 1):
        earlier, later = largest_neighbour[:-offset], largest_neighbour[offset:]
        np.maximum(later, steps[:-offset], out=later)
        np.maximum(earlier, steps[offset:], out=earlier)
    goal_threshold = MIN_JUMP + GOAL_MOTION_FACTOR * goal_moves
    is_isolated = steps > np.maximum(
        NEIGHBOUR_FACTOR * largest_neighbour, goal_threshold
    )
    # The first and the last step have neighbours on one side only.
    is_isolated[:1] = is_isolated[-1:] = False
    return np.asarray(is_isolated, np.bool_)


def _jumps_at(
    joint_names: Sequence[str],
    is_jump: BoolArray,
    steps: FloatArray,
    source_steps: FloatArray,
    goal_moves: FloatArray,
    chain_length: float | None = None,
) -> list[Jump]:
    """Return the jumps at flagged steps ``(F - 1, J)``; slides if a length is given."""
    is_by_goals = steps - source_steps <= MIN_JUMP + GOAL_MOTION_FACTOR * goal_moves
    steps_and_joints: IntArray = np.argwhere(is_jump)
    return [
        Jump(
            int(t) + 1,
            joint_names[int(j)],
            float(steps[t, j]) * (chain_length or 1.0),
            float(source_steps[t, j]) * (chain_length or 1.0),
            chain_length is not None,
            bool(is_by_goals[t, j]) and bool(goal_moves[t, 0] > 0),
        )
        for t, j in steps_and_joints
    ]
