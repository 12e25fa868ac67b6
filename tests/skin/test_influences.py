from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

from animtool.core.errors import FormatError
from animtool.skin.influences import read_influences


def faults_of(indices: object, weights: object, **options: object) -> list[str]:
    with pytest.raises(FormatError) as caught:
        read_influences(indices, weights, **{"joint_count": 3, **options})
    return [str(fault) for fault in caught.value.faults]


def test_the_strongest_is_first_and_nothing_weightless_is_left() -> None:
    found, report = read_influences(
        [[0, 1, 2], [2, 0, 0]], [[0.25, 0.75, 0], [1, 0, 0]], 3
    )
    assert_array_equal(found.row_starts, [0, 2, 3])
    assert_array_equal(found.joints, [1, 0, 2])
    assert_array_equal(found.weights, [0.75, 0.25, 1])
    assert report.normalized_count == 0


def test_a_joint_named_twice_counts_once() -> None:
    found, _ = read_influences([[1, 1, 0]], [[0.3, 0.2, 0.5]], 2)
    assert_array_equal(found.joints, [0, 1])
    assert_allclose(found.weights, [0.5, 0.5])


def test_rounding_of_float32_is_not_called_normalised() -> None:
    weights = np.full((1, 3), 1 / 3, np.float32)
    found, report = read_influences([[0, 1, 2]], weights, 3)
    assert report.normalized_count == 0
    assert abs(found.weights.sum() - 1) < 1e-15


def test_one_row_stands_for_all_vertices() -> None:
    found, _ = read_influences([[2]], [[1.0]], 3, vertex_count=4)
    assert_array_equal(found.joints, [2, 2, 2, 2])


@given(st.integers(0, 2**32 - 1), st.integers(1, 6), st.integers(1, 5))
def test_each_vertex_sums_to_one(seed: int, count: int, joints: int) -> None:
    rng = np.random.default_rng(seed)
    weights = rng.random((9, count)) * (rng.random((9, count)) < 0.7)
    weights[:, 0] += 0.1
    indices = rng.integers(0, joints, (9, count))
    found, _ = read_influences(indices, weights, joints)
    dense = np.zeros((9, joints))
    np.add.at(dense, (np.arange(9)[:, None], indices), weights)
    dense /= dense.sum(axis=1, keepdims=True)
    again = np.zeros_like(dense)
    again[np.repeat(np.arange(9), np.diff(found.row_starts)), found.joints] = (
        found.weights
    )
    assert_allclose(again, dense, atol=1e-15)


@pytest.mark.parametrize(
    ("indices", "weights", "code", "says"),
    [
        ([[0, 1]], [[1.0]], "SKIN001", "(1, 2)"),
        ([0, 1], [1.0, 1.0], "SKIN001", "(2,)"),
        ([[0.5]], [[1.0]], "SKIN002", "float64"),
        ([[0], [3]], [[1.0], [1.0]], "SKIN002", "0…2: 1"),
        ([[0], [-1]], [[1.0], [0.0]], "SKIN002", "0…2: 1"),
        ([[0], [0], [1]], [[1.0], [1.0], [np.nan]], "SKIN003", "finite: 2"),
        (
            [[0], [0]],
            [[0.0], [1.0]],
            "SKIN004",
            "vertex with no weight on any joint: 0",
        ),
        ([[0, 1]], [[1.0, -1.0]], "SKIN004", ": 0"),
    ],
)
def test_a_fault_is_named(
    indices: object, weights: object, code: str, says: str
) -> None:
    (fault,) = faults_of(indices, weights)
    assert code in fault
    assert says in fault


def test_all_faults_are_told_at_once() -> None:
    faults = faults_of([[0], [5], [0]], [[1.0], [1.0], [np.inf]])
    assert [fault[:7] for fault in faults] == ["SKIN002", "SKIN003"]


def test_another_number_of_vertices_is_refused() -> None:
    (fault,) = faults_of([[0], [0]], [[1.0], [1.0]], vertex_count=3)
    assert "SKIN001 influences of 2 vertices, but there are 3" in fault
