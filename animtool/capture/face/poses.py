"""Initial head poses from a face's landmarks at rest."""

from __future__ import annotations

import numpy as np

from animtool.core.array_types import BoolArray, FloatArray
from animtool.maths.so3 import from_matrix, rotate

# Rounds of reweighting, and of perspective.
ROUNDS = 4
PERSPECTIVE_ROUNDS = 30


def head_poses(neutral: FloatArray, observed: FloatArray) -> FloatArray:
    """Return a head pose per frame, quaternion (x, y, z, w) and translation ``(F, 7)``.

    Landmarks that move most have the least weight. Frames with fewer than three
    landmarks repeat the last known pose.

    Args:
        neutral: Landmarks at rest ``(N, 3)``.
        observed: Likewise in the world, NaN where missing ``(F, N, 3)``.
    """
    visible: BoolArray = np.asarray(np.isfinite(observed).all(axis=-1))
    points = np.where(visible[..., None], observed, 0.0)
    shares: FloatArray = visible.astype(np.float64)
    poses = np.zeros((len(observed), 7))
    poses[:, 3] = 1.0
    for _ in range(ROUNDS):
        poses = _rigid(neutral, points, shares)
        placed = rotate(poses[:, None, :4], neutral[None]) + poses[:, None, 4:]
        miss = np.where(visible, np.linalg.norm(points - placed, axis=-1), np.nan)
        limits = np.full(len(miss), np.inf)
        some: BoolArray = np.asarray(visible.any(axis=1))
        limits[some] = np.maximum(np.nanmedian(miss[some], axis=1), 1e-9)
        shares = np.where(visible, 1.0 / (1.0 + (miss / limits[:, None]) ** 2), 0.0)
    return last_good_poses(poses, visible.sum(axis=1) >= 3)


def _rigid(neutral: FloatArray, points: FloatArray, shares: FloatArray) -> FloatArray:
    """Return poses by Kabsch's rule, weighted ``(F, 7)``."""
    total = np.maximum(shares.sum(axis=1), 1e-300)[:, None]
    middle = shares @ neutral / total
    target = np.einsum("fn,fni->fi", shares, points) / total
    away = neutral[None] - middle[:, None]
    covariance = np.einsum("fn,fni,fnj->fij", shares, points - target[:, None], away)
    u, _, vt = np.linalg.svd(covariance)
    signs = np.ones((len(points), 3))
    signs[:, 2] = np.sign(np.linalg.det(u @ vt))
    rotations = from_matrix((u * signs[:, None]) @ vt)
    return np.concatenate([rotations, target - rotate(rotations, middle)], axis=1)


def last_good_poses(poses: FloatArray, good: BoolArray) -> FloatArray:
    """Return poses with each bad one replaced by the last good one, or the first."""
    if not good.any():
        return poses
    before = np.maximum.accumulate(np.where(good, np.arange(len(good)), -1))
    return np.asarray(poses[np.where(before < 0, int(np.argmax(good)), before)])


def camera_pose(
    neutral: FloatArray, pixels: FloatArray, camera: FloatArray
) -> FloatArray | None:
    """Return a head's pose before a camera ``(7,)``; None if not found.

    Args:
        neutral: Landmarks at rest ``(N, 3)``.
        pixels: Where they are seen, free of lens distortion, NaN where missing
            ``(N, 2)``.
        camera: fx, fy, cx, cy [px].

    References:
        D. F. DeMenthon and L. S. Davis, Model-based object pose in 25 lines of code,
        1995.
    """
    visible: BoolArray = np.asarray(np.isfinite(pixels).all(axis=1))
    if visible.sum() < 4:
        return None
    points, image = neutral[visible], (pixels[visible] - camera[2:]) / camera[:2]
    middle = points.mean(axis=0)
    inverse = np.linalg.pinv(np.c_[points - middle, np.ones(len(points))])
    depth = np.ones(len(points))
    rotation, shift = np.eye(3), np.zeros(3)
    for _ in range(PERSPECTIVE_ROUNDS):
        rows = inverse @ (image * depth[:, None])
        lengths = np.linalg.norm(rows[:3], axis=0)
        if not (np.isfinite(rows).all() and lengths.min() > 1e-12):
            return None
        scale = float(np.sqrt(lengths.prod()))
        first, second = rows[:3, 0] / lengths[0], rows[:3, 1] / lengths[1]
        u, _, vt = np.linalg.svd(np.stack([first, second, np.cross(first, second)]))
        rotation = u @ np.diag([1, 1, np.linalg.det(u @ vt)]) @ vt
        shift = np.array([rows[3, 0], rows[3, 1], 1.0]) / scale
        depth = 1.0 + (points - middle) @ rotation[2] / shift[2]
    quaternion = from_matrix(rotation[None])[0]
    return np.concatenate([quaternion, shift - rotation @ middle])
