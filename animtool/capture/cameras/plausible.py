"""Warnings about implausible cameras: their distances and focal lengths."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from animtool.capture.cameras.camera import Camera
from animtool.core.arguments import argument
from animtool.core.quantities import length_text
from animtool.core.units import LengthUnit, likely_unit
from animtool.documents.document import Document, Location

# Range of the largest distance of two cameras, from a stereo camera to a stadium [m].
MIN_CAMERA_SPREAD, MAX_CAMERA_SPREAD = 0.01, 300.0
# Largest distance of two cameras in a typical capture [m].
TYPICAL_CAMERA_SPREAD = 6.0

# Widest view that a lens without fisheye projection has [deg].
MAX_FIELD_OF_VIEW = 150.0
# Focal lengths below are a fraction of the image's width, not millimetres.
MAX_FOCAL_FRACTION = 3.0
# Width of the sensor that focal lengths in millimetres are usually stated for [mm].
FULL_FRAME_WIDTH = 36.0


def warn_of_focal_lengths(
    document: Document, locations: Sequence[Location], cameras: Sequence[Camera]
) -> None:
    """Warn if a camera's field of view is too wide for a focal length in px (CAM114).

    locations: Location of each camera's focal lengths.
    """
    wide_cameras = []
    for location, camera in zip(locations, cameras, strict=True):
        width = camera.size[0] if camera.size else 2 * camera.centre[0]
        field_of_view = math.degrees(2 * math.atan2(width / 2, camera.focal[0]))
        if width > 1 and field_of_view > MAX_FIELD_OF_VIEW:
            wide_cameras.append((location, camera.focal[0], width, field_of_view))
    if not wide_cameras:
        return
    location, focal, width, field_of_view = wide_cameras[0]
    message = f"a focal length of {focal:.4g} px for an image of {width:.5g} px is a "
    message += f"field of view of {field_of_view:.0f}°"
    if len(wide_cameras) > 1:
        message += f"; the same holds for {len(wide_cameras) - 1} more"
    size_product = f"{focal:.4g} * {width:.5g}"
    hint = f"focal lengths are in pixels: {focal:.4g} mm on a sensor of "
    hint += f"{FULL_FRAME_WIDTH:g} mm is {size_product} / {FULL_FRAME_WIDTH:g} = "
    hint += f"{focal * width / FULL_FRAME_WIDTH:.0f}"
    if focal <= MAX_FOCAL_FRACTION:
        hint = "focal lengths are in pixels: as a fraction of the image's width it is "
        hint += f"{size_product} = {focal * width:.0f}"
    document.warn("CAM114", location, message, hint)


def warn_of_spread(
    document: Document,
    location: Location,
    cameras: Sequence[Camera],
    unit: LengthUnit,
    stated_unit: LengthUnit | None,
) -> None:
    """Warn of cameras that are too far apart, or too close (CAM113).

    ``unit`` is that of the user, else the ``stated_unit`` of the file.
    ``location`` is where the file states the unit, or else the first translation.
    """
    positions = np.array([camera.position for camera in cameras]).reshape(-1, 3)
    offsets = positions[:, None] - positions
    spread = float(np.linalg.norm(offsets, axis=-1).max(initial=0.0))
    if (
        len(cameras) < 2
        or spread == 0
        or MIN_CAMERA_SPREAD <= spread <= MAX_CAMERA_SPREAD
    ):
        return
    nearest_unit, converted_spread = likely_unit(spread, unit, TYPICAL_CAMERA_SPREAD)
    message = f"the cameras are up to {length_text(spread)} apart"
    hint = f"are the translations in {unit}?"
    if MIN_CAMERA_SPREAD <= converted_spread <= MAX_CAMERA_SPREAD:
        message += f"; in {nearest_unit} it would be {length_text(converted_spread)}"
        hint = f"write units: {{length: {nearest_unit}}} in the file"
        if stated_unit is nearest_unit:
            hint = f"leave out {argument('source.unit', unit)}: the file states "
            hint += f"{stated_unit}"
        elif stated_unit is None:
            hint += f", or set {argument('source.unit', nearest_unit)}"
    document.warn("CAM113", location, message, hint)
