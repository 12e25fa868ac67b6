"""Lost, frozen, repeated and off-grid frames."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from animtool.core.array_types import BoolArray, FloatArray, IntArray
from animtool.core.clock import span_label
from animtool.core.errors import Fault, counted
from animtool.maths.runs import runs
from animtool.validation.motion.body import limbs_of
from animtool.validation.motion.subject import MotionSubject

# A time code closer to a frame than this is that frame, rounded [time codes].
ROUNDING = 1e-6
# Farther from it, a sample is intended, such as for motion blur [time codes].
REGULAR_SAMPLE = 0.05
# Fraction of unevenly spaced samples that may be off the frames; more of them are a
# separate grid [1].
ASTRAY_FRACTION = 0.25
# A range may begin and end this far from the samples [time codes].
RANGE_SLACK = 1.0
# How far a range may start before or end after the samples, of their span: poses are
# often held [1].
EARLY_FRACTION, LATE_FRACTION = 0.02, 0.1


def off_frame(subject: MotionSubject) -> Iterator[Fault]:
    """Yield a fault if samples are off the frames (MOT216)."""
    codes = subject.codes
    if codes is None or len(codes) < 2:
        return
    off = codes - np.round(codes)
    misaligned = (np.abs(off) > ROUNDING) & (np.abs(off) < REGULAR_SAMPLE)
    astray = np.abs(off) > ROUNDING
    if float(astray.mean()) < ASTRAY_FRACTION:
        misaligned = astray
    if misaligned.any():
        worst = int(np.where(misaligned, np.abs(off), 0.0).argmax())
        message = (
            f"{np.count_nonzero(misaligned)} of {len(codes)} samples are off the "
            f"frame, by up to {abs(off[worst]):.3g} time codes, at "
            f"{codes[worst]:.10g}"
        )
    else:
        steps = np.diff(codes)
        integral = np.abs(steps - np.round(steps)) < ROUNDING
        if not integral.all() or abs(off[0]) <= ROUNDING:
            return
        worst = 0
        message = f"all samples are {off[0]:+.3g} time codes off the frame"
    hint = "write them at whole time codes, where other tools sample"
    yield subject.fault("MOT216", None, worst, message, hint)


def other_range(subject: MotionSubject) -> Iterator[Fault]:
    """Yield a fault if the range starts or ends where no sample is (MOT217).

    Samples outside of it are USD256's.
    """
    if subject.frame_range is None or subject.codes is None or subject.frames < 2:
        return
    start, end = subject.frame_range
    first, last = float(subject.codes[0]), float(subject.codes[-1])
    early, late = first - start, end - last
    most = last - first
    is_early = early > max(RANGE_SLACK, EARLY_FRACTION * most)
    is_late = late > max(RANGE_SLACK, LATE_FRACTION * most)
    if start > last or end < first or not (is_early or is_late):
        return
    message = (
        f"the range is {span_label(start, end)}, but the samples are at "
        f"{span_label(first, last)}: the pose is constant for {max(early, late):g} "
        "time codes"
    )
    hint = "let the range be that of the samples, and a glTF begin at time 0"
    yield subject.fault("MOT217", None, 0, message, hint)


# Fewer frames do not show a typical step.
MIN_FRAMES = 12
# With fewer moving joints, a lost frame looks like a key [1].
MIN_JOINTS = 4
# A step over lost frames is as long as all of theirs; up to this many are searched,
# more are a cut [1]. At most this fraction of the squared difference to one step may
# remain: steps that joints of captures agree in leave .45 or more [1].
MAX_LOST, EXPLAINED = 6, 0.35
# If few joints move, all of them must agree, with at most this remainder [1].
FEW_EXPLAINED, MIN_FEW = 0.06, 2
# The step must be this many times farther from its prediction than most others in
# blocks of this many frames [1]. Joints are not smoother than this fraction of a
# typical step, which is text of few digits, or than this [rad].
STANDS_OUT, BLOCK, EVEN, NOISE = 5.0, 40, 0.02, 1e-5
# A joint shows a loss if its step is this many times the typical deviation [1].
SHOWS = 4.0
# Gaps between samples are longer than this many steps [1].
DOUBLE = 1.6
# Number of steps around a repeated frame that are examined together [1].
GAP = 3
# Of the typical step: less shows no loss, and is not motion that stops [1].
MIN_PACE = 0.3
# Fraction of the joints that must show a loss: a single joint may pop [1].
MAX_JOINTS = 0.5
# Joints that move no more than this many steps contradict a loss. They may be at most
# this fraction, weighted by squared steps; and if they are not few, at most this much
# of the difference may remain [1].
GOES_ON, FEW_ON, MAX_ON, WELL_EXPLAINED = 1.25, 0.15, 0.4, 0.2
# If hardly any difference remains, fast joints such as a landing foot may contradict,
# and fewer joints must agree [1].
SURELY, SURE_ON, SURE_JOINTS = 0.04, 0.8, 0.4
# Few joints must be this fraction of all moving ones, and of two limbs [1].
FEW_PACE = 0.1
# Of the typical step: less is a repeated frame, even in text of four digits [1].
STATIC_SPEED = 1e-4
# Repeats this regular and this many are a frame rate; one at least every so many
# frames [1].
REGULAR, MIN_REPEATS, LONGEST_PERIOD = 0.8, 5, 12
# With a larger fraction of repeats a take is keyed in poses, and does not freeze [1].
MOSTLY_STATIC = 0.5


def lost_frames(subject: MotionSubject) -> Iterator[Fault]:
    """Yield steps as long as two or more in smooth motion (MOT205).

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
        f"all joints move {ratios[step]:.0f} times as far from frame "
        f"{subject.at(step)} to {subject.at(step + 1)} as nearby: "
        f"{counted(count, 'frame')} lost{more}"
    )
    hint = "record or export the take again, or insert the missing frame"
    yield subject.fault("MOT205", None, step, message, hint)


def _holes(subject: MotionSubject) -> Iterator[Fault]:
    """Yield gaps between the time codes of samples."""
    if subject.codes is None or subject.reduced or subject.frames < MIN_FRAMES:
        return
    gaps = np.diff(subject.codes)
    typical = float(np.median(gaps))
    ratios = gaps / typical
    even = np.abs(ratios - 1.0) < 0.25
    holes = np.flatnonzero(ratios > DOUBLE)
    # Curve keys have any spacing; even sampling has few gaps.
    if not len(holes) or np.count_nonzero(even) < 0.9 * len(gaps):
        return
    hole = int(holes[0])
    count = max(1, round(float(ratios[hole])) - 1)
    more = f"; there are {len(holes) - 1} more gaps" if len(holes) > 1 else ""
    message = (
        f"no sample between time codes {subject.at(hole)} and "
        f"{subject.at(hole + 1)}, though one is due every {typical:g}: "
        f"{counted(count, 'sample')} lost{more}"
    )
    hint = "export the take again; USD interpolates across the gap"
    yield subject.fault("MOT205", None, hole, message, hint)


def _columns(subject: MotionSubject) -> IntArray:
    """Return the animated joints, twice if they both rotate and translate."""
    return np.concatenate([subject.turning, subject.moving])


def _vectors(subject: MotionSubject) -> FloatArray:
    """Return rotation and translation steps ``(F - 1, N, 3)``, scaled alike."""
    shifts = subject.shifts * (2.0 / subject.size)
    return np.concatenate([subject.rotation_steps, shifts], axis=1)


def _double_steps(subject: MotionSubject) -> tuple[FloatArray, BoolArray]:
    """Return the length of each step in frames, and which are losses ``(S,)``.

    A loss is a step that is far from what the two on either side predict of one, and
    near to what they predict of several.
    """
    steps = _vectors(subject)
    count = len(steps)
    ratios, lost = np.ones(count), np.zeros(count, bool)
    a, b, c, d, e = (steps[i : count - 4 + i] for i in range(5))
    near, far = 0.5 * (b + d), 0.5 * (a + e)
    predicted = _predicted(near, far, 0)
    off = _squares(c - predicted)
    pace = _squares(predicted)
    noise = _typical_around(off) + (EVEN**2) * np.median(pace, axis=0) + NOISE**2
    shows = pace > SHOWS**2 * noise
    shows &= pace > 0.001 * pace.max(axis=1, keepdims=True)
    many = shows.sum(axis=1)
    total = (shows * off / noise).sum(axis=1)
    paces = np.sqrt(pace.sum(axis=1))
    possible = (many >= MIN_FEW) & (total > STANDS_OUT**2 * many)
    possible &= paces > MIN_PACE * np.median(paces)
    possible &= ~(subject.cuts() | _next_to_static(subject))[2:-2]
    on = np.einsum("snc,snc->sn", c, predicted) < GOES_ON * pace
    against = (shows * on * pace).sum(axis=1) / np.maximum(
        (shows * pace).sum(axis=1), np.finfo(float).tiny
    )
    possible &= against < SURE_ON
    for frames in range(1, MAX_LOST + 1):
        left = _squares(c - _predicted(near, far, frames))
        rest = (shows * left / noise).sum(axis=1)
        further = shows & (left < 0.5 * off)
        joints = further.sum(axis=1)
        explained = np.where(against < FEW_ON, EXPLAINED, WELL_EXPLAINED) * total
        skipped = (rest < explained) & (joints > MAX_JOINTS * many) & (against < MAX_ON)
        skipped |= (rest < SURELY * total) & (joints > SURE_JOINTS * many)
        few = (rest < FEW_EXPLAINED * total) & (joints == many)
        few &= (further * pace).sum(axis=1) > FEW_PACE * pace.sum(axis=1)
        few &= _of_two_limbs(subject, further)
        skipped = possible & np.where(many >= MIN_JOINTS, skipped, few)
        ratios[2:-2][skipped & ~lost[2:-2]] = frames + 1.0
        lost[2:-2] |= skipped
    return ratios, lost


def _of_two_limbs(subject: MotionSubject, flags: BoolArray) -> BoolArray:
    """Return rows in which joints of more than one limb are flagged ``(S,)``.

    A finger that jumps with its hand is no loss. A trunk that both turns and moves as
    far as in several steps counts as two. ``flags`` ``(S, N)`` of the columns.
    """
    limbs = limbs_of(subject.take.rig.parents)[_columns(subject)]
    moves = np.arange(len(limbs)) >= len(subject.turning)
    limbs = np.where(moves & (limbs < 0), -2, limbs)
    where = [flags[:, limbs == limb].any(axis=1) for limb in np.unique(limbs)]
    return np.asarray(np.sum(where, axis=0) > 1)


def _predicted(near: FloatArray, far: FloatArray, lost: int) -> FloatArray:
    """Return the predicted step over lost frames, from its neighbors.

    ``near`` and ``far`` are the means of the steps next to it and of those after these
    ``(S, N, 3)``. A parabola through these and their mirror images is summed.
    """
    first, second = 1.0 + 0.5 * lost, 2.0 + 0.5 * lost
    bend = (far - near) / (second**2 - first**2)
    level = near - bend * first**2
    offsets = np.arange(lost + 1) - 0.5 * lost
    return np.asarray((lost + 1) * level + bend * float((offsets**2).sum()))


def _squares(vectors: FloatArray) -> FloatArray:
    """Return the squared lengths of vectors ``(S, N, 3)``."""
    return np.asarray(np.einsum("snc,snc->sn", vectors, vectors))


def _typical_around(squares: FloatArray) -> FloatArray:
    """Return the typical value around each row, per column ``(S, N)``.

    The largest median of its block of rows and the two beside it.
    """
    count = len(squares)
    blocks = max(1, count // BLOCK)
    edges = np.linspace(0, count, blocks + 1).astype(int)
    medians = np.stack(
        [np.median(squares[i:j], axis=0) for i, j in pairwise(edges.tolist())]
    )
    rows = np.pad(medians, ((1, 1), (0, 0)), mode="edge")
    around = np.maximum(np.maximum(rows[:-2], rows[1:-1]), rows[2:])
    return np.asarray(np.repeat(around, np.diff(edges), axis=0))


def _next_to_static(subject: MotionSubject) -> BoolArray:
    """Return steps close to a repeated frame, where pace is unreliable."""
    static = subject.speeds < STATIC_SPEED * np.median(subject.speeds)
    windows = sliding_window_view(np.pad(static, GAP), 2 * GAP + 1)
    return np.asarray(windows.any(axis=1))


def _static_steps(subject: MotionSubject) -> BoolArray | None:
    """Return steps that repeat a frame within motion; None if that is common."""
    if subject.frames < MIN_FRAMES or len(_columns(subject)) < 2:
        return None
    speeds = subject.speeds
    moving = speeds[speeds > STATIC_SPEED * speeds.max()]
    if len(moving) < MIN_FRAMES // 2:
        return None
    return np.asarray(speeds < STATIC_SPEED * np.median(moving))


def _abrupt(speeds: FloatArray, typical: float, first: int, last: int) -> bool:
    """Return whether motion stops abruptly before a run of steps and resumes."""
    if first == 0 or last == len(speeds) - 1:
        return False
    return bool(min(speeds[first - 1], speeds[last + 1]) > MIN_PACE * typical)


def _repeats(subject: MotionSubject) -> tuple[BoolArray, bool]:
    """Return the repeated frames within motion, and whether they are regular."""
    static = _static_steps(subject)
    if static is None:
        return np.zeros(0, bool), False
    speeds = subject.speeds
    typical_speed = float(np.median(speeds[speeds > STATIC_SPEED * speeds.max()]))
    kept = np.zeros(len(static), bool)
    starts = []
    for first, end in runs(static):
        if _abrupt(speeds, typical_speed, first, end - 1):
            kept[first:end] = True
            starts.append(first)
    gaps = np.diff(starts)
    if len(gaps) < MIN_REPEATS:
        return kept, False
    typical = float(np.median(gaps))
    regular = float(np.mean(np.abs(gaps - typical) <= 1.0)) >= REGULAR
    return kept, regular and typical <= LONGEST_PERIOD


def frozen_frames(subject: MotionSubject) -> Iterator[Fault]:
    """Yield frames at which all motion stops abruptly and resumes (MOT206)."""
    kept, regular = _repeats(subject)
    if regular or not kept.any() or float(kept.mean()) > MOSTLY_STATIC:
        return
    frozen = runs(kept)
    first, end = max(frozen, key=lambda run: run[1] - run[0])
    more = f"; it freezes {len(frozen) - 1} more times" if len(frozen) > 1 else ""
    message = (
        f"nothing moves from frame {subject.at(first)} to {subject.at(end)}, "
        f"between frames that do{more}"
    )
    hint = "frames were lost and the last one repeated; record or export the take again"
    yield subject.fault("MOT206", None, first, message, hint)


def repeated_frames(subject: MotionSubject) -> Iterator[Fault]:
    """Yield a fault if frames are repeated to reach a rate (MOT207)."""
    kept, regular = _repeats(subject)
    if regular:
        rate = float(subject.take.clock.rate)
        actual = rate * (1.0 - float(kept.mean()))
        message = (
            f"{np.count_nonzero(kept)} of {subject.frames} frames repeat the "
            f"previous one: the motion has about {actual:.3g} frames per second, the "
            f"take {rate:g}"
        )
        hint = "export it at its recording rate"
        first = int(np.flatnonzero(kept)[0])
        yield subject.fault("MOT207", None, first, message, hint)
        return
    yield from _off_grid_step(subject)


def _is_multiple(ratio: float) -> bool:
    """Return whether a positive ratio is an integer or the inverse of one.

    >>> _is_multiple(2.0), _is_multiple(1 / 3), _is_multiple(1.25)
    (True, True, False)
    """
    parts = ratio if ratio >= 1.0 else 1.0 / ratio
    return abs(parts - round(parts)) < 0.02


def _off_grid_step(subject: MotionSubject) -> Iterator[Fault]:
    """Yield a fault if samples are even, but not on frames or simple subframes."""
    if subject.codes is None or subject.frames < MIN_FRAMES:
        return
    gaps = np.diff(subject.codes)
    step = float(np.median(gaps))
    fps = float(subject.take.clock.fps)
    shown = subject.shown_rate
    if shown is not None and not _is_multiple(fps / shown):
        message = (
            f"the stage has {shown:g} frames per second, but {fps:g} time codes per "
            "second: most frames fall between samples"
        )
        hint = "author the same framesPerSecond and timeCodesPerSecond"
        yield subject.fault("MOT207", None, 0, message, hint)
        return
    if np.abs(gaps - step).max() > 0.02 * step or _is_multiple(step):
        return
    message = (
        f"samples are {step:.6g} time codes apart: {fps / step:.4g} per second in a "
        f"stage of {fps:g} time codes per second"
    )
    hint = "export at the stage's rate; most samples fall between frames"
    yield subject.fault("MOT207", None, 0, message, hint)
