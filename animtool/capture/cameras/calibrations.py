"""Reads camera calibrations of OpenCV, Pose2Sim and anipose.

References:
    OpenCV, ``FileStorage``; Pagnon et al., Pose2Sim, 2021; Karashchuk et al.,
    Anipose, 2021. All have world to camera, rotations as matrices or as
    rotation vectors, and the lens as OpenCV.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from animtool.capture.cameras.camera import (
    DEFAULT_CAMERA_NAME,
    MAX_IMAGE_SIDE,
    Camera,
    Cameras,
    nearest_rotation,
)
from animtool.capture.cameras.plausible import warn_of_focal_lengths, warn_of_spread
from animtool.core.array_types import FloatArray
from animtool.core.config import parse_toml
from animtool.core.errors import Fault, FormatError, excerpt, listed
from animtool.core.record import dataclass
from animtool.core.units import LengthUnit, UpAxis
from animtool.documents.document import Document, Location, parse_document, read_text
from animtool.documents.fields import MAX_NUMBER
from animtool.documents.yaml_values import SourceMarks
from animtool.maths.so3 import exp, to_matrix

# Names of a value in other programs, in order of preference.
_QUANTITY_KEYS = {
    "matrix": ("K", "camera_matrix", "cameraMatrix", "matrix", "intrinsics"),
    "distortion": (
        "dist",
        "distortion_coefficients",
        "distCoeffs",
        "dist_coeffs",
        "distortions",
        "distortion",
        "D",
    ),
    "rotation": ("R", "rotation", "rvec", "rotation_matrix"),
    "translation": ("t", "T", "translation", "tvec", "translation_vector"),
    "size": ("size", "image_size"),
}
_SIZE_KEYS = (("width", "height"), ("image_width", "image_height"))
# OpenCV's numbers of distortion coefficients. Those after the eighth, for a thin prism
# and a tilted sensor, are not modelled.
_COEFFICIENT_COUNTS = (0, 4, 5, 8, 12, 14)
MAX_MODELLED_COEFFICIENTS = 8
_TOML_TABLE = re.compile(r"^\s*\[\s*\"?([^\"\]]+?)\"?\s*\]")


def read_camera_document(path: Path) -> Document:
    """Parse a camera file in YAML, JSON, TOML or OpenCV storage to a document."""
    text = read_text(path)
    if path.suffix.lower() == ".toml":
        return _parse_toml(text, path)
    if "opencv-matrix" in text and not text.lstrip().startswith("{"):
        # OpenCV writes a YAML 1.0 header; its matrix tag repeats what rows and cols
        # say.
        text = re.sub(r"\A\ufeff?%YAML[^\n]*", "", text)
        text = text.replace("!!opencv-matrix", "")
    return parse_document(text, path)


def _parse_toml(text: str, path: Path) -> Document:
    """Parse TOML text to a document that records the lines of its tables."""
    try:
        value = parse_toml(text)
    except ValueError as error:
        match = re.search(r"at line (\d+)", str(error))
        lines = (int(match[1]),) if match else ()
        message = f"invalid TOML: {str(error).split(' (at ')[0]}"
        raise FormatError(Fault("CAM003", message, str(path), lines)) from error
    line_of_table: dict[str, int] = {}
    for line_number, row in enumerate(text.splitlines(), 1):
        table = _TOML_TABLE.match(row)
        if table is not None:
            line_of_table.setdefault(table[1], line_number)
    positions = [(1, 1)]
    for key, table_value in value.items():
        line = line_of_table.get(key, 1)
        positions += [(line, 1)] * (1 + _count_nodes(table_value))
    return Document(path, value, lambda: SourceMarks(positions, {}))


def _count_nodes(value: Any) -> int:
    """Return the number of document nodes in a value, including keys and items."""
    if isinstance(value, dict):
        return 1 + len(value) + sum(map(_count_nodes, value.values()))
    return 1 + sum(map(_count_nodes, value)) if isinstance(value, list) else 1


def parse_calibration(
    document: Document, unit: LengthUnit | None, up: UpAxis | None
) -> Cameras:
    """Convert a calibration of OpenCV, Pose2Sim or anipose to cameras."""
    stated_unit = _stated_unit(document)
    unit = unit or stated_unit or LengthUnit.M
    scale = unit.meters
    camera_tables = list(_find_camera_tables(document.value))
    if not camera_tables:
        message = "holds no cameras"
        hint = "animtool reads cameras: animtool/1, OpenCV, Pose2Sim and anipose"
        document.add("CAM003", (), message, hint)
    cameras: list[Camera] = []
    for location, name, table in camera_tables:
        camera = _CameraTable(document, location, table).read_camera(name, scale)
        if camera is None:
            continue
        if camera.name in {earlier_camera.name for earlier_camera in cameras}:
            message = f"two cameras are called {camera.name!r}"
            document.add("CAM002", location, message)
        cameras.append(camera)
    document.check()
    unit_location: Location = () if stated_unit is None else ("units",)
    warn_of_spread(document, unit_location, cameras, unit, stated_unit)
    warn_of_focal_lengths(
        document, [location for location, _, _ in camera_tables], cameras
    )
    notices = tuple(document.notices)
    return Cameras(tuple(cameras), up or UpAxis.Y, str(document.path), notices)


def _stated_unit(document: Document) -> LengthUnit | None:
    """Return the unit that a document states, or None; record a fault if unknown."""
    location: Location = ("units",)
    stated_unit = document.value.get("units")
    if isinstance(stated_unit, dict) and "length" in stated_unit:
        stated_unit, location = stated_unit["length"], ("units", "length")
    if stated_unit is None or isinstance(stated_unit, dict):
        return None
    if isinstance(stated_unit, str) and stated_unit in set(LengthUnit):
        return LengthUnit(stated_unit)
    hint = f"allowed: {', '.join(LengthUnit)}"
    document.add("CAM003", location, f"unknown unit {excerpt(str(stated_unit))}", hint)
    return None


def _find_camera_tables(
    value: dict[str, Any],
) -> Iterator[tuple[Location, str, dict[str, Any]]]:
    """Yield location, default name and table of each camera in a calibration."""
    camera_list = value.get("cameras")
    if isinstance(camera_list, list):
        for i, table in enumerate(camera_list):
            if isinstance(table, dict):
                yield ("cameras", i), f"cam{i:02d}", table
    elif _is_camera(value):
        yield (), DEFAULT_CAMERA_NAME, value
    else:
        tables = camera_list if isinstance(camera_list, dict) else value
        parent: Location = ("cameras",) if isinstance(camera_list, dict) else ()
        for name, table in tables.items():
            if isinstance(table, dict) and _is_camera(table):
                yield (*parent, name), name, table


def _is_camera(value: Mapping[str, Any]) -> bool:
    """Return whether a table has a camera matrix, under any of its names."""
    return any(key in value for key in _QUANTITY_KEYS["matrix"])


@dataclass(frozen=True, slots=True)
class _CameraTable:
    """The table of one camera in a calibration; records faults in its document."""

    document: Document
    location: Location
    value: dict[str, Any]

    def read_camera(self, name: str, scale: float) -> Camera | None:
        """Convert the table to a camera; record faults and return None if invalid."""
        if self.value.get("fisheye") is True:
            message = "fisheye lenses are not supported"
            hint = "undistort the pixels first, and write a lens without distortion"
            self.document.add("CAM003", (*self.location, "fisheye"), message, hint)
            return None
        matrix = self._read_numbers("matrix", (3, 3))
        lens = self._read_numbers("distortion", None)
        rotation = self._read_numbers("rotation", None)
        translation = self._read_numbers("translation", (3,))
        size = self._read_size()
        if matrix is None or rotation is None or translation is None or lens is None:
            return None
        if not self._check_matrix(matrix):
            return None
        rotation_matrix = self._read_rotation(rotation)
        if rotation_matrix is None or not self._check_lens(lens):
            return None
        stated_name = self.value.get("name")
        return Camera(
            stated_name if isinstance(stated_name, str) and stated_name else str(name),
            (float(matrix[0, 0]), float(matrix[1, 1])),
            (float(matrix[0, 2]), float(matrix[1, 2])),
            rotation_matrix,
            translation * scale,
            size,
            float(matrix[0, 1]),
            (*lens.ravel().tolist(), *[0.0] * MAX_MODELLED_COEFFICIENTS)[
                :MAX_MODELLED_COEFFICIENTS
            ],
        )

    def _key_of(self, quantity: str) -> str | None:
        """Return the first of a quantity's names that the table has, or None."""
        return next(
            (key for key in _QUANTITY_KEYS[quantity] if key in self.value), None
        )

    def _add_fault(
        self, code: str, quantity: str, message: str, hint: str | None = None
    ) -> None:
        """Record a fault at the key of a quantity."""
        key = self._key_of(quantity) or quantity
        self.document.add(code, (*self.location, key), message, hint)

    def _read_numbers(
        self, quantity: str, shape: tuple[int, ...] | None
    ) -> FloatArray | None:
        """Return the numbers of a quantity, or None after recording a fault."""
        key = self._key_of(quantity)
        if key is None:
            if quantity == "distortion":
                return np.zeros(0)
            message = f"the camera has no {quantity}"
            hint = f"write it as {listed(_QUANTITY_KEYS[quantity])}"
            if quantity in {"rotation", "translation"}:
                hint = f"only its lens is calibrated; {hint}"
            self.document.add("CAM003", self.location, message, hint)
            return None
        value = self.value[key]
        if isinstance(value, dict) and "data" in value:
            value = self._matrix_of_storage(value)
        try:
            numbers = np.array(value, np.float64)
        except (TypeError, ValueError, OverflowError):
            numbers = np.array(np.nan)
        if shape is not None and numbers.size == np.prod(shape):
            numbers = numbers.reshape(shape)
        message = ""
        if numbers.ndim == 0 or not np.isfinite(numbers).all():
            message = f"{key} is not a list of finite numbers"
        elif numbers.size and np.abs(numbers).max() > MAX_NUMBER:
            message = f"{key} has a number beyond {MAX_NUMBER:g}"
        elif shape is not None and numbers.shape != shape:
            message = f"{key} has shape {numbers.shape}, not {shape}"
        if message:
            self._add_fault("CAM003", quantity, message)
            return None
        return numbers

    def _matrix_of_storage(self, value: dict[str, Any]) -> Any:
        """Return the rows of a FileStorage matrix; None if it is malformed."""
        rows, columns, data = (value.get(key) for key in ("rows", "cols", "data"))
        if not (isinstance(rows, int) and isinstance(columns, int)):
            return None
        if not isinstance(data, list) or not rows > 0 < columns:
            return None
        if rows * columns != len(data):
            return None
        return [data[i * columns : (i + 1) * columns] for i in range(rows)]

    def _check_matrix(self, matrix: FloatArray) -> bool:
        """Return whether a matrix is a camera matrix; record a fault otherwise."""
        constant_elements = [*matrix[1:, 0], matrix[2, 1], matrix[2, 2] - 1]
        is_valid = (
            matrix[0, 0] > 0 and matrix[1, 1] > 0 and np.allclose(constant_elements, 0)
        )
        if not is_valid:
            hint = "write [[fx, s, cx], [0, fy, cy], [0, 0, 1]] with fx and fy above 0"
            self._add_fault("CAM003", "matrix", "is not a camera matrix", hint)
        return bool(is_valid)

    def _read_rotation(self, value: FloatArray) -> FloatArray | None:
        """Return a rotation matrix; record a fault and return None if it is invalid."""
        if value.size == 3:
            return to_matrix(exp(value.ravel()))
        rotation_matrix = (
            nearest_rotation(value.reshape(3, 3)) if value.size == 9 else None
        )
        if rotation_matrix is None:
            hint = "write a matrix with orthogonal rows of length 1, or a rotation "
            hint += "vector"
            self._add_fault("CAM001", "rotation", "is not a rotation", hint)
        return rotation_matrix

    def _check_lens(self, value: FloatArray) -> bool:
        """Return whether a lens is supported; record a fault otherwise."""
        if value.size not in range(9) and value.size not in _COEFFICIENT_COUNTS:
            message = f"{value.size} numbers do not make an OpenCV lens"
            self._add_fault("CAM003", "distortion", message)
            return False
        if value.ravel()[MAX_MODELLED_COEFFICIENTS:].any():
            message = "thin prisms and tilted sensors are not supported"
            hint = "calibrate without them: k1, k2, p1, p2, k3 to k6"
            self._add_fault("CAM003", "distortion", message, hint)
            return False
        return True

    def _read_size(self) -> tuple[int, int] | None:
        """Return width and height of the image [px]; None if unknown."""
        key = self._key_of("size")
        size: Any = None if key is None else self.value[key]
        for width, height in _SIZE_KEYS:
            if width in self.value and height in self.value:
                size, key = [self.value[width], self.value[height]], width
        if size is None or key is None:
            return None
        try:
            sides = [int(side) for side in size]
        except (TypeError, ValueError, OverflowError):
            sides = []
        if len(sides) != 2 or not all(0 < side <= MAX_IMAGE_SIDE for side in sides):
            message = "is not the width and height of an image"
            self.document.add("CAM003", (*self.location, key), message)
            return None
        return sides[0], sides[1]
