"""Cameras that moved after calibration: which, when, and by how much."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from typing import ClassVar

import numpy as np

from animtool.capture.cameras.camera import Camera, project
from animtool.core.array_types import BoolArray, FloatArray
from animtool.core.record import dataclass
from animtool.maths.runs import merge_runs, runs
from animtool.maths.so3 import exp, from_matrix, log, to_matrix

# Minimum fraction of outliers of a camera that does not fit its calibration [1].
MISFIT_FRACTION = 0.5
# Minimum duration [s] and number of observations to judge it.
MIN_SHIFT_SECONDS = 0.25
MIN_OBSERVATIONS = 20
_GAUSS_NEWTON_STEPS = 8
# Minimum observations for testing a camera in a frame; how far the other observations
# deviate, over the noise; and by how many standard errors.
MIN_VIEWS, MAX_DEVIATION_RATIO, MAX_STANDARD_ERRORS = 3, 2.0, 6.0

# Error of another camera that fits, over the camera's own error; neighbours reach .28.
MATCH_ERROR_RATIO = 0.05


@dataclass(frozen=True, slots=True)
class PoseChange:
    """Rotation and shift of a camera since its calibration, and its error after it."""

    angle: float  # rotation [rad]
    distance: float  # translation [m]
    error_px: float  # median reprojection error after the change [px]
    matching: str = ""  # name of a camera whose calibration fits as well; or empty

    def __str__(self) -> str:
        """Return rotation [deg], shift [mm] and error [px] as text for messages."""
        rotation = f"a rotation of {np.degrees(self.angle):.2f} degrees"
        shift = f"a shift of {1000 * self.distance:.1f} mm"
        return f"{rotation} and {shift} (reprojection then {self.error_px:.2f} px)"


@dataclass(frozen=True, slots=True)
class PoseShift:
    """A range of frames in which a camera does not fit its calibration."""

    first: int  # index of the first frame
    end: int  # one past the last frame
    outliers: float  # fraction of its observations that are outliers [1]
    # The pose change that explains it; None if none does.
    change: PoseChange | None = None
    # Whether it is used anyway, because leaving it out improves nothing.
    kept: bool = False
    json_keys: ClassVar[str] = (
        "first=number last=end outliers kept "
        "change{angle_rad=angle distance_m=distance reprojection_px=error_px matching}"
    )

    @property
    def number(self) -> int:
        """Number of the first frame, counted from 1."""
        return self.first + 1


@dataclass(frozen=True, slots=True)
class CameraDisagreement:
    """A frame in which a camera does not agree with the others."""

    frame: int  # frame index
    outliers: float  # fraction of its observations that are outliers [1]
    # Root mean square reprojection error of the other observations [px]; NaN if there
    # are none.
    error_px: float
    json_keys: ClassVar[str] = "frame=number outliers error_px"

    @property
    def number(self) -> int:
        """Number of the frame, counted from 1."""
        return self.frame + 1


def find_shifted_ranges(
    tested_counts: FloatArray, rejections: FloatArray, is_active: BoolArray, rate: float
) -> tuple[int, list[PoseShift]] | None:
    """Return the camera with most outliers and its misfit ranges; None if all fit.

    Counts of observations of triangulated points, outliers among them and use of the
    cameras are ``(F, C)``. A camera is skipped if fewer than two would remain without
    it.
    """
    window = max(1, min(len(tested_counts), round(MIN_SHIFT_SECONDS * rate)))
    worst_fit: tuple[int, list[PoseShift]] | None = None
    most_rejections = 0
    for camera in range(tested_counts.shape[1]):
        is_tested = is_active[:, camera] & (is_active.sum(axis=1) > 2)
        window_counts, window_rejections = (
            _window_sums(np.where(is_tested, counts[:, camera], 0), window)
            for counts in (tested_counts, rejections)
        )
        is_misfit = (
            is_tested
            & (window_rejections > MISFIT_FRACTION * window_counts)
            & (window_counts >= MIN_OBSERVATIONS)
        )
        active_rejections = np.where(is_tested[:, None], rejections, 0.0)
        ranges = _exact_ranges(
            tested_counts, active_rejections, camera, is_misfit, window
        )
        rejection_total = sum(
            int(rejections[shift.first : shift.end, camera].sum()) for shift in ranges
        )
        if rejection_total > most_rejections:
            worst_fit, most_rejections = (camera, ranges), rejection_total
    return worst_fit


def find_stale_ranges(
    tested_counts: FloatArray, rejections: FloatArray, camera: int, rate: float
) -> list[PoseShift]:
    """Return ranges in which an unused camera does not fit; the full take by default.

    Arguments are those of `find_shifted_ranges`.
    """
    window = max(1, min(len(tested_counts), round(MIN_SHIFT_SECONDS * rate)))
    window_counts = _window_sums(tested_counts[:, camera], window)
    window_rejections = _window_sums(rejections[:, camera], window)
    is_observed = window_counts >= MIN_OBSERVATIONS
    is_misfit = (window_rejections > MISFIT_FRACTION * window_counts) | ~is_observed
    if not (is_misfit & is_observed).any():
        is_misfit[:] = True
    return _exact_ranges(tested_counts, rejections, camera, is_misfit, window)


def find_disagreements(
    tallies: FloatArray, camera: int, noise: float, is_active: BoolArray
) -> list[CameraDisagreement]:
    """Return single frames in which a camera does not agree with the others.

    ``tallies`` are tallies of the kernel ``(F, C, 8)``; the noise is the standard
    deviation of an axis of the camera's observations [px].
    """
    _, used_counts, tested_counts, rejections, _, squared_px, *_ = tallies[:, camera].T
    with np.errstate(invalid="ignore", divide="ignore"):
        noise_ratios = squared_px / used_counts / (2 * noise**2)
        max_ratios = 1 + MAX_STANDARD_ERRORS / np.sqrt(used_counts)
    is_mostly_rejected = rejections > MISFIT_FRACTION * tested_counts
    is_noisy = (used_counts >= MIN_VIEWS) & (
        noise_ratios > np.maximum(MAX_DEVIATION_RATIO**2, max_ratios)
    )
    is_active = is_active & (tested_counts >= MIN_VIEWS)
    frame_indices = np.flatnonzero(is_active & (is_mostly_rejected | is_noisy))
    return [
        CameraDisagreement(
            f,
            float(rejections[f] / tested_counts[f]),
            float(np.sqrt(squared_px[f] / used_counts[f]))
            if used_counts[f]
            else float("nan"),
        )
        for f in frame_indices.tolist()
    ]


def truncated_error(
    residuals: FloatArray,
    is_visible: BoolArray,
    noise: FloatArray,
    gate: float,
    has_extra_camera: BoolArray | bool = False,
) -> float:
    """Return the truncated mean squared reprojection error over its expectation.

    Residuals ``(F, C, M, 2)`` [px] beyond the gate, a multiple of the noise ``(C,)``
    [px], are set to the gate, and so are NaN ones of points without a position. Only
    ``is_visible`` observations count; ``has_extra_camera`` ``(F, M)`` marks points that
    one more camera is used for.
    """
    squared_ratios = (residuals**2).sum(axis=-1) / noise[:, None] ** 2
    squared_ratios = np.where(
        np.isfinite(squared_ratios), np.minimum(squared_ratios, gate**2), gate**2
    )
    camera_counts = is_visible.sum(axis=1)
    # A point takes 3 of the 2n residuals of all n cameras that see it.
    degrees_of_freedom = 2 * camera_counts - 3 * camera_counts / np.maximum(
        camera_counts + has_extra_camera, 1
    )
    return float(
        squared_ratios[is_visible].sum() / max(float(degrees_of_freedom.sum()), 1e-12)
    )


def _exact_ranges(
    tested_counts: FloatArray,
    rejections: FloatArray,
    camera: int,
    is_misfit: BoolArray,
    window: int,
) -> list[PoseShift]:
    """Return runs of misfit windows, extended by adjacent frames with outliers."""
    is_frame_rejected = np.append(
        rejections[:, camera] > MISFIT_FRACTION * tested_counts[:, camera], False
    )
    # A shift that lasts a window shows for at least half of one around it.
    min_frames = max(1, window // 2)
    ranges = []
    for start, end in merge_runs(runs(is_misfit), window):
        if end - start < min_frames:
            continue
        first = start - int(np.argmin(is_frame_rejected[:start][::-1])) if start else 0
        if start and is_frame_rejected[:start].all():
            first = 0
        last = end + int(np.argmin(is_frame_rejected[end:]))
        observation_count = max(1, tested_counts[first:last, camera].sum())
        outliers = float(rejections[first:last, camera].sum() / observation_count)
        ranges.append(PoseShift(first, last, outliers))
    return ranges


def _window_sums(values: FloatArray, window: int) -> FloatArray:
    """Return sums over the ``window`` frames around each frame of the take ``(F,)``."""
    cumulative_sums = np.concatenate([[0], np.cumsum(values)])
    frames = np.arange(len(values))
    first = np.maximum(frames - window // 2, 0)
    end = np.minimum(first + window, len(values))
    first = np.maximum(end - window, 0)
    return np.asarray(cumulative_sums[end] - cumulative_sums[first])


def fit_pose_change(
    camera: Camera,
    points: FloatArray,
    pixels: FloatArray,
    others: Iterable[Camera] = (),
) -> PoseChange | None:
    """Return the pose change that fits a camera's pixels best; None if none fits.

    World positions ``(F, M, 3)`` [m] and pixels ``(F, M, 2)`` are NaN where missing.
    The pixels may belong to one of the other cameras instead.
    """
    is_valid = np.isfinite(points).all(axis=-1) & np.isfinite(pixels).all(axis=-1)
    points, pixels = points[is_valid], pixels[is_valid]
    if len(points) < MIN_OBSERVATIONS:
        return None
    initial_error = _median_error(camera, points, pixels)
    # The pose of another camera may be too far away for the steps to get there.
    refined_camera = min(
        others, key=lambda other: _median_error(other, points, pixels), default=camera
    )
    refined_error = _median_error(refined_camera, points, pixels)
    matching = refined_camera.name
    if not refined_error < MATCH_ERROR_RATIO * initial_error:
        refined_camera, matching = _refined_camera(camera, points, pixels), ""
        refined_error = _median_error(refined_camera, points, pixels)
    if not refined_error < 0.5 * initial_error:
        return None
    rotation_vector = log(from_matrix(refined_camera.rotation @ camera.rotation.T))
    return PoseChange(
        float(np.linalg.norm(rotation_vector)),
        float(np.linalg.norm(refined_camera.position - camera.position)),
        refined_error,
        matching,
    )


def _refined_camera(camera: Camera, points: FloatArray, pixels: FloatArray) -> Camera:
    """Return the camera with the pose that fits points ``(N, 3)`` best.

    Gauss-Newton steps with residuals weighted by 1 / (1 + r / s), s their median.
    """
    rotation, translation = camera.rotation, camera.translation
    refined_camera = camera
    for _ in range(_GAUSS_NEWTON_STEPS):
        refined_camera = replace(camera, rotation=rotation, translation=translation)
        residual_vectors = project(refined_camera, points) - pixels
        lengths = np.linalg.norm(residual_vectors, axis=-1)
        is_usable = np.isfinite(lengths)
        if is_usable.sum() < MIN_OBSERVATIONS:
            return camera
        median_length = max(float(np.median(lengths[is_usable])), 1e-6)
        weights = np.where(is_usable, 1 / (1 + lengths / median_length), 0.0)
        jacobian = _pixel_derivatives(refined_camera, points)
        is_usable &= np.isfinite(jacobian).all(axis=(1, 2))
        root_weights = np.sqrt(weights[is_usable])[:, None]
        design_matrix = (jacobian[is_usable] * root_weights[..., None]).reshape(-1, 6)
        weighted_residuals = (residual_vectors[is_usable] * root_weights).ravel()
        step = np.linalg.lstsq(design_matrix, -weighted_residuals, rcond=None)[0]
        rotation = to_matrix(exp(step[:3])) @ rotation
        translation = to_matrix(exp(step[:3])) @ translation + step[3:]
    return refined_camera


def _median_error(camera: Camera, points: FloatArray, pixels: FloatArray) -> float:
    """Return the median reprojection error of the points in a camera's view [px]."""
    distances = np.linalg.norm(project(camera, points) - pixels, axis=-1)
    return float(np.nanmedian(distances)) if np.isfinite(distances).any() else np.inf


def _pixel_derivatives(camera: Camera, points: FloatArray) -> FloatArray:
    """Return the Jacobian of pixels with respect to the camera's pose ``(N, 2, 6)``."""
    projected_points = project(camera, points)
    increment = 1e-6
    slopes = []
    for axis in range(6):
        rotation = to_matrix(exp(increment * np.eye(6)[axis][:3]))
        shift = increment * np.eye(6)[axis][3:]
        shifted_camera = replace(
            camera,
            rotation=rotation @ camera.rotation,
            translation=rotation @ camera.translation + shift,
        )
        slopes.append((project(shifted_camera, points) - projected_points) / increment)
    return np.stack(slopes, axis=-1)
