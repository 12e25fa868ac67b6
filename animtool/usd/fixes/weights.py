"""Weights of skins that sum to one at every point."""

from __future__ import annotations

import numpy as np

from animtool.errors import Fault, counted
from animtool.usd.fixes.target import (
    AnyArray,
    Change,
    Edit,
    NotFixableError,
    Target,
    rewrite,
)

# Of a sum: float32 weights cannot do better.
ROUNDING = 1e-6


def normalised(target: Target, fault: Fault) -> Edit:
    """Divide the weights of each point by their sum."""
    spec = target.attribute(fault)
    attr = target.stage.GetAttributeAtPath(fault.where)
    size = int(attr.GetMetadata("elementSize") or 1)
    indices = target.stage.GetAttributeAtPath(f"{fault.where}:indices")
    if indices and indices.HasAuthoredValue():
        raise NotFixableError("the weights are indexed")

    def edit() -> Change:
        points = total = 0

        def divided(arrays: list[AnyArray]) -> list[AnyArray]:
            nonlocal points, total
            new = []
            for array in arrays:
                rows = array.astype(np.float64).reshape(-1, size)
                sums = rows.sum(axis=1, keepdims=True)
                if not (sums > 0).all() or not np.isfinite(sums).all():
                    raise NotFixableError("a point has no weight at all")
                wrong = np.abs(sums - 1) > ROUNDING
                points, total = points + int(wrong.sum()), total + len(rows)
                rows = rows / np.where(wrong, sums, 1.0)
                new.append(rows.reshape(array.shape).astype(array.dtype))
            return new

        _, _, largest = rewrite(spec, divided)
        text = f"divides the weights of {points} of {counted(total, 'point')} "
        return Change(f"{text}by their sums", largest)

    return edit
