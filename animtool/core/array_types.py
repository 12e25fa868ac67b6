"""Array types, and the check of arrays at public functions."""

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
    """Return values as C-contiguous float64 of the given shape.

    Args:
        values: Anything that numpy converts to floats.
        shape: One entry per axis: a length, or a letter for any length.
        name: Name of the array in messages.

    Raises:
        ValueError: The shape is another one, or the values are not numbers.

    >>> as_floats([[0, 1, 2]], ("F", 3), "positions").dtype
    dtype('float64')
    """
    try:
        array = np.ascontiguousarray(values, dtype=np.float64)
    except (TypeError, ValueError) as error:
        # Texts, and lists of different lengths.
        expected = ", ".join(map(str, shape))
        raise ValueError(f"{name} must be numbers of shape ({expected})") from error
    lengths = array.shape
    fits = len(lengths) == len(shape)
    if fits:
        for expected_length, length in zip(shape, lengths):  # noqa: B905 - of one length
            if expected_length != length and expected_length.__class__ is not str:
                fits = False
    if not fits:
        expected = ", ".join(map(str, shape))
        raise ValueError(f"{name} must have shape ({expected}), not {array.shape}")
    return array
