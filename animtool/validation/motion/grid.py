"""Sample times off the frame, and ranges that begin elsewhere than the samples."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from animtool.clock import span_label
from animtool.errors import Fault
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
