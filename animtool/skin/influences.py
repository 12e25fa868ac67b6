"""Checks and normalises the joint influences of vertices."""

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
    def vertex_count(self) -> int:
        """Number of vertices, also those without influences."""
        return len(self.row_starts) - 1


@dataclass(frozen=True, slots=True)
class InfluenceReport:
    """Corrections applied to influences on reading."""

    normalized_count: int  # number of vertices with a weight sum off by more than 1e-6
    sum_error: float  # largest difference of a vertex's weight sum from 1, as read
    sum_vertex: int  # the vertex with the largest difference


def read_influences(
    indices: ArrayLike,
    weights: ArrayLike,
    joint_count: int,
    *,
    vertex_count: int | None = None,
) -> tuple[Influences, InfluenceReport]:
    """Return the normalised influences of a mesh, and a report of the corrections.

    Influences of zero weight are removed, duplicate joints of a vertex are merged, and
    the weights of each vertex are normalised to the sum 1.

    Args:
        indices: ``(V, I)`` joint indices, or ``(1, I)`` for all vertices.
        weights: The same shape [1].
        joint_count: Number of joints.
        vertex_count: Expected number of vertices; None is the number of rows.

    >>> influences, report = read_influences([[0, 1]], [[3.0, 1.0]], joint_count=2)
    >>> influences.weights.tolist(), report.normalized_count, report.sum_error
    ([0.75, 0.25], 1, 3.0)
    """
    joint_indices, weights_array = np.asarray(indices), np.asarray(weights, np.float64)
    _check_array_shapes(joint_indices, weights_array, vertex_count)
    if vertex_count is not None and len(joint_indices) == 1:
        joint_indices = np.broadcast_to(
            joint_indices, (vertex_count, joint_indices.shape[1])
        )
        weights_array = np.broadcast_to(weights_array, joint_indices.shape)
    integer_indices = joint_indices.astype(np.int64)
    is_outside = np.asarray(
        ((integer_indices < 0) | (integer_indices >= joint_count)).any(axis=1)
    )
    is_not_finite = np.asarray(~np.isfinite(weights_array).all(axis=1))
    _raise_vertex_faults(
        ("SKIN002", is_outside, f"a joint index outside 0…{joint_count - 1}"),
        ("SKIN003", is_not_finite, "a weight that is not finite"),
    )
    row_count = len(joint_indices)
    vertices, joints, sorted_weights = _merge_duplicates(
        integer_indices, weights_array, max(joint_count, 1)
    )
    weight_sums = np.bincount(vertices, sorted_weights, row_count).astype(np.float64)
    _raise_vertex_faults(
        ("SKIN004", np.asarray(weight_sums <= 0), "no weight on any joint")
    )
    sum_errors = np.abs(weight_sums - 1)
    report = InfluenceReport(
        normalized_count=int(np.count_nonzero(sum_errors > SUM_TOLERANCE)),
        sum_error=float(sum_errors.max(initial=0.0)),
        sum_vertex=int(np.argmax(sum_errors)) if row_count else 0,
    )
    row_starts = np.searchsorted(vertices, np.arange(row_count + 1))
    normalized_weights = sorted_weights / weight_sums[vertices]
    influences = Influences(row_starts, joints.astype(np.int32), normalized_weights)
    return influences, report


def _merge_duplicates(
    joint_indices: IntArray, weights: FloatArray, joint_count: int
) -> tuple[IntArray, IntArray, FloatArray]:
    """Return the vertex, joint and weight of each influence, with duplicates merged.

    Sorted by vertex, then by descending weight; ties keep the order of the input.
    """
    order = np.argsort(-weights, axis=1, kind="stable")
    sorted_weights = np.take_along_axis(weights, order, axis=1)
    sorted_joints = np.take_along_axis(joint_indices, order, axis=1)
    is_nonzero = sorted_weights != 0
    vertices = np.nonzero(is_nonzero)[0]
    sorted_joints = sorted_joints[is_nonzero]
    sorted_weights = sorted_weights[is_nonzero]
    if not _has_duplicates(joint_indices, weights):
        return vertices, sorted_joints, sorted_weights
    vertex_joint_keys = vertices * joint_count + sorted_joints
    unique_vertex_joint_keys, first_indices, inverse = np.unique(
        vertex_joint_keys, return_index=True, return_inverse=True
    )
    merged_weights = np.bincount(
        inverse, sorted_weights, len(unique_vertex_joint_keys)
    ).astype(np.float64)
    order = np.argsort(first_indices)
    return (
        unique_vertex_joint_keys[order] // joint_count,
        unique_vertex_joint_keys[order] % joint_count,
        merged_weights[order],
    )


def _has_duplicates(joint_indices: IntArray, weights: FloatArray) -> bool:
    """Return whether any vertex has two nonzero weights for the same joint."""
    # Entries of zero weight get a placeholder that differs from all joints.
    placeholders = -1 - np.arange(joint_indices.shape[1])
    sorted_joints = np.sort(np.where(weights != 0, joint_indices, placeholders), axis=1)
    return bool((sorted_joints[:, 1:] == sorted_joints[:, :-1]).any())


def _check_array_shapes(
    joint_indices: npt.NDArray[np.generic],
    weights: FloatArray,
    vertex_count: int | None,
) -> None:
    """Raise unless joint indices are integers with the array shape of the weights."""
    if joint_indices.ndim != 2 or joint_indices.shape != weights.shape:
        message = (
            f"joint indices {joint_indices.shape} and weights {weights.shape} must "
            "both be (vertices, influences)"
        )
        raise FormatError(Fault("SKIN001", message))
    if vertex_count is not None and len(joint_indices) not in {1, vertex_count}:
        message = (
            f"influences of {len(joint_indices)} vertices, but there are {vertex_count}"
        )
        raise FormatError(Fault("SKIN001", message))
    if not np.issubdtype(joint_indices.dtype, np.integer):
        message = f"joint indices are {joint_indices.dtype}, not integers"
        raise FormatError(Fault("SKIN002", message))


def _raise_vertex_faults(*checks: tuple[str, BoolArray, str]) -> None:
    """Raise one fault per failed check, listing its invalid vertices.

    A check has a code, a mask of the invalid vertices ``(V,)``, and their problem.
    """
    faults = []
    for code, is_invalid, problem in checks:
        invalid_vertices = np.flatnonzero(is_invalid).tolist()
        if invalid_vertices:
            noun = (
                "vertex"
                if len(invalid_vertices) == 1
                else f"{len(invalid_vertices)} vertices"
            )
            message = f"{noun} with {problem}: {listed(invalid_vertices)}"
            faults.append(Fault(code, message))
    if faults:
        raise FormatError(faults)
