"""Operations of a prim's transform."""

from __future__ import annotations

from typing import Any

from pxr import Gf, Sdf, Vt

from animtool._types import FloatArray
from animtool.usd.layers import attribute


def author_order(spec: Any, *names: str) -> None:
    """Say in which order a prim's operations follow each other."""
    order = Vt.TokenArray(names)
    types = Sdf.ValueTypeNames
    attribute(spec, "xformOpOrder", types.TokenArray, order, uniform=True)


def quaternion(row: FloatArray) -> Any:
    """Return a quaternion ``(4,)``, x y z w, as USD has it.

    >>> import numpy as np
    >>> quaternion(np.array([0.0, 0.0, 0.0, 1.0])).GetReal()
    1.0
    """
    x, y, z, w = row.tolist()
    return Gf.Quatd(w, x, y, z)
