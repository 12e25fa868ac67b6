"""Where results go: a new array, or one of the caller's."""

from __future__ import annotations

import numpy as np

from animtool._types import FloatArray


def result(out: FloatArray | None, shape: tuple[int, ...]) -> FloatArray:
    """Return the caller's array if it gave one, else a new one of zeros.

    Of many frames, fresh memory takes about as long as the arithmetic.

    Raises:
        ValueError: It is of another shape or type, or not in one piece.

    >>> result(None, (1, 2)).tolist()
    [[0.0, 0.0]]
    """
    if out is None:
        return np.zeros(shape)
    if out.shape != shape or out.dtype != np.float64 or not out.flags.c_contiguous:
        raise ValueError(f"out must be float64 {shape}, in C order")
    return out
