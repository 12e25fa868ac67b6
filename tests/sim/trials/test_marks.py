"""Which settings are worth having."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from animtool.sim.trials.costs import (
    Cost,
    cheapest_index,
    pareto_optimal,
    recommended_index,
)

COST = st.builds(Cost, st.integers(1, 6).map(float), st.integers(1, 6).map(float))
COSTS = st.lists(st.none() | COST, min_size=1, max_size=8)


@given(COSTS)
def test_the_best_are_those_that_none_beats(costs: list[Cost | None]) -> None:
    best = pareto_optimal(costs)
    for i, cost in enumerate(costs):
        if cost is None:
            assert i not in best
            continue
        beaten = any(
            other.value <= cost.value
            and other.error <= cost.error
            and (other.value, other.error) != (cost.value, cost.error)
            for other in costs
            if other
        )
        assert i not in best if beaten else (cost in [costs[k] for k in best])


@given(COSTS, st.data())
def test_what_is_recommended_is_as_exact_and_faster(
    costs: list[Cost | None], data: st.DataObject
) -> None:
    chosen = data.draw(st.integers(0, len(costs) - 1))
    found = recommended_index(costs, chosen, 2.0)
    now = costs[chosen]
    if found is None:
        assert now is not None or not any(costs)
        return
    better = costs[found]
    assert better is not None
    if now is not None:
        assert better.error <= now.error * 1.05
        assert better.value < now.value


def test_in_place_of_what_does_not_work_the_fastest_that_will_do() -> None:
    costs = [None, Cost(1, 0.5), Cost(2, 0.1), Cost(3, 0.01)]
    assert recommended_index(costs, 0, 0.2) == 2
    # Where none will do, the most exact.
    assert recommended_index(costs, 0, 1e-6) == 3
    assert recommended_index([None], 0, 1.0) is None


def test_a_run_that_is_the_same_is_not_recommended_for_its_time() -> None:
    now = Cost(1.0, 0.1, 30)
    assert recommended_index([now, Cost(0.5, 0.1, 30)], 0, 1.0) is None
    assert recommended_index([now, Cost(0.5, 0.1, 29)], 0, 1.0) == 1
    # Where no work is counted, costs are all there is.
    assert recommended_index([Cost(1.0, 0.1), Cost(0.5, 0.1)], 0, 1.0) == 1


def test_the_cheapest_within_a_budget_by_work_where_costs_are_alike() -> None:
    costs = [Cost(2, 0.01, 10), Cost(1.0, 0.1, 80), Cost(1.2, 0.1, 50), None]
    assert cheapest_index(costs, 0.1) == 2
    assert cheapest_index(costs, 0.05) == 0
    assert cheapest_index(costs, 0.001) is None
    # A quarter more time is the limit.
    assert cheapest_index([Cost(1.0, 0.1, 80), Cost(1.26, 0.1, 50)], 0.1) == 0
