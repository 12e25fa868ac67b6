"""Points in the world from what calibrated cameras see of them.

Each point is where the sum of squared reprojection errors is least. Where the residual
says that an observation is wrong, cameras are left out until the others agree, or the
point is sought that most cameras agree on. What no two cameras agree on is a gap.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace

import numpy as np

from animtool import _kernels
from animtool._types import FloatArray, IntArray
from animtool.errors import Fault, OptionError, Severity, counted, listed, percent
from animtool.markers import Markers
from animtool.mocap.cameras.camera import Cameras, camera_numbers
from animtool.mocap.cameras.noise import measured_noise
from animtool.mocap.cameras.observations import Observations, matched
from animtool.mocap.cameras.options import TriangulateOptions
from animtool.mocap.cameras.stale import Moved, PoseChange, moved_ranges, pose_change

# Observations that are worked on at once: what they take stays below 100 MB.
BLOCK = 1_000_000
# What the kernel says of an observation.
UNSEEN, USED, REJECTED, INACTIVE, NO_RAY, UNRESOLVED = range(6)
# Noise above this share of an image's width means that cameras and observations do not
# belong together [1].
MAX_NOISE = 0.03
# Share of a camera's observations that are outliers, above which it is named [1].
MANY_OUTLIERS = 0.1

Progress = Callable[[float], None]


@dataclass(frozen=True, slots=True)
class CameraReport:
    """How well a camera agrees with the points.

    Attributes:
        name: Of the camera.
        observed: Observations that it has.
        used: Observations that points are from.
        outliers: Share of the observations of found points that were left out [1].
        error_px: Root mean square reprojection error of the used ones [px].
        error_mm: The same at the depth of the points [mm].
        noise_px: Standard deviation of an axis, as measured [px].
        moved: Frames through which it does not fit its calibration.
    """

    name: str
    observed: int
    used: int
    outliers: float
    error_px: float
    error_mm: float
    noise_px: float
    moved: tuple[Moved, ...] = ()


@dataclass(frozen=True, slots=True)
class Triangulation:
    """Points from cameras, and how well the cameras agree.

    Attributes:
        markers: The points, with camera counts and residuals.
        deviations: Standard error of each point [m] ``(F, M)``, NaN for a gap.
        cameras: One report for each.
        error_px: Root mean square reprojection error of used observations [px].
        error_mm: The same at the depth of the points [mm].
        seen: Points that two cameras and more see.
        found: Points that have a position.
        notices: Warnings and notes.
    """

    markers: Markers
    deviations: FloatArray = field(repr=False)
    cameras: tuple[CameraReport, ...]
    error_px: float
    error_mm: float
    seen: int
    found: int
    notices: tuple[Fault, ...]


@dataclass(slots=True)
class _Sums:
    """What is known of every frame, filled block by block."""

    positions: FloatArray  # (F, M, 3) [m]
    numbers: FloatArray  # (F, M, 3): residual [px] and [m], standard error [m]
    counts: IntArray  # (F, M) cameras
    judged: IntArray  # (F, C) observations of found points
    rejected: IntArray  # (F, C) of them
    used: IntArray  # (F, C)
    observed: IntArray  # (F, C)
    pairs: IntArray  # (F,) points that two cameras and more see
    no_ray: IntArray  # (F, C) pixels that no direction leads to
    squares: FloatArray  # (F, C) sum of squared residuals [px^2]
    squares_mm: FloatArray  # (F, C) [mm^2]

    @classmethod
    def empty(cls, frames: int, cameras: int, markers: int) -> _Sums:
        """Return sums of nothing."""
        by_camera = (frames, cameras)
        return cls(
            np.full((frames, markers, 3), np.nan),
            np.full((frames, markers, 3), np.nan),
            np.zeros((frames, markers), np.int64),
            *(np.zeros(by_camera, np.int64) for _ in range(4)),
            np.zeros(frames, np.int64),
            np.zeros(by_camera, np.int64),
            *(np.zeros(by_camera) for _ in range(2)),
        )


def triangulate(
    observations: Observations,
    cameras: Cameras,
    options: TriangulateOptions | None = None,
    *,
    progress: Progress | None = None,
) -> Triangulation:
    """Return the points that calibrated cameras see.

    Args:
        observations: Pixels over frames.
        cameras: Their calibrations, in any order where the observations name theirs.
        options: How; None is the defaults.
        progress: Told the share done.

    Raises:
        OptionError: Cameras and observations do not belong together (CAM011, CAM014),
            there is one camera (CAM012), or no point is seen by two (CAM013).
    """
    options = options or TriangulateOptions()
    run = _Run(observations, matched(observations, cameras), options, progress)
    return run.result()


class _Run:
    """A triangulation under way."""

    def __init__(
        self,
        observations: Observations,
        cameras: Cameras,
        options: TriangulateOptions,
        progress: Progress | None,
    ) -> None:
        self.observations, self.cameras, self.options = observations, cameras, options
        self.progress = progress
        self.frames, self.views, self.markers = observations.stored.shape[:3]
        self.numbers = camera_numbers(cameras.cameras)
        self.active = np.ones((self.frames, self.views), bool)
        self.sums = _Sums.empty(self.frames, self.views, self.markers)
        self.notices = [*cameras.notices, *observations.notices]
        self.noise = np.ones(self.views)
        self.stale: dict[int, PoseChange] = {}

    def result(self) -> Triangulation:
        """Return the points and the reports."""
        self._check_gate()
        self.noise = self._noise()
        self._solve(0, self.frames, 0.0, 1.0)
        moved = self._leave_out_moved()
        self._check_found()
        return self._triangulation(moved)

    def _check_gate(self) -> None:
        for name, value in (("gate", self.options.gate), ("noise", self.options.noise)):
            if value is not None and not 0 < value < np.inf:
                message = f"{name} must be above 0 and finite, not {value:g}"
                raise OptionError(Fault("CAM015", message, where=name))
        if not 0 <= self.options.min_angle < np.pi / 2:
            degrees = np.degrees(self.options.min_angle)
            message = f"min_angle must be 0 or more and below 90, not {degrees:g}"
            raise OptionError(Fault("CAM015", message, where="min_angle"))

    def _noise(self) -> FloatArray:
        """Return the standard deviation of each camera's pixels [px] ``(C,)``."""
        if self.options.noise is not None:
            return np.full(self.views, float(self.options.noise))
        measured = measured_noise(
            self.observations, self.cameras.cameras, self.options.gate, self._condition
        )
        self.stale = measured.stale
        if not self.options.keep_moved:
            self.active[:, list(self.stale)] = False
        noise = measured.pixels
        middle = float(np.median(noise))
        widths = [
            c.size[0] if c.size else 2 * c.centre[0] for c in self.cameras.cameras
        ]
        if middle > MAX_NOISE * max(1.0, float(np.median(widths))):
            message = f"cameras do not agree: they miss each other by {middle:.0f} px"
            hint = "is this calibration of these cameras, in this order, and in pixels "
            hint += "of these images?"
            path = self.cameras.path or None
            raise OptionError(Fault("CAM014", message, path, (), hint))
        return noise

    @property
    def _condition(self) -> float:
        """The most that the trace of a normal matrix times its inverse's may be.

        Of two rays at an angle a, unit weights: 4 / (2 sin(a / 2)^2).
        """
        return 2 / max(np.sin(self.options.min_angle / 2) ** 2, 1e-12)

    def _blocks(self, first: int, end: int) -> Iterator[tuple[int, int]]:
        size = max(1, BLOCK // (self.views * self.markers))
        for begin in range(first, end, size):
            yield begin, min(begin + size, end)

    def _solve(self, first: int, end: int, done: float, share: float) -> None:
        """Solve frames, and add up what is known of them."""
        for begin, stop in self._blocks(first, end):
            self._solve_block(begin, stop)
            if self.progress is not None:
                self.progress(done + share * (stop - first) / (end - first))

    def _solve_block(self, begin: int, end: int) -> None:
        sums, at = self.sums, slice(begin, end)
        points, numbers, residuals, states = _kernels.triangulate_points(
            self.observations.pixels(begin, end),
            self.observations.trust(begin, end),
            self.numbers,
            np.ascontiguousarray(self.active[at]),
            self.noise,
            self.options.gate,
            self._condition,
        )
        sums.positions[at], sums.numbers[at] = points, numbers
        used = states == USED
        sums.counts[at] = used.sum(axis=1)
        found = np.isfinite(points[..., 0])[:, None]
        squared = np.einsum("fcmi,fcmi->fcm", residuals, residuals)
        # What is not active is judged too: whether it would fit.
        far = squared > (self.options.gate * self.noise[:, None]) ** 2
        idle = (states == INACTIVE) & found
        sums.rejected[at] = ((states == REJECTED) | (idle & far)).sum(axis=2)
        sums.used[at] = used.sum(axis=2)
        sums.judged[at] = sums.used[at] + ((states == REJECTED) | idle).sum(axis=2)
        seen = (states != UNSEEN) & (states != NO_RAY)
        sums.observed[at] = (states != UNSEEN).sum(axis=2)
        sums.no_ray[at] = (states == NO_RAY).sum(axis=2)
        sums.pairs[at] = (seen.sum(axis=1) > 1).sum(axis=1)
        kept = np.where(used, squared, 0.0)
        sums.squares[at] = kept.sum(axis=2)
        # Depth of the points [mm], over the focal length.
        lines, shift = self.numbers[:, 19:22], self.numbers[:, 24]
        depth = np.nan_to_num(points) @ lines.T + shift
        scale = 2000 * depth / (self.numbers[:, 0] + self.numbers[:, 1])
        sums.squares_mm[at] = np.einsum("fcm,fmc->fc", kept, scale**2)

    def _leave_out_moved(self) -> list[list[Moved]]:
        """Leave out cameras where they do not fit, the worst first; return where."""
        found: list[list[Moved]] = [[] for _ in range(self.views)]
        for camera, change in self.stale.items():
            judged = max(1, int(self.sums.judged[:, camera].sum()))
            share = int(self.sums.rejected[:, camera].sum()) / judged
            found[camera].append(Moved(0, self.frames, share, change))
        for _ in range(self.views):
            ranges = moved_ranges(
                self.sums.judged, self.sums.rejected, self.active,
                float(self.observations.clock.rate),
            )  # fmt: skip
            if not ranges:
                break
            camera, moved = ranges
            found[camera] += moved
            for each in moved:
                at = slice(each.first, each.end)
                self.active[at, camera] = False
                if not self.options.keep_moved:
                    self._solve(each.first, each.end, 1.0, 0.0)
        return found

    def _check_found(self) -> None:
        if np.isfinite(self.sums.positions).any():
            return
        pairs = int(self.sums.pairs.sum())
        path = self.observations.path or None
        if not pairs:
            message = "no point is seen by two cameras in any frame"
            raise OptionError(Fault("CAM013", message, path))
        message = f"no two cameras agree on any of {counted(pairs, 'point')}"
        hint = "is this calibration of these cameras, in this order?"
        raise OptionError(Fault("CAM014", message, path, (), hint))

    def _triangulation(self, moved: list[list[Moved]]) -> Triangulation:
        sums = self.sums
        described = [
            tuple(
                each if each.change else self._described(camera, each)
                for each in moved[camera]
            )
            for camera in range(self.views)
        ]
        reports = tuple(self._report(c, described[c]) for c in range(self.views))
        for report in reports:
            self._name_camera(report)
        used = max(1, int(sums.used.sum()))
        found = int(np.isfinite(sums.positions[..., 0]).sum())
        self._name_gaps(found)
        markers = Markers(
            self.observations.names,
            self.observations.clock,
            sums.positions,
            self.cameras.up,
            sums.counts,
            sums.numbers[..., 1].copy(),
            None,
        )
        return Triangulation(
            replace(markers, notices=tuple(self.notices)),
            sums.numbers[..., 2].copy(),
            reports,
            float(np.sqrt(sums.squares.sum() / used)),
            float(np.sqrt(sums.squares_mm.sum() / used)),
            int(sums.pairs.sum()),
            found,
            tuple(self.notices),
        )

    def _described(self, camera: int, moved: Moved) -> Moved:
        """Return a range with the change of pose that would explain it."""
        at = slice(moved.first, moved.end)
        step = max(1, (moved.end - moved.first) // 50)
        pixels = self.observations.pixels(moved.first, moved.end, step)[:, camera]
        points = self.sums.positions[at][::step]
        change = pose_change(self.cameras.cameras[camera], points, pixels)
        return replace(moved, change=change)

    def _report(self, camera: int, moved: tuple[Moved, ...]) -> CameraReport:
        sums = self.sums
        used = int(sums.used[:, camera].sum())
        judged = int(sums.judged[:, camera].sum())

        def error(squares: FloatArray) -> float:
            return float(np.sqrt(squares[:, camera].sum() / used)) if used else np.nan

        return CameraReport(
            self.cameras.cameras[camera].name,
            int(sums.observed[:, camera].sum()),
            used,
            float(sums.rejected[:, camera].sum()) / judged if judged else 0.0,
            error(sums.squares),
            error(sums.squares_mm),
            float(self.noise[camera]),
            moved,
        )

    def _warn(self, code: str, message: str, hint: str | None = None) -> None:
        path = self.observations.path or None
        self.notices.append(Fault(code, message, path, (), hint, Severity.WARNING))

    def _name_camera(self, report: CameraReport) -> None:
        for moved in report.moved:
            whole = moved.first == 0 and moved.end == self.frames
            first, last = moved.first + 1, moved.end
            when = "in all frames" if whole else f"in frames {first} to {last}"
            verb = "does not fit its calibration" if whole else "moved"
            message = f"camera {report.name!r} {verb}: {when}, "
            message += f"{percent(moved.outliers)} of what it sees are outliers"
            if moved.change is not None:
                message += f"; {moved.change} would explain it"
            left = "it is kept" if self.options.keep_moved else "it is left out there"
            self._warn("CAM101", f"{message}; {left}", "calibrate it again")
        if report.outliers > MANY_OUTLIERS and not report.moved:
            message = f"{percent(report.outliers)} of what camera {report.name!r} sees "
            self._warn("CAM102", f"{message}are outliers", "check its labels and focus")
        if not report.observed:
            self._warn("CAM103", f"camera {report.name!r} sees nothing")

    def _name_gaps(self, found: int) -> None:
        sums = self.sums
        positions = np.isfinite(sums.positions[..., 0])
        never = [
            name
            for name, any_ in zip(
                self.observations.names, positions.any(axis=0), strict=True
            )
            if not any_
        ]
        if never:
            message = f"no two cameras agree on {listed(never)} in any frame"
            self._warn("CAM104", message)
        pairs = int(sums.pairs.sum())
        if found < pairs:
            count = counted(pairs - found, "point")
            message = f"{count} that two cameras and more see are gaps: no two agree, "
            message += "or their rays are too flat"
            self.notices.append(Fault("CAM105", message, severity=Severity.NOTE))
        lost = sums.no_ray.sum(axis=0)
        outside = self._outside()
        for c, camera in enumerate(self.cameras.cameras):
            if lost[c]:
                message = f"{counted(int(lost[c]), 'pixel')} of camera {camera.name!r} "
                self._warn("CAM106", f"{message}are beyond what its lens model covers")
            if outside[c]:
                count = counted(int(outside[c]), "pixel")
                message = f"{count} of camera {camera.name!r} are outside of its image "
                assert camera.size is not None
                message += f"of {camera.size[0]} x {camera.size[1]}"
                hint = "are calibration and observations of the same image size?"
                self._warn("CAM107", message, hint)

    def _outside(self) -> IntArray:
        """Return how many pixels are outside of each camera's image ``(C,)``."""
        sizes = np.array(
            [c.size or (np.inf, np.inf) for c in self.cameras.cameras], np.float64
        )[:, None]
        counts = np.zeros(self.views, np.int64)
        for begin, end in self._blocks(0, self.frames):
            pixels = self.observations.pixels(begin, end)
            # Half a pixel around: the centre of the first pixel is 0.
            beyond = (pixels < -0.5) | (pixels > sizes + 0.5)
            counts += beyond.any(axis=-1).sum(axis=(0, 2))
        return counts


__all__ = ["CameraReport", "Moved", "Triangulation", "triangulate"]
