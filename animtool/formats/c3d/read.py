"""Reads marker trajectories from C3D files."""

from __future__ import annotations

import math
import re
from fractions import Fraction
from pathlib import Path

import numpy as np

from animtool.core.arguments import argument
from animtool.core.array_types import BoolArray, FloatArray, IntArray
from animtool.core.clock import Clock
from animtool.core.errors import FormatError, counted, excerpt, listed
from animtool.core.files.reading import MAX_INPUT_BYTES, open_input
from animtool.core.files.signatures import expects_format
from animtool.core.rates import FractionLike
from animtool.core.units import LengthUnit, UpAxis
from animtool.formats.c3d.field_values import (
    WORD_RANGE,
    FieldValue,
    collect_field_values,
    trial_frame_range,
    unsigned_word,
)
from animtool.formats.c3d.layout import (
    Layout,
    LayoutResult,
    choose_layout,
    find_contradictions,
)
from animtool.formats.c3d.plausibility import measure_evidence
from animtool.formats.c3d.sections import (
    BLOCK_BYTES,
    MalformedError,
    Sections,
    read_sections,
)
from animtool.formats.trajectories import MAX_POSITIONS, CaptureFile
from animtool.motion.markers import Markers

_UP_HINT = f"{argument('source.up', 'Y')} or {argument('source.up', 'Z')}"
_AXIS_PATTERN = re.compile(r"([+-]?)([XYZ])")
# For other up axes than +Y and +Z: the up axis after conversion, and the order and
# signs of the coordinates that become x, y and z.
_UP_CONVERSIONS = {
    "-Y": (UpAxis.Y, [0, 1, 2], [1, -1, -1]),
    "-Z": (UpAxis.Z, [0, 1, 2], [1, -1, -1]),
    "+X": (UpAxis.Y, [1, 0, 2], [-1, 1, 1]),
    "-X": (UpAxis.Y, [1, 0, 2], [1, -1, 1]),
}
# Parameters that list the labels of model outputs, which are stored like points.
MODEL_OUTPUT_PARAMETERS = (
    "ANGLES",
    "FORCES",
    "MOMENTS",
    "POWERS",
    "SCALARS",
    "REACTIONS",
)
# Parameter group in which `write_c3d` lists filled positions.
ANIMTOOL_GROUP = "ANIMTOOL"


def _up_axis(file: CaptureFile, sections: Sections, up: UpAxis | None) -> str:
    """Return the signed up axis such as ``+Z``: the option, else the stated one.

    C3D files state the axes that point right and up on a screen.
    """
    if up is not None:
        return f"+{UpAxis(up)}"
    right_axis, up_axis = (_read_axis(file, sections, f"{n}_SCREEN") for n in "XY")
    if up_axis is None and right_axis is not None and right_axis[1] == "Y":
        # Y points sideways and cannot be the default up axis.
        message = f"the file states no up axis; using Z, as X_SCREEN is {right_axis}"
        file.note("MKR103", message, f"set the up axis with {argument('source.up')}")
        return "+Z"
    if up_axis is None:
        return f"+{file.choose_up(None, None)}"
    if right_axis is not None and right_axis[1] == up_axis[1]:
        message = f"X_SCREEN is {right_axis} and Y_SCREEN {up_axis}, which are the "
        message += f"same axis; {up_axis} is used as up"
        file.warn("C3D105", message, _UP_HINT)
    if up_axis in _UP_CONVERSIONS:
        message = f"has {up_axis} up; positions are rotated so that "
        message += f"{_UP_CONVERSIONS[up_axis][0]} is up"
        file.note("C3D106", message)
    return up_axis


def _read_axis(file: CaptureFile, sections: Sections, name: str) -> str | None:
    """Return a signed axis such as ``+Z``; None if missing or invalid."""
    texts = sections.texts("POINT", name)
    text = texts[0].strip() if texts else ""
    if not text:
        return None
    match = _AXIS_PATTERN.fullmatch(text.upper())
    if match is None:
        message = f"{name} is {excerpt(text)}, not one of +X, -X, +Y, -Y, +Z, -Z"
        file.warn("C3D105", message, _UP_HINT)
        return None
    return f"{match[1] or '+'}{match[2]}"


@expects_format("C3D001", "a C3D file")
def read_c3d(
    path: Path | str,
    *,
    unit: LengthUnit | None = None,
    up: UpAxis | None = None,
    fps: FractionLike | None = None,
    subject: str | None = None,
) -> Markers:
    """Return the marker trajectories of a C3D file.

    Reads integer and float files of Intel, DEC and SGI processors, and more than 255
    labels. If header, parameters and file size disagree about counts, the counts that
    fill the file are used (C3D101). Model outputs (angles, forces) are skipped. A point
    with a negative residual, exactly at the origin, or with a NaN is not visible.

    Args:
        path: The file.
        unit: Unit of the lengths; None is the stated unit, or millimetres.
        up: The up axis; None is the stated axis, or Y. If the file states -Y, -Z or an
            X axis, positions are converted so that Y or Z is up.
        fps: The frame rate, if the file states a wrong one or none.
        subject: Subject whose prefix, as in ``Anna:LFHD``, is removed from names; None
            is the only subject, if there is only one.
    """
    path = Path(path)
    file = CaptureFile(str(path))
    with open_input(path, MAX_INPUT_BYTES) as input_file:
        data = input_file.read_all()
    try:
        sections = read_sections(data)
    except MalformedError as error:
        raise file.error("C3D001", str(error)) from None
    if not sections.groups:
        message = "has no parameters: names, unit and up axis are unknown, and "
        message += "nothing confirms the counts in its header"
        file.warn("C3D107", message, "check the number of points and frames")
    layout = _find_layout(file, sections, data)
    _check_scale(file, sections, layout)
    stated_unit = next(iter(sections.texts("POINT", "UNITS")), None)
    length_unit = file.choose_unit(stated_unit, unit, LengthUnit.MM)
    rate = file.choose_rate(_frame_rate(file, sections, fps), fps)
    signed_up = _up_axis(file, sections, up)
    positions, status_words = _read_points(sections, layout, data)
    names, point_indices = _marker_names(file, sections, layout.point_count, subject)
    positions = positions[:, point_indices]
    status_words = status_words[:, point_indices]
    positions[status_words < 0] = np.nan
    positions = file.clean_positions(positions, length_unit.meters)
    if signed_up in _UP_CONVERSIONS:
        up_axis, axis_order, signs = _UP_CONVERSIONS[signed_up]
        positions = positions[..., axis_order] * signs
    else:
        up_axis = UpAxis(signed_up[1])
    is_visible = np.isfinite(positions[..., 0])
    residual_scale = abs(_point_scale(sections)) * length_unit.meters
    first_frame = _first_frame(sections, layout.frame_count)
    clock = Clock(rate, Fraction(first_frame), Fraction(1), layout.frame_count)
    return Markers(
        names,
        clock,
        positions,
        up_axis,
        _camera_counts(status_words, is_visible),
        _residuals(status_words, is_visible, residual_scale),
        _find_filled(sections, status_words, is_visible, point_indices),
        tuple(file.notices),
    )


def _find_layout(file: CaptureFile, sections: Sections, data: bytes) -> Layout:
    """Return the layout that fits the file; warn about contradictions."""
    fields = collect_field_values(sections)
    end_offsets = [*_rotation_starts(sections, len(data)), len(data)]
    result = choose_layout(
        fields,
        data,
        end_offsets,
        lambda candidate: measure_evidence(candidate, data, sections.processor),
    )
    layout = result.layout
    if layout is None:
        raise _layout_error(file, result, len(data))
    if layout.point_count == 0 or layout.frame_count == 0:
        noun = "points" if layout.point_count == 0 else "frames"
        raise file.error("MKR013", f"has no {noun}")
    if layout.point_count * layout.frame_count > MAX_POSITIONS:
        message = f"claims {layout.point_count} points in {layout.frame_count} frames, "
        raise file.error("C3D001", message + "above the limit")
    contradictions = find_contradictions(fields, layout)
    if contradictions:
        message = "its header, parameters and size disagree; what matches the file "
        message += "size is read: "
        message += "; ".join(_contradiction_text(*c) for c in contradictions)
        file.warn("C3D101", message)
    # ezc3d writes a block of zeros behind frames that fill their last block.
    if data.endswith(b"\0" * BLOCK_BYTES) and layout.trailing_bytes == BLOCK_BYTES:
        return layout
    if layout.trailing_bytes >= min(
        BLOCK_BYTES, layout.number_bytes * layout.numbers_per_frame
    ) or (layout.trailing_bytes and len(data) % BLOCK_BYTES):
        message = f"has {counted(layout.trailing_bytes, 'byte')} after the last of "
        message += f"{counted(layout.frame_count, 'frame')}, which are ignored"
        file.warn("C3D108", message, "check the number of frames")
    return layout


def _rotation_starts(sections: Sections, size: int) -> list[int]:
    """Return the byte offset of the rotation data as a list; empty if there is none."""
    block = unsigned_word(sections, "ROTATION", "DATA_START") or 0
    start = BLOCK_BYTES * (block - 1)
    has_rotations = block > 2 and sections.number("ROTATION", "USED")
    return [start] if has_rotations and start < size else []


def _layout_error(file: CaptureFile, result: LayoutResult, size: int) -> FormatError:
    """Return the error for a file whose size fits no combination of counts."""
    rival_layouts = result.ambiguous_layouts
    if rival_layouts:
        message = "its header, parameters and size disagree, and nothing resolves it: "
        message += f"between {' or '.join(map(str, rival_layouts))}"
        if len(rival_layouts) == 1:
            message = f"its counts do not match its size of {size} bytes: "
            message += f"{rival_layouts[0]} end at {rival_layouts[0].end}, and are not "
            message += "positions"
        return file.error("C3D003", message, "export it again")
    layout = result.truncated_layout
    if layout is None or not layout.point_count or not layout.frame_count:
        return file.error("MKR013", "has no points in frames")
    available_bytes = max(0, size - layout.data_offset)
    frame_bytes = layout.number_bytes * layout.numbers_per_frame
    message = (
        f"is truncated: it claims {layout}, {layout.end - layout.data_offset} "
        f"bytes; it has {available_bytes}, {available_bytes // frame_bytes} frames"
    )
    return file.error("C3D002", message, "copy or export it again")


_QUANTITIES = {
    "frame_count": "frames",
    "point_count": "points",
    "analog_count": "analogue values per frame",
    "number_bytes": "bytes per number",
    "data_offset": "bytes before the first frame",
}


def _contradiction_text(name: str, value: int, stated_values: list[FieldValue]) -> str:
    texts = ", ".join(f"{v.value} ({v.source})" for v in stated_values)
    return f"{value} {_QUANTITIES[name]}, not {texts}"


def _first_frame(sections: Sections, frame_count: int) -> int:
    """Return the first frame number, which may exceed the 16 bits of the header."""
    header = sections.header
    start, end = trial_frame_range(sections)
    if start is None or end is None or end - start + 1 != frame_count:
        return header.first_frame
    is_header_valid = (
        header.last_frame - header.first_frame + 1 == frame_count and end < WORD_RANGE
    )
    return header.first_frame if is_header_valid else start


def _point_scale(sections: Sections) -> float:
    """Return the scale of stored integers; a negative scale means floats."""
    parameter_scale = sections.number("POINT", "SCALE")
    scale = sections.header.scale if parameter_scale is None else parameter_scale
    return scale if np.isfinite(scale) and scale != 0 else -1.0


def _check_scale(file: CaptureFile, sections: Sections, layout: Layout) -> None:
    """Warn about a scale that is missing or stated with two values."""
    if layout.number_bytes == 4:
        return
    stated_scales = sections.number("POINT", "SCALE"), sections.header.scale
    scales = [abs(s) for s in stated_scales if s and np.isfinite(s)]
    if not scales:
        message = "has integers without a scale; they are read unscaled"
        file.warn("C3D101", message, "check the size of the captured subject")
    elif len(scales) == 2 and not math.isclose(scales[0], scales[1], rel_tol=1e-4):
        message = f"its header has the scale {scales[1]:g}, but its parameters "
        message += f"{scales[0]:g}"
        file.warn("C3D101", f"{message}; using the parameters")


def _frame_rate(
    file: CaptureFile, sections: Sections, fps: FractionLike | None
) -> float | None:
    """Return the frame rate of the parameters, or else of the header."""
    header_rate, parameter_rate = sections.header.rate, sections.number("POINT", "RATE")
    if not parameter_rate or not np.isfinite(parameter_rate):
        return header_rate
    is_same_rate = np.isclose(header_rate, parameter_rate, rtol=1e-4)
    if fps is None and header_rate > 0 and not is_same_rate:
        message = f"its header has {header_rate:g} fps, but its parameters "
        message += f"{parameter_rate:g}"
        file.warn("C3D101", f"{message}; using the parameters")
    return parameter_rate


def _read_points(
    sections: Sections, layout: Layout, data: bytes
) -> tuple[FloatArray, IntArray]:
    """Return positions ``(F, M, 3)`` in file units, and the status words ``(F, M)``."""
    frame_data = data[layout.data_offset : layout.end]
    rows = sections.processor.rows(
        frame_data,
        layout.number_bytes,
        layout.numbers_per_frame,
        4 * layout.point_count,
    )
    rows = rows.reshape(layout.frame_count, layout.point_count, 4)
    positions = np.ascontiguousarray(rows[..., :3])
    if layout.number_bytes == 2:
        positions *= abs(_point_scale(sections))
    stored_words = rows[..., 3]
    is_valid_word = np.isfinite(stored_words) & (np.abs(stored_words) < 2**31)
    # The sign of the last word marks a point as not visible.
    status_words = np.where(
        is_valid_word, stored_words, np.where(stored_words < 0, -1.0, 0.0)
    ).astype(np.int64)
    status_words[stored_words < 0] = -1
    return positions, status_words


def _marker_names(
    file: CaptureFile, sections: Sections, point_count: int, subject: str | None
) -> tuple[tuple[str, ...], IntArray]:
    """Return marker names and point indices, without model outputs."""
    labels = sections.texts("POINT", "LABELS")
    if len(labels) < point_count:
        message = f"names {len(labels)} of {counted(point_count, 'point')}"
        file.warn("C3D102", f"{message}; the others are unlabelled points")
    labels = [*labels[:point_count], *[""] * (point_count - len(labels))]
    output_labels = [sections.texts("POINT", name) for name in MODEL_OUTPUT_PARAMETERS]
    model_labels = {label for names in output_labels for label in names if label}
    point_indices = np.array(
        [i for i, name in enumerate(labels) if name not in model_labels]
    )
    if len(point_indices) < point_count:
        skipped_labels = [name for name in labels if name in model_labels]
        message = f"{counted(len(skipped_labels), 'result')} of models skipped: "
        file.note("C3D103", message + listed(skipped_labels))
    if not len(point_indices):
        raise file.error("MKR013", "has no marker points")
    names = [labels[i] for i in point_indices.tolist()]
    return file.unique_names(names, subject), point_indices


def _camera_counts(status_words: IntArray, is_visible: BoolArray) -> IntArray | None:
    """Return the number of cameras, at most 7, of each position; None if not stated."""
    camera_bits = np.where(is_visible, (status_words >> 8) & 0x7F, 0)
    if not camera_bits.any():
        return None
    return sum(
        ((camera_bits >> bit) & 1 for bit in range(7)), np.zeros_like(camera_bits)
    )


def _residuals(
    status_words: IntArray, is_visible: BoolArray, meters_per_step: float
) -> FloatArray | None:
    """Return residuals [m] ``(F, M)``; NaN for positions that were not measured."""
    residual_steps = status_words & 0xFF
    is_measured = is_visible & (residual_steps > 0)
    if not is_measured.any():
        return None
    return np.where(is_measured, residual_steps * meters_per_step, np.nan)


def _find_filled(
    sections: Sections,
    status_words: IntArray,
    is_visible: BoolArray,
    point_indices: IntArray,
) -> BoolArray | None:
    """Return whether positions ``(F, M)`` were filled, not measured; None if none.

    animtool lists them in its own parameter group. In other files, a residual and
    cameras of 0 mean filled if other positions have nonzero ones.
    """
    animtool_group = sections.groups.get(ANIMTOOL_GROUP)
    if animtool_group is not None:
        return _read_filled_group(sections, is_visible, point_indices)
    if not (is_visible & (status_words > 0)).any():
        return None
    is_filled = is_visible & (status_words == 0)
    return is_filled if is_filled.any() else None


def _read_filled_group(
    sections: Sections, is_visible: BoolArray, point_indices: IntArray
) -> BoolArray | None:
    is_filled = np.zeros(is_visible.shape, bool)
    column_by_point = {
        point: column for column, point in enumerate(point_indices.tolist())
    }
    for value in sections.continued_values(ANIMTOOL_GROUP, "FILLED"):
        if not isinstance(value, np.ndarray) or not value.size:
            break
        for marker, first, last in value.ravel()[: value.size // 3 * 3].reshape(-1, 3):
            if np.isfinite([marker, first, last]).all() and marker in column_by_point:
                first_frame = int(min(max(first, 0), len(is_visible)))
                end_frame = int(min(max(last + 1, 0), len(is_visible)))
                is_filled[first_frame:end_frame, column_by_point[int(marker)]] = True
    is_filled &= is_visible
    return is_filled if is_filled.any() else None
