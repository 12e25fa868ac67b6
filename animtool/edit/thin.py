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

# Least distance of a split from the ends of an interval, as a fraction of it.
SPLIT_MARGIN = 0.125
# Each pass may drop every second remaining sample; few find any.
JOINING = 8


@dataclass(frozen=True, slots=True)
class Thinned:
    """Which samples are kept, and the resulting error."""

    samples: int  # number of samples before
    kept: IntArray  # indices of those that stay, ascending ``(N,)``
    error: float  # largest distance of a point from where it was [m]
    joint_index: int  # of the joint that carries it
    code: float  # time code of that
    weight_error: float  # largest error of a shape's weight [1]

    @property
    def count(self) -> int:
        """Number of kept samples."""
        return len(self.kept)


def thin_samples(
    rig: Rig,
    codes: FloatArray,
    motion: Motion,
    tolerance: float,
    *,
    joint_tolerances: Mapping[str, float] | None = None,
) -> Thinned:
    """Return which samples ``(F,)`` reproduce a motion within a tolerance > 0 [m].

    Between two samples USD interpolates translations, scales and weights linearly, and
    rotations along the shortest arc. An interval beyond the tolerance is split at its
    worst sample (Douglas and Peucker, 1973); then samples that turn out not to be
    needed are dropped again. The measure is that of
    `animtool.clip.reduction.reduce.reduce_motion`: points that each joint carries, in
    the world, at every sample. The first and last sample are kept. ``joint_tolerances``
    are by names of joints or patterns such as ``hand_*`` > 0 [m], that of weights is
    `WEIGHT_TOLERANCE` [1].
    """
    bounds = joint_bounds(rig, tolerance, joint_tolerances or {})
    measure = _Measure(rig, codes, motion, bounds)
    kept = _split(measure, np.unique([0, len(codes) - 1]))
    for round_ in range(JOINING):
        kept = _joined(measure, kept, round_ % 2)
    return measure.report(kept)


def _split(measure: _Measure, kept: IntArray) -> IntArray:
    """Add samples until every interval is within the tolerance."""
    frames = np.setdiff1d(np.arange(len(measure.codes)), kept)
    while len(frames):
        ratios = measure.ratios(kept, frames)
        interval = np.searchsorted(kept, frames) - 1
        starts = np.flatnonzero(np.diff(interval, prepend=-1))
        worst = np.maximum.reduceat(ratios, starts)
        beyond = worst > 1
        if not beyond.any():
            break
        of_frame = np.repeat(np.arange(len(starts)), np.diff([*starts, len(frames)]))
        peaks = np.flatnonzero(ratios == worst[of_frame])
        _, first = np.unique(of_frame[peaks], return_index=True)
        chosen = frames[peaks[first]][beyond]
        low, high = kept[interval[starts[beyond]]], kept[interval[starts[beyond]] + 1]
        margin = ((high - low) * SPLIT_MARGIN).astype(np.int64)
        chosen = np.clip(chosen, low + margin, high - margin)
        frames = np.setdiff1d(frames[beyond[of_frame]], chosen)
        kept = np.union1d(kept, chosen)
    return kept


def _joined(measure: _Measure, kept: IntArray, skip: int) -> IntArray:
    """Return the samples without every second one that is not needed."""
    trial = np.arange(1 + skip, len(kept) - 1, 2)
    if not len(trial):
        return kept
    fewer = np.delete(kept, trial)
    frames = np.setdiff1d(np.arange(kept[trial[0] - 1], kept[trial[-1] + 1]), fewer)
    ratios = measure.ratios(fewer, frames)
    # Every interval of the trial has a frame: the sample that it drops.
    interval = np.searchsorted(kept[trial - 1], frames, side="right") - 1
    worst = np.zeros(len(trial))
    np.maximum.at(worst, interval, ratios)
    return np.delete(kept, trial[worst <= 1])


class _Measure:
    """Error of the motion restored from the kept samples."""

    def __init__(
        self,
        rig: Rig,
        codes: FloatArray,
        motion: Motion,
        bounds: FloatArray,
    ) -> None:
        self.rig, self.codes, self.motion = rig, codes, motion
        self.bounds = bounds
        self.points = attached_points(rig, SHELL_DISTANCE)
        self.truth = motion.world(rig)

    def errors(self, kept: IntArray, frames: IntArray) -> tuple[FloatArray, FloatArray]:
        """Return errors of the joints ``(N, J)`` and of the weights ``(N,)``."""
        at = positions_between(self.codes[kept], self.codes[frames])
        blended = self.motion.select(kept).map(at.blend)
        truth = WorldTransforms(self.truth.positions[frames], self.truth.linear[frames])
        world = blended.world(self.rig)
        weights = np.zeros(len(frames))
        if blended.weights is not None and self.motion.weights is not None:
            true = self.motion.weights.values[frames]
            off = np.abs(blended.weights.values - true)
            weights = off.max(axis=(1, 2), initial=0.0)
        return point_errors(self.points, truth, world), weights

    def ratios(self, kept: IntArray, frames: IntArray) -> FloatArray:
        """Return the largest error at each frame, over its tolerance ``(N,)``."""
        joints, weights = self.errors(kept, frames)
        largest = (joints / self.bounds).max(axis=1, initial=0.0)
        return np.asarray(np.maximum(largest, weights / WEIGHT_TOLERANCE))

    def report(self, kept: IntArray) -> Thinned:
        """Return the result for the kept samples."""
        count = len(self.codes)
        joints, weights = self.errors(kept, np.arange(count))
        if not joints.shape[1]:
            joints = np.zeros((count, 1))
        frame, joint = divmod(int(np.argmax(joints)), joints.shape[1])
        return Thinned(
            count,
            kept,
            float(joints[frame, joint]),
            joint,
            float(self.codes[frame]),
            float(weights.max()),
        )
