"""Solves a capture, one window of frames at a time."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import field, replace

import numpy as np

from animtool.capture.options import SolveOptions
from animtool.capture.solve.model import (
    MIN_MARKERS,
    MarkerProblem,
    build_marker_problem,
    visibility_mask,
)
from animtool.capture.solve.report import SolveScore
from animtool.capture.solve.sampling import (
    ROBUST_DEVIATIONS,
    estimate_noise,
    fullest_frames,
    mirrored_offsets_notices,
    swapped_side_notices,
)
from animtool.capture.templates.match import (
    MarkerMatch,
    match_markers,
    resembling_names,
)
from animtool.capture.templates.template import MarkerTemplate
from animtool.core.arguments import argument
from animtool.core.array_types import BoolArray, FloatArray
from animtool.core.errors import (
    Fault,
    OptionError,
    Severity,
    counted,
    listed,
    warning,
    with_notices,
)
from animtool.core.quantities import length_text
from animtool.core.record import dataclass
from animtool.core.shot import frame_spans
from animtool.core.units import confused_units, up_from_up
from animtool.ik.fit import FitOptions, fit
from animtool.maths import so3
from animtool.motion.driving import drive_take
from animtool.motion.markers import Markers
from animtool.motion.motion import Channel, Motion
from animtool.motion.take import Take
from animtool.rig.joints import local_from_coordinates
from animtool.rig.skeleton import Rig

Progress = Callable[[float], None] | None
# Frames that are solved at once, and lookahead frames after them; motion beyond those
# has no influence on a frame. Fixed, so that results do not depend on how a take is
# read.
WINDOW_FRAMES, LOOKAHEAD_FRAMES = 600, 120
# Frames before a window whose poses are fixed, so that motion continues smoothly.
PAST_FRAMES = 2
# Independent frames for the noise estimate.
NOISE_SAMPLES = 24
# Ratio of marker distances to the rig's that means other units.
MIN_UNIT_RATIO = 30.0
# Logarithm of the largest ratio of the sizes of a rig and a person.
MAX_LOG_RATIO = math.log(2.0)
# Typical residual above which markers do not belong to this rig [m].
MAX_TYPICAL_RESIDUAL = 0.01
# A marker this many times farther off than most has a wrong name or offset [1].
MISPLACED_RATIO = 4.0
# A marker on a body moves by more than this: breathing alone moves a chest by 4 mm [m].
STATIC_EXTENT = 0.002
# A marker that does not move while the others move by this much is not on the body [m].
MOVING_EXTENT = 0.05
# With fewer frames, a static marker proves nothing.
MIN_MOVING_FRAMES = 25


@dataclass
class MarkerSolve:
    """A prepared marker solve; its frames are solved as `blocks` is read.

    Attributes:
        model: Rig and markers of the solve.
        match: The template's markers in the capture.
        positions: Positions of the model's markers ``(F, E, 3)`` [m], in the rig's
            world; NaN where one is missing.
        markers: The capture.
        noise: Standard deviation of each marker per axis ``(E,)`` [m].
        options: Solve options.
        score: The fit; complete once `blocks` are consumed.
        notices: Warnings.
    """

    model: MarkerProblem
    match: MarkerMatch
    positions: FloatArray
    markers: Markers
    noise: FloatArray
    options: SolveOptions
    score: SolveScore
    notices: list[Fault] = field(default_factory=list)

    def blocks(self, progress: Progress = None) -> Iterator[Motion]:
        """Solve and yield one window of frames after another; complete the score."""
        previous_poses: FloatArray | None = None
        last_rotations: FloatArray | None = None
        frame_count = len(self.positions)
        for first in range(0, frame_count, WINDOW_FRAMES):
            end = min(first + WINDOW_FRAMES, frame_count)
            coordinates = self._solve_window(first, end, previous_poses)
            previous_poses = coordinates[-PAST_FRAMES:]
            motion = self._to_motion(coordinates, last_rotations)
            last_rotations = motion.rotations.values[-1]
            yield motion
            if progress is not None:
                progress(end / frame_count)
        self.score.finish()
        self._warn_of_frames()

    def take(self, progress: Progress = None) -> Take:
        """Solve all frames; return them as a take with the rig's drivers applied."""
        motion = Motion.concatenate(list(self.blocks(progress)))
        motion = motion.map(Channel.compact)
        rig, clock = self.model.rig, self.markers.clock
        return drive_take(Take(rig, clock, motion, tuple(self.notices)))

    def _solve_window(
        self, first: int, end: int, previous_poses: FloatArray | None
    ) -> FloatArray:
        """Return poses ``(F, Q)`` of a window that continue the previous ones."""
        past_count = 0 if previous_poses is None else len(previous_poses)
        lookahead_end = min(end + LOOKAHEAD_FRAMES, len(self.positions))
        positions = self.positions[first - past_count : lookahead_end]
        start_poses = self.model.start_poses(positions)
        if previous_poses is not None:
            start_poses[:past_count] = previous_poses
        result = fit(
            self.model.problem,
            self.model.targets(positions, self.noise),
            start_poses,
            FitOptions(
                float(self.markers.clock.rate),
                self.options.acceleration,
                robust=ROBUST_DEVIATIONS,
            ),
            path=None if previous_poses is None else start_poses,
            first=past_count,
        )
        window_frames = slice(past_count, past_count + end - first)
        self.score.add(
            first,
            result.misses[window_frames],
            result.target_indices[window_frames],
            result.is_restarted[window_frames],
            visibility_mask(positions[window_frames]),
        )
        return result.coordinates[window_frames]

    def _to_motion(
        self, coordinates: FloatArray, previous_rotations: FloatArray | None
    ) -> Motion:
        """Convert poses ``(F, Q)`` to motion; signs continue the previous rotations."""
        rig = self.model.rig
        local = local_from_coordinates(rig, coordinates)
        goal_joints = sorted({rig.index(name) for name in self.model.problem.joints})
        sliders = [
            j for j in goal_joints if rig.joints[j].type in {"free", "prismatic"}
        ]
        rotations = so3.align_signs(local.rotations[:, goal_joints], previous_rotations)
        return Motion(
            Channel(
                rig.rest_translations,
                np.array(sliders, np.int64),
                local.translations[:, sliders],
            ),
            Channel(rig.rest_rotations, np.array(goal_joints, np.int64), rotations),
        )

    def _warn_of_frames(self) -> None:
        """Warn of frames with too few markers (SOL101) or few that fit (SOL102)."""
        clock = self.markers.clock
        for code, frame_indices, problem in (
            ("SOL101", self.score.sparse, f"fewer than {MIN_MARKERS} markers are seen"),
            ("SOL102", self.score.poor, "markers do not match"),
        ):
            if not len(frame_indices):
                continue
            frame_numbers = [
                math.floor(clock.start + clock.step * f) for f in frame_indices.tolist()
            ]
            frames_text = frame_spans(frame_numbers)
            message = (
                f"{problem} in {counted(len(frame_indices), 'frame')}: {frames_text}"
            )
            hint = "their poses are taken from nearby frames"
            if code == "SOL102":
                hint = "labels may be wrong there, or the rig may not match the subject"
            self.notices.append(warning(code, message, hint))


def solve_markers(
    markers: Markers,
    rig: Rig,
    template: MarkerTemplate,
    options: SolveOptions | None = None,
) -> MarkerSolve:
    """Prepare the solve of a capture; frames are solved as its blocks are read.

    Args:
        markers: F frames of labelled markers.
        rig: The subject's rig: see `animtool.capture.solve.calibrate`.
        template: The rig's markers.
        options: Solve options.

    Raises:
        OptionError: No marker has a name of the template (SOL001), or those of several
            subjects have (SOL002); there are fewer than 3 markers (SOL003) or no frame
            with as many (SOL004), or they are in other units than the rig (SOL005); the
            rig lacks a joint of the template (MKT001).

    Limits of the method: each pose is the solution nearest to the previous frames. A
    limb that reappears after a long gap is found if enough of its markers agree.
    """
    options = options or SolveOptions()
    with with_notices(markers.notices):
        match = match_markers(template, markers.names, options.subject)
    model = build_marker_problem(rig, template, match.columns)
    positions = positions_in_rig_axes(model.rig, markers)[:, model.columns]
    sample = positions[fullest_frames(positions, NOISE_SAMPLES)]
    if not len(sample):
        message = f"no frame has {MIN_MARKERS} markers of the template"
        raise OptionError(Fault("SOL004", message, hint="see animtool info"))
    check_units(model, sample, template)
    notices = [] if template.document is None else list(template.document.notices)
    if match.missing:
        verb = "is" if len(match.missing) == 1 else "are"
        message = f"{counted(len(match.missing), 'marker')} of the template {verb} "
        message += f"missing from the capture: {listed(match.missing, 8)}"
        hint = _renamed_hint(match)
        hint = hint or "label them in the capture, or remove them from the template"
        notices.append(warning("SOL103", message, hint))
    notices += static_notices(model.template.names, positions)
    noise = estimate_noise(model, sample, options.noise)
    side_notices = swapped_side_notices(model, sample, noise, options.noise)
    if all(notice.code not in {"MKT003", "MKT005"} for notice in notices):
        notices += (
            side_notices
            or mirrored_offsets_notices(model, sample, noise, options.noise)
            or _residual_notices(model.template.names, noise)
        )
    score = SolveScore(model.template.names, len(positions), noise)
    return MarkerSolve(model, match, positions, markers, noise, options, score, notices)


def _renamed_hint(match: MarkerMatch) -> str | None:
    """Return a hint to add captured names as aliases of similar missing markers."""
    name_pairs = [
        f"{captured_name!r} for {name!r}"
        for name, captured_name in resembling_names(match.missing, match.unused)
    ]
    if not name_pairs:
        return None
    return f"is it {listed(name_pairs, 8)}? add such names to `aliases` in the template"


def _residual_notices(names: Sequence[str], noise: FloatArray) -> list[Fault]:
    """Warn about markers that are far from their positions on the rig (SOL107).

    A few markers that are much farther off than the others likely have swapped names,
    which calibration would not correct.
    """
    median_noise = float(np.median(noise))
    is_far = (noise > MISPLACED_RATIO * median_noise) & (noise > MAX_TYPICAL_RESIDUAL)
    far_markers = sorted(np.flatnonzero(is_far).tolist(), key=lambda i: -noise[i])
    if far_markers:
        far_text = listed(
            [f"{names[i]} by {length_text(noise[i])}" for i in far_markers], 6
        )
        message = f"markers are off their positions on the rig: {far_text}; the others "
        message += f"by {length_text(median_noise)}"
        hint = "are their names swapped, or their offsets wrong? correct that first: "
        hint += f"{argument('calibrate', True)} would keep it"
    elif median_noise > MAX_TYPICAL_RESIDUAL:
        message = (
            f"markers are {length_text(median_noise)} off their positions on the rig"
        )
        hint = f"{argument('calibrate', True)} fits bones and offsets to the subject"
    else:
        return []
    return [warning("SOL107", message, hint)]


def static_notices(names: Sequence[str], positions: FloatArray) -> list[Fault]:
    """Return a warning if all or some markers ``(F, E, 3)`` never move (SOL108)."""
    if len(positions) < MIN_MOVING_FRAMES:
        return []
    is_known: BoolArray = np.asarray(np.isfinite(positions).all(axis=2))
    padded_for_min, padded_for_max = (
        np.where(is_known[..., None], positions, limit) for limit in (np.inf, -np.inf)
    )
    extents = np.linalg.norm(
        padded_for_max.max(axis=0) - padded_for_min.min(axis=0), axis=1
    )
    is_tested = is_known.sum(axis=0) >= MIN_MOVING_FRAMES
    is_static = is_tested & (extents < STATIC_EXTENT)
    if not is_static.any():
        return []
    hint = "delete them or label them again: they may be on a fixed object"
    if is_static.sum() == is_tested.sum():
        message = f"no marker moves by more than {length_text(STATIC_EXTENT)} in "
        message += f"{counted(len(positions), 'frame')}"
        hint = "is this the static trial? solve the take in which the subject moves"
    elif np.median(extents[is_tested]) < MOVING_EXTENT:
        return []
    else:
        static_names = list(itertools.compress(names, is_static))
        message = (
            f"these markers never move, while others move by "
            f"{length_text(float(np.median(extents[is_tested])))}: "
            f"{listed(static_names, 8)}"
        )
    return [warning("SOL108", message, hint)]


def positions_in_rig_axes(rig: Rig, markers: Markers) -> FloatArray:
    """Return marker positions ``(F, M, 3)`` [m], rotated to a rig's up axis."""
    rotation = up_from_up(rig.up, markers.up)
    if rotation is None:
        return markers.positions
    return so3.rotate(np.array(rotation), markers.positions)


def check_units(
    model: MarkerProblem, sample: FloatArray, template: MarkerTemplate | None = None
) -> None:
    """Raise if markers ``(F, E, 3)`` are in another unit than the rig (SOL005).

    The error is located in the template if the offsets are suspicious (MKT003).
    """
    rest_points = model.points(model.start_poses(sample[:1]))[0]
    ratios = []
    for frame in sample:
        is_visible = np.isfinite(frame).all(axis=1)
        rest_size, frame_size = (
            float(np.linalg.norm(points - points.mean(axis=0), axis=1).mean())
            for points in (rest_points[is_visible], frame[is_visible])
        )
        ratios.append(frame_size / max(rest_size, 1e-9))
    ratio = float(np.median(ratios))
    if 1 / MIN_UNIT_RATIO < ratio < MIN_UNIT_RATIO:
        return
    comparison = f"{1 / max(ratio, 1e-12):.3g} times smaller than those on the rig"
    if ratio > 1:
        comparison = f"{ratio:.3g} times larger than those on the rig"
    message = f"the markers are {comparison}"
    document = None if template is None else template.document
    for notice in () if document is None else document.notices:
        if notice.code == "MKT003":
            message = f"{notice.message}; captured markers are {comparison}"
            severity = Severity.ERROR
            fault = replace(notice, code="SOL005", message=message, severity=severity)
            raise OptionError(fault)
    unit_written, unit_read = confused_units(ratio)
    hint = f"set the unit of the capture with {argument('source.unit')}: m, cm, mm or "
    hint += "in"
    if abs(math.log(ratio * unit_written.meters / unit_read.meters)) < MAX_LOG_RATIO:
        unit_text = argument("source.unit", str(unit_written))
        hint = f"the numbers look like {unit_written} that are read as {unit_read}: "
        hint += f"set {unit_text}"
    raise OptionError(Fault("SOL005", message, hint=hint))
