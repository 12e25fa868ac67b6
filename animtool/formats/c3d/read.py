"""C3D reader: marker trajectories of a file."""

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
from animtool.core.record import dataclass
from animtool.core.units import LengthUnit, UpAxis
from animtool.formats.c3d.claims import (
    WORD_RANGE,
    Claim,
    collect_declared_layouts,
    trial_frame_range,
    unsigned_word,
)
from animtool.formats.c3d.layout import (
    Layout,
    LayoutResult,
    choose_layout,
    contradicted_claims,
)
from animtool.formats.c3d.plausibility import measure_evidence
from animtool.formats.c3d.sections import (
    BLOCK_BYTES,
    MalformedError,
    Sections,
    read_sections,
)
from animtool.formats.trajectories import MAX_POSITIONS, MarkerFile
from animtool.motion.markers import Markers

# C3D files state the axes that point right and up on a screen.

_AXIS = re.compile(r"([+-]?)([XYZ])")
# For other up axes than +Y and +Z: the up axis after conversion, and the order and
# signs of the coordinates that become x, y and z.
_UP_CONVERSIONS = {
    "-Y": (UpAxis.Y, (0, 1, 2), (1, -1, -1)),
    "-Z": (UpAxis.Z, (0, 1, 2), (1, -1, -1)),
    "+X": (UpAxis.Y, (1, 0, 2), (-1, 1, 1)),
    "-X": (UpAxis.Y, (1, 0, 2), (1, -1, 1)),
}


@dataclass(frozen=True, slots=True)
class ScreenAxes:
    """Up axis of a file, and the axis permutation that converts positions to it."""

    up: UpAxis  # the up axis of the converted positions
    # File coordinates that become x, y and z; None without a conversion.
    order: IntArray | None = None
    signs: FloatArray | None = None  # signs of the converted coordinates

    def convert(self, positions: FloatArray) -> FloatArray:
        """Return positions ``(..., 3)`` rotated to the up axis."""
        if self.order is None or self.signs is None:
            return positions
        return positions[..., self.order] * self.signs


def read_screen_axes(
    file: MarkerFile, sections: Sections, stated_up: UpAxis | None
) -> ScreenAxes:
    """Return the up axis of ``X_SCREEN`` and ``Y_SCREEN``; an option overrides it."""
    if stated_up is not None:
        return ScreenAxes(UpAxis(stated_up))
    right_axis, up_axis = (_read_axis(file, sections, f"{n}_SCREEN") for n in "XY")
    if up_axis is None and right_axis is not None and right_axis[1] == "Y":
        # Y points sideways and cannot be the default up axis.
        message = f"the file states no up axis; using Z, as X_SCREEN is {right_axis}"
        file.note("MKR103", message, f"set the up axis with {argument('source.up')}")
        return ScreenAxes(UpAxis.Z)
    if up_axis is None:
        return ScreenAxes(file.up(None, None))
    if right_axis is not None and right_axis[1] == up_axis[1]:
        message = f"X_SCREEN is {right_axis} and Y_SCREEN {up_axis}, which are the "
        message += "same axis; "
        file.warn(
            "C3D105",
            f"{message}{up_axis} is used as up",
            f"{argument('source.up', 'Y')} or {argument('source.up', 'Z')}",
        )
    if up_axis not in _UP_CONVERSIONS:
        return ScreenAxes(UpAxis(up_axis[1]))
    axis, order, signs = _UP_CONVERSIONS[up_axis]
    message = f"has {up_axis} up; positions are rotated so that {axis} is up"
    file.note("C3D106", message)
    return ScreenAxes(axis, np.array(order), np.array(signs, np.float64))


def _read_axis(file: MarkerFile, sections: Sections, name: str) -> str | None:
    """Return a signed axis such as ``+Z``; None if missing or invalid."""
    texts = sections.texts("POINT", name)
    text = texts[0].strip() if texts else ""
    if not text:
        return None
    match = _AXIS.fullmatch(text.upper())
    if match is None:
        message = f"{name} is {excerpt(text)}, not one of +X, -X, +Y, -Y, +Z, -Z"
        file.warn(
            "C3D105",
            message,
            f"{argument('source.up', 'Y')} or {argument('source.up', 'Z')}",
        )
        return None
    return f"{match[1] or '+'}{match[2]}"


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
    file = MarkerFile(str(path))
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
    length_unit = file.unit(_length_unit(sections), unit, LengthUnit.MM)
    rate = file.rate(_frame_rate(file, sections, fps), fps)
    screen_axes = read_screen_axes(file, sections, up)
    positions, words = _read_points(sections, layout, data)
    names, columns = _marker_names(file, sections, layout.points, subject)
    positions, words = positions[:, columns], words[:, columns]
    positions[words < 0] = np.nan
    positions = screen_axes.convert(file.clean_positions(positions, length_unit.meters))
    visible = np.isfinite(positions[..., 0])
    residual_scale = abs(_point_scale(sections)) * length_unit.meters
    first_frame = _first_frame(sections, layout.frames)
    clock = Clock(rate, Fraction(first_frame), Fraction(1), layout.frames)
    return Markers(
        names,
        clock,
        positions,
        screen_axes.up,
        _camera_counts(words, visible),
        _residuals(words, visible, residual_scale),
        _filled_positions(sections, words, visible, columns),
        tuple(file.notices),
    )


def _find_layout(file: MarkerFile, sections: Sections, data: bytes) -> Layout:
    """Return the layout that fits the file; warn about contradicted claims."""
    claims = collect_declared_layouts(sections)
    ends = [*_data_ends(sections, len(data)), len(data)]
    result = choose_layout(
        claims,
        data,
        ends,
        lambda candidate: measure_evidence(candidate, data, sections.processor),
    )
    layout = result.layout
    if layout is None:
        raise _layout_error(file, result, len(data))
    if layout.points == 0 or layout.frames == 0:
        noun = "points" if layout.points == 0 else "frames"
        raise file.error("MKR013", f"has no {noun}")
    if layout.points * layout.frames > MAX_POSITIONS:
        message = f"claims {layout.points} points in {layout.frames} frames, "
        raise file.error("C3D001", message + "above the limit")
    candidates = [_candidate_text(*c) for c in contradicted_claims(claims, layout)]
    if candidates:
        message = "its header, parameters and size disagree; what matches the file "
        message += "size is "
        file.warn("C3D101", f"{message}read: {'; '.join(candidates)}")
    if layout.trailing_bytes >= min(
        BLOCK_BYTES, layout.width * layout.numbers_per_frame
    ) or (layout.trailing_bytes and len(data) % BLOCK_BYTES):
        message = f"has {counted(layout.trailing_bytes, 'byte')} after the last of "
        message += f"{counted(layout.frames, 'frame')}, which are ignored"
        file.warn("C3D108", message, "check the number of frames")
    return layout


def _data_ends(sections: Sections, size: int) -> list[int]:
    """Return byte offsets where points may end before the end of the file."""
    rotation_block = unsigned_word(sections, "ROTATION", "DATA_START")
    rotations = sections.number("ROTATION", "USED")
    if not rotation_block or not rotations or not rotation_block > 2:
        return []
    return [end for end in [BLOCK_BYTES * (rotation_block - 1)] if end < size]


def _layout_error(file: MarkerFile, result: LayoutResult, size: int) -> FormatError:
    """Return the error for a file whose size fits no combination of counts."""
    if len(result.ambiguous_layouts) == 1:
        (rival,) = result.ambiguous_layouts
        message = f"its counts do not match its size of {size} bytes: {rival} end at "
        message += f"{rival.end}, and are not positions"
        return file.error("C3D003", message, "export it again")
    if result.ambiguous_layouts:
        message = "its header, parameters and size disagree, and nothing resolves it: "
        message += f"between {' or '.join(map(str, result.ambiguous_layouts))}"
        return file.error("C3D003", message, "export it again")
    truncated = result.truncated
    if truncated is None or not truncated.points or not truncated.frames:
        return file.error("MKR013", "has no points in frames")
    available_bytes = max(0, size - truncated.begin)
    message = (
        f"is truncated: it claims {truncated}, {truncated.end - truncated.begin} "
        f"bytes; it has {available_bytes}, "
        f"{available_bytes // (truncated.width * truncated.numbers_per_frame)} frames"
    )
    return file.error("C3D002", message, "copy or export it again")


_QUANTITIES = {
    "frames": "frames",
    "points": "points",
    "analog": "analogue values per frame",
    "width": "bytes per number",
    "begin": "bytes before the first frame",
}


def _candidate_text(name: str, value: int, contradicting: list[Claim]) -> str:
    claims = ", ".join(f"{claim.value} ({claim.source})" for claim in contradicting)
    return f"{value} {_QUANTITIES[name]}, not {claims}"


def _first_frame(sections: Sections, frames: int) -> int:
    """Return the first frame number, which may exceed the 16 bits of the header."""
    header = sections.header
    start, end = trial_frame_range(sections)
    if start is None or end is None or end - start + 1 != frames:
        return header.first
    is_header_valid = header.last - header.first + 1 == frames and end < WORD_RANGE
    return header.first if is_header_valid else start


def _point_scale(sections: Sections) -> float:
    """Return the scale of integers; negative means floats."""
    parameter_scale = sections.number("POINT", "SCALE")
    scale = sections.header.scale if parameter_scale is None else parameter_scale
    return scale if np.isfinite(scale) and scale != 0 else -1.0


def _check_scale(file: MarkerFile, sections: Sections, layout: Layout) -> None:
    """Warn about a scale that is missing or stated with two values."""
    header_scale = sections.header.scale
    parameter_scale = sections.number("POINT", "SCALE")
    if layout.width == 4:
        return
    scales = [abs(s) for s in (parameter_scale, header_scale) if s and np.isfinite(s)]
    if not scales:
        message = "has integers without a scale; they are read unscaled"
        file.warn("C3D101", message, "check the size of the captured subject")
    elif len(scales) == 2 and not math.isclose(scales[0], scales[1], rel_tol=1e-4):
        message = f"its header has the scale {scales[1]:g}, but its parameters "
        message += f"{scales[0]:g}"
        file.warn("C3D101", f"{message}; using the parameters")


def _frame_rate(
    file: MarkerFile, sections: Sections, fps: FractionLike | None
) -> float | None:
    """Return the stated frame rate; parameters come before the header."""
    header_rate, parameter_rate = sections.header.rate, sections.number("POINT", "RATE")
    if not parameter_rate or not np.isfinite(parameter_rate):
        return header_rate
    are_close = np.isclose(header_rate, parameter_rate, rtol=1e-4)
    if fps is None and header_rate > 0 and not are_close:
        message = f"its header has {header_rate:g} fps, but its parameters "
        message += f"{parameter_rate:g}"
        file.warn("C3D101", f"{message}; using the parameters")
    return parameter_rate


def _length_unit(sections: Sections) -> str | None:
    texts = sections.texts("POINT", "UNITS")
    return texts[0] if texts else None


def _read_points(
    sections: Sections, layout: Layout, data: bytes
) -> tuple[FloatArray, IntArray]:
    """Return positions ``(F, M, 3)`` in file units, and the status words ``(F, M)``."""
    data_bytes = data[layout.begin : layout.end]
    rows = sections.processor.rows(
        data_bytes, layout.width, layout.numbers_per_frame, 4 * layout.points
    )
    rows = rows.reshape(layout.frames, layout.points, 4)
    positions = np.ascontiguousarray(rows[..., :3])
    if layout.width == 2:
        positions *= abs(_point_scale(sections))
    fourth_words = rows[..., 3]
    is_valid_word = np.isfinite(fourth_words) & (np.abs(fourth_words) < 2**31)
    # The sign of the last word marks a point as not visible.
    words = np.where(
        is_valid_word, fourth_words, np.where(fourth_words < 0, -1.0, 0.0)
    ).astype(np.int64)
    words[fourth_words < 0] = -1
    return positions, words


def _marker_names(
    file: MarkerFile, sections: Sections, point_count: int, subject: str | None
) -> tuple[tuple[str, ...], IntArray]:
    """Return marker names and point indices, without model outputs."""
    labels = sections.texts("POINT", "LABELS")
    if len(labels) < point_count:
        message = f"names {len(labels)} of {counted(point_count, 'point')}"
        file.warn("C3D102", f"{message}; the others are unlabelled points")
    labels = [*labels[:point_count], *[""] * (point_count - len(labels))]
    model_labels = {
        label
        for group in MODEL_OUTPUT_PARAMETERS
        for label in sections.texts("POINT", group)
        if label
    }
    columns = np.array([i for i, name in enumerate(labels) if name not in model_labels])
    if len(columns) < point_count:
        skipped_labels = [name for name in labels if name in model_labels]
        message = f"{counted(len(skipped_labels), 'result')} of models skipped: "
        file.note("C3D103", message + listed(skipped_labels))
    if not len(columns):
        raise file.error("MKR013", "has no marker points")
    return file.names([labels[i] for i in columns.tolist()], subject), columns


def _camera_counts(words: IntArray, visible: BoolArray) -> IntArray | None:
    """Return how many of seven cameras saw each position; None if not stated."""
    mask = np.where(visible, (words >> 8) & 0x7F, 0)
    if not mask.any():
        return None
    return sum(((mask >> bit) & 1 for bit in range(7)), np.zeros_like(mask))


def _residuals(words: IntArray, visible: BoolArray, scale: float) -> FloatArray | None:
    """Return residuals [m]; NaN where the position was not measured."""
    residual_steps = words & 0xFF
    is_measured = visible & (residual_steps > 0)
    if not is_measured.any():
        return None
    return np.where(is_measured, residual_steps * scale, np.nan)


def _filled_positions(
    sections: Sections, words: IntArray, visible: BoolArray, columns: IntArray
) -> BoolArray | None:
    """Return which positions were filled rather than measured ``(F, M)``.

    animtool lists them in its own parameter group. In other files, a residual and
    cameras of 0 mean filled if other positions have nonzero ones.
    """
    animtool_group = sections.groups.get(ANIMTOOL_GROUP)
    if animtool_group is not None:
        return _read_filled_group(sections, visible, columns)
    if not (visible & (words > 0)).any():
        return None
    is_filled = visible & (words == 0)
    return is_filled if is_filled.any() else None


def _read_filled_group(
    sections: Sections, visible: BoolArray, marker_columns: IntArray
) -> BoolArray | None:
    is_filled = np.zeros(visible.shape, bool)
    columns = {point: column for column, point in enumerate(marker_columns.tolist())}
    for value in sections.continued_values(ANIMTOOL_GROUP, "FILLED"):
        if not isinstance(value, np.ndarray) or not value.size:
            break
        for marker, first, last in value.ravel()[: value.size // 3 * 3].reshape(-1, 3):
            if np.isfinite([marker, first, last]).all() and marker in columns:
                begin = int(min(max(first, 0), len(visible)))
                end = int(min(max(last + 1, 0), len(visible)))
                is_filled[begin:end, columns[int(marker)]] = True
    is_filled &= visible
    return is_filled if is_filled.any() else None
