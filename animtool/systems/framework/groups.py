"""Individuals of several entries of a spec, such as species or populations."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import cached_property
from typing import Any, ClassVar

import numpy as np

from animtool.core.array_types import FloatArray, IntArray
from animtool.core.errors import Problem, excerpt
from animtool.core.record import dataclass


@dataclass(frozen=True)
class Groups:
    """N individuals, ordered by their entry, such as a species."""

    noun: ClassVar[str]  # word for an individual in messages
    entries: Sequence[Any]  # models with a name and a radius
    end_indices: Sequence[int]  # end index of each entry

    def __len__(self) -> int:
        """Return the number of individuals."""
        return self.end_indices[-1]

    @cached_property
    def ranges_by_entry(self) -> list[slice]:
        """Index range of each entry."""
        start_indices = [0, *self.end_indices[:-1]]
        return [
            slice(a, b) for a, b in zip(start_indices, self.end_indices, strict=True)
        ]

    @cached_property
    def entry_indices(self) -> IntArray:
        """Entry index of each individual ``(N,)``."""
        return np.repeat(np.arange(len(self.entries)), np.diff([0, *self.end_indices]))

    def repeat_per_individual(self, entry_values: Sequence[float]) -> FloatArray:
        """Return the value of each entry, repeated for all its individuals ``(N,)``."""
        return np.asarray(entry_values, np.float64)[self.entry_indices]

    @cached_property
    def radii(self) -> FloatArray:
        """Radius of each individual ``(N,)`` [m]."""
        return self.repeat_per_individual([entry.radius for entry in self.entries])

    def label(self, i: int) -> str:
        """Return the name of an individual for messages."""
        entry_index = int(self.entry_indices[i])
        number = i - self.ranges_by_entry[entry_index].start
        return f"{self.noun} {number} of {self.entries[entry_index].name!r}"


def duplicate_names(key: str, names: Sequence[str]) -> Iterator[Problem]:
    """Yield a problem for each entry of a key with a repeated name."""
    for k, name in enumerate(names):
        if name in names[:k]:
            yield f"two {key} are named {excerpt(name)}", f"{key}[{k}]", None
