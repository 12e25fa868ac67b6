"""Checks of frames for numbers out of bounds, after a blow-up."""

from __future__ import annotations

import numpy as np

from animtool.core.array_types import FloatArray, IntArray
from animtool.core.errors import Fault, ToleranceError
from animtool.core.quantities import floor_to_two_digits, plain_number
from animtool.motion.frames import Frame, TransformsFrame

# Largest number of a frame; files hold up to 3e38 in any unit.
MAX_VALUE = 1e30
# Checked arrays besides primvars, with their units.
ARRAY_UNITS = {
    "points": "m",
    "velocities": "m/s",
    "spins": "rad/s",
    "rotations": "",
    "scales": "",
    "radii": "m",
}


def check_bounds(name: str, frame: Frame, t: float, step: float) -> None:
    """Raise if any number of a frame is out of bounds (SIM102)."""
    primvars = {f"primvars:{key}": values for key, values in _primvars(frame)}
    arrays = {
        array_name: getattr(frame, array_name, None) for array_name in ARRAY_UNITS
    } | primvars
    for array_name, values in arrays.items():
        if values is None or not values.size or values.dtype.kind != "f":
            continue
        if values.min() >= -MAX_VALUE and values.max() <= MAX_VALUE:
            continue
        index = np.argwhere(~(np.abs(values) <= MAX_VALUE))[0]
        number, unit = float(values[tuple(index)]), ARRAY_UNITS.get(array_name, "")
        value = f"{number:.3g} {unit}".rstrip()
        message = f"{name} blew up at {t:g} s: {array_name}[{int(index[0])}] is {value}"
        hint = f"use step: {half_step_text(step)}, or weaker forces"
        raise ToleranceError(Fault("SIM102", message, hint=hint))


def check_finite(name: str, frame: Frame, t: float, step: float) -> None:
    """Raise if any point of a frame is not finite (SIM102).

    Field velocities may be undefined between frames, and are not checked.
    """
    arrays = [frame.points]
    if isinstance(frame, TransformsFrame):
        arrays += [frame.rotations, frame.scales]
    if all(np.isfinite(array).all() for array in arrays):
        return
    finite = np.isfinite(np.concatenate(arrays, axis=1))
    (rows,) = np.nonzero(~finite.all(axis=1))
    message = f"{name} blew up at {t:g} s: point {int(rows[0])} is not finite"
    hint = f"use step: {half_step_text(step)}, or weaker forces"
    raise ToleranceError(Fault("SIM102", message, hint=hint))


def half_step_text(step: float) -> str:
    """Return half a step [s] as text."""
    return plain_number(floor_to_two_digits(step / 2))


def _primvars(frame: Frame) -> list[tuple[str, FloatArray | IntArray]]:
    return sorted(getattr(frame, "primvars", {}).items())
