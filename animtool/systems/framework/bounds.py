"""Checks of frames for numbers out of bounds, after a blow-up."""

from __future__ import annotations

from typing import NoReturn

import numpy as np

from animtool.core.errors import Fault, ToleranceError
from animtool.core.quantities import floor_to_two_digits, plain_number
from animtool.motion.frames import Frame, TransformsFrame

# Largest number of a frame; files hold up to 3e38 in any unit.
MAX_FRAME_VALUE = 1e30
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
    arrays = {key: getattr(frame, key, None) for key in ARRAY_UNITS}
    primvars = sorted(getattr(frame, "primvars", {}).items())
    arrays |= {f"primvars:{key}": values for key, values in primvars}
    for array_name, values in arrays.items():
        if values is None or not values.size or values.dtype.kind != "f":
            continue
        if values.min() >= -MAX_FRAME_VALUE and values.max() <= MAX_FRAME_VALUE:
            continue
        index = np.argwhere(~(np.abs(values) <= MAX_FRAME_VALUE))[0]
        number, unit = float(values[tuple(index)]), ARRAY_UNITS.get(array_name, "")
        value_text = f"{number:.3g} {unit}".rstrip()
        _stop(name, t, f"{array_name}[{int(index[0])}] is {value_text}", step)


def check_finite(name: str, frame: Frame, t: float, step: float) -> None:
    """Raise if any point of a frame is not finite (SIM102).

    Field velocities may be undefined between frames, and are not checked.
    """
    arrays = [frame.points]
    if isinstance(frame, TransformsFrame):
        arrays += [frame.rotations, frame.scales]
    if all(np.isfinite(array).all() for array in arrays):
        return
    is_finite = np.isfinite(np.concatenate(arrays, axis=1))
    (nonfinite_indices,) = np.nonzero(~is_finite.all(axis=1))
    _stop(name, t, f"point {int(nonfinite_indices[0])} is not finite", step)


def _stop(name: str, t: float, reason: str, step: float) -> NoReturn:
    """Raise SIM102 with a reason, and half the step [s] as a hint."""
    half_step = plain_number(floor_to_two_digits(step / 2))
    hint = f"use step: {half_step}, or weaker forces"
    message = f"{name} blew up at {t:g} s: {reason}"
    raise ToleranceError(Fault("SIM102", message, hint=hint))
