"""Blend shapes: prepared once, then evaluated over frames of weights.

A shape has offsets at weight 1, and possibly at inbetween weights. Each of these is a
column, and points are linear in the columns: frames are a product of column weights
and offsets. It is dense for shapes that move most of the mesh, and sparse for those
that move a region.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, cast

import numpy as np
import numpy.typing as npt

from animtool import _kernels
from animtool.core.array_types import (
    ArrayLike,
    BoolArray,
    FloatArray,
    IntArray,
    as_floats,
    output_array,
)
from animtool.core.errors import Fault, FormatError, listed
from animtool.core.record import dataclass

# Minimum distance of inbetween weights from 0, 1 and each other; UsdSkel skips closer
# ones.
MIN_INBETWEEN_DISTANCE = 1e-6

# Cost of the sparse relative to the dense product, measured per frame over 10 000
# vertices on one thread (tests/bench/deform.py): a dense column takes 1.75 us for any
# number of offsets; a full sparse column 4.3 us, in proportion to its offsets; using
# both takes another pass over the points, 11.6 us. So sparse is cheaper while fewer
# than 40 % of the vertices move.
SPARSE_COST = 2.5
PASS_COLUMNS = 6.6

# Rows of the dense table are copied to leave out inactive columns. Copying a row costs
# as much as its product over this many frames (measured: 6.7).
MIN_COPY_FRAMES = 7


@dataclass(frozen=True, slots=True)
class InbetweenDeltas:
    """The offsets of a shape at an inbetween weight."""

    weight: float  # weight of the full offsets [1], neither 0 nor 1
    # ``(D, 3)`` at the vertices of the shape; None moves no points.
    offsets: ArrayLike | None
    normal_offsets: ArrayLike | None = None  # ``(D, 3)``; None keeps normals


@dataclass(frozen=True, slots=True)
class ShapeDeltas:
    """A blend shape as stored in files."""

    name: str  # name of the shape, for messages
    # ``(D, 3)`` added at weight 1, in the space and unit of the points; None if the
    # shape changes normals only.
    offsets: ArrayLike | None
    # Vertices of the offsets ``(D,)``; None is every vertex.
    indices: ArrayLike | None = None
    # Normal offsets ``(D, 3)``; None leaves the normals unchanged.
    normal_offsets: ArrayLike | None = None
    # Offsets at weights other than 0 and 1, in any order.
    inbetweens: tuple[InbetweenDeltas, ...] = ()


@dataclass(frozen=True, slots=True)
class _Columns:
    """Rest values and offsets of C columns, each dense or sparse."""

    rest: FloatArray  # ``(1, V, 3)``
    is_dense: BoolArray  # whether each column is dense ``(C,)``
    dense_table: FloatArray  # ``(1 + dense, 3·V)``: rest values, then dense columns
    row_starts: IntArray  # first sparse offset of each vertex, and the end ``(V + 1,)``
    columns: npt.NDArray[np.int32]  # column of each sparse offset ``(K,)`` int32
    offsets: FloatArray  # sparse offsets ``(K, 3)``


@dataclass(frozen=True, slots=True)
class PreparedShapes:
    """The shapes of a mesh, ready to be evaluated."""

    names: tuple[str, ...]  # names of the S shapes, in the order of the weights
    # Weights at which each shape has offsets, 0 and 1 included, ascending.
    knots: tuple[FloatArray, ...]
    points: _Columns  # columns of the points: one per shape and knot, except knot 0
    normals: _Columns | None  # columns of the normals; None without normals

    @property
    def vertices(self) -> int:
        """Number of vertices."""
        return int(self.points.rest.shape[1])


def prepare_shapes(
    shapes: Sequence[ShapeDeltas], points: ArrayLike, normals: ArrayLike | None = None
) -> PreparedShapes:
    """Return shapes prepared for evaluation on a mesh.

    Args:
        shapes: Blend shapes of the mesh.
        points: Points at rest ``(V, 3)``.
        normals: Normals at rest ``(V, 3)``; None without normals.

    >>> smile = ShapeDeltas("smile", [[0.0, 2.0, 0.0]], indices=[1])
    >>> shapes = prepare_shapes([smile], np.zeros((2, 3)))
    >>> blend_points(shapes, [[0.5]])[0].tolist()
    [[0.0, 0.0, 0.0], [0.0, 1.0, 0.0]]
    """
    rest = as_floats(points, ("V", 3), "points")
    faults = [fault for shape in shapes for fault in _shape_faults(shape, len(rest))]
    if faults:
        raise FormatError(faults)
    sorted_shapes = [_offsets_by_weight(shape) for shape in shapes]
    knots = tuple(
        np.array([offset.weight for offset in shape_offsets])
        for shape_offsets in sorted_shapes
    )
    return PreparedShapes(
        tuple(shape.name for shape in shapes),
        tuple(np.sort(np.append(weights, 0.0)) for weights in knots),
        _prepare_columns(
            shapes,
            [[p.offsets for p in shape_offsets] for shape_offsets in sorted_shapes],
            rest,
        ),
        None
        if normals is None
        else _prepare_columns(
            shapes,
            [
                [p.normal_offsets for p in shape_offsets]
                for shape_offsets in sorted_shapes
            ],
            as_floats(normals, (len(rest), 3), "normals"),
        ),
    )


def column_weights(shapes: PreparedShapes, weights: ArrayLike) -> FloatArray:
    """Return the weight of each column of offsets ``(F, C)``.

    A shape is piecewise linear through zero at 0, its offsets at 1 and its inbetweens;
    beyond them the first and last segment continue, as in UsdSkel.

    ``weights`` ``(F, S)`` [1].
    """
    values = as_floats(weights, ("F", len(shapes.names)), "weights")
    if all(len(knots) == 2 for knots in shapes.knots):
        return values
    weights_per_shape = [
        values[:, i : i + 1] if len(knots) == 2 else _hat_weights(knots, values[:, i])
        for i, knots in enumerate(shapes.knots)
    ]
    return np.concatenate([np.zeros((len(values), 0)), *weights_per_shape], axis=1)


def blend_points(
    shapes: PreparedShapes, weights: ArrayLike, *, out: FloatArray | None = None
) -> FloatArray:
    """Return the points of a mesh blended with its shapes ``(F, V, 3)``.

    Shapes with zero weight in all frames are skipped.

    ``weights`` ``(F, S)`` [1], ``out`` ``(F, V, 3)``.
    """
    return _blend_columns(shapes.points, column_weights(shapes, weights), out)


def blend_normals(
    shapes: PreparedShapes, weights: ArrayLike, *, out: FloatArray | None = None
) -> FloatArray:
    """Return the normals of a mesh blended with its shapes ``(F, V, 3)``, unnormalised.

    ``weights`` ``(F, S)`` [1], ``out`` ``(F, V, 3)``.
    """
    if shapes.normals is None:
        raise ValueError("the shapes were prepared without normals")
    return _blend_columns(shapes.normals, column_weights(shapes, weights), out)


def _blend_columns(
    columns: _Columns, weights: FloatArray, out: FloatArray | None
) -> FloatArray:
    """Return rest values plus columns times their weights ``(F, V, 3)``."""
    is_active = np.asarray(weights.any(axis=0), np.bool_)
    active_dense = np.asarray(columns.is_dense & is_active, np.bool_)
    active_sparse = np.asarray(~columns.is_dense & is_active, np.bool_)
    blended_rows = output_array(out, (len(weights), *columns.rest.shape[1:]))
    points = columns.rest
    if active_dense.any():
        _add_dense_columns(
            columns, weights, is_active, blended_rows.reshape(len(blended_rows), -1)
        )
        points = blended_rows
    if active_sparse.any():
        row_starts = columns.row_starts
        column_indices = columns.columns
        offsets = columns.offsets
        # The kernel skips inactive columns of a single frame.
        if len(weights) > 1:
            row_starts, column_indices, offsets = _active_offsets(
                columns, active_sparse
            )
        _kernels.add_sparse(
            points, weights, row_starts, column_indices, offsets, blended_rows
        )
    elif not active_dense.any():
        blended_rows[:] = points
    return blended_rows


def _add_dense_columns(
    columns: _Columns, weights: FloatArray, is_active: BoolArray, out: FloatArray
) -> None:
    """Fill in rest values plus dense columns times their weights ``(F, 3·V)``."""
    dense_weights, is_used = weights[:, columns.is_dense], is_active[columns.is_dense]
    dense_table = columns.dense_table
    inactive_count = len(is_used) - int(is_used.sum())
    if inactive_count * len(weights) > MIN_COPY_FRAMES * (
        len(is_used) - inactive_count + 1
    ):
        dense_table = dense_table[np.append(True, is_used)]
        dense_weights = dense_weights[:, is_used]
    factors = np.concatenate([np.ones((len(dense_weights), 1)), dense_weights], axis=1)
    np.matmul(factors, dense_table, out=out)


def _active_offsets(
    columns: _Columns, is_active: BoolArray
) -> tuple[IntArray, npt.NDArray[np.int32], FloatArray]:
    """Return the sparse offsets of the active columns."""
    is_kept = is_active[columns.columns]
    if is_kept.all():
        return columns.row_starts, columns.columns, columns.offsets
    kept_before = np.concatenate([[0], np.cumsum(is_kept)])
    return (
        kept_before[columns.row_starts],
        columns.columns[is_kept],
        columns.offsets[is_kept],
    )


def _hat_weights(knots: FloatArray, weights: FloatArray) -> FloatArray:
    """Return the hat function values of all knots except 0 ``(F, knots - 1)``."""
    last_segment = len(knots) - 2
    segments = np.clip(np.searchsorted(knots, weights, "right") - 1, 0, last_segment)
    fraction = (weights - knots[segments]) / (knots[segments + 1] - knots[segments])
    hats = np.zeros((len(weights), len(knots)))
    frames = np.arange(len(weights))
    hats[frames, segments] = 1.0 - fraction
    hats[frames, segments + 1] = fraction
    return hats[:, knots != 0]


def _offsets_by_weight(shape: ShapeDeltas) -> list[InbetweenDeltas]:
    """Return the offsets of a shape at all inbetween weights and 1, by weight.

    Empty offsets with normal offsets mean a shape of normals only.
    """
    full_offsets = InbetweenDeltas(1.0, shape.offsets, shape.normal_offsets)
    all_offsets = [
        replace(offset, offsets=None)
        if offset.normal_offsets is not None
        and np.size(cast("Any", offset.offsets)) == 0
        else offset
        for offset in (*shape.inbetweens, full_offsets)
    ]
    return sorted(all_offsets, key=lambda offset: offset.weight)


def _prepare_columns(
    shapes: Sequence[ShapeDeltas],
    offsets: Sequence[Sequence[ArrayLike | None]],
    rest: FloatArray,
) -> _Columns:
    """Return the dense and sparse columns of all shapes' offsets."""
    nonzero_offsets: list[tuple[IntArray, FloatArray]] = []
    for shape, shape_offsets in zip(shapes, offsets, strict=True):
        for shape_values in shape_offsets:
            nonzero_offsets.append(_nonzero_offsets(shape, shape_values, len(rest)))
    density = np.array([len(vertices) for vertices, _ in nonzero_offsets]) / max(
        len(rest), 1
    )
    is_dense = _is_dense(density)
    dense_table = np.zeros((1 + int(is_dense.sum()), *rest.shape))
    dense_table[0] = rest
    for row, i in enumerate(np.flatnonzero(is_dense), 1):
        vertices, shape_values = nonzero_offsets[i]
        if (vertices[1:] > vertices[:-1]).all():
            dense_table[row, vertices] = shape_values
        else:
            np.add.at(dense_table[row], vertices, shape_values)
    sparse = np.flatnonzero(~is_dense)
    sparse_vertices = np.concatenate(
        [np.zeros(0, np.int64), *(nonzero_offsets[i][0] for i in sparse)]
    )
    sparse_offsets = np.concatenate(
        [np.zeros((0, 3)), *(nonzero_offsets[i][1] for i in sparse)]
    )
    column_indices = np.repeat(
        sparse, [len(nonzero_offsets[i][0]) for i in sparse]
    ).astype(np.int32)
    order = np.argsort(sparse_vertices, kind="stable")
    counts = np.bincount(sparse_vertices, minlength=len(rest))
    return _Columns(
        rest[None],
        is_dense,
        dense_table.reshape(len(dense_table), -1),
        np.concatenate([[0], np.cumsum(counts)]).astype(np.int64),
        column_indices[order],
        sparse_offsets[order],
    )


def _is_dense(density: FloatArray) -> BoolArray:
    """Return a mask of the columns for which the dense product is faster."""
    cost = density * SPARSE_COST
    is_dense = np.asarray(cost >= 1.0)
    saved_cost = float((1.0 - cost[~is_dense]).sum())
    if is_dense.any() and saved_cost < PASS_COLUMNS:
        return np.ones(len(density), np.bool_)
    return is_dense


def _nonzero_offsets(
    shape: ShapeDeltas, values: ArrayLike | None, count: int
) -> tuple[IntArray, FloatArray]:
    """Return the indices of vertices with a nonzero offset, and their offsets."""
    if values is None:
        return np.zeros(0, np.int64), np.zeros((0, 3))
    offsets = np.asarray(values, np.float64)
    vertices = np.arange(count) if shape.indices is None else np.asarray(shape.indices)
    x, y, z = offsets.T
    is_nonzero = (x != 0) | (y != 0) | (z != 0)
    if is_nonzero.all():
        return vertices.astype(np.int64), offsets
    return vertices[is_nonzero].astype(np.int64), offsets[is_nonzero]


def _shape_faults(shape: ShapeDeltas, count: int) -> list[Fault]:
    """Return the faults of a shape's vertices, offsets and inbetweens."""
    label = f"shape {shape.name!r}"
    faults = []
    length = count
    if shape.indices is not None:
        vertices = np.asarray(shape.indices)
        if vertices.ndim != 1 or not (
            vertices.size == 0 or np.issubdtype(vertices.dtype, np.integer)
        ):
            message = (
                f"{label}: vertex indices are {vertices.dtype} {vertices.shape}, not "
                "integers (D,)"
            )
            return [Fault("SKIN001", message)]
        length = len(vertices)
        out_of_range = vertices[(vertices < 0) | (vertices >= count)].tolist()
        if out_of_range:
            message = (
                f"{label} moves vertices outside 0…{count - 1}: {listed(out_of_range)}"
            )
            faults.append(Fault("SKIN002", message))
    for offset in _offsets_by_weight(shape):
        for array_name, values in (
            ("offsets", offset.offsets),
            ("normal offsets", offset.normal_offsets),
        ):
            if values is not None:
                name = f"{label}: {array_name} at {offset.weight:g}"
                faults += _offset_faults(name, values, length)
    return faults + _knot_faults(label, shape)


def _offset_faults(name: str, values: ArrayLike, length: int) -> list[Fault]:
    """Return the faults of offsets: wrong shape, or not finite."""
    array = np.asarray(values, np.float64)
    if array.shape != (length, 3):
        message = f"{name} are {array.shape}, but must be ({length}, 3)"
        return [Fault("SKIN001", message)]
    is_finite = np.isfinite(array)
    if is_finite.all():
        return []
    not_finite = np.flatnonzero(~is_finite.all(axis=1)).tolist()
    return [Fault("SKIN003", f"{name} are not finite in rows {listed(not_finite)}")]


def _knot_faults(label: str, shape: ShapeDeltas) -> list[Fault]:
    """Return a fault if inbetweens share a weight, or are at 0 or 1."""
    knots = np.sort([0.0, 1.0, *(inbetween.weight for inbetween in shape.inbetweens)])
    if (np.diff(knots) > MIN_INBETWEEN_DISTANCE).all():
        return []
    weights = listed([f"{inbetween.weight:g}" for inbetween in shape.inbetweens])
    message = f"{label} has inbetweens at {weights}"
    hint = "each needs its own weight, other than 0 and 1"
    return [Fault("SKIN006", message, hint=hint)]
