"""Detects legs and arms whose names are those of the other side of the body."""

from __future__ import annotations

import numpy as np

from animtool.core.array_types import FloatArray
from animtool.core.errors import Fault, counted, warning
from animtool.core.record import dataclass
from animtool.motion.motion import Motion
from animtool.rig.body_size import find_feet, find_hands, is_character
from animtool.rig.kinematics import rest_size, rest_world
from animtool.rig.sides import SidePairs, pair_sides
from animtool.rig.skeleton import Rig

# Fraction of the frames with left joints on the right side, for a swap [1].
SWAP_FRACTION = 0.9
# Frames with the hips above the feet within 26 degrees are used, if this fraction of
# all frames has it [1].
MIN_UPRIGHT, MIN_UPRIGHT_FRACTION = 0.9, 0.3
# Toes must point forward, and hips be apart, by at least this distance [size].
MIN_TOE_LENGTH = 0.01
# Fewest and most frames of a check of a block.
MIN_FRAMES, MAX_FRAMES = 8, 64
SWAPPED_SIDES_HINT = (
    "swap the names of the left and right joints in the file; if the motion itself is "
    "mirrored, correct it in the program it came from"
)


@dataclass(frozen=True, slots=True)
class SwappedSides:
    """Hips or shoulders on the other side of the body than their names say."""

    left_joint: int  # index of the hip or shoulder that is named left
    left_name: str
    right_name: str
    first_frame: int  # index of the first frame in which it is on the right
    swapped_count: int  # number of such frames
    frame_count: int

    @property
    def message(self) -> str:
        """Text with the names of both joints and the count of swapped frames."""
        return (
            f"judging by the feet, {self.left_name!r} is on the right of the body and "
            f"{self.right_name!r} on the left, in {self.swapped_count} of "
            f"{counted(self.frame_count, 'frame')}"
        )


def find_swapped_sides(
    rig: Rig, positions: FloatArray, body_size: float, sides: SidePairs | None = None
) -> SwappedSides | None:
    """Return the limbs that are on the other side of a body whose toes point forward.

    Legs come before arms. None if there are none, or if it cannot be told: for lying or
    crawling bodies, and rigs without toes.

    Args:
        rig: J joints.
        positions: Positions of the joints ``(F, J, 3)`` [m].
        body_size: Size of the body [m].
        sides: Pairs of left and right joints; None determines them by name.
    """
    feet = find_feet(rig.names)
    facing_direction = _facing_direction(rig, positions, feet.tolist())
    if facing_direction is None:
        return None
    sides = pair_sides(rig.names, rig.parents) if sides is None else sides
    legs = _limb_pairs(rig, sides, feet.tolist(), MIN_TOE_LENGTH * body_size)
    if not legs:
        return None
    hip_centers = positions[:, legs[0]].mean(axis=1)
    up_directions = hip_centers - positions[:, feet].mean(axis=1)
    left_direction = np.cross(up_directions, facing_direction)
    is_used = np.linalg.norm(facing_direction, axis=1) > MIN_TOE_LENGTH * body_size
    # The feet of a crawling or lying body are next to its hips and point anywhere.
    leg_lengths = np.linalg.norm(up_directions, axis=1)
    is_used &= up_directions @ np.array(rig.up.vector) > MIN_UPRIGHT * leg_lengths
    if np.count_nonzero(is_used) < max(1.0, MIN_UPRIGHT_FRACTION * len(is_used)):
        return None
    hands = find_hands(rig.names).tolist()
    arms = _limb_pairs(rig, sides, hands, MIN_TOE_LENGTH * body_size)
    # Clavicles may be right and the arms below them swapped.
    for left, right in (legs[0], *arms[:2]):
        offsets = positions[:, left] - positions[:, right]
        left_distance = np.einsum("fc,fc->f", left_direction, offsets)
        is_swapped = is_used & (left_distance < 0.0)
        swapped_count = int(np.count_nonzero(is_swapped))
        if swapped_count > SWAP_FRACTION * np.count_nonzero(is_used):
            names = rig.names[left], rig.names[right]
            first_frame, frame_count = int(is_swapped.argmax()), len(positions)
            return SwappedSides(left, *names, first_frame, swapped_count, frame_count)
    return None


def swapped_sides_warning(
    rig: Rig, motion: Motion, file_format: str = ""
) -> Fault | None:
    """Return a warning if limbs of a block of frames have swapped names (MOT210).

    Long blocks are sampled. A BVH may state another order of its angles.
    """
    if motion.frames < MIN_FRAMES or not is_character(rig.names):
        return None
    count = min(motion.frames, MAX_FRAMES)
    frames = np.linspace(0, motion.frames - 1, count).astype(np.int64)
    positions = motion.select(frames).world(rig).positions
    swap = find_swapped_sides(rig, positions, rest_size(rig))
    if swap is None:
        return None
    message = (
        f"judging by the feet, {swap.left_name!r} is on the right of the body and "
        f"{swap.right_name!r} on the left"
    )
    hint = SWAPPED_SIDES_HINT
    if file_format == "BVH":
        hint += "; if limbs bend the wrong way too, correct the order of the rotations "
        hint += "in CHANNELS: it may not be that of the data"
    return warning("MOT210", message, hint)


def _facing_direction(
    rig: Rig, positions: FloatArray, feet: list[int]
) -> FloatArray | None:
    """Return the mean direction of the feet ``(F, 3)``; None if there are no toes."""
    toe_joints = [
        i
        for i in feet
        if rig.joints[i].parent in feet and "toe" in rig.names[i].lower()
    ]
    if not toe_joints:
        return None
    toes, up = np.array(toe_joints), np.array(rig.up.vector)
    bones = positions[:, toes] - positions[:, rig.parents[toes]]
    height_gain = bones @ up
    horizontal_bones = bones - height_gain[..., None] * up
    # Toes of a hanging or raised foot point down.
    is_flat = np.abs(height_gain) < np.linalg.norm(horizontal_bones, axis=2)
    return np.asarray(np.where(is_flat[..., None], horizontal_bones, 0.0).mean(axis=1))


def _limb_pairs(
    rig: Rig, sides: SidePairs, tips: list[int], min_width: float
) -> list[tuple[int, int]]:
    """Return left and right joints that are apart, from the root to the first tip."""
    rest_positions = rest_world(rig).positions[0]
    partners = {int(left): int(sides.partners[left]) for left in sides.left}
    for left in sorted(tips, key=lambda tip: (tip not in partners, tip)):
        # Joints nearest to the root may be at its position.
        pairs = [
            (joint, partners[joint])
            for joint in reversed(rig.upwards(left))
            if joint in partners
            and np.linalg.norm(rest_positions[joint] - rest_positions[partners[joint]])
            > min_width
        ]
        if pairs:
            return pairs
    return []
