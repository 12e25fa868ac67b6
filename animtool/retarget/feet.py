"""Foot planting: solves root path and legs so that planted feet stay in place."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from animtool.core.array_types import BoolArray, FloatArray
from animtool.core.record import dataclass
from animtool.maths import so3
from animtool.maths.runs import runs
from animtool.motion.contacts import (
    RAISED_HEEL_HEIGHT,
    FootContacts,
    gaussian_smooth,
    remove_short_runs,
)
from animtool.retarget.bending import MAX_EXTENSION

# Time within which the hips shift from one foot to the other at a contact [s].
HANDOVER_SECONDS = 0.15
# Smoothing time of the hips' response to the feet [s].
HIP_SMOOTHING = 0.15
# Weight of the source's hip position where nothing else determines it.
FREE_WEIGHT = 1e-6
# Weight of fixed rows.
FIXED_WEIGHT = 1e9
# The knee angle changes quickly near its stop: while feet are planted, legs are bent
# more than those of the source by this factor.
BEND_FACTOR = 1.4
# Fraction of a leg's length below which its knee is far from its stop.
BENT_FRACTION = 0.98
# Maximum number of times that feet in the air are raised, and the tolerated depth below
# the ground [m].
MAX_RAISE_ITERATIONS, MAX_PENETRATION = 3, 1e-4
# Corrections of a foot in the air fade within this time [s].
FADE_SECONDS = 0.06
# A planted foot that leans more than this is not on level ground [rad].
MAX_LEAN = np.radians(20.0)
# Window around each frame in which a leg is as straight as the source's leg, and the
# width of its Gaussian smoothing [s]. Both fade within a second, so that block
# boundaries leave no trace.
STRAIGHTNESS_WINDOW, STRAIGHTNESS_SMOOTHING = 0.75, 0.05
# Approximate time within which the hips sink for a leg that does not reach [s].
LOWERING_SECONDS = 0.07
# Maximum iterations for sinking, and the tolerated reach error [m].
MAX_LOWERING_ITERATIONS, REACH_TOLERANCE = 12, 1e-5


@dataclass(frozen=True, slots=True)
class Foot:
    """A foot of the target before planting, relative to the middle of the hips."""

    contacts: FootContacts
    hip: FloatArray  # start of the thigh (F, 3) [m]
    ankle: FloatArray  # (F, 3) [m]
    toe: FloatArray | None  # (F, 3) [m]
    rotation: FloatArray  # world rotation of the foot (F, 4)
    # World rotation of the foot planted flat at rest (4,); None keeps its rotation.
    flat_rotation: FloatArray | None
    height: float  # height of the planted ankle above the ground [m]
    leg_length: float  # largest distance between ankle and hip [m]
    min_reach: float  # smallest distance between ankle and hip [m]
    height_change: FloatArray  # source ankle above its planted height, scaled (F,) [m]
    # Hip-ankle distance of the source over its leg length (F,).
    straightness: FloatArray


@dataclass(frozen=True, slots=True)
class PlacedFeet:
    """Solved paths of hips and feet, and the frames in which feet are planted."""

    hips: FloatArray  # the middle between the thighs (F, 3) [m]
    ankles: Sequence[FloatArray]  # ankle positions of each foot (F, 3) [m]
    rotations: Sequence[FloatArray]  # world rotations of each foot (F, 4)
    is_planted: Sequence[BoolArray]  # frames in which each foot is planted (F,)
    toe_rolls: Sequence[FloatArray]  # weight of pinning the toe, 0 to 1 (F,)
    # Planted height of each toe, or of the ankle without a toe [m].
    sole_heights: Sequence[float]
    max_lowering: float  # largest distance that the hips sank so that legs reach [m]


def plant_feet(
    hips: FloatArray, feet: Sequence[Foot], fps: float, up: int
) -> PlacedFeet:
    """Solve paths of hips and feet so that planted feet stay in place.

    The hips follow the scaled path of the source, so that an excerpt of a take moves as
    in the full take. They rise and sink so that planted feet need no other leg pose, as
    far as that is smooth. The remaining offset of each foot is constant while it is
    planted and as smooth as possible in between.

    Args:
        hips: Middle between the thighs, as the source's scaled ``(F, 3)`` [m]; the
            ground is at 0.
        feet: Feet relative to these hips.
        fps: Frames a second.
        up: Index of the up axis.
    """
    rotations = [_planted_rotations(foot, fps, up) for foot in feet]
    toe_vectors = list(map(_ankle_to_toe, feet, rotations))
    # A foot that rolls over its toe pins the toe, else the ankle.
    pinned_points = [
        foot.ankle if foot.toe is None else foot.toe - toe_vector
        for foot, toe_vector in zip(feet, toe_vectors, strict=True)
    ]
    hips = hips.copy()
    ankle_rises = [
        _ankle_rise(foot, toe_vector, up)
        for foot, toe_vector in zip(feet, toe_vectors, strict=True)
    ]
    hips[:, up] += _hip_lift(hips, feet, pinned_points, ankle_rises, fps, up)
    is_planted = [foot.contacts.any for foot in feet]
    ankles = [
        _pinned_path(hips + ankle, toe_vector, foot, fps, up)
        for foot, ankle, toe_vector in zip(
            feet, pinned_points, toe_vectors, strict=True
        )
    ]
    hip_lowering, hip_rise = _hip_shifts(hips, feet, ankles, fps, up)
    hips[:, up] += hip_rise - hip_lowering
    sole_heights = [foot.height + _toe_height(foot, up) for foot in feet]
    toe_rolls = [_toe_roll(foot.contacts.toe, fps) for foot in feet]
    max_lowering = max(float(hip_lowering.max(initial=0.0)), 0.0)
    foot_states = is_planted, toe_rolls, sole_heights
    return PlacedFeet(hips, ankles, rotations, *foot_states, max_lowering)


def _planted_rotations(foot: Foot, fps: float, up: int) -> FloatArray:
    """Return a foot's rotations, constant and level while planted flat ``(F, 4)``."""
    is_flat = remove_short_runs(foot.contacts.ankle & foot.contacts.toe, fps)
    correction = np.zeros((len(is_flat), 3))
    for start, end in runs(is_flat):
        # The mean of rotations that are near each other.
        mean = so3.normalize(so3.align_signs(foot.rotation[start:end]).sum(axis=0))
        target_rotation = mean
        if foot.flat_rotation is not None:
            lean = so3.multiply(mean, so3.conjugate(foot.flat_rotation))
            heading = _heading_rotation(lean, up)
            level_rotation = so3.multiply(heading, foot.flat_rotation)
            if so3.angle_between(level_rotation, mean) <= MAX_LEAN:
                target_rotation = level_rotation
        inverse_rotations = so3.conjugate(foot.rotation[start:end])
        to_target = so3.multiply(target_rotation, inverse_rotations)
        correction[start:end] = so3.log(to_target)
    fill_between(correction, is_flat, fps)
    return so3.align_signs(so3.multiply(so3.exp(correction), foot.rotation))


def _toe_roll(is_toe_planted: BoolArray, fps: float) -> FloatArray:
    """Return the weight of pinning the toe: 1 while planted, fading to 0 ``(F,)``."""
    weights = is_toe_planted[:, None].astype(np.float64)
    fill_between(weights, is_toe_planted, fps)
    return np.asarray(np.clip(weights[:, 0], 0.0, 1.0))


def _heading_rotation(rotation: FloatArray, up: int) -> FloatArray:
    """Return the part of a rotation about the vertical ``(4,)``."""
    heading = np.zeros(4)
    heading[up], heading[3] = rotation[up], rotation[3]
    norm = float(np.linalg.norm(heading))
    return heading / norm if norm > 0 else so3.IDENTITY.copy()


def _ankle_to_toe(foot: Foot, rotation: FloatArray) -> FloatArray:
    """Return the vector from ankle to toe for the foot's rotation ``(F, 3)``."""
    if foot.toe is None:
        return np.zeros_like(foot.ankle)
    rotation_change = so3.multiply(rotation, so3.conjugate(foot.rotation))
    return so3.rotate(rotation_change, foot.toe - foot.ankle)


def _ankle_rise(foot: Foot, toe_vector: FloatArray, up: int) -> FloatArray:
    """Return the ankle's rise above a level foot while on the toe only ``(F,)`` [m]."""
    is_only_toe_planted = foot.contacts.toe & ~foot.contacts.ankle
    rise = _toe_height(foot, up) - toe_vector[:, up]
    return np.where(is_only_toe_planted, rise, 0.0)


def _hip_lift(
    hips: FloatArray,
    feet: Sequence[Foot],
    relative_ankles: Sequence[FloatArray],
    ankle_rises: Sequence[FloatArray],
    fps: float,
    up: int,
) -> FloatArray:
    """Return the smoothed height that planted feet add to the hips ``(F,)`` [m]."""
    weights = np.array([_foot_weight(foot.contacts.any, fps) for foot in feet])
    lift = np.zeros((len(hips), 1))
    for weight, foot, ankle, ankle_rise in zip(
        weights, feet, relative_ankles, ankle_rises, strict=True
    ):
        lift[:, 0] += weight * (foot.height + ankle_rise - ankle[:, up] - hips[:, up])
    return smooth_path_to_targets(
        weights.sum(axis=0), lift, (HIP_SMOOTHING * fps) ** 4
    )[:, 0]


def smooth_path_to_targets(
    weights: FloatArray, weighted_targets: FloatArray, stiffness: float
) -> FloatArray:
    """Return the path ``(F, K)`` that best balances position targets against curvature.

    It minimises the sum of squared distances to the targets, times ``weights``
    ``(F,)``, and of squared second differences, times ``stiffness``.
    ``weighted_targets`` ``(F, K)`` are the targets times their weights.
    """
    from scipy.linalg import solveh_banded

    count = len(weights)
    if count < 3 or not weights.any():
        return np.zeros_like(weighted_targets)
    band = np.zeros((3, count))
    band[2] = weights + FREE_WEIGHT
    for offset, pattern in ((0, (1.0, 4.0, 1.0)), (1, (-2.0, -2.0)), (2, (1.0,))):
        for k, value in enumerate(pattern):
            band[2 - offset, offset + k : count - 2 + offset + k] += stiffness * value
    return np.asarray(solveh_banded(band, weighted_targets))


def _foot_weight(is_planted: BoolArray, fps: float) -> FloatArray:
    """Return how much a foot determines the hip height, 0 to 1 ``(F,)``."""
    support_weight = np.zeros(len(is_planted))
    for start, end in runs(is_planted):
        frames = np.arange(start, end)
        ramp_frames = max(min(HANDOVER_SECONDS * fps, (end - start) / 2), 1.0)
        # Contacts cut off by the ends of the take continue.
        frames_since_start = np.inf if start == 0 else frames - start
        frames_until_end = np.inf if end == len(is_planted) else end - 1 - frames
        frames_to_edge = np.minimum(frames_since_start, frames_until_end)
        support_weight[start:end] = _smooth_step(frames_to_edge / ramp_frames)
    return support_weight


def _smooth_step(fraction: FloatArray) -> FloatArray:
    """Return a smooth step from 0 to 1 of class C2."""
    t = np.clip(fraction, 0.0, 1.0)
    return np.asarray(t**3 * (10 - 15 * t + 6 * t * t))


def _toe_height(foot: Foot, up: int) -> float:
    """Return the height of the toe above the ankle for a level foot [m]."""
    if foot.toe is None:
        return 0.0
    if foot.flat_rotation is None:
        is_flat = foot.contacts.ankle & foot.contacts.toe
        heights = (foot.toe - foot.ankle)[:, up]
        return float(np.median(heights[is_flat] if is_flat.any() else heights))
    rotation = so3.multiply(foot.flat_rotation, so3.conjugate(foot.rotation[:1]))
    return float(so3.rotate(rotation, (foot.toe - foot.ankle)[:1])[0, up])


def _pinned_path(
    ankle: FloatArray, ankle_to_toe: FloatArray, foot: Foot, fps: float, up: int
) -> FloatArray:
    """Return the path of an ankle whose foot is pinned while planted ``(F, 3)``.

    The toe is pinned whenever it is planted, with the heel or alone; a heel that is
    planted alone stays in place while the toe comes down.
    """
    contacts = foot.contacts
    is_planted = contacts.any
    correction = np.zeros_like(ankle)
    planted_height = foot.height + _toe_height(foot, up)
    for start, end in runs(is_planted):
        ankle_path, toe_offset = ankle[start:end], ankle_to_toe[start:end].copy()
        heel, toe = contacts.ankle[start:end], contacts.toe[start:end]
        flat_frames = np.flatnonzero(heel & toe)
        if not len(flat_frames):
            flat_frames = np.arange(end - start)
        # A heel that is planted alone stays where it is in the nearest frame with the
        # toe.
        heel_only_frames = np.flatnonzero(heel & ~toe)
        insertion_indices = np.searchsorted(flat_frames, heel_only_frames)
        flat_before = flat_frames[np.maximum(insertion_indices - 1, 0)]
        flat_after = flat_frames[np.minimum(insertion_indices, len(flat_frames) - 1)]
        is_after_nearer = flat_after - heel_only_frames < heel_only_frames - flat_before
        nearest_flat = np.where(is_after_nearer, flat_after, flat_before)
        toe_offset[heel_only_frames] = toe_offset[nearest_flat]
        goal = (ankle_path + toe_offset)[flat_frames].mean(axis=0)
        goal[up] = planted_height
        if foot.toe is None:
            # A kneeling body rests on its toes, even without toe joints.
            median_height = float(np.median(foot.height_change[start:end]))
            if median_height > RAISED_HEEL_HEIGHT * foot.leg_length:
                goal[up] += median_height
        correction[start:end] = goal - toe_offset - ankle_path
    fill_between(correction, is_planted, fps)
    toe_height = (ankle + ankle_to_toe)[:, up]
    _raise_above_ground(correction[:, up], toe_height, planted_height, is_planted, fps)
    return ankle + correction


def _raise_above_ground(
    correction: FloatArray,
    toe_heights: FloatArray,
    min_height: float,
    is_planted: BoolArray,
    fps: float,
) -> None:
    """Raise a height correction ``(F,)`` [m] so that no toe in the air is below ground.

    ``toe_heights`` ``(F,)`` are those without that correction, and ``min_height`` is
    the lowest allowed one [m].
    """
    if not is_planted.any():
        return  # the ground is unknown
    is_fixed = is_planted.copy()
    for _ in range(MAX_RAISE_ITERATIONS):
        heights = toe_heights + correction
        is_below = ~is_planted & (heights < min_height - MAX_PENETRATION)
        if not is_below.any():
            return
        correction[is_below] = (min_height - toe_heights)[is_below]
        is_fixed |= is_below
        correction_rows = correction[:, None].copy()
        fill_between(correction_rows, is_fixed, fps)
        correction[:] = correction_rows[:, 0]


def fill_between(
    values: FloatArray, is_fixed: BoolArray, fps: float, fade: float = FADE_SECONDS
) -> None:
    """Replace rows ``(F, K)`` that are not fixed by smooth ones that fade to 0.

    The rows fade over about ``fade`` [s] away from the fixed rows; ``values`` change.
    """
    if is_fixed.all() or not is_fixed.any():
        return
    weights = np.where(is_fixed, FIXED_WEIGHT, 1.0)
    weighted_values = values * np.where(is_fixed, FIXED_WEIGHT, 0.0)[:, None]
    stiffness = (fade * fps) ** 4
    faded_values = smooth_path_to_targets(weights, weighted_values, stiffness)
    values[~is_fixed] = faded_values[~is_fixed]


def _hip_shifts(
    hips: FloatArray,
    feet: Sequence[Foot],
    ankles: Sequence[FloatArray],
    fps: float,
    up: int,
) -> tuple[FloatArray, FloatArray]:
    """Return how far hips sink and rise so that all legs reach, each ``(F,)`` [m]."""
    hip_lowering, hip_rise = np.full((2, len(hips)), -np.inf)
    for foot, ankle in zip(feet, ankles, strict=True):
        hip_to_ankle = hips + foot.hip - ankle
        largest_reach = upper_envelope(
            foot.straightness, STRAIGHTNESS_WINDOW * fps, STRAIGHTNESS_SMOOTHING * fps
        )
        # A similar leg may be as straight as the source's.
        bend_factor = BEND_FACTOR if foot.flat_rotation is not None else 1.0
        reach_fraction = np.clip(
            1 - bend_factor * (1 - largest_reach), BENT_FRACTION, MAX_EXTENSION
        )
        horizontal = hip_to_ankle.copy()
        horizontal[:, up] = 0.0
        horizontal_squared = (horizontal**2).sum(axis=1)
        highest_squared = (reach_fraction * foot.leg_length) ** 2 - horizontal_squared
        highest = np.sqrt(np.maximum(highest_squared, 0.0))
        hip_lowering = np.maximum(hip_lowering, hip_to_ankle[:, up] - highest)
        lowest = np.sqrt(np.maximum(foot.min_reach**2 - horizontal_squared, 0.0))
        # A body hanging by its feet is not flipped.
        is_above = (hip_to_ankle[:, up] > 0) & (lowest > 0)
        hip_rise = np.maximum(
            hip_rise, np.where(is_above, lowest - hip_to_ankle[:, up], 0.0)
        )
    width = LOWERING_SECONDS * fps
    return smooth_cover(hip_lowering, width), smooth_cover(hip_rise, width)


def smooth_cover(values: FloatArray, width: float) -> FloatArray:
    """Return a smooth curve above all positive values, near 0 elsewhere ``(F,)``.

    It is 0 where no value is above 0, and returns to 0 within a width [frames].
    """
    curve, is_fixed = np.zeros((len(values), 1)), np.zeros(len(values), np.bool_)
    for _ in range(MAX_LOWERING_ITERATIONS):
        is_low = values > curve[:, 0] + REACH_TOLERANCE
        if not is_low.any():
            break
        is_fixed |= is_low & _local_maxima(values - curve[:, 0])
        weights = np.where(is_fixed, FIXED_WEIGHT, 1.0)
        weighted_values = np.where(is_fixed, FIXED_WEIGHT * values, 0.0)[:, None]
        curve = smooth_path_to_targets(weights, weighted_values, max(width, 1.0) ** 4)
    return np.asarray(curve[:, 0])


def _local_maxima(values: FloatArray) -> BoolArray:
    """Return a mask of the values that are positive local maxima ``(F,)``."""
    padded_values = np.pad(values, 1, constant_values=-np.inf)
    is_peak = (values >= padded_values[:-2]) & (values >= padded_values[2:])
    return np.asarray(is_peak & (values > 0))


def upper_envelope(
    values: FloatArray, width: float, smooth: float | None = None
) -> FloatArray:
    """Return a smooth upper envelope of values ``(F,)`` with a width [frames].

    It is smoothed by a Gaussian of ``smooth`` frames; None uses a quarter of the width.
    """
    half_width = int(np.ceil(width))
    padded_values = np.pad(values, half_width, mode="edge")
    sliding_windows = np.lib.stride_tricks.sliding_window_view
    windows = sliding_windows(padded_values, 2 * half_width + 1)
    return gaussian_smooth(windows.max(axis=1), width / 4 if smooth is None else smooth)
