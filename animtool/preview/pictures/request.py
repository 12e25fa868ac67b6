"""Parses picture options: size, camera, light, layers."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence

import numpy as np

from animtool.core.array_types import FloatArray
from animtool.core.errors import Fault, OptionError
from animtool.core.names import most_similar
from animtool.core.record import dataclass
from animtool.preview.options import PictureOptions
from animtool.preview.pictures.camera import (
    KEY_LIGHT,
    MAX_PITCH,
    VIEW_ANGLES,
    CameraView,
    spherical_offset,
)
from animtool.preview.pictures.kinds import PictureKind
from animtool.preview.pictures.scene import DEFAULT_LAYERS, LAYERS

SHEET_PICTURE_SIZE = (480, 360)
# Smallest and largest size of a picture [px], and most cells of a sheet.
MIN_SIZE, MAX_SIZE, MAX_SHEET_PICTURES = 16, 8192, 400
_SIZE_PAIR_PATTERN = re.compile(r"(\d{1,5})x(\d{1,5})")
_SHOT_CAMERA_PATTERN = re.compile(r"shot:(\d{1,6})")


@dataclass(frozen=True, slots=True)
class CameraChoice:
    """A requested camera: an orbit, a framed view, or a shot camera.

    Attributes:
        yaw: Angle around the subject [rad].
        pitch: Angle above the horizon [rad].
        distance: Distance from the target [m]; None frames everything.
        target: Point that it looks at [m]; empty is the center.
        shot: Index of a shot camera of the page; None uses the orbit camera.
    """

    yaw: float = VIEW_ANGLES["home"][0]
    pitch: float = VIEW_ANGLES["home"][1]
    distance: float | None = None
    target: tuple[float, ...] = ()
    shot: int | None = None

    def aim(self, view: CameraView) -> None:
        """Set the yaw and pitch of a view before it is framed."""
        view.yaw, view.pitch = self.yaw, min(max(self.pitch, -MAX_PITCH), MAX_PITCH)

    def position(self, view: CameraView) -> None:
        """Set the distance and target of a framed view, if the choice has them."""
        if self.distance is not None:
            view.distance, view.target = self.distance, np.array(self.target)


def option_error(option: str, message: str, hint: str) -> OptionError:
    """Return the error for an invalid picture option."""
    return OptionError(Fault("PRV006", message, hint=hint, where=option))


def picture_size(
    options: PictureOptions, kind: PictureKind, *, is_sheet: bool
) -> tuple[int, int]:
    """Return the requested or default size of a picture or film [px]."""
    if options.size is None:
        return SHEET_PICTURE_SIZE if is_sheet else kind.size
    width, height = _parse_pair(options.size, "size", "960x540")
    if not (MIN_SIZE <= width <= MAX_SIZE and MIN_SIZE <= height <= MAX_SIZE):
        message = (
            f"invalid size {options.size}: {MIN_SIZE} to {MAX_SIZE} pixels per side"
        )
        raise option_error("size", message, "write 960x540, for example")
    return width, height


def sheet_layout(options: PictureOptions) -> tuple[int, int] | None:
    """Return the number of columns and rows of a requested sheet, or None."""
    if options.sheet is None:
        return None
    columns, rows = _parse_pair(options.sheet, "sheet", "4x3")
    if not 1 <= columns * rows <= MAX_SHEET_PICTURES:
        message = f"a sheet of {options.sheet} pictures"
        raise option_error(
            "sheet", message, f"use 1 to {MAX_SHEET_PICTURES} of them, such as 4x3"
        )
    return columns, rows


def _parse_pair(text: str, option: str, example: str) -> tuple[int, int]:
    """Return the two numbers of a text such as `960x540`; refuse any other text."""
    match = _SIZE_PAIR_PATTERN.fullmatch(text.strip().lower())
    if match is None:
        raise option_error(
            option,
            f"{text!r} is not two whole numbers",
            f"write {example}, for example",
        )
    return int(match[1]), int(match[2])


def drawn_layers(options: PictureOptions) -> frozenset[str]:
    """Return the requested layers, or the default ones; refuse unknown names."""
    for name in options.show:
        if name not in LAYERS:
            message = f"unknown part of a picture {name!r}"
            raise option_error("show", message, f"allowed: {', '.join(LAYERS)}")
    return frozenset(options.show) or DEFAULT_LAYERS


def light_direction(options: PictureOptions) -> FloatArray:
    """Return the direction to the key light ``(3,)`` in view space."""
    if options.light is None:
        return KEY_LIGHT.copy()
    numbers = _parse_numbers(options.light)
    if len(numbers) != 2:
        message = f"{options.light!r} is not two angles in degrees"
        raise option_error("light", message, "write -27,40, for example")
    return spherical_offset(*map(math.radians, numbers))


def camera_choice(text: str, camera_names: Sequence[str]) -> CameraChoice:
    """Return a camera choice; ``camera_names`` are the page's shot cameras."""
    text = text.strip()
    if text in VIEW_ANGLES:
        return CameraChoice(*VIEW_ANGLES[text])
    if text in camera_names:
        return CameraChoice(shot=camera_names.index(text))
    if match := _SHOT_CAMERA_PATTERN.fullmatch(text):
        if int(match[1]) < len(camera_names):
            return CameraChoice(shot=int(match[1]))
    else:
        numbers = _parse_numbers(text)
        if len(numbers) == 2:
            return CameraChoice(math.radians(numbers[0]), math.radians(numbers[1]))
        # In the format of a page's address.
        if len(numbers) == 6 and numbers[2] > 0:
            yaw, pitch, distance, *target = numbers
            return CameraChoice(yaw, pitch, distance, tuple(target))
    all_names = [*VIEW_ANGLES, *camera_names]
    similar_name = most_similar(text, all_names)
    hint = (
        f"did you mean {similar_name!r}?"
        if similar_name
        else f"allowed: {', '.join(all_names)}"
    )
    hint += "; or YAW,PITCH in degrees, or the `cam` of a page's address"
    raise option_error("camera", f"unknown camera {text!r}", hint)


def _parse_numbers(text: str) -> list[float]:
    """Return comma-separated finite numbers; empty if invalid."""
    try:
        numbers = [float(number_text) for number_text in text.split(",")]
    except ValueError:
        return []
    return numbers if all(map(math.isfinite, numbers)) else []
