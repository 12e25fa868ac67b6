"""The solve of a capture, window by window."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import field

import numpy as np

from animtool.capture.options import SolveOptions
from animtool.capture.solve.model import (
    MIN_MARKERS,
    MarkerProblem,
    marker_model,
    visible_markers,
)
from animtool.capture.solve.report import SolveScore
from animtool.capture.solve.sampling import (
    ROBUST,
    misses_of,
    sampled_frames,
    sampled_poses,
    typical_noise,
)
from animtool.capture.templates.match import MarkerMatch, match_markers
from animtool.capture.templates.template import MarkerTemplate
from animtool.core.arguments import argument
from animtool.core.array_types import BoolArray, FloatArray
from animtool.core.errors import Fault, OptionError, Severity, counted, listed
from animtool.core.quantities import length_text
from animtool.core.record import dataclass
from animtool.core.shot import frame_spans
from animtool.core.units import up_from_up
from animtool.ik.fit import FitOptions, fit
from animtool.maths import so3
from animtool.motion.driving import driven_take
from animtool.motion.markers import Markers
from animtool.motion.motion import Channel, Motion
from animtool.motion.take import Take
from animtool.retarget.standing import lying_notice
from animtool.rig.skeleton import Rig

Progress = Callable[[float], None] | None
# Frames that are solved at once, and how far the solve looks ahead of them: beyond
# that, what a joint does next says nothing of a frame. Fixed, so that results are the
# same however a take is read.
WINDOW, LOOKAHEAD = 600, 120
# Frames before a window, whose poses are fixed and whose speed continues.
BEHIND = 2
# Independent frames for the noise estimate.
SAMPLES = 24
# Ratio of marker distances to the rig's that means other units.
OTHER_UNITS = 30.0
# Typical deviation above which markers do not belong to this rig [m].
STRANGE = 0.01
# Initial noise, and its convergence ratio.
FAR, ROUNDS, SETTLED = 0.02, 4, 0.7
# A marker on a body moves by more than this: breathing alone moves a chest by 4 mm [m].
STATIC_EXTENT = 0.002
# If the others move by this much, one that does not is not on the body [m].
MOVING_EXTENT = 0.05
# Fewer frames do not show that a marker never moves.
MIN_MOVING_FRAMES = 25


@dataclass
class MarkerSolve:
    """The solve of one capture.

    Attributes:
        model: Rig and markers that are solved for.
        match: The template's markers in the capture.
        positions: Of the model's markers ``(F, E, 3)`` [m], in the rig's world; NaN
            where one is missing.
        markers: The capture.
        noise: Standard deviation of each marker per axis ``(E,)``
            [m].
        options: How to solve.
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
        """Yield the motion of one window of frames after another."""
        last: FloatArray | None = None
        rotations: FloatArray | None = None
        count = len(self.positions)
        for first in range(0, count, WINDOW):
            end = min(first + WINDOW, count)
            coordinates = self._window(first, end, last)
            last = coordinates[-BEHIND:]
            motion = self._motion(coordinates, rotations)
            rotations = motion.rotations.values[-1]
            if first == 0:
                self.notices += lying_notice(
                    None, self.model.rig, motion, Severity.WARNING
                )
            yield motion
            if progress is not None:
                progress(end / count)
        self.score.finish()
        self._name_frames()

    def take(self, progress: Progress = None) -> Take:
        """Return the full take."""
        motion = Motion.concatenate(list(self.blocks(progress)))
        motion = motion.map(Channel.compact)
        rig, clock = self.model.rig, self.markers.clock
        return driven_take(Take(rig, clock, motion, tuple(self.notices)))

    def _window(self, first: int, end: int, last: FloatArray | None) -> FloatArray:
        """Return the poses of frames that continue those before them."""
        behind = 0 if last is None else len(last)
        lookahead = min(end + LOOKAHEAD, len(self.positions))
        positions = self.positions[first - behind : lookahead]
        starts = self.model.starts(positions)
        if last is not None:
            starts[:behind] = last
        fitted = fit(
            self.model.problem,
            self.model.targets(positions, self.noise),
            starts,
            FitOptions(
                float(self.markers.clock.rate),
                self.options.acceleration,
                robust=ROBUST,
            ),
            path=None if last is None else starts,
            first=behind,
        )
        kept = slice(behind, behind + end - first)
        self.score.add(
            first,
            fitted.misses[kept],
            fitted.taken[kept],
            fitted.searched[kept],
            visible_markers(positions[kept]),
        )
        return fitted.coordinates[kept]

    def _motion(
        self, coordinates: FloatArray, quaternions: FloatArray | None
    ) -> Motion:
        rig = self.model.rig
        local = self.model.local(coordinates)
        driven = sorted({rig.index(name) for name in self.model.problem.joints})
        slides = [j for j in driven if rig.joints[j].type in {"free", "prismatic"}]
        rotations = so3.align_signs(local.rotations[:, driven], quaternions)
        return Motion(
            Channel(
                rig.rest_translations,
                np.array(slides, np.int64),
                local.translations[:, slides],
            ),
            Channel(rig.rest_rotations, np.array(driven, np.int64), rotations),
        )

    def _name_frames(self) -> None:
        """Warn about frames with too few markers, or none that fit."""
        clock = self.markers.clock
        for code, frames, what in (
            ("SOL101", self.score.sparse, f"fewer than {MIN_MARKERS} markers are seen"),
            ("SOL102", self.score.poor, "markers do not match"),
        ):
            if not len(frames):
                continue
            start, step = clock.start, clock.step
            named = frame_spans([math.floor(start + step * f) for f in frames.tolist()])
            message = f"{what} in {counted(len(frames), 'frame')}: {named}"
            hint = "their poses are taken from nearby frames"
            if code == "SOL102":
                hint = "labels may be wrong there, or the rig may not match the subject"
            self.notices.append(
                Fault(code, message, hint=hint, severity=Severity.WARNING)
            )


def solve_markers(
    markers: Markers,
    rig: Rig,
    template: MarkerTemplate,
    options: SolveOptions | None = None,
) -> MarkerSolve:
    """Return the solve of a capture; iterating its blocks does the work.

    Args:
        markers: F frames of labelled markers.
        rig: The subject's rig: see `animtool.capture.solve.calibrate`.
        template: Its markers.
        options: How to solve.

    Raises:
        OptionError: No marker has a name of the template (SOL001), or those of several
            subjects have (SOL002); there are fewer than 3 markers (SOL003) or no frame
            with as many (SOL004), or they are in other units than the rig (SOL005); the
            rig lacks a joint of the template (MKT001).

    Limits of the method: poses are the nearest to those of the frames before them; what
    was captured of a limb that comes back from a long gap is found if its markers say
    so together.
    """
    options = options or SolveOptions()
    match = match_markers(template, markers.names, options.subject)
    model = marker_model(rig, template, match.columns)
    positions = in_world_of(model.rig, markers)[:, model.columns]
    sample = positions[sampled_frames(positions, SAMPLES)]
    if not len(sample):
        message = f"no frame has {MIN_MARKERS} markers of the template"
        raise OptionError(Fault("SOL004", message, hint="see animtool info"))
    check_units(model, sample)
    notices = []
    if match.missing:
        message = f"the capture lacks {counted(len(match.missing), 'marker')} of the "
        message += f"template: {listed(match.missing, 8)}"
        notices.append(Fault("SOL103", message, severity=Severity.WARNING))
    notices += static_notices(model.template.names, positions)
    noise = sampled_noise(model, sample, options.noise)
    median = float(np.median(noise))
    if median > STRANGE:
        message = f"markers are {length_text(median)} off their positions on the rig"
        hint = f"{argument('calibrate', True)} fits bones and offsets to the subject"
        notices.append(Fault("SOL107", message, hint=hint, severity=Severity.WARNING))
    score = SolveScore(model.template.names, len(positions), noise)
    return MarkerSolve(model, match, positions, markers, noise, options, score, notices)


def static_notices(names: Sequence[str], positions: FloatArray) -> list[Fault]:
    """Return a warning about markers ``(F, E, 3)`` that never move (SOL108)."""
    if len(positions) < MIN_MOVING_FRAMES:
        return []
    known: BoolArray = np.asarray(np.isfinite(positions).all(axis=2))
    low, high = (
        np.where(known[..., None], positions, fill) for fill in (np.inf, -np.inf)
    )
    extents = np.linalg.norm(high.max(axis=0) - low.min(axis=0), axis=1)
    enough = known.sum(axis=0) >= MIN_MOVING_FRAMES
    static = enough & (extents < STATIC_EXTENT)
    if not static.any():
        return []
    hint = "delete them or label them again: they may be on a fixed object"
    if static.sum() == enough.sum():
        message = (
            f"no marker moves by more than {length_text(STATIC_EXTENT)} in "
            f"{counted(len(positions), 'frame')}"
        )
        hint = "is this the static trial? solve the take in which the subject moves"
    elif np.median(extents[enough]) < MOVING_EXTENT:
        return []
    else:
        named = [name for name, fixed in zip(names, static, strict=True) if fixed]
        message = (
            f"these markers never move, while others move by "
            f"{length_text(float(np.median(extents[enough])))}: {listed(named, 8)}"
        )
    return [Fault("SOL108", message, hint=hint, severity=Severity.WARNING)]


def sampled_noise(model: MarkerProblem, sample: FloatArray, least: float) -> FloatArray:
    """Return the noise of markers ``(F, E, 3)``, per axis ``(E,)`` [m].

    It starts from a large value, so that a rig of another subject is told from wrong
    labels.
    """
    noise = np.full(len(model.joints), FAR)
    for _ in range(ROUNDS):
        misses = misses_of(model, sampled_poses(model, sample, noise), sample)
        estimate = typical_noise(misses, least)
        settled = bool((estimate > SETTLED * noise).all())
        noise = estimate
        if settled:
            break
    return noise


def in_world_of(rig: Rig, markers: Markers) -> FloatArray:
    """Return positions ``(F, M, 3)`` with the up axis of a rig [m]."""
    rotation = up_from_up(rig.up, markers.up)
    if rotation is None:
        return markers.positions
    return so3.rotate(np.array(rotation), markers.positions)


def check_units(model: MarkerProblem, sample: FloatArray) -> None:
    """Refuse markers ``(F, E, 3)`` in other units than the rig (SOL005)."""
    rest = model.points(model.starts(sample[:1]))[0]
    ratios = []
    for frame in sample:
        visible = np.isfinite(frame).all(axis=1)
        rest_points, frame_points = rest[visible], frame[visible]
        spread = np.linalg.norm(rest_points - rest_points.mean(axis=0), axis=1).mean()
        other = np.linalg.norm(frame_points - frame_points.mean(axis=0), axis=1).mean()
        ratios.append(other / max(float(spread), 1e-9))
    ratio = float(np.median(ratios))
    if 1 / OTHER_UNITS < ratio < OTHER_UNITS:
        return
    times, what = (ratio, "larger") if ratio > 1 else (1 / max(ratio, 1e-12), "smaller")
    message = f"the markers are {times:.3g} times {what} than those on the rig"
    hint = (
        f"set the unit of the capture with {argument('source.unit')}: m, cm, mm or in"
    )
    raise OptionError(Fault("SOL005", message, hint=hint))
