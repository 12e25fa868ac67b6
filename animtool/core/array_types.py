"""Array types, and checks of the arrays passed to public functions."""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
import numpy.typing as npt

FloatArray: TypeAlias = npt.NDArray[np.float64]
Float32Array: TypeAlias = npt.NDArray[np.float32]
IntArray: TypeAlias = npt.NDArray[np.int64]
BoolArray: TypeAlias = npt.NDArray[np.bool_]
ArrayLike: TypeAlias = npt.ArrayLike


def as_floats(values: ArrayLike, shape: tuple[int | str, ...], name: str) -> FloatArray:
    """Return values as a C-contiguous float64 array after checking its shape.

    Args:
        values: Anything that numpy converts to floats.
        shape: One entry per axis: a length, or a letter for any length.
        name: Name of the array in messages.

    >>> as_floats([[0, 1, 2]], ("F", 3), "positions").dtype
    dtype('float64')
    """
    try:
        array = np.ascontiguousarray(values, np.float64)
    except (TypeError, ValueError) as error:
        # Texts, and lists of different lengths.
        shape_text = ", ".join(map(str, shape))
        raise ValueError(f"{name} must be numbers of shape ({shape_text})") from error
    lengths = array.shape
    # Callers mostly know all lengths, or all but the first.
    has_shape = lengths == shape or (
        lengths[1:] == shape[1:] and bool(lengths) and shape[0].__class__ is str
    )
    if not has_shape and not _matches_shape(lengths, shape):
        shape_text = ", ".join(map(str, shape))
        raise ValueError(f"{name} must have shape ({shape_text}), not {array.shape}")
    return array


def _matches_shape(lengths: tuple[int, ...], shape: tuple[int | str, ...]) -> bool:
    return len(lengths) == len(shape) and all(
        isinstance(expected, str) or expected == length
        for expected, length in zip(shape, lengths, strict=True)
    )


def median(values: FloatArray) -> FloatArray:
    """Return the median of each column of an array ``(N, ...)`` of one or more rows.

    `numpy.median` does the same, but loads `numpy.ma`, which takes 7 ms.

    >>> float(median(np.array([4.0, 1.0, 2.0, 9.0])))
    3.0
    """
    sorted_values, middle = np.sort(values, axis=0), len(values) // 2
    middles = sorted_values[middle - (len(values) % 2 == 0) : middle + 1]
    last = sorted_values[-1]  # NaN is sorted last
    medians: FloatArray = np.where(np.isnan(last), last, middles.mean(axis=0))
    return medians


def distinct_values(values: FloatArray) -> FloatArray:
    """Return the different values of an array ``(N,)``, sorted.

    `numpy.unique` does the same, but loads `numpy.ma`, as `numpy.median` does.

    >>> distinct_values(np.array([2.0, 1.0, 2.0])).tolist()
    [1.0, 2.0]
    """
    sorted_values = np.sort(values)
    is_first = np.ones(len(values), bool)
    is_first[1:] = sorted_values[1:] != sorted_values[:-1]
    return sorted_values[is_first]


def output_array(out: FloatArray | None, shape: tuple[int, ...]) -> FloatArray:
    """Return the caller's output array, or a new array of zeros.

    For many frames, allocating memory takes about as long as the arithmetic.

    >>> output_array(None, (1, 2)).tolist()
    [[0.0, 0.0]]
    """
    if out is None:
        return np.zeros(shape)
    if out.shape != shape or out.dtype != np.float64 or not out.flags.c_contiguous:
        raise ValueError(f"out must be float64 {shape}, in C order")
    return out
