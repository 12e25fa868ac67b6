"""Predicts hidden markers from the markers around them or from a skeleton.

References:
    Rasmussen, C. E. and Williams, C. K. I., "Gaussian Processes for Machine Learning",
    MIT Press, 2006, section 2.2.
    Gløersen, Ø. and Federolf, P., "Predicting Missing Marker Trajectories in Human
    Motion Data Using Marker Intercorrelations", PLOS ONE 11(3), 2016.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import product
from typing import TYPE_CHECKING

import numpy as np

from animtool.capture.markers.geometry import fit_shape, mean_shape
from animtool.core.array_types import BoolArray, FloatArray, IntArray
from animtool.core.record import dataclass

if TYPE_CHECKING:
    from animtool.capture.markers.skeleton import SkeletonMarkers

# Training window on either side of a gap [s].
TRAINING_SECONDS = 6.0
# Maximum number of training frames in total, and on each side next to the gap.
MAX_TRAINING_FRAMES, DENSE_FRAMES = 180, 16
MIN_TRAINING_FRAMES = 12
# Numbers of markers that define the frame, and the pose.
FRAME_MARKERS, POSE_MARKERS = (3, 4), (0, 5, 9)
# Noise of a position [m].
MARKER_NOISE = 0.0005
# Minimum noise variance relative to the kernel's variance [1], so that float64 can
# factor the matrix.
MIN_NOISE_RATIO = 1e-12
# Amplitude [m] and time scale [s] of a marker's deviation from the pose.
DEVIATION_KERNELS = ((0.004, 0.12), (0.03, 0.35))
# The same if no marker determines the joint.
LOOSE_KERNELS = (*DEVIATION_KERNELS, (0.05, 1.0))
# The same for a skeleton's prediction: none, or as skin moves.
SKIN_KERNELS = ((0.0, 1.0), *product((0.001, 0.004), (0.1, 0.3, 1.0)))
# Length scale of the pose kernel relative to the pose's spread [1]; 0 is infinite: the
# marker moves linearly with the pose.
LENGTH_SCALES = (0.0, 1.0, 3.0)
# Number of cross-validation spans.
VALIDATION_SPANS = 6


@dataclass(frozen=True, slots=True)
class Prediction:
    """Predicted positions of a marker in a gap."""

    positions: FloatArray  # ``(G, 3)`` [m]
    error: float  # cross-validation error in spans of the same length [m]


@dataclass(frozen=True, slots=True)
class MarkerGap:
    """A gap of a marker to predict, and the positions of the take."""

    positions: FloatArray  # ``(F, M, 3)`` [m], filled gaps included
    visible: BoolArray  # mask of the positions to learn from ``(F, M)``
    marker: int
    frames: slice  # frames of the gap
    # How much the distance to each marker varies ``(M,)`` [m].
    distance_deviations: FloatArray
    rate: float  # [frame/s]

    def nearest_markers(self) -> IntArray:
        """Return the markers visible throughout the gap, the most rigid first."""
        deviations = self.distance_deviations
        is_usable = self.visible[self.frames].all(axis=0) & np.isfinite(deviations)
        is_usable[self.marker] = False
        order = np.argsort(np.where(is_usable, deviations, np.inf), kind="stable")
        return np.asarray(order[: min(max(POSE_MARKERS), int(is_usable.sum()))])

    def training_frames(self, neighbours: IntArray) -> IntArray:
        """Return the frames to learn from: all near the gap, and some farther away."""
        gap, visible = self.frames, self.visible
        window = int(TRAINING_SECONDS * self.rate)
        first, end = max(gap.start - window, 0), min(gap.stop + window, len(visible))
        neighbours_visible = visible[first:end][:, neighbours].all(axis=1)
        is_usable = visible[first:end, self.marker] & neighbours_visible
        frames = np.flatnonzero(is_usable) + first
        frames = frames[(frames < gap.start) | (frames >= gap.stop)]
        is_before = frames < gap.start
        distance = np.where(is_before, gap.start - frames, frames - gap.stop + 1)
        dense_frames = frames[distance <= DENSE_FRAMES]
        other_frames = frames[distance > DENSE_FRAMES]
        count = MAX_TRAINING_FRAMES - len(dense_frames)
        if len(other_frames) > count:
            rows = np.linspace(0, len(other_frames) - 1, count).astype(np.int64)
            other_frames = other_frames[rows]
        return np.sort(np.concatenate([dense_frames, other_frames]))

    def with_gap_frames(self, training: IntArray) -> IntArray:
        """Return training frames followed by the frames of the gap."""
        return np.concatenate(
            [training, np.arange(self.frames.start, self.frames.stop)]
        )


def predict_from_markers(gap: MarkerGap) -> Prediction | None:
    """Return a marker's predicted positions in a gap; None if too few are visible.

    The marker is expressed in the frame of those around it that are most rigid with it.
    Its motion there is learnt from the frames in which it is visible: a Gaussian
    process over the others' pose, plus one over time that joins the ends.
    """
    neighbours = gap.nearest_markers()
    if len(neighbours) < 3:
        return None
    training = gap.training_frames(neighbours)
    if len(training) < MIN_TRAINING_FRAMES:
        return None
    frames = gap.with_gap_frames(training)
    predictions = []
    for count in FRAME_MARKERS:
        if count <= len(neighbours):
            local, pose, to_world = _in_neighbour_frame(gap, frames, neighbours, count)
            best = _best_prediction(gap, local, pose, frames, DEVIATION_KERNELS, count)
            predictions.append(replace(best, positions=to_world(best.positions)))
    return min(predictions, key=lambda prediction: prediction.error)


def _best_prediction(
    gap: MarkerGap,
    local: FloatArray,
    pose: FloatArray,
    frames: IntArray,
    deviation_kernels: tuple[tuple[float, float], ...],
    min_markers: int = 1,
) -> Prediction:
    """Return the prediction with the smallest cross-validation error of all kernels.

    local: Marker positions in a moving frame of reference ``(F, 3)``, visible in all
    frames but those of the gap, which are last. pose: Other markers in that frame, the
    most rigid first ``(F, K, 3)``. min_markers: Minimum number of pose markers, if
    there are any.
    """
    known = local[: len(frames) - (gap.frames.stop - gap.frames.start)]
    best_prediction: Prediction | None = None
    for pose_markers in POSE_MARKERS:
        if pose_markers > pose.shape[1]:
            continue
        pose_features = pose[:, : max(pose_markers, min_markers)].reshape(
            len(frames), -1
        )
        for length_scale, (deviation, time) in product(
            LENGTH_SCALES, deviation_kernels
        ):
            if not pose_markers and length_scale != LENGTH_SCALES[0]:
                continue
            kernel = _covariance(
                pose_features, frames / gap.rate, length_scale, deviation, time, known
            )
            error, values = _predict_gap(known, kernel, frames, gap.frames)
            if best_prediction is None or error < best_prediction.error:
                best_prediction = Prediction(values, error)
    assert best_prediction is not None
    return best_prediction


def predict_from_parent_joint(
    skeleton: SkeletonMarkers, gap: MarkerGap
) -> Prediction | None:
    """Return a marker's positions in a gap, predicted from its parent joint.

    None if the marker has no parent joint or too few frames to learn from. The marker
    is expressed in the frame of the parent joint, and in frames rotated towards each
    marker on the same joint. Its motion in these frames is learnt as in
    `predict_from_markers`.
    """
    positions, marker = gap.positions, gap.marker
    neighbours = gap.nearest_markers()
    training = gap.training_frames(neighbours)
    if len(training) < MIN_TRAINING_FRAMES or not skeleton.has_parent(marker):
        return None
    frames, known_count = gap.with_gap_frames(training), len(training)
    origin = skeleton.origins[frames, marker]
    parent_rotations = skeleton.parent_rotations[frames, marker]
    rotations = [parent_rotations]
    visible_throughout = np.asarray(gap.visible[gap.frames].all(axis=0))
    for marker_on_joint in skeleton.markers_on_joint(marker, visible_throughout):
        if np.isin(training, np.flatnonzero(gap.visible[:, marker_on_joint])).all():
            arms = positions[frames, marker_on_joint] - origin
            rotations.append(_rotate_towards(parent_rotations, arms))
    predictions = []
    for rotation in rotations:
        local = np.einsum("fji,fj->fi", rotation, positions[frames, marker] - origin)
        neighbour_offsets = positions[frames][:, neighbours] - origin[:, None]
        pose = np.einsum("fji,fkj->fki", rotation, neighbour_offsets)
        best = _best_prediction(gap, local, pose, frames, LOOSE_KERNELS)
        rotated = np.einsum("fij,fj->fi", rotation[known_count:], best.positions)
        predictions.append(replace(best, positions=rotated + origin[known_count:]))
    return min(predictions, key=lambda prediction: prediction.error)


def _rotate_towards(parent_rotations: FloatArray, arms: FloatArray) -> FloatArray:
    """Return frames ``(F, 3, 3)`` rotated by the shortest arc towards a point."""
    local_directions = np.einsum("fji,fj->fi", parent_rotations, arms)
    local_directions /= np.linalg.norm(local_directions, axis=1, keepdims=True)
    mean_direction = local_directions.mean(axis=0)
    mean_direction /= np.linalg.norm(mean_direction)
    axis = np.cross(mean_direction, local_directions)
    frames = np.zeros((len(local_directions), 3, 3))
    frames[:, 0, 1], frames[:, 0, 2] = -axis[:, 2], axis[:, 1]
    frames[:, 1, 2] = -axis[:, 0]
    frames -= frames.transpose(0, 2, 1)
    cosine = np.maximum(local_directions @ mean_direction, -0.99)
    swing = np.eye(3) + frames + frames @ frames / (1.0 + cosine)[:, None, None]
    return np.asarray(parent_rotations @ swing)


def predict_from_skeleton(skeleton: SkeletonMarkers, gap: MarkerGap) -> Prediction:
    """Return a marker's predicted positions in a gap from a skeleton.

    They are the marker's positions on the skeleton plus an offset: a Gaussian process
    over time, in the frame of its joint, that joins the ends. Amplitude and speed of
    skin motion are those with the least cross-validation error.
    """
    marker, training = gap.marker, gap.training_frames(np.zeros(0, np.int64))
    frames = gap.with_gap_frames(training)
    rotations, points = skeleton.rotations[frames, marker], skeleton.positions[frames]
    skeleton_path, known_count = points[:, marker], len(training)
    offsets = np.einsum(
        "fji,fj->fi",
        rotations[:known_count],
        gap.positions[training, marker] - skeleton_path[:known_count],
    )
    correction = np.zeros((gap.frames.stop - gap.frames.start, 3))
    least_error = np.inf
    no_pose = np.zeros((len(frames), 0))
    for deviation, time in SKIN_KERNELS if known_count >= MIN_TRAINING_FRAMES else ():
        kernel = _covariance(
            no_pose, frames / gap.rate, LENGTH_SCALES[0], deviation, time, offsets
        )
        error, values = _predict_gap(offsets, kernel, frames, gap.frames)
        if error < least_error:
            least_error, correction = error, values
    world_correction = np.einsum("fij,fj->fi", rotations[known_count:], correction)
    return Prediction(
        np.asarray(skeleton_path[known_count:] + world_correction, np.float64),
        least_error,
    )


def _in_neighbour_frame(
    gap: MarkerGap, frames: IntArray, neighbours: IntArray, count: int
) -> tuple[FloatArray, FloatArray, Callable[[FloatArray], FloatArray]]:
    """Return marker and pose in the frame of the nearest, and the inverse mapping."""
    neighbour_positions = gap.positions[frames][:, neighbours]
    shape = mean_shape(neighbour_positions[:, :count])
    rotation, shift = fit_shape(neighbour_positions[:, :count], shape)
    pose = np.einsum("fji,fkj->fki", rotation, neighbour_positions - shift[:, None])
    offset = gap.positions[frames, gap.marker] - shift
    local = np.einsum("fji,fj->fi", rotation, offset)

    def to_world(values: FloatArray) -> FloatArray:
        """Return positions of the gap in world space."""
        rotated = np.einsum("fij,fj->fi", rotation[-len(values) :], values)
        return np.asarray(rotated + shift[-len(values) :])

    return local, pose, to_world


def _predict_gap(
    known_positions: FloatArray, kernel: FloatArray, frames: IntArray, gap: slice
) -> tuple[float, FloatArray]:
    """Return cross-validation error and predicted positions of the gap.

    The error is that of known positions left out in spans as long as the gap [m].
    """
    from scipy.linalg import cho_factor, cho_solve

    known_count = len(known_positions)
    mean = known_positions.mean(axis=0)
    # Rounding of outlying samples exceeds the noise.
    variance = max(
        MARKER_NOISE**2,
        MIN_NOISE_RATIO * float(np.trace(kernel[:known_count])) / known_count,
    )
    cholesky_factor = cho_factor(kernel[:known_count] + variance * np.eye(known_count))
    inverse = cho_solve(cholesky_factor, np.eye(known_count))
    weights_of_known = inverse @ (known_positions - mean)
    values = kernel[known_count:] @ weights_of_known + mean
    length = gap.stop - gap.start
    training_frames = frames[:known_count]
    errors = []
    for begin in _validation_spans(training_frames, gap):
        is_left_out = (training_frames >= begin) & (training_frames < begin + length)
        left_out_rows = np.flatnonzero(is_left_out)
        if 0 < len(left_out_rows) < known_count - MIN_TRAINING_FRAMES:
            inverse_block = inverse[np.ix_(left_out_rows, left_out_rows)]
            residuals = np.linalg.solve(inverse_block, weights_of_known[left_out_rows])
            errors.append((residuals**2).sum(axis=1).mean())
    return (float(np.sqrt(np.mean(errors))) if errors else np.inf), values


def _validation_spans(training: IntArray, gap: slice) -> list[int]:
    """Return the starts of cross-validation spans on both sides of a gap."""
    length = gap.stop - gap.start
    starts = []
    for k in range(VALIDATION_SPANS // 2):
        starts.append(gap.start - (k + 1) * (length + 2))
        starts.append(gap.stop + k * (length + 2) + 2)
    return [
        start
        for start in starts
        if start + length > training[0] and start <= training[-1]
    ]


def _covariance(
    pose: FloatArray,
    times: FloatArray,
    length_scale: float,
    deviation: float,
    deviation_time: float,
    local: FloatArray,
) -> FloatArray:
    """Return the covariance of all frames with known frames ``(F, known)`` [m^2]."""
    known_count = len(local)
    variance = max(float(((local - local.mean(axis=0)) ** 2).mean()), MARKER_NOISE**2)
    distance = np.abs(times[:, None] - times[None, :known_count])
    lag = np.sqrt(5.0) * distance / deviation_time
    time_covariance = deviation**2 * (1.0 + lag + lag**2 / 3.0) * np.exp(-lag)
    centred_pose = pose - pose[:known_count].mean(axis=0)
    pose_spread = np.sqrt((centred_pose[:known_count] ** 2).sum(axis=1).mean())
    features = centred_pose / (pose_spread + 1e-9)
    products = features @ features[:known_count].T
    if length_scale:
        norms = (features**2).sum(axis=1)
        squares = norms[:, None] + norms[None, :known_count] - 2.0 * products
        squares = np.maximum(squares, 0.0)
        products = products + np.exp(-0.5 * squares / length_scale**2)
    return np.asarray(variance * products + time_covariance)
