"""Base class for records of arrays that have the same number of rows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields
from typing import Any, Self

import numpy as np

from animtool.core.array_types import BoolArray, IntArray


class Rows:
    """Base of dataclasses whose fields are arrays with a row for each element."""

    __slots__ = ()

    def select(self, rows: IntArray | BoolArray) -> Self:
        """Return a record of the rows selected by indices or by a mask ``(N,)``."""
        record: Any = self
        return type(self)(*(getattr(record, f.name)[rows] for f in fields(record)))

    @classmethod
    def concatenate(cls, records: Sequence[Self]) -> Self:
        """Concatenate the rows of one or more records."""
        kind: Any = cls
        columns = ([getattr(r, f.name) for r in records] for f in fields(kind))
        return cls(*map(np.concatenate, columns))
