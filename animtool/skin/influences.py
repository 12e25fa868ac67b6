"""Joint influences of vertices: checked, pruned and normalised."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from animtool.core.array_types import ArrayLike, BoolArray, FloatArray, IntArray
from animtool.core.errors import Fault, FormatError, listed
from animtool.core.record import dataclass

# Rounding error of sums of float32 weights.
SUM_TOLERANCE = 1e-6


@dataclass(frozen=True, slots=True)
class Influences:
    """Joint influences; those of vertex v are ``first[v]`` to ``first[v + 1]``."""

    first: IntArray  # ``(V + 1,)``, ascending from 0
    # ``(K,)`` int32, per vertex the strongest first, without duplicates.
    joints: npt.NDArray[np.int32]
    weights: FloatArray  # ``(K,)`` [1], not zero; they sum to 1 per vertex

    @property
    def vertices(self) -> int:
        """Number of vertices."""
        return len(self.first) - 1

    def rows(self, vertices: IntArray) -> Influences:
        """Return the influences of selected vertices, in their order.

        Args:
            vertices: Vertex indices ``(N,)``, possibly repeated.
        """
        counts = np.diff(self.first)[vertices]
        first = np.concatenate([[0], np.cumsum(counts)])
        entries = np.arange(first[-1]) + np.repeat(
            self.first[vertices] - first[:-1], counts
        )
        return Influences(first, self.joints[entries], self.weights[entries])


@dataclass(frozen=True, slots=True)
class InfluenceReport:
    """Corrections applied to influences on reading."""

    normalized: int  # vertices whose weights differ from the sum 1 by more than 1e-6
    pruned: int  # vertices with weights dropped by the limit of influences
    zeros: int  # influences of zero weight, removed
    merged: int  # duplicate influences of a joint, merged
    sum_error: float  # largest difference of a vertex's weight sum from 1, as read
    sum_vertex: int  # the vertex with that difference


def read_influences(
    indices: ArrayLike,
    weights: ArrayLike,
    joints: int,
    *,
    vertices: int | None = None,
    max_influences: int | None = None,
) -> tuple[Influences, InfluenceReport]:
    """Return the influences of a mesh, and the corrections applied.

    Influences of zero weight are removed, duplicate joints of a vertex are merged, and
    the weights of each vertex are normalised to the sum 1.

    Args:
        indices: ``(V, I)`` joint indices, or ``(1, I)`` for all vertices.
        weights: The same shape [1].
        joints: Number of joints.
        vertices: Expected number of vertices; None is the number of rows.
        max_influences: Number of the strongest influences to keep per vertex;
            None keeps all.

    >>> influences, report = read_influences([[0, 1]], [[3.0, 1.0]], joints=2)
    >>> influences.weights.tolist(), report.normalized, report.sum_error
    ([0.75, 0.25], 1, 3.0)
    """
    numbers, values = np.asarray(indices), np.asarray(weights, np.float64)
    _check_shapes(numbers, values, vertices)
    if vertices is not None and len(numbers) == 1:
        numbers = np.broadcast_to(numbers, (vertices, numbers.shape[1]))
        values = np.broadcast_to(values, numbers.shape)
    _check_values(numbers, values, joints)
    count = len(numbers)
    rows, joints_of_rows, strengths = _merge_duplicates(
        numbers.astype(np.int64), values, max(joints, 1)
    )
    weight_sums = np.bincount(rows, strengths, count).astype(np.float64)
    is_kept = _first_entries(rows, count, max_influences)
    is_pruned = np.bincount(rows[~is_kept], minlength=count) > 0
    nonzero, merged_count = int(np.count_nonzero(values)), len(rows)
    rows, joints_of_rows, strengths = (
        rows[is_kept],
        joints_of_rows[is_kept],
        strengths[is_kept],
    )
    totals = np.bincount(rows, strengths, count).astype(np.float64)
    _check_sums(weight_sums, totals)
    errors = np.abs(weight_sums - 1)
    report = InfluenceReport(
        normalized=int(np.count_nonzero(errors > SUM_TOLERANCE)),
        pruned=int(np.count_nonzero(is_pruned)),
        zeros=values.size - nonzero,
        merged=nonzero - merged_count,
        sum_error=float(errors.max(initial=0.0)),
        sum_vertex=int(np.argmax(errors)) if count else 0,
    )
    normalized = strengths / totals[rows]
    return Influences(
        _row_starts(rows, count), joints_of_rows.astype(np.int32), normalized
    ), report


def _merge_duplicates(
    numbers: IntArray, values: FloatArray, joints: int
) -> tuple[IntArray, IntArray, FloatArray]:
    """Return vertex, joint and weight of every influence, without duplicates.

    Sorted by vertex, then by descending weight; ties keep the order of the input.
    """
    order = np.argsort(-values, axis=1, kind="stable")
    strengths = np.take_along_axis(values, order, axis=1)
    sorted_joints = np.take_along_axis(numbers, order, axis=1)
    is_nonzero = strengths != 0
    rows = np.nonzero(is_nonzero)[0]
    sorted_joints, strengths = sorted_joints[is_nonzero], strengths[is_nonzero]
    if not _has_duplicates(numbers, values):
        return rows, sorted_joints, strengths
    pairs = rows * joints + sorted_joints
    unique, at, inverse = np.unique(pairs, return_index=True, return_inverse=True)
    merged_weights = np.bincount(inverse, strengths, len(unique)).astype(np.float64)
    order = np.argsort(at)
    return unique[order] // joints, unique[order] % joints, merged_weights[order]


def _has_duplicates(numbers: IntArray, values: FloatArray) -> bool:
    """Return whether a vertex has a joint twice with weight."""
    # Entries of zero weight get a placeholder that differs from all joints.
    placeholders = -1 - np.arange(numbers.shape[1])
    in_order = np.sort(np.where(values != 0, numbers, placeholders), axis=1)
    return bool((in_order[:, 1:] == in_order[:, :-1]).any())


def _row_starts(rows: IntArray, count: int) -> IntArray:
    """Return the first entry of each row, and the end ``(count + 1,)``."""
    counts = np.bincount(rows, minlength=count)
    return np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)


def _first_entries(rows: IntArray, count: int, max_count: int | None) -> BoolArray:
    """Return a mask of the first ``max_count`` entries of each row."""
    if max_count is None:
        return np.ones(len(rows), np.bool_)
    ranks = np.arange(len(rows)) - _row_starts(rows, count)[rows]
    return np.asarray(ranks < max_count, np.bool_)


def _check_shapes(
    numbers: npt.NDArray[np.generic], values: FloatArray, vertices: int | None
) -> None:
    faults = []
    if numbers.ndim != 2 or numbers.shape != values.shape:
        message = (
            f"joint indices {numbers.shape} and weights {values.shape} must both be "
            "(vertices, influences)"
        )
        faults.append(Fault("SKIN001", message))
    elif vertices is not None and len(numbers) not in {1, vertices}:
        message = f"influences of {len(numbers)} vertices, but there are {vertices}"
        faults.append(Fault("SKIN001", message))
    elif not np.issubdtype(numbers.dtype, np.integer):
        faults.append(
            Fault("SKIN002", f"joint indices are {numbers.dtype}, not integers")
        )
    if faults:
        raise FormatError(faults)


def _check_values(
    numbers: npt.NDArray[np.generic], values: FloatArray, joints: int
) -> None:
    integers = numbers.astype(np.int64)
    out_of_range = (integers < 0) | (integers >= joints)
    infinite = ~np.isfinite(values)
    faults = [
        *_vertex_faults(
            "SKIN002",
            _any_per_vertex(out_of_range),
            f"a joint index outside 0…{joints - 1}",
        ),
        *_vertex_faults(
            "SKIN003", _any_per_vertex(infinite), "a weight that is not finite"
        ),
    ]
    if faults:
        raise FormatError(faults)


def _any_per_vertex(is_wrong: BoolArray) -> BoolArray:
    return np.asarray(is_wrong.any(axis=1), np.bool_)


def _check_sums(sums: FloatArray, kept_sums: FloatArray) -> None:
    without_weight = np.minimum(sums, kept_sums) <= 0
    faults = _vertex_faults(
        "SKIN004", np.asarray(without_weight), "no weight on any joint"
    )
    if faults:
        raise FormatError(faults)


def _vertex_faults(code: str, is_wrong: BoolArray, problem: str) -> list[Fault]:
    """Return a fault that lists the vertices of a mask, if any."""
    at = np.flatnonzero(is_wrong).tolist()
    if not at:
        return []
    noun = "vertex" if len(at) == 1 else f"{len(at)} vertices"
    return [Fault(code, f"{noun} with {problem}: {listed(at)}")]
