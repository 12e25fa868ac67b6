"""Marker positions on a skeleton that is solved to the take."""

from __future__ import annotations

from dataclasses import field

import numpy as np

from animtool.capture.solve import SolveOptions, calibrate, solve_markers
from animtool.capture.templates.template import MarkerTemplate
from animtool.core.array_types import BoolArray, FloatArray, IntArray
from animtool.core.errors import Fault
from animtool.core.record import dataclass
from animtool.core.units import up_from_up
from animtool.maths import so3
from animtool.motion.markers import Markers
from animtool.rig.skeleton import JointType, Rig

# Drift of a marker in one second, if two other markers determine its joint, one on it
# and one below; if fewer do; and if none does [m].
DRIFT_PER_SECOND = (0.004, 0.008, 0.02)


@dataclass(frozen=True, slots=True)
class MarkerSubject:
    """The subject wearing the markers."""

    rig: Rig  # a rig of roughly the subject's build
    template: MarkerTemplate  # where the markers are on it, to a few centimetres
    # A take of the subject standing roughly in the rest pose; or None.
    static: Markers | None = None
    options: SolveOptions = field(default_factory=SolveOptions)  # how to solve


@dataclass(frozen=True, slots=True)
class SkeletonMarkers:
    """Positions over F frames of M markers fixed to the joints of a skeleton."""

    # ``(F, M, 3)`` [m], in the world of the take; NaN for markers that the template
    # lacks.
    positions: FloatArray
    # Rotations of the joints the markers are attached to ``(F, M, 3, 3)``.
    rotations: FloatArray
    origins: FloatArray  # origins of those joints ``(F, M, 3)`` [m]
    # Rotations of the parents of those joints ``(F, M, 3, 3)``.
    parent_rotations: FloatArray
    # Joint of each marker ``(M,)``; -1 for markers that the template lacks.
    joints: IntArray
    parent_of_joint: IntArray  # parent of each joint ``(J,)``; -1 for the root
    has_free_rotation: BoolArray  # which joints rotate about any axis ``(J,)``
    is_pose_determined: BoolArray  # frames with enough markers for the pose ``(F,)``
    notices: tuple[Fault, ...]  # notices of calibration and solve

    def is_predicted(self, marker: int, frames: slice) -> bool:
        """Return whether the skeleton predicts a marker in all given frames."""
        is_known = np.isfinite(self.positions[frames, marker]).all()
        return bool(is_known and self.is_pose_determined[frames].all())

    def has_parent(self, marker: int) -> bool:
        """Return whether a marker is on a joint of the skeleton that has a parent."""
        joint = int(self.joints[marker])
        return joint >= 0 and int(self.parent_of_joint[joint]) >= 0

    def markers_on_joint(self, marker: int, is_visible: BoolArray) -> list[int]:
        """Return the other markers of a mask ``(M,)`` on the same joint as a marker."""
        is_on_joint = (self.joints == self.joints[marker]) & is_visible
        is_on_joint[marker] = False
        return [int(other_marker) for other_marker in np.flatnonzero(is_on_joint)]

    def drift_speed(self, marker: int, is_visible: BoolArray) -> float:
        """Return the speed of a marker's drift from its skeleton position [m/s].

        Other visible markers determine its joint: three on it or below, or one if it is
        a hinge. With fewer, more of its pose is guessed.
        """
        joint = int(self.joints[marker])
        same_joint_count = len(self.markers_on_joint(marker, is_visible))
        visible_joints = self.joints[is_visible & (self.joints >= 0)]
        lower_joint_count = int((self.parent_of_joint[visible_joints] == joint).sum())
        if same_joint_count >= 2 or (
            not self.has_free_rotation[joint] and same_joint_count + lower_joint_count
        ):
            return 0.0
        if same_joint_count and lower_joint_count:
            return DRIFT_PER_SECOND[0]
        return DRIFT_PER_SECOND[1 if same_joint_count or lower_joint_count > 1 else 2]


def solve_skeleton_markers(markers: Markers, subject: MarkerSubject) -> SkeletonMarkers:
    """Solve a subject's skeleton to a take; return its markers as fixed to the joints.

    Bones and offsets are calibrated to the take, then its poses are solved.
    """
    rig, template, options = subject.rig, subject.template, subject.options
    calibration = calibrate(
        markers, rig, template, static=subject.static, options=options
    )
    solve = solve_markers(markers, calibration.rig, calibration.template, options)
    take = solve.take()
    world, model = take.world(), solve.model
    rotated_offsets = np.einsum(
        "feij,ej->fei", world.linear[:, model.joints], model.offsets
    )
    parent_of_joint = np.asarray(model.rig.parents, np.int64)
    take_from_rig = up_from_up(model.rig.up, markers.up)
    marker_count = len(markers.names)

    def to_take_axes(
        points: FloatArray, rotations: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Convert to the take's axes, with an entry for each marker of the take."""
        if take_from_rig is not None:
            inverse_rotation = so3.conjugate(np.array(take_from_rig))
            points = so3.rotate(inverse_rotation, points)
            rotations = so3.multiply(inverse_rotation, rotations)
        return (
            _to_all_markers(points, model.columns, marker_count),
            _to_all_markers(so3.to_matrix(rotations), model.columns, marker_count),
        )

    joint_positions = world.positions[:, model.joints]
    positions, matrices = to_take_axes(
        joint_positions + rotated_offsets, world.rotations[:, model.joints]
    )
    parents = np.maximum(parent_of_joint[model.joints], 0)
    origins, parent_matrices = to_take_axes(
        joint_positions, world.rotations[:, parents]
    )
    joints = np.full(marker_count, -1)
    joints[model.columns] = model.joints
    is_pose_determined = np.ones(len(markers), np.bool_)
    is_pose_determined[solve.score.sparse] = False
    notices = (*calibration.notices, *solve.notices)
    restricted_types = {JointType.PIN, JointType.FIXED, JointType.PRISMATIC}
    has_free_rotation = np.array(
        [joint.type not in restricted_types for joint in model.rig.joints]
    )
    return SkeletonMarkers(
        positions,
        matrices,
        origins,
        parent_matrices,
        joints,
        parent_of_joint,
        has_free_rotation,
        is_pose_determined,
        notices,
    )


def _to_all_markers(
    values: FloatArray, columns: IntArray, marker_count: int
) -> FloatArray:
    """Return values of all markers ``(F, M, …)`` from columns; others are NaN."""
    all_values = np.full((len(values), marker_count, *values.shape[2:]), np.nan)
    all_values[:, columns] = values
    return all_values
