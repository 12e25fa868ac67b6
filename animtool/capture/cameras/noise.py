"""Observation noise and stale cameras, measured on a sample of frames.

References:
    Rousseeuw, Least median of squares regression, 1984; the median of chi-square is
    that of Wilson and Hilferty, 1931.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np
import numpy.typing as npt

from animtool import _kernels
from animtool.capture.cameras.camera import Camera, camera_parameters
from animtool.capture.cameras.observations import Observations
from animtool.capture.cameras.stale import PoseChange, fit_pose_change
from animtool.core.array_types import BoolArray, Float32Array, FloatArray
from animtool.core.record import dataclass

# Points for the noise estimate: enough for a few percent.
NOISE_SAMPLE_POINTS = 1500
# Points at which all pairs of cameras are compared.
PAIRWISE_POINTS = 400
# Median length of a vector of two normal numbers of deviation 1: sqrt(2 ln 2).
MEDIAN_LENGTH_2D = 1.1774100225154747
# Expected least median of residuals over pairs of rays, relative to the noise, by the
# number of cameras that see a point, from 2 on. Measured with cameras around a volume.
_LEAST_MEDIAN_FACTORS = (0.50, 0.20, 0.83, 0.61, 0.91, 0.76, 0.94, 0.83, 0.97)
# With less, a gate would follow the rounding of pixels [px].
MIN_NOISE = 0.05
# Cameras share one noise unless a camera's differs by this factor.
SIMILAR_NOISE = 1.5
# Largest noise of a camera, relative to the noise of all.
_MAX_NOISE_RATIO = 3.0
# A camera whose noise is this many times that of all may be stale.
_SUSPECT_NOISE_RATIO = 1.1
_MAX_SUSPECTS = 4
# Minimum fraction of triangulated points for cameras to agree [1].
MIN_TRIANGULATED = 0.5
_NOISE_ROUNDS = 2
_UNLIMITED_GATE = 1e6  # a gate that accepts everything
# The kernel's state of an observation.
USED_STATE, _REJECTED_STATE, _INACTIVE_STATE = 1, 2, 3


@dataclass(frozen=True, slots=True)
class ObservationNoise:
    """Noise of each camera's observations."""

    deviations_px: FloatArray  # standard deviation of an axis [px] ``(C,)``
    # Cameras that another pose fits much better in all frames, by index.
    pose_changes: dict[int, PoseChange]
    do_cameras_agree: bool = True  # whether cameras agree on most of the points


def measure_noise(
    observations: Observations,
    cameras: Sequence[Camera],
    gate: float,
    max_condition: float,
) -> ObservationNoise:
    """Estimate each camera's pixel noise on a sample of frames, and find stale cameras.

    Observations beyond ``gate`` standard deviations are outliers; ``max_condition``
    limits the condition of a point, as in the kernel `triangulate_points`.
    """
    frame_count, view_count, marker_count = observations.stored.shape[:3]
    frame_step = max(1, frame_count * marker_count // NOISE_SAMPLE_POINTS)
    pixels = observations.pixels(0, frame_count, frame_step)
    confidences = observations.confidences_of(0, frame_count, frame_step)
    kernel_cameras = camera_parameters(cameras)
    noise = np.full(view_count, initial_noise(pixels, kernel_cameras))
    is_active = np.ones(pixels.shape[:2], bool)
    pose_changes: dict[int, PoseChange] = {}
    limits = (gate, max_condition)
    triangulate = partial(
        _kernels.triangulate_points, pixels, confidences, kernel_cameras
    )
    for round_ in range(_NOISE_ROUNDS + view_count):
        *_, residuals, states = triangulate(is_active, noise, *limits, has_details=True)
        residual_lengths = _residual_lengths(residuals)
        if confidences is not None:
            residual_lengths = residual_lengths * np.sqrt(np.maximum(confidences, 0))
        pooled_noise = _pooled_noise(residual_lengths, states == USED_STATE)
        if pooled_noise is None:
            break
        camera_noises = _camera_noise(residual_lengths, states)
        median_noise = (
            np.nanmedian(camera_noises) if np.isfinite(camera_noises).any() else 1.0
        )
        ratios = np.nan_to_num(camera_noises / median_noise, nan=1.0)
        noise = np.maximum(pooled_noise * _noise_factors(ratios), MIN_NOISE)
        stale_fit = _find_stale_camera(
            cameras, pixels, confidences, noise, is_active, ratios, limits
        )
        if stale_fit is not None:
            stale_camera, pose_changes[stale_camera] = stale_fit
            is_active[:, stale_camera] = False
            is_kept = is_active[0]
            noise[:] = initial_noise(pixels[:, is_kept], kernel_cameras[is_kept])
        elif round_ >= _NOISE_ROUNDS - 1:
            break
    points, *_ = triangulate(is_active, noise, *limits, has_details=False)
    view_counts = (np.isfinite(pixels).all(axis=-1) & is_active[..., None]).sum(axis=1)
    triangulated_count = int(np.isfinite(points[..., 0]).sum())
    if triangulated_count < MIN_TRIANGULATED * (view_counts > 1).sum():
        # If no two cameras agree, or any two do, all are pooled.
        pose_changes, is_active = {}, np.ones_like(is_active)
        *_, residuals, states = triangulate(
            is_active, noise, _UNLIMITED_GATE, max_condition, has_details=True
        )
        pooled_noise = _pooled_noise(_residual_lengths(residuals), states == USED_STATE)
        noise[:] = noise if pooled_noise is None else max(pooled_noise, MIN_NOISE)
        return ObservationNoise(noise, pose_changes, do_cameras_agree=False)
    noise[list(pose_changes)] = np.median(noise[is_active[0]])
    return ObservationNoise(noise, pose_changes)


def sampled_noise(observations: Observations, cameras: Sequence[Camera]) -> float:
    """Return the `initial_noise` of a sample of the frames, for all cameras [px]."""
    frame_count, _, marker_count = observations.stored.shape[:3]
    frame_step = max(1, frame_count * marker_count // NOISE_SAMPLE_POINTS)
    pixels = observations.pixels(0, frame_count, frame_step)
    return initial_noise(pixels, camera_parameters(cameras))


def _residual_lengths(residuals: Float32Array) -> Any:
    """Return the lengths ``(F, C, M)`` of residual vectors ``(F, C, M, 2)`` [px]."""
    return np.sqrt(np.einsum("fcmi,fcmi->fcm", residuals, residuals))


def _noise_factors(ratios: FloatArray) -> FloatArray:
    """Return each camera's bounded factor of the pooled noise; 1 if nearly equal."""
    is_similar = (ratios < SIMILAR_NOISE) & (ratios > 1 / SIMILAR_NOISE)
    bounded_ratios = np.clip(ratios, 1 / _MAX_NOISE_RATIO, _MAX_NOISE_RATIO)
    return np.asarray(np.where(is_similar, 1.0, bounded_ratios))


def _find_stale_camera(
    cameras: Sequence[Camera],
    pixels: FloatArray,
    confidences: FloatArray | None,
    noise: FloatArray,
    is_active: BoolArray,
    ratios: FloatArray,
    limits: tuple[float, float],
) -> tuple[int, PoseChange] | None:
    """Return the index of the likeliest stale camera and its pose change, or None.

    It is the one without which the others agree best. Only one is returned, since a
    stale camera makes others look worse.
    """
    if is_active[0].sum() < 3:
        return None
    suspect_cameras = np.argsort(-ratios, kind="stable")
    stale_fits: list[tuple[float, int, PoseChange]] = []
    for camera in suspect_cameras[:_MAX_SUSPECTS].tolist():
        if not is_active[0, camera] or ratios[camera] < _SUSPECT_NOISE_RATIO:
            continue
        is_active_other = is_active.copy()
        is_active_other[:, camera] = False
        points, errors, *_ = _kernels.triangulate_points(
            pixels, confidences, camera_parameters(cameras), is_active_other, noise,
            *limits, has_details=False,
        )  # fmt: skip
        others = [*cameras[:camera], *cameras[camera + 1 :]]
        pose_change = fit_pose_change(
            cameras[camera], points, pixels[:, camera], others
        )
        if pose_change is not None:
            stale_fits.append(
                (float(np.nanmedian(errors[..., 0])), camera, pose_change)
            )
    if not stale_fits:
        return None
    _, camera, pose_change = min(stale_fits, key=lambda stale_fit: stale_fit[:2])
    return camera, pose_change


def initial_noise(pixels: FloatArray, kernel_cameras: FloatArray) -> float:
    """Estimate the noise by least median of squares over camera pairs [px]."""
    pixels = pixels[:: max(1, pixels.shape[0] * pixels.shape[2] // PAIRWISE_POINTS)]
    view_counts = np.isfinite(pixels).all(axis=-1).sum(axis=1)
    pixels = np.ascontiguousarray(pixels)
    least_medians = _kernels.least_median_residuals(pixels, kernel_cameras)
    has_estimate = np.isfinite(least_medians) & (view_counts > 1)
    if not has_estimate.any():
        return 1.0
    factor_indices = np.clip(view_counts - 2, 0, len(_LEAST_MEDIAN_FACTORS))
    factors = np.array([*_LEAST_MEDIAN_FACTORS, 1.0])[factor_indices]
    return max(
        float(np.median(least_medians[has_estimate] / factors[has_estimate])), MIN_NOISE
    )


def _pooled_noise(lengths: FloatArray, is_used: BoolArray) -> float | None:
    """Estimate the common noise from the chi-square median of the points [px]."""
    camera_counts = is_used.sum(axis=1)
    square_sums = np.where(is_used, lengths, 0.0)
    square_sums = (square_sums * square_sums).sum(axis=1)[camera_counts > 1]
    degrees_of_freedom = 2.0 * camera_counts[camera_counts > 1] - 3
    if not len(square_sums):
        return None
    expected_median = degrees_of_freedom * (1 - 2 / (9 * degrees_of_freedom)) ** 3
    return float(np.sqrt(np.median(square_sums / expected_median)))


def _camera_noise(lengths: FloatArray, states: npt.NDArray[np.uint8]) -> FloatArray:
    """Estimate each camera's noise from its median residual [px] ``(C,)``."""
    is_used = states == USED_STATE
    other_counts = is_used.sum(axis=1)[:, None] - is_used
    is_compared = is_used | (states == _REJECTED_STATE) | (states == _INACTIVE_STATE)
    is_compared &= other_counts > 1
    # A point seen by n cameras takes 3 of their 2n residuals.
    residual_fraction = np.where(
        is_used, 1 - 1.5 / np.maximum(other_counts + is_used, 2), 1.0
    )
    scaled_lengths = np.where(
        is_compared & np.isfinite(lengths), lengths / np.sqrt(residual_fraction), np.nan
    )
    camera_noises = np.full(lengths.shape[1], np.nan)
    for camera in range(len(camera_noises)):
        camera_lengths = scaled_lengths[:, camera]
        if np.isfinite(camera_lengths).sum() >= 20:
            camera_noises[camera] = np.nanmedian(camera_lengths) / MEDIAN_LENGTH_2D
    return camera_noises
