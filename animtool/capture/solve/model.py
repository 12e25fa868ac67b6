"""A rig with markers: the IK problem of a marker solve, and its start poses."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from animtool.capture.templates.template import MarkerTemplate
from animtool.core.array_types import BoolArray, FloatArray, IntArray
from animtool.core.errors import Fault, OptionError
from animtool.core.record import dataclass
from animtool.ik.goals import GOAL_KINDS, Goal, Targets
from animtool.ik.problem import Problem, build
from animtool.ik.sub_rig import with_ball_joints
from animtool.maths import so3
from animtool.rig.joints import coordinate_slices, local_from_coordinates
from animtool.rig.kinematics import forward_kinematics, rest_world
from animtool.rig.skeleton import JointType, Rig

# Minimum number of markers that determine a rotation.
MIN_MARKERS = 3
# Weight of a marker for the root's pose falls by this factor with each joint between.
WEIGHT_FALLOFF = 0.3


@dataclass(frozen=True)
class MarkerProblem:
    """The IK problem of a capture: E markers on a rig whose poses have Q numbers."""

    problem: Problem  # a position goal for each marker
    template: MarkerTemplate  # template of these markers only, grouped by joint
    columns: IntArray  # column of each marker in the capture ``(E,)``
    joints: IntArray  # joint index of each marker ``(E,)``

    @property
    def rig(self) -> Rig:
        """The rig with a joint type assigned to every joint."""
        return self.problem.rig

    @property
    def offsets(self) -> FloatArray:
        """Offsets of the markers in their joints' frames ``(E, 3)`` [m]."""
        return self.template.offsets

    def targets(self, positions: FloatArray, noise: FloatArray) -> Targets:
        """Return IK targets for markers ``(F, E, 3)`` [m], weight 0 where they are NaN.

        noise: Standard deviation of each marker at weight 1 ``(E,)`` [m].
        """
        is_visible = visibility_mask(positions)
        weights = np.zeros((*is_visible.shape, len(GOAL_KINDS)))
        weights[:, :, 0] = (
            is_visible * self.template.weights * self.problem.length / noise
        )
        return Targets(
            np.where(is_visible[:, :, None], positions, 0.0), weights=weights
        )

    def start_poses(self, positions: FloatArray) -> FloatArray:
        """Return rest poses ``(F, Q)`` rigidly aligned to markers ``(F, E, 3)``.

        Markers near the root have the largest weights. Without a single free root, the
        rest pose is not moved.
        """
        rig = self.rig
        coordinates = np.zeros((len(positions), self.problem.coordinates))
        slice_by_joint = coordinate_slices(rig)
        for joint_columns, joint in zip(slice_by_joint, rig.joints, strict=True):
            if joint.type in {JointType.BALL, JointType.FREE}:
                coordinates[:, joint_columns.stop - 1] = 1.0
        roots = [j for j in rig.roots if rig.joints[j].type is JointType.FREE]
        if len(roots) != 1:
            return coordinates
        root = roots[0]
        depths = np.array([len(rig.upwards(j)) for j in self.joints])
        joint_weights = WEIGHT_FALLOFF ** (depths - depths.min())
        is_visible = visibility_mask(positions)
        rotation, translation = fit_rigid_motions(
            self.points(coordinates[:1])[0],
            np.where(is_visible[:, :, None], positions, 0.0),
            is_visible * joint_weights * self.template.weights,
        )
        rest_pose = rest_world(rig)
        rest_position = rest_pose.positions[0, root]
        rest_rotation = rest_pose.rotations[0, root]
        # world = T(rest) R(rest) motion: the remaining rotation.
        world_rotation = so3.multiply(rotation, rest_rotation)
        world_position = so3.rotate(rotation, rest_position) + translation
        inverse_rest = so3.conjugate(rest_rotation)
        joint_columns = slice_by_joint[root]
        coordinates[:, joint_columns.start : joint_columns.start + 3] = so3.rotate(
            inverse_rest, world_position - rest_position
        )
        coordinates[:, joint_columns.start + 3 : joint_columns.stop] = so3.multiply(
            inverse_rest, world_rotation
        )
        return coordinates

    def points(self, coordinates: FloatArray) -> FloatArray:
        """Return the markers' world positions ``(F, E, 3)`` [m] in poses ``(F, Q)``."""
        local = local_from_coordinates(self.rig, coordinates)
        world = forward_kinematics(self.rig, local.translations, local.rotations)
        joint_matrices = world.linear[:, self.joints]
        rotated_offsets = np.einsum("feij,ej->fei", joint_matrices, self.offsets)
        return np.asarray(world.positions[:, self.joints] + rotated_offsets)

    def with_bones(self, rig: Rig, offsets: FloatArray) -> MarkerProblem:
        """Rebuild the problem with another rig and marker offsets ``(E, 3)`` [m]."""
        markers = tuple(
            replace(marker, offset=tuple(offset))
            for marker, offset in zip(
                self.template.markers, offsets.tolist(), strict=True
            )
        )
        return _build_problem(
            rig, replace(self.template, markers=markers), self.columns
        )


def build_marker_problem(
    rig: Rig, template: MarkerTemplate, columns: IntArray
) -> MarkerProblem:
    """Build the IK problem for the template's markers that a capture has.

    ``columns`` are the indices of the template's markers in the capture, -1 if missing.
    Joints without a type in the rig file rotate.
    """
    rig = with_ball_joints(rig)
    joints = template.joints(rig)
    used_markers = [
        m for m in range(len(columns)) if columns[m] >= 0 and template.weights[m] > 0
    ]
    if len(used_markers) < MIN_MARKERS:
        names = ", ".join(template.markers[m].name for m in used_markers)
        message = f"has {len(used_markers)} of the template's {len(columns)} markers: "
        message += f"{names}"
        hint = f"at least {MIN_MARKERS} are needed, with some on every limb"
        raise OptionError(Fault("SOL003", message, hint=hint))
    used_markers.sort(key=lambda m: int(joints[m]))
    markers = tuple(template.markers[m] for m in used_markers)
    return _build_problem(
        rig, replace(template, markers=markers), columns[used_markers]
    )


def _build_problem(
    rig: Rig, template: MarkerTemplate, columns: IntArray
) -> MarkerProblem:
    """Return the IK problem with a position goal for each marker."""
    goals = [Goal(marker.joint, marker.offset) for marker in template.markers]
    problem = build(rig, goals)
    return MarkerProblem(problem, template, columns, template.joints(rig))


def fit_rigid_motions(
    points: FloatArray, positions: FloatArray, weights: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return rotations ``(F, 4)`` and translations ``(F, 3)`` between point sets.

    The motions of points ``(E, 3)`` to positions ``(F, E, 3)`` minimise the sum of
    squared distances with weights ``(F, E)`` (W. Kabsch, 1976). If all weights are 0,
    the rotation is identity.
    """
    weight_sums = np.maximum(weights.sum(axis=1, keepdims=True), 1e-12)
    fractions = weights / weight_sums
    point_centre = fractions @ points
    position_centre = np.einsum("fe,fei->fi", fractions, positions)
    covariance = np.einsum(
        "fe,fei,fej->fij",
        fractions,
        points - point_centre[:, None],
        positions - position_centre[:, None],
    )
    inverse_rotation = so3.nearest_rotations(covariance)
    rotation = so3.from_matrix(np.swapaxes(inverse_rotation, 1, 2))
    return rotation, position_centre - so3.rotate(rotation, point_centre)


def visibility_mask(positions: FloatArray) -> BoolArray:
    """Return a mask ``(F, E)``, True where positions ``(F, E, 3)`` are not NaN."""
    return np.asarray(np.isfinite(positions).all(axis=2))
