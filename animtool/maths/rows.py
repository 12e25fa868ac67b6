"""Dataclasses of arrays that have a row for each of what they describe."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields
from typing import Any, Self

import numpy as np

from animtool.core.array_types import BoolArray, IntArray


class Rows:
    """Base of dataclasses whose fields all are such arrays."""

    __slots__ = ()

    def select(self, rows: IntArray | BoolArray) -> Self:
        """Return some of them, by number in an order, or by a mask ``(N,)``."""
        own: Any = self
        return type(self)(*(getattr(own, each.name)[rows] for each in fields(own)))

    @classmethod
    def joined(cls, parts: Sequence[Self]) -> Self:
        """Return those of many, one after the other: at least one."""
        kind: Any = cls
        columns = ([getattr(one, f.name) for one in parts] for f in fields(kind))
        return cls(*map(np.concatenate, columns))
