"""Error estimate of linear interpolation between the frames of a take."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from animtool.core.array_types import FloatArray, IntArray
from animtool.core.clock import frame_label
from animtool.core.errors import Fault, Severity, listed
from animtool.core.quantities import angle_text, length_text, plain
from animtool.core.record import dataclass
from animtool.edit.between import Between
from animtool.edit.travel import FramePositions
from animtool.maths import so3
from animtool.motion.motion import Channel
from animtool.rig.kinematics import rest_size

# Smaller errors are not reported: a tenth of a degree moves the end of a limb by less
# than marker noise, 3 parts in 10,000 of a body are half a millimetre, and a weight is
# visible from about a hundredth [rad], [1], [1].
NEGLIGIBLE_ANGLE = np.radians(0.1)
NEGLIGIBLE = 3e-4
NEGLIGIBLE_WEIGHT = 5e-3
# Samples per block.
BLOCK_FRAMES = 4096


@dataclass(frozen=True, slots=True)
class StraightError:
    """The largest error of one kind of channel between frames."""

    channel: str  # field of a motion
    row: int  # joint, shape or control
    frame: float  # of the take, where it is
    size: float  # estimate [m], [rad], [1]


def straight_errors(between: Between, positions: FramePositions) -> list[StraightError]:
    """Return the largest interpolation error of each kind of channel.

    A smooth curve f deviates from the line between two frames by at most s (1 - s) / 2
    · |f''| at the fraction s; f'' is taken from differences of neighbouring frames.
    Rotations likewise, from the change of angular velocity. A motion that jumps
    deviates more than a smooth one.
    """
    motion = between.take.motion
    errors = []
    for name in ("translations", "rotations", "scales", "weights", "controls"):
        channel: Channel | None = getattr(motion, name)
        if channel is None:
            continue
        straight = np.ones(len(channel.animated), bool)
        if name in between.curved:
            straight = ~between.curved[name][channel.animated]
        largest = _largest(channel, np.flatnonzero(straight), positions)
        if largest is not None:
            frame, column, size = largest
            row = int(channel.animated[column])
            errors.append(StraightError(name, row, frame, size))
    return errors


def straight_notices(
    between: Between, positions: FramePositions, hint: str
) -> list[Fault]:
    """Return the note of the estimated interpolation error (TAKE007), if it matters.

    hint: How its caller avoids it.
    """
    take = between.take
    rig = take.rig
    least = {
        "translations": NEGLIGIBLE * (rest_size(rig) or 1.0),
        "rotations": NEGLIGIBLE_ANGLE,
    }
    said = []
    for error in straight_errors(between, positions):
        if error.size <= least.get(error.channel, NEGLIGIBLE_WEIGHT):
            continue
        size = plain(error.size)
        kind, names = "joint", list(rig.names)
        if error.channel == "translations":
            size = length_text(error.size)
        elif error.channel == "rotations":
            size = angle_text(float(np.degrees(error.size)))
        elif error.channel != "scales":
            kind = error.channel.replace("weights", "shapes")[:-1]
            names = [one.name for one in getattr(rig, f"{kind}s")]
        else:
            kind = "scale of joint"
        code = float(take.clock.start) + error.frame * float(take.clock.step)
        said.append(
            f"{size} ({kind} {names[error.row]!r}, frame {frame_label(round(code, 2))})"
        )
    if not said:
        return []
    message = (
        "the take has samples, not curves, there: interpolation between frames is "
        f"linear, and may be off by about {listed(said)}"
    )
    return [Fault("TAKE007", message, hint=hint, severity=Severity.NOTE)]


def _largest(
    channel: Channel, columns: IntArray, positions: FramePositions
) -> tuple[float, int, float] | None:
    """Return frame, column and size of the largest error of some columns."""
    (inside,) = np.nonzero(positions.fractions > 0)
    count = len(channel.values)
    if not len(inside) or not len(columns) or count < 3:
        return None
    worst: tuple[float, int, float] | None = None
    for at in _blocks(inside):
        frames, fraction = positions.frames[at], positions.fractions[at]
        # Curvature at the frames before and after each position.
        low = int(np.clip(frames.min(), 1, count - 2))
        high = int(np.clip(frames.max() + 1, 1, count - 2))
        bends = _bends(channel.values[low - 1 : high + 2][:, columns])
        before, behind = (
            bends[np.clip(one, low, high) - low] for one in (frames, frames + 1)
        )
        sizes = np.maximum(before, behind) * (fraction * (1 - fraction) / 2)[:, None]
        i, column = np.unravel_index(int(np.argmax(sizes)), sizes.shape)
        size = float(sizes[i, column])
        if worst is None or size > worst[2]:
            worst = float(frames[i] + fraction[i]), int(columns[column]), size
    return worst


def _blocks(indices: IntArray) -> Iterator[IntArray]:
    for begin in range(0, len(indices), BLOCK_FRAMES):
        yield indices[begin : begin + BLOCK_FRAMES]


def _bends(values: FloatArray) -> FloatArray:
    """Return the sizes of second differences of values ``(F, A, K)``, ``(F-2, A)``."""
    if values.shape[-1] == 4:
        return np.asarray(np.linalg.norm(np.diff(so3.steps(values), axis=0), axis=-1))
    return np.asarray(np.linalg.norm(np.diff(values, 2, axis=0), axis=-1))
