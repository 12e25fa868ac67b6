"""Completes marker trajectories: repairs swaps and spikes, and fills gaps."""

from __future__ import annotations

from dataclasses import field, replace
from typing import TYPE_CHECKING

import numpy as np

from animtool.capture.markers.geometry import marker_distances
from animtool.capture.markers.plausible import plausibility_warnings
from animtool.capture.markers.predict import (
    MarkerGap,
    Prediction,
    predict_from_markers,
    predict_from_parent_joint,
    predict_from_skeleton,
)
from animtool.capture.markers.spikes import Spike, find_spikes, remove_spikes
from animtool.capture.markers.swaps import Swap, repair_swaps
from animtool.capture.options import FillOptions
from animtool.core.arguments import argument
from animtool.core.array_types import BoolArray, FloatArray
from animtool.core.errors import Fault, counted, warning
from animtool.core.process.blas import one_thread
from animtool.core.quantities import frames_hint, plain_number
from animtool.core.record import dataclass
from animtool.maths.runs import runs
from animtool.motion.markers import Markers

if TYPE_CHECKING:
    from animtool.capture.markers.skeleton import MarkerSubject, SkeletonMarkers

# Longest gap that is filled by a curve through the surrounding frames [s].
MAX_CURVE_SECONDS = 0.05
# Frames on either side for fitting the curve, and the minimum on one side.
CURVE_FRAMES, MIN_SIDE_FRAMES = 6, 3
CURVE_DEGREE = 5
# A prediction with an error below this is not compared with others [m]; and the
# fraction of a gap in which another marker must be visible to support the joint.
MAX_ACCEPTED_ERROR, MIN_SUPPORT_VISIBILITY = 0.001, 0.8
# Cross-validation next to a gap underestimates the error within it by this factor.
VALIDATION_BIAS = 1.6


@dataclass(frozen=True, slots=True)
class FilledGap:
    """A gap of a marker, and the method that filled it, if any."""

    marker: str  # name of the marker
    first: int  # first frame without a position, from 0
    last: int  # last frame
    # ``skeleton`` by the pose, ``curve`` by the frames around, ``markers`` by the other
    # markers; empty if the gap was left.
    method: str


@dataclass(frozen=True, slots=True)
class FillReport:
    """Result of completing markers: filled gaps, spikes and swaps."""

    frames: int  # number of frames
    markers: int  # number of markers
    filled: int  # positions that were filled
    left: int  # positions that are still missing
    # Every gap, by marker and frame.
    gaps: list[FilledGap] = field(default_factory=list)
    # Spikes that were removed and became gaps.
    spikes: list[Spike] = field(default_factory=list)
    # Spans in which two markers had each other's names.
    swaps: list[Swap] = field(default_factory=list)
    notices: list[Fault] = field(default_factory=list)  # warnings


def fill_markers(
    markers: Markers,
    options: FillOptions | None = None,
    subject: MarkerSubject | None = None,
) -> tuple[Markers, FillReport]:
    """Repair swapped names, remove spikes and fill gaps where that is possible.

    With a subject, gaps are filled from its skeleton: the marker's position on it plus
    its offset there before and after the gap. Other gaps, and all without a subject,
    are filled by a curve through the frames around them, up to 50 ms. Longer ones are
    filled from the other markers: those most rigid with the marker, and how it moves
    with their pose while it is visible. A gap with fewer than three other visible
    markers, or one at an end of the take with too little to learn from, is left; a last
    position is never repeated.

    Each gap is filled from the frames within six seconds of it. Rigidity, swaps and the
    skeleton come from the full take.

    Args:
        markers: Named trajectories; points without a label stay as they are.
        options: What to repair.
        subject: The subject wearing the markers; its template lists those the skeleton
            predicts. Frames with fewer than three are not predicted.

    >>> from animtool.core.clock import Clock
    >>> path = np.zeros((9, 1, 3)) + np.arange(9.0)[:, None, None]
    >>> path[4] = np.nan
    >>> whole, report = fill_markers(Markers(("LFHD",), Clock(120, 1, 1, 9), path))
    >>> whole.positions[4, 0].round(6).tolist(), report.gaps[0].method
    ([4.0, 4.0, 4.0], 'curve')
    """
    with one_thread():
        return _repair_and_fill(markers, options or FillOptions(), subject)


def _repair_and_fill(
    markers: Markers, options: FillOptions, subject: MarkerSubject | None
) -> tuple[Markers, FillReport]:
    """Run the repairs that the options ask for; see `fill_markers`."""
    swaps: list[Swap] = []
    spikes: list[Spike] = []
    # Distances in the wrong unit look like swaps.
    has_unit = all(notice.code != "MKR117" for notice in markers.notices)
    if not options.keep_swaps and has_unit:
        markers, swaps = repair_swaps(markers)
    if not options.keep_spikes:
        spikes = find_spikes(markers)
        markers = remove_spikes(markers, spikes)
    positions = markers.positions
    gaps: list[FilledGap] = []
    notices: list[Fault] = []
    is_labelled = [not name.startswith("*") for name in markers.names]
    if not options.keep_gaps:
        skeleton = None
        if subject is not None and not markers.visible[:, is_labelled].all():
            from animtool.capture.markers.skeleton import solve_skeleton_markers

            skeleton = solve_skeleton_markers(markers, subject)
            notices += skeleton.notices
        positions, gaps = _fill_gaps(markers, options.longest, skeleton)
    is_measured = markers.visible
    is_known = np.asarray(np.isfinite(positions).all(axis=-1))
    is_filled = is_known & ~is_measured
    if markers.filled is not None:
        is_filled |= markers.filled & is_known
    result = replace(
        markers, positions=positions, filled=is_filled if is_filled.any() else None
    )
    left_count = int((~is_known[:, is_labelled]).sum())
    if left_count and not options.keep_gaps:
        open_gaps = sum(not gap.method for gap in gaps)
        message = f"{counted(open_gaps, 'gap')} could not be filled"
        hint = "fewer than three nearby markers are visible, or the take is too short"
        if options.longest is not None:
            hint = f"longer gaps are left by {argument('longest', options.longest)}"
        notices.append(warning("MKR111", message, hint))
    notices += [
        *_length_warning(options.longest, markers),
        *plausibility_warnings(markers),
    ]
    report = FillReport(
        len(markers), len(markers.names), int((is_known & ~is_measured).sum()),
        left_count, gaps, spikes, swaps, notices,
    )  # fmt: skip
    return result, report


def _length_warning(longest: float | None, markers: Markers) -> list[Fault]:
    """Return a warning if a limit on gaps seems to be in frames (MKR112)."""
    rate = float(markers.clock.rate)
    duration = markers.clock.count / rate
    hint = None if longest is None else frames_hint(longest, rate)
    if longest is None or hint is None or longest <= duration:
        return []
    limit_text = argument("longest", plain_number(longest))
    message = f"{limit_text} allows gaps of {longest:g} s, but the take has "
    message += f"{duration:.3g} s: gaps of any length are filled"
    return [warning("MKR112", message, hint)]


def _fill_gaps(
    markers: Markers, max_seconds: float | None, skeleton: SkeletonMarkers | None
) -> tuple[FloatArray, list[FilledGap]]:
    """Fill the shortest gaps first; return positions ``(F, M, 3)``, and all gaps."""
    positions = markers.positions.copy()
    is_measured = np.asarray(np.isfinite(positions).all(axis=-1))
    is_known = is_measured.copy()
    rate = float(markers.clock.rate)
    spread = marker_distances(positions).spread
    filled_gaps = []
    for length, first, marker in _sorted_gaps(markers, is_known):
        gap = slice(first, first + length)
        marker_gap = MarkerGap(positions, is_known, marker, gap, spread[marker], rate)
        gap_positions: FloatArray | None = None
        method = ""
        if max_seconds is None or length <= max_seconds * rate:
            if skeleton is not None and skeleton.is_predicted(marker, gap):
                measured_gap = replace(marker_gap, is_visible=is_measured)
                prediction = predict_from_skeleton(skeleton, measured_gap)
                method = "skeleton"
                is_supporting = is_measured[gap].mean(axis=0) >= MIN_SUPPORT_VISIBILITY
                drift = skeleton.drift_speed(marker, is_supporting) * length / rate
                if drift and max(drift, prediction.error) > MAX_ACCEPTED_ERROR:
                    prediction = replace(prediction, error=max(drift, prediction.error))
                    prediction, method = _most_accurate_prediction(
                        (prediction, "skeleton"),
                        (predict_from_parent_joint(skeleton, marker_gap), "skeleton"),
                        (predict_from_markers(marker_gap), "markers"),
                    )
                gap_positions = prediction.positions
            elif length <= MAX_CURVE_SECONDS * rate + 1e-9:
                method = "curve"
                gap_positions = _polynomial_positions(
                    positions[:, marker], is_known[:, marker], gap
                )
            if gap_positions is None:
                prediction_from_markers = predict_from_markers(marker_gap)
                if prediction_from_markers is not None:
                    gap_positions, method = prediction_from_markers.positions, "markers"
        if gap_positions is not None:
            positions[gap, marker] = gap_positions
            is_known[gap, marker] = True
        name = markers.names[marker]
        last = first + length - 1
        filled_gaps.append(
            FilledGap(name, first, last, "" if gap_positions is None else method)
        )
    marker_order = {name: i for i, name in enumerate(markers.names)}
    filled_gaps.sort(key=lambda gap: (marker_order[gap.marker], gap.first))
    return positions, filled_gaps


def _most_accurate_prediction(
    *predictions: tuple[Prediction | None, str],
) -> tuple[Prediction, str]:
    """Return the prediction with the least error, and its method.

    The first one's error is within the gap; those of the others are next to it.
    """
    (first, method), *alternatives = (
        (prediction, method)
        for prediction, method in predictions
        if prediction is not None
    )
    error = first.error / VALIDATION_BIAS
    return min(
        [(replace(first, error=error), method), *alternatives],
        key=lambda prediction: prediction[0].error,
    )


def _sorted_gaps(markers: Markers, is_known: BoolArray) -> list[tuple[int, int, int]]:
    """Return length [frame], first frame and marker of the gaps of named markers."""
    gaps = []
    for marker, name in enumerate(markers.names):
        if name.startswith("*") or not is_known[:, marker].any():
            continue
        missing_runs = runs(~is_known[:, marker])
        gaps += [(end - first, first, marker) for first, end in missing_runs]
    return sorted(gaps)


def _polynomial_positions(
    marker_positions: FloatArray, is_known: BoolArray, gap: slice
) -> FloatArray | None:
    """Return positions in a gap on a polynomial through nearby frames ``(G, 3)``.

    None if fewer than `MIN_SIDE_FRAMES` are visible on a side.
    """
    frames_before = _visible_frames_near(is_known, gap.start - 1, -1)
    frames_after = _visible_frames_near(is_known, gap.stop, 1)
    if len(frames_before) < MIN_SIDE_FRAMES or len(frames_after) < MIN_SIDE_FRAMES:
        return None
    frames = np.array([*frames_before[::-1], *frames_after])
    middle_frame = 0.5 * (gap.start + gap.stop - 1)
    scale = float(max(frames[-1] - middle_frame, middle_frame - frames[0]))
    degree = min(CURVE_DEGREE, len(frames) - 3)
    powers = np.vander((frames - middle_frame) / scale, degree + 1)
    gap_frames = np.arange(gap.start, gap.stop)
    gap_powers = np.vander((gap_frames - middle_frame) / scale, degree + 1)
    return np.asarray(gap_powers @ (np.linalg.pinv(powers) @ marker_positions[frames]))


def _visible_frames_near(is_known: BoolArray, start: int, step: int) -> list[int]:
    """Return up to `CURVE_FRAMES` consecutive visible frames, starting at ``start``."""
    frames: list[int] = []
    frame = start
    while 0 <= frame < len(is_known) and is_known[frame] and len(frames) < CURVE_FRAMES:
        frames.append(frame)
        frame += step
    return frames
