from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal
from support.faults import raises
from support.skins import Array

from animtool.core.errors import FormatError
from animtool.rig.surfaces import SurfaceInbetween, SurfaceShape
from animtool.skin.shapes import (
    PreparedShapes,
    blend_normals,
    blend_points,
    column_weights,
    prepare_shapes,
)

seeds = st.integers(0, 2**32 - 1)


def random_shapes(rng: np.random.Generator, vertices: int) -> list[SurfaceShape]:
    """Return dense and sparse shapes, enough of each for both products."""
    shapes = []
    for i in range(30):
        count = vertices if i % 2 else 2
        at = None if i % 2 else rng.permutation(vertices)[:count]
        knots = [[], [0.5], [0.2, -0.3, 1.4]][i % 3]
        between = tuple(
            SurfaceInbetween(
                k, rng.normal(size=(count, 3)), rng.normal(size=(count, 3))
            )
            for k in knots
        )
        offsets, turns = rng.normal(size=(2, count, 3))
        shapes.append(SurfaceShape(f"s{i}", offsets, at, turns, between))
    return shapes


def plain(
    shapes: list[SurfaceShape], rest: Array, weights: Array, what: str = "deltas"
) -> Array:
    """Return points one shape, one frame after the other."""
    made = np.repeat(rest[None], len(weights), axis=0)
    for f, row in enumerate(weights):
        for shape, weight in zip(shapes, row, strict=True):
            parts = [SurfaceInbetween(1.0, shape.deltas, shape.normals)]
            parts += shape.inbetweens
            knots = {part.at: np.asarray(getattr(part, what)) for part in parts}
            knots[0.0] = np.zeros_like(knots[1.0])
            at = sorted(knots)
            i = max(sum(knot <= weight for knot in at) - 1, 0)
            i = min(i, len(at) - 2)
            share = (weight - at[i]) / (at[i + 1] - at[i])
            offset = (1 - share) * knots[at[i]] + share * knots[at[i + 1]]
            where = (
                slice(None) if shape.vertices is None else np.asarray(shape.vertices)
            )
            made[f, where] += offset
    return made


@given(seeds, st.integers(1, 9), st.integers(20, 40))
def test_points_and_normals_written_out(seed: int, frames: int, vertices: int) -> None:
    rng = np.random.default_rng(seed)
    rest, normals = rng.normal(size=(2, vertices, 3))
    shapes = random_shapes(rng, vertices)
    made = prepare_shapes(shapes, rest, normals)
    assert 0 < made.points.is_dense.sum() < len(made.points.is_dense)
    weights = rng.uniform(-1, 2, (frames, 30)) * (rng.random((frames, 30)) < 0.4)
    assert_allclose(
        blend_points(made, weights), plain(shapes, rest, weights), atol=1e-12
    )
    expected = plain(shapes, normals, weights, "normals")
    assert_allclose(blend_normals(made, weights), expected, atol=1e-12)


@given(seeds)
def test_shapes_without_inbetweens_are_linear(seed: int) -> None:
    rng = np.random.default_rng(seed)
    rest = rng.normal(size=(25, 3))
    shapes = [s for s in random_shapes(rng, 25) if not s.inbetweens]
    made = prepare_shapes(shapes, rest)
    a, b = rng.normal(size=(2, 4, len(shapes)))

    def offsets(weights: Array) -> Array:
        return blend_points(made, weights) - rest

    assert_allclose(offsets(2 * a - b), 2 * offsets(a) - offsets(b), atol=1e-11)


def one(knots: list[float]) -> PreparedShapes:
    parts = tuple(SurfaceInbetween(k, [[k * 10 + 1, 0, 0]]) for k in knots)
    return prepare_shapes(
        [SurfaceShape("s", [[3.0, 0, 0]], inbetweens=parts)], [[0, 0, 0]]
    )


@pytest.mark.parametrize(
    ("weight", "expected"),
    [(0, 0), (0.5, 6), (0.25, 3), (1, 3), (0.75, 4.5), (2, -3), (-1, -12)],
)
def test_inbetweens_are_hit_and_the_ends_go_on(weight: float, expected: float) -> None:
    assert blend_points(one([0.5]), [[weight]])[0, 0, 0] == expected


@given(st.lists(st.integers(-30, 30), min_size=1, max_size=6, unique=True))
def test_inbetweens_are_hit_exactly(tenths: list[int]) -> None:
    knots = [t / 10 for t in tenths if t not in {0, 10}]
    for knot in knots:
        assert blend_points(one(knots), [[knot]])[0, 0, 0] == knot * 10 + 1
    assert blend_points(one(knots), [[1.0]])[0, 0, 0] == 3
    assert blend_points(one(knots), [[0.0]])[0, 0, 0] == 0


def test_columns_of_a_shape_are_its_knots_but_zero() -> None:
    assert_allclose(column_weights(one([-0.5, 0.5]), [[-0.25]]), [[0.5, 0, 0]])
    assert_allclose(column_weights(one([-0.5, 0.5]), [[0.75]]), [[0, 0.5, 0.5]])


def test_what_moves_most_is_dense_and_the_rest_sparse() -> None:
    full = SurfaceShape("full", np.ones((100, 3)))
    tiny = [SurfaceShape(f"t{i}", np.ones((1, 3)), [i]) for i in range(40)]
    made = prepare_shapes([full, *tiny], np.zeros((100, 3)))
    assert_array_equal(np.flatnonzero(made.points.is_dense), [0])
    few = prepare_shapes([full, *tiny[:3]], np.zeros((100, 3)))
    assert few.points.is_dense.all()
    none = prepare_shapes(tiny[:3], np.zeros((100, 3)))
    assert not none.points.is_dense.any()


def test_offsets_of_zero_are_not_stored() -> None:
    offsets = np.zeros((100, 3))
    offsets[7] = 1
    made = prepare_shapes([SurfaceShape("s", offsets)], np.zeros((100, 3)))
    assert len(made.points.offsets) == 1


@pytest.mark.parametrize("dense", [True, False])
def test_shapes_that_never_show_change_no_bit(dense: bool) -> None:
    rng = np.random.default_rng(0)
    rest = rng.normal(size=(60, 3))
    count = 60 if dense else 5
    shapes = [
        SurfaceShape(f"s{i}", rng.normal(size=(count, 3)), np.arange(count))
        for i in range(20)
    ]
    weights = np.zeros((64, 20))
    assert_array_equal(blend_points(prepare_shapes(shapes, rest), weights)[5], rest)
    weights[:, :2] = rng.normal(size=(64, 2))
    all_of_them = blend_points(prepare_shapes(shapes, rest), weights)
    alone = blend_points(prepare_shapes(shapes[:2], rest), weights[:, :2])
    assert_allclose(all_of_them, alone, atol=1e-15)


def test_each_frame_alone_is_the_same() -> None:
    """Of sparse shapes, some of which are inactive in a frame."""
    rng = np.random.default_rng(4)
    shapes = [
        SurfaceShape(f"s{i}", rng.normal(size=(5, 3)), rng.permutation(60)[:5])
        for i in range(20)
    ]
    made = prepare_shapes(shapes, rng.normal(size=(60, 3)))
    weights = rng.normal(size=(7, 20)) * rng.integers(0, 2, (7, 20))
    whole = blend_points(made, weights)
    for f in range(7):
        assert_array_equal(blend_points(made, weights[f : f + 1])[0], whole[f])


def test_no_shapes_and_no_frames() -> None:
    made = prepare_shapes([], np.eye(3))
    assert_array_equal(blend_points(made, np.zeros((2, 0))), [np.eye(3)] * 2)
    assert blend_points(one([]), np.zeros((0, 1))).shape == (0, 1, 3)


@pytest.mark.parametrize("shown", [[], [1], [0], [0, 1]])
def test_a_result_is_filled_in(shown: list[int]) -> None:
    rng = np.random.default_rng(4)
    rest = rng.normal(size=(30, 3))
    made = prepare_shapes(random_shapes(rng, 30), rest)
    weights = np.zeros((5, 30))
    weights[:, shown] = 0.7
    out = np.full((5, 30, 3), np.nan)
    assert blend_points(made, weights, out=out) is out
    assert_array_equal(out, blend_points(made, weights))


@pytest.mark.parametrize(
    "out",
    [np.zeros((4, 30, 3)), np.zeros((5, 30, 3), np.float32), np.zeros((3, 30, 5)).T],
)
def test_a_result_of_another_kind_is_refused(out: Array) -> None:
    made = prepare_shapes([], np.zeros((30, 3)))
    with pytest.raises(ValueError, match=r"float64 \(5, 30, 3\), in C order"):
        blend_points(made, np.zeros((5, 0)), out=out)


def test_normals_that_were_not_prepared_are_refused() -> None:
    with pytest.raises(ValueError, match="without normals"):
        blend_normals(one([]), [[1.0]])


def between(at: float, offsets: object = ((0, 0, 0),)) -> tuple[SurfaceInbetween, ...]:
    return (SurfaceInbetween(at, np.asarray(offsets)),)


ROW = [[0.0, 0.0, 0.0]]


@pytest.mark.parametrize(
    ("shape", "code"),
    [
        (SurfaceShape("s", ROW), "SKIN001"),
        (SurfaceShape("s", ROW, [0, 1]), "SKIN001"),
        (SurfaceShape("s", ROW, [[0]]), "SKIN001"),
        (SurfaceShape("s", ROW, [0.5]), "SKIN001"),
        (SurfaceShape("s", ROW, [0], inbetweens=between(0.5, np.eye(3))), "SKIN001"),
        (SurfaceShape("s", ROW, [0], np.eye(3)), "SKIN001"),
        (SurfaceShape("s", ROW, [2]), "SKIN002"),
        (SurfaceShape("s", ROW, [-1]), "SKIN002"),
        (SurfaceShape("s", [[np.nan, 0, 0]], [0]), "SKIN003"),
        (SurfaceShape("s", ROW, [0], inbetweens=between(1.0)), "SKIN006"),
        (SurfaceShape("s", ROW, [0], inbetweens=between(0.0)), "SKIN006"),
        (SurfaceShape("s", ROW, [0], inbetweens=2 * between(0.5)), "SKIN006"),
    ],
)
def test_a_fault_is_named(shape: SurfaceShape, code: str) -> None:
    with raises(FormatError, code, match="'s'"):
        prepare_shapes([shape], np.zeros((2, 3)))


def test_the_faults_of_all_shapes_are_told_at_once() -> None:
    shapes = [SurfaceShape("a", ROW, [9]), SurfaceShape("b", [[np.inf, 0, 0]], [0])]
    with pytest.raises(FormatError) as caught:
        prepare_shapes(shapes, np.zeros((2, 3)))
    assert [fault.code for fault in caught.value.faults] == ["SKIN002", "SKIN003"]


@pytest.mark.parametrize("offsets", [None, [], np.zeros((0, 3))])
def test_a_shape_may_turn_normals_alone(offsets: object) -> None:
    turned = [[0.0, 0.5, 0.0]]
    half = (SurfaceInbetween(0.5, offsets, [[0.0, 0.1, 0.0]]),)
    shape = SurfaceShape("crease", offsets, [1], turned, half)
    made = prepare_shapes([shape], np.zeros((2, 3)), [[0.0, 0.0, 1.0]] * 2)
    weights = [[0.5], [1.0]]
    np.testing.assert_array_equal(blend_points(made, weights), np.zeros((2, 2, 3)))
    normals = blend_normals(made, weights)
    np.testing.assert_allclose(normals[:, 0], [[0, 0, 1]] * 2)
    tilts = normals[:, 1, 1] / normals[:, 1, 2]
    np.testing.assert_allclose(tilts, [0.1, 0.5])
