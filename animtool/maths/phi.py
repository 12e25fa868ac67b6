"""Matrix functions φ, for the exact solution of linear equations over a step.

References:
    M. Hochbruck, A. Ostermann, "Exponential integrators", Acta Numerica 2010, eq. 2.10:
    ``φ0(A) = exp(A)``, ``φk(A) = Σ A^j / (j + k)!``. N. Higham, "Functions of
    Matrices", 2008, ch. 10: scaling and doubling.
"""

from __future__ import annotations

import math

import numpy as np

from animtool.core.array_types import FloatArray

# Matrices are halved until their norm is below this; then the series needs few terms.
_MAX_NORM = 0.5
# Terms of the series for matrices up to a norm: the remainder is below rounding.
_SERIES_TERMS = ((0.02, 7), (0.15, 10), (_MAX_NORM, 14))


def phi_functions(matrices: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return φ1 and φ2 of matrices ``(M, n, n)``; equal matrices are computed once.

    >>> phi_functions(np.array([[[0.0]], [[-1e3]]]))[0][:, 0, 0].tolist()
    [1.0, 0.001]
    """
    matrix_count = len(matrices)
    matrices, inverse_indices = np.unique(matrices, axis=0, return_inverse=True)
    inverse_indices = inverse_indices.reshape(matrix_count)
    norm = float(np.abs(matrices).sum(axis=2).max(initial=0.0))
    halving_count = max(math.ceil(math.log2(norm / _MAX_NORM)), 0) if norm > 0 else 0
    scaled_matrices, identity = matrices / 2.0**halving_count, np.eye(matrices.shape[1])
    scaled_norm = norm / 2.0**halving_count
    term_count = next(
        (n for max_norm, n in _SERIES_TERMS if scaled_norm <= max_norm),
        _SERIES_TERMS[-1][1],
    )
    phi2 = np.broadcast_to(identity / math.factorial(term_count + 2), matrices.shape)
    for k in range(term_count - 1, -1, -1):
        phi2 = scaled_matrices @ phi2 + identity / math.factorial(k + 2)
    phi1 = identity + scaled_matrices @ phi2
    exponential = identity + scaled_matrices @ phi1
    for _ in range(halving_count):
        phi2 = (exponential @ phi2 + phi1 + phi2) / 4
        phi1 = (exponential @ phi1 + phi1) / 2
        exponential = exponential @ exponential
    return phi1[inverse_indices], phi2[inverse_indices]
