"""Report of a triangulation: points, camera agreement and warnings."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import field
from pathlib import Path
from typing import ClassVar

import numpy as np

from animtool.capture.cameras.camera import Camera
from animtool.capture.cameras.stale import MIN_VIEWS, CameraDisagreement, PoseShift
from animtool.core.array_types import BoolArray, FloatArray
from animtool.core.clock import Clock
from animtool.core.errors import Fault, Severity, counted, listed, percent_text
from animtool.core.quantities import vector_text
from animtool.core.record import dataclass
from animtool.core.shot import frame_spans
from animtool.motion.markers import Markers

# Fraction of a camera's outliers above which it is reported [1].
MAX_CAMERA_OUTLIERS = 0.1
# Fraction of lost points in a frame above which it is reported [1].
MAX_LOST_FRACTION = 0.5
# If the principal point is nearer to the centre of an image turned by 90 degrees than
# this fraction of its distance to the centre, width and height are exchanged [1].
MAX_CENTRE_FRACTION = 0.3


@dataclass(frozen=True, slots=True)
class CameraReport:
    """One camera's agreement with the triangulated points, and where it moved.

    Attributes:
        name: Name of the camera.
        observed: Number of observations.
        used: Observations used for points.
        outliers: Fraction of the observations of triangulated points that were rejected
            [1].
        error_px: Root mean square reprojection error of the used observations [px].
        error_mm: The same error at the depth of the points [mm].
        noise_px: Measured standard deviation along an axis [px].
        no_ray: Number of observations outside the domain of its lens model.
        outside: Number of observations outside its image.
        shifts: Frame ranges in which it does not fit its calibration.
        disagrees: Single frames in which it disagrees with the others.
    """

    name: str
    observed: int
    used: int
    outliers: float
    error_px: float
    error_mm: float
    noise_px: float
    no_ray: int = 0
    outside: int = 0
    shifts: tuple[PoseShift, ...] = ()
    disagrees: tuple[CameraDisagreement, ...] = ()
    json_keys: ClassVar[str] = (
        "name observed used outliers noise_px reprojection=.{px=error_px mm=error_mm} "
        "moved=shifts disagrees"
    )


@dataclass(frozen=True, slots=True)
class Triangulation:
    """Result of a triangulation: points, and how well the cameras agree.

    Attributes:
        markers: The points, with camera counts and residuals.
        deviations: Standard error of each point [m] ``(F, M)``, NaN for a gap.
        cameras: One report for each.
        error_px: Root mean square reprojection error of used observations [px].
        error_mm: The same at the depth of the points [mm].
        visible: Points visible to two or more cameras.
        triangulated: Points that have a position.
        notices: Warnings and notes.
    """

    markers: Markers
    deviations: FloatArray = field(repr=False)
    cameras: tuple[CameraReport, ...]
    error_px: float
    error_mm: float
    visible: int
    triangulated: int
    notices: tuple[Fault, ...]
    source: Path | None = None  # the observations, if from files
    output: Path | None = None  # the marker file, likewise
    json_keys: ClassVar[str] = (
        "'mocap triangulate' observations=source output frames=markers.clock.count "
        "fps=markers.clock.rate markers=markers.names points=.{seen=visible "
        "found=triangulated} reprojection=.{px=error_px mm=error_mm} cameras notices"
    )

    @property
    def fraction(self) -> float:
        """Fraction of the visible points that have a position [1]."""
        return self.triangulated / max(1, self.visible)


@dataclass(frozen=True, slots=True)
class ObservationCounts:
    """The kernel's counts and squared residuals by frame and camera ``(F, C, 8)``."""

    tallies: FloatArray

    @property
    def used(self) -> FloatArray:
        """Number of observations used for points ``(F, C)``."""
        return self.tallies[..., 1]

    @property
    def tested(self) -> FloatArray:
        """Number of observations of points that have a position ``(F, C)``."""
        return self.tallies[..., 2]

    @property
    def rejected(self) -> FloatArray:
        """Number of outliers among observations of triangulated points ``(F, C)``."""
        return self.tallies[..., 3]

    def report(
        self, camera: int, name: str, noise: float, shifts: tuple[PoseShift, ...]
    ) -> CameraReport:
        """Return a camera's report: sums of its counts, and root mean square errors."""
        sums = self.tallies[:, camera].sum(axis=0)
        observed, used, tested, rejected, no_ray, squared_px, squared_m, outside = sums
        return CameraReport(
            name,
            int(observed),
            int(used),
            float(rejected / tested) if tested else 0.0,
            float(np.sqrt(squared_px / used)) if used else np.nan,
            float(1000 * np.sqrt(squared_m / used)) if used else np.nan,
            noise,
            int(no_ray),
            int(outside),
            shifts,
        )

    def reprojection_errors(self) -> tuple[float, float]:
        """Return the root mean square error of all used observations [px] and [mm]."""
        used = max(1.0, float(self.used.sum()))
        squared_px, squared_m = self.tallies[..., 5:7].sum(axis=(0, 1))
        return float(np.sqrt(squared_px / used)), float(
            1000 * np.sqrt(squared_m / used)
        )


def camera_notices(
    report: CameraReport, camera: Camera, clock: Clock, path: str, *, is_kept: bool
) -> Iterator[Fault]:
    """Yield warnings if a camera moved, sees nothing or has many outliers (CAM101-111).

    is_kept: Whether the camera is used even where its pose shifted.
    """

    def warning(code: str, text: str, hint: str | None = None) -> Fault:
        """Return a warning located in the observations file."""
        return Fault(code, text, path or None, (), hint, Severity.WARNING)

    for shift in report.shifts:
        is_every_frame = shift.first == 0 and shift.end == clock.count
        text = f"camera {report.name!r} moved in frames {shift.number} to "
        text += f"{shift.end}"
        if is_every_frame:
            text = f"camera {report.name!r} does not match its calibration in any frame"
        text += f": {percent_text(shift.outliers)} of its points are outliers"
        hint = "calibrate it again"
        if shift.change is not None and shift.change.matching:
            matching_name = repr(shift.change.matching)
            text += f", and the calibration of {matching_name} fits them within "
            text += f"{shift.change.error_px:.2g} px"
            hint = f"swap the points or the calibrations of {report.name!r} and "
            hint += matching_name
        elif shift.change is not None:
            text += f", and {shift.change} would explain it"
        if shift.kept:
            text += "; it is kept: without it, the others do not agree better"
        else:
            text += "; it is " + ("kept" if is_kept else "excluded")
            text += "" if is_kept or is_every_frame else " in these frames"
        yield warning("CAM101", text, hint)
    if report.disagrees:
        worst = max(report.disagrees, key=lambda disagreement: disagreement.outliers)
        frames_text = frame_spans([frame.number for frame in report.disagrees])
        text = f"camera {report.name!r} disagrees with the others in "
        text += f"{counted(len(report.disagrees), 'frame')}: {frames_text}"
        if worst.outliers > 0:
            text += f" ({percent_text(worst.outliers)} outliers in {worst.number})"
        hint = "was it bumped or out of sync there? its outliers are excluded"
        yield warning("CAM111", text, hint)
    if report.outliers > MAX_CAMERA_OUTLIERS and not report.shifts:
        text = f"{percent_text(report.outliers)} of the points of camera "
        text += f"{report.name!r} are "
        yield warning("CAM102", f"{text}outliers", "check its labels and its clock")
    if not report.observed:
        yield warning("CAM103", f"camera {report.name!r} sees nothing")
    if report.no_ray:
        text = f"{counted(report.no_ray, 'pixel')} of camera {report.name!r} are "
        text += "outside "
        yield warning("CAM106", f"{text}the range of its lens model")
    if report.outside and camera.size is not None:
        text = f"{counted(report.outside, 'pixel')} of camera {report.name!r} are "
        text += f"outside its image of {camera.size[0]} x {camera.size[1]}"
        yield warning("CAM107", text, _image_size_hint(camera, *camera.size))


def _image_size_hint(camera: Camera, width: int, height: int) -> str:
    """Return a hint for pixels outside an image: is it turned by 90 degrees?"""
    # The principal point is near the centre of an image.
    offset = math.dist(camera.centre, (width / 2, height / 2))
    turned_offset = math.dist(camera.centre, (height / 2, width / 2))
    if turned_offset >= MAX_CENTRE_FRACTION * offset:
        return "do calibration and observations have the same image size?"
    hint = "width and height look exchanged, as the principal point is at "
    return f"{hint}{vector_text(camera.centre)}: write {height} x {width}"


def lost_frame_notices(
    positions: FloatArray, is_visible: BoolArray, clock: Clock, path: str
) -> Iterator[Fault]:
    """Yield a warning about frames in which most visible points are gaps (CAM112).

    Positions ``(F, M, 3)`` are NaN in a gap; ``is_visible`` ``(F, M)`` marks points
    that two or more cameras see.
    """
    lost_counts = (is_visible & np.isnan(positions[..., 0])).sum(axis=1)
    lost_frames = np.flatnonzero(
        (lost_counts > MAX_LOST_FRACTION * is_visible.sum(axis=1))
        & (lost_counts >= MIN_VIEWS)
    )
    if not len(lost_frames) or len(lost_frames) == clock.count:
        return
    message = f"cameras disagree in {counted(len(lost_frames), 'frame')}: "
    message += f"{frame_spans((lost_frames + 1).tolist())}; most points there are gaps"
    hint = "too few cameras see them to tell which one is wrong: one may have moved"
    yield Fault("CAM112", message, path or None, (), hint, Severity.WARNING)


def gap_notices(
    names: Sequence[str], positions: FloatArray, visible_count: int, path: str
) -> Iterator[Fault]:
    """Yield warnings about points that are never triangulated, or not in some frames.

    positions: ``(F, M, 3)``, NaN for a gap.
    """
    is_triangulated = np.isfinite(positions[..., 0])
    missing_names = [
        names[i] for i in np.flatnonzero(~is_triangulated.any(axis=0)).tolist()
    ]
    if missing_names:
        text = f"no two cameras agree on {listed(missing_names)} in any frame"
        yield Fault("CAM104", text, path or None, severity=Severity.WARNING)
    lost_count = visible_count - int(is_triangulated.sum())
    if lost_count > 0:
        text = f"{counted(lost_count, 'point')} that two or more cameras see are gaps: "
        text += "no two agree, or their rays are too close to parallel"
        yield Fault("CAM105", text, path or None, severity=Severity.NOTE)
