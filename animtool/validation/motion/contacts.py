"""Detects ground contacts: foot joints, frames of stance, and the ground height."""

from __future__ import annotations

from typing import TypeVar

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from animtool.core.array_types import BoolArray, FloatArray, IntArray
from animtool.core.record import dataclass
from animtool.rig.body_size import find_feet
from animtool.validation.motion.body import body_joints
from animtool.validation.motion.subject import MotionSubject

Scalar = TypeVar("Scalar", np.float64, np.bool_)

# Height above its lowest resting height within which a foot is planted [size].
PLANTED_HEIGHT = 0.025
# A planted foot moves less than this distance in this time [s], [size].
STATIC_SECONDS, MAX_STATIC_MOVE = 0.1, 0.012
# Fewer static frames, or a smaller fraction of all frames, do not show the ground: feet
# also pause in the air [1].
MIN_CONTACT_FRAMES, MIN_CONTACT_FRACTION = 4, 0.1
# A foot that is rarely static slides throughout: it is planted at the height that it is
# near in this fraction of the frames [1].
MIN_LOW_FRACTION = 0.25
# A foot carries the body if no other joint is lower by more than this [size].
CARRYING_TOLERANCE = 0.05
# A body crawls, kneels or lies, and drags its feet, if a hand, a knee or the trunk is
# this close to the ground; considered are joints that rest this far above the feet
# [size].
MAX_LYING_HEIGHT, MIN_HEIGHT_ABOVE_FEET = 0.12, 0.15
# The same applies this long before and after: feet take or release the weight while a
# body goes down or gets up [s]. The ground is the lowest foot height within the second
# interval, since in the air a knee may be as low as the feet.
TRANSITION_SECONDS, STRIDE_SECONDS = 0.15, 0.3
# Fraction of a foot's contacts at one height if its ground is flat; and at two heights
# together and each, if part of the take floats or is on a step [1].
ONE_HEIGHT_FRACTION, TWO_HEIGHTS_FRACTION, EACH_HEIGHT_FRACTION = 0.5, 0.85, 0.2


@dataclass(frozen=True, slots=True)
class FootStances:
    """Feet of a take, the heights at which they are planted, and when they are.

    Attributes:
        feet: Indices of the foot joints ``(E,)``.
        partners: Column of the opposite foot, or the foot's own ``(E,)``.
        ground: Contact height of each foot ``(E,)`` [m].
        is_level: Whether most contacts of a foot are at that height ``(E,)``.
        has_same_height: Whether a foot has the contact height of its opposite ``(E,)``.
        floor: The lower of two common contact heights, else the ground; infinite for
            more than two ``(E,)`` [m].
        is_carrying: Whether no other joint is much lower ``(F, E)``.
        is_near_ground: Whether a foot carries the body near flat ground ``(F, E)``.
        is_static: Whether it carries the body without moving ``(F, E)``.
    """

    feet: IntArray
    partners: IntArray
    ground: FloatArray
    is_level: BoolArray
    has_same_height: BoolArray
    floor: FloatArray
    is_carrying: BoolArray
    is_near_ground: BoolArray
    is_static: BoolArray


def find_contacts(subject: MotionSubject) -> FootStances | None:
    """Detect planted feet; return None if the rig has no feet or the take is short."""
    feet = find_feet(subject.take.rig.names)
    if not len(feet) or subject.frame_count < MIN_CONTACT_FRAMES:
        return None
    heights = subject.heights[:, feet]
    lowest_heights = subject.heights[:, body_joints(subject)].min(axis=1, keepdims=True)
    is_carrying = heights < lowest_heights + CARRYING_TOLERANCE * subject.size
    is_carrying &= ~_is_lying(subject, feet)[:, None]
    is_static = is_carrying & _is_static(subject, subject.positions[:, feet])
    ground = np.zeros(len(feet))
    floor = np.full(len(feet), np.inf)
    is_level = np.zeros(len(feet), bool)
    tolerance = PLANTED_HEIGHT * subject.size
    min_contacts = max(MIN_CONTACT_FRAMES, MIN_CONTACT_FRACTION * subject.frame_count)
    for column in range(len(feet)):
        static_heights = heights[is_static[:, column], column]
        if len(static_heights) >= min_contacts:
            ground[column], fraction = _common_height(static_heights, tolerance)
            is_level[column] = fraction > ONE_HEIGHT_FRACTION
            floor[column] = _lower_ground_height(static_heights, tolerance)
        else:
            ground[column] = np.percentile(heights[:, column], 5)
            is_low = np.abs(heights[:, column] - ground[column]) < tolerance
            is_level[column] = is_low.mean() > MIN_LOW_FRACTION
            floor[column] = ground[column] if is_level[column] else np.inf
    partners = _opposite_feet(subject, feet)
    has_same_height = is_level & _is_at_opposite_height(ground, partners, tolerance)
    floor[~_is_at_opposite_height(floor, partners, tolerance)] = np.inf
    is_near = is_carrying & has_same_height & (np.abs(heights - ground) < tolerance)
    height_fields = ground, is_level, has_same_height, floor
    return FootStances(feet, partners, *height_fields, is_carrying, is_near, is_static)


def _common_height(heights: FloatArray, tolerance: float) -> tuple[float, float]:
    """Return the most common height, and the fraction of heights near it.

    >>> _common_height(np.array([0.0, 0.1, 0.2, 5.0]), 0.5)
    (0.1, 0.75)
    """
    heights = np.sort(heights)
    end_indices = np.searchsorted(heights, heights + 2.0 * tolerance, "right")
    start = int((end_indices - np.arange(len(heights))).argmax())
    nearby_heights = heights[start : int(end_indices[start])]
    return float(np.median(nearby_heights)), len(nearby_heights) / len(heights)


def _lower_ground_height(heights: FloatArray, tolerance: float) -> float:
    """Return the lower of at most two heights that most values are at; else infinity.

    >>> _lower_ground_height(np.array([0.0, 0.1, 5.0, 5.1, 5.2]), 0.5)
    0.05
    """
    first_height, fraction = _common_height(heights, tolerance)
    only_height = first_height if fraction > ONE_HEIGHT_FRACTION else np.inf
    other_heights = heights[np.abs(heights - first_height) > 2.0 * tolerance]
    if len(other_heights) < EACH_HEIGHT_FRACTION * len(heights):
        return only_height
    second_height, second_fraction = _common_height(other_heights, tolerance)
    second_fraction *= len(other_heights) / len(heights)
    if second_fraction < EACH_HEIGHT_FRACTION:
        return only_height
    is_common = fraction + second_fraction > TWO_HEIGHTS_FRACTION
    return min(first_height, second_height) if is_common else np.inf


def _is_lying(subject: MotionSubject, feet: IntArray) -> BoolArray:
    """Return a mask of frames in which a joint other than a foot is near the ground."""
    parents = subject.take.rig.parents
    other_joints = body_joints(subject)
    leg_joints = set(feet.tolist())
    for joint in range(len(parents)):
        if parents[joint] in leg_joints:
            leg_joints.add(joint)
    other_joints[list(leg_joints)] = False
    if subject.has_rest:
        rest_heights = subject.rest_positions @ subject.up_vector
        min_distance = MIN_HEIGHT_ABOVE_FEET * subject.rest_size
        other_joints &= rest_heights > rest_heights[feet].min() + min_distance
    if not other_joints.any():
        return np.zeros(subject.frame_count, bool)
    lowest_foot_heights = subject.heights[:, feet].min(axis=1)
    lowest_other_heights = subject.heights[:, other_joints].min(axis=1)
    ground_heights = _frame_windows(
        lowest_foot_heights, STRIDE_SECONDS / subject.interval
    ).min(axis=1)
    is_lying = lowest_other_heights < ground_heights + MAX_LYING_HEIGHT * subject.size
    windows = _frame_windows(is_lying, TRANSITION_SECONDS / subject.interval)
    return np.asarray(windows.any(axis=1))


def _frame_windows(values: NDArray[Scalar], half_width: float) -> NDArray[Scalar]:
    """Return the values around each frame ``(F, W)``, padded with the end values."""
    pad = round(half_width)
    padded_values = np.pad(values, pad, mode="edge")
    return sliding_window_view(padded_values, 2 * pad + 1)


def _opposite_feet(subject: MotionSubject, feet: IntArray) -> IntArray:
    """Return the index of each foot's opposite in ``feet``, or its own ``(E,)``."""
    column_of_foot = {int(joint): column for column, joint in enumerate(feet)}
    partners = subject.sides.partners[feet].tolist()
    return np.array(
        [column_of_foot.get(joint, column) for column, joint in enumerate(partners)]
    )


def _is_at_opposite_height(
    ground: FloatArray, partners: IntArray, tolerance: float
) -> BoolArray:
    """Return whether each foot's contact height equals its opposite's ``(E,)``."""
    with np.errstate(invalid="ignore"):
        return np.asarray(np.abs(ground - ground[partners]) < tolerance)


def displacements_around(
    subject: MotionSubject, points: FloatArray, seconds: float
) -> tuple[FloatArray, IntArray]:
    """Return displacements over an interval around each frame, and its frame count.

    seconds: approximate interval [s]. Returns displacements ``(F, E, 3)`` [m] and frame
    counts ``(F,)``.
    """
    count, half_span = (len(points), max(1, round(0.5 * seconds / subject.interval)))
    frames_before = np.clip(np.arange(count) - half_span, 0, count - 1)
    frames_after = np.clip(np.arange(count) + half_span, 0, count - 1)
    return points[frames_after] - points[frames_before], frames_after - frames_before


def _is_static(subject: MotionSubject, points: FloatArray) -> BoolArray:
    """Return a mask of where points ``(F, E, 3)`` are nearly at rest ``(F, E)``."""
    displacements, frame_counts = displacements_around(subject, points, STATIC_SECONDS)
    # At low rates a frame is longer than that interval.
    max_lengths = MAX_STATIC_MOVE * frame_counts * subject.interval / STATIC_SECONDS
    lengths = np.linalg.norm(displacements, axis=2)
    return np.asarray(lengths < max_lengths[:, None] * subject.size)
