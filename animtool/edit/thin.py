"""Thinning of samples that interpolation restores, for smaller files."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from animtool.clip.reduction.points import (
    SHELL_DISTANCE,
    attached_points,
    joint_bounds,
    point_errors,
)
from animtool.clip.reduction.tolerance import WEIGHT_TOLERANCE
from animtool.core.array_types import FloatArray, IntArray
from animtool.core.record import dataclass
from animtool.edit.travel import positions_between
from animtool.motion.motion import Motion
from animtool.rig.kinematics import WorldTransforms
from animtool.rig.skeleton import Rig

# Minimum distance of a split from the ends of an interval, as a fraction of its length.
SPLIT_MARGIN = 0.125
# Maximum number of passes; each may drop every second remaining sample, but few do.
MAX_DROP_PASSES = 8


@dataclass(frozen=True, slots=True)
class ThinnedSamples:
    """The kept samples of a motion, and the errors of interpolating the others."""

    samples: int  # number of samples before thinning
    kept_samples: IntArray  # indices of the kept samples, ascending ``(N,)``
    error: float  # largest distance of a point from its original position [m]
    joint_index: int  # index of the joint of that point
    code: float  # time code of that error
    weight_error: float  # largest error of a shape's weight [1]

    @property
    def count(self) -> int:
        """Number of kept samples."""
        return len(self.kept_samples)


def thin_samples(
    rig: Rig,
    codes: FloatArray,
    motion: Motion,
    tolerance: float,
    *,
    joint_tolerances: Mapping[str, float] | None = None,
) -> ThinnedSamples:
    """Select samples that reproduce a motion within a tolerance > 0 [m].

    Between two samples USD interpolates translations, scales and weights linearly, and
    rotations along the shortest arc. An interval beyond the tolerance is split at its
    worst sample (Douglas and Peucker, 1973); then samples that turn out to be
    unnecessary are dropped again. The measure is that of
    `animtool.clip.reduction.reduce.reduce_motion`: points attached to each joint, in
    world space, at every sample. The first and last sample are kept.
    ``joint_tolerances`` are by joint name or pattern such as ``hand_*`` > 0 [m]; the
    tolerance of weights is `WEIGHT_TOLERANCE` [1].
    """
    bounds = joint_bounds(rig, tolerance, joint_tolerances or {})
    error_meter = _ThinningErrorMeter(rig, codes, motion, bounds)
    kept_samples = _add_samples(error_meter, np.unique([0, len(codes) - 1]))
    for pass_index in range(MAX_DROP_PASSES):
        kept_samples = _drop_alternate(error_meter, kept_samples, pass_index % 2)
    return error_meter.build_result(kept_samples)


def _add_samples(error_meter: _ThinningErrorMeter, kept_samples: IntArray) -> IntArray:
    """Split intervals at their worst sample until all are within the tolerance."""
    frames = np.setdiff1d(np.arange(len(error_meter.codes)), kept_samples)
    while len(frames):
        ratios = error_meter.error_ratios(kept_samples, frames)
        interval_indices = np.searchsorted(kept_samples, frames) - 1
        run_starts = np.flatnonzero(np.diff(interval_indices, prepend=-1))
        worst_ratios = np.maximum.reduceat(ratios, run_starts)
        is_over_tolerance = worst_ratios > 1
        if not is_over_tolerance.any():
            break
        lengths = np.diff([*run_starts, len(frames)])
        interval_of_frame = np.repeat(np.arange(len(run_starts)), lengths)
        peak_indices = np.flatnonzero(ratios == worst_ratios[interval_of_frame])
        _, first_peaks = np.unique(interval_of_frame[peak_indices], return_index=True)
        split_frames = frames[peak_indices[first_peaks]][is_over_tolerance]
        split_intervals = interval_indices[run_starts[is_over_tolerance]]
        interval_starts = kept_samples[split_intervals]
        interval_ends = kept_samples[split_intervals + 1]
        margin = ((interval_ends - interval_starts) * SPLIT_MARGIN).astype(np.int64)
        lowest, highest = interval_starts + margin, interval_ends - margin
        split_frames = np.clip(split_frames, lowest, highest)
        remaining_frames = frames[is_over_tolerance[interval_of_frame]]
        frames = np.setdiff1d(remaining_frames, split_frames)
        kept_samples = np.union1d(kept_samples, split_frames)
    return kept_samples


def _drop_alternate(
    error_meter: _ThinningErrorMeter, kept_samples: IntArray, first_dropped: int
) -> IntArray:
    """Drop every second sample if its removal stays within the tolerance."""
    dropped_positions = np.arange(1 + first_dropped, len(kept_samples) - 1, 2)
    if not len(dropped_positions):
        return kept_samples
    fewer_samples = np.delete(kept_samples, dropped_positions)
    first = kept_samples[dropped_positions[0] - 1]
    end = kept_samples[dropped_positions[-1] + 1]
    omitted_frames = np.setdiff1d(np.arange(first, end), fewer_samples)
    ratios = error_meter.error_ratios(fewer_samples, omitted_frames)
    # Every interval of the trial contains one frame: the sample that it drops.
    starts = kept_samples[dropped_positions - 1]
    interval_indices = np.searchsorted(starts, omitted_frames, side="right") - 1
    worst_ratios = np.zeros(len(dropped_positions))
    np.maximum.at(worst_ratios, interval_indices, ratios)
    return np.delete(kept_samples, dropped_positions[worst_ratios <= 1])


class _ThinningErrorMeter:
    """Measures the error of the motion interpolated from the kept samples."""

    def __init__(
        self, rig: Rig, codes: FloatArray, motion: Motion, bounds: FloatArray
    ) -> None:
        self.rig, self.codes, self.motion = rig, codes, motion
        self.bounds = bounds
        self.points = attached_points(rig, SHELL_DISTANCE)
        self.original_world = motion.world(rig)

    def errors(
        self, kept_samples: IntArray, frames: IntArray
    ) -> tuple[FloatArray, FloatArray]:
        """Return the deviation from the original motion at N frames.

        The first array is that of the joints ``(N, J)``, the second the largest of the
        weights ``(N,)``.
        """
        positions = positions_between(self.codes[kept_samples], self.codes[frames])
        restored_motion = self.motion.select(kept_samples).map(positions.interpolate)
        original_world = self.original_world
        original_world = WorldTransforms(
            original_world.positions[frames], original_world.linear[frames]
        )
        world = restored_motion.world(self.rig)
        weight_errors_by_frame = np.zeros(len(frames))
        if restored_motion.weights is not None and self.motion.weights is not None:
            original_weights = self.motion.weights.values[frames]
            weight_errors = np.abs(restored_motion.weights.values - original_weights)
            weight_errors_by_frame = weight_errors.max(axis=(1, 2), initial=0.0)
        return point_errors(self.points, original_world, world), weight_errors_by_frame

    def error_ratios(self, kept_samples: IntArray, frames: IntArray) -> FloatArray:
        """Return the largest error at each frame, divided by its tolerance ``(N,)``."""
        joint_errors, weight_errors = self.errors(kept_samples, frames)
        largest_ratios = (joint_errors / self.bounds).max(axis=1, initial=0.0)
        return np.asarray(np.maximum(largest_ratios, weight_errors / WEIGHT_TOLERANCE))

    def build_result(self, kept_samples: IntArray) -> ThinnedSamples:
        """Return the kept samples with their errors."""
        count = len(self.codes)
        joint_errors, weight_errors = self.errors(kept_samples, np.arange(count))
        if not joint_errors.shape[1]:
            joint_errors = np.zeros((count, 1))
        frame, joint = divmod(int(np.argmax(joint_errors)), joint_errors.shape[1])
        return ThinnedSamples(
            count,
            kept_samples,
            float(joint_errors[frame, joint]),
            joint,
            float(self.codes[frame]),
            float(weight_errors.max()),
        )
