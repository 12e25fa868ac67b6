"""Cameras that moved after calibration: which, when, and by how much."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from animtool._types import BoolArray, FloatArray
from animtool.maths.so3 import exp, from_matrix, log, to_matrix
from animtool.mocap.cameras.camera import Camera, project

# Share of outliers from which a camera does not fit its calibration [1].
MOVED = 0.5
# How long it must last [s], and how many observations say so.
MIN_SECONDS = 0.25
MIN_OBSERVATIONS = 20
_STEPS = 8


@dataclass(frozen=True, slots=True)
class PoseChange:
    """A motion of a camera.

    Attributes:
        angle: How far it turned [rad].
        distance: How far it went [m].
        error_px: Median reprojection error that is left with it [px].
    """

    angle: float
    distance: float
    error_px: float

    def __str__(self) -> str:
        """Return it in words."""
        turn = f"a turn of {np.degrees(self.angle):.2f} degrees"
        way = f"a shift of {1000 * self.distance:.1f} mm"
        return f"{turn} and {way} (reprojection then {self.error_px:.2f} px)"


@dataclass(frozen=True, slots=True)
class Moved:
    """Frames through which a camera does not fit its calibration.

    Attributes:
        first: The first one, from 0.
        end: Behind the last one.
        outliers: Share of what it sees that are outliers [1].
        change: What would explain it; None where nothing does.
    """

    first: int
    end: int
    outliers: float
    change: PoseChange | None = None


def moved_ranges(
    judged: FloatArray, rejected: FloatArray, active: BoolArray, rate: float
) -> tuple[int, list[Moved]] | None:
    """Return the camera that fits worst, and where; None where all fit.

    A camera that would leave fewer than two is not taken.

    Args:
        judged: Observations of found points ``(F, C)``.
        rejected: Outliers among them ``(F, C)``.
        active: Cameras that take part ``(F, C)``.
        rate: Frames a second.
    """
    window = max(1, min(len(judged), round(MIN_SECONDS * rate)))
    best: tuple[int, list[Moved]] | None = None
    most = 0
    for camera in range(judged.shape[1]):
        live = active[:, camera] & (active.sum(axis=1) > 2)
        count = _around(np.where(live, judged[:, camera], 0), window)
        wrong = _around(np.where(live, rejected[:, camera], 0), window)
        off = live & (wrong > MOVED * count) & (count >= MIN_OBSERVATIONS)
        ranges = [
            Moved(a, b, _share(judged, rejected, camera, a, b))
            for a, b in _runs(off, window)
        ]
        total = sum(int(rejected[m.first : m.end, camera].sum()) for m in ranges)
        if total > most:
            best, most = (camera, ranges), total
    return best


def _share(
    judged: FloatArray, rejected: FloatArray, camera: int, a: int, b: int
) -> float:
    return float(rejected[a:b, camera].sum() / max(1, judged[a:b, camera].sum()))


def _around(values: FloatArray, window: int) -> FloatArray:
    """Return sums over a window around each frame ``(F,)``, cut at the ends."""
    total = np.concatenate([[0], np.cumsum(values)])
    frames = np.arange(len(values))
    first = np.maximum(frames - window // 2, 0)
    end = np.minimum(first + window, len(values))
    first = np.maximum(end - window, 0)
    return np.asarray(total[end] - total[first])


def _runs(off: BoolArray, window: int) -> list[tuple[int, int]]:
    """Return runs of frames of a window and more, gaps shorter than one closed."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], off.astype(np.int8), [0]])))
    closed: list[list[int]] = []
    for a, b in edges.reshape(-1, 2).tolist():
        if closed and a - closed[-1][1] < window:
            closed[-1][1] = b
        else:
            closed.append([a, b])
    # What lasts for a window is off for half of one at least around it.
    return [(a, b) for a, b in closed if b - a >= max(1, window // 2)]


def pose_change(
    camera: Camera, points: FloatArray, pixels: FloatArray
) -> PoseChange | None:
    """Return the motion of a camera that fits its pixels best; None where none does.

    Gauss-Newton steps with residuals weighted by 1 / (1 + r / s), s their median.

    Args:
        camera: As it was calibrated.
        points: In the world [m] ``(F, M, 3)``, NaN for gaps.
        pixels: What it sees of them ``(F, M, 2)``, NaN for what it does not.
    """
    known = np.isfinite(points).all(axis=-1) & np.isfinite(pixels).all(axis=-1)
    points, pixels = points[known], pixels[known]
    if len(points) < MIN_OBSERVATIONS:
        return None
    rotation, translation = camera.rotation, camera.translation
    moved = camera
    for _ in range(_STEPS):
        moved = Camera(
            camera.name, camera.focal, camera.centre, rotation, translation,
            camera.size, camera.skew, camera.distortion,
        )  # fmt: skip
        off = project(moved, points) - pixels
        lengths = np.linalg.norm(off, axis=-1)
        usable = np.isfinite(lengths)
        if usable.sum() < MIN_OBSERVATIONS:
            return None
        middle = max(float(np.median(lengths[usable])), 1e-6)
        weights = np.where(usable, 1 / (1 + lengths / middle), 0.0)
        slopes = _slopes(moved, points)
        usable &= np.isfinite(slopes).all(axis=(1, 2))
        root = np.sqrt(weights[usable])[:, None]
        matrix = (slopes[usable] * root[..., None]).reshape(-1, 6)
        step = np.linalg.lstsq(matrix, -(off[usable] * root).ravel(), rcond=None)[0]
        rotation = to_matrix(exp(step[:3])) @ rotation
        translation = to_matrix(exp(step[:3])) @ translation + step[3:]
    left = np.linalg.norm(project(moved, points) - pixels, axis=-1)
    before = np.linalg.norm(project(camera, points) - pixels, axis=-1)
    if not np.nanmedian(left) < 0.5 * np.nanmedian(before):
        return None
    turn = log(from_matrix(moved.rotation @ camera.rotation.T))
    return PoseChange(
        float(np.linalg.norm(turn)),
        float(np.linalg.norm(moved.position - camera.position)),
        float(np.nanmedian(left)),
    )


def _slopes(camera: Camera, points: FloatArray) -> FloatArray:
    """Return pixels by a turn and a shift in the camera's frame ``(N, 2, 6)``."""
    here = project(camera, points)
    size = 1e-6
    columns = []
    for axis in range(6):
        turn = to_matrix(exp(size * np.eye(6)[axis][:3]))
        shift = size * np.eye(6)[axis][3:]
        nudged = Camera(
            camera.name, camera.focal, camera.centre, turn @ camera.rotation,
            turn @ camera.translation + shift, camera.size, camera.skew,
            camera.distortion,
        )  # fmt: skip
        columns.append((project(nudged, points) - here) / size)
    return np.stack(columns, axis=-1)
