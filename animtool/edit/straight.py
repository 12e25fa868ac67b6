"""Error estimate of linear interpolation between the frames of a take."""

from __future__ import annotations

import numpy as np

from animtool.core.array_types import FloatArray, IntArray
from animtool.core.clock import frame_label
from animtool.core.errors import Fault, Severity, listed
from animtool.core.quantities import angle_text, length_text, plain_number
from animtool.core.record import dataclass
from animtool.edit.between import TakeSampler
from animtool.edit.travel import FramePositions
from animtool.maths import so3
from animtool.motion.motion import CURVE_CHANNELS, Channel
from animtool.rig.kinematics import rest_size

# Smaller errors are not reported: a tenth of a degree moves the end of a limb by less
# than marker noise, 3 parts in 10,000 of a body are half a millimetre, and a weight is
# visible from about a hundredth [rad], [1], [1].
NEGLIGIBLE_ANGLE = np.radians(0.1)
NEGLIGIBLE_LENGTH = 3e-4
NEGLIGIBLE_WEIGHT = 5e-3
# Samples per block.
BLOCK_FRAMES = 4096


@dataclass(frozen=True, slots=True)
class InterpolationDeviation:
    """The largest interpolation error of one kind of channel between frames."""

    channel: str  # field of a motion
    row: int  # index of the joint, shape or control
    frame: float  # frame of the take with the largest error
    size: float  # estimated size [m], [rad], [1]


def interpolation_deviations(
    sampler: TakeSampler, positions: FramePositions
) -> list[InterpolationDeviation]:
    """Return the largest interpolation error of each kind of channel.

    A smooth curve f deviates from the line between two frames by at most s (1 - s) / 2
    · |f''| at the fraction s; f'' is estimated from differences of neighbouring frames.
    For rotations, f'' is the change of angular velocity. A motion that jumps
    deviates more than a smooth one.
    """
    motion = sampler.take.motion
    deviations = []
    for name in CURVE_CHANNELS:
        channel: Channel | None = getattr(motion, name)
        if channel is None:
            continue
        is_interpolated = np.ones(len(channel.animated), bool)
        if name in sampler.rows_on_curve:
            is_interpolated = ~sampler.rows_on_curve[name][channel.animated]
        interpolated_columns = np.flatnonzero(is_interpolated)
        largest_deviation = _largest_deviation(
            name, channel, interpolated_columns, positions
        )
        if largest_deviation is not None:
            deviations.append(largest_deviation)
    return deviations


def interpolation_notices(
    sampler: TakeSampler, positions: FramePositions, hint: str
) -> list[Fault]:
    """Return a note with the interpolation error (TAKE007), unless it is negligible.

    hint: How the caller can avoid it.
    """
    take = sampler.take
    rig = take.rig
    threshold_by_channel = {
        "translations": NEGLIGIBLE_LENGTH * (rest_size(rig) or 1.0),
        "rotations": NEGLIGIBLE_ANGLE,
    }
    error_texts = []
    for deviation in interpolation_deviations(sampler, positions):
        if deviation.size <= threshold_by_channel.get(
            deviation.channel, NEGLIGIBLE_WEIGHT
        ):
            continue
        size_text = plain_number(deviation.size)
        part_kind, part_names = "joint", list(rig.names)
        if deviation.channel == "translations":
            size_text = length_text(deviation.size)
        elif deviation.channel == "rotations":
            size_text = angle_text(float(np.degrees(deviation.size)))
        elif deviation.channel != "scales":
            part_kind = deviation.channel.replace("weights", "shapes")[:-1]
            part_names = [part.name for part in getattr(rig, f"{part_kind}s")]
        else:
            part_kind = "scale of joint"
        name = part_names[deviation.row]
        code = float(take.clock.start) + deviation.frame * float(take.clock.step)
        error_texts.append(
            f"{size_text} ({part_kind} {name!r}, frame {frame_label(round(code, 2))})"
        )
    if not error_texts:
        return []
    message = "the take has samples, not curves, there: interpolation between frames "
    message += f"is linear, and may be off by about {listed(error_texts)}"
    return [Fault("TAKE007", message, hint=hint, severity=Severity.NOTE)]


def _largest_deviation(
    channel_name: str, channel: Channel, columns: IntArray, positions: FramePositions
) -> InterpolationDeviation | None:
    """Return the largest error of the given columns of a channel."""
    (indices_between,) = np.nonzero(positions.fractions > 0)
    frame_count = len(channel.values)
    if not len(indices_between) or not len(columns) or frame_count < 3:
        return None
    largest_error: InterpolationDeviation | None = None
    for start in range(0, len(indices_between), BLOCK_FRAMES):
        block = indices_between[start : start + BLOCK_FRAMES]
        frames, fraction = positions.frames[block], positions.fractions[block]
        # Curvature at the frames before and after each position.
        first_inner = int(np.clip(frames.min(), 1, frame_count - 2))
        last_inner = int(np.clip(frames.max() + 1, 1, frame_count - 2))
        values = channel.values[first_inner - 1 : last_inner + 2]
        second_differences = _second_differences(values, columns)
        peaks, bend_factor = (
            second_differences.max(axis=1),
            fraction * (1 - fraction) / 2,
        )
        before, after = (
            np.clip(indices, first_inner, last_inner) - first_inner
            for indices in (frames, frames + 1)
        )
        worst_index = int(
            np.argmax(np.maximum(peaks[before], peaks[after]) * bend_factor)
        )
        sizes = np.maximum(
            *second_differences[[before[worst_index], after[worst_index]]]
        )
        sizes = sizes * bend_factor[worst_index]
        worst_column = int(np.argmax(sizes))
        size = float(sizes[worst_column])
        if largest_error is None or size > largest_error.size:
            frame = float(frames[worst_index] + fraction[worst_index])
            row = int(channel.animated[columns[worst_column]])
            largest_error = InterpolationDeviation(channel_name, row, frame, size)
    return largest_error


def _second_differences(values: FloatArray, columns: IntArray) -> FloatArray:
    """Return norms ``(F-2, A)`` of the second differences of values ``(F, A, K)``."""
    if len(columns) < values.shape[1]:
        values = values[:, columns]
    if values.shape[-1] == 4:
        return np.asarray(np.linalg.norm(np.diff(so3.steps(values), axis=0), axis=-1))
    return np.asarray(np.linalg.norm(np.diff(values, 2, axis=0), axis=-1))
