"""Nodes of the grid of ways, how far they are from edges, and where ways end."""

from __future__ import annotations

import numpy as np
from numpy.testing import assert_allclose

from animtool.systems.crowds.routes import FlowField, NavGrid, flow_field

LOW = np.array([10.0, -4.0])


def grid(*rows: str) -> NavGrid:
    """Return a grid of half a metre from (10, -4) on; ``#`` is not free."""
    free = np.array([[node != "#" for node in row] for row in rows])
    return NavGrid(LOW, 0.5, free)


def test_nodes_are_numbered_along_z_and_then_x() -> None:
    own = grid("....", "....", "....")
    assert_allclose(
        NavGrid.all_positions(LOW, 0.5, (2, 2)),
        [[10, -4], [10, -3.5], [10.5, -4], [10.5, -3.5]],
    )
    assert_allclose(
        own.node_positions(np.array([0, 3, 4, 11])),
        [[10, -4], [10, -2.5], [10.5, -4], [11, -2.5]],
    )
    assert_allclose(own.high, [11, -2.5])
    near = own.nearest_nodes(
        np.array([[10.26, -3.76], [10.24, -3.74], [-9, 9], [99, -99]])
    )
    assert near.tolist() == [[1, 0], [0, 1], [0, 3], [2, 0]]
    border_distance = own.border_distance(
        np.array([[10.2, -3], [10.9, -3.2], [9.5, -3], [10.5, -2.4]])
    )
    assert_allclose(border_distance, [0.2, 0.1, -0.5, -0.1])


def test_who_is_outside_faces_the_sides_that_he_is_beyond() -> None:
    """By more than a cell."""
    own = grid("....", "....", "....")
    for point, nodes in (
        ([9.4, -3.0], [0, 1, 2, 3]),
        ([9.6, -3.0], []),
        ([11.6, -3.0], [8, 9, 10, 11]),
        ([10.5, -4.6], [0, 4, 8]),
        ([10.5, -1.9], [3, 7, 11]),
        ([9.0, -9.0], [0, 1, 2, 3, 4, 8]),
    ):
        assert own.border_nodes_facing(np.array(point)).tolist() == nodes


def test_edges_are_half_a_cell_from_what_is_not_free() -> None:
    """Of a hall of 3 by 5 nodes: its sides are a cell from the nodes at them."""
    own = grid(".....", ".....", ".....")
    gaps, ways = own.obstacle_distances(
        np.array([[10.5, -3.0], [10.0, -3.0], [10.25, -3.0]])
    )
    assert_allclose(gaps, [0.75, 0.25, 0.5])
    assert_allclose(ways[1:], [[1, 0], [1, 0]])
    rows, columns, shares = own.cell_corners(np.array([[10.1, -3.6], [99.0, -99.0]]))
    assert (rows[0].ravel().tolist(), columns[0].ravel().tolist()) == ([0, 1], [0, 1])
    assert_allclose(shares[0], [[0.8 * 0.2, 0.8 * 0.8], [0.2 * 0.2, 0.2 * 0.8]])
    assert_allclose(shares[1], [[0, 0], [1, 0]])


def test_ways_go_round_walls_and_end_at_the_goal_or_the_node_next_to_it() -> None:
    """A wall between two rows with a gap at its end; a part that is shut off."""
    own = grid(".....#.", "####.#.", ".....#.")
    goal = np.array([10.0, -4.0])
    route = flow_field(own, goal)
    assert_allclose(route.goals[own.components[0, 0]], goal)
    shut = own.components[0, 6]
    assert shut != own.components[0, 0]
    assert_allclose(route.goals[shut], [10, -1])
    assert route.distances[0, 0] == 0
    # Along the wall, round its end, and back: 4 cells, a turn, and 4 cells.
    assert 8 * 0.5 < route.distances[2, 0] < 10 * 0.5 + 1e-9
    assert_allclose(route.gradient[0, 2], [0, -1], atol=1e-9)
    assert_allclose(route.gradient[2, 1], [0, 1], atol=1e-9)
    assert_allclose(
        route.path_ends(np.array([[11.0, -3.9], [11, -1]])), [goal, [10, -1]]
    )
    # Straight ahead what is seen, and along the wall what is not.
    points = np.array([[10.0, -3.0], [11.0, -4.0]])
    found = route.path_directions(points, np.array([goal, goal]))
    assert_allclose(found[0], [0, -1], atol=1e-9)
    assert found[1, 1] > 0.7


def test_a_way_longer_by_up_to_a_cell_and_a_half_is_straight() -> None:
    """Along z it is 2 cells, across nothing; who does not see it goes as nodes say."""
    own = grid(*["....."] * 5)
    goal = np.array([[11.0, -3.0]])
    point = np.array([[10.0, -4.0]])
    straight = np.sqrt(2) / 2
    for longer, way in ((1.45, [straight, straight]), (1.55, [0.0, 1.0])):
        far = np.full(own.is_free.shape, np.sqrt(2) + longer * 0.5)
        far -= 0.1 * np.arange(5)
        far[0, 0] = np.sqrt(2) + longer * 0.5
        goals = np.array([[0.0, 0.0], goal[0]])
        found = FlowField(own, goals, far).path_directions(point, goal)
        assert_allclose(found, [way], atol=1e-9)
