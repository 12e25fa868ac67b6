"""Cost and error of settings, and selection of the best settings."""

from __future__ import annotations

from collections.abc import Sequence

from animtool.core.record import dataclass

# Errors within this factor count as equal; only costs below this fraction of the chosen
# setting's cost are worth a recommendation.
EQUAL_ERROR, MAX_WORTHWHILE_COST = 1.05, 0.8
# Timings within this fraction count as equal; then the counted work decides.
TIMING_NOISE = 0.25


@dataclass(frozen=True, slots=True)
class Cost:
    """The cost of a setting, and the error of its result."""

    value: float  # time [s], or another cost
    error: float  # [m]
    work: int = 0  # counted work, such as steps


def pareto_optimal(costs: Sequence[Cost | None]) -> list[int]:
    """Return the indices of Pareto-optimal settings; costs of failed runs are None.

    >>> pareto_optimal([Cost(1, 0.1), Cost(2, 0.01), Cost(3, 0.05), None])
    [0, 1]
    """
    cost_rows = [(cost.value, cost.error, i) for i, cost in enumerate(costs) if cost]
    optimal_indices, min_error = [], float("inf")
    for _, error, i in sorted(cost_rows):
        if error < min_error:
            optimal_indices.append(i)
            min_error = error
    return sorted(optimal_indices)


def recommended_index(
    costs: Sequence[Cost | None], chosen_index: int, accepted_error: float
) -> int | None:
    """Return the index of the setting to use instead of the chosen one.

    None if the chosen one is best. Costs of failed runs are None; if the chosen setting
    failed, settings with up to the accepted error [m] are candidates.

    >>> recommended_index([Cost(1, 0.1), Cost(0.4, 0.1), Cost(0.3, 0.2)], 0, 1.0)
    1
    """
    chosen_cost = costs[chosen_index]
    max_error, max_cost, chosen_work = accepted_error, float("inf"), None
    if chosen_cost is not None:
        max_error = chosen_cost.error * EQUAL_ERROR
        max_cost = chosen_cost.value * MAX_WORTHWHILE_COST
        # Equal error after equal work is the same run; the timing is noise.
        chosen_work = chosen_cost.error, chosen_cost.work
    candidates = [
        (cost.value, i)
        for i, cost in enumerate(costs)
        if cost is not None
        and cost.error <= max_error
        and cost.value <= max_cost
        and (not cost.work or (cost.error, cost.work) != chosen_work)
    ]
    if not candidates and chosen_cost is None:
        candidates = [(cost.error, i) for i, cost in enumerate(costs) if cost]
    return min(candidates)[1] if candidates else None


def cheapest_index(costs: Sequence[Cost | None], budget: float) -> int | None:
    """Return the index of the cheapest setting within an error budget [m].

    Of nearly equal costs, the one with the least work; None if no setting qualifies.

    >>> cheapest_index([Cost(1.1, 0.01, 50), Cost(1.0, 0.01, 80), Cost(0.2, 0.3)], 0.1)
    0
    """
    candidates = [(c, i) for i, c in enumerate(costs) if c and c.error <= budget]
    if not candidates:
        return None
    lowest_cost = min(cost.value for cost, _ in candidates)
    tied_candidates = [
        (c.work, c.value, i)
        for c, i in candidates
        if c.value <= lowest_cost * (1 + TIMING_NOISE)
    ]
    return min(tied_candidates)[-1]
