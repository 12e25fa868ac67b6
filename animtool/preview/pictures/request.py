"""Parses picture options: size, camera, light, layers."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence

import numpy as np

from animtool.core.array_types import FloatArray
from animtool.core.errors import Fault, OptionError
from animtool.core.record import dataclass
from animtool.core.similar import similar
from animtool.preview.options import PictureOptions
from animtool.preview.pictures.camera import LIGHT, PRESETS, STEEP, CameraView
from animtool.preview.pictures.kinds import PictureKind
from animtool.preview.pictures.scene import DEFAULT_LAYERS, LAYERS

CELL = (480, 360)
# Sizes of pictures, and cells of a sheet [px].
LEAST, MOST, MOST_CELLS = 16, 8192, 400
_PAIR = re.compile(r"(\d{1,5})x(\d{1,5})")
_SHOT = re.compile(r"shot:(\d{1,6})")


@dataclass(frozen=True, slots=True)
class CameraChoice:
    """Where a picture is taken from.

    Attributes:
        yaw: Around what is shown [rad].
        pitch: Likewise.
        distance: From the target [m]; None shows all.
        target: What it looks at [m].
        shot: Number of a camera of the page; None looks from outside.
    """

    yaw: float = PRESETS["home"][0]
    pitch: float = PRESETS["home"][1]
    distance: float | None = None
    target: tuple[float, ...] = ()
    shot: int | None = None

    def aim(self, view: CameraView) -> None:
        """Rotate a view before it is framed."""
        view.yaw, view.pitch = self.yaw, min(max(self.pitch, -STEEP), STEEP)

    def position(self, view: CameraView) -> None:
        """Place a view after it is framed, if a position is given."""
        if self.distance is not None:
            view.distance, view.target = self.distance, np.array(self.target)


def refused(where: str, message: str, hint: str) -> OptionError:
    """Return the error of an invalid picture option."""
    return OptionError(Fault("PRV006", message, hint=hint, where=where))


def size_of(
    options: PictureOptions, kind: PictureKind, *, sheet: bool
) -> tuple[int, int]:
    """Return the size of a picture [px]."""
    if options.size is None:
        return CELL if sheet else kind.size
    wide, high = _pair(options.size, "size", "960x540")
    if not (LEAST <= wide <= MOST and LEAST <= high <= MOST):
        message = f"invalid size {options.size}: {LEAST} to {MOST} pixels per side"
        raise refused("size", message, "write 960x540, for example")
    return wide, high


def sheet_of(options: PictureOptions) -> tuple[int, int] | None:
    """Return columns and rows of a sheet; None without one."""
    if options.sheet is None:
        return None
    columns, rows = _pair(options.sheet, "sheet", "4x3")
    if not 1 <= columns * rows <= MOST_CELLS:
        message = f"a sheet of {options.sheet} pictures"
        raise refused("sheet", message, f"use 1 to {MOST_CELLS} of them, such as 4x3")
    return columns, rows


def _pair(text: str, where: str, example: str) -> tuple[int, int]:
    match = _PAIR.fullmatch(text.strip().lower())
    if match is None:
        raise refused(
            where, f"{text!r} is not two whole numbers", f"write {example}, for example"
        )
    return int(match[1]), int(match[2])


def layers_of(options: PictureOptions) -> frozenset[str]:
    """Return the layers to draw."""
    for name in options.show:
        if name not in LAYERS:
            message = f"unknown part of a picture {name!r}"
            raise refused("show", message, f"allowed: {', '.join(LAYERS)}")
    return frozenset(options.show) or DEFAULT_LAYERS


def light_of(options: PictureOptions) -> FloatArray:
    """Return the direction of the key light in view space."""
    if options.light is None:
        light: FloatArray = LIGHT / np.linalg.norm(LIGHT)
        return light
    numbers = _numbers(options.light)
    if len(numbers) != 2:
        message = f"{options.light!r} is not two angles in degrees"
        raise refused("light", message, "write -27,40, for example")
    yaw, pitch = map(math.radians, numbers)
    level = math.cos(pitch)
    return np.array([math.sin(yaw) * level, math.sin(pitch), math.cos(yaw) * level])


def camera_of(text: str, names: Sequence[str]) -> CameraChoice:
    """Return a camera choice; names: those of the page's shot cameras."""
    text = text.strip()
    if text in PRESETS:
        return CameraChoice(*PRESETS[text])
    if text in names:
        return CameraChoice(shot=names.index(text))
    if match := _SHOT.fullmatch(text):
        if int(match[1]) < len(names):
            return CameraChoice(shot=int(match[1]))
    else:
        numbers = _numbers(text)
        if len(numbers) == 2:
            return CameraChoice(math.radians(numbers[0]), math.radians(numbers[1]))
        # As the address of a page has it.
        if len(numbers) == 6 and numbers[2] > 0:
            yaw, pitch, distance, *target = numbers
            return CameraChoice(yaw, pitch, distance, tuple(target))
    known = [*PRESETS, *names]
    near = similar(text, known)
    hint = f"did you mean {near!r}?" if near else f"allowed: {', '.join(known)}"
    hint += "; or YAW,PITCH in degrees, or the `cam` of a page's address"
    raise refused("camera", f"unknown camera {text!r}", hint)


def _numbers(text: str) -> list[float]:
    """Return comma-separated finite numbers; none if invalid."""
    try:
        numbers = [float(part) for part in text.split(",")]
    except ValueError:
        return []
    return numbers if all(map(math.isfinite, numbers)) else []
