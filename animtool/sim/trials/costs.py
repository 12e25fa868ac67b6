"""Cost and error of settings, and the best of them."""

from __future__ import annotations

from collections.abc import Sequence

from animtool.core.record import dataclass

# Errors within this factor are equal; a cost lower by this factor is worth it.
AS_GOOD, WORTH_IT = 1.05, 0.8
# Timings within this fraction are equal; the counted work decides.
NOISE = 0.25


@dataclass(frozen=True, slots=True)
class Cost:
    """The cost and the error of a setting."""

    value: float  # time [s], or another cost
    error: float  # [m]
    work: int = 0  # what is counted


def best_of(costs: Sequence[Cost | None]) -> list[int]:
    """Return the Pareto-optimal settings; failed runs are None.

    >>> best_of([Cost(1, 0.1), Cost(2, 0.01), Cost(3, 0.05), None])
    [0, 1]
    """
    order = sorted((cost.value, cost.error, i) for i, cost in enumerate(costs) if cost)
    best, least = [], float("inf")
    for _, error, i in order:
        if error < least:
            best.append(i)
            least = error
    return sorted(best)


def recommended_of(
    costs: Sequence[Cost | None], chosen: int, accepted_error: float
) -> int | None:
    """Return the setting to use instead of the chosen; None if that is best.

    Costs are None of what did not work; where the chosen one did not, an error that is
    enough [m] will do.

    >>> recommended_of([Cost(1, 0.1), Cost(0.4, 0.1), Cost(0.3, 0.2)], 0, 1.0)
    1
    """
    now = costs[chosen]
    # Equal error after equal work is the same run; the timing is noise.
    same = None if now is None else (now.error, now.work)
    within = accepted_error if now is None else now.error * AS_GOOD
    most = float("inf") if now is None else now.value * WORTH_IT
    fit = [
        (cost.value, i)
        for i, cost in enumerate(costs)
        if cost is not None
        and cost.error <= within
        and cost.value <= most
        and (not cost.work or (cost.error, cost.work) != same)
    ]
    if not fit and now is None:
        fit = [(cost.error, i) for i, cost in enumerate(costs) if cost is not None]
    return min(fit)[1] if fit else None


def cheapest_of(costs: Sequence[Cost | None], budget: float) -> int | None:
    """Return the cheapest setting within an error budget [m]; None if none is.

    Among equal costs, the one with the least work.

    >>> cheapest_of([Cost(1.1, 0.01, 50), Cost(1.0, 0.01, 80), Cost(0.2, 0.3)], 0.1)
    0
    """
    fit = [(c, i) for i, c in enumerate(costs) if c is not None and c.error <= budget]
    if not fit:
        return None
    least = min(cost.value for cost, _ in fit)
    equals = [(c.work, c.value, i) for c, i in fit if c.value <= least * (1 + NOISE)]
    return min(equals)[-1]
