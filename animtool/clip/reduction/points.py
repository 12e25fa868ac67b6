"""Error measurement on points attached to joints, and channel tolerances."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import field
from fnmatch import fnmatchcase

import numpy as np

from animtool import _kernels
from animtool.clip.reduction.keys import ChannelKind
from animtool.clip.reduction.tracks import KeyTrack
from animtool.core.array_types import ArrayLike, FloatArray, IntArray
from animtool.core.errors import Fault, OptionError, excerpt
from animtool.core.record import dataclass
from animtool.maths.fit import FittedKeys, evaluate_keys, fit_keys
from animtool.rig.kinematics import WorldTransforms
from animtool.rig.skeleton import Rig

# Distance of skin and props from their joint, as ACL assumes [m].
SHELL_DISTANCE = 0.03


def joint_bounds(
    rig: Rig, tolerance: float, tolerances_by_pattern: Mapping[str, float]
) -> FloatArray:
    """Return the tolerance of every joint ``(J,)`` [m].

    ``tolerances_by_pattern`` has other tolerances [m] by joint name or pattern such as
    ``hand_*``; the last match counts.

    >>> from animtool.rig.skeleton import Joint
    >>> arm = Rig("arm", (Joint("upper", -1), Joint("hand", 0)))
    >>> joint_bounds(arm, 0.001, {"ha*": 0.0001}).tolist()
    [0.001, 0.0001]
    """
    bounds_by_option = [("reduce", tolerance)]
    bounds_by_option += [("reduce_at", v) for v in tolerances_by_pattern.values()]
    faults = [
        Fault(
            "CLIP020",
            f"a tolerance must be above 0 and finite, not {value:g} m",
            where=option,
            hint="write a length such as 0.5mm",
        )
        for option, value in bounds_by_option
        if not (math.isfinite(value) and value > 0)
    ]
    bounds = np.full(len(rig.joints), float(tolerance))
    for pattern, value in tolerances_by_pattern.items():
        matching_joints = [
            j for j, name in enumerate(rig.names) if fnmatchcase(name, pattern)
        ]
        bounds[matching_joints] = value
        if not matching_joints:
            hint = rig.joint_hint(pattern)
            message = f"unknown joint {excerpt(pattern)} of {rig.name!r}"
            faults.append(Fault("CLIP020", message, where="reduce_at", hint=hint))
    if faults:
        raise OptionError(faults)
    return bounds


def attached_points(rig: Rig, axis_distance: float) -> FloatArray:
    """Return points attached to each joint, in the joint's frame ``(J, P, 3)`` [m].

    These are the joint's origin, one point on each axis at a distance of
    ``axis_distance`` [m], and the tips of its bone. Joints with fewer tips repeat their
    origin.

    >>> from animtool.rig.skeleton import Joint
    >>> attached_points(Rig("r", (Joint("a", -1),)), 0.03)[0].tolist()[:2]
    [[0.0, 0.0, 0.0], [0.03, 0.0, 0.0]]
    """
    max_tip_count = max((len(joint.tips) for joint in rig.joints), default=0)
    points = np.zeros((len(rig.joints), 4 + max_tip_count, 3))
    points[:, 1:4] = axis_distance * np.eye(3)
    for j, joint in enumerate(rig.joints):
        for i, tip in enumerate(joint.tips):
            points[j, 4 + i] = tip
    return points


def point_distances(points: FloatArray) -> FloatArray:
    """Return the largest distance of attached points from each joint ``(J,)`` [m]."""
    return np.asarray(np.linalg.norm(points, axis=-1).max(axis=-1))


def point_errors(
    points: FloatArray, original_world: WorldTransforms, reduced_world: WorldTransforms
) -> FloatArray:
    """Return the largest point error of each joint ``(F, J)`` [m].

    The points ``(J, P, 3)`` [m] are in the joints' frames, moved by the original world
    transforms and by the reduced ones.
    """
    return _kernels.point_errors(
        points,
        original_world.positions,
        original_world.linear,
        reduced_world.positions,
        reduced_world.linear,
    )


@dataclass(slots=True)
class TrackReduction:
    """A track with its current tolerance, fitted keys and their errors."""

    track: KeyTrack  # samples of one channel
    tolerance: float  # for the Euclidean error, in the unit of the samples
    # fraction of the tolerance at each frame ``(F,)`` [1]
    tolerance_fractions: FloatArray
    keys: FittedKeys  # keys fitted to the samples
    # Error of these keys at every frame ``(F,)``, in the unit of the samples.
    errors: FloatArray
    values: FloatArray  # values of these keys at every frame ``(F, D)``
    # Frames at which a straight segment starts.
    straight_starts: IntArray = field(default_factory=lambda: np.zeros(0, np.int64))

    @staticmethod
    def from_track(track: KeyTrack, tolerance: float) -> TrackReduction:
        """Return a track with keys fitted to the same tolerance in all frames."""
        ones = np.ones(len(track.samples))
        keys = fit_keys(track.samples, tolerance, bounds=track.range)
        reduction = TrackReduction(
            track, tolerance, ones, keys, 0 * ones, track.samples
        )
        reduction.update_errors()
        return reduction

    def scale_tolerance(self, factor: float) -> None:
        """Multiply the tolerance by a factor in all frames, and refit the keys."""
        self.tolerance *= factor
        self.tolerance_fractions = np.ones(len(self.tolerance_fractions))
        self.refit()

    def tighten_frames(
        self, frames: ArrayLike, new_tolerances: ArrayLike, *, moves_keys: bool
    ) -> None:
        """Reduce the tolerance around the given frames, and refit their segments.

        ``frames`` ``(N,)`` [frame], ``new_tolerances`` ``(N,)`` in the samples' unit.
        If not ``moves_keys``, keys are only added.
        """
        frame_indices = np.asarray(frames)
        fraction_limits = np.asarray(new_tolerances) / self.tolerance
        key_frames = self.keys.frames
        segment_indices = np.searchsorted(key_frames, frame_indices, side="right") - 1
        segment_indices = segment_indices.clip(0, max(0, len(key_frames) - 2))
        lengths = np.diff(key_frames)
        if not len(lengths):
            lengths = np.array([len(self.tolerance_fractions)])
        half_widths = np.maximum(1, lengths[segment_indices] // 4)
        columns = zip(frame_indices, fraction_limits, half_widths, strict=True)
        for frame, limit, half_width in columns:
            first = max(0, int(frame - half_width))
            fractions = self.tolerance_fractions[first : int(frame + half_width + 1)]
            np.minimum(fractions, limit, out=fractions)
        is_kept = np.ones(len(key_frames), np.bool_)
        segments = np.unique(segment_indices)
        if not moves_keys:
            segments = segments[np.isin(segments + 1, segments)]
        is_kept[(segments + 1).clip(max=len(key_frames) - 1)] = False
        self.refit(key_frames[1:-1][is_kept[1:-1]])

    def straighten_segments(self, frames: IntArray) -> None:
        """Force straight segments from the given frames, and refit the keys."""
        self.straight_starts = np.union1d(self.straight_starts, frames)
        self.tighten_frames(
            frames, self.tolerance_fractions[frames] * self.tolerance, moves_keys=False
        )

    def refit(self, anchors: ArrayLike = ()) -> None:
        """Fit keys within the current tolerances; anchors are frames that stay keys."""
        self.keys = fit_keys(
            self.track.samples,
            self.tolerance,
            tolerance_scale=self.tolerance_fractions,
            anchors=anchors,
            bounds=self.track.range,
            straight_frames=self.straight_starts,
        )
        self.update_errors()

    def update_errors(self) -> None:
        """Evaluate the keys at every frame, and store values and errors."""
        samples = self.track.samples
        self.values = evaluate_keys(self.keys, np.arange(len(samples)))
        self.errors = np.linalg.norm(self.values - samples, axis=1)

    def displacement_per_unit(self, distance: FloatArray | float) -> FloatArray:
        """Return the displacement per unit of error at a distance from the joint."""
        kind, lever_arms = self.track.kind, np.asarray(distance, np.float64)
        if kind is ChannelKind.TRANSLATION:
            return np.ones_like(lever_arms)
        return np.radians(lever_arms) if kind is ChannelKind.ROTATION else lever_arms


def subtree_maxima(parents: IntArray, values: FloatArray) -> FloatArray:
    """Return the maximum value over each joint and its descendants ``(F, J)``."""
    maxima = np.ascontiguousarray(values.T)
    for joint in range(len(maxima) - 1, -1, -1):
        if parents[joint] >= 0:
            parent_values = maxima[parents[joint]]
            np.maximum(parent_values, maxima[joint], out=parent_values)
    return maxima.T
