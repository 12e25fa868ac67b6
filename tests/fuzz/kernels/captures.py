"""Cameras that see points, and faces."""

from __future__ import annotations

from typing import Any

import numpy as np

Rng = np.random.Generator


def _cameras(rng: Rng, count: int) -> np.ndarray:
    """Return cameras about the origin ``(count, 27)``."""
    rows = np.zeros((count, 27))
    rows[:, :2] = rng.uniform(500, 2000, (count, 2))
    rows[:, 2:4] = rng.uniform(200, 1000, (count, 2))
    rows[:, 5:13] = rng.normal(scale=rng.choice([0.0, 0.05, 5.0]), size=(count, 8))
    for row in rows:
        turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
        row[13:22] = turn.ravel()
        row[22:25] = np.add(rng.normal(size=3), (0, 0, 4))
    return rows


def _pixels(rng: Rng, shape: tuple[int, ...]) -> np.ndarray:
    pixels = rng.uniform(-200, 2200, (*shape, 2))
    pixels[rng.random(shape) < 0.2] = np.nan
    return pixels


def _triangulate(rng: Rng) -> dict[str, Any]:
    frames, cameras, markers = (int(rng.integers(0, most)) for most in (4, 7, 5))
    shape = (frames, cameras, markers)
    return {
        "pixels": _pixels(rng, shape),
        "confidences": rng.random(shape) if rng.integers(2) else None,
        "cameras": _cameras(rng, cameras),
        "is_active": rng.random((frames, cameras)) < 0.9,
        "noise": rng.uniform(0.1, 3, cameras),
        "outlier_gate": float(rng.uniform(2, 6)),
        "max_condition": float(rng.choice([1e2, 1e6])),
        "has_details": bool(rng.integers(2)),
    }


def _least_median(rng: Rng) -> dict[str, Any]:
    frames, cameras, markers = (int(rng.integers(0, most)) for most in (4, 7, 5))
    return {
        "pixels": _pixels(rng, (frames, cameras, markers)),
        "cameras": _cameras(rng, cameras),
    }


def _face(rng: Rng) -> dict[str, Any]:
    frames, landmarks, shapes = (int(rng.integers(0, most)) for most in (4, 9, 5))
    camera = np.array([900.0, 900, 400, 300]) if rng.integers(2) else None
    neutral = rng.normal(scale=0.1, size=(1, landmarks, 3))
    observed = rng.normal(scale=0.1, size=(frames, landmarks, 3))
    if camera is not None:
        observed = rng.uniform(0, 800, (frames, landmarks, 2))
    observed[rng.random((frames, landmarks)) < 0.2] = np.nan
    poses = np.zeros((frames, 7))
    poses[:, 3] = 1
    poses[:, 6] = 0.5
    return {
        "neutral": neutral,
        "deltas": rng.normal(scale=0.02, size=(shapes, landmarks, 3)),
        "observed": observed,
        "camera": camera,
        "poses": poses,
        "weights": rng.random((frames, shapes)),
        "threshold": float(rng.uniform(1e-4, 10)),
        "smooth": float(rng.choice([0.0, 1e-3, 1.0])),
        "rest": float(rng.choice([0.0, 1e-4, 1.0])),
        "tolerance": 1e-4,
        "max_iterations": int(rng.integers(1, 6)),
        "is_warm_start": bool(rng.integers(2)),
    }


CALLS = {
    "triangulate_points": _triangulate,
    "least_median_residuals": _least_median,
    "fit_face": _face,
}
# What is not seen has no place, residual or share.
UNBOUNDED: frozenset[str] = frozenset(CALLS)
