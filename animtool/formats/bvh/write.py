"""Writes a take as a BVH file."""

from __future__ import annotations

from collections.abc import Iterator
from fractions import Fraction
from pathlib import Path

import numpy as np

from animtool import _kernels
from animtool.core.arguments import argument
from animtool.core.array_types import FloatArray
from animtool.core.errors import Fault, OptionError, Severity, counted, listed
from animtool.core.loaded import check_loaded
from animtool.core.rates import rate_from_frame_time
from animtool.core.units import LengthUnit, UpAxis, unit_name
from animtool.formats.take_text import TakeText, format_rows, write_text
from animtool.maths.euler import axes_of
from animtool.motion.take import Take
from animtool.rig.skeleton import Joint, Rig

# Angles in degrees to 7 places are exact to 1e-9 rad, lengths to 9 places to 1e-9
# units: both far finer than float32.
ANGLE_DECIMALS = 7
LENGTH_DECIMALS = 9
# Tolerance of unused rotation channels [deg]; float32 quaternions have errors up to
# 1e-5 degrees about axes without rotation.
UNUSED_AXIS_TOLERANCE = 1e-4
# Tolerance of unused position channels, relative to the largest offset.
UNUSED_LENGTH_TOLERANCE = 1e-6

_POSITION_CHANNELS = ("Xposition", "Yposition", "Zposition")
_DEFAULT_ROTATION_CHANNELS = ("Zrotation", "Xrotation", "Yrotation")


def write_bvh(take: Take, path: Path | str, *, overwrite: bool = False) -> list[Fault]:
    """Write a take as a BVH file, in the unit of its rig; see `build_bvh_text`.

    Args:
        take: The take.
        path: Path of the file, ``.bvh``.
        overwrite: Replace an existing file.

    Returns:
        Warnings about data that BVH cannot store.

    Raises:
        OptionError: The rig has no joints (RIG044), or the file exists (OUT001).
        OutputError: The file cannot be written (OUT002).
    """
    check_loaded(take, Take, "take")
    return write_text(take, path, build_bvh_text, overwrite=overwrite)


def build_bvh_text(take: Take) -> TakeText:
    """Return a take as BVH text in its rig's unit (RIG044 without joints).

    Joints keep the channels and names they were read with if these can represent the
    motion; other joints get ``Zrotation Xrotation Yrotation``, and roots and translated
    joints also positions. Angles are continuous over time. BVH cannot store the start
    time code and scales; notices report scales.
    """
    if not take.rig.joints:
        message = f"{take.rig.name!r} has no joints, and a BVH can hold only joints"
        hint = "write USD, or keys in a .clip.yaml"
        raise OptionError(Fault("RIG044", message, hint=hint))
    motion = take.motion
    translations = motion.translations.dense() / take.rig.meters_per_unit
    offsets = take.rig.rest_translations / take.rig.meters_per_unit
    children: list[list[int]] = [[] for _ in take.rig.joints]
    for i, joint in enumerate(take.rig.joints):
        if joint.parent >= 0:
            children[joint.parent].append(i)
    max_offset = float(np.abs(offsets).max(initial=0.0))

    columns: list[FloatArray] = []
    decimal_counts: list[int] = []
    channel_orders: dict[int, tuple[str, ...]] = {}
    rotations = motion.rotations.dense()
    # Columns follow the joints' order in the hierarchy.
    for j in _joints_depth_first(take.rig, children):
        joint = take.rig.joints[j]
        tolerance = UNUSED_LENGTH_TOLERANCE * max_offset
        position_names = _position_channels(
            joint, translations[:, j], offsets[j], tolerance
        )
        rotation_names, angles = _rotation_channels(joint, rotations[:, j])
        channel_order = _order_channels(joint, position_names, rotation_names)
        channel_orders[j] = channel_order
        for name in channel_order:
            if name in position_names:
                columns.append(translations[:, j, "XYZ".index(name[0])])
                decimal_counts.append(LENGTH_DECIMALS)
            else:
                columns.append(angles[:, rotation_names.index(name)])
                decimal_counts.append(ANGLE_DECIMALS)
    rows = np.stack(columns, axis=1) if columns else np.zeros((motion.frames, 0))
    return TakeText(
        _header_lines(take, offsets, children, channel_orders),
        format_rows(rows, decimal_counts),
        _scale_notices(take) + _shape_notices(take) + _unit_notices(take.rig),
    )


def _joints_depth_first(rig: Rig, children: list[list[int]]) -> list[int]:
    """Return joint indices depth-first, the order of a BVH hierarchy."""
    order, stack = [], rig.roots[::-1]
    while stack:
        j = stack.pop()
        order.append(j)
        stack += children[j][::-1]
    return order


def _position_channels(
    joint: Joint, translations: FloatArray, offset: FloatArray, tolerance: float
) -> tuple[str, ...]:
    """Return the position channels needed to store a joint's translations."""
    declared_names = tuple(n for n in joint.channels or () if n.endswith("position"))
    is_off_rest = np.abs(translations - offset).max(axis=0) > tolerance
    has_needed_channels = all(
        not is_off_rest[axis] or _POSITION_CHANNELS[axis] in declared_names
        for axis in range(3)
    )
    if joint.channels is not None and has_needed_channels:
        return declared_names
    if joint.parent < 0 or is_off_rest.any():
        return _POSITION_CHANNELS
    return ()


def _rotation_channels(
    joint: Joint, rotations: FloatArray
) -> tuple[tuple[str, ...], FloatArray]:
    """Return the rotation channels that a joint's rotations need, and angles [deg]."""
    declared_names = tuple(n for n in joint.channels or () if n.endswith("rotation"))
    names = declared_names if joint.channels is not None else _DEFAULT_ROTATION_CHANNELS
    axis_order = "".join(name[0] for name in names)
    axis_order += "".join(letter for letter in "XYZ" if letter not in axis_order)
    axes = np.array([axes_of(axis_order)], np.int32)
    quaternions = np.ascontiguousarray(rotations[:, None])
    angles = _kernels.quaternion_to_euler(quaternions, axes)[:, 0]
    declared_count = len(names)
    max_unused_angle = np.abs(angles[:, declared_count:]).max(initial=0.0)
    if declared_count == 3 or max_unused_angle <= UNUSED_AXIS_TOLERANCE:
        return names, angles[:, :declared_count]
    return tuple(f"{letter}rotation" for letter in axis_order), angles


def _order_channels(
    joint: Joint, position_names: tuple[str, ...], rotation_names: tuple[str, ...]
) -> tuple[str, ...]:
    """Return channels in the order that the joint declares, else positions first."""
    declared_names, needed_names = joint.channels or (), position_names + rotation_names
    is_unchanged = set(needed_names) == set(declared_names)
    return declared_names if is_unchanged else needed_names


def _header_lines(
    take: Take,
    offsets: FloatArray,
    children: list[list[int]],
    channel_orders: dict[int, tuple[str, ...]],
) -> Iterator[str]:
    yield "HIERARCHY"
    # A stack replaces recursion: chains may be thousands of joints long. It has joints
    # with their depth, and lines that close their blocks.
    pending: list[tuple[int, int] | str] = [(root, 0) for root in take.rig.roots[::-1]]
    while pending:
        item = pending.pop()
        if isinstance(item, str):
            yield item
            continue
        joint_index, depth = item
        joint, indent = take.rig.joints[joint_index], "\t" * depth
        keyword = "ROOT" if joint.parent < 0 else "JOINT"
        yield f"{indent}{keyword} {joint.source_name or joint.name}"
        yield f"{indent}{{"
        yield f"{indent}\tOFFSET {_vector_text(offsets[joint_index])}"
        channels = channel_orders[joint_index]
        yield f"{indent}\tCHANNELS {' '.join([str(len(channels)), *channels])}"
        for tip in _end_sites(joint, children[joint_index]):
            vector = _vector_text(np.asarray(tip) / take.rig.meters_per_unit)
            yield f"{indent}\tEnd Site"
            yield f"{indent}\t{{"
            yield f"{indent}\t\tOFFSET {vector}"
            yield f"{indent}\t}}"
        pending.append(f"{indent}}}")
        pending += [(child, depth + 1) for child in children[joint_index][::-1]]
    yield "MOTION"
    yield f"Frames: {take.clock.count}"
    yield f"Frame Time: {frame_time(take.clock.rate)}"


def _end_sites(
    joint: Joint, children: list[int]
) -> tuple[tuple[float, float, float], ...]:
    """Return End Site offsets [m]; leaf joints of other formats get one of length 0."""
    if joint.tips or children or joint.channels is not None:
        return joint.tips
    return ((0.0, 0.0, 0.0),)


def _vector_text(values: FloatArray) -> str:
    row = np.ascontiguousarray(values, np.float64)[None]
    decimals = np.full(3, LENGTH_DECIMALS, np.int64)
    return _kernels.format_bvh_rows(row, decimals).decode().strip()


def frame_time(rate: Fraction) -> str:
    """Return the shortest frame time [s] of at least 6 decimals that gives the rate.

    >>> frame_time(Fraction(30)), frame_time(Fraction(24000, 1001))
    ('0.033333', '0.041708')
    """
    text = ""
    for decimals in range(6, 18):
        text = f"{float(1 / rate):.{decimals}f}"
        if float(text) > 0:
            rate_choice = rate_from_frame_time(text)
            if rate_choice.fps == rate and not rate_choice.ambiguous_rates:
                break
    return text


def _unit_notices(rig: Rig) -> list[Fault]:
    """Return notices about unit and up axis, which BVH cannot store."""
    unit = unit_name(rig.meters_per_unit)
    if (unit, rig.up) == (LengthUnit.CM.value, UpAxis.Y):
        return []
    message = f"a BVH states neither unit nor up axis: this one is in {unit}, {rig.up} "
    message += "up"
    hint = f"read it back with {argument('source.unit', unit)} "
    hint += f"{argument('source.up', rig.up)}"
    return [Fault("BVH110", message, None, (), hint, Severity.NOTE)]


def _scale_notices(take: Take) -> list[Fault]:
    scales = take.motion.scales
    if scales is None:
        return []
    has_scale = np.abs(scales.dense() - 1.0).max(axis=(0, 2)) > 1e-3
    names = [take.rig.names[j] for j in np.flatnonzero(has_scale)]
    if not names:
        return []
    message = f"BVH has no scale, so the scale of {counted(len(names), 'joint')} is "
    message += f"lost ({listed(names)})"
    hint = "write .usdc or .glb, which store scales"
    return [Fault("BVH108", message, None, (), hint, Severity.WARNING)]


def _shape_notices(take: Take) -> list[Fault]:
    weights = take.motion.weights
    if weights is None:
        return []
    has_weight = (weights.dense() != 0.0).any(axis=(0, 2))
    names = [take.rig.shapes[k].name for k in np.flatnonzero(has_weight)]
    if not names:
        return []
    message = (
        f"BVH has no shapes, so the weights of {counted(len(names), 'shape')} are "
    )
    message += f"lost ({listed(names)})"
    hint = "write .usdc or .glb, which store them"
    return [Fault("BVH114", message, None, (), hint, Severity.WARNING)]
