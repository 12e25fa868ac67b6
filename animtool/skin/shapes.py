"""Blend shapes: prepared once, then evaluated over frames of weights.

A shape has offsets at weight 1, and possibly at inbetween weights. Each of these is a
column, and points are linear in the columns: frames are a product of column weights
and offsets. It is dense for shapes that move most of the mesh, and sparse for those
that move a region.
"""

from __future__ import annotations

from collections.abc import Sequence

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
from animtool.rig.surfaces import SurfaceInbetween, SurfaceShape

# Minimum distance of inbetween weights from 0, 1 and each other; UsdSkel skips closer
# ones.
MIN_INBETWEEN_DISTANCE = 1e-6

# Cost of the sparse relative to the dense product, measured per frame over 10 000
# vertices on one thread (tests/bench/deform.py): a dense column takes 1.75 us for any
# number of offsets; a full sparse column 4.3 us, in proportion to its offsets; using
# both takes another pass over the points, 11.6 us. So sparse is cheaper while fewer
# than 40 % of the vertices move.
SPARSE_COST = 2.5
SPARSE_PASS_COST = 6.6

# Rows of the dense table are copied to leave out inactive columns. Copying a row costs
# as much as its product over this many frames (measured: 6.7).
MIN_COPY_FRAMES = 7


@dataclass(frozen=True, slots=True)
class _Columns:
    """Rest values of vertices, and C columns of offsets, each dense or sparse."""

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
    normals: _Columns | None  # columns of the normals; None if it has none

    @property
    def vertex_count(self) -> int:
        """Number of vertices of the mesh that the shapes deform."""
        return int(self.points.rest.shape[1])


def prepare_shapes(
    shapes: Sequence[SurfaceShape], points: ArrayLike, normals: ArrayLike | None = None
) -> PreparedShapes:
    """Return shapes prepared for evaluation on a mesh.

    Args:
        shapes: Blend shapes of the mesh.
        points: Points at rest ``(V, 3)``.
        normals: Normals at rest ``(V, 3)``; None if it has none.

    >>> smile = SurfaceShape("smile", np.array([[0.0, 2.0, 0.0]]), np.array([1]))
    >>> shapes = prepare_shapes([smile], np.zeros((2, 3)))
    >>> blend_points(shapes, [[0.5]])[0].tolist()
    [[0.0, 0.0, 0.0], [0.0, 1.0, 0.0]]
    """
    rest = as_floats(points, ("V", 3), "points")
    faults = [fault for shape in shapes for fault in _shape_faults(shape, len(rest))]
    if faults:
        raise FormatError(faults)
    columns = [
        (shape, inbetween) for shape in shapes for inbetween in _deltas_by_weight(shape)
    ]
    prepared_normals = None
    if normals is not None:
        prepared_normals = _prepare_columns(
            [_nonzero_offsets(s, i.normals, len(rest)) for s, i in columns],
            as_floats(normals, (len(rest), 3), "normals"),
        )
    return PreparedShapes(
        tuple(shape.name for shape in shapes),
        tuple(
            np.sort([0.0, *(inbetween.at for inbetween in _deltas_by_weight(shape))])
            for shape in shapes
        ),
        _prepare_columns(
            [_nonzero_offsets(s, i.deltas, len(rest)) for s, i in columns], rest
        ),
        prepared_normals,
    )


def column_weights(shapes: PreparedShapes, weights: ArrayLike) -> FloatArray:
    """Return the weight of each column of offsets ``(F, C)``.

    A shape is piecewise linear through zero at 0, its offsets at 1 and its inbetweens;
    beyond them the first and last segment continue, as in UsdSkel.

    ``weights`` ``(F, S)`` [1].
    """
    shape_weights = as_floats(weights, ("F", len(shapes.names)), "weights")
    if all(len(knots) == 2 for knots in shapes.knots):
        return shape_weights
    weights_per_shape = [
        shape_weights[:, i : i + 1]
        if len(knots) == 2
        else _hat_weights(knots, shape_weights[:, i])
        for i, knots in enumerate(shapes.knots)
    ]
    return np.concatenate(
        [np.zeros((len(shape_weights), 0)), *weights_per_shape], axis=1
    )


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
    is_active_dense = np.asarray(columns.is_dense & is_active, np.bool_)
    is_active_sparse = np.asarray(~columns.is_dense & is_active, np.bool_)
    blended_rows = output_array(out, (len(weights), *columns.rest.shape[1:]))
    points = columns.rest
    if is_active_dense.any():
        _add_dense_columns(
            columns, weights, is_active, blended_rows.reshape(len(blended_rows), -1)
        )
        points = blended_rows
    if is_active_sparse.any():
        row_starts = columns.row_starts
        column_indices = columns.columns
        offsets = columns.offsets
        # The kernel skips inactive columns of a single frame.
        if len(weights) > 1:
            row_starts, column_indices, offsets = _active_offsets(
                columns, is_active_sparse
            )
        _kernels.add_sparse(
            points, weights, row_starts, column_indices, offsets, blended_rows
        )
    elif not is_active_dense.any():
        blended_rows[:] = points
    return blended_rows


def _add_dense_columns(
    columns: _Columns, weights: FloatArray, is_active: BoolArray, out: FloatArray
) -> None:
    """Write rest values plus weighted dense columns into ``out`` ``(F, 3·V)``."""
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
    columns: _Columns, is_active_column: BoolArray
) -> tuple[IntArray, npt.NDArray[np.int32], FloatArray]:
    """Return row starts, column indices and offsets of the active sparse columns."""
    is_active_offset = is_active_column[columns.columns]
    if is_active_offset.all():
        return columns.row_starts, columns.columns, columns.offsets
    offset_counts = np.concatenate([[0], np.cumsum(is_active_offset)])
    return (
        offset_counts[columns.row_starts],
        columns.columns[is_active_offset],
        columns.offsets[is_active_offset],
    )


def _hat_weights(knots: FloatArray, weights: FloatArray) -> FloatArray:
    """Return the value of each knot's hat function, except 0's ``(F, knots - 1)``."""
    last_segment = len(knots) - 2
    segments = np.clip(np.searchsorted(knots, weights, "right") - 1, 0, last_segment)
    fraction = (weights - knots[segments]) / (knots[segments + 1] - knots[segments])
    hat_weights = np.zeros((len(weights), len(knots)))
    frames = np.arange(len(weights))
    hat_weights[frames, segments] = 1.0 - fraction
    hat_weights[frames, segments + 1] = fraction
    return hat_weights[:, knots != 0]


def _deltas_by_weight(shape: SurfaceShape) -> list[SurfaceInbetween]:
    """Return the deltas of a shape at its inbetween weights and 1, ascending."""
    full_deltas = SurfaceInbetween(1.0, shape.deltas, shape.normals)
    return sorted((*shape.inbetweens, full_deltas), key=lambda deltas: deltas.at)


def _prepare_columns(
    nonzero_offsets: Sequence[tuple[IntArray, FloatArray]], rest: FloatArray
) -> _Columns:
    """Return dense and sparse columns from the vertices and offsets of each column."""
    density = np.array([len(vertices) for vertices, _ in nonzero_offsets]) / max(
        len(rest), 1
    )
    is_dense = _is_dense(density)
    dense_table = np.zeros((1 + int(is_dense.sum()), *rest.shape))
    dense_table[0] = rest
    for row, i in enumerate(np.flatnonzero(is_dense).tolist(), 1):
        vertices, offsets = nonzero_offsets[i]
        if (vertices[1:] > vertices[:-1]).all():
            dense_table[row, vertices] = offsets
        else:
            np.add.at(dense_table[row], vertices, offsets)
    sparse_columns = np.flatnonzero(~is_dense).tolist()
    sparse_vertices = np.concatenate(
        [np.zeros(0, np.int64), *(nonzero_offsets[i][0] for i in sparse_columns)]
    )
    sparse_offsets = np.concatenate(
        [np.zeros((0, 3)), *(nonzero_offsets[i][1] for i in sparse_columns)]
    )
    column_indices = np.repeat(
        np.array(sparse_columns, np.int32),
        [len(nonzero_offsets[i][0]) for i in sparse_columns],
    )
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
    """Return a mask of the columns that are faster to evaluate as dense."""
    cost = density * SPARSE_COST
    is_dense = np.asarray(cost >= 1.0)
    saved_cost = float((1.0 - cost[~is_dense]).sum())
    if is_dense.any() and saved_cost < SPARSE_PASS_COST:
        return np.ones(len(density), np.bool_)
    return is_dense


def _nonzero_offsets(
    shape: SurfaceShape, values: FloatArray | None, vertex_count: int
) -> tuple[IntArray, FloatArray]:
    """Return the indices of vertices with a nonzero offset, and their offsets."""
    if values is None or not np.size(values):
        return np.zeros(0, np.int64), np.zeros((0, 3))
    offsets = np.asarray(values, np.float64)
    vertices = np.arange(vertex_count)
    if shape.vertices is not None:
        vertices = np.asarray(shape.vertices)
    x, y, z = offsets.T
    is_nonzero = (x != 0) | (y != 0) | (z != 0)
    if is_nonzero.all():
        return vertices.astype(np.int64), offsets
    return vertices[is_nonzero].astype(np.int64), offsets[is_nonzero]


def _shape_faults(shape: SurfaceShape, vertex_count: int) -> list[Fault]:
    """Return the faults in a shape's vertices, offsets and inbetweens."""
    label = f"shape {shape.name!r}"
    faults = []
    offset_count = vertex_count
    if shape.vertices is not None:
        vertices = np.asarray(shape.vertices)
        if vertices.ndim != 1 or not (
            vertices.size == 0 or np.issubdtype(vertices.dtype, np.integer)
        ):
            message = (
                f"{label}: vertex indices are {vertices.dtype} {vertices.shape}, not "
                "integers (D,)"
            )
            return [Fault("SKIN001", message)]
        offset_count = len(vertices)
        out_of_range = vertices[(vertices < 0) | (vertices >= vertex_count)].tolist()
        if out_of_range:
            message = (
                f"{label} moves vertices outside 0…{vertex_count - 1}: "
                f"{listed(out_of_range)}"
            )
            faults.append(Fault("SKIN002", message))
    for inbetween in _deltas_by_weight(shape):
        # Empty offsets with normal offsets are a shape that changes normals only.
        changes_points = inbetween.normals is None or np.size(inbetween.deltas)
        for array_name, values in (
            ("offsets", inbetween.deltas if changes_points else None),
            ("normal offsets", inbetween.normals),
        ):
            if values is not None:
                name = f"{label}: {array_name} at {inbetween.at:g}"
                faults += _offset_faults(name, values, offset_count)
    return faults + _knot_faults(label, shape)


def _offset_faults(name: str, values: FloatArray, offset_count: int) -> list[Fault]:
    """Return a fault if offsets have the wrong array shape or are not finite."""
    array = np.asarray(values, np.float64)
    if array.shape != (offset_count, 3):
        message = f"{name} are {array.shape}, but must be ({offset_count}, 3)"
        return [Fault("SKIN001", message)]
    is_finite = np.isfinite(array)
    if is_finite.all():
        return []
    bad_indices = np.flatnonzero(~is_finite.all(axis=1)).tolist()
    return [Fault("SKIN003", f"{name} are not finite in rows {listed(bad_indices)}")]


def _knot_faults(label: str, shape: SurfaceShape) -> list[Fault]:
    """Return a fault if inbetweens share a weight, or are at 0 or 1."""
    knots = np.sort([0.0, 1.0, *(inbetween.at for inbetween in shape.inbetweens)])
    if (np.diff(knots) > MIN_INBETWEEN_DISTANCE).all():
        return []
    weights = listed([f"{inbetween.at:g}" for inbetween in shape.inbetweens])
    message = f"{label} has inbetweens at {weights}"
    hint = "each needs its own weight, other than 0 and 1"
    return [Fault("SKIN006", message, hint=hint)]
