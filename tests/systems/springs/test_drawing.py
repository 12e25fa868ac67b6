"""Surfaces that part where springs along their sides tear."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from support.suite import examples

from animtool.maths import so3
from animtool.systems.springs import Body, Family, Tearing, surface, tear_surface

Mesh = tuple[np.ndarray, np.ndarray, np.ndarray]
AWAY = np.array([1.0, 2.0, 3.0])
KINDS = ("quads", "triangles", "both")


def grid(kind: str, columns: int = 5, rows: int = 4) -> Mesh:
    """Return points, counts and corners of a flat sheet of some kind of faces."""
    at = np.arange(rows * columns).reshape(rows, columns)
    points = np.array([[x, y, 0.0] for y in range(rows) for x in range(columns)])
    faces = []
    for y in range(rows - 1):
        for x in range(columns - 1):
            a, b, c, d = at[y, x], at[y, x + 1], at[y + 1, x + 1], at[y + 1, x]
            split = kind == "triangles" or (kind == "both" and (x + y) % 2)
            faces += [[a, b, c], [a, c, d]] if split else [[a, b, c, d]]
    counts = np.array([len(face) for face in faces])
    return points, counts, np.concatenate(faces).astype(np.int64)


def sides_of(body: Body, counts: np.ndarray, indices: np.ndarray) -> np.ndarray:
    known = {
        tuple(sorted(ends)): i for i, ends in enumerate(body.springs.ends.tolist())
    }
    return np.array([known[tuple(sorted(side))] for side in sides(counts, indices)])


def sides(counts: np.ndarray, indices: np.ndarray) -> list[tuple[int, int]]:
    found = []
    start = 0
    for count in counts.tolist():
        face = indices[start : start + count].tolist()
        found += list(zip(face, [*face[1:], face[0]], strict=True))
        start += count
    return found


def areas(points: np.ndarray, counts: np.ndarray, indices: np.ndarray) -> np.ndarray:
    """Return the areas of flat faces, of fans about their first corners."""
    found, start = [], 0
    for count in counts.tolist():
        face = points[indices[start : start + count]]
        ways = face[1:] - face[0]
        found.append(np.linalg.norm(np.cross(ways[:-1], ways[1:]).sum(axis=0)) / 2)
        start += count
    return np.array(found)


def parts(count: int, pairs: np.ndarray) -> np.ndarray:
    """Return the part that each of some things is in, by pairs that are together."""
    pairs = np.asarray(pairs, np.int64).reshape(-1, 2)
    graph = coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), (count, count))
    return np.asarray(connected_components(graph, directed=False)[1])


def made(kind: str, torn: list[int]) -> tuple[Mesh, Body, np.ndarray, Tearing]:
    points, counts, indices = grid(kind)
    body = surface(points, counts, indices, mass=1.0, structural=Family(1.0))
    ever = np.isin(np.arange(len(body.springs.rest)), torn)
    along = sides_of(body, counts, indices)
    found = tear_surface(counts, indices, along, body.springs, ever, points)
    return (points, counts, indices), body, ever, found


def knows_its_turn(found: Tearing) -> bool:
    """Return whether every particle at a tear has neighbours in two directions."""
    turning = found.rotations
    ways = [
        turning.rest_offsets[turning.owners == i] for i in range(len(turning.particles))
    ]
    return all(np.linalg.matrix_rank(own) == 2 for own in ways)


# Springs of each kind of sheet are 31 and more.
torn_springs = st.lists(st.integers(0, 30), max_size=31)


@settings(deadline=None, max_examples=examples(60))
@given(kind=st.sampled_from(KINDS), torn=torn_springs)
def test_until_it_tears_it_is_the_same_surface(kind: str, torn: list[int]) -> None:
    (points, counts, indices), _, ever, found = made(kind, torn)
    rng = np.random.default_rng(len(torn))
    # Sheared and stretched, so that it is flat and nothing is where it was.
    moved = points @ (np.eye(3) + 0.3 * rng.standard_normal((3, 3)))
    drawn = found.points(moved, np.zeros_like(ever))
    assert len(drawn) == found.size
    assert found.indices.max() < found.size
    assert np.array_equal(drawn[: len(points)], moved)
    before, after = (
        areas(moved, counts, indices).sum(),
        areas(drawn, found.counts, found.indices).sum(),
    )
    assert after == pytest.approx(before, rel=1e-9)
    # Seams are closed: every point that is not a particle is where its twin is.
    for e in range(len(found.springs)):
        one = len(points) + 2 * e
        assert np.array_equal(drawn[one], drawn[one + 1])


@settings(deadline=None, max_examples=examples(60))
@given(kind=st.sampled_from(KINDS), torn=torn_springs)
def test_its_parts_are_those_of_its_particles(kind: str, torn: list[int]) -> None:
    (points, _, _), body, ever, found = made(kind, torn)
    together = parts(len(points), body.springs.ends[~ever])
    drawn = parts(found.size, np.array(sides(found.counts, found.indices)))
    used = np.unique(found.indices)
    of_drawn = drawn[: len(points)]
    same = of_drawn[:, None] == of_drawn[None]
    assert np.array_equal(same, together[:, None] == together[None])
    # Nothing is drawn that goes with no particle.
    assert set(drawn[used]) == set(of_drawn)


@settings(deadline=None, max_examples=examples(60))
@given(kind=st.sampled_from(KINDS), torn=torn_springs, now=torn_springs)
def test_no_area_is_lost_where_all_of_it_moves_alike(
    kind: str, torn: list[int], now: list[int]
) -> None:
    (points, counts, indices), _, ever, found = made(kind, torn)
    turn = np.array([0.4, -0.5, 0.1, 0.76])
    turn /= np.linalg.norm(turn)
    moved = so3.rotate(turn, points) + AWAY
    gone = ever & np.isin(np.arange(len(ever)), now)
    drawn = found.points(moved, gone)
    apart = so3.rotate(turn, found.points(points, np.zeros_like(ever))) + AWAY
    stays = np.isin(np.arange(found.size), np.arange(len(points)))
    np.testing.assert_allclose(drawn[stays], apart[stays], atol=1e-12)
    if knows_its_turn(found):
        np.testing.assert_allclose(drawn, apart, atol=1e-6)
        total = areas(drawn, found.counts, found.indices).sum()
        assert total == pytest.approx(areas(points, counts, indices).sum(), rel=1e-6)


def test_halves_go_with_their_particles() -> None:
    points, counts, indices = grid("quads", 3, 2)
    body = surface(points, counts, indices, mass=1.0, structural=Family(1.0))
    ends = body.springs.ends.tolist()
    ever = np.array([end in ([1, 2], [4, 5]) for end in ends])
    found = tear_surface(
        counts, indices, sides_of(body, counts, indices), body.springs, ever, points
    )
    moved = points + np.where(points[:, :1] == 2, [[5.0, 0, 0]], 0.0)
    drawn = found.points(moved, ever)
    assert found.counts.tolist() == [4, 4, 4]
    total = areas(drawn, found.counts, found.indices)
    np.testing.assert_allclose(total, [1.0, 0.5, 0.5], rtol=1e-6)
    assert sorted({round(x, 6) for x in drawn[:, 0]}) == [0, 1, 1.5, 6.5, 7]


def test_a_face_with_one_torn_side_opens_to_its_middle() -> None:
    points, counts, indices = grid("quads", 2, 2)
    body = surface(points, counts, indices, mass=1.0, structural=Family(1.0))
    ever = np.array([end == [0, 1] for end in body.springs.ends.tolist()])
    found = tear_surface(
        counts, indices, sides_of(body, counts, indices), body.springs, ever, points
    )
    assert found.counts.tolist() == [3] * 5
    assert found.size == 4 + 2 + 1
    moved = points.copy()
    moved[:2, 0] = [-0.5, 1.5]
    drawn = found.points(moved, ever)
    np.testing.assert_allclose(drawn[-1], [0.5, 0.5, 0])
    wedge = drawn[5, 0] - drawn[4, 0]
    assert 0.5 < wedge < 1.5
    whole = areas(found.points(moved, ~ever & ever), found.counts, found.indices)
    assert areas(drawn, found.counts, found.indices).sum() < whole.sum()


def test_parts_of_a_face_in_three_meet_until_two_sides_are_torn() -> None:
    points, counts, indices = grid("triangles", 2, 2)
    body = surface(points, counts, indices, mass=1.0, structural=Family(1.0))
    along = sides_of(body, counts, indices)
    ever = np.isin(np.arange(len(body.springs.rest)), along[:3])
    found = tear_surface(counts, indices, along, body.springs, ever, points)
    first, second, third = along[:3]
    for gone, apart in (([], 1), ([first], 1), ([first, third], 2), (along[:3], 3)):
        drawn = found.points(points * 1.2, np.isin(np.arange(len(ever)), gone))
        corners = found.indices[np.cumsum(found.counts) - found.counts]
        middles = drawn[corners[found.counts == 4]]
        assert len(np.unique(middles.round(9), axis=0)) == apart
    assert second in found.springs


@settings(deadline=None, max_examples=examples(30))
@given(kind=st.sampled_from(KINDS), torn=torn_springs, now=torn_springs)
def test_velocities_are_those_of_the_points(
    kind: str, torn: list[int], now: list[int]
) -> None:
    (points, _, _), _, ever, found = made(kind, torn)
    gone = ever & np.isin(np.arange(len(ever)), now)
    spin = np.array([0.0, 0.0, 2.0])
    speeds = np.cross(spin, points) + AWAY
    drawn = found.points(points, gone)
    got = found.velocities(points, speeds, gone)
    assert np.array_equal(got[: len(points)], speeds)
    if knows_its_turn(found):
        np.testing.assert_allclose(got, np.cross(spin, drawn) + AWAY, atol=1e-5)
