"""Which settings are worth having."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

# An error this much larger is as good, and a time this much shorter is worth it.
AS_GOOD, WORTH_IT = 1.05, 0.8


@dataclass(frozen=True, slots=True)
class Cost:
    """What a setting takes, and what it gives.

    Attributes:
        seconds: Wall time [s].
        error: [m]
    """

    seconds: float
    error: float


def best_of(costs: Sequence[Cost | None]) -> list[int]:
    """Return which are as fast as any that is as exact.

    Args:
        costs: None of what did not work.

    >>> best_of([Cost(1, 0.1), Cost(2, 0.01), Cost(3, 0.05), None])
    [0, 1]
    """
    order = sorted(
        (cost.seconds, cost.error, i) for i, cost in enumerate(costs) if cost
    )
    found, least = [], float("inf")
    for _, error, i in order:
        if error < least:
            found.append(i)
            least = error
    return sorted(found)


def recommended_of(
    costs: Sequence[Cost | None], chosen: int, enough: float
) -> int | None:
    """Return what to take in place of the chosen setting; None where it is right.

    Args:
        costs: None of what did not work.
        chosen: Which of them is.
        enough: Error that will do where the chosen one does not work [m].

    >>> recommended_of([Cost(1, 0.1), Cost(0.4, 0.1), Cost(0.3, 0.2)], 0, 1.0)
    1
    """
    now = costs[chosen]
    within = enough if now is None else now.error * AS_GOOD
    most = float("inf") if now is None else now.seconds * WORTH_IT
    fit = [
        (cost.seconds, i)
        for i, cost in enumerate(costs)
        if cost is not None and cost.error <= within and cost.seconds <= most
    ]
    if not fit and now is None:
        fit = [(cost.error, i) for i, cost in enumerate(costs) if cost is not None]
    return min(fit)[1] if fit else None
