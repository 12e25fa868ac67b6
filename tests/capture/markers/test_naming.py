"""Names of points that explain all distances between them best."""

from __future__ import annotations

import numpy as np
import pytest

from animtool.capture.markers.geometry import MarkerDistances
from animtool.capture.markers.naming import PointNaming

SHAPE = np.random.default_rng(6).uniform(-0.15, 0.15, (7, 3))
REST = np.linalg.norm(SHAPE[:, None] - SHAPE, axis=-1)


def naming(order: list[int], seen: float = 100.0) -> PointNaming:
    """Return the naming of points that are these markers of one rigid shape."""
    mean = REST[np.ix_(order, order)] + 1e-4
    spread = np.full_like(mean, 5e-4)
    np.fill_diagonal(mean, np.nan)
    return PointNaming(MarkerDistances(mean, spread), np.full(mean.shape, seen), REST)


ORDER = [4, 0, 6, 2, 1, 5, 3]


def test_points_of_a_rigid_shape_get_the_names_of_those_about_them() -> None:
    own = naming(ORDER)
    assert (own.point_markers == -1).all()
    for point in (0, 1, 2):
        own.assign(point, ORDER[point])
    own.assign_greedily()
    assert own.point_markers.tolist() == ORDER
    other = own.copy()
    other.assign(0, -1)
    assert own.point_markers.tolist() == ORDER
    assert other.point_markers.tolist() == [-1, *ORDER[1:]]
    assert other.total_evidence() < own.total_evidence()
    other.assign_greedily()
    assert other.point_markers.tolist() == ORDER
    assert own.total_evidence() == pytest.approx(other.total_evidence(), rel=1e-5)


@pytest.mark.parametrize(("a", "b"), [(0, 3), (1, 6), (2, 5)])
def test_names_that_are_swapped_are_put_right(a: int, b: int) -> None:
    """The first marker and the last one too."""
    own = naming(ORDER)
    wrong = [b if m == a else a if m == b else m for m in ORDER]
    for point, marker in enumerate(wrong):
        own.assign(point, marker)
    before = own.total_evidence()
    own.improve()
    assert own.point_markers.tolist() == ORDER
    assert own.total_evidence() > before + 1


def test_two_pairs_and_three_are_swapped_at_once() -> None:
    for change in ({0: 1, 1: 2, 2: 0}, {0: 1, 1: 0, 2: 3, 3: 2}):
        own = naming(ORDER)
        for point, marker in enumerate(ORDER):
            own.assign(point, change.get(marker, marker))
        own.improve()
        assert own.point_markers.tolist() == ORDER


def test_names_in_doubt_and_markers_that_lack_points() -> None:
    own = naming(ORDER)
    for point, marker in enumerate(ORDER):
        own.assign(point, marker)
    assert own.most_doubtful_point(set()) is None
    assert not len(own.scarce_markers())
    wrong = naming(ORDER)
    for point, marker in enumerate([0, 4, *ORDER[2:]]):
        wrong.assign(point, marker)
    found = wrong.most_doubtful_point(set())
    assert found in {(0, 4), (1, 0)}
    assert wrong.most_doubtful_point({(0, 4), (1, 0)}) not in {(0, 4), (1, 0)}
    own.assign(3, -1)
    assert own.scarce_markers().tolist() == [2]


def test_who_gets_a_name_takes_it_from_those_who_are_seen_with_him() -> None:
    """And those about them are named anew, where that is asked for."""
    nowhere = np.zeros(7, bool)
    for around in (nowhere, nowhere | (np.arange(7) == ORDER[5])):
        own = naming(ORDER)
        for point, marker in enumerate(ORDER):
            own.assign(
                point, {ORDER[0]: ORDER[3], ORDER[3]: ORDER[0]}.get(marker, marker)
            )
        own.force_name(0, ORDER[0], around)
        assert own.point_markers.tolist() == ORDER
    apart = naming(ORDER)
    apart.are_concurrent = np.zeros_like(apart.are_concurrent)
    apart.assign(3, 4)
    apart.force_name(0, 4, nowhere)
    assert (apart.point_markers[0], apart.point_markers[3]) == (4, 4)
