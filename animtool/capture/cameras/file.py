"""Camera files, ``*.cameras.yaml``, and calibrations as other programs write them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from annotated_types import Len
from pydantic import Field

from animtool.capture.cameras.camera import (
    DEFAULT_CAMERA_NAME,
    MAX_CAMERAS,
    MAX_IMAGE_SIDE,
    Camera,
    Cameras,
    nearest_rotation,
)
from animtool.capture.cameras.plausible import warn_of_focal_lengths, warn_of_spread
from animtool.core.array_types import FloatArray
from animtool.core.errors import Fault, FormatError
from animtool.core.files.reading import require_file
from animtool.core.names import FILE_KINDS
from animtool.core.options import key
from animtool.core.units import LengthUnit, UpAxis
from animtool.documents.check import FileModel, validate_file
from animtool.documents.document import Document
from animtool.documents.fields import IgnoreModel, Name, Quaternion, Real, Vector
from animtool.maths.so3 import to_matrix

FocalLength = Annotated[Real, Field(gt=0)]
ImageSide = Annotated[int, Field(ge=1, le=MAX_IMAGE_SIDE)]


class CameraUnitsModel(FileModel):
    """Key ``units`` of a camera file: the unit of its translations."""

    length: Literal["m", "cm", "mm", "in"] = key(
        "Unit of translations. Focal lengths and centres are in pixels.",
        "mm",
        default="m",
    )


class CameraModel(FileModel):
    """An entry of ``views``: `x_camera = rotation * x_world + translation`."""

    name: Name = key("Unique name of the camera.", "cam01")
    size: Annotated[list[ImageSide], Len(2, 2)] | None = key(
        "Width and height of its images in pixels. Pixels outside are reported.",
        [1920, 1080],
        default=None,
    )
    focal: Annotated[list[FocalLength], Len(2, 2)] = key(
        "Focal lengths along x and y in pixels.", [1334.4, 1333.1]
    )
    centre: Annotated[list[Real], Len(2, 2)] = key(
        "The principal point in pixels.", [949.9, 539.3]
    )
    skew: Real = key("Skew of the image axes in pixels.", 0.5, default=0.0)
    distortion: Annotated[list[Real], Len(0, 8)] = key(
        "k1, k2, p1, p2, k3, k4, k5, k6 of the lens, in OpenCV's order; trailing "
        "ones can be omitted.",
        [-0.073, 0.006, 0, 0, 0],
        default=[],
    )
    rotation: Annotated[list[Vector], Len(3, 3)] | Quaternion = key(
        "Rotation from the world to the camera, which looks along z with y down: a "
        "matrix by rows, or `[w, x, y, z]`.",
        [0.7, 0.0, 0.7, 0.0],
    )
    translation: Vector = key(
        "Position of the world's origin in the camera's frame.", [-0.08, 0.92, 4.72]
    )


class CamerasModel(FileModel):
    """Schema of a camera file, ``*.cameras.yaml``."""

    cameras: Literal["animtool/1"] = key("File type and format version.", "animtool/1")
    units: CameraUnitsModel = key(
        "Units of the numbers.", {"length": "mm"}, default=CameraUnitsModel()
    )
    up: Literal["Y", "Z"] = key("The axis of the world that points up.", "Z", "Y")
    views: Annotated[list[CameraModel], Len(1, MAX_CAMERAS)] = key(
        "The cameras, in the order of the observations.",
        [
            {
                "name": "cam01",
                "focal": [1334.4, 1333.1],
                "centre": [949.9, 539.3],
                "rotation": [1, 0, 0, 0],
                "translation": [0, 0, 4],
            }
        ],
    )
    ignore: list[IgnoreModel] = key(
        "Findings of `animtool validate` that are accepted.",
        [{"code": "CAM002", "why": "this is intended"}],
        default=[],
    )


def parse_cameras(
    document: Document, unit: LengthUnit | None = None, up: UpAxis | None = None
) -> Cameras:
    """Convert the document of a ``*.cameras.yaml`` file to cameras, and check them.

    ``unit`` and ``up`` apply if the file states none.
    """
    model = validate_file(document, "cameras", CamerasModel)
    is_unit_stated = "length" in model.units.model_fields_set
    if unit is None or is_unit_stated:
        unit = LengthUnit(model.units.length)
    if up is None or "up" in model.model_fields_set:
        up = UpAxis(model.up)
    scale = unit.meters
    cameras: list[Camera] = []
    index_by_name: dict[str, int] = {}
    for i, view in enumerate(model.views):
        if view.name in index_by_name:
            message = f"two cameras are called {view.name!r}"
            hint = f"the first is views[{index_by_name[view.name]}]"
            document.add("CAM002", ("views", i, "name"), message, hint)
        index_by_name.setdefault(view.name, i)
        rotation = _rotation_matrix(view.rotation)
        if rotation is None:
            message = "is not a rotation"
            hint = "write orthogonal, right-handed rows of length 1, or [w, x, y, z]"
            document.add("CAM001", ("views", i, "rotation"), message, hint)
            continue
        cameras.append(
            Camera(
                view.name,
                (view.focal[0], view.focal[1]),
                (view.centre[0], view.centre[1]),
                rotation,
                np.array(view.translation) * scale,
                None if view.size is None else (view.size[0], view.size[1]),
                view.skew,
                (*view.distortion, *[0.0] * (8 - len(view.distortion))),
            )
        )
    document.check()
    location = ("units", "length") if is_unit_stated else ("views", 0, "translation")
    stated_unit = unit if is_unit_stated else None
    warn_of_spread(document, location, cameras, unit, stated_unit)
    focal_locations = [("views", i, "focal") for i in range(len(cameras))]
    warn_of_focal_lengths(document, focal_locations, cameras)
    notices = tuple(document.notices)
    return Cameras(tuple(cameras), up, str(document.path), notices)


def _rotation_matrix(value: list[list[float]] | list[float]) -> FloatArray | None:
    """Return ``(3, 3)`` from a matrix or quaternion (w, x, y, z); None if invalid."""
    numbers = np.array(value, np.float64)
    if numbers.ndim == 2:
        return nearest_rotation(numbers)
    norm = float(np.linalg.norm(numbers))
    if not 0.99 < norm < 1.01:
        return None
    return to_matrix(np.roll(numbers / norm, -1))


def load_cameras(
    path: Path | str, *, unit: LengthUnit | None = None, up: UpAxis | None = None
) -> Cameras:
    """Read calibrated cameras, from animtool, OpenCV, Pose2Sim or anipose.

    Args:
        path: A camera file (``cameras: animtool/1``), an OpenCV FileStorage in YAML or
            JSON, a JSON file with a list of cameras with ``K``, ``R``, ``t`` and
            ``dist``, or a TOML file of Pose2Sim or anipose.
        unit: Unit of translations, if the file does not state it; metres if not given.
        up: The world's up axis, if the file does not state it.

    Raises:
        FormatError: The file cannot be read or is malformed; lists every fault.
    """
    from animtool.capture.cameras.calibrations import (
        parse_calibration,
        read_camera_document,
    )

    require_file(Path(path), "cameras")
    document = read_camera_document(Path(path))
    versions = [document.value.get(kind) for kind in FILE_KINDS]
    is_animtool_file = any(str(text).startswith("animtool/") for text in versions)
    if is_animtool_file or isinstance(document.value.get("cameras"), str):
        return parse_cameras(document, unit, up)
    return parse_calibration(document, unit, up)


def load_all_cameras(
    paths: Sequence[Path], *, unit: LengthUnit | None = None, up: UpAxis | None = None
) -> Cameras:
    """Load cameras from one or more files, such as one file per camera.

    A camera without a name in its file is named after the file.
    """
    camera_sets = [load_cameras(path, unit=unit, up=up) for path in paths]
    if len(camera_sets) == 1:
        return camera_sets[0]
    cameras: dict[str, Camera] = {}
    for path, camera_set in zip(paths, camera_sets, strict=True):
        if camera_set.up != camera_sets[0].up:
            first_axis_text = f"that of {paths[0].name} is {camera_sets[0].up}"
            message = f"its up axis is {camera_set.up}, but {first_axis_text}"
            hint = "calibrate all cameras in one world, and write its `up` in each file"
            raise FormatError(Fault("CAM003", message, str(path), hint=hint))
        for camera in camera_set.cameras:
            is_unnamed = len(camera_set) == 1 and camera.name == DEFAULT_CAMERA_NAME
            name = path.name.partition(".")[0] if is_unnamed else camera.name
            if name in cameras:
                message = f"two cameras are called {name!r}"
                raise FormatError(Fault("CAM002", message, str(path)))
            cameras[name] = replace(camera, name=name)
    notices = tuple(note for camera_set in camera_sets for note in camera_set.notices)
    return Cameras(tuple(cameras.values()), camera_sets[0].up, str(paths[0]), notices)
