"""Cameras whose frames are late or early.

The points are projected into a camera at shifted frames: those of a camera that starts
late fit the pixels best at another frame than its own.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from animtool.capture.cameras.camera import Camera, project
from animtool.capture.cameras.observations import Observations
from animtool.core.array_types import FloatArray
from animtool.core.errors import Fault, Severity, counted

# A camera is tested if its error is this many times the median of the others, or it is
# excluded; with the right offset it is below that.
SUSPECT_ERROR_RATIO = 2.0
# Largest offset that is tested [frames], and the sample of frames.
MAX_DELAY, MAX_SAMPLED_FRAMES = 12, 300
# An offset must divide the error by this much.
MIN_DELAY_IMPROVEMENT = 1.5
MIN_CAMERAS = 3
# Smaller errors are rounding [px].
MIN_ERROR_PX = 1e-6


def delay_warnings(
    observations: Observations,
    cameras: Sequence[Camera],
    positions: FloatArray,
    errors: Sequence[float],
) -> dict[str, Fault]:
    """Return a warning for each camera that is likely late or early, by name (CAM115).

    Args:
        observations: The pixels of F frames, C cameras and M points.
        cameras: The C cameras.
        positions: Triangulated points ``(F, M, 3)`` [m]; NaN in gaps.
        errors: Reprojection error of each camera [px]; NaN for excluded ones.
    """
    if len(cameras) < MIN_CAMERAS or len(positions) <= 2 * MAX_DELAY:
        return {}
    warning_by_name: dict[str, Fault] = {}
    for camera_index, (camera, error) in enumerate(zip(cameras, errors, strict=True)):
        other_errors = [
            e for index, e in enumerate(errors) if index != camera_index and e > 0
        ]
        if not other_errors:
            continue
        max_error = SUSPECT_ERROR_RATIO * float(np.median(other_errors))
        if error <= max_error:
            continue
        delay, improvement, best_error = _best_delay(
            observations, camera, camera_index, positions
        )
        if improvement < MIN_DELAY_IMPROVEMENT or best_error > max_error:
            continue
        offset = f"{counted(abs(delay), 'frame')} {'late' if delay > 0 else 'early'}"
        message = f"camera {camera.name!r} is probably {offset}: shifted by {-delay}, "
        message += f"its points match the other cameras {improvement:.1f} times better"
        hint = f"shift its frames by {-delay}, or synchronise the cameras"
        path = observations.path or None
        fault = Fault("CAM115", message, path, (), hint, Severity.WARNING)
        warning_by_name[camera.name] = fault
    return warning_by_name


def _best_delay(
    observations: Observations, camera: Camera, camera_index: int, positions: FloatArray
) -> tuple[int, float, float]:
    """Return the delay of the best fit [frames], its improvement, and its error [px].

    The improvement is the error without a delay over that with it; 1 if too few
    points are visible.
    """
    frames = np.arange(MAX_DELAY, len(positions) - MAX_DELAY)
    frames = frames[:: max(1, len(frames) // MAX_SAMPLED_FRAMES)]
    projected_points = project(camera, positions[frames])
    camera_observations = replace(
        observations, stored=observations.stored[:, [camera_index]]
    )
    pixels = camera_observations.pixels(0, len(positions))[:, 0]
    delays = range(-MAX_DELAY, MAX_DELAY + 1)
    median_errors = []
    for delay in delays:
        lengths = np.linalg.norm(pixels[frames + delay] - projected_points, axis=-1)
        lengths = lengths[np.isfinite(lengths)]
        if not len(lengths):
            return 0, 1.0, np.inf
        median_errors.append(float(np.median(lengths)))
    best_index = int(np.argmin(median_errors))
    best_error = median_errors[best_index]
    improvement = median_errors[MAX_DELAY] / max(best_error, MIN_ERROR_PX)
    return delays[best_index], improvement, best_error
