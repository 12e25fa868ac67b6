"""The up axis of a C3D file, by which of its axes point right and up on a screen."""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np

from animtool.core.array_types import FloatArray, IntArray
from animtool.core.errors import excerpt
from animtool.core.units import UpAxis
from animtool.formats.c3d.sections import Sections
from animtool.formats.trajectories import MarkerFile

_AXIS = re.compile(r"([+-]?)([XYZ])")
# For other up axes than +Y and +Z: the axis that is up once the positions are turned,
# and which numbers, with which signs, are x, y and z then.
_TURNS = {
    "-Y": (UpAxis.Y, (0, 1, 2), (1, -1, -1)),
    "-Z": (UpAxis.Z, (0, 1, 2), (1, -1, -1)),
    "+X": (UpAxis.Y, (1, 0, 2), (-1, 1, 1)),
    "-X": (UpAxis.Y, (1, 0, 2), (1, -1, 1)),
}


@dataclass(frozen=True, slots=True)
class Screen:
    """The up axis, and how positions are turned so that it points up.

    Attributes:
        up: The up axis of the turned positions.
        order: Which coordinate of the file is x, y and z; None where nothing turns.
        signs: By which they are multiplied.
    """

    up: UpAxis
    order: IntArray | None = None
    signs: FloatArray | None = None

    def turned(self, positions: FloatArray) -> FloatArray:
        """Return positions ``(..., 3)`` with `up` up."""
        if self.order is None or self.signs is None:
            return positions
        return positions[..., self.order] * self.signs


def read_screen(file: MarkerFile, sections: Sections, given: UpAxis | None) -> Screen:
    """Return the up axis that ``Y_SCREEN`` states; an option comes before it."""
    if given is not None:
        return Screen(UpAxis(given))
    right, up = (_axis(file, sections, f"{name}_SCREEN") for name in "XY")
    if up is None and right is not None and right[1] == "Y":
        # Y points to the side, and cannot be assumed to point up.
        message = f"states no up axis; Z is assumed, as X_SCREEN is {right}"
        file.note("MKR103", message, "--up says which axis is up")
        return Screen(UpAxis.Z)
    if up is None:
        return Screen(file.up(None, None))
    if right is not None and right[1] == up[1]:
        message = f"X_SCREEN is {right} and Y_SCREEN {up}, which are one axis; "
        file.warn("C3D105", f"{message}{up} is taken as up", "--up Y or --up Z")
    if up not in _TURNS:
        return Screen(UpAxis(up[1]))
    axis, order, signs = _TURNS[up]
    message = f"has {up} up; positions are turned so that {axis} is up"
    file.note("C3D106", message)
    return Screen(axis, np.array(order), np.array(signs, np.float64))


def _axis(file: MarkerFile, sections: Sections, name: str) -> str | None:
    """Return an axis with its sign, as in ``+Z``."""
    found = sections.texts("POINT", name)
    text = found[0].strip() if found else ""
    if not text:
        return None
    match = _AXIS.fullmatch(text.upper())
    if match is None:
        message = f"{name} is {excerpt(text)}, which is none of +X, -X, +Y, -Y, +Z, -Z"
        file.warn("C3D105", message, "--up Y or --up Z")
        return None
    return f"{match[1] or '+'}{match[2]}"
