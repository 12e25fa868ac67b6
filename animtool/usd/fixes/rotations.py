"""Quaternions of unit length, with signs that are continuous along time."""

from __future__ import annotations

from typing import Any

import numpy as np

from animtool.errors import Fault, counted
from animtool.maths import so3
from animtool.usd.fixes.target import AnyArray, Change, Edit, NotFixableError, Target
from animtool.usd.fixes.target import rewrite as rewrite_arrays

# Shorter quaternions have no direction that can be trusted.
MIN_LENGTH = 1e-3


def continuous(target: Target, fault: Fault) -> Edit:
    """Negate the rotations that change their sign between samples."""
    spec = target.attribute(fault)

    def edit() -> Change:
        flipped = 0

        def aligned(arrays: list[AnyArray]) -> list[AnyArray]:
            nonlocal flipped
            q = _stacked(arrays)
            new = so3.align_signs(q, q[0])
            flipped = int((new != q).any(axis=-1).sum())
            return [row.astype(q.dtype) for row in new]

        changed, count, _ = rewrite_arrays(spec, aligned)
        samples = f"{changed} of {counted(count, 'sample')}"
        return Change(f"negates {counted(flipped, 'quaternion')} in {samples}")

    return edit


def unit(target: Target, fault: Fault) -> Edit:
    """Divide rotations by their lengths."""
    spec = target.attribute(fault)

    def edit() -> Change:
        off = 0

        def normalised(arrays: list[AnyArray]) -> list[AnyArray]:
            nonlocal off
            new = []
            for array in arrays:
                lengths = np.linalg.norm(array.astype(np.float64), axis=-1)
                if not (lengths > MIN_LENGTH).all() or not np.isfinite(lengths).all():
                    raise NotFixableError("a quaternion has no direction")
                wrong = np.abs(lengths - 1) > _rounding(array)
                off += int(wrong.sum())
                rows = array / np.where(wrong, lengths, 1.0)[..., None]
                new.append(rows.astype(array.dtype))
            return new

        changed, count, largest = rewrite_arrays(spec, normalised)
        samples = f"{changed} of {counted(count, 'sample')}"
        text = f"normalises {counted(off, 'quaternion')} in {samples}"
        return Change(text, largest)

    return edit


def _stacked(arrays: list[AnyArray]) -> AnyArray:
    if len({array.shape for array in arrays}) != 1:
        raise NotFixableError("samples have different numbers of rotations")
    return np.stack(arrays)


def _rounding(array: Any) -> float:
    """Return how far from one a unit quaternion's length may be by rounding."""
    return 4 * float(np.finfo(array.dtype).eps)
