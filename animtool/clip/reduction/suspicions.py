"""Warnings about implausible tolerances of key reduction."""

from __future__ import annotations

from animtool.core.arguments import argument
from animtool.core.errors import Fault, Severity
from animtool.core.quantities import length_text
from animtool.rig.kinematics import rest_size
from animtool.rig.skeleton import Rig

# A larger tolerance, as a fraction of the rig's size, loses the motion [1].
MAX_TOLERANCE_FRACTION = 0.1


def tolerance_notices(tolerance: float | None, rig: Rig, path: str) -> list[Fault]:
    """Return a warning about a tolerance [m] that is large for a rig (CLIP120)."""
    size = rest_size(rig)
    if tolerance is None or not size > 0 or tolerance <= MAX_TOLERANCE_FRACTION * size:
        return []
    message = f"a tolerance of {length_text(tolerance)} is large for a rig of "
    message += f"{length_text(size)}: most of the motion is lost"
    hint = f"{argument('reduce', f'{tolerance:g}mm')} may be meant"
    return [Fault("CLIP120", message, path, (), hint, Severity.WARNING)]
