"""Fits sparse keys to a take."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from animtool.clip.clip import Clip
from animtool.clip.control_keys import (
    FittedControls,
    driven_pose,
    fit_controls,
    largest_weight_error,
    solve_take_controls,
    uncombined_weights_of,
)
from animtool.clip.coordinates import (
    COORDINATE_PARTS,
    JointMotion,
    Tolerances,
    joint_tracks,
    relative_joint_motions,
)
from animtool.clip.key_report import ChannelDeviation, channel_deviations, key_notices
from animtool.clip.reduction.keys import ChannelKind, Reduction, clip_of_reduction
from animtool.clip.reduction.points import (
    SHELL_DISTANCE,
    attached_points,
    joint_bounds,
    point_errors,
)
from animtool.clip.reduction.reduce import reduce_motion
from animtool.clip.reduction.tolerance import WEIGHT_TOLERANCE
from animtool.clip.reduction.tracks import (
    KeyTrack,
    additive_pose,
    find_tracks,
    sort_tracks,
)
from animtool.clip.sample import sample_channels, sample_values
from animtool.core.array_types import FloatArray
from animtool.core.errors import Fault
from animtool.core.record import dataclass
from animtool.motion.motion import Channel, Motion
from animtool.motion.take import Take
from animtool.rig.control_inverse import SolvedControls
from animtool.rig.controls import evaluate_controls
from animtool.rig.driver_plan import plan_of
from animtool.rig.kinematics import rest_size
from animtool.rig.shapes import combination_order
from animtool.rig.skeleton import Rig

# Rounding of float32 samples between joints and drivers [rad], [m], [1].
ANGLE_ROUNDING, LENGTH_ROUNDING, WEIGHT_ROUNDING = 2e-6, 1e-6, 1e-6
# Largest fraction of a tolerance for such rounding [1].
ROUNDING_FRACTION = 0.05
# Rounding to ten digits may exceed a tolerance by this fraction [1].
DIGIT_ROUNDING = 1e-6
# Maximum number of refinements of all keys, and the factor on their tolerance.
MAX_REFINEMENTS = 4
REFINEMENT_FACTOR = 0.5


@dataclass(frozen=True, slots=True)
class KeyedTake:
    """A clip of sparse keys, with its errors against the take."""

    clip: Clip  # clip of the sparse keys
    # Keys of the clip; their errors are those of the clip sampled on the rig.
    reduction: Reduction
    controls: tuple[str, ...]  # names of the rig's controls that have keys
    errors: tuple[ChannelDeviation, ...]  # largest error of each channel
    # Notes on controls, joint types and mimics that the take does not follow.
    notices: tuple[Fault, ...]


def fit_take_keys(
    take: Take,
    rig: Rig,
    name: str,
    tolerance: float,
    *,
    joint_tolerances: Mapping[str, float] | None = None,
    base: Take | None = None,
) -> KeyedTake:
    """Return a clip of sparse keys that reproduces a take.

    Controls are keyed if their values follow from their targets. Keys of joints and
    shapes hold what controls, mimics and combination shapes do not produce: an angle,
    slide, translation or rotation relative to rest, or the local transform if a joint
    moves beyond its type.

    The tolerances are the largest errors of joints [m], of all or by name or pattern.
    Controls of an additive take, one with a ``base``, stay at their defaults.
    """
    other_tolerances = joint_tolerances or {}
    bounds = joint_bounds(rig, tolerance, other_tolerances)
    smallest_tolerance = float(bounds.min()) if len(bounds) else tolerance
    rounding_tolerances = _rounding_differences(rig, smallest_tolerance)
    joint_motions = relative_joint_motions(rig, take.motion, rounding_tolerances)
    if base is None:
        solution = solve_take_controls(take, rig, joint_motions, rounding_tolerances)
    else:
        frame_count = take.motion.frames
        default_values = {c.name: np.full(frame_count, c.default) for c in rig.controls}
        solution = SolvedControls(default_values, (), ())
    job = _KeyingJob(
        take,
        rig,
        name,
        joint_motions,
        uncombined_weights_of(take, rig),
        solution,
        rounding_tolerances,
        tolerance,
        other_tolerances,
        base,
    )
    keyed_take = job.reduce(1.0)
    for i in range(MAX_REFINEMENTS):
        if keyed_take.reduction.held:
            break
        finer_result = job.reduce(REFINEMENT_FACTOR ** (i + 1))
        keyed_take = min(
            keyed_take, finer_result, key=lambda keyed: keyed.reduction.error
        )
    return keyed_take


def _rounding_differences(rig: Rig, tolerance: float) -> Tolerances:
    """Return the largest differences that are rounding, for a tolerance [m]."""
    rounding = ROUNDING_FRACTION * tolerance
    return Tolerances(
        min(ANGLE_ROUNDING, rounding / max(rest_size(rig), SHELL_DISTANCE)),
        min(LENGTH_ROUNDING, rounding),
        WEIGHT_ROUNDING,
    )


@dataclass(frozen=True, slots=True)
class _KeyingJob:
    """A take to fit keys to, with its solved controls."""

    take: Take
    rig: Rig
    name: str
    joint_motions: list[JointMotion]
    weights_by_shape: dict[str, FloatArray]
    solution: SolvedControls
    rounding_tolerances: Tolerances
    tolerance: float
    joint_tolerances: Mapping[str, float]
    base: Take | None

    def reduce(self, factor: float) -> KeyedTake:
        """Return the take's keys, fitted with the tolerance times ``factor``."""
        take, rig = self.take, self.rig
        scaled_tolerance_by_pattern = {
            p: factor * v for p, v in self.joint_tolerances.items()
        }
        bounds = joint_bounds(rig, factor * self.tolerance, scaled_tolerance_by_pattern)
        unkeyable_values = self._driven_values()
        driven_values = evaluate_controls(rig.controls, self.solution.values)
        exact_targets = driven_values.targets | unkeyable_values
        weights = self._weight_tracks(exact_targets, exact_targets)
        weight_tolerance = WEIGHT_TOLERANCE * factor / _combination_gain(rig, weights)
        exact_tracks = joint_tracks(
            rig,
            self.joint_motions,
            exact_targets,
            exact_targets,
            self.rounding_tolerances,
        )
        keyed_channels = self._keyed_channels(exact_tracks)
        controls = fit_controls(
            take, rig, self.solution.values, keyed_channels, bounds, weight_tolerance
        )
        driven_values = evaluate_controls(rig.controls, controls.values_by_name)
        fitted_targets = driven_values.targets | unkeyable_values
        tracks = joint_tracks(
            rig,
            self.joint_motions,
            exact_targets,
            fitted_targets,
            self.rounding_tolerances,
        )
        tracks += self._scale_tracks()
        tracks += self._weight_tracks(exact_targets, fitted_targets)
        reduction = reduce_motion(
            take,
            factor * self.tolerance,
            joint_tolerances=scaled_tolerance_by_pattern,
            weight_tolerance=weight_tolerance,
            base=self.base,
            tracks=sort_tracks(tracks),
            start=self._start_motion(controls, keyed_channels),
        )
        reduction = replace(
            reduction,
            channels=(*controls.channels, *reduction.channels),
            samples=controls.sample_count + reduction.samples,
        )
        clip = clip_of_reduction(reduction, rig, self.name)
        sampled_motion = sample_channels(clip.channels, rig, take.clock.times).motion
        all_bounds = joint_bounds(rig, self.tolerance, self.joint_tolerances)
        return KeyedTake(
            clip,
            _measure_errors(reduction, take, sampled_motion, self.base, all_bounds),
            tuple(controls.values_by_name),
            channel_deviations(clip, rig, take, sampled_motion, self.solution.values),
            key_notices(rig, self.joint_motions, self.solution, tracks, exact_targets),
        )

    def _driven_values(self) -> dict[str, FloatArray]:
        """Return the values of unkeyable targets, driven by joint coordinates."""
        rig = self.rig
        if not rig.is_driven:
            return {}
        plan = plan_of(rig)
        values_by_target = {
            f"shape/{name}": self.weights_by_shape[name] for name in plan.shapes
        }
        for j in plan.joints:
            part = COORDINATE_PARTS[rig.joints[j].type]
            values_by_target[f"joint/{rig.names[j]}.{part}"] = self.joint_motions[
                j
            ].coordinate
        return values_by_target

    def _keyed_channels(
        self, tracks: list[KeyTrack]
    ) -> frozenset[tuple[ChannelKind, int]]:
        """Return the keyed channels, and those of mimic joints of keyed joints."""
        keyed_channels = {(track.kind, track.index) for track in tracks}
        leading_joints = {self.rig.joints[index].name for _, index in keyed_channels}
        for j, joint in enumerate(self.rig.joints):
            if joint.mimic is not None and joint.mimic.joint in leading_joints:
                kinds = ChannelKind.TRANSLATION, ChannelKind.ROTATION
                keyed_channels |= {(kind, j) for kind in kinds}
        return frozenset(keyed_channels)

    def _start_motion(
        self,
        controls: FittedControls,
        keyed_channels: frozenset[tuple[ChannelKind, int]],
    ) -> Motion:
        """Return the take with joints driven by the fitted control keys."""
        times = self.take.clock.times
        exact_values = {
            f"control/{n}": v[:, None] for n, v in self.solution.values.items()
        }
        exact_motion = sample_values(exact_values, self.rig, times).motion
        fitted_motion = sample_values(controls.values, self.rig, times).motion
        return driven_pose(
            self.take.motion, fitted_motion, exact_motion, keyed_channels
        )

    def _scale_tracks(self) -> list[KeyTrack]:
        """Return key tracks of joint scales, which controls do not change."""
        motion = self.take.motion
        if motion.scales is None:
            return []
        without_weights = replace(motion, weights=None)
        unit_scales = Channel.static(np.ones_like(motion.scales.rest))
        rest = replace(without_weights, scales=unit_scales)
        tracks = find_tracks(self.rig, without_weights, rest)
        return [track for track in tracks if track.kind is ChannelKind.SCALE]

    def _weight_tracks(
        self,
        exact_targets: Mapping[str, FloatArray],
        fitted_targets: Mapping[str, FloatArray],
    ) -> list[KeyTrack]:
        """Return key tracks of the shape weights that nothing else drives."""
        tracks = []
        zero = np.zeros(1)
        for i, shape in enumerate(self.rig.shapes):
            take_weight = self.weights_by_shape[shape.name]
            target = f"shape/{shape.name}"
            undriven_weight = take_weight - exact_targets.get(target, zero)
            is_derived = bool(shape.combine) or target in exact_targets
            tolerance = self.rounding_tolerances.weight if is_derived else 0.0
            if np.abs(undriven_weight).max(initial=0.0) <= tolerance:
                continue
            samples = np.array(take_weight - fitted_targets.get(target, zero))[:, None]
            samples = samples[:1] if (samples == samples[:1]).all() else samples
            tracks.append(KeyTrack(ChannelKind.WEIGHT, i, None, samples))
        return tracks


def _combination_gain(rig: Rig, tracks: list[KeyTrack]) -> float:
    """Return the factor by which combination shapes amplify errors [1], at least 1."""
    keyed_shapes = {track.index for track in tracks}
    weight_by_shape = {
        s.name: float(i in keyed_shapes) for i, s in enumerate(rig.shapes)
    }
    for shape in combination_order(rig.shapes):
        weight_by_shape[shape.name] += sum(
            weight_by_shape[name] for name in shape.combine
        )
    return max(1.0, *weight_by_shape.values()) if weight_by_shape else 1.0


def _measure_errors(
    reduction: Reduction,
    take: Take,
    keyed_motion: Motion,
    base: Take | None,
    bounds: FloatArray,
) -> Reduction:
    """Return a reduction whose errors are measured against the take."""
    weight_error = largest_weight_error(take.motion, keyed_motion)
    if not take.rig.joints:
        return replace(reduction, weight_error=weight_error)
    base_motion = None if base is None else base.motion
    true_world, reduced_world = (
        additive_pose(take.rig, motion, base_motion).world_transforms()
        for motion in (take.motion, keyed_motion)
    )
    points = attached_points(take.rig, SHELL_DISTANCE)
    joint_errors = point_errors(points, true_world, reduced_world)
    frame, joint = divmod(int(np.argmax(joint_errors)), len(bounds))
    return replace(
        reduction,
        error=float(joint_errors[frame, joint]),
        joint=take.rig.joints[joint].name,
        frame=frame,
        held=bool((joint_errors / bounds).max() <= 1 + DIGIT_ROUNDING),
        weight_error=weight_error,
    )
