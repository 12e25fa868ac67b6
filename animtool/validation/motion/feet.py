"""Foot slide while in contact."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from animtool.core.array_types import FloatArray, IntArray
from animtool.core.errors import Fault
from animtool.maths import so3
from animtool.maths.runs import runs
from animtool.validation.motion.body import hips_of
from animtool.validation.motion.contacts import (
    FootStances,
    contacts_of,
    moves_over,
)
from animtool.validation.motion.size import body_axis
from animtool.validation.motion.subject import MotionSubject

# Body travel relative to foot travel.

# Time over which velocities are measured [s].
SPAN = 0.1
# Slower hips [size/s], or a shorter time [s], show no ratio. Feet that slide less in
# total are not reported [size].
SLOW, MIN_SECONDS, MIN_SLIDE = 0.1, 0.2, 0.05
# With scaled travel, the planted foot moves with the hips, or against them, at a nearly
# constant fraction of their speed. The 15th percentile of this ratio is above the first
# value, or the median and the 75th are below the others [1]: a rolling foot moves along
# a little.
ALONG, AGAINST, MOSTLY_AGAINST = 0.1, -0.15, -0.05
# From the 15th percentile to the median the ratio changes by less than this, along and
# against [1]: feet that slide on purpose, as in a dance, have no constant ratio.
EVEN_ALONG, EVEN_AGAINST = 0.12, 0.2


def travel_scale(subject: MotionSubject, contacts: FootStances) -> float | None:
    """Return the ratio of hip travel to foot travel, if it is consistently off.

    Over 1 feet are dragged along, and below they slip back.
    """
    ratios, weights = _ratios(subject, contacts)
    path = float(weights.sum()) * subject.interval / subject.size
    if len(ratios) * subject.interval < MIN_SECONDS:
        return None
    order = np.argsort(ratios, kind="stable")
    totals = np.cumsum(weights[order]) / weights.sum()
    quartiles = np.searchsorted(totals, (0.15, 0.5, 0.75)).clip(0, len(order) - 1)
    low, middle, high = ratios[order][quartiles].tolist()
    along = low > ALONG and middle - low < EVEN_ALONG and middle < 1.0
    against = middle < AGAINST and high < MOSTLY_AGAINST
    against &= middle - low < EVEN_AGAINST * max(1.0, -middle)
    if path * abs(middle) < MIN_SLIDE or not (along or against):
        return None
    return float(1.0 / (1.0 - middle))


def _ratios(
    subject: MotionSubject, contacts: FootStances
) -> tuple[FloatArray, FloatArray]:
    """Return velocities of the stance foot relative to the hips ``(N,)``.

    Along the hips' velocity, and their speeds [m/s]. Of feet near to the ground the
    slowest one counts.
    """
    points = subject.level(np.append(contacts.feet, hips_of(subject)))
    travels, steps = moves_over(subject, points, SPAN)
    velocities = travels / (steps * subject.interval)[:, None, None]
    feet, hips = velocities[:, :-1], velocities[:, -1]
    speeds = np.where(contacts.near, np.linalg.norm(feet, axis=2), np.inf)
    slowest = feet[np.arange(len(feet)), speeds.argmin(axis=1)]
    pace = np.linalg.norm(hips, axis=1)
    known = contacts.near.any(axis=1) & (pace > SLOW * subject.size)
    along = np.einsum("fc,fc->f", slowest, hips)[known]
    return np.asarray(along / pace[known] ** 2), np.asarray(pace[known])


# A take that travels less is in place, and its feet slide on purpose [size].
TRAVEL = 0.2
# Minimum speed of a sliding planted foot [size/s], and minimum duration [s].
SLIDE_SPEED, SLIDE_SECONDS = 0.12, 0.1
# One slide of the first length, or this many of the second [size], [1].
SLIDE_LENGTH, OFTEN_LENGTH, OFTEN = 0.08, 0.035, 3
# The speed is the lower of those over this time before and after [s]: a landing foot
# decelerates, and a lifting one was planted just before. Shorter times are noise.
SPEED_SECONDS = 0.1
# A landing foot decelerates at least to this fraction of its speed [1] while it falls
# by this height [size]; a lifting one does the reverse.
LANDS, LIFTS = 0.6, 0.005
# After a jump a body skids on and decelerates [1]: the skid starts this soon after
# landing [s], and lasts at most this long [s].
SKIDS, SKID_SECONDS, SKID_LASTS = 0.75, 0.15, 0.25
# Motion of a foot that rotates about a point under it, of the size per radian, or that
# rises or falls this many times as far, is not slide [1].
LEVER, STEEP = 0.07, 2.0


def foot_slide(subject: MotionSubject) -> Iterator[Fault]:
    """Yield a fault if the foot that carries the body slides (MOT208).

    The slowest foot on the ground counts: one may drag while the other is planted, and
    a heel rotates about its toes.
    """
    subject = subject.main
    contacts = contacts_of(subject)
    if (
        contacts is None
        or body_axis(subject)
        or _travel(subject) < TRAVEL * subject.size
    ):
        return
    speeds, slides = _speeds(subject, contacts.feet)
    speeds = np.where(contacts.carries, speeds, np.inf)
    slowest = speeds.min(axis=1)
    slides = _slowest_slides(subject, contacts, speeds, slides)
    fast = np.minimum(slowest, slides) > SLIDE_SPEED * subject.size
    sliding = contacts.near.any(axis=1) & fast
    lowest = subject.heights[:, contacts.feet].min(axis=1) / subject.size
    long_slides = []
    for first, end in runs(sliding):
        last, seconds = end - 1, (end - first) * subject.interval
        if _lands(slowest[first:end], lowest[first:end]):
            continue
        if seconds <= SKID_LASTS and _skids(subject, contacts, slowest, first, last):
            continue
        length = _slide_length(subject, contacts, first, last)
        if length >= OFTEN_LENGTH * subject.size and seconds >= SLIDE_SECONDS:
            long_slides.append((length, first, last))
    if len(long_slides) < OFTEN and not any(
        w >= SLIDE_LENGTH * subject.size for w, *_ in long_slides
    ):
        yield from _scaled_travel(subject, contacts)
        return
    length, first, last = max(long_slides)
    foot = int(contacts.feet[int(speeds[first : last + 1].mean(axis=0).argmin())])
    more = (
        f"; feet slide {len(long_slides) - 1} more times"
        if len(long_slides) > 1
        else ""
    )
    message = (
        f"planted foot {subject.take.rig.joints[foot].name!r} slides {length:.3g} m "
        f"from frame {subject.at(first)} to {subject.at(last)}{more}"
    )
    hint = "hold it with IK, or make the cycle in place"
    yield subject.fault("MOT208", foot, first, message, hint)


def _slowest_slides(
    subject: MotionSubject,
    contacts: FootStances,
    speeds: FloatArray,
    slides: FloatArray,
) -> FloatArray:
    """Return the slide speed of the slowest foot on the ground ``(F,)``.

    All joints of a foot near the ground count: a planted toe makes the foot slow, and
    a heel that rotates about it does not count as slide.
    """
    feet, parents = contacts.feet.tolist(), subject.take.rig.parents
    column_of = {foot: e for e, foot in enumerate(feet)}
    tops: list[int] = []
    for e, foot in enumerate(feet):
        above = column_of.get(int(parents[foot]))
        tops.append(e if above is None else tops[above])
    resting, slowest = np.zeros(len(speeds)), np.full(len(speeds), np.inf)
    for top in sorted(set(tops)):
        columns = np.flatnonzero(np.array(tops) == top)
        near = contacts.near[:, columns]
        speed = np.where(near, speeds[:, columns], np.inf).min(axis=1)
        slide = np.where(near, slides[:, columns], 0.0).max(axis=1)
        resting = np.where(speed < slowest, slide, resting)
        slowest = np.minimum(slowest, speed)
    return resting


def _lands(speeds: FloatArray, heights: FloatArray) -> bool:
    """Return whether a foot decelerates while landing, or accelerates while lifting.

    ``speeds`` [m/s] and ``heights`` [size], ``(N,)`` each.

    >>> _lands(np.array([3.0, 2.0, 1.0]), np.array([0.02, 0.01, 0.0]))
    True
    >>> _lands(np.array([3.0, 2.0, 1.0]), np.array([0.01, 0.01, 0.01]))
    False
    """
    rises = float(heights[-1] - heights[0])
    changes = np.diff(speeds) * np.sign(rises)
    slows = float(speeds.min()) < LANDS * float(speeds.max())
    return abs(rises) > LIFTS and slows and bool((changes >= 0.0).all())


def _skids(
    subject: MotionSubject,
    contacts: FootStances,
    speeds: FloatArray,
    first: int,
    last: int,
) -> bool:
    """Return whether feet decelerate after a flight, or accelerate before one.

    ``speeds`` of the slowest foot ``(F,)`` [m/s].
    """
    air = ~np.asarray(contacts.near.any(axis=1))
    reach = max(1, round(SKID_SECONDS / subject.interval))
    start, end = float(speeds[first]), float(speeds[last])
    lands = bool(air[max(first - reach, 0) : first].any()) and end < SKIDS * start
    leaves = bool(air[last + 1 :][:reach].any()) and start < SKIDS * end
    return lands or leaves


def _slide_length(
    subject: MotionSubject, contacts: FootStances, first: int, last: int
) -> float:
    """Return the shortest path of a foot near the ground over a run [m].

    With half of the time that its speed is that of, before and after.
    """
    reach = max(1, round(0.5 * SPEED_SECONDS / subject.interval))
    part = slice(max(first - reach, 0), last + reach + 1)
    feet = contacts.feet[contacts.near[first : last + 1].any(axis=0)]
    level = subject.level(feet)[part]
    return float(np.linalg.norm(np.diff(level, axis=0), axis=2).sum(axis=0).min())


def _scaled_travel(subject: MotionSubject, contacts: FootStances) -> Iterator[Fault]:
    """Yield a fault if root travel does not match the feet throughout."""
    scale = travel_scale(subject, contacts)
    if scale is None:
        return
    frame = int(contacts.near.any(axis=1).argmax())
    foot = int(contacts.feet[int(contacts.near[frame].argmax())])
    how = "along with" if scale > 1.0 else "back against"
    message = (
        f"planted feet slide {how} the body: it travels {scale:.2g} times as far as "
        f"they step, such as {subject.take.rig.joints[foot].name!r}"
    )
    hint = "scale the root motion to the legs, or hold planted feet with IK"
    yield subject.fault("MOT208", foot, frame, message, hint)


def _travel(subject: MotionSubject) -> float:
    """Return the diagonal of the hips' path along the ground [m]."""
    points = subject.level(np.array([hips_of(subject)]))[:, 0]
    return float(np.linalg.norm(points.max(axis=0) - points.min(axis=0)))


def _speeds(subject: MotionSubject, feet: IntArray) -> tuple[FloatArray, FloatArray]:
    """Return ground speeds and slide speeds of feet, ``(F, E)`` each [m/s].

    The lower of the distances a short time before and after each frame counts: a foot
    that reverses is not planted. Slide excludes rotating and lifting the foot.
    """
    count = subject.frames
    reach = max(1, round(SPEED_SECONDS / subject.interval))
    level, heights = subject.level(feet), subject.heights[:, feet]
    rotations = subject.world.rotations[:, feet]
    speeds = np.full((2, count, len(feet)), np.inf)
    for sign in (-1, 1):
        lengths = np.zeros((2, count, len(feet)))
        for offset in range(1, reach + 1):
            ends = np.clip(np.arange(count) + sign * offset, 0, count - 1)
            length = np.linalg.norm(level[ends] - level, axis=2)
            explained = STEEP * np.abs(heights[ends] - heights)
            angles = so3.angle_between(rotations[ends], rotations)
            explained += LEVER * subject.size * angles
            lengths = np.maximum(lengths, np.stack([length, length - explained]))
        # The first frame has nothing before it, and the last one nothing after it.
        seconds = np.abs(ends - np.arange(count)) * subject.interval
        known = seconds > 0.0
        speeds[:, known] = np.minimum(
            speeds[:, known], lengths[:, known] / seconds[known, None]
        )
    return speeds[0], speeds[1]
