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
AXES_MARKERS, POSE_MARKERS = (3, 4), (0, 5, 9)
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
VALIDATION_SPAN_COUNT = 6


@dataclass(frozen=True, slots=True)
class Prediction:
    """Predicted positions of a marker in a gap."""

    positions: FloatArray  # ``(G, 3)`` [m]
    error: float  # cross-validation error in spans of the same length [m]


@dataclass(frozen=True, slots=True)
class MarkerGap:
    """A marker's gap, with the positions in the take from which to predict it."""

    positions: FloatArray  # ``(F, M, 3)`` [m], filled gaps included
    is_visible: BoolArray  # mask of the positions to learn from ``(F, M)``
    marker: int
    frames: slice  # frames of the gap
    # How much the distance to each marker varies ``(M,)`` [m].
    distance_deviations: FloatArray
    rate: float  # [frame/s]

    def nearest_markers(self) -> IntArray:
        """Return the markers visible throughout the gap, the most rigid first."""
        deviations = self.distance_deviations
        is_usable = self.is_visible[self.frames].all(axis=0) & np.isfinite(deviations)
        is_usable[self.marker] = False
        order = np.argsort(np.where(is_usable, deviations, np.inf), kind="stable")
        return np.asarray(order[: min(max(POSE_MARKERS), int(is_usable.sum()))])

    def training_frames(self, neighbours: IntArray) -> IntArray:
        """Return the frames to learn from: all near the gap, and some farther away."""
        gap, is_visible = self.frames, self.is_visible
        window = int(TRAINING_SECONDS * self.rate)
        first, end = max(gap.start - window, 0), min(gap.stop + window, len(is_visible))
        are_neighbours_visible = is_visible[first:end][:, neighbours].all(axis=1)
        is_usable = is_visible[first:end, self.marker] & are_neighbours_visible
        frames = np.flatnonzero(is_usable) + first
        frames = frames[(frames < gap.start) | (frames >= gap.stop)]
        is_before = frames < gap.start
        distance = np.where(is_before, gap.start - frames, frames - gap.stop + 1)
        dense_frames = frames[distance <= DENSE_FRAMES]
        other_frames = frames[distance > DENSE_FRAMES]
        max_other_frames = MAX_TRAINING_FRAMES - len(dense_frames)
        if len(other_frames) > max_other_frames:
            rows = np.linspace(0, len(other_frames) - 1, max_other_frames).astype(
                np.int64
            )
            other_frames = other_frames[rows]
        return np.sort(np.concatenate([dense_frames, other_frames]))

    def with_gap_frames(self, training: IntArray) -> IntArray:
        """Return the training frames, and after them the frames of the gap."""
        return np.concatenate(
            [training, np.arange(self.frames.start, self.frames.stop)]
        )


def predict_from_markers(gap: MarkerGap) -> Prediction | None:
    """Predict a marker in a gap from other markers; None if too few are visible.

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
    for axes_marker_count in AXES_MARKERS:
        if axes_marker_count <= len(neighbours):
            relative_path, pose, to_world = _in_neighbour_axes(
                gap, frames, neighbours, axes_marker_count
            )
            prediction = _best_prediction(
                gap, relative_path, pose, frames, DEVIATION_KERNELS, axes_marker_count
            )
            predictions.append(
                replace(prediction, positions=to_world(prediction.positions))
            )
    return min(predictions, key=lambda prediction: prediction.error)


def _best_prediction(
    gap: MarkerGap,
    relative_path: FloatArray,
    pose: FloatArray,
    frames: IntArray,
    deviation_kernels: tuple[tuple[float, float], ...],
    min_markers: int = 1,
) -> Prediction:
    """Return the prediction with the smallest cross-validation error of all kernels.

    relative_path: Marker positions in moving axes ``(F, 3)``, visible in all frames but
    those of the gap, which are last. pose: Other markers in these axes, the most
    rigid first ``(F, K, 3)``. min_markers: Minimum number of pose markers, if
    there are any.
    """
    known_positions = relative_path[
        : len(frames) - (gap.frames.stop - gap.frames.start)
    ]
    best_prediction: Prediction | None = None
    for pose_marker_count in POSE_MARKERS:
        if pose_marker_count > pose.shape[1]:
            continue
        pose_features = pose[:, : max(pose_marker_count, min_markers)].reshape(
            len(frames), -1
        )
        for length_scale, (deviation, time_scale) in product(
            LENGTH_SCALES, deviation_kernels
        ):
            if not pose_marker_count and length_scale != LENGTH_SCALES[0]:
                continue
            kernel = _covariance(
                pose_features,
                frames / gap.rate,
                length_scale,
                deviation,
                time_scale,
                known_positions,
            )
            error, values = _predict_gap(known_positions, kernel, frames, gap.frames)
            if best_prediction is None or error < best_prediction.error:
                best_prediction = Prediction(values, error)
    assert best_prediction is not None
    return best_prediction


def predict_from_parent_joint(
    skeleton: SkeletonMarkers, gap: MarkerGap
) -> Prediction | None:
    """Predict a marker in a gap relative to the parent of its joint.

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
    is_always_visible = np.asarray(gap.is_visible[gap.frames].all(axis=0))
    for marker_on_joint in skeleton.markers_on_joint(marker, is_always_visible):
        if np.isin(training, np.flatnonzero(gap.is_visible[:, marker_on_joint])).all():
            directions = positions[frames, marker_on_joint] - origin
            rotations.append(_rotate_towards(parent_rotations, directions))
    predictions = []
    for rotation in rotations:
        relative_path = np.einsum(
            "fji,fj->fi", rotation, positions[frames, marker] - origin
        )
        neighbour_offsets = positions[frames][:, neighbours] - origin[:, None]
        pose = np.einsum("fji,fkj->fki", rotation, neighbour_offsets)
        prediction = _best_prediction(gap, relative_path, pose, frames, LOOSE_KERNELS)
        path = np.einsum("fij,fj->fi", rotation[known_count:], prediction.positions)
        predictions.append(replace(prediction, positions=path + origin[known_count:]))
    return min(predictions, key=lambda prediction: prediction.error)


def _rotate_towards(parent_rotations: FloatArray, directions: FloatArray) -> FloatArray:
    """Turn axes ``(F, 3, 3)`` by the shortest arc so that they follow a direction.

    directions: In the world ``(F, 3)``. In the turned axes they all point where they
    point on average in the given ones.
    """
    local_directions = np.einsum("fji,fj->fi", parent_rotations, directions)
    local_directions /= np.linalg.norm(local_directions, axis=1, keepdims=True)
    mean_direction = local_directions.mean(axis=0)
    mean_direction /= np.linalg.norm(mean_direction)
    axis = np.cross(mean_direction, local_directions)
    cross_matrices = np.zeros((len(local_directions), 3, 3))
    cross_matrices[:, 0, 1], cross_matrices[:, 0, 2] = -axis[:, 2], axis[:, 1]
    cross_matrices[:, 1, 2] = -axis[:, 0]
    cross_matrices -= cross_matrices.transpose(0, 2, 1)
    cosine = np.maximum(local_directions @ mean_direction, -0.99)
    swing = (
        np.eye(3)
        + cross_matrices
        + cross_matrices @ cross_matrices / (1.0 + cosine)[:, None, None]
    )
    return np.asarray(parent_rotations @ swing)


def predict_from_skeleton(skeleton: SkeletonMarkers, gap: MarkerGap) -> Prediction:
    """Predict a marker in a gap from its position on a solved skeleton.

    The offset from that position is predicted by a Gaussian process over time, in the
    frame of the marker's joint, that joins the ends. Amplitude and speed of skin
    motion are those with the least cross-validation error.
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
    for deviation, time_scale in (
        SKIN_KERNELS if known_count >= MIN_TRAINING_FRAMES else ()
    ):
        kernel = _covariance(
            no_pose, frames / gap.rate, LENGTH_SCALES[0], deviation, time_scale, offsets
        )
        error, values = _predict_gap(offsets, kernel, frames, gap.frames)
        if error < least_error:
            least_error, correction = error, values
    world_correction = np.einsum("fij,fj->fi", rotations[known_count:], correction)
    return Prediction(
        np.asarray(skeleton_path[known_count:] + world_correction, np.float64),
        least_error,
    )


def _in_neighbour_axes(
    gap: MarkerGap, frames: IntArray, neighbours: IntArray, axes_marker_count: int
) -> tuple[FloatArray, FloatArray, Callable[[FloatArray], FloatArray]]:
    """Return the marker and its neighbours in axes that follow the nearest ones.

    The last result maps positions in these axes in the gap back to the world.
    """
    neighbour_positions = gap.positions[frames][:, neighbours]
    neighbour_shape = mean_shape(neighbour_positions[:, :axes_marker_count])
    rotation, shift = fit_shape(
        neighbour_positions[:, :axes_marker_count], neighbour_shape
    )
    pose = np.einsum("fji,fkj->fki", rotation, neighbour_positions - shift[:, None])
    offset = gap.positions[frames, gap.marker] - shift
    relative_path = np.einsum("fji,fj->fi", rotation, offset)

    def to_world(values: FloatArray) -> FloatArray:
        """Map positions in the last frames, ``(G, 3)``, to the world."""
        path = np.einsum("fij,fj->fi", rotation[-len(values) :], values)
        return np.asarray(path + shift[-len(values) :])

    return relative_path, pose, to_world


def _predict_gap(
    known_positions: FloatArray, kernel: FloatArray, frames: IntArray, gap: slice
) -> tuple[float, FloatArray]:
    """Return the cross-validation error [m] and the positions in the gap ``(G, 3)``.

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
    known_weights = inverse @ (known_positions - mean)
    gap_positions = kernel[known_count:] @ known_weights + mean
    length = gap.stop - gap.start
    training = frames[:known_count]
    errors = []
    for begin in _validation_spans(training, gap):
        is_left_out = (training >= begin) & (training < begin + length)
        left_out = np.flatnonzero(is_left_out)
        if 0 < len(left_out) < known_count - MIN_TRAINING_FRAMES:
            inverse_block = inverse[np.ix_(left_out, left_out)]
            residuals = np.linalg.solve(inverse_block, known_weights[left_out])
            errors.append((residuals**2).sum(axis=1).mean())
    return (float(np.sqrt(np.mean(errors))) if errors else np.inf), gap_positions


def _validation_spans(training: IntArray, gap: slice) -> list[int]:
    """Return first frames of spans as long as the gap, before and after it."""
    length = gap.stop - gap.start
    starts = []
    for k in range(VALIDATION_SPAN_COUNT // 2):
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
    time_scale: float,
    known_positions: FloatArray,
) -> FloatArray:
    """Return the covariance of all F frames with the K known ones ``(F, K)`` [m^2].

    It is the sum of a kernel over the pose and a Matérn kernel over time.
    """
    known_count = len(known_positions)
    variance = max(
        float(((known_positions - known_positions.mean(axis=0)) ** 2).mean()),
        MARKER_NOISE**2,
    )
    distance = np.abs(times[:, None] - times[None, :known_count])
    lag = np.sqrt(5.0) * distance / time_scale
    time_covariance = deviation**2 * (1.0 + lag + lag**2 / 3.0) * np.exp(-lag)
    centred_pose = pose - pose[:known_count].mean(axis=0)
    pose_spread = np.sqrt((centred_pose[:known_count] ** 2).sum(axis=1).mean())
    features = centred_pose / (pose_spread + 1e-9)
    products = features @ features[:known_count].T
    if length_scale:
        norms = (features**2).sum(axis=1)
        squared_distances = norms[:, None] + norms[None, :known_count] - 2.0 * products
        squared_distances = np.maximum(squared_distances, 0.0)
        products = products + np.exp(-0.5 * squared_distances / length_scale**2)
    return np.asarray(variance * products + time_covariance)
