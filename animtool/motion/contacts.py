"""Detects foot contacts from the speed and height of feet."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from animtool.core.array_types import BoolArray, FloatArray
from animtool.core.record import dataclass
from animtool.maths.runs import runs

# Width of the Gaussian that smooths jitter [s]: the speed of walking feet changes over
# ten times as long.
SMOOTHING_WIDTH = 0.03
# Margin of the speed threshold over the jitter that smoothing leaves.
NOISE_MARGIN = 1.2
# Largest speed of a standing foot in leg lengths per second: contact edges are then
# within a frame at 60 fps (F1 of at least 0.99 on takes with known contacts, with and
# without jitter).
MAX_STANDING_SPEED = 0.18
# Largest height of a standing foot above its lowest, in leg lengths.
MAX_STANDING_HEIGHT = 0.12
# A heel higher than this is raised, and only the toe stands; in leg lengths.
RAISED_HEEL_HEIGHT = 0.05
# Quantile of heights that is the ground; lower frames are outliers.
GROUND_QUANTILE = 0.02
# Fewer frames have no contacts.
MIN_CONTACT_FRAMES = 3
# Shorter contacts and gaps are ignored [s].
MIN_CONTACT_DURATION = 0.06


@dataclass(frozen=True, slots=True)
class FootContacts:
    """Masks of the frames in which ankle and toe are planted, and the ground height."""

    ankle: BoolArray  # mask of frames with the ankle planted (F,)
    toe: BoolArray  # mask of frames with the toe planted (F,)
    ground: float  # height of the standing ankle [m]

    @property
    def any(self) -> BoolArray:
        """Mask of frames in which ankle or toe is planted ``(F,)``."""
        return self.ankle | self.toe


def gaussian_smooth(values: FloatArray, width: float) -> FloatArray:
    """Smooth values ``(F, …)`` over frames with a Gaussian of a width [frames]."""
    half_width = math.ceil(4 * width)
    if not half_width or len(values) < 2:
        return values
    offsets = np.arange(-half_width, half_width + 1)
    kernel_weights = np.exp(-0.5 * (offsets / width) ** 2)
    kernel_weights /= kernel_weights.sum()
    # Mirrored at the ends, so that straight lines stay straight.
    frame_count = len(values)
    indices = np.arange(-half_width, frame_count + half_width)
    clamped_indices = np.clip(indices, 0, frame_count - 1)
    mirrored_indices = np.clip(2 * clamped_indices - indices, 0, frame_count - 1)
    padded_values = np.where(
        (indices == clamped_indices).reshape(-1, *[1] * (values.ndim - 1)),
        values[clamped_indices],
        2 * values[clamped_indices] - values[mirrored_indices],
    )
    columns = padded_values.reshape(len(padded_values), -1)
    smoothed_columns = [
        np.convolve(column, kernel_weights, "valid") for column in columns.T
    ]
    return np.stack(smoothed_columns, axis=1).reshape(values.shape)


def find_contacts(
    ankle: FloatArray,
    toe: FloatArray | None,
    fps: float,
    leg_length: float,
    up_axis: int = 1,
) -> FootContacts:
    """Detect the frames in which ankle and toe of a foot are planted.

    Speeds are of smoothed positions ``(F, 3)`` [m]; the smoothing widens for takes
    whose jitter would hide contacts. The ground height is measured: the foot is lowest
    there while slow. ``leg_length`` is that of thigh plus shin [m].
    """
    max_speed = MAX_STANDING_SPEED * leg_length
    points = [ankle] if toe is None else [ankle, toe]
    if len(ankle) < MIN_CONTACT_FRAMES or leg_length <= 0:
        no_contacts = np.zeros(len(ankle), np.bool_)
        lowest_height = float(ankle[:, up_axis].min(initial=np.inf))
        return FootContacts(no_contacts, no_contacts, lowest_height)
    width = SMOOTHING_WIDTH * fps
    jitter_speed = noise_speed(points, fps)
    if jitter_speed > 0:
        # A Gaussian reduces the speed of white noise by width^1.5.
        remaining_speed = jitter_speed / max(width, 1.0) ** 1.5
        width *= max(1.0, (NOISE_MARGIN * remaining_speed / max_speed) ** (2 / 3))
    slow_masks_and_heights = []
    for point in points:
        smoothed_point = gaussian_smooth(point, width)
        speed = np.linalg.norm(np.gradient(smoothed_point, axis=0), axis=1) * fps
        slow_masks_and_heights.append((speed < max_speed, smoothed_point[:, up_axis]))
    contact_masks = []
    for k, (is_slow, height) in enumerate(slow_masks_and_heights):
        slow_heights = height[is_slow] if is_slow.any() else height
        ground_height = float(np.quantile(slow_heights, GROUND_QUANTILE))
        is_heel = k == 0 and toe is not None
        max_height = RAISED_HEEL_HEIGHT if is_heel else MAX_STANDING_HEIGHT
        is_low = height < ground_height + max_height * leg_length
        contact_masks.append(remove_short_runs(is_slow & is_low, fps))
    is_planted = contact_masks[0] & contact_masks[-1]
    height = slow_masks_and_heights[0][1]
    ground = np.median(height[is_planted]) if is_planted.any() else height.min()
    return FootContacts(contact_masks[0], contact_masks[-1], float(ground))


def noise_speed(points: Sequence[FloatArray], fps: float) -> float:
    """Return the apparent speed that white noise causes, by third differences [m/s]."""
    if len(points[0]) < 8:
        return 0.0
    differences = [np.diff(point, 3, axis=0) for point in points]
    # Third differences of white noise are sqrt(20) times as large.
    deviations = [float(np.median(np.abs(d))) / 0.6745 for d in differences]
    return max(deviations) / math.sqrt(20) * fps * math.sqrt(3)


def remove_short_runs(is_contact: BoolArray, fps: float) -> BoolArray:
    """Fill the short gaps of a mask and remove its short runs."""
    min_frames = MIN_CONTACT_DURATION * fps
    cleaned_mask = is_contact.copy()
    for start, end in runs(~cleaned_mask):
        if start > 0 and end < len(cleaned_mask) and end - start < min_frames:
            cleaned_mask[start:end] = True
    for start, end in runs(cleaned_mask):
        # Spans cut off by the take may be longer.
        if start > 0 and end < len(cleaned_mask) and end - start < min_frames:
            cleaned_mask[start:end] = False
    return cleaned_mask
