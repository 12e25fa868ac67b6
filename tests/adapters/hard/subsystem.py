"""What a thing that simulates does of the hard cases."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import TypeAlias

from support.suite import is_full

__all__ = ["Case", "Subsystem", "Unfit", "resting_seconds"]

# It raises where a way of simulating does not behave as a case asks.
Case: TypeAlias = Callable[[str], None]
# Whether a way of simulating has no such case.
Unfit: TypeAlias = Callable[[str], bool]


def resting_seconds(way: str, ways: Sequence[str]) -> int:
    """Return how long a way rests [s].

    The minute that the case asks for by the first of the ways; the others differ in
    how they move, and rest as long in the full profile alone.
    """
    return 60 if way == ways[0] or is_full() else 12


@dataclass(frozen=True)
class Subsystem:
    """A thing that simulates.

    Attributes:
        name: Of it.
        ways: How it simulates: solvers, methods.
        cases: By their ids.
        apart: Why there is none of other ids.
        unfit: Of some cases, which ways have none.
    """

    name: str
    ways: Sequence[str]
    cases: dict[str, Case]
    apart: dict[str, str]
    unfit: dict[str, Unfit] = field(default_factory=dict)

    def ways_of(self, case: str) -> list[str]:
        """Return the ways that have a case."""
        unfit = self.unfit.get(case, lambda _: False)
        return [way for way in self.ways if not unfit(way)]
