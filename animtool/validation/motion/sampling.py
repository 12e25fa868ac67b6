"""Frames that are lost, frozen, repeated or off the grid."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from animtool._types import BoolArray, FloatArray, IntArray
from animtool.clock import span_label
from animtool.errors import Fault, counted
from animtool.validation.motion.pops import runs
from animtool.validation.motion.subject import MotionSubject

# Nearer to a frame than this a time code is that frame, rounded [time codes].
ROUNDING = 1e-6
# Further from it, a sample is one of its own, as for motion blur [time codes].
OWN_SAMPLE = 0.05
# Of unevenly spaced samples, so few off the frame are astray; more are of a grid of
# their own [1].
ASTRAY_SHARE = 0.25
# A range may begin and end this far from the samples [time codes].
RANGE_SLACK = 1.0
# Of the span of the samples, how far a range may begin before or end after them, where
# a pose is held more often [1].
EARLY_SHARE, LATE_SHARE = 0.02, 0.1


def off_frame(subject: MotionSubject) -> Iterator[Fault]:
    """Yield that samples lie off the frames (MOT216)."""
    codes = subject.codes
    if codes is None or len(codes) < 2:
        return
    off = codes - np.round(codes)
    drifting = (np.abs(off) > ROUNDING) & (np.abs(off) < OWN_SAMPLE)
    astray = np.abs(off) > ROUNDING
    if float(astray.mean()) < ASTRAY_SHARE:
        drifting = astray
    if drifting.any():
        worst = int(np.where(drifting, np.abs(off), 0.0).argmax())
        message = (
            f"{np.count_nonzero(drifting)} of {len(codes)} samples lie off the frame, "
            f"by up to {abs(off[worst]):.3g} time codes, at {codes[worst]:.10g}"
        )
    else:
        steps = np.diff(codes)
        whole = np.abs(steps - np.round(steps)) < ROUNDING
        if not whole.all() or abs(off[0]) <= ROUNDING:
            return
        worst = 0
        message = f"all samples lie {off[0]:+.3g} time codes off the frame"
    hint = "write them at whole time codes: other tools sample there"
    yield subject.fault("MOT216", None, worst, message, hint)


def other_range(subject: MotionSubject) -> Iterator[Fault]:
    """Yield that the stated range begins or ends where no sample is (MOT217).

    Samples outside of it are USD256's.
    """
    if subject.frame_range is None or subject.codes is None or subject.frames < 2:
        return
    start, end = subject.frame_range
    first, last = float(subject.codes[0]), float(subject.codes[-1])
    early, late = first - start, end - last
    most = last - first
    is_early = early > max(RANGE_SLACK, EARLY_SHARE * most)
    is_late = late > max(RANGE_SLACK, LATE_SHARE * most)
    if start > last or end < first or not (is_early or is_late):
        return
    message = (
        f"the range is {span_label(start, end)}, and the samples are at "
        f"{span_label(first, last)}: the pose is held for "
        f"{max(early, late):g} time codes"
    )
    hint = "set startTimeCode and endTimeCode to the first and last sample"
    yield subject.fault("MOT217", None, 0, message, hint)


# Fewer frames do not show what is usual in them.
MIN_FRAMES = 12
# Fewer joints that move do not tell a lost frame from a key of theirs [1].
MIN_JOINTS = 4
# A step over one lost frame is twice what the steps around predict; in captures none
# comes to 1.4 where the motion is smooth [1]. More than so many frames are a cut [1].
DOUBLE, MAX_LOST = 1.6, 8.0
# Share of the step that may go another way than predicted [1].
ASTRAY = 0.25
# Steps around count for so many before and after, but the nearest, which the loss
# disturbs; they may be so much less uneven than the step [1].
REACH, GAP, UNEVEN = 10, 3, 0.4
# Of the usual step: less shows no loss, and is no motion that stops [1].
MIN_PACE = 0.3
# Share of the joints that must show a loss: a single one jumps for itself [1].
MAX_JOINTS = 0.7
# Of the usual step: what is less is a frame repeated, in text of four digits too [1].
STILL = 1e-4
# Repeats so regular and so many are a rate of its own; a repeat at least every so many
# frames [1].
REGULAR, MIN_REPEATS, LONGEST_PERIOD = 0.8, 5, 12
# Share of its frames beyond which a take is keyed in poses, and does not freeze [1].
MOSTLY_STILL = 0.5


def lost_frames(subject: MotionSubject) -> Iterator[Fault]:
    """Yield steps that go as far as two or more in smooth motion (MOT205).

    In a file with time codes a lost frame is a hole between them.
    """
    yield from _holes(subject)
    if subject.frames < MIN_FRAMES or len(_columns(subject)) < MIN_JOINTS:
        return
    ratios, lost = _double_steps(subject)
    frames = np.flatnonzero(lost)
    if not len(frames):
        return
    step = int(frames[0])
    count = max(1, round(float(ratios[step])) - 1)
    more = f"; so are {len(frames) - 1} more steps" if len(frames) > 1 else ""
    message = (
        f"all joints go {ratios[step]:.1f} times as far from frame {subject.at(step)} "
        f"to {subject.at(step + 1)} as around: {counted(count, 'frame')} lost{more}"
    )
    hint = "record or export the take again, or put the missing frame in between"
    yield subject.fault("MOT205", None, step, message, hint)


def _holes(subject: MotionSubject) -> Iterator[Fault]:
    """Yield the holes between the time codes of samples."""
    if subject.codes is None or subject.reduced or subject.frames < MIN_FRAMES:
        return
    gaps = np.diff(subject.codes)
    usual = float(np.median(gaps))
    ratios = gaps / usual
    even = np.abs(ratios - 1.0) < 0.25
    holes = np.flatnonzero(ratios > DOUBLE)
    # Keys of a curve have any distance; holes are few in what is sampled evenly.
    if not len(holes) or np.count_nonzero(even) < 0.9 * len(gaps):
        return
    hole = int(holes[0])
    count = max(1, round(float(ratios[hole])) - 1)
    more = f"; there are {len(holes) - 1} more holes" if len(holes) > 1 else ""
    message = (
        f"no sample between time codes {subject.at(hole)} and {subject.at(hole + 1)}, "
        f"where one is due every {usual:g}: {counted(count, 'sample')} lost{more}"
    )
    hint = "export the take again; USD interpolates across the hole"
    yield subject.fault("MOT205", None, hole, message, hint)


def _columns(subject: MotionSubject) -> IntArray:
    """Return the joints that turn or move, those that do both twice."""
    return np.concatenate([subject.turning, subject.moving])


def _vectors(subject: MotionSubject) -> FloatArray:
    """Return the steps of turning and of moving joints ``(F - 1, N, 3)``, as one."""
    shifts = subject.shifts * (2.0 / subject.size)
    return np.concatenate([subject.turns, shifts], axis=1)


def _double_steps(subject: MotionSubject) -> tuple[FloatArray, BoolArray]:
    """Return how many times the predicted way each step goes, and which are losses."""
    steps = _vectors(subject)
    count = len(steps)
    ratios, lost = np.ones(count), np.zeros(count, bool)
    a, b, c, d, e = (steps[i : count - 4 + i] for i in range(5))
    # What a cubic through the two steps on either side has in the middle.
    usual = (4.0 * (b + d) - a - e) / 6.0
    along = np.einsum("snc,snc->sn", c, usual)
    square = np.einsum("snc,snc->sn", usual, usual)
    own = np.einsum("snc,snc->s", c, c)
    total = square.sum(axis=1)
    tiny = np.finfo(float).tiny
    ratio = along.sum(axis=1) / np.maximum(total, tiny)
    astray = 1.0 - along.sum(axis=1) ** 2 / np.maximum(total * own, tiny)
    pace = np.sqrt(total)
    fast = pace > MIN_PACE * np.median(pace)
    unlike = np.where(fast, np.abs(ratio - 1.0), 0.0)
    doubled = fast & (ratio > DOUBLE) & (ratio < MAX_LOST) & (astray < ASTRAY)
    doubled &= ~(subject.cuts() | _next_to_still(subject))[2:-2]
    if doubled.any():
        doubled &= _uneven_around(unlike) < UNEVEN * unlike
        doubled &= _share(along, square) > MAX_JOINTS
    ratios[2:-2], lost[2:-2] = ratio, doubled
    return ratios, lost


def _next_to_still(subject: MotionSubject) -> BoolArray:
    """Return the steps within a few of a repeated frame, where a pace says nothing."""
    still = subject.speeds < STILL * np.median(subject.speeds)
    windows = sliding_window_view(np.pad(still, GAP), 2 * GAP + 1)
    return np.asarray(windows.any(axis=1))


def _uneven_around(unlike: FloatArray) -> FloatArray:
    """Return the second largest of the values around each ``(S,)``.

    Of several losses near each other, each may leave one other out.
    """
    windows = sliding_window_view(np.pad(unlike, REACH), 2 * REACH + 1).copy()
    windows[:, REACH - GAP : REACH + GAP + 1] = 0.0
    return np.asarray(np.partition(windows, -2, axis=1)[:, -2])


def _share(along: FloatArray, square: FloatArray) -> FloatArray:
    """Return which share of the joints that move much go further too ``(S,)``."""
    counts = square > 0.02 * square.max(axis=1, keepdims=True)
    far = along > 0.5 * (1.0 + DOUBLE) * square
    many = counts.sum(axis=1)
    share = (counts & far).sum(axis=1) / np.maximum(many, 1)
    return np.where(many >= MIN_JOINTS, share, 0.0)


def _still_steps(subject: MotionSubject) -> BoolArray | None:
    """Return which steps repeat a frame within motion; None where that is usual."""
    if subject.frames < MIN_FRAMES or len(_columns(subject)) < 2:
        return None
    speeds = subject.speeds
    moving = speeds[speeds > STILL * speeds.max()]
    if len(moving) < MIN_FRAMES // 2:
        return None
    return np.asarray(speeds < STILL * np.median(moving))


def _abrupt(speeds: FloatArray, usual: float, first: int, last: int) -> bool:
    """Return whether motion stops at once before a run of steps and goes on after."""
    if first == 0 or last == len(speeds) - 1:
        return False
    return bool(min(speeds[first - 1], speeds[last + 1]) > MIN_PACE * usual)


def _repeats(subject: MotionSubject) -> tuple[BoolArray, bool]:
    """Return the repeated frames within motion, and whether they come regularly."""
    still = _still_steps(subject)
    if still is None:
        return np.zeros(0, bool), False
    speeds = subject.speeds
    usual_speed = float(np.median(speeds[speeds > STILL * speeds.max()]))
    kept = np.zeros(len(still), bool)
    starts = []
    for first, last in runs(still):
        if _abrupt(speeds, usual_speed, first, last):
            kept[first : last + 1] = True
            starts.append(first)
    gaps = np.diff(starts)
    if len(gaps) < MIN_REPEATS:
        return kept, False
    usual = float(np.median(gaps))
    regular = float(np.mean(np.abs(gaps - usual) <= 1.0)) >= REGULAR
    return kept, regular and usual <= LONGEST_PERIOD


def frozen_frames(subject: MotionSubject) -> Iterator[Fault]:
    """Yield frames at which all that moves stops at once and goes on (MOT206)."""
    kept, regular = _repeats(subject)
    if regular or not kept.any() or float(kept.mean()) > MOSTLY_STILL:
        return
    frozen = list(runs(kept))
    first, last = max(frozen, key=lambda run: run[1] - run[0])
    more = f"; it freezes {len(frozen) - 1} times more" if len(frozen) > 1 else ""
    message = (
        f"nothing moves from frame {subject.at(first)} to {subject.at(last + 1)}, "
        f"between frames that do{more}"
    )
    hint = "frames were lost and the last one held; record or export the take again"
    yield subject.fault("MOT206", None, first, message, hint)


def repeated_frames(subject: MotionSubject) -> Iterator[Fault]:
    """Yield that frames are repeated to reach a rate (MOT207)."""
    kept, regular = _repeats(subject)
    if regular:
        rate = float(subject.take.clock.rate)
        own = rate * (1.0 - float(kept.mean()))
        message = (
            f"{np.count_nonzero(kept)} of {subject.frames} frames repeat the one "
            f"before: the motion has about {own:.3g} frames a second, the take {rate:g}"
        )
        hint = "export it at the rate that it was recorded at"
        first = int(np.flatnonzero(kept)[0])
        yield subject.fault("MOT207", None, first, message, hint)
        return
    yield from _off_grid_step(subject)


def _is_multiple(ratio: float) -> bool:
    """Return whether a positive ratio is a whole number, or one part of a whole.

    >>> _is_multiple(2.0), _is_multiple(1 / 3), _is_multiple(1.25)
    (True, True, False)
    """
    parts = ratio if ratio >= 1.0 else 1.0 / ratio
    return abs(parts - round(parts)) < 0.02


def _off_grid_step(subject: MotionSubject) -> Iterator[Fault]:
    """Yield that samples lie evenly, but neither on frames nor on parts of them."""
    if subject.codes is None or subject.frames < MIN_FRAMES:
        return
    gaps = np.diff(subject.codes)
    step = float(np.median(gaps))
    fps = float(subject.take.clock.fps)
    shown = subject.shown_rate
    if shown is not None and not _is_multiple(fps / shown):
        message = (
            f"the stage shows {shown:g} frames a second, and has {fps:g} time codes a "
            "second: most frames fall between samples"
        )
        hint = "author framesPerSecond and timeCodesPerSecond alike"
        yield subject.fault("MOT207", None, 0, message, hint)
        return
    if np.abs(gaps - step).max() > 0.02 * step or _is_multiple(step):
        return
    message = (
        f"samples lie {step:.6g} time codes apart: {fps / step:.4g} a second in a "
        f"stage of {fps:g} time codes a second"
    )
    hint = "export at the stage's rate; most samples fall between frames"
    yield subject.fault("MOT207", None, 0, message, hint)
