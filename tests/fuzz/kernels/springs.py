"""Springs and strands."""

from __future__ import annotations

from fuzz.kernels import Maker

CALLS: dict[str, Maker] = {}
UNBOUNDED: frozenset[str] = frozenset()
