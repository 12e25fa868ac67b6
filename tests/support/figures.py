"""Figures of results: one number for each array, that each of its values has a part in.

Some laws have no number that could be worked out by hand: how a leg reaches ground that
slopes below who turns and is pushed. What such a small run gives is kept in
`figures.json` beside its tests, so that another factor, sign or index is noticed there,
while tests of laws tell what is right. Where a change is meant, they are written anew
with ``ANIMTOOL_FIGURES=write``, and what changed is looked at.
"""

from __future__ import annotations

import json
import math
import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import fields, is_dataclass
from enum import Enum
from fractions import Fraction
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np

from animtool.core.errors import Fault

WRITE = "ANIMTOOL_FIGURES"
# Numbers of another processor differ by rounding alone.
RELATIVE, ABSOLUTE = 1e-6, 1e-9
# What stands for a value that is missing.
MISSING = 7.25
# Longer texts are kept as digests.
LONG = 300
# Messages are compared by their numbers, not by their words.
_NUMBER = re.compile(r"(?<![\w.])\d+(?:\.\d+)?(?:e[-+]?\d+)?")


def figure(values: Any) -> float:
    """Return a number that each of some values has a part of its own in.

    >>> figure([1.0, 2.0]) == figure([2.0, 1.0])
    False
    """
    flat = np.asarray(values, float).ravel()
    weights = 1.5 + np.cos(1.0 + np.arange(len(flat), dtype=float))
    known = np.where(np.isfinite(flat), flat, np.where(flat > 0, 5 * MISSING, MISSING))
    return float((known * weights).sum()) + len(flat)


def figures(value: Any, name: str = "") -> dict[str, float | str]:
    """Return the figures of a record, by field; those of a list's entries are one."""
    if isinstance(value, Fault):
        numbers = [float(text) for text in _NUMBER.findall(value.message)]
        return {f"{name}.code": value.code, f"{name}.numbers": figure(numbers)}
    if value is None:
        return {}
    if isinstance(value, str | Path | Enum):
        return {name: _short(str(value))}
    if isinstance(value, bool | int | float | Fraction | np.ndarray | np.generic):
        return {name: figure(value)}
    if is_dataclass(value) and not isinstance(value, type):
        value = {one.name: getattr(value, one.name) for one in fields(value)}
    if isinstance(value, Mapping):
        found: dict[str, float | str] = {}
        for key, part in value.items():
            found |= figures(part, f"{name}.{key}" if name else str(key))
        return found
    if not isinstance(value, Sequence | set | frozenset):
        message = f"{name} is a {type(value).__name__}: it has no figure"
        raise TypeError(message)
    parts = value if isinstance(value, Sequence) else sorted(value)
    return _folded([figures(part, name) for part in parts]) | {
        f"{name}.count": float(len(parts))
    }


def _short(text: str) -> str:
    """Return a text, one of many lines by its digest."""
    return text if len(text) < LONG else sha256(text.encode()).hexdigest()[:16]


def _folded(parts: Sequence[Mapping[str, float | str]]) -> dict[str, float | str]:
    """Return figures of entries as one: numbers by weight, texts one after another."""
    made: dict[str, Any] = {}
    for i, part in enumerate(parts):
        for key, one in part.items():
            if isinstance(one, str):
                made[key] = f"{made[key]} {one}" if key in made else one
            else:
                made[key] = made.get(key, 0.0) + one * (1.5 + math.sin(1.0 + i))
    return made


def check_figures(test: str, name: str, value: Any) -> None:
    """Compare the figures of what a run gives with those that are kept.

    Args:
        test: The file of the test.
        name: Of the run.
        value: What it gives.
    """
    path = Path(test).with_name("figures.json")
    known = json.loads(path.read_text("utf-8")) if path.exists() else {}
    found = figures(value)
    if os.environ.get(WRITE) == "write":
        kept = {key: _rounded(one) for key, one in found.items()}
        text = json.dumps(known | {name: kept}, indent=1, sort_keys=True)
        path.write_text(text + "\n", "utf-8")
        return
    kept = known[name]
    assert found.keys() == kept.keys()
    other = {
        key: (kept[key], one) for key, one in found.items() if not _same(one, kept[key])
    }
    assert not other, f"{name}: {other}"


def _rounded(value: float | str) -> float | str:
    return value if isinstance(value, str) else float(f"{value:.12g}")


def _same(one: float | str, other: float | str) -> bool:
    if isinstance(one, str) or isinstance(other, str):
        return one == other
    return math.isclose(one, other, rel_tol=RELATIVE, abs_tol=ABSOLUTE)
