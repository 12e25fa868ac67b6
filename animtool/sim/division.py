"""How fixed steps divide the time between two values."""

from __future__ import annotations

import math
from dataclasses import dataclass

# A time within this share of a step is on a multiple of it.
ON_GRID = 1e-9


@dataclass(frozen=True, slots=True)
class Division:
    """Even steps from a time to another."""

    start: float  # [s]
    end: float  # [s]
    count: int  # of steps
    h: float  # each step [s]
    # Where the times are multiples of the step, which multiple the start is; None where
    # they are not.
    first: int | None

    def time(self, i: int) -> float:
        """Return when step i begins [s]; i may be the count."""
        if self.first is not None:
            return (self.first + i) * self.h
        return self.end if i == self.count else self.start + i * self.h


def divide(start: float, end: float, step: float) -> Division:
    """Return the even steps, none longer than a step, between two times.

    Where both times are multiples of the step, it is taken as it is, and steps begin
    at multiples of it: so it is the same steps whichever values are asked for between,
    and wherever a motion is gone on from.

    >>> divide(0.5, 1.0, 0.2).h
    0.16666666666666666
    >>> divide(0.1 + 0.2, 0.6, 0.1)
    Division(start=0.30000000000000004, end=0.6, count=3, h=0.1, first=3)
    """
    first, last = start / step, end / step
    near, far = round(first), round(last)
    # What rounding of the times alone makes of a multiple.
    slack = ON_GRID + 4 * math.ulp(max(abs(first), abs(last)))
    on_grid = max(abs(first - near), abs(last - far)) <= slack < 0.5
    if on_grid and far > near:
        return Division(start, end, far - near, step, near)
    count = max(1, math.ceil((end - start) / step * (1 - 1e-12)))
    return Division(start, end, count, (end - start) / count, None)
