"""Finds the axis along which a body stands, for files that do not state the up axis.

It is inferred from limbs, trunk and head, independent of names, and from motion.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from animtool.core.arguments import ArgumentNamer, argument
from animtool.core.array_types import FloatArray
from animtool.core.errors import Fault, Severity, warning
from animtool.core.quantities import length_text
from animtool.core.rates import rate_warning
from animtool.core.readers import reader_of
from animtool.core.record import dataclass
from animtool.core.units import LengthUnit, UpAxis
from animtool.motion.motion import Motion
from animtool.motion.quaternion_order import order_warning
from animtool.motion.take import TakeStream
from animtool.retarget.implausible_motion import (
    CAPTURE_FORMATS,
    GroundCheck,
    fast_motion_warning,
)
from animtool.retarget.root_position import root_warning
from animtool.retarget.swapped_sides import swapped_sides_warning
from animtool.rig.body_size import fitting_unit, size_warning_texts
from animtool.rig.kinematics import forward_kinematics, rest_size, rest_world
from animtool.rig.skeleton import MAX_RIG_SIZE, Rig

# Smallest size of what a user chose a unit for: of a prop, and of many joints [m].
MIN_SIZES, MIN_CHARACTER_JOINTS = (0.01, 0.05), 8
# Formats that state their unit, as details of a stream name them.
SIZED_FORMATS = frozenset({"USD", "glTF", "FBX"})
# How a file states its up axis.
UP_AXIS_HINTS = {"USD": 'set upAxis = "{}"', "clip": "write up: {} in the rig"}
# Sizes of people [m].
PERSON_HEIGHTS = (0.5, 3.0)
# Minimum cosine to an axis for a body that stands along it [1].
MIN_STANDING_COSINE = 0.8
# Minimum fraction of standing frames of a body that stands throughout [1].
MIN_STANDING_FRACTION = 0.9
# Fraction of standing frames below which it stands by chance [1].
MAX_CHANCE_FRACTION = 0.1
# Minimum cosine between trunk and feet-to-hips direction of an upright body [1].
MIN_UPRIGHT_COSINE = 0.5
# Minimum mean cosine of a trunk to an axis, and of legs across it [1].
MIN_TRUNK_COSINE = 0.6
# The lowest point of a lying body varies by less than this fraction of its length [1].
LYING_VARIATION = 0.06
# Minimum cosine between arms and legs of a four-legged stance [1].
MIN_FOURS_COSINE = 0.8
# On the ground, the lowest joint is at most this far from 0, relative to height [1].
MAX_GROUND_DISTANCE = 0.08
# A body on level ground has no joint farther below 0, relative to the height [1].
MAX_DEPTH_BELOW_GROUND = 0.02
# Minimum fraction of frames on the ground; the others allow for jumps [1].
MIN_GROUND_FRACTION = 0.6
# A walking body travels at least this far over the ground, and at most this far
# vertically, relative to its height [1].
MIN_TRAVEL, MAX_VERTICAL_TRAVEL = 0.6, 0.25
# Number of sampled frames: at first, and of a long take.
FIRST_SAMPLE_COUNT, MAX_SAMPLE_COUNT = 3, 2000


@dataclass(frozen=True, slots=True)
class Stance:
    """The axis along which a body stands in a take, and how often.

    Attributes:
        axis: The axis along which it stands, if that is not the up axis.
        fraction: Fraction of the frames in which it stands along that axis.
        is_upside_down: Whether the body is upside down in nearly all frames.
    """

    axis: UpAxis | None = None
    fraction: float = 0.0
    is_upside_down: bool = False


def standing_directions(roles: Sequence[str], positions: FloatArray) -> FloatArray:
    """Return the unit direction from feet to head in each frame ``(F, 3)``.

    It is 0 where the body does not stand: crawling, sitting on its heels, or no body. A
    four-legged body points away from its feet, whatever the direction of its trunk.
    ``roles`` ``(J,)`` and ``positions`` ``(F, J, 3)`` [m] are those of the joints.
    """
    no_direction = np.zeros((len(positions), 3))
    trunk = _trunk_vectors(roles, positions)
    if trunk is None:
        return no_direction
    legs, arms = (_limb_vectors(roles, positions, *limb_roles) for limb_roles in _LIMBS)
    if legs is None:
        return trunk
    uprightness = (trunk * -legs).sum(axis=1)
    is_upright = uprightness[:, None] > MIN_UPRIGHT_COSINE
    directions = np.where(is_upright, _unit_vectors(trunk - legs), no_direction)
    if arms is None:
        return directions
    down_directions = _unit_vectors(legs + arms)
    is_on_fours = (legs * arms).sum(axis=1) > MIN_FOURS_COSINE
    is_on_fours &= np.abs((trunk * down_directions).sum(axis=1)) < MIN_UPRIGHT_COSINE
    return np.where(is_on_fours[:, None], -down_directions, directions)


_LIMBS = (("thigh", "foot"), ("upper_arm", "hand"))


def _trunk_vectors(roles: Sequence[str], positions: FloatArray) -> FloatArray | None:
    """Return the vector from hips to head ``(F, 3)``; None if either is unknown."""
    if "hips" not in roles or "head" not in roles:
        return None
    hips, head = roles.index("hips"), roles.index("head")
    thighs = [roles.index(f"thigh_{s}") for s in "lr" if f"thigh_{s}" in roles]
    hips_middle = positions[:, thighs if len(thighs) == 2 else [hips]].mean(axis=1)
    return _unit_vectors(positions[:, head] - hips_middle)


def _limb_vectors(
    roles: Sequence[str], positions: FloatArray, first_role: str, last_role: str
) -> FloatArray | None:
    """Return the mean vector along a pair of limbs ``(F, 3)``; None if unknown."""
    role_pairs = [(f"{first_role}_{side}", f"{last_role}_{side}") for side in "lr"]
    if not all({*role_pair} <= {*roles} for role_pair in role_pairs):
        return None
    vectors = [
        _unit_vectors(positions[:, roles.index(b)] - positions[:, roles.index(a)])
        for a, b in role_pairs
    ]
    return _unit_vectors(vectors[0] + vectors[1])


def _unit_vectors(vectors: FloatArray) -> FloatArray:
    """Scale vectors ``(F, 3)`` to length 1; zero vectors stay zero."""
    sizes = np.linalg.norm(vectors, axis=1)
    return np.asarray(vectors / np.maximum(sizes, 1e-12)[:, None])


def measure_stance(
    roles: Sequence[str], positions: FloatArray, up: UpAxis, rest: FloatArray | None
) -> Stance:
    """Return the axis along which a body stands in a take, and how often.

    It stands along another axis if it does in nearly all frames, or from the first
    frame on and at least as often as along the up axis. Rest pose, motion or ground
    contact must confirm that; otherwise the body lies down.

    Args:
        roles: Joint roles ``(J,)``.
        positions: Joint positions ``(F, J, 3)`` [m].
        up: The assumed up axis.
        rest: Joint positions at rest ``(J, 3)`` [m]; None if unknown.
    """
    directions, other_axis = standing_directions(roles, positions), _other_axis(up)
    is_along_other = directions @ np.array(other_axis.vector) > MIN_STANDING_COSINE
    cosines = directions @ np.array(up.vector)
    other_fraction = float(is_along_other.mean())
    upright_fraction = float((cosines > MIN_STANDING_COSINE).mean())
    inverted_fraction = float((cosines < -MIN_STANDING_COSINE).mean())
    if inverted_fraction >= MIN_STANDING_FRACTION:
        return Stance(fraction=inverted_fraction, is_upside_down=True)
    rest_axis = np.zeros(3)
    if rest is not None:
        rest_axis = standing_directions(roles, rest[None])[0]
    is_frequent = other_fraction >= max(upright_fraction, MAX_CHANCE_FRACTION)
    stands_throughout = other_fraction >= MIN_STANDING_FRACTION
    if rest_axis @ np.array(other_axis.vector) > MIN_STANDING_COSINE:
        is_confirmed = (
            (is_frequent and (is_along_other[0] or is_along_other[-1]))
            or stands_throughout
            or _is_trunk_along(roles, positions, other_axis, up)
        )
        return Stance(other_axis, other_fraction) if is_confirmed else Stance()
    if not (stands_throughout or (is_along_other[0] and is_frequent)):
        return Stance()
    standing_positions = positions[is_along_other]
    stands_along_other = (
        _travels_across(positions, other_axis, up)
        or _has_feet_on_ground(standing_positions, other_axis, up)
        or (stands_throughout and not _keeps_level(standing_positions, up))
    )
    return Stance(other_axis, other_fraction) if stands_along_other else Stance()


def _is_trunk_along(
    roles: Sequence[str], positions: FloatArray, axis: UpAxis, up: UpAxis
) -> bool:
    """Return whether the trunk is along an axis on average, with no legs below it.

    This covers takes that never stand, such as a leap.
    """
    trunk = _trunk_vectors(roles, positions)
    legs = _limb_vectors(roles, positions, *_LIMBS[0])
    if trunk is None:
        return False
    mean_trunk = trunk.mean(axis=0)
    axis_cosine, up_cosine = (mean_trunk @ np.array(a.vector) for a in (axis, up))
    legs_along_up = 0.0 if legs is None else legs.mean(axis=0) @ np.array(up.vector)
    return bool(
        axis_cosine > MIN_TRUNK_COSINE
        and up_cosine < MIN_UPRIGHT_COSINE
        and legs_along_up > -MIN_TRUNK_COSINE
    )


def _keeps_level(positions: FloatArray, up: UpAxis) -> bool:
    """Return whether the lowest joint keeps its height, as for a lying body."""
    body_size = float(np.median(np.ptp(positions, axis=1).max(axis=1)))
    heights = (positions @ np.array(up.vector)).min(axis=1)
    low, high = (
        np.quantile(heights, q) for q in (MAX_CHANCE_FRACTION, 1 - MAX_CHANCE_FRACTION)
    )
    return float(high - low) < LYING_VARIATION * body_size


def _has_feet_on_ground(positions: FloatArray, axis: UpAxis, up: UpAxis) -> bool:
    """Return whether feet are at 0 along an axis, but the body is not at 0 along up."""
    body_size = float(np.median(np.ptp(positions, axis=1).max(axis=1)))
    axis_heights = (positions @ np.array(axis.vector)).min(axis=1) / body_size
    heights = (positions @ np.array(up.vector)).min(axis=1) / body_size
    ground_fraction = float((np.abs(axis_heights) < MAX_GROUND_DISTANCE).mean())
    # A lying body has nothing below the ground.
    is_level = (heights > -MAX_DEPTH_BELOW_GROUND) & (heights < MAX_GROUND_DISTANCE)
    is_on_ground = ground_fraction >= MIN_GROUND_FRACTION
    return is_on_ground and float(is_level.mean()) < MIN_GROUND_FRACTION


def _travels_across(positions: FloatArray, axis: UpAxis, up: UpAxis) -> bool:
    """Return whether a body travels across an axis as a walking one does."""
    mean_positions = positions.mean(axis=1)
    body_size = float(np.median(np.ptp(positions, axis=1).max(axis=1)))
    extents = np.ptp(mean_positions, axis=0)
    travel_along_axis = float(extents @ np.array(axis.vector))
    # A lying body does not travel along the assumed up axis.
    travel_along_up = float(extents @ np.array(up.vector))
    is_level = travel_along_axis < MAX_VERTICAL_TRAVEL * body_size
    return is_level and travel_along_up > MIN_TRAVEL * body_size


def find_standing_axis(rig: Rig, motion: Motion, roles: Sequence[str]) -> UpAxis | None:
    """Return the axis that a body stands along, if it is not the rig's up axis.

    BVH files do not state the up axis. ``roles`` ``(J,)`` are those of the rig's
    joints.
    """
    return _standing_axis(rig, motion, roles) if _other_is_longer(rig, motion) else None


def _standing_axis(
    rig: Rig, motion: Motion, roles: Sequence[str], *, is_inverted: bool = False
) -> UpAxis | None:
    """Return the axis of `find_standing_axis`, even if the body is taller along up.

    With ``is_inverted``, the body stands with the head at the negative end of the axis,
    as in a take that was turned from the wrong axis.
    """
    frame_step = max(motion.frames // MAX_SAMPLE_COUNT, 1)
    frames = motion.select(slice(0, motion.frames, frame_step))
    world = forward_kinematics(
        rig, frames.translations.dense(), frames.rotations.dense()
    )
    positions, rest = world.positions, rest_world(rig).positions[0]
    if is_inverted:
        mirror = 1.0 - 2.0 * np.array(_other_axis(rig.up).vector)
        positions, rest = positions * mirror, rest * mirror
    return measure_stance(roles, positions, rig.up, rest).axis


def _other_is_longer(rig: Rig, motion: Motion) -> bool:
    """Return whether any sampled pose is longer along the other axis than along up."""
    if not rig.joints or not motion.frames:
        return False
    sampled_frames = np.linspace(0, motion.frames - 1, FIRST_SAMPLE_COUNT).astype(int)
    up_vector = np.array(rig.up.vector)
    other_vector = np.array(_other_axis(rig.up).vector)
    for frame in sorted(set(sampled_frames.tolist())):
        single_frame = motion.select(slice(frame, frame + 1))
        pose = forward_kinematics(
            rig, single_frame.translations.dense(), single_frame.rotations.dense()
        )
        extents = np.ptp(pose.positions[0], axis=0)
        if extents @ other_vector > extents @ up_vector:
            return True
    return False


def lying_body_notices(
    path: Path,
    rig: Rig,
    motion: Motion,
    severity: Severity = Severity.NOTE,
    up: UpAxis | None = None,
    file_format: str = "",
) -> list[Fault]:
    """Return a notice if a body stands along another axis than up (MOT214).

    ``up`` is the axis that the user chose. ``file_format`` may state its axis.
    """
    # An axis that the user chose is always checked: four-legged bodies are long.
    if up is None and not _other_is_longer(rig, motion):
        return []
    from animtool.retarget.anatomy import find_anatomy

    roles, sign = find_anatomy(rig).roles, ""
    axis = _standing_axis(rig, motion, roles)
    suggested_axis = axis
    if axis is None and up is not None:
        axis = _standing_axis(rig, motion, roles, is_inverted=True)
        suggested_axis, sign = _other_axis(up), "-"
    if axis is None:
        return []
    message = f"the body stands along {sign}{axis}, but the up axis is {rig.up}"
    if up is rig.up:
        stated_option = argument("source.up", up)
        message = f"the body stands along {sign}{axis}, but {stated_option} was given"
    if up not in {None, rig.up}:
        chosen_option = argument("source.up", up)
        message = f"read with {chosen_option}, the body stands along {sign}{axis}, "
        message += f"not {rig.up}"
    hint = UP_AXIS_HINTS.get(file_format, "").format(suggested_axis)
    hint = hint or f"read it with {argument('source.up', suggested_axis)}"
    return [Fault("MOT214", message, str(path), (), hint, severity)]


def with_source_warnings(
    path: Path,
    stream: TakeStream,
    up: UpAxis | None = None,
    unit: LengthUnit | None = None,
    *,
    namer: ArgumentNamer | None = None,
    reported_codes: Collection[str] = (),
) -> TakeStream:
    """Return a stream with warnings about its rate, size, up axis and ground.

    ``unit`` and ``up`` are those that the user chose. With a ``namer``, all notices of
    the stream name arguments by it. Warnings about the rate are left out if the
    reader's notices or ``reported_codes`` contain one.

    MOT209 is determined from all blocks, and MOT214 from the first: a warning if the
    user chose the axis ``up``, the file states it or markers were solved, and a note
    for BVH, which states no axis.
    """
    rate = stream.fps / stream.step
    known_codes = {notice.code for notice in stream.notices}
    reader = reader_of(path)
    has_rate = reader is not None and "fps" in reader.options
    rate_argument = "source.fps" if has_rate else None
    rate_warnings = rate_warning(rate, rate_argument)

    located_warnings = [notice.in_file(path) for notice in rate_warnings]
    if "TAKE009" in reported_codes:
        stream.notices[:] = [n for n in stream.notices if n not in located_warnings]

    def add_notices(notices: Iterable[Fault]) -> None:
        stream.notices.extend(
            notice if namer is None else notice.with_argument_names(namer)
            for notice in notices
        )

    if namer is not None:
        stream.notices[:] = [
            notice.with_argument_names(namer) for notice in stream.notices
        ]
    if {*known_codes, *reported_codes}.isdisjoint({"BVH105", "TAKE009"}):
        add_notices(located_warnings)
    file_format = stream.details.get("format")
    if unit is not None and "RIG217" not in known_codes and file_format != "markers":
        add_notices(_size_warning(path, stream.rig, unit))
    is_note = up is None and file_format == "BVH"
    severity = Severity.NOTE if is_note else Severity.WARNING

    ground_check = GroundCheck(stream)

    def blocks() -> Iterator[Motion]:
        """Yield the blocks; check the first for its up axis, and all for the ground."""
        for i, block in enumerate(stream.blocks):
            ground_check.add(block)
            if i == 0 and file_format in CAPTURE_FORMATS:
                warnings = fast_motion_warning(stream.rig, block, rate, rate_argument)
                add_notices(fault.in_file(path) for fault in warnings)
            if i == 0 and file_format not in {"BVH", "markers"}:
                add_notices(order_warning(stream.rig, block, str(path)))
            if i == 0 and unit is None and file_format in SIZED_FORMATS:
                codes = {notice.code for notice in stream.notices}
                if codes.isdisjoint({"USD126", "RIG217"}):
                    unit_notices = unit_warnings(stream.rig, file_format)
                    add_notices(replace(n, path=str(path)) for n in unit_notices)
            is_swapped = has_swapped_channels(stream.notices)
            if i == 0 and not is_swapped:
                settings = (severity, up, str(file_format))
                add_notices(lying_body_notices(path, stream.rig, block, *settings))
            if i == 0 and file_format != "markers" and not is_swapped:
                known_codes = {notice.code for notice in stream.notices}
                for problem in (
                    root_warning(stream.rig, block, float(1 / rate)),
                    swapped_sides_warning(stream.rig, block, str(file_format)),
                ):
                    if problem is not None and problem.code not in known_codes:
                        add_notices([problem.in_file(path)])
            yield block
        reported = [*reported_codes, *(notice.code for notice in stream.notices)]
        add_notices(fault.in_file(path) for fault in ground_check.notices(reported))

    return replace(stream, blocks=blocks())


def has_swapped_channels(notices: Iterable[Fault]) -> bool:
    """Return whether channels look swapped, so that no orientation can be checked."""
    return any(notice.code in {"BVH115", "BVH117"} for notice in notices)


def _size_warning(path: Path, rig: Rig, unit: LengthUnit) -> list[Fault]:
    """Return a warning if the chosen unit gives an implausible size (RIG217)."""
    size = rest_size(rig)
    min_size = MIN_SIZES[len(rig.joints) >= MIN_CHARACTER_JOINTS]
    if not size or min_size <= size <= MAX_RIG_SIZE:
        return []
    message = f"the skeleton measures {length_text(size)}, with lengths in {unit}"
    min_height, max_height = PERSON_HEIGHTS
    fitting_units = [
        str(fitting_unit)
        for fitting_unit in LengthUnit
        if min_height <= size / unit.meters * fitting_unit.meters <= max_height
    ]
    hint = f"remove {argument('source.unit')} if the file states its unit"
    if fitting_units:
        hint = f"use {argument('source.unit', fitting_units[0])}, or {hint}"
    return [Fault("RIG217", message, str(path), (), hint, Severity.WARNING)]


def unit_warnings(rig: Rig, file_format: object) -> list[Fault]:
    """Return a warning about a character that fits another unit (MOT213).

    Only formats of `SIZED_FORMATS` are checked.
    """
    size = rest_size(rig)
    better_unit = fitting_unit(rig.names, size, rig.meters_per_unit)
    if better_unit is None or file_format not in SIZED_FORMATS:
        return []
    message_and_hint = size_warning_texts(
        size, rig.meters_per_unit, better_unit, str(file_format)
    )
    return [warning("MOT213", *message_and_hint)]


def _other_axis(up: UpAxis) -> UpAxis:
    """Return Z for Y, and Y for Z."""
    return UpAxis.Z if up is UpAxis.Y else UpAxis.Y
