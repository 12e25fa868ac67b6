"""Joint influences of vertices: checked, pruned and normalised."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from animtool.core.array_types import ArrayLike, BoolArray, FloatArray, IntArray
from animtool.core.errors import Fault, FormatError, listed
from animtool.core.record import dataclass

# Tolerance of weight sums: rounding error of float32 weights.
SUM_TOLERANCE = 1e-6


@dataclass(frozen=True, slots=True)
class Influences:
    """Joint influences in CSR layout; those of vertex v begin at ``row_starts[v]``."""

    row_starts: IntArray  # first influence of each vertex, and the end ``(V + 1,)``
    # ``(K,)`` int32, per vertex the strongest first, without duplicates.
    joints: npt.NDArray[np.int32]
    weights: FloatArray  # ``(K,)`` [1], not zero; they sum to 1 per vertex

    @property
    def vertices(self) -> int:
        """Number of vertices."""
        return len(self.row_starts) - 1

    def select(self, vertices: IntArray) -> Influences:
        """Return the influences of selected vertices, in their order.

        Args:
            vertices: Vertex indices ``(N,)``, possibly repeated.
        """
        counts = np.diff(self.row_starts)[vertices]
        row_starts = np.concatenate([[0], np.cumsum(counts)])
        entries = np.arange(row_starts[-1]) + np.repeat(
            self.row_starts[vertices] - row_starts[:-1], counts
        )
        return Influences(row_starts, self.joints[entries], self.weights[entries])


@dataclass(frozen=True, slots=True)
class InfluenceReport:
    """Corrections applied to influences on reading."""

    normalized: int  # number of vertices with a weight sum off by more than 1e-6
    pruned: int  # number of vertices that lost influences to the limit
    zeros: int  # number of influences of zero weight, removed
    merged: int  # number of duplicate influences of a joint, merged
    sum_error: float  # largest difference of a vertex's weight sum from 1, as read
    sum_vertex: int  # the vertex with the largest difference


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
    joint_indices, weights_array = np.asarray(indices), np.asarray(weights, np.float64)
    _check_shapes(joint_indices, weights_array, vertices)
    if vertices is not None and len(joint_indices) == 1:
        joint_indices = np.broadcast_to(
            joint_indices, (vertices, joint_indices.shape[1])
        )
        weights_array = np.broadcast_to(weights_array, joint_indices.shape)
    _check_values(joint_indices, weights_array, joints)
    count = len(joint_indices)
    rows, joints_of_rows, sorted_weights = _merge_duplicates(
        joint_indices.astype(np.int64), weights_array, max(joints, 1)
    )
    weight_sums = np.bincount(rows, sorted_weights, count).astype(np.float64)
    is_kept = _first_entries(rows, count, max_influences)
    is_pruned = np.bincount(rows[~is_kept], minlength=count) > 0
    nonzero_count, merged_count = int(np.count_nonzero(weights_array)), len(rows)
    rows, joints_of_rows, sorted_weights = (
        rows[is_kept],
        joints_of_rows[is_kept],
        sorted_weights[is_kept],
    )
    kept_sums = np.bincount(rows, sorted_weights, count).astype(np.float64)
    _check_sums(weight_sums, kept_sums)
    errors = np.abs(weight_sums - 1)
    report = InfluenceReport(
        normalized=int(np.count_nonzero(errors > SUM_TOLERANCE)),
        pruned=int(np.count_nonzero(is_pruned)),
        zeros=weights_array.size - nonzero_count,
        merged=nonzero_count - merged_count,
        sum_error=float(errors.max(initial=0.0)),
        sum_vertex=int(np.argmax(errors)) if count else 0,
    )
    normalized = sorted_weights / kept_sums[rows]
    return Influences(
        _row_starts(rows, count), joints_of_rows.astype(np.int32), normalized
    ), report


def _merge_duplicates(
    joint_indices: IntArray, weights: FloatArray, joints: int
) -> tuple[IntArray, IntArray, FloatArray]:
    """Return vertex, joint and weight of each influence, duplicates merged.

    Sorted by vertex, then by descending weight; ties keep the order of the input.
    """
    order = np.argsort(-weights, axis=1, kind="stable")
    sorted_weights = np.take_along_axis(weights, order, axis=1)
    sorted_joints = np.take_along_axis(joint_indices, order, axis=1)
    is_nonzero = sorted_weights != 0
    rows = np.nonzero(is_nonzero)[0]
    sorted_joints, sorted_weights = (
        sorted_joints[is_nonzero],
        sorted_weights[is_nonzero],
    )
    if not _has_duplicates(joint_indices, weights):
        return rows, sorted_joints, sorted_weights
    pairs = rows * joints + sorted_joints
    unique, first_indices, inverse = np.unique(
        pairs, return_index=True, return_inverse=True
    )
    merged_weights = np.bincount(inverse, sorted_weights, len(unique)).astype(
        np.float64
    )
    order = np.argsort(first_indices)
    return unique[order] // joints, unique[order] % joints, merged_weights[order]


def _has_duplicates(joint_indices: IntArray, weights: FloatArray) -> bool:
    """Return whether any vertex has two nonzero weights for the same joint."""
    # Entries of zero weight get a placeholder that differs from all joints.
    placeholders = -1 - np.arange(joint_indices.shape[1])
    sorted_joints = np.sort(np.where(weights != 0, joint_indices, placeholders), axis=1)
    return bool((sorted_joints[:, 1:] == sorted_joints[:, :-1]).any())


def _row_starts(rows: IntArray, count: int) -> IntArray:
    """Return the CSR row offsets of sorted row indices ``(count + 1,)``."""
    counts = np.bincount(rows, minlength=count)
    return np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)


def _first_entries(rows: IntArray, count: int, max_count: int | None) -> BoolArray:
    """Return a mask of the first ``max_count`` entries of each row."""
    if max_count is None:
        return np.ones(len(rows), np.bool_)
    ranks = np.arange(len(rows)) - _row_starts(rows, count)[rows]
    return np.asarray(ranks < max_count, np.bool_)


def _check_shapes(
    joint_indices: npt.NDArray[np.generic], weights: FloatArray, vertices: int | None
) -> None:
    """Check that joint indices and weights have the same, expected shape."""
    faults = []
    if joint_indices.ndim != 2 or joint_indices.shape != weights.shape:
        message = (
            f"joint indices {joint_indices.shape} and weights {weights.shape} must "
            "both be (vertices, influences)"
        )
        faults.append(Fault("SKIN001", message))
    elif vertices is not None and len(joint_indices) not in {1, vertices}:
        message = (
            f"influences of {len(joint_indices)} vertices, but there are {vertices}"
        )
        faults.append(Fault("SKIN001", message))
    elif not np.issubdtype(joint_indices.dtype, np.integer):
        faults.append(
            Fault("SKIN002", f"joint indices are {joint_indices.dtype}, not integers")
        )
    if faults:
        raise FormatError(faults)


def _check_values(
    joint_indices: npt.NDArray[np.generic], weights: FloatArray, joints: int
) -> None:
    """Check that joint indices are in range and weights are finite."""
    integers = joint_indices.astype(np.int64)
    out_of_range = (integers < 0) | (integers >= joints)
    infinite = ~np.isfinite(weights)
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
    """Return a mask of the vertices with an invalid influence ``(V,)``."""
    return np.asarray(is_wrong.any(axis=1), np.bool_)


def _check_sums(sums: FloatArray, remaining_sums: FloatArray) -> None:
    """Check that the weights of each vertex sum above 0, before and after pruning."""
    without_weight = np.minimum(sums, remaining_sums) <= 0
    faults = _vertex_faults(
        "SKIN004", np.asarray(without_weight), "no weight on any joint"
    )
    if faults:
        raise FormatError(faults)


def _vertex_faults(code: str, is_wrong: BoolArray, problem: str) -> list[Fault]:
    """Return a fault that lists the vertices selected by a mask; empty if none are."""
    vertices = np.flatnonzero(is_wrong).tolist()
    if not vertices:
        return []
    noun = "vertex" if len(vertices) == 1 else f"{len(vertices)} vertices"
    return [Fault(code, f"{noun} with {problem}: {listed(vertices)}")]
