"""A BVH file as a stream of blocks of motion."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import numpy as np

from animtool import _kernels
from animtool.core.arguments import argument
from animtool.core.array_types import BoolArray, FloatArray, IntArray
from animtool.core.errors import Fault, Severity, counted, listed
from animtool.core.files.reading import open_input, unreadable_error
from animtool.core.files.signatures import expects_format
from animtool.core.names import numbered_names
from animtool.core.rates import FractionLike, rate_option
from animtool.core.units import LengthUnit, UpAxis
from animtool.formats.bvh.hierarchy import BvhHeader, BvhJoint, read_header
from animtool.formats.bvh.lines import HeaderLines, RowReader, RowSource
from animtool.maths.so3 import IDENTITY
from animtool.motion.motion import Channel, Motion
from animtool.motion.take import TakeStream
from animtool.rig.kinematics import rest_size
from animtool.rig.skeleton import Joint, JointType, Rig

# Plausible size at rest of any character, and of a person [m].
LIKELY_METERS = (0.3, 6.0)
PERSON_METERS = (1.0, 2.6)
# Skeletons with fewer joints may be props; their size is not judged.
MIN_JOINTS = 8
MAX_NAMED = 4
# Bones shorter than this fraction of their OFFSET have collapsed [1].
MIN_LENGTH_FRACTION = 1e-4


@expects_format("BVH001", "a BVH file")
def read_bvh(
    path: Path | str,
    *,
    unit: LengthUnit | None = None,
    up: UpAxis | None = None,
    fps: FractionLike | None = None,
    positions: str | None = None,
    progress: Callable[[float], None] | None = None,
) -> TakeStream:
    """Open a BVH file as a stream; rows are parsed as blocks are read.

    Position channels replace the OFFSET on their axes. Rotations multiply left to right
    in the order of the CHANNELS line, after the translation, wherever the position
    channels are listed. Values that are not finite are filled by interpolation, values
    beyond float32 are clamped, and notices report both.

    Args:
        path: The file.
        unit: Unit of its lengths; None is centimetres, with a note if the skeleton's
            size fits another unit better.
        up: Its up axis; None is Y. The file does not state it.
        fps: The actual frame rate, if ``Frame Time`` is wrong.
        positions: ``offsets`` keeps the OFFSETs of joints below a root and ignores
            their position channels. None or ``channels`` lets channels replace them;
            joints whose channels are all 0 are reported (BVH111).
        progress: Called with the fraction of the file read, 0 to 1.

    Raises:
        FormatError: The file cannot be read, or is malformed. Faults of rows are raised
            when the rows are read.
        OptionError: fps is not a frame rate (SCN022).
    """
    path = Path(path)
    rate = None if fps is None else rate_option(fps)
    with open_input(path, None) as file:
        try:
            lines = HeaderLines(file, path)
            header, notices = read_header(lines, str(path))
            rows_start = file.tell() - len(lines.unread)
        except OSError as error:
            raise unreadable_error(path, error) from error
    rig = _rig(header, path.stem, unit or LengthUnit.CM, up or UpAxis.Y)
    notices += _size_notice(rig, unit, str(path))
    if rate is not None:
        notices = [notice for notice in notices if notice.code not in _RATE_CODES]
    channels = [
        f"{joint.name}.{channel}"
        for joint in header.joints
        for channel in joint.channels or ()
    ]
    rows = RowSource(
        path,
        file.state,
        rows_start,
        lines.number,
        channels,
        header.declared_frames,
        header.frames_line,
        progress,
    )
    layout = _Layout(header, offsets=positions == "offsets")
    assert header.rate is not None
    details: dict[str, object] = {
        "format": "BVH",
        "declared_frames": header.declared_frames,
        "frame_time": header.frame_time,
        "rate_choice": str(header.rate.kind) if rate is None else "stated",
        "channels": len(channels),
    }
    if up is not None:
        details["up_choice"] = "stated"
    fps = header.rate.fps if rate is None else rate
    blocks = _blocks(rows, layout, rig, notices)
    return TakeStream(rig, fps, None, Fraction(1), blocks, notices, details)


@expects_format("BVH001", "a BVH file")
def read_bvh_rig(path: Path) -> Rig:
    """Return the skeleton of a BVH file in centimetres, without reading its rows."""
    return read_bvh(path).rig


_RATE_CODES = {"BVH105", "BVH106", "BVH107"}


def _size_notice(rig: Rig, option: LengthUnit | None, path: str) -> list[Fault]:
    """Return a note about a skeleton whose size suggests another unit."""
    size = rest_size(rig)
    smallest, largest = LIKELY_METERS
    if len(rig.joints) < MIN_JOINTS or smallest <= size <= largest:
        return []
    numbers = size / rig.meters_per_unit
    smallest, largest = PERSON_METERS
    fitting_units = [
        unit for unit in LengthUnit if smallest <= numbers * unit.meters <= largest
    ]
    unit = option or LengthUnit.CM
    message = (
        f"the skeleton spans {numbers:.4g}, which is not plausible for a character in "
        f"{unit}"
    )
    hint = f"set the unit with {argument('source.unit')}"
    if fitting_units:
        hint = (
            f"with {argument('source.unit', fitting_units[0])} it would be "
            f"{numbers * fitting_units[0].meters:.2g} m"
        )
    severity = Severity.NOTE if option is None else Severity.WARNING
    return [Fault("RIG217", message, path, (), hint, severity)]


def _rig(header: BvhHeader, name: str, unit: LengthUnit, up: UpAxis) -> Rig:
    joints = []
    names = numbered_names(joint.name for joint in header.joints)
    for joint, unique in zip(header.joints, names, strict=True):
        converted = _joint(joint, unit.meters)
        source_name = joint.name if unique != joint.name else ""
        joints.append(replace(converted, name=unique, source_name=source_name))
    return Rig(name, tuple(joints), unit.meters, up)


def _joint(joint: BvhJoint, meters: float) -> Joint:
    channels = joint.channels or ()
    rotations = [name[0] for name in channels if name.endswith("rotation")]
    positions = [name[0] for name in channels if name.endswith("position")]
    axis = (0.0, 0.0, 1.0)
    kind = JointType.FREE
    if not channels:
        kind = JointType.FIXED
    elif not positions:
        kind = JointType.PIN if len(rotations) == 1 else JointType.BALL
        if kind is JointType.PIN:
            axis = _axis(rotations[0])
    elif not rotations and len(positions) == 1:
        kind, axis = JointType.PRISMATIC, _axis(positions[0])

    def scaled(values: tuple[float, float, float]) -> tuple[float, float, float]:
        return (values[0] * meters, values[1] * meters, values[2] * meters)

    return Joint(
        joint.name,
        joint.parent,
        kind,
        scaled(joint.offset or (0.0, 0.0, 0.0)),
        axis=axis,
        channels=channels,
        tips=tuple(scaled(tip) for tip in joint.tips),
    )


def _axis(letter: str) -> tuple[float, float, float]:
    return {"X": (1.0, 0.0, 0.0), "Y": (0.0, 1.0, 0.0), "Z": (0.0, 0.0, 1.0)}[letter]


class _Layout:
    """Column indices of each joint's position and rotation channels."""

    def __init__(self, header: BvhHeader, *, offsets: bool = False) -> None:
        """Assign columns to joints; ``offsets`` skips position channels below roots."""
        self.position_joints: list[int] = []
        self.rotation_joints: list[int] = []
        slots: list[int] = []
        columns: list[int] = []
        rotation_columns: list[list[int]] = []
        rotation_axes: list[list[int]] = []
        column = 0
        for j, joint in enumerate(header.joints):
            rotations: list[tuple[int, int]] = []
            has_positions = False
            for name in joint.channels or ():
                axis = "XYZ".index(name[0])
                if name.endswith("position") and offsets and joint.parent >= 0:
                    pass
                elif name.endswith("position"):
                    slots.append(3 * len(self.position_joints) + axis)
                    columns.append(column)
                    has_positions = True
                else:
                    rotations.append((column, axis))
                column += 1
            if has_positions:
                self.position_joints.append(j)
            if rotations:
                self.rotation_joints.append(j)
                rotations += [(-1, 0)] * (3 - len(rotations))
                rotation_columns.append([c for c, _ in rotations])
                rotation_axes.append([a for _, a in rotations])
        self.slots = np.array(slots, np.int64)
        self.columns = np.array(columns, np.int64)
        self.rotation_columns = np.array(rotation_columns, np.int32).reshape(-1, 3)
        self.rotation_axes = np.array(rotation_axes, np.int32).reshape(-1, 3)


def _blocks(
    source: RowSource, layout: _Layout, rig: Rig, notices: list[Fault]
) -> Iterator[Motion]:
    reader, farthest = RowReader(source), np.zeros(len(layout.columns))
    position_joints = np.array(layout.position_joints, np.int64)
    rotation_joints = np.array(layout.rotation_joints, np.int64)
    rest = rig.rest_translations[position_joints].ravel()
    identity = rig.rest_rotations
    previous: FloatArray = np.tile(IDENTITY, (len(rotation_joints), 1))
    for rows in reader.blocks():
        translations = np.repeat(rest[None], len(rows), axis=0)
        farthest = np.maximum(farthest, np.abs(rows[:, layout.columns]).max(axis=0))
        translations[:, layout.slots] = rows[:, layout.columns] * rig.meters_per_unit
        rotations = _kernels.euler_to_quaternion(
            rows, layout.rotation_columns, layout.rotation_axes, previous
        )
        previous = rotations[-1].copy()
        yield Motion(
            Channel(
                rig.rest_translations,
                position_joints,
                translations.reshape(len(rows), -1, 3),
            ),
            Channel(identity, rotation_joints, rotations),
        )
    notices.extend(reader.notices)
    reaches = np.zeros(3 * len(position_joints))
    reaches[layout.slots] = farthest
    has_channel = np.zeros(3 * len(position_joints), np.bool_)
    has_channel[layout.slots] = True
    faults = _zero_length_warning(
        rig, position_joints, reaches, has_channel, str(source.path)
    )
    notices.extend(faults)


def _zero_length_warning(
    rig: Rig,
    position_joints: IntArray,
    reaches: FloatArray,
    has_channel: BoolArray,
    path: str,
) -> list[Fault]:
    """Return a warning about joints whose zero position channels collapse bones.

    Args:
        rig: The skeleton.
        position_joints: Joints with position channels ``(M,)``.
        reaches: Largest absolute value of each position along each axis ``(3 M,)``.
        has_channel: Whether each axis has a channel ``(3 M,)``.
        path: The file.
    """
    offsets = rig.rest_translations[position_joints]
    extents = np.where(
        has_channel.reshape(-1, 3), reaches.reshape(-1, 3), np.abs(offsets)
    )
    sizes = np.linalg.norm(offsets, axis=1) / rig.meters_per_unit
    lengths = np.linalg.norm(extents, axis=1) * rig.meters_per_unit
    is_short = lengths <= MIN_LENGTH_FRACTION * sizes * rig.meters_per_unit
    has_length = (sizes > 0) & (rig.parents[position_joints] >= 0)
    is_collapsed = is_short & has_length
    if not is_collapsed.any():
        return []
    names = [rig.names[j] for j in position_joints[is_collapsed].tolist()]
    reach = sizes[is_collapsed].max()
    message = (
        f"the position channels of {counted(len(names), 'joint')} are 0 in all "
        f"frames, but their OFFSETs reach {reach:.4g}: the joints are at "
        f"their parents, without a bone ({listed(names, MAX_NAMED)})"
    )
    hint = (
        "position channels replace OFFSETs; "
        f"{argument('source.positions', 'offsets')} keeps the OFFSETs"
    )
    # If channels of other joints have values, the zeros may be intended as well.
    severity = (
        Severity.WARNING if is_collapsed.sum() == has_length.sum() else Severity.NOTE
    )
    return [Fault("BVH111", message, path, (), hint, severity)]
