"""How fast and which way agents would like to go, in numbers."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.testing import assert_allclose

from animtool.systems.crowds.agents import Agents
from animtool.systems.crowds.spec import CrowdGoalModel, PopulationModel, QueueModel
from animtool.systems.crowds.steering import NO_TICKET, Progress, Steering

POINTS = np.array([[10.0, 0.0], [0.0, 5.0]])


def steering(count: int, then: str = "stay", **keys: Any) -> Steering:
    """Return agents of 0.3 m that like 1.2 m/s, on their way from A to B."""
    population = PopulationModel.model_validate(
        {"name": "all", "route": ["a", "b"], "then": then, "radius": 0.3}
    )
    given: dict[str, Any] = {
        "entries": [population],
        "end_indices": [count],
        "start_points": np.zeros((count, 2)),
        "speeds": np.full(count, 1.2),
        "max_speeds": np.full(count, 2.0),
        "yield_weights": np.ones(count),
        "delays": np.zeros(count),
        "groups": np.full(count, -1, np.int32),
        "lateral_offsets": np.zeros(count),
        "goal_offsets": np.zeros((count, 2)),
        "sizes": np.ones(count),
        "clip_phases": np.zeros(count),
        **keys,
    }
    goals = [
        CrowdGoalModel(name="a", at=[10, 0, 0], radius=1.0),
        CrowdGoalModel(
            name="b", at=[0, 0, 5], radius=1.0, queue=QueueModel(direction=[0, 0, 1])
        ),
    ]
    return Steering(Agents(**given), goals, POINTS, np.array([[0, 0], [0, 0.8]]), None)


def progress(stages: list[int], **keys: Any) -> Progress:
    count = len(stages)
    blank = {"waited": np.zeros(count), "tickets": np.full(count, NO_TICKET)}
    return Progress(**{"stages": np.array(stages), **blank, **keys})


def test_who_comes_to_a_goal_stops_within_half_a_second() -> None:
    """0.2 m from it at 0.4 m/s; from 0.6 m on as fast as each likes."""
    x = np.array([[9.8, 0.0], [9.4, 0.0], [10.0, 4.0], [10.0, 0.0]])
    found = steering(4).preferred_velocities(3.0, 0.0, progress([0] * 4), x)
    assert_allclose(found, [[0.4, 0], [1.2, 0], [0, -1.2], [0, 0]], atol=1e-12)


def test_they_set_out_so_long_after_the_beginning_whenever_that_is() -> None:
    own = steering(3, delays=np.array([0.0, 2.0, 2.5]))
    for t, goes in ((10.0, [1, 0, 0]), (12.0, [1, 1, 0]), (12.5, [1, 1, 1])):
        found = own.preferred_velocities(t, 10.0, progress([0] * 3), np.zeros((3, 2)))
        assert_allclose(found[:, 0], 1.2 * np.array(goes))


def test_who_is_of_a_group_walks_on_its_own_side() -> None:
    """Along z left is along x; they come back at half the speed that they like."""
    own = steering(
        3, groups=np.zeros(3, np.int32), lateral_offsets=np.array([0.1, 0.0, -2.0])
    )
    x = np.zeros((3, 2))
    found = own._keep_formation(np.tile([0.0, 1.2], (3, 1)), np.zeros(3, np.bool_), x)
    assert_allclose(found, [[0.2, 1.2], [0.0, 1.2], [-0.6, 1.2]], atol=1e-12)
    # Along -x left is along z.
    found = own._keep_formation(np.tile([-1.0, 0.0], (3, 1)), np.zeros(3, np.bool_), x)
    assert_allclose(found, [[-1.0, 0.2], [-1.0, 0.0], [-1.0, -0.6]], atol=1e-12)


def test_a_group_goes_by_its_middle_and_who_queues_by_himself() -> None:
    """Those at 0 and 1 m are drawn to 0.5 m, at 0.6 m/s at most."""
    own = steering(3, groups=np.array([1, 0, 1], np.int32))
    x = np.array([[0.0, 0.0], [7.0, 7.0], [1.0, 0.0]])
    ahead = np.tile([0.0, 1.2], (3, 1))
    found = own._keep_formation(ahead, np.zeros(3, np.bool_), x)
    assert_allclose(found, [[0.6, 1.2], [0, 1.2], [-0.6, 1.2]], atol=1e-12)
    assert_allclose(own._keep_formation(ahead, np.array([True, False, True]), x), ahead)


def test_a_goal_grows_with_the_ground_that_those_who_are_there_cover() -> None:
    """32 of 0.3 m cover half of a disc of 2.4 m; 4 of them fit in the goal's own."""
    own = steering(40)
    goal = np.zeros(40, np.int64)
    there = np.arange(40) < 32
    assert_allclose(own._arrival_radii(goal, there), 2.4)
    assert_allclose(own._arrival_radii(goal, np.arange(40) < 4), 1.0)
    assert_allclose(own._arrival_radii(goal + 1, there), 2.4)


def test_places_in_a_queue_are_given_from_its_end_the_nearest_first() -> None:
    """Two stand at B already: the third place is 1.6 m behind the first."""
    own = steering(5)
    tickets = np.array([4, 7, NO_TICKET, NO_TICKET, NO_TICKET])
    x = np.array([[0, 5], [0, 5.8], [0.3, 6.6], [0.1, 6.6], [0, 9.0]])
    found = own._assign_tickets(tickets, np.ones(5, np.int64), np.ones(5, np.bool_), x)
    assert found.tolist() == [4, 7, 9, 8, NO_TICKET]
    at, queued = own.targets(progress([1] * 5, tickets=found), np.ones(5, np.int64), x)
    assert queued.tolist() == [True] * 4 + [False]
    assert_allclose(at[:, 1], [5.0, 5.8, 7.4, 6.6, 5.0])


def test_routes_are_gone_through_again_or_ended_or_left() -> None:
    stages = [0, 1, 2, 3, 5]
    for then, goals in (("repeat", [0, 1, 0, 1, 1]), ("stay", [0, 1, -1, -1, -1])):
        assert steering(5, then).current_goals(progress(stages)).tolist() == goals
    gone = steering(2, "leave").current_goals(progress([-1, 1]))
    assert gone.tolist() == [-1, 1]
