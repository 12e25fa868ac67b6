"""Whether a take fits the rig that its motion is written onto."""

from __future__ import annotations

import math

from animtool._types import IntArray
from animtool.errors import Fault, FormatError, Severity, naming
from animtool.rig.fit import FITS, NOTICEABLE, Fit, measure_fit
from animtool.rig.skeleton import Rig

# What a length unit that is off makes of the size, and the units of such a file.
UNIT_RATIOS = (100.0, 1000.0, 10.0, 2.54, 39.37)
RATIO_TOLERANCE = 0.15


def check_fit(
    take: Rig,
    rig: Rig,
    source: IntArray,
    where: str,
    *,
    forced: bool,
    unmatched: list[Fault] | None = None,
) -> tuple[Fit, list[Fault]]:
    """Return how well a take fits a rig, and a warning where that can be seen.

    Args:
        take: The take's rig, with the up axis of the other.
        rig: The rig that the take is written onto.
        source: Joint of the take for each joint of the rig ``(J,)``, -1 for none.
        where: File of the rig.
        forced: Warn in place of an error.
        unmatched: Notices of joints that only one of them has; an error about joints
            includes them.

    Raises:
        FormatError: It does not fit (RIG040).
    """
    fit = measure_fit(take, rig, source, posed=take.has_rest)
    if fit.score >= NOTICEABLE:
        return fit, []
    names = [rig.names[j] for j in fit.differing]
    if fit.score >= FITS or forced:
        message = f"the take differs from the rig: score {fit.score:.2f}; "
        message += _numbers(fit)
        return fit, [_fault("RIG041", message, names, where, None, Severity.WARNING)]
    message = (
        f"the take does not fit the rig: score {fit.score:.2f}, {FITS} is needed; "
    )
    message += _numbers(fit)
    faults = [_fault("RIG040", message, names, where, _hint(fit), Severity.ERROR)]
    if fit.parts["joints"] < FITS:
        faults += unmatched or []
    raise FormatError(faults)


def _fault(
    code: str,
    message: str,
    names: list[str],
    where: str,
    hint: str | None,
    severity: Severity,
) -> Fault:
    if not names:
        return Fault(code, message, where, (), hint, severity)
    message += "; joints that rest differently: "
    return naming(code, message, names, where, hint, severity)


def _numbers(fit: Fit) -> str:
    """Return the parts of a score that can be seen."""
    said = {
        "joints": f"{fit.take_share:.0%} of the take's, {fit.rig_share:.0%} of the "
        "rig's",
        "rotations": f"{math.degrees(fit.rotation):.1f} degrees apart",
        "lengths": f"{fit.length:.0%} apart",
        "size": f"{fit.size:.3g} times the rig's",
        "up axis": f"{math.degrees(fit.tilt):.0f} degrees apart",
    }
    return ", ".join(
        f"{name} {value:.2f} ({said[name]})"
        for name, value in fit.parts.items()
        if value < NOTICEABLE
    )


def _hint(fit: Fit) -> str:
    """Return what to do about the worst part of a score."""
    parts = fit.parts
    worst = min(parts, key=lambda name: parts[name])
    advice = {
        "joints": "name another rig, or match the names (--strip-namespace N drops "
        "prefixes)",
        "rotations": "retarget the motion to the rest pose of the rig",
        "lengths": "retarget the motion to the bones of the rig",
        "size": "check the units of both (--units states those of a BVH)"
        if _unit_apart(fit.size)
        else "retarget the motion to the size of the rig",
        "up axis": "check the up axes of both (--up states that of a BVH)",
    }
    return f"{advice[worst]}; --force-fit writes it as it is"


def _unit_apart(size: float) -> bool:
    """Return whether one unit taken for another makes so much difference in size."""
    ratio = max(size, 1.0 / size) if size > 0 else math.inf
    return any(abs(ratio / r - 1.0) < RATIO_TOLERANCE for r in UNIT_RATIOS)
