"""Detects lost, frozen, repeated and off-grid frames."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from animtool.core.array_types import BoolArray, FloatArray, IntArray
from animtool.core.clock import span_label
from animtool.core.errors import Fault, counted
from animtool.maths.runs import runs
from animtool.validation.motion.body import limb_roots
from animtool.validation.motion.subject import MotionSubject

# A time code closer to a frame than this is that frame, up to rounding [time codes].
TIME_CODE_ROUNDING = 1e-6
# Farther from a frame, a sample is intentional, such as for motion blur [time codes].
MAX_MISALIGNMENT = 0.05
# Fraction of unevenly spaced samples that may be off the frames; more of them form a
# separate grid [1].
MIN_GRID_FRACTION = 0.25
# The stated range may begin and end this far from the samples [time codes].
RANGE_TOLERANCE = 1.0
# Largest extension of the range before and after the samples, as a fraction of their
# span: poses are often held [1].
EARLY_RANGE_FRACTION, LATE_RANGE_FRACTION = 0.02, 0.1


def samples_off_frames(subject: MotionSubject) -> Iterator[Fault]:
    """Yield a fault if samples are not on whole frames (MOT216)."""
    time_codes = subject.time_codes
    if time_codes is None or len(time_codes) < 2:
        return
    offsets = time_codes - np.round(time_codes)
    is_off_frame = np.abs(offsets) > TIME_CODE_ROUNDING
    is_misaligned = is_off_frame & (np.abs(offsets) < MAX_MISALIGNMENT)
    if float(is_off_frame.mean()) < MIN_GRID_FRACTION:
        is_misaligned = is_off_frame
    if is_misaligned.any():
        farthest_sample = int(np.where(is_misaligned, np.abs(offsets), 0.0).argmax())
        count = np.count_nonzero(is_misaligned)
        message = (
            f"{count} of {len(time_codes)} samples {'is' if count == 1 else 'are'} not "
            "on a whole time code; the largest offset is "
            f"{abs(offsets[farthest_sample]):.3g}, at "
            f"{time_codes[farthest_sample]:.10g}"
        )
    else:
        steps = np.diff(time_codes)
        is_integral = np.abs(steps - np.round(steps)) < TIME_CODE_ROUNDING
        if not is_integral.all() or abs(offsets[0]) <= TIME_CODE_ROUNDING:
            return
        farthest_sample = 0
        message = f"all samples are off whole time codes by {offsets[0]:+.3g}"
    hint = "write samples at whole time codes, where other tools read them"
    yield subject.fault("MOT216", None, farthest_sample, message, hint)


def range_without_samples(subject: MotionSubject) -> Iterator[Fault]:
    """Yield a fault if the frame range starts or ends without a sample (MOT217).

    Samples outside the range are reported as USD256.
    """
    if (
        subject.frame_range is None
        or subject.time_codes is None
        or subject.frame_count < 2
    ):
        return
    range_start, range_end = subject.frame_range
    first_code, last_code = float(subject.time_codes[0]), float(subject.time_codes[-1])
    lead, tail = first_code - range_start, range_end - last_code
    sample_span = last_code - first_code
    is_early = lead > max(RANGE_TOLERANCE, EARLY_RANGE_FRACTION * sample_span)
    is_late = tail > max(RANGE_TOLERANCE, LATE_RANGE_FRACTION * sample_span)
    if range_start > last_code or range_end < first_code or not (is_early or is_late):
        return
    message = (
        f"the range is {span_label(range_start, range_end)}, but the samples run from "
        f"{span_label(first_code, last_code)}, so the pose is constant for "
        f"{max(lead, tail):g} time codes"
    )
    hint = "set the range to that of the samples, or export a glTF from time 0"
    yield subject.fault("MOT217", None, 0, message, hint)


# With fewer frames there is no typical step.
MIN_FRAMES = 12
# With fewer moving joints, a lost frame looks like a key [1].
MIN_MOVING_JOINTS = 4
# A step over lost frames is as long as theirs together; up to this many are tested,
# more are a cut [1]. At most this fraction of the squared difference to a single step
# may remain: in captures, steps with consistent joints leave .45 or more [1].
MAX_LOST_FRAMES, MAX_LOSS_REMAINDER = 6, 0.35
# If few joints move, all of them must agree, with at most this remainder [1].
MAX_SPARSE_REMAINDER, MIN_SPARSE_JOINTS = 0.06, 2
# A loss must be this many times farther from its prediction than most steps in blocks
# of this many frames [1]. Joints are not assumed smoother than this fraction of a
# typical step (text with few digits), or than this [rad].
OUTLIER_RATIO, BLOCK_FRAMES, MIN_ROUGHNESS, MIN_JOINT_NOISE = 5.0, 40, 0.02, 1e-5
# A joint can show a loss if its step is this many times the typical deviation [1].
SIGNIFICANT_RATIO = 4.0
# Gaps between samples are longer than this many steps [1].
GAP_RATIO = 1.6
# Number of steps around a repeated frame that are examined together [1].
REPEAT_WINDOW = 3
# Minimum speed relative to the typical one: below, there is no loss, and no motion that
# stops [1].
MIN_SPEED_RATIO = 0.3
# Minimum fraction of the joints that must show a loss, since a single joint may pop
# [1].
MIN_JOINT_FRACTION = 0.5
# Joints that move at most this many steps contradict a loss. Their fraction, weighted
# by squared steps, is limited; and if there are not few joints, so is the remaining
# difference [1].
MAX_CONTRADICTING_STEPS = 1.25
MAX_CONSISTENT_FRACTION = 0.15
MAX_CONTRADICTING_FRACTION = 0.4
MAX_GOOD_REMAINDER = 0.2
# If hardly any difference remains, fast joints such as a landing foot may contradict,
# and fewer joints must agree [1].
CERTAIN_REMAINDER, CERTAIN_CONTRADICTING, CERTAIN_JOINT_FRACTION = 0.04, 0.8, 0.4
# If few joints show a loss, they must be this fraction of all moving ones, and in two
# limbs [1].
MIN_SPARSE_FRACTION = 0.1
# Speed relative to the typical one below which a frame is repeated, even in text of
# four digits [1].
STATIC_SPEED = 1e-4
# Repeats this regular and this many indicate a lower frame rate; with at least one
# repeat per this many frames [1].
REGULAR_FRACTION, MIN_REPEATS, MAX_REPEAT_PERIOD = 0.8, 5, 12
# With a larger fraction of repeats, a take is keyed in poses and does not freeze [1].
MAX_STATIC_FRACTION = 0.5


def lost_frames(subject: MotionSubject) -> Iterator[Fault]:
    """Report steps that cover two or more frames of smooth motion (MOT205).

    In a file with time codes a lost frame is a gap between them.
    """
    yield from _sample_gaps(subject)
    if (
        subject.frame_count < MIN_FRAMES
        or len(_column_joints(subject)) < MIN_MOVING_JOINTS
    ):
        return
    step_lengths, is_lost = _find_lost_steps(subject)
    losses = np.flatnonzero(is_lost)
    if not len(losses):
        return
    first_step = int(losses[0])
    lost_count = max(1, round(float(step_lengths[first_step])) - 1)
    repeat_text = ""
    if len(losses) > 1:
        places = counted(len(losses) - 1, "more place")
        repeat_text = f"; frames are lost in {places}"
    message = (
        f"all joints move {step_lengths[first_step]:.0f} times as far between frames "
        f"{subject.time_text(first_step)} and {subject.time_text(first_step + 1)} as "
        f"between the frames around them, so {counted(lost_count, 'frame')} "
        f"{'was' if lost_count == 1 else 'were'} probably lost{repeat_text}"
    )
    hint = "record or export the take again, or insert the missing frames"
    yield subject.fault("MOT205", None, first_step, message, hint)


def _sample_gaps(subject: MotionSubject) -> Iterator[Fault]:
    """Yield a fault for each gap between the time codes of samples."""
    if (
        subject.time_codes is None
        or subject.is_reduced
        or subject.frame_count < MIN_FRAMES
    ):
        return
    gaps = np.diff(subject.time_codes)
    typical_gap = float(np.median(gaps))
    gap_ratios = gaps / typical_gap
    is_even = np.abs(gap_ratios - 1.0) < 0.25
    gap_indices = np.flatnonzero(gap_ratios > GAP_RATIO)
    # Curve keys have any spacing; even sampling has few gaps.
    if not len(gap_indices) or np.count_nonzero(is_even) < 0.9 * len(gaps):
        return
    gap_index = int(gap_indices[0])
    lost_count = max(1, round(float(gap_ratios[gap_index])) - 1)
    other_count = len(gap_indices) - 1
    repeat_text = ""
    if other_count:
        verb = "is" if other_count == 1 else "are"
        repeat_text = f"; there {verb} {counted(other_count, 'more gap')}"
    message = (
        f"there is no sample between time codes {subject.time_text(gap_index)} and "
        f"{subject.time_text(gap_index + 1)}, although the others are {typical_gap:g} "
        f"apart, so {counted(lost_count, 'sample')} "
        f"{'was' if lost_count == 1 else 'were'} probably lost{repeat_text}"
    )
    hint = "export the take again; USD interpolates across the gap"
    yield subject.fault("MOT205", None, gap_index, message, hint)


def _column_joints(subject: MotionSubject) -> IntArray:
    """Return the joint index of each column of `_step_vectors` ``(N,)``."""
    return np.concatenate([subject.rotating_joints, subject.translating_joints])


def _step_vectors(subject: MotionSubject) -> FloatArray:
    """Return rotation and translation steps in comparable units ``(F - 1, N, 3)``."""
    shifts = subject.translation_steps * (2.0 / subject.size)
    return np.concatenate([subject.rotation_steps, shifts], axis=1)


def _find_lost_steps(subject: MotionSubject) -> tuple[FloatArray, BoolArray]:
    """Return how many frames each step covers, and a mask of those with loss ``(S,)``.

    A loss is a step that is far from the prediction of a single step by its two
    neighbours on either side, and near their prediction of several steps.
    """
    steps = _step_vectors(subject)
    step_count = len(steps)
    step_lengths, is_lost = np.ones(step_count), np.zeros(step_count, bool)
    steps_before_2, steps_before_1, middle_steps, steps_after_1, steps_after_2 = (
        steps[i : step_count - 4 + i] for i in range(5)
    )
    near_steps = 0.5 * (steps_before_1 + steps_after_1)
    far_steps = 0.5 * (steps_before_2 + steps_after_2)
    predicted_step = _predicted_step(near_steps, far_steps, 0)
    squared_deviations = _squared_lengths(middle_steps - predicted_step)
    squared_steps = _squared_lengths(predicted_step)
    variance = (
        _typical_squares(squared_deviations)
        + (MIN_ROUGHNESS**2) * np.median(squared_steps, axis=0)
        + MIN_JOINT_NOISE**2
    )
    is_significant = squared_steps > SIGNIFICANT_RATIO**2 * variance
    is_significant &= squared_steps > 0.001 * squared_steps.max(axis=1, keepdims=True)
    significant_count = is_significant.sum(axis=1)
    weighted_deviation = (is_significant * squared_deviations / variance).sum(axis=1)
    total_steps = np.sqrt(squared_steps.sum(axis=1))
    is_possible = (significant_count >= MIN_SPARSE_JOINTS) & (
        weighted_deviation > OUTLIER_RATIO**2 * significant_count
    )
    is_possible &= total_steps > MIN_SPEED_RATIO * np.median(total_steps)
    is_possible &= ~(subject.cut_mask() | _near_repeats(subject))[2:-2]
    dot_products = np.einsum("snc,snc->sn", middle_steps, predicted_step)
    is_contradicting = dot_products < MAX_CONTRADICTING_STEPS * squared_steps
    loss_weight = (is_significant * squared_steps).sum(axis=1)
    contradicting_weight = (is_significant * is_contradicting * squared_steps).sum(
        axis=1
    )
    contradicting_weight /= np.maximum(loss_weight, np.finfo(float).tiny)
    is_possible &= contradicting_weight < CERTAIN_CONTRADICTING
    is_consistent = contradicting_weight < MAX_CONSISTENT_FRACTION
    max_remainder = np.where(is_consistent, MAX_LOSS_REMAINDER, MAX_GOOD_REMAINDER)
    max_remainder = max_remainder * weighted_deviation
    for lost_count in range(1, MAX_LOST_FRAMES + 1):
        prediction = _predicted_step(near_steps, far_steps, lost_count)
        remaining_squares = _squared_lengths(middle_steps - prediction)
        weighted_remaining = (is_significant * remaining_squares / variance).sum(axis=1)
        is_better = is_significant & (remaining_squares < 0.5 * squared_deviations)
        better_count = is_better.sum(axis=1)
        is_loss = weighted_remaining < max_remainder
        is_loss &= better_count > MIN_JOINT_FRACTION * significant_count
        is_loss &= contradicting_weight < MAX_CONTRADICTING_FRACTION
        is_loss |= (weighted_remaining < CERTAIN_REMAINDER * weighted_deviation) & (
            better_count > CERTAIN_JOINT_FRACTION * significant_count
        )
        better_steps = (is_better * squared_steps).sum(axis=1)
        is_sparse_loss = weighted_remaining < MAX_SPARSE_REMAINDER * weighted_deviation
        is_sparse_loss &= better_count == significant_count
        is_sparse_loss &= better_steps > MIN_SPARSE_FRACTION * squared_steps.sum(axis=1)
        is_sparse_loss &= _in_two_limbs(subject, is_better)
        is_loss = np.where(
            significant_count >= MIN_MOVING_JOINTS, is_loss, is_sparse_loss
        )
        is_loss &= is_possible
        step_lengths[2:-2][is_loss & ~is_lost[2:-2]] = lost_count + 1.0
        is_lost[2:-2] |= is_loss
    return step_lengths, is_lost


def _in_two_limbs(subject: MotionSubject, is_flagged: BoolArray) -> BoolArray:
    """Return a mask of steps in which joints of two or more limbs are flagged ``(S,)``.

    A finger that jumps with its hand is not a lost frame. A trunk that both rotates and
    moves as far as in several steps counts as two limbs. ``is_flagged``: mask of
    flagged columns ``(S, N)``.
    """
    limbs = limb_roots(subject.take.rig.parents)[_column_joints(subject)]
    is_translating = np.arange(len(limbs)) >= len(subject.rotating_joints)
    limbs = np.where(is_translating & (limbs < 0), -2, limbs)
    is_limb_flagged = [
        is_flagged[:, limbs == limb].any(axis=1) for limb in np.unique(limbs)
    ]
    return np.asarray(np.sum(is_limb_flagged, axis=0) > 1)


def _predicted_step(
    near_steps: FloatArray, far_steps: FloatArray, lost_count: int
) -> FloatArray:
    """Extrapolate the step over lost frames from the steps around it ``(S, N, 3)``.

    ``near_steps`` and ``far_steps`` ``(S, N, 3)`` are the means of the first, and of
    the second, steps before and after. The prediction integrates the symmetric parabola
    through both.
    """
    near_position, far_position = 1.0 + 0.5 * lost_count, 2.0 + 0.5 * lost_count
    curvature = (far_steps - near_steps) / (far_position**2 - near_position**2)
    center_step = near_steps - curvature * near_position**2
    offsets = np.arange(lost_count + 1) - 0.5 * lost_count
    return np.asarray(
        (lost_count + 1) * center_step + curvature * float((offsets**2).sum())
    )


def _squared_lengths(vectors: FloatArray) -> FloatArray:
    """Return the squared Euclidean norms of vectors ``(S, N, 3)``."""
    return np.asarray(np.einsum("snc,snc->sn", vectors, vectors))


def _typical_squares(squares: FloatArray) -> FloatArray:
    """Return a local maximum of block medians for each row and column ``(S, N)``.

    The maximum is taken over the block of the row and the two neighbouring blocks.
    """
    row_count = len(squares)
    block_count = max(1, row_count // BLOCK_FRAMES)
    block_edges = np.linspace(0, row_count, block_count + 1).astype(int)
    blocks = [squares[start:end] for start, end in pairwise(block_edges.tolist())]
    medians = np.stack([np.median(block, axis=0) for block in blocks])
    padded_medians = np.pad(medians, ((1, 1), (0, 0)), mode="edge")
    largest_medians = np.maximum(
        np.maximum(padded_medians[:-2], padded_medians[1:-1]), padded_medians[2:]
    )
    return np.asarray(np.repeat(largest_medians, np.diff(block_edges), axis=0))


def _near_repeats(subject: MotionSubject) -> BoolArray:
    """Return a mask of steps near a repeated frame, where speeds are unreliable."""
    is_static = subject.speeds < STATIC_SPEED * np.median(subject.speeds)
    padded_mask = np.pad(is_static, REPEAT_WINDOW)
    windows = sliding_window_view(padded_mask, 2 * REPEAT_WINDOW + 1)
    return np.asarray(windows.any(axis=1))


def _repeated_steps(subject: MotionSubject) -> BoolArray | None:
    """Return a mask of steps without motion; None if too few steps have motion."""
    if subject.frame_count < MIN_FRAMES or len(_column_joints(subject)) < 2:
        return None
    speeds = subject.speeds
    moving_speeds = speeds[speeds > STATIC_SPEED * speeds.max()]
    if len(moving_speeds) < MIN_FRAMES // 2:
        return None
    return np.asarray(speeds < STATIC_SPEED * np.median(moving_speeds))


def _repeated_frames(subject: MotionSubject) -> tuple[BoolArray, bool]:
    """Return a mask of repeated frames, and whether they recur regularly."""
    is_static = _repeated_steps(subject)
    if is_static is None:
        return np.zeros(0, bool), False
    speeds = subject.speeds
    typical_speed = float(np.median(speeds[speeds > STATIC_SPEED * speeds.max()]))
    min_speed = MIN_SPEED_RATIO * typical_speed
    is_repeat = np.zeros(len(is_static), bool)
    repeat_starts = []
    for first, end in runs(is_static):
        # The motion stops abruptly before these steps, and resumes after.
        is_inside = first > 0 and end < len(speeds)
        if is_inside and min(speeds[first - 1], speeds[end]) > min_speed:
            is_repeat[first:end] = True
            repeat_starts.append(first)
    repeat_gaps = np.diff(repeat_starts)
    if len(repeat_gaps) < MIN_REPEATS:
        return is_repeat, False
    period = float(np.median(repeat_gaps))
    is_regular = float(np.mean(np.abs(repeat_gaps - period) <= 1.0)) >= REGULAR_FRACTION
    return is_repeat, is_regular and period <= MAX_REPEAT_PERIOD


def frozen_frames(subject: MotionSubject) -> Iterator[Fault]:
    """Report frames in which all motion stops abruptly and then resumes (MOT206)."""
    is_repeat, is_regular = _repeated_frames(subject)
    if is_regular or not is_repeat.any():
        return
    if float(is_repeat.mean()) > MAX_STATIC_FRACTION:
        return
    frozen_runs = runs(is_repeat)
    first_frame, end_frame = max(frozen_runs, key=lambda run: run[1] - run[0])
    repeat_text = ""
    if len(frozen_runs) > 1:
        repeat_text = f", and {counted(len(frozen_runs) - 1, 'more time')}"
    message = (
        f"the motion freezes from frame {subject.time_text(first_frame)} to "
        f"{subject.time_text(end_frame)}{repeat_text}; frames were probably lost and "
        "the last one repeated"
    )
    hint = "record or export the take again"
    yield subject.fault("MOT206", None, first_frame, message, hint)


def repeated_frames(subject: MotionSubject) -> Iterator[Fault]:
    """Yield a fault if frames are repeated to reach a higher rate (MOT207)."""
    is_repeat, is_regular = _repeated_frames(subject)
    if is_regular:
        rate = float(subject.take.clock.rate)
        actual_rate = rate * (1.0 - float(is_repeat.mean()))
        message = (
            f"{np.count_nonzero(is_repeat)} of {subject.frame_count} frames repeat the "
            f"previous one, so the motion has about {actual_rate:.3g} frames per "
            f"second, but the take has {rate:g}"
        )
        hint = "export it at its recording rate"
        first_frame = int(np.flatnonzero(is_repeat)[0])
        yield subject.fault("MOT207", None, first_frame, message, hint)
        return
    yield from _off_grid_step(subject)


def _is_multiple(ratio: float) -> bool:
    """Return whether a positive ratio is an integer or the reciprocal of an integer.

    >>> _is_multiple(2.0), _is_multiple(1 / 3), _is_multiple(1.25)
    (True, True, False)
    """
    multiple = ratio if ratio >= 1.0 else 1.0 / ratio
    return abs(multiple - round(multiple)) < 0.02


def _off_grid_step(subject: MotionSubject) -> Iterator[Fault]:
    """Yield a fault if samples are even, but neither on frames nor on subframes."""
    if subject.time_codes is None or subject.frame_count < MIN_FRAMES:
        return
    time_steps = np.diff(subject.time_codes)
    typical_step = float(np.median(time_steps))
    fps = float(subject.take.clock.fps)
    playback_rate = subject.playback_rate
    if playback_rate is not None and not _is_multiple(fps / playback_rate):
        message = (
            f"the stage has {playback_rate:g} frames per second, but {fps:g} time "
            "codes per second: most frames fall between samples"
        )
        hint = "author the same framesPerSecond and timeCodesPerSecond"
        yield subject.fault("MOT207", None, 0, message, hint)
        return
    is_uneven = np.abs(time_steps - typical_step).max() > 0.02 * typical_step
    if is_uneven or _is_multiple(typical_step):
        return
    message = (
        f"samples are {typical_step:.6g} time codes apart: {fps / typical_step:.4g} "
        f"per second in a stage of {fps:g} time codes per second"
    )
    hint = "export at the stage's rate; most samples fall between frames"
    yield subject.fault("MOT207", None, 0, message, hint)
