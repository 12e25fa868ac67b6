"""Checks of frames for numbers out of bounds, after a blow-up."""

from __future__ import annotations

import numpy as np

from animtool.core.array_types import FloatArray, IntArray
from animtool.core.errors import Fault, ToleranceError
from animtool.core.quantities import floored, plain
from animtool.motion.frames import Frame, TransformsFrame

# Largest number of a frame; files hold up to 3e38 in any unit.
BOUND = 1e30
# Checked arrays besides primvars, with their units.
UNITS = {
    "points": "m",
    "velocities": "m/s",
    "spins": "rad/s",
    "rotations": "",
    "scales": "",
    "radii": "m",
}


def check_bounds(name: str, frame: Frame, t: float, step: float) -> None:
    """Raise if a frame contains a number out of bounds (SIM102)."""
    primvars = {f"primvars:{key}": rows for key, rows in _primvars(frame)}
    arrays = {what: getattr(frame, what, None) for what in UNITS} | primvars
    for what, rows in arrays.items():
        if rows is None or not rows.size or rows.dtype.kind != "f":
            continue
        if rows.min() >= -BOUND and rows.max() <= BOUND:
            continue
        index = np.argwhere(~(np.abs(rows) <= BOUND))[0]
        value = f"{float(rows[tuple(index)]):.3g} {UNITS.get(what, '')}".rstrip()
        message = f"{name} blew up at {t:g} s: {what}[{int(index[0])}] is {value}"
        hint = f"use step: {half(step)}, or weaker forces"
        raise ToleranceError(Fault("SIM102", message, hint=hint))


def check_finite(name: str, frame: Frame, t: float, step: float) -> None:
    """Raise if a point of a frame is not finite (SIM102).

    Field velocities may be undefined between frames, and are not checked.
    """
    arrays = [frame.points]
    if isinstance(frame, TransformsFrame):
        arrays += [frame.rotations, frame.scales]
    if all(np.isfinite(array).all() for array in arrays):
        return
    finite = np.isfinite(np.concatenate(arrays, axis=1))
    (bad,) = np.nonzero(~finite.all(axis=1))
    message = f"{name} blew up at {t:g} s: point {int(bad[0])} is not finite"
    hint = f"use step: {half(step)}, or weaker forces"
    raise ToleranceError(Fault("SIM102", message, hint=hint))


def half(step: float) -> str:
    """Return half a step [s] as text."""
    return plain(floored(step / 2))


def _primvars(frame: Frame) -> list[tuple[str, FloatArray | IntArray]]:
    return sorted(getattr(frame, "primvars", {}).items())
