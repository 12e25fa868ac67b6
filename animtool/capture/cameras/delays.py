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
SUSPECT_ERROR = 2.0
# Largest offset that is tested [frames], and the sample of frames.
MAX_DELAY, MAX_SAMPLED_FRAMES = 12, 300
# An offset must divide the error by this much.
MIN_IMPROVEMENT = 1.5
MIN_CAMERAS = 3
# Smaller errors are rounding [px].
MIN_ERROR = 1e-6


def delay_warnings(
    observations: Observations,
    cameras: Sequence[Camera],
    positions: FloatArray,
    errors: Sequence[float],
) -> dict[str, Fault]:
    """Return a warning for each camera that fits better some frames off, by name.

    The code is CAM115.

    Args:
        observations: The pixels of F frames, C cameras and M points.
        cameras: The C cameras.
        positions: Triangulated points ``(F, M, 3)`` [m]; NaN in gaps.
        errors: Reprojection error of each camera [px]; NaN for excluded ones.
    """
    if len(cameras) < MIN_CAMERAS or len(positions) <= 2 * MAX_DELAY:
        return {}
    warnings = []
    for c, (camera, error) in enumerate(zip(cameras, errors, strict=True)):
        others = [other for k, other in enumerate(errors) if k != c and other > 0]
        limit = SUSPECT_ERROR * float(np.median(others)) if others else 0.0
        if error <= limit or not others:
            continue
        delay, improvement, best_error = _best_delay(observations, camera, c, positions)
        if improvement < MIN_IMPROVEMENT or best_error > limit:
            continue
        offset = f"{counted(abs(delay), 'frame')} {'late' if delay > 0 else 'early'}"
        message = f"camera {camera.name!r} is likely {offset}: there its points are "
        message += f"{improvement:.1f} times nearer to those of the others"
        hint = f"shift its frames by {-delay}, or synchronise the cameras"
        path = observations.path or None
        fault = Fault("CAM115", message, path, (), hint, Severity.WARNING)
        warnings.append((camera.name, fault))
    return dict(warnings)


def _best_delay(
    observations: Observations, camera: Camera, index: int, positions: FloatArray
) -> tuple[int, float, float]:
    """Return the delay of the best fit [frames], its improvement, and its error [px].

    The improvement divides the error; it is 1 if no delay fits better, or too little
    is seen.
    """
    frames = np.arange(MAX_DELAY, len(positions) - MAX_DELAY)
    frames = frames[:: max(1, len(frames) // MAX_SAMPLED_FRAMES)]
    projected = project(camera, positions[frames])
    of_camera = replace(observations, stored=observations.stored[:, [index]])
    pixels = of_camera.pixels(0, len(positions))[:, 0]
    delays = range(-MAX_DELAY, MAX_DELAY + 1)
    errors = []
    for delay in delays:
        lengths = np.linalg.norm(pixels[frames + delay] - projected, axis=-1)
        lengths = lengths[np.isfinite(lengths)]
        if not len(lengths):
            return 0, 1.0, np.inf
        errors.append(float(np.median(lengths)))
    best = int(np.argmin(errors))
    improvement = errors[MAX_DELAY] / max(errors[best], MIN_ERROR)
    return delays[best], improvement, errors[best]
