"""Head poses: initial estimates from rigid landmarks, and poses across gaps."""

from __future__ import annotations

import numpy as np

from animtool.core.array_types import BoolArray, FloatArray
from animtool.maths.so3 import (
    align_signs,
    from_matrix,
    nearest_rotations,
    rotate,
    slerp,
)

# Iterations of reweighting, and of perspective.
ROBUST_ROUNDS = 4
PERSPECTIVE_ROUNDS = 30


def estimate_head_poses(neutral: FloatArray, landmarks: FloatArray) -> FloatArray:
    """Return a head pose per frame, quaternion (x, y, z, w) and translation ``(F, 7)``.

    Landmarks ``(F, N, 3)`` are NaN where missing. Those that move most have the least
    weight; frames with fewer than three repeat the last known pose.
    """
    is_visible: BoolArray = np.asarray(np.isfinite(landmarks).all(axis=-1))
    points = np.where(is_visible[..., None], landmarks, 0.0)
    robust_weights: FloatArray = is_visible.astype(np.float64)
    poses = np.zeros((len(landmarks), 7))
    poses[:, 3] = 1.0
    for _ in range(ROBUST_ROUNDS):
        poses = _kabsch_poses(neutral, points, robust_weights)
        posed_points = rotate(poses[:, None, :4], neutral[None]) + poses[:, None, 4:]
        distances = np.linalg.norm(points - posed_points, axis=-1)
        distances = np.where(is_visible, distances, np.nan)
        median_distances = np.full(len(distances), np.inf)
        has_landmarks: BoolArray = np.asarray(is_visible.any(axis=1))
        medians = np.nanmedian(distances[has_landmarks], axis=1)
        median_distances[has_landmarks] = np.maximum(medians, 1e-9)
        robust_weights = 1.0 / (1.0 + (distances / median_distances[:, None]) ** 2)
        robust_weights = np.where(is_visible, robust_weights, 0.0)
    return last_good_poses(poses, is_visible.sum(axis=1) >= 3)


def _kabsch_poses(
    neutral: FloatArray, points: FloatArray, robust_weights: FloatArray
) -> FloatArray:
    """Return weighted rigid poses by the Kabsch algorithm ``(F, 7)``."""
    weight_sums = np.maximum(robust_weights.sum(axis=1), 1e-300)[:, None]
    centre = robust_weights @ neutral / weight_sums
    centroid = np.einsum("fn,fni->fi", robust_weights, points) / weight_sums
    centred_points = neutral[None] - centre[:, None]
    covariance = np.einsum(
        "fn,fni,fnj->fij", robust_weights, points - centroid[:, None], centred_points
    )
    rotations = from_matrix(nearest_rotations(covariance))
    return np.concatenate([rotations, centroid - rotate(rotations, centre)], axis=1)


def last_good_poses(poses: FloatArray, is_good: BoolArray) -> FloatArray:
    """Replace bad poses ``(F, 7)`` with the last good pose before, else the first."""
    if not is_good.any():
        return poses
    last_good = np.maximum.accumulate(np.where(is_good, np.arange(len(is_good)), -1))
    return np.asarray(
        poses[np.where(last_good < 0, int(np.argmax(is_good)), last_good)]
    )


def estimate_camera_pose(
    neutral: FloatArray, pixels: FloatArray, camera: FloatArray
) -> FloatArray | None:
    """Return a head's pose in front of a camera ``(7,)``; None if not found.

    The pixels ``(N, 2)`` are free of lens distortion, NaN where missing; the camera is
    fx, fy, cx, cy [px].

    After D. F. DeMenthon and L. S. Davis, Model-based object pose in 25 lines of code,
    1995.
    """
    is_visible: BoolArray = np.asarray(np.isfinite(pixels).all(axis=1))
    if is_visible.sum() < 4:
        return None
    points = neutral[is_visible]
    image_points = (pixels[is_visible] - camera[2:]) / camera[:2]
    centre = points.mean(axis=0)
    inverse = np.linalg.pinv(np.c_[points - centre, np.ones(len(points))])
    depth = np.ones(len(points))
    rotation, shift = np.eye(3), np.zeros(3)
    for _ in range(PERSPECTIVE_ROUNDS):
        solution = inverse @ (image_points * depth[:, None])
        lengths = np.linalg.norm(solution[:3], axis=0)
        if not (np.isfinite(solution).all() and lengths.min() > 1e-12):
            return None
        scale = float(np.sqrt(lengths.prod()))
        first, second = solution[:3, 0] / lengths[0], solution[:3, 1] / lengths[1]
        u, _, vt = np.linalg.svd(np.stack([first, second, np.cross(first, second)]))
        rotation = u @ np.diag([1, 1, np.linalg.det(u @ vt)]) @ vt
        shift = np.array([solution[3, 0], solution[3, 1], 1.0]) / scale
        depth = 1.0 + (points - centre) @ rotation[2] / shift[2]
    quaternion = from_matrix(rotation[None])[0]
    return np.concatenate([quaternion, shift - rotation @ centre])


def interpolate_poses(
    poses: FloatArray, is_usable: BoolArray
) -> tuple[FloatArray, FloatArray]:
    """Split poses ``(F, 7)`` into rotations and translations, interpolated over gaps.

    Rotations ``(F, 4)`` have continuous signs; at both ends, the nearest pose holds.
    """
    rotations, shifts = align_signs(poses[:, :4]), poses[:, 4:].copy()
    if is_usable.all():
        return rotations, shifts
    good_frames, frames = np.flatnonzero(is_usable), np.arange(len(is_usable))
    rotations[good_frames] = align_signs(rotations[good_frames])
    next_index = np.minimum(np.searchsorted(good_frames, frames), len(good_frames) - 1)
    previous_index = np.maximum(np.searchsorted(good_frames, frames, "right") - 1, 0)
    previous_frame, next_frame = (good_frames[previous_index], good_frames[next_index])
    gap_length = np.maximum(next_frame - previous_frame, 1)
    fraction = np.clip((frames - previous_frame) / gap_length, 0.0, 1.0)
    is_gap = ~is_usable
    rotations[is_gap] = slerp(
        rotations[previous_frame[is_gap]],
        rotations[next_frame[is_gap]],
        fraction[is_gap],
    )
    start, end = shifts[previous_frame[is_gap]], shifts[next_frame[is_gap]]
    shifts[is_gap] = start + fraction[is_gap, None] * (end - start)
    return align_signs(rotations), shifts
