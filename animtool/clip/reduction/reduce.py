"""Key reduction of a sampled take within a world-space tolerance."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from animtool.clip.reduction.keys import ChannelKind, ReducedChannel, Reduction
from animtool.clip.reduction.points import (
    SHELL_DISTANCE,
    TrackReduction,
    attached_points,
    joint_bounds,
    point_distances,
    point_errors,
    subtree_maxima,
)
from animtool.clip.reduction.tolerance import WEIGHT_TOLERANCE
from animtool.clip.reduction.tracks import (
    KeyTrack,
    ReducedPose,
    additive_pose,
    find_tracks,
)
from animtool.core.array_types import BoolArray, FloatArray, IntArray
from animtool.core.record import dataclass
from animtool.maths.fit import evaluate_keys, fit_keys
from animtool.maths.so3 import IDENTITY
from animtool.motion.motion import Channel, Motion
from animtool.motion.take import Take
from animtool.rig.kinematics import WorldTransforms
from animtool.rig.limits import BallLimit
from animtool.rig.skeleton import Rig

# Lever arms are only a first guess: the first rounds scale each channel's tolerance by
# the resulting world error; the others tighten where that was too large.
CALIBRATION_ROUNDS = 3
MAX_ROUNDS = 40
# From this round on, keys no longer move; each round only adds keys, so that errors
# decrease.
FIRST_SPLITTING_ROUND = 8
# Keys of balls stay within their limits up to this between samples [rad], checked at
# this many points per frame.
LIMIT_SLACK, LIMIT_CHECKS_PER_FRAME = 1e-4, 4
# Quantile of the frames used for calibration [1].
CALIBRATION_QUANTILE = 0.95


def reduce_motion(
    take: Take,
    tolerance: float,
    *,
    joint_tolerances: Mapping[str, float] | None = None,
    weight_tolerance: float = WEIGHT_TOLERANCE,
    base: Take | None = None,
    tracks: Sequence[KeyTrack] | None = None,
    start: Motion | None = None,
) -> Reduction:
    """Return sparse keys of a take whose world error is within a tolerance.

    The error of a joint is the largest distance, over all frames of the take, of its
    origin, of points on its three axes and of its bone's tips from their original
    positions. It therefore includes twist that leaves all origins in place, like the
    measure of ACL. Inherited scale enlarges the shell too.

    Each channel is fitted by `animtool.maths.fit.fit_keys` with its own tolerance.
    Tolerances start from lever arms and are scaled by the resulting world error. Where
    a joint's error is still too large, the channels of its chain that contribute most
    are tightened around that frame. The result is deterministic.

    Pins and slides stay within their limits between frames, too. Balls stay within
    theirs up to some hundredths of a degree, or tenths if they rotate by more than 10
    degrees per frame, along the shortest arc between frames. This requires that all
    their motion is keyed.

    Limits: errors between frames are not measured. A tolerance near rounding (1e-12 of
    the rig's size) may not be reached; ``held`` is False then. Controls are omitted,
    since joints and weights contain their effect.

    Args:
        take: A take of at least one frame.
        tolerance: Largest error of any joint > 0 [m].
        joint_tolerances: Other tolerances by joint name or pattern such as ``hand_*`` >
            0 [m].
        weight_tolerance: Largest error of a shape's weight > 0 [1].
        base: For a take of additive deltas, the motion they are added to, frame by
            frame: translations are summed, rotations are applied after the base's,
            scales are multiplied. The rest pose then has no deltas. None for a complete
            take.
        tracks: Channels to key; None keys every joint that is not at rest, with its
            full transform.
        start: Motion of the joints without a track; None uses the take's motion.

    References:
        N. Frechette, Animation Compression Library, 2017: error on a shell around
        each joint, in world space.
    """
    rig, motion = take.rig, take.motion
    _check_takes(take, base)
    if not (np.isfinite(weight_tolerance) and weight_tolerance > 0):
        raise ValueError(f"weight_tolerance must be above 0, not {weight_tolerance}")
    rest_motion = _unkeyed_motion(rig, motion, is_additive=base is not None)
    bounds = joint_bounds(rig, tolerance, joint_tolerances or {})
    tracks = find_tracks(rig, motion, rest_motion) if tracks is None else tracks
    weight_tracks = [t for t in tracks if t.kind is ChannelKind.WEIGHT]
    joint_tracks = [t for t in tracks if t.kind is not ChannelKind.WEIGHT]

    base_motion = None if base is None else base.motion
    reductions: list[TrackReduction] = []
    search_result = _SearchResult(np.zeros((motion.frames, 1)), 0.0, 0)
    if rig.joints:
        world_errors = _WorldErrors(rig, motion, base_motion, bounds)
        if start is not None:
            world_errors.pose = additive_pose(rig, start, base_motion)
        reductions = [
            TrackReduction.from_track(t, world_errors.initial_tolerance(t))
            for t in joint_tracks
            if t.is_animated
        ]
        search_result = _search_tolerances(world_errors, reductions)
    weight_reductions = [
        TrackReduction.from_track(track, weight_tolerance)
        for track in weight_tracks
        if track.is_animated
    ]

    errors = search_result.errors
    frame, joint = divmod(int(np.argmax(errors)), errors.shape[1])
    keys_by_channel = {
        (b.track.kind, b.track.index): b.keys for b in [*reductions, *weight_reductions]
    }
    return Reduction(
        clock=take.clock,
        channels=tuple(
            ReducedChannel(
                f"shape/{rig.shapes[t.index].name}"
                if t.kind is ChannelKind.WEIGHT
                else f"joint/{rig.joints[t.index].name}.{t.part}",
                t.order,
                keys_by_channel[t.kind, t.index]
                if t.is_animated
                else fit_keys(t.samples, 1.0),
            )
            for t in joint_tracks + weight_tracks
        ),
        samples=motion.frames * sum(track.is_animated for track in tracks),
        error=float(errors[frame, joint]),
        joint=rig.joints[joint].name if rig.joints else "",
        frame=frame,
        held=search_result.error_ratio <= 1,
        weight_error=max(
            (float(b.errors.max()) for b in weight_reductions), default=0.0
        ),
        rounds=search_result.round_count,
    )


@dataclass(frozen=True, slots=True)
class _SearchResult:
    """World errors of a tolerance search, and its number of rounds."""

    errors: FloatArray
    error_ratio: float
    round_count: int


class _WorldErrors:
    """Measures world-space errors of reduced keys on points attached to joints."""

    def __init__(
        self,
        rig: Rig,
        motion: Motion,
        base: Motion | None,
        bounds: FloatArray,
    ) -> None:
        self.rig, self.bounds = rig, bounds
        self.pose: ReducedPose = additive_pose(rig, motion, base)
        self.original_world = self.pose.world_transforms()
        self.reduced_world: WorldTransforms | None = None
        self.points = attached_points(rig, SHELL_DISTANCE)
        self.point_distances = point_distances(self.points)
        self.is_descendant = _descendant_mask(rig)
        self.pose = self.pose.copy()

    def initial_tolerance(self, track: KeyTrack) -> float:
        """Return a channel's initial tolerance by the lever arms of its descendants."""
        descendant_indices = np.flatnonzero(self.is_descendant[track.index])
        bounds = self.bounds[descendant_indices]
        if track.kind is ChannelKind.TRANSLATION:
            return float(bounds.min() / 2)
        frame_count = len(self.original_world.positions)
        frames = np.linspace(0, frame_count - 1, 8).astype(np.int64)
        positions = self.original_world.positions[frames]
        offsets = positions[:, descendant_indices] - positions[:, track.index, None]
        joint_distances = np.linalg.norm(offsets, axis=-1).max(axis=0)
        lever_arms = joint_distances + self.point_distances[descendant_indices]
        tolerance = float((bounds / (2 * lever_arms.clip(min=1e-9))).min())
        is_rotation = track.kind is ChannelKind.ROTATION
        return float(np.degrees(tolerance)) if is_rotation else tolerance

    def measure_errors(self, reductions: list[TrackReduction]) -> FloatArray:
        """Return every joint's error ``(F, J)`` [m] after updating the given tracks."""
        for reduction in reductions:
            self.pose.set_track(reduction.track, reduction.values)
        self.reduced_world = self.pose.world_transforms(self.reduced_world)
        return point_errors(self.points, self.original_world, self.reduced_world)

    def lever_arms(
        self, joint: int, frames: IntArray, end_joints: IntArray
    ) -> FloatArray:
        """Return the lever arms from a joint to the points of other joints [m]."""
        positions = self.original_world.positions
        offsets = positions[frames, end_joints] - positions[frames, joint]
        distances = np.linalg.norm(offsets, axis=-1)
        return np.asarray(distances + self.point_distances[end_joints])


def _search_tolerances(
    world_errors: _WorldErrors, reductions: list[TrackReduction]
) -> _SearchResult:
    """Scale, then locally reduce channel tolerances until errors are within bounds."""
    errors = world_errors.measure_errors(reductions)
    round_count = 1
    for _ in range(CALIBRATION_ROUNDS if reductions else 0):
        error_ratios = subtree_maxima(
            world_errors.rig.parents, errors / world_errors.bounds
        )
        for reduction in reductions:
            joint_ratios = error_ratios[:, reduction.track.index]
            typical_ratio = float(np.quantile(joint_ratios, CALIBRATION_QUANTILE))
            factor = np.clip(0.9 / max(typical_ratio, 1e-9), 0.25, 4.0)
            reduction.scale_tolerance(float(factor))
        errors = world_errors.measure_errors(reductions)
        round_count += 1
    error_ratio = float((errors / world_errors.bounds).max())
    while round_count < MAX_ROUNDS:
        changed_reductions = []
        if error_ratio > 1:
            moves_keys = round_count < FIRST_SPLITTING_ROUND
            changed_reductions = _tighten_causes(
                world_errors, reductions, errors, moves_keys
            )
        for reduction in reductions:
            frames = _frames_beyond_limits(reduction)
            if len(frames):
                reduction.straighten_segments(frames)
                changed_reductions.append(reduction)
        if not changed_reductions:
            break
        errors = world_errors.measure_errors(changed_reductions)
        error_ratio = float((errors / world_errors.bounds).max())
        round_count += 1
    return _SearchResult(errors, error_ratio, round_count)


def _frames_beyond_limits(reduction: TrackReduction) -> IntArray:
    """Return the frames after which a ball's keys exceed its limits between samples.

    Between two samples, the larger excess of these samples is allowed.
    """
    track = reduction.track
    if not isinstance(track.limits, BallLimit) or len(track.samples) < 2:
        return np.zeros(0, np.int64)
    sample_excess = track.limit_excess(track.samples)
    larger_excess = np.maximum(sample_excess[:-1], sample_excess[1:])
    allowed_excess = np.repeat(larger_excess, LIMIT_CHECKS_PER_FRAME - 1) + LIMIT_SLACK
    substeps = np.arange(1, LIMIT_CHECKS_PER_FRAME * (len(sample_excess) - 1))
    times = substeps / LIMIT_CHECKS_PER_FRAME
    times_between = times[substeps % LIMIT_CHECKS_PER_FRAME != 0]
    excess = track.limit_excess(evaluate_keys(reduction.keys, times_between))
    is_beyond = excess > allowed_excess
    first_frames = np.unique(np.floor(times_between[is_beyond]).astype(np.int64))
    return np.setdiff1d(first_frames, reduction.straight_starts)


def _tighten_causes(
    world_errors: _WorldErrors,
    reductions: list[TrackReduction],
    errors: FloatArray,
    moves_keys: bool,
) -> list[TrackReduction]:
    """Reduce tolerances of channels that contribute most to errors above bounds."""
    frames, joints_beyond = np.argwhere(errors > world_errors.bounds).T.astype(np.int64)
    excess = errors[frames, joints_beyond] / world_errors.bounds[joints_beyond]
    contributions = np.zeros((len(reductions), len(frames)))
    for i, reduction in enumerate(reductions):
        joint = reduction.track.index
        is_affected = world_errors.is_descendant[joint, joints_beyond]
        affected_frames, affected_joints = (
            frames[is_affected],
            joints_beyond[is_affected],
        )
        lever_arms = world_errors.lever_arms(joint, affected_frames, affected_joints)
        displacements = reduction.displacement_per_unit(lever_arms)
        displacements = displacements * reduction.errors[affected_frames]
        contributions[i, is_affected] = displacements
    is_large = contributions >= 0.5 * contributions.max(axis=0, initial=0.0)
    changed_reductions = []
    for reduction, is_cause in zip(
        reductions, is_large & (contributions > 0), strict=True
    ):
        if is_cause.any():
            bad_frames, indices = np.unique(frames[is_cause], return_inverse=True)
            largest_excess = np.zeros(len(bad_frames))
            np.maximum.at(largest_excess, indices, excess[is_cause])
            new_tolerances = reduction.errors[bad_frames] * 0.9 / largest_excess
            reduction.tighten_frames(bad_frames, new_tolerances, moves_keys=moves_keys)
            changed_reductions.append(reduction)
    return changed_reductions


def _descendant_mask(rig: Rig) -> BoolArray:
    """Return a mask ``(J, J)``: at [j, k], whether k is j or a descendant of j."""
    is_descendant = np.eye(len(rig.joints), dtype=np.bool_)
    for joint, parent in enumerate(rig.parents):
        if parent >= 0:
            is_descendant[:, joint] |= is_descendant[:, parent]
    return is_descendant


def _unkeyed_motion(rig: Rig, motion: Motion, *, is_additive: bool) -> Motion:
    """Return one frame with the values of channels that have no keys."""
    joint_count = len(rig.joints)
    static = Channel.static
    return Motion(
        static(np.zeros((joint_count, 3)) if is_additive else rig.rest_translations),
        static(
            np.tile(IDENTITY, (joint_count, 1)) if is_additive else rig.rest_rotations
        ),
        None if motion.scales is None else static(np.ones((joint_count, 3))),
        None if motion.weights is None else static(np.zeros_like(motion.weights.rest)),
    )


def _check_takes(take: Take, base: Take | None) -> None:
    """Raise if the take is empty, or a base is invalid."""
    if not take.motion.frames:
        raise ValueError("the take has no frame")
    if base is not None and (
        base.rig.names != take.rig.names or base.motion.frames != take.motion.frames
    ):
        raise ValueError("the base has other joints or a different number of frames")
