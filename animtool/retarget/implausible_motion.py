"""Detects motions too fast for a body, and bodies below or above the ground."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from fractions import Fraction

import numpy as np

from animtool.core.arguments import argument
from animtool.core.array_types import FloatArray, median
from animtool.core.errors import Fault, warning
from animtool.core.quantities import length_text
from animtool.core.rates import is_common_rate, rate_label
from animtool.motion.motion import Motion
from animtool.motion.take import TakeStream
from animtool.retarget.root_position import find_hips, upright_leg_length
from animtool.rig.body_size import find_feet, is_character
from animtool.rig.kinematics import rest_size, rest_world
from animtool.rig.skeleton import Rig

# Formats of captures with a rest pose.
CAPTURE_FORMATS = frozenset({"BVH", "glTF", "FBX"})
GRAVITY = 9.81  # [m/s²]
# Size of a person, from the soles to the hand of a raised arm [m].
PERSON_SIZE = 2.2
# Falling hips accelerate by 1 g, and legs push them up by 2 g for a moment: in
# continuous jumps half of the frames are below 1.3 g [g].
MAX_TYPICAL_ACCELERATION, LIKELY_ACCELERATION = 2.5, 1.3
# Accelerations are differences over this time, which excludes noise [s].
ACCELERATION_INTERVAL = Fraction(1, 30)
MIN_FRAMES = 8
# Factors of a mistaken rate, and the lowest rate of a capture.
RATE_FACTORS, MIN_CAPTURE_RATE = (2, 3, 4, 5, 8, 10), 15
# A planted foot moves less than this in this time [size], [s].
MAX_STATIC_MOVE, STATIC_SECONDS = 0.012, Fraction(1, 10)
# Warnings that explain another height.
EXPLAINING_CODES = frozenset(
    {"MAP009", "MOT209", "MOT213", "MOT214", "BVH115", "BVH117"}
)
# Sampled pairs of frames of a block, and planted feet that show the ground.
PAIR_COUNT, MIN_PLANTED_FEET = 32, 8
# A planted foot is the lowest joint, within this distance [size].
CARRYING_TOLERANCE = 0.05
# The lowest joint of a body that rests on the ground is within this range [size].
REST_HEIGHTS = (-0.02, 0.06)
# Planted feet this far from their rest height are below or above the ground; on flat
# ground nine in ten are within the tolerance [size].
MAX_SUNK_DEPTH, MAX_CLEARANCE, FLAT_TOLERANCE = 0.04, 0.05, 0.025


def fast_motion_warning(
    rig: Rig, block: Motion, rate: Fraction, rate_argument: str | None = None
) -> list[Fault]:
    """Return a warning if the hips accelerate too much for a body (TAKE012).

    The body is scaled to the size of a person. ``rate_argument`` sets the ``rate``.
    """
    size = rest_size(rig)
    frame_step = max(1, round(ACCELERATION_INTERVAL * rate))
    if not is_character(rig.names) or not size or len(rig.roots) != 1:
        return []
    if block.frames < 2 * frame_step + MIN_FRAMES:
        return []
    hips = block.world(rig).positions[:, find_hips(rig)] * (PERSON_SIZE / size)
    changes = (
        hips[2 * frame_step :]
        - 2 * hips[frame_step:-frame_step]
        + hips[: -2 * frame_step]
    )
    seconds = float(frame_step / rate)
    acceleration = float(median(np.linalg.norm(changes, axis=1)))
    acceleration /= seconds**2 * GRAVITY
    if acceleration <= MAX_TYPICAL_ACCELERATION:
        return []
    message = (
        f"at {rate_label(rate)}, the hips of a person of this size would accelerate by "
        f"{acceleration:.2g} g or more in half of the frames, with g = {GRAVITY} m/s²"
    )
    hint = "is the frame time right?"
    for factor in RATE_FACTORS:
        slower_acceleration = acceleration / factor**2
        if rate / factor < MIN_CAPTURE_RATE:
            break
        is_likely = slower_acceleration <= LIKELY_ACCELERATION
        if is_likely and is_common_rate(rate / factor):
            slower_rate = rate / factor
            hint += f" at {rate_label(slower_rate)}, 1/{factor} of the rate, it would "
            hint += f"be {slower_acceleration:.2g} g"
            if rate_argument is not None:
                hint += f": set {argument(rate_argument, f'{float(slower_rate):g}')}"
            break
    return [warning("TAKE012", message, hint)]


class GroundCheck:
    """Collects how far planted feet are above their height at rest, block by block.

    Only captures of rigs that stand upright on 0 of the up axis at rest are checked.
    """

    def __init__(self, stream: TakeStream) -> None:
        self._rig, self._rate = stream.rig, stream.fps / stream.step
        self._heights = list[FloatArray]()  # [m]
        self._leg_length = None
        rig, is_capture = stream.rig, stream.details.get("format") in CAPTURE_FORMATS
        if is_capture and is_character(rig.names) and len(rig.roots) == 1:
            heights = rest_world(rig).positions[0] @ np.array(rig.up.vector, float)
            low, high = (height * rest_size(rig) for height in REST_HEIGHTS)
            if low < float(heights.min()) < high:
                self._leg_length = upright_leg_length(rig)

    def recorded_blocks(self, blocks: Iterable[Motion]) -> Iterator[Motion]:
        """Yield the blocks, and record each of them."""
        for block in blocks:
            self.add(block)
            yield block

    def add(self, block: Motion) -> None:
        """Add the planted feet of sampled frames of a block."""
        frame_step = max(1, round(STATIC_SECONDS * self._rate))
        if self._leg_length is None or block.frames <= frame_step:
            return
        count = min(PAIR_COUNT, block.frames - frame_step)
        frames = np.linspace(0, block.frames - frame_step - 1, count).astype(np.int64)
        up, rig_size = np.array(self._rig.up.vector, float), rest_size(self._rig)
        feet = find_feet(self._rig.names)
        positions, later_positions = (
            block.select(sampled_frames).world(self._rig).positions
            for sampled_frames in (frames, frames + frame_step)
        )
        moves = np.linalg.norm((later_positions - positions)[:, feet], axis=-1)
        joint_heights = positions @ up
        foot_heights = joint_heights[:, feet]
        lowest = joint_heights.min(axis=1, keepdims=True)
        is_planted = foot_heights < lowest + CARRYING_TOLERANCE * rig_size
        is_planted &= moves < MAX_STATIC_MOVE * rig_size
        # A body that lies or crawls shows no ground of feet.
        hips = joint_heights[:, find_hips(self._rig)]
        is_planted &= (hips - lowest[:, 0] > 0.5 * self._leg_length)[:, None]
        rest_heights = rest_world(self._rig).positions[0, feet] @ up
        self._heights.append((foot_heights - rest_heights)[is_planted])

    def notices(self, reported_codes: Sequence[str]) -> list[Fault]:
        """Return a warning if all planted feet are far from the ground (MOT209)."""
        heights = np.concatenate(self._heights) if self._heights else np.zeros(0)
        if len(heights) < MIN_PLANTED_FEET or EXPLAINING_CODES & set(reported_codes):
            return []
        offset, size = float(median(heights)), rest_size(self._rig)
        spread = np.percentile(heights, 95) - np.percentile(heights, 5)
        is_off = offset < -MAX_SUNK_DEPTH * size or offset > MAX_CLEARANCE * size
        if not is_off or spread > 2 * FLAT_TOLERANCE * size:
            return []
        side, direction = ("below", "raise") if offset < 0 else ("above", "lower")
        distance = length_text(abs(offset))
        message = f"the feet are planted {distance} {side} the ground, 0 of the up "
        message += "axis, on which the skeleton rests"
        return [warning("MOT209", message, f"{direction} the root by {distance}")]
