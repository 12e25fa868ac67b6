"""Detects implausible rates, rotations, root channels and offsets of a BVH file."""

from __future__ import annotations

from fractions import Fraction

import numpy as np

from animtool.core.arguments import argument
from animtool.core.array_types import FloatArray, IntArray
from animtool.core.errors import Fault, Severity
from animtool.core.quantities import length_text, plain_number, vector_text
from animtool.core.rates import RateKind, rate_label, rate_warning
from animtool.formats.bvh.hierarchy import BvhHeader
from animtool.rig.kinematics import rest_size, rest_world
from animtool.rig.sides import pair_sides
from animtool.rig.skeleton import Rig

# Skeletons with fewer joints may be props; their size and rotations are not judged.
MIN_BODY_JOINTS = 8
# Relative tolerance of equal rates; film transferred to video is 0.1 % slower.
RATE_TOLERANCE = Fraction(2, 1000)
# A body travels if its root moves farther than this fraction of its size; its largest
# rotation then looks like radians in this range. Smaller changes are noise [deg].
MIN_TRAVEL_FRACTION, MIN_RADIANS, MAX_RADIANS, MIN_CHANGE = 0.5, 0.7, 6.4, 0.1
# A body that does not travel moves if this fraction of its rotation channels changes;
# most channels are those of fingers.
MIN_MOVING_FRACTION = 0.1


def stated_rate_note(
    header: BvhHeader, stated_rate: Fraction, path: str
) -> list[Fault]:
    """Return a note if the option's rate differs from a plausible Frame Time."""
    file_rate, frame_count = header.rate_choice.fps, header.declared_frame_count
    is_same_rate = (
        abs(stated_rate - file_rate) <= RATE_TOLERANCE * file_rate
        or stated_rate in header.rate_choice.ambiguous_rates
    )
    if is_same_rate or header.rate_choice.kind is RateKind.PRINTED:
        return []
    if rate_warning(file_rate) or rate_warning(stated_rate):
        return []
    durations = (float(frame_count / fps) for fps in (stated_rate, file_rate))
    message = f"Frame Time {header.frame_time} is {rate_label(file_rate)}, not "
    message += f"{argument('source.fps', f'{float(stated_rate):g}')}: {frame_count} "
    message += "frames last {:.3g} s instead of {:.3g} s".format(*durations)
    hint = f"leave it out to keep {rate_label(file_rate)}; to resample the motion, use "
    hint += argument("fps")
    return [Fault("TAKE011", message, path, (), hint, Severity.NOTE)]


def unused_positions_note(header: BvhHeader, path: str) -> list[Fault]:
    """Return a note if no joint below a root has position channels (BVH113)."""
    child_joints = [joint for joint in header.joints if joint.parent >= 0]
    if any(c.endswith("position") for j in child_joints for c in j.channels or ()):
        return []
    message = f"{argument('source.positions', 'offsets')} has no effect: only roots "
    message += "have position channels"
    return [Fault("BVH113", message, path, (), "remove it", Severity.NOTE)]


class ChannelRanges:
    """Smallest and largest rotation channels and root positions of a file."""

    def __init__(self, columns: IntArray) -> None:
        self.columns = columns
        self.min_values = np.full(len(columns) + 3, np.inf)
        self.max_values = -self.min_values

    def add(self, rows: FloatArray, root: FloatArray) -> None:
        """Extend the ranges to include rows of channels and the root positions.

        ``root`` is ``(F, 3)``, or ``(F, 0)`` without position channels.
        """
        rotations = rows[:, self.columns]
        for values, columns in ((rotations, slice(0, -3)), (root, slice(-3, None))):
            if values.shape[1]:
                self.min_values[columns] = np.minimum(
                    self.min_values[columns], values.min(axis=0)
                )
                self.max_values[columns] = np.maximum(
                    self.max_values[columns], values.max(axis=0)
                )

    @property
    def rotation_summary(self) -> tuple[float, int]:
        """Largest absolute rotation [file's angle], and number of changing channels."""
        low, high = self.min_values[:-3], self.max_values[:-3]
        largest = np.maximum(np.abs(low), np.abs(high)).max(initial=0.0)
        return float(largest), int((high - low > MIN_CHANGE).sum())

    @property
    def travel(self) -> float:
        """Diagonal of the bounding box of the path of the first joint [m]."""
        return float(np.linalg.norm(self.max_values[-3:] - self.min_values[-3:]))


def radians_warning(ranges: ChannelRanges, rig: Rig, path: str) -> list[Fault]:
    """Return a notice if the rotations of a body look like radians (BVH112).

    A warning for a body that travels, and a note for one that moves in place.
    """
    if len(rig.joints) < MIN_BODY_JOINTS or not np.isfinite(ranges.travel):
        return []
    max_angle, moving_channel_count = ranges.rotation_summary
    is_static = moving_channel_count < MIN_BODY_JOINTS
    if is_static or not MIN_RADIANS <= max_angle <= MAX_RADIANS:
        return []
    is_traveling = ranges.travel > MIN_TRAVEL_FRACTION * rest_size(rig)
    is_moving = moving_channel_count >= MIN_MOVING_FRACTION * len(ranges.columns)
    if not is_traveling and not (is_moving and max_angle <= np.pi):
        return []
    message = f"none of {moving_channel_count} rotation channels that change exceeds "
    message += f"{max_angle:.3g}: the body hardly moves, unless they are radians"
    if is_traveling:
        message = (
            f"the body travels {length_text(ranges.travel)}, but none of "
            f"{moving_channel_count} rotation channels that change exceeds "
            f"{max_angle:.3g}: the rotations look like radians"
        )
    hint = f"a BVH has degrees: {max_angle:.3g} rad is {np.degrees(max_angle):.3g}; "
    hint += "export degrees, or multiply the rotation channels by 57.2958"
    severity = Severity.WARNING if is_traveling else Severity.NOTE
    return [Fault("BVH112", message, path, (), hint, severity)]


# Height of the root of a body above its lowest joint at rest, over the body's size, and
# range of a height that equals it, over it [1].
MIN_LEG_FRACTION, HEIGHT_RANGE = 0.35, (0.75, 1.2)
# Maximum of the position channel of the up axis, over that height [1], and smallest
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
    positions = [i for i, name in enumerate(channels) if name.endswith("position")]
    rotations = [i for i, name in enumerate(channels) if name.endswith("rotation")]
    if len(rig.joints) < MIN_BODY_JOINTS or len(positions) != 3 or len(rotations) != 3:
        return []
    up = np.array(rig.up.vector, float)
    rest_heights = rest_world(rig).positions[0] @ up
    leg_length = float(rest_heights[0] - rest_heights.min())
    if leg_length <= MIN_LEG_FRACTION * rest_size(rig) or not len(rows):
        return []
    values = rows[:, : len(channels)] * rig.meters_per_unit / leg_length
    ranges = np.ptp(rows[:, : len(channels)], axis=0)
    # Rotation channels would hold the positions in the order of their axes.
    up_name = "XYZ"[int(up.argmax())]
    k = next(k for k, i in enumerate(positions) if channels[i][0] == up_name)
    heights = values[:, rotations[k]]
    path_columns = [i for i in rotations if i != rotations[k]]
    is_leg_length = HEIGHT_RANGE[0] < heights.min() <= heights.max() < HEIGHT_RANGE[1]
    is_root_near_ground = (
        np.abs(values[:, positions[k]]).max() < MAX_ROOT_HEIGHT_FRACTION
    )
    distances = np.abs(values[:, positions])
    is_height = (distances > HEIGHT_RANGE[0]) & (distances < HEIGHT_RANGE[1])
    is_moving = (ranges[positions] > MIN_ANGLE_RANGE).sum() > 1
    is_moving &= ranges[rotations[k]] > 0
    has_path = np.ptp(values[:, path_columns], axis=0).max() > MIN_PATH_FRACTION
    if is_height.all(axis=0).any():
        return []
    if not (is_leg_length and is_root_near_ground and is_moving and has_path):
        return []
    height = float(np.median(rows[:, rotations[k]]))
    length = leg_length / rig.meters_per_unit
    message = f"{channels[rotations[k]]} of {root.name!r} is about "
    message += f"{plain_number(height)} in all frames, as high as the legs are long "
    message += f"({plain_number(length)}), and {channels[positions[k]]} is near 0: the "
    message += "columns of positions and rotations look exchanged"
    swapped = dict(zip(positions + rotations, rotations + positions, strict=True))
    names = " ".join(channels[swapped[i]] for i in range(6))
    hint = f"if so, write CHANNELS 6 {names}"
    return [Fault("BVH115", message, path, (root.line,), hint, Severity.WARNING)]


def opposite_offset_warnings(header: BvhHeader, rig: Rig, path: str) -> list[Fault]:
    """Return warnings about OFFSETs with another sign than on the other side (BVH116).

    Most pairs of left and right joints must be mirror images.
    """
    size = rest_size(rig)
    partners = pair_sides(rig.names, rig.parents)
    pairs = [(left, int(partners.partners[left])) for left in partners.left]
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
        mirrored = signs * offsets[left]
        is_mirrored = np.abs(mirrored - offsets[right]).max(axis=1) <= tolerances
        count = int(is_mirrored.sum())
        is_lateral = 2.0 * np.abs(mirrored[:, axis]) > lengths[left]
        if (is_mirrored & is_lateral).sum() < MIN_LATERAL_PAIRS:
            continue
        if count >= max(MIN_MIRRORED_PAIRS, MIN_MIRRORED_FRACTION * len(pairs)):
            break
    else:
        return []
    differences = np.abs(np.abs(mirrored) - np.abs(offsets[right])).max(axis=1)
    faults = []
    for i in np.flatnonzero(~is_mirrored & (differences <= tolerances)).tolist():
        k = int(np.abs(offsets[right[i]]).argmax())
        if mirrored[i, k] * offsets[right[i], k] > 0:
            continue
        joint = _folded_joint(rig, int(left[i]), int(right[i]))
        other = int(right[i]) if joint == left[i] else int(left[i])
        texts = [
            vector_text((offsets[j] / rig.meters_per_unit).tolist(), 6)
            for j in (joint, other)
        ]
        message = f"the OFFSET of {rig.names[joint]!r} is {texts[0]}, but that of "
        message += f"{rig.names[other]!r} is {texts[1]}: {'XYZ'[k]} has the wrong sign "
        message += f"on one side, as {count} of {len(pairs)} pairs of left and right "
        message += "joints are mirror images"
        hint = f"negate {'XYZ'[k]}, likely that of {rig.names[joint]!r}"
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
