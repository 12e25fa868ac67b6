"""Bodies as builders make them."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from animtool.maths.faces import triangulate
from animtool.systems.springs import (
    Body,
    Family,
    Pins,
    SpringOptions,
    SpringSystem,
    block,
    join,
    rope,
    sheet,
    simulate_springs,
    springs_between,
    strand,
    surface,
    tetrahedra,
)

ONE = Family(1.0)
FAMILIES = ("structural", "diagonal", "diagonals", "bend")


def pairs(body: Body) -> set[tuple[int, int]]:
    """Return who is joined to whom."""
    found = [tuple(sorted(ends)) for ends in body.springs.ends.tolist()]
    assert len(set(found)) == len(found)
    return set(found)


def test_a_rope_has_its_tip() -> None:
    body = rope([0, 0, 0], [0, 0, -3], 4, ONE, mass=0.5, tip_mass=9.0, bend=ONE)
    assert body.masses.tolist() == [0.5, 0.5, 0.5, 9.0]
    assert pairs(body) == {(0, 1), (1, 2), (2, 3), (0, 2), (1, 3)}
    assert body.springs.rest.tolist() == [1, 1, 1, 2, 2]


@given(st.integers(1, 6), st.integers(1, 6), st.sets(st.sampled_from(FAMILIES)))
def test_families_of_a_sheet_stand_alone_and_together(
    columns: int, rows: int, names: set[str]
) -> None:
    def made(chosen: set[str]) -> set[tuple[int, int]]:
        families = dict.fromkeys(chosen, ONE)
        found = sheet(columns, rows, mass=1.0, **families).springs.ends
        return {(min(ends), max(ends)) for ends in found.tolist()}

    counts = {
        "structural": (columns - 1) * rows + columns * (rows - 1),
        "diagonal": (columns - 1) * (rows - 1),
        "diagonals": 2 * (columns - 1) * (rows - 1),
        "bend": max(columns - 2, 0) * rows + columns * max(rows - 2, 0),
    }
    together: set[tuple[int, int]] = set()
    for name in names:
        alone = made({name})
        assert len(alone) == counts[name]
        together |= alone
    assert made(names) == together


def test_a_sheet_lies_where_it_is_told() -> None:
    body = sheet(3, 2, mass=1.0, corner=[1, 0, 0], across=[0, 2, 0], up=[0, 0, 5])
    assert body.positions[4].tolist() == [1, 1, 5]
    normals = np.cross(
        body.positions[body.triangles[:, 1]] - body.positions[body.triangles[:, 0]],
        body.positions[body.triangles[:, 2]] - body.positions[body.triangles[:, 0]],
    )
    assert (normals[:, 0] > 0).all()
    assert np.linalg.norm(normals, axis=1).sum() / 2 == pytest.approx(10)


def test_a_mesh_of_quads_is_the_sheet() -> None:
    flat = sheet(4, 3, mass=1.0, structural=ONE, diagonals=ONE)
    grid = np.arange(12).reshape(3, 4)
    quads = np.stack(
        [grid[:-1, :-1], grid[:-1, 1:], grid[1:, 1:], grid[1:, :-1]], axis=-1
    )
    body = surface(
        flat.positions, [4] * 6, quads.ravel(), mass=1.0, structural=ONE, diagonals=ONE
    )
    assert pairs(body) == pairs(flat)
    assert len(body.triangles) == 12


def test_an_edge_of_many_triangles_joins_all_of_them() -> None:
    fan = [0, 1, 2, 0, 1, 3, 1, 0, 4]
    body = surface(np.eye(5, 3), [3, 3, 3], fan, mass=1.0, bend=ONE)
    assert pairs(body) == {(2, 3), (2, 4), (3, 4)}


def test_corners_that_stand_twice_join_nothing() -> None:
    body = surface(np.eye(3, 3), [3], [0, 0, 1], mass=1.0, structural=ONE, bend=ONE)
    assert pairs(body) == {(0, 1)}


def test_polygons_are_crossed_between_corners_that_are_no_neighbours() -> None:
    six = np.arange(6)
    body = surface(np.eye(6, 3), [6], six, mass=1.0, diagonals=ONE)
    edges = {tuple(sorted((i, (i + 1) % 6))) for i in range(6)}
    assert pairs(body) == set(combinations(range(6), 2)) - edges
    assert triangulate(np.array([6]), six).tolist()[-1] == [0, 4, 5]


@given(st.integers(1, 4), st.integers(1, 4), st.integers(1, 4))
def test_a_block_joins_all_neighbours(a: int, b: int, c: int) -> None:
    body = block(
        (a, b, c), [a - 1, b - 1, c - 1], mass=1.0,
        structural=ONE, face_diagonals=ONE, body_diagonals=ONE,
    )  # fmt: skip
    places = body.positions.round().astype(int)
    near = {
        (i, j)
        for i, j in combinations(range(len(places)), 2)
        if np.abs(places[i] - places[j]).max() == 1
    }
    assert pairs(body) == near
    lengths = sorted(set(body.springs.rest.round(9)))
    assert set(lengths) <= {1.0, round(2**0.5, 9), round(3**0.5, 9)}


def volume(body: Body) -> float:
    """Return the volume that triangles close in."""
    a, b, c = body.positions[body.triangles].swapaxes(0, 1)
    return float((a * np.cross(b, c)).sum() / 6)


def test_the_skin_of_a_block_looks_outwards() -> None:
    body = block((3, 4, 2), [2, 3, 1], mass=1.0, structural=ONE, corner=[5, 5, 5])
    assert volume(body) == pytest.approx(6)


def test_the_skin_of_tetrahedra_looks_outwards() -> None:
    points = [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 1]]
    body = tetrahedra(points, [[0, 1, 2, 3], [1, 2, 3, 4]], ONE, mass=1.0)
    assert len(body.triangles) == 6
    assert len(pairs(body)) == 9
    assert volume(body) == pytest.approx(1 / 6 + 1 / 3)


def test_damping_may_be_a_share_of_what_is_critical() -> None:
    springs = springs_between(
        [[0, 1]], Family(4.0, damping=0.5, ratio=0.25, tear=0.5),
        np.array([[0.0, 0, 0], [2, 0, 0]]), np.array([1.0, 3.0]),
    )  # fmt: skip
    assert springs.damping[0] == pytest.approx(0.5 + 2 * 0.25 * (4 * 2) ** 0.5)
    assert springs.limit.tolist() == [3.0]


def test_springs_may_have_no_length() -> None:
    springs = springs_between([[0, 1]], ONE, np.eye(2, 3), np.ones(2), rest=0.0)
    assert springs.rest.tolist() == [0.0]
    assert springs.limit.tolist() == [np.inf]


def test_bodies_are_joined_one_behind_the_other() -> None:
    bodies = [
        strand(np.eye(3), ONE, mass=[1.0, 2.0, 3.0]),
        sheet(2, 2, mass=1.0, structural=ONE),
    ]
    both = join(bodies)
    assert both.masses.tolist() == [1, 2, 3, 1, 1, 1, 1]
    assert both.springs.ends.min(axis=0)[0] == 0
    assert both.springs.ends[2:].min() == 3
    assert both.triangles.min() == 3
    assert len(join([]).positions) == 0


def test_springs_of_a_frequency_swing_alike_whatever_their_mass() -> None:
    """A mass on a spring to a heavy one has the period that the frequency says."""
    for mass in (0.01, 3.0):
        body = rope([0, 0, 0], [0, 0, -1], 2, Family(0.0, frequency=2.0), mass=mass)
        assert_allclose(body.springs.stiffness, (4 * np.pi) ** 2 * mass)
        pinned = SpringSystem(body, pins=Pins([0]), gravity=[0, 0, 0])
        start = body.positions * 1.1
        motion = simulate_springs(
            pinned.starting_at(start), np.linspace(0, 0.5, 3), SpringOptions(step=1e-4)
        )
        heights = motion.positions[:, 1, 2]
        assert_allclose(heights, [-1.1, -0.9, -1.1], atol=1e-4)
