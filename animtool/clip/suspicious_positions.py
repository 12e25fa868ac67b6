"""Warnings about clips whose translations have another origin or up axis."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from fractions import Fraction

import numpy as np

from animtool.clip.channels import ClipChannel, ClipUnits
from animtool.core.array_types import FloatArray
from animtool.core.quantities import length_text
from animtool.core.record import dataclass
from animtool.core.units import UpAxis
from animtool.documents.document import Document
from animtool.rig.joints import KEYED_PARTS, split_part
from animtool.rig.kinematics import rest_size
from animtool.rig.skeleton import Rig
from animtool.rig.suspicious_shape import (
    FOOT_NAMES,
    HINGE_NAMES,
    rest_pose_without_kernels,
)

# Joints closer to their parent at rest than this fraction of the rig's size are at it.
MIN_REST_RATIO = 0.05
# Largest distances from the rest position, in rest lengths: of keys that include the
# rest offset, on average and each, and of a key that is at the rest position.
NEAR_REST_RATIO, ABOUT_REST_RATIO, AT_REST_RATIO = 0.15, 0.5, 0.01
# With fewer keys, a walk, whose speed is even, cannot be distinguished from a fall.
MIN_WALK_KEYS = 3
# A walk that goes down because of another up axis: largest motion to the side, and
# largest deviation from an even speed [1].
MAX_SIDEWAYS_RATIO, MAX_UNEVENNESS = 0.1, 0.15
# Positions from software with the other up axis, in the axes of the rig.
_CONVERTED_AXES = {UpAxis.Y: "[x, z, -y]", UpAxis.Z: "[x, -z, y]"}


@dataclass(frozen=True, slots=True)
class CheckedClip:
    """A clip file whose numbers are compared with its rig."""

    document: Document  # the file
    channels: Sequence[ClipChannel]
    fps: Fraction  # frames a second
    units: ClipUnits  # units of its numbers
    rig: Rig

    def joint_channels(self, *parts: str) -> Iterator[tuple[int, ClipChannel, str]]:
        """Yield index, channel and joint name of the channels of some joint parts."""
        for i, channel in enumerate(self.channels):
            group, _, target = channel.target.partition("/")
            name, part = split_part(target, KEYED_PARTS)
            if group == "joint" and part in parts:
                yield i, channel, name

    def root_translations(self) -> Iterator[tuple[int, ClipChannel]]:
        """Yield index and channel of the translations of roots."""
        roots = {self.rig.names[j] for j in self.rig.roots}
        parts = "translation", "local_translation"
        for i, channel, name in self.joint_channels(*parts):
            if name in roots:
                yield i, channel

    def warn(self, code: str, channel: int, key: int, message: str, hint: str) -> None:
        """Add a warning at the value of a key."""
        location = ("channels", channel, "keys", key, "v")
        self.document.warn(code, location, message, hint)


def warn_of_positions(clip: CheckedClip) -> None:
    """Warn of translations that seem to have another origin or other axes."""
    _warn_of_rest(clip)
    if any(HINGE_NAMES.search(n) or FOOT_NAMES.search(n) for n in clip.rig.names):
        _warn_of_offsets(clip)
        _warn_of_up_axis(clip)


def _warn_of_rest(clip: CheckedClip) -> None:
    """Warn of translations that already include the rest offset (CLIP112)."""
    rig, rig_size = clip.rig, rest_size(clip.rig)
    for i, channel, name in clip.joint_channels("translation"):
        joint = rig.joints[rig.index(name)]
        rest = np.array(joint.translation)
        is_at_parent = float(np.linalg.norm(rest)) <= MIN_REST_RATIO * rig_size
        if is_at_parent or not _is_near_rest_position(channel.values, rest):
            continue
        position_text, sum_text = (
            length_text(float(np.linalg.norm(position)))
            for position in (rest, rest + channel.values[0])
        )
        origin = "the origin" if joint.parent < 0 else "its parent"
        message = (
            f"{channel.target!r} is keyed near the joint's rest position, "
            f"{position_text} from {origin}; keys are added to the rest position, so "
            f"the joint is at {sum_text}"
        )
        hint = "subtract the rest position from the keys, or key "
        hint += f"joint/{name}.local_translation"
        clip.warn("CLIP112", i, 0, message, hint)
        return


def _is_near_rest_position(values: FloatArray, rest: FloatArray) -> bool:
    """Return whether translations stay near a rest position."""
    rest_length = float(np.linalg.norm(rest))
    if (np.linalg.norm(values - rest, axis=1) <= AT_REST_RATIO * rest_length).all():
        return True
    fraction_along_rest = values @ rest / rest_length**2
    is_near = abs(float(fraction_along_rest.mean()) - 1) <= NEAR_REST_RATIO
    is_near &= bool((abs(fraction_along_rest - 1) <= ABOUT_REST_RATIO).all())
    return is_near and len(values) > 1


def _warn_of_offsets(clip: CheckedClip) -> None:
    """Warn of offsets from rest that are keyed as local translations (CLIP122)."""
    rig, rig_size = clip.rig, rest_size(clip.rig)
    for i, channel, name in clip.joint_channels("local_translation"):
        joint = rig.joints[rig.index(name)]
        rest = np.array(joint.translation)
        rest_length = float(np.linalg.norm(rest))
        if rest_length <= MIN_REST_RATIO * rig_size:
            continue
        fraction_along_rest = channel.values @ rest / rest_length**2
        offset_lengths = np.linalg.norm(channel.values, axis=1)
        nearest_key = int(offset_lengths.argmin())
        # A body that lies on the ground is near 0, but hardly at it.
        is_near = abs(float(fraction_along_rest.mean())) <= NEAR_REST_RATIO
        is_near &= max(fraction_along_rest) <= ABOUT_REST_RATIO
        is_at_zero = offset_lengths[nearest_key] <= AT_REST_RATIO * rest_length
        if joint.parent < 0:
            is_at_zero |= bool(fraction_along_rest.mean() < 0)
        else:
            is_at_zero |= bool(offset_lengths.max() <= NEAR_REST_RATIO * rest_length)
        if not (is_at_zero and is_near):
            continue
        if joint.parent < 0:
            drop_height = float(rest @ rig.up.vector)
            if drop_height <= MIN_REST_RATIO * rig_size:
                continue
            result = f"the joint is {length_text(drop_height)} lower than at rest"
        else:
            result = f"the joint is at {rig.names[joint.parent]!r}"
        numbers = ", ".join(f"{number:.4g}" for number in rest / clip.units.length)
        message = f"{channel.target!r} is keyed near [0, 0, 0], but the rest position "
        message += f"is [{numbers}]: {result}"
        hint = f"for moves from rest, key joint/{name}.translation"
        clip.warn("CLIP122", i, nearest_key, message, hint)
        return


def _warn_of_up_axis(clip: CheckedClip) -> None:
    """Warn of a root that walks into the ground (CLIP123)."""
    rig, up = clip.rig, clip.rig.up.vector
    lowest_rest_height = float((rest_pose_without_kernels(rig)[0] @ up).min())
    for i, channel in clip.root_translations():
        name, part = split_part(channel.target.removeprefix("joint/"), KEYED_PARTS)
        rest_position = np.array(rig.joints[rig.index(name)].translation)
        root_offsets = channel.values - (
            rest_position if part == "local_translation" else 0.0
        )
        if len(root_offsets) < MIN_WALK_KEYS:
            continue
        heights = root_offsets @ up
        fall_height = float(heights[0] - heights[-1])
        end_height = float(rest_position @ up + heights[-1])
        if fall_height < rest_size(rig) / 2 or end_height >= lowest_rest_height:
            continue
        offsets = root_offsets - root_offsets[0] - np.outer(heights - heights[0], up)
        sideways_distances = np.linalg.norm(offsets, axis=1)
        times = channel.times
        even_heights = np.interp(times, times[[0, -1]], heights[[0, -1]])
        unevenness = np.abs(heights - even_heights).max()
        if (
            sideways_distances.max() > MAX_SIDEWAYS_RATIO * fall_height
            or unevenness > MAX_UNEVENNESS * fall_height
        ):
            continue
        message = (
            f"{channel.target!r} moves {length_text(fall_height)} down along {rig.up} "
            f"and at most {length_text(float(sideways_distances.max()))} to the side: "
            f"the lowest joint ends at "
            f"{length_text(lowest_rest_height + float(heights[-1]))} on {rig.up}"
        )
        other_axis = UpAxis.Z if rig.up is UpAxis.Y else UpAxis.Y
        hint = f"for {other_axis}-up keys write [x, y, z] as {_CONVERTED_AXES[rig.up]}"
        clip.warn("CLIP123", i, len(root_offsets) - 1, message, hint)
        return
