"""Bone lengths and marker offsets of a subject, from a static and a motion take.

Bone scales s and marker offsets o are solved together with the poses of some frames:
reweighted Gauss-Newton, with the poses eliminated from each step (the Schur complement
of bundle adjustment: B. Triggs et al., Bundle adjustment, a modern synthesis, 2000,
section 6.1), and anthropometric priors.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import ClassVar

import numpy as np

from animtool import _kernels
from animtool.capture.options import SolveOptions
from animtool.capture.solve.model import (
    MIN_MARKERS,
    MarkerProblem,
    build_marker_problem,
    visibility_mask,
)
from animtool.capture.solve.run import check_units, positions_in_rig_axes
from animtool.capture.solve.sampling import (
    ROBUST_DEVIATIONS,
    fullest_frames,
    independent_poses,
    marker_residuals,
    residual_noise,
)
from animtool.capture.templates.match import match_markers
from animtool.capture.templates.template import MarkerTemplate
from animtool.core.array_types import FloatArray
from animtool.core.errors import Fault, Severity, listed, refuse, warning
from animtool.core.record import dataclass
from animtool.ik.chain import joint_steps
from animtool.ik.fit import FitOptions, fit
from animtool.ik.solving import pack_for_chain
from animtool.motion.markers import Markers
from animtool.rig.joints import local_from_coordinates
from animtool.rig.kinematics import forward_kinematics
from animtool.rig.sides import pair_sides
from animtool.rig.skeleton import JointType, Pose, Rig

# Frames sampled of the motion and of the static take.
MOTION_FRAMES, STATIC_FRAMES = 120, 10
# Standard deviations of the priors: bone scales about the overall scale, that scale
# about 1, left bones about right ones [1], and markers about their template offsets,
# per axis [m].
BONE_DEVIATION, OVERALL_DEVIATION, SIDE_DEVIATION = 0.07, 0.25, 0.004
OFFSET_DEVIATION = 0.008
# Standard deviations of the pose about the rest pose, in the static take and in the
# motion, where no marker determines it [rad].
STATIC_POSE_DEVIATION, MOTION_POSE_DEVIATION = 0.08, 1.5
# Maximum number of steps, and the change of bones [1] and offsets [m] at convergence.
MAX_STEPS, CONVERGED_STEP = 25, 2e-4
# Initial noise with a generic template [m].
GENERIC_NOISE = 0.03
# Uncertainty of a bone's scale above which it is reported, relative to its prior.
UNCERTAIN_SCALE_RATIO = 0.5
# Minimum number of frames.
MIN_FRAMES = 10


@dataclass(frozen=True)
class Calibration:
    """A subject's calibrated rig and template, with scales and statistics.

    Attributes:
        rig: The rig with the subject's bones.
        template: The template with the subject's offsets.
        scales: Scale of the bone from its parent to each joint, relative to the input
            rig ``(J,)``.
        shifts: Shift of each marker from its offset ``(M,)`` [m]; NaN if the
            capture lacks it.
        noise: Standard deviation of markers per axis ``(E,)`` [m].
        rounds: Number of steps.
        frames: Number of frames used.
        converged: Whether the steps converged.
        notices: Warnings.
    """

    rig: Rig
    template: MarkerTemplate
    scales: FloatArray
    shifts: FloatArray
    noise: FloatArray
    rounds: int
    frames: int
    converged: bool
    notices: tuple[Fault, ...] = ()
    json_keys: ClassVar[str] = "rounds frames converged bones shifts=marker_shifts"

    @property
    def bones(self) -> dict[str, float]:
        """The scale of each joint's bone."""
        return dict(zip(self.rig.names, self.scales.tolist(), strict=True))

    @property
    def marker_shifts(self) -> dict[str, float]:
        """Distance of each marker from its offset in the template [m]."""
        return dict(zip(self.template.names, self.shifts.tolist(), strict=True))


def calibrate(
    markers: Markers,
    rig: Rig,
    template: MarkerTemplate,
    *,
    static: Markers | None = None,
    options: SolveOptions | None = None,
) -> Calibration:
    """Fit bone scales and marker offsets to a subject by least squares.

    Args:
        markers: A take in which every joint moves.
        rig: A rig of roughly the subject's build.
        template: Marker positions on the rig, to a few centimetres.
        static: A take of the subject standing roughly in the rest pose; it separates
            marker placement from joint rotation.
        options: Noise and subject.

    Raises:
        OptionError: As of `animtool.capture.solve.solve_markers`; or too few frames
            have enough markers (SOL006).

    Limits of the method: only the static take shows a marker's rotation about the axis
    of a bone whose joints the markers do not determine. Bones without markers scale
    with the others.
    """
    options = options or SolveOptions()
    solver = _CalibrationState(markers, rig, template, static, options)
    rounds, has_converged = solver.run()
    return solver.build_result(rounds, has_converged)


class _CalibrationState:
    """A calibration in progress: bone scales, marker offsets and noise."""

    def __init__(
        self,
        markers: Markers,
        rig: Rig,
        template: MarkerTemplate,
        static: Markers | None,
        options: SolveOptions,
    ) -> None:
        self.template, self.options = template, options
        match = match_markers(template, markers.names, options.subject)
        model = build_marker_problem(rig, template, match.columns)
        self.model = model.with_bones(rig_without_limits(model), model.offsets)
        self.source_rig = rig
        motion = positions_in_rig_axes(rig, markers)[:, self.model.columns]
        samples = [motion[fullest_frames(motion, MOTION_FRAMES)]]
        if static is not None:
            static_motion = self._to_model_order(
                positions_in_rig_axes(rig, static), static.names
            )
            samples.insert(
                0, static_motion[fullest_frames(static_motion, STATIC_FRAMES)]
            )
        self.static_count = 0 if static is None else len(samples[0])
        self.positions = np.concatenate(samples)
        if len(self.positions) < MIN_FRAMES:
            message = f"{len(self.positions)} frames have at least {MIN_MARKERS} "
            message += "markers"
            refuse("SOL006", message, hint=f"a calibration needs {MIN_FRAMES}")
        check_units(self.model, self.positions, self.model.template)
        # The joints whose bones scale independently: all but roots.
        self.bone_joints = [
            j
            for j, joint in enumerate(self.model.rig.joints)
            if joint.parent >= 0 and any(joint.translation)
        ]
        self.base_translations = self.model.rig.rest_translations
        self.initial_offsets = self.model.offsets
        self.scales = np.full(len(self.bone_joints), self._size_ratio())
        template_markers = self.model.template.markers
        self.is_fixed_offset = np.array([m.fixed for m in template_markers], np.bool_)
        marker_scales = np.where(self.is_fixed_offset, 1.0, self.scales[0])
        self.offsets = marker_scales[:, None] * self.initial_offsets
        self.noise = np.full(len(self.model.joints), max(GENERIC_NOISE, options.noise))
        self.scale_certainty = np.zeros(len(self.bone_joints))

    def _to_model_order(
        self, positions: FloatArray, names: tuple[str, ...]
    ) -> FloatArray:
        """Return another take's markers in the order of the model ``(F, E, 3)``."""
        match = match_markers(self.model.template, names, self.options.subject)
        ordered_positions = np.full((len(positions), len(match.columns), 3), np.nan)
        is_captured = match.columns >= 0
        ordered_positions[:, is_captured] = positions[:, match.columns[is_captured]]
        return ordered_positions

    def _size_ratio(self) -> float:
        """Return subject size over rig size in the static take; 1 without one."""
        if self.static_count == 0:
            return 1.0
        frames = self.positions[: self.static_count]
        rest_points = self.model.points(self.model.start_poses(frames))
        is_visible = visibility_mask(frames)[:, :, None]

        def spread(points: FloatArray) -> float:
            """Return the mean standard deviation of visible coordinates in a frame."""
            visible_points = np.where(is_visible, points, np.nan)
            return float(np.nanstd(visible_points, axis=1).mean())

        return min(max(spread(frames) / max(spread(rest_points), 1e-9), 0.2), 5.0)

    def run(self) -> tuple[int, bool]:
        """Iterate to convergence; return the step count and whether it converged."""
        self._rebuild_model()
        poses = independent_poses(self.model, self.positions, self.noise)
        for step_index in range(MAX_STEPS):
            poses = self._fit_poses(poses)
            step = self._solve_step(poses)
            scale_steps, offset_steps = np.split(step, [len(self.bone_joints)])
            self.scales = np.clip(self.scales + scale_steps, 0.1, 10.0)
            self.offsets = self.offsets + offset_steps.reshape(-1, 3)
            self._rebuild_model()
            if np.abs(step).max(initial=0) < CONVERGED_STEP:
                return step_index + 1, True
        return MAX_STEPS, False

    def _rebuild_model(self) -> None:
        """Set the model's bones and marker offsets to the current estimates."""
        rig, joints = self.model.rig, list(self.model.rig.joints)
        for j, scale in zip(self.bone_joints, self.scales.tolist(), strict=True):
            x, y, z = (scale * self.base_translations[j]).tolist()
            joints[j] = replace(joints[j], translation=(x, y, z))
        rig = replace(rig, joints=tuple(joints))
        self.model = self.model.with_bones(rig, self.offsets)

    def _fit_poses(self, poses: FloatArray) -> FloatArray:
        """Return poses fitted to the current bones, and update the noise."""
        options = FitOptions(1.0, math.inf, robust=ROBUST_DEVIATIONS, rounds=6)
        targets = self.model.targets(self.positions, self.noise)
        pose_fit = fit(self.model.problem, targets, poses, options, path=poses)
        residuals = marker_residuals(self.model, pose_fit.coordinates, self.positions)
        deviations = residual_noise(residuals, self.options.noise)
        # Halved at most: markers that are far off at first must not be rejected.
        self.noise = np.minimum(self.noise, np.maximum(deviations, self.noise / 2))
        return pose_fit.coordinates

    def _solve_step(self, poses: FloatArray) -> FloatArray:
        """Return the Gauss-Newton step of scales and offsets by Schur complement."""
        problem, model = self.model.problem, self.model
        targets = pack_for_chain(problem, model.targets(self.positions, self.noise))
        chain = problem.chain
        frame_count, dof_count = len(poses), problem.degrees
        _, residuals, jacobian, _ = _kernels.linearize_ik(
            *chain.kernel_arrays,
            starts=chain.from_rig(poses),
            targets=targets,
            steps=np.zeros((frame_count, dof_count)),
        )
        derivatives = self._marker_derivatives(poses)
        distances = np.linalg.norm(residuals.reshape(frame_count, -1, 3), axis=2)
        weights = np.repeat(1 / (1 + (distances / ROBUST_DEVIATIONS) ** 2), 3, axis=1)
        residuals = residuals * weights
        jacobian = jacobian * weights[:, :, None]
        derivatives = derivatives * weights[:, :, None]
        transposed_jacobian = np.swapaxes(jacobian, 1, 2)
        pose_matrix = transposed_jacobian @ jacobian
        pose_precision = np.full((frame_count, dof_count), MOTION_POSE_DEVIATION**-2.0)
        pose_precision[: self.static_count] = STATIC_POSE_DEVIATION**-2.0
        pose_matrix += np.eye(dof_count) * pose_precision[:, :, None]
        # Parameters and residuals with the poses eliminated.
        mixed_terms = transposed_jacobian @ derivatives
        eliminated_columns = np.linalg.solve(pose_matrix, mixed_terms)
        pose_gradient = transposed_jacobian @ residuals[:, :, None]
        pose_gradient -= (pose_precision * self._deviation_from_rest(poses))[:, :, None]
        pose_step = np.linalg.solve(pose_matrix, pose_gradient)
        shared_jacobian = derivatives.reshape(-1, derivatives.shape[2])
        mixed_terms = mixed_terms.reshape(-1, derivatives.shape[2])
        eliminated_columns = eliminated_columns.reshape(mixed_terms.shape)
        normal_matrix = (
            shared_jacobian.T @ shared_jacobian - mixed_terms.T @ eliminated_columns
        )
        gradient = shared_jacobian.T @ residuals.ravel()
        gradient = gradient - mixed_terms.T @ pose_step.ravel()
        prior_matrix, prior_gradient = self._prior_equations()
        bone_precision = np.diag(normal_matrix)[: len(self.bone_joints)]
        self.scale_certainty = bone_precision / (bone_precision + BONE_DEVIATION**-2.0)
        return np.linalg.solve(normal_matrix + prior_matrix, gradient + prior_gradient)

    def _deviation_from_rest(self, poses: FloatArray) -> FloatArray:
        """Return the deviation of poses from rest ``(F, D)``, root motion excluded."""
        chain = self.model.problem.chain
        start = chain.from_rig(self.model.start_poses(self.positions))
        coordinates = chain.from_rig(poses)
        deviation = joint_steps(chain, start, coordinates)
        # The root is free.
        deviation[:, : min(6, deviation.shape[1])] = 0.0
        return deviation

    def _marker_derivatives(self, poses: FloatArray) -> FloatArray:
        """Return the Jacobian of weighted marker positions ``(F, 3 E, B + 3 E)``."""
        model, rig = self.model, self.model.rig
        local = local_from_coordinates(rig, poses)
        world = forward_kinematics(rig, local.translations, local.rotations)
        frame_count, marker_count = len(poses), len(model.joints)
        derivatives = np.zeros(
            (frame_count, marker_count, 3, len(self.bone_joints) + 3 * marker_count)
        )
        is_above = np.zeros((marker_count, len(rig.joints)), np.bool_)
        for e, j in enumerate(model.joints.tolist()):
            is_above[e, rig.upwards(j)] = True
        for b, j in enumerate(self.bone_joints):
            vectors = world.linear[:, rig.joints[j].parent] @ self.base_translations[j]
            derivatives[:, is_above[:, j], :, b] += vectors
        for e, j in enumerate(model.joints.tolist()):
            first = len(self.bone_joints) + 3 * e
            if not model.template.markers[e].fixed:
                derivatives[:, e, :, first : first + 3] = world.linear[:, j]
        weights = model.template.weights / self.noise
        is_visible = visibility_mask(self.positions)
        derivatives *= (is_visible * weights)[:, :, None, None]
        return derivatives.reshape(frame_count, 3 * marker_count, -1)

    def _prior_equations(self) -> tuple[FloatArray, FloatArray]:
        """Return matrix and gradient of the priors on bone scales and offsets."""
        bone_count = len(self.bone_joints)
        parameter_count = bone_count + self.offsets.size
        matrix, gradient = (
            np.zeros((parameter_count, parameter_count)),
            np.zeros(parameter_count),
        )
        # Bones vary about an overall scale, which varies about 1 and is summed out.
        precision = np.eye(bone_count) / BONE_DEVIATION**2
        prior_sum = bone_count / BONE_DEVIATION**2 + OVERALL_DEVIATION**-2.0
        precision -= np.ones((bone_count, bone_count)) / BONE_DEVIATION**4 / prior_sum
        deviation = self.scales - 1.0
        matrix[:bone_count, :bone_count] = precision
        gradient[:bone_count] = -precision @ deviation
        for left_bone, right_bone in self._side_pairs():
            difference = self.scales[left_bone] - self.scales[right_bone]
            for bone, sign in ((left_bone, 1.0), (right_bone, -1.0)):
                matrix[bone, bone] += SIDE_DEVIATION**-2.0
                gradient[bone] -= sign * difference / SIDE_DEVIATION**2
            matrix[left_bone, right_bone] -= SIDE_DEVIATION**-2.0
            matrix[right_bone, left_bone] -= SIDE_DEVIATION**-2.0
        # Markers scale with their bones; the prior is on the remaining offset, d = A p.
        offset_map = np.zeros((self.offsets.size, parameter_count))
        offset_map[:, bone_count:] = np.eye(self.offsets.size)
        bone_weights = self._bone_weights()[:, None, :]
        offset_terms = bone_weights * self.initial_offsets[:, :, None]
        offset_terms = offset_terms.reshape(-1, bone_count)
        offset_map[:, :bone_count] = -offset_terms
        deviation = self.offsets.ravel() - offset_terms @ self.scales
        # Fixed markers do not scale with bones.
        is_fixed = np.repeat(self.is_fixed_offset, 3)
        offset_map[is_fixed, :bone_count] = 0.0
        deviation[is_fixed] = 0.0
        matrix += offset_map.T @ offset_map / OFFSET_DEVIATION**2
        gradient -= offset_map.T @ deviation / OFFSET_DEVIATION**2
        return matrix, gradient

    def _bone_weights(self) -> FloatArray:
        """Return the weight of each bone scale in a marker's offset scale ``(E, B)``.

        A joint scales with the bones that begin there; an end joint scales with the
        bone that ends there, else with all bones.
        """
        rig = self.model.rig
        joint_of_bone = np.array(self.bone_joints)
        parents = np.array([rig.joints[j].parent for j in self.bone_joints])
        weights = np.zeros((len(self.model.joints), len(self.bone_joints)))
        for e, j in enumerate(self.model.joints.tolist()):
            is_bone = parents == j if (parents == j).any() else joint_of_bone == j
            weights[e, is_bone if is_bone.any() else slice(None)] = 1.0
        return np.asarray(weights / weights.sum(axis=1, keepdims=True))

    def _side_pairs(self) -> list[tuple[int, int]]:
        """Return pairs of a left and a right bone, as indices of `bone_joints`."""
        rig = self.model.rig
        stated_pairs = [(j.name, j.mirror) for j in rig.joints if j.mirror]
        partners = pair_sides(rig.names, rig.parents, stated_pairs).partners
        bone_by_joint = {j: b for b, j in enumerate(self.bone_joints)}
        return [
            (bone_by_joint[j], bone_by_joint[k])
            for j, k in enumerate(partners.tolist())
            if j < k and j in bone_by_joint and k in bone_by_joint
        ]

    def build_result(self, rounds: int, has_converged: bool) -> Calibration:
        """Return the scaled rig, the template with new offsets, and warnings."""
        rig = self.model.rig
        scales = np.ones(len(rig.joints))
        scales[self.bone_joints] = self.scales
        offset_by_marker = {m.name: m.offset for m in self.model.template.markers}
        shifts = np.full(len(self.template.markers), np.nan)
        markers = list(self.template.markers)
        for i, marker in enumerate(markers):
            offset = offset_by_marker.get(marker.name)
            if offset is not None:
                shifts[i] = np.linalg.norm(np.subtract(offset, marker.offset))
                markers[i] = replace(marker, offset=offset)
        notices = []
        if not has_converged:
            message = f"the calibration did not converge in {MAX_STEPS} steps"
            hint = "a longer take, or a static one, gives more data"
            notices.append(warning("SOL104", message, hint))
        uncertain_bones = [
            rig.names[j]
            for j, certainty in zip(self.bone_joints, self.scale_certainty, strict=True)
            if certainty < UNCERTAIN_SCALE_RATIO
        ]
        if uncertain_bones:
            message = "no marker determines the length of these bones; they scale with "
            message += f"the others: {listed(uncertain_bones, 8)}"
            notices.append(Fault("SOL105", message, severity=Severity.NOTE))
        return Calibration(
            scale_rig_bones(self.source_rig, scales),
            replace(self.template, markers=tuple(markers), document=None),
            scales,
            shifts,
            self.noise,
            rounds,
            len(self.positions),
            has_converged,
            tuple(notices),
        )


def rig_without_limits(model: MarkerProblem) -> Rig:
    """Return a rig without limits on the hinges that enough markers determine.

    At its limit, a joint cannot distinguish a displaced marker from its own rotation.
    """
    rig = model.rig
    marker_counts = np.zeros(len(rig.joints), np.int64)
    for j in model.joints.tolist():
        marker_counts[rig.upwards(j)] += 1
    joints = tuple(
        replace(joint, limits=None)
        if joint.type is JointType.PIN and marker_count >= MIN_MARKERS
        else joint
        for joint, marker_count in zip(rig.joints, marker_counts.tolist(), strict=True)
    )
    return replace(rig, joints=joints)


def scale_rig_bones(rig: Rig, scales: FloatArray) -> Rig:
    """Scale the bone from its parent to each joint by ``(J,)``; meshes stay bound.

    The tip of a bone without a child joint scales with the joint's own bone.
    """
    joints, bind = [], dict(rig.bind)
    for joint, scale in zip(rig.joints, scales.tolist(), strict=True):
        x, y, z = (scale * value for value in joint.translation)
        tips = tuple((scale * a, scale * b, scale * c) for a, b, c in joint.tips)
        joints.append(replace(joint, translation=(x, y, z), tips=tips))
        if rig.meshes and joint.name not in bind and scale != 1.0:
            bind[joint.name] = Pose(joint.translation, joint.rotation)
    return replace(rig, joints=tuple(joints), bind=bind)
