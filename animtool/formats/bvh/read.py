"""Reads a BVH file as a stream of motion blocks."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import numpy as np

from animtool import _kernels
from animtool.core.arguments import argument
from animtool.core.array_types import FloatArray, IntArray
from animtool.core.errors import Fault, Severity, counted, listed
from animtool.core.files.reading import open_input, unreadable_error
from animtool.core.files.signatures import expects_format
from animtool.core.names import numbered_names
from animtool.core.rates import FractionLike, rate_option
from animtool.core.units import LengthUnit, UpAxis
from animtool.formats.bvh.hierarchy import BvhHeader, BvhJoint, read_header
from animtool.formats.bvh.lines import HeaderLines, RowReader, RowSource
from animtool.formats.bvh.plausibility import (
    MIN_BODY_JOINTS,
    ChannelRanges,
    radians_warning,
    stated_rate_note,
    unused_positions_note,
)
from animtool.formats.bvh.suspicious import (
    channel_order_warning,
    opposite_offset_warnings,
    swapped_root_warning,
)
from animtool.maths.so3 import IDENTITY
from animtool.motion.motion import Channel, Motion
from animtool.motion.take import TakeStream
from animtool.rig.kinematics import rest_size
from animtool.rig.skeleton import Joint, JointType, Rig

# Plausible extent at rest of any character, and of a person [m].
CHARACTER_SIZES = (0.3, 6.0)
PERSON_SIZES = (1.0, 2.6)
DECIMETRE = 0.1  # [m]
MAX_LISTED_JOINTS = 4
# Bones shorter than this fraction of their OFFSET are collapsed [1].
MIN_LENGTH_FRACTION = 1e-4
# Frames a second at which orders of channels are compared, and their greatest number.
TRIAL_RATE, MAX_TRIAL_FRAMES = 30.0, 240


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
        unit: Unit of the lengths; None is centimetres, with a note if the skeleton's
            size fits another unit better.
        up: The up axis; None is Y. The file does not state it.
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
            header_lines = HeaderLines(file, path)
            header, notices = read_header(header_lines, str(path))
            first_row_offset = file.tell() - len(header_lines.unread_bytes)
        except OSError as error:
            raise unreadable_error(path, error) from error
    rig = _build_rig(header, path.stem, unit or LengthUnit.CM, up or UpAxis.Y)
    notices += _size_notice(rig, unit, str(path))
    notices += opposite_offset_warnings(header, rig, str(path))
    if rate is not None:
        notices = [notice for notice in notices if notice.code not in _FRAME_TIME_CODES]
        notices += stated_rate_note(header, rate, str(path))
    channels = [f"{j.name}.{c}" for j in header.joints for c in j.channels or ()]
    if positions == "offsets":
        notices += unused_positions_note(header, str(path))
    row_source = RowSource(
        path,
        file.state,
        first_row_offset,
        header_lines.number,
        channels,
        header.declared_frame_count,
        header.frames_line,
        progress,
    )
    layout = _ColumnLayout(header, keeps_offsets=positions == "offsets")
    details: dict[str, object] = {
        "format": "BVH",
        "declared_frames": header.declared_frame_count,
        "frame_time": header.frame_time,
        "rate_choice": str(header.rate_choice.kind) if rate is None else "stated",
        "channels": len(channels),
    }
    if up is not None:
        details["up_choice"] = "stated"
    fps = header.rate_choice.fps if rate is None else rate
    blocks = _read_blocks(row_source, header, layout, rig, float(fps), notices)
    return TakeStream(rig, fps, None, Fraction(1), blocks, notices, details)


@expects_format("BVH001", "a BVH file")
def read_bvh_rig(path: Path) -> Rig:
    """Return the skeleton of a BVH file in centimetres, without reading its rows."""
    return read_bvh(path).rig


_FRAME_TIME_CODES = {"BVH105", "BVH106", "BVH107"}


def _size_notice(rig: Rig, stated_unit: LengthUnit | None, path: str) -> list[Fault]:
    """Return a notice if the size of a skeleton suggests another unit (RIG217)."""
    size = rest_size(rig)
    smallest, largest = CHARACTER_SIZES
    if len(rig.joints) < MIN_BODY_JOINTS or smallest <= size <= largest:
        return []
    extent = size / rig.meters_per_unit
    message = f"the skeleton spans {extent:.4g} {stated_unit or LengthUnit.CM}, which "
    message += "is not plausible for a character"
    severity = Severity.NOTE if stated_unit is None else Severity.WARNING
    return [Fault("RIG217", message, path, (), _unit_hint(extent), severity)]


def _unit_hint(extent: float) -> str:
    """Return a hint about the unit in which an extent fits a person or an animal.

    >>> _unit_hint(22.5)
    'in decimetres it would be 2.2 m: export it in cm, at 10 times the size'
    """
    for smallest, largest in (PERSON_SIZES, CHARACTER_SIZES):
        for unit in LengthUnit:
            if smallest <= extent * unit.meters <= largest:
                option_text = argument("source.unit", unit)
                return f"{option_text} would make it {extent * unit.meters:.2g} m"
        # No option has decimetres, in which MakeHuman exports.
        if smallest <= extent * DECIMETRE <= largest:
            hint = f"in decimetres it would be {extent * DECIMETRE:.2g} m"
            return f"{hint}: export it in cm, at 10 times the size"
    return "export it at its true size, or ignore this if it is meant"


def _build_rig(header: BvhHeader, name: str, unit: LengthUnit, up: UpAxis) -> Rig:
    names = numbered_names([joint.name for joint in header.joints])
    joints = [
        _build_joint(joint, unique_name, unit.meters)
        for joint, unique_name in zip(header.joints, names, strict=True)
    ]
    return Rig(name, tuple(joints), unit.meters, up)


def _build_joint(joint: BvhJoint, name: str, meters_per_unit: float) -> Joint:
    channels = joint.channels or ()
    rotations = [name[0] for name in channels if name.endswith("rotation")]
    positions = [name[0] for name in channels if name.endswith("position")]
    axis = (0.0, 0.0, 1.0)
    joint_type = JointType.FREE
    if not channels:
        joint_type = JointType.FIXED
    elif not positions:
        joint_type = JointType.PIN if len(rotations) == 1 else JointType.BALL
        if joint_type is JointType.PIN:
            axis = _channel_axis(rotations[0])
    elif not rotations and len(positions) == 1:
        joint_type, axis = JointType.PRISMATIC, _channel_axis(positions[0])

    def to_meters(values: tuple[float, float, float]) -> tuple[float, float, float]:
        return (
            values[0] * meters_per_unit,
            values[1] * meters_per_unit,
            values[2] * meters_per_unit,
        )

    return Joint(
        name,
        joint.parent,
        joint_type,
        to_meters(joint.offset or (0.0, 0.0, 0.0)),
        axis=axis,
        channels=channels,
        tips=tuple(to_meters(tip) for tip in joint.tips),
        source_name="" if name == joint.name else joint.name,
    )


def _channel_axis(letter: str) -> tuple[float, float, float]:
    return {"X": (1.0, 0.0, 0.0), "Y": (0.0, 1.0, 0.0), "Z": (0.0, 0.0, 1.0)}[letter]


class _ColumnLayout:
    """Columns of the position and rotation channels of the joints.

    Attributes:
        position_joints: The P joints with position channels.
        rotation_joints: The R joints with rotation channels.
        position_slots: Index of each position channel in positions ``(P, 3)``, raveled.
        position_columns: Column of each position channel.
        rotation_columns: Columns of the rotation channels ``(R, 3)``, padded with -1.
        rotation_axes: Axes of the rotation channels ``(R, 3)``, padded with 0.
    """

    def __init__(self, header: BvhHeader, *, keeps_offsets: bool = False) -> None:
        """Assign columns; ``keeps_offsets`` ignores position channels below roots."""
        self.position_joints: list[int] = []
        self.rotation_joints: list[int] = []
        position_slots: list[int] = []
        position_columns: list[int] = []
        rotation_columns: list[list[int]] = []
        rotation_axes: list[list[int]] = []
        column_count = 0
        for j, joint in enumerate(header.joints):
            rotations: list[tuple[int, int]] = []
            ignores_positions = keeps_offsets and joint.parent >= 0
            for column, name in enumerate(joint.channels or (), column_count):
                axis = "XYZ".index(name[0])
                if not name.endswith("position"):
                    rotations.append((column, axis))
                elif not ignores_positions:
                    if self.position_joints[-1:] != [j]:
                        self.position_joints.append(j)
                    position_slots.append(3 * len(self.position_joints) - 3 + axis)
                    position_columns.append(column)
            column_count += len(joint.channels or ())
            if rotations:
                self.rotation_joints.append(j)
                rotations += [(-1, 0)] * (3 - len(rotations))
                rotation_columns.append([column for column, _ in rotations])
                rotation_axes.append([axis for _, axis in rotations])
        self.position_slots = np.array(position_slots, np.int64)
        self.position_columns = np.array(position_columns, np.int64)
        self.rotation_columns = np.array(rotation_columns, np.int32).reshape(-1, 3)
        self.rotation_axes = np.array(rotation_axes, np.int32).reshape(-1, 3)


def _read_blocks(
    source: RowSource,
    header: BvhHeader,
    layout: _ColumnLayout,
    rig: Rig,
    rate: float,
    notices: list[Fault],
) -> Iterator[Motion]:
    path = str(source.path)
    reader, max_positions = RowReader(source), np.zeros(len(layout.position_columns))
    position_joints = np.array(layout.position_joints, np.int64)
    rotation_joints = np.array(layout.rotation_joints, np.int64)
    rest_positions = rig.rest_translations[position_joints].ravel()
    previous_rotations: FloatArray = np.tile(IDENTITY, (len(rotation_joints), 1))
    rotation_columns = layout.rotation_columns
    ranges = ChannelRanges(rotation_columns[rotation_columns >= 0].astype(np.int64))
    for i, rows in enumerate(reader.blocks()):
        if i == 0:
            notices += swapped_root_warning(header, rows, rig, path)
        translations = np.repeat(rest_positions[None], len(rows), axis=0)
        max_positions = np.maximum(
            max_positions, np.abs(rows[:, layout.position_columns]).max(axis=0)
        )
        translations[:, layout.position_slots] = (
            rows[:, layout.position_columns] * rig.meters_per_unit
        )
        rotations = _kernels.euler_to_quaternion(
            rows, layout.rotation_columns, layout.rotation_axes, previous_rotations
        )
        previous_rotations = rotations[-1].copy()
        ranges.add(rows, translations[:, :3])
        motion = Motion(
            Channel(
                rig.rest_translations,
                position_joints,
                translations.reshape(len(rows), -1, 3),
            ),
            Channel(rig.rest_rotations, rotation_joints, rotations),
        )
        if i == 0:
            notices += channel_order_warning(
                header, _OrderTrial(motion, rows, layout, rate).motion, rig, path
            )
        yield motion
    notices.extend(reader.notices)
    extents = np.abs(rest_positions) / rig.meters_per_unit
    extents[layout.position_slots] = max_positions
    notices += _collapsed_bones_notice(rig, position_joints, extents, path)
    notices += radians_warning(ranges, rig, path)


class _OrderTrial:
    """Samples of a block with its rotation channels in other orders."""

    def __init__(
        self, motion: Motion, rows: FloatArray, layout: _ColumnLayout, rate: float
    ) -> None:
        """Take samples from the middle of a block, at a rate of cameras."""
        step = max(1, round(rate / TRIAL_RATE))
        count = min(len(rows) // step, MAX_TRIAL_FRAMES)
        first = (len(rows) - step * count) // 2
        frames = np.arange(first, first + step * count, step)
        self._motion, self._rows = motion.select(frames), rows[frames]
        self._layout = layout

    def motion(self, order: tuple[int, ...]) -> Motion:
        """Return the motion with the channels of each joint permuted."""
        layout, rotations = self._layout, self._motion.rotations
        has_three = (layout.rotation_columns >= 0).all(axis=1, keepdims=True)
        axes = np.where(
            has_three, layout.rotation_axes[:, order], layout.rotation_axes
        ).astype(np.int32)
        first: FloatArray = np.tile(IDENTITY, (len(axes), 1))
        values = _kernels.euler_to_quaternion(
            self._rows, layout.rotation_columns, axes, first
        )
        return replace(self._motion, rotations=replace(rotations, values=values))


def _collapsed_bones_notice(
    rig: Rig, position_joints: IntArray, extents: FloatArray, path: str
) -> list[Fault]:
    """Return a notice about position channels that are 0 and so collapse bones.

    Args:
        rig: The skeleton.
        position_joints: Joints with position channels ``(M,)``.
        extents: Largest absolute value of each position channel, or of the OFFSET on an
            axis without a channel, in the file's unit ``(3 M,)``.
        path: The file.
    """
    offsets = rig.rest_translations[position_joints] / rig.meters_per_unit
    offset_lengths = np.linalg.norm(offsets, axis=1)
    channel_lengths = np.linalg.norm(extents.reshape(-1, 3), axis=1)
    is_short = channel_lengths <= MIN_LENGTH_FRACTION * offset_lengths
    has_length = (offset_lengths > 0) & (rig.parents[position_joints] >= 0)
    is_collapsed = is_short & has_length
    if not is_collapsed.any():
        return []
    names = [rig.names[j] for j in position_joints[is_collapsed].tolist()]
    longest_offset = offset_lengths[is_collapsed].max()
    message = (
        f"the position channels of {counted(len(names), 'joint')} "
        f"({listed(names, MAX_LISTED_JOINTS)}) are 0 in all frames, although their "
        f"OFFSETs reach {longest_offset:.4g}; position channels replace OFFSETs, so "
        "the bones have no length"
    )
    hint = f"to keep the OFFSETs, use {argument('source.positions', 'offsets')}"
    # If channels of other joints have values, the zeros may be intended as well.
    severity = (
        Severity.WARNING if is_collapsed.sum() == has_length.sum() else Severity.NOTE
    )
    return [Fault("BVH111", message, path, (), hint, severity)]
