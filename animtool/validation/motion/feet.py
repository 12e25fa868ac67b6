"""Detects feet that slide while in contact with the ground."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from animtool.core.array_types import FloatArray, IntArray
from animtool.core.errors import Fault, counted
from animtool.maths import so3
from animtool.maths.runs import runs
from animtool.validation.motion.body import hips_of
from animtool.validation.motion.contacts import (
    FootStances,
    displacements_around,
    find_contacts,
)
from animtool.validation.motion.size import tilted_stance
from animtool.validation.motion.subject import MotionSubject

# Interval over which velocities are measured [s].
VELOCITY_SECONDS = 0.1
# Hips slower than this [size/s], or a shorter time [s], show no ratio. Feet that slide
# less in total are not reported [size].
MIN_HIP_SPEED, MIN_TRAVEL_SECONDS, MIN_TOTAL_SLIDE = 0.1, 0.2, 0.05
# With wrongly scaled travel, the planted foot moves with the hips, or against them, at
# a nearly constant fraction of their speed. The 15th percentile of this ratio is then
# above the first value, or the median and the 75th percentile are below the others [1];
# a rolling foot moves along a little.
MIN_ALONG_RATIO, MAX_AGAINST_MEDIAN, MAX_AGAINST_QUARTILE = 0.1, -0.15, -0.05
# Largest change of the ratio from the 15th percentile to the median, along and against
# [1]: feet that slide intentionally, as in a dance, have no constant ratio.
MAX_ALONG_SPREAD, MAX_AGAINST_SPREAD = 0.12, 0.2


def travel_scale(subject: MotionSubject, contacts: FootStances) -> float | None:
    """Return the ratio of hip travel to foot travel if it is consistently not 1.

    Above 1 the feet are dragged along; below 1 they slip back.
    """
    ratios, weights = _velocity_ratios(subject, contacts)
    hip_path_length = float(weights.sum()) * subject.interval / subject.size
    if len(ratios) * subject.interval < MIN_TRAVEL_SECONDS:
        return None
    order = np.argsort(ratios, kind="stable")
    cumulative_weights = np.cumsum(weights[order]) / weights.sum()
    quantile_indices = np.searchsorted(cumulative_weights, (0.15, 0.5, 0.75)).clip(
        0, len(order) - 1
    )
    low, median, high = ratios[order][quantile_indices].tolist()
    is_dragged = (
        low > MIN_ALONG_RATIO and median - low < MAX_ALONG_SPREAD and median < 1.0
    )
    is_slipping = median < MAX_AGAINST_MEDIAN and high < MAX_AGAINST_QUARTILE
    is_slipping &= median - low < MAX_AGAINST_SPREAD * max(1.0, -median)
    if hip_path_length * abs(median) < MIN_TOTAL_SLIDE or not (
        is_dragged or is_slipping
    ):
        return None
    return float(1.0 / (1.0 - median))


def _velocity_ratios(
    subject: MotionSubject, contacts: FootStances
) -> tuple[FloatArray, FloatArray]:
    """Return ratios of stance-foot to hip velocity, and hip speeds [m/s] ``(N,)``.

    The ratios are the component of the slowest near-ground foot's velocity along the
    hips' velocity, divided by the hip speed.
    """
    points = subject.ground_positions(np.append(contacts.feet, hips_of(subject)))
    displacements, step_counts = displacements_around(subject, points, VELOCITY_SECONDS)
    velocities = displacements / (step_counts * subject.interval)[:, None, None]
    foot_velocities, hip_velocities = velocities[:, :-1], velocities[:, -1]
    speeds = np.where(
        contacts.is_near_ground, np.linalg.norm(foot_velocities, axis=2), np.inf
    )
    frames = np.arange(len(foot_velocities))
    stance_velocity = foot_velocities[frames, speeds.argmin(axis=1)]
    hip_speed = np.linalg.norm(hip_velocities, axis=1)
    is_used = contacts.is_near_ground.any(axis=1) & (
        hip_speed > MIN_HIP_SPEED * subject.size
    )
    along_products = np.einsum("fc,fc->f", stance_velocity, hip_velocities)[is_used]
    hip_speed = np.asarray(hip_speed[is_used])
    return np.asarray(along_products / hip_speed**2), hip_speed


# A take that travels less is in place, and its feet slide intentionally [size].
MIN_TRAVEL = 0.2
# Minimum speed of a sliding planted foot [size/s], and minimum duration [s].
MIN_SLIDE_SPEED, MIN_SLIDE_SECONDS = 0.12, 0.1
# Length of a single reported slide, or of each of several, and their number [size],
# [1].
MIN_SINGLE_SLIDE, MIN_REPEATED_SLIDE, MIN_SLIDES = 0.08, 0.035, 3
# The speed is the lower of those over this interval before and after [s]: a landing
# foot decelerates, and a lifting foot was planted just before. Shorter intervals show
# noise.
SPEED_SECONDS = 0.1
# A landing foot decelerates at least to this fraction of its speed [1] while it falls
# by this height [size]; for a lifting foot it is reversed.
LANDING_RATIO, LANDING_HEIGHT = 0.6, 0.005
# After a jump a body skids and decelerates to this fraction [1]: the skid starts this
# soon after landing [s], and lasts at most this long [s].
SKID_RATIO, LANDING_SECONDS, MAX_SKID_SECONDS = 0.75, 0.15, 0.25
# Motion of a foot that rotates about a point below it, up to this distance [size per
# radian], or that rises or falls this many times as far, is not a slide [1].
ROLL_LEVER, LIFT_RATIO = 0.07, 2.0


def foot_slide(subject: MotionSubject) -> Iterator[Fault]:
    """Yield a fault if the foot that carries the body slides (MOT208).

    The slowest foot on the ground counts: one foot may drag while the other is planted,
    and a heel rotates about its toes.
    """
    subject = subject.without_first_pose
    contacts = find_contacts(subject)
    if contacts is None or tilted_stance(subject):
        return
    hip_path = subject.ground_positions(np.array([hips_of(subject)]))[:, 0]
    if np.linalg.norm(np.ptp(hip_path, axis=0)) < MIN_TRAVEL * subject.size:
        return
    speeds, slide_speeds = _foot_speeds(subject, contacts.feet)
    speeds = np.where(contacts.is_carrying, speeds, np.inf)
    slowest_speeds = speeds.min(axis=1)
    slide_speeds = _slowest_slides(subject, contacts, speeds, slide_speeds)
    is_fast = np.minimum(slowest_speeds, slide_speeds) > MIN_SLIDE_SPEED * subject.size
    is_sliding = contacts.is_near_ground.any(axis=1) & is_fast
    lowest_heights = subject.heights[:, contacts.feet].min(axis=1) / subject.size
    slides = []
    for first, end in runs(is_sliding):
        seconds = (end - first) * subject.interval
        if _is_landing(slowest_speeds[first:end], lowest_heights[first:end]):
            continue
        if seconds <= MAX_SKID_SECONDS and _is_skid(
            subject, contacts, slowest_speeds, first, end - 1
        ):
            continue
        length = _slide_length(subject, contacts, first, end - 1)
        if length >= MIN_REPEATED_SLIDE * subject.size and seconds >= MIN_SLIDE_SECONDS:
            slides.append((length, first, end - 1))
    longest_slide = max(slides, default=(0.0, 0, 0))
    if len(slides) < MIN_SLIDES and longest_slide[0] < MIN_SINGLE_SLIDE * subject.size:
        yield from _travel_scale_fault(subject, contacts)
        return
    length, first, last = longest_slide
    joint = int(contacts.feet[int(speeds[first : last + 1].mean(axis=0).argmin())])
    repeat_text = ""
    if len(slides) > 1:
        repeat_text = f"; feet slide {counted(len(slides) - 1, 'more time')}"
    message = (
        f"planted foot {subject.take.rig.joints[joint].name!r} slides {length:.3g} m "
        f"between frames {subject.time_text(first)} and {subject.time_text(last)}"
        f"{repeat_text}"
    )
    hint = "hold planted feet with IK; ignore this in a cycle without root motion"
    yield subject.fault("MOT208", joint, first, message, hint)


def _slowest_slides(
    subject: MotionSubject,
    contacts: FootStances,
    speeds: FloatArray,
    slide_speeds: FloatArray,
) -> FloatArray:
    """Return how fast the slowest foot near the ground slides ``(F,)`` [m/s].

    All joints of a foot near the ground count: a planted toe makes the foot slow, and a
    heel that rotates about it does not slide.
    """
    parents = subject.take.rig.parents
    feet_columns: list[list[int]] = []  # columns of the joints of each foot
    foot_of_joint: dict[int, list[int]] = {}
    for column, joint in enumerate(contacts.feet.tolist()):
        if int(parents[joint]) not in foot_of_joint:
            feet_columns.append([])
        foot_of_joint[joint] = foot_of_joint.get(int(parents[joint]), feet_columns[-1])
        foot_of_joint[joint].append(column)
    slowest_slides, slowest_speeds = np.zeros(len(speeds)), np.full(len(speeds), np.inf)
    for columns in feet_columns:
        is_near = contacts.is_near_ground[:, columns]
        foot_speeds = np.where(is_near, speeds[:, columns], np.inf).min(axis=1)
        foot_slides = np.where(is_near, slide_speeds[:, columns], 0.0).max(axis=1)
        is_slower = foot_speeds < slowest_speeds
        slowest_slides = np.where(is_slower, foot_slides, slowest_slides)
        slowest_speeds = np.minimum(slowest_speeds, foot_speeds)
    return slowest_slides


def _is_landing(speeds: FloatArray, heights: FloatArray) -> bool:
    """Return whether a foot decelerates as it lands, or accelerates as it lifts off.

    ``speeds`` [m/s] and ``heights`` [size], ``(N,)`` each.

    >>> _is_landing(np.array([3.0, 2.0, 1.0]), np.array([0.02, 0.01, 0.0]))
    True
    >>> _is_landing(np.array([3.0, 2.0, 1.0]), np.array([0.01, 0.01, 0.01]))
    False
    """
    height_change = float(heights[-1] - heights[0])
    speed_changes = np.diff(speeds) * np.sign(height_change)
    is_slowing = float(speeds.min()) < LANDING_RATIO * float(speeds.max())
    is_monotonic = bool((speed_changes >= 0.0).all())
    return abs(height_change) > LANDING_HEIGHT and is_slowing and is_monotonic


def _is_skid(
    subject: MotionSubject,
    contacts: FootStances,
    speeds: FloatArray,
    first: int,
    last: int,
) -> bool:
    """Return whether the feet decelerate after a flight or accelerate before one.

    ``speeds``: of the slowest foot ``(F,)`` [m/s].
    """
    is_airborne = ~np.asarray(contacts.is_near_ground.any(axis=1))
    window = max(1, round(LANDING_SECONDS / subject.interval))
    start_speed, end_speed = float(speeds[first]), float(speeds[last])
    has_landed = bool(is_airborne[max(first - window, 0) : first].any())
    is_taking_off = bool(is_airborne[last + 1 :][:window].any())
    return (has_landed and end_speed < SKID_RATIO * start_speed) or (
        is_taking_off and start_speed < SKID_RATIO * end_speed
    )


def _slide_length(
    subject: MotionSubject, contacts: FootStances, first: int, last: int
) -> float:
    """Return the shortest path of a foot near the ground in a run of frames [m].

    The run is extended by half the interval of its speeds, before and after.
    """
    half_window = max(1, round(0.5 * SPEED_SECONDS / subject.interval))
    frame_slice = slice(max(first - half_window, 0), last + half_window + 1)
    feet = contacts.feet[contacts.is_near_ground[first : last + 1].any(axis=0)]
    steps = np.diff(subject.ground_positions(feet)[frame_slice], axis=0)
    return float(np.linalg.norm(steps, axis=2).sum(axis=0).min())


def _travel_scale_fault(
    subject: MotionSubject, contacts: FootStances
) -> Iterator[Fault]:
    """Yield a fault if the root consistently travels farther or less than the feet."""
    scale = travel_scale(subject, contacts)
    if scale is None:
        return
    frame = int(contacts.is_near_ground.any(axis=1).argmax())
    joint = int(contacts.feet[int(contacts.is_near_ground[frame].argmax())])
    direction = "along with" if scale > 1.0 else "back against"
    message = (
        f"planted feet slide {direction} the body: it travels {scale:.2g} times as far "
        f"as they step, such as {subject.take.rig.joints[joint].name!r}"
    )
    hint = "scale the root motion to the legs, or hold planted feet with IK"
    yield subject.fault("MOT208", joint, frame, message, hint)


def _foot_speeds(
    subject: MotionSubject, feet: IntArray
) -> tuple[FloatArray, FloatArray]:
    """Return the horizontal speeds and slide speeds of the feet ``(F, E)`` [m/s].

    The lower of the distances a short time before and after each frame counts, since a
    foot that reverses is not planted. Slides exclude rotation and lifting of the foot.
    """
    frames = np.arange(subject.frame_count)
    max_offset = max(1, round(SPEED_SECONDS / subject.interval))
    positions, heights = subject.ground_positions(feet), subject.heights[:, feet]
    rotations = subject.world.rotations[:, feet]
    speeds = np.full((2, subject.frame_count, len(feet)), np.inf)
    for sign in (-1, 1):
        max_distances = np.zeros(speeds.shape)
        for offset in range(1, max_offset + 1):
            other_frames = np.clip(frames + sign * offset, 0, subject.frame_count - 1)
            distances = np.linalg.norm(positions[other_frames] - positions, axis=2)
            lift_distances = LIFT_RATIO * np.abs(heights[other_frames] - heights)
            angles = so3.angle_between(rotations[other_frames], rotations)
            lift_distances += ROLL_LEVER * subject.size * angles
            offset_distances = np.stack([distances, distances - lift_distances])
            max_distances = np.maximum(max_distances, offset_distances)
        # The first frame has nothing before it, and the last one nothing after it.
        seconds = np.abs(other_frames - frames) * subject.interval
        has_other = seconds > 0.0
        side_speeds = max_distances[:, has_other] / seconds[has_other, None]
        speeds[:, has_other] = np.minimum(speeds[:, has_other], side_speeds)
    return speeds[0], speeds[1]
