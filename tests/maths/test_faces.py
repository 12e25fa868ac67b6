"""Polygons, against what loops over them find."""

from __future__ import annotations

from itertools import combinations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from support.suite import examples

from animtool.core.array_types import IntArray
from animtool.maths.faces import (
    coincident_edges,
    directed_edges,
    edge_counts,
    edges,
    is_closed,
    triangulate,
    unique_pairs,
)

POLYGON = st.lists(st.integers(0, 9), min_size=3, max_size=6, unique=True)
POLYGONS = st.lists(POLYGON, min_size=1, max_size=8)
FEW = settings(max_examples=examples(50), deadline=None)


def flat(polygons: list[list[int]]) -> tuple[IntArray, IntArray]:
    return np.array([len(one) for one in polygons]), np.concatenate(polygons)


def around(polygon: list[int]) -> list[tuple[int, int]]:
    return list(zip(polygon, [*polygon[1:], polygon[0]], strict=True))


@given(POLYGONS)
@FEW
def test_sides_go_around_each_polygon(polygons: list[list[int]]) -> None:
    wanted = [list(side) for polygon in polygons for side in around(polygon)]
    assert directed_edges(*flat(polygons)).tolist() == wanted


@given(POLYGONS)
@FEW
def test_an_edge_is_there_once_and_counted(polygons: list[list[int]]) -> None:
    every = [tuple(sorted(side)) for one in polygons for side in around(one)]
    found, often = edge_counts(*flat(polygons))
    assert [tuple(edge) for edge in found.tolist()] == sorted(set(every))
    assert often.tolist() == [every.count(edge) for edge in sorted(set(every))]
    assert edges(*flat(polygons)).tolist() == found.tolist()


@given(POLYGONS)
@FEW
def test_sides_of_one_edge_are_paired(polygons: list[list[int]]) -> None:
    own = directed_edges(*flat(polygons))
    wanted = {
        (i, j)
        for i, j in combinations(range(len(own)), 2)
        if set(own[i].tolist()) == set(own[j].tolist())
    }
    one, other = coincident_edges(own)
    pairs = [
        (min(pair), max(pair))
        for pair in zip(one.tolist(), other.tolist(), strict=True)
    ]
    assert len(pairs) == len(wanted)
    assert set(pairs) == wanted


@given(POLYGONS)
@FEW
def test_a_fan_has_two_triangles_less_than_corners(polygons: list[list[int]]) -> None:
    triangles = triangulate(*flat(polygons))
    assert len(triangles) == sum(len(polygon) - 2 for polygon in polygons)
    corners = {corner for polygon in polygons for corner in polygon}
    assert set(triangles.ravel().tolist()) == corners


def test_nothing_has_no_pairs() -> None:
    none = np.zeros((0, 2), np.int64)
    assert unique_pairs(none).shape == (0, 2)
    assert [len(part) for part in coincident_edges(none)] == [0, 0]


@given(POLYGONS)
@FEW
def test_what_is_closed_has_two_faces_at_every_edge(polygons: list[list[int]]) -> None:
    both = [*polygons, *polygons]
    for some in (polygons, both):
        found = is_closed(*flat(some))
        assert found == bool((edge_counts(*flat(some))[1] == 2).all())
