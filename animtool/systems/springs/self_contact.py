"""How surfaces keep apart from themselves."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from animtool import _kernels
from animtool._types import FloatArray, IntArray
from animtool.errors import Fault, OptionError, Severity, counted
from animtool.ranges import range_faults
from animtool.systems.springs.body import Body
from animtool.systems.springs.records import SelfContact


def check_self_contact(contact: SelfContact, body: Body) -> None:
    """Raise where a body cannot keep apart from itself in this way.

    Raises:
        OptionError: A number is out of its range, positions at rest do not fit, or the
            body has no triangles (SIM045), with every such fault.
    """
    messages = [fault.message for fault in range_faults(contact)]
    if not len(body.triangles):
        messages.append("a body without triangles does not keep apart from itself")
    if contact.rest is not None:
        rest = np.asarray(contact.rest, np.float64)
        if rest.shape != body.positions.shape:
            wanted = body.positions.shape
            messages.append(f"rest must have shape {wanted}, not {rest.shape}")
        elif not np.isfinite(rest).all():
            messages.append("rest must be finite")
    if messages:
        raise OptionError(
            [Fault("SIM045", message, where="self_contact") for message in messages]
        )


@dataclass(frozen=True, slots=True)
class Through:
    """What of a surface went through itself, at most at a time."""

    passed: int = 0  # particles through triangles that were not yet brought back
    cut: int = 0  # pairs of edges through each other
    # Steps a second in which what went too far in one would have been seen [1/s]; 0
    # where nothing did.
    rate: float = 0.0

    def with_more(self, more: Through) -> Through:
        """Return the most of both."""
        return Through(
            max(self.passed, more.passed),
            max(self.cut, more.cut),
            max(self.rate, more.rate),
        )


def tangle_notices(
    positions: FloatArray, triangles: IntArray, what: str = "the surface"
) -> list[Fault]:
    """Return a warning where a surface of points ``(N, 3)`` [m] is tangled (SIM166).

    >>> points = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0.2, 0.2, -1]])
    >>> points = np.append(points, [[0.2, 0.2, 1], [2, 2, 0]], axis=0)
    >>> (notice,) = tangle_notices(points, np.array([[0, 1, 2], [3, 4, 5]]))
    >>> notice.message
    'the surface begins in a tangle: its edges go through its triangles in 2 places'
    """
    pierced = _kernels.pierced_edges(
        np.ascontiguousarray(positions), np.ascontiguousarray(triangles, np.int64)
    )
    if not pierced:
        return []
    places = counted(pierced, "place")
    message = (
        f"{what} begins in a tangle: its edges go through its triangles in {places}"
    )
    hint = "what is through is not told from what is not: it may stay so"
    return [_warning("SIM166", message, hint)]


def through_notices(through: Through, what: str = "the surface") -> list[Fault]:
    """Return warnings of what went through a surface (SIM144, SIM165, SIM167)."""
    found = []
    if through.passed:
        message = f"{counted(through.passed, 'particle')} went through {what}"
        hint = "take a shorter step, or a greater thickness"
        found.append(_warning("SIM144", message, hint))
    if through.cut:
        times = counted(through.cut, "pair")
        message = f"{times} of edges cut through each other in {what}"
        hint = "take a shorter step, or a greater thickness"
        found.append(_warning("SIM167", message, hint))
    if through.rate:
        message = f"parts of {what} went over each other by many thicknesses in a step"
        hint = "take a shorter step"
        if math.isfinite(through.rate):
            hint = f"{math.ceil(through.rate)} steps a second miss nothing"
        found.append(_warning("SIM165", message, hint))
    return found


def _warning(code: str, message: str, hint: str) -> Fault:
    return Fault(code, message, hint=hint, severity=Severity.WARNING)
