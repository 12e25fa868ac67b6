"""Triangulation of points from calibrated cameras.

Each point minimises the sum of squared reprojection errors. If the residual shows a
wrong observation, cameras are left out until the others agree, or the point that most
cameras agree on is searched for. Points that no two cameras agree on are gaps.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any, NoReturn

import numpy as np

from animtool import _kernels
from animtool.capture.cameras.camera import Cameras, camera_parameters
from animtool.capture.cameras.conventions import MIN_IMPROVEMENT, better_convention
from animtool.capture.cameras.delays import delay_warnings
from animtool.capture.cameras.noise import USED_STATE, measure_noise, sampled_noise
from animtool.capture.cameras.observations import (
    Observations,
    match_cameras,
    pixels_in_other_conventions,
)
from animtool.capture.cameras.report import (
    ObservationCounts,
    Triangulation,
    camera_notices,
    gap_notices,
    lost_frame_notices,
)
from animtool.capture.cameras.stale import (
    CameraDisagreement,
    PoseChange,
    PoseShift,
    find_disagreements,
    find_shifted_ranges,
    find_stale_ranges,
    fit_pose_change,
    truncated_error,
)
from animtool.capture.markers.plausible import plausibility_warnings
from animtool.capture.options import TriangulateOptions
from animtool.core.array_types import BoolArray, FloatArray
from animtool.core.errors import Fault, OptionError, Severity, counted
from animtool.core.quantities import pixels_text
from animtool.maths.runs import runs
from animtool.motion.markers import Markers

# Observations per block: memory stays below 50 MB.
BLOCK_VALUES = 500_000
# With noise above this fraction of an image's width, cameras and observations do not
# belong together [1].
MAX_NOISE_FRACTION = 0.03
# Keypoint detectors have less noise than this fraction of the width [1].
SUSPECT_NOISE_FRACTION = 0.01
# Number of frames for estimating a camera's pose change.
_POSE_CHANGE_FRAMES = 50
# Relative difference below which errors count as equal [1]: outliers of a camera that
# is kept are rejected anyway.
TIE_COST_RATIO = 1.02

Progress = Callable[[float], None]


def triangulate(
    observations: Observations,
    cameras: Cameras,
    options: TriangulateOptions | None = None,
    *,
    progress: Progress | None = None,
) -> Triangulation:
    """Triangulate the points that calibrated cameras observe.

    Args:
        observations: Pixels in each frame.
        cameras: Calibrated cameras, in any order if the observations name cameras.
        options: Triangulation options; None uses the defaults.
        progress: Called with the fraction done.

    Raises:
        OptionError: Cameras and observations do not belong together (CAM011, CAM014),
            there is one camera (CAM012), no point is seen by two (CAM013), or an
            option is out of range (CAP001).
    """
    options = options or TriangulateOptions()
    _check_options(options)
    cameras = match_cameras(observations, cameras)
    return _TriangulationRun(observations, cameras, options, progress).run()


def _check_options(options: TriangulateOptions) -> None:
    """Raise unless gate and noise are above 0 and the angle is below 90° (CAP001)."""
    for name in ("gate", "noise"):
        value = getattr(options, name)
        if value is not None and not 0 < value < np.inf:
            message = f"{name} must be above 0 and finite, not {value:g}"
            raise OptionError(Fault("CAP001", message, where=name))
    if not 0 <= options.min_angle < np.pi / 2:
        degrees = np.degrees(options.min_angle)
        message = "the smallest angle must be from 0 to below 90 degrees, not "
        message += f"{degrees:g}"
        raise OptionError(Fault("CAP001", message, where="min_angle"))


# Warnings about a camera that a delay explains.
DELAY_CODES = {"CAM101", "CAM102", "CAM111"}


class _TriangulationRun:
    """A triangulation in progress: noise, points, tallies and active cameras."""

    def __init__(
        self,
        observations: Observations,
        cameras: Cameras,
        options: TriangulateOptions,
        progress: Progress | None,
    ) -> None:
        self.observations, self.cameras, self.options = observations, cameras, options
        self.progress = progress
        shape = observations.stored.shape
        self.frame_count, self.view_count, self.marker_count = shape[:3]
        self.kernel_cameras = camera_parameters(cameras.cameras)
        self.is_active = np.ones((self.frame_count, self.view_count), bool)
        self.noise = np.ones(self.view_count)
        self.positions = np.full((self.frame_count, self.marker_count, 3), np.nan)
        self.statistics = np.full((self.frame_count, self.marker_count, 5), np.nan)
        self.counts = ObservationCounts(
            np.zeros((self.frame_count, self.view_count, 8))
        )
        self.notices = [*cameras.notices, *observations.notices]
        self.shifts: list[list[PoseShift]] = [[] for _ in range(self.view_count)]

    def run(self) -> Triangulation:
        """Triangulate all frames; exclude cameras where they moved, and solve again."""
        pose_changes = self._measure_noise()
        self._solve_frames(0, self.frame_count)
        self._exclude_stale_cameras(pose_changes)
        self._exclude_shifted_cameras()
        self._check_triangulated()
        return self._build_result()

    def _measure_noise(self) -> dict[int, PoseChange]:
        """Measure the noise; return the stale cameras with their pose changes."""
        if self.options.noise is not None:
            self.noise = np.full(self.view_count, float(self.options.noise))
            return {}
        gate, cameras = self.options.gate, self.cameras.cameras
        noise = measure_noise(self.observations, cameras, gate, self._max_condition)
        if not self.options.keep_moved:
            self.is_active[:, list(noise.pose_changes)] = False
        self.noise = noise.deviations_px
        median_noise = float(np.median(self.noise))
        widths = [c.size[0] if c.size else 2 * c.centre[0] for c in cameras]
        width = max(1.0, float(np.median(widths)))
        max_noise = SUSPECT_NOISE_FRACTION * width
        if noise.pose_changes or not noise.do_cameras_agree or median_noise > max_noise:
            self._refuse_other_convention(max_noise)
            self._refuse_other_pixels(max_noise)
        if median_noise > MAX_NOISE_FRACTION * width:
            message = "cameras disagree: their rays miss each other by "
            message += pixels_text(median_noise)
            self._refuse_cameras(message)
        if not noise.do_cameras_agree or median_noise > max_noise:
            message = (
                f"rays of the cameras miss each other by {pixels_text(median_noise)}"
            )
            hint = "a camera may have moved, or this may be the calibration of another "
            hint += "stage or day; calibrate the cameras again"
            path = self.cameras.path or None
            fault = Fault("CAM108", message, path, (), hint, Severity.WARNING)
            self.notices.append(fault)
        return noise.pose_changes

    def _refuse_other_convention(self, max_noise: float) -> None:
        """Raise if poses fit in another convention, such as w-last quaternions."""
        better_fit = better_convention(
            self.cameras.cameras,
            lambda cameras: sampled_noise(self.observations, cameras),
            max_noise,
        )
        if better_fit is None:
            return
        convention, noise, noise_as_read = better_fit
        difference, remedy = convention.description_and_remedy
        message = f"rays of the cameras miss each other by {pixels_text(noise_as_read)}"
        message += f", but by {pixels_text(noise)} if {difference}"
        hint = f"{remedy}: x_camera = rotation * x_world + translation"
        path = self.cameras.path or None
        raise OptionError(Fault("CAM014", message, path, hint=hint))

    def _refuse_other_pixels(self, max_noise: float) -> None:
        """Raise if pixels fit as [v, u], scaled, or with v upwards (CAM014)."""
        cameras, observations = self.cameras.cameras, self.observations
        noise_as_read = sampled_noise(observations, cameras)
        for convention, remedy, stored in pixels_in_other_conventions(
            observations, cameras
        ):
            noise = sampled_noise(replace(observations, stored=stored), cameras)
            if noise <= min(max_noise, noise_as_read / MIN_IMPROVEMENT):
                message = "rays of the cameras miss each other by "
                message += f"{pixels_text(noise_as_read)}, but by {pixels_text(noise)} "
                message += f"if pixels are {convention}"
                path = observations.path or None
                raise OptionError(Fault("CAM014", message, path, hint=remedy))

    @property
    def _max_condition(self) -> float:
        """Largest allowed product of the traces of a normal matrix and of its inverse.

        For two rays at an angle a with unit weights it is 4 / (2 sin(a / 2)^2).
        """
        return float(2 / max(np.sin(self.options.min_angle / 2) ** 2, 1e-12))

    def _solve_frames(self, first: int, end: int) -> None:
        """Triangulate frames block by block; store points, statistics and tallies."""
        block_size = max(1, BLOCK_VALUES // (self.view_count * self.marker_count))
        for block_first in range(first, end, block_size):
            block = slice(block_first, min(block_first + block_size, end))
            views = self._observations_of(block_first, block.stop)
            results = self._triangulate(views, self.is_active[block], has_details=False)
            self.positions[block], self.statistics[block] = results[:2]
            self.counts.tallies[block] = results[2]
            if self.progress is not None:
                self.progress(block.stop / self.frame_count)

    def _observations_of(self, *frames: int) -> tuple[FloatArray, FloatArray | None]:
        """Return pixels and confidences of frames, given as first, end and step."""
        observations = self.observations
        return observations.pixels(*frames), observations.confidences_of(*frames)

    def _triangulate(
        self,
        pixels_and_confidences: tuple[FloatArray, FloatArray | None],
        is_active: BoolArray,
        *,
        has_details: bool,
    ) -> Any:
        """Return the kernel's results for pixels and confidences with active cameras.

        Residuals and states of observations are empty unless ``has_details``.
        """
        return _kernels.triangulate_points(
            *pixels_and_confidences,
            self.kernel_cameras,
            np.ascontiguousarray(is_active),
            self.noise,
            self.options.gate,
            self._max_condition,
            has_details=has_details,
        )

    def _exclude_stale_cameras(self, pose_changes: dict[int, PoseChange]) -> None:
        """Exclude stale cameras in the frames where they do not fit, and only there.

        The test covers all frames at once first: a camera that moved during the take is
        off in part of them.
        """
        rate = float(self.observations.clock.rate)
        for camera, change in pose_changes.items():
            counts = self.counts
            ranges = find_stale_ranges(counts.tested, counts.rejected, camera, rate)
            was_active = self.is_active[:, camera].copy()
            self.shifts[camera] += self._mark_kept_ranges(
                camera, [replace(shift, change=change) for shift in ranges]
            )
            if not self.options.keep_moved:
                self.is_active[:, camera] = True
                for shift in self.shifts[camera]:
                    self.is_active[shift.first : shift.end, camera] = shift.kept
                for first, end in runs(self.is_active[:, camera] != was_active):
                    self._solve_frames(first, end)

    def _mark_kept_ranges(
        self, camera: int, ranges: list[PoseShift]
    ) -> list[PoseShift]:
        """Mark ranges as kept where excluding the camera does not reduce the error.

        The criterion is the reprojection error of the other cameras.
        """
        if self.options.keep_moved:
            return ranges
        return [
            replace(shift, kept=not self._is_better_without(camera, shift))
            for shift in ranges
        ]

    def _is_better_without(self, camera: int, shift: PoseShift) -> bool:
        """Return whether excluding a camera in a range does not worsen the others."""
        step = max(1, (shift.end - shift.first) // _POSE_CHANGE_FRAMES)
        frames = slice(shift.first, shift.end, step)
        views = self._observations_of(shift.first, shift.end, step)
        is_visible = np.isfinite(views[0]).all(axis=-1)
        is_compared = is_visible & self.is_active[frames][..., None]
        is_compared[:, camera] = False
        is_compared &= (is_compared.sum(axis=1) > 1)[:, None]
        errors = []
        for is_kept in (True, False):
            is_active = self.is_active[frames].copy()
            is_active[:, camera] = is_kept
            *_, residuals, states = self._triangulate(
                views, is_active, has_details=True
            )
            is_used = states[:, camera] == USED_STATE
            residuals = residuals.astype(np.float64)
            gate = self.options.gate
            errors.append(
                truncated_error(residuals, is_compared, self.noise, gate, is_used)
            )
        return errors[1] <= TIE_COST_RATIO * errors[0]

    def _exclude_shifted_cameras(self) -> None:
        """Exclude cameras in frame ranges in which they do not fit, the worst first."""
        rate = float(self.observations.clock.rate)
        is_active = self.is_active.copy()
        for camera, shifts in enumerate(self.shifts):
            for shift in shifts:
                is_active[shift.first : shift.end, camera] = False
        for _ in range(self.view_count):
            tested_counts, rejections = self.counts.tested, self.counts.rejected
            worst_fit = find_shifted_ranges(tested_counts, rejections, is_active, rate)
            if worst_fit is None:
                break
            camera, ranges = worst_fit
            ranges = self._mark_kept_ranges(camera, ranges)
            self.shifts[camera] += [
                self._with_pose_change(camera, shift) for shift in ranges
            ]
            for shift in ranges:
                is_active[shift.first : shift.end, camera] = False
                if not (self.options.keep_moved or shift.kept):
                    self.is_active[shift.first : shift.end, camera] = False
                    self._solve_frames(shift.first, shift.end)

    def _find_disagreements(self, camera: int) -> tuple[CameraDisagreement, ...]:
        """Return single frames in which a camera disagrees with the others."""
        is_active = self.is_active[:, camera].copy()
        for shift in self.shifts[camera]:
            is_active[shift.first : shift.end] = False
        noise = float(self.noise[camera])
        return tuple(find_disagreements(self.counts.tallies, camera, noise, is_active))

    def _with_pose_change(self, camera: int, shift: PoseShift) -> PoseShift:
        """Return the shift with the pose change that best fits its frames."""
        step = max(1, (shift.end - shift.first) // _POSE_CHANGE_FRAMES)
        pixels = self.observations.pixels(shift.first, shift.end, step)[:, camera]
        points = self.positions[shift.first : shift.end : step]
        others = list(self.cameras.cameras)
        change = fit_pose_change(others.pop(camera), points, pixels, others)
        return replace(shift, change=change)

    def _check_triangulated(self) -> None:
        """Raise if no point was triangulated in any frame (CAM013 or CAM014)."""
        if np.isfinite(self.positions).any():
            return
        if not self._visible_count:
            message = "no point is seen by two cameras in any frame"
            path = self.observations.path or None
            raise OptionError(Fault("CAM013", message, path))
        self._refuse_cameras(
            f"no two cameras agree on any of {counted(self._visible_count, 'point')}"
        )

    def _refuse_cameras(self, message: str) -> NoReturn:
        """Raise CAM014: cameras and observations do not belong together."""
        for notice in self.cameras.notices:
            if notice.code == "CAM114":
                message = f"{notice.message}; {message}"
                raise OptionError(
                    replace(
                        notice,
                        code="CAM014",
                        message=message,
                        severity=Severity.ERROR,
                    )
                )
        hint = "is this the calibration of these cameras, in this order, for images of "
        points = self.observations.path
        hint += f"the size of those in {points}?" if points else "this size?"
        path = self.cameras.path or None
        raise OptionError(Fault("CAM014", message, path, (), hint))

    @property
    def _visible_count(self) -> int:
        """Number of points visible to two or more cameras."""
        return int((self.statistics[..., 4] > 1).sum())

    def _build_result(self) -> Triangulation:
        """Return the triangulation, with a report of each camera and all warnings."""
        observations, cameras = self.observations, self.cameras.cameras
        reports = tuple(
            replace(
                self.counts.report(
                    camera_index,
                    cameras[camera_index].name,
                    float(self.noise[camera_index]),
                    tuple(shifts),
                ),
                disagrees=self._find_disagreements(camera_index),
            )
            for camera_index, shifts in enumerate(self.shifts)
        )
        keep_moved = self.options.keep_moved
        notices = self.notices
        path, clock = observations.path, observations.clock
        camera_errors = [report.error_px for report in reports]
        delay_warning_by_camera = delay_warnings(
            observations, cameras, self.positions, camera_errors
        )
        for report, camera in zip(reports, cameras, strict=True):
            camera_faults = camera_notices(
                report, camera, clock, path, is_kept=keep_moved
            )
            # A delay explains what looks like another pose.
            notices += [
                notice
                for notice in camera_faults
                if report.name not in delay_warning_by_camera
                or notice.code not in DELAY_CODES
            ]
        notices += delay_warning_by_camera.values()
        is_visible = self.statistics[..., 4] > 1
        notices += lost_frame_notices(self.positions, is_visible, clock, path)
        notices += gap_notices(
            observations.names, self.positions, self._visible_count, path
        )
        markers = Markers(
            observations.names,
            clock,
            self.positions,
            self.cameras.up,
            self.statistics[..., 3].astype(np.int64),
            self.statistics[..., 1].copy(),
            notices=tuple(notices),
        )
        # The markers are as wrong as the cameras.
        is_unit_known = all(notice.code != "CAM113" for notice in notices)
        notices += [
            replace(notice, path=self.cameras.path or None)
            for notice in plausibility_warnings(markers)
            if is_unit_known or notice.code != "MKR117"
        ]
        return Triangulation(
            markers,
            self.statistics[..., 2].copy(),
            reports,
            *self.counts.reprojection_errors(),
            self._visible_count,
            int(markers.visible.sum()),
            tuple(notices),
        )
