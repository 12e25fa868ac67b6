"""A stage of cameras around points, and what the cameras see of them."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np

from animtool.capture.cameras.camera import Camera, Cameras, project
from animtool.capture.cameras.observations import Observations
from animtool.core.array_types import FloatArray
from animtool.core.clock import Clock

LENS = (-0.08, 0.01, 0.0008, -0.0005, 0.002, 0.0, 0.0, 0.0)


def look_at(place: FloatArray, target: FloatArray, name: str, **more: Any) -> Camera:
    """Return a camera at a place [m] that looks at another, with Y up."""
    ahead = (target - place) / np.linalg.norm(target - place)
    right = np.cross(ahead, [0.0, 1.0, 0.0])
    right /= np.linalg.norm(right)
    rotation = np.stack([right, np.cross(ahead, right), ahead])
    return Camera(
        name, (1300.0, 1302.0), (955.0, 543.0), rotation, -rotation @ place,
        **{"size": (1920, 1080), **more},
    )  # fmt: skip


def ring(count: int, *, lens: tuple[float, ...] = LENS, turn: float = 1.0) -> Cameras:
    """Return cameras in a ring of 4.5 m around the origin, at two heights.

    turn: Share of the ring that they stand on.
    """
    angles = 2 * np.pi * turn * np.arange(count) / count
    places = [
        np.array([4.5 * np.cos(a), 1.2 + 1.1 * (i % 2), 4.5 * np.sin(a)])
        for i, a in enumerate(angles)
    ]
    made = [
        look_at(place, np.array([0.0, 1.0, 0.0]), f"cam{i}", distortion=lens)
        for i, place in enumerate(places)
    ]
    return Cameras(tuple(made))


def walkers(frames: int, markers: int, seed: int = 1) -> FloatArray:
    """Return points that move smoothly in a volume of 2 m ``(F, M, 3)``."""
    rng = np.random.default_rng(seed)
    t = np.arange(frames)[:, None, None] / 120
    phase = rng.uniform(0, 6, (1, markers, 3))
    middle = rng.uniform([-0.6, 0.2, -0.6], [0.6, 1.8, 0.6], (1, markers, 3))
    return np.asarray(middle + 0.2 * np.sin(2 * t + phase))


def observed(
    cameras: Cameras, points: FloatArray, *, noise: float = 0.4, seed: int = 2
) -> Observations:
    """Return what cameras see of points, with noise of each pixel's axis [px]."""
    rng = np.random.default_rng(seed)
    pixels = np.stack([project(c, points) for c in cameras.cameras], axis=1)
    pixels += rng.normal(0, noise, pixels.shape)
    names = tuple(f"M{i}" for i in range(points.shape[1]))
    clock = Clock(Fraction(120), Fraction(1), Fraction(1), len(points))
    return Observations(names, clock, pixels, cameras.names)


def changed(observations: Observations, pixels: FloatArray) -> Observations:
    """Return observations with other pixels."""
    return replace(observations, stored=pixels)


def write_observations(path: Path, observations: Observations, **more: Any) -> Path:
    """Write observations as an npz file."""
    arrays: dict[str, Any] = {
        "uv": observations.stored,
        "fs": np.array(float(observations.clock.rate)),
        "marker_names": np.array(observations.names),
        "camera_names": np.array(observations.cameras),
    }
    np.savez(path, **{k: v for k, v in {**arrays, **more}.items() if v is not None})
    return path


def cameras_text(cameras: Cameras) -> str:
    """Return cameras as a camera file."""
    lines = ["cameras: animtool/1", "views:"]
    for camera in cameras.cameras:
        fields = {
            "name": camera.name,
            "size": list(camera.size or (1920, 1080)),
            "focal": list(camera.focal),
            "centre": list(camera.centre),
            "distortion": list(camera.distortion),
            "rotation": camera.rotation.tolist(),
            "translation": camera.translation.tolist(),
        }
        body = ", ".join(f"{key}: {value}" for key, value in fields.items())
        lines.append(f"- {{{body}}}".replace("'", ""))
    return "\n".join(lines) + "\n"
