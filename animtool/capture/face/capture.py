"""Face landmarks from files, matched to those of a rig."""

from __future__ import annotations

import re
from collections.abc import Sequence
from fractions import Fraction
from functools import partial
from pathlib import Path

import numpy as np

from animtool.capture.face.model import FaceModel
from animtool.core.arguments import argument
from animtool.core.array_types import FloatArray
from animtool.core.clock import Clock
from animtool.core.errors import (
    Fault,
    FormatError,
    OptionError,
    Severity,
    counted,
    listed,
    names_fault,
)
from animtool.core.names import name_hint
from animtool.core.rates import (
    FractionLike,
    RateError,
    parse_rate,
    rate_from_float,
    rate_option,
)
from animtool.core.readers import find_reader
from animtool.core.record import dataclass
from animtool.core.units import LengthUnit, UpAxis
from animtool.documents.arrays import Archives, open_arrays
from animtool.documents.references import split_reference

_UNIT_SUFFIXES = {f"_{unit}": unit.meters for unit in LengthUnit}
_POINTS_ARRAY = re.compile(r"landmarks(_mm|_cm|_m|_in|_px)?")
MAX_POSITIONS = 200_000_000


@dataclass(frozen=True, slots=True)
class FaceCapture:
    """Landmarks of a face over frames."""

    path: Path  # the file
    # Names of the landmarks; None where the file has none.
    names: tuple[str, ...] | None
    clock: Clock  # times of the frames
    # World space [m] ``(F, N, 3)``, or of one camera [px] ``(F, N, 2)``; NaN where
    # missing.
    points: FloatArray
    up: UpAxis = UpAxis.Y  # the up axis of the world
    # The face that the same file contains; None if it has none.
    model: FaceModel | None = None
    notices: tuple[Fault, ...] = ()  # warnings

    @property
    def is_in_pixels(self) -> bool:
        """Whether the points are pixels of a camera, not positions."""
        return int(self.points.shape[-1]) == 2


def read_capture(
    path: Path | str,
    *,
    unit: LengthUnit | None = None,
    up: UpAxis | None = None,
    fps: FractionLike | None = None,
) -> FaceCapture:
    """Return the landmarks of a file: an npz, or any file of markers.

    An npz has positions ``landmarks_mm`` (or ``_cm``, ``_m``, ``_in``) ``(F, N, 3)`` or
    pixels ``landmarks_px`` ``(F, N, 2)``, and the rate ``fs``. Optional: the texts
    ``landmark_names``, and a face: ``neutral_mm`` ``(N, 3)``, ``delta_mm`` ``(S, N,
    3)``, the texts ``shape_names``.

    Args:
        path: The file; ``take.npz#landmarks_b_mm`` selects an array too.
        unit: Unit of positions; None takes it from the file.
        up: The up axis; None takes it from the file, else Y.
        fps: The frame rate; None takes it from the file.
    """
    path_text, array_name = split_reference(str(path), "")
    path = Path(path_text)
    if path.suffix.lower() != ".npz":
        reader = find_reader(path).markers_opener(path)
        markers = reader(path, unit=unit, up=up, fps=fps)
        labelled_names = [name for name in markers.names if not name.startswith("*")]
        return FaceCapture(
            path,
            tuple(markers.names) if len(labelled_names) == len(markers.names) else None,
            markers.clock,
            markers.positions,
            markers.up,
            notices=markers.notices,
        )
    with open_arrays(path, partial(_format_error, path)) as archives:
        return _read_arrays(archives, path, array_name, unit, up or UpAxis.Y, fps)


def _format_error(path: Path, message: str, hint: str | None = None) -> FormatError:
    """Return an error about an invalid array of a capture file (FAC003)."""
    return FormatError(Fault("FAC003", message, str(path), (), hint))


def _read_arrays(
    archives: Archives,
    path: Path,
    array_name: str,
    unit: LengthUnit | None,
    up: UpAxis,
    fps: FractionLike | None,
) -> FaceCapture:
    """Read and check the arrays of an npz that `read_capture` lists."""
    array_names = archives.names(path)
    point_arrays = [name for name in array_names if _POINTS_ARRAY.fullmatch(name)]
    if array_name:
        point_arrays = [array_name]
    if not point_arrays:
        hint = f"it holds {listed(array_names)}; landmarks_mm (F, N, 3) are positions "
        hint += "in mm"
        raise _format_error(path, "has no array landmarks_mm or landmarks_px", hint)
    array_name = point_arrays[0]
    header = archives.header(path, array_name)
    component_count = 2 if array_name.endswith("_px") else 3
    if (
        len(header.shape) != 3
        or header.shape[2] != component_count
        or header.kind not in "fiu"
    ):
        message = f"{array_name} has shape {header.shape}, not (frames, landmarks, "
        message += f"{component_count})"
        raise _format_error(path, message)
    frame_count, landmark_count, _ = header.shape
    if not 0 < frame_count * landmark_count <= MAX_POSITIONS:
        raise _format_error(
            path, f"{array_name} has {frame_count} frames of {landmark_count} landmarks"
        )
    scale = 1.0 if component_count == 2 else _unit_meters(array_name, unit)
    points = np.array(archives.load_stored(path, array_name), np.float64) * scale
    notices = []
    # NaN marks missing values; infinite ones count as missing too.
    is_infinite = np.isinf(points).any(axis=-1)
    if is_infinite.any():
        points[is_infinite] = np.nan
        message = f"{int(is_infinite.sum())} landmarks are infinite: treated as missing"
        notices.append(Fault("FAC106", message, str(path), severity=Severity.WARNING))
    names = None
    if "landmark_names" in array_names:
        names = tuple(archives.texts(path, "landmark_names"))
        if len(names) != landmark_count or len(set(names)) < landmark_count:
            message = (
                f"landmark_names has {len(set(names))} names for {landmark_count} "
            )
            message += "landmarks"
            raise _format_error(path, message)
    rate = _capture_rate(archives, path, array_names, fps)
    clock = Clock(rate, Fraction(1), Fraction(1), frame_count)
    model = _read_model(archives, path, array_names, names, unit)
    return FaceCapture(path, names, clock, points, up, model, tuple(notices))


def _unit_meters(array_name: str, unit: LengthUnit | None) -> float:
    """Return an array's unit [m]: the option, else the suffix of its name, else mm."""
    if unit is not None:
        return unit.meters
    return _UNIT_SUFFIXES.get(
        array_name[array_name.rfind("_") :] if "_" in array_name else "",
        LengthUnit.MM.meters,
    )


def _capture_rate(
    archives: Archives, path: Path, array_names: Sequence[str], fps: FractionLike | None
) -> Fraction:
    """Return ``fps``, or else the number ``fs`` of the file [Hz]."""
    if fps is not None:
        return rate_option(fps)
    if "fs" not in array_names:
        hint = f"set it with {argument('source.fps')}"
        raise _format_error(path, "states no rate (fs)", hint)
    stored_rates = archives.load_stored(path, "fs").ravel()
    try:
        return parse_rate(rate_from_float(float(stored_rates[0])))
    except (IndexError, RateError, ValueError, OverflowError) as error:
        message = f"fs is {stored_rates[:1].tolist()}, which is not a frame rate"
        raise _format_error(path, message) from error


def _read_model(
    archives: Archives,
    path: Path,
    array_names: Sequence[str],
    names: tuple[str, ...] | None,
    unit: LengthUnit | None,
) -> FaceModel | None:
    """Return the face model in an npz; None if the file has no face."""
    neutral_key, deltas_key = (
        next((key for key in array_names if re.match(pattern, key)), None)
        for pattern in (r"neutral(_|$)", r"deltas?(_|$)")
    )
    if neutral_key is None or deltas_key is None or "shape_names" not in array_names:
        return None

    def load_in_meters(key: str) -> FloatArray:
        """Read an array of lengths, converted to metres by its name or the option."""
        return np.asarray(archives.load(path, key) * _unit_meters(key, unit))

    neutral = load_in_meters(neutral_key)
    shapes = tuple(archives.texts(path, "shape_names"))
    landmark_names = tuple(map(str, range(len(neutral)))) if names is None else names
    try:
        return FaceModel(landmark_names, shapes, neutral, load_in_meters(deltas_key))
    except OptionError as error:
        faults = [
            Fault(f.code, f.message, str(path), hint=f.hint) for f in error.faults
        ]
        raise FormatError(faults) from error


def order_landmarks(
    capture: FaceCapture, model: FaceModel
) -> tuple[FloatArray, list[Fault]]:
    """Return landmarks in the order of a face model ``(F, N, …)``, and warnings.

    Named landmarks match by name, so that some may be missing; unnamed ones match by
    index.
    """
    path, landmark_count = str(capture.path), len(model.names)
    if capture.names is None or capture.names == model.names:
        if capture.points.shape[1] != landmark_count:
            message = f"has {counted(capture.points.shape[1], 'landmark')} without "
            message += f"names, but the face has {landmark_count}"
            hint = "write landmark_names in the npz to tell which are which"
            raise OptionError(Fault("FAC004", message, path, (), hint))
        return capture.points, []
    column_of_name = {name: i for i, name in enumerate(capture.names)}
    landmark_columns = [column_of_name.get(name, -1) for name in model.names]
    if max(landmark_columns) < 0:
        message = f"no landmark belongs to the face, such as {capture.names[0]!r}"
        hint = f"{name_hint(capture.names[0], model.names)}"
        raise OptionError(Fault("FAC004", message, path, (), hint))
    ordered_points = np.take(capture.points, landmark_columns, axis=1)
    ordered_points[:, np.array(landmark_columns) < 0] = np.nan
    notices = []
    for names, problem in (
        ([n for n in model.names if n not in column_of_name],
         "landmarks of the face are not in the capture: "),
        ([n for n in capture.names if n not in set(model.names)],
         "landmarks of the capture are not on the face: "),
    ):  # fmt: skip
        if names:
            message = f"{len(names)} {problem}"
            notices.append(
                names_fault("FAC107", message, names, path, severity=Severity.WARNING)
            )
    return ordered_points, notices
