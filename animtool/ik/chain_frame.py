"""Poses of a take as one IK problem over many frames.

A problem has one rig in which the joints above the goals' chains are fixed. In a take
those joints move, and joints may move in directions that their types do not allow.
Therefore the targets of each frame are transformed to the frame that carries the chain,
and motion outside the joint coordinates is stored in the rest pose.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from animtool.core.array_types import BoolArray, FloatArray
from animtool.core.errors import Fault, OptionError
from animtool.core.record import dataclass
from animtool.ik.goals import GOAL_KINDS, Goal, Targets, targets_of_frames
from animtool.ik.problem import build
from animtool.maths import so3
from animtool.motion.take import Take
from animtool.rig.driver_plan import plan_of
from animtool.rig.joints import (
    LocalTransforms,
    local_from_coordinates,
    project_to_coordinates,
)
from animtool.rig.kinematics import WorldTransforms
from animtool.rig.skeleton import Rig

# Transforms that differ by less are equal up to rounding [m], [rad].
EQUAL_TOLERANCE = 1e-9


@dataclass(frozen=True, slots=True)
class SolveSpan:
    """Consecutive frames that are solved on one rig."""

    rig: Rig  # its rest pose contains motion outside the joint coordinates
    frames: slice  # frames of the take
    coordinates: FloatArray  # coordinates of the source poses ``(N, Q)``
    # Positions of the frames above the chains ``(N, E, 3)`` [m].
    carrier_positions: FloatArray
    carrier_rotations: FloatArray  # rotations of these frames ``(N, E, 4)``

    def to_chain_frame(self, targets: Targets) -> Targets:
        """Return the span's targets in the carrier frame of its first pose."""
        inverse = so3.conjugate(self.carrier_rotations)
        rotation = so3.multiply(self.carrier_rotations[:1], inverse)
        span_targets = targets_of_frames(targets, self.frames)
        values_by_kind = {}
        for kind in GOAL_KINDS:
            values = np.asarray(getattr(span_targets, kind.targets_field))
            if kind.is_rotation:
                values_by_kind[kind.targets_field] = so3.multiply(rotation, values)
            else:
                offsets = so3.rotate(rotation, values - self.carrier_positions)
                positions = self.carrier_positions[:1] + offsets
                values_by_kind[kind.targets_field] = np.asarray(positions)
        return replace(span_targets, **values_by_kind)


@dataclass(frozen=True, slots=True)
class SolveSpans:
    """The frames of a take, divided into spans that are solved on one rig each."""

    spans: list[SolveSpan]  # one span, or one per frame if no rig fits all
    # Names of the joints and driver controls that prevent a single span.
    moving_between: tuple[str, ...]


def spans_of_take(
    rig: Rig,
    local: LocalTransforms,
    world: WorldTransforms,
    goals: Sequence[Goal],
    joints: Collection[str] | None,
    controls: Mapping[str, FloatArray] | None = None,
) -> SolveSpans:
    """Return the spans of a take's frames; each span is solved on one rig.

    ``controls``: values ``(F,)`` of the controls that joint drivers read.
    """
    coordinates = project_to_coordinates(rig, local)
    controls = controls or {}
    rig = with_controls(rig, controls, 0)
    problem = build(rig, goals, joints=joints, pose=coordinates[0])
    moving_joints = {rig.index(name) for name in problem.joints}
    goal_paths = [rig.upwards(rig.index(goal.joint)) for goal in goals]
    root_path_indices = [
        max(i for i, j in enumerate(path) if j in moving_joints) for path in goal_paths
    ]
    carrier_joints = [
        rig.parents[path[root_path_index]]
        for path, root_path_index in zip(goal_paths, root_path_indices, strict=True)
    ]
    path_joints = {
        j
        for path, root_path_index in zip(goal_paths, root_path_indices, strict=True)
        for j in path[: root_path_index + 1]
    }
    rest_poses = _effective_rest_poses(rig, local, coordinates)
    pivot_joints = path_joints - _rotation_joints(goals, goal_paths)
    is_changed = _is_translated(local), _is_rotated(local)
    leaves_joint_type = _is_translated(rest_poses) | _is_rotated(rest_poses)
    moving_between = [
        j
        for j in sorted(path_joints)
        if (leaves_joint_type[j] if j in moving_joints else is_changed[0][j])
        or (j not in moving_joints | pivot_joints and is_changed[1][j])
    ]
    moving_sources = _moving_sources(
        rig, moving_joints & path_joints, moving_joints, is_changed[0] | is_changed[1]
    )
    moving_between = sorted({*moving_between, *moving_sources})
    changing_controls = [
        name for name, values in controls.items() if (values != values[0]).any()
    ]
    frame_count = len(coordinates)
    if moving_between or changing_controls:
        spans = [slice(f, f + 1) for f in range(frame_count)]
    else:
        spans = [slice(0, frame_count)]
    positions, rotations = _carrier_transforms(world, carrier_joints)
    joints_above_goals = sorted({j for path in goal_paths for j in path})
    spans_of_frames = [
        SolveSpan(
            with_controls(
                _with_rest_pose(rig, rest_poses, span.start, joints_above_goals),
                controls,
                span.start,
            ),
            span,
            coordinates[span],
            positions[span],
            rotations[span],
        )
        for span in spans
    ]
    return SolveSpans(
        spans_of_frames, (*(rig.names[j] for j in moving_between), *changing_controls)
    )


def _moving_sources(
    rig: Rig, driven_joints: set[int], solved_joints: set[int], is_changed: BoolArray
) -> list[int]:
    """Return the unsolved joints that change over the frames and that drivers read."""
    if not rig.is_driven:
        return []
    plan = plan_of(rig)
    sources = {
        source
        for j in driven_joints.intersection(plan.joints)
        for source in plan.sources_of(j)
    }
    return [j for j in sources - solved_joints if is_changed[j]]


def with_controls(
    rig: Rig, control_values: Mapping[str, FloatArray], frame: int
) -> Rig:
    """Return a rig whose control defaults are set to the control values of a frame."""
    if not control_values:
        return rig
    controls = tuple(
        replace(control, default=float(control_values[control.name][frame]))
        if control.name in control_values
        else control
        for control in rig.controls
    )
    return replace(rig, controls=controls)


def _rotation_joints(goals: Sequence[Goal], paths: Sequence[Sequence[int]]) -> set[int]:
    """Return the joints whose rotation moves a goal, except joints at its point."""
    rotation_joints: set[int] = set()
    for goal, path in zip(goals, paths, strict=True):
        rotation_joints.update(path[1:] if goal.ignores_joint_rotation else path)
    return rotation_joints


def _effective_rest_poses(
    rig: Rig, local: LocalTransforms, coordinates: FloatArray
) -> LocalTransforms:
    """Return the rest poses with which the coordinates reproduce the local poses."""
    # local = rest · motion, so rest = local · motion⁻¹.
    modeled_poses = local_from_coordinates(rig, coordinates)
    inverse_rest = so3.conjugate(rig.rest_rotations)
    motion_rotations = so3.multiply(inverse_rest, modeled_poses.rotations)
    offsets = modeled_poses.translations - rig.rest_translations
    motion_translations = so3.rotate(inverse_rest, offsets)
    rotations = so3.multiply(local.rotations, so3.conjugate(motion_rotations))
    translations = local.translations - so3.rotate(rotations, motion_translations)
    return LocalTransforms(translations, rotations)


def _is_translated(local: LocalTransforms) -> BoolArray:
    """Return a mask of the joints whose translation changes over the frames."""
    displacement = np.abs(local.translations - local.translations[:1]).max(axis=(0, 2))
    return np.asarray(displacement > EQUAL_TOLERANCE, np.bool_)


def _is_rotated(local: LocalTransforms) -> BoolArray:
    """Return a mask of the joints whose rotation changes over the frames."""
    angles = so3.angle_between(local.rotations, local.rotations[:1]).max(axis=0)
    return np.asarray(angles > EQUAL_TOLERANCE, np.bool_)


def _with_rest_pose(
    rig: Rig, rest: LocalTransforms, frame: int, path_joints: Sequence[int]
) -> Rig:
    """Return the rig with its rest pose replaced by that of a frame, if different."""
    joints = list(rig.joints)
    for j in path_joints:
        translation, rotation = rest.translations[frame, j], rest.rotations[frame, j]
        is_translated = (
            np.abs(translation - rig.rest_translations[j]).max() > EQUAL_TOLERANCE
        )
        if (
            is_translated
            or so3.angle_between(rotation, rig.rest_rotations[j]) > EQUAL_TOLERANCE
        ):
            x, y, z = translation.tolist()
            a, b, c, w = rotation.tolist()
            joints[j] = replace(joints[j], translation=(x, y, z), rotation=(a, b, c, w))
    return rig if tuple(joints) == rig.joints else replace(rig, joints=tuple(joints))


def _carrier_transforms(
    world: WorldTransforms, joints: Sequence[int]
) -> tuple[FloatArray, FloatArray]:
    """Return joint positions ``(F, E, 3)`` and rotations; the identity for joint -1."""
    frame_count = len(world.positions)
    positions = np.zeros((frame_count, len(joints), 3))
    rotations = np.tile(so3.IDENTITY, (frame_count, len(joints), 1))
    for e, j in enumerate(joints):
        if j >= 0:
            positions[:, e] = world.positions[:, j]
            rotations[:, e] = so3.align_signs(so3.from_matrix(world.linear[:, j]))
    return positions, rotations


def check_scales(
    take: Take, effectors: Iterable[tuple[str, str]], path: Path | None = None
) -> None:
    """Raise if a joint above an effector is scaled: bone lengths must be constant."""
    channel = take.motion.scales
    if channel is None:
        return
    is_scaled = (channel.rest != 1.0).any(axis=1)
    is_scaled[channel.animated] |= (channel.values != 1.0).any(axis=(0, 2))
    fault_by_joint = {}
    path_text = None if path is None else str(path)
    for effector, joint in effectors:
        for j in take.rig.upwards(take.rig.index(joint)):
            if is_scaled[j]:
                name = take.rig.names[j]
                message = f"{effector!r} is below {name!r}, which is scaled"
                hint = "inverse kinematics needs joints without scale"
                fault_by_joint[name] = Fault("TGT016", message, path_text, (), hint)
    if fault_by_joint:
        raise OptionError(list(fault_by_joint.values()))
