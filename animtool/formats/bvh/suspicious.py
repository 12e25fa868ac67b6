"""Detects swapped channels, and offsets whose sign differs between sides."""

from __future__ import annotations

from collections.abc import Callable
from itertools import permutations

import numpy as np

from animtool.core.array_types import FloatArray, IntArray
from animtool.core.errors import Fault, Severity
from animtool.core.quantities import plain_number, vector_text
from animtool.formats.bvh.hierarchy import BvhHeader
from animtool.motion.motion import Motion
from animtool.rig.body_size import find_feet, is_character
from animtool.rig.kinematics import rest_size, rest_world
from animtool.rig.sides import pair_sides
from animtool.rig.skeleton import Rig

# Skeletons with fewer joints may be props.
MIN_BODY_JOINTS = 8
# Height of the root of a body above its lowest joint at rest, over the body's size, and
# range of a height that equals it, over it [1].
MIN_LEG_FRACTION, HEIGHT_RANGE = 0.35, (0.75, 1.2)
# Maximum of the up axis's position channel relative to that height [1], and smallest
# range of two angles of a body that moves [deg].
MAX_ROOT_HEIGHT_FRACTION, MIN_ANGLE_RANGE = 0.4, 1.0
# Smallest range of another rotation channel that holds a path, over that height [1].
MIN_PATH_FRACTION = 0.5
# Fewest pairs of sides that are mirror images, and their smallest fraction of all pairs
# and largest difference, over the length of an offset [1].
MIN_MIRRORED_PAIRS, MIN_MIRRORED_FRACTION, MAX_DIFFERENCE = 4, 0.75, 0.1
# Pairs with a shorter offset than this are not compared, over the body's size [1].
MIN_OFFSET_FRACTION = 0.03
# Fewest mirrored pairs with most of their offset across the plane of symmetry; bones
# with axes of their own have none.
MIN_LATERAL_PAIRS = 2
# Speed of the slower foot of a body whose feet slide, over the mean speed of joints,
# and largest ratio to it of the speed in the right order of angles [1].
MIN_SLIDING_SPEED, MAX_SPEED_RATIO = 0.05, 0.1
# Fewest frames in which feet can be seen to stand still.
MIN_ORDER_FRAMES = 20


def swapped_root_warning(
    header: BvhHeader, rows: FloatArray, rig: Rig, path: str
) -> list[Fault]:
    """Return a warning if a root's position and rotation values look swapped.

    Its height is near 0, and a rotation channel is as constant and high as
    the legs are long (BVH115).

    Args:
        header: The header of the file.
        rows: Rows of channel values ``(F, C)``.
        rig: The skeleton, in metres.
        path: The file.
    """
    root = header.joints[0]
    channels = list(root.channels or ())
    position_columns = [
        i for i, name in enumerate(channels) if name.endswith("position")
    ]
    rotation_columns = [
        i for i, name in enumerate(channels) if name.endswith("rotation")
    ]
    if (
        len(rig.joints) < MIN_BODY_JOINTS
        or len(position_columns) != 3
        or len(rotation_columns) != 3
    ):
        return []
    up = np.array(rig.up.vector, float)
    rest_heights = rest_world(rig).positions[0] @ up
    leg_length = float(rest_heights[0] - rest_heights.min())
    if leg_length <= MIN_LEG_FRACTION * rest_size(rig) or not len(rows):
        return []
    relative_values = rows[:, : len(channels)] * rig.meters_per_unit / leg_length
    ranges = np.ptp(rows[:, : len(channels)], axis=0)
    # Rotation channels would hold the positions in the order of their axes.
    up_name = "XYZ"[int(up.argmax())]
    up_channel = next(
        up_channel
        for up_channel, i in enumerate(position_columns)
        if channels[i][0] == up_name
    )
    heights = relative_values[:, rotation_columns[up_channel]]
    path_columns = [i for i in rotation_columns if i != rotation_columns[up_channel]]
    is_leg_length = HEIGHT_RANGE[0] < heights.min() <= heights.max() < HEIGHT_RANGE[1]
    is_root_near_ground = (
        np.abs(relative_values[:, position_columns[up_channel]]).max()
        < MAX_ROOT_HEIGHT_FRACTION
    )
    distances = np.abs(relative_values[:, position_columns])
    is_height = (distances > HEIGHT_RANGE[0]) & (distances < HEIGHT_RANGE[1])
    is_moving = (ranges[position_columns] > MIN_ANGLE_RANGE).sum() > 1
    is_moving &= ranges[rotation_columns[up_channel]] > 0
    has_path = (
        np.ptp(relative_values[:, path_columns], axis=0).max() > MIN_PATH_FRACTION
    )
    if is_height.all(axis=0).any():
        return []
    if not (is_leg_length and is_root_near_ground and is_moving and has_path):
        return []
    height = float(np.median(rows[:, rotation_columns[up_channel]]))
    length = leg_length / rig.meters_per_unit
    message = f"{channels[rotation_columns[up_channel]]} of {root.name!r} is about "
    message += f"{plain_number(height)} in all frames, as high as the legs are long "
    message += f"({plain_number(length)}), and "
    message += f"{channels[position_columns[up_channel]]} is near 0: the "
    message += "columns of positions and rotations look exchanged"
    exchanged_columns = dict(
        zip(
            position_columns + rotation_columns,
            rotation_columns + position_columns,
            strict=True,
        )
    )
    names = " ".join(channels[exchanged_columns[i]] for i in range(6))
    hint = f"if so, write CHANNELS 6 {names}"
    return [Fault("BVH115", message, path, (root.line,), hint, Severity.WARNING)]


def channel_order_warning(
    header: BvhHeader,
    motion_in_order: Callable[[tuple[int, ...]], Motion],
    rig: Rig,
    path: str,
) -> list[Fault]:
    """Return a warning if feet stand still only in another order of angles (BVH117).

    Args:
        header: The header of the file.
        motion_in_order: Returns frames of the take with the three rotation channels of
            each joint permuted.
        rig: The skeleton.
        path: The file.
    """
    feet, names = find_feet(rig.names), _rotation_names(header)
    if not is_character(rig.names) or len(names) != 3:
        return []
    speeds: dict[tuple[int, ...], float] = {}
    for order in permutations(range(3)):
        motion = motion_in_order(order)
        if motion.frames < MIN_ORDER_FRAMES:
            return []
        speeds[order] = _foot_speed(motion.world(rig).positions, feet)
        # The first is the order as read.
        if speeds[0, 1, 2] < MIN_SLIDING_SPEED:
            return []
    speed_as_read = speeds[0, 1, 2]
    order = min(speeds, key=speeds.__getitem__)
    if speeds[order] > MAX_SPEED_RATIO * speed_as_read:
        return []
    channels = " ".join(names[i] for i in order)
    message = f"no foot stands still: the slower one moves at {speed_as_read:.0%} of "
    message += f"the mean speed of joints, but at {speeds[order]:.1%} if the angles of "
    message += f"CHANNELS {' '.join(names)} are those of {channels}"
    line = header.joints[0].line
    hint = f"if so, write {channels} in the CHANNELS of the root, and exchange those "
    hint += "of the other joints likewise"
    return [Fault("BVH117", message, path, (line,), hint, Severity.WARNING)]


def _rotation_names(header: BvhHeader) -> list[str]:
    """Return the rotation channels of the root."""
    return [c for c in header.joints[0].channels or () if c.endswith("rotation")]


def _foot_speed(positions: FloatArray, feet: IntArray) -> float:
    """Return the speed of the slower foot, over the mean speed of the joints.

    In a fifth of the frames it is slower. 0 for bodies that stand still.
    """
    speeds = np.linalg.norm(np.diff(positions, axis=0), axis=-1)
    foot_speed = np.percentile(speeds[:, feet].min(axis=1), 20)
    return float(foot_speed / speeds.mean()) if foot_speed > 0 else 0.0


def opposite_offset_warnings(header: BvhHeader, rig: Rig, path: str) -> list[Fault]:
    """Return warnings about OFFSETs with another sign than on the other side (BVH116).

    Most pairs of left and right joints must be mirror images.
    """
    size = rest_size(rig)
    side_pairs = pair_sides(rig.names, rig.parents)
    pairs = [(left, int(side_pairs.partners[left])) for left in side_pairs.left]
    offsets = rig.rest_translations
    lengths = np.linalg.norm(offsets, axis=1)
    pairs = [
        pair for pair in pairs if min(lengths[list(pair)]) > MIN_OFFSET_FRACTION * size
    ]
    if len(rig.joints) < MIN_BODY_JOINTS or len(pairs) <= MIN_MIRRORED_PAIRS:
        return []
    left, right = (np.array(side) for side in zip(*pairs, strict=True))
    tolerances = MAX_DIFFERENCE * lengths[right]
    for axis in range(3):
        signs = np.where(np.arange(3) == axis, -1.0, 1.0)
        mirrored_offsets = signs * offsets[left]
        is_mirrored = (
            np.abs(mirrored_offsets - offsets[right]).max(axis=1) <= tolerances
        )
        count = int(is_mirrored.sum())
        is_lateral = 2.0 * np.abs(mirrored_offsets[:, axis]) > lengths[left]
        if (is_mirrored & is_lateral).sum() < MIN_LATERAL_PAIRS:
            continue
        if count >= max(MIN_MIRRORED_PAIRS, MIN_MIRRORED_FRACTION * len(pairs)):
            break
    else:
        return []
    differences = np.abs(np.abs(mirrored_offsets) - np.abs(offsets[right])).max(axis=1)
    faults = []
    for i in np.flatnonzero(~is_mirrored & (differences <= tolerances)).tolist():
        wrong_axis = int(np.abs(offsets[right[i]]).argmax())
        if mirrored_offsets[i, wrong_axis] * offsets[right[i], wrong_axis] > 0:
            continue
        joint = _folded_joint(rig, int(left[i]), int(right[i]))
        opposite_joint = int(right[i]) if joint == left[i] else int(left[i])
        texts = [
            vector_text((offsets[j] / rig.meters_per_unit).tolist(), 6)
            for j in (joint, opposite_joint)
        ]
        message = f"the OFFSET of {rig.names[joint]!r} is {texts[0]}, but that of "
        message += f"{rig.names[opposite_joint]!r} is {texts[1]}: {'XYZ'[wrong_axis]} "
        message += "has the wrong sign "
        message += f"on one side, as {count} of {len(pairs)} pairs of left and right "
        message += "joints are mirror images"
        hint = f"negate {'XYZ'[wrong_axis]}, likely that of {rig.names[joint]!r}"
        line = header.joints[joint].line
        faults.append(Fault("BVH116", message, path, (line,), hint, Severity.WARNING))
    return faults


def _folded_joint(rig: Rig, left: int, right: int) -> int:
    """Return the joint whose offset points more against those of its child joints."""
    offsets = rig.rest_translations
    directions = []
    for joint in (left, right):
        children = np.flatnonzero(rig.parents == joint)
        parent = int(rig.parents[joint])
        chain_offset = offsets[children].sum(axis=0)
        if parent >= 0:
            chain_offset = chain_offset + offsets[parent]
        directions.append(float(offsets[joint] @ chain_offset))
    return left if directions[0] < directions[1] else right
